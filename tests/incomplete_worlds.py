"""Machines that do not change and of which the model lacks something: what all runs miss is nobody's change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from changed_worlds import DeltaPair
from sherkit.model.kinds import robot_from_tables

Floats = NDArray[np.float64]

#: A small six-axis arm (modified Denavit and Hartenberg): lengths mm, angles deg.
_D, _A, _ALPHA = (135.0, 0, 0, 120, 0, 70), (0, 0, 135, 38, 0, 0), (0, -90, 0, -90, 90, -90)
_THETA, _TOOL = (0, -90, 0, 0, 0, 180), (-88.4, -0.5, 61.0)
_ORIGINS = ((0, 0, 135), (0, 0, 0), (135, 0, 0), (38, 120, 0), (0, 0, 0), (0, 70, 0))
_TURNS = ((0, 0, 0), (-45, -90, -45), (0, 0, 0), (-90, 0, 0), (90, 0, 0), (90, 0, 180))
_MIDDLE = {"right": (-100, 50, 0, -100, -90, 0), "left": (92, 40, 0, 110, -80, 0)}
_HALF = (22, 22, 25, 25, 18, 88)


def small_arm() -> Any:
    """The drawing of the arm before a tracker."""
    return robot_from_tables(
        {
            "kind": "serial",
            "tool": {"target_mm": list(_TOOL), "rpy_deg": [0.0, 0.0, 0.0]},
            "base": {"gravity": [0.0, 0.0, -1.0]},
            "tracker": {"origin_mm": [0.0, 0.0, 0.0], "rpy_deg": [0.0, 0.0, 0.0]},
            "joint": [
                {"name": f"joint_{k}", "type": "revolute", "origin_mm": [float(x) for x in origin],
                 "rpy_deg": [float(x) for x in turn], "axis": [0.0, 0.0, 1.0]}
                for k, (origin, turn) in enumerate(zip(_ORIGINS, _TURNS, strict=True), 1)
            ],
        },
        "small arm",
    )  # fmt: skip


class GearErrors:
    """The arm with a fixed gear error of harmonics 3 to 9 in each joint (0.3 mrad), which no effect is."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.size = self.rng.normal(0, 3e-4 / np.sqrt(7), (6, 7))
        self.phase = self.rng.uniform(0, 2 * np.pi, (6, 7))
        self.zero = self.rng.normal(0, 2e-3, 6)

    def at(self, q: Floats) -> Floats:
        """Where the target is (3,), mm."""
        pose = np.eye(4)
        for k in range(6):
            wave = np.sum(self.size[k] * np.sin(np.arange(3, 10) * q[k] + self.phase[k]))
            t, alpha = q[k] + np.deg2rad(_THETA[k]) + self.zero[k] + wave, np.deg2rad(_ALPHA[k])
            c, s, ca, sa = np.cos(t), np.sin(t), np.cos(alpha), np.sin(alpha)
            pose = pose @ np.array([[c, -s, 0, _A[k]], [s * ca, c * ca, -sa, -sa * _D[k]],
                                    [s * sa, c * sa, ca, ca * _D[k]], [0, 0, 0, 1]])  # fmt: skip
        return np.asarray((pose @ [*_TOOL, 1])[:3])

    def postures(self, side: str, count: int = 92) -> Floats:
        """Joint angles (n, 6), rad, on one side of the table."""
        return np.asarray(np.deg2rad(np.array(_MIDDLE[side]) + self.rng.uniform(-1, 1, (count, 6)) * np.array(_HALF)))

    def run(self, postures: Floats, moved: Mapping[int, float] | None = None, reads: int = 3) -> dict[str, Any]:
        """Each posture read several times; ``moved`` adds to the zeros of joints (rad)."""
        by = np.zeros(6)
        for joint, value in (moved or {}).items():
            by[joint] = value
        where = np.repeat(np.array([self.at(q + by) for q in postures]), reads, axis=0)
        read, q = where + self.rng.normal(0, 1e-3, where.shape), np.repeat(postures, reads, axis=0)
        out: dict[str, Any] = {"pose": np.repeat(np.arange(1, len(postures) + 1), reads)}
        out |= {f"joint_{k + 1}_rad": q[:, k] for k in range(6)}
        return out | {f"{axis}_mm": read[:, k] for k, axis in enumerate("xyz")}


class RippledDelta(DeltaPair):
    """A pair of runs of one delta that lies off, in both alike, by a ripple over the joints which no effect is."""

    def __init__(
        self, seed: int, changed: tuple[str, ...] = (), ratio: float = 4.0, places: Sequence[Mapping[str, float]] = ()
    ) -> None:
        super().__init__(seed, changed, ratio, stationed=False, places=places)
        for run in self.runs:
            q = np.stack([run[f"q{k}_mm"] for k in (1, 2, 3)])
            run["z_mm"] = run["z_mm"] + 0.012 * np.sin((q[0] - q[1]) / 6.0)
