"""Runs of the simulated robot, their noise-free truth, and effects of a prescribed size."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .effects import (
    EFFECTS,
    SPAN_MM,
    Columns,
    Effects,
    carriage_points,
    complete,
    disturbed_point,
    draw_effect,
    joint_readings,
    rail_directions,
    sensor_reading,
    true_joints,
)
from .geometry import FITTED_SIZES, Array, Errors, Robot, inverse_kinematics, with_errors
from .noise import Noise
from .plans import COLUMN_NAMES, make_plan
from .solve import Limbs, given_way, solve_pose

STEP = 1e-3  # of the central differences, mm; angles move their carriage by as much
RANK_TOLERANCE = 1e-7  # above difference noise (1e-9), below any real singular value
SCALE_TOLERANCE = 1e-3
MAX_RESCALINGS = 60
MAX_FACTOR = 2.0  # steeply nonlinear effects overshoot to where no pose exists


def platform_pose(
    robot: Robot, columns: Columns, errors: Errors | None = None, effects: Effects | None = None
) -> tuple[Array, Array, Array]:
    """Carriages (n, 3, 3) under load, platform centres (n, 3) in mm and rotation matrices (n, 3, 3)."""
    full = complete(effects)
    real = with_errors(robot, errors)
    home = inverse_kinematics(robot, np.zeros(3))[0]
    joints = true_joints(real, home, columns, full)
    if not full["link_growth"].any():
        return _pose_of(real, home, joints, full)
    rods, frame, rails = 1 + full["link_growth"][:, None] * (columns["temperature_c"] - 20.0)
    each = []
    for k, q in enumerate(joints):  # every row has a robot of its own
        radii = {"base_radius": real.base_radius * frame[k], "platform_radius": real.platform_radius * frame[k]}
        larger = replace(real, rod_length=real.rod_length * rods[k], **radii)
        each.append(_pose_of(larger, home * rails[k], rails[k] * q[None], full))
    carriages, centres, turns = zip(*each, strict=True)
    return np.concatenate(carriages), np.concatenate(centres), np.concatenate(turns)


def _pose_of(real: Robot, home: Array, joints: Array, full: dict[str, Array]) -> tuple[Array, Array, Array]:
    """The same of a robot that is the same at all rows."""
    # Repeats of a pose share their mechanism: each distinct one is solved once.
    distinct, row = np.unique(joints, axis=0, return_inverse=True)
    carriages = carriage_points(real, home, distinct, full["rail_lean"])
    limbs = Limbs(
        full["rod_mismatch"], full["gravity_sag"], full["limb_twist"], full["drive_compliance"],
        rail_directions(real, full["rail_lean"]),
    )  # fmt: skip
    centre, turn = solve_pose(real, carriages, limbs)
    loaded, _ = given_way(real, limbs, carriages, centre, turn)
    return loaded[row], centre[row], turn[row]


def truth(robot: Robot, columns: Columns, errors: Errors | None = None, effects: Effects | None = None) -> Array:
    """Noise-free sensor readings (n, 3), mm, for the rows of a plan or of a simulated run."""
    full = complete(effects)
    return sensor_reading(_target(robot, columns, errors, full), columns, full)


def _target(robot: Robot, columns: Columns, errors: Errors | None, full: Effects) -> Array:
    """Where the measured point is (n, 3), mm, whatever the sensor makes of it."""
    _, centre, turn = platform_pose(robot, columns, errors, full)
    return disturbed_point(centre + turn @ robot.target_offset, columns, full)


def simulate(
    robot: Robot,
    plan: Columns | Array,
    errors: Errors | None = None,
    effects: Effects | None = None,
    noise: Noise | float = 0.0,
    seed: int = 0,
    encoder_step_mm: float = 0.0,
) -> dict[str, NDArray[Any]]:
    """Columns of a measurement file, in the plan's row order.

    ``plan`` comes from ``make_plan``; points (n, 3) in mm are visited once each, as they stand.
    A number for ``noise`` is a gaussian sd per axis in mm. ``seed`` rules the noise alone: the
    plan has its own. A nonzero ``encoder_step_mm`` rounds the readings in the file; the robot
    still goes to the unrounded ones.
    """
    if isinstance(plan, np.ndarray):
        plan = make_plan(robot, plan)
    if not isinstance(noise, Noise):
        noise = Noise(sigma_mm=noise)
    exact = truth(robot, plan, errors, effects)
    rng = np.random.default_rng(seed)
    measured = exact + noise.draw(rng, exact, plan["time_s"], robot.workspace_radius)
    columns = {**plan, "x_mm": measured[:, 0], "y_mm": measured[:, 1], "z_mm": measured[:, 2]}
    if encoder_step_mm:
        for name in ("q1_mm", "q2_mm", "q3_mm"):
            columns[name] = encoder_step_mm * np.round(columns[name] / encoder_step_mm)
    return {name: columns[name] for name in COLUMN_NAMES}


def fitted_directions(
    robot: Robot, columns: Columns, errors: Errors | None = None, beside: Effects | None = None
) -> Array:
    """Orthonormal basis (3 n, rank) of what 12 geometric parameters and the pose of the sensor can do.

    Derivatives are central differences of this simulator at ``errors`` and where the sensor of ``beside`` stands. A
    shift along z equals a common joint offset, a turn about z common base angles, so the rank is below 18.
    """
    distinct, row = np.unique(joint_readings(columns), axis=0, return_inverse=True)
    still = {name: np.zeros(len(distinct)) for name in ("time_s", "temperature_c", "humidity_pct")}
    poses = still | {f"q{i + 1}_mm": distinct[:, i] for i in range(3)}
    base = dict(errors or {})
    derivatives = []
    for name in (f"{group}_{i}" for group in FITTED_SIZES for i in (1, 2, 3)):
        step = STEP / robot.base_radius[0] if "angle" in name else STEP
        ahead, behind = (
            truth(robot, poses, base | {name: base.get(name, 0.0) + change}, beside) for change in (step, -step)
        )
        derivatives.append(((ahead - behind) / (2 * step))[row].ravel())
    full = complete(beside)
    target = _target(robot, poses, base, full)
    for axis in np.eye(6) * ([STEP / SPAN_MM] * 3 + [STEP] * 3):
        ahead, behind = (
            sensor_reading(target, poses, full | {"sensor_pose": full["sensor_pose"] + by}) for by in (axis, -axis)
        )
        derivatives.append(((ahead - behind) / (2 * axis.sum()))[row].ravel())
    jacobian = np.stack(derivatives, axis=1)
    jacobian /= np.linalg.norm(jacobian, axis=0)
    basis, size, _ = np.linalg.svd(jacobian, full_matrices=False)
    return basis[:, size > RANK_TOLERANCE * size[0]]


def scaled_effect(
    robot: Robot,
    plan: Columns,
    name: str,
    rng: np.random.Generator,
    target_rms: float,
    fitted: Literal["geometric", "none"] = "geometric",
    errors: Errors | None = None,
    beside: Effects | None = None,
) -> dict[str, Array]:
    """Random parameters of one effect, ``{name: parameters}``, sized by what a fit leaves of it.

    ``beside`` is what the robot and its instruments have anyway, such as where the sensor stands.

    The RMS over all rows and axes (mm) of the noise-free change of the readings, less its linear
    least-squares fit by ``fitted_directions`` (or whole, with "none"), equals ``target_rms``.
    Large effects are not proportional to their parameters, so rescaling repeats, by the power law
    through the last two trials.
    """
    basis = np.zeros((3 * len(plan["time_s"]), 0))
    if fitted == "geometric":
        basis = fitted_directions(robot, plan, errors, beside)
    without = truth(robot, plan, errors, beside)
    parameters = draw_effect(name, rng, float(plan["time_s"].max()))
    rms, factor, power = 0.0, 1.0, 1.0
    for _ in range(MAX_RESCALINGS):
        change = (truth(robot, plan, errors, {**(beside or {}), name: parameters}) - without).ravel()
        left = change - basis @ (basis.T @ change)
        if np.linalg.norm(left) < 1e-6 * np.linalg.norm(change):
            raise ValueError(f"{name} is absorbed by the fitted parameters: no scale leaves it")
        last, rms = rms, float(np.sqrt(np.mean(left**2)))
        if abs(target_rms / rms - 1) < SCALE_TOLERANCE:
            return {name: parameters}
        if last:
            power = float(np.clip(np.log(rms / last) / np.log(factor), 0.5, 10.0))
        factor = min((target_rms / rms) ** (1 / power), MAX_FACTOR)
        parameters[: EFFECTS[name].amplitudes] *= factor
    raise RuntimeError(f"{name} does not reach {target_rms} mm")
