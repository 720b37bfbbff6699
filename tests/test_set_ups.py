"""An instrument that was moved between sessions: a column ``setup``, one pose for each value."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import sherkit as sk
import test_arm_counted as arm
import test_discovery as delta
from running import command, slow
from second_simulator import (
    NOMINAL_CONFIG,
    Noise,
    Robot,
    draw_geometric_errors,
    draw_pose,
    grid,
    make_plan,
    scaled_effect,
    simulate,
    write_robot_toml,
)
from sherkit.base.types import Floats
from sherkit.model.rows import EffectRows
from sherkit.model.set_ups import InSetUp

NOISE_MM = 2e-3
AXES = ("x_mm", "y_mm", "z_mm")


def moved(
    seed: int, cuts: tuple[int, ...] = (60, 110), hidden: str = "", *, turned: bool = True
) -> tuple[pl.DataFrame, list[Floats]]:
    """A run of a delta whose tracker stands anywhere, and elsewhere after each of the ``cuts`` in the order of time;
    its poses. What is ``hidden`` leaves five times the noise."""
    rng = np.random.default_rng([seed, 77])
    robot = Robot.from_dict(NOMINAL_CONFIG)
    plan = make_plan(robot, grid(20.0, 5, (-20.0, 0.0, 20.0)), 2, "shuffled", seed)
    errors = draw_geometric_errors(np.random.default_rng([seed, 1]))
    poses = [draw_pose(rng) * np.repeat([float(turned), 1.0], 3) for _ in range(len(cuts) + 1)]
    stands = {"sensor_pose": poses[-1]}
    effects = scaled_effect(robot, plan, hidden, rng, 5 * NOISE_MM, errors=errors, beside=stands) if hidden else {}
    noise = Noise(sigma_mm=NOISE_MM)
    runs = [pl.DataFrame(simulate(robot, plan, errors, effects | {"sensor_pose": p}, noise, seed=seed)) for p in poses]
    order, edges = np.argsort(runs[0]["time_s"].to_numpy()), [0, *cuts, len(runs[0])]
    parts = [
        run[order[a:b]].with_columns(setup=pl.lit("ABCDE"[k]))
        for k, (run, a, b) in enumerate(zip(runs, edges[:-1], edges[1:], strict=True))
    ]
    return pl.concat(parts), poses


def written(folder: Path, table: pl.DataFrame, **tables: Any) -> tuple[Path, Path]:
    """Robot and run as files."""
    write_robot_toml(folder / "robot.toml", NOMINAL_CONFIG | tables)
    table.write_csv(folder / "run.csv")
    return folder / "robot.toml", folder / "run.csv"


# -- the whole story -------------------------------------------------------------------------------------------------


def test_nothing_is_missing_and_where_it_stood_is_told(tmp_path: Path) -> None:
    """Catches set-ups that are taken for one place, and a motion between them that is another than the other
    program's: of the middle of the readings within 5 µm, turned within 0.01°."""
    table, poses = moved(1)
    d = sk.diagnose(*written(tmp_path, table))
    assert d.verdict == "adequate"
    assert d.error.rms < 1.3 * 1e3 * NOISE_MM * np.sqrt(3)
    for name, pose in zip("AB", poses, strict=False):
        one = next(s for s in d.fit.data.set_ups if s.name == name)
        off = {
            p: d.fit.by_name[f"setup={name}.{p}"]
            for p in ("turn_x", "turn_y", "turn_z", "shift_x", "shift_y", "shift_z")
        }
        numbers = np.array(list(off.values()))
        # what is fitted takes the last to the set-up as it was brought there, about its middle
        still = Rotation.from_rotvec(numbers[:3])
        turn = still.inv() * Rotation.from_matrix(one.turn)
        true = Rotation.from_rotvec(poses[-1][:3]) * Rotation.from_rotvec(pose[:3]).inv()
        assert np.rad2deg((turn * true.inv()).magnitude()) < 0.01
        at = np.array(one.turn).T @ (np.array(one.middle_mm) + numbers[3:] - one.shift_mm)
        np.testing.assert_allclose(true.apply(at - pose[3:]) + poses[-1][3:], one.middle_mm, atol=5e-3)
        assert any(note.startswith(f"setup '{name}': the instrument saw the robot ") for note in d.notes)


@pytest.mark.parametrize("name", ["backlash", *slow("rail_lean")])
def test_an_effect_is_named_beside_set_ups(name: str, tmp_path: Path) -> None:
    """Catches poses of set-ups that take an effect up, and an effect that acts along the axes of another set-up."""
    table, _ = moved(2, hidden=name)
    d = sk.diagnose(*written(tmp_path, table))
    assert d.effects == (name,)
    assert d.verdict == "explained"
    assert d.not_needed == ()


def test_what_is_deployed_is_seen_from_the_last(tmp_path: Path) -> None:
    """Catches a calibration in the axes of the first set-up, or in none: it says what the last read, within the noise.
    That is told."""
    table, _ = moved(3)
    robot, run = written(tmp_path, table)
    with pytest.warns(sk.SherkitWarning, match="in setup 'C'"):
        made = sk.calibrate(robot, run, correction="none").calibration
    made.save(tmp_path / "calibrated.toml")
    assert "setup C" in (tmp_path / "calibrated.toml").read_text()
    back = sk.load_calibration(tmp_path / "calibrated.toml")
    last = table.filter(pl.col("setup") == "C")
    seen = np.array([back.forward(q) for q in last.select("q1_mm", "q2_mm", "q3_mm").to_numpy()])
    left = seen - last.select(AXES).to_numpy()
    assert np.sqrt((left**2).mean()) < 1.3 * NOISE_MM


def test_unchanged_where_only_the_instrument_moved(tmp_path: Path) -> None:
    """Catches a comparison that takes the second run for one of one place."""
    first, _ = moved(4)
    other, _ = moved(4, cuts=(80,))
    robot, _ = written(tmp_path, first)
    later = other.with_columns(setup=pl.col("setup") + "2", time_s=pl.col("time_s") + 1e6)
    noise = np.random.default_rng(0).normal(0.0, NOISE_MM, (len(later), 3))
    later = later.with_columns(pl.Series(name, later[name] + noise[:, k]) for k, name in enumerate(AXES))
    found = sk.compare(robot, [first, later])
    assert found.headline == "unchanged"


def test_held_turns_leave_each_set_up_its_shift(tmp_path: Path) -> None:
    """Catches a set-up that is turned though the robot's file holds the turns."""
    table, _ = moved(5, turned=False)
    fit = sk.identify(*written(tmp_path, table, sensor_pose={"free": True, "turn_sd_deg": 0.0}))
    own = [p.name for p in fit.parameters if p.name.startswith("setup=")]
    assert own == [f"setup={name}.shift_{axis}" for name in "AB" for axis in "xyz"]
    assert all(one.turn == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)) for one in fit.data.set_ups)
    assert fit.error.rms < 1.4 * 1e3 * NOISE_MM * np.sqrt(3)


def test_a_held_pose_knows_no_set_ups(tmp_path: Path) -> None:
    """Catches a set-up with numbers of its own where the robot's file says where the instrument stands."""
    table, _ = moved(5)
    fit = sk.identify(*written(tmp_path, table, sensor_pose={"free": False}))
    assert fit.data.set_ups == ()


# -- the same however it is written ---------------------------------------------------------------------------------


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), numbered=st.booleans())
def test_names_and_the_order_of_rows_say_nothing(seed: int, numbered: bool) -> None:
    """Catches set-ups in the order of their names or rows: the last is the last in time."""
    table, _ = moved(6)
    rng = np.random.default_rng(seed)
    texts = [str(one) for one in rng.permutation(["α", "b 2", "x"])]
    names: list[Any] = [int(k) for k in rng.permutation(9)[:3]] if numbered else texts
    with_names = table.with_columns(setup=pl.col("setup").replace_strict(dict(zip("ABC", names, strict=True))))
    plain = sk.identify(delta.DELTA, sk.from_frame(table))
    other = sk.identify(delta.DELTA, sk.from_frame(with_names[rng.permutation(len(table))]))
    assert other.data.last_set_up == str(names[2])
    count = len(plain.model.bare)
    np.testing.assert_allclose(other.values[:count], plain.values[:count], rtol=0, atol=1e-6)
    assert other.rms() == pytest.approx(plain.rms(), rel=1e-6)


def test_derivatives_are_exact() -> None:
    """Catches a turn about another point, or with the other sign, in the columns of a set-up."""
    table, _ = moved(6)
    data = sk.from_frame(table)
    rng = np.random.default_rng(0)
    position = rng.normal(size=(len(data), 3)) * 100
    rows, one = EffectRows(data, lambda: position), InSetUp("B", (10.0, -20.0, 30.0))
    names = ("turn_x", "turn_z", "shift_y")
    at = rng.normal(size=3)
    made = one.derivative(rows, SimpleNamespace(**dict(zip(names, at, strict=True))))
    for k, step in enumerate(1e-6 * np.eye(3)):
        up, down = (one(rows, SimpleNamespace(**dict(zip(names, at + s, strict=True)))) for s in (step, -step))
        np.testing.assert_allclose(made[:, :, k], (up - down) / 2e-6, atol=1e-6)
    assert not made[table["setup"].to_numpy() != "B"].any()


def elsewhere(table: pl.DataFrame, rows: Any, seed: int) -> pl.DataFrame:
    """The table where these rows were read from another place."""
    rng = np.random.default_rng(seed)
    at = table.select(AXES).to_numpy().copy()
    at[rows] = Rotation.random(random_state=seed).apply(at[rows]) + rng.uniform(-300, 300, 3)
    names = np.where(np.isin(np.arange(len(at)), rows), "before", "after")
    return table.with_columns(pl.Series(n, at[:, k]) for k, n in enumerate(AXES)).with_columns(setup=pl.Series(names))


def test_for_an_arm_and_a_machine(tmp_path: Path) -> None:
    """Catches set-ups that only a delta has: what is left is what was left of one place, but for six numbers more."""
    robot = arm.arm_in(tmp_path)
    run = arm.simulated(robot, 1, arm.ROWS)
    plain = sk.identify(robot, run)
    table = elsewhere(sk.identify(robot, run).data.to_frame(), np.arange(arm.ROWS // 2), 3)
    fit = sk.identify(robot, sk.from_frame(table))
    assert len(fit.values) == len(plain.values) + 6
    assert fit.error.rms < 1.15 * plain.error.rms

    def gantry(q: Floats, p: Any) -> Floats:
        x, y, z = q.T
        return np.stack([x + p.squareness_xy * y, y, z + p.tilt * x], axis=1)

    machine = sk.Machine(
        gantry, joints={"a_mm": (0, 400), "b_mm": (0, 300), "c_mm": (0, 200)}, readings=AXES,
        parameters={"squareness_xy": ("rad", 1e-3), "tilt": ("rad", 1e-3)}, sensor_pose="free",
    )  # fmt: skip
    rng = np.random.default_rng(2)
    q = rng.uniform(0, 1, (120, 3)) * [400, 300, 200]
    read = gantry(q, SimpleNamespace(squareness_xy=8e-4, tilt=-5e-4)) + rng.normal(0, NOISE_MM, q.shape)
    columns = dict(zip(("a_mm", "b_mm", "c_mm", *AXES), [*q.T, *read.T], strict=True))
    table = elsewhere(pl.DataFrame(columns).with_columns(time_s=pl.int_range(120) * 3.0), np.arange(50), 4)
    fit = sk.identify(machine, table)
    assert len(fit.data.set_ups) == 1
    assert max(fit.rms().values()) < 1.2e3 * NOISE_MM


# -- what is wrong ---------------------------------------------------------------------------------------------------

ONE_POSE = pl.when(pl.int_range(pl.len()) < 1).then(pl.lit("A")).otherwise(pl.lit("B"))
SIXTH = pl.int_range(pl.len()) == 5


@pytest.mark.parametrize(
    ("column", "made", "said"),
    [
        (
            "setup",
            ONE_POSE,
            r"setup 'A' has 1 rows with x_mm, y_mm, z_mm: these do not tell where",
        ),
        ("setup", pl.when(SIXTH).then(pl.lit("")).otherwise(pl.col("setup")), r"line 7, column 'setup': is empty"),
        ("setup", pl.when(SIXTH).then(1.5).otherwise(2.0), r"line 7, column 'setup': 1.5 is not a whole number"),
        (
            "z_mm",
            pl.when(SIXTH).then(None).otherwise(pl.col("z_mm")),
            r"line 7: setup 'A': one coordinate says",
        ),
    ],
)
def test_bad_input(column: str, made: pl.Expr, said: str, tmp_path: Path) -> None:
    """Catches a traceback, and a set-up that is guessed: one sentence with line, column and what to do."""
    table, _ = moved(1)
    written(tmp_path, table.with_columns(made.alias(column)))
    code, out, error = command(tmp_path, "diagnose", "robot.toml", "run.csv")
    assert code == 1
    assert not out
    with pytest.raises(sk.SherkitError, match=said):
        sk.diagnose(tmp_path / "robot.toml", tmp_path / "run.csv")
    assert "Traceback" not in error


@pytest.mark.slow
def test_exchanged_columns_are_found_in_set_ups(tmp_path: Path) -> None:
    """Catches set-ups whose registrations turn a mirror into as many shapes as there are: it is one mistake in all."""
    table, _ = moved(1)
    wrong = table.with_columns(x_mm=pl.col("y_mm"), y_mm=pl.col("x_mm"))
    d = sk.diagnose(*written(tmp_path, wrong))
    assert "left-handed" in d.headline


@pytest.mark.slow
def test_one_name_for_two_places_is_no_effect(tmp_path: Path) -> None:
    """Catches an effect of the robot where the instrument was moved within what is called one set-up."""
    table, _ = moved(1)
    wrong = table.with_columns(setup=pl.col("setup").replace_strict({"A": 1, "B": 2, "C": 2}))
    d = sk.diagnose(*written(tmp_path, wrong))
    assert d.verdict in ("unexplained", "undecided") or d.effects == ("sensor_slip",)


def test_a_camera_has_no_set_ups() -> None:
    """Catches a column that is ignored where it could not be used."""
    import test_spherical_discovery as spherical

    run = spherical.measured("small", 1)
    half = np.where(np.arange(len(run.data)) < len(run.data) // 2, "a", "b").astype(object)
    data = replace(run.data, labels={**run.data.labels, "setup": half})
    with pytest.raises(sk.SherkitError, match="give the rows of each set-up a run of its own"):
        sk.identify(spherical.ROBOT, data)
