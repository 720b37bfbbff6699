"""Streams of a run that froze: rows that go on while all nine wavelengths, or the robot's pose, repeat themselves.

Nine wavelengths scatter by their noise, whatever the tool does, and never come again to the last digit: where they do,
the reading is that of an earlier row. A robot may stand still, and then gives the same pose for as long as it likes;
but one that stood still begins to move as it moves elsewhere. It froze where it is elsewhere at once, or where the
tool is bent as far meanwhile as it is by the robot's motion and the robot stopped within one row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...base.figures import listed
from ...base.types import Bools, Floats

#: A stream froze where nothing new comes for so long, s, and for so many of its usual steps.
_LONG_S, _STEPS = 0.2, 10.0
#: Wavelengths are written so finely that no two are alike by chance: in this part of how one usually jumps.
_FINE = 0.5
#: A robot is elsewhere at once where it would have gone so many times as fast as its fastest, since its last usual row.
_AT_ONCE = 3.0
#: Bent while it seems to stand, over what it is bent elsewhere in as much time; speed before, over the usual.
_BENT, _STOPPED = 0.5, 0.2
#: Rows without which nothing is usual.
_FEWEST = 20


def repeats(wavelengths_nm: Floats) -> Bools:
    """Rows (n,) whose wavelengths (n, 9) are all those of the row before; none where they are written so coarsely that
    noise repeats them."""
    known = np.isfinite(wavelengths_nm)
    before, now = wavelengths_nm[:-1], wavelengths_nm[1:]
    same = ((now == before) | (~known[1:] & ~known[:-1])).all(axis=1) & known[1:].any(axis=1)
    out = np.concatenate([[False], same])
    if out.any() and not _fine(wavelengths_nm[~out]):
        out[:] = False
    return np.asarray(out)


def _fine(wavelengths_nm: Floats) -> bool:
    """Whether the step in which they are written is small beside how they scatter."""
    if len(wavelengths_nm) < _FEWEST:
        return False
    steps = np.abs(np.diff(wavelengths_nm, axis=0))
    usual = np.abs(np.diff(wavelengths_nm, n=2, axis=0))
    told = []
    for one, two in zip(steps.T, usual.T, strict=True):
        least, scatter = one[one > 0], two[np.isfinite(two)]
        if len(least) and len(scatter):
            told.append(least.min() < _FINE * np.median(scatter))
    return bool(told) and bool(np.median(told) > 0.5)


@dataclass(frozen=True)
class Frozen:
    """Rows ``first`` to ``last`` of a run repeat the one before."""

    first: int
    last: int
    since_s: float
    until_s: float


def frozen_stretches(time_s: Floats, same: Bools) -> list[Frozen]:
    """Stretches of rows (n,) that hold the ``same`` as the row before, again and again."""
    if not same.any():
        return []
    usual = float(np.median(np.diff(time_s[~same]))) if int((~same).sum()) > 1 else np.inf
    long_s = max(_LONG_S, _STEPS * usual)
    return [one for one in _stretches(time_s, same) if one.until_s - one.since_s >= long_s]


def _stretches(time_s: Floats, rows: Bools) -> list[Frozen]:
    edges = np.flatnonzero(np.diff(rows.astype(int), prepend=0, append=0)).reshape(-1, 2)
    return [Frozen(int(a), int(b) - 1, float(time_s[a - 1]), float(time_s[b - 1])) for a, b in edges]


def frozen_pose(time_s: Floats, position_mm: Floats, turn_rad: Floats, wavelengths_nm: Floats) -> list[Frozen]:
    """Stretches in which the robot's place or turn (n, 3) repeats itself though the tool moved; ``wavelengths_nm``
    (n, 9) are NaN where nothing was read."""
    paths = [_Path(time_s, one) for one in (position_mm, turn_rad)]
    out = [one for path in paths for one in frozen_stretches(time_s, path.same) if path.jumps(one)]
    for one in frozen_stretches(time_s, paths[0].same & paths[1].same):
        if any(path.stops(one) for path in paths) and _bent(wavelengths_nm, one):
            out.append(one)
    return _stretches(time_s, rows_of(out, len(time_s)))


class _Path:
    """A place or a turn over time: where it is the ``same`` as in the row before, and how fast it goes from new row to
    new row where these follow each other as usual."""

    def __init__(self, time_s: Floats, values: Floats) -> None:
        self.time_s, self.values = time_s, values
        self.same = np.append(False, (np.diff(values, axis=0) == 0).all(axis=1))
        here = np.flatnonzero(~self.same)
        step = np.diff(time_s[here])
        self.usual_s = float(np.median(step)) if len(step) else np.inf
        follows = step < min(_LONG_S, _STEPS * self.usual_s)
        moved = np.linalg.norm(np.diff(values[here], axis=0), axis=1)
        speed = moved[follows] / step[follows]
        known = len(speed) >= _FEWEST
        self.usual, self.fastest = (float(of(speed)) if known else np.inf for of in (np.median, np.max))

    def jumps(self, one: Frozen) -> bool:
        """Whether it is elsewhere at once after a stretch."""
        after = one.last + 1
        return after < len(self.time_s) and self._speed(one.last, after) > _AT_ONCE * self.fastest

    def stops(self, one: Frozen) -> bool:
        """Whether it stood from one row to the next."""
        return one.first > 1 and self._speed(one.first - 2, one.first - 1) > _STOPPED * self.usual

    def _speed(self, a: int, b: int) -> float:
        gap = max(float(self.time_s[b] - self.time_s[a]), self.usual_s)
        return float(np.linalg.norm(self.values[b] - self.values[a])) / gap


def _bent(wavelengths_nm: Floats, one: Frozen) -> bool:
    """Whether the differences between fibres range as far as they do elsewhere in as much time."""
    waves = wavelengths_nm.reshape(-1, 3, 3)[:, :2]
    bends = (waves - waves.mean(axis=2, keepdims=True)).reshape(-1, 6)
    here = rows_of([one], len(bends))
    # as long as it is, or as there is to compare with
    rows = min(int(here.sum()), int((~here).sum()) // 3)

    def ranges(inside: Bools) -> float:
        part = bends[inside]
        blocks = [part[k : k + rows] for k in range(0, len(part) - rows + 1, rows)] if rows >= _FEWEST else []
        blocks = [block[np.isfinite(block).all(axis=1)] for block in blocks]
        told = [float(block.std(axis=0).max()) for block in blocks if len(block) >= _FEWEST]
        return float(np.median(told)) if told else np.nan

    return ranges(here) > _BENT * ranges(~here)


def rows_of(found: list[Frozen], count: int) -> Bools:
    """Rows (n,) of these stretches."""
    out = np.zeros(count, dtype=bool)
    for one in found:
        out[one.first : one.last + 1] = True
    return out


# -- What follows ----------------------------------------------------------------------------------------------------


def strayed_mm2(position_mm: Floats, along: Floats, frozen: Bools) -> tuple[Floats, Floats]:
    """How far the robot may have gone while its pose stood (n,): mean squares along the shaft (n, 3) and of a
    coordinate, mm², as it goes in as much time in the other rows."""
    count = len(frozen)
    slides, goes = np.zeros(count), np.zeros(count)
    since = np.arange(count) - np.maximum.accumulate(np.where(frozen, -1, np.arange(count)))
    farthest = (0.0, 0.0)
    for k in range(1, int(since[frozen].max(initial=0)) + 1):
        both = ~frozen[k:] & ~frozen[:-k]
        if both.any():
            went = (position_mm[k:] - position_mm[:-k])[both]
            slid = np.einsum("ni,ni->n", went, along[:-k][both])
            farthest = max(farthest[0], float((slid**2).mean())), max(farthest[1], float((went**2).mean()))
        here = frozen & (since == k)
        slides[here], goes[here] = farthest
    return slides, goes


def sentences(fibres: list[Frozen], pose: list[Frozen]) -> list[str]:
    """What froze, when, and what follows."""
    out = []
    if fibres:
        out.append(
            f"All wavelengths repeat themselves to the last digit {_spans(fibres)} while the rows go on: the "
            "interrogator, or what writes its readings, froze. They count as lost; look at what records them, and "
            "measure again"
        )
    if pose:
        out.append(
            f"The robot's pose repeats itself to the last digit {_spans(pose)} while the tool moved: its source froze "
            "(a topic that was not renewed, a stopped recorder). Depth and tip of these rows are not to be trusted; "
            "measure again"
        )
    return out


def _spans(found: list[Frozen]) -> str:
    return listed((f"from {one.since_s:.2f} to {one.until_s:.2f} s" for one in found), 4)
