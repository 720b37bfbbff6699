"""Sentences on the effects of the linear delta; the table of the effects is `rust/core/src/delta/effects.rs`."""

from __future__ import annotations

from sherkit._core import DeltaModel

from ...model.effect import Effect, Sentences
from ...model.sentences import COMMON, catalogue_of

_OWN = {
    "datum": COMMON["datum"],
    "joint_scale": Sentences(
        physics="Each encoder counts too many or too few millimetres: its scale is a few parts in ten thousand off.",
        residuals="Grows in proportion to the travel of one joint; zero at the home position.",
        remedy="Compare each axis with a gauge block or laser over its travel; correct counts per millimetre.",
    ),
    "rail_lean": Sentences(
        physics="The rails are not parallel: each leans outwards (radial) or sideways (tangential).",
        residuals="A shear that grows with height; the common tangential part twists the frame.",
        remedy="Square the rails to the base with a level or autocollimator; shim the feet.",
    ),
    "rod_mismatch": Sentences(
        physics="The two rods of a limb differ in length, so the platform tilts and carries the measured point with "
        "it.",
        residuals="Quadratic in position, nearly all of it hidden in radii and rod lengths: a small rest, a large "
        "cause.",
        remedy="Measure rods in pairs on one fixture and match them; shorten the lever from platform to tool.",
    ),
    "limb_twist": Sentences(
        physics="The joint axis of a limb at its carriage is turned against that at the platform, as a rail at a wrong "
        "base angle turns it: the limb is no parallelogram, and the platform tilts as it moves.",
        residuals="The tilt times the lever from platform to tool, growing from the middle outwards. A turn common to "
        "all limbs hides in the base geometry: differences between limbs are what shows.",
        remedy="Align the axes of each limb with a bar through both joints; turn each carriage with its rail.",
    ),
    "drive_compliance": Sentences(
        physics="Belt, screw or controller let a carriage give way along its rail under what its limb pulls with; the "
        "value is the way under the platform's whole weight.",
        residuals="A joint error that follows the limb's share of the weight: most where that limb carries most.",
        remedy="Stiffen belt and controller, balance the platform's weight, or read the carriage and not the motor.",
    ),
    "gravity_sag": Sentences(
        physics="Limbs stretch under the platform's weight, the more the more of it they carry; the value is the "
        "stretch of a limb under all of it.",
        residuals="Smooth over the workspace, deeper where one limb hangs steep; mostly hidden in rod lengths.",
        remedy="Stiffen joints and rods, or balance the platform's weight.",
    ),
    "link_growth": Sentences(
        physics="Rods, frame and rails expand with temperature, each by its own part: carbon rods between steel rails, "
        "a warm frame around cool rods. Where all parts are equal, it is thermal_growth.",
        residuals="Proportional to the deviation of temperature from 20 °C: rods that grow push the platform along "
        "the rails, a frame that grows pulls it back, rails that grow stretch the heights.",
        remedy="Warm up before measuring; hold the temperature; rods and frame of one material, or of Invar.",
    ),
    "slip": Sentences(
        physics="Something let go at one moment: a clamp, a magnet, the calibration cube.",
        residuals="A step over time: all readings before it agree, all after it agree.",
        remedy="Tighten clamp and cube; measure again from the moment on.",
    ),
    "beam_alignment": Sentences(
        physics="The laser beams are not square to the faces of the cube, the cube is turned to the base, or a "
        "sensor's scale is off: each reading shows a little of the other coordinates.",
        residuals="Linear in the coordinates.",
        remedy="Square the beams to the cube with a mirror; compare sensor scales on a gauge block.",
    ),
}

#: The effects by name, in the order of the chain.
CATALOGUE: dict[str, Effect] = catalogue_of(DeltaModel.CATALOGUE, _OWN)
