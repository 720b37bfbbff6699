"""A stage of two crossed axes, brought to sherkit from outside: this folder and lines of ``pyproject.toml``.

``stage.py`` is the drawing, ``model.py`` what the drawing may get wrong, ``virtual.py`` a stage with hidden errors that
shares no formula with the model. ``dial_gauge.py`` is an instrument, ``log.py`` an importer, ``squareness.py`` a verb.
"""

from sherkit.model.kinds import Kind

from .model import XY, XYModel
from .stage import XYStage, grid, grid_of_plan
from .virtual import VirtualXYStage

KIND = Kind(
    "xy_stage", XYStage, XYModel, (XY,), None, VirtualXYStage, coordinates=XY.coordinates, poses={"grid": grid_of_plan},
    grid="grid", areas={"whole": grid, "local": lambda stage: grid(stage, 5, 0.3)}, called="the XY stage",
    example=XYStage((120.0, 80.0)),
)  # fmt: skip

__all__ = ["KIND", "VirtualXYStage", "XYModel", "XYStage"]
