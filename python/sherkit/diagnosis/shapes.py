"""Generic shapes: what a residual may look like when no effect of the catalogue is behind it.

They test whether something is left, and describe it; they never compete for the name of a cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..types import Floats
from .linearised import Linearised

_ORDERS = 3
_STEPS = 24
_PLAY_WIDTHS = (0.02, 0.1, 0.5, 2.0)
#: Shortest period looked for, as a part of the range of a variable.
_SHORTEST = 1.0 / 22.0
OVERSAMPLING = 1.5
#: A variable with fewer different values than this has no shape.
_FEWEST_VALUES = 2


@dataclass(frozen=True)
class Shape:
    """A family of columns that stand for one description.

    ``separable`` columns are indices of functions, used on axis ``axis`` or on all (None); ``dense`` ones indices of
    full columns.
    """

    depends_on: tuple[str, ...]
    shape: str
    order: int | None = None
    period: float | None = None
    axis: int | None = None
    pattern: str | None = None
    setting: float | None = None
    functions: tuple[int, ...] = ()
    dense: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class Family:
    """Shapes with their columns: ``functions`` (n, f), used on single axes, and ``dense`` (n, m, d)."""

    shapes: tuple[Shape, ...]
    functions: Floats
    dense: Floats


class _Builder:
    def __init__(self, view: Linearised) -> None:
        self.view = view
        self.shapes: list[Shape] = []
        self.functions: list[Floats] = []
        self.dense: list[Floats] = []

    def function(self, raw: NDArray[Any]) -> int:
        values: Floats = raw - raw.mean()
        norm = np.linalg.norm(values)
        self.functions.append(values / norm if norm > 0 else values)
        return len(self.functions) - 1

    def column(self, pattern: str, raw: NDArray[Any]) -> int:
        column: Floats = self.view.patterns[pattern] * (raw - raw.mean())[:, None]
        norm = np.linalg.norm(column)
        self.dense.append(column / norm if norm > 0 else column)
        return len(self.dense) - 1

    def on_axes(self, functions: tuple[int, ...], depends_on: tuple[str, ...], shape: str, **about: object) -> None:
        """The functions on each axis by itself, and on all together."""
        for axis in (*range(self.view.axes), None):
            self.shapes.append(Shape(depends_on, shape, axis=axis, functions=functions, **about))  # type: ignore[arg-type]


def build(view: Linearised, *, thorough: bool = True, periods: Sequence[tuple[str, float]] = ()) -> Family:
    """All shapes for the variables of a view; periods and hysteresis only where ``thorough``.

    ``periods`` (variable, period) are looked at besides those of the grid.
    """
    b = _Builder(view)
    unit = {name: _unit(v) for name, v in view.variables.items() if len(np.unique(v)) >= _FEWEST_VALUES}
    poses = [name for name in unit if name in view.pattern_of or name in view.place]
    others = [name for name in unit if name not in poses]
    for name, t in unit.items():
        orders = min(_ORDERS, len(np.unique(t)) - 1)
        legendre = np.polynomial.legendre.legvander(t, orders)[:, 1:]
        columns = tuple(b.function(legendre[:, k]) for k in range(orders))
        b.on_axes(columns[:1], (name,), "smooth", order=1)
        if orders > 1:
            b.on_axes(columns, (name,), "smooth", order=orders)
        pattern = view.pattern_of.get(name)
        if pattern is not None and orders > 1:
            dense = tuple(b.column(pattern, legendre[:, k]) for k in range(orders))
            b.shapes.append(Shape((name,), "smooth", order=orders, pattern=pattern, dense=dense))
    for name in poses if thorough else ():
        _periodic(b, name)
    for name, period in periods:
        if name in unit:
            _wave(b, name, period)
    for k, first in enumerate(poses):
        for second in poses[k + 1 :]:
            if (first in view.pattern_of) == (second in view.pattern_of):
                column = b.function(unit[first] * unit[second])
                b.on_axes((column,), (first, second), "interaction")
    for name in others:
        for pose in poses:
            if pose not in view.pattern_of:
                b.on_axes((b.function(unit[name] * unit[pose]),), (name, pose), "interaction")
    for joint, pattern in view.pattern_of.items():
        for other in view.pattern_of:
            if joint in unit and other in unit and joint != other:
                t, u = unit[joint], unit[other]
                dense = tuple(b.column(pattern, v) for v in (u, u * u, t * u))
                b.shapes.append(Shape((joint, other), "interaction", pattern=pattern, dense=dense))
    if thorough:
        _hysteretic(b)
    _steps(b)
    n, m = len(view), view.axes
    functions = np.stack(b.functions, axis=1) if b.functions else np.zeros((n, 0))
    full = np.stack(b.dense, axis=2) if b.dense else np.zeros((n, m, 0))
    return Family(tuple(b.shapes), functions, full)


def _periodic(b: _Builder, name: str) -> None:
    """Sine and cosine over a fine grid of frequencies, as far as the values of the variable can tell them."""
    values = b.view.variables[name]
    span = float(values.max() - values.min())
    count = int(OVERSAMPLING / _SHORTEST)
    for k in range(int(OVERSAMPLING * 2), count + 1):
        _wave(b, name, OVERSAMPLING * span / k)


def _wave(b: _Builder, name: str, period: float) -> None:
    waves = wave(b.view.variables[name], period)
    pattern = b.view.pattern_of.get(name)
    if pattern is not None:
        dense = tuple(b.column(pattern, w) for w in waves)
        b.shapes.append(Shape((name,), "periodic", period=period, pattern=pattern, dense=dense))
    else:
        functions = tuple(b.function(w) for w in waves)
        b.on_axes(functions, (name,), "periodic", period=period)


def wave(values: Floats, period: float) -> tuple[Floats, Floats]:
    """Sine and cosine of a variable."""
    angle = 2 * np.pi * (values - values.min()) / period
    return np.sin(angle), np.cos(angle)


def _hysteretic(b: _Builder) -> None:
    """Direction of motion and play of several widths at each joint."""
    for joint, pattern in b.view.pattern_of.items():
        q = b.view.variables[joint]
        step = np.sign(np.diff(q, prepend=q[:1]))
        last = np.maximum.accumulate(np.where(step != 0, np.arange(len(q)), 0))
        direction = step[last]
        b.on_axes((b.function(direction),), (joint,), "hysteretic", setting=0.0)
        columns = (b.column(pattern, direction),)
        b.shapes.append(Shape((joint,), "hysteretic", pattern=pattern, setting=0.0, dense=columns))
        for width in _PLAY_WIDTHS:
            columns = (b.column(pattern, play_operator(q, width) - q),)
            b.shapes.append(Shape((joint,), "hysteretic", pattern=pattern, setting=width, dense=columns))


def play_operator(q: Floats, width: float) -> Floats:
    """The play operator: what follows ``q`` with a dead zone of ``width`` (Visintin, *Differential Models of
    Hysteresis*, 1994)."""
    out = np.empty_like(q)
    at = q[0]
    half = 0.5 * width
    for k, value in enumerate(q.tolist()):
        at = min(max(at, value - half), value + half)
        out[k] = at
    return out


def _steps(b: _Builder) -> None:
    """A step at a searched time, on all axes."""
    time = b.view.time
    if time is None:
        return
    n = len(b.view)
    for k in range(1, _STEPS):
        cut = k * n // _STEPS
        if 0 < cut < n and time[cut] > time[cut - 1]:
            column = b.function((np.arange(n) >= cut).astype(float))
            b.shapes.append(Shape(("time_s",), "step", setting=float(time[cut]), functions=(column,)))


def _unit(values: Floats) -> Floats:
    low, high = values.min(), values.max()
    return 2 * (values - low) / (high - low) - 1
