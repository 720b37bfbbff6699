"""Generic shapes: what a residual may look like when no effect of the catalogue is behind it.

They test whether something is left, and describe it; they never compete for the name of a cause.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import count as count_from

import numpy as np

from .._core import play
from ..base.types import Floats, Ints
from ..evidence.linearised import Linearised, last_asked
from .axis_waves import Along
from .columns import Columns
from .waves import OVERSAMPLING, TURN, Waves, bends

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

    ``functions`` are indices of functions, used on axis ``axis`` or on all (None); ``dense`` ones of full columns,
    ``waves`` of :class:`~.waves.Waves` and ``along`` of :class:`~.axis_waves.AxisWaves`.
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
    along: tuple[int, ...] = ()

    @cached_property
    def columns(self) -> Columns:
        """Its columns for a scan."""
        return Columns(self.functions, self.axis, self.dense, self.waves, self.along)


#: Values (b,) of a function in a stretch of rows.
Function = Callable[[slice], Floats]


@dataclass(frozen=True, eq=False)
class Family:
    """Shapes, and what gives their columns in any stretch of rows: ``functions``, used on single axes, with the mean
    and the length that are taken out of each; ``dense``, with the input whose pattern each follows, whose numbers go on
    from those of the effects; ``along`` waves on single axes."""

    view: Linearised
    shapes: tuple[Shape, ...]
    functions: tuple[tuple[Function, float, float], ...]
    dense: tuple[tuple[str, Function, float, float], ...]
    along: tuple[Along, ...]

    @last_asked
    def functions_in(self, rows: slice) -> Floats:
        """Functions (b, f) without their mean, of unit length over all rows."""
        out = np.empty((len(self.functions), rows.stop - rows.start))
        for k, (function, mean, length) in enumerate(self.functions):
            out[k] = (function(rows) - mean) / length
        return np.ascontiguousarray(out.T)

    @last_asked
    def dense_in(self, rows: slice) -> Floats:
        """Full columns (b, m, d), of unit length over all rows."""
        out = np.empty((len(self.dense), rows.stop - rows.start, self.view.axes))
        for k, (pattern, function, mean, length) in enumerate(self.dense):
            np.multiply(self.view.patterns[pattern][rows], ((function(rows) - mean) / length)[:, None], out=out[k])
        return np.ascontiguousarray(out.transpose(1, 2, 0))


class _Builder:
    def __init__(self, view: Linearised, first: int) -> None:
        self.view = view
        self.shapes: list[Shape] = []
        self.functions: list[tuple[Function, float, float]] = []
        self.dense: list[tuple[str, Function, float, float]] = []
        self.along: list[Along] = []
        self.first, self.count_along = first, 0

    def function(self, function: Function) -> int:
        raw = function(self.view.whole)
        mean = float(raw.mean())
        self.functions.append((function, mean, float(np.linalg.norm(raw - mean)) or 1.0))
        return len(self.functions) - 1

    def column(self, pattern: str, function: Function, *, centred: bool = True) -> int:
        raw = function(self.view.whole)
        mean = float(raw.mean()) if centred else 0.0
        by = self.view.patterns[pattern]
        squares = np.einsum("na,na->n", by, by) @ (raw - mean) ** 2
        self.dense.append((pattern, function, mean, float(np.sqrt(squares)) or 1.0))
        return self.first + len(self.dense) - 1

    def waves_on_axes(self, name: str, unit: float, turns: Ints) -> None:
        """Waves of a variable on each axis by itself, and on all together."""
        along = Along(np.ascontiguousarray(self.view.variables[name]), unit, turns)
        count = len(turns)
        half = np.round(OVERSAMPLING * float(np.ptp(along.values)) * along.at).astype(np.int64)
        seen = ~bends(half, np.hypot(*along.mean))
        for f, period in enumerate((1.0 / along.at).tolist()):
            if not seen[f]:
                continue
            pairs = [tuple(self.count_along + (2 * a + s) * count + f for s in (0, 1)) for a in range(self.view.axes)]
            for axis, numbers in (*enumerate(pairs), (None, tuple(k for pair in pairs for k in pair))):
                self.shapes.append(Shape((name,), "periodic", period=period, axis=axis, along=numbers))
        self.along.append(along)
        self.count_along += 2 * self.view.axes * count

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
    values = {name: len(np.unique(v)) for name, v in view.variables.items()}
    unit = {name: _unit(v) for name, v in view.variables.items() if values[name] >= _FEWEST_VALUES}
    poses = [name for name in unit if name in view.pattern_of or name in view.place]
    others = [name for name in unit if name not in poses]
    for name, t in unit.items():
        orders = min(_ORDERS, values[name] - 1)
        powers = [_legendre(t, order) for order in range(1, orders + 1)]
        columns = tuple(b.function(power) for power in powers)
        b.on_axes(columns[:1], (name,), "smooth", order=1)
        if orders > 1:
            b.on_axes(columns, (name,), "smooth", order=orders)
        pattern = view.pattern_of.get(name)
        if pattern is not None and orders > 1:
            dense = tuple(b.column(pattern, power) for power in powers)
            b.shapes.append(Shape((name,), "smooth", order=orders, pattern=pattern, dense=dense))
    if waves is not None:
        for name in poses:
            if name in waves.names:
                b.shapes += _of_input(waves, name, view.pattern_of[name])
            elif name in view.waving:
                if len(waves.turns):
                    b.waves_on_axes(name, waves.unit, waves.turns)
            else:
                b.waves_on_axes(name, 1.0 / (OVERSAMPLING * float(np.ptp(view.variables[name]))), _COARSE)
        if "time_s" in unit:
            b.waves_on_axes("time_s", 1.0 / (OVERSAMPLING * float(np.ptp(view.variables["time_s"]))), _IN_TIME)
    for name, at in periods:
        if name in unit:
            _wave(b, name, at)
    for k, first in enumerate(poses):
        for second in poses[k + 1 :]:
            if (first in view.pattern_of) == (second in view.pattern_of):
                b.on_axes((b.function(_product(unit[first], unit[second])),), (first, second), "interaction")
    for name in others:
        for pose in poses:
            if pose not in view.pattern_of:
                b.on_axes((b.function(_product(unit[name], unit[pose])),), (name, pose), "interaction")
    for joint, pattern in view.pattern_of.items():
        for other in view.pattern_of:
            if joint in unit and other in unit and joint != other:
                t, u = unit[joint], unit[other]
                dense = tuple(b.column(pattern, one) for one in (_itself(u), _product(u, u), _product(t, u)))
                b.shapes.append(Shape((joint, other), "interaction", pattern=pattern, dense=dense))
    if waves is not None:
        _hysteretic(b)
    _steps(b)
    return Family(view, tuple(b.shapes), tuple(b.functions), tuple(b.dense), tuple(b.along))


def _of_input(waves: Waves, name: str, pattern: str) -> list[Shape]:
    """A shape for each frequency of an input, made once for all fits to the same rows."""
    if name not in waves.shapes:
        first, count = waves.numbers(name, 0)[0], len(waves.at)
        waves.shapes[name] = [
            Shape((name,), "periodic", period=period, pattern=pattern, waves=(k, k + count))
            for k, period, none in zip(count_from(first), (1.0 / waves.at).tolist(), waves.bends(name), strict=False)
            if not none
        ]
    return waves.shapes[name]


# a recipe travels with what was found by it: a partial call of a function with a name can be sent, a lambda cannot


def _itself(t: Floats) -> Function:
    return partial(_rows_of, t)


def _rows_of(t: Floats, rows: slice) -> Floats:
    return t[rows]


def _product(t: Floats, u: Floats) -> Function:
    return partial(_rows_of_both, t, u)


def _rows_of_both(t: Floats, u: Floats, rows: slice) -> Floats:
    return t[rows] * u[rows]


def _legendre(t: Floats, order: int) -> Function:
    """Legendre's polynomial of order 1 to 3."""
    return partial(_rows_of_legendre, t, order)


def _rows_of_legendre(t: Floats, order: int, rows: slice) -> Floats:
    x = t[rows]
    return (x, 1.5 * x**2 - 0.5, (2.5 * x**2 - 1.5) * x)[order - 1]


#: Frequencies of a coordinate: from two waves over its range on.
_COARSE = np.arange(2 * int(OVERSAMPLING), int(OVERSAMPLING) * _MOST_WAVES + 1)
#: Frequencies of time: a room may swing but once while a run lasts.
_IN_TIME = np.arange(int(OVERSAMPLING), int(OVERSAMPLING) * _MOST_WAVES + 1)


def _wave(b: _Builder, name: str, period: float) -> None:
    """Sine and cosine of a variable at one period."""
    values = b.view.variables[name]
    both = [partial(_rows_of_wave, one, values, float(values.min()), period) for one in (np.sin, np.cos)]
    pattern = b.view.pattern_of.get(name)
    if pattern is None:
        b.on_axes(tuple(b.function(one) for one in both), (name,), "periodic", period=period)
    else:
        # along an input they are what an encoder adds to it, its mean as well
        dense = tuple(b.column(pattern, one, centred=False) for one in both)
        b.shapes.append(Shape((name,), "periodic", period=period, pattern=pattern, dense=dense))


def _rows_of_wave(of: np.ufunc, values: Floats, low: float, period: float, rows: slice) -> Floats:
    return np.asarray(of(TURN * (values[rows] - low) / period))


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
        direction = _itself(step[last])
        b.on_axes((b.function(direction),), (joint,), "hysteretic", setting=0.0)
        columns = (b.column(pattern, direction),)
        b.shapes.append(Shape((joint,), "hysteretic", pattern=pattern, setting=0.0, dense=columns))
        for width in _PLAY_WIDTHS:
            columns = (b.column(pattern, _itself(play_operator(q, width) - q)),)
            b.shapes.append(Shape((joint,), "hysteretic", pattern=pattern, setting=width, dense=columns))


def play_operator(q: Floats, width: float) -> Floats:
    """The play operator: what follows ``q`` with a dead zone of ``width`` (Visintin, *Differential Models of
    Hysteresis*, 1994)."""
    return play(np.ascontiguousarray(q, dtype=float), width)


def _steps(b: _Builder) -> None:
    """A step at a searched time, on all axes."""
    time = b.view.time
    if time is None:
        return
    n = len(b.view)
    for k in range(1, _STEPS):
        cut = k * n // _STEPS
        if 0 < cut < n and time[cut] > time[cut - 1]:
            column = b.function(_after(cut))
            b.shapes.append(Shape(("time_s",), "step", setting=float(time[cut]), functions=(column,)))


def _after(cut: int) -> Function:
    return partial(_rows_after, cut)


def _rows_after(cut: int, rows: slice) -> Floats:
    return (np.arange(rows.start, rows.stop) >= cut).astype(float)


def _unit(values: Floats) -> Floats:
    low, high = values.min(), values.max()
    return 2 * (values - low) / (high - low) - 1
