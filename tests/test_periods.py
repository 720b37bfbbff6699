"""The period of a cyclic error: searched, kept where the file is right, and carried to what is deployed."""

from __future__ import annotations

import itertools
import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import sherkit as sk
import worlds
from running import slow
from sherkit.diagnosis.selection import adopting
from sherkit.model.kinds import model_of
from strategies import EXAMPLE
from worlds import NOISE_UM, World, settings_without

NO_PITCH = settings_without("pole_pitch_mm")


def notes_on_periods(d: sk.diagnosis.Diagnosis) -> list[str]:
    return [note for note in d.notes if "period" in note]


#: Robot files without a pitch say so.
pytestmark = pytest.mark.filterwarnings("ignore:.*is left out")


@pytest.mark.slow
def test_a_pitch_that_is_right_stays() -> None:
    """Catches a searched period in place of the file's where it is as good, and words on it."""
    d = worlds.delta_world(0, {"encoder_cyclic": 2 * NOISE_UM}).ask().diagnosis
    assert d.effects == ("encoder_cyclic",)
    assert d.fit.model.period_mm == 2.0
    assert notes_on_periods(d) == []


def test_a_pitch_that_is_wrong_is_said_with_the_right_one() -> None:
    """Catches a name that is given at the file's period, and a deviation that is none: five of them at most."""
    d = worlds.pitch_wrong(0).ask().diagnosis
    (note,) = notes_on_periods(d)
    value, std = (float(part.split()[0]) for part in note.split("period ")[1].split("±"))
    assert abs(value - 2.0) < 5 * std < 0.005
    assert "2.05 mm" in note


def lattice(spacing_mm: float, per_side: int) -> np.ndarray:
    """Positions (n, 3) whose joint readings stand on a lattice."""
    nominal = worlds.clean(0).robot
    middle = np.array(nominal.inverse((0.0, 0.0, 0.0)))
    steps = spacing_mm * (np.arange(per_side) - (per_side - 1) / 2)
    joints = np.array([middle + step for step in itertools.product(steps, repeat=3)])
    return nominal.forward_batch(joints).values


def test_an_alias_is_said() -> None:
    """Catches one of two periods given as the finding where the readings stand on a lattice and cannot tell them."""
    spacing, period = 2.5, 8.0
    world = worlds.delta_world(
        0, {"encoder_cyclic": 4 * NOISE_UM}, NO_PITCH, points=lattice(spacing, 8), repeats=1, period_mm=period
    )
    other = 1.0 / (1.0 / spacing - 1.0 / period)
    d = world.ask().diagnosis
    assert d.effects == ("encoder_cyclic",)
    told = " ".join(note for note in d.notes if "alias" in note)
    found = d.fit.model.period_mm
    right, wrong = (period, other) if abs(found - period) < abs(found - other) else (other, period)
    assert found == pytest.approx(right, rel=0.01)
    numbers = [float(word.strip(",")) for word in told.split() if word.strip(",").replace(".", "", 1).isdigit()]
    assert any(abs(number / wrong - 1) < 0.01 for number in numbers)


@pytest.mark.slow
def test_the_file_decides_between_aliases() -> None:
    """Catches a file that is overruled by an alias which fits as well."""
    world = worlds.delta_world(
        0, {"encoder_cyclic": 4 * NOISE_UM}, settings_without(pole_pitch_mm=8.0), points=lattice(2.5, 8), repeats=1,
        period_mm=8.0,
    )  # fmt: skip
    d = world.ask().diagnosis
    assert d.effects == ("encoder_cyclic",)
    assert d.fit.model.period_mm == 8.0


def test_an_effect_of_unknown_period_is_refused_or_searched() -> None:
    """Catches a period of 1.0 mm that nobody gave."""
    world = worlds.pitch_left_out(0)
    data = world.study().data
    with pytest.raises(sk.errors.EffectError, match="pole_pitch_mm"):
        sk.identify(world.robot, data, effects=["encoder_cyclic"])
    study = world.study()
    study.add("encoder_cyclic")
    assert study.model.period_mm == pytest.approx(2.0, rel=1e-3)


def test_the_period_is_deployed(tmp_path: Path) -> None:
    """Catches a calibration that runs at the period of the file, or none."""
    world = worlds.pitch_wrong(0)
    result = sk.calibrate(world.robot, world.study().data, effects=["encoder_cyclic"], correction="none")
    made = result.calibration
    assert made.robot.pole_pitch_mm == pytest.approx(2.0, rel=1e-3)
    made.save(tmp_path / "c.toml")
    again = sk.load_calibration(tmp_path / "c.toml")
    point = (3.0, -4.0, 5.0)
    assert np.array_equal(again.inverse(point, frame="base"), made.inverse(point, frame="base"))
    wrong = replace(again, whole=replace(again.whole, settings=again.whole.settings | {"period_mm": 2.05}))
    assert not np.allclose(wrong.inverse(point, frame="base"), made.inverse(point, frame="base"), atol=1e-4)


def ring(seed: int, per_turn: float) -> World:
    """A spherical run whose encoders err so many times per turn: by 1 mrad where that is slow, else by 0.2 mrad."""
    waves = (2e-4 if per_turn > 10 else 1e-3) * np.random.default_rng(seed).normal(size=4)
    settings = worlds.SPHERICAL | {"workspace": {"phi_deg": [55.0, 125.0], "gamma_deg": [25.0, 65.0]}}
    hidden = {"encoder_cyclic": [*waves, per_turn]}
    return worlds.spherical_world(seed, effects=hidden, per_side=14, repeats=3, settings=settings)


@pytest.mark.parametrize("per_turn", [2, *slow(5, 90)])
def test_the_period_of_a_ring_is_a_part_of_a_turn(per_turn: int) -> None:
    """Catches a second harmonic that is taken for an eccentricity, lines that are too fine for a grid, and a period
    that does not close in a turn."""
    d = ring(0, per_turn).ask().diagnosis
    assert d.effects == ("encoder_cyclic",)
    assert 2 * np.pi / d.fit.model.period_rad == pytest.approx(per_turn, rel=1e-12)
    assert any(f"{per_turn} per turn" in note for note in d.notes)


def test_a_ring_of_unknown_period_is_refused_or_searched() -> None:
    """Catches a period of one rad that nobody gave, and one that a saved study forgets."""
    world = ring(1, 24)
    study = world.study()
    with pytest.raises(sk.errors.EffectError, match="needs the period"):
        sk.identify(world.robot, study.data, effects=["encoder_cyclic"])
    study.add("encoder_cyclic")
    assert 2 * np.pi / study.model.period_rad == pytest.approx(24, rel=1e-12)
    # as `sherkit diagnose --effect` and `calibrate` put it in
    model = model_of(world.robot)
    made = adopting(model, [model.known_effects["encoder_cyclic"]], study.data)
    assert 2 * np.pi / made.period_rad == pytest.approx(24, rel=1e-12)
    made = study.calibration()
    assert made.whole.settings["period_rad"] == study.model.period_rad


@pytest.mark.parametrize("pitch_mm", [1.0, *slow(2.0, 5.0)])
def test_no_ripple_of_metres_where_joints_stand_at_its_multiples(pitch_mm: float) -> None:
    """Catches a period chosen beside the one that these poses cannot see, where an amplitude of metres does what a
    slow error does; and a calibration that deploys what is not plausible in silence."""
    robot = replace(EXAMPLE, pole_pitch_mm=pitch_mm)
    joints = pitch_mm * np.round(robot.inverse_batch(worlds.GRID)[0] / pitch_mm)
    slow_mm = 0.2 * np.sin(joints / 37.0)
    noise_mm = 0.005 * np.random.default_rng(3).normal(size=joints.shape)
    rows = np.column_stack([joints, robot.forward_batch(joints)[0] + slow_mm + noise_mm])
    data = sk.from_frame(pl.DataFrame(rows, schema=["q1_mm", "q2_mm", "q3_mm", "x_mm", "y_mm", "z_mm"]))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = sk.calibrate(robot, data, effects=["encoder_cyclic"], correction="none")
    fit = found.whole.fit
    mine = ["encoder_cyclic" in p.name for p in fit.parameters]
    ripple, std = np.abs(fit.values[mine]), fit.std_from_readings[mine]
    told = any(re.search(r"encoder_cyclic.*where 0\.005 mm is usual", str(one.message)) for one in said)
    assert told == bool((ripple - 2 * std).max() > 5 * 0.005)
    assert fit.converged
    assert ripple.max() < 1.0
