"""A second simulator of the flexible tool: exact rod, true kinematics about the hole, fibres as strains.

It shares nothing with the package whose tests use it, and imports nothing of it; agreement is then evidence.
:class:`World` is a world of chosen conditions, :class:`Wide` one whose every convention and error a seed draws.
"""

from . import faults
from .conditions import CONDITIONS, FAULTS
from .honesty import Honesty, honesty, pooled
from .motion import EXPERIMENTS
from .rod import Rod
from .wide import Wide, WideRun
from .world import Gratings, Recorded, World, write_csv

__all__ = [
    "CONDITIONS", "EXPERIMENTS", "FAULTS", "Gratings", "Honesty", "Recorded", "Rod", "Wide", "WideRun", "World",
    "faults", "honesty", "pooled", "write_csv",
]  # fmt: skip
