"""A virtual delta: planted errors, noise, and the paper's experiments.

Written apart from the core on purpose: positions come from Newton's method on the rod lengths in NumPy, never
from the code that is to be tested with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ...base import linalg
from ...base.figures import nearest
from ...base.types import Floats
from ...data import Measurements
from ...data.toml import Table
from ...errors import NotFinite, OutOfReach, ShapeError, Singular
from ...model.kinds import Option, walked
from .robot import Delta

#: Root mean squares of the columns of the paper's Table II (whole workspace), mm and rad.
TABLE_II_SIZES = {
    "base_radius": 3.67,
    "base_angle": float(np.deg2rad(0.80)),
    "joint_offset": 1.13,
    "rod_length": 2.15,
}
_DWELL_S = 2.0
_TRAVEL_S = 1.0
_OUT_OF_REACH = "the virtual robot cannot reach one of these joint readings"


@dataclass(frozen=True)
class VirtualDelta:
    """A delta that is not as drawn.

    ``errors`` are geometric errors by name (``rod_length_1`` …, mm and rad). ``rail_lean_rad`` (3, 2) leans each
    rail radially and tangentially, ``beam_matrix`` (3, 3) is what the sensors add to the position per mm: the
    paper's own suspects for what its model leaves. ``noise_mm`` is the standard deviation of a reading.
    """

    robot: Delta
    errors: Mapping[str, float] = field(default_factory=dict)
    rail_lean_rad: ArrayLike = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
    beam_matrix: ArrayLike = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    noise_mm: float | tuple[float, float, float] = 0.0

    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "noise_um": Option(5.0, "of a reading"),
        "rail_lean_mrad": Option(0.0, "rails that lean by this much"),
        "beam_mrad": Option(0.0, "laser beams that are not square"),
    }

    def __post_init__(self) -> None:
        names = self.robot.parameter_names
        for name in self.errors:
            if name not in names:
                raise ShapeError(f"'{name}' is not a geometric parameter of a delta{nearest(name, names)}")

    @classmethod
    def draw(
        cls,
        robot: Delta,
        seed: int,
        *,
        sizes: Mapping[str, float] = TABLE_II_SIZES,
        rail_lean_rad: float = 0.0,
        beam: float = 0.0,
        noise_mm: float | tuple[float, float, float] = 0.005,
    ) -> VirtualDelta:
        """Gaussian errors of the given sizes on the paper's twelve parameters, lean and beam errors beside them."""
        rng = np.random.default_rng(seed)
        errors = {f"{group}_{limb}": float(size * rng.normal()) for group, size in sizes.items() for limb in (1, 2, 3)}
        lean = rail_lean_rad * rng.normal(size=(3, 2))
        return cls(robot, errors, lean, beam * rng.normal(size=(3, 3)), noise_mm)

    @classmethod
    def simulated(cls, robot: Delta, seed: int, errors: float, sizes: Mapping[str, float]) -> VirtualDelta:
        """One with errors of ``errors`` times the sizes of Table II, and ``sizes`` of each of :attr:`OPTIONS`."""
        return cls.draw(
            robot,
            seed,
            sizes={name: errors * size for name, size in TABLE_II_SIZES.items()},
            rail_lean_rad=1e-3 * sizes["rail_lean_mrad"],
            beam=1e-3 * sizes["beam_mrad"],
            noise_mm=1e-3 * sizes["noise_um"],
        )

    @classmethod
    def hidden(cls, robot: Delta, seed: int, table: Table) -> VirtualDelta:
        """One as a laboratory describes it, without noise: ``errors``, ``rail_lean_mrad``, ``beam_mrad``."""
        errors = table.number("errors", 0.0)
        leaning = {name: table.number(name, 0.0) for name in ("rail_lean_mrad", "beam_mrad")}
        return cls.simulated(robot, seed, errors, {"noise_um": 0.0, **leaning})

    def truth(self) -> dict[str, Any]:
        """The hidden errors, for TOML: mm and rad."""
        return {
            "errors": dict(self.errors),
            "rail_lean_rad": np.asarray(self.rail_lean_rad, dtype=float).tolist(),
            "beam_matrix": np.asarray(self.beam_matrix, dtype=float).tolist(),
        }

    def true_reading(self, joints_mm: ArrayLike) -> Floats:
        """What noise-free sensors would show (n, 3), mm, for joint readings (n, 3).

        Raises :class:`~sherkit.errors.OutOfReach` where Newton finds no position.
        """
        q = np.atleast_2d(np.asarray(joints_mm, dtype=float))
        off = np.array([self.errors.get(name, 0.0) for name in self.robot.parameter_names])
        radius, angle, zero, rods, joint, at = (self.robot.geometry + off).reshape(3, -1).T
        flat, lean = np.zeros(3), np.asarray(self.rail_lean_rad, dtype=float)
        out = np.column_stack([np.cos(angle), np.sin(angle), flat])
        along = np.column_stack([-np.sin(angle), np.cos(angle), flat])
        rails = np.array([0.0, 0.0, 1.0]) + lean[:, :1] * out + lean[:, 1:] * along
        rails /= np.linalg.norm(rails, axis=1, keepdims=True)
        carriages = radius[:, None] * out + (q + zero)[:, :, None] * rails
        joints = joint[:, None] * np.column_stack([np.cos(at), np.sin(at), flat])
        x = self._newton(carriages, joints, rods)
        x = x + np.array(self.robot.target_offset_mm)
        return x + x @ np.asarray(self.beam_matrix, dtype=float).T

    def _newton(self, carriages: Floats, joints: Floats, rods: Floats) -> Floats:
        side = 1.0 if self.robot.assembly_mode == "below" else -1.0
        x = carriages.mean(axis=1) - joints.mean(axis=0)
        x[:, 2] -= side * 0.9 * rods.mean()
        for _ in range(50):
            rod = x[:, None, :] + joints - carriages
            miss = (rod**2).sum(axis=2) - rods**2
            try:
                step = linalg.solve(2 * rod, -miss[:, :, None])[:, :, 0]
            except (NotFinite, Singular) as error:
                raise OutOfReach(_OUT_OF_REACH, 0, float("nan")) from error
            x = x + step
            if np.abs(step).max() < 1e-12:
                break
        else:
            raise OutOfReach(_OUT_OF_REACH, 0, float("nan"))
        return x

    @cached_property
    def _home(self) -> Floats:
        return self.true_reading(self.robot.inverse([0.0, 0.0, 0.0]))

    def noise_free(self, joints_mm: ArrayLike) -> Floats:
        """What lasers without noise, zeroed at home, would show (n, 3), mm. Raises as :meth:`true_reading`."""
        return self.true_reading(joints_mm) - self._home

    def measure(self, poses_mm: ArrayLike, *, repeats: int = 5, order: str = "planes", seed: int = 0) -> Measurements:
        """Drives to poses (n, 3), mm, by the nominal inverse kinematics and reads three lasers at each.

        Readings are differences from the home position, as in the paper. ``order`` as
        :func:`~sherkit.model.kinds.walked`; ``seed`` rules order and noise.
        """
        rng = np.random.default_rng(seed)
        poses = np.atleast_2d(np.asarray(poses_mm, dtype=float))
        commanded = self.robot.inverse_batch(poses).require("pose")
        pose, said = walked(len(poses), repeats, order, rng)
        joints = commanded[pose]
        clean = self.noise_free(joints)
        reading = clean + rng.normal(size=clean.shape) * np.asarray(self.noise_mm)
        columns = {
            "time_s": np.arange(len(pose)) * (_DWELL_S + _TRAVEL_S),
            **said,
            **{f"q{k + 1}_mm": joints[:, k] for k in range(3)},
            **{f"{a}_mm": reading[:, k] for k, a in enumerate("xyz")},
        }
        return Measurements.from_columns(columns, "simulation")
