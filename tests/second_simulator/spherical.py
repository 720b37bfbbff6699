"""The spherical robot DIAMOND seen by one camera, with hidden physical effects; lengths in mm, angles in rad.

Origin at the remote centre, z along the common actuated axis. A limb is the chain of turns Rz(psi) Ry(alpha) Rz(tau)
Ry(beta): actuated joint, proximal link, free turn tau of the elbow, distal link. Both chains end in one tool axis;
tau of limb 1 is what Newton makes of that. Parameters of the effects are flat arrays; all zero means no effect.

Joints, all evaluated at the reading r and added to it (joint 1, joint 2):
  joint_offset (2)           constant, rad
  joint_scale (2)            s_i (r_i - home_i), relative
  encoder_eccentricity (4)   a1 b1 a2 b2, rad: a sin(r) + b cos(r)
  encoder_second (5)         the same at twice those waves; it goes with encoder_cyclic
  encoder_cyclic (5)         a1 b1 a2 b2, rad, then how many waves n a turn has: a sin(n r) + b cos(n r)
  joint_slip (3)             what the joints lost, rad, then the time in s from which they have
  backlash (2)               b_i, rad: half of it in the direction of the joint's last motion
  camera_delay (1)           d, s: the picture shows the joints as they were d earlier, -d times their velocity
Mechanism:
  unequal_limbs (2)          alpha, beta, rad: limb 1 has that much more than the common arc, limb 2 that much less
  axis_offset (4)            miss of elbow 1, elbow 2, mm: across the proximal link's plane (the way the joint turns),
                             then in that plane (the way the elbow goes when alpha grows); the platform's centre is
                             the mean of both
  gravity_flexure (2)        c_i, rad: how far a distal link opens under the whole weight square to it
Measured point:
  marker_offset (2)          mm, square to the tool axis: towards elbow 1, then ahead of it about the tool axis
then, at the marker p that this gives:
  thermal_growth (1)         a, 1/degC: a (T - 20) p, about the remote centre
  drift (3)                  mm/h, linear in time from its zero
  thermal_shift (4)          mm/degC, base frame: k (S - 20), then the lag in s of the stand's temperature S
  slip (4)                   step x y z in mm, then the time in s from which it is there
In no catalogue, and therefore no effect by name (``Unmodelled``): a sine of u in the pixels, and an error of the
marker's centre that is the same in every repeat of a pose.

Sensor:
  sensor_pose (6)            turn about the camera's own axes after its rotation, rad, then translation, mm
  sensor_slip (7)            what is added to sensor_pose, then the time in s from which it is
  sensor_drift (6)           what is added to sensor_pose in an hour from the time zero
  focal_length (1)           relative error of both focal lengths
  lens_distortion (4)        errors of k1, k2, p1, p2
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from .effects import Columns, Effects, motion_direction, stand_temperature
from .geometry import Array
from .plans import Order, visit_order

MAX_ITERATIONS = 60
SETTLED_RAD = 1e-11  # Newton squares it: the step after the one below this is exact to rounding
CLOSED = 1e-12
STEP = 1e-4  # of the central differences; lengths move by more, in proportion to their size
RANK_TOLERANCE = 1e-7  # above difference noise (1e-9), below any real singular value
SCALE_TOLERANCE = 1e-3
MAX_RESCALINGS = 60
MAX_FACTOR = 2.0  # steeply nonlinear effects overshoot to where no pose exists
COLUMN_NAMES = (
    "pose", "repeat", "time_s", "temperature_c", "theta1_rad", "theta2_rad", "u_px", "v_px", "theta1_rad_per_s",
    "theta2_rad_per_s",
)  # fmt: skip


@dataclass(frozen=True)
class Now:
    """What a row is besides its joints: direction of each joint's last motion and velocity in rad/s (n, 2); time in s,
    temperature and that of the stands in degC (n,)."""

    direction: ArrayLike | None = None
    velocity: ArrayLike | None = None
    time_s: ArrayLike | None = None
    temperature_c: ArrayLike | None = None
    stand_c: ArrayLike | None = None

    def needed(self, name: str, what: str) -> Array:
        """A covariate that an effect at work asks for."""
        found = getattr(self, name)
        if found is None:
            raise ValueError(f"{what} needs the {name.split('_')[0]}")
        return np.asarray(found, float)


@dataclass(frozen=True)
class Effect:
    """Orders of magnitude of an effect's amplitudes, each in its own unit."""

    typical: tuple[float, ...]
    positive: bool = False  # physically one-signed
    fixed: int = 0  # of these the last ones, which never scale

    @property
    def size(self) -> int:
        return len(self.typical)


SPHERICAL_EFFECTS: dict[str, Effect] = {
    "joint_offset": Effect((2e-3,) * 2),
    "joint_scale": Effect((2e-3,) * 2),
    "encoder_eccentricity": Effect((2e-3,) * 4),
    "encoder_cyclic": Effect((5e-4,) * 4 + (20.0,), fixed=1),
    "backlash": Effect((2e-3,) * 2, positive=True),
    "joint_slip": Effect((2e-3, 2e-3, 100.0), fixed=1),
    "unequal_limbs": Effect((2e-3,) * 2),
    "axis_offset": Effect((0.3,) * 4),
    "gravity_flexure": Effect((3e-3,) * 2, positive=True),
    "marker_offset": Effect((0.5,) * 2),
    "thermal_growth": Effect((1e-3,)),
    "drift": Effect((2.0,) * 3),
    "slip": Effect((0.5, 0.5, 0.5, 100.0), fixed=1),
    "thermal_shift": Effect((0.2, 0.2, 0.2, 60.0), fixed=1),
    "sensor_pose": Effect((1e-3,) * 3 + (0.5,) * 3),
    "sensor_slip": Effect((1e-3,) * 3 + (0.5,) * 3 + (60.0,), fixed=1),
    "sensor_drift": Effect((0.02,) * 3 + (2.0,) * 3),
    "focal_length": Effect((2e-3,)),
    "lens_distortion": Effect((0.01, 0.01, 1e-3, 1e-3)),
    "camera_delay": Effect((5e-3,), positive=True),
}
#: With what goes with another, and is asked for where that is.
ALL_EFFECTS = SPHERICAL_EFFECTS | {"encoder_second": Effect((2e-4,) * 4 + (20.0,), fixed=1)}


@dataclass(frozen=True)
class Unmodelled:
    """What a picture does that no effect of a catalogue does, added to the noise-free pixels.

    ``sine_px``: amplitude along u and v of a sine of u itself (a lens or sensor with a ripple, a grid printed badly),
    with ``period_px`` and ``phase_rad``. ``scatter_px``: sd per axis of an error that each pose has for itself and
    all its repeats share (the marker's centre is found a little off, as its edges fall on the pixels).
    """

    sine_px: tuple[float, float] = (0.0, 0.0)
    period_px: float = 100.0
    phase_rad: float = 0.0
    scatter_px: float = 0.0

    def moved(self, pixels: Array, pose: NDArray[np.int64], rng: np.random.Generator) -> Array:
        """Pixels (n, 2) as they are shown; ``pose`` (n,) counts from 1."""
        sine = np.sin(2 * np.pi * pixels[:, :1] / self.period_px + self.phase_rad)
        own = self.scatter_px * rng.normal(size=(int(pose.max()) + 1, 2))
        return pixels + sine * np.asarray(self.sine_px) + own[pose]


GEOMETRY: dict[str, float] = {"alpha_rad": 1.0, "beta_rad": 1.0, "radius_mm": 200.0}  # size of each, for its step
PRINCIPAL_POINT = "principal_point"  # fitted by some, hidden by none


def complete(effects: Effects | None) -> dict[str, Array]:
    """Parameters of every effect, zero where none are given."""
    given = effects or {}
    if unknown := set(given) - set(ALL_EFFECTS):
        raise ValueError(f"unknown effects {sorted(unknown)}")
    full = {name: np.zeros(effect.size) for name, effect in ALL_EFFECTS.items()}
    for name, value in given.items():
        full[name] = np.asarray(value, float).reshape(ALL_EFFECTS[name].size)
    return full


def draw_spherical_effect(name: str, rng: np.random.Generator) -> Array:
    """Random parameters of typical size."""
    effect = ALL_EFFECTS[name]
    if effect.positive:
        return np.array(effect.typical) * rng.uniform(0.5, 1.5, effect.size)
    drawn = np.array(effect.typical) * rng.normal(size=effect.size)
    if effect.fixed:
        drawn[-effect.fixed :] = np.array(effect.typical)[-effect.fixed :]
    if name == "thermal_shift":
        drawn[-1] *= rng.choice([0.0, rng.uniform(0.3, 1.5)])
    return drawn


def camera_facing(phi_rad: float, gamma_rad: float, distance_mm: float, intrinsics: ArrayLike) -> Array:
    """The 15 numbers of a camera without distortion that looks at the centre from phi, gamma and a distance.

    In its picture phi grows to the right and gamma downwards.
    """
    outward = Rotation.from_euler("ZY", [phi_rad, gamma_rad])  # its x goes with gamma, its y with phi, its z out
    to_camera = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    turn = Rotation.from_matrix(to_camera) * outward.inv()
    return np.concatenate([np.asarray(intrinsics, float), np.zeros(5), turn.as_rotvec(), [0.0, 0.0, distance_mm]])


def sphere_grid(phi_rad: tuple[float, float], gamma_rad: tuple[float, float], per_side: int) -> Array:
    """Directions phi, gamma (n, 2) over a patch of the sphere, rows in serpentine order."""
    phi = np.tile(np.linspace(*phi_rad, per_side), (per_side, 1))
    phi[1::2] = phi[1::2, ::-1].copy()
    return np.column_stack([phi.ravel(), np.repeat(np.linspace(*gamma_rad, per_side), per_side)])


def spherical_plan(
    joints: Array, repeats: int = 1, order: Order = "planes", seed: int = 0, travel_s: float = 1.0
) -> dict[str, NDArray[Any]]:
    """Columns of a run in time order, all but the measured u, v; poses count from 1.

    The camera films the moving robot: it passes each pose at the constant velocity of the way from the pose before.
    Travel varies by half about ``travel_s``. Order as for the delta; "planes" visits the poses as they stand.
    """
    rng = np.random.default_rng(seed)
    visited = visit_order(rng, len(joints), repeats, order)
    n = len(visited)
    repeat = np.empty(n, int)
    repeat[np.argsort(visited, kind="stable")] = np.tile(np.arange(1, repeats + 1), len(joints))
    time_s = np.concatenate([[0.0], np.cumsum(travel_s * rng.uniform(0.5, 1.5, n - 1))])
    theta = np.asarray(joints, float)[visited]
    velocity = np.zeros_like(theta)
    velocity[1:] = np.diff(theta, axis=0) / np.diff(time_s)[:, None]
    return {
        "pose": visited + 1,
        "repeat": repeat,
        "time_s": time_s,
        # the room swings about its mean while the run lasts
        "temperature_c": 20.0 + 1.5 * np.sin(5.0 * np.pi * np.linspace(0.0, 1.0, n)),
        **{f"theta{i + 1}_rad": theta[:, i] for i in range(2)},
        **{f"theta{i + 1}_rad_per_s": velocity[:, i] for i in range(2)},
    }


def write_spherical_csv(columns: Columns, path: str | Path) -> None:
    """Write the measurement file; ten decimals keep rounding far below any effect."""
    formats = ["%d" if name in ("pose", "repeat") else "%.10f" for name in COLUMN_NAMES]
    table = np.column_stack([columns[name] for name in COLUMN_NAMES])
    np.savetxt(path, table, fmt=formats, delimiter=",", header=",".join(COLUMN_NAMES), comments="")


def pair(columns: Columns, unit: str) -> Array:
    """Columns of both joints, (n, 2)."""
    return np.stack([columns[f"theta{i}_{unit}"] for i in (1, 2)], axis=1)


def along(rows: Array, other: Array) -> Array:
    """Row by row scalar product, (n,)."""
    return np.einsum("ij,ij->i", rows, other)


class SecondSpherical:
    """The real robot: its true common arcs and radius, its camera, and the effects it hides.

    ``camera``: fx, fy, cx, cy, k1, k2, p1, p2, k3, rotation vector (3), translation (3) mm. ``gravity``: where the
    weight pulls, any length. ``home_rad``: joint readings about which scale errors turn. ``seed`` rules what is drawn
    where no other seed is given. ``assembly``: "outer" takes the tool axis on the far side of the plane of both elbow
    axes, seen from the actuated axis (plus sign of Eq. 35).
    """

    def __init__(
        self,
        alpha_rad: float,
        beta_rad: float,
        radius_mm: float,
        camera: ArrayLike,
        gravity: ArrayLike = (0.0, 0.0, -1.0),
        home_rad: ArrayLike = (0.0, 0.0),
        seed: int = 0,
        effects: Effects | None = None,
        assembly: Literal["outer", "inner"] = "outer",
    ) -> None:
        self.alpha_rad, self.beta_rad, self.radius_mm = float(alpha_rad), float(beta_rad), float(radius_mm)
        self.camera = np.array(camera, float).reshape(15)
        self.gravity = np.array(gravity, float).reshape(3)
        self.home_rad = np.array(home_rad, float).reshape(2)
        self.seed = seed
        self.assembly = assembly
        self._effects = complete(effects)

    @property
    def effects(self) -> dict[str, Array]:
        """Parameters of every effect; set to a mapping of those that are hidden, the others then are none."""
        return self._effects

    @effects.setter
    def effects(self, effects: Effects) -> None:
        self._effects = complete(effects)

    def hide(self, **effects: ArrayLike) -> SecondSpherical:
        """Adds effects by name to those already hidden; returns the robot itself."""
        self._effects = self._effects | {k: complete({k: v})[k] for k, v in effects.items()}
        return self

    def changed(self, **changes: Any) -> SecondSpherical:
        """A copy with other arguments of the constructor."""
        now = {name: getattr(self, name) for name in (*GEOMETRY, "camera", "gravity", "home_rad", "seed")}
        now |= {"effects": self._effects, "assembly": self.assembly}
        return SecondSpherical(**(now | changes))

    # joints

    def true_joints(self, joints: ArrayLike, now: Now) -> Array:
        """Joint angles (n, 2) that the picture shows, behind the readings."""
        r = np.atleast_2d(np.asarray(joints, float))
        hidden = self._effects
        sine, cosine = hidden["encoder_eccentricity"].reshape(2, 2).T
        theta = r + hidden["joint_offset"] + hidden["joint_scale"] * (r - self.home_rad)
        theta = theta + sine * np.sin(r) + cosine * np.cos(r)
        *waves, per_turn = hidden["encoder_cyclic"]
        for k in (0, 1):
            theta[:, k] += waves[2 * k] * np.sin(per_turn * r[:, k]) + waves[2 * k + 1] * np.cos(per_turn * r[:, k])
        *waves, per_turn = hidden["encoder_second"]
        for k, (sine, cosine) in enumerate(np.reshape(waves, (2, 2))):
            theta[:, k] += sine * np.sin(2 * per_turn * r[:, k]) + cosine * np.cos(2 * per_turn * r[:, k])
        if np.any(hidden["joint_slip"][:2]):
            lost, when = hidden["joint_slip"][:2], hidden["joint_slip"][2]
            theta = theta + np.outer(now.needed("time_s", "a slip of a joint") >= when, lost)
        if np.any(hidden["backlash"]):
            theta = theta + 0.5 * hidden["backlash"] * now.needed("direction", "backlash")
        if np.any(hidden["camera_delay"]):
            theta = theta - hidden["camera_delay"] * now.needed("velocity", "a delay of the camera")
        return theta

    def joints_at(self, angles: ArrayLike) -> Array:
        """Readings (n, 2) that bring the tool axis of the robot without effects to phi, gamma; joint 1 is ahead."""
        phi, gamma = np.atleast_2d(np.asarray(angles, float)).T
        # tangent form of the half angle in the spherical triangle of actuated axis, elbow axis and tool axis
        s = 0.5 * (self.alpha_rad + self.beta_rad + gamma)
        with np.errstate(invalid="ignore"):
            half = np.arctan(
                np.sqrt(np.sin(s - self.alpha_rad) * np.sin(s - gamma) / (np.sin(s) * np.sin(s - self.beta_rad)))
            )
        if not np.all(np.isfinite(half)):
            raise ValueError("a direction is out of reach of the links")
        return np.column_stack([phi + 2 * half, phi - 2 * half])

    # mechanism

    def arcs(self) -> tuple[Array, Array]:
        """Proximal and distal arcs of both limbs."""
        more_alpha, more_beta = self._effects["unequal_limbs"]
        sign = np.array([1.0, -1.0])
        return self.alpha_rad + sign * more_alpha, self.beta_rad + sign * more_beta

    def elbow_frames(self, theta: Array) -> list[Rotation]:
        """Frame of each elbow (n): z its axis, x where the axis goes when alpha grows, y where the joint turns it."""
        alphas, _ = self.arcs()
        return [
            Rotation.from_euler("ZY", np.column_stack([theta[:, i], np.full(len(theta), alphas[i])])) for i in (0, 1)
        ]

    def close(self, theta: Array, beta: Array) -> Rotation:
        """Frame of distal link 1 (n), z the tool axis, so that limb 2 ends there too; ``beta`` (n, 2).

        The tool axis of limb 1 goes round its elbow; its angle to elbow 2 must be that of distal link 2. Newton starts
        a quarter turn from where it is nearest to elbow 2, at the inflection, and so never leaves its branch.
        """
        first, second = self.elbow_frames(theta)
        up = np.array([0.0, 0.0, 1.0])
        elbow, other = first.apply(up), second.apply(up)
        nearest = first.inv().apply(other)
        side = np.where(np.sin(0.5 * (theta[:, 0] - theta[:, 1])) < 0, -1.0, 1.0)
        side *= 1.0 if self.assembly == "outer" else -1.0
        tau = np.arctan2(nearest[:, 1], nearest[:, 0]) + side * 0.5 * np.pi
        distal = Rotation.from_euler("Y", beta[:, :1])
        cosine = np.cos(beta[:, 1])
        settled = False
        for _ in range(MAX_ITERATIONS):
            link = first * Rotation.from_euler("Z", tau[:, None]) * distal
            axis = link.apply(up)
            gap = along(axis, other) - cosine
            if settled:
                if np.max(np.abs(gap), initial=0.0) > CLOSED:
                    break
                return link
            slope = along(np.cross(elbow, axis), other)
            with np.errstate(divide="ignore", invalid="ignore"):
                step = gap / slope
            if not np.all(np.isfinite(step)):
                break
            tau = tau - step
            settled = bool(np.max(np.abs(step), initial=0.0) < SETTLED_RAD)
        raise ValueError("the limbs do not meet in a row")

    def loads(self, theta: Array, link: Rotation, beta: Array) -> Array:
        """Part of the weight (n, 2) that opens each distal link, when a unit weight hangs at the end of the tool axis.

        The end is held by the distal links, each square to the tool axis in its own plane, and by the centre along the
        tool axis: three forces that balance the weight.
        """
        axis = link.apply([0.0, 0.0, 1.0])
        pull = np.empty((len(theta), 3, 3))
        for i, frame in enumerate(self.elbow_frames(theta)):
            away = np.cross(np.cross(frame.apply([0.0, 0.0, 1.0]), axis), axis)
            pull[:, :, i] = away / np.sin(beta[:, i])[:, None]
        pull[:, :, 2] = axis
        weight = np.broadcast_to((self.gravity / np.linalg.norm(self.gravity))[:, None], (len(theta), 3, 1))
        return np.linalg.solve(pull, weight)[:, :2, 0]

    def distal_link(self, theta: Array) -> Rotation:
        """Frame of distal link 1 (n) under the weight; the loads are those of the unbent robot."""
        beta = np.tile(self.arcs()[1], (len(theta), 1))
        link = self.close(theta, beta)
        flexure = self._effects["gravity_flexure"]
        if np.any(flexure):
            link = self.close(theta, beta + flexure * self.loads(theta, link, beta))
        return link

    def _centre(self, theta: Array) -> Array:
        misses = self._effects["axis_offset"].reshape(2, 2)
        limbs = [
            frame.apply([in_plane, across, 0.0])
            for frame, (across, in_plane) in zip(self.elbow_frames(theta), misses, strict=True)
        ]
        return 0.5 * (limbs[0] + limbs[1])

    def centre_mm(self, joints: ArrayLike, **now: ArrayLike) -> Array:
        """Where the platform's centre stands (n, 3), mm, instead of at the remote one; ``now`` as :class:`Now`."""
        return self._centre(self.true_joints(joints, Now(**now)))

    def markers(self, joints: ArrayLike, **now: ArrayLike) -> Array:
        """Marker (n, 3), mm; ``now`` as :class:`Now`."""
        return self._wandering(self._on_the_tool(joints, Now(**now)), Now(**now))

    def _apart(self, marker: Array, now: Now) -> Array:
        """Where a marker (n, 3) seems to be to who does not know that stands have moved apart."""
        if np.any(shift := self._effects["thermal_shift"][:3]):
            return marker + np.outer(now.needed("stand_c", "a stand") - 20.0, shift)
        return marker

    def _wandering(self, point: Array, now: Now) -> Array:
        """Where a marker (n, 3) is that grows, drifts and slips."""
        growth, drift, slip = (self._effects[name] for name in ("thermal_growth", "drift", "slip"))
        if np.any(growth):
            point = point * (1.0 + growth * (now.needed("temperature_c", "growth") - 20.0)[:, None])
        if np.any(drift):
            point = point + np.outer(now.needed("time_s", "drift") / 3600.0, drift)
        if np.any(slip[:3]):
            point = point + np.outer(now.needed("time_s", "slip") >= slip[3], slip[:3])
        return point

    def _on_the_tool(self, joints: ArrayLike, now: Now) -> Array:
        """Where the tool holds the marker (n, 3)."""
        theta = self.true_joints(joints, now)
        towards, ahead = self._effects["marker_offset"]
        # the elbow lies on the -x side of the distal link's frame, and ahead is a quarter turn on about z
        return self._centre(theta) + self.distal_link(theta).apply([-towards, -ahead, self.radius_mm])

    # sensor

    def image(self, points: Array, now: Now | None = None) -> Array:
        """Pixels (n, 2) of points (n, 3), mm; the camera slips in time."""
        fx, fy, cx, cy, k1, k2, p1, p2, k3 = self.camera[:9]
        longer = 1.0 + self._effects["focal_length"][0]
        dk1, dk2, dp1, dp2 = self._effects["lens_distortion"]
        k1, k2, p1, p2 = k1 + dk1, k2 + dk2, p1 + dp1, p2 + dp2
        pose = np.tile(self._effects["sensor_pose"], (len(points), 1))
        *step, when = self._effects["sensor_slip"]
        if np.any(step):
            pose = pose + np.outer((now or Now()).needed("time_s", "a slip of the camera") >= when, step)
        if np.any(self._effects["sensor_drift"]):
            hours = (now or Now()).needed("time_s", "a drift of the camera") / 3600.0
            pose = pose + np.outer(hours, self._effects["sensor_drift"])
        turn = Rotation.from_rotvec(pose[:, :3]) * Rotation.from_rotvec(self.camera[9:12])
        x, y, depth = (turn.apply(points) + self.camera[12:] + pose[:, 3:]).T
        if np.any(depth <= 0):
            raise ValueError("a marker is behind the camera")
        x, y = x / depth, y / depth
        r2 = x**2 + y**2
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
        bent_y = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
        return np.column_stack([fx * longer * bent_x + cx, fy * longer * bent_y + cy])

    def pixels(self, joints: ArrayLike, **now: ArrayLike) -> Array:
        """Noise-free pixels (n, 2) of the marker at joint readings (n, 2); ``now`` as :class:`Now`."""
        return self.image(self._apart(self.markers(joints, **now), Now(**now)), Now(**now))

    def angles(self, joints: ArrayLike, **now: ArrayLike) -> Array:
        """Direction phi, gamma (n, 2) of the marker from the remote centre, phi within a quarter turn of the joints'
        mean; gamma is negative where that takes the other side of the actuated axis."""
        x, y, z = self._apart(self.markers(joints, **now), Now(**now)).T
        mean = np.mean(self.true_joints(joints, Now(**now)), axis=1)
        turns = np.round((np.arctan2(y, x) - mean) / np.pi)
        beyond = np.where(turns % 2, -1.0, 1.0)
        return np.column_stack([np.arctan2(y, x) - np.pi * turns, beyond * np.arctan2(np.hypot(x, y), z)])

    # runs

    def truth(self, plan: Columns) -> Array:
        """Noise-free pixels (n, 2) for the rows of a plan or of a run."""
        theta = pair(plan, "rad")
        direction = motion_direction(theta, plan["time_s"])
        known = {name: plan[name] for name in ("time_s", "temperature_c")}
        known["stand_c"] = stand_temperature(*known.values(), float(self._effects["thermal_shift"][3]))
        return self.pixels(theta, direction=direction, velocity=pair(plan, "rad_per_s"), **known)

    def run(
        self,
        joints: Array | Columns,
        repeats: int = 1,
        noise_px: float = 0.0,
        order: Order = "planes",
        seed: int | None = None,
        unmodelled: Unmodelled | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Columns of a measurement file, in time order; ``noise_px`` is a gaussian sd per axis.

        A plan of ``spherical_plan`` instead of joints (n, 2) is taken as it stands; ``seed`` then rules only the noise
        and the scatter of poses, each from a stream of its own.
        """
        seed = self.seed if seed is None else seed
        plan = spherical_plan(joints, repeats, order, seed) if isinstance(joints, np.ndarray) else dict(joints)
        exact = self.truth(plan)
        if unmodelled is not None:
            exact = unmodelled.moved(exact, plan["pose"], np.random.default_rng([seed, 3]))
        measured = exact + noise_px * np.random.default_rng([seed, 1]).normal(size=exact.shape)
        columns = {**plan, "u_px": measured[:, 0], "v_px": measured[:, 1]}
        return {name: columns[name] for name in COLUMN_NAMES}

    def fitted_directions(self, plan: Columns, fitted: Sequence[str] = tuple(GEOMETRY)) -> Array:
        """Orthonormal basis (2 n, rank) of what the fitted parameters can do to the pixels.

        ``fitted`` names arguments of the constructor, effects (whole) or the principal point. Derivatives are central
        differences of this simulator as it stands.
        """
        changes: list[tuple[dict[str, Any], dict[str, Any]]] = []

        def vary(name: str, value: Array | float, by: Array | float) -> None:
            changes.append(({name: value + by}, {name: value - by}))

        for name in fitted:
            if name in GEOMETRY:
                vary(name, getattr(self, name), STEP * GEOMETRY[name])
            elif name == PRINCIPAL_POINT:
                for k in (2, 3):
                    vary("camera", self.camera, np.eye(15)[k])
            else:
                effect = ALL_EFFECTS[name]
                now = self._effects[name].copy()
                if not np.any(now) and effect.fixed:  # what is not there yet would come at its time
                    now[-effect.fixed :] = effect.typical[-effect.fixed :]
                steps = STEP * np.diag(np.maximum(100.0 * np.array(effect.typical), 1.0))
                for by in steps[: effect.size - effect.fixed]:
                    ahead, behind = ({"effects": self._effects | {name: now + s * by}} for s in (1, -1))
                    changes.append((ahead, behind))
        basis = np.zeros((2 * len(plan["time_s"]), 0))
        if changes:
            moved = [self.changed(**a).truth(plan) - self.changed(**b).truth(plan) for a, b in changes]
            jacobian = np.stack([m.ravel() for m in moved], axis=1)
            jacobian /= np.linalg.norm(jacobian, axis=0)
            basis, size, _ = np.linalg.svd(jacobian, full_matrices=False)
            basis = basis[:, size > RANK_TOLERANCE * size[0]]
        return basis

    def at_ratio(
        self,
        effect: str,
        ratio: float,
        noise_px: float,
        joints: Array | Columns,
        rng: np.random.Generator | None = None,
        fitted: Sequence[str] = tuple(GEOMETRY),
    ) -> dict[str, Array]:
        """Random parameters of one effect, ``{name: parameters}``, sized by what a fit leaves of it.

        The RMS over all rows and both axes of the noise-free change of the pixels, less its linear least-squares fit
        by ``fitted_directions`` (or whole, with none fitted), equals ``ratio`` times ``noise_px``. As for the delta,
        other effects that this robot hides take no part, and rescaling repeats, by the power law through the last two
        trials.
        """
        target_px = ratio * noise_px
        plan = spherical_plan(joints, seed=self.seed) if isinstance(joints, np.ndarray) else joints
        rng = rng or np.random.default_rng([self.seed, 2, tuple(ALL_EFFECTS).index(effect)])
        plain = self.changed(effects=None)
        basis, without = plain.fitted_directions(plan, fitted), plain.truth(plan)
        parameters = draw_spherical_effect(effect, rng)
        rms, factor, power = 0.0, 1.0, 1.0
        for _ in range(MAX_RESCALINGS):
            change = (self.changed(effects={effect: parameters}).truth(plan) - without).ravel()
            left = change - basis @ (basis.T @ change)
            if np.linalg.norm(left) <= 1e-6 * np.linalg.norm(change):
                raise ValueError(f"{effect} is absorbed by the fitted parameters: no scale leaves it")
            last, rms = rms, float(np.sqrt(np.mean(left**2)))
            if abs(target_px / rms - 1) < SCALE_TOLERANCE:
                return {effect: parameters}
            if last:
                power = float(np.clip(np.log(rms / last) / np.log(factor), 0.5, 10.0))
            factor = min((target_px / rms) ** (1 / power), MAX_FACTOR)
            parameters = parameters.copy()
            parameters[: len(parameters) - ALL_EFFECTS[effect].fixed] *= factor
        raise RuntimeError(f"{effect} does not reach {target_px} px")
