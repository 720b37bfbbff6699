"""The second simulator of the spherical robot against closed forms, OpenCV and the core: two routes, one physics."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from running import slow
from second_simulator.effects import motion_direction
from second_simulator.spherical import (
    ALL_EFFECTS,
    COLUMN_NAMES,
    GEOMETRY,
    Now,
    SecondSpherical,
    camera_facing,
    complete,
    draw_spherical_effect,
    pair,
    sphere_grid,
    spherical_plan,
    write_spherical_csv,
)
from sherkit import _core

Floats = NDArray[np.float64]
Assembly = Literal["outer", "inner"]

#: Where the parameters of each effect stand among those of the core.
PLACES: dict[str, slice] = {}
for _row in _core.SphericalModel.CATALOGUE:
    _start = max((place.stop for place in PLACES.values()), default=0)
    PLACES[_row["name"]] = slice(_start, _start + len(_row["parameters"]))
CAMERA = camera_facing(np.pi / 2, np.pi / 4, 446.2, [1100.0, 1100.0, 640.0, 320.0])
PAPER = SecondSpherical(0.7634, 0.8037, 222.1, CAMERA, gravity=(0.0, 0.6, -0.8), home_rad=(2.4, 0.7))
ANGLES = sphere_grid((0.9, 2.2), (0.4, 1.2), 12)
JOINTS = PAPER.joints_at(ANGLES)
PLAN = spherical_plan(JOINTS, 2, "shuffled", seed=4)


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def random_robot(rng: np.random.Generator, assembly: Assembly = "outer") -> SecondSpherical:
    """Any geometry, any camera that has the sphere in front of it, distortion and all."""
    radius = rng.uniform(50.0, 400.0)
    camera = camera_facing(
        rng.uniform(-3.0, 3.0), rng.uniform(0.2, 1.4), radius * rng.uniform(2.0, 4.0),
        [*rng.uniform(500.0, 1500.0, 2), *rng.uniform(200.0, 700.0, 2)],
    )  # fmt: skip
    camera[4:9] = rng.normal(size=5) * [0.1, 0.05, 3e-3, 3e-3, 0.02]
    camera[9:12] += 0.05 * rng.normal(size=3)
    camera[12:] += 0.05 * radius * rng.normal(size=3)
    return SecondSpherical(
        *rng.uniform(0.3, 1.4, 2), radius, camera, rng.normal(size=3), rng.uniform(-1.0, 1.0, 2), assembly=assembly
    )


def random_joints(robot: SecondSpherical, rng: np.random.Generator, n: int = 200) -> Floats:
    """Joints on both sides of each other whose limbs meet well, half or more of a turn apart too."""
    half = rng.uniform(0.15, 3.0, 40 * n) * rng.choice([-1.0, 1.0], 40 * n)
    spread = np.abs(np.sin(robot.alpha_rad) * np.sin(half))
    half = half[(spread < 0.85 * np.sin(robot.beta_rad)) & (spread > 0.1 * np.sin(robot.beta_rad))][:n]
    mean = rng.uniform(-4.0, 4.0, len(half))
    return np.column_stack([mean + half, mean - half])


def core_of(robot: SecondSpherical, geometry: Floats | None = None, readings: str = "pixels") -> Any:
    if geometry is None:
        geometry = np.array([robot.alpha_rad, robot.beta_rad, 0.0] * 2)
    times = [0.0, robot.effects["slip"][3], robot.effects["joint_slip"][2], robot.effects["sensor_slip"][6]]
    period = 2 * np.pi / (robot.effects["encoder_cyclic"][4] or robot.effects["encoder_second"][4] or 2.0)
    settings = np.concatenate([[robot.radius_mm], robot.gravity, robot.home_rad, times, [period]])
    return _core.SphericalModel(geometry, robot.camera, settings, robot.assembly, readings=readings)


def core_block(joints: Floats, now: dict[str, Floats]) -> Any:
    known = [now[name] for name in ("time_s", "temperature_c", "direction", "velocity", "stand_c")]
    return (joints, None, np.ascontiguousarray(np.column_stack(known)), None)


def core_values(robot: SecondSpherical) -> Floats:
    values = np.zeros(_core.SphericalModel.PARAMETERS)
    for name, parameters in robot.effects.items():
        place = PLACES[name]
        values[place] = parameters[: place.stop - place.start]
    return values


def disagreement(robot: SecondSpherical, rng: np.random.Generator) -> float:
    """Largest difference of a pixel; angles and centres are compared on the way."""
    joints = random_joints(robot, rng)
    now = {
        "direction": rng.choice([-1.0, 1.0], joints.shape),
        "velocity": 0.5 * rng.normal(size=joints.shape),
        "time_s": rng.uniform(0.0, 4000.0, len(joints)),
        "temperature_c": 20.0 + rng.normal(size=len(joints)),
        "stand_c": 20.0 + rng.normal(size=len(joints)),
    }
    core, values = core_of(robot), core_values(robot)
    readings, reached = core.predict(values, core_block(joints, now))
    for row in np.flatnonzero(~reached):  # links so soft that they bend away from each other
        with pytest.raises(ValueError, match="do not meet"):
            robot.pixels(joints[row : row + 1], **{name: rows[row : row + 1] for name, rows in now.items()})
    joints, readings = joints[reached], readings[reached]
    now = {name: rows[reached] for name, rows in now.items()}
    assert len(joints) > 50
    block = core_block(joints, now)
    centres, _, _, reached = core.centres(values, block, [])
    assert reached.all()
    np.testing.assert_allclose(robot.centre_mm(joints, **now), centres, atol=1e-11)
    np.testing.assert_allclose(robot.markers(joints, **now), core.markers(values, block)[0], atol=1e-8)
    seen, reached = core_of(robot, readings="angles").predict(values, block)
    away = reached & (np.abs(seen[:, 1]) > 0.05)
    np.testing.assert_allclose(robot.angles(joints, **now)[away], seen[away], atol=1e-9)
    return float(np.abs(robot.pixels(joints, **now) - readings).max())


def test_equal_limbs_are_the_papers_equations() -> None:
    """Catches the wrong branch of the loop closure, and frames that are not the paper's (Eqs. 34, 35)."""
    rng = np.random.default_rng(1)
    for assembly, sign in (("outer", 1.0), ("inner", -1.0)):
        robot = random_robot(rng, assembly)  # type: ignore[arg-type]
        joints = random_joints(robot, rng)
        half = 0.5 * (joints[:, 0] - joints[:, 1])
        a, b = robot.alpha_rad, robot.beta_rad
        root = np.sqrt(np.sin(b) ** 2 - (np.sin(a) * np.sin(half)) ** 2)
        gamma = 2 * np.arctan2(np.sin(a) * np.cos(half) + sign * root, np.cos(a) + np.cos(b))
        away = np.abs(gamma) > 1e-3
        expected = np.column_stack([joints.mean(axis=1), gamma])[away]
        np.testing.assert_allclose(robot.angles(joints)[away], expected, atol=1e-11)
    np.testing.assert_allclose(PAPER.angles(JOINTS), ANGLES, atol=1e-13)
    with pytest.raises(ValueError, match="do not meet"):
        SecondSpherical(1.2, 0.5, 200.0, CAMERA).pixels([[1.5, -1.5]])
    with pytest.raises(ValueError, match="out of reach"):
        PAPER.joints_at([[1.0, 1.6]])


def test_the_loop_closes_and_the_marker_stands_where_it_was_put() -> None:
    """Catches a distal link of the wrong length, and the marker's offset on the wrong side or in the wrong order."""
    robot = PAPER.changed(effects={"unequal_limbs": [0.03, -0.05], "joint_offset": [0.02, -0.01]})
    theta = robot.true_joints(JOINTS, Now())
    alphas, betas = robot.arcs()
    np.testing.assert_allclose([*alphas, *betas], [0.7934, 0.7334, 0.7537, 0.8537], atol=1e-12)
    axis = robot.markers(JOINTS) / robot.radius_mm
    elbows = [
        np.column_stack([np.sin(a) * np.cos(t), np.sin(a) * np.sin(t), np.full_like(t, np.cos(a))])
        for a, t in zip(alphas, theta.T, strict=True)
    ]
    for elbow, beta in zip(elbows, betas, strict=True):
        np.testing.assert_allclose(np.sum(axis * elbow, axis=1), np.cos(beta), atol=1e-13)
    plain = robot.markers(JOINTS)
    towards, ahead = (robot.hide(marker_offset=offset).markers(JOINTS) - plain for offset in ([1.0, 0.0], [0.0, 1.0]))
    np.testing.assert_allclose(np.sum(towards * axis, axis=1), 0.0, atol=1e-10)
    np.testing.assert_allclose(np.sum(towards * elbows[0], axis=1), np.sin(betas[0]), atol=1e-10)
    np.testing.assert_allclose(ahead, np.cross(axis, towards), atol=1e-10)


def test_weight_bends_links_the_way_that_lets_it_down() -> None:
    """Catches flexure of the wrong sign or size: the load of a link is what the weight gains when that link opens."""
    robot = PAPER.changed(effects={"unequal_limbs": [0.02, 0.03]})
    beta = np.tile(robot.arcs()[1], (len(JOINTS), 1))
    loads = robot.loads(JOINTS, robot.close(JOINTS, beta), beta)
    down = robot.gravity / np.linalg.norm(robot.gravity)

    def height(change: Floats) -> Floats:
        return robot.close(JOINTS, beta + change).apply([0.0, 0.0, 1.0]) @ down

    for i in (0, 1):
        step = 1e-4 * np.eye(2)[i]
        gain = (8 * (height(step) - height(-step)) - (height(2 * step) - height(-2 * step))) / 12e-4
        np.testing.assert_allclose(loads[:, i], gain, atol=1e-10)
    bent = robot.hide(gravity_flexure=[1e-3, 1e-3]).distal_link(JOINTS).apply([0.0, 0.0, 1.0]) @ down
    assert (bent > height(np.zeros(2))).all()


def test_a_late_picture_shows_where_the_joints_were() -> None:
    """Catches a delay of the wrong sign, and a plan whose velocities are not those of its own motion."""
    delay, theta = 0.05, pair(PLAN, "rad")
    before = np.column_stack([np.interp(PLAN["time_s"] - delay, PLAN["time_s"], column) for column in theta.T])
    late = PAPER.changed(effects={"camera_delay": delay}).truth(PLAN)
    np.testing.assert_allclose(late, PAPER.pixels(before), atol=1e-9)
    moved = pair(PLAN, "rad_per_s") != 0
    assert (np.sign(pair(PLAN, "rad_per_s")) == motion_direction(theta, PLAN["time_s"]))[moved].all()


def test_projection_is_that_of_opencv() -> None:
    """Catches a distortion, a turn or a principal point with another meaning than OpenCV's."""
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(5)
    for _ in range(10):
        robot = random_robot(rng)
        points = robot.radius_mm * rng.normal(size=(50, 3)) / 3
        fx, fy, cx, cy = robot.camera[:4]
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        seen, _ = cv2.projectPoints(points, robot.camera[9:12], robot.camera[12:], matrix, robot.camera[4:9])
        np.testing.assert_allclose(robot.image(points), seen[:, 0], atol=1e-9)


@pytest.mark.parametrize("assembly", ["outer", "inner"])
@pytest.mark.parametrize("seed", range(10))
def test_without_effects_the_core_sees_the_same_pixels(assembly: Assembly, seed: int) -> None:
    """Catches a core whose tool axis, sphere or camera is not where the chain of turns and a pinhole have it."""
    rng = np.random.default_rng([1, seed])
    assert disagreement(random_robot(rng, assembly), rng) < 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_limbs_of_any_geometry_are_the_cores(seed: int) -> None:
    """Catches a core whose six parameters of two unequal limbs are confused with one another."""
    rng = np.random.default_rng([2, seed])
    robot = random_robot(rng).hide(unequal_limbs=0.03 * rng.normal(size=2), joint_offset=0.03 * rng.normal(size=2))
    joints = random_joints(robot, rng)
    (a1, a2), (b1, b2) = robot.arcs()
    o1, o2 = robot.effects["joint_offset"]
    core = core_of(robot, np.array([a1, b1, o1, a2, b2, o2]))
    readings, reached = core.predict(np.zeros(core.PARAMETERS), (joints, None, None, None))
    assert reached.all()
    np.testing.assert_allclose(robot.pixels(joints), readings, atol=1e-9)


@pytest.mark.parametrize("size", [1.0, *slow(0.1, 10.0)])
@pytest.mark.parametrize("name", ALL_EFFECTS)
def test_each_effect_is_the_cores(name: str, size: float) -> None:
    """Catches an effect with another sign, unit, order of parameters or place in the chain than the core's."""
    for seed in range(4):
        rng = np.random.default_rng([3, seed])
        robot = random_robot(rng, "outer" if seed % 2 else "inner")
        robot.hide(**{name: size * draw_spherical_effect(name, rng)})
        assert disagreement(robot, rng) < 1e-6


@pytest.mark.parametrize("seed", range(10))
def test_all_effects_at_once_are_the_cores(seed: int) -> None:
    """Catches effects that meet in another order than the core's: one link of the chain placed before another."""
    rng = np.random.default_rng([4, seed])
    robot = random_robot(rng)
    robot.hide(**{name: 3 * draw_spherical_effect(name, rng) for name in ALL_EFFECTS})
    assert disagreement(robot, rng) < 1e-6


@pytest.mark.parametrize("name", ALL_EFFECTS)
def test_effect_vanishes_with_its_parameters_and_only_then(name: str) -> None:
    """Catches an effect that is not applied, or that another one switches on."""
    drawn = draw_spherical_effect(name, np.random.default_rng(1))
    plain = PAPER.truth(PLAN)
    assert np.abs(PAPER.changed(effects={name: drawn}).truth(PLAN) - plain).max() > 0.05
    np.testing.assert_array_equal(PAPER.changed(effects={name: 0 * drawn}).truth(PLAN), plain)
    amplitudes = len(drawn) - ALL_EFFECTS[name].fixed
    for k in range(amplitudes):
        kept = np.arange(len(drawn)) >= amplitudes
        one = PAPER.changed(effects={name: drawn * np.where(kept, 1.0, np.eye(len(drawn))[k])})
        assert np.abs(one.truth(PLAN) - plain).max() > 1e-3, k


@pytest.mark.parametrize("name", ALL_EFFECTS)
@pytest.mark.parametrize("ratio", [1.0, *slow(5.0)])
def test_at_ratio_leaves_that_many_times_the_noise(name: str, ratio: float) -> None:
    """Catches sizes measured before the fit instead of after, and a noise taken for a variance."""
    found = PAPER.at_ratio(name, ratio, 0.1, PLAN, np.random.default_rng(3))
    moved = (PAPER.changed(effects=found).truth(PLAN) - PAPER.truth(PLAN)).ravel()
    basis = PAPER.fitted_directions(PLAN)
    assert basis.shape[1] == len(GEOMETRY)
    left = moved - basis @ np.linalg.lstsq(basis, moved, rcond=None)[0]
    assert rms(left) == pytest.approx(0.1 * ratio, rel=0.01)
    shifted = PAPER.changed(effects={"marker_offset": [3.0, -2.0]})
    other = shifted.at_ratio(name, ratio, 0.1, PLAN, np.random.default_rng(3))
    np.testing.assert_array_equal(other[name], found[name])  # others that are hidden take no part
    whole = PAPER.at_ratio(name, ratio, 0.1, PLAN, np.random.default_rng(3), fitted=())
    moved = (PAPER.changed(effects=whole).truth(PLAN) - PAPER.truth(PLAN)).ravel()
    assert rms(moved) == pytest.approx(0.1 * ratio, rel=0.01)


def test_what_is_fitted_away_cannot_be_scaled() -> None:
    """Catches a size without meaning: nothing of the effect is left to be scaled."""
    with pytest.raises(ValueError, match="absorbed"):
        PAPER.at_ratio("focal_length", 2.0, 0.1, PLAN, fitted=("alpha_rad", "focal_length", "principal_point"))
    # all lengths together scale without a trace in the pixels, and a common joint offset is a turn of the camera
    assert PAPER.fitted_directions(PLAN, (*GEOMETRY, "sensor_pose", "joint_offset")).shape[1] == 3 + 6 + 2 - 2


def test_runs() -> None:
    """Catches columns that do not belong together, noise of another size, and numbers that do not come back."""
    robot = PAPER.changed(seed=7).hide(backlash=[2e-3, 1e-3], camera_delay=0.01)
    run = robot.run(JOINTS, repeats=3, noise_px=0.2, order="shuffled")
    assert tuple(run) == COLUMN_NAMES
    again, other = (robot.run(JOINTS, repeats=3, noise_px=0.2, order="shuffled", seed=s) for s in (7, 8))
    assert all(np.array_equal(run[name], again[name]) for name in run)
    assert not np.array_equal(run["pose"], other["pose"])
    noise = np.column_stack([run["u_px"], run["v_px"]]) - robot.truth(run)
    assert noise.std(axis=0) == pytest.approx([0.2, 0.2], rel=0.15)
    np.testing.assert_array_equal(pair(run, "rad"), JOINTS[run["pose"] - 1])
    assert run["repeat"][run["pose"] == 5].tolist() == [1, 2, 3]
    direction = motion_direction(pair(run, "rad"), run["time_s"])
    for sign in (direction, -direction):
        same = robot.pixels(pair(run, "rad"), direction=sign, velocity=pair(run, "rad_per_s")) - robot.truth(run)
        assert (np.abs(same).max() < 1e-12) == (sign is direction)
    fresh = robot.run(PLAN, noise_px=0.2, seed=1)
    assert not np.array_equal(fresh["u_px"], robot.run(PLAN, noise_px=0.2, seed=2)["u_px"])
    np.testing.assert_array_equal(fresh["time_s"], PLAN["time_s"])


def test_files(tmp_path: Path) -> None:
    """Catches a file that says something else than the run."""
    run = PAPER.run(JOINTS)
    write_spherical_csv(run, tmp_path / "run.csv")
    assert (tmp_path / "run.csv").read_text().splitlines()[0] == ",".join(COLUMN_NAMES)
    table = np.loadtxt(tmp_path / "run.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table, np.column_stack(list(run.values())), atol=1e-10)


def test_hiding() -> None:
    """Catches effects that leak from a copy to its original, unknown names, and covariates silently left out."""
    robot = PAPER.changed()
    robot.hide(backlash=[1e-3, 2e-3]).hide(joint_scale=[1e-3, 0.0])
    assert not np.any(PAPER.effects["backlash"])
    assert robot.effects["backlash"].tolist() == [1e-3, 2e-3]
    with pytest.raises(ValueError, match="direction"):
        robot.pixels(JOINTS)
    robot.effects = {"camera_delay": 0.01}
    assert not np.any(robot.effects["backlash"])
    with pytest.raises(ValueError, match="velocity"):
        robot.pixels(JOINTS)
    with pytest.raises(ValueError, match="unknown effects"):
        robot.hide(magic=1.0)
    base = {row["name"] for row in _core.SphericalModel.CATALOGUE if row["base"]}
    # where the camera stands belongs to the model, and may be drawn by the simulator
    assert set(complete(None)) == (set(PLACES) - base) | {"sensor_pose"}


def test_it_shares_nothing_with_the_core() -> None:
    """Catches a second simulator that asks the program under test for its answer."""
    package = Path(__file__).parent / "second_simulator"
    assert not [path.name for path in package.glob("*.py") if "import sherkit" in path.read_text()]
    assert not [path.name for path in package.glob("*.py") if "from sherkit" in path.read_text()]
