"""The host's time, as readings and rows carry it: one that never goes back while the program runs."""

from __future__ import annotations

import time

_WALL_S = time.time()
_STEADY_S = time.monotonic()


def now_s() -> float:
    """Seconds since 1970, by the wall clock as it was when the program began, counted on by the monotonic clock.

    A wall clock that is set while a run goes on does not reach the rows.
    """
    return _WALL_S + (time.monotonic() - _STEADY_S)


def wall_ahead_s() -> float:
    """By how much the wall clock has been set forward since the program began, s; negative: back."""
    return time.time() - now_s()
