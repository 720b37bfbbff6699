"""The catalogue of the flexible tool: what gratings, shaft and camera do that the calibrated model does not say.

An effect is one entry: its parameters, three sentences, and what a tool file with it says, or, where that is not all or
no file can say it, a function that says where the tip would be. All of them are identified offline, on a recorded run
against the stereo camera; their values are changes of the tool file, of the wavelengths or of the camera, which the
compiled code carries to the tip.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ...base.types import Floats
from ...model.effect import Effect, Parameter
from .places import TipPlaces
from .tool import FlexibleTool, nested, rotation_of

#: Where the tip is (k, 3), mm, robot's base, with parameters of these values.
TipWith = Callable[[TipPlaces, Floats], Floats]
#: The tool whose file says an effect of these values.
ToolWith = Callable[[FlexibleTool, Floats], FlexibleTool]


@dataclass(frozen=True, kw_only=True)
class ToolEffect(Effect):
    """An effect of the tool: ``places`` says where the tip is with it, ``tool`` what its file says then; None where a
    tool file has no key for it. The frame of the camera is the model's to turn."""

    places: TipWith = field(repr=False)
    tool: ToolWith | None = field(default=None, repr=False)


#: Two patterns of three fibres without a common part: the first against the second, both against the third. None is a
#: limb, of which a name would end in its number.
_NAMES = ("1_and_2_apart", "3_below")
_PATTERNS = np.array([[1.0, -1.0, 0.0], [0.5, 0.5, -1.0]])


def _of_fibres(values: Floats) -> Floats:
    """Numbers (2, 3) of the fibres of sections I and II, by two numbers a section."""
    return np.asarray(values.reshape(2, 2) @ _PATTERNS)


def _stronger(tool: FlexibleTool, values: Floats) -> FlexibleTool:
    """A section that answers more strongly needs a smaller gain."""
    return replace(tool, gains=nested(np.array(tool.gains) / (1.0 + values)[:, None, None]))


def _crept(tool: FlexibleTool, values: Floats) -> FlexibleTool:
    shift = np.append(_of_fibres(values), np.zeros(3))
    return replace(tool, reference_nm=nested(np.array(tool.reference_nm) + shift))


def _dragged(at: TipPlaces, values: Floats) -> Floats:
    return at.tip(at.tool, replace(at.felt, beside_mn=at.ahead(float(values[0]))))


def _turned(at: TipPlaces, values: Floats) -> Floats:
    # about the middle of the run, so that it does not take the part of the camera's offset
    middle = at.tip_mm.mean(axis=0)
    return middle + (at.tip_mm - middle) @ rotation_of(values)[0].T


def _p(name: str, unit: str, size: float) -> Parameter:
    return Parameter(name, name, unit, size)


def _effect(
    name: str, link: str, *parameters: Parameter, physics: str, residuals: str, remedy: str,
    tool: ToolWith | None = None, places: TipWith | None = None,
) -> ToolEffect:  # fmt: skip
    """An effect whose tip is, unless something else is said, that of the tool whose file says it."""
    if places is None:
        assert tool is not None

        def places(at: TipPlaces, values: Floats) -> Floats:
            changed = tool(at.tool, values)
            return at.tip(changed, at.feel(changed))

    return ToolEffect(
        name, link, parameters, physics=physics, residuals=residuals, remedy=remedy, places=places, tool=tool
    )


_EFFECTS = (
    _effect(
        "tool_stiffness",
        "structure",
        _p("relative", "1", 0.05),
        physics="The shaft is stiffer or softer than calibrated: every bend has another size.",
        residuals="Along the force, in proportion to it, more the less deep the tool is.",
        remedy="Load the shaft at a known place and measure the bend; identify EI again.",
        tool=lambda tool, v: replace(tool, stiffness_mn_mm2=tool.stiffness_mn_mm2 * (1.0 + float(v[0]))),
    ),
    _effect(
        "tool_length",
        "structure",
        _p("length", "mm", 1.0),
        physics="The shaft is clamped elsewhere than drawn: the free length h is another.",
        residuals="Along the force, growing with depth otherwise than those of a stiffness.",
        remedy="Measure from the clamp to the tip.",
        tool=lambda tool, v: replace(tool, length_mm=tool.length_mm + float(v[0])),
    ),
    _effect(
        "shaft_bend",
        "body",
        _p("x", "mm", 1.0),
        _p("y", "mm", 1.0),
        physics="The shaft is not straight: without any force its tip is off the robot's axis.",
        residuals="Constant in the tool's frame, so that it turns with the tool; a camera's offset does not.",
        remedy="Turn the tool about its shaft before the camera: a bent tip walks on a circle.",
        places=lambda at, v: at.tip_mm + np.einsum("nij,j->ni", at.turn[:, :, :2], v),
    ),
    _effect(
        "fbg_gain",
        "sensor",
        _p("section_I", "1", 0.03),
        _p("section_II", "1", 0.03),
        physics="The gratings of a section answer more or less strongly than calibrated.",
        residuals="Along the force; force and depth are both off.",
        remedy="Calibrate K_I and K_II again with known forces at known places.",
        tool=_stronger,
    ),
    _effect(
        "fbg_bias",
        "sensor",
        *(_p(f"{s}_{k}", "nm", 0.01) for s in ("I", "II") for k in _NAMES),
        physics="Wavelengths of the unloaded tool have crept: a force is felt where there is none.",
        residuals="Constant in the tool's frame where the tool is free, and a wrong depth where forces are small.",
        remedy="Read the unloaded tool before each run and take that as reference_nm.",
        tool=_crept,
    ),
    _effect(
        "fbg_temperature",
        "sensor",
        *(_p(f"{s}_{k}", "nm/nm", 0.1) for s in ("I", "II") for k in _NAMES),
        physics="The three fibres of a section answer unlike to warmth: taking out what is common leaves a rest.",
        residuals="Follow the common shift of the wavelengths: slow, as the tool warms in the eye.",
        remedy="Warm the unloaded tool and watch the moments; wait until it is warm before the run.",
        tool=lambda tool, v: replace(tool, warmth=nested(np.array(tool.warmth) + _of_fibres(v))),
    ),
    _effect(
        "force_hysteresis",
        "sensor",
        _p("width", "mN", 5.0),
        physics="Glue and fibres yield late: the force that is felt lags behind the true one by a width.",
        residuals="Change sides with the direction in which the force changes.",
        remedy="Load and unload slowly at one place; look for a loop.",
        places=_dragged,
    ),
    _effect(
        "registration",
        "sensor",
        _p("turn_x", "rad", 0.02),
        _p("turn_y", "rad", 0.02),
        _p("turn_z", "rad", 0.02),
        physics="The camera's frame is turned against what its registration says.",
        residuals="Grow from the middle of the run's places outwards, across the axis of the turn.",
        remedy="Register again, with the free tool led through the whole workspace (sherkit register).",
        places=_turned,
    ),
    _effect(
        "camera_delay",
        "sensor",
        _p("delay", "s", 0.02),
        physics="The camera's clock is later or earlier than its setting says.",
        residuals="In proportion to the velocity of the tip.",
        remedy="Let both clocks see one sharp motion; set delay_s.",
        tool=lambda tool, v: replace(tool, camera_delay_s=tool.camera_delay_s + float(v[0])),
        places=lambda at, v: at.tip(at.tool, at.felt, at.moments_s - v[0]),
    ),
    _effect(
        "fibre_delay",
        "sensor",
        # slow ones are late by 0.3 s
        _p("delay", "s", 0.06),
        physics=(
            "Interrogator and robot are not of one time, as the setting has it: above zero a force is felt after it "
            "was there, below zero the robot's rows are late."
        ),
        residuals="Along the force, in proportion to how fast it changes.",
        remedy="Let robot and interrogator see one sharp touch; set [gratings] delay_s, or write fbg_time_s.",
        # a file says no delay below zero, and a robot may be late
        tool=lambda tool, v: replace(tool, fibre_delay_s=tool.fibre_delay_s + float(v[0])),
        places=lambda at, v: at.tip(at.tool, at.feel(at.tool, at.waves_later(float(v[0])))),
    ),
)
TOOL_CATALOGUE: dict[str, ToolEffect] = {effect.name: effect for effect in _EFFECTS}
