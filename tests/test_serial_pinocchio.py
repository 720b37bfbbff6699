"""Serial arms against pinocchio, on the URDFs of example-robot-data: a second way to the same numbers.

Both are large and serve these tests alone: ``pip install pin example-robot-data`` (the extra ``arms``).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sherkit.errors import RobotError
from sherkit.robots.serial import Serial
from sherkit.robots.serial.imported import _Tree, import_urdf

pin = pytest.importorskip("pinocchio", reason="pinocchio is not installed: pip install pin example-robot-data")

#: Robots by how their file is called; arms of one maker, hands, legs and lifts among them.
ROBOTS = ("ur5_robot", "ur10_robot", "ur3_robot", "panda", "xarm7", "kinova", "z1", "so101", "tiago", "talos_left_arm",
          "baxter", "romeo", "icub", "hyq_no_sensors", "pr2")  # fmt: skip
#: Those whose every joint counts many times in the slow test.
ARMS = {
    "ur5_robot": "tool0", "panda": "panda_link8", "xarm7": "link_eef", "talos_left_arm": "arm_left_7_link",
}  # fmt: skip
_G = 9.81


def urdf(name: str) -> Path:
    """The file of a robot."""
    for folder in (Path(pin.__file__).parents[4] / "share", *(Path(p) for p in pin.__path__)):
        for found in sorted(folder.glob(f"example-robot-data/robots/*/*/{name}.urdf")):
            return found
    pytest.skip("example-robot-data is not installed: pip install example-robot-data")


def chains(path: Path, only: str | None = None) -> Iterator[tuple[Serial, list[str], str]]:
    """Every arm from the root to an end, or to one link, the names of its joints in the file, and its last link."""
    tree = _Tree(path)
    parents = {one.parent for one in tree.to.values()}
    for tip in [one for one in tree.links if one not in parents] if only is None else [only]:
        try:
            arm = import_urdf(path, None, tip)
        except RobotError:
            continue  # nothing that moves, more joints than nine, or one that follows another
        yield arm, [one.name for one in tree.between(tree.root, tip) if one.kind != "fixed"], tip


def configured(model: Any, arm: Serial, names: list[str], joints: np.ndarray) -> np.ndarray:
    """The configuration of all of a robot, whose other joints are at zero."""
    full = pin.neutral(model)
    for name, value, joint in zip(names, joints, arm.joints, strict=True):
        own = model.joints[model.getJointId(name)]
        if own.nq == 2:
            full[own.idx_q : own.idx_q + 2] = np.cos(value), np.sin(value)
        else:
            full[own.idx_q] = value / 1000.0 if joint.slides else value
    return full


def compare(path: Path, count: int, only: str | None = None) -> int:
    """How many arms of a file were found to agree, at ``count`` configurations each."""
    model = pin.buildModelFromUrdf(str(path))
    data, rng, arms = model.createData(), np.random.default_rng(0), 0
    for arm, names, tip in chains(path, only):
        arms += 1
        slides = np.array([joint.slides for joint in arm.joints])
        columns = [model.joints[model.getJointId(name)].idx_v for name in names]
        frame = model.getFrameId(tip, pin.FrameType.BODY)
        for joints in rng.uniform(arm.ranges[0], arm.ranges[1], (count, len(names))):
            full = configured(model, arm, names, joints)
            by_joints = pin.computeFrameJacobian(model, data, full, frame, pin.LOCAL_WORLD_ALIGNED)[:3, columns]
            pin.framesForwardKinematics(model, data, full)
            there, mine = data.oMf[frame], arm.tool_frame(joints)
            np.testing.assert_allclose(mine[:3, 3], 1000.0 * there.translation, atol=1e-9)
            np.testing.assert_allclose(mine[:3, :3], there.rotation, atol=1e-12)
            np.testing.assert_allclose(arm.jacobian(joints), np.where(slides, 1.0, 1000.0) * by_joints, atol=1e-9)
            found = arm.inverse(arm.forward(joints))
            np.testing.assert_allclose(arm.forward(found), arm.forward(joints), atol=2e-9)
    return arms


@pytest.mark.parametrize("name", ROBOTS)
def test_places_turns_and_slopes_are_those_of_pinocchio(name: str) -> None:
    """Catches a link that is folded in the wrong order, an axis that is askew, metres for millimetres, and an inverse
    that does not come back, on arms that other people drew."""
    assert compare(urdf(name), 3) >= 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ARMS)
def test_so_they_are_at_a_thousand_configurations(name: str) -> None:
    """Catches what three configurations leave out: limits, singular postures, turns by more than a circle."""
    assert compare(urdf(name), 1000, ARMS[name]) == 1


@pytest.mark.parametrize("name", ARMS)
def test_what_joints_carry_is_what_pinocchio_says(name: str) -> None:
    """Catches a mass on the wrong joint, a centre in the wrong frame, a moment of the wrong sign."""
    path = urdf(name)
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    arm, names, _ = next(chains(path, ARMS[name]))
    rng, core = np.random.default_rng(1), arm.core()
    every = [(row["name"], p["name"]) for row in core.CATALOGUE for p in row["parameters"]]
    yields = [k for k, (effect, _) in enumerate(every) if effect == "joint_compliance"][: len(names)]
    columns = [model.joints[model.getJointId(one)].idx_v for one in names]
    joints = rng.uniform(arm.ranges[0], arm.ranges[1], (20, len(names)))
    moved, by_joints, _, _ = core.derivatives(np.zeros(len(every)), (joints, None, None, None), yields)
    # each column is that of its joint times what it carries
    carried = (moved * by_joints).sum(axis=1) / np.maximum((by_joints**2).sum(axis=1), 1e-300)
    masses, centres = arm.weights
    for i in range(len(names)):
        arms = np.cumsum([0.0, *(float(np.linalg.norm(one.origin_mm)) for one in arm.joints[i + 1 :])])
        most = float(masses[i:] @ (arms + np.linalg.norm(centres[i:], axis=1))) / 1000.0
        expected = [
            -pin.computeGeneralizedGravity(model, data, configured(model, arm, names, q))[columns[i]] / _G
            for q in joints
        ]
        seen = np.linalg.norm(by_joints[:, :, i], axis=1) > 1e-6
        np.testing.assert_allclose(carried[seen, i] * most, np.array(expected)[seen], atol=1e-9)


@pytest.mark.parametrize("name", ARMS)
def test_what_a_payload_puts_on_joints_is_what_pinocchio_says(name: str) -> None:
    """Catches a payload that hangs elsewhere than at the target, kilogrammes for newtons, a moment in N mm."""
    path = urdf(name)
    plain, loaded = (pin.buildModelFromUrdf(str(path)) for _ in range(2))
    arm, names, tip = next(chains(path, ARMS[name]))
    frame = loaded.frames[loaded.getFrameId(tip, pin.FrameType.BODY)]
    weight = pin.Inertia(3.0, np.zeros(3), np.zeros((3, 3)))
    loaded.appendBodyToJoint(frame.parentJoint, weight, frame.placement)
    core, joints = arm.core(), np.random.default_rng(2).uniform(arm.ranges[0], arm.ranges[1], (20, len(names)))
    every = [(row["name"], p["name"]) for row in core.CATALOGUE for p in row["parameters"]]
    gives = [k for k, (effect, _) in enumerate(every) if effect == "payload_compliance"][: len(names)]
    known = np.tile([np.nan, np.nan, *np.zeros(2 * len(names)), 1.0, 3.0], (len(joints), 1))
    moved, by_joints, _, _ = core.derivatives(np.zeros(len(every)), (joints, None, known, None), gives)
    carried = (moved * by_joints).sum(axis=1) / np.maximum((by_joints**2).sum(axis=1), 1e-300)
    sides = [
        [
            pin.computeGeneralizedGravity(model, model.createData(), configured(model, arm, names, q))
            [[model.joints[model.getJointId(one)].idx_v for one in names]]
            for q in joints
        ]
        for model in (plain, loaded)
    ]  # fmt: skip
    expected = (np.array(sides[0]) - np.array(sides[1])) * 9.80665 / _G
    seen = np.linalg.norm(by_joints, axis=1) > 1e-6
    np.testing.assert_allclose(carried[seen], expected[seen], atol=1e-8)
