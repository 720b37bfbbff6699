"""Stands that expand with the room, perhaps long after it, and joints that lose steps: for every robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy import integrate, stats

import sherkit as sk
import test_arm_counted as arm
import test_discovery as delta
import test_spherical_discovery as spherical
from consistency import named
from running import slow
from second_simulator import grid
from sherkit.base.types import Floats
from sherkit.data.in_time import Room

NEW = ("thermal_shift", "joint_slip")
#: Chance with which a correct program fails one of the counts below.
RARE = 1e-3
AXES = ("x_mm", "y_mm", "z_mm")


@pytest.mark.parametrize("lag_s", [3.0, 200.0, 5000.0])
def test_what_lags_follows_its_equation(lag_s: float) -> None:
    """Catches a lag of another order or sign, and one that forgets how far readings lie apart: against a solver of
    differential equations, at uneven times, some of them equal."""
    rng = np.random.default_rng(1)
    time = np.sort(np.r_[rng.uniform(0.0, 3000.0, 60), 700.0, 700.0])
    room = 20.0 + np.sin(time / 400.0) + time / 1000.0
    order = rng.permutation(len(time))
    made = Room.of(time[order], room[order])
    found = made.later(time, lag_s)

    def slope(t: float, stand: Floats) -> Floats:
        return (np.interp(t, time, room) - stand) / lag_s

    solved = integrate.solve_ivp(slope, (time[0], time[-1]), [room[0]], t_eval=np.unique(time), max_step=2.0, rtol=1e-9)
    np.testing.assert_allclose(found, np.interp(time, solved.t, solved.y[0]), atol=2e-5)


def test_rows_of_a_run_know_its_whole_room() -> None:
    """Catches a stand that is as warm as the room at the first of some rows: a fold of a run begins in its middle."""
    data = delta.measured(delta.GRIDS["small"], 1).data
    whole = data.later(600.0)
    rows = np.arange(100, 400, 3)
    some = data.select(rows).later(600.0)
    assert some is not None
    np.testing.assert_array_equal(some, whole[rows])


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_the_lag_of_a_stand_is_found(seed: int) -> None:
    """Catches a lag that stays where the grid has it, is not used by the fit, or not told. Five times the noise: the
    other program's lag within a quarter, and what is left at the noise."""
    run = delta.measured(delta.GRIDS["small"], seed, scaled={"thermal_shift": 5 * delta.NOISE_UM})
    d = run.diagnose()
    assert d.effects == ("thermal_shift",)
    true = run.effects["thermal_shift"][3]
    assert abs(d.fit.model.thermal_shift_lag_s / true - 1) < 0.25
    assert abs(d.steps[-1].error.rms / np.sqrt(d.error.axes) / delta.NOISE_UM - 1) < delta.held_out_allowance(d)
    assert any("after the recorded temperature" in note for note in d.notes)


def test_a_loop_is_not_given_what_a_stand_does() -> None:
    """Catches a control loop that moves with the tripod of an instrument that is no longer there."""
    run = delta.measured(delta.GRIDS["whole"], 2, scaled={"thermal_shift": delta.NOISE_UM}, repeats=1)
    made = sk.calibrate(delta.DELTA, run.data, effects=["thermal_shift"], correction="none").calibration
    q = delta.DELTA.inverse([1.0, 2.0, 3.0])
    np.testing.assert_array_equal(made.forward(q, temperature_c=15.0), made.forward(q, temperature_c=25.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"),
    [("joint_slip", 2), ("slip", 1), ("joint_slip", 7)],
)
def test_a_wave_as_long_as_the_poses_lie_apart_is_none(name: str, seed: int) -> None:
    """Catches what "repeats with z, period 10" where the planes lie 10 mm apart: any bend does. Without time and
    temperature nothing has a name here."""
    points = grid(20.0, 9, (-20.0, -10.0, 0.0, 10.0, 20.0))
    run = delta.measured(points, seed, scaled={name: 3 * delta.NOISE_UM}, repeats=1, order="planes")
    frame = run.data.to_frame().drop("time_s", "temperature_c", "humidity_pct")
    d = sk.diagnose(delta.DELTA, sk.from_frame(frame))
    assert d.signature["shape"] != "periodic"


# -- rates ---------------------------------------------------------------------------------------------------------


def _of_delta(name: str, folder: Path) -> Iterator[sk.diagnosis.Diagnosis]:
    del folder
    for seed in range(100, 110):
        for ratio in (2, 5):
            yield delta.hidden(name, ratio, "whole", seed)


def _of_spherical(name: str, folder: Path) -> Iterator[sk.diagnosis.Diagnosis]:
    del folder
    for seed in range(100, 110):
        for ratio in (2, 5):
            yield spherical.hidden(name, ratio, "local", seed)


def _of_an_arm(name: str, folder: Path) -> Iterator[sk.diagnosis.Diagnosis]:
    robot = arm.arm_in(folder)
    for seed in range(100, 108):
        for ratio in (2, 5):
            hidden = arm.hidden_at(robot, name, ratio, seed)
            yield sk.diagnose(robot, arm.simulated(robot, seed, arm.ROWS, **hidden))


@pytest.mark.slow
@pytest.mark.parametrize("runs", [_of_delta, _of_spherical, _of_an_arm], ids=["delta", "spherical", "arm"])
@pytest.mark.parametrize("name", NEW)
def test_they_lead_or_are_tied_in_98_of_100(
    name: str, runs: Callable[[str, Path], Iterator[sk.diagnosis.Diagnosis]], tmp_path: Path
) -> None:
    """Catches a stand or a slip that is taken for something else. At 2 and 5 times the noise, seeds from 100; binomial
    allowance of 1 in 1,000. Machines are counted in ``test_machine.py``."""
    right = [name in named(d) for d in runs(name, tmp_path)]
    assert right.count(False) <= stats.binom.isf(RARE, len(right), 0.02)


@pytest.mark.parametrize("seed", [1, *slow(0, 2, 3)])
@pytest.mark.parametrize("course", ["drift", *slow("sensor_slip")])
def test_a_slow_drift_is_no_instrument_that_was_knocked(course: str, seed: int) -> None:
    """Catches "the instrument moved", at a moment that means nothing, of readings that drift evenly by one noise, and
    a knock of as much that is called a drift."""
    run = delta.measured(delta.GRIDS["small"], seed).data.to_frame()
    t = run["time_s"] / run["time_s"].max()
    by = t if course == "drift" else (t > 0.4).cast(float)
    ways = np.random.default_rng(seed).choice([-1.0, 1.0], 3)
    moved = {name: run[name] + 1e-3 * delta.NOISE_UM * way * by for name, way in zip(AXES, ways, strict=True)}
    found = sk.diagnose(delta.EXAMPLE, run.with_columns(**moved))
    assert found.effects == (course,), found.headline
