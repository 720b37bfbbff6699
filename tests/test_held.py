"""Parameters that are held at the drawing are candidates like effects: what a person did not free is not physics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

import sherkit as sk
from consistency import named
from second_simulator import NOMINAL_CONFIG, Noise, Robot, grid, make_plan, simulate
from second_simulator.spherical import spherical_plan
from sherkit.robots.serial import postures
from test_arm_counted import OwnArm, arm_in
from test_discovery import DELTA
from test_spherical_discovery import ERRORS, PLANS, ROBOT, real_robot


def test_a_joint_of_an_arm_that_reads_from_another_zero(tmp_path: Path) -> None:
    """Catches "unexplained" of an arm whose third joint is off by 0.02 rad, where the frames alone are free."""
    arm, own = arm_in(tmp_path), OwnArm.drawn()
    own.table[2, 4] = 0.02
    free = [name for name in sk.serial.SerialModel(arm).free if name.startswith(("sensor", "tool"))]
    run = own.run(arm, postures(arm, 80, 0.9, 1), 1, declared=True)
    d = sk.diagnose(sk.identify(arm, run, free=free))
    assert d.verdict == "explained", d.headline
    assert d.effects == ("free offset_3",)
    freed = sk.identify(arm, run, free=free, effects=["free offset_3"])
    assert freed.model.free == (*free, "offset_3")
    assert freed.by_name["offset_3"] == pytest.approx(0.02, abs=1e-4)
    assert d.fit.by_name["offset_3"] == pytest.approx(freed.by_name["offset_3"], rel=1e-6)
    # all that may be free is so by default: nothing is left to be proposed
    assert not sk.serial.SerialModel(arm).held


@pytest.mark.slow
def test_a_rod_of_a_delta_that_nobody_freed() -> None:
    """Catches the same on the other kinds of robot: a rod longer by 0.3 mm."""
    plan = make_plan(Robot.from_dict(NOMINAL_CONFIG), grid(20.0, 7, (-20.0, 0.0, 20.0)), 2, "shuffled", 3)
    columns = simulate(Robot.from_dict(NOMINAL_CONFIG), plan, {"rod_length_2": 0.3}, {}, Noise(0.002), 3)
    model = sk.delta.DeltaModel(DELTA)
    free = [name for name in model.free if name != "rod_length_2"]
    d = sk.diagnose(sk.identify(DELTA, sk.from_frame(pl.DataFrame(columns)), free=free))
    assert d.verdict == "explained", d.headline
    assert "free rod_length_2" in named(d)
    study = sk.Study(DELTA, sk.from_frame(pl.DataFrame(columns)), free=free)
    study.add("free rod_length_2")
    assert study.fit.by_name["rod_length_2"] == pytest.approx(0.3, abs=4.0 * study.fit.std_from_readings[-1])
    assert study.history[-1].action == "free rod_length_2"
    study.calibration()
    data = sk.from_frame(pl.DataFrame(columns))
    made = sk.calibrate(DELTA, data, free=free, effects=["free rod_length_2"], correction="none")
    assert made.whole.fit.by_name["rod_length_2"] == pytest.approx(study.fit.by_name["rod_length_2"])


def test_an_arc_of_a_spherical_robot_that_nobody_freed() -> None:
    """Catches the same of a camera's robot: β is off by a degree, and held."""
    plan = spherical_plan(PLANS["small"], 3, "shuffled", 2)
    columns = real_robot(2).run(plan, noise_px=0.05, seed=2)
    data = sk.from_frame(pl.DataFrame(columns))
    d = sk.diagnose(sk.identify(ROBOT, data, free=["alpha", "radius"]))
    assert "free beta" in named(d), d.headline
    assert d.verdict == "explained"
    assert abs(d.fit.by_name["beta"] - ERRORS[1]) < 0.6 * abs(ERRORS[1])


def test_a_number_of_ones_own_machine_that_nobody_freed() -> None:
    """Catches a machine of one's own whose held number is not proposed; and one that is free by default."""
    machine = sk.Machine(
        lambda q, p: (100.0 + p.length) * np.column_stack([np.cos(q), np.sin(q) + p.skew]) + [[p.zero, 0.0]],
        ("q_rad",), ("x_mm", "y_mm"),
        {"length": ("mm", 1.0), "zero": ("mm", 1.0), "skew": ("1", 0.01)}, name="crank",
    )  # fmt: skip
    rng = np.random.default_rng(5)
    q = np.repeat(rng.uniform(-3.0, 3.0, 60), 2)
    x = np.column_stack([100.5 * np.cos(q), 100.5 * np.sin(q) + 0.4]) + 0.01 * rng.normal(size=(120, 2))
    frame = pl.DataFrame({"q_rad": q, "x_mm": x[:, 0], "y_mm": x[:, 1]})
    d = sk.diagnose(sk.identify(machine, frame, free=["length", "zero"]))
    assert "free skew" in named(d), d.headline
    every = sk.diagnose(machine, frame)
    assert every.verdict == "adequate", every


def test_what_nothing_misses_frees_nothing() -> None:
    """Catches a parameter that is freed because it is there: the arc is as drawn, and held."""
    plan = spherical_plan(PLANS["small"], 3, "shuffled", 2)
    robot = real_robot(2).changed(beta_rad=np.pi / 4)
    columns = robot.run(plan, noise_px=0.05, seed=2)
    d = sk.diagnose(sk.identify(ROBOT, sk.from_frame(pl.DataFrame(columns)), free=["alpha", "radius"]))
    assert d.verdict == "adequate", d.headline
