"""The simulator against its own physics: constraints, closed forms and hand-written formulas."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from . import (
    EFFECTS,
    NOMINAL_CONFIG,
    Noise,
    Robot,
    draw_effect,
    draw_geometric_errors,
    fitted_directions,
    grid,
    local_grid,
    make_plan,
    platform_pose,
    scaled_effect,
    simulate,
    truth,
    whole_grid,
    with_errors,
    write_csv,
    write_robot_toml,
)
from .geometry import Array
from .solve import PLATFORM_WEIGHT_N
from .spherical import SecondSpherical, Unmodelled, camera_facing, sphere_grid, spherical_plan

ROBOT = Robot.from_dict()
PLAN = make_plan(ROBOT, grid(10.0, 5, (-10.0, 0.0, 10.0)), repeats=2)
Q = np.stack([PLAN[f"q{i}_mm"] for i in (1, 2, 3)], axis=1)
HOME = 25.0 + np.sqrt(120.0**2 - 60.0**2)


def errors(seed: int = 5) -> dict[str, float]:
    return draw_geometric_errors(np.random.default_rng(seed))


def xyz(columns: dict[str, NDArray[Any]]) -> Array:
    return np.stack([columns[name] for name in ("x_mm", "y_mm", "z_mm")], axis=1)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def change(name: str, parameters: ArrayLike) -> Array:
    return truth(ROBOT, PLAN, errors(), {name: parameters}) - truth(ROBOT, PLAN, errors())


def three_spheres(centres: Array, radii: Array) -> Array:
    """Lower intersection of three spheres: centres (n, 3, 3), radii (3)."""
    first, second, third = np.moveaxis(centres, 1, 0)
    ex = second - first
    d = np.linalg.norm(ex, axis=1)
    ex /= d[:, None]
    i = np.sum(ex * (third - first), axis=1)
    ey = third - first - i[:, None] * ex
    ey /= np.linalg.norm(ey, axis=1, keepdims=True)
    j = np.sum(ey * (third - first), axis=1)
    x = (radii[0] ** 2 - radii[1] ** 2 + d**2) / (2 * d)
    y = (radii[0] ** 2 - radii[2] ** 2 + i**2 + j**2 - 2 * i * x) / (2 * j)
    z = np.sqrt(radii[0] ** 2 - x**2 - y**2)
    ez = np.cross(ex, ey)
    ez *= -np.sign(ez[:, 2:])
    lower: Array = first + x[:, None] * ex + y[:, None] * ey + z[:, None] * ez
    return lower


def test_nominal_robot_reaches_its_commanded_points() -> None:
    reached = truth(ROBOT, make_plan(ROBOT, whole_grid()))
    assert np.abs(reached - whole_grid()).max() < 1e-11


def test_six_rods_keep_their_lengths_and_carry_the_platform() -> None:
    mismatch, compliance = np.array([0.3, -0.2, 0.1]), np.array([0.02, 0.05, 0.01])
    planted: dict[str, float | Array] = {
        **errors(),
        "platform_angle": np.array([0.01, -0.02, 0.005]),
        "platform_radius_2": 1.0,
    }
    effects: dict[str, ArrayLike] = {
        "rod_mismatch": mismatch,
        "gravity_sag": compliance,
        "rail_lean": [0.01] * 6,
    }
    carriages, centre, turn = platform_pose(ROBOT, PLAN, planted, effects)
    real = with_errors(ROBOT, planted)
    np.testing.assert_allclose(turn @ np.swapaxes(turn, 1, 2), np.tile(np.eye(3), (len(Q), 1, 1)), atol=1e-13)
    for row in range(0, len(Q), 5):
        ends, sensitivities = np.zeros((3, 3)), np.zeros((3, 3))
        tops = carriages[row]
        for i in range(3):
            angle = real.platform_angle[i]
            sensitivities[i] = real.platform_radius[i] * np.array([np.cos(angle), np.sin(angle), 0])
            ends[i] = centre[row] + turn[row] @ sensitivities[i]
        axes = (tops - ends) / np.linalg.norm(tops - ends, axis=1)[:, None]
        tension = np.linalg.solve(axes.T, [0, 0, PLATFORM_WEIGHT_N])
        assert tension.min() > 0  # the platform hangs
        for i in range(3):
            for sign in (1, -1):
                pair = np.array([-np.sin(real.pair_angle[i]), np.cos(real.pair_angle[i]), 0])
                top = tops[i] + sign * 20.0 * pair
                end = centre[row] + turn[row] @ (sensitivities[i] + sign * 20.0 * pair)
                length = real.rod_length[i] + sign * mismatch[i] / 2 + compliance[i] * tension[i]
                assert abs(np.linalg.norm(top - end) - length) < 1e-10


def test_only_mismatch_tilts_the_platform() -> None:
    _, _, turn = platform_pose(ROBOT, PLAN, errors())
    assert np.abs(turn - np.eye(3)).max() < 1e-12
    _, _, turn = platform_pose(ROBOT, PLAN, errors(), {"rod_mismatch": [0.1, 0, 0]})
    assert np.abs(turn - np.eye(3)).max() > 1e-3


MIRRORED = [0, 2, 1]  # joints as the mirror x -> -x sees them: limb 1 stands on the mirror's plane
FLIP_X = np.array([-1.0, 1.0, 1.0])


def plan_with(q: Array) -> dict[str, NDArray[Any]]:
    """The plan of all tests with other joint readings."""
    return PLAN | {f"q{i + 1}_mm": q[:, i] for i in range(3)}


@pytest.mark.parametrize(
    ("name", "here", "mirrored"),
    [
        ("limb_twist", [0.01, 0.02, -0.005], [-0.01, 0.005, -0.02]),
        ("drive_compliance", [0.01, 0.02, 0.03], [0.01, 0.03, 0.02]),
    ],
)
def test_structural_effects_are_seen_in_a_mirror(name: str, here: ArrayLike, mirrored: ArrayLike) -> None:
    """Catches a limb that is taken for another, and a turn counted the wrong way: a mirror turns angles, not loads."""
    seen = truth(ROBOT, plan_with(Q[:, MIRRORED]), None, {name: mirrored})
    np.testing.assert_allclose(seen, truth(ROBOT, PLAN, None, {name: here}) * FLIP_X, atol=1e-10)


@pytest.mark.parametrize("name", ["limb_twist", "drive_compliance"])
def test_structural_effects_turn_with_the_limbs(name: str) -> None:
    """Catches an effect that depends on where a limb stands: a third of a turn of a symmetric robot changes nothing."""
    one = truth(ROBOT, PLAN, None, {name: [0.01, 0.02, 0.03]})
    next_limb = truth(ROBOT, plan_with(Q[:, [2, 0, 1]]), None, {name: [0.03, 0.01, 0.02]})
    c, s = np.cos(2 * np.pi / 3), np.sin(2 * np.pi / 3)
    np.testing.assert_allclose(next_limb, one @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T, atol=1e-10)


def test_six_twisted_rods_keep_their_lengths() -> None:
    """Catches a twist that is linearised, put at the platform instead of the carriage, or counted the wrong way."""
    twist = np.array([0.05, -0.03, 0.02])
    carriages, centre, turn = platform_pose(ROBOT, PLAN, errors(), {"limb_twist": twist})
    real = with_errors(ROBOT, errors())
    for row in range(0, len(Q), 10):
        for i in range(3):
            above, below = real.pair_angle[i] + twist[i], real.pair_angle[i]
            joint = 30.0 * np.array([np.cos(real.platform_angle[i]), np.sin(real.platform_angle[i]), 0])
            for side in (20.0, -20.0):
                top = carriages[row, i] + side * np.array([-np.sin(above), np.cos(above), 0])
                end = centre[row] + turn[row] @ (joint + side * np.array([-np.sin(below), np.cos(below), 0]))
                assert abs(np.linalg.norm(top - end) - real.rod_length[i]) < 1e-10


def test_a_twist_tilts_the_platform_as_three_lines_say() -> None:
    """Catches a wrong size or sign of the tilt: to first order both rods of a limb stay as long as each other where
    the platform turns by w with u . (w x e_t) = twist u . (de_t/dangle), whatever their spacing."""
    twist = np.array([3e-5, -2e-5, 1e-5])
    carriages, centre, turn = platform_pose(ROBOT, PLAN, None, {"limb_twist": twist})
    angle = ROBOT.pair_angle
    along = np.stack([-np.sin(angle), np.cos(angle), np.zeros(3)], axis=1)
    inward = -np.stack([np.cos(angle), np.sin(angle), np.zeros(3)], axis=1)
    for row in range(0, len(Q), 10):
        axes = carriages[row] - centre[row] - ROBOT.platform_joints()
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        w = np.linalg.solve(np.cross(along, axes), twist * np.sum(axes * inward, axis=1))
        tilt = turn[row][[2, 0, 1], [1, 2, 0]]
        np.testing.assert_allclose(tilt, w, atol=2e-3 * np.abs(twist).max())
    narrow = replace(ROBOT, rod_spacing=10.0)
    np.testing.assert_allclose(platform_pose(narrow, PLAN, None, {"limb_twist": twist})[2], turn, atol=1e-8)


def test_a_base_angle_alone_leaves_the_platform_flat_and_a_twist_does_not() -> None:
    """Catches the world that was forgotten: a rail turned with its joint axes is a twist as well."""
    _, _, flat = platform_pose(ROBOT, PLAN, {"base_angle_1": 0.01})
    assert np.abs(flat - np.eye(3)).max() < 1e-12
    _, _, tilted = platform_pose(ROBOT, PLAN, {"base_angle_1": 0.01}, {"limb_twist": [0.01, 0, 0]})
    assert np.abs(tilted - np.eye(3)).max() > 1e-3


def test_a_drive_gives_way_by_the_work_of_its_load() -> None:
    """Catches a wrong size or sign of the load: a carriage moved by dq lifts the weight by dz, so that it carries
    W dz/dq; all three carry the whole weight."""
    loaded, _, _ = platform_pose(ROBOT, PLAN, None, {"drive_compliance": [1e-5] * 3})
    free, _, _ = platform_pose(ROBOT, PLAN)
    drop = (free - loaded)[..., 2] / 1e-5
    assert drop.min() > 0
    np.testing.assert_allclose(drop.sum(axis=1), PLATFORM_WEIGHT_N, rtol=1e-6)
    for i in range(3):
        step = 1e-4 * np.eye(3)[i]
        lift = (truth(ROBOT, plan_with(Q + step)) - truth(ROBOT, plan_with(Q - step)))[:, 2] / 2e-4
        np.testing.assert_allclose(drop[:, i], PLATFORM_WEIGHT_N * lift, rtol=1e-4)


def test_equal_drives_lower_the_middle_by_a_third_of_the_weight() -> None:
    """Catches a load that is not shared, and one that moves the carriage up."""
    middle = make_plan(ROBOT, np.zeros((1, 3)))
    sunk = truth(ROBOT, middle, None, {"drive_compliance": [0.3] * 3})
    np.testing.assert_allclose(sunk, [[0, 0, -0.3 * PLATFORM_WEIGHT_N / 3]], atol=1e-10)


def test_untilted_robot_is_the_intersection_of_three_spheres() -> None:
    straight = {name: value for name, value in errors().items() if "angle" not in name}
    real = with_errors(ROBOT, straight)
    angle = np.deg2rad([90.0, 210.0, 330.0])
    reach = real.base_radius - 30.0
    centres = np.empty((len(Q), 3, 3))
    centres[..., 0], centres[..., 1] = reach * np.cos(angle), reach * np.sin(angle)
    centres[..., 2] = Q + real.joint_offset
    expected = three_spheres(centres, real.rod_length) + ROBOT.target_offset
    assert np.abs(truth(ROBOT, PLAN, straight) - expected).max() < 1e-11


@pytest.mark.parametrize("name", EFFECTS)
def test_effect_vanishes_with_its_parameters_and_only_then(name: str) -> None:
    drawn = draw_effect(name, np.random.default_rng(1), float(PLAN["time_s"][-1]))
    assert np.abs(change(name, drawn)).max() > 1e-4
    drawn[: EFFECTS[name].amplitudes] = 0
    assert np.all(change(name, drawn) == 0)


def test_point_and_sensor_effects_match_their_formulas() -> None:
    p, t = truth(ROBOT, PLAN, errors()), PLAN["time_s"][:, None]
    v = np.array([0.1, -0.2, 0.3])
    matrix = np.arange(9.0) * 1e-3
    expected: dict[str, tuple[ArrayLike, Array]] = {
        "thermal_growth": ([1e-3], 1e-3 * (PLAN["temperature_c"][:, None] - 20) * p),
        "drift": (v, v * t / 3600),
        "slip": ([*v, 200.0], np.where(t > 200, v, 0)),
        "humidity": (v, v * (PLAN["humidity_pct"][:, None] - 45)),
        "periodic_z": ([*v, 0.4], v * np.sin(2 * np.pi * p[:, 2:] / 7.3 + 0.4)),
        "beam_alignment": (matrix, p @ matrix.reshape(3, 3).T),
        "sensor_linearity": (v, v * (p / 20) ** 3),
        "sensor_pose": ([*v, *v], Rotation.from_rotvec(v).apply(p) + v - p),
        "sensor_slip": ([*v, *v, 200.0], np.where(t > 200, Rotation.from_rotvec(v).apply(p) + v - p, 0.0)),
    }
    turned = np.stack([Rotation.from_rotvec(v * h).apply(one) for h, one in zip(t[:, 0] / 3600, p, strict=True)])
    expected["sensor_drift"] = ([*v, *v], turned + v * t / 3600 - p)
    for name, (parameters, moved) in expected.items():
        np.testing.assert_allclose(change(name, parameters), moved, atol=1e-12, err_msg=name)
    # a scale bends about its own zero, not about the robot's
    datum, bent = np.array([30.0, -20.0, 45.0]), 0.01 * v
    zeros: dict[str, ArrayLike] = {"sensor_pose": [0.0, 0.0, 0.0, *datum]}
    moved = truth(ROBOT, PLAN, errors(), zeros | {"sensor_linearity": bent}) - truth(ROBOT, PLAN, errors(), zeros)
    np.testing.assert_allclose(moved, bent * ((p + datum) / 20) ** 3, atol=1e-12)


def test_joint_effects_are_the_matching_shift_of_the_readings() -> None:
    s, k = (Q - HOME) / 20, np.array([1.0, 2, 3, 4, 5, 6]) * 0.01
    b = np.array([0.01, 0.02, 0.03])
    direction = np.ones_like(Q)
    for row in range(1, len(Q)):
        step = Q[row] - Q[row - 1]
        direction[row] = np.where(np.abs(step) > 1e-9, np.sign(step), direction[row - 1])
    driving = np.stack([
        k[0] * s[:, 1] + k[1] * s[:, 2],
        k[2] * s[:, 0] + k[3] * s[:, 2],
        k[4] * s[:, 0] + k[5] * s[:, 1],
    ], axis=1)  # fmt: skip
    expected = {
        "joint_scale": (b, b * (Q - HOME)),
        "encoder_cyclic": (k, k[::2] * np.sin(np.pi * Q) + k[1::2] * np.cos(np.pi * Q)),
        "encoder_second": (k, k[::2] * np.sin(2 * np.pi * Q) + k[1::2] * np.cos(2 * np.pi * Q)),
        "backlash": (b, 0.5 * b * direction),
        "joint_crosstalk": (k, driving),
        "joint_coupling": (k, driving * s),
    }
    for name, (parameters, shift) in expected.items():
        moved = PLAN | {f"q{i + 1}_mm": Q[:, i] + shift[:, i] for i in range(3)}
        left = truth(ROBOT, PLAN, errors(), {name: parameters}) - truth(ROBOT, moved, errors())
        assert np.abs(left).max() < 1e-11, name


def test_leaning_rail_turns_about_its_home_height() -> None:
    carriages, _, _ = platform_pose(ROBOT, PLAN, None, {"rail_lean": [0.01, 0.02, 0, 0, 0, 0]})
    along = carriages[:, 0] - [0, 90, HOME]
    np.testing.assert_allclose(np.linalg.norm(along, axis=1), np.abs(Q[:, 0] - HOME), atol=1e-11)
    np.testing.assert_allclose(along[:, 1], 0.01 * along[:, 2], atol=1e-12)
    np.testing.assert_allclose(along[:, 0], -0.02 * along[:, 2], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "target"),
    # a robot of its own in every row takes long to simulate
    [pytest.param(name, target, marks=[pytest.mark.slow] * (target < 0.01 or name == "link_growth"))
     for target in (0.0005, 0.01) for name in EFFECTS if name != "sensor_pose"],
)  # fmt: skip
def test_scaled_effect_leaves_the_target(name: str, target: float) -> None:
    effect = scaled_effect(ROBOT, PLAN, name, np.random.default_rng(3), target, errors=errors())
    moved = change(name, effect[name]).ravel()
    basis = fitted_directions(ROBOT, PLAN, errors())
    left = moved - basis @ np.linalg.lstsq(basis, moved, rcond=None)[0]
    assert rms(left) == pytest.approx(target, rel=0.02)


def test_where_the_sensor_stands_is_absorbed() -> None:
    moved = change("sensor_pose", 1e-6 * np.array([1.0, -2.0, 1.5, 20.0, 30.0, -10.0])).ravel()
    basis = fitted_directions(ROBOT, PLAN, errors())
    assert rms(moved - basis @ (basis.T @ moved)) < 1e-5 * rms(moved)


def test_fitted_directions_hold_small_geometric_changes() -> None:
    small = {name: 1e-4 * value for name, value in errors().items()}
    moved = (truth(ROBOT, PLAN, small) - truth(ROBOT, PLAN)).ravel()
    basis = fitted_directions(ROBOT, PLAN)
    assert rms(moved - basis @ (basis.T @ moved)) < 1e-6 * rms(moved)


def test_plan_orders() -> None:
    together = make_plan(ROBOT, local_grid(), 3, "repeats_together")
    assert together["pose"][:4].tolist() == [1, 1, 1, 2]
    assert together["repeat"][:4].tolist() == [1, 2, 3, 1]
    shuffled = make_plan(ROBOT, local_grid(), 3, "shuffled", seed=1)
    for plan in (PLAN, together, shuffled):
        pairs = set(zip(plan["pose"].tolist(), plan["repeat"].tolist(), strict=True))
        assert len(pairs) == len(plan["pose"])
        assert np.all(np.diff(plan["time_s"]) > 2.0)
        assert np.all(np.abs(plan["humidity_pct"] - 45) < 5)
    assert shuffled["repeat"][shuffled["pose"] == 7].tolist() == [1, 2, 3]
    assert np.any(np.diff(shuffled["pose"]) < 0)


def test_grid_rows_are_serpentine() -> None:
    assert whole_grid().shape == (588, 3)
    rows = local_grid().reshape(3, 11, 11, 3)
    assert np.all(np.diff(rows[:, 0, :, 0]) > 0)
    assert np.all(np.diff(rows[:, 1, :, 0]) < 0)


def test_noise_options() -> None:
    plan = make_plan(ROBOT, whole_grid(), 6)
    exact = truth(ROBOT, plan)

    def drawn(noise: Noise) -> Array:
        return xyz(simulate(ROBOT, plan, noise=noise, seed=2)) - exact

    assert drawn(Noise((0.01, 0.02, 0.0))).std(axis=0) == pytest.approx([0.01, 0.02, 0], rel=0.05)
    far = np.hypot(exact[:, 0], exact[:, 1]) > 20
    grown = drawn(Noise(0.01, rim_factor=3.0))
    assert rms(grown[far]) > 1.5 * rms(grown[np.hypot(exact[:, 0], exact[:, 1]) < 10])
    heavy = drawn(Noise(0.01, student=True))
    assert rms(heavy) == pytest.approx(0.01, rel=0.15)
    assert np.abs(heavy).max() > 0.06
    spoiled = np.linalg.norm(drawn(Noise(0.01, outlier_fraction=0.02)), axis=1) > 0.12
    assert np.count_nonzero(spoiled) == round(0.02 * len(exact))
    slow = drawn(Noise(0.01, rho=0.8))
    assert rms(slow) == pytest.approx(0.01, rel=0.1)
    for axis in slow.T:
        assert np.corrcoef(axis[1:], axis[:-1])[0, 1] == pytest.approx(0.8, abs=0.05)


def test_same_seed_same_numbers() -> None:
    def run(seed: int) -> dict[str, NDArray[Any]]:
        plan = make_plan(ROBOT, local_grid(), 2, "shuffled", seed=seed)
        return simulate(ROBOT, plan, errors(), {"backlash": [0.01] * 3}, 0.001, seed=seed)

    first, again, other = run(1), run(1), run(2)
    assert all(np.array_equal(first[name], again[name]) for name in first)
    assert not np.array_equal(first["x_mm"], other["x_mm"])


def test_encoder_step_rounds_only_the_file() -> None:
    plan = make_plan(ROBOT, local_grid())
    rounded = simulate(ROBOT, plan, encoder_step_mm=0.01)
    assert np.abs(rounded["q1_mm"] - plan["q1_mm"]).max() == pytest.approx(0.005, rel=0.1)
    assert np.array_equal(xyz(rounded), truth(ROBOT, plan))


def test_files(tmp_path: Path) -> None:
    write_robot_toml(tmp_path / "robot.toml")
    assert tomllib.loads((tmp_path / "robot.toml").read_text()) == NOMINAL_CONFIG
    columns = simulate(ROBOT, local_grid(), errors(), noise=0.001)
    write_csv(columns, tmp_path / "run.csv")
    lines = (tmp_path / "run.csv").read_text().splitlines()
    assert lines[0] == ",".join(columns)
    assert lines[1].startswith("1,1,0.0000000000,")
    table = np.loadtxt(tmp_path / "run.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table, np.stack(list(columns.values()), axis=1), atol=1e-10)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(ValueError, match="unknown effects"):
        truth(ROBOT, PLAN, None, {"magic": 1.0})
    with pytest.raises(ValueError, match="unknown geometric error"):
        truth(ROBOT, PLAN, {"base_radius_4": 1.0})


def test_what_a_picture_does_beside_the_effects() -> None:
    """Catches a sine of another size, period or axis, an error of a pose that its repeats do not share, and noise that
    changes with what is planted."""
    camera = camera_facing(np.pi / 2, np.pi / 4, 446.2, [710.0, 710.0, 639.5, 319.5])
    robot = SecondSpherical(0.8, 0.8, 200.0, camera)
    joints = robot.joints_at(sphere_grid((1.1, 2.0), (0.5, 1.1), 20))
    plan = spherical_plan(joints, 2, "shuffled", 1)
    plain = robot.run(plan, noise_px=0.1, seed=4)

    def moved(unmodelled: Unmodelled) -> Array:
        shown = robot.run(plan, noise_px=0.1, seed=4, unmodelled=unmodelled)
        return np.column_stack([shown[name] - plain[name] for name in ("u_px", "v_px")])

    u = robot.truth(plan)[:, 0]
    sine = moved(Unmodelled(sine_px=(3.0, 1.0), period_px=37.0, phase_rad=0.3))
    np.testing.assert_allclose(sine, np.outer(np.sin(2 * np.pi * u / 37.0 + 0.3), [3.0, 1.0]), atol=1e-10)
    scatter = moved(Unmodelled(scatter_px=0.4))
    for pose in (1, 7, 400):
        assert np.ptp(scatter[plan["pose"] == pose], axis=0).max() < 1e-10
    assert scatter.std(axis=0) == pytest.approx([0.4, 0.4], rel=0.15)
    np.testing.assert_allclose(moved(Unmodelled()), 0, atol=1e-12)
