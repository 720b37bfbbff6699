"""Worlds on which a verdict was seen to contradict its own numbers: a robot file, a run, and what is true there.

Each function takes a seed and makes one world with the second simulator. Nothing here judges: the tests do.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import ArrayLike, NDArray

import sherkit as sk
from second_simulator import (
    NOMINAL_CONFIG,
    Noise,
    Robot,
    draw_geometric_errors,
    draw_pose,
    grid,
    local_grid,
    make_plan,
    scaled_effect,
    simulate,
    truth,
    write_robot_toml,
)
from second_simulator.plans import Order
from second_simulator.spherical import SecondSpherical, Unmodelled, camera_facing, sphere_grid, spherical_plan

Floats = NDArray[np.float64]
Columns = dict[str, NDArray[Any]]
Settings = dict[str, Any]

NOISE_UM = 2.0
NOISE_PX = 0.1
GRID = grid(20.0, 8, (-20.0, 0.0, 20.0))


@dataclass(frozen=True, eq=False)
class Answer:
    """What a person is told: a diagnosis or, where none came, the error; and every sentence on the way there."""

    diagnosis: Any  # of sk.diagnosis.Diagnosis, or None
    sentences: tuple[str, ...]

    @property
    def verdict(self) -> str:
        return "error" if self.diagnosis is None else self.diagnosis.verdict

    def says(self, *words: tuple[str, ...]) -> bool:
        """Whether one sentence has a word of every group; case does not matter."""
        return any(
            all(any(word.lower() in sentence.lower() for word in group) for group in words)
            for sentence in self.sentences
        )

    def short(self) -> str:
        """One line for a table of outcomes."""
        if self.diagnosis is None:
            return "error: " + " ".join(self.sentences[-1].split())[-90:]
        d = self.diagnosis
        fall = " → ".join(f"{s.error.rms:.4g}" for s in d.steps)
        noise = float(np.sqrt(np.mean(np.square(list(d.noise.values())))))
        what = f": {', '.join(d.effects)}" if d.effects else ""
        p = "" if d.confirmed is None else f", confirmed p {d.confirmed:.2g}"
        return f"{d.verdict}{what}; held out {fall} {d.unit}, noise {noise:.3g} ({d.noise_origin}){p}"


def sentences_of(d: Any) -> tuple[str, ...]:
    """Everything that a diagnosis says in words."""
    return (*d.notes, *(str(check) for check in getattr(d, "checks", ())))


def heard(diagnose: Callable[[], Any]) -> Answer:
    """What a person hears who asks: what was warned of and the diagnosis, or the error in its place."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            d = diagnose()
        except sk.SherkitError as error:
            return Answer(None, (*(str(w.message) for w in warned), str(error)))
        except Exception as error:  # a crash is an outcome as well, and belongs in the table
            return Answer(None, (*(str(w.message) for w in warned), f"{type(error).__name__} {error}"))
    return Answer(d, (*(str(w.message) for w in warned), *sentences_of(d)))


@dataclass(frozen=True, eq=False)
class World:
    """``settings`` are the tables of the robot file, ``columns`` those of the run.

    ``noise`` is the sd of one reading in the unit of the readings as people read them (µm, px), whether or not the run
    tells; ``planted`` what is hidden; ``steps`` the effects that a person has added before asking.
    """

    settings: Settings
    columns: Columns
    noise: float
    planted: dict[str, Any] = field(default_factory=dict)
    steps: tuple[str, ...] = ()

    @cached_property
    def robot(self) -> Any:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "robot.toml"
            write_robot_toml(path, self.settings)
            return sk.load_robot(path)

    def study(self) -> sk.Study:
        study = sk.Study(self.robot, sk.from_frame(pl.DataFrame(self.columns)))
        for name in self.steps:
            study.add(name)
        return study

    def ask(self, seed: int = 0) -> Answer:
        """What a person hears who loads the robot, reads the run and asks for a diagnosis."""
        if self.steps:
            return heard(lambda: self.study().diagnose())
        return heard(lambda: sk.diagnose(sk.identify(self.robot, sk.from_frame(pl.DataFrame(self.columns))), seed=seed))


# -- the delta -----------------------------------------------------------------------------------------------------


def settings_without(*keys: str, base: Mapping[str, Any] = NOMINAL_CONFIG, **changed: Any) -> Settings:
    """Tables of a robot file without some keys, and with others changed, in whatever table they stand."""
    tables = deepcopy(dict(base))
    for table in tables.values():
        if isinstance(table, dict):
            for key in keys:
                table.pop(key, None)
            table.update({k: v for k, v in changed.items() if k in table})
    return {name: table for name, table in tables.items() if table != {}}


def delta_world(
    seed: int,
    scaled_um: Mapping[str, float] | None = None,
    settings: Settings | None = None,
    *,
    effects: Mapping[str, ArrayLike] | None = None,
    repeats: int = 3,
    points: Floats = GRID,
    noise_um: float = NOISE_UM,
    config: Mapping[str, Any] = NOMINAL_CONFIG,
    period_mm: float | None = None,
    steps: tuple[str, ...] = (),
    order: Order = "shuffled",
    own_axes: bool = False,
) -> World:
    """A run over ``points`` in this order. Of each ``scaled_um`` effect a geometric fit leaves that RMS.

    ``settings`` is the file that the person writes; the real robot is ``config`` with errors of its own, and its
    encoders have ``period_mm``. The instrument stands anywhere, unless it reads along the robot's ``own_axes``.
    """
    stands = {"sensor_pose": np.zeros(6) if own_axes else draw_pose(np.random.default_rng([seed, 8]))}
    robot = Robot.from_dict(config | ({"joints": {"pole_pitch_mm": period_mm}} if period_mm else {}))
    plan = make_plan(robot, points, repeats, order, seed)
    errors = draw_geometric_errors(np.random.default_rng([seed, 1]))
    planted: dict[str, Any] = dict(effects or {})
    for k, (name, rms_um) in enumerate((scaled_um or {}).items()):
        rng = np.random.default_rng([seed, 2, k])
        planted |= scaled_effect(robot, plan, name, rng, 1e-3 * rms_um, errors=errors, beside=stands)
    columns = simulate(robot, plan, errors, planted | stands, Noise(sigma_mm=1e-3 * noise_um), seed=1000 + seed)
    return World(settings or deepcopy(dict(config)), columns, noise_um, planted, steps)


def clean(seed: int) -> World:
    """Nothing hidden beyond the twelve parameters."""
    return delta_world(seed)


def pitch_left_out(seed: int, repeats: int = 3) -> World:
    """``pole_pitch_mm`` is not in the file (silently 1.0); a cyclic error of four times the noise."""
    return delta_world(seed, {"encoder_cyclic": 4 * NOISE_UM}, settings_without("pole_pitch_mm"), repeats=repeats)


def pitch_wrong(seed: int) -> World:
    """The file's pitch is 2.5 % too long; a cyclic error of four times the noise."""
    return delta_world(seed, {"encoder_cyclic": 4 * NOISE_UM}, settings_without(pole_pitch_mm=2.05))


def pitch_left_out_and_no_repeats(seed: int) -> World:
    """As above without repeats, so that nothing tells the noise."""
    return pitch_left_out(seed, repeats=1)


def cyclic_of_any_period(seed: int) -> World:
    """A cyclic error with a period of 0.7 to 20 mm (logarithmically even) that the file does not know; 400 poses at
    random, three times each."""
    rng = np.random.default_rng([seed, 7])
    period = float(0.7 * (20.0 / 0.7) ** rng.uniform())
    points = np.column_stack([rng.uniform(-20, 20, (400, 2)), rng.uniform(-20, 20, 400)])
    world = delta_world(
        seed, {"encoder_cyclic": 4 * NOISE_UM}, settings_without("pole_pitch_mm"), points=points, period_mm=period
    )
    world.planted["period_mm"] = period
    return world


def spacing_left_out(seed: int) -> World:
    """``rod_spacing_mm`` is not in the file (silently 0), so that unequal rods cannot be tried; they are there."""
    return delta_world(seed, {"rod_mismatch": 2 * NOISE_UM}, settings_without("rod_spacing_mm"), points=local_grid())


def pose_wrong_by_metres(seed: int) -> World:
    """One pose is off by three metres in all its repeats; else nothing is hidden."""
    world = delta_world(seed)
    pose = int(np.random.default_rng([seed, 4]).integers(1, len(GRID) + 1))
    world.columns["x_mm"] = world.columns["x_mm"] + 3000.0 * (world.columns["pose"] == pose)
    world.planted["wrong_poses"] = [pose]
    return world


def superfluous_effect(seed: int) -> World:
    """Leaning rails; the person added beam_alignment first and then the right one."""
    return delta_world(seed, {"rail_lean": 4 * NOISE_UM}, steps=("beam_alignment", "rail_lean"))


def twisted_limbs(seed: int) -> World:
    """The joint axes of each limb are not parallel."""
    return delta_world(seed, {"limb_twist": 2 * NOISE_UM})


def twisted_by_a_base_angle(seed: int) -> World:
    """What an error of the base angles does to a real machine: the axes at the carriages turn with their rails."""
    rng = np.random.default_rng([seed, 1])
    return delta_world(seed, effects={"limb_twist": rng.normal(0, np.deg2rad(0.5), 3)})


def yielding_drives(seed: int) -> World:
    """Carriages give way along their rails under their limbs' load."""
    return delta_world(seed, {"drive_compliance": 2 * NOISE_UM})


def printer_heights(seed: int) -> World:
    """A printer's probed bed: the joints where the nozzle touches, and a height that is 0.0 in every row.

    Its towers lean tangentially by 0.4°, the probe scatters by 20 µm, and there are no repeats.
    """
    config = deepcopy(NOMINAL_CONFIG)
    config["geometry"] |= {
        "base_radius_mm": [130.0] * 3, "rod_length_mm": [300.0] * 3, "target_offset_mm": [0.0, 0.0, 0.0],
    }  # fmt: skip
    del config["workspace"]["z_mm"]
    robot = Robot.from_dict(config)
    rng = np.random.default_rng([seed, 1])
    errors = draw_geometric_errors(rng)
    side = np.linspace(-70.0, 70.0, 15)
    x, y = (v.ravel() for v in np.meshgrid(side, side))
    on = np.hypot(x, y) <= 70.0
    plan = make_plan(robot, np.column_stack([x[on], y[on], np.zeros(on.sum())]), seed=seed)
    lean = {"rail_lean": np.tile([0.0, np.deg2rad(0.4)], 3)}
    for _ in range(6):
        height = truth(robot, plan, errors, lean)[:, 2]
        plan |= {f"q{k}_mm": plan[f"q{k}_mm"] - height for k in (1, 2, 3)}
    scatter = rng.normal(0, 0.02, on.sum())
    plan |= {f"q{k}_mm": plan[f"q{k}_mm"] + scatter for k in (1, 2, 3)}
    columns = {k: plan[k] for k in ("q1_mm", "q2_mm", "q3_mm")} | {"z_mm": np.zeros(on.sum())}
    # the printer carries its probe
    return World(config | {"sensor_pose": {"free": True, "turn_sd_deg": 0.0}}, columns, 20.0, lean)


# -- the spherical robot -------------------------------------------------------------------------------------------

SPHERICAL: Settings = {
    "kind": "spherical",
    "geometry": {"alpha_deg": 45.0, "beta_deg": 45.0, "radius_mm": 200.0, "gravity": [0.0, 0.6, -0.8]},
    "camera": {
        "size_px": [1280, 640], "focal_px": [710.0, 710.0], "phi_deg": 90.0, "gamma_deg": 45.0, "distance_mm": 446.2,
    },
}  # fmt: skip


def real_spherical(settings: Settings, seed: int) -> SecondSpherical:
    """The real robot behind a file: arcs and radius off by about a degree and 11 mm, the camera where it says."""
    g, c = settings["geometry"], settings["camera"]
    rng = np.random.default_rng([seed, 1])
    arcs = np.deg2rad([g["alpha_deg"], g["beta_deg"]]) + np.array([-0.02, 0.015]) * rng.uniform(0.3, 1.0, 2)
    centre = (np.array(c["size_px"]) - 1) / 2
    camera = camera_facing(
        np.deg2rad(c["phi_deg"]), np.deg2rad(c["gamma_deg"]), c["distance_mm"], [*c["focal_px"], *centre]
    )
    return SecondSpherical(*arcs, g["radius_mm"] * (1 + 0.05 * rng.uniform()), camera, g["gravity"], seed=seed)


def spherical_joints(settings: Settings, per_side: int) -> Floats:
    """Readings of a patch of the sphere in front of the camera, by the nominal robot."""
    g, c = settings["geometry"], settings["camera"]
    plain = SecondSpherical(np.deg2rad(g["alpha_deg"]), np.deg2rad(g["beta_deg"]), 1.0, np.zeros(15))
    phi, gamma = np.deg2rad(c["phi_deg"]), np.deg2rad(c["gamma_deg"])
    return plain.joints_at(sphere_grid((phi - 0.6, phi + 0.6), (gamma - 0.35, gamma + 0.35), per_side))


def spherical_world(
    seed: int,
    *,
    per_side: int = 10,
    repeats: int = 2,
    noise_px: float = NOISE_PX,
    unmodelled: Unmodelled | None = None,
    effects: Mapping[str, ArrayLike] | None = None,
    scaled: Mapping[str, float] | None = None,
    settings: Settings | None = None,
) -> World:
    """A patch of ``per_side``² poses in shuffled order, filmed in motion. Of each ``scaled`` effect a fit of α, β and
    R leaves that many times the noise."""
    settings = settings or deepcopy(SPHERICAL)
    robot = real_spherical(settings, seed)
    plan = spherical_plan(spherical_joints(settings, per_side), repeats, "shuffled", seed)
    planted: dict[str, Any] = dict(effects or {})
    for k, (name, ratio) in enumerate((scaled or {}).items()):
        planted |= robot.at_ratio(name, ratio, noise_px, plan, np.random.default_rng([seed, 2, k]))
    robot.effects = planted
    columns = robot.run(plan, noise_px=noise_px, seed=1000 + seed, unmodelled=unmodelled)
    return World(settings, columns, noise_px, planted | ({"unmodelled": unmodelled} if unmodelled else {}))


def spherical_clean(seed: int) -> World:
    """Nothing hidden beyond α, β and R."""
    return spherical_world(seed)


def needless_member(seed: int) -> World:
    """Flexure and a backlash that is half of it; seed 15 is a run on which a third effect joins that does nothing."""
    return spherical_world(seed, repeats=3, noise_px=0.05, scaled={"gravity_flexure": 2, "backlash": 1})


def spherical_sine(seed: int) -> World:
    """A sine of 3 px in u and v, of a period too short for the shapes that are tried; 100 poses, twice each."""
    rng = np.random.default_rng([seed, 5])
    sine = Unmodelled(
        sine_px=(3.0, 3.0), period_px=float(rng.uniform(12.0, 25.0)), phase_rad=float(rng.uniform(0.0, 6.28))
    )
    return spherical_world(seed, unmodelled=sine)


def spherical_scatter(seed: int) -> World:
    """The marker's centre is off by 0.4 px at each pose, alike in its repeats: four times the noise, and no shape."""
    return spherical_world(seed, unmodelled=Unmodelled(scatter_px=4 * NOISE_PX))


# -- a model of a user's own ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class WrongDerivative:
    """A turntable with an eccentric scale whose ``derivatives`` are not those of ``predict``.

    Reading = angle + offset + a sin(angle) + b sin(2 angle + 40 c); the derivative by c has the wrong sign.
    """

    wrong: bool = True
    parameters: tuple[sk.model.Parameter, ...] = tuple(
        sk.model.Parameter(name, name, "mrad", size)
        for name, size in (("offset", 1.0), ("a", 5.0), ("b", 5.0), ("c", 0.02))
    )

    def predict(self, data: sk.Measurements, values: Floats) -> Floats:
        angle = data["angle_rad"]
        offset, a, b, c = values
        shown = 1e3 * angle + offset + a * np.sin(angle) + (5.0 + b) * np.sin(2 * angle + 40.0 * c)
        return shown[:, None]

    def derivatives(self, data: sk.Measurements, values: Floats) -> Floats:
        angle = data["angle_rad"]
        _, _, b, c = values
        by_c = 40.0 * (5.0 + b) * np.cos(2 * angle + 40.0 * c) * (-1.0 if self.wrong else 1.0)
        columns = (np.ones_like(angle), np.sin(angle), np.sin(2 * angle + 40.0 * c), by_c)
        return np.stack(columns, axis=1)[:, None, :]

    def covariates(self, data: sk.Measurements) -> dict[str, Floats]:
        return {}


def turntable(seed: int, *, wrong: bool = True) -> sk.fit.Fit:
    """100 angles, three readings each with a noise of 0.2 mrad; fitted by a model whose derivative is wrong."""
    rng = np.random.default_rng([seed, 6])
    pose = np.repeat(np.arange(100), 3)
    angle = rng.uniform(-3.0, 3.0, 100)[pose]
    c = 0.02 * rng.uniform(0.8, 1.2)
    shown = 1e3 * angle + 1.0 + 4.0 * np.sin(angle) + 8.0 * np.sin(2 * angle + 40.0 * c)
    readings = (shown + 0.2 * rng.normal(size=300))[:, None]
    data = sk.data.from_arrays(place={"angle_rad": angle}, readings=readings, names=("shown",), unit="mrad", pose=pose)
    return sk.identify(WrongDerivative(wrong), data)


ROWS: dict[str, Callable[[int], World]] = {
    "pitch left out": pitch_left_out,
    "pitch 2.5 % wrong": pitch_wrong,
    "no repeats, no pitch": pitch_left_out_and_no_repeats,
    "rod spacing left out": spacing_left_out,
    "one pose wrong by metres": pose_wrong_by_metres,
    "superfluous effect first": superfluous_effect,
    "needless member": needless_member,
    "spherical sine": spherical_sine,
    "spherical scatter": spherical_scatter,
    "limb twist": twisted_limbs,
    "limb twist of a base angle": twisted_by_a_base_angle,
    "drive compliance": yielding_drives,
    "printer's heights": printer_heights,
}
