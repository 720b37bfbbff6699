"""The planar arm as a model for identification: lengths, offsets, where the sensor stands, and effects."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from sherkit.base.types import Floats
from sherkit.data import Measurements
from sherkit.model.chain import ChainModel
from sherkit.model.sensor_pose import POSE, TURNS

from .columns import PLANAR, TIP
from .core import CATALOGUE, PlanarCore
from .effects import PLANAR_CATALOGUE
from .robot import PlanarArm

#: Poses of each joint from which the next ones are chosen.
_GRID = 9


@dataclass(frozen=True)
class PlanarModel(ChainModel):
    """A nominal planar arm with named errors and effects to identify. Readings are x, y, z of the tip, mm."""

    robot: PlanarArm
    slip_time_s: float = 0.0
    joint_slip_time_s: float = 0.0
    thermal_shift_lag_s: float = 0.0
    sensor_slip_time_s: float = 0.0
    time_origin_s: float = 0.0
    period_rad: float | None = None

    catalogue: ClassVar = PLANAR_CATALOGUE
    layouts: ClassVar = (PLANAR,)
    table: ClassVar = CATALOGUE
    targets: ClassVar = TIP

    def lever_mm(self, name: str) -> float:
        """An offset moves what hangs on its joint, a turn of the sensor all that it sees."""
        if name in TURNS:
            return sum(self.robot.length_mm)
        return sum(self.robot.length_mm) if name == "offset_1" else self.robot.length_mm[1]

    @property
    def default(self) -> tuple[str, ...]:
        """All that a drawing gives, and what is open of the sensor's pose; the shoulder's zero is a turn of it."""
        held = {name for name in POSE if self.held_of_pose(name)}
        held |= {"offset_1"} if "sensor_turn_z" not in held else set()
        return tuple(p.name for p in self.base if p.name not in held)

    def settings(self) -> dict[str, float | None]:
        """Moments of the slips, lag of the stands, origin of time, period of the encoders."""
        times = {"slip_time_s": self.slip_time_s, "joint_slip_time_s": self.joint_slip_time_s}
        more = {"thermal_shift_lag_s": self.thermal_shift_lag_s, "time_origin_s": self.time_origin_s,
                "sensor_slip_time_s": self.sensor_slip_time_s}  # fmt: skip
        return {**times, **more, "period_rad": self.period_rad}

    @cached_property
    def core(self) -> PlanarCore:
        """The chain."""
        r = self.robot
        home = np.deg2rad(r.home_deg)
        times = (self.time_origin_s, self.slip_time_s, self.joint_slip_time_s, self.sensor_slip_time_s)
        lengths, period = np.array(r.length_mm), self.period_rad or np.pi
        return PlanarCore(lengths, r.height_mm, home, *times, period, r.sensor_pose)

    def grid(self, data: Measurements) -> Floats:
        """Places of the tip (k, 2), mm, for a grid over the joints where the run was."""
        low, high = data.joints.min(axis=0), data.joints.max(axis=0)
        ticks = np.meshgrid(*np.linspace(low, high, _GRID).T, indexing="ij")
        return np.array([self.robot.forward(q) for q in np.stack(ticks, axis=-1).reshape(-1, 2)])

    def reason(self, data: Measurements, row: int, values: Floats) -> str:
        """Joints reach everywhere: it is a column."""
        del data, row, values
        return "an effect that is at work needs a column that these rows lack"
