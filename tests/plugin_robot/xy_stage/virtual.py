"""A stage with hidden errors, written from the machine and not from the model: a table on a slide on a base, each a
frame of its own that a guide turns and shifts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from sherkit.base.types import Floats
from sherkit.data import Measurements
from sherkit.data.toml import Table
from sherkit.model.kinds import Option

from .model import XY
from .stage import XYStage

_SECONDS_PER_POSE = 4.0
#: How far the interferometer stands from the stage at most, along each axis, mm.
_FAR_MM = 300.0


@dataclass(frozen=True)
class VirtualXYStage:
    """``lean_rad`` is how far the second axis leans from the right angle, ``seen_turned_rad`` and ``seen_from_mm`` how
    the interferometer stands, ``bow_mm`` how far the first guide leads off in its middle, ``lost_mm`` (2,) the lost
    motion of each axis."""

    robot: XYStage
    lean_rad: float = 0.0
    seen_turned_rad: float = 0.0
    seen_from_mm: tuple[float, float] = (0.0, 0.0)
    bow_mm: float = 0.0
    lost_mm: tuple[float, float] = (0.0, 0.0)
    noise_mm: float = 0.0

    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "noise_um": Option(1.0, "of a reading"),
        "bow_um": Option(0.0, "of the first guide", signed=True),
    }

    @classmethod
    def simulated(cls, robot: XYStage, seed: int, errors: float, sizes: Mapping[str, float]) -> VirtualXYStage:
        """One with geometric errors of ``errors`` times a plausible size, and the ``sizes`` of the options; the
        interferometer stands anywhere."""
        rng = np.random.default_rng(seed)
        lean, turned = 1e-3 * errors * float(rng.normal()), float(rng.uniform(-np.pi, np.pi))
        x, y = rng.uniform(-_FAR_MM, _FAR_MM, 2).tolist()
        return cls(robot, lean, turned, (x, y), 1e-3 * sizes["bow_um"], noise_mm=1e-3 * sizes["noise_um"])

    @classmethod
    def hidden(cls, robot: XYStage, seed: int, table: Table) -> VirtualXYStage:
        """One without noise, as a laboratory describes it."""
        sizes = {"noise_um": 0.0, "bow_um": table.number("bow_um", 0.0)}
        return cls.simulated(robot, seed, table.number("errors", 0.0), sizes)

    def truth(self) -> dict[str, Any]:
        """The hidden errors, for TOML."""
        return {"lean_rad": self.lean_rad, "seen_turned_rad": self.seen_turned_rad, "bow_mm": self.bow_mm}

    def _seen(self, joints: Floats, came: Floats) -> Floats:
        frame = np.eye(3)
        turned = np.eye(3)
        turned[:2, :2] = [[np.cos(self.seen_turned_rad), -np.sin(self.seen_turned_rad)],
                          [np.sin(self.seen_turned_rad), np.cos(self.seen_turned_rad)]]  # fmt: skip
        turned[:2, 2] = self.seen_from_mm
        moved = joints + 0.5 * np.array(self.lost_mm) * came
        slide = np.eye(3)
        slide[:2, 2] = [moved[0], self.bow_mm * (1.0 - (2.0 * moved[0] / self.robot.travel_mm[0]) ** 2)]
        table = np.eye(3)
        table[:2, 2] = moved[1] * np.array([-np.tan(self.lean_rad), 1.0])
        return np.asarray((turned @ frame @ slide @ table)[:2, 2])

    def noise_free(self, joints: ArrayLike) -> Floats:
        """What a run without noise and motion would hold (n, 2), mm."""
        rows = np.atleast_2d(np.asarray(joints, dtype=float))
        return np.array([self._seen(q, np.zeros(2)) for q in rows])

    def measure(
        self, coordinates: ArrayLike, *, repeats: int = 3, order: str = "shuffled", seed: int = 0
    ) -> Measurements:
        """Drives to x, y (n, 2) by the drawing and reads the table."""
        rng = np.random.default_rng(seed)
        commanded = self.robot.inverse_batch(coordinates).require("pose")
        walk = np.arange(len(commanded))
        pose = np.concatenate([rng.permutation(walk) if order == "shuffled" else walk for _ in range(repeats)])
        joints = commanded[pose]
        came = np.sign(np.diff(joints, axis=0, prepend=joints[:1] - 0.1))
        clean = np.array([self._seen(*row) for row in zip(joints, came, strict=True)])
        seen = clean + self.noise_mm * rng.normal(size=clean.shape)
        columns = {
            "time_s": _SECONDS_PER_POSE * np.arange(len(pose)), "pose": pose + 1,
            "repeat": np.repeat(np.arange(repeats), len(walk)) + 1,
            "axis_1_mm": joints[:, 0], "axis_2_mm": joints[:, 1], "x_mm": seen[:, 0], "y_mm": seen[:, 1],
            "direction_1": came[:, 0], "direction_2": came[:, 1],
        }  # fmt: skip
        return Measurements.from_columns(columns, "simulation", layout=XY)
