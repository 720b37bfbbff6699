"""Set-ups on which a promised accuracy is tried: what was measured, what was hidden, what the person fitted.

Each run is made by the second simulator, and so are the readings that judge it: the robot is sent where the calibration
says, at places that were not measured, after the run and from either side.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

import sherkit as sk
from second_simulator import NOMINAL_CONFIG, Robot, draw_geometric_errors, grid, make_plan, simulate
from second_simulator.effects import draw_effect, motion_direction
from second_simulator.spherical import draw_spherical_effect, sphere_grid, spherical_plan
from sherkit.calibration import Result
from sherkit.fit.hold_out import hold_out
from sherkit.robots.calibrated import calibration_class
from sherkit.robots.calibration_run import CalibrationRun
from worlds import SPHERICAL, World, real_spherical, settings_without

Floats = NDArray[np.float64]
Poses = Callable[[int], Floats]

#: The box, mm, or patch about its middle, rad, from which places are drawn.
HALF_MM = 19.0
HALF_RAD = (0.55, 0.3)
MIDDLE_RAD = np.array([np.pi / 2, np.pi / 4])
NOISE_UM = 2.0
NOISE_PX = 0.1
#: Visits, from whatever side, of which the mean is taken.
_VISITS = 8
#: How well it is known where the camera stands, as docs/spherical.md has it: turns, rad, and shifts, mm.
_STANDS = (np.deg2rad(0.1), 1.0)


@dataclass(frozen=True)
class SetUp:
    """``poses`` gives points (n, 3), mm, or directions (n, 2), rad, for a seed; ``hidden`` effects are there at
    plausible size (times ``times``), ``fitted`` ones are in the model. ``period`` is that of the encoders, mm or waves
    per turn; ``in_file`` says whether the robot file has it, ``period_known`` that it is not searched for. ``aliased``:
    the poses cannot show what is hidden."""

    name: str
    robot: str
    poses: Poses
    hidden: tuple[str, ...] = ()
    fitted: tuple[str, ...] = ()
    noise: float = 1.0
    repeats: int = 2
    period: float = 2.0
    in_file: bool = True
    times: float = 1.0
    aliased: bool = False
    period_known: bool = False
    calibrate: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Kept:
    """How far off the mean of many visits was (n,), mm, at each place, and the ``radius`` and ``addition`` (n,), mm,
    promised; how far off it was ``read`` there (n,), mm, and what was promised of a ``visit`` (n,), mm."""

    off: Floats
    radius: Floats
    addition: Floats
    read: Floats
    visit: Floats

    @property
    def by_radius(self) -> float:
        """Share of the places at which the radius alone holds."""
        return float(np.mean(self.off <= self.radius))

    @property
    def whole(self) -> float:
        """Share of the places at which radius and addition together hold."""
        return float(np.mean(self.off <= self.radius + self.addition))

    @property
    def by_visit(self) -> float:
        """Share of single readings that lie within what was promised of a visit."""
        return float(np.mean(self.read <= self.visit))


def kept(set_up: SetUp, seeds: range, places: int = 100) -> Kept:
    """Runs, calibrations and fresh readings of these seeds, together."""
    judge = {"delta": of_delta, "spherical": of_spherical}[set_up.robot]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sk.errors.SherkitWarning)
        each = [judge(set_up, seed, places) for seed in seeds]
    return Kept(*(np.concatenate([getattr(one, name) for one in each]) for name in Kept.__annotations__))


def calibrated(set_up: SetUp, world: World) -> Any:
    """As a person calibrates who knows what to fit, and the period where the file has it."""
    run = sk.from_frame(pl.DataFrame(world.columns))
    if set_up.fitted and set_up.period_known:
        fit = sk.identify(world.robot, run, effects=list(set_up.fitted))
        whole = CalibrationRun(fit, hold_out(fit.model, run).residuals)
        return Result(whole, None, calibration_class(world.robot).from_runs(whole))
    return sk.calibrate(world.robot, run, effects=list(set_up.fitted), **set_up.calibrate)


def judged(calibration: Any, x: Floats, missed: Callable[[Any, float], Floats], noise: float, seed: int) -> Kept:
    """``missed`` gives what places are missed by (n, d), mm, that are driven to in an order, read with a noise."""
    promised = calibration.predicted_accuracies(x)
    mean = np.zeros((len(x), x.shape[1]))
    for visit in range(_VISITS):
        order = np.random.default_rng([seed, 4, visit]).permutation(len(x))
        mean[order] += missed(order, 0.0) / _VISITS
    off, read = (np.linalg.norm(one, axis=1) for one in (mean, missed(np.arange(len(x)), noise)))
    return Kept(off, promised.radius_mm, promised.addition_mm, read, promised.visit_mm)


# -- the delta -----------------------------------------------------------------------------------------------------


def of_delta(set_up: SetUp, seed: int, places: int) -> Kept:
    robot = Robot.from_dict(NOMINAL_CONFIG | {"joints": {"pole_pitch_mm": set_up.period}})
    settings = deepcopy(dict(NOMINAL_CONFIG)) if set_up.in_file else settings_without("pole_pitch_mm")
    if set_up.in_file:
        settings["joints"] = {"pole_pitch_mm": set_up.period}
    plan = make_plan(robot, set_up.poses(seed), set_up.repeats, "shuffled", seed)
    rng = np.random.default_rng([seed, 1])
    errors = draw_geometric_errors(rng)
    end = float(plan["time_s"][-1])
    effects = {name: set_up.times * draw_effect(name, rng, end) for name in set_up.hidden}
    noise = 1e-3 * NOISE_UM * set_up.noise
    run = simulate(robot, plan, errors, effects, noise, seed)
    world = World(settings, run, 1e3 * noise)
    made = calibrated(set_up, world).calibration
    x = rng.uniform(-HALF_MM, HALF_MM, (places, 3))
    joints = made.inverse_batch(x).require()

    def missed(order: Any, sigma: float) -> Floats:
        """What the places are missed by (n, 3), mm, driven to in this order just after the run, in a room that is as it
        was."""
        there = make_plan(robot, x[order], seed=seed)
        there |= {f"q{k + 1}_mm": joints[order, k] for k in range(3)}
        there["time_s"] = end + 1e-3 * there["time_s"]
        there["temperature_c"] = np.full(places, plan["temperature_c"].mean())
        read = simulate(robot, there, errors, effects, sigma, seed + 1000)
        return np.column_stack([read[f"{axis}_mm"] for axis in "xyz"]) - x[order]

    return judged(made, x, missed, noise, seed)


def box(count: int) -> Poses:
    """Places at random, others for each seed."""
    return lambda seed: np.random.default_rng([seed, 2]).uniform(-20.0, 20.0, (count, 3))


def planes(per_side: int, heights: int = 3) -> Poses:
    """A square grid on planes."""
    return lambda _: grid(20.0, per_side, tuple(np.linspace(-20.0, 20.0, heights)))


def jittered(poses: Poses, by: float) -> Poses:
    """Each place moved at random by as much."""

    def moved(seed: int) -> Floats:
        at = poses(seed)
        return at + np.random.default_rng([seed, 3]).uniform(-by, by, at.shape)

    return moved


@cache
def _drawn() -> Any:
    return World(dict(NOMINAL_CONFIG), {}, 0.0).robot


def even_joints(step_mm: float, per_joint: int = 5) -> Poses:
    """Places at which every joint stands at a multiple of a step from the middle."""

    def places(_: int) -> Floats:
        robot = _drawn()
        steps = step_mm * (np.arange(per_joint) - per_joint // 2)
        joints = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        return np.asarray(robot.forward_batch(robot.inverse(np.zeros(3)) + joints).require())

    return places


# -- the spherical robot -------------------------------------------------------------------------------------------


def of_spherical(set_up: SetUp, seed: int, places: int) -> Kept:
    robot = real_spherical(SPHERICAL, seed)
    plain = real_spherical(SPHERICAL, seed).changed(alpha_rad=np.pi / 4, beta_rad=np.pi / 4)
    plan = spherical_plan(plain.joints_at(set_up.poses(seed)), set_up.repeats, "shuffled", seed)
    rng = np.random.default_rng([seed, 1])
    end = float(plan["time_s"][-1])
    effects = {name: set_up.times * draw_spherical_effect(name, rng) for name in set_up.hidden}
    if "encoder_cyclic" in effects:
        effects["encoder_cyclic"][-1] = set_up.period
    for name in {"slip", "sensor_slip"} & set(effects):
        effects[name][-1] = 0.5 * end
    # the camera stands as well as its file says that this is known
    stands = np.random.default_rng([seed, 5]).normal(0.0, np.repeat(_STANDS, 3))
    robot.effects = {"sensor_pose": stands} | effects
    noise = NOISE_PX * set_up.noise
    run = robot.run(plan, noise_px=noise, seed=1000 + seed)
    world = World(deepcopy(SPHERICAL), run, noise)
    result = calibrated(set_up, world)
    made = result.calibration
    x = MIDDLE_RAD + rng.uniform(-1.0, 1.0, (places, 2)) * HALF_RAD
    joints = made.inverse_batch(x).require()
    fit = result.whole.fit

    # where the tool ends, whatever holds the marker
    tool = robot.changed(effects={name: size for name, size in effects.items() if name != "marker_offset"})

    def missed(order: Any, sigma: float) -> Floats:
        """What the tool points beside, as mm across it (n, 2), at rest just after the run and whatever the camera made
        of it, with the noise of a picture."""
        there = spherical_plan(joints[order], seed=seed)
        now = end + 1e-3 * there["time_s"]
        at = tool.angles(
            joints[order],
            direction=motion_direction(joints[order], now),
            velocity=np.zeros((places, 2)),
            time_s=now,
            temperature_c=np.full(places, plan["temperature_c"].mean()),
        )
        off = (at - x[order]) * np.column_stack([np.sin(at[:, 1]), np.ones(places)])
        rows = sk.from_frame(pl.DataFrame(robot.run(there, seed=0)))
        seen = sigma * np.random.default_rng([2000 + seed, 1]).normal(size=(places, 2, 1))
        noisy = made.carried(joints[order], fit.model.linearised(rows, fit.values).inputs, seen)
        return np.asarray(made.radius_mm * (off + noisy[:, :, 0]))

    return judged(made, x, missed, noise, seed)


def patch(per_side: int) -> Poses:
    """A grid of directions."""
    (phi, gamma), (half_phi, half_gamma) = MIDDLE_RAD, (0.6, 0.35)
    return lambda _: sphere_grid((phi - half_phi, phi + half_phi), (gamma - half_gamma, gamma + half_gamma), per_side)


def directions(count: int) -> Poses:
    """Directions at random, others for each seed."""
    return lambda seed: MIDDLE_RAD + np.random.default_rng([seed, 2]).uniform(-1.0, 1.0, (count, 2)) * (0.6, 0.35)


def even_angles(per_turn: int, per_joint: int = 7) -> Poses:
    """Directions at which both joints stand at a multiple of a part of a turn from the middle."""

    def places(_: int) -> Floats:
        robot = World(deepcopy(SPHERICAL), {}, 0.0).robot
        steps = 2.0 * np.pi / per_turn * (np.arange(per_joint) - per_joint // 2)
        joints = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        middle = 2.0 * np.pi / per_turn * np.round(robot.inverse(MIDDLE_RAD) * per_turn / (2.0 * np.pi))
        made = robot.forward_batch(middle + joints)
        return np.asarray(made.values[made.reached])

    return places


# -- the list ------------------------------------------------------------------------------------------------------

_DELTA_EFFECTS = (
    "joint_scale", "encoder_cyclic", "backlash", "rail_lean", "rod_mismatch", "gravity_sag", "drive_compliance",
    "limb_twist", "thermal_growth", "drift", "slip", "joint_slip", "beam_alignment", "sensor_linearity",
)  # fmt: skip
_SPHERICAL_EFFECTS = (
    "joint_scale", "encoder_eccentricity", "encoder_cyclic", "backlash", "unequal_limbs", "axis_offset",
    "gravity_flexure", "marker_offset", "focal_length", "lens_distortion",
)  # fmt: skip
_RIPPLE = ("encoder_cyclic",)
_SPARSE = planes(7)
_PLAIN = {"correction": "none"}
_TENTH = even_angles(36)
_FIVE = even_joints(5.0)

SET_UPS: tuple[SetUp, ...] = (
    # nothing hidden: poses, repeats, noise
    SetUp("delta, grid of 147", "delta", _SPARSE),
    SetUp("delta, grid of 48", "delta", planes(4)),
    SetUp("delta, grid of 588", "delta", planes(14)),
    SetUp("delta, grid of 147, jittered", "delta", jittered(_SPARSE, 3.0)),
    SetUp("delta, 12 poses at random", "delta", box(12)),
    SetUp("delta, 20 poses at random", "delta", box(20)),
    SetUp("delta, 60 poses at random, no repeats", "delta", box(60), repeats=1),
    SetUp("delta, 60 poses at random, 5 repeats", "delta", box(60), repeats=5),
    SetUp("delta, 60 poses at random, ten times the noise", "delta", box(60), noise=10.0),
    # each effect left in, and fitted
    *(SetUp(f"delta, {e} left in", "delta", box(120), (e,)) for e in _DELTA_EFFECTS),
    *(SetUp(f"delta, {e} fitted", "delta", box(120), (e,), (e,)) for e in _DELTA_EFFECTS),
    SetUp("delta, rail_lean left in, grid of 147", "delta", _SPARSE, ("rail_lean",)),
    SetUp("delta, rail_lean left in, 20 poses", "delta", box(20), ("rail_lean",)),
    SetUp("delta, backlash left in, grid of 75", "delta", planes(5), ("backlash",), calibrate=_PLAIN),
    # ripples that the grid aliases
    SetUp("delta, 2 mm ripple, 6.7 mm grid", "delta", _SPARSE, _RIPPLE, aliased=True),
    SetUp("delta, 2 mm ripple × 10, 6.7 mm grid", "delta", _SPARSE, _RIPPLE, times=10.0, aliased=True),
    SetUp("delta, 2 mm ripple, 6.7 mm grid, pitch unknown", "delta", _SPARSE, _RIPPLE, in_file=False, aliased=True),
    SetUp("delta, 2 mm ripple, 6.7 mm grid, no correction", "delta", _SPARSE, _RIPPLE, calibrate=_PLAIN),
    SetUp("delta, 2 mm ripple, 6.7 mm grid jittered by 3 mm", "delta", jittered(_SPARSE, 3.0), _RIPPLE),
    SetUp("delta, 2 mm ripple, 3.1 mm grid", "delta", planes(14), _RIPPLE),
    SetUp("delta, 5 mm ripple, joints 5 mm apart", "delta", _FIVE, _RIPPLE, period=5.0, in_file=False, aliased=True),
    SetUp("delta, 2.5 mm ripple, joints 5 mm apart", "delta", _FIVE, _RIPPLE, period=2.5, aliased=True),
    SetUp("delta, 2 mm ripple, joints 6 mm apart, noisy", "delta", even_joints(6.0), _RIPPLE, noise=10.0, aliased=True),
    SetUp(
        "delta, 5 mm ripple fitted, joints 5 mm apart", "delta", _FIVE, _RIPPLE, _RIPPLE, period=5.0, aliased=True,
        period_known=True,
    ),
    # the spherical robot
    SetUp("spherical, grid of 100", "spherical", patch(10)),
    SetUp("spherical, grid of 25", "spherical", patch(5)),
    SetUp("spherical, 12 poses at random", "spherical", directions(12)),
    SetUp("spherical, 60 poses at random, no repeats", "spherical", directions(60), repeats=1),
    SetUp("spherical, 60 poses at random, ten times the noise", "spherical", directions(60), noise=10.0),
    SetUp("spherical, camera elsewhere", "spherical", directions(100), ("sensor_pose",), period=20.0),
    *(SetUp(f"spherical, {e} left in", "spherical", directions(100), (e,), period=20.0) for e in _SPHERICAL_EFFECTS),
    *(
        SetUp(f"spherical, {e} fitted", "spherical", directions(100), (e,), (e,), period=20.0)
        for e in _SPHERICAL_EFFECTS
        if e != "encoder_cyclic"
    ),
    SetUp("spherical, 36 waves per turn, joints 10° apart", "spherical", _TENTH, _RIPPLE, period=36.0, aliased=True),
    SetUp("spherical, 72 waves per turn, joints 10° apart", "spherical", _TENTH, _RIPPLE, period=72.0, aliased=True),
    SetUp("spherical, 36 waves per turn, jittered", "spherical", jittered(_TENTH, 0.05), _RIPPLE, period=36.0),
)  # fmt: skip
