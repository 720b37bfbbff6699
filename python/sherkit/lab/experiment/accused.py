"""Of which instrument it is the fault that a row cannot be true: which single one, were it wrong, would make the rest
fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...base import linalg
from ...base.types import Floats
from ...data.columns import Layout

#: What one free number of an explanation costs, in squares of standard deviations (about Akaike's, a little dearer).
_COST = 6.0
#: Explanations this near to the best are told beside it.
_TIE = 4.0
#: Part of the motion that was expected, within which a reading "has not changed", "is that of before", "is mirrored".
_SAME = 0.1


@dataclass(frozen=True, eq=False)
class ComparedRow:
    """A row beside its prediction: ``read`` and ``predicted`` (m,), covariance ``spread`` (m, m) of their difference,
    ``by_joints`` gives derivatives (m, k). ``least`` is how far it is at least, by a model that may bend to it."""

    step: int
    columns: Sequence[str]
    read: Floats
    predicted: Floats
    spread: Floats
    by_joints: Callable[[], Floats]
    least: float = np.inf

    @cached_property
    def miss(self) -> Floats:
        """What the readings are beyond the prediction."""
        return self.read - self.predicted

    @cached_property
    def distance(self) -> float:
        """Norm of the whitened difference; empty cells are left out."""
        return min(float(np.sqrt(self.squares(np.isfinite(self.read)))), self.least)

    def squares(self, kept: np.ndarray, miss: Floats | None = None) -> float:
        """Sum of whitened squares over the columns that are kept."""
        left = (self.miss if miss is None else miss)[kept]
        return float(left @ linalg.solve(self.spread[np.ix_(kept, kept)], left)) if len(left) else 0.0


@dataclass(frozen=True)
class Accused:
    """The ``columns`` that are wrong, those that may be instead among them, and ``why``."""

    columns: tuple[str, ...]
    why: str


def accuse(odd: Sequence[ComparedRow], before: Sequence[ComparedRow], layout: Layout) -> Accused:
    """Which explanation of the odd rows is the best: some columns wrong, or a joint that stands elsewhere than it says.

    ``before`` are rows that were right. The last of the odd rows is the newest.
    """
    newest = odd[-1]
    names = list(newest.columns)
    there = np.isfinite(newest.read)
    tried: list[tuple[float, tuple[str, ...], str]] = []
    groups = [[k] for k in range(len(names))]
    if len(names) > 1:
        groups.append(list(range(len(names))))
    for which in groups:
        kept = there.copy()
        kept[which] = False
        told, alike = _told(odd, before, which)
        # readings that may be anything are many free numbers; a look that has a name is one
        free = 1 if alike else len(odd) * len(which)
        cost = sum(s.squares(kept & np.isfinite(s.read)) for s in odd) + _COST * free
        tried.append((cost, tuple(names[k] for k in which), told))
    ways = dict(zip(layout.joints, np.eye(len(layout.joints)), strict=True))
    unit = layout.joints[0].rpartition("_")[2]
    by_joints = [s.by_joints() for s in odd]
    # a zero that was set elsewhere moves all of them
    for what, way in {**ways, "all joints": np.ones(len(ways))}.items():
        by = [one @ way for one in by_joints]
        moved = _fitted(odd, by)
        cost = _COST + sum(s.squares(np.isfinite(s.read), s.miss - moved * g) for s, g in zip(odd, by, strict=True))
        slipped = f"slipped by {-moved:.3g} {unit}"
        if what in ways:
            tried.append((cost, (what,), f"{what} is not where its encoder says, as if that had {slipped}"))
        else:
            why = f"{what} stand where the encoders do not say, as if those had {slipped}"
            tried.append((cost, layout.joints, why))
    tried.sort(key=lambda one: one[0])
    best = [one for one in tried if one[0] <= tried[0][0] + _TIE]
    # one sentence for each; what is said of a column is not said again of all of them
    chosen = [one for k, one in enumerate(best) if not any(set(b[1]) <= set(one[1]) for b in best[:k])]
    columns = tuple(dict.fromkeys(c for one in chosen for c in one[1]))
    return Accused(columns, "; or ".join(one[2] for one in chosen))


def _fitted(odd: Sequence[ComparedRow], by: Sequence[Floats]) -> float:
    """By how much the joints would have to be elsewhere, along ``by`` of each row; generalised least squares."""
    weights = [linalg.solve(s.spread, g) for s, g in zip(odd, by, strict=True)]
    squares = sum(float(w @ g) for w, g in zip(weights, by, strict=True))
    moved = sum(float(w @ np.nan_to_num(s.miss)) for w, s in zip(weights, odd, strict=True))
    return moved / squares if squares > 0 else 0.0


def _told(odd: Sequence[ComparedRow], before: Sequence[ComparedRow], which: Sequence[int]) -> tuple[str, bool]:
    """What these columns look like, in words, and whether that look has a name: frozen, late, mirrored, swapped."""
    newest = odd[-1]
    columns = [newest.columns[k] for k in which]
    unit = columns[0].rpartition("_")[2]
    read, expected = newest.read[which], newest.predicted[which]
    said = ", ".join(
        f"{c} is {r:.3f} {unit} where the joints put it at {p:.3f} ± {np.sqrt(newest.spread[k, k]):.2g} {unit}"
        for c, r, p, k in zip(columns, read, expected, which, strict=True)
    )
    near = _SAME * np.abs(expected).max()
    last = odd[-2] if len(odd) > 1 else before[-1] if before else None
    alike = []
    if last is not None:
        motion = _SAME * np.abs(expected - last.predicted[which]).max()
        if np.abs(read - last.read[which]).max() < motion:
            alike.append(f"it has not changed since step {last.step}, while the robot moved")
        elif np.abs(read - last.predicted[which]).max() < motion:
            alike.append(f"as it should have been at step {last.step}, before the robot moved")
    if np.abs(read + expected).max() < near:
        alike.append("as if its sign were turned")
    if len(which) > 1 and _is_permuted(read, expected, near):
        alike.append("as if columns were swapped")
    return (f"{said}: {', or '.join(alike)}", True) if alike else (said, False)


def _is_permuted(read: Floats, expected: Floats, within: float) -> bool:
    near = np.abs(read[:, None] - expected[None, :]) < within
    return bool(near.any(axis=1).all() and near.any(axis=0).all())
