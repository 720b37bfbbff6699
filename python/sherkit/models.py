"""Which model goes with which kind of robot: the one place where a new kind is named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .chain import ChainModel
from .effects import Effect
from .model import DeltaModel
from .robots.file import Robot
from .spherical_model import SphericalModel

#: A new kind of robot brings: its class in ``robots/`` (KINDS), the columns of its runs in ``measurements/columns.py``
#: (LAYOUTS), a model here, and a calibration in ``calibrations.py``.
MODELS: dict[str, type[ChainModel]] = {"delta": DeltaModel, "spherical": SphericalModel}


def model_of(robot: Robot | ChainModel, free: Sequence[str] = ()) -> ChainModel:
    """The model of a robot, with these parameters free (by default those of its kind); a model as it is."""
    if isinstance(robot, ChainModel):
        return robot
    return MODELS[robot.kind](robot, tuple(free))


def catalogue_of(robot: Robot) -> Mapping[str, Effect]:
    """The built-in effects of a robot by name, in the order of the chain."""
    return MODELS[robot.kind].catalogue
