"""A virtual spherical robot and the camera that looks at it: planted errors and noise.

It is the compiled robot with errors put in. What judges that, by formulas of its own, is
``tests/second_simulator/spherical.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

import sherkit._core as _core

from ...base.figures import nearest
from ...base.types import Floats
from ...data import Measurements
from ...data.toml import Table
from ...errors import OutOfReach, ShapeError
from ...model.kinds import Option, walked
from .robot import SPHERICAL_JOINTS, SPHERICAL_PIXELS, CameraView, Spherical, axes_at

#: What the paper identified on its robot, less what the drawing says (Table I): rad and mm.
PAPER_ERRORS = {"alpha": 0.7634 - 0.7854, "beta": 0.8037 - 0.7854, "radius": 22.1}
#: What joints and limbs differ by from one another.
_EACH_ITS_WAY = np.array([1.0, -0.5])
_DWELL_S = 2.0
_TRAVEL_S = 1.0


@dataclass(frozen=True)
class VirtualSpherical:
    """A spherical robot that is not as drawn, seen by a camera.

    ``errors`` are those of ``alpha`` and ``beta`` (rad) and ``radius`` (mm). ``joint_offset_rad`` (2,) is added to the
    readings, ``unequal_limbs_rad`` (2,) to the arcs of limb 1 and taken from those of limb 2, ``marker_mm`` (3,) moves
    the marker in the base frame. ``camera`` is the true one (the nominal one if left out). ``noise_px`` is the standard
    deviation of a reading; rendered pictures have their own.
    """

    robot: Spherical
    errors: Mapping[str, float] = field(default_factory=dict)
    joint_offset_rad: ArrayLike = (0.0, 0.0)
    unequal_limbs_rad: ArrayLike = (0.0, 0.0)
    marker_mm: ArrayLike = (0.0, 0.0, 0.0)
    camera: CameraView | None = None
    noise_px: float = 0.1

    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "noise_px": Option(0.1, "of a reading"),
        "joint_offset_mrad": Option(0.0, "joints that are off by this much, each its own way", signed=True),
        "unequal_limbs_mrad": Option(0.0, "limbs that differ by twice this much", signed=True),
    }

    @classmethod
    def simulated(cls, robot: Spherical, seed: int, errors: float, sizes: Mapping[str, float]) -> VirtualSpherical:
        """One with ``errors`` times the paper's, the same for every seed, and ``sizes`` of each of :attr:`OPTIONS`."""
        del seed
        offset, unequal = (1e-3 * sizes[name] * _EACH_ITS_WAY for name in ("joint_offset_mrad", "unequal_limbs_mrad"))
        return cls(robot, cls._of_paper(errors), offset, unequal, noise_px=sizes["noise_px"])

    @classmethod
    def hidden(cls, robot: Spherical, seed: int, table: Table) -> VirtualSpherical:
        """One as a laboratory describes it, without noise, in pictures that have their own.

        ``errors`` times the paper's, ``joint_offset_mrad`` and ``unequal_limbs_mrad`` (2,), ``marker_mm`` (3,).
        """
        del seed
        errors = cls._of_paper(table.number("errors", 0.0))
        both = (table.numbers(key, 2, (0.0, 0.0)) for key in ("joint_offset_mrad", "unequal_limbs_mrad"))
        offset, unequal = (1e-3 * np.array(one) for one in both)
        return cls(robot, errors, offset, unequal, table.numbers("marker_mm", 3, (0.0, 0.0, 0.0)), noise_px=0.0)

    @staticmethod
    def _of_paper(size: float) -> dict[str, float]:
        return {name: size * value for name, value in PAPER_ERRORS.items()}

    def truth(self) -> dict[str, Any]:
        """The hidden errors, for TOML: mm and rad."""
        return {
            "errors": dict(self.errors),
            "joint_offset_rad": list(np.asarray(self.joint_offset_rad, dtype=float)),
            "unequal_limbs_rad": list(np.asarray(self.unequal_limbs_rad, dtype=float)),
        }

    def __post_init__(self) -> None:
        for name in self.errors:
            if name not in PAPER_ERRORS:
                raise ShapeError(f"'{name}' is not a geometric parameter of the robot{nearest(name, PAPER_ERRORS)}")

    @property
    def eye(self) -> CameraView:
        """The camera that looks at it. Raises :class:`~sherkit.errors.SherkitError` where there is none."""
        return self.camera or self.robot.seen

    def axes(self, joints_rad: ArrayLike) -> Floats:
        """Unit vectors (n, 3) of the tool axis. Raises :class:`~sherkit.errors.OutOfReach` where limbs do not meet."""
        more, off = (np.asarray(one, dtype=float) for one in (self.unequal_limbs_rad, self.joint_offset_rad))
        longer = np.array([self.errors.get("alpha", 0.0), self.errors.get("beta", 0.0)])
        limbs = np.array([[*(longer + more), off[0]], [*(longer - more), off[1]]])
        kinematics = _core.SphericalKinematics(self.robot.geometry + limbs.ravel(), self.robot.assembly_mode)
        angles, reached = kinematics.forward_batch(np.atleast_2d(np.ascontiguousarray(joints_rad, dtype=float)))
        if not reached.all():
            row = int(np.argmax(~reached))
            raise OutOfReach(
                f"the virtual robot's limbs do not meet at row {row} of these joint readings", 0, float("nan")
            )
        return axes_at(angles)

    def markers(self, joints_rad: ArrayLike) -> Floats:
        """Places of the marker (n, 3), mm, base frame."""
        radius = self.robot.radius_mm + self.errors.get("radius", 0.0)
        return radius * self.axes(joints_rad) + np.asarray(self.marker_mm)

    def true_reading(self, joints_rad: ArrayLike) -> Floats:
        """Pixels (n, 2) that a camera without noise would give."""
        return self.eye.core.project_batch(self.markers(joints_rad))[0]

    def noise_free(self, joints_rad: ArrayLike) -> Floats:
        """What a run without noise would hold (n, 2), px: the same as :meth:`true_reading`."""
        return self.true_reading(joints_rad)

    def plan(
        self, angles_rad: ArrayLike, *, repeats: int = 5, order: str = "planes", seed: int = 0
    ) -> dict[str, Floats]:
        """Columns of a run over φ, γ (n, 2) by the nominal inverse kinematics: time, pose, repeat, joints, velocities.

        The robot stands still when it is seen. Raises :class:`~sherkit.errors.OutOfReach`, :class:`ShapeError`.
        """
        joints = self.robot.inverse_batch(np.atleast_2d(np.asarray(angles_rad, dtype=float))).require("pose")
        pose, said = walked(len(joints), repeats, order, np.random.default_rng(seed))
        return {
            "time_s": np.arange(len(pose)) * (_DWELL_S + _TRAVEL_S),
            **said,
            **{name: joints[pose, k] for k, name in enumerate(SPHERICAL_JOINTS)},
        }

    def measure(self, angles_rad: ArrayLike, *, repeats: int = 5, order: str = "planes", seed: int = 0) -> Measurements:
        """Drives to φ, γ (n, 2) and reads pixels with Gaussian noise; ``seed`` rules order and noise."""
        columns = self.plan(angles_rad, repeats=repeats, order=order, seed=seed)
        clean = self.true_reading(np.column_stack([columns[name] for name in SPHERICAL_JOINTS]))
        noise = self.noise_px * np.random.default_rng([seed, 1]).normal(size=clean.shape)
        readings = {name: (clean + noise)[:, k] for k, name in enumerate(SPHERICAL_PIXELS.coordinates)}
        return Measurements.from_columns({**columns, **readings}, "simulation", layout=SPHERICAL_PIXELS)
