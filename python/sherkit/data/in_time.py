"""Rows in the order of time: where each stands, and from which side its joints came there."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.types import Floats, Ints

#: A joint that moved by less than this part of its range stood still.
_NO_MOTION = 1e-9


def directions(joints: Floats, order: Ints, *, begins: float) -> Floats:
    """Sign (n, k) of the last motion of each joint (n, k), in the ``order`` (n,) of time; ``begins`` before the first.

    A joint that was sent to where it stood moves by the last digit of a number, if at all: that is no motion.
    """
    if not len(joints):
        return joints.copy()
    at = np.argsort(order, kind="stable")
    move = np.diff(joints[at], axis=0, prepend=joints[at[:1]])
    step = np.where(np.abs(move) > _NO_MOTION * np.ptp(joints, axis=0), np.sign(move), 0.0)
    # where a joint did not move, the direction of the motion before still holds
    last = np.maximum.accumulate(np.where(step != 0, np.arange(len(step))[:, None], 0), axis=0)
    step[:1] = begins
    out = np.empty_like(step)
    out[at] = np.take_along_axis(step, last, axis=0)
    return out


#: Rows that follow within this time, s, may have been read in motion.
_DENSE_S = 0.5
#: Part of the velocity by which it changes from row to row in the median, where rows show the course of a motion.
_SMOOTH = 0.3
_FEWEST_DENSE = 20


def velocities(joints: Floats, time_s: NDArray[Any] | None) -> Floats | None:
    """Velocities (n, k) of joints (n, k) by central differences, where rows follow one another so closely that they
    show the course of a motion; None where a robot stood still between readings, as far as rows tell."""
    if time_s is None or len(joints) < _FEWEST_DENSE or not joints.shape[1]:
        return None
    at = np.argsort(time_s, kind="stable")
    gaps = np.diff(time_s[at])
    if not 0 < np.median(gaps) < _DENSE_S or gaps.min() <= 0:
        return None
    each = np.diff(joints[at], axis=0) / gaps[:, None]
    usual = np.median(np.abs(each), axis=0)
    moves = usual > 0
    if not moves.any() or (np.median(np.abs(np.diff(each, axis=0)), axis=0) > _SMOOTH * usual)[moves].any():
        return None
    out = np.empty_like(joints)
    out[at] = np.gradient(joints[at], time_s[at], axis=0)
    return out


def begin_of(time_s: NDArray[Any] | None) -> float:
    """The earliest time; zero where none is known."""
    return float(np.min(time_s)) if time_s is not None and len(time_s) else 0.0


def order_in_time(time_s: NDArray[Any] | None, n: int) -> Ints:
    """Places (n,) of rows in time, from 0; as they stand where no time is known."""
    out = np.arange(n, dtype=np.int64)
    if time_s is not None:
        out[np.argsort(np.asarray(time_s, dtype=float), kind="stable")] = np.arange(n)
    return out
