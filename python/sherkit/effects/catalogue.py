"""The built-in effects of the linear delta, by link. The numbers run in Rust (`rust/core/src/delta`)."""

from __future__ import annotations

from ..parameters import Parameter
from .effect import Effect


def _each(stems: str, unit: str, size: float, lever_mm: float, *, over: str = "123") -> tuple[Parameter, ...]:
    """Parameters ``stem_1`` … for every limb (or axis), limb by limb."""
    names = [f"{stem}_{k}" for k in over for stem in stems.split()]
    return tuple(Parameter(name, name, unit, size, lever_mm) for name in names)


JOINT_SCALE = Effect(
    name="joint_scale",
    link="joints",
    parameters=_each("scale", "mm/mm", 5e-4, 20.0),
    physics="Each encoder counts too many or too few millimetres: its scale is a few parts in ten thousand off.",
    residuals="Grows in proportion to the travel of one joint; zero at the home position.",
    workshop="Compare each axis with a gauge block or laser over its travel; correct counts per millimetre.",
)
ENCODER_CYCLIC = Effect(
    name="encoder_cyclic",
    link="joints",
    parameters=_each("sine cosine", "mm", 0.005, 1.0),
    search="period_mm",
    physics="A magnetic scale read a little off centre errs by a sine and cosine once per pole pair.",
    residuals="A fine ripple that repeats with the pole pitch along one joint.",
    workshop="Adjust gap and angle of the reading head; enable the encoder's own harmonic compensation.",
)
BACKLASH = Effect(
    name="backlash",
    link="joints",
    parameters=_each("width", "mm", 0.02, 1.0),
    needs=("direction",),
    physics="Play in nut and guide: where a joint stops depends on the side from which it came.",
    residuals="Two values at one place, by the direction of the last motion.",
    workshop="Preload the nut; or approach every pose from the same side.",
)
RAIL_LEAN = Effect(
    name="rail_lean",
    link="structure",
    parameters=_each("radial tangential", "rad", 5e-3, 20.0),
    physics="The rails are not parallel: each leans outwards (radial) or sideways (tangential) by some milliradians.",
    residuals="A shear that grows with height; the common tangential part twists the frame.",
    workshop="Square the rails to the base with a level or autocollimator; shim the feet.",
)
ROD_MISMATCH = Effect(
    name="rod_mismatch",
    link="structure",
    parameters=_each("difference", "mm", 0.1, 1.0),
    physics="The two rods of a limb differ in length, so the platform tilts and carries the measured point with it.",
    residuals="Quadratic in position, nearly all of it hidden in radii and rod lengths: a small rest, a large cause.",
    workshop="Measure rods in pairs on one fixture and match them; shorten the lever from platform to tool.",
)
GRAVITY_SAG = Effect(
    name="gravity_sag",
    link="body",
    parameters=_each("compliance", "mm", 0.05, 1.0),
    physics="Limbs stretch under the platform's weight, the more the more of it they carry; the value is the "
    "stretch of a limb under all of it.",
    residuals="Smooth over the workspace, deeper where one limb hangs steep; mostly hidden in rod lengths.",
    workshop="Stiffen joints and rods, or balance the platform's weight.",
)
THERMAL_GROWTH = Effect(
    name="thermal_growth",
    link="body",
    parameters=(Parameter("coefficient", "α", "1/°C", 2e-5, 20.0),),
    needs=("temperature_c",),
    physics="Everything expands with temperature, so every coordinate grows in proportion to itself.",
    residuals="Proportional to position times the deviation of temperature from 20 °C.",
    workshop="Warm up before measuring; hold the temperature; use Invar rods.",
)
DRIFT = Effect(
    name="drift",
    link="body",
    parameters=_each("rate", "mm/h", 0.1, 1.0, over="xyz"),
    needs=("time_s",),
    physics="The point wanders steadily while the run lasts: creep, settling supports, warming electronics.",
    residuals="A straight line over time, whatever the pose.",
    workshop="Warm up; return to a reference pose regularly; shuffle the order of poses.",
)
SLIP = Effect(
    name="slip",
    link="body",
    parameters=_each("step", "mm", 0.1, 1.0, over="xyz"),
    needs=("time_s",),
    search="time_s",
    physics="Something let go at one moment: a clamp, a magnet, the calibration cube.",
    residuals="A step over time: all readings before it agree, all after it agree.",
    workshop="Tighten clamp and cube; measure again from the moment on.",
)
BEAM_ALIGNMENT = Effect(
    name="beam_alignment",
    link="sensor",
    parameters=tuple(
        Parameter(f"{shown}_by_{of}", f"{shown}{of}", "mm/mm", 5e-3 if shown != of else 1e-3, 20.0)
        for shown in "xyz"
        for of in "xyz"
    ),
    physics="The laser beams are not square to the faces of the cube, the cube is turned to the base, or a sensor's "
    "scale is off: each reading shows a little of the other coordinates.",
    residuals="Linear in the coordinates.",
    workshop="Square the beams to the cube with a mirror; compare sensor scales on a gauge block.",
)
SENSOR_LINEARITY = Effect(
    name="sensor_linearity",
    link="sensor",
    parameters=_each("cubic", "mm", 0.005, 1.0, over="xyz"),
    physics="A sensor's reading bends away from the straight line towards the ends of its range.",
    residuals="Cubic in one coordinate, the same at all other coordinates.",
    workshop="Use the middle of the range; have the sensor's linearity table loaded.",
)
DATUM = Effect(
    name="datum",
    link="sensor",
    parameters=_each("offset", "mm", 10.0, 1.0, over="xyz"),
    physics="Readings are differences from a reference position, so their zero is arbitrary. In the default model.",
    residuals="Constant.",
    workshop="None needed.",
)

#: The catalogue in the order of the chain.
CATALOGUE: dict[str, Effect] = {
    e.name: e
    for e in (
        JOINT_SCALE, ENCODER_CYCLIC, BACKLASH, RAIL_LEAN, ROD_MISMATCH, GRAVITY_SAG, THERMAL_GROWTH, DRIFT, SLIP,
        BEAM_ALIGNMENT, SENSOR_LINEARITY, DATUM,
    )
}  # fmt: skip

#: Effects of the core in the order of its parameters, after the 18 geometric ones.
CORE_ORDER: tuple[Effect, ...] = (
    DATUM, JOINT_SCALE, ENCODER_CYCLIC, BACKLASH, RAIL_LEAN, ROD_MISMATCH, GRAVITY_SAG, THERMAL_GROWTH, DRIFT, SLIP,
    BEAM_ALIGNMENT, SENSOR_LINEARITY,
)  # fmt: skip
