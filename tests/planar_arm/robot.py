"""The planar arm as on its drawing: two links in a plane, each turned by a joint about z."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sherkit.base.types import Floats
from sherkit.data.toml import Table
from sherkit.errors import OutOfReach, ShapeError
from sherkit.model.batch import Batch, matrix, vector, why
from sherkit.model.sensor_pose import OPEN, SensorPose

ELBOWS = ("left", "right")


@dataclass(frozen=True)
class PlanarArm:
    """Nominal planar arm: lengths of its links and height of its plane in mm, angles in degrees.

    ``elbow`` says to which side of the line from shoulder to tip it bends. Joint readings are rad, the elbow's counted
    from the direction of the first link. ``home_deg`` are those about which encoder scales are counted, ``sensor_pose``
    is where the instrument stands that reads the tip: anywhere, unless it is said.
    """

    length_mm: tuple[float, float]
    height_mm: float = 0.0
    elbow: str = "left"
    home_deg: tuple[float, float] = (0.0, 0.0)
    joint_limits_deg: tuple[float, float] | None = None
    sensor_pose: SensorPose = OPEN
    kind: str = field(default="planar", init=False)

    def __post_init__(self) -> None:
        if min(self.length_mm) <= 0:
            raise ShapeError(f"length_mm: expected two positive numbers, got {self.length_mm}")

    @classmethod
    def from_table(cls, table: Table) -> PlanarArm:
        """Reads the tables of a robot file."""
        with table.table("geometry") as g:
            first, second = g.numbers("length_mm", 2, positive=True)
            height, elbow = g.number("height_mm", 0.0), g.text("elbow", ELBOWS, "left")
        with table.table("joints", optional=True) as j:
            home, limits = j.numbers("home_deg", 2, (0.0, 0.0)), j.heights("limits_deg")
        with table.table("sensor_pose", optional=True) as p:
            pose = SensorPose.from_table(p)
        return cls((first, second), height, elbow, (home[0], home[1]), limits, pose)

    def to_tables(self) -> dict[str, Any]:
        """What :meth:`from_table` reads, without loss."""
        joints: dict[str, Any] = {"home_deg": list(self.home_deg)}
        if self.joint_limits_deg is not None:
            joints["limits_deg"] = list(self.joint_limits_deg)
        geometry = {"length_mm": list(self.length_mm), "height_mm": self.height_mm, "elbow": self.elbow}
        return {"kind": self.kind, "geometry": geometry, "joints": joints, "sensor_pose": self.sensor_pose.to_table()}

    @property
    def joint_unit(self) -> str:
        """Unit of the joint readings."""
        return "rad"

    @property
    def joint_limits(self) -> tuple[float, float] | None:
        """Lowest and highest joint reading, rad."""
        if self.joint_limits_deg is None:
            return None
        low, high = np.deg2rad(self.joint_limits_deg).tolist()
        return (low, high)

    @property
    def middle(self) -> tuple[float, float]:
        """Straight ahead, the elbow at a right angle, mm."""
        return (float(np.hypot(*self.length_mm)), 0.0)

    def forward(self, joints_rad: ArrayLike) -> Floats:
        """x and y (2,) of the tip, mm."""
        shoulder, elbow = vector(joints_rad, "joint readings", 2)
        a, b = self.length_mm
        turned = shoulder + elbow
        return np.array([a * np.cos(shoulder) + b * np.cos(turned), a * np.sin(shoulder) + b * np.sin(turned)])

    def inverse(self, tip_mm: ArrayLike) -> Floats:
        """Joint readings (2,), rad, that bring the tip to x, y (2,). Raises :class:`~sherkit.errors.OutOfReach`."""
        x, y = vector(tip_mm, "x and y", 2)
        a, b = self.length_mm
        cosine = (x * x + y * y - a * a - b * b) / (2 * a * b)
        if abs(cosine) > 1:
            reach = float(np.hypot(x, y))
            raise OutOfReach(f"the tip cannot be {reach:.1f} mm from the shoulder", 0, reach - (a + b))
        elbow = np.arccos(cosine) * (1 if self.elbow == "left" else -1)
        shoulder = np.arctan2(y, x) - np.arctan2(b * np.sin(elbow), a + b * np.cos(elbow))
        return np.array([shoulder, elbow])

    def inverse_batch(self, tips_mm: ArrayLike) -> Batch:
        """Joint readings (n, 2) for rows of x, y (n, 2); those out of reach are marked."""
        x = matrix(tips_mm, "x and y", 2)
        out, reached = np.full(x.shape, np.nan), np.zeros(len(x), dtype=bool)
        for k, one in enumerate(x):
            try:
                out[k], reached[k] = self.inverse(one), True
            except OutOfReach:
                continue
        return Batch(out, reached, why(self.inverse, x, reached))
