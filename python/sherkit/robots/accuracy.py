"""How well a calibrated robot goes where it is sent: the radius that holds it in 95 of 100 cases, and where to ask."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..fit.coverage import radius_95
from ..model.batch import Batch
from ..types import Bools, Floats
from .deployed import Deployed
from .part import Part

#: Accuracy that subretinal injection needs, µm (Xiao et al., ISMR 2022).
REQUIREMENT_UM = 20.0


@dataclass(frozen=True, eq=False)
class Planes:
    """Planes of the workspace to draw a quantity on: ``x`` (nx,) and ``y`` (ny,) in the units of ``labels``.

    ``grid`` (planes · ny · nx, k) are their points in coordinates, plane by plane and row by row, of which ``inside``
    (planes · ny · nx,) belong to the workspace; ``titles`` are those of the planes.
    """

    x: Floats
    y: Floats
    labels: tuple[str, str]
    titles: tuple[str, ...]
    grid: Floats
    inside: Bools


@dataclass(frozen=True, eq=False)
class Accurate(Deployed):
    """A deployed robot of which it is known how far off it may be."""

    @abstractmethod
    def spread(self, coordinates: Floats, joints: Floats) -> Floats:
        """Covariance (n, d, d) of where the robot really is when sent to ``coordinates`` (n, k) by ``joints`` (n, j).

        Parameter covariance carried there, plus that of held-out residuals. In units of which one makes
        :attr:`reach_mm` at the tool.
        """

    @abstractmethod
    def places(self) -> list[tuple[str, Floats]]:
        """Coordinates (k,) for which a person would ask how accurate the robot is, with their names."""

    @abstractmethod
    def planes(self, per_side: int) -> Planes:
        """Planes of the workspace, or of what was measured, with ``per_side`` points along each side."""

    @property
    def reach_mm(self) -> float:
        """How far one unit of the coordinates moves the tool, mm."""
        return 1.0

    def accuracy(self, coordinates: ArrayLike) -> float:
        """Radius, mm, within which the robot is predicted to be of ``coordinates`` (k,) in 95 of 100 cases.

        Parameter covariance carried to the place, plus the covariance of held-out residuals (noise and what the model
        leaves). Where no pose was measured (:meth:`measured`) this is extrapolation and holds only as far as the model
        does. The radius of a Gaussian by matching two moments of its squared length (Satterthwaite). Raises as
        :meth:`inverse`.
        """
        x = self._place(coordinates)
        self.inverse(x)  # says why where it cannot be reached
        return float(self.accuracy_batch(x[None, :]).require(self.called[0])[0])

    def accuracy_batch(self, coordinates: ArrayLike) -> Batch:
        """:meth:`accuracy` at every one of ``coordinates`` (n, k): values (n,), mm; those out of reach are marked."""
        x = self._places(coordinates)
        joints = self.inverse_batch(x)
        out = np.full(len(x), np.nan)
        rows = np.flatnonzero(joints.reached)
        out[rows] = self.reach_mm * radius_95(self.spread(x[rows], np.ascontiguousarray(joints.values[rows])))
        return Batch(out, joints.reached, joints.why)

    def measured(self, coordinates: ArrayLike) -> bool:
        """Whether ``coordinates`` (k,) lie in the box in which poses were measured, give or take a tenth."""
        x = self._place(coordinates)
        part = self.part_at(x)
        margin = 0.1 * (part.high - part.low)
        return bool(((x >= part.low - margin) & (x <= part.high + margin)).all())

    def part_at(self, coordinates: Floats) -> Part:
        """The part that rules at ``coordinates`` (k,)."""
        del coordinates
        return self.whole
