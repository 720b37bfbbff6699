"""Rows in the order of time: where each stands, from which side its joints came there, what follows the room slowly."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.types import Bools, Floats, Ints

# -- The order of time -------------------------------------------------------------------------------------------------

#: A joint that moved by less than this part of its range stood still.
_NO_MOTION = 1e-9
#: Turns that make a course there and back, and the part of its rows that they are at most.
_FEWEST_TURNS, _SELDOM = 2, 0.25


def directions(joints: Floats, order: Ints, *, begins: float) -> Floats:
    """Sign (n, k) of the last motion of each joint (n, k), in the ``order`` (n,) of time; ``begins`` before the first.

    A joint that was sent to where it stood moves by the last digit of a number, if at all: that is no motion. But where
    it goes there and back and stands still nowhere else, what it reads a second time where it turns it has come back to
    from beyond, as ISO 230-2 has it.
    """
    if not len(joints):
        return joints.copy()
    at = np.argsort(order, kind="stable")
    move = np.diff(joints[at], axis=0, prepend=joints[at[:1]])
    step = np.where(np.abs(move) > _NO_MOTION * np.ptp(joints, axis=0), np.sign(move), 0.0)
    stood = (step == 0).all(axis=1)
    for course in step.T:
        turned = _turned(course, stood)
        course[turned] = course[turned + 1]
    # where a joint did not move, the direction of the motion before still holds
    last = np.maximum.accumulate(np.where(step != 0, np.arange(len(step))[:, None], 0), axis=0)
    step[:1] = begins
    out = np.empty_like(step)
    out[at] = np.take_along_axis(step, last, axis=0)
    return out


def _turned(step: Floats, stood: Bools) -> Ints:
    """Rows at which all joints ``stood`` (n,) and one of them, of its motions (n,), turns: where it turns nowhere else,
    nor stands, and seldom; none else."""
    still, moves = np.flatnonzero(step[1:-1] == 0) + 1, step[step != 0]
    turns = int(np.count_nonzero(np.diff(moves)))
    at_turns = stood[still] & (step[still - 1] != 0) & (step[still + 1] == -step[still - 1])
    seldom = _FEWEST_TURNS <= len(still) <= _SELDOM * len(step)
    return still if seldom and turns == len(still) and at_turns.all() else still[:0]


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


# -- What follows the room slowly --------------------------------------------------------------------------------------
# The temperature of what follows the room slowly: a stand, a tripod, a base, a slab.

#: Temperature at which a robot is as drawn, and that of its stand in a control loop, which has no instrument, °C.
DRAWN_C = 20.0


class Room(NamedTuple):
    """The temperature of the room as a whole run has it: times (k,), s, in order, and °C (k,)."""

    time_s: Floats
    temperature_c: Floats

    @classmethod
    def of(cls, time_s: Floats | None, temperature_c: Floats | None) -> Room | None:
        """From columns in any order; None where one of them is missing."""
        if time_s is None or temperature_c is None:
            return None
        known = np.isfinite(temperature_c)
        order = np.flatnonzero(known)[np.argsort(time_s[known], kind="stable")]
        return cls(time_s[order], temperature_c[order]) if len(order) else None

    def later(self, time_s: Floats, lag_s: float) -> Floats:
        """Temperature (n,), °C, at times (n,) of what follows with a time constant of ``lag_s``.

        First order, ``lag · dT/dt = room - T``, exact where the room's temperature goes straight from one reading to
        the next; as warm as the room when the run began.
        """
        room = self.temperature_c
        apart = np.diff(self.time_s) / lag_s
        stays = np.exp(-apart)
        # of a ramp of one degree, how much is still to come at its end; of a jump all of it
        behind = np.divide(-np.expm1(-apart), apart, out=np.ones_like(apart), where=apart > 0)
        missing = np.concatenate([[0.0], _decayed(stays, behind * np.diff(room))])
        return np.asarray(np.interp(time_s, self.time_s, room - missing))


def _decayed(stays: Floats, new: Floats) -> Floats:
    """What is left (n,) of all that came so far: ``left[k] = stays[k] left[k - 1] + new[k]``.

    Stretches of twice the length are joined in each turn, as long as there are longer ones (Hillis and Steele, "Data
    parallel algorithms", 1986).
    """
    length = 1
    while length < len(new):
        new = np.concatenate([new[:length], new[length:] + stays[length:] * new[:-length]])
        stays = np.concatenate([stays[:length], stays[length:] * stays[:-length]])
        length *= 2
    return new
