"""Whether an effect keeps its name beside the shapes that show with it: a step beside a smooth course in time, a growth
beside a shift.

Where effects leave something that shapes describe, or shapes alone describe a run better than the effects do, the cause
may be in no catalogue, and an effect may stand in for a part of it. Then whatever depends on the variables of these
shapes is put into the model, as freely as the rows allow, and the effect is asked what it still brings: on rows that
were held out one here and one there, so that what is free can follow its neighbours. A part of what an unknown cause
does brings next to nothing there; a cause of its own brings nearly all of what it brought before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import scipy

from ..base.names import listed
from ..base.types import Floats, Ints
from ..evidence.fitted_run import FittedRun
from ..evidence.run import in_time
from .explanation import CLEARLY, bic, lowest, schwarz
from .held_out import PRAISE, Columns, HeldOutGain, held_out_gain, rms, squares_of
from .scan import Scan
from .search import Search, SearchResult
from .shapes import Shape, play_operator, wave
from .stage import Stage

#: Shapes by which a run is described at most.
_MOST_SHAPES = 12
#: Part of what an effect brings that it must still bring beside the shapes; and where effects, with the shapes that go
#: with them, say clearly more than shapes alone.
_KEEPS, _KEEPS_AT_LEAST = 0.25, 0.01
#: Part of what effects take by which shapes take more where they say more.
_SAYS_MORE = 0.01
#: Part of what is there beyond noise that may be left where effects are named.
_LEFT_AT_MOST = 0.5
#: What effects and their shapes leave on rows held out is all that is left up to this many times what is free leaves.
_AS_WELL = 1.02
#: A shape counts from this part of what the leading one takes.
_COUNTS = 0.1
#: Waves (half ones) that make a function of one variable free, of time, and of two variables together.
_FREE, _FREE_IN_TIME, _FREE_TOGETHER = 8, 24, 3
#: Free columns for each reading, at most.
_MOST_COLUMNS = 0.125
_FOLDS, _REPETITIONS = 6, 3


@dataclass(frozen=True, eq=False)
class Description:
    """Shapes that describe what a model leaves, the leading one first; the sum of squares that is ``left`` and the
    ``numbers`` that were taken once the first k of them are in the model, k from none to all; how many residuals."""

    shapes: tuple[Shape, ...]
    left: tuple[float, ...]
    numbers: tuple[int, ...]
    count: int

    def schwarz(self, more: int = 0) -> float:
        """Schwarz's criterion of all of them, with so many ``more`` numbers."""
        return self.by_fit() + (self.numbers[-1] + more) * float(np.log(self.count))

    def by_fit(self) -> float:
        """The same without a price on numbers."""
        return float(self.count * np.log(max(self.left[-1], 1e-300) / self.count))

    @property
    def shown(self) -> tuple[Shape, ...]:
        """Those that count."""
        takes = -np.diff(self.left)
        return tuple(s for s, t in zip(self.shapes, takes, strict=True) if t >= _COUNTS * takes.max())


@dataclass(frozen=True, eq=False)
class Alone:
    """What a stage leaves by shapes without any effect: most runs are judged by the first few of them."""

    search: Search
    stage: Stage

    @cached_property
    def every(self) -> Description:
        """All of them."""
        return described(self.search, self.stage)

    def first(self, most: int) -> Description:
        """So many of them at most."""
        return described(self.search, self.stage, most)


def described(search: Search, stage: Stage, most: int = _MOST_SHAPES) -> Description:
    """What a stage leaves, by shapes alone: each time the one by which Schwarz's criterion falls most, until none shows
    at the level of the test or there are so many."""
    scan: Scan = stage.scan
    count = scan.n * scan.m
    shapes: list[Shape] = []
    left, numbers = [scan.sum_of_squares], [0]
    # what is left has a structure, whose flips are no measure of noise
    limit = float(scipy.special.ndtri(1.0 - search.level / max(stage.n_shapes, 1)))
    while len(shapes) < most:
        z_scores, (gain, rank) = scan.z_scores[: stage.n_shapes], scan.gains
        if not len(z_scores) or z_scores.max() <= limit:
            break
        gain, rank = gain[: stage.n_shapes], rank[: stage.n_shapes]
        score = np.where(
            rank > 0, count * np.log1p(-gain / scan.sum_of_squares * (1 - 1e-12)) + rank * np.log(count), np.inf
        )
        shape = lowest(stage, score)
        if shape is None:
            break
        best = stage.shapes.index(shape)
        shapes.append(shape)
        numbers.append(numbers[-1] + int(rank[best]) + (shape.period is not None) + (shape.shape == "step"))
        scan = scan.with_columns(shape.columns)
        left.append(scan.sum_of_squares)
    return Description(tuple(shapes), tuple(left), tuple(numbers), count)


def innocents(
    search: Search,
    result: SearchResult,
    final: FittedRun,
    gains: Sequence[HeldOutGain],
    sigma: Floats,
    by_shapes: Alone,
) -> list[tuple[str, str]]:
    """Effects of those found that must not be named, each with why. ``by_shapes`` describes the run without any
    effect; ``final`` has all effects."""
    stage = result.stages[-1]
    # where the test says that nothing is left, chance has no shape
    beside = described(search, stage, 0 if result.p_left > search.level else _MOST_SHAPES)
    shown = (*result.signature, *beside.shown)
    numbers = sum(len(c.effect.parameters) + (c.setting is not None) for c in result.added)
    numbers += sum(len(stage.scan.numbers(m)) for m in stage.scan.model)
    with_effects = beside.schwarz(more=numbers)
    # effects that leave nothing are asked only where no more shapes do better: one more is fitted to noise
    alone = by_shapes.every if shown else by_shapes.first(len(result.added))
    # and a shape that says what one tied with them does is no rival
    tied = [] if shown or len(result.replaced) < len(result.added) else result.alternatives
    best = min([with_effects, *(bic(e.stage.scan, e.candidates) for e in tied)])
    by_fit = min([beside.by_fit(), *(schwarz(e.stage.scan, 0) for e in tied)])
    clearly = alone.schwarz() < best - CLEARLY
    # the best of many shapes takes a little more than what is true by chance
    taken, more = alone.left[0] - beside.left[-1], beside.left[-1] - alone.left[-1]
    fits = alone.by_fit() < by_fit - CLEARLY and more > _SAYS_MORE * taken
    if clearly and (shown or len(alone.shapes) < len(result.added) or fits):
        shown = (*shown, *by_shapes.every.shown)
    left = final.beyond_noise(sigma)
    if left > max(PRAISE**2 - 1.0, _LEFT_AT_MOST * search.base.beyond_noise(sigma)):
        return [(c.name, "more is left than is taken: whatever leaves that may leave all") for c in result.added]
    if not shown:
        return []
    fold = _scattered(final, search.seed)
    better = with_effects < by_shapes.every.schwarz() - CLEARLY
    out: dict[str, str] = {}

    def ask(columns: Columns) -> None:
        """Those that bring nothing beside these columns."""
        for one in gains:
            if one.effect in out:
                continue
            effect = next(c.effect for c in result.added if c.name == one.effect)
            plain = held_out_gain(final, effect, sigma=sigma, repeated_folds=fold, seed=search.seed)
            free = held_out_gain(final, effect, sigma=sigma, repeated_folds=fold, beside=columns, seed=search.seed)
            # with what is free much of a true cause goes too: then it must say more in few numbers than shapes in many
            if free.holds and _gain(free) >= (_KEEPS_AT_LEAST if better else _KEEPS) * _gain(plain):
                continue
            what = listed(sorted({name for s in shown for name in s.depends_on}))
            out[one.effect] = (
                f"what is left depends on {what} in a way that no effect has, and beside whatever depends on that the "
                f"error on rows held out goes from {free.without:.4g} to {free.with_it:.4g} {final.unit} with it "
                f"(p = {free.p:.2g})"
            )

    # first beside what is alike at all places, then beside what is not: unless effects and their shapes say as much
    ask(free_columns(stage, shown, everywhere=True))
    columns = free_columns(stage, shown)
    described_too = _held_out(final, sigma, fold, _columns_of(stage, stage.nuisance))
    if not better or described_too > _AS_WELL * _held_out(final, sigma, fold, columns):
        ask(columns)
    return list(out.items())


def _gain(one: HeldOutGain) -> float:
    return one.without**2 - one.with_it**2


def _held_out(run: FittedRun, sigma: Floats, repeated_folds: Sequence[Ints], beside: Columns | None) -> float:
    """RMS on rows held out, of a model with these columns besides."""
    scale = sigma[list(run.axes)]
    rows = in_time(run, np.flatnonzero(run.whole))
    return rms(
        squares_of(run.linearised(rows, (), scale), np.stack([d[rows] for d in repeated_folds]), beside)[0], scale
    )


def _columns_of(stage: Stage, shapes: Sequence[Shape]) -> Columns | None:
    """Columns (b, m, k) of shapes as they are; None where there are none."""
    view, parts = stage.view, []
    for shape in shapes:
        if shape.period is not None:
            functions = np.stack(wave(view.variables[shape.depends_on[0]], shape.period), axis=1)
            if shape.pattern is not None:
                parts.append(view.patterns[shape.pattern][:, :, None] * functions[:, None, :])
                continue
            parts.append(_on_axes(functions, view.axes))
        else:
            parts.append(stage.raw(shape.columns, view.whole))
        if shape.axis is not None:
            # of each function the columns of all axes stand together
            parts[-1] = parts[-1][:, :, shape.axis :: view.axes]
    if not parts:
        return None
    every = np.concatenate(parts, axis=2)
    return lambda rows: every[rows]


def _scattered(run: FittedRun, seed: int) -> list[Ints]:
    """Folds (n,) of all rows, whose poses are dealt one by one: between those held out others stand."""
    pose = np.unique(run.data.groups, return_inverse=True)[1].ravel()
    rng = np.random.default_rng([seed, 5])
    return [(rng.permutation(int(pose.max()) + 1) % _FOLDS)[pose] for _ in range(_REPETITIONS)]


def free_columns(stage: Stage, shapes: Sequence[Shape], *, everywhere: bool = False) -> Columns:
    """Columns (b, m, k) of whatever depends on what these shapes depend on: at a joint where they are errors of one, on
    each axis else, and at any place in a way of its own where it changes in the course of time or with a covariate, but
    for what is the same ``everywhere``."""
    view = stage.view
    room = int(_MOST_COLUMNS * view.residual.size)
    poses = {*view.pattern_of, *view.place}
    made: dict[tuple[object, ...], Floats] = {}
    for shape in shapes:
        for name in set(shape.depends_on) - poses:
            if (name,) not in made:
                most = min(_FREE_IN_TIME if name == "time_s" else _FREE, room // (2 * view.axes))
                made[(name,)] = _on_axes(_waves(view.variables[name], most), view.axes)
                course = _waves(view.variables[name], min(_FREE, room // (2 * view.axes * max(len(view.place), 1))))
                for place in () if everywhere else view.place:
                    made[name, place] = _on_axes(course * _unit(view.variables[place])[:, None], view.axes)
        names = tuple(n for n in shape.depends_on if n in poses)
        key = (*names, shape.pattern, shape.shape == "hysteretic")
        if not names or key in made:
            continue
        values = [view.variables[n] for n in names]
        functions = (
            _of_the_way(values[0]) if shape.shape == "hysteretic"
            else _waves(values[0], _FREE) if len(values) == 1 else _together(*values)
        )  # fmt: skip
        if shape.pattern is None:
            made[key] = _on_axes(functions, view.axes)
        else:
            made[key] = view.patterns[shape.pattern][:, :, None] * functions[:, None, :]
    every = np.concatenate(list(made.values()), axis=2)[:, :, : 2 * room]
    return lambda rows: every[rows]


def _on_axes(functions: Floats, axes: int) -> Floats:
    """Functions (n, k) on each axis (n, m, m·k)."""
    return np.einsum("nf,ab->nafb", functions, np.eye(axes)).reshape(len(functions), axes, -1)


def _unit(values: Floats) -> Floats:
    return np.asarray(2 * (values - values.min()) / max(float(np.ptp(values)), 1e-300) - 1)


def _waves(values: Floats, count: int) -> Floats:
    """Half waves (n, k), of which the first is a constant, over the range by rank: dense where the values are."""
    distinct, place = np.unique(values, return_inverse=True)
    even = np.linspace(0.0, 1.0, len(distinct))[place.ravel()]
    return np.asarray(np.cos(np.pi * np.outer(even, np.arange(min(count + 1, len(distinct))))))


def _together(first: Floats, second: Floats) -> Floats:
    u, v = _unit(first), _unit(second)
    powers = [(i, j) for i, j in product(range(_FREE_TOGETHER + 1), repeat=2) if i + j <= _FREE_TOGETHER]
    return np.stack([u**i * v**j for i, j in powers], axis=1)


def _of_the_way(q: Floats) -> Floats:
    step = np.sign(np.diff(q, prepend=q[:1]))
    last = np.maximum.accumulate(np.where(step != 0, np.arange(len(q)), 0))
    played = [play_operator(q, width) - q for width in np.ptp(q) * np.array([0.002, 0.01, 0.05, 0.2])]
    return np.stack([step[last], *played], axis=1)
