"""Full poses of an arm's tool, as an instrument with a body of several marks gives them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import sherkit as sk
from running import slow
from second_arms import SecondArm
from sherkit.cli import main
from sherkit.errors import MeasurementError, SherkitWarning
from sherkit.robots.serial import KIND, Hidden, Serial, points_of_poses, postures

Floats = NDArray[np.float64]
#: The instrument: noise of a place, mm, and of a turn, rad, the same at a lever of 100 mm.
PLACE_MM, TURN_RAD = 0.02, 2e-4


def arm() -> Serial:
    """The example, its tool turned in the hand."""
    return replace(KIND.example, tool_rpy_deg=(20.0, -35.0, 110.0))


@lru_cache(maxsize=8)
def measured(robot: Serial, seed: int, rows: int = 45, **hidden: Any) -> pl.DataFrame:
    """Places and turns of the tool of a virtual arm, read by an instrument that stands anywhere."""
    rng = np.random.default_rng(seed)
    plain = SecondArm.simulated(
        robot, seed, 1.0, {"noise_um": 0.0, "yield_mrad": 0.0, "play_mrad": 0.0, "ring_mrad": 0.0}
    )
    virtual = replace(plain, effects=Hidden(**hidden), noise_mm=0.0)
    # three more points of the body give its turn, written apart from what is tested
    held = Rotation.from_euler("xyz", robot.tool_rpy_deg, degrees=True).as_matrix()
    more = tuple(tuple(np.array(robot.target_mm) + 50.0 * held[:, axis]) for axis in range(3))
    virtual = replace(virtual, robot=replace(robot, more_targets_mm=more))
    every = virtual.measure(postures(robot, rows, 0.9, seed), repeats=2, seed=seed).to_frame()
    frame = every.filter(pl.col("target") == 1).drop("target")
    points = every[["x_mm", "y_mm", "z_mm"]].to_numpy().reshape(-1, 4, 3)
    body = (points[:, 1:] - points[:, :1]).transpose(0, 2, 1) / 50.0
    turn = Rotation.from_rotvec(rng.normal(0, TURN_RAD, (len(frame), 3))) * Rotation.from_matrix(body)
    noise = rng.normal(0, PLACE_MM, (len(frame), 3))
    places = {name: frame[name] + noise[:, k] for k, name in enumerate(("x_mm", "y_mm", "z_mm"))}
    quaternion = dict(zip(("qx", "qy", "qz", "qw"), turn.as_quat().T, strict=True))
    return frame.with_columns(**places, **{name: pl.Series(values) for name, values in quaternion.items()})


def as_vectors(frame: pl.DataFrame, unit: str) -> pl.DataFrame:
    turn = Rotation.from_quat(frame[["qx", "qy", "qz", "qw"]].to_numpy()).as_rotvec(degrees=unit == "deg")
    vectors = {f"r{axis}_{unit}": pl.Series(turn[:, k]) for k, axis in enumerate("xyz")}
    return frame.drop("qx", "qy", "qz", "qw").with_columns(**vectors)


def test_every_way_to_write_a_turn_is_the_same() -> None:
    """Catches degrees taken for radians, a quaternion whose scalar comes first, and a turn the other way."""
    frame = measured(arm(), 1, rows=20)
    ways = (frame, as_vectors(frame, "rad"), as_vectors(frame, "deg"))
    robots, runs = zip(*(points_of_poses(arm(), sk.from_frame(way)) for way in ways), strict=True)
    assert robots[0] == robots[1] == robots[2]
    for run in runs:
        np.testing.assert_allclose(run.readings[:, :3], runs[0].readings[:, :3], atol=1e-9)
        assert len(run) == 3 * len(frame)
    np.testing.assert_array_equal(runs[0].covariates["target"][:6], [1, 2, 3, 1, 2, 3])
    assert list(runs[0].line[:4]) == [0, 0, 0, 1]
    apart = runs[0].readings[:, :3].reshape(-1, 3, 3)
    np.testing.assert_allclose(np.linalg.norm(apart[:, 1:] - apart[:, :1], axis=2), 100.0, rtol=1e-12)


@pytest.mark.parametrize(
    ("written", "said"),
    [
        (lambda q: np.roll(q, 1, axis=1), "they are read as a quaternion, its real part first"),
        (lambda q: q * [-1, -1, -1, 1], "they are read as .* from the instrument's axes to the tool's"),
    ],
)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_quaternion_written_otherwise_is_read_as_it_is(written: Any, said: str, seed: int) -> None:
    """Catches the scalar first under qx, qy, qz, qw taken for the turn the other way: both fit the turns between poses,
    and one of them the places as well."""
    frame = measured(arm(), seed, rows=20)
    names = ("qx", "qy", "qz", "qw")
    other = frame.with_columns(**dict(zip(names, written(frame[list(names)].to_numpy()).T, strict=True)))
    with pytest.warns(SherkitWarning, match=said):
        _, run = points_of_poses(arm(), sk.from_frame(other))
    _, meant = points_of_poses(arm(), sk.from_frame(frame))
    np.testing.assert_allclose(run.readings[:, :3], meant.readings[:, :3], atol=1e-9)


def test_degrees_under_radians_are_degrees() -> None:
    """Catches "are the joints those of this arm?" where rotation vectors are in degrees under names of radians."""
    frame = measured(arm(), 1, rows=20)
    names = {f"r{axis}_deg": f"r{axis}_rad" for axis in "xyz"}
    with pytest.warns(SherkitWarning, match="read as a rotation vector, in deg"):
        _, run = points_of_poses(arm(), sk.from_frame(as_vectors(frame, "deg").rename(names)))
    _, meant = points_of_poses(arm(), sk.from_frame(frame))
    np.testing.assert_allclose(run.readings[:, :3], meant.readings[:, :3], atol=1e-9)


def test_the_turn_of_a_tool_tells_more_than_its_place() -> None:
    """Catches points that lie elsewhere in the hand: three tell more of the arm than a place alone, and leave the noise
    of the instrument."""
    robot, run = points_of_poses(arm(), sk.from_frame(measured(arm(), 2)))
    fit = sk.identify(robot, run)
    assert fit.rank > sk.identify(arm(), sk.from_frame(measured(arm(), 2).drop("qx", "qy", "qz", "qw"))).rank
    # noise of the place, and of the turn at the lever, in two directions of three
    expected = 1e3 * np.sqrt(PLACE_MM**2 + 2 / 3 * 2 / 3 * (100 * TURN_RAD) ** 2)
    assert np.sqrt(np.mean(np.array([fit.rms()[f"{a}_mm"] for a in "xyz"]) ** 2)) == pytest.approx(expected, rel=0.1)
    # the body keeps its shape, though each point of it is free
    known = dict(zip((p.name for p in fit.parameters), fit.values.tolist(), strict=True))
    off = [[known.get(f"{p}_{a}", 0.0) for a in "xyz"] for p in ("tool", "target_2", "target_3")]
    points = np.array(robot.targets_mm) + off
    assert np.linalg.norm(points[1] - points[0]) == pytest.approx(100.0, abs=0.05)
    assert (points[1] - points[0]) @ (points[2] - points[0]) == pytest.approx(0.0, abs=5.0)


@pytest.mark.parametrize(
    ("seed", "hidden", "says"),
    [
        (3, {}, ()),
        *slow((4, {}, ()), (3, {"play": 4e-4}, ("backlash",)), (4, {"gives": 1e-3}, ("joint_compliance",))),
    ],
)
def test_a_diagnosis_of_full_poses(seed: int, hidden: dict[str, float], says: tuple[str, ...]) -> None:
    """Catches three witnesses made of one pose, and a turn that hides what its place shows."""
    robot, run = points_of_poses(arm(), sk.from_frame(measured(arm(), seed, **hidden).drop("temperature_c")))
    found = sk.diagnose(robot, run)
    assert (found.verdict, found.effects) == ("explained" if says else "adequate", says)


def test_declared_noise_of_places_is_left_out() -> None:
    """Catches a sigma of the place that is taken for that of a point a lever away."""
    frame = measured(arm(), 1, rows=10).with_columns(
        sigma_x_mm=pl.lit(0.02), sigma_y_mm=pl.lit(0.02), sigma_z_mm=pl.lit(0.02)
    )
    with pytest.warns(SherkitWarning, match="sigma_x_mm, sigma_y_mm.* the noise of places alone"):
        _, run = points_of_poses(arm(), sk.from_frame(frame))
    assert not np.isfinite(run.sigma).any()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda f: f.drop("qw"),
            "frame: no columns tell the turn of a pose; expected rx_rad, ry_rad, rz_rad or rx_deg",
        ),
        (lambda f: f.with_columns(qw=pl.col("qw") + 0.5), "expected a quaternion of length one, found"),
        (lambda f: f.with_columns(qx=pl.lit("a")), "qx: expected a number"),
        (lambda f: f.with_columns(target=pl.lit(1.0)), "this arm has other targets already"),
        (lambda f: f.with_columns(pl.col("x_mm", "y_mm", "z_mm") / 1e3), "look like metres: places lie .* multiply by"),
        (lambda f: f.with_columns(pl.col("x_mm", "y_mm", "z_mm") / 25.4), "look like inches"),
    ],
)
def test_what_is_no_pose_is_refused(change: Any, said: str) -> None:
    """Catches Euler angles and damaged quaternions that would be turned into places."""
    with pytest.raises(MeasurementError, match=said):
        points_of_poses(arm(), sk.from_frame(change(measured(arm(), 1, rows=8))))


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a folder whose two files do not belong together, and a robot that is no arm."""
    sk.save_robot(arm(), tmp_path / "arm.toml")
    measured(arm(), 5).write_csv(tmp_path / "poses.csv")
    run = [str(tmp_path / name) for name in ("arm.toml", "poses.csv")]
    with pytest.raises(SystemExit) as ended:
        main(["import", "poses", *run, "-o", str(tmp_path / "points")])
    assert ended.value.code == 0
    assert "270 rows, three for each pose" in capsys.readouterr().out
    fit = sk.identify(str(tmp_path / "points" / "robot.toml"), str(tmp_path / "points" / "run.csv"))
    assert fit.scale == pytest.approx(1.0, rel=0.15)
    with pytest.raises(SystemExit) as ended:
        main(["import", "poses", *run, "-o", str(tmp_path / "no"), "--lever-mm", "0"])
    assert ended.value.code == 1
    assert "lever_mm: expected a length above 0" in capsys.readouterr().err
