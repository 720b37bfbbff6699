"""The catalogue of the flexible tool: what gratings, shaft and camera do that the calibrated model does not say.

All of them are identified offline, on a recorded run against the stereo camera. Their values are changes of the tool
file or of the wavelengths; `estimation/model.py` computes what they do to the tip, by the same sensing, filter and beam
that a control loop runs.
"""

from __future__ import annotations

from ..parameters import Parameter
from .effect import Effect


def _p(name: str, unit: str, size: float) -> Parameter:
    return Parameter(name, name, unit, size)


TOOL_CATALOGUE: dict[str, Effect] = {
    e.name: e
    for e in (
        Effect(
            "tool_stiffness", "structure", (_p("relative", "1", 0.05),),
            physics="The shaft is stiffer or softer than calibrated: every bend has another size.",
            residuals="Along the force, in proportion to it, more the less deep the tool is.",
            workshop="Load the shaft at a known place and measure the bend; identify EI again.",
        ),
        Effect(
            "tool_length", "structure", (_p("length", "mm", 1.0),),
            physics="The shaft is clamped elsewhere than drawn: the free length h is another.",
            residuals="Along the force, growing with depth otherwise than those of a stiffness.",
            workshop="Measure from the clamp to the tip.",
        ),
        Effect(
            "shaft_bend", "body", (_p("x", "mm", 0.3), _p("y", "mm", 0.3)),
            physics="The shaft is not straight: without any force its tip is off the robot's axis.",
            residuals="Constant in the tool's frame, so that it turns with the tool; a camera's offset does not.",
            workshop="Turn the tool about its shaft before the camera: a bent tip walks on a circle.",
        ),
        Effect(
            "fbg_gain", "sensor", (_p("section_I", "1", 0.03), _p("section_II", "1", 0.03)),
            physics="The gratings of a section answer more or less strongly than calibrated.",
            residuals="Along the force; force and depth are both off.",
            workshop="Calibrate K_I and K_II again with known forces at known places.",
        ),
        Effect(
            "fbg_bias", "sensor", tuple(_p(f"{s}_{k}", "nm", 0.01) for s in ("I", "II") for k in (1, 2)),
            physics="Wavelengths of the unloaded tool have crept: a force is felt where there is none.",
            residuals="Constant in the tool's frame where the tool is free, and a wrong depth where forces are small.",
            workshop="Read the unloaded tool before each run and take that as reference_nm.",
        ),
        Effect(
            "fbg_temperature", "sensor", tuple(_p(f"{s}_{k}", "nm/nm", 0.1) for s in ("I", "II") for k in (1, 2)),
            physics="The three fibres of a section answer unlike to warmth: taking out what is common leaves a rest.",
            residuals="Follow the common shift of the wavelengths: slow, as the tool warms in the eye.",
            workshop="Warm the unloaded tool and watch the moments; wait until it is warm before the run.",
        ),
        Effect(
            "force_hysteresis", "sensor", (_p("width", "mN", 5.0),),
            physics="Glue and fibres yield late: the force that is felt lags behind the true one by a width.",
            residuals="Change sides with the direction in which the force changes.",
            workshop="Load and unload slowly at one place; look for a loop.",
        ),
        Effect(
            "registration", "sensor", (_p("turn_x", "rad", 0.02), _p("turn_y", "rad", 0.02), _p("turn_z", "rad", 0.02)),
            physics="The camera's frame is turned against what its registration says.",
            residuals="Grow from the middle of the run's places outwards, across the axis of the turn.",
            workshop="Register again, with the free tool led through the whole workspace (sherkit register).",
        ),
        Effect(
            "camera_delay", "sensor", (_p("delay", "s", 0.02),),
            physics="The camera's clock is later or earlier than its setting says.",
            residuals="In proportion to the velocity of the tip.",
            workshop="Let both clocks see one sharp motion; set delay_s.",
        ),
    )
}  # fmt: skip
