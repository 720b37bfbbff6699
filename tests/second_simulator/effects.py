"""Hidden physical effects. Parameters are flat arrays; all zero means no effect.

Joints, all evaluated at the reading q and added to it (v = (q - q_home) / 20 mm):
  joint_scale (3)          s_i (q_i - q_home_i), relative
  encoder_cyclic (6)       a1 b1 a2 b2 a3 b3, mm: a sin(2 pi q / pitch) + b cos(2 pi q / pitch)
  encoder_second (6)       the same with twice the phase: it goes with encoder_cyclic
  backlash (3)             b_i, mm: half of it in the direction of the joint's last motion
  joint_coupling (6) *     k12 k13 k21 k23 k31 k32, mm: q_i error = k_ij v_j v_i
  joint_crosstalk (6) *    same order, mm: q_i error = k_ij v_j
  joint_slip (4)           what joints 1, 2, 3 lost, mm, then the time in s after which they have
Mechanism:
  rail_lean (6)            radial and tangential lean of rails 1, 2, 3 in turn, rad
  rod_mismatch (3)         length difference of a limb's two rods, mm
  gravity_sag (3)          axial compliance of each limb under the platform's weight, mm/N
  limb_twist (3)           rad: the rod pair's axis at carriage i is turned by this about the vertical against the one
                           at the platform, so that the limb is no parallelogram and the platform tilts
  drive_compliance (3)     mm/N: carriage i gives way along its rail under the force that its limb pulls with
  link_growth (3)          1/degC of rods, frame, rails: rod lengths, base and platform radii, and heights of carriages
                           above the base, each times 1 + a (T - 20)
Measured point, all evaluated at the point p the mechanism reaches:
  thermal_growth (1)       a, 1/degC: a (T - 20) p
  drift (3)                mm/h, linear in time_s from its zero
  slip (4)                 step x y z in mm, then the time in s after which it is there
  thermal_shift (4)        mm/degC: k (S - 20), then the lag L in s of the stand's temperature S behind the room's
                           T: L dS/dt = T - S, and S = T when the run begins
  humidity (3) *           mm per %: v (humidity - 45)
  periodic_z (4) *         amplitude x y z in mm, then phase: amplitude sin(2 pi p_z / 7.3 + phase)
Sensor, whose scale says r where the point is at x after the effects above:
  sensor_pose (6)          rotation vector w, rad, and shift t, mm: the sensor sees the point x at s = exp(w) x + t
  sensor_slip (7)          what is added to sensor_pose, then the time in s after which it is
  sensor_drift (6)         rad/h and mm/h: what is added to sensor_pose in an hour, linear in time_s from its zero
  beam_alignment (9)       M by rows: r = (I + M) s
  sensor_linearity (3)     a_k, mm: a_k (r_k / 20 mm)^3 more is shown than r_k
Effects marked * are outside the catalogue a calibration is expected to know.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from .geometry import Array, Robot, radial, tangential

Columns = Mapping[str, NDArray[Any]]
Effects = Mapping[str, ArrayLike]

SPAN_MM = 20.0
PERIOD_Z_MM = 7.3
SHIFTED_MM = 300.0
STEPS_IN_TIME = 2**17
STILL_MM = 1e-9  # commanded heights that agree to rounding are no motion
PAIRS = (np.array([0, 0, 1, 1, 2, 2]), np.array([1, 2, 0, 2, 0, 1]))  # (driven, driving) joint


@dataclass(frozen=True)
class Effect:
    """Shape of an effect: its amplitudes come first, then ``fixed`` ones that never scale."""

    amplitudes: int
    typical: float  # order of magnitude of one amplitude, in its own unit
    positive: bool = False  # physically one-signed
    fixed: int = 0
    catalogued: bool = True
    goes_with: str = ""  # no cause of its own: asked for where that effect is

    @property
    def size(self) -> int:
        return self.amplitudes + self.fixed


EFFECTS: dict[str, Effect] = {
    "joint_scale": Effect(3, 1e-3),
    "encoder_cyclic": Effect(6, 5e-3),
    "encoder_second": Effect(6, 2e-3, goes_with="encoder_cyclic"),
    "backlash": Effect(3, 0.01, positive=True),
    "rail_lean": Effect(6, 1e-3),
    "rod_mismatch": Effect(3, 0.05),
    "gravity_sag": Effect(3, 0.01, positive=True),
    "thermal_growth": Effect(1, 1e-4),
    "drift": Effect(3, 0.02),
    "slip": Effect(3, 0.02, fixed=1),
    "joint_slip": Effect(3, 0.02, fixed=1),
    "thermal_shift": Effect(3, 0.01, fixed=1),
    "beam_alignment": Effect(9, 1e-3),
    "sensor_linearity": Effect(3, 0.01),
    "sensor_pose": Effect(6, 0.1),
    "sensor_slip": Effect(6, 0.005, fixed=1),
    "sensor_drift": Effect(6, 0.02),
    "humidity": Effect(3, 1e-3, catalogued=False),
    "joint_coupling": Effect(6, 0.01, catalogued=False),
    "joint_crosstalk": Effect(6, 0.01, catalogued=False),
    "periodic_z": Effect(3, 0.01, fixed=1, catalogued=False),
    "limb_twist": Effect(3, 5e-3),
    "drive_compliance": Effect(3, 0.01, positive=True),
    "link_growth": Effect(3, 1e-4),
}
CATALOGUE = tuple(name for name, effect in EFFECTS.items() if effect.catalogued and not effect.goes_with)
OUTSIDE_CATALOGUE = tuple(name for name, effect in EFFECTS.items() if not effect.catalogued)


def complete(effects: Effects | None) -> dict[str, Array]:
    """Parameters of every effect, zero where none are given."""
    given = effects or {}
    if unknown := set(given) - set(EFFECTS):
        raise ValueError(f"unknown effects {sorted(unknown)}")
    full = {name: np.zeros(effect.size) for name, effect in EFFECTS.items()}
    for name, value in given.items():
        full[name] = np.asarray(value, float).reshape(EFFECTS[name].size)
    return full


def draw_pose(rng: np.random.Generator) -> Array:
    """Where somebody has put an instrument (6,): any turn, rad, and within ± 300 mm along each axis."""
    return np.concatenate([Rotation.random(random_state=rng).as_rotvec(), rng.uniform(-SHIFTED_MM, SHIFTED_MM, 3)])


def draw_effect(name: str, rng: np.random.Generator, duration_s: float) -> Array:
    """Random parameters of typical size; a slip falls in the middle of the run."""
    effect = EFFECTS[name]
    if effect.positive:
        amplitudes = rng.uniform(0.5, 1.5, effect.amplitudes)
    else:
        amplitudes = rng.normal(size=effect.amplitudes)
    parameters = effect.typical * amplitudes
    if name in ("slip", "sensor_slip"):
        return np.append(parameters, duration_s * rng.uniform(0.3, 0.7))
    if name == "joint_slip":  # one motor stalls, not three at once
        return np.append(parameters * np.eye(3)[rng.integers(3)], duration_s * rng.uniform(0.3, 0.7))
    if name == "thermal_shift":
        return np.append(parameters, duration_s * rng.uniform(0.0, 0.3))
    if name == "periodic_z":
        return np.append(parameters, rng.uniform(0.0, 2 * np.pi))
    return parameters


def joint_readings(columns: Columns) -> Array:
    """Joint readings (n, 3), mm."""
    return np.stack([columns[f"q{i}_mm"] for i in (1, 2, 3)], axis=1)


def motion_direction(q: Array, time_s: Array) -> Array:
    """Direction (+1 or -1) of the last motion of each joint, (n, 3); +1 before any motion."""
    order = np.argsort(time_s, kind="stable")
    step = np.diff(q[order], axis=0, prepend=q[order[:1]])
    sign = np.where(np.abs(step) > STILL_MM, np.sign(step), 0.0)
    sign[0] = 1.0
    row = np.arange(len(q))[:, None]
    last_moved = np.maximum.accumulate(np.where(sign != 0, row, 0), axis=0)
    direction = np.empty_like(sign)
    direction[order] = np.take_along_axis(sign, last_moved, axis=0)
    return direction


def stand_temperature(time_s: Array, temperature_c: Array, lag_s: float) -> Array:
    """Temperature (n,) of what follows the room with a lag, by the trapezoidal rule on a fine grid of time."""
    if lag_s <= 0:
        return temperature_c
    order = np.argsort(time_s, kind="stable")
    fine = np.linspace(time_s.min(), time_s.max(), STEPS_IN_TIME)
    room = np.interp(fine, time_s[order], temperature_c[order])
    half = 0.5 * (fine[1] - fine[0]) / lag_s
    stand = room[0] + lfilter([half / (1 + half)] * 2, [1.0, -(1 - half) / (1 + half)], room - room[0])
    return np.interp(time_s, fine, stand)


def coupling_matrix(k: Array) -> Array:
    """Matrix whose row is the driven and column the driving joint."""
    matrix = np.zeros((3, 3))
    matrix[PAIRS] = k
    return matrix


def true_joints(robot: Robot, home: Array, columns: Columns, effects: Mapping[str, Array]) -> Array:
    """True carriage heights (n, 3), mm, behind the readings; ``robot`` carries the offsets."""
    q = joint_readings(columns)
    v = (q - home) / SPAN_MM
    phase = 2 * np.pi * q / robot.pole_pitch
    sine, cosine = effects["encoder_cyclic"].reshape(3, 2).T
    sine_2, cosine_2 = effects["encoder_second"].reshape(3, 2).T
    lost, when = effects["joint_slip"][:3], effects["joint_slip"][3]
    return (
        q
        + lost * (columns["time_s"][:, None] > when)
        + robot.joint_offset
        + effects["joint_scale"] * (q - home)
        + sine * np.sin(phase)
        + cosine * np.cos(phase)
        + sine_2 * np.sin(2 * phase)
        + cosine_2 * np.cos(2 * phase)
        + 0.5 * effects["backlash"] * motion_direction(q, columns["time_s"])
        + (v @ coupling_matrix(effects["joint_coupling"]).T) * v
        + v @ coupling_matrix(effects["joint_crosstalk"]).T
    )


def rail_directions(robot: Robot, lean: Array) -> Array:
    """Unit vectors (3, 3) along the leaning rails, upwards."""
    outward, along = radial(robot.base_angle), tangential(robot.base_angle)
    lean = lean.reshape(3, 2)
    rail = np.array([0.0, 0.0, 1.0]) + lean[:, :1] * outward + lean[:, 1:] * along
    return rail / np.linalg.norm(rail, axis=1, keepdims=True)


def carriage_points(robot: Robot, home: Array, q: Array, lean: Array) -> Array:
    """Carriages (n, 3, 3), mm: along leaning rails that pass their true foot at height q_home."""
    foot = robot.base_radius[:, None] * radial(robot.base_angle) + home[:, None] * np.array([0.0, 0.0, 1.0])
    return foot + (q - home)[..., None] * rail_directions(robot, lean)


def disturbed_point(point: Array, columns: Columns, effects: Mapping[str, Array]) -> Array:
    """Where the measured point really is, (n, 3), mm: growth, humidity, drift, slip, ripple."""
    time_s = columns["time_s"][:, None]
    warmth = columns["temperature_c"][:, None] - 20.0
    damp = columns["humidity_pct"][:, None] - 45.0
    ripple, phase = effects["periodic_z"][:3], effects["periodic_z"][3]
    step, when = effects["slip"][:3], effects["slip"][3]
    stand = stand_temperature(columns["time_s"], columns["temperature_c"], effects["thermal_shift"][3])
    return (
        point * (1 + effects["thermal_growth"] * warmth)
        + effects["humidity"] * damp
        + effects["drift"] * time_s / 3600.0
        + step * (time_s > when)
        + effects["thermal_shift"][:3] * (stand - 20.0)[:, None]
        + ripple * np.sin(2 * np.pi * point[:, 2:] / PERIOD_Z_MM + phase)
    )


def sensor_reading(x: Array, columns: Columns, effects: Mapping[str, Array]) -> Array:
    """What the sensor makes of the point x, (n, 3), mm."""
    beams = np.eye(3) + effects["beam_alignment"].reshape(3, 3)
    before, (*step, when) = effects["sensor_pose"], effects["sensor_slip"]
    time_s = columns["time_s"][:, None]
    stands = np.where(time_s > when, before + step, before) + effects["sensor_drift"] * time_s / 3600.0
    straight = (Rotation.from_rotvec(stands[:, :3]).apply(x) + stands[:, 3:]) @ beams.T
    return straight + effects["sensor_linearity"] * (straight / SPAN_MM) ** 3
