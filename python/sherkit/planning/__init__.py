"""Before measuring: what a plan could find, which poses, with which power."""

from .effect_power import Planning, planning_of
from .poses import PoseDesign, choose_poses
from .power import EffectSize, study_power
from .to_measure import poses_to_measure, rows_at

__all__ = [
    "EffectSize",
    "Planning",
    "PoseDesign",
    "choose_poses",
    "planning_of",
    "poses_to_measure",
    "rows_at",
    "study_power",
]
