"""What to measure next: poses that a person can drive to, and what is said where none would tell."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import sherkit as sk
import test_discovery as delta
import test_spherical_discovery as spherical
from sherkit.data.toml import Table
from sherkit.diagnosis import next_poses
from sherkit.diagnosis.next_poses import SEPARATION, times_as_often
from sherkit.evidence.thresholds import SURE_SIGMA
from sherkit.lab.experiment.file import coordinates_of_plan
from sherkit.model.kinds import kind_of, model_of

#: Robots with joint limits and a workspace smaller than what their runs cover.
NARROW = {
    "delta": replace(delta.DELTA, joint_limits_mm=(100.0, 150.0), workspace_radius_mm=25.0),
    "spherical": replace(spherical.ROBOT, joint_limits_deg=(0.0, 170.0), phi_deg=(70.0, 110.0), gamma_deg=(35.0, 60.0)),
}


def run_of(kind: str) -> sk.Measurements:
    return (delta.measured(delta.GRIDS["small"], 0) if kind == "delta" else spherical.measured("small", 0)).data


@pytest.mark.parametrize("kind", NARROW)
def test_poses_are_within_limits_and_workspace(kind: str) -> None:
    """Catches a pose beyond a limit, outside the workspace, twice after rounding, or whose joints lead elsewhere."""
    robot: Any = NARROW[kind]
    model = model_of(robot)
    data = run_of(kind)
    found = model.reachable(data, sk.identify(robot, data).values)
    assert tuple(found.targets) == kind_of(robot).coordinates
    targets = np.column_stack(list(found.targets.values()))
    assert len(np.unique(np.round(targets, 6), axis=0)) == len(targets) == len(found.rows) > 20
    joints = found.rows.joints
    low, high = robot.joint_limits
    assert low <= joints.min() < joints.max() <= high
    assert model.allowed(targets).all()
    # joints are rounded as well, by less than moves anything
    by_joints = robot.forward_batch(joints).require("pose")
    np.testing.assert_allclose(by_joints, targets, atol=2e-3 if robot.joint_unit == "mm" else 5e-5)


def test_a_shifted_robot_is_kept_in_its_workspace() -> None:
    """Catches a workspace that is asked of the drawing alone: a robot 5 mm off leaves it on that side."""
    robot = NARROW["delta"]
    model = model_of(robot)
    data = run_of("delta")
    values = np.zeros(len(model.parameters))
    plain = model.reachable(data, values)
    names = [p.name for p in model.parameters]
    for limb, angle in enumerate(robot.base_angle_deg, start=1):
        values[names.index(f"base_radius_{limb}")] = 5.0 * np.cos(np.deg2rad(angle))
    shifted = model.reachable(data, values)
    assert plain.targets["x_mm"].max() > shifted.targets["x_mm"].max()
    assert plain.targets["x_mm"].min() == shifted.targets["x_mm"].min()


def test_what_no_pose_tells_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a leader without a name, and the same effects with another moment as a rival of theirs."""

    class Fitted:
        def __init__(self, *names: str) -> None:
            self.model = SimpleNamespace(effects=[SimpleNamespace(name=name) for name in names])

    monkeypatch.setattr(next_poses, "_told_by", lambda *_: "")
    true, again, other = Fitted("sensor_slip"), Fitted("sensor_slip"), Fitted("joint_slip")
    wider = Fitted("sensor_slip", "drift")
    said = next_poses._advice(true, None, {again: 0.0, other: 2.1, wider: 2.4}, np.ones(3), 12)
    assert "tell sensor_slip from joint_slip (by 2.1 σ), sensor_slip with drift (by 2.4 σ): these" in said
    assert next_poses._advice(true, None, {again: 0.0}, np.ones(3), 12) == ""


def test_the_poses_of_a_tie_are_a_plan(tmp_path: Path) -> None:
    """Catches poses that an experiment cannot take as they are. A drift tied with crossed beams, seed 6."""
    run = delta.measured(delta.GRIDS["whole"], 6, scaled={"drift": delta.NOISE_UM}, repeats=1, order="planes")
    d = run.diagnose()
    assert d.indistinguishable
    # an instrument that creeps without a turn is the same at all of them
    assert "tell drift from sensor_drift (by 0.0 σ)" in d.advice
    assert d.advice.endswith("The poses below tell it from beam_alignment")
    assert list(d.next_poses[0]) == ["q1_mm", "q2_mm", "q3_mm", "x_mm", "y_mm", "z_mm", "separation_sigma"]
    assert d.next_poses[-1]["separation_sigma"] >= SURE_SIGMA
    (tmp_path / "found.json").write_text(json.dumps(d.to_json()))
    plan = Table({"poses": "diagnosis", "file": "found.json"}, "plan")
    targets = coordinates_of_plan(plan, tmp_path, delta.DELTA)
    joints = delta.DELTA.inverse_batch(targets).require("pose")
    asked = np.array([[p[f"q{k}_mm"] for k in (1, 2, 3)] for p in d.next_poses])
    np.testing.assert_allclose(joints, asked, atol=1e-3)


def test_what_no_pose_tells_is_said_with_what_would(tmp_path: Path) -> None:
    """Catches a list of poses that tell nothing. A marker that slips is a camera that slips, in pixels; seed 0."""
    d = spherical.measured("small", 0, scaled={"slip": 2}).diagnose()
    assert set(d.indistinguishable[0]) == {"slip", "sensor_slip"}
    assert d.next_poses == ()
    assert "these instruments cannot tell" in d.advice
    assert "readings of phi, gamma, as fine as these, would" in d.advice
    (tmp_path / "found.json").write_text(json.dumps(d.to_json()))
    plan = Table({"poses": "diagnosis", "file": "found.json"}, "plan")
    with pytest.raises(sk.errors.ExperimentError, match="these instruments cannot tell"):
        coordinates_of_plan(plan, tmp_path, spherical.ROBOT)


def test_an_effect_in_the_model_hides_as_well() -> None:
    """Catches effects that are looked for in the geometry alone, and one in the model that nobody says is hidden."""
    study = sk.Study(delta.DELTA, delta.measured(delta.GRIDS["small"], 0).data)
    study.add("gravity_sag")
    d = study.diagnose()
    assert {name.partition("_")[0] for name in d.confounded_with["gravity_sag"]} <= {"rod", "base", "joint"}
    assert any(name.startswith("gravity_sag.") for name in d.confounded_with["drive_compliance"])


def test_poses_that_tell_little_are_read_more_often() -> None:
    """Catches poses that separate by three sigma advised for a tie of 10,000 to 1: of twelve ties whose poses had been
    measured none was lifted."""
    tie = 2.0 * np.log(1e4)
    for reached in (3.0, 4.0, 6.0):
        times = times_as_often([{"q1_mm": 1.0, SEPARATION: 1.0}, {"q1_mm": 2.0, SEPARATION: reached}])
        by_square = times * reached**2
        # half a square, less what it scatters by in one of five
        assert by_square - 2.0 * 0.84 * np.sqrt(by_square) >= tie - 1e-9
        assert times == 1 or (times - 1) * reached**2 - 2.0 * 0.84 * np.sqrt(times - 1) * reached < tie
