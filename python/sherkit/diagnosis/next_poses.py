"""What to measure next: the poses that tell tied models apart best, or what else would where no pose does.

T-optimality (Atkinson and Fedorov, "The design of experiments for discriminating between two rival models", 1975):
take the first model as fitted for true, and look for poses where the best refit of the rival still misses it most.
Poses are chosen one after another. The new rows are measured after the run, so time goes on; that alone separates a
cause in time from one in space where the run had mixed them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..base import linalg
from ..base.names import listed
from ..base.types import Floats
from ..data import Measurements
from ..data.columns import bare
from ..errors import SherkitError
from ..fit.identify import Fit
from ..model.base import Reachable

MOST = 12
#: Separation from which poses are worth measuring, in standard deviations.
TELLS_SIGMA = 3.0
SEPARATION = "separation_sigma"
#: Digits of what would be read at a pose.
_DIGITS_READ = 3
_PAUSE_S = 600.0
_SECONDS_PER_POSE = 3.0


@dataclass(frozen=True)
class Proposal:
    """Poses in the order to measure them, and a sentence on what they cannot tell; either may be empty.

    A pose names the joints to drive to, the coordinates of the drawing's kinematics that these are, what would be read
    there where that is something else, and ``separation_sigma``: how far the nearest rival that the poses can tell,
    refitted to run and poses up to this one, is still from the true model, in standard deviations, where each new pose
    is read as often as those of the run.
    """

    poses: tuple[dict[str, float], ...] = ()
    advice: str = ""


def next_poses(true: Fit, rivals: Sequence[Fit], sigma: Floats, most: int = MOST) -> Proposal:
    """Up to ``most`` reachable poses that tell ``true`` from its rivals; ``sigma`` (m,) is the noise of each reading.

    A rival that no reachable poses tell by :data:`TELLS_SIGMA` is left out, and named in the advice with what else, as
    fine as these readings, would tell it.
    """
    reachable = true.model.reachable(true.data, true.values)
    if reachable is None or not rivals:
        return Proposal()
    try:
        trial = _Trial(true, reachable.rows, sigma, most)
        problems = [_Problem(trial, rival) for rival in rivals]
        chosen, told = _chosen(problems, most)
        untold = {p.rival: float(np.sqrt(max(p.distance, 0.0))) for p in problems if p not in told}
        if not untold:
            return Proposal(_named(trial, reachable, chosen))
        advice = _advice(true, reachable.rows, untold, sigma, most)
    except SherkitError:
        return Proposal()
    return Proposal(_named(trial, reachable, chosen), advice)


def _chosen(problems: Sequence[_Problem], most: int) -> tuple[list[tuple[int, float]], list[_Problem]]:
    """Poses with the separation reached with each, and the rivals that they tell: the nearest are given up one after
    another until the others are told."""
    left = list(problems)
    while left:
        poses = _greedy(left, most)
        if poses and poses[-1][1] >= TELLS_SIGMA:
            return poses, left
        left.remove(min(left, key=lambda p: p.distance))
    return [], []


def _greedy(problems: Sequence[_Problem], most: int) -> list[tuple[int, float]]:
    for p in problems:
        p.begin()
    out: list[tuple[int, float]] = []
    for k in range(most):
        scores = np.min([p.scores(k) for p in problems], axis=0)
        scores[[pose for pose, _ in out]] = -1.0
        best = int(np.argmax(scores))
        if not scores[best] > 0:
            break
        for p in problems:
            p.add(best, k)
        out.append((best, float(np.sqrt(max(min(p.distance for p in problems), 0.0)))))
    return out


def _named(trial: _Trial, reachable: Reachable, chosen: Sequence[tuple[int, float]]) -> tuple[dict[str, float], ...]:
    """Each pose by the names of its numbers."""
    layout = reachable.rows.layout
    columns = dict(zip(layout.joints, reachable.rows.joints.T, strict=True)) | dict(reachable.targets)
    if not set(layout.coordinates) & set(columns):
        columns |= dict(zip(layout.coordinates, np.round(trial.told[0].T, _DIGITS_READ), strict=False))
    return tuple(
        {name: float(column[pose]) for name, column in columns.items()} | {SEPARATION: separation}
        for pose, separation in chosen
    )


def _what(fit: Fit, other: Fit) -> str:
    """The effects that a fit has and another has not."""
    names = {e.name for e in other.model.effects}
    return " with ".join(e.name for e in fit.model.effects if e.name not in names) or "the model without effects"


def _advice(true: Fit, rows: Measurements, untold: Mapping[Fit, float], sigma: Floats, most: int) -> str:
    """That these instruments cannot tell, and which of the readings that the model can predict would; ``untold`` has
    the separation that poses reach, in standard deviations."""
    would: dict[str, list[str]] = {}
    for rival in untold:
        told_by = _told_by(true, rows, rival, sigma, most) or "no instrument known to sherkit"
        would.setdefault(told_by, []).append(_what(rival, true))
    which = listed([f"{_what(rival, true)} (by {reached:.1f} σ)" for rival, reached in untold.items()])
    lead = _what(true, next(iter(untold)))
    poses = "no reachable poses, read as often as those of the run,"
    out = f"{poses} tell {lead} from {which}: these instruments cannot tell"
    if len(would) == 1:
        return f"{out}; {next(iter(would))} would"
    return "; ".join([out, *(f"{one} would tell {listed(names)}" for one, names in would.items())])


def _told_by(true: Fit, rows: Measurements, rival: Fit, sigma: Floats, most: int) -> str:
    """Readings besides these that would tell a rival; empty where none that the model can predict does."""
    read = true.data.taken[:, : true.data.coordinates].any(axis=0)
    for layout in true.model.readable(true.data):
        same = layout == true.data.layout
        if same and read.all():
            continue
        other = rows.to_be_read(layout)
        of_new = sigma[: rows.coordinates] if same else _as_fine(true, rows, other, sigma)
        for zero_is_free, said in ((True, ""), (False, " and counted from a zero that is surveyed to the base")):
            problem = _Problem(_Trial(true, other, sigma, most, of_new=of_new, zero_is_free=zero_is_free), rival)
            if _chosen([problem], most)[1]:
                return f"readings of {listed([bare(name) for name in layout.coordinates])}, as fine as these{said},"
    return ""


def _as_fine(fit: Fit, rows: Measurements, other: Measurements, sigma: Floats) -> Floats:
    """Noise (c,) of other readings that shows a movement of the joints as well as these do."""

    def answer(seen: Measurements) -> Floats:
        inputs = fit.model.linearised(seen, fit.values).inputs
        assert inputs is not None, "a model that knows what it can read knows its joints"
        return np.median(np.linalg.norm(inputs[:, : seen.coordinates], axis=2), axis=0)

    now = answer(rows) / sigma[: rows.coordinates]
    return answer(other) / np.sqrt(np.mean(now**2))


class _Trial:
    """The same poses at each later moment at which they could be read, and what the true model says of them.

    ``of_new`` (c,) is the noise of the new readings where it is not that of the old ones; ``zero_is_free`` where their
    zero is not known and is identified besides.
    """

    def __init__(
        self,
        true: Fit,
        rows: Measurements,
        sigma: Floats,
        most: int,
        *,
        of_new: Floats | None = None,
        zero_is_free: bool = False,
    ) -> None:
        self.true, self.zero_is_free = true, zero_is_free
        self.sigma = sigma[: true.data.coordinates]
        # each new pose is read as often as those of the run
        often = np.sqrt(len(true.data) / len(np.unique(true.data.groups)))
        self.of_new = (self.sigma if of_new is None else of_new) / often
        self.later = [_at(rows, true, k) for k in range(most)]
        self.told = [true.model.predict(one, true.values)[:, : rows.coordinates] for one in self.later]


class _Problem:
    """One rival: its normal equations with the old rows, and what each new pose would add."""

    def __init__(self, trial: _Trial, rival: Fit) -> None:
        self.rival, self.distance = rival, 0.0
        data, true, sigma = rival.data, trial.true, trial.sigma
        count = data.coordinates
        used = data.used[:, :count]
        old = rival.model.derivatives(data, rival.values)[:, :count]
        old = np.where(used[:, :, None], old / sigma[:, None], 0.0)
        scale = np.linalg.norm(old.reshape(-1, old.shape[2]), axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        flat = old.reshape(-1, old.shape[2]) / scale
        apart = (true.model.predict(data, true.values) - rival.predicted)[:, :count]
        apart = np.where(used, apart / sigma, 0.0).reshape(-1)
        zeros = len(trial.of_new) if trial.zero_is_free else 0
        size = flat.shape[1] + zeros
        self._gram, self._right = np.zeros((size, size)), np.zeros(size)
        self._gram[: flat.shape[1], : flat.shape[1]] = flat.T @ flat
        self._right[: flat.shape[1]] = flat.T @ apart
        self._square = float(apart @ apart)
        self.new = []
        for rows, there in zip(trial.later, trial.told, strict=True):
            made = rival.model.derivatives(rows, rival.values)[:, : rows.coordinates]
            columns = made / trial.of_new[:, None] / scale
            if zeros:
                own = np.broadcast_to(np.eye(zeros), (len(rows), zeros, zeros))
                columns = np.concatenate([columns, own], axis=2)
            away = there - rival.model.predict(rows, rival.values)[:, : rows.coordinates]
            self.new.append((columns, away / trial.of_new))
        self.begin()

    def begin(self) -> None:
        """Nothing has been measured besides the run."""
        self.gram, self.right, self.square = self._gram.copy(), self._right.copy(), self._square

    def scores(self, k: int) -> Floats:
        """Distance of the refitted rival from the true model once each pose is added as the k-th."""
        columns, away = self.new[k]
        value, vector = linalg.eigh(self.gram)
        keep = value > 1e-10 * value[-1]
        root = vector[:, keep] / np.sqrt(value[keep])
        rest = vector[:, ~keep]
        x = root @ (root.T @ self.right)
        miss = away - columns @ x
        # directions that the old rows do not observe must not count as separation: they are free to fit
        free = columns @ rest
        spread = columns @ root
        covariance = (
            np.eye(columns.shape[1]) + spread @ spread.transpose(0, 2, 1) + 1e8 * free @ free.transpose(0, 2, 1)
        )
        gained = np.einsum("na,na->n", miss, linalg.solve(covariance, miss[:, :, None])[:, :, 0])
        return gained + self.square - float(self.right @ x)

    def add(self, pose: int, k: int) -> None:
        """Takes a pose into the data."""
        columns, away = self.new[k][0][pose], self.new[k][1][pose]
        self.gram += columns.T @ columns
        self.right += columns.T @ away
        self.square += float(away @ away)
        value, vector = linalg.eigh(self.gram)
        keep = value > 1e-10 * value[-1]
        root = vector[:, keep] / np.sqrt(value[keep])
        x = root @ (root.T @ self.right)
        self.distance = self.square - float(self.right @ x)


def _at(rows: Measurements, fit: Fit, k: int) -> Measurements:
    """The rows at the moment at which the k-th new pose would be measured: after a pause."""
    if fit.data.time_s is None:
        return rows
    end = float(fit.data.time_s.max())
    return replace(rows, time_s=np.full(len(rows), end + _PAUSE_S + k * _SECONDS_PER_POSE))
