"""The spherical parallel robot: two limbs on one actuated axis, all axes through a remote centre; seen by a camera.

Source: Agand, Taghirad, Molaei, "Vision-Based Kinematic Calibration of Spherical Robots" (DIAMOND). The nominal
geometry is the user's. Frame: origin at the remote centre of motion, z along the actuated axis; φ counted about z,
γ from it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy
from numpy.typing import ArrayLike

import sherkit._core as _core

from ...base.notebook import Saved, Shown
from ...base.types import Floats
from ...data.columns import Layout
from ...data.declared import Declared, Inner, key
from ...data.toml import Table
from ...errors import RobotError, ShapeError, SherkitError
from ...model.batch import Batch, matrix, vector, why
from ...model.sensor_pose import WITH_ITS_FILE, KnownPose, SensorPose
from ...model.tolerances import NOT_STATED, Stated, Stating

# -- The camera: calibrated before, and placed by the robot's file ------------------------------------------------

Pair = tuple[float, float]
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class CameraView(Saved):
    """A calibrated camera and where it stands: x_camera = R(``rotation_rad``) x + ``translation_mm``, as in OpenCV.

    ``distortion`` holds k1, k2, p1, p2, k3 (Brown and Conrady). Pixels, mm, rad. ``marker_sigma_px`` is the standard
    deviation of where a marker is found, along u and v, by which poses differ and repeats of one do not: its edges fall
    on the pixels another way at every pose. None where it is not declared.
    """

    size_px: tuple[int, int]
    focal_px: Pair
    centre_px: Pair
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    rotation_rad: Triple = (0.0, 0.0, 0.0)
    translation_mm: Triple = (0.0, 0.0, 0.0)
    marker_sigma_px: float | None = None

    @classmethod
    def facing(
        cls, phi_rad: float, gamma_rad: float, distance_mm: float, *, size_px: tuple[int, int], focal_px: Pair,
        centre_px: Pair | None = None, distortion: tuple[float, float, float, float, float] = (0.0,) * 5,
        marker_sigma_px: float | None = None,
    ) -> CameraView:  # fmt: skip
        """A camera at (φ, γ), ``distance_mm`` from the centre of the sphere, that looks at it; γ grows downwards."""
        centre = centre_px or ((size_px[0] - 1) / 2.0, (size_px[1] - 1) / 2.0)
        inner = np.array([*focal_px, *centre])
        made = _core.Camera.facing(phi_rad, gamma_rad, distance_mm, inner)
        turn, shift = made[9:12].tolist(), made[12:15].tolist()
        return cls(
            size_px, focal_px, centre, distortion, (turn[0], turn[1], turn[2]), (shift[0], shift[1], shift[2]),
            marker_sigma_px,
        )  # fmt: skip

    @property
    def parameters(self) -> Floats:
        """The 15 numbers of the core: focal lengths, centre, distortion, rotation, translation."""
        return np.array(
            [*self.focal_px, *self.centre_px, *self.distortion, *self.rotation_rad, *self.translation_mm], dtype=float
        )

    @cached_property
    def core(self) -> _core.Camera:
        """The compiled camera."""
        return _core.Camera(self.parameters)

    @classmethod
    def from_table(cls, table: Table) -> CameraView:
        """Reads the table [camera]: placed by ``phi_deg``, ``gamma_deg`` and ``distance_mm``, or by pose."""
        size = table.numbers("size_px", 2, positive=True)
        inner: dict[str, Any] = {
            "size_px": (round(size[0]), round(size[1])),
            "focal_px": table.numbers("focal_px", 2, positive=True),
            "centre_px": table.numbers("centre_px", 2, ((size[0] - 1) / 2.0, (size[1] - 1) / 2.0)),
            "distortion": table.numbers("distortion", 5, (0.0,) * 5),
            "marker_sigma_px": table.positive("marker_sigma_px"),
        }
        if table.has("distance_mm"):
            distance = table.number("distance_mm", positive=True)
            phi, gamma = (float(np.deg2rad(table.number(key))) for key in ("phi_deg", "gamma_deg"))
            return cls.facing(phi, gamma, distance, **inner)
        return cls(
            **inner,
            rotation_rad=table.numbers("rotation_rad", 3),  # type: ignore[arg-type]
            translation_mm=table.numbers("translation_mm", 3),  # type: ignore[arg-type]
        )

    def to_table(self) -> dict[str, Any]:
        """What :meth:`from_table` reads, without loss."""
        told = {one.name: getattr(self, one.name) for one in fields(self)}
        return {name: list(v) if isinstance(v, tuple) else v for name, v in told.items() if v is not None}


# -- Where to put the one camera that looks at a spherical robot ----------------------------------------------------

REGIONS = ("half", "quarter")
#: The paper's weight of seen against wasted.
PAPER_WEIGHT = 5.0


@dataclass(frozen=True)
class Placement:
    """What a camera sees from ``distance_mm`` from the centre of the sphere, all of its rim in the picture.

    ``half_angle_rad`` is the horizon, where rays touch the sphere, counted at the centre from the point below the
    camera. ``coverage`` is the share of the half circle inside the horizon. Areas as in Eq. 32; ``benefit_mm2`` is what
    was maximised.
    """

    distance_mm: float
    half_angle_rad: float
    coverage: float
    seen_mm2: float
    waste_mm2: float
    benefit_mm2: float


def camera_placement(
    radius_mm: float, lens_rad: float, *, weight: float = PAPER_WEIGHT, region: str = "half",
    distance_mm: float | None = None,
) -> Placement:  # fmt: skip
    """The best distance of a camera whose half angle of view is ``lens_rad``, or what is seen from ``distance_mm``.

    ``region`` is the part of the sphere that is worked on, ``"half"`` or ``"quarter"``. Eq. 32 takes the lens for wide
    enough to show the sphere's whole rim; what lies beside it in the picture is wasted.

    Raises :class:`~sherkit.errors.ShapeError` where it is not (:func:`picture_half_angle` says what such a lens shows),
    and for a lens, radius, weight or distance that make no picture of the sphere.
    """
    if region not in REGIONS:
        raise ShapeError(f"region: '{region}' is not known; choose {' or '.join(REGIONS)}")
    found = _core.spherical_camera_placement(radius_mm, lens_rad, weight, region, distance_mm)
    if found["waste_mm2"] < 0:
        distance = found["distance_mm"]
        lens, rim = np.rad2deg([lens_rad, np.arcsin(radius_mm / distance)])
        best = "" if distance_mm is not None else ", where the benefit would be largest"
        raise ShapeError(
            f"lens_rad: half an angle of view of {lens:.2f}° shows nothing but sphere from {distance:.1f} mm{best}: "
            f"its rim takes {rim:.2f}° there, and the area beside it would be negative; take a wider lens, or choose "
            "the distance by what picture_half_angle must show"
        )
    return Placement(**found)


def picture_half_angle(radius_mm: float, lens_rad: float, distance_mm: float) -> float:
    """How much of the sphere a picture shows whose half angle of view is ``lens_rad``, rad.

    Counted at the centre, from the point below the camera to the edge of the picture, or to the horizon where that is
    nearer (Eq. 13).

    Raises :class:`~sherkit.errors.ShapeError` for a camera within the sphere or a lens that is none.
    """
    if not (0.0 < radius_mm < distance_mm < np.inf and 0.0 < lens_rad < 0.5 * np.pi):
        raise ShapeError(
            "picture_half_angle: expected a camera outside the sphere and half an angle of view between 0 and π/2, got "
            f"radius_mm = {radius_mm:g}, distance_mm = {distance_mm:g}, lens_rad = {lens_rad:g}"
        )
    edge = distance_mm / radius_mm * np.sin(lens_rad)
    return float(np.arcsin(edge) - lens_rad if edge < 1.0 else np.arccos(radius_mm / distance_mm))


# -- The columns of a run -----------------------------------------------------------------------------------------

SPHERICAL_JOINTS = ("theta1_rad", "theta2_rad")
_VELOCITIES = ("theta1_rad_per_s", "theta2_rad_per_s")

SPHERICAL_PIXELS = Layout(SPHERICAL_JOINTS, ("u_px", "v_px"), "px", 1.0, velocities=_VELOCITIES)
SPHERICAL_ANGLES = Layout(SPHERICAL_JOINTS, ("phi_rad", "gamma_rad"), "mrad", 1e3, velocities=_VELOCITIES)


# -- The robot ----------------------------------------------------------------------------------------------------

ASSEMBLY_MODES = ("outer", "inner")
WORKING_MODES = ("open", "crossed", "ahead", "behind")


def axes_at(angles_rad: Floats) -> Floats:
    """Unit vectors (n, 3) of the base frame that point to φ, γ (n, 2)."""
    phi, gamma = angles_rad.T
    return np.column_stack([np.sin(gamma) * np.cos(phi), np.sin(gamma) * np.sin(phi), np.cos(gamma)])


@dataclass(frozen=True)
class Spherical(Declared, Stating, Saved, Shown):
    """Nominal spherical robot. Angles in degrees as on a drawing, lengths in mm.

    ``alpha_deg`` and ``beta_deg`` are the arcs of the proximal and distal links, ``radius_mm`` the distance of the
    marker from the centre. ``assembly_mode`` is ``"outer"`` or ``"inner"`` (the sign of the root of Eq. 35),
    ``working_mode`` tells on which side of the tool each elbow is (``"open"``: joint 1 ahead, joint 2 behind).
    ``gravity`` is the direction of the weight, ``home_deg`` the joint readings about which encoder scales are counted.
    ``phi_deg`` and ``gamma_deg`` are the limits of the workspace, ``joint_limits_deg`` (low, high) those that no motor
    may leave, ``required_um`` the accuracy that it is for. ``sensor_pose`` says how well the pose of the camera is
    known, which stands with it. Joint readings are angles about z.
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
    sensor_pose: SensorPose = WITH_ITS_FILE
    tolerances: Stated = NOT_STATED
    known: Stated = NOT_STATED
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
        "sensor_pose": Inner(KnownPose, "sensor_pose"),
        "tolerances": Inner(Stated, "tolerances"),
        "known": Inner(Stated, "known"),
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

    def drawn_values(self) -> Mapping[str, float]:
        """Arcs (rad), the radius and the camera's principal point by the name of their parameter."""
        arcs = {"alpha": float(np.deg2rad(self.alpha_deg)), "beta": float(np.deg2rad(self.beta_deg))}
        centre = (0.0, 0.0) if self.camera is None else self.camera.centre_px
        points = dict(zip(("principal_point_u", "principal_point_v"), centre, strict=True))
        return arcs | {"radius": self.radius_mm} | points

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
        low, high = np.deg2rad(self.joint_limits_deg).tolist()
        return (low, high)

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
        return self.radius_mm * axes_at(matrix(angles_rad, "phi and gamma", 2))

    @property
    def seen(self) -> CameraView:
        """The camera. Raises :class:`~sherkit.errors.SherkitError` where the robot file has none."""
        if self.camera is None:
            raise SherkitError("pixels need a camera: add [camera] to the robot file, or give phi_rad and gamma_rad")
        return self.camera

    @cached_property
    def _nominal(self) -> _core.SphericalKinematics:
        return self.kinematics()


# -- The cameras that a file may have meant: a pose is written in more than one way --------------------------------

_MEANT = "x_camera = R x_base + t is meant"


def camera_written_otherwise(robot: Spherical) -> Iterator[tuple[str, str, Spherical]]:
    """The robots whose camera was written from the camera to the base, as OpenCV does not, or in degrees: what looks
    wrong, what to write, and the robot as it would be then."""
    camera = robot.camera
    if camera is None:
        return
    turn, shift = scipy.spatial.transform.Rotation.from_rotvec(camera.rotation_rad), np.array(camera.translation_mm)
    back, forth = turn.inv(), "that from the camera to the base"
    here, place = "of [camera] in the robot file", "the camera's place in the base"
    for looks, is_turn, is_shift in (
        (f"rotation_rad {here} looks like {forth}", back, shift),
        (f"rotation_rad and translation_mm {here} look like {forth}", back, -back.apply(shift)),
        (f"translation_mm {here} looks like {place}", turn, -turn.apply(shift)),
    ):
        yield from _as_meant(robot, camera, f"{looks}, where {_MEANT}", is_turn.as_rotvec(), is_shift)
    looks = f"rotation_rad {here} looks like degrees"
    yield from _as_meant(robot, camera, looks, np.deg2rad(camera.rotation_rad), shift)


def _as_meant(
    robot: Spherical, camera: CameraView, looks: str, rotation_rad: Floats, translation_mm: Floats
) -> Iterator[tuple[str, str, Spherical]]:
    """The robot with this pose of its camera, unless it is the one that it has."""
    poses = {"rotation_rad": rotation_rad, "translation_mm": translation_mm}
    changed = {key: value for key, value in poses.items() if not np.allclose(value, getattr(camera, key), atol=1e-9)}
    if changed:
        told = "; ".join(f"{key} = [{', '.join(_plain(v) for v in value)}]" for key, value in changed.items())
        meant = replace(camera, **{key: tuple(value.tolist()) for key, value in changed.items()})  # type: ignore[arg-type]
        yield looks, f"write {told}", replace(robot, camera=meant)


def _plain(value: float) -> str:
    """Six digits; what is but rounding is none."""
    return f"{round(value, 9) + 0.0:.6g}"
