"""What may be wrong with a printer, in the order of its chain, in words of its owner."""

from __future__ import annotations

from dataclasses import replace

from ...model.effect import Effect
from ..delta.effects import CATALOGUE as DELTA
from .bed import bed_shape, probing_zero

_BELTS = replace(
    DELTA["joint_scale"],
    physics="A belt moves its carriage a little more or less than the firmware believes: it is stretched, or of "
    "another pitch.",
    residuals="Grows with the travel of one carriage.",
    remedy="Send a carriage 300 mm down and measure with callipers or a steel rule how far it went; correct "
    "rotation_distance or the steps per millimetre of that tower.",
)
_LEAN = replace(
    DELTA["rail_lean"],
    physics="A tower does not stand upright: it leans out from the middle (radial) or sideways (tangential). All three "
    "leaning sideways the same way is a frame that is twisted.",
    residuals="High and low places between the towers that no radius, angle or arm length takes away.",
    remedy="Loosen the screws of the upper corner of that tower, push the frame until it is upright, tighten.",
)
_LOOSE = replace(
    DELTA["backlash"],
    physics="A loose belt or pulley: where a carriage stops depends on the side from which it came.",
    remedy="Tighten the belt and the pulley's screw. A probe that always comes from above does not show it.",
)
#: How far the two rods of a printer's arm usually differ, mm.
_RODS_MM = 0.2
_ARMS = replace(
    DELTA["rod_mismatch"],
    parameters=tuple(replace(p, size=_RODS_MM) for p in DELTA["rod_mismatch"].parameters),
    physics="The two rods of an arm differ in length, so the effector tilts as it moves, and a probe beside the nozzle "
    "is higher or lower than it.",
    remedy="Lay the two rods of each arm side by side on two pins and match their lengths.",
)

_PLATE = replace(bed_shape, residuals="A smooth shape over the plate that turns with it.")
_ZERO = replace(probing_zero, residuals="Constant over each probing.")

#: What is tried of a printer.
CATALOGUE: dict[str, Effect] = {one.name: one for one in (_BELTS, _LOOSE, _LEAN, _ARMS, _PLATE, _ZERO)}
#: Effects that need the distance of the two rods of an arm.
OF_RODS = ("rod_mismatch",)
