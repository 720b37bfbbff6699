"""Targets of one plate are one rigid body: six numbers, in fits, files, calibrations and exports."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sherkit as sk
from second_arms import SecondArm
from sherkit.errors import RobotError, ShapeError
from sherkit.model.kinds import known_kinds, model_of
from sherkit.robots.serial import Serial, postures
from sherkit.robots.serial.identified import as_identified

PLAIN = {"noise_um": 20.0, "yield_mrad": 0.0, "play_mrad": 0.0, "ring_mrad": 0.0}
#: How the plate is really turned, rad, and where its first nest is off, mm, in the frame of the last joint.
TURNED, SHIFTED = np.array([0.03, -0.02, 0.04]), np.array([1.5, -0.8, 2.0])


def arm(group: str) -> Serial:
    """The example with three nests."""
    example = known_kinds()["serial"].example
    more = ((80.0, 0.0, 120.0), (0.0, 90.0, 130.0))
    return replace(example, target_mm=(10.0, 0.0, 120.0), group=group, more_targets_mm=more, more_groups=(group,) * 2)


def virtual(robot: Serial, errors: float = 1.0) -> SecondArm:
    """Off by so many plausible sizes, its nests on a plate that is turned and shifted."""
    made = SecondArm.simulated(robot, 4, errors, PLAIN)
    apart = robot.targets - robot.targets[0]
    off = SHIFTED + apart @ (Rotation.from_rotvec(TURNED).as_matrix() - np.eye(3)).T
    return replace(made, tool_mm=off)


def test_a_plate_is_six_numbers_whose_derivatives_are_exact() -> None:
    """Catches a turn that is linear in what is no small angle, about another point or axis, and a target of the plate
    that does not follow: against differences, at a plate that is turned already, for each of the three targets."""
    robot = arm("plate")
    model = model_of(robot)
    names = [p.name for p in model.parameters]
    assert {"tool_x", "tool_y", "tool_z", "plate_turn_x", "plate_turn_y", "plate_turn_z"} <= set(names)
    assert not any(name.startswith("target_") for name in [*names, *(p.name for p in model.fixed)])
    data = virtual(robot).measure(postures(robot, 12))
    values = 0.3 * np.random.default_rng(0).normal(size=len(names)) * [min(p.size, 5.0) for p in model.parameters]
    exact = model.derivatives(data, values)
    for k, p in enumerate(model.parameters):
        step = 1e-5 * (0.1 if p.unit == "rad" else 1.0)
        both = [model.predict(data, values + s * step * np.eye(len(names))[k]) for s in (1.0, -1.0)]
        found = (both[0] - both[1]) / (2 * step)
        np.testing.assert_allclose(exact[..., k], found, rtol=1e-5, atol=1e-4 * max(1.0, np.nanmax(np.abs(found))))


def test_the_plate_is_found_and_known_better_than_its_nests() -> None:
    """Catches a plate that fits worse than nests by themselves, turns that are found about other axes, and a group that
    changes nothing: by a tracker with a noise of 20 µm."""
    robot = arm("plate")
    data = virtual(robot).measure(postures(robot, 60, 0.9, 1), seed=2)
    one, three = sk.identify(robot, data, priors=False), sk.identify(arm(""), data, priors=False)
    assert len(three.values) == len(one.values) + 3
    # what joints are off by turns the plate as well, and nothing tells them apart: here none is
    alone = sk.identify(robot, virtual(robot, 0.0).measure(postures(robot, 60, 0.9, 1), seed=2), priors=False)
    turns = np.array([alone.by_name[f"plate_turn_{axis}"] for axis in "xyz"])
    known = np.array([s for p, s in zip(alone.parameters, alone.std, strict=True) if p.name.startswith("plate_turn")])
    assert (np.abs(turns - TURNED) < 4 * known).all()
    assert known.max() < 1e-3
    assert one.scale == pytest.approx(three.scale, rel=0.03)
    assert one.error.rms < 1.02 * three.error.rms


def test_files_calibrations_and_exports_keep_the_plate(tmp_path: Path) -> None:
    """Catches a group that a saved robot loses, a calibration whose target is elsewhere than its fit has it, and an
    identified drawing whose other nests are where they were drawn."""
    robot = arm("plate")
    sk.save_robot(robot, tmp_path / "robot.toml")
    assert sk.load_robot(tmp_path / "robot.toml") == robot
    data = virtual(robot).measure(postures(robot, 60, 0.9, 1), seed=2)
    made = sk.calibrate(robot, data).calibration
    made.save(tmp_path / "c.toml")
    again = sk.load_calibration(tmp_path / "c.toml")
    q = data.joints[:5]
    first = data.select(np.flatnonzero(data.covariates["target"] == 1))
    fit = sk.identify(robot, data)
    told = fit.model.predict(first, fit.values)[:, :3]
    np.testing.assert_allclose(made.forward_batch(first.joints, frame="sensor").values, told, atol=1e-6)
    np.testing.assert_allclose(again.forward_batch(q).values, made.forward_batch(q).values, atol=1e-9)
    nests = np.array(as_identified(made).targets_mm)
    drawn = np.array(robot.targets_mm)
    apart = [np.linalg.norm(one[1:] - one[0], axis=1) for one in (nests, drawn)]
    np.testing.assert_allclose(apart[0], apart[1], atol=1e-9)
    assert np.linalg.norm((nests - nests[0]) - (drawn - drawn[0])) > 1.0


def test_groups_that_are_none_are_refused(tmp_path: Path) -> None:
    """Catches a slip in the name of a group, after which its targets are free without a word."""
    with pytest.raises(ShapeError, match="one target alone"):
        replace(arm("plate"), more_groups=("plate", "plat"))
    with pytest.raises(ShapeError, match="small letters"):
        arm("Plate 1")
    with pytest.raises(ShapeError, match="not one of"):
        arm("tool")
    sk.save_robot(arm("plate"), tmp_path / "robot.toml")
    text = (tmp_path / "robot.toml").read_text().replace('group = "plate"', 'group = "plat"', 1)
    (tmp_path / "wrong.toml").write_text(text)
    with pytest.raises(RobotError, match=r"wrong\.toml.*did you mean 'plate'"):
        sk.load_robot(tmp_path / "wrong.toml")
