"""What the reading of one grating does that no bend does: it leaps off for once, or jumps for good.

A bend moves the three fibres of a section to all sides, and their mean by what their places are uneven; warmth moves
the mean, slowly. A reading that is off, or a fibre that slips, moves one fibre alone and with it the mean by a third.
Readings are held against those before and after them: a loop cannot, so its filter only gates what is far off.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...base.types import Bools, Floats
from .tool import FIBRES

#: Readings on each side that show where a grating stands at a moment.
_SIDE = 10
#: A mean moves beyond so many of its deviations, what 0.1 K between gratings make, nm, and these parts of the bend and
#: of its way.
_DEVIATIONS, _WARMER_NM, _UNEVEN, _LAGS = 8.0, 1e-3, 0.15, 0.03
#: The other two fibres move by less than this part of what the one does.
_OTHERS = 0.4
#: Readings around one that leaps are apart by less than this part of it.
_AGREE = 0.5
#: What jumps does so from one reading to the next, by this part at least.
_AT_ONCE = 0.7
#: What comes back within so many readings did not jump for good; readings are no further apart than so many times the
#: usual.
_BACK, _APART = 4 * _SIDE, 3.0
#: Of a normal distribution: its deviation over the median of what it is off; with the median of four others taken off.
_BY_MEDIAN, _BESIDE = 1.4826, 1.15
#: Further than any reading of a grating, nm: another fault, with another name.
_NO_READING_NM = 8.0


@dataclass(frozen=True)
class Jump:
    """A grating (column) that stands elsewhere from a moment on."""

    column: str
    at_s: float
    by_nm: float

    def __str__(self) -> str:
        return (
            f"{self.column} jumps by {1e3 * self.by_nm:+.0f} pm at {self.at_s:.2f} s and stays there, while the other "
            "two of its section do not: its fibre slipped or its peak is another. Depth and force are off from then on"
        )


@dataclass(frozen=True, eq=False)
class Leaps:
    """``single`` (n, 9) are readings that are off for once; ``scatter_nm`` is how a reading scatters about those around
    it, by the means of sections, which bends leave where they are."""

    single: Bools
    jumps: tuple[Jump, ...]
    scatter_nm: float


def leaps_of(time_s: Floats, wavelengths_nm: Floats, new: Bools) -> Leaps:
    """Of readings (n, 9) in the rows (n,) that bring ``new`` ones."""
    rows = np.flatnonzero(new)
    single = np.zeros(wavelengths_nm.shape, dtype=bool)
    if len(rows) < 4 * _SIDE:
        return Leaps(single, (), np.nan)
    waves = wavelengths_nm[rows]
    around = _shifted(waves, (-2, -1, 1, 2))
    off = waves - _median(around)
    scatter = _BY_MEDIAN * _median(np.abs(off)) / _BESIDE
    # where a jump lies between them, those around do not agree
    low, high = np.sort(around, axis=0)[1:3]
    single[rows] = _alone(off, scatter * _BESIDE) & (high - low < _AGREE * np.abs(off))
    smooth = _median(_shifted(waves, (-2, -1, 0, 1, 2)))
    means = np.abs(off.reshape(-1, 3, 3).mean(axis=2))
    own = float(_median(_median(means))) * _BY_MEDIAN / _BESIDE * float(np.sqrt(3.0))
    return Leaps(single, _jumps(time_s[rows], waves, smooth, scatter), own)


def _shifted(waves: Floats, by: Sequence[int]) -> Floats:
    """The readings (n, 9) that are so many rows on, each (k, n, 9)."""
    padded = np.pad(waves, ((2, 2), (0, 0)), constant_values=np.nan)
    return np.stack([padded[2 + k : 2 + k + len(waves)] for k in by])


def _median(values: Floats) -> Floats:
    """Over the first axis of what is known."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # nothing is known: NaN
        return np.asarray(np.nanmedian(values, axis=0))


def _alone(moved: Floats, scatter: Floats, went: Floats | None = None) -> Bools:
    """Fibres (n, 9) that moved alone, as their section's mean shows, beyond their ``scatter`` (9,) and what a fibre
    that lags may keep of the way that it ``went`` meanwhile (n, 9)."""
    by = moved.reshape(-1, 3, 3)
    mean = by.mean(axis=2, keepdims=True)
    bend = np.abs(by - mean).max(axis=2, keepdims=True)
    std = np.sqrt((scatter.reshape(3, 3) ** 2).sum(axis=1, keepdims=True)) / 3.0
    keeps = 0.0 if went is None else _LAGS * went.reshape(-1, 3, 3)
    size = np.sort(np.abs(by), axis=2)
    alone = (size[:, :, 1:2] < _OTHERS * size[:, :, 2:]) & (np.abs(by) == size[:, :, 2:])
    return np.asarray((alone & (np.abs(mean) > _DEVIATIONS * std + _WARMER_NM + _UNEVEN * bend + keeps)).reshape(-1, 9))


def _jumps(time_s: Floats, waves: Floats, smooth: Floats, scatter: Floats) -> tuple[Jump, ...]:
    """Where the lines through the ``smooth`` readings before and behind a moment meet it at two places, and lines
    through the ``waves`` themselves that no outlier moves do so too."""
    at = np.arange(_SIDE) - 0.5 * (_SIDE - 1)
    # a line through the readings, half a step beyond the last
    ahead = 1.0 / _SIDE + at * (0.5 * _SIDE) / (at @ at)
    windows = np.lib.stride_tricks.sliding_window_view(smooth, _SIDE, axis=0)
    moved = (windows @ ahead[::-1])[_SIDE:] - (windows @ ahead)[:-_SIDE]
    spans = time_s[2 * _SIDE - 1 :] - time_s[: 1 - 2 * _SIDE]
    near = spans < _APART * (2 * _SIDE - 1) * float(np.median(np.diff(time_s)))
    std = scatter * float(np.sqrt(2.0 * ahead @ ahead))
    # glue with play bends the course of a fibre where the bend turns, and leaves it whole
    course = np.cumsum(np.abs(np.diff(smooth, axis=0, prepend=smooth[:1])), axis=0)
    went = course[2 * _SIDE - 1 :] - course[: 1 - 2 * _SIDE]
    alone = _alone(moved, std, went) & near[:, None] & (np.abs(moved) < _NO_READING_NM)
    found = []
    for k, name in enumerate(FIBRES):
        size = np.where(alone[:, k], moved[:, k], 0.0)
        while size.any():
            here = int(np.argmax(np.abs(size)))
            around = size[max(0, here - 2 * _SIDE) : here + 2 * _SIDE]
            around[around * size[here] > 0.0] = 0.0
            edge = here + _SIDE
            by = _ahead(waves[edge : edge + _SIDE][::-1]) - _ahead(waves[here:edge])
            step = np.diff(waves[here : edge + _SIDE, k])
            at_once = np.abs(step - _median(step))[_SIDE - 3 : _SIDE + 2].max()
            if _alone(by[None], std, went[here : here + 1])[0, k] and at_once > _AT_ONCE * abs(by[k]):
                found.append((here, Jump(name, float(time_s[edge]), float(by[k]))))
    return tuple(one for here, one in sorted(found, key=lambda each: each[0]) if not _comes_back(here, one, found))


def _ahead(waves: Floats) -> Floats:
    """Where a line through readings (k, 9) is half a step beyond the last, by medians (Theil 1950, Sen 1968)."""
    at = np.arange(len(waves)) - len(waves) + 0.5
    one, other = np.triu_indices(len(at), 1)
    slope = _median((waves[other] - waves[one]) / (at[other] - at[one])[:, None])
    return _median(waves - np.outer(at, slope))


def _comes_back(here: int, one: Jump, found: Sequence[tuple[int, Jump]]) -> bool:
    """Whether the same grating jumps to the other side soon before or after."""
    return any(
        other.column == one.column and abs(there - here) < _BACK and other.by_nm * one.by_nm < 0.0
        for there, other in found
    )
