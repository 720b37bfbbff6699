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
from .waves import OVERSAMPLING, TURN, Waves, frequencies

_ORDERS = 3
_STEPS = 24
_PLAY_WIDTHS = (0.02, 0.1, 0.5, 2.0)
#: Most waves over the range of a coordinate; along the inputs they are looked for as finely as these can tell.
_MOST_WAVES = 22
#: A variable with fewer different values than this has no shape.
_FEWEST_VALUES = 2


@dataclass(frozen=True)
class Shape:
    """A family of columns that stand for one description.

    ``functions`` are indices of functions, used on axis ``axis`` or on all (None); ``dense`` ones of full columns and
    ``waves`` of :class:`~.waves.Waves`.
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
    waves: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class Family:
    """Shapes with their columns: ``functions`` (n, f), used on single axes, and ``dense`` (n, m, d), whose numbers
    go on from those of the effects."""

    shapes: tuple[Shape, ...]
    functions: Floats
    dense: Floats


class _Builder:
    def __init__(self, view: Linearised, first: int) -> None:
        self.view = view
        self.shapes: list[Shape] = []
        self.functions: list[Floats] = []
        self.dense: list[Floats] = []
        self.count_functions, self.count_dense = 0, first

    def function(self, raw: NDArray[Any]) -> int:
        return self.block(raw[:, None])[0]

    def block(self, raw: Floats) -> range:
        """Numbers of functions (n, k)."""
        values = raw - raw.mean(axis=0)
        norm = np.linalg.norm(values, axis=0)
        self.functions.append(values / np.where(norm > 0, norm, 1.0))
        first, self.count_functions = self.count_functions, self.count_functions + raw.shape[1]
        return range(first, self.count_functions)

    def column(self, pattern: str, raw: NDArray[Any]) -> int:
        return self.columns(pattern, (raw - raw.mean())[:, None])[0]

    def columns(self, pattern: str, values: Floats) -> range:
        """Numbers of the columns that a pattern makes of functions (n, k)."""
        by = self.view.patterns[pattern]
        norm = np.sqrt((by**2).sum(axis=1) @ values**2)
        self.dense.append(by[:, :, None] * (values / np.where(norm > 0, norm, 1.0))[:, None, :])
        first, self.count_dense = self.count_dense, self.count_dense + values.shape[1]
        return range(first, self.count_dense)

    def on_axes(self, functions: tuple[int, ...], depends_on: tuple[str, ...], shape: str, **about: object) -> None:
        """The functions on each axis by itself, and on all together."""
        for axis in (*range(self.view.axes), None):
            self.shapes.append(Shape(depends_on, shape, axis=axis, functions=functions, **about))  # type: ignore[arg-type]


def build(
    view: Linearised, waves: Waves | None = None, *, periods: Sequence[tuple[str, float]] = (), number: int = 0
) -> Family:
    """All shapes for the variables of a view; periods and hysteresis only with the ``waves`` of its inputs.

    ``periods`` (variable, period) are looked at besides those of the grid; ``number`` is that of the first full
    column.
    """
    b = _Builder(view, number)
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
    if waves is not None:
        for name in poses:
            if name in waves.names:
                for f, period in enumerate((1.0 / waves.at).tolist()):
                    pair = waves.numbers(name, f)
                    b.shapes.append(
                        Shape((name,), "periodic", period=period, pattern=view.pattern_of[name], waves=pair)
                    )
            else:
                _waves(b, name, frequencies(view) if name in view.inputs else _coarse(view.variables[name]))
    for name, period in periods:
        if name in unit:
            _waves(b, name, np.array([1.0 / period]))
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
    if waves is not None:
        _hysteretic(b)
    _steps(b)
    n, m = len(view), view.axes
    functions = np.concatenate(b.functions, axis=1) if b.functions else np.zeros((n, 0))
    full = np.concatenate(b.dense, axis=2) if b.dense else np.zeros((n, m, 0))
    return Family(tuple(b.shapes), functions, full)


def _coarse(values: Floats) -> Floats:
    """Frequencies of a coordinate, from two waves over its range on."""
    span = float(values.max() - values.min())
    return np.arange(2.0 * OVERSAMPLING, OVERSAMPLING * _MOST_WAVES + 1.0) / (OVERSAMPLING * span)


def _waves(b: _Builder, name: str, at: Floats) -> None:
    """Sine and cosine of a variable at each of these frequencies (k,)."""
    values = b.view.variables[name]
    angles = TURN * np.outer(values - values.min(), at)
    both = np.stack([np.sin(angles), np.cos(angles)], axis=2).reshape(len(values), -1)
    pattern = b.view.pattern_of.get(name)
    # along an input they are what an encoder adds to it, its mean as well
    numbers = b.block(both) if pattern is None else b.columns(pattern, both)
    for period, pair in zip((1.0 / at).tolist(), zip(numbers[::2], numbers[1::2], strict=True), strict=True):
        if pattern is None:
            b.on_axes(pair, (name,), "periodic", period=period)
        else:
            b.shapes.append(Shape((name,), "periodic", period=period, pattern=pattern, dense=pair))


def wave(values: Floats, period: float) -> tuple[Floats, Floats]:
    """Sine and cosine of a variable."""
    angle = TURN * (values - values.min()) / period
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
