"""The temperature of what follows the room slowly: a stand, a tripod, a base, a slab."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.types import Floats

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
