"""Which model goes with which kind of robot: the one place where a new kind is named."""

from __future__ import annotations

from collections.abc import Sequence

from .chain import ChainModel
from .model import DeltaModel
from .robots.file import Robot

#: A new kind of robot brings: its class in ``robots/`` (KINDS), the columns of its runs in ``measurements/columns.py``
#: (LAYOUTS), a model here, and a calibration in ``calibration.py``.
MODELS: dict[str, type[ChainModel]] = {"delta": DeltaModel}


def model_of(robot: Robot | ChainModel, free: Sequence[str] = ()) -> ChainModel:
    """The model of a robot, with these parameters free (by default those of its kind); a model as it is."""
    if isinstance(robot, ChainModel):
        return robot
    return MODELS[robot.kind](robot, tuple(free))
