"""Mistakes that people make when they set up a robot and a run, as changes of a clean world.

Each has key words: a right answer has one sentence that holds a word of every group, so that it says what to change.
The robots are random ones without symmetry: on a symmetric delta joints that are swapped cyclically and a frame turned
by 120° are the same statement, and so are two swapped joints and a mirror.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from second_simulator import NOMINAL_CONFIG, Noise, Robot, draw_geometric_errors, grid, make_plan, simulate
from worlds import SPHERICAL, Settings, World, real_spherical, spherical_world

Words = tuple[tuple[str, ...], ...]
INCH_MM = 25.4
JOINTS = {"delta": ("q1_mm", "q2_mm", "q3_mm"), "spherical": ("theta1_rad", "theta2_rad")}
READINGS = {"delta": ("x_mm", "y_mm", "z_mm"), "spherical": ("u_px", "v_px")}
SIGMA_MM = 0.005
#: How far a carriage stops from where it was sent, sd: ten times the noise of the sensor.
FOLLOWING_MM = 0.05
COMMANDED = "_commanded"  # a column kept beside the run for the mistake that needs it; it is in no file

SWAPPED = ("swap", "exchang", "interchang", "permut", "order of")
MIRRORED = ("mirror", "negat", "sign", "other way", "reversed", "opposite")


@dataclass(frozen=True)
class Mistake:
    """``change`` makes the mistake in a clean world; ``words`` are those of a right answer."""

    name: str
    words: Words
    change: Callable[[World], World]


# -- robots and clean runs -----------------------------------------------------------------------------------------


def random_delta(seed: int) -> Settings:
    """Tables of a delta that a workshop could build, no limb like another; limbs count anticlockwise."""
    rng = np.random.default_rng([seed, 20])
    base, platform = rng.uniform(70.0, 130.0), rng.uniform(20.0, 40.0)
    angle = rng.uniform(0.0, 360.0) + np.array([0.0, 120.0, 240.0]) + rng.uniform(-12.0, 12.0, 3)
    base_radius = base * rng.uniform(0.9, 1.1, 3)
    config = deepcopy(NOMINAL_CONFIG)
    config["geometry"] = {
        "base_radius_mm": base_radius.tolist(),
        "base_angle_deg": (angle % 360.0).tolist(),
        "platform_radius_mm": (platform * rng.uniform(0.9, 1.1, 3)).tolist(),
        "platform_angle_deg": ((angle + rng.uniform(-3.0, 3.0, 3)) % 360.0).tolist(),
        "rod_length_mm": (base_radius * rng.uniform(1.3, 1.7, 3)).tolist(),
        "rod_spacing_mm": 40.0,
        "target_offset_mm": [*rng.uniform(-10.0, 10.0, 2).tolist(), -25.0],
        "assembly_mode": "below",
    }
    config["joints"] = {"pole_pitch_mm": 2.0}
    return config


def delta_run(seed: int, settings: Settings | None = None) -> World:
    """A clean run of a random delta: 108 poses, twice each, in shuffled order.

    Carriages stop a little off where they were sent, each time anew; the file holds what was read. The sensor's noise
    is declared. ``q1_mm_commanded`` and so on are kept for one of the mistakes and are not part of the file.
    """
    settings = settings or random_delta(seed)
    robot = Robot.from_dict(settings)
    half = 0.22 * min(settings["geometry"]["base_radius_mm"])
    plan = make_plan(robot, grid(half, 6, (-half, 0.0, half)), 2, "shuffled", seed)
    rng = np.random.default_rng([seed, 21])
    commanded = {name + COMMANDED: np.round(plan[name], 4) for name in JOINTS["delta"]}
    for name in JOINTS["delta"]:
        plan[name] = plan[name] + FOLLOWING_MM * rng.normal(size=len(plan["pose"]))
    errors = draw_geometric_errors(np.random.default_rng([seed, 1]))
    columns = simulate(robot, plan, errors, noise=Noise(SIGMA_MM), seed=1000 + seed)
    sigma = {f"sigma_{name}": np.full(len(plan["pose"]), SIGMA_MM) for name in READINGS["delta"]}
    return World(settings, columns | sigma | commanded, 1e3 * SIGMA_MM)


def random_spherical(seed: int) -> Settings:
    """Tables of a spherical robot whose camera looks at its patch a little from the side."""
    rng = np.random.default_rng([seed, 22])
    settings = deepcopy(SPHERICAL)
    alpha = rng.uniform(40.0, 50.0)
    settings["geometry"] |= {
        "alpha_deg": alpha, "beta_deg": alpha + rng.uniform(0.0, 6.0), "radius_mm": rng.uniform(150.0, 250.0),
        "assembly_mode": "outer", "working_mode": "open",
    }  # fmt: skip
    distance = settings["geometry"]["radius_mm"] * rng.uniform(2.2, 2.6)
    settings["camera"] |= {"phi_deg": rng.uniform(60.0, 120.0), "gamma_deg": 45.0, "distance_mm": distance}
    return settings


def spherical_run(seed: int, settings: Settings | None = None) -> World:
    """A clean run of a random spherical robot: 100 poses, twice each, in shuffled order; the noise is declared."""
    world = spherical_world(seed, settings=settings or random_spherical(seed))
    sigma = {f"sigma_{name}": np.full(len(world.columns["pose"]), world.noise) for name in READINGS["spherical"]}
    return replace(world, columns=world.columns | sigma)


def file_of(world: World) -> World:
    """The world as its file shows it: without what only a simulator knows."""
    return replace(world, columns={k: v for k, v in world.columns.items() if not k.endswith(COMMANDED)})


# -- changes -------------------------------------------------------------------------------------------------------


def columns(function: Callable[[dict[str, Any]], dict[str, Any]]) -> Callable[[World], World]:
    """A change of some columns."""
    return lambda world: replace(world, columns=world.columns | function(world.columns))


def moved(*names: str) -> Callable[[World], World]:
    """Each column takes the values of the next one named, the last those of the first."""
    ring = (*names, names[0])
    return columns(lambda c: {here: c[there] for here, there in pairwise(ring)})


def times(factor: float, *names: str) -> Callable[[World], World]:
    return columns(lambda c: {name: factor * c[name] for name in names if name in c})


def shifted(kind: str, by: int) -> Callable[[World], World]:
    """Readings stand ``by`` rows below the joints that they belong to; the ends are cut off."""

    def change(world: World) -> World:
        names = {*READINGS[kind], *(f"sigma_{name}" for name in READINGS[kind])}
        n = len(world.columns["pose"])
        joints, readings = (slice(by, n), slice(0, n - by)) if by > 0 else (slice(0, n + by), slice(-by, n))
        return replace(world, columns={k: v[readings if k in names else joints] for k, v in world.columns.items()})

    return change


def geometry(function: Callable[[dict[str, Any]], dict[str, Any]]) -> Callable[[World], World]:
    """A change of the geometry in the robot file."""

    def change(world: World) -> World:
        settings = deepcopy(world.settings)
        settings["geometry"] |= function(settings["geometry"])
        return replace(world, settings=settings)

    return change


def clockwise(g: dict[str, Any]) -> dict[str, Any]:
    """Angles counted clockwise from where limb 1 stands."""
    first = g["base_angle_deg"][0]
    names = ("base_angle_deg", "platform_angle_deg")
    return {name: [(2 * first - a) % 360.0 for a in g[name]] for name in names}


def in_radians(g: dict[str, Any]) -> dict[str, Any]:
    names = ("base_angle_deg", "platform_angle_deg")
    return {name: np.deg2rad(g[name]).tolist() for name in names}


def _in(unit_mm: float, name: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    """A length of the robot's file in another unit."""
    return lambda g: {name: (np.asarray(g[name]) / unit_mm).tolist()}


def rolled(degrees: float) -> Callable[[World], World]:
    """The camera turned about its axis."""

    def change(c: dict[str, Any]) -> dict[str, Any]:
        middle = (np.array(SPHERICAL["camera"]["size_px"]) - 1) / 2
        turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()[:2, :2]
        seen = turn @ (np.stack([c["u_px"], c["v_px"]]) - middle[:, None]) + middle[:, None]
        return {"u_px": seen[0], "v_px": seen[1]}

    return columns(change)


def seen_as(kind: str) -> tuple[str, ...]:
    """Joints and readings of a kind, with the sigmas of the readings: what a wrong unit touches."""
    return (*JOINTS[kind], *READINGS[kind], *(f"sigma_{name}" for name in READINGS[kind]))


def _readings(kind: str) -> tuple[str, ...]:
    return tuple(name for name in seen_as(kind) if name not in JOINTS[kind])


def _units(kind: str, what: str, names: tuple[str, ...], word: tuple[str, ...]) -> list[Mistake]:
    return [
        Mistake(f"{what} in metres", (word, ("metres", "in m", "1000")), times(1e-3, *names)),
        Mistake(f"{what} in micrometres", (word, ("micromet", "µm", "1000")), times(1e3, *names)),
        Mistake(f"{what} in inches", (word, ("inch", "25.4")), times(1 / INCH_MM, *names)),
    ]


def _delta() -> list[Mistake]:
    q, x = JOINTS["delta"], READINGS["delta"]
    time: Words = (("time",), ("millisecond", " ms"))
    out = [
        Mistake("joints 1 and 2 swapped", (("q1",), ("q2",), SWAPPED), moved("q1_mm", "q2_mm")),
        Mistake("joints 1 and 3 swapped", (("q1",), ("q3",), SWAPPED), moved("q1_mm", "q3_mm")),
        Mistake("joints 2 and 3 swapped", (("q2",), ("q3",), SWAPPED), moved("q2_mm", "q3_mm")),
        Mistake("joints counted from 2", (("q1",), ("q2",), ("q3",), SWAPPED), moved(*q)),
        Mistake("joints counted from 3", (("q1",), ("q2",), ("q3",), SWAPPED), moved(*q[::-1])),
        Mistake("x and y swapped", (("x_mm",), ("y_mm",), SWAPPED), moved("x_mm", "y_mm")),
        Mistake("x and z swapped", (("x_mm",), ("z_mm",), SWAPPED), moved("x_mm", "z_mm")),
        Mistake("y and z swapped", (("y_mm",), ("z_mm",), SWAPPED), moved("y_mm", "z_mm")),
    ]
    for name in x:
        out.append(Mistake(f"{name[0]} mirrored", ((name,), MIRRORED), times(-1.0, name)))
    out += [
        Mistake("all axes negated", (("x_mm",), ("y_mm",), ("z_mm",), ("left-handed",)), times(-1.0, *x)),
    ]
    for k, name in enumerate(q):
        out.append(Mistake(f"joint {k + 1} counted downwards", ((name[:2],), MIRRORED), times(-1.0, name)))
    out.append(Mistake("all joints counted downwards", (("joint", "q1"), MIRRORED), times(-1.0, *q)))
    out += _units("delta", "joints", q, ("joint", "q1"))
    out += _units("delta", "readings", _readings("delta"), ("reading", "x_mm"))
    out += _units("delta", "everything", seen_as("delta"), ("unit", "joint", "reading", "all lengths"))
    out += [
        Mistake("assembly mode", (("assembly",), ("above", "below")), geometry(lambda g: {"assembly_mode": "above"})),
        Mistake("clockwise limbs", (("clockwise", "mirror", "base_angle"),), geometry(clockwise)),
        Mistake(
            "platform in centimetres", (("platform_radius",), ("centimet",)), geometry(_in(10.0, "platform_radius_mm"))
        ),
        Mistake("base in inches", (("base_radius",), ("inch",)), geometry(_in(INCH_MM, "base_radius_mm"))),
        Mistake("base angles in radians", (("base_angle",), ("radian", "rad")), geometry(in_radians)),
        Mistake("time in milliseconds", time, times(1e3, "time_s")),
    ]
    for by in (-2, -1, 1, 2):
        words = (("row",), ("shift", "late", "early", "below", "above"), (str(abs(by)), ("one", "two")[abs(by) - 1]))
        out.append(Mistake(f"readings {by:+d} rows", words, shifted("delta", by)))
    for name in x:
        still = columns(lambda c, name=name: {name: np.full(len(c[name]), 1.5)})
        out.append(Mistake(f"{name[0]} constant", ((name,), ("constant", "same", "never changes")), still))
    sent = columns(lambda c: {name: c[name + COMMANDED] for name in q})
    out.append(Mistake("commanded joints", (("command",), ("read", "joint")), sent))
    return out


def _spherical() -> list[Mistake]:
    t, u = JOINTS["spherical"], READINGS["spherical"]
    time: Words = (("time",), ("millisecond", " ms"))
    width, height = SPHERICAL["camera"]["size_px"]
    both = ("theta1_rad", "theta2_rad"), ("theta1_rad_per_s", "theta2_rad_per_s")

    def swap(world: World) -> World:
        return moved(*both[1])(moved(*both[0])(world))

    degrees: Words = (("joint", "theta"), ("degree", "57.3"))
    out = [
        Mistake("joints swapped", (("theta1",), ("theta2",), SWAPPED), swap),
        Mistake("u and v swapped", (("u_px",), ("v_px",), SWAPPED), moved("u_px", "v_px")),
        Mistake("u mirrored", (("u_px",), MIRRORED), columns(lambda c: {"u_px": width - 1 - c["u_px"]})),
        Mistake("v counted upwards", (("v_px",), MIRRORED), columns(lambda c: {"v_px": height - 1 - c["v_px"]})),
        Mistake("u negated", (("u_px",), MIRRORED), times(-1.0, "u_px")),
        Mistake("v negated", (("v_px",), MIRRORED), times(-1.0, "v_px")),
        Mistake(
            "picture upside down",
            (("u_px",), ("v_px",), (*MIRRORED, "upside down", "180")),
            columns(lambda c: {"u_px": width - 1 - c["u_px"], "v_px": height - 1 - c["v_px"]}),
        ),
        Mistake("pixels of a picture of half size", (("pixel", "u_px"), ("half", "2", "size")), times(0.5, *u)),
        Mistake("joints in degrees", degrees, times(float(np.rad2deg(1)), *t)),
        Mistake("joints in milliradians", (("joint", "theta"), ("milliradian", "mrad", "1000")), times(1e3, *t)),
        Mistake("joint 1 in degrees", (("theta1",), ("degree", "57.3")), times(float(np.rad2deg(1)), t[0])),
    ]
    for k, name in enumerate(t):
        out.append(Mistake(f"joint {k + 1} counted backwards", ((name[:6],), MIRRORED), times(-1.0, name)))
    out += [
        Mistake("both joints counted backwards", (("joint", "theta"), MIRRORED), times(-1.0, *t)),
        Mistake("a camera that is turned", (("picture",), ("turned by 70",)), rolled(70.0)),
        Mistake(
            "a picture that is cropped",
            (("u_px",), ("cropped",), ("+120 to u_px",)),
            columns(lambda c: {"u_px": c["u_px"] - 120.0, "v_px": c["v_px"] - 60.0}),
        ),
        Mistake(
            "a picture that is cropped at the left",
            (("u_px",), ("cropped",), ("+100 to u_px",)),
            columns(lambda c: {"u_px": c["u_px"] - 100.0}),
        ),
        Mistake(
            "alpha in radians",
            (("alpha",), ("radian",)),
            geometry(lambda g: {"alpha_deg": float(np.deg2rad(g["alpha_deg"]))}),
        ),
        Mistake("assembly mode", (("assembly",), ("inner", "outer")), geometry(lambda g: {"assembly_mode": "inner"})),
        Mistake("working mode", (("working",), ("open", "crossed")), geometry(lambda g: {"working_mode": "crossed"})),
        Mistake("time in milliseconds", time, times(1e3, "time_s")),
    ]
    for by in (-2, -1, 1, 2):
        words = (("row",), ("shift", "late", "early", "below", "above"), (str(abs(by)), ("one", "two")[abs(by) - 1]))
        out.append(Mistake(f"readings {by:+d} rows", words, shifted("spherical", by)))
    for name in u:
        still = columns(lambda c, name=name: {name: np.full(len(c[name]), 300.0)})
        out.append(Mistake(f"{name[0]} constant", ((name,), ("constant", "same", "never changes")), still))
    return out


def _angles() -> list[Mistake]:
    """Those of a run in which vision has found the angles already."""
    degrees = float(np.rad2deg(1))
    phi, gamma = "phi_rad", "gamma_rad"
    return [
        Mistake("phi and gamma swapped", ((phi,), (gamma,), SWAPPED), moved(phi, gamma)),
        Mistake("phi in degrees", (("phi",), ("degree", "57.3")), times(degrees, phi)),
        Mistake("phi and gamma in degrees", (("phi", "angle"), ("degree", "57.3")), times(degrees, phi, gamma)),
        Mistake("phi mirrored", ((phi,), MIRRORED), times(-1.0, phi)),
        Mistake("gamma mirrored", ((gamma,), MIRRORED), times(-1.0, gamma)),
        Mistake(
            "gamma counted from the equator",
            ((gamma,), ("90", "equator", "complement")),
            columns(lambda c: {gamma: np.pi / 2 - c[gamma]}),
        ),
    ]


def angles_run(seed: int) -> World:
    """The clean run of :func:`spherical_run` as angles, with a noise of 0.2 mrad; the robot has no camera."""
    world = spherical_run(seed)
    settings = deepcopy(world.settings)
    settings["geometry"]["radius_mm"] = 200.0
    c = world.columns
    angles = real_spherical(world.settings, seed).angles(np.stack([c["theta1_rad"], c["theta2_rad"]], axis=1))
    angles = angles + 2e-4 * np.random.default_rng([seed, 23]).normal(size=angles.shape)
    keep = {k: v for k, v in c.items() if "px" not in k}
    return World(settings, keep | {"phi_rad": angles[:, 0], "gamma_rad": angles[:, 1]}, 0.2)


MISTAKES: dict[str, tuple[Callable[[int], World], list[Mistake]]] = {
    "delta": (delta_run, _delta()),
    "spherical": (spherical_run, _spherical()),
    "angles": (angles_run, _angles()),
}
#: Robots on which each mistake is made.
ROBOTS = 5


def named(mistake: Mistake, world: World) -> tuple[bool, str]:
    """Whether the mistake is named in a sentence and never praised, and what is said instead, in short."""
    answer = file_of(mistake.change(world)).ask()
    right = answer.says(*mistake.words) and answer.verdict not in ("adequate", "explained")
    return right, answer.short()
