"""The spherical parallel robot: two limbs on one actuated axis, all axes through a remote centre; seen by a camera.

Source: Agand, Taghirad, Molaei, "Vision-Based Kinematic Calibration of Spherical Robots" (DIAMOND). The nominal
geometry is the user's. Frame: origin at the remote centre of motion, z along the actuated axis; φ counted about z,
γ from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

import sherkit._core as _core

from ...base.notebook import Shown
from ...base.saved import Saved
from ...base.types import Floats
from ...data.columns import Layout
from ...data.declared import Declared, Inner, key
from ...data.toml import Table
from ...errors import RobotError, ShapeError, SherkitError
from ...model.batch import Batch, matrix, vector, why
from .camera import CameraView

# -- The columns of a run -----------------------------------------------------------------------------------------

SPHERICAL_JOINTS = ("theta1_rad", "theta2_rad")
_VELOCITIES = ("theta1_rad_per_s", "theta2_rad_per_s")

SPHERICAL_PIXELS = Layout(SPHERICAL_JOINTS, ("u_px", "v_px"), "px", 1.0, velocities=_VELOCITIES)
SPHERICAL_ANGLES = Layout(SPHERICAL_JOINTS, ("phi_rad", "gamma_rad"), "mrad", 1e3, velocities=_VELOCITIES)


# -- The robot ----------------------------------------------------------------------------------------------------

Pair = tuple[float, float]
Triple = tuple[float, float, float]

ASSEMBLY_MODES = ("outer", "inner")
WORKING_MODES = ("open", "crossed", "ahead", "behind")


@dataclass(frozen=True)
class Spherical(Declared, Saved, Shown):
    """Nominal spherical robot. Angles in degrees as on a drawing, lengths in mm.

    ``alpha_deg`` and ``beta_deg`` are the arcs of the proximal and distal links, ``radius_mm`` the distance of the
    marker from the centre. ``assembly_mode`` is ``"outer"`` or ``"inner"`` (the sign of the root of Eq. 35),
    ``working_mode`` tells on which side of the tool each elbow is (``"open"``: joint 1 ahead, joint 2 behind).
    ``gravity`` is the direction of the weight, ``home_deg`` the joint readings about which encoder scales are counted.
    ``phi_deg`` and ``gamma_deg`` are the limits of the workspace, ``joint_limits_deg`` (low, high) those that no motor
    may leave, ``required_um`` the accuracy that it is for. Joint readings are angles about z.
    """

    alpha_deg: float
    beta_deg: float
    radius_mm: float
    camera: CameraView | None = None
    assembly_mode: str = "outer"
    working_mode: str = "open"
    gravity: Triple = (0.0, 0.0, -1.0)
    home_deg: Pair = (0.0, 0.0)
    phi_deg: Pair | None = None
    gamma_deg: Pair | None = None
    joint_limits_deg: Pair | None = None
    required_um: float | None = None
    kind: str = field(default="spherical", init=False)

    TABLES: ClassVar = {
        "geometry": {
            "alpha_deg": key(Table.number, positive=True),
            "beta_deg": key(Table.number, positive=True),
            "radius_mm": key(Table.number, positive=True),
            "assembly_mode": key(Table.text, ASSEMBLY_MODES),
            "working_mode": key(Table.text, WORKING_MODES),
            "gravity": key(Table.numbers, 3),
        },
        "joints": {"home_deg": key(Table.numbers, 2), "limits_deg": key(Table.heights).of("joint_limits_deg")},
        "workspace": {
            "phi_deg": key(Table.heights),
            "gamma_deg": key(Table.heights),
            "required_um": key(Table.positive),
        },
        "camera": Inner(CameraView, "camera"),
    }

    @classmethod
    def check(cls, name: str, table: Table, values: Mapping[str, Any]) -> None:
        """Refuses arcs that make no robot."""
        if name != "geometry":
            return
        for arc in ("alpha_deg", "beta_deg"):
            if values[arc] >= 180.0:
                raise table.fail(arc, "an arc of less than 180 degrees")
        if values["alpha_deg"] + values["beta_deg"] > 180.0:
            raise table.fail("beta_deg", "arcs that together make no more than 180 degrees")
        if not np.any(values["gravity"]):
            raise table.fail("gravity", "a direction, not zero")

    def __post_init__(self) -> None:
        self.kinematics()  # refuses a geometry that is no robot
        if self.radius_mm <= 0 or not np.isfinite(self.radius_mm):
            raise ShapeError(f"radius_mm: expected a positive number, got {self.radius_mm}")
        if self.working_mode not in WORKING_MODES:
            raise ShapeError(f"working_mode: '{self.working_mode}' is not known; choose {', '.join(WORKING_MODES)}")

    # -- kinematics --------------------------------------------------------------------------------------

    @property
    def joint_unit(self) -> str:
        """Unit of the joint readings."""
        return "rad"

    @property
    def joint_limits(self) -> Pair | None:
        """Lowest and highest joint reading, rad, to which a motor may go; None where the file names none."""
        if self.joint_limits_deg is None:
            return None
        low, high = self.joint_limits_deg
        return (float(np.deg2rad(low)), float(np.deg2rad(high)))

    @property
    def middle(self) -> Pair:
        """The middle of the workspace, φ and γ, rad. Raises :class:`~sherkit.errors.RobotError` without limits."""
        if self.phi_deg is None or self.gamma_deg is None:
            raise RobotError("the robot file needs [workspace] phi_deg and gamma_deg: that is where it may be sent")
        phi, gamma = np.deg2rad([np.mean(self.phi_deg), np.mean(self.gamma_deg)]).tolist()
        return (phi, gamma)

    @cached_property
    def geometry(self) -> Floats:
        """The six geometric parameters of the core: α, β and joint offset of each limb, rad."""
        limb = [np.deg2rad(self.alpha_deg), np.deg2rad(self.beta_deg), 0.0]
        return np.array([*limb, *limb], dtype=float)

    def kinematics(self, errors: Mapping[str, float] | None = None) -> _core.SphericalKinematics:
        """Kinematics with errors of ``alpha`` and ``beta``, rad. Raises :class:`~sherkit.errors.ShapeError`."""
        p = self.geometry.copy()
        for name, value in (errors or {}).items():
            if name not in ("alpha", "beta"):
                raise ShapeError(f"'{name}' is not a geometric parameter of the spherical robot; it has alpha and beta")
            p[[0, 3] if name == "alpha" else [1, 4]] += value
        return _core.SphericalKinematics(p, self.assembly_mode)

    def forward(self, joints_rad: ArrayLike) -> Floats:
        """φ and γ (2,) of the tool axis for joint angles (2,), rad (Eqs. 34 and 35).

        Raises :class:`~sherkit.errors.OutOfReach`, ``Singular``, ``NotFinite`` with what is wrong.
        """
        return self._nominal.forward(vector(joints_rad, "joint readings", 2))

    def inverse(self, angles_rad: ArrayLike) -> Floats:
        """Joint angles (2,) that point the tool to φ and γ (2,), rad. Raises as :meth:`forward`."""
        return self._nominal.inverse(vector(angles_rad, "phi and gamma", 2), self.working_mode)

    def forward_batch(self, joints_rad: ArrayLike) -> Batch:
        """φ, γ (n, 2) for joint angles (n, 2); rows out of reach are marked."""
        q = matrix(joints_rad, "joint readings", 2)
        x, reached = self._nominal.forward_batch(q)
        return Batch(x, reached, why(self._nominal.forward, q, reached))

    def inverse_batch(self, angles_rad: ArrayLike) -> Batch:
        """Joint angles (n, 2) for φ, γ (n, 2); rows out of reach are marked."""
        x = matrix(angles_rad, "phi and gamma", 2)
        q, reached = self._nominal.inverse_batch(x, self.working_mode)
        return Batch(q, reached, why(lambda one: self._nominal.inverse(one, self.working_mode), x, reached))

    def point(self, angles_rad: ArrayLike) -> Floats:
        """Points (n, 3) of the sphere at φ, γ (n, 2), mm, base frame."""
        phi, gamma = matrix(angles_rad, "phi and gamma", 2).T
        axis = np.column_stack([np.sin(gamma) * np.cos(phi), np.sin(gamma) * np.sin(phi), np.cos(gamma)])
        return self.radius_mm * axis

    @property
    def seen(self) -> CameraView:
        """The camera. Raises :class:`~sherkit.errors.SherkitError` where the robot file has none."""
        if self.camera is None:
            raise SherkitError("pixels need a camera: add [camera] to the robot file, or give phi_rad and gamma_rad")
        return self.camera

    @cached_property
    def _nominal(self) -> _core.SphericalKinematics:
        return self.kinematics()
