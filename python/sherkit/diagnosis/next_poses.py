"""What to measure next: the poses that tell tied models apart best, or what else would where no pose does.

The first model as fitted is taken for true, and poses are chosen where the best refit of its rivals still misses it
most (:mod:`~sherkit.evidence.design`). The new rows are measured after the run, so time goes on; that alone separates a
cause in time from one in space where the run had mixed them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..base.figures import listed
from ..base.types import Floats
from ..data import Measurements
from ..data.columns import bare
from ..errors import SherkitError
from ..evidence.design import Rival, telling
from ..evidence.thresholds import SURE_SIGMA, TIED
from ..fit.identify import Fit
from ..model.base import Reachable

MOST = 12
#: That with which four of five ties are lifted: what it says in nats, half its square, scatters by itself.
_LIFTS_SIGMA = 0.84 + float(np.sqrt(0.84**2 + 2.0 * TIED))
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

    A rival that no reachable poses tell by three deviations is left out, and named in the advice with what else, as
    fine as these readings, would tell it.
    """
    reachable = true.model.reachable(true.data, true.values)
    if reachable is None or not rivals:
        return Proposal()
    try:
        trial = _Trial(true, reachable.rows, sigma, most)
        chosen, untold = _chosen(trial, rivals)
        advice = _advice(true, reachable.rows, untold, sigma, most) if untold else ""
        if advice and chosen:
            told = [_what(rival, true) for rival in rivals if rival not in untold]
            advice += f". The poses below tell it from {listed(dict.fromkeys(told))}"
    except SherkitError:
        return Proposal()
    return Proposal(_named(trial, reachable, chosen), advice)


def times_as_often(poses: Sequence[Mapping[str, float]]) -> int:
    """How many times as often as those of the run these poses are to be read, so that they lift a tie."""
    return max(int(np.ceil((_LIFTS_SIGMA / poses[-1][SEPARATION]) ** 2)), 1)


def _chosen(trial: _Trial, rivals: Sequence[Fit]) -> tuple[list[tuple[int, float]], dict[Fit, float]]:
    """Poses with the separation reached with each, and that of rivals that they do not tell: the nearest are given up
    one after another until the others are told."""
    left, untold = {rival: trial.beside(rival) for rival in rivals}, dict[Fit, float]()
    while left:
        poses, reached = telling(list(left.values()), trial.most)
        if poses and poses[-1][1] >= SURE_SIGMA:
            return poses, untold
        least, nearest = min(zip(reached, left, strict=True), key=lambda pair: pair[0])
        untold[nearest] = least
        del left[nearest]
    return [], untold


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


def _effects(fit: Fit) -> list[str]:
    return [effect.name for effect in fit.model.effects]


def _what(fit: Fit, other: Fit) -> str:
    """The effects that a fit has and another has not; all of them where one of both has none of its own."""
    own, others = _effects(fit), _effects(other)
    apart = [name for name in own if name not in others]
    named = apart if apart and set(others) - set(own) else own
    return " with ".join(named) or "the model without effects"


def _advice(true: Fit, rows: Measurements, untold: Mapping[Fit, float], sigma: Floats, most: int) -> str:
    """That these instruments cannot tell, and which of the readings that the model can predict would; ``untold`` has
    the separation that poses reach, in standard deviations."""
    # the same effects with another moment or shape are no other cause
    untold = {rival: reached for rival, reached in untold.items() if set(_effects(rival)) != set(_effects(true))}
    if not untold:
        return ""
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
            trial = _Trial(true, other, sigma, most, of_new=of_new, zero_is_free=zero_is_free)
            if _chosen(trial, [rival])[0]:
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
    """The same poses at each of ``most`` later moments at which they could be read, as the true model has them.

    ``of_new`` (c,) is the noise of the new readings where it is not that of the old ones; ``zero_is_free`` where their
    zero is not known and is identified besides.
    """

    def __init__(
        self, true: Fit, rows: Measurements, sigma: Floats, most: int, *, of_new: Floats | None = None,
        zero_is_free: bool = False,
    ) -> None:  # fmt: skip
        self.true, self.most = true, most
        self.sigma = sigma[: true.data.coordinates]
        # each new pose is read as often as those of the run
        often = np.sqrt(len(true.data) / len(np.unique(true.data.groups)))
        self.of_new = (self.sigma if of_new is None else of_new) / often
        self.zeros = len(self.of_new) if zero_is_free else 0
        self.later = [_at(rows, true, k) for k in range(most)]
        self.told = [true.model.predict(one, true.values)[:, : rows.coordinates] for one in self.later]

    def beside(self, rival: Fit) -> tuple[Rival, list[tuple[Floats, Floats]]]:
        """A rival as the old rows leave it, and for each moment what each pose would add."""
        model, values, data = rival.model, rival.values, rival.data
        count = data.coordinates
        used = data.used[:, :count]
        old = np.where(used[:, :, None], model.derivatives(data, values)[:, :count] / self.sigma[:, None], 0.0)
        apart = (self.true.model.predict(data, self.true.values) - rival.predicted)[:, :count]
        flat = old.reshape(-1, old.shape[2])
        scale = np.linalg.norm(flat, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        flat = np.concatenate([flat / scale, np.zeros((len(flat), self.zeros))], axis=1)
        new = []
        for rows, there in zip(self.later, self.told, strict=True):
            columns = model.derivatives(rows, values)[:, : rows.coordinates] / self.of_new[:, None] / scale
            own = np.broadcast_to(np.eye(rows.coordinates, self.zeros), (len(rows), rows.coordinates, self.zeros))
            away = (there - model.predict(rows, values)[:, : rows.coordinates]) / self.of_new
            new.append((np.concatenate([columns, own], axis=2), away))
        return Rival.of(flat, np.where(used, apart / self.sigma, 0.0).ravel()), new


def _at(rows: Measurements, fit: Fit, k: int) -> Measurements:
    """The rows at the moment at which the k-th new pose would be measured: after a pause."""
    if fit.data.time_s is None:
        return rows
    end = float(fit.data.time_s.max())
    return replace(rows, time_s=np.full(len(rows), end + _PAUSE_S + k * _SECONDS_PER_POSE))
