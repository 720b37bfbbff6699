"""What may be the case, one by one: effects of the catalogue, and shapes that stand for what is in none.

Shapes are on scales that are fixed before the first reading: places and joints are counted from the middle of the
region over its half width, time in hours, a covariate from its first value over a width of its own. What
:mod:`sherkit.evidence.shapes` scales to the rows of a finished run would be another hypothesis at each look.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from ..base.types import Floats, Ints
from ..data import Measurements
from ..data.columns import TEMPERATURE
from ..model.effect import Effect
from .region import Region

#: Waves over the range of a joint or a place that are tried; periods in time, s.
WAVES, WAVES_OF_PLACES = np.arange(1.0, 60.0, 0.5), np.arange(1.0, 12.0, 0.5)
PERIODS_S = np.geomspace(240.0, 3600.0, 14)
#: Rows after which something may let go: what one or two rows before it say may be their own.
CUTS = np.arange(4.0, 122.0, 2.0)
#: A covariate is counted in these, unless its name is known.
_WIDTHS = {TEMPERATURE: 1.0}
#: The part of its value by which another may swing while a run lasts.
_LEAST_WIDTH, _SWINGS = 1e-9, 0.1


@dataclass(frozen=True)
class Covariate:
    """A column beside the readings, counted from ``begins`` over ``width``."""

    name: str
    begins: float
    width: float

    @classmethod
    def of(cls, name: str, values: Floats) -> Covariate:
        """By the first rows of a run, whose readings say nothing of it. They last a minute: a room that swings by a
        tenth of its humidity in an hour has hardly begun to."""
        begins, spread = float(values[0]), float(np.ptp(values))
        return cls(name, begins, _WIDTHS.get(name, max(_SWINGS * abs(begins), 4.0 * spread, _LEAST_WIDTH)))


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows as shapes see them: ``places`` (n, c) and ``joints`` (n, k) on their scales, ``patterns`` (n, m, k) of an
    error at each joint, None where they are not known, ``number`` (n,) counts them in time."""

    places: Floats
    joints: Floats
    patterns: Floats | None
    direction: Floats
    hours: Floats | None
    number: Ints
    covariates: Mapping[str, Floats]
    axes: int

    @classmethod
    def of(
        cls, data: Measurements, region: Region, patterns: Floats | None, axes: int, covariates: tuple[Covariate, ...],
        before: int = 0,
    ) -> Rows:  # fmt: skip
        """Those of a run; ``before`` rows were read earlier."""
        hours = None if data.time_s is None else (data.time_s - data.begins_s) / 3600.0
        own = {c.name: (data.covariates[c.name] - c.begins) / c.width for c in covariates}
        places, joints = region.scaled(data.joints)
        return cls(places, joints, patterns, data.direction, hours, data.order + before, own, axes)

    @property
    def clock(self) -> Floats:
        """The time (n, 1), hours."""
        assert self.hours is not None, "asked only where times are known"
        return self.hours[:, None]

    def everywhere(self, values: Floats) -> Floats:
        """Values (n, s, f), each on every axis by itself (n, m, s, f m)."""
        n, s, f = values.shape
        out = np.zeros((n, self.axes, s, f, self.axes))
        for a in range(self.axes):
            out[:, a, :, :, a] = values
        return out.reshape(n, self.axes, s, -1)

    def on_axis(self, axis: int, values: Floats) -> Floats:
        """Values (n, s, f) on one axis (n, m, s, f)."""
        out = np.zeros((len(values), self.axes, *values.shape[1:]))
        out[:, axis] = values
        return out

    def along(self, joint: int, values: Floats) -> Floats:
        """Values (n, s, f) added to the reading of a joint (n, m, s, f)."""
        assert self.patterns is not None, "asked only where patterns are known"
        return self.patterns[:, :, joint, None, None] * values[:, None]


@dataclass(frozen=True)
class Shape:
    """One shape: how it is told, its columns (n, m, s, k) at settings (s,), what it may be set to, and whether it lives
    in time."""

    name: str
    columns: Callable[[Rows, Floats], Floats]
    settings: tuple[float | None, ...] = (None,)
    in_time: bool = False


Columns = Callable[[Rows, Floats], Floats]


def shapes(
    places: tuple[str, ...],
    joints: tuple[str, ...],
    readings: tuple[str, ...],
    covariates: tuple[str, ...],
    *,
    timed: bool,
    patterns: bool,
) -> list[Shape]:
    """All shapes of a robot: ``places`` and ``joints`` name what they depend on, ``readings`` the axes."""
    out = [*_of_places(places, readings)]
    if patterns:
        out += _of_joints(joints)
    if timed:
        out += _of_time(places)
    for name in covariates:
        out.append(Shape(name, _everywhere(_covariate(name)), in_time=True))
        out.append(Shape(f"{name} by place", _everywhere(_covariate(name, by_place=True)), in_time=True))
    return out


def _of_places(places: tuple[str, ...], readings: tuple[str, ...]) -> Iterator[Shape]:
    for k, name in enumerate(places):
        yield Shape(f"smooth in {name}", _everywhere(_smooth(k)))
        for a, axis in enumerate(readings):
            yield Shape(f"{axis}: smooth in {name}", _on_axis(a, _smooth(k)))
        yield Shape(f"wave along {name}", _everywhere(_wave(k)), tuple(WAVES_OF_PLACES.tolist()))
    for j, k in combinations(range(len(places)), 2):
        both = f"{places[j]} by {places[k]}"
        yield Shape(both, _everywhere(_product(j, k)))
        for a, axis in enumerate(readings):
            yield Shape(f"{axis}: {both}", _on_axis(a, _product(j, k)))


def _of_joints(joints: tuple[str, ...]) -> Iterator[Shape]:
    for k, name in enumerate(joints):
        yield Shape(f"added to {name}, smooth in it", _along(k, _smooth_joint(k)))
        yield Shape(f"added to {name}, a wave along it", _along(k, _wave_joint(k)), tuple(WAVES.tolist()))
        yield Shape(f"direction of {name}", _everywhere(_direction(k)))
        for j, other in enumerate(joints):
            if j != k:
                yield Shape(f"added to {name}, smooth in {other}", _along(k, _smooth_joint(j, k)))


def _of_time(places: tuple[str, ...]) -> Iterator[Shape]:
    yield Shape("course of time", _everywhere(lambda r, _: np.stack([r.clock, r.clock**2], axis=-1)), in_time=True)
    yield Shape("a cycle in time", _everywhere(lambda r, period_s: _turn(r.clock * 3600.0 / period_s)),
                tuple(PERIODS_S.tolist()), in_time=True)  # fmt: skip
    yield Shape("a step in time", _everywhere(lambda r, cut: (r.number[:, None] >= cut)[:, :, None].astype(float)),
                tuple(CUTS.tolist()), in_time=True)  # fmt: skip
    for k, name in enumerate(places):
        yield Shape(f"course of time by {name}", _everywhere(_in_time(k)), in_time=True)


# what a shape is a function of (n, s, f), and where it acts


def _everywhere(of: Columns) -> Columns:
    return lambda r, settings: r.everywhere(of(r, settings))


def _on_axis(axis: int, of: Columns) -> Columns:
    return lambda r, settings: r.on_axis(axis, of(r, settings))


def _along(joint: int, of: Columns) -> Columns:
    return lambda r, settings: r.along(joint, of(r, settings))


def _smooth(k: int) -> Columns:
    return lambda r, _: _powers(r.places[:, k])


def _wave(k: int) -> Columns:
    # so many waves over the range from -1 to 1
    return lambda r, waves: _turn(0.5 * r.places[:, k, None] * waves)


def _wave_joint(k: int) -> Columns:
    return lambda r, waves: _turn(0.5 * r.joints[:, k, None] * waves)


def _product(j: int, k: int) -> Columns:
    return lambda r, _: (r.places[:, j] * r.places[:, k])[:, None, None]


def _smooth_joint(k: int, with_other: int | None = None) -> Columns:
    def of(r: Rows, _: Floats) -> Floats:
        alone = _powers(r.joints[:, k])
        if with_other is None:
            return alone
        return np.concatenate([alone, (r.joints[:, k] * r.joints[:, with_other])[:, None, None]], axis=2)

    return of


def _direction(k: int) -> Columns:
    return lambda r, _: r.direction[:, None, k : k + 1]


def _in_time(k: int) -> Columns:
    return lambda r, _: (r.clock * r.places[:, k : k + 1])[:, :, None]


def _covariate(name: str, *, by_place: bool = False) -> Columns:
    def of(r: Rows, _: Floats) -> Floats:
        value = r.covariates[name][:, None]
        return (value * r.places if by_place else value)[:, None]

    return of


def _powers(x: Floats) -> Floats:
    """Legendre's polynomials of order 1 to 3 (n, 1, 3)."""
    return np.column_stack([x, 1.5 * x**2 - 0.5, (2.5 * x**2 - 1.5) * x])[:, None]


def _turn(turns: Floats) -> Floats:
    """Sine and cosine (n, s, 2) of so many turns (n, s)."""
    return np.stack([np.sin(2.0 * np.pi * turns), np.cos(2.0 * np.pi * turns)], axis=-1)


# -- what may be the case, one by one ---------------------------------------------------------------------------------

#: Shares of the weight of one: causes one by one, shapes, pairs.
SINGLES, SHAPES, PAIRS = 0.45, 0.45, 0.1

#: A hypothesis by name, at what it is set to.
Key = tuple[str, float | None]


@dataclass(frozen=True)
class Hypothesis:
    """One thing that may be the case: an ``effect`` of the catalogue, a ``shape`` of what is in none, or neither: a
    parameter of the model that has changed.

    ``settings`` are what it may be set to, None alone where there is nothing to set; ``in_time`` tells whether a later
    moment shows more of it; ``weight`` is its share.
    """

    name: str
    effect: Effect | None
    shape: Shape | None
    settings: tuple[float | None, ...]
    in_time: bool
    weight: float = 0.0

    @property
    def is_shape(self) -> bool:
        """Whether it only describes."""
        return self.shape is not None


def weighted(hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """The same with their shares: causes have as much as shapes."""
    causes = max(sum(not h.is_shape for h in hypotheses), 1)
    share = {False: SINGLES / causes, True: SHAPES / max(len(hypotheses) - causes, 1)}
    return tuple(replace(h, weight=share[h.is_shape]) for h in hypotheses)


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """All of them."""

    hypotheses: tuple[Hypothesis, ...]

    @cached_property
    def by_name(self) -> dict[str, Hypothesis]:
        """Hypotheses by name."""
        return {h.name: h for h in self.hypotheses}

    @cached_property
    def effects(self) -> tuple[Hypothesis, ...]:
        """Those that are causes."""
        return tuple(h for h in self.hypotheses if not h.is_shape)

    def weight(self, names: Sequence[str]) -> float:
        """The share of one hypothesis or of a pair; half of that of pairs is for two effects."""
        if len(names) == 1:
            return self.by_name[names[0]].weight
        count, every = len(self.effects), len(self.hypotheses)
        two = max(count * (count - 1) / 2, 1.0)
        if not any(self.by_name[name].is_shape for name in names):
            return 0.5 * PAIRS / two
        return 0.5 * PAIRS / max(every * (every - 1) / 2 - two, 1.0)
