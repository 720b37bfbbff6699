"""What a diagnosis named, written into the tool: the file of the next run."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from ...base import linalg
from ...errors import RobotError
from ...fit.identify import Fit
from .effects import TOOL_CATALOGUE
from .model import ToolModel
from .tool import FlexibleTool, rotation_of


@dataclass(frozen=True)
class Applied:
    """``tool`` says the effects that are ``written``; ``kept_out`` are those that a tool file cannot say, ``why`` a
    sentence on each."""

    tool: FlexibleTool
    written: tuple[str, ...]
    kept_out: tuple[str, ...]
    why: tuple[str, ...]


@linalg.one_thread()
def applied(model: ToolModel, fit: Fit) -> Applied:
    """The tool of a model with the camera's offset and the effects of a fit to its rows written into it.

    The camera saw the tip at m + R (tip - m) + c, with the middle m of the run's places, the turn R of ``registration``
    and the offset c; its frame is turned and moved back by that.
    """
    tool, written, kept_out, why = model.tool, [], [], []
    turn = np.eye(3)
    for effect in fit.model.effects:
        values = fit.values[fit.model.owns(effect)]
        known = TOOL_CATALOGUE.get(effect.name)
        if effect.name == "registration":
            turn = rotation_of(values)[0]
        elif known is None or known.tool is None:
            kept_out.append(effect.name)
            why.append(f"{effect.name} has no key in a tool file. {known.remedy if known else ''}".strip())
            continue
        else:
            try:
                tool = known.tool(tool, values)
            except RobotError as error:
                kept_out.append(effect.name)
                why.append(f"{effect.name} cannot be written: {error}")
                continue
        written.append(effect.name)
    offset = fit.values[: len(model.parameters)]
    middle = model.predict(model.readings, np.zeros(len(model.parameters))).mean(axis=0)
    shift = turn.T @ (np.array(tool.camera_translation_mm) - offset - middle) + middle
    rotation = scipy.spatial.transform.Rotation.from_matrix(turn.T @ tool.camera_rotation).as_rotvec()
    tool = replace(
        tool,
        camera_rotation_rad=tuple(rotation.tolist()),
        camera_translation_mm=tuple(shift.tolist()),
    )
    return Applied(tool, tuple(written), tuple(kept_out), tuple(why))
