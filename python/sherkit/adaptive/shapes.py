"""Shapes that stand for what is in no catalogue, on scales that are fixed before the first reading.

Places and joints are counted from the middle of the region over its half width, time in hours, a covariate from its
first value over a width of its own. What :mod:`sherkit.diagnosis.shapes` scales to the rows of a finished run would be
another hypothesis at each look.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ..base.types import Floats, Ints
from ..data import Measurements
from ..data.columns import TEMPERATURE
from .region import Region

#: Waves over the range of a joint or a place that are tried; periods in time, s.
WAVES, WAVES_OF_PLACES = np.arange(1.0, 60.0, 0.5), np.arange(1.0, 12.0, 0.5)
PERIODS_S = np.geomspace(240.0, 3600.0, 14)
#: Rows after which something may let go.
CUTS = np.arange(2.0, 122.0, 2.0)
#: A covariate is counted in these, unless its name is known.
_WIDTHS = {TEMPERATURE: 1.0}
_LEAST_WIDTH = 1e-9


@dataclass(frozen=True)
class Covariate:
    """A column beside the readings, counted from ``begins`` over ``width``."""

    name: str
    begins: float
    width: float

    @classmethod
    def of(cls, name: str, values: Floats) -> Covariate:
        """By the first rows of a run, whose readings say nothing of it."""
        spread = float(np.ptp(values))
        return cls(name, float(values[0]), _WIDTHS.get(name, max(4.0 * spread, _LEAST_WIDTH)))


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


def shapes(
    places: tuple[str, ...], joints: tuple[str, ...], readings: tuple[str, ...], covariates: tuple[str, ...], *,
    timed: bool, patterns: bool,
) -> list[Shape]:  # fmt: skip
    """All shapes of a robot: ``places`` and ``joints`` name what they depend on, ``readings`` the axes."""
    out = [*_of_places(places, readings)]
    if patterns:
        out += _of_joints(joints)
    if timed:
        out += _of_time(places)
    for name in covariates:
        out.append(Shape(name, lambda r, _, v=name: r.everywhere(r.covariates[v][:, None, None]), in_time=True))
        out.append(
            Shape(f"{name} by place", lambda r, _, v=name: r.everywhere((r.covariates[v][:, None] * r.places)[:, None]),
                  in_time=True)
        )  # fmt: skip
    return out


def _of_places(places: tuple[str, ...], readings: tuple[str, ...]) -> list[Shape]:
    out = []
    for k, name in enumerate(places):
        out.append(Shape(f"smooth in {name}", lambda r, _, k=k: r.everywhere(_powers(r.places[:, k]))))
        for a, axis in enumerate(readings):
            out.append(
                Shape(f"{axis}: smooth in {name}", lambda r, _, k=k, a=a: r.on_axis(a, _powers(r.places[:, k])))
            )
        out.append(
            Shape(f"wave along {name}", lambda r, waves, k=k: r.everywhere(_wave(r.places[:, k], waves)),
                  tuple(WAVES_OF_PLACES.tolist()))
        )  # fmt: skip
    for j, k in combinations(range(len(places)), 2):
        both = f"{places[j]} by {places[k]}"
        out.append(Shape(both, lambda r, _, j=j, k=k: r.everywhere((r.places[:, j] * r.places[:, k])[:, None, None])))
        for a, axis in enumerate(readings):
            out.append(
                Shape(f"{axis}: {both}",
                      lambda r, _, j=j, k=k, a=a: r.on_axis(a, (r.places[:, j] * r.places[:, k])[:, None, None]))
            )  # fmt: skip
    return out


def _of_joints(joints: tuple[str, ...]) -> list[Shape]:
    out = []
    for k, name in enumerate(joints):
        out.append(Shape(f"added to {name}, smooth in it", lambda r, _, k=k: r.along(k, _powers(r.joints[:, k]))))
        out.append(
            Shape(f"added to {name}, a wave along it", lambda r, waves, k=k: r.along(k, _wave(r.joints[:, k], waves)),
                  tuple(WAVES.tolist()))
        )  # fmt: skip
        out.append(Shape(f"direction of {name}", lambda r, _, k=k: r.everywhere(r.direction[:, None, k : k + 1])))
        for j, other in enumerate(joints):
            if j != k:
                out.append(
                    Shape(f"added to {name}, smooth in {other}",
                          lambda r, _, k=k, j=j: r.along(k, np.concatenate([_powers(r.joints[:, j]),
                                                                          (r.joints[:, j] * r.joints[:, k])[:, None, None]], axis=2)))
                )  # fmt: skip
    return out


def _of_time(places: tuple[str, ...]) -> list[Shape]:
    def course(r: Rows) -> Floats:
        assert r.hours is not None, "asked only where times are known"
        return np.column_stack([r.hours, r.hours**2])[:, None]

    out = [
        Shape("course of time", lambda r, _: r.everywhere(course(r)), in_time=True),
        Shape("a cycle in time", lambda r, period_s: r.everywhere(_turn(course(r)[:, :, 0] * 3600.0 / period_s)),
              tuple(PERIODS_S.tolist()), in_time=True),
        Shape("a step in time", lambda r, cut: r.everywhere((r.number[:, None] >= cut)[:, :, None].astype(float)),
              tuple(CUTS.tolist()), in_time=True),
    ]  # fmt: skip
    for k, name in enumerate(places):
        out.append(
            Shape(f"course of time by {name}",
                  lambda r, _, k=k: r.everywhere(course(r)[:, :, :1] * r.places[:, None, k : k + 1]), in_time=True)
        )  # fmt: skip
    return out


def _powers(x: Floats) -> Floats:
    """Legendre's polynomials of order 1 to 3 (n, 1, 3)."""
    return np.column_stack([x, 1.5 * x**2 - 0.5, (2.5 * x**2 - 1.5) * x])[:, None]


def _wave(x: Floats, waves: Floats) -> Floats:
    """Sine and cosine (n, s, 2) of so many waves (s,) over the range from -1 to 1."""
    return _turn(0.5 * x[:, None] * waves)


def _turn(turns: Floats) -> Floats:
    return np.stack([np.sin(2.0 * np.pi * turns), np.cos(2.0 * np.pi * turns)], axis=-1)
