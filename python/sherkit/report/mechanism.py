"""The picture of a machine, and of an effect on it: as drawn, and with the effect exaggerated."""

from __future__ import annotations

import numpy as np

from ..data import Measurements
from ..model.kinds import Robot, kind_of, model_of
from .exaggerated import Exaggerated, joints_over
from .scene import Scene


def scene_of(shown: Exaggerated) -> Scene:
    """The scene: pale as the drawing has it, in colour with the effect."""
    frames = [(0.0, shown.plain), *zip(shown.factors, shown.drawings, strict=True)]
    label = f"The machine with {shown.effect.name} exaggerated, behind it the machine as drawn"
    return Scene(label, frames, shown.factor, unit=shown.plain.unit)


def scene_of_robot(robot: Robot) -> Scene:
    """The machine as drawn, amid the poses that it reaches. Raises :class:`~sherkit.errors.SherkitError` where it
    reaches none."""
    kind, model = kind_of(robot), model_of(robot)
    rows = Measurements.planned(joints_over(robot, kind), kind.layout, "drawing")
    values = np.zeros(len(model.parameters))
    targets = kind.drawing(model, rows, values, None).target_mm
    middle = int(np.argmin(np.linalg.norm(targets - targets.mean(axis=0), axis=1)))
    drawn = kind.drawing(model, rows.select(np.array([middle])), values, None)
    return Scene(f"{kind.title[:1].upper()}{kind.title[1:]}, as drawn", [(0.0, drawn)], unit=drawn.unit)
