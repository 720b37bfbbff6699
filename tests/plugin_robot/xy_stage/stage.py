"""The stage as drawn: two axes at a right angle, each from the middle of its travel, mm."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from sherkit.base.types import Floats
from sherkit.data.declared import Declared, Inner, key
from sherkit.data.toml import Table
from sherkit.errors import OutOfReach, ShapeError
from sherkit.model.batch import Batch, matrix, vector, why
from sherkit.model.sensor_pose import OPEN, SensorPose


@dataclass(frozen=True)
class XYStage(Declared):
    """``travel_mm`` (2,) of its axes. The table is where its scales say: x is the first axis, y the second.
    ``sensor_pose`` is where the interferometer stands that reads it."""

    travel_mm: tuple[float, float]
    sensor_pose: SensorPose = OPEN
    kind: str = field(default="xy_stage", init=False)

    TABLES: ClassVar = {
        "geometry": {"travel_mm": key(Table.numbers, 2, positive=True)},
        "sensor_pose": Inner(SensorPose, "sensor_pose"),
    }

    def __post_init__(self) -> None:
        if min(self.travel_mm) <= 0:
            raise ShapeError(f"travel_mm: expected two positive numbers, got {self.travel_mm}")

    @property
    def joint_unit(self) -> str:
        """Unit of the scales."""
        return "mm"

    @property
    def joint_limits(self) -> tuple[float, float]:
        """Of the longer axis; the shorter one is refused by :meth:`inverse`."""
        return (-0.5 * max(self.travel_mm), 0.5 * max(self.travel_mm))

    @property
    def middle(self) -> tuple[float, float]:
        """Both axes in the middle of their travel."""
        return (0.0, 0.0)

    def forward(self, joints: ArrayLike) -> Floats:
        """x and y (2,) for the scales (2,), mm."""
        return vector(joints, "joint readings", 2).copy()

    def inverse(self, place: ArrayLike) -> Floats:
        """Scales (2,) for x and y (2,), mm. Raises :class:`~sherkit.errors.OutOfReach`."""
        wanted = vector(place, "x and y", 2)
        for k, (value, travel) in enumerate(zip(wanted, self.travel_mm, strict=True)):
            if abs(value) > 0.5 * travel:
                raise OutOfReach(f"axis {k + 1} goes to ±{0.5 * travel:g} mm, not to {value:g}", k, abs(value))
        return wanted.copy()

    def inverse_batch(self, places: ArrayLike) -> Batch:
        """Scales (n, 2) for rows of x and y (n, 2); those out of reach are marked."""
        wanted = matrix(places, "x and y", 2)
        reached = (np.abs(wanted) <= 0.5 * np.array(self.travel_mm)).all(axis=1)
        return Batch(np.where(reached[:, None], wanted, np.nan), reached, why(self.inverse, wanted, reached))


def grid(stage: XYStage, per_side: int = 9, share: float = 0.95) -> Floats:
    """Places (n, 2), mm: a grid over a share of the travel."""
    x, y = (0.5 * share * travel * np.linspace(-1.0, 1.0, per_side) for travel in stage.travel_mm)
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


def grid_of_plan(stage: XYStage, table: Table) -> Floats:
    """As a plan asks for it."""
    return grid(stage, table.whole("per_side", least=2))
