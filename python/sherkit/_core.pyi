"""The compiled core: numerics in Rust. Arrays are float64 and contiguous; errors are ``sherkit.errors``."""

from typing import Any, final, type_check_only

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]
_Bools = NDArray[np.bool_]
_Ints = NDArray[np.int64]
_Bytes = NDArray[np.uint8]

__all__ = [
    "STATUS_CLOCK",
    "STATUS_GATED",
    "STATUS_LATE",
    "STATUS_MISSING",
    "STATUS_NOT_FINITE",
    "STATUS_NO_FORCE",
    "STATUS_NO_MOTION",
    "STATUS_UPDATED",
    "Bernstein",
    "Calibrated",
    "Camera",
    "DeltaKinematics",
    "DeltaModel",
    "PaperFilter",
    "SerialCalibrated",
    "SerialModel",
    "Solver",
    "SphericalCalibrated",
    "SphericalKinematics",
    "SphericalModel",
    "ToolBeam",
    "ToolFilter",
    "ToolSensor",
    "__version__",
    "bernstein_basis",
    "bernstein_fit",
    "bernstein_fit_grid",
    "bernstein_held_out",
    "blocks_taken",
    "play",
    "register_most",
    "register_points",
    "rotation_vector",
    "spherical_camera_placement",
]

__version__: str

STATUS_UPDATED: int
STATUS_MISSING: int
STATUS_LATE: int
STATUS_NOT_FINITE: int
STATUS_NO_FORCE: int
STATUS_NO_MOTION: int
STATUS_CLOCK: int
STATUS_GATED: int

@final
class DeltaKinematics:
    def __new__(cls, parameters: _Floats, assembly_mode: str) -> DeltaKinematics: ...
    def forward(self, joints: _Floats) -> _Floats: ...
    def inverse(self, position: _Floats) -> _Floats: ...
    def forward_batch(self, joints: _Floats) -> tuple[_Floats, _Bools]: ...
    def inverse_batch(self, positions: _Floats) -> tuple[_Floats, _Bools]: ...
    def derivatives_batch(self, joints: _Floats) -> tuple[_Floats, _Floats, _Bools]:
        """Of the position: by the joints (n, 3, 3) and by ``parameters`` (n, 3, 18)."""

#: Joints (n, k), other ends of distances (n, k), covariates (n, 3 + 2 k), displacements of the point (n, 3) mm.
_Block = tuple[_Floats, _Floats | None, _Floats | None, _Floats | None]

@type_check_only
class _Model:
    """The measurement chain of a robot of k joints, whose runs have m columns of readings.

    A block of rows: joints (n, k), joints at the other end of a distance (NaN elsewhere) or None, covariates (time s,
    temperature °C, k directions, k velocities, of an arm the target and its payload, temperature of the stands) or
    None, displacements of the measured point or None. Rows that cannot
    be computed are NaN and ``False``. ``CATALOGUE`` has a dict for each effect: name, link, base (whether every model
    has it), needs, search, parameters; these have name, symbol, unit, size, lever_mm (None where the robot says it).
    """

    PARAMETERS: int
    CATALOGUE: list[dict[str, Any]]
    def predict(self, values: _Floats, block: _Block) -> tuple[_Floats, _Bools]:
        """Readings (n, m); what does not apply to a row is zero."""

    def parts(self, values: _Floats, block: _Block) -> tuple[_Floats, _Bools]:
        """Points (n, k, 3) of the mechanism's parts, mm, in an order of its own; the measured point is the last."""

    def derivatives(self, values: _Floats, block: _Block, free: list[int]) -> tuple[_Floats, _Floats, _Floats, _Bools]:
        """By the parameters in ``free`` (n, m, free), the joints (n, m, k), a displacement of the point (n, m, 3)."""

    def accumulate(
        self, solver: Solver, values: _Floats, free: list[int], block: _Block, readings: _Floats, weights: _Floats
    ) -> list[int]:
        """Adds rows to the solver at its trial; returns those that cannot be computed there."""

    def solve(
        self, solver: Solver, values: _Floats, free: list[int], block: _Block, readings: _Floats, weights: _Floats
    ) -> tuple[str, list[int]]:
        """Iterates to the minimum; how it ended, and rows that cannot be computed at the start."""

@final
class DeltaModel(_Model):
    """Readings are x, y, z, distance. ``sensor`` (12,): from the base to the sensors (turn row by row, shift in mm).

    ``settings``: rod spacing, pole pitch, three home readings, origin of time, slip times of point, joints and sensors;
    ``periods`` (3,) the pitch of each joint, where they differ.
    """

    def __new__(
        cls,
        geometry: _Floats,
        target_offset: _Floats,
        assembly_mode: str,
        sensor: _Floats,
        settings: _Floats,
        periods: _Floats | None = None,
    ) -> DeltaModel: ...

@final
class SphericalKinematics:
    """Tool axis of a spherical robot with two limbs on one actuated axis. Angles in rad.

    ``parameters``: alpha, beta, joint offset of limb 1, then of limb 2. ``assembly_mode``: "outer" or "inner", the
    sign of the root of Eq. 35. ``elbows``: "open" (joint 1 ahead of the tool axis, joint 2 behind), "crossed",
    "ahead" or "behind" (both). In a batch, what cannot be computed is NaN and ``False``.
    """

    def __new__(cls, parameters: _Floats, assembly_mode: str = "outer") -> SphericalKinematics: ...
    def forward(self, joints: _Floats) -> _Floats:
        """phi and gamma (2,) for joint angles (2,)."""

    def inverse(self, angles: _Floats, elbows: str = "open") -> _Floats:
        """Joint angles (2,) for phi, gamma (2,)."""

    def forward_batch(self, joints: _Floats) -> tuple[_Floats, _Bools]:
        """phi, gamma (n, 2) for joint angles (n, 2)."""

    def inverse_batch(self, angles: _Floats, elbows: str = "open") -> tuple[_Floats, _Bools]:
        """Joint angles (n, 2) for phi, gamma (n, 2)."""

    def derivatives_batch(self, joints: _Floats) -> tuple[_Floats, _Floats, _Bools]:
        """Of phi, gamma: by the joints (n, 2, 2) and by ``parameters`` (n, 2, 6)."""

    def inverse_derivatives_batch(self, joints: _Floats) -> tuple[_Floats, _Floats, _Bools]:
        """Of the joints, at joint angles (n, 2): by phi, gamma (n, 2, 2) and by ``parameters`` (n, 2, 6)."""

@final
class Camera:
    """A pinhole camera with Brown-Conrady distortion in OpenCV's conventions; mm, px, rad.

    ``parameters``: fx, fy, cx, cy, k1, k2, p1, p2, k3, rotation vector (3), translation (3), with X_cam = R X + t.
    In a batch, what is not seen is NaN and ``False``. ``face``: "near" or "far", where the line of sight enters or
    leaves the sphere about the origin.
    """

    def __new__(cls, parameters: _Floats) -> Camera: ...
    @staticmethod
    def facing(phi_rad: float, gamma_rad: float, distance_mm: float, intrinsics: _Floats) -> _Floats:
        """Parameters (15,) of a camera that looks at the origin; in its picture phi grows right and gamma down."""

    @property
    def position(self) -> _Floats:
        """Optical centre (3,), mm."""

    @property
    def rotation(self) -> _Floats:
        """From the base frame to its own, x right, y down, z forward (3, 3)."""

    def project(self, point: _Floats) -> _Floats:
        """Pixel (2,) of a point (3,)."""

    def project_batch(self, points: _Floats) -> tuple[_Floats, _Bools]:
        """Pixels (n, 2) of points (n, 3)."""

    def derivatives_batch(self, points: _Floats) -> tuple[_Floats, _Floats, _Floats, _Floats, _Bools]:
        """Of the pixels: by point (n, 2, 3), pose (n, 2, 6), intrinsics (n, 2, 4) and distortion (n, 2, 5)."""

    def undistort(self, pixel: _Floats) -> _Floats:
        """Direction x, y (2,), with z = 1, in the camera frame."""

    def undistort_batch(self, pixels: _Floats) -> tuple[_Floats, _Bools]:
        """Directions (n, 2) of pixels (n, 2)."""

    def angles(self, pixel: _Floats, radius_mm: float, face: str = "near") -> _Floats:
        """phi, gamma (2,) of the point of the sphere that a pixel shows."""

    def angles_batch(self, pixels: _Floats, radius_mm: float, face: str = "near") -> tuple[_Floats, _Bools]:
        """phi, gamma (n, 2) of the points of the sphere that pixels show."""

    def on_sphere_batch(self, pixels: _Floats, radius_mm: float, face: str = "near") -> tuple[_Floats, _Bools]:
        """Points (n, 3) of the sphere that pixels show, mm."""

@final
class SphericalModel(_Model):
    """Readings are u, v (px) or phi, gamma (rad), as ``readings`` says: "pixels" or "angles".

    ``settings``: radius of the sphere (mm), direction of the weight (3), home joint readings (2, rad), and perhaps
    origin of time and slip time (s) and the period of the encoders (rad); ``periods`` (2,) that of each joint.
    """

    def __new__(
        cls,
        geometry: _Floats,
        camera: _Floats,
        settings: _Floats,
        assembly_mode: str = "outer",
        face_mode: str = "near",
        readings: str = "pixels",
        periods: _Floats | None = None,
    ) -> SphericalModel: ...
    def reading(self, readings: str) -> SphericalModel:
        """The same robot for runs of the other kind."""

    def camera(self, values: _Floats) -> Camera:
        """The camera with its errors."""

    def markers(self, values: _Floats, block: _Block) -> tuple[_Floats, _Bools]:
        """Markers (n, 3), base frame, mm."""

    def centres(self, values: _Floats, block: _Block, free: list[int]) -> tuple[_Floats, _Floats, _Floats, _Bools]:
        """Displacement of the remote centre (n, 3), mm; by the parameters (n, 3, free) and the joints (n, 3, 2)."""

    def inverse_residuals(
        self, values: _Floats, block: _Block, readings: _Floats, free: list[int]
    ) -> tuple[_Floats, _Floats, _Bools]:
        """Measured joints minus the inverse kinematics of the readings (n, 2), rad (Eq. 6); by (n, 2, free)."""

    def solve_inverse(
        self, solver: Solver, values: _Floats, free: list[int], block: _Block, readings: _Floats, weights: _Floats
    ) -> tuple[str, list[int]]:
        """As ``solve``, over the paper's residuals of the joints; weights are 1/rad."""

@final
class SerialModel(_Model):
    """A serial arm of k joints, at most nine; readings are x, y, z of its target, mm, in the frame of the sensor.

    ``joints`` (k, 19): of each its frame behind the one before it (turn row by row, shift in mm), 1 where it slides, by
    how much it follows the one before, home reading, mass and the centre of it (mm). ``targets`` (t, 3) behind the last
    joint, up to four, and ``centres`` (c, 3) of distances in the base frame, up to eight, mm; ``planes`` (p, 6) a point
    and the normal of up to four; ``sensor`` (12,): from base to sensor.
    ``settings``: direction of the weight (3), period of the encoders, origin of time, slip times of target, joints and
    sensor (s); ``periods`` (k,) that of each joint, where they differ.
    """

    def __new__(
        cls,
        joints: _Floats,
        targets: _Floats,
        centres: _Floats,
        planes: _Floats,
        sensor: _Floats,
        settings: _Floats,
        periods: _Floats | None = None,
    ) -> SerialModel: ...

@final
class SerialCalibrated:
    """Where the target of a calibrated arm is in a ``frame``, "base" or "sensor", mm. Covariates as those of others."""

    def __new__(
        cls, model: SerialModel, values: _Floats, low: _Floats, high: _Floats, frame: str = "base"
    ) -> SerialCalibrated: ...
    def sensor(self) -> _Floats:
        """From the base to the sensor (12,): the turn row by row, the shift in mm."""

    def flat(self) -> _Floats:
        """All that makes it as a row of numbers (n,), for a control loop in another language."""

    def forward(self, joints: _Floats, covariates: list[float]) -> tuple[_Floats, _Floats]:
        """The target (3,), and the derivative by the joints (3, k)."""

    def forward_batch(self, joints: _Floats, covariates: list[float]) -> tuple[_Floats, _Floats, _Bools]:
        """The same for rows (n, k) of joints: (n, 3), (n, 3, k), and which could be computed."""

    def flange(self, joints: _Floats, covariates: list[float]) -> _Floats:
        """The turn (3, 3) of the frame behind the last joint."""

    def by_parameters_batch(self, joints: _Floats, covariates: list[float], free: list[int]) -> tuple[_Floats, _Bools]:
        """Derivatives of the target by the parameters in ``free`` (n, 3, free), and which could be computed."""

    def inverse(self, place: _Floats, covariates: list[float], start: _Floats | None = None) -> _Floats:
        """Joints (k,) for a place (3,), from those of a start, or from home."""

    def inverse_batch(
        self, places: _Floats, covariates: list[float], starts: _Floats | None = None
    ) -> tuple[_Floats, _Bools]:
        """Joints (n, k) for places (n, 3), each from a start of its own (n, k), and which are in reach."""

@type_check_only
class _Calibrated:
    """The model that a control loop runs. Covariates are time s, temperature °C and a direction for each joint."""

    def flat(self) -> _Floats:
        """All that makes it as a row of numbers (n,), for a control loop in another language."""

    def forward(self, joints: _Floats, covariates: list[float]) -> tuple[_Floats, _Floats]:
        """Where it is (k,), and the derivative by the joints (k, k)."""

    def forward_batch(self, joints: _Floats, covariates: list[float]) -> tuple[_Floats, _Floats, _Bools]:
        """The same for rows (n, k) of joints: (n, k), (n, k, k), and which are in reach."""

@final
class SphericalCalibrated(_Calibrated):
    """Where the end of the tool axis is, seen from the nominal centre: phi and gamma, rad."""

    def __new__(cls, model: SphericalModel, values: _Floats, elbows: str = "open") -> SphericalCalibrated: ...
    def inverse(self, angles: _Floats, covariates: list[float]) -> _Floats: ...
    def by_parameters_batch(
        self, joints: _Floats, covariates: list[float], free: list[int]
    ) -> tuple[_Floats, _Floats, _Bools]:
        """phi, gamma (n, 2), their derivatives by the parameters in ``free`` (n, 2, free), and which are in reach."""

    def inverse_batch(self, angles: _Floats, covariates: list[float]) -> tuple[_Floats, _Bools]: ...

@final
class Solver:
    def __new__(
        cls,
        start: _Floats,
        sizes: _Floats,
        *,
        loss: str = "linear",
        max_evaluations: int = 100,
        step_tolerance: float = 1e-5,
        rank_tolerance: float = 1e-9,
        single_step: bool = False,
        known: list[float] | None = None,
    ) -> Solver:
        """``known``: parameters that have a row of their own, zero give or take so many of their sizes; 0 has none."""

    @property
    def trial(self) -> _Floats: ...
    def clear(self) -> None: ...
    def push(self, derivatives: _Floats, residuals: _Floats, weights: _Floats) -> None: ...
    def push_priors(self) -> None: ...
    def fail(self) -> None: ...
    def advance(self) -> str: ...
    def result(self) -> dict[str, Any]: ...

@final
class Bernstein:
    def __new__(
        cls, orders: tuple[int, int, int], low: _Floats, high: _Floats, fade: float, coefficients: _Floats
    ) -> Bernstein: ...
    def share(self, position: _Floats) -> float: ...
    def evaluate(self, positions: _Floats) -> tuple[_Floats, _Floats]: ...

@final
class Calibrated(_Calibrated):
    """Where the measured point of a delta is in a ``frame``, "sensor" or "base", mm.

    A part is a model, the values of its parameters, a correction, which like the region is of the base frame.
    """

    def __new__(
        cls,
        whole: tuple[DeltaModel, _Floats, Bernstein | None],
        local: tuple[DeltaModel, _Floats, Bernstein | None] | None,
        region: tuple[_Floats, _Floats, float] | None,
        frame: str = "sensor",
    ) -> Calibrated: ...
    def sensor(self) -> _Floats:
        """From the base to the sensors (12,): the turn row by row, the shift in mm."""

    def inverse(self, position: _Floats, covariates: list[float]) -> _Floats: ...
    def inverse_batch(self, positions: _Floats, covariates: list[float]) -> tuple[_Floats, _Bools]: ...

@final
class ToolSensor:
    """Nine wavelengths (three fibres at sections I, II, III; nm) into moments, sclera force and insertion depth.

    ``gains`` (2, 2, 3): K_I, K_II in mN·mm/nm. ``distances_mm``: from the tip to sections I and II. ``reference_nm``
    (9,) of the unloaded tool. A *measurement* is eleven numbers: time (s), force x, y (mN), its covariance xx, xy, yx,
    yy (mN²), depth (mm), its variance (mm²; infinite where there is no force), covariance of depth with force x, y
    (mm·mN).
    """

    def __new__(
        cls,
        gains: _Floats,
        distances_mm: _Floats,
        reference_nm: _Floats,
        noise_nm: float,
        beam: ToolBeam,
    ) -> ToolSensor: ...
    def measure_batch(
        self, times_s: _Floats, wavelengths_nm: _Floats
    ) -> tuple[_Floats, _Floats, _Floats, _Floats, _Bytes]:
        """Measurements (n, 11), moments (n, 2, 2), misfit (n,), common mode (n, 3) nm, and a code (n,).

        Code 0: force and depth; 1: no force that would tell the depth; 2: not finite, all but the time is NaN.
        """

@final
class ToolBeam:
    """The shaft: free length in mm, bending stiffness EI in mN·mm²; a cantilever (Eq. 9), or, where ``exact``, an
    elastica."""

    def __new__(cls, length_mm: float, stiffness: float, exact: bool = False) -> ToolBeam: ...
    def loads_batch(
        self, forces_mn: _Floats, depths_mm: _Floats, distances_mm: tuple[float, float], axial: bool, across: bool
    ) -> _Floats:
        """Of loads (n,) at depths (n,) as a bench reads them, the depth ``axial`` or by the shaft, the force
        ``across`` the clamp's axis or the shaft: force across the rod, length of shaft beyond it, moments at two
        distances from the tip, mN·mm, and the deflection of the contact, mm (n, 5)."""

    def tip_batch(self, forces_mn: _Floats, depths_mm: _Floats, poses: _Floats) -> _Floats:
        """The tip in the base frame (n, 3), mm. A pose is twelve numbers: the rotation's rows, then the shift."""

class _ToolFilter:
    def step(
        self, time_s: float, pose: _Floats, stamp_s: float | None = None, wavelengths_nm: _Floats | None = None
    ) -> int:
        """One step to a time and a pose (12,); a reading (9,) may bear a stamp up to 0.3 s back. The status."""

    def run(
        self, times_s: _Floats, poses: _Floats, stamps_s: _Floats, wavelengths_nm: _Floats, present: _Bools
    ) -> dict[str, Any]:
        """As many steps as there are times; by name ``state`` (n, 4), ``covariance`` (n, 4, 4), ``force_mn`` (n, 2),
        ``inner`` (n, 13) and (n,) ``arc_mm``, ``force_variance``, ``misfit``, ``nis``, ``degrees``, ``faulty``,
        ``status``. ``inner``: pace of the hole along the shaft (mm²/s) and across ((mm/s)²), clearance (mm), give
        (mm/mN), the gratings' turn (rad), how much deeper they are (mm), the four moments of no force (mN·mm), the
        share of its slides by which the shaft takes the hole along (0 where nothing tells), how much fibres lag, over
        the bend, by how much the robot is later than the gratings (s; 0 where nothing tells)."""

    @property
    def depth_mm(self) -> float: ...
    @property
    def arc_mm(self) -> float: ...
    @property
    def tip_mm(self) -> _Floats: ...
    @property
    def covariance(self) -> _Floats: ...
    @property
    def force_mn(self) -> _Floats: ...
    @property
    def force_variance(self) -> float: ...
    @property
    def misfit(self) -> float: ...
    @property
    def faulty(self) -> int: ...
    @property
    def time_s(self) -> float: ...
    def statistics(self) -> dict[str, Any]: ...

@final
class ToolFilter(_ToolFilter):
    """Depth and tip from wavelengths and poses, by the rod, its pivot and its gratings.

    ``means_nm`` (2, 2): what the mean of a section's fibres answers to a moment, nm per mN·mm; ``warmth`` (2, 3): how
    much more than its section's mean each fibre answers to it; ``doubts``: deviations of all depths alike (mm), of the
    gratings' turn (rad), of a force (relative), of a reference (nm), of ``means_nm`` (over a fibre's answer), of the
    fibres' answers to warmth among each other and of ``warmth``, of the clearance (mm); ``depth_covariance`` (3, 3) of
    θ where the depth is off by θ₀ + θ₁ d/10 + θ₂ (d/10)²; ``start``: depth (mm), its variance (mm²), time (s).
    """

    def __new__(
        cls,
        sensor: ToolSensor,
        means_nm: _Floats,
        warmth: _Floats,
        depth_covariance: _Floats,
        beam_covariance: _Floats,
        doubts: tuple[float, float, float, float, float, float, float, float],
        clearance_mm: float,
        per_second_mm2: float,
        start: tuple[float, float, float],
        pose: _Floats,
    ) -> ToolFilter: ...
    def copy(self) -> ToolFilter: ...

@final
class PaperFilter(_ToolFilter):
    """The paper's two filters as they are printed (Eqs. 8 and 14), with the noise of its section VII.

    ``of_force``: its entries for the tip are variances of the force (mN²), not of the deflection (mm²).
    """

    def __new__(
        cls, sensor: ToolSensor, start: tuple[float, float, float], pose: _Floats, of_force: bool = False
    ) -> PaperFilter: ...
    def copy(self) -> PaperFilter: ...

def blocks_taken(grams: _Floats, right: _Floats, least: _Floats) -> tuple[_Floats, _Floats]:
    """The sum of squares that each block (b, k, k) takes, and its rank, (b,) each: ``right`` (b, k) are products with
    what is left of the readings; a column of whose square no more is left than ``least`` (b,) is none."""

def register_most(
    points: _Floats, read: _Floats, *, mirrored: bool = False, fewest: int = 4
) -> tuple[_Floats, _Floats, float] | None:
    """The turn (3, 3) and shift (3,) that take most points (n, 3) to where they were read (n, 3), and by how much half
    of them are off or less, mm; None where too few tell it, or these stand in a line."""

def rotation_vector(turn: _Floats) -> _Floats:
    """A turn (3, 3) as a rotation vector (3,), rad."""

def register_points(source: _Floats, target: _Floats, method: str = "quaternion") -> dict[str, Any]:
    """The rigid transform that takes points (n, 3) to points (n, 3), by "quaternion" or "svd".

    Keys: rotation (3, 3), translation_mm (3,), residuals_mm (n, 3), residual_variance (mm²), width_ratio,
    unit_covariance (6, 6) of small rotation and translation for coordinates of variance 1, used (n,). Rows that are
    not finite are passed over. Too few points or points on a line are a FitError that says so.
    """

def bernstein_basis(order: int, t: _Floats) -> _Floats: ...
def bernstein_fit(
    orders: tuple[int, int, int], low: _Floats, high: _Floats, positions: _Floats, targets: _Floats
) -> tuple[_Floats, float]: ...
def bernstein_held_out(
    orders: tuple[int, int, int], low: _Floats, high: _Floats, positions: _Floats, targets: _Floats, block: _Ints
) -> tuple[_Floats, float]: ...
def bernstein_fit_grid(
    orders: tuple[int, int, int], axes: tuple[_Floats, _Floats, _Floats], values: _Floats
) -> _Floats: ...
def spherical_camera_placement(
    radius_mm: float, lens_rad: float, weight: float, region: str = "half", distance_mm: float | None = None
) -> dict[str, float]:
    """What a camera sees from a distance from the centre, by default from the best one (Eqs. 29 to 33).

    ``lens_rad`` is half the angle of view; ``region`` "half" or "quarter" of the sphere. Keys: distance_mm,
    half_angle_rad, coverage (share of the region), seen_mm2, waste_mm2, benefit_mm2.
    """

def play(motion: _Floats, width: float) -> _Floats:
    """What follows ``motion`` (n,) with a dead zone of ``width``."""
