"""What one unknown cause would look like in place of several effects that explain together.

Two or three effects of unrelated links with a dozen numbers imitate many a cause that is in no catalogue. Here the
cause is taken as unknown: an error of every joint that is a polynomial of its own reading, or of all of them, or one of
the readings that is a polynomial of all joints. The smallest that predicts rows held out as well as the best of them
does is what one unknown would look like. It and the named effects are then fitted to the inner poses and compared on
the outermost, where an imitation departs first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations_with_replacement
from types import SimpleNamespace
from typing import Any

import numpy as np

from ..base.types import Bools, Floats, Ints
from ..data.columns import unit_in
from ..errors import SherkitError
from ..evidence.fitted_run import FittedRun
from ..model.effect import Effect, Parameter
from .held_out import error_of, flipped

#: Orders of the polynomials tried.
_ORDERS = (1, 2, 3)
#: An unknown whose held-out error is within this part of the best one's does as well.
_AS_WELL = 1.02
#: One that is this much worse than the named effects is no rival of theirs.
_WORSE = 1.15
#: Part of the poses that count as outermost, and how few of them can be compared.
_RIM = 0.2
_FEWEST = 10
_LEVEL = 0.05
#: What a plausible unknown adds, by unit of what it is added to; a hundredth of a unit for others.
_SIZES = {"mm": 0.1, "rad": 1e-3, "px": 1.0}


@dataclass(frozen=True, eq=False)
class OneUnknown:
    """One unknown cause in place of the named effects.

    ``what`` says its link and shape, ``numbers`` how many it takes where the named ones take ``instead``. ``held_out``
    and ``rim`` are RMS on rows held out and on the outermost poses, each of the unknown and of the named effects, in
    ``unit``; ``p_rim`` is the one-sided p of the unknown being nearer at the rim.
    """

    what: str
    numbers: int
    instead: int
    held_out: tuple[float, float]
    rim: tuple[float, float] | None
    p_rim: float | None
    unit: str
    run: FittedRun = field(repr=False)

    @property
    def rivals(self) -> bool:
        """Whether these rows leave room for it beside the named effects."""
        return self.held_out[0] <= _WORSE * self.held_out[1]

    @property
    def preferred(self) -> bool:
        """Whether it predicts the outermost poses better, and rows held out no worse."""
        return self.rivals and self.p_rim is not None and self.p_rim <= _LEVEL and self.rim[0] < self.rim[1]  # type: ignore[index]

    def __str__(self) -> str:
        at_rim = ""
        if self.rim is not None:
            at_rim = f", {self.rim[0]:.4g} instead of {self.rim[1]:.4g} at the outermost poses"
        return (
            f"one unknown would be {self.what}: {self.numbers} numbers instead of {self.instead}, "
            f"{self.held_out[0]:.4g} instead of {self.held_out[1]:.4g} {self.unit} on rows held out{at_rim}"
        )


def one_unknown(
    base: FittedRun, final: FittedRun, names: Sequence[str], sigma: Floats, repeated_folds: Sequence[Ints]
) -> OneUnknown | None:
    """The single unknown that comes nearest, beside the effects ``names`` that ``final`` has and ``base`` has not.

    None where no unknown can be fitted to these rows.
    """
    fitted = []
    for effect, what in _unknowns(base):
        try:
            run = base.refit([(effect, None)])
            fitted.append((len(effect.parameters), error_of(run, sigma, repeated_folds).rms, run, what))
        except SherkitError:
            continue
    if not fitted:
        return None
    best = min(error for _, error, _, _ in fitted)
    numbers, error, run, what = min((f for f in fitted if f[1] <= _AS_WELL * best), key=lambda f: f[:2])
    rim, p_rim = _at_the_rim(run, final, sigma)
    return OneUnknown(
        what=what,
        numbers=numbers,
        instead=sum(len(e.parameters) for e in final.model.effects if e.name in names),
        held_out=(error, error_of(final, sigma, repeated_folds).rms),
        rim=rim,
        p_rim=p_rim,
        unit=final.unit,
        run=run,
    )


def _at_the_rim(unknown: FittedRun, named: FittedRun, sigma: Floats) -> tuple[tuple[float, float] | None, float | None]:
    """Errors of both at the outermost poses after a fit to the others, and the p of the first being nearer."""
    outer = _outermost(named)
    rows = np.flatnonzero(named.whole & outer)
    group = np.unique(named.data.standing[rows], return_inverse=True)[1]
    if not len(rows) or group.max() + 1 < _FEWEST:
        return None, None
    inner = np.flatnonzero(named.whole & ~outer)
    axes = list(named.axes)
    left = []
    try:
        for run in (unknown, named):
            left.append(run.residuals_on(rows, run.on(inner, sigma))[:, axes])
    except SherkitError:
        return None, None
    rms = tuple(named.per_row * float(np.sqrt(np.mean(one**2))) for one in left)
    gain = ((left[1] / sigma[axes]) ** 2 - (left[0] / sigma[axes]) ** 2).sum(axis=1)
    return (rms[0], rms[1]), flipped(gain, group, 0)


def _outermost(run: FittedRun) -> Bools:
    """Rows (n,) of the poses farthest from the middle of those measured."""
    place = np.stack(list(run.model.place(run.data, run.fit.predicted, run.fit.values).values()), axis=1)
    spread = np.where(np.ptp(place, axis=0) > 0, place.std(axis=0), 1.0)
    away = np.sqrt((((place - np.median(place, axis=0)) / spread) ** 2).sum(axis=1))
    return away > np.quantile(away[run.whole], 1.0 - _RIM)


def _unknowns(run: FittedRun) -> list[tuple[Effect, str]]:
    """Unknown causes as effects, each with what it is in words; those of few numbers first."""
    data = run.data
    joints = data.joints[run.whole]
    moving = [k for k in range(joints.shape[1]) if np.ptp(joints[:, k]) > 0]
    if not moving:
        return []
    middle, half = 0.5 * (joints.max(axis=0) + joints.min(axis=0)), 0.5 * np.ptp(joints, axis=0)
    scaled = _Scaled(middle, np.where(half > 0, half, 1.0))
    names, read = data.layout.joints, data.layout.coordinates
    most = int(run.whole.sum()) * len(run.axes) // 4
    # m readings of a pose tell m combinations of its joints' errors: many numbers for more joints are told by none
    limit = {"sensor": most, "joints": most * min(len(run.axes), len(moving)) // len(moving)}
    out: list[tuple[Effect, str]] = []
    for order in _ORDERS:
        each = [tuple([k] * power) for k in moving for power in range(1, order + 1)]
        together = [t for power in range(1, order + 1) for t in combinations_with_replacement(moving, power)]
        how = ("linearly", "to the second order", "to the third order")[order - 1]
        if run.model.robot is not None:
            own = [(term[0], term) for term in each]
            out.append(
                (_effect("joints", scaled, own, names), f"an error of each joint that depends {how} on its own reading")
            )
            coupled = [(k, term) for term in together for k in moving]
            out.append(
                (_effect("joints", scaled, coupled, names), f"an error of the joints that depends {how} on all of them")
            )
        # a distance has no column that what is added to readings could name
        moved = [(k, term) for term in together for k in run.axes if k < data.coordinates]
        if not moved:
            continue
        out.append(
            (_effect("sensor", scaled, moved, read), f"a displacement of the readings that depends {how} on all joints")
        )
    return sorted((o for o in out if len(o[0].parameters) <= limit[o[0].link]), key=lambda o: len(o[0].parameters))


@dataclass(frozen=True, eq=False)
class _Scaled:
    """Joint readings brought to -1 … 1."""

    middle: Floats
    half: Floats

    def terms(self, rows: Any, terms: Sequence[tuple[int, ...]]) -> Floats:
        """Products (n, t) of the joints in each term."""
        u = (rows.joints - self.middle) / self.half
        return np.stack([np.prod(u[:, list(term)], axis=1) for term in terms], axis=1)


def _effect(at: str, scaled: _Scaled, places: Sequence[tuple[int, tuple[int, ...]]], columns: Sequence[str]) -> Effect:
    """An effect that adds to column ``k`` each ``term`` of ``places`` times a number of its own."""
    names_ = [f"{columns[k]}_{'_'.join(str(j + 1) for j in term)}" for k, term in places]
    which = np.array([k for k, _ in places])
    terms = [term for _, term in places]

    def derivative(rows: Any, p: SimpleNamespace) -> Floats:
        del p
        out = np.zeros((len(rows), len(columns), len(places)))
        out[:, which, np.arange(len(places))] = scaled.terms(rows, terms)
        return out

    def function(rows: Any, p: SimpleNamespace) -> Floats:
        values = np.array([getattr(p, name) for name in names_])
        return derivative(rows, p) @ values

    parameters = tuple(
        Parameter(name, name, unit_in(columns[k]), _SIZES.get(unit_in(columns[k]), 0.01))
        for name, (k, _) in zip(names_, places, strict=True)
    )
    return Effect("one_unknown", at, parameters, function=function, derivative=derivative)
