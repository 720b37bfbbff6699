"""What was measured ends where the poses end: places and postures of a run, and what grows outside them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.types import Bools, Floats
from ..model.batch import Batch
from .deployed import Deployed
from .identified_model import IdentifiedModel
from .poses_hull import beyond


@dataclass(frozen=True, eq=False)
class WhereMeasured(Deployed):
    """A deployed robot that knows where its run measured."""

    def measured(self, coordinates: ArrayLike, *, frame: str | None = None) -> bool:
        """Whether ``coordinates`` (k,) of a ``frame`` lie where poses were measured: in the box of their places, and
        the joints that lead there (:meth:`joints_to`) in their convex hull, both give or take a tenth."""
        return bool(self.measured_batch(self._place(coordinates)[None, :], frame=frame)[0])

    def measured_batch(self, coordinates: ArrayLike, *, frame: str | None = None) -> Bools:
        """:meth:`measured` of every one of ``coordinates`` (n, k), as (n,); what is out of reach was not."""
        x = self._own(self._places(coordinates), self.frame_of(frame))
        inside = np.zeros(len(x), dtype=bool)
        for part, here in self._ruled(x):
            margin = 0.1 * (part.high - part.low)
            inside |= here & ((x >= part.low - margin) & (x <= part.high + margin)).all(axis=1)
        asked = np.flatnonzero(inside)
        if len(asked):
            there = self.joints_to(np.ascontiguousarray(x[asked]))
            inside[asked] = there.reached
            reached = np.flatnonzero(there.reached)
            inside[asked[reached]] = self.beyond_poses(x[asked[reached]], there.values[reached]) == 0.0
        return inside

    def joints_to(
        self, coordinates: Floats, *, frame: str | None = None, temperature_c: float | None = None,
        direction: ArrayLike | None = None,
    ) -> Batch:  # fmt: skip
        """Joints (n, j) with which the robot is asked how accurate it is at ``coordinates`` (n, k); where a place
        leaves them open, those nearest to what was measured. Arguments as :meth:`inverse_batch`."""
        return self.inverse_batch(coordinates, frame=frame, temperature_c=temperature_c, direction=direction)

    def beyond_poses(self, coordinates: Floats, joints: Floats) -> Floats:
        """How far outside the hull of the poses (:func:`~sherkit.robots.poses_hull.beyond`) the ``joints`` (n, j) lie
        that lead to ``coordinates`` (n, k) of :attr:`frame`: (n,), zero inside."""
        out = np.zeros(len(joints))
        for part, here in self._ruled(coordinates):
            out[here] = beyond(part.poses, joints[here])
        return out

    def grown(self, part: IdentifiedModel, far: Floats) -> Floats:
        """By what factor (n,) the covariance of what a part leaves grows so ``far`` (n,) outside the poses: there it is
        at least what regions show that were left out whole, and farther out it grows with the distance, as that of
        differences does of what has no scale of its own (a linear variogram: Matheron, Economic Geology 1963)."""
        return np.where(far > 0.0, part.elsewhere**2 * (1.0 + far), 1.0)

    def part_at(self, coordinates: Floats) -> IdentifiedModel:
        """The part that rules at ``coordinates`` (k,)."""
        del coordinates
        return self.whole

    def _ruled(self, coordinates: Floats) -> list[tuple[Any, Bools]]:
        """The parts that rule at ``coordinates`` (n, k) of :attr:`frame`, each with the rows (n,) where it does."""
        parts = [self.part_at(one) for one in coordinates]
        return [(p, np.array([one is p for one in parts])) for p in {id(one): one for one in parts}.values()]
