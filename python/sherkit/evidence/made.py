"""Waves, and where blocks are put together: columns are gathered by what they are made of, and numbered when all are
there."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..base.types import Bools, Floats, Ints
from .blocks import Block, ColumnPart, ReferenceRows, Visits
from .run import Run
from .thresholds import SAME_PLACE
from .whitening import orthonormal

# -- Waves -------------------------------------------------------------------------------------------------------------
# Waves over the range of a variable: tables of their sines and cosines, and which of them poses can tell.

#: Waves over the range: along a joint, a half wave apart; in time; over a place, which a grid tells less well.
_JOINT, _TIME, _PLACE = (1.0, 60.0), (1.0, 61.0), (2.0, 12.0)
#: Of scales and screws, all of one pitch; of a gear.
CYCLIC, _GEAR = (1.0, 121.0), (3.0, 321.0)
#: How many times as many waves as values uneven places tell.
_UNEVEN = 3.0
#: Part of a wave, or of its frequency, from which on slower ones stand in for it where values are too far apart.
_STANDS_IN = 0.8
#: Values that tell whether they do.
_LOOKED_AT = 2000


def waves_along(values: Floats, tried: tuple[float, float] = _JOINT, *, per_value: float = 1.0) -> Floats:
    """How many waves over a joint's range are tried: no more than ``per_value`` of those that it has, or three times as
    many as these where they lie so unevenly that none looks like a slower one (VanderPlas, "Understanding the
    Lomb-Scargle periodogram", ApJS 2018, section 7.1: the spectral window)."""
    counts = np.arange(*tried, 0.5)
    reach = max(float(np.ptp(values)), 1e-300)
    places = np.unique(np.round(values / (SAME_PLACE * reach))) * SAME_PLACE
    if len(places) > counts[-1] or len(places) < 2:
        return np.asarray(counts[counts <= max(len(places), 2)])
    window = np.abs(np.exp(2j * np.pi * np.outer(counts, places)).mean(axis=1))
    even = window[counts <= _UNEVEN * len(places)].max() > _STANDS_IN
    return np.asarray(counts[counts <= max((per_value if even else _UNEVEN) * len(places), 2)])


def waves_of_gear(values: Floats, axes: float) -> Floats:
    """The same of a joint by itself that is read by so many ``axes``: a gear has more waves than what all joints share,
    and slow ones are not told from what else a joint does."""
    counts = np.arange(*_GEAR, 0.5)
    distinct = len(np.unique(np.round(values / (SAME_PLACE * max(float(np.ptp(values)), 1e-300)))))
    return np.asarray(counts[counts <= max(0.5 * axes * distinct, 2)])


def waves_in_time() -> Floats:
    """How many waves over a run are tried."""
    return np.arange(*_TIME, 0.5)


def waves_over_place() -> Floats:
    """How many waves over a coordinate are tried."""
    return np.arange(*_PLACE, 0.5)


def wave_table(angle: Floats, counts: Floats) -> Floats:
    """Sines, then cosines (n, 2 w) of so many times the ``angle`` (n,) each; ``counts`` (w,) are evenly apart, so that
    all are products of a few (angle addition)."""
    few = max(int(np.sqrt(len(counts))), 1)
    apart = counts[1] - counts[0] if len(counts) > 1 else 0.0
    first = np.exp(1j * np.multiply.outer(angle, counts[:few]))
    on = np.exp(1j * np.multiply.outer(angle, apart * few * np.arange(-(-len(counts) // few))))
    waves = (on[:, :, None] * first[:, None, :]).reshape(len(angle), -1)[:, : len(counts)]
    return np.concatenate([waves.imag, waves.real], axis=1)


def distinguishable_waves(values: Floats, counts: Floats) -> Bools:
    """Which waves (w,) the ``values`` that a variable has can tell: on the lines of a grid one as short as their
    distance is next to nothing, or what any slow bend is."""
    some = np.sort(values)[:: max(len(values) // _LOOKED_AT, 1)]
    u = (some - some[0]) / (some[-1] - some[0])
    out, slower, known = np.ones(len(counts), dtype=bool), np.zeros((len(u), 0)), 0
    # what is slower than one wave is slower than all after it
    for k in np.argsort(counts):
        half = np.arange(0, 2.0 * _STANDS_IN * counts[k] + 1e-9)
        if 2 * len(half) >= len(some):
            break
        more = np.cos(np.pi * np.outer(u, half[known:]))
        more = more - slower @ (slower.T @ more)
        more = orthonormal(more[:, np.square(more).sum(axis=0) > 1e-12 * len(u)], 1e-6)
        slower, known = np.concatenate([slower, more - slower @ (slower.T @ more)], axis=1), len(half)
        wave = np.exp(2j * np.pi * counts[k] * u)
        out[k] = np.square(np.abs(wave - slower @ (slower.T @ wave))).sum() >= (1.0 - _STANDS_IN) * len(u)
    return out


# -- Blocks put together -----------------------------------------------------------------------------------------------

#: Columns to be: the part they will stand in, and their numbers (k,) there.
Piece = tuple[int, Ints]

_FUNCTIONS, _WHOLE = (0, 1), (2, 3)
#: Moments at which a step is tried, evenly of the rows.
MOMENTS = 24


class Maker:
    """Gathers blocks of a ``run`` whose poses were seen in these ``visits``.

    What functions are of is brought to the range ``like`` that it has in the run itself, or in a ``reference``;
    ``moments`` are those from which on a step is tried, each with its row.
    """

    def __init__(self, run: Run, visits: Visits, reference: ReferenceRows | None = None) -> None:
        self.run, self.view, self.visits, self.reference = run, run.view, visits, reference
        self.like = run.view if reference is None else reference.view
        n = len(run)
        cuts = [k * n // MOMENTS for k in range(1, MOMENTS)] if reference is None else reference.cuts
        time = run.view.time
        self.moments: list[float] = [] if time is None else [
            float(0.5 * (time[c] + time[c - 1])) for c in cuts if 0 < c < n and time[c] > time[c - 1]
        ]  # fmt: skip
        self._blocks: list[tuple[dict[str, Any], list[Piece]]] = []
        # functions on axes and whole columns, each by row and by pose
        self._gathered: tuple[list[Floats], ...] = ([], [], [], [])
        self._parts: list[ColumnPart] = []

    def since(self, moment: float) -> Floats:
        """One (n,) from a moment on, zero before."""
        assert self.view.time is not None, "a step has a moment"
        return (self.view.time > moment).astype(float)

    def unit(self, name: str, *, at_ends: bool = False) -> Floats:
        """A variable (n,), or an input at the ends of the rows (e n,), its range brought to -1 … 1."""
        values, like = (view.stood[name] if at_ends else view.variables[name] for view in (self.view, self.like))
        if self.reference is not None and name == "time_s":
            # counted from the begin of each
            values, like = values - self.run.of.data.begins_s, like - like[0]
        return np.asarray(2.0 * (values - like.min()) / max(float(np.ptp(like)), 1e-300) - 1.0)

    def waves(self, angle: Floats, counts: Floats, carriers: Floats) -> int:
        """The part of sines, then cosines of so many times an ``angle`` (n,), on ``carriers`` as :meth:`part` has
        them; without their means unless there is a reference."""
        posed = self.visits.same(angle) and self.visits.same(carriers)
        rows = self.visits.first if posed else slice(None)
        table = wave_table(angle[rows], counts)
        if self.reference is None:
            table -= np.average(table, axis=0, weights=self.visits.count if posed else None)
        return self._part(table, carriers[rows], posed)

    def waves_of(self, joint: str, angle: Floats, counts: Floats) -> int:
        """The same of an ``angle`` (e n,) at the ends of the rows, as an error of this joint arrives."""
        if self.view.ends == 1:
            return self.waves(angle, counts, self.view.patterns[joint][:, :, None])
        table = wave_table(angle, counts)
        if self.reference is None:
            table -= table.mean(axis=0)
        return self.part(np.ones((len(self.view), 1)), self.view.arriving(joint, table))

    def function(self, values: Floats) -> Piece:
        """A function (n,) of the row on every axis alone, without its mean unless there is a reference: m columns."""
        posed = self.visits.same(values)
        centred = self._centred(values)
        mine = self._gathered[_FUNCTIONS[posed]]
        mine.append(centred[self.visits.first] if posed else centred)
        m = self.view.axes
        return _FUNCTIONS[posed], (len(mine) - 1) * m + np.arange(m)

    def whole(self, columns: Floats) -> Piece:
        """Columns (n, m, k) as they are."""
        posed = self.visits.same(columns)
        mine = self._gathered[_WHOLE[posed]]
        first = sum(one.shape[2] for one in mine)
        mine.append(columns[self.visits.first] if posed else columns)
        return _WHOLE[posed], first + np.arange(columns.shape[2])

    def along(self, joint: str, values: Floats) -> Piece:
        """The same of the ends of the rows (e n,), as an error of this joint arrives at the readings."""
        return self.whole(self.view.arriving(joint, self._centred(values)[:, None]))

    def _centred(self, values: Floats) -> Floats:
        return values - values.mean() if self.reference is None else values

    def part(self, functions: Floats, carriers: Floats) -> int:
        """All products of ``functions`` (n, f) and ``carriers`` (n, c) or (n, m, c): the number of their part."""
        posed = self.visits.same(functions) and self.visits.same(carriers)
        rows = self.visits.first if posed else slice(None)
        return self._part(np.ascontiguousarray(functions[rows]), carriers[rows], posed)

    def _part(self, functions: Floats, carriers: Floats, posed: bool) -> int:
        self._parts.append(ColumnPart(functions, np.ascontiguousarray(carriers), self.view.axes, posed))
        return 3 + len(self._parts)

    def add(self, shape: str, depends_on: tuple[str, ...], pieces: list[Piece], **about: Any) -> None:
        """A block of these columns; ``about`` as :class:`~.blocks.Block` has it."""
        self._blocks.append(({"shape": shape, "depends_on": depends_on, **about}, pieces))

    def on_axes(
        self, shape: str, depends_on: tuple[str, ...], functions: list[Piece], *, each: bool = True, **about: Any
    ) -> None:
        """A block of functions on all axes together, and of ``each`` alone."""
        if each and self.view.axes > 1:
            for a in range(self.view.axes):
                self.add(shape, depends_on, [(part, at[a : a + 1]) for part, at in functions], axis=a, **about)
        self.add(shape, depends_on, functions, **about)

    def done(self) -> tuple[list[ColumnPart], list[Block]]:
        """All parts, and the blocks with the numbers of their columns."""
        n, p, m = len(self.run), len(self.visits), self.view.axes
        parts = []
        for k, gathered in enumerate(self._gathered):
            posed = k % 2 == 1
            rows = p if posed else n
            if k in _FUNCTIONS:
                values = np.stack(gathered, axis=1) if gathered else np.zeros((rows, 0))
                parts.append(ColumnPart(values, np.ones((rows, 1)), m, posed))
            else:
                columns = np.concatenate([np.zeros((rows, m, 0)), *gathered], axis=2)
                parts.append(ColumnPart(np.ones((rows, 1)), columns, m, posed))
        parts += self._parts
        starts = np.concatenate([[0], np.cumsum([len(part) for part in parts])]).astype(np.int64)
        blocks = [
            Block(at=np.concatenate(at) if len(at) > 1 else at[0], **about)
            for about, at in ((about, [starts[part] + at for part, at in pieces]) for about, pieces in self._blocks)
        ]
        return parts, blocks
