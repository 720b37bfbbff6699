"""Physics that no catalogue has, for the delta and for the spherical robot: a kind adds something to joints, point or
readings, whose size is what a fit of the geometry leaves of it.

All of it is small beside the robot, so that a joint's error reaches the readings by a difference of the simulator.
Where the readings have their zero, how far the temperature swings and what the plan is are drawn from wide ranges.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .effects import draw_pose
from .geometry import NOMINAL_CONFIG, Array, Robot, draw_geometric_errors
from .plans import COLUMN_NAMES, grid, make_plan, room_temperature
from .simulate import fitted_directions, truth
from .spherical import COLUMN_NAMES as SPHERICAL_NAMES
from .spherical import SecondSpherical, camera_facing, sphere_grid, spherical_plan

STEP_MM = 1e-3
STEP_RAD = 1e-6
#: A kind of which the fit leaves less than this part is drawn again.
LEAST_LEFT = 0.02
TRIALS = 40
TIME = frozenset({"time_s"})

Ordered = Literal["raster", "shuffled"]


@dataclass(frozen=True, eq=False)
class Scene:
    """A run without noise: rows (n) in the order of time.

    ``joints`` (n, k), ``point`` (n, 3) mm in the frame of the robot, ``readings`` (n, m) with a zero of their own;
    ``by_joint`` (n, m, k) and ``by_point`` (n, m, 3) are what an error of a joint and of the point does to them;
    ``by_radius`` (n, m, k) what a wider base does, where there is one.
    """

    rng: np.random.Generator
    time_s: Array
    temperature_c: Array
    humidity_pct: Array
    joints: Array
    point: Array
    readings: Array
    by_joint: Array
    by_point: Array
    by_radius: Array | None = None
    velocity: Array | None = None

    @property
    def duration_s(self) -> float:
        return float(self.time_s.max())

    @property
    def unit_joints(self) -> Array:
        """Joints brought to -1 … 1."""
        return _unit(self.joints)

    def vector(self) -> Array:
        """A direction of the point (3,), of unit length."""
        drawn = self.rng.normal(size=3)
        return np.asarray(drawn / np.linalg.norm(drawn))

    def of_joints(self, error: Array) -> Array:
        """What an error of the joints (n, k) does to the readings."""
        return np.einsum("nmk,nk->nm", self.by_joint, error)

    def of_point(self, moved: Array) -> Array:
        """What a displacement (n, 3) of the point does to the readings."""
        return np.einsum("nmk,nk->nm", self.by_point, moved)

    def in_time(self, course: Array) -> Array:
        """The whole moves along one direction, with this course (n,) in time."""
        return self.of_point(np.outer(course, self.vector()))


def _unit(values: Array) -> Array:
    low, high = values.min(axis=0), values.max(axis=0)
    return np.asarray(2 * (values - low) / np.where(high > low, high - low, 1.0) - 1.0)


def _share(scene: Scene, low: float, high: float) -> float:
    """A part of the duration, drawn evenly by its logarithm."""
    return scene.duration_s * float(np.exp(scene.rng.uniform(np.log(low), np.log(high))))


def _lagged(values: Array, time_s: Array, lag_s: float) -> Array:
    """What follows ``values`` with a first-order lag, from rest."""
    out = np.empty_like(values)
    out[0] = values[0]
    for k in range(1, len(values)):
        out[k] = values[k] + (out[k - 1] - values[k]) * np.exp(-(time_s[k] - time_s[k - 1]) / lag_s)
    return out


def _came(values: Array) -> Array:
    """Direction (n, …) of the last motion; +1 before any."""
    out = np.ones_like(values)
    for k in range(1, len(values)):
        step = values[k] - values[k - 1]
        out[k] = np.where(np.abs(step) > 1e-9, np.sign(step), out[k - 1])
    return out


# -- in the course of time -----------------------------------------------------------------------------------------


def room_cycle(s: Scene) -> Array:
    """The air conditioning of the room, which nobody recorded."""
    return s.in_time(np.sin(2 * np.pi * s.time_s / _share(s, 1 / 12, 1 / 1.5) + s.rng.uniform(0, 6.28)))


def random_walk(s: Scene) -> Array:
    """A stand that goes where it likes."""
    return s.of_point(np.cumsum(s.rng.normal(size=(len(s.time_s), 3)), axis=0))


def creep(s: Scene) -> Array:
    """A stand that gives way: by the logarithm of time."""
    return s.in_time(np.log1p(s.time_s / _share(s, 1 / 100, 1 / 10)))


def warm_up(s: Scene) -> Array:
    """Motors that become warm once they are on, at a pace that no column has."""
    pace = 1.0 - np.exp(-s.time_s / _share(s, 1 / 12, 1 / 3))
    return s.of_joints(np.outer(pace, s.rng.uniform(0.3, 1.0, s.joints.shape[1])))


def bump_back(s: Scene) -> Array:
    """Somebody leaned on the table for a while."""
    begin = s.rng.uniform(0.2, 0.5)
    inside = (s.time_s > begin * s.duration_s) & (s.time_s < (begin + s.rng.uniform(0.12, 0.3)) * s.duration_s)
    return s.in_time(inside.astype(float))


def telegraph(s: Scene) -> Array:
    """A loose screw: two places, between which the whole snaps every now and then."""
    switches = np.sort(s.rng.uniform(0, s.duration_s, s.rng.integers(4, 9)))
    return s.in_time(np.searchsorted(switches, s.time_s) % 2.0)


def breathing_lens(s: Scene) -> Array:
    """A focus motor that hunts: the picture grows and shrinks about its middle, slowly."""
    course = np.sin(2 * np.pi * s.time_s / _share(s, 1 / 10, 1 / 2) + s.rng.uniform(0, 6.28))
    return course[:, None] * (s.readings - s.readings.mean(axis=0))


# -- with what was recorded, and with what was not -----------------------------------------------------------------


def lagged_growth(s: Scene) -> Array:
    """A body that follows the recorded temperature late, and grows about a point of its own."""
    late = _lagged(s.temperature_c, s.time_s, _share(s, 1 / 10, 1 / 2))
    about = s.point.mean(axis=0) + s.rng.uniform(-2, 2, 3) * s.point.std(axis=0)
    return s.of_point((late - s.temperature_c.mean())[:, None] * (s.point - about))


def tilt_of_warmth(s: Scene) -> Array:
    """A base of two metals that leans as it becomes warm: a turn about a line far below."""
    arm = s.point - s.point.mean(axis=0)
    return s.of_point((s.temperature_c - s.temperature_c.mean())[:, None] * np.cross(s.vector(), arm))


def humidity(s: Scene) -> Array:
    """A plate that swells with the recorded humidity."""
    return s.in_time(_unit(s.humidity_pct))


def humidity_unrecorded(s: Scene) -> Array:
    """The same, and no column has it."""
    return s.in_time(_unit(s.humidity_pct))


# -- by place ------------------------------------------------------------------------------------------------------


def saddle(s: Scene) -> Array:
    """A plate that is warped: its height is a product of both ways along it."""
    turn, (x, y, _) = s.rng.uniform(0, np.pi), (s.point - s.point.mean(axis=0)).T
    height = (x * np.cos(turn) + y * np.sin(turn)) * (y * np.cos(turn) - x * np.sin(turn))
    return s.of_point(np.outer(height, [0.0, 0.0, 1.0]))


def bowed_rails(s: Scene) -> Array:
    """Rails that are bent: in the middle of its travel a carriage stands farther out."""
    assert s.by_radius is not None, "a robot without rails has none that are bowed"
    bow = s.rng.uniform(0.4, 1.0, s.joints.shape[1]) * s.rng.choice([-1.0, 1.0], s.joints.shape[1])
    return np.einsum("nmk,nk->nm", s.by_radius, bow * (1.0 - s.unit_joints**2))


def ripple(s: Scene) -> Array:
    """A straightedge that is not straight: a wave along one coordinate, of a period that no part has."""
    axis = int(s.rng.integers(0, 2))
    across = s.readings[:, axis]
    period = float(np.ptp(across)) / s.rng.uniform(2.5, 9.0)
    wave = np.sin(2 * np.pi * across / period + s.rng.uniform(0, 6.28))
    change = np.outer(wave, s.rng.normal(size=s.readings.shape[1]))
    return np.asarray(change)


def worn_spot(s: Scene) -> Array:
    """One rail or bearing is worn where it is used most."""
    joint = int(s.rng.integers(0, s.joints.shape[1]))
    away = (s.unit_joints[:, joint] - s.rng.uniform(-0.4, 0.4)) / s.rng.uniform(0.15, 0.35)
    error = np.zeros_like(s.joints)
    error[:, joint] = np.exp(-(away**2))
    return s.of_joints(error)


def cable(s: Scene) -> Array:
    """A cable that hangs loose near its anchor and pulls beyond."""
    size = s.point.std(axis=0)
    anchor = s.point.mean(axis=0) + s.vector() * size * s.rng.uniform(1.0, 2.0)
    away = s.point - anchor
    far = np.linalg.norm(away, axis=1)
    pull = np.maximum(far - np.quantile(far, s.rng.uniform(0.3, 0.6)), 0.0)
    return s.of_point(-away / far[:, None] * pull[:, None])


def saturation(s: Scene) -> Array:
    """A sensor that runs into its end: beyond a point a coordinate shows half of what there is."""
    axis = int(s.rng.integers(0, s.readings.shape[1]))
    shown = s.readings[:, axis]
    beyond = np.maximum(shown - np.quantile(shown, s.rng.uniform(0.6, 0.85)), 0.0)
    out = np.zeros_like(s.readings)
    out[:, axis] = -beyond
    return out


def one_sided_light(s: Scene) -> Array:
    """A marker lit from one side: its bright part lies off its middle, more the more it is turned away."""
    normal = s.point / np.linalg.norm(s.point, axis=1, keepdims=True)
    facing = normal @ s.vector()
    return np.outer(np.sqrt(np.maximum(1.0 - facing**2, 0.0)), s.rng.normal(size=2))


# -- between the joints --------------------------------------------------------------------------------------------


def _coupled(s: Scene, of: Callable[[Array, Array], Array]) -> Array:
    unit, error = s.unit_joints, np.zeros_like(s.joints)
    count = s.joints.shape[1]
    for driven in range(count):
        for driving in range(count):
            if driven != driving:
                error[:, driven] += s.rng.normal() * of(unit[:, driven], unit[:, driving])
    return s.of_joints(error)


def crosstalk_product(s: Scene) -> Array:
    """Each joint errs by the product of its own and another's reading."""
    return _coupled(s, lambda own, other: own * other)


def crosstalk_square(s: Scene) -> Array:
    """Each joint errs by the square of another's reading."""
    return _coupled(s, lambda own, other: other**2)


# -- by the way that it came ---------------------------------------------------------------------------------------


def clearance_of_whole(s: Scene) -> Array:
    """A carriage that holds the whole has play: it lies on the side that the point came from."""
    along = s.vector()
    return s.of_point(np.outer(_came(s.point @ along), along))


def clock_of_another(s: Scene) -> Array:
    """Readings numbered by another computer: each was taken a little before its joints had arrived."""
    late = np.concatenate([np.zeros((1, s.joints.shape[1])), np.diff(s.joints, axis=0)])
    return -s.of_joints(late)


def stick_slip(s: Scene) -> Array:
    """A joint that arrives slowly sticks short of where it goes, one that is fast does not."""
    if s.velocity is None:
        moved = np.concatenate([np.zeros((1, s.joints.shape[1])), np.diff(s.joints, axis=0)])
        pace = np.diff(s.time_s, prepend=s.time_s[0] - 1.0)[:, None]
        velocity = moved / pace
    else:
        velocity = s.velocity
    usual = np.median(np.abs(velocity), axis=0) + 1e-12
    return s.of_joints(-np.sign(velocity) * np.exp(-np.abs(velocity) / usual))


def rolling_shutter(s: Scene) -> Array:
    """Lines of the picture are exposed one after another: what is lower is seen later."""
    assert s.velocity is not None, "a still robot shows no shutter"
    line = s.readings[:, 1] - s.readings[:, 1].mean()
    return s.of_joints(line[:, None] * s.velocity)


def shifting_clock(s: Scene) -> Array:
    """Two clocks that run apart: pictures are late at the end of the run, early at its begin."""
    assert s.velocity is not None, "a still robot shows no clock"
    return s.of_joints((s.time_s - s.time_s.mean())[:, None] * s.velocity)


# -- which are there -----------------------------------------------------------------------------------------------

Kind = Callable[[Scene], Array]

_JOINTS = frozenset({"q1_mm", "q2_mm", "q3_mm"})
_PLACE = frozenset({"x_mm", "y_mm", "z_mm"})
_ANGLES = frozenset({"theta1_rad", "theta2_rad"})
_PICTURE = frozenset({"u_px", "v_px"})
_SPEED = frozenset({"theta1_rad_per_s", "theta2_rad_per_s"})

#: Kinds, and the columns of which a description of what they leave must name one.
DELTA_KINDS: dict[Kind, frozenset[str]] = {
    room_cycle: TIME, random_walk: TIME, creep: TIME, warm_up: TIME, bump_back: TIME, telegraph: TIME,
    lagged_growth: TIME | {"temperature_c"}, tilt_of_warmth: frozenset({"temperature_c"}),
    humidity: frozenset({"humidity_pct"}), humidity_unrecorded: TIME, saddle: _PLACE, bowed_rails: _JOINTS,
    ripple: _PLACE, worn_spot: _JOINTS, cable: _PLACE | _JOINTS, saturation: _PLACE, crosstalk_product: _JOINTS,
    crosstalk_square: _JOINTS, clearance_of_whole: _JOINTS | _PLACE, clock_of_another: _JOINTS, stick_slip: _JOINTS,
}  # fmt: skip
SPHERICAL_KINDS: dict[Kind, frozenset[str]] = {
    room_cycle: TIME, random_walk: TIME, creep: TIME, warm_up: TIME, telegraph: TIME, breathing_lens: TIME,
    lagged_growth: TIME | {"temperature_c"}, worn_spot: _ANGLES, cable: _ANGLES | _PICTURE, ripple: _PICTURE,
    one_sided_light: _ANGLES | _PICTURE, clearance_of_whole: _ANGLES | _PICTURE, stick_slip: _ANGLES | _SPEED,
    rolling_shutter: _PICTURE | _SPEED, shifting_clock: TIME | _SPEED,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Unnamed:
    """A run with such physics: ``settings`` of the robot file, ``columns`` of the run, ``noise`` the sd of a reading in
    µm or px, ``true`` the columns it depends on."""

    settings: dict[str, Any]
    columns: dict[str, NDArray[Any]]
    noise: float
    true: frozenset[str]


def delta_unnamed(kind: Kind, ratio: float, order: Ordered, seed: int) -> Unnamed:
    """The delta; of what ``kind`` does a fit of twelve parameters and the readings' zero leaves ``ratio`` noises."""
    rng = np.random.default_rng([seed, 11])
    config = deepcopy(NOMINAL_CONFIG)
    config["geometry"]["target_offset_mm"] = [*rng.uniform(-5, 5, 2).tolist(), float(rng.uniform(-50, 50))]
    robot, errors = Robot.from_dict(config), draw_geometric_errors(rng)
    half, planes = rng.uniform(9, 20), int(rng.integers(2, 5))
    z = np.linspace(-1, 1, planes) * rng.uniform(6, 20)
    points = grid(half, int(rng.integers(6, 10)), tuple(z.tolist()))
    repeats, noise_um = int(rng.integers(2, 4)), float(rng.uniform(0.5, 4.0))
    visited: Literal["planes", "shuffled"] = "planes" if order == "raster" else "shuffled"
    plan = make_plan(robot, points, repeats, visited, seed, dwell_s=float(rng.uniform(1, 8)))
    plan["temperature_c"] = room_temperature(rng, plan["time_s"])
    stands = {"sensor_pose": draw_pose(rng)}
    exact = truth(robot, plan, errors, stands)
    turn, shift = Rotation.from_rotvec(stands["sensor_pose"][:3]), stands["sensor_pose"][3:]
    joints = np.stack([plan[f"q{i}_mm"] for i in (1, 2, 3)], axis=1)

    def by(changed: Callable[[int, float], Array]) -> Array:
        ends = [[changed(i, sign * STEP_MM) for sign in (1, -1)] for i in range(3)]
        return np.stack([(ahead - behind) / (2 * STEP_MM) for ahead, behind in ends], axis=2)

    def radius(i: int, step: float) -> Array:
        name = f"base_radius_{i + 1}"
        return truth(robot, plan, errors | {name: errors[name] + step}, stands)

    scene = Scene(
        rng, plan["time_s"], plan["temperature_c"], plan["humidity_pct"], joints, turn.inv().apply(exact - shift),
        exact, by(lambda i, step: truth(robot, plan | {f"q{i + 1}_mm": plan[f"q{i + 1}_mm"] + step}, errors, stands)),
        np.broadcast_to(turn.as_matrix(), (len(joints), 3, 3)), by(radius),
    )  # fmt: skip
    change = _sized(kind, scene, fitted_directions(robot, plan, errors, stands), 1e-3 * noise_um * ratio)
    measured = exact + change + 1e-3 * noise_um * rng.normal(size=exact.shape)
    columns = plan | {f"{a}_mm": measured[:, k] for k, a in enumerate("xyz")}
    left_out = {"humidity_pct"} if kind is not humidity and (kind is humidity_unrecorded or rng.uniform() < 0.5) else {}
    kept = {name: columns[name] for name in COLUMN_NAMES if name not in left_out}
    return Unnamed(config, kept, noise_um, DELTA_KINDS[kind])


def spherical_unnamed(kind: Kind, ratio: float, order: Ordered, seed: int) -> Unnamed:
    """The spherical robot, filmed in motion; of what ``kind`` does a fit of α, β and R leaves ``ratio`` noises."""
    rng = np.random.default_rng([seed, 12])
    phi, gamma = rng.uniform(0.3, 2.8), rng.uniform(0.7, 0.9)
    lean = rng.normal(size=3) * 0.5 - [0, 0, 1]
    focal, radius = float(rng.uniform(500, 900)), float(rng.uniform(120, 220))
    away, size = 2.2 * radius, [1280, 960]
    settings: dict[str, Any] = {
        "kind": "spherical",
        "geometry": {"alpha_deg": 45.0, "beta_deg": 45.0, "radius_mm": radius, "gravity": lean.tolist()},
        "camera": {
            "size_px": size, "focal_px": [focal, focal], "phi_deg": float(np.rad2deg(phi)),
            "gamma_deg": float(np.rad2deg(gamma)), "distance_mm": away,
        },
    }  # fmt: skip
    camera = camera_facing(phi, gamma, away, [focal, focal, 639.5, 479.5])
    arcs = np.deg2rad(45.0) + np.array([-0.02, 0.015]) * rng.uniform(0.3, 1.0, 2)
    robot = SecondSpherical(*arcs, radius * (1 + 0.05 * rng.uniform()), camera, lean, seed=seed)
    wide, high, side = rng.uniform(0.35, 0.6), rng.uniform(0.25, 0.35), int(rng.integers(9, 15))
    plain = SecondSpherical(np.deg2rad(45.0), np.deg2rad(45.0), 1.0, np.zeros(15))
    joints = plain.joints_at(sphere_grid((phi - wide, phi + wide), (gamma - high, gamma + high), side))
    repeats, noise_px = int(rng.integers(2, 4)), float(rng.uniform(0.05, 0.3))
    pace = float(rng.uniform(0.7, 4.0))
    plan = spherical_plan(joints, repeats, "planes" if order == "raster" else "shuffled", seed, pace)
    plan["temperature_c"] = room_temperature(rng, plan["time_s"])
    theta, velocity = (np.stack([plan[f"theta{i}_{u}"] for i in (1, 2)], axis=1) for u in ("rad", "rad_per_s"))
    exact, point = robot.truth(plan), robot.markers(theta)

    def by(changed: Callable[[Array], Array], steps: Array) -> Array:
        step = float(steps.max())
        return np.stack([(changed(s) - changed(-s)) / (2 * step) for s in steps], axis=2)

    scene = Scene(
        rng, plan["time_s"], plan["temperature_c"], np.zeros(len(theta)), theta, point, exact,
        by(lambda s: robot.pixels(theta + s), STEP_RAD * np.eye(2)),
        by(lambda s: robot.image(point + s), STEP_MM * np.eye(3)), velocity=velocity,
    )  # fmt: skip
    change = _sized(kind, scene, robot.fitted_directions(plan), noise_px * ratio)
    measured = exact + change + noise_px * rng.normal(size=exact.shape)
    columns = plan | {"u_px": measured[:, 0], "v_px": measured[:, 1]}
    return Unnamed(settings, {name: columns[name] for name in SPHERICAL_NAMES}, noise_px, SPHERICAL_KINDS[kind])


def _sized(kind: Kind, scene: Scene, fitted: Array, size: float) -> Array:
    """What the kind does (n, m), so that the fit leaves this RMS of it; drawn again where it would take all."""
    for _ in range(TRIALS):
        change = kind(scene)
        flat = change.ravel()
        left = flat - fitted @ (fitted.T @ flat)
        if np.linalg.norm(left) > LEAST_LEFT * np.linalg.norm(flat):
            return np.asarray(change * size / np.sqrt(np.mean(left**2)))
    raise ValueError(f"{kind.__name__} is absorbed by the geometry")
