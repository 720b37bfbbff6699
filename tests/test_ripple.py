"""A period for each joint: gears that are not round, each by its own number of waves a turn."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import gear_worlds
import sherkit as sk
import test_spherical_discovery
import worlds
from gear_worlds import TURN, asked, is_right, robot_of, run_of
from running import slow
from second_machines import apart
from second_machines import run_of as run_of_machine
from sherkit.errors import ArgumentError, EffectError
from sherkit.model.kinds import model_of
from sherkit.robots.machine import load_machine

EACH = (TURN / 51, TURN / 80, TURN / 121, TURN / 160, TURN / 40.5, TURN / 202)


def test_each_joint_waves_at_its_own_period() -> None:
    """Catches one period for all joints, or those of others: the arm is at where a hand turns its joints to."""
    rng = np.random.default_rng(1)
    robot = robot_of()
    data = run_of(gear_worlds.world(0, 0, rows=20))
    model = replace(sk.identify(robot, data).model, period_rad=EACH)
    effect = model.known_effects["encoder_cyclic"]
    model = model.with_effect(effect)
    values = np.zeros(len(model.parameters))
    waves = 1e-3 * rng.normal(size=(6, 2))
    values[model.owns(effect)] = waves.ravel()
    angle = TURN * data.joints / np.array(EACH)
    turned = replace(data, joints=data.joints + waves[:, 0] * np.sin(angle) + waves[:, 1] * np.cos(angle))
    expected = model.predict(turned, np.zeros(len(values)))
    assert np.allclose(model.predict(data, values), expected, rtol=0, atol=1e-9)


def test_as_many_periods_as_joints() -> None:
    """Catches a list of another length that is spread over the joints, or a traceback."""
    model = model_of(robot_of())
    with pytest.raises(EffectError, match="expected one number, or 6, one for each joint; found 2"):
        replace(model, period_rad=(0.1, 0.2))


def test_a_gear_ratio_in_the_file_is_its_period() -> None:
    """Catches a ratio that is not read or not written, one that is searched for all the same, and an arm whose gears
    are all known that is asked for a period."""
    made = gear_worlds.world(3, 1)
    ((joint, ratio),) = made.per_turn.items()
    tables: dict[str, Any] = gear_worlds.drawing()
    tables["joint"][joint - 1]["gear_ratio"] = ratio + 0.2
    robot = robot_of(tables)
    assert robot.joints[joint - 1].gear_ratio == ratio + 0.2
    assert robot_of(robot.to_tables()) == robot
    study = sk.Study(robot, run_of(made))
    study.add("encoder_cyclic")
    assert study.model.period_rad[joint - 1] == pytest.approx(TURN / (ratio + 0.2), rel=1e-12)
    for one in tables["joint"]:
        one["gear_ratio"] = 100.0
    known = sk.identify(robot_of(tables), run_of(made), effects=["encoder_cyclic"])
    assert known.model.period_rad == (TURN / 100.0,) * 6


@pytest.mark.slow
def test_periods_are_deployed_and_read_again(tmp_path: Path) -> None:
    """Catches a calibration that runs at one period of those that were found, or whose file or study forgets them."""
    made = gear_worlds.world(0, 4)
    study = sk.Study(robot_of(), run_of(made))
    study.add("encoder_cyclic")
    periods = study.model.period_rad
    assert [TURN / periods[k - 1] for k in made.per_turn] == pytest.approx([*made.per_turn.values()], rel=0.01)
    done = study.calibration()
    done.save(tmp_path / "c.toml")
    again = sk.load_calibration(tmp_path / "c.toml")
    joints = made.joints[0]
    assert again.whole.settings["period_rad"] == periods
    assert np.array_equal(again.forward(joints), done.forward(joints))
    one = replace(again, whole=replace(again.whole, settings=again.whole.settings | {"period_rad": periods[0]}))
    assert not np.allclose(one.forward(joints), done.forward(joints), rtol=0, atol=1e-3)
    study.save(tmp_path / "study")
    assert sk.Study.load(tmp_path / "study").model.period_rad == periods


def test_a_person_says_a_period_for_each_joint() -> None:
    """Catches a list that is refused or searched for all the same, and one of another length that is spread over the
    joints."""
    made = gear_worlds.world(0, 4)
    study = sk.Study(robot_of(), run_of(made))
    study.add("encoder_cyclic", period_rad=[*EACH])
    assert study.model.period_rad == EACH
    study.undo()
    study.add("encoder_cyclic", period_rad=EACH[0])
    assert study.model.period_rad == EACH[0]
    study.undo()
    with pytest.raises(EffectError, match="6, one for each joint; found 2"):
        study.add("encoder_cyclic", period_rad=[0.1, 0.2])
    with pytest.raises(ArgumentError, match="period_rad: expected a finite number"):
        study.add("encoder_cyclic", period_rad=[0.1, -0.2])


@pytest.mark.slow
@pytest.mark.parametrize(("gears", "noises"), [(1, 2.0), (2, 2.0), (4, 2.0), (4, 1.0)])
def test_gears_are_named_with_their_periods(gears: int, noises: float) -> None:
    """Catches ripple of several periods that is not named as one effect, with each within one percent, in three runs of
    three; 20 of 20 were when this was written."""
    for seed in range(3):
        made = gear_worlds.world(seed, gears, noises)
        found, named, said = asked(made)
        assert named
        assert is_right(made, found)
        for joint, ratio in made.per_turn.items():
            assert any(f"of joint {joint} at" in note or f"{ratio:g} per turn" in note for note in said)


@pytest.mark.slow
def test_no_gear_ripples_where_there_is_none() -> None:
    """Catches ripple that is read out of noise by a period for each joint, in five runs."""
    assert not any(asked(gear_worlds.world(seed, 0))[1] for seed in range(5))


def test_a_second_wave_in_each_period() -> None:
    """Catches a second wave of another joint or at another period: the arm is at where a hand turns its joints to."""
    robot, rng = robot_of(), np.random.default_rng(2)
    data = run_of(gear_worlds.world(0, 0, rows=20))
    model = replace(model_of(robot), period_rad=EACH)
    for joint in (2, 5):
        model = model.with_effect(model.known_effects[f"encoder_second_{joint}"])
    assert [e.name for e in model.effects] == ["encoder_cyclic", "encoder_second_2", "encoder_second_5"]
    values, angle = np.zeros(len(model.parameters)), 2.0 * TURN * data.joints / np.array(EACH)
    joints = data.joints.copy()
    for joint in (2, 5):
        waves = 1e-3 * rng.normal(size=2)
        values[model.owns(model.known_effects[f"encoder_second_{joint}"])] = waves
        joints[:, joint - 1] += waves[0] * np.sin(angle[:, joint - 1]) + waves[1] * np.cos(angle[:, joint - 1])
    expected = model.predict(replace(data, joints=joints), np.zeros(len(values)))
    assert np.allclose(model.predict(data, values), expected, rtol=0, atol=1e-9)


def test_a_second_wave_goes_with_the_first() -> None:
    """Catches a second wave that is tried where there is no period to halve, and one that stays when the first is taken
    out: it would wave at half of a period that nobody has."""
    model, data = model_of(robot_of()), run_of(gear_worlds.world(0, 0, rows=20))
    tried, refused = model.is_testable(tuple(model.known_effects.values()), data)
    assert not any(name.startswith("encoder_second") for name in (*(e.name for e in tried), *refused))
    first, second = (model.known_effects[name] for name in ("encoder_cyclic", "encoder_second_1"))
    with pytest.raises(EffectError, match="needs the period of the encoders"):
        model.with_effect(second)
    both = model.with_effect(first, at=0.1).with_effect(second)
    assert both.without_effect("encoder_cyclic").effects == ()
    with pytest.raises(EffectError, match="'encoder_second_1' goes with 'encoder_cyclic', which is not in the model"):
        replace(both, effects=(second,))
    tried, _ = model.with_effect(first, at=0.1).is_testable([second], data)
    assert tried == [second]


@pytest.mark.slow
def test_second_waves_are_named_and_deployed(tmp_path: Path) -> None:
    """Catches second waves that stay unnamed, those of gears that have none, a file that forgets them, and a size that
    is not that which was hidden."""
    made = gear_worlds.world(2, 2, second=0.4)
    found = sk.diagnose(robot_of(), run_of(made))
    joints = sorted(made.per_turn)
    assert found.effects == ("encoder_cyclic", *(f"encoder_second_{joint}" for joint in joints))
    (said,) = (note for note in found.notes if "twice as often" in note)
    assert all(f"joint {joint} by " in said for joint in joints)
    fit = found.fit
    for joint in joints:
        first, second = (
            np.hypot(*(fit.by_name[f"{effect}.{wave}_{joint}"] for wave in ("sine", "cosine")))
            for effect in ("encoder_cyclic", f"encoder_second_{joint}")
        )
        assert second / first == pytest.approx(made.second, rel=0.3)
    done = sk.calibrate(robot_of(), run_of(made), effects=found.effects).calibration
    done.save(tmp_path / "c.toml")
    again = sk.load_calibration(tmp_path / "c.toml")
    assert again.whole.effects == found.effects
    assert np.array_equal(again.forward(made.joints[0]), done.forward(made.joints[0]))
    off = np.linalg.norm(done.forward_batch(made.joints, frame="sensor").values - made.read, axis=1)
    assert np.sqrt(np.mean(off**2)) < 1.2 * np.sqrt(3.0) * gear_worlds.NOISE_MM


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 0, 2, 3, 5, 7])
def test_an_overtone_is_no_wave_of_another_joint(seed: int) -> None:
    """Catches ripple that is told of four or five joints where one has it, with a second wave in each period: the
    others took parts of that, each at a period of its own."""
    made = gear_worlds.world(seed, 1, 4.0, second=0.6, rows=120)
    (joint,) = made.per_turn
    found = sk.diagnose(robot_of(), run_of(made))
    assert found.effects == ("encoder_cyclic", f"encoder_second_{joint}")
    (said,) = (note for note in found.notes if "per turn" in note)
    assert re.findall(r"joint (\d)", said) == [str(joint)]


def of_a_delta() -> tuple[sk.diagnosis.Diagnosis, tuple[str, ...]]:
    hidden = {"encoder_cyclic": [0.004, 0, 0, 0.003, 0, 0], "encoder_second": [0, 0.0015, 0, 0, 0, 0]}
    return worlds.delta_world(3, effects=hidden).ask().diagnosis, ("encoder_second_1",)


def of_a_sphere() -> tuple[sk.diagnosis.Diagnosis, tuple[str, ...]]:
    hidden = {"encoder_cyclic": [4e-4, 0, 0, 3e-4, 20], "encoder_second": [0, 0, 2e-4, 0, 20]}
    return test_spherical_discovery.measured("local", 3, hidden).diagnose(), ("encoder_second_2",)


def of_a_machine() -> tuple[sk.diagnosis.Diagnosis, tuple[str, ...]]:
    machine = load_machine(Path(__file__).parents[1] / "examples" / "machines" / "gantry.py")
    frame = run_of_machine("gantry", 1, {"ripple_mm": 0.02, "second_mm": 0.008})
    return sk.Study(machine, sk.from_frame(frame)).diagnose(), ("encoder_second_x_axis",)


@pytest.mark.parametrize("world", [of_a_delta, *slow(of_a_sphere, of_a_machine)])
def test_second_waves_of_other_robots(world: Callable[[], tuple[sk.diagnosis.Diagnosis, tuple[str, ...]]]) -> None:
    """Catches robots whose encoders have no second wave, one that is given to another joint, and no word on its size.
    Where this was written, 110 of 110 of 60 deltas were named at 0.4 of the first, none in 60 that have the first
    alone."""
    found, seconds = world()
    assert found.effects == ("encoder_cyclic", *seconds)
    (said,) = (note for note in found.notes if "twice as often" in note)
    assert said.count("twice as often") == 1
    assert f"joint {seconds[0].removeprefix('encoder_second_')} by " in said


@pytest.mark.slow
def test_waves_that_are_large_and_no_pure_sines() -> None:
    """Catches a cause that is refused since what half of it leaves follows no shape: "each pose is off by 78 µm of its
    own", where the first wave and the second of each joint say all."""
    rng, angle = np.random.default_rng(81), np.arange(3.0)
    points = np.column_stack([rng.uniform(-20, 20, (150, 2)), rng.uniform(-20, 20, 150)])
    waves = np.column_stack([np.cos(angle), np.sin(angle)]).ravel()
    hidden = {"encoder_cyclic": 0.05 * waves, "encoder_second": 0.025 * waves[::-1]}
    found = worlds.delta_world(81, effects=hidden, points=points, repeats=2, noise_um=10.0).ask().diagnosis
    assert found.effects == ("encoder_cyclic", *(f"encoder_second_{k}" for k in (1, 2, 3)))
    assert found.verdict == "explained"


@pytest.mark.parametrize(("joint", "bend", "told"), [(1, 0.02, True), (0, 0.0, False)])
def test_a_wave_that_is_seen_too_little_of_may_be_a_bend(joint: int, bend: float, told: bool) -> None:
    """Catches a smooth bend of an elbow that goes over a quarter of a turn, explained as its ring without a word that a
    polynomial says as much (arms with a bent joint: 12 of 24, 1 now); and a word too many on a ring seen over a
    turn. Seed 0."""

    def shown(q: Any, p: Any) -> Any:
        first, second = np.deg2rad(q[:, 0]), np.deg2rad(q.sum(axis=1))
        upper, lower = 300.0 + p.upper, 200.0 + p.lower
        return np.stack([upper * f(first) + lower * f(second) for f in (np.cos, np.sin)], axis=1)

    with apart():
        machine = sk.Machine(
            shown, joints={"base_deg": (-170.0, 170.0), "elbow_deg": (20.0, 110.0)}, readings=("x_mm", "y_mm"),
            parameters={"upper": ("mm", 0.5), "lower": ("mm", 0.5)}, name="two_arms",
        )  # fmt: skip
        rng = np.random.default_rng(0)
        q = np.tile(rng.uniform(*machine.box.T, (90, 2)), (2, 1))
        off = bend * ((q[:, 1] - 65.0) / 45.0) ** 2 if bend else 0.06 * np.cos(np.deg2rad(q[:, 0] - 40.0))
        read = shown(q + np.outer(off, np.eye(2)[joint]), SimpleNamespace(upper=0.2, lower=-0.1))
        read = read + 0.01 * rng.normal(size=read.shape)
        columns = {"pose": np.tile(np.arange(90) + 1, 2), "base_deg": q[:, 0], "elbow_deg": q[:, 1]}
        d = sk.diagnose(machine, sk.from_frame(columns | {"x_mm": read[:, 0], "y_mm": read[:, 1]}))
    assert "encoder_eccentricity" in d.effects
    assert ("may as well be that the error of joint elbow_deg varies smoothly" in (d.caveat or "")) is told


@pytest.mark.parametrize("seed", [1, 2])
def test_a_wave_repeats_at_the_joint_that_has_it(seed: int) -> None:
    """Catches a cubic of an elbow that is explained as a wave of which it shows less than one, since another joint goes
    far enough to show it repeat: 4 of 15, 0 now."""

    def shown(q: Any, p: Any) -> Any:
        first, second = np.deg2rad(q[:, 0]), np.deg2rad(q[:, 0] + q[:, 1])
        upper, lower = 300.0 + p.upper, 200.0 + p.lower
        return np.stack([*(upper * f(first) + lower * f(second) for f in (np.cos, np.sin)), q[:, 2]], axis=1)

    with apart():
        machine = sk.Machine(
            shown, joints={"base_deg": (-170.0, 170.0), "elbow_deg": (20.0, 110.0), "lift_mm": (0.0, 100.0)},
            readings=("x_mm", "y_mm", "z_mm"), parameters={"upper": ("mm", 0.5), "lower": ("mm", 0.5)}, name="lifted",
        )  # fmt: skip
        rng = np.random.default_rng(seed)
        q = np.tile(rng.uniform(*machine.box.T, (90, 3)), (2, 1))
        z = (q[:, 1] - 65.0) / 45.0
        stood = q + np.outer(0.01 * (z**3 - 0.6 * z), np.eye(3)[1])
        read = shown(stood, SimpleNamespace(upper=0.2, lower=-0.1)) + 0.01 * rng.normal(size=(180, 3))
        columns = dict(zip((*machine.joint_names, *machine.readings), np.hstack([q, read]).T, strict=True))
        d = sk.diagnose(machine, sk.from_frame({"pose": np.tile(np.arange(90) + 1, 2), **columns}))
    assert (d.verdict, d.effects) == ("unexplained", ())
