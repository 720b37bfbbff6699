"""What a model is, whatever the robot: parameters, effects, the rows that an effect sees, the compiled chain."""

from .any import Extended, Model
from .effect import Effect, Parameter, load_effects

__all__ = [
    "Effect",
    "Extended",
    "Model",
    "Parameter",
    "load_effects",
]
