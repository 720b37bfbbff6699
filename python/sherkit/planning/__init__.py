"""Before measuring: what a plan could find, which poses, with which power."""

from .outlook import Planning, planning_of
from .poses import PoseDesign, choose_poses
from .power import Sought, study_power

__all__ = [
    "Planning",
    "PoseDesign",
    "Sought",
    "choose_poses",
    "planning_of",
    "study_power",
]
