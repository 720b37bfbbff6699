"""Sentences on the effects of a serial arm, and those of them that an arm has; the table of the effects, for all the
joints that one may have, is `rust/core/src/serial/effects.rs`."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from sherkit._core import SerialModel

from ...model.effect import Effect, Parameter, Sentences
from ...model.sentences import catalogue_of
from .robot import Joint, Serial

_OWN = {
    "joint_coupling": Sentences(
        physics="A joint moves a little when the one before it does: a belt or shaft runs through that joint, as in "
        "many wrists, and the controller's ratio for it is missing or not quite right.",
        residuals="Proportional to the travel of the joint before, as if the next one had turned.",
        remedy="Enter the coupling ratio of the wrist in the controller; check it by turning one joint alone.",
    ),
    "joint_compliance": Sentences(
        physics="Gears and bearings give way under the weight that a joint carries; the value is how far under the "
        "greatest moment that this weight can make.",
        residuals="Downwards, most where the arm is stretched out level, none where it stands upright.",
        remedy="Enter the payload and its centre in the controller; balance the arm; read joints behind gears.",
    ),
    "payload_compliance": Sentences(
        physics="Gears and bearings give way under what hangs at the target; the value is how far a joint turns by the "
        "moment that this puts on it, or how far it slides by the force.",
        residuals="Downwards and proportional to the payload, most where the arm is stretched out level.",
        remedy="Enter mass and centre of each payload in the controller; calibrate with the payload of the work.",
    ),
    "link_growth": Sentences(
        physics="Each link expands with temperature by its own part: links of other materials, or nearer to motors, "
        "than the rest. Where all parts are equal, it is thermal_growth.",
        residuals="Along the links as they stand, proportional to the deviation of temperature from 20 °C.",
        remedy="Warm up before measuring; hold the temperature; links of carbon fibre or Invar.",
    ),
    "tracker_slip": Sentences(
        physics="The tracker or its stand was knocked, or the robot moved on its floor: from one moment on it sees the "
        "robot elsewhere, shifted and turned.",
        residuals="A step over time, which differs from place to place where it is a turn.",
        remedy="Measure reference nests on the robot's base before and after; measure again from the moment on.",
    ),
    "sensor_scale": Sentences(
        physics="All that the instrument reads is too large or too small by the same part: air temperature and "
        "pressure of a laser tracker, focal length of a camera, a scale bar.",
        residuals="The picture of the robot grows about the instrument.",
        remedy="Enter air temperature and pressure; check the instrument on a scale bar.",
    ),
    "bar_zero": Sentences(
        physics="Every distance is read too long or too short by the same length: the bar's zero, the radius of its "
        "balls, the dead path of a wire or beam.",
        residuals="The same in every distance, whatever its length and direction.",
        remedy="Calibrate the bar on a gauge of known length.",
    ),
    "reading_delay": Sentences(
        physics="A reading shows the robot a little earlier than the joints beside it: filters, transfer, buffers.",
        residuals="Proportional to the velocity of the joints; none where the robot stands still.",
        remedy="Trigger instrument and encoders together; or measure at rest.",
    ),
}

#: The effects by name, in the order of the chain, for all the joints that an arm may have.
SERIAL_CATALOGUE: dict[str, Effect] = catalogue_of(SerialModel.CATALOGUE, _OWN)

#: Postures by which the drawing tells what weight does, and the part of what a joint moves that counts as nothing.
_POSTURES, _NOTHING = 50, 1e-9
#: Millimetres of a sliding joint that are as plausible as a radian of a turning one.
_SLIDE_MM = 100.0
#: What a payload does to joints that turn; to one that slides so much is plausible, under a common weight of one.
_BY_MOMENT, _SLIDE_MM_BY_N, _PAYLOAD_N = "rad/(N·m)", 1e-3, 40.0
#: Effects of which the drawing leaves some parameters nothing to do: no weight turns an upright joint, no link grows
#: that has no length.
_BY_DRAWING = ("joint_compliance", "payload_compliance", "link_growth")


def joint_of(name: str) -> int | None:
    """The joint, from zero, that a parameter of the table belongs to by its number; None for one of the whole arm."""
    number = name.rpartition("_")[2]
    return int(number) - 1 if number.isdigit() else None


def has(robot: Serial, name: str) -> bool:
    """Whether an arm has the instrument or target that a parameter or effect of the table belongs to by its name."""
    kind, _, rest = name.partition("_")
    there = {"target": robot.targets_mm, "centre": robot.centres_mm, "plane": robot.planes}
    if kind in there:
        return int(rest[0]) <= len(there[kind])
    if name == "bar_zero":
        return bool(robot.centres_mm)
    return robot.has_tracker or kind not in ("frame", "tracker", "sensor")


def parameter_of(parameter: Parameter, joints: Sequence[Joint]) -> Parameter | None:
    """A parameter of the table as an arm has it: in the unit of its joint; None where it has no such joint."""
    k = joint_of(parameter.name)
    if k is None or "rad" not in parameter.unit:
        return parameter if k is None or k < len(joints) else None
    if k >= len(joints):
        return None
    if parameter.unit == _BY_MOMENT:
        if not joints[k].slides:
            return parameter
        return replace(parameter, unit="mm/N", size=_SLIDE_MM_BY_N, lever_mm=_PAYLOAD_N)
    # shares and scales count what one joint does by what another reads, or itself
    over = [k - 1 if parameter.name.startswith("share") else k] if "/" in parameter.unit else []
    unit = "/".join(joints[i].unit for i in (k, *over))
    size = parameter.size * (_SLIDE_MM if joints[k].slides else 1.0)
    for i in over:
        size /= _SLIDE_MM if joints[i].slides else 1.0
    lever = 1.0 if joints[k].slides and not over else parameter.lever_mm
    return replace(parameter, unit=unit, size=size, lever_mm=lever)


@lru_cache(maxsize=32)
def effects_of(robot: Serial) -> Mapping[str, Effect]:
    """The effects that an arm can have, with the parameters of its own joints."""
    joints, out = robot.joints, {}
    idle = _idle(robot)
    for name, effect in SERIAL_CATALOGUE.items():
        if not has(robot, name):
            continue
        mine = [p for p in effect.parameters if p.name not in idle.get(name, ())]
        own = [one for p in mine if (one := parameter_of(p, joints)) is not None]
        if name == "encoder_eccentricity":
            # once per turn: what slides has none
            own = [p for p in own if p.unit == "rad"]
        elif effect.is_periodic:
            # one period for joints of one unit: that of most of them
            own = [p for p in own if p.unit == robot.joint_unit]
            effect = replace(effect, search=f"period_{robot.joint_unit}")
        elif name == "reading_delay":
            effect = replace(effect, needs=robot.layout.velocities)
        if own:
            out[name] = replace(effect, parameters=tuple(own))
    return out


def _idle(robot: Serial) -> Mapping[str, Collection[str]]:
    """Of each effect that the drawing has to do with, the parameters that can move no target."""
    low, high = robot.ranges
    joints = np.random.default_rng(0).uniform(low, high, (_POSTURES, len(low)))
    # one degree warmer, first target, one kilogramme
    known = np.tile([np.nan, 21.0, *np.zeros(2 * len(low)), 1.0, 1.0, 21.0], (_POSTURES, 1))
    names = [(row["name"], p["name"]) for row in SerialModel.CATALOGUE for p in row["parameters"]]
    asked = [k for k, (effect, _) in enumerate(names) if effect in _BY_DRAWING]
    columns, _, _, _ = robot.core().derivatives(np.zeros(len(names)), (joints, None, known, None), asked)
    moved, out = np.abs(columns).max(axis=(0, 1)), {}
    for effect in _BY_DRAWING:
        own = [(moved[i], names[k][1]) for i, k in enumerate(asked) if names[k][0] == effect]
        most = max(size for size, _ in own)
        out[effect] = {name for size, name in own if size <= _NOTHING * most}
    return out
