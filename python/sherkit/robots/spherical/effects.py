"""Sentences on the effects of the spherical robot and its camera; the table is `rust/core/src/spherical/effects.rs`."""

from __future__ import annotations

from sherkit._core import SphericalModel

from ...model.effect import Effect, Sentences
from ...model.sentences import catalogue_of

_OWN = {
    "joint_offset": Sentences(
        physics="The zero of an encoder is not where the drawing has it: every reading of the joint is off by one "
        "angle.",
        residuals="The common part turns the whole picture about the actuated axis; the difference lifts the tool.",
        remedy="Drive each joint to its mechanical zero and set the encoder there.",
    ),
    "joint_scale": Sentences(
        physics="The ratio of gear or belt is not quite what the drawing says, so an encoder counts too many or too "
        "few radians.",
        residuals="Grows in proportion to the travel of one joint; zero at the home position.",
        remedy="Compare a full turn of each joint with its index mark; correct counts per turn.",
    ),
    "unequal_limbs": Sentences(
        physics="The two limbs are not alike: the arcs of limb 1 are longer than the common ones by the value, those "
        "of limb 2 shorter by as much, so the limbs differ by twice the value.",
        residuals="The tool leans to one side, more where it points away from the actuated axis.",
        remedy="Measure the arcs of both limbs on one fixture and match them.",
    ),
    "axis_offset": Sentences(
        physics="The axis between the links of a limb misses the centre, so the remote centre of motion wanders as the "
        "robot moves.",
        residuals="Millimetres that turn with the joints, whatever the radius.",
        remedy="Shim the bearings of the elbows until their axes meet; this is what makes the robot safe.",
    ),
    "gravity_flexure": Sentences(
        physics="The distal links bend under the weight of the tool; the value is the bend under all of its moment.",
        residuals="Droop that grows with the horizontal lever arm of the tool.",
        remedy="Stiffen the distal links, or balance the tool.",
    ),
    "marker_offset": Sentences(
        physics="The marker is not on the tool axis: it sits beside it, and turns with the distal link.",
        residuals="A shift that turns with the tool.",
        remedy="Move the marker onto the axis, or measure where it is.",
    ),
    "thermal_growth": Sentences(
        physics="Everything expands with temperature, so the marker moves away from the remote centre.",
        residuals="A growth of the radius in proportion to the deviation of temperature from 20 °C; none in angles.",
        remedy="Warm up before measuring; hold the temperature; use Invar.",
    ),
}

#: The effects by name, in the order of the chain.
SPHERICAL_CATALOGUE: dict[str, Effect] = catalogue_of(SphericalModel.CATALOGUE, _OWN)
