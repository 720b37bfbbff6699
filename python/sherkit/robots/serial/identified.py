"""A calibrated arm as another drawing of it: its geometry as identified, and what no drawing of rigid links holds.

Zeros of joints, where their axes lie and lean, the target, and how a joint follows the one before it are places of
frames; all else (compliance, waves of gears and encoders, scales, play, temperature, drift) is not.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from ...base.types import Floats
from ...data import Measurements
from ...data.columns import TEMPERATURE, TIME
from ...model.drawing import Drawing, DrawnPart, line, with_target
from ...model.effect import Effect
from ..deployed import SENSOR
from .calibration import SerialCalibration
from .frames import about, frame, rpy_of_transform, triple
from .model import SerialModel
from .plates import offsets
from .robot import PAYLOAD, Serial

# -- As it is drawn ----------------------------------------------------------------------------------------------------
# The serial arm as it is drawn: its links from joint to joint, the axes, the target.

#: Half the length of a drawn axis, and of the axes of the base, by the reach of the arm.
_AXIS, _BASE = 0.06, 0.12


def drawing(model: SerialModel, data: Measurements, values: Floats, readings: Floats | None = None) -> Drawing:
    """The arm at each row, or with ``readings`` (n, m) as what is read. Raises as
    :meth:`~sherkit.model.chain.ChainModel.predict`."""
    robot, points = model.robot, model.parts(data, values)
    # what the tracker shows, seen from the base
    shown = model.at_base((model.predict(data, values) if readings is None else readings)[:, :3], values)
    reach = float(robot.reach_mm[0])
    base = _BASE * reach * np.eye(3)
    parts = [DrawnPart(f"{axis} of the base", "guide", line(np.zeros(3), base[k])) for k, axis in enumerate("xyz")]
    behind = np.zeros_like(points[:, 0])
    for k in range(1, len(robot.joints) + 1):
        # of a joint the core hands over a point of its axis, a second one along it, and where what it carries is
        origin, along, carried = (points[:, 3 * (k - 1) + i] for i in range(3))
        half = _AXIS * reach * (along - origin)
        parts += [
            DrawnPart(f"link {k - 1}" if k > 1 else "base", "link", line(behind, origin)),
            DrawnPart(f"axis {k}", "axis", line(origin - half, origin + half)),
            DrawnPart(f"slide {k}", "rod", line(origin, carried)),
            DrawnPart(f"joint {k}", "joint", line(origin)),
        ]
        behind = carried
    tip, target = points[:, -2], points[:, -1]
    parts += [
        DrawnPart("tool", "platform", line(behind, tip)),
        DrawnPart("from the tool's end to the target", "ray", line(tip, target)),
    ]
    return with_target(parts, target, shown)


# -- As another drawing ------------------------------------------------------------------------------------------------

#: Effects that the robot file of an arm has a key for.
FOLLOWING = "joint_coupling"
#: Postures at which a size is counted, and how many have to lie where the run measured; else it is counted over all.
_POSTURES, _ENOUGH = 4000, 100
#: What does less, mm, is not worth a sentence.
_NOTHING = 1e-9


def as_identified(made: SerialCalibration, held: Collection[str] = (FOLLOWING,)) -> Serial:
    """The arm whose drawing is the geometry that was identified; its effects are left out, but ``joint_coupling`` where
    that is ``held``."""
    robot, values = made.robot, made.by_name
    before, joints = None, []
    for k, joint in enumerate(robot.joints, start=1):
        names = ("offset", "shift_x", "shift_y", "tilt_x", "tilt_y")
        off, shift_x, shift_y, tilt_x, tilt_y = (values.get(f"{name}_{k}", 0.0) for name in names)
        share = values.get(f"{FOLLOWING}.share_{k}", 0.0) if FOLLOWING in held else 0.0
        follows = joint.follows + share
        if before is not None:
            off += follows * values.get(f"offset_{k - 1}", 0.0) - share * before.reading(before.home)
        # how the axis lies and leans beside its place, and what the joint moves, in its own frame
        beside = frame((shift_x, shift_y, 0.0), about(0, tilt_x) @ about(1, tilt_y))
        by_zero = frame((0.0, 0.0, off), np.eye(3)) if joint.slides else frame((0.0, 0.0, 0.0), about(2, off))
        moved = joint.frame @ beside @ by_zero
        moved[:3, :3] = moved[:3, :3] @ joint.turn.T
        origin, rpy = rpy_of_transform(moved)
        joints.append(replace(joint, origin_mm=origin, rpy_deg=rpy, follows=follows))
        before = joint
    turn = robot.joints[-1].turn
    off_by = offsets(robot, values)
    first, *more = map(triple, np.array(robot.targets_mm) + off_by @ turn.T)
    return replace(robot, joints=tuple(joints), target_mm=first, more_targets_mm=tuple(more))


# -- What does not fit in ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Lost:
    """What a drawing cannot hold: an effect, what it does to the target, mm (root mean square and at worst), and for
    what that is counted, empty where it always is."""

    effect: str
    rms_mm: float
    worst_mm: float
    counted: str = ""

    def __str__(self) -> str:
        rms, worst = in_words(self.rms_mm), in_words(self.worst_mm)
        return f"{self.effect}: {rms} RMS, {worst} at worst{f' ({self.counted})' if self.counted else ''}"


def in_words(size_mm: float) -> str:
    """A length as people read it."""
    return f"{size_mm:.2f} mm" if size_mm >= 1.0 else f"{1e3 * size_mm:.3g} µm"


def lost(made: SerialCalibration, held: Collection[str] = (FOLLOWING,)) -> tuple[list[Lost], str]:
    """What a drawing that holds the effects ``held`` lacks, the largest first, and where that is counted in words."""
    joints, where = _postures(made)
    names = [p.name for p in made.model.parameters]
    found = []
    for effect in made.model.built_in:
        if effect.name in held or effect.link == SENSOR:
            continue
        now, counted = _moment(made, effect)
        own = np.array([name.startswith(f"{effect.name}.") for name in names])
        without = replace(made, whole=replace(made.whole, values=np.where(own, 0.0, made.whole.values)))
        apart = made.core.forward_batch(joints, now)[0] - without.core.forward_batch(joints, now)[0]
        size = np.linalg.norm(apart, axis=1)
        if size.max() > _NOTHING:
            found.append(Lost(effect.name, float(np.sqrt((size**2).mean())), float(size.max()), counted))
    return sorted(found, key=lambda one: -one.rms_mm), where


def missed_mm(made: SerialCalibration, arm: Serial) -> tuple[float, float]:
    """How far the target of ``arm`` is from that of a calibration as it stands, mm: RMS and at worst."""
    joints, _ = _postures(made)
    size = np.linalg.norm(made.forward_batch(joints).require() - arm.forward_batch(joints).require(), axis=1)
    return float(np.sqrt((size**2).mean())), float(size.max())


def _postures(made: SerialCalibration) -> tuple[Floats, str]:
    """Joints (n, k) spread over their limits, those whose target is where the run measured if they are enough."""
    low, high = made.robot.ranges
    joints = np.random.default_rng(0).uniform(low, high, (_POSTURES, len(low)))
    place = made.forward_batch(joints).require()
    inside = ((place >= made.whole.low) & (place <= made.whole.high)).all(axis=1)
    if inside.sum() >= _ENOUGH:
        return np.ascontiguousarray(joints[inside]), "in the box that the run measured"
    return joints, "over the limits of the joints"


def _moment(made: SerialCalibration, effect: Effect) -> tuple[list[float], str]:
    """The covariates for which the size of an effect is counted, and what they are in words."""
    now, counted = [*made.whole.now, 0.0], []
    for need, place, value, said in (
        (TEMPERATURE, slice(1, 2), 21.0, "for each °C from 20 °C"),
        (TIME, slice(0), 0.0, "at the end of the run"),
        (PAYLOAD, slice(-1, None), 1.0, "by each kg"),
        ("direction", slice(2, -1), 1.0, "to either side, by the direction of travel"),
    ):
        if need in effect.needs:
            now[place] = [value] * len(now[place])
            counted.append(said)
    return now, ", ".join(counted)
