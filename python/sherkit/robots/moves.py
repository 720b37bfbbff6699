"""How well a calibrated robot moves from one place to another: what both places are off by alike is no part of it."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import SherkitError
from ..fit.error import radius_95
from ..model.batch import vector
from .accuracy import Accurate
from .deployed import BASE, SENSOR

#: What the place is called from which moves begin.
MIDDLE = "middle of the run"


@dataclass(frozen=True)
class BesideBase:
    """How accurate a robot is at a place of its base that is called ``name``, as the sensor reads it, and in a move to
    there from the middle of the run, in the sensor's axes; NaN where no joints lead there, and for no move."""

    name: str
    sensor_mm: float
    move_mm: float


@dataclass(frozen=True, eq=False)
class Moving(Accurate):
    """A deployed robot of which it is known how far off its moves may be."""

    def move_accuracy(
        self, start: ArrayLike, end: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None
    ) -> float:
        """Radius, mm, within which the mean of many moves from ``start`` to ``end``, coordinates (k,) of a ``frame``,
        lies of the way commanded, in 95 of 100 cases.

        What turns or shifts all places alike (zeros that the drawing shares with its base, where the target sits) is in
        the accuracy of places, and not in that of a way between them. What the poses show, with what effects of the
        catalogue could do between both places that these did not show, as
        :meth:`~sherkit.robots.accuracy.Accurate.predicted_accuracies` has it. Both places are to be ruled by one part.
        Raises
        :class:`~sherkit.errors.OutOfReach`.
        """
        x = np.stack([self._place(start), self._place(end)])
        joints = self.joints_to(x, frame=frame, temperature_c=temperature_c).require("end of the move")
        return self.move_accuracy_with(joints[0], joints[1], frame=frame, temperature_c=temperature_c)

    def move_accuracy_with(
        self, start: ArrayLike, end: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None
    ) -> float:
        """:meth:`move_accuracy` from joints (j,) to joints (j,), which places alone may leave open. Raises
        :class:`~sherkit.errors.OutOfReach`."""
        where = self.frame_of(frame)
        joints = np.stack([vector(one, "joint readings", self._joints) for one in (start, end)])
        x = self.forward_batch(joints, temperature_c=temperature_c).require("end of the move")
        part: Any = self.part_at(x[0])
        now = self._now(temperature_c)
        columns = np.where(self.counted(part, where), self.by_values(part, joints, now), 0.0)
        way = (columns[1] - columns[0])[None]
        left = self.left_at(part, x) * self.grown(part, self.beyond_poses(x, joints))[:, None, None]
        known = way @ part.covariance @ way.transpose(0, 2, 1) + left.sum(axis=0)
        # of the effect that could do most to the way; what was shown at the poses is left at both ends, and counted
        functions = part.functions(x)
        missed = ((one, self.missed(part, one, functions, joints, where, now[:2])) for one in part.unobserved_effects)
        unseen = (one.beyond((ends[1] - ends[0])[None]) for one, ends in missed)
        worst = max(unseen, key=lambda spread: float(np.trace(spread[0])), default=np.zeros_like(known))
        return self.reach_mm * float(radius_95(known + worst)[0])

    def beside_base(self) -> list[BesideBase]:
        """For a robot whose places are those of its base, and whose instrument stood elsewhere, at each of
        :meth:`places`; empty for any other."""
        if self.frame != BASE or SENSOR not in self.frames:
            return []
        places, out = self.places(), []
        middle = self.to_sensor(dict(places).get(MIDDLE, places[0][1])[None])[0]
        for name, place in places:
            there = self.to_sensor(place[None])[0]
            sizes = [float("nan")] * 2
            with suppress(SherkitError):  # what is out of reach is said where accuracy is
                sizes[0] = self.accuracy(there, frame=SENSOR)
                if name != MIDDLE:
                    sizes[1] = self.move_accuracy(middle, there, frame=SENSOR)
            out.append(BesideBase(name, *sizes))
        return out
