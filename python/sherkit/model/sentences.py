"""Sentences on effects that any robot can have. A robot whose physics differs says it in its own words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .effect import Effect, Sentences, catalogue_of_core

COMMON: dict[str, Sentences] = {
    "reading_delay": Sentences(
        physics="A reading shows the robot a little earlier than the joints beside it: filters, transfer, buffers.",
        residuals="Proportional to the velocity of the joints; none where the robot stands still.",
        remedy="Trigger instrument and encoders together; or measure at rest.",
        sizes={"delay": "readings come {size} late/early"},
    ),
    "joint_scale": Sentences(
        physics="The ratio of gear, belt or scale is not quite what the drawing says, so an encoder counts too much or "
        "too little.",
        residuals="Grows in proportion to the travel of one joint; zero at the home position.",
        remedy="Compare the travel of each joint with a gauge or its index marks; correct counts per travel.",
        sizes={"scale": "joint {k} counts {size} too much/little"},
    ),
    "encoder_cyclic": Sentences(
        physics="An encoder errs by a sine and cosine that repeat: a magnetic scale read a little off centre once per "
        "pole pair; a ring twice per turn where two heads read it, and once per line that is divided unevenly.",
        residuals="A ripple along one joint that repeats with the pole pitch, or a whole number of times per turn.",
        remedy="Adjust gap and angle of the reading head; enable the encoder's own harmonic compensation.",
    ),
    "encoder_second": Sentences(
        physics="What an encoder's scale or a gear does in each period is no pure sine: a second wave goes with it, of "
        "half the period.",
        residuals="A ripple along one joint, two waves in each period of its cyclic error.",
        remedy="As for encoder_cyclic: the encoder's own compensation may have the second harmonic, too.",
    ),
    "encoder_eccentricity": Sentences(
        physics="The encoder's ring sits off the axis of its joint, so it errs by a sine once per turn.",
        residuals="A slow wave along one joint: one period in a whole turn.",
        remedy="Centre the ring with a dial gauge; or read it at two opposite places.",
    ),
    "backlash": Sentences(
        physics="Play in drive and bearings: where a joint stops depends on the side from which it came.",
        residuals="Two values at one place, by the direction of the last motion: width is negative where what is "
        "driven lags behind its encoder.",
        remedy="Preload the drive; or approach every pose from the same side.",
        sizes={"width": "joint {k} has {size} of play"},
    ),
    "thermal_growth": Sentences(
        physics="Everything expands with temperature, so every coordinate grows in proportion to itself.",
        residuals="Proportional to position times the deviation of temperature from 20 °C.",
        remedy="Warm up before measuring; hold the temperature; use Invar.",
        sizes={"coefficient": "everything grows/shrinks by {size}"},
    ),
    "joint_slip": Sentences(
        physics="A joint lost steps at one moment, or its encoder, pulley or coupling slipped: from then on it stands "
        "beside where it is read. The value is how far.",
        residuals="From one moment on as if one joint stood elsewhere by the same amount; none before it.",
        remedy="Home the joint and compare; lower its acceleration, tighten coupling and pulley; measure again.",
        sizes={"step": "joint {k} jumped by {size}"},
    ),
    "thermal_shift": Sentences(
        physics="A stand, a tripod or a base expands, so that instrument and robot move apart with the temperature, "
        "perhaps long after the room has warmed. A growth about another point than the origin is a growth with such a "
        "shift. The control loop, which has no instrument, is not given it.",
        residuals="The same at every pose, in proportion to the temperature, or to that of some minutes ago.",
        remedy="Put robot and instrument on one plate; warm up; shield the stand; return to a reference pose often.",
        sizes={"shift": "robot and instrument move apart along {k} by {size}"},
    ),
    "drift": Sentences(
        physics="The point wanders steadily while the run lasts: creep, settling supports, warming electronics.",
        residuals="A straight line over time, whatever the pose.",
        remedy="Warm up; return to a reference pose regularly; shuffle the order of poses.",
        sizes={"rate": "the point wanders along {k} by {size}"},
    ),
    "slip": Sentences(
        physics="Something let go at one moment: a clamp, a magnet, what the instrument looks at.",
        residuals="A step over time: all readings before it agree, all after it agree.",
        remedy="Tighten what holds the measured point; measure again from the moment on.",
        sizes={"step": "the point jumped along {k} by {size}"},
    ),
    "sensor_linearity": Sentences(
        physics="A sensor's reading bends away from the straight line with the distance from its own zero.",
        residuals="Cubic in one reading, the same whatever the others are.",
        remedy="Use the middle of the range; have the sensor's linearity table loaded.",
    ),
    "sensor_slip": Sentences(
        physics="The instrument or its stand was knocked, or the robot moved on its floor: from one moment on it sees "
        "the robot elsewhere, shifted and turned.",
        residuals="A step over time, which differs from place to place where it is a turn.",
        remedy="Clamp the stand; measure reference nests on the robot's base before and after; measure again from the "
        "moment on.",
    ),
    "sensor_drift": Sentences(
        physics="The instrument turns or creeps steadily while the run lasts: a tripod settles, a stand warms on one "
        "side, a zero of its angles wanders; or the robot sinks on its floor.",
        residuals="A straight line over time, which differs from place to place where it is a turn.",
        remedy="Let instrument and stand warm up and settle; measure reference nests on the robot's base before, "
        "between and after; shuffle the order of poses.",
        sizes={
            "turn_rate": "the instrument turns about its {k} by {size}",
            "shift_rate": "the instrument creeps along its {k} by {size}",
        },
    ),
    "focal_length": Sentences(
        physics="The focal length differs from the calibrated one: the lens was refocused, or warmed up.",
        residuals="The picture grows or shrinks about its middle.",
        remedy="Lock the focus and calibrate the camera again.",
        sizes={"focal": "the focal length is {size} longer/shorter than calibrated"},
    ),
    "lens_distortion": Sentences(
        physics="The lens bends straight lines: radially (k1, k2) and, where its elements are not centred, sideways "
        '(p1, p2). Source: Brown, "Decentering distortion of lenses", 1966.',
        residuals="Grows with the third power of the distance from the middle of the picture.",
        remedy="Calibrate the camera with a board that fills the picture to its corners.",
    ),
    "camera_delay": Sentences(
        physics="A picture shows the robot a little earlier than its time stamp says: exposure, transfer, buffers.",
        residuals="Proportional to the velocity of the joints; none where the robot stands still.",
        remedy="Trigger camera and encoders together; or measure at rest.",
        sizes={"delay": "pictures come {size} late/early"},
    ),
}


def catalogue_of(table: Sequence[Mapping[str, Any]], own: Mapping[str, Sentences]) -> dict[str, Effect]:
    """The effects of a robot's compiled table by name, in its order: the sentences of each are the robot's ``own``, or
    those of any robot.

    A row that every model has (geometry, the sensor's pose) is an effect only where the robot's own say so. Raises
    :class:`~sherkit.errors.EffectError` where an effect has no sentences, or sentences no effect.
    """
    shared = {row["name"]: COMMON[row["name"]] for row in table if not row["base"] and row["name"] in COMMON}
    return catalogue_of_core(table, {**shared, **own})
