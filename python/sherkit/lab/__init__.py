"""Everything at a port: instruments and their emulators, laboratories, experiments.

What a user takes from it stands here and is loaded when it is asked for: who only analyses a run loads no driver, and
who measures loads no emulator.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .experiment import Bench, Control, Goal, Live, Plan, RunFile, export_run, load_experiment, plan_of_poses, run
    from .laboratory import RunningLaboratory, load_laboratory
    from .ports import read_ports, write_ports

__all__ = [
    "Bench",
    "Control",
    "Goal",
    "Live",
    "Plan",
    "RunFile",
    "RunningLaboratory",
    "export_run",
    "load_experiment",
    "load_laboratory",
    "plan_of_poses",
    "read_ports",
    "run",
    "write_ports",
]
_ELSEWHERE = {
    "RunningLaboratory": "laboratory",
    "load_laboratory": "laboratory",
    "read_ports": "ports",
    "write_ports": "ports",
}
_ROOMS = ("emulators", "experiment", "instruments", "laboratory")


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return import_module(f".{name}", __name__)
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_ELSEWHERE.get(name, 'experiment')}", __name__), name)


def __dir__() -> list[str]:
    return [*__all__, *_ROOMS]
