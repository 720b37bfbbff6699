"""A planar arm with hidden errors. Shares no formula with ``core.py``: matrices carry frame to frame, and what an
instrument shows is the last one's origin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from sherkit.base.types import Floats
from sherkit.data import Measurements
from sherkit.data.toml import Table
from sherkit.model.kinds import Option, walked

from .columns import JOINTS, PLANAR
from .robot import PlanarArm

_SECONDS_PER_POSE = 3.0
#: What the instrument shows where the drawing has its origin, mm.
_ZERO_MM = (1.5, -2.0, 4.0)


@dataclass(frozen=True)
class VirtualPlanarArm:
    """An arm that is not as drawn.

    ``length_error_mm`` and ``offset_rad`` (2,) are its geometric errors; ``play_rad`` (2,) is the lost motion of each
    joint, ``ring_rad`` the sine that each encoder errs by and ``lines_rad`` that of its ``per_turn`` lines, ``fall_mm``
    what the tip falls at full reach, ``rate_mm_h`` (3,) how fast it drifts. ``noise_mm`` is the standard deviation of a
    reading.
    """

    robot: PlanarArm
    length_error_mm: tuple[float, float] = (0.0, 0.0)
    offset_rad: tuple[float, float] = (0.0, 0.0)
    play_rad: tuple[float, float] = (0.0, 0.0)
    ring_rad: tuple[float, float] = (0.0, 0.0)
    lines_rad: tuple[float, float] = (0.0, 0.0)
    per_turn: float = 2.0
    fall_mm: float = 0.0
    rate_mm_h: tuple[float, float, float] = (0.0, 0.0, 0.0)
    warmth_per_c: float = 0.0
    step_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise_mm: float = 0.0

    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "noise_um": Option(5.0, "of a reading"),
        "fall_mm": Option(0.0, "of the tip at full reach", signed=True),
    }

    @classmethod
    def simulated(cls, robot: PlanarArm, seed: int, errors: float, sizes: Mapping[str, float]) -> VirtualPlanarArm:
        """One with geometric errors of ``errors`` times a plausible size, and the ``sizes`` of the options."""
        a, b, c, d = (errors * np.random.default_rng(seed).normal(size=4)).tolist()
        sized = {"fall_mm": sizes["fall_mm"], "noise_mm": 1e-3 * sizes["noise_um"]}
        return cls(robot, (a, b), (0.01 * c, 0.01 * d), **sized)

    @classmethod
    def hidden(cls, robot: PlanarArm, seed: int, table: Table) -> VirtualPlanarArm:
        """One without noise, as a laboratory describes it."""
        sizes = {"noise_um": 0.0, "fall_mm": table.number("fall_mm", 0.0)}
        return cls.simulated(robot, seed, table.number("errors", 0.0), sizes)

    def truth(self) -> dict[str, Any]:
        """The hidden errors, for TOML: mm and rad."""
        return {"length_error_mm": list(self.length_error_mm), "offset_rad": list(self.offset_rad),
                "fall_mm": self.fall_mm}  # fmt: skip

    def true_tip(self, joints: Floats, came: Floats, time_s: float, temperature_c: float, late: bool) -> Floats:
        """The tip (3,), mm, for readings and directions (2,) of the joints."""
        frame = np.eye(4)
        for k in range(2):
            angle = joints[k] + self.offset_rad[k] + self.ring_rad[k] * np.sin(joints[k])
            angle += self.play_rad[k] * came[k] / 2 + self.lines_rad[k] * np.sin(self.per_turn * joints[k])
            turn = np.eye(4)
            turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
            along = np.eye(4)
            along[0, 3] = self.robot.length_mm[k] + self.length_error_mm[k]
            frame = frame @ turn @ along
        tip = frame[:3, 3].copy()
        # the shoulder tilts by the moment, which grows with the reach; the tip falls by tilt times reach
        reach, span = float(np.hypot(tip[0], tip[1])), sum(self.robot.length_mm)
        tip[2] = self.robot.height_mm - self.fall_mm / span * (reach / span) * reach
        tip += tip * self.warmth_per_c * (temperature_c - 20.0) + np.array(self.rate_mm_h) * time_s / 3600.0
        return tip + (np.array(self.step_mm) if late else 0.0)

    def noise_free(self, joints_rad: ArrayLike) -> Floats:
        """What a run without noise, time and motion would hold (n, 3), mm."""
        joints = np.atleast_2d(np.asarray(joints_rad, dtype=float))
        return np.array([self.true_tip(q, np.zeros(2), 0.0, 20.0, False) for q in joints])

    def measure(self, tips_mm: ArrayLike, *, repeats: int = 3, order: str = "shuffled", seed: int = 0) -> Measurements:
        """Drives to x, y (n, 2) by the drawing and reads the tip; half way through, ``step_mm`` lets go."""
        rng = np.random.default_rng(seed)
        commanded = self.robot.inverse_batch(tips_mm).require("pose")
        pose, said = walked(len(commanded), repeats, order, rng)
        joints, time = commanded[pose], _SECONDS_PER_POSE * np.arange(len(pose))
        came = np.sign(np.diff(joints, axis=0, prepend=joints[:1] - 0.1))
        warmth = 20.0 + 3.0 * np.sin(time / time[-1] * 2.0 if len(time) > 1 else time)
        late = np.arange(len(pose)) >= len(pose) // 2
        clean = np.array(
            [self.true_tip(*row) for row in zip(joints, came, time.tolist(), warmth.tolist(), late, strict=True)]
        )
        reading = clean + np.array(_ZERO_MM) + self.noise_mm * rng.normal(size=clean.shape)
        columns = {
            "time_s": time, "temperature_c": warmth, **said,
            **dict(zip(JOINTS, joints.T, strict=True)), **dict(zip(PLANAR.coordinates, reading.T, strict=True)),
            "direction_1": came[:, 0], "direction_2": came[:, 1],
        }  # fmt: skip
        return Measurements.from_columns(columns, "simulation", layout=PLANAR)
