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
#: How far from the shoulder an instrument stands at most, along each axis, mm.
_FAR_MM = 300.0


def anywhere(seed: int) -> dict[str, Any]:
    """How an instrument sees the arm that somebody has put somewhere."""
    rng = np.random.default_rng([seed, 53])
    turned, far = rng.uniform(-np.pi, np.pi, 3).tolist(), rng.uniform(-_FAR_MM, _FAR_MM, 3).tolist()
    return {"seen_turned_rad": tuple(turned), "seen_from_mm": tuple(far)}


@dataclass(frozen=True)
class VirtualPlanarArm:
    """An arm that is not as drawn.

    ``length_error_mm`` and ``offset_rad`` (2,) are its geometric errors; ``play_rad`` (2,) is the lost motion of each
    joint, ``ring_rad`` the sine that each encoder errs by and ``lines_rad`` that of its ``per_turn`` lines, ``fall_mm``
    what the tip falls at full reach, ``rate_mm_h`` (3,) how fast it drifts. ``noise_mm`` is the standard deviation of a
    reading. The instrument sees the arm turned about its x, then y, then z, and its shoulder at ``seen_from_mm``.
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
    seen_turned_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seen_from_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise_mm: float = 0.0

    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "noise_um": Option(5.0, "of a reading"),
        "fall_mm": Option(0.0, "of the tip at full reach", signed=True),
    }

    @classmethod
    def simulated(cls, robot: PlanarArm, seed: int, errors: float, sizes: Mapping[str, float]) -> VirtualPlanarArm:
        """One with geometric errors of ``errors`` times a plausible size, and the ``sizes`` of the options, read from
        anywhere."""
        a, b, c, d = (errors * np.random.default_rng(seed).normal(size=4)).tolist()
        sized = {"fall_mm": sizes["fall_mm"], "noise_mm": 1e-3 * sizes["noise_um"]}
        return cls(robot, (a, b), (0.01 * c, 0.01 * d), **sized, **anywhere(seed))

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

    def seen(self, tips: Floats) -> Floats:
        """What the instrument shows of tips (n, 3), mm."""
        frame = np.eye(4)
        frame[:3, 3] = self.seen_from_mm
        for axis in (2, 1, 0):
            turn, angle = np.eye(4), self.seen_turned_rad[axis]
            i, j = (axis + 1) % 3, (axis + 2) % 3
            turn[i, i] = turn[j, j] = np.cos(angle)
            turn[j, i], turn[i, j] = np.sin(angle), -np.sin(angle)
            frame = frame @ turn
        return np.array([(frame @ [*tip, 1.0])[:3] for tip in tips])

    def tips(self, joints_rad: ArrayLike) -> Floats:
        """Where the tip is (n, 3), mm, in the frame of the base, without time and motion."""
        joints = np.atleast_2d(np.asarray(joints_rad, dtype=float))
        return np.array([self.true_tip(q, np.zeros(2), 0.0, 20.0, False) for q in joints])

    def noise_free(self, joints_rad: ArrayLike) -> Floats:
        """What a run without noise, time and motion would hold (n, 3), mm."""
        return self.seen(self.tips(joints_rad))

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
        reading = self.seen(clean) + self.noise_mm * rng.normal(size=clean.shape)
        columns = {
            "time_s": time, "temperature_c": warmth, **said,
            **dict(zip(JOINTS, joints.T, strict=True)), **dict(zip(PLANAR.coordinates, reading.T, strict=True)),
            "direction_1": came[:, 0], "direction_2": came[:, 1],
        }  # fmt: skip
        return Measurements.from_columns(columns, "simulation", layout=PLANAR)
