"""Machines before and after, by the second simulators: what changed, and where the sensor stands the second time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import sherkit as sk
import worlds
from driven_worlds import UNKNOWN
from second_arms import SecondArm
from second_simulator.effects import EFFECTS, draw_pose
from second_simulator.geometry import FITTED_SIZES, NOMINAL_CONFIG, Robot, draw_geometric_errors
from second_simulator.plans import make_plan
from second_simulator.simulate import scaled_effect, truth
from second_simulator.spherical import spherical_plan
from sherkit.model.kinds import robot_from_tables
from sherkit.robots.serial import postures
from test_arm_counted import arm_in
from test_serial import NOISE_MM, PLAIN, hidden_at
from test_spherical_discovery import NOISE_PX, PLANS, ROBOT, real_robot

Floats = NDArray[np.float64]

#: What may change of a delta: its fitted geometry, and the effects that are no matter of time or temperature.
PARAMETERS = tuple(f"{group}_{k}" for group in FITTED_SIZES for k in (1, 2, 3))
MECHANICAL = ("joint_scale", "encoder_cyclic", "backlash", "rail_lean", "rod_mismatch", "gravity_sag", "beam_alignment",
              "sensor_linearity", "limb_twist", "drive_compliance")  # fmt: skip


def somewhere(rng: np.random.Generator, count: int) -> Floats:
    """Places (n, 3), mm, over the workspace of the delta."""
    out = rng.uniform([-20, -20, -18], [20, 20, 18], (3 * count, 3))
    return out[np.hypot(out[:, 0], out[:, 1]) < 26.0][:count]


def unstationed(at: Floats, change: Floats) -> Floats:
    """What a turn and a shift of the sensor leave of a change (n, 3) of readings ``at`` (n, 3)."""
    arms = at - at.mean(axis=0)
    rigid = [np.tile(axis, (len(at), 1)).ravel() for axis in np.eye(3)]
    rigid += [np.cross(axis, arms).ravel() for axis in np.eye(3)]
    basis, _ = np.linalg.qr(np.stack(rigid, axis=1))
    flat = change.ravel()
    return np.asarray(flat - basis @ (basis.T @ flat)).reshape(change.shape)


class DeltaPair:
    """Two runs of one delta: poses, noise, order and room differ; ``changed`` names what did, as large as the geometry
    and the sensor's stand leave ``ratio`` noises of it in the second run."""

    def __init__(
        self, seed: int, changed: tuple[str, ...] = (), ratio: float = 2.0, *, poses: tuple[int, int] = (60, 40),
        stationed: bool = True, warmer_c: float = 0.0, unknown: str = "", noise_um: float = 2.0, growth: bool = False,
        places: Sequence[Mapping[str, float]] = (), repeats: int = 2, ratio_unknown: float | None = None,
    ) -> None:  # fmt: skip
        rng = np.random.default_rng([seed, 21])
        self.robot = robot_from_tables(deepcopy(NOMINAL_CONFIG), "nominal")
        self.real, self.noise = Robot.from_dict(NOMINAL_CONFIG), 1e-3 * noise_um
        self.unknown: Floats = np.zeros(3)
        self.errors = draw_geometric_errors(np.random.default_rng([seed, 1]))
        self.common: dict[str, Any] = {"thermal_growth": np.array([12e-6])} if growth or warmer_c else {}
        where = [somewhere(rng, n) for n in poses]
        if places:
            where[1] = np.array([[p["x_mm"], p["y_mm"], p["z_mm"]] for p in places])
        plans = [
            make_plan(self.real, at, n, "shuffled", seed + k)
            for k, (at, n) in enumerate(zip(where, (2, repeats), strict=True))
        ]
        plans[1]["temperature_c"] = plans[1]["temperature_c"] + warmer_c
        # somebody has put the instrument somewhere, and if it was stationed anew, elsewhere before the second run
        first, second = (draw_pose(np.random.default_rng([seed, 8, k])) for k in range(2))
        self.stands = (first, second if stationed else first)
        there: dict[str, Any] = {"sensor_pose": self.stands[1]}
        self.true: dict[str, float] = {}
        after, effects = dict(self.errors), dict(self.common)
        for k, name in enumerate(changed):
            if name in EFFECTS:
                drawn = np.random.default_rng([seed, 2, k])
                effects |= scaled_effect(
                    self.real, plans[1], name, drawn, ratio * self.noise, errors=self.errors, beside=there
                )
            else:
                step = 1e-3 if "angle" not in name else 1e-5
                by = self._left(plans[1], truth(self.real, plans[1], self.errors | {name: self.errors[name] + step})
                                - truth(self.real, plans[1], self.errors))  # fmt: skip
                self.true[name] = step * ratio * self.noise / by * rng.choice([-1.0, 1.0])
                after[name] += self.true[name]
        exact = [
            truth(self.real, plans[0], self.errors, self.common | {"sensor_pose": self.stands[0]}),
            truth(self.real, plans[1], after, effects | there),
        ]
        self.after = (plans[1], after, effects)
        if unknown:
            at = truth(self.real, plans[1], after, effects)
            moved = UNKNOWN[unknown](np.random.default_rng([seed, 3]))(plans[1], at)
            of_unknown = ratio if ratio_unknown is None else ratio_unknown
            self.unknown = moved * of_unknown * self.noise / self._left(plans[1], moved)
            exact[1] = exact[1] + Rotation.from_rotvec(self.stands[1][:3]).apply(self.unknown)
        self.runs = []
        for k, (plan, seen) in enumerate(zip(plans, exact, strict=True)):
            sigma = self.noise * (1.0 if not k else rng.uniform(0.8, 1.3))
            read = seen + sigma * rng.normal(size=seen.shape)
            self.runs.append({**plan, "x_mm": read[:, 0], "y_mm": read[:, 1], "z_mm": read[:, 2]})

    def run_with(
        self, moved: Mapping[str, float], seed: int, effects: Mapping[str, Sequence[float]] | None = None,
        foot_mm: float = 0.0,
    ) -> dict[str, Any]:  # fmt: skip
        """One more run of the robot as it was before, but for what has moved (mm, rad) and ``effects``; the sensor
        stands anew. Rails that lean stand on a foot that is so far above the home position."""
        if foot_mm and effects:
            lean = np.reshape(effects["rail_lean"], (3, 2))
            radius = NOMINAL_CONFIG["geometry"]["base_radius_mm"]
            by = {f"base_{what}_{k + 1}": -foot_mm * lean[k, j] / over for k in range(3)
                  for j, (what, over) in enumerate((("radius", 1.0), ("angle", radius[k])))}  # fmt: skip
            moved = {name: moved.get(name, 0.0) + by.get(name, 0.0) for name in {*moved, *by}}
        rng = np.random.default_rng([seed, 23])
        plan = make_plan(self.real, somewhere(rng, 30), 2, "shuffled", seed)
        errors = {name: value + moved.get(name, 0.0) for name, value in self.errors.items()}
        beside = {name: np.asarray(values, dtype=float) for name, values in (effects or {}).items()}
        seen = truth(self.real, plan, errors, {"sensor_pose": draw_pose(rng), **beside})
        read = seen + self.noise * rng.normal(size=seen.shape)
        return {**plan, "x_mm": read[:, 0], "y_mm": read[:, 1], "z_mm": read[:, 2]}

    def missed(self, deployed: sk.Calibration) -> Floats:
        """What the deployed model is truly off (n, 3), mm, in the second run, as the sensor of the first sees it."""
        joints = np.column_stack([self.runs[1][f"q{k}_mm"] for k in (1, 2, 3)])
        plan, errors, effects = self.after
        there = truth(self.real, plan, errors, effects | {"sensor_pose": self.stands[0]})
        there = there + Rotation.from_rotvec(self.stands[0][:3]).apply(self.unknown)
        return unstationed(there, there - deployed.forward_batch(joints, frame="sensor").values)

    def _left(self, plan: Mapping[str, Floats], change: Floats) -> float:
        """The root mean square that the sensor's stand leaves of a change of the readings."""
        return float(np.sqrt(np.mean(np.square(unstationed(truth(self.real, plan, self.errors), change)))))

    def compare(self, **settings: Any) -> sk.changes.Comparison:
        """As a user does."""
        return sk.compare(self.robot, self.runs, **settings)


def truth_of_change(pair: DeltaPair, name: str) -> float:
    """By how much a parameter has truly changed."""
    return pair.true[name]


class ArmPair:
    """Two runs of a UR5 before a tracker that was stationed anew; ``changed`` by ``size``, or as large as that stand
    leaves ``ratio`` noises of it in the second run."""

    def __init__(
        self, seed: int, changed: str = "", size: float = 0.0, poses: tuple[int, int] = (60, 50), ratio: float = 0.0
    ) -> None:
        with TemporaryDirectory() as folder:
            self.robot = arm_in(Path(folder))
        rng = np.random.default_rng([seed, 22])
        before = SecondArm.simulated(self.robot, seed, 1.0, PLAIN)
        where = [postures(self.robot, n, 0.8, seed + k) for k, n in enumerate(poses)]
        before, stand = replace(before, stand=draw_pose(rng)), draw_pose(rng)
        after = before
        if changed in ARM_MECHANICAL:
            drawn = hidden_at(self.robot, changed, ratio, seed)
            after = before.with_hidden(**drawn)
        elif changed and changed not in ARM_PARAMETERS:
            after = before.with_hidden(**{changed: size * rng.uniform(0.7, 1.3, 6)})
        elif changed:
            size = size or 1e-3 * ratio * NOISE_MM / self._left(before, _with(before, changed, 1e-3), where[1], seed)
            after = _with(before, changed, size)
        self.runs = [
            world.measure(at, seed=seed + 5 + k)
            for k, (world, at) in enumerate(zip((before, replace(after, stand=stand)), where, strict=True))
        ]

    @staticmethod
    def _left(before: SecondArm, after: SecondArm, where: Any, seed: int) -> float:
        """The root mean square that the tracker's stand leaves of a change of the readings."""
        exact = [replace(one, noise_mm=0.0).measure(where, seed=seed).readings[:, :3] for one in (before, after)]
        return float(np.sqrt(np.mean(np.square(unstationed(exact[0], exact[1] - exact[0])))))

    def compare(self) -> sk.changes.Comparison:
        """As a user does."""
        return sk.compare(self.robot, self.runs)


#: What may change of an arm: what is free of its geometry, and the effects that are no matter of time or temperature.
ARM_PARAMETERS = (*(f"offset_{k}" for k in (2, 3, 4, 5)), *(f"shift_x_{k}" for k in (2, 3, 4, 5, 6)),
                  "shift_y_5", "shift_y_6", *(f"tilt_x_{k}" for k in (2, 3, 4, 5, 6)), "tilt_y_3",
                  "tool_x", "tool_y", "tool_z")  # fmt: skip
ARM_MECHANICAL = ("joint_scale", "joint_coupling", "joint_compliance", "backlash", "encoder_eccentricity",
                  "encoder_cyclic", "sensor_scale", "sensor_linearity")  # fmt: skip


def _with(arm: SecondArm, name: str, by: float) -> SecondArm:
    """An arm of which one number of its geometry is another (rad or mm)."""
    what, *axis, last = name.split("_")
    field = {"offset": "offset", "shift": "shift_mm", "tilt": "tilt_rad", "tool": "tool_mm"}[what]
    shape: tuple[int, ...] = {"offset": (6,), "tool": (3,)}.get(what, (6, 2))
    value = np.array(np.broadcast_to(getattr(arm, field), shape), dtype=float)
    letters = {"x": 0, "y": 1, "z": 2}
    at = (letters[last],) if what == "tool" else (int(last) - 1, *(letters[a] for a in axis))
    value[at] += by
    return replace(arm, **{field: value})


#: What may change of the spherical robot: its geometry, and the effects that are no matter of time or temperature; an
#: error of the encoders needs a period, which the file of this robot does not have.
SPHERICAL_PARAMETERS = ("alpha", "beta", "radius")
SPHERICAL_MECHANICAL = ("joint_offset", "joint_scale", "encoder_eccentricity", "backlash", "unequal_limbs",
                        "axis_offset", "gravity_flexure", "marker_offset", "focal_length",
                        "lens_distortion")  # fmt: skip


class SphericalPair:
    """Two runs of the spherical robot before its camera, which was moved between them; ``changed`` is as large as the
    camera's pose leaves ``ratio`` noises of it in the second run."""

    def __init__(self, seed: int, changed: str = "", ratio: float = 2.0, poses: tuple[int, int] = (120, 80)) -> None:
        rng = np.random.default_rng([seed, 24])
        self.robot, before = ROBOT, real_robot(seed)
        plans = []
        for k, n in enumerate(poses):
            at = PLANS["whole"][rng.choice(len(PLANS["whole"]), n, replace=False)]
            plan = spherical_plan(at, 2, "shuffled", seed + k)
            plans.append(plan | {name: 0.0 * plan["time_s"] for name in plan if name.endswith("_per_s")})
        after = before
        if changed in SPHERICAL_MECHANICAL:
            after = before.changed(
                effects=before.at_ratio(changed, ratio, NOISE_PX, plans[1], rng, fitted=("sensor_pose",))
            )
        elif changed:
            field = {"alpha": "alpha_rad", "beta": "beta_rad", "radius": "radius_mm"}[changed]
            step = 1e-3 if field.endswith("mm") else 1e-5
            basis = before.fitted_directions(plans[1], ("sensor_pose",))
            moved = before.changed(**{field: getattr(before, field) + step})
            by = (moved.truth(plans[1]) - before.truth(plans[1])).ravel()
            left = by - basis @ (basis.T @ by)
            if np.linalg.norm(left) < 1e-3 * np.linalg.norm(by):
                raise ValueError(f"{changed} is absorbed by the pose of the camera: no scale leaves it")
            size = step * ratio * NOISE_PX / float(np.sqrt(np.mean(left**2))) * rng.choice([-1.0, 1.0])
            after = before.changed(**{field: getattr(before, field) + size})
        camera = after.camera + np.r_[np.zeros(9), rng.uniform(-5e-3, 5e-3, 3), rng.uniform(-3.0, 3.0, 3)]
        after = after.changed(camera=camera)
        self.runs = []
        for k, (world, plan) in enumerate(zip((before, after), plans, strict=True)):
            columns = world.run(plan, noise_px=NOISE_PX, seed=1000 + 2 * seed + k)
            self.runs.append(sk.from_frame(pl.DataFrame(columns)))

    def compare(self) -> sk.changes.Comparison:
        """As a user does."""
        return sk.compare(self.robot, self.runs)


#: What is wrong with a run, as factors of its coordinates, and a word on it.
MISTAKES = [([1 / 25.4] * 3, "inches"), ([1.0, 1.0, -1.0], "left-handed")]


def thirds(factor: list[float]) -> tuple[Any, list[pl.DataFrame]]:
    """A robot and three runs of it, the last with a mistake."""
    world = worlds.clean(2)
    every, poses = pl.DataFrame(world.columns), np.unique(world.columns["pose"])
    runs = [every.filter(pl.col("pose").is_in(poses[k::3].tolist())) for k in range(3)]
    axes = ("x_mm", "y_mm", "z_mm")
    runs[2] = runs[2].with_columns(pl.col(axis) * by for axis, by in zip(axes, factor, strict=True))
    return world.robot, runs
