"""Everything at a port: instruments and their emulators, laboratories, experiments.

What a user takes from it stands here and is loaded when it is asked for: who only analyses a run loads no driver, and
who measures loads no emulator.
"""

from typing import TYPE_CHECKING

from ..base.lazy_imports import door

if TYPE_CHECKING:
    from . import emulators as emulators
    from . import experiment as experiment
    from . import instruments as instruments
    from . import laboratory as laboratory
    from .experiment import Bench, Control, Goal, Live, Plan, RunFile, export_run, load_experiment, plan_of_poses, run
    from .kinds import read_ports, write_ports
    from .laboratory import RunningLaboratory, load_laboratory

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
_ROOMS = ("emulators", "experiment", "instruments", "laboratory")
_ELSEWHERE = {
    "RunningLaboratory": "laboratory",
    "load_laboratory": "laboratory",
    "read_ports": "kinds",
    "write_ports": "kinds",
}

if not TYPE_CHECKING:
    __getattr__ = door(
        __name__, {name: _ELSEWHERE.get(name, "experiment") for name in __all__}, {name: name for name in _ROOMS}
    )


def __dir__() -> list[str]:
    return [*__all__, *_ROOMS]
