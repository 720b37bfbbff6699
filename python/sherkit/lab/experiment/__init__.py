"""Experiments: a plan of steps, the bench that carries it out, and the run file that loses nothing."""

from .bench import Bench
from .file import AdaptiveRun, Experiment, load_experiment
from .plan import Plan, PlanStep, Point, plan_of_poses
from .run_file import RunFile, export_run
from .runner import Control, Goal, Live, RunProgress, run

__all__ = [
    "AdaptiveRun",
    "Bench",
    "Control",
    "Experiment",
    "Goal",
    "Live",
    "Plan",
    "PlanStep",
    "Point",
    "RunFile",
    "RunProgress",
    "export_run",
    "load_experiment",
    "plan_of_poses",
    "run",
]
