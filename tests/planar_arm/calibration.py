"""The calibrated planar arm: where its tip is in its plane, how to bring it there, and how well."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from sherkit.base.types import Bools, Floats
from sherkit.errors import NotConverged
from sherkit.model.chain import Block
from sherkit.model.sensor_pose import SensorPose
from sherkit.robots.accuracy import Planes
from sherkit.robots.calibrated import Calibration
from sherkit.robots.calibration_run import CalibrationRun
from sherkit.robots.identified_model import IdentifiedModel

from .columns import TIP
from .core import PlanarCore
from .robot import PlanarArm

_ROUNDS = 6


@dataclass(frozen=True)
class PlanarCalibrated:
    """What a binding of the control loop's model would be: forward and inverse for ``values`` of the chain."""

    chain: PlanarCore
    values: Floats
    nominal: PlanarArm

    def block(self, joints: Floats, now: list[float]) -> Block:
        """Rows that all have the covariates of this moment."""
        known = np.concatenate([now, [0.0, 0.0]])
        return joints, None, np.tile(known, (len(joints), 1)), None

    def forward_batch(self, joints: Floats, now: list[float]) -> tuple[Floats, Floats, Bools]:
        """x, y (n, 2), their derivatives by the joints (n, 2, 2), and which rows could be computed."""
        block = self.block(joints, now)
        values, reached = self.chain.predict(self.values, block)
        return values[:, :2], self.chain.derivatives(self.values, block, [])[1][:, :2], reached

    def forward(self, joints: Floats, now: list[float]) -> tuple[Floats, Floats]:
        """The same of one pose."""
        values, by_joints, _ = self.forward_batch(joints[None, :], now)
        return values[0], by_joints[0]

    def inverse(self, tip: Floats, now: list[float]) -> Floats:
        """Joint readings for x, y. Raises as :meth:`PlanarArm.inverse`."""
        self.nominal.inverse(tip)
        joints, reached = self.inverse_batch(tip[None, :], now)
        if not reached[0]:
            raise NotConverged("the inverse kinematics does not settle there")
        return joints[0]

    def inverse_batch(self, tips: Floats, now: list[float]) -> tuple[Floats, Bools]:
        """Joint readings of rows, by Newton's method from the drawing's; those out of reach are marked."""
        joints = self.nominal.inverse_batch(tips).values
        still = np.zeros(len(tips), dtype=bool)
        for _ in range(_ROUNDS):
            with np.errstate(invalid="ignore", divide="ignore"):
                value, by_joints, _ = self.forward_batch(joints, now)
                step = np.linalg.solve(by_joints, (tips - value)[:, :, None])[:, :, 0]
            # what runs away is out of reach
            joints = np.where(np.abs(step) < np.pi, joints + step, np.nan)
            still = (np.abs(step) < 1e-12).all(axis=1)
        return np.where(still[:, None], joints, np.nan), still


@dataclass(frozen=True, eq=False, repr=False)
class PlanarCalibration(Calibration):
    """A calibrated planar arm. Coordinates are x and y of the tip from the shoulder, mm, in the axes of the base: where
    the instrument stood is not the arm's, and is left out, as is what else the instrument shows."""

    coordinates: ClassVar = TIP
    called: ClassVar = ("x and y", "places")

    robot: PlanarArm
    whole: IdentifiedModel

    @classmethod
    def of(cls, whole: CalibrationRun, local: CalibrationRun | None = None) -> Self:
        """From a run; there is no local one."""
        del local
        fit = whole.fit
        use = fit.data.taken[:, :2].all(axis=1) & ~fit.data.outlier
        where = fit.model.place(fit.data, fit.predicted, fit.values)
        turn, _ = fit.model.sensor_frame(fit.values)
        left, scatter = whole.left(
            lambda missed: (np.nan_to_num(missed[use]) @ turn)[:, :2], whole.deployed(whole.held_out)
        )
        seen = np.column_stack([where[name][use] for name in TIP])
        return cls(fit.model.robot, IdentifiedModel.identified(fit, 2).leaving(left, scatter, seen))

    @cached_property
    def core(self) -> PlanarCalibrated:
        """The model of the control loop: read from the base, by an instrument without errors."""
        model = replace(self.model, robot=replace(self.robot, sensor_pose=SensorPose()))
        arms = np.array([p.name not in model.of_sensor for p in model.core_parameters])
        return PlanarCalibrated(model.core, np.where(arms, model.full(self.whole.values), 0.0), self.robot)

    def counted(self, part: IdentifiedModel, frame: str) -> Bools:
        """Nothing that is the instrument's."""
        ours = [p.name not in self.model.of_sensor for p in self.model.parameters[: len(part.values)]]
        return super().counted(part, frame) & np.array(ours, dtype=bool)

    def carried(self, joints: Floats, by_joints: Floats, missed: Floats) -> Floats:
        """In the axes of the base."""
        del joints, by_joints
        turn, _ = self.model.sensor_frame(self.whole.values)
        return (turn.T @ missed)[:, :2]

    def by_values(self, part: IdentifiedModel, joints: Floats, now: list[float]) -> Floats:
        """Of x and y (n, 2, p)."""
        del part
        block = self.core.block(joints, now)
        return self.core.chain.derivatives(self.core.values, block, self.model.indices)[0][:, :2]

    def places(self) -> list[tuple[str, Floats]]:
        """The middle of the run and its far side, x and y, mm."""
        middle = 0.5 * (self.whole.low + self.whole.high)
        return [("middle of the run", middle), ("its far side", np.array([self.whole.high[0], middle[1]]))]

    def planes(self, per_side: int) -> Planes:
        """The plane, where the run measured."""
        x, y = (np.linspace(a, b, per_side) for a, b in zip(self.whole.low, self.whole.high, strict=True))
        grid = np.stack(np.meshgrid(y, x, indexing="ij"), axis=-1).reshape(-1, 2)[:, ::-1]
        return Planes(x, y, ("x, mm", "y, mm"), ("the arm's plane",), grid, np.ones(len(grid), dtype=bool))
