"""Any machine: one function of joints and parameters, and their names. The rest is as for a built-in robot."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

from ...base.figures import listed
from ...errors import RobotError
from ...model.kinds import Kind, Robot, known_kinds, register
from ...model.python_file import carried, portable, run_python
from ...model.robot_file import RobotLike, load_robot
from .calibration import MachineCalibration
from .described import MachineDescription
from .generic_effects import machine_catalogue
from .model import MachineModel

# -- What a machine brings ------------------------------------------------------------------------------------------


def kind_for(machine: MachineDescription) -> Kind:
    """A kind of its own: tables, columns and classes of this machine."""
    own = [
        {"name": p.name, "symbol": p.name, "unit": p.unit, "size": p.size, "lever_mm": None} for p in machine.own
    ]  # fmt: skip
    table: list[dict[str, Any]] = [
        {"name": machine.name, "link": "structure", "base": True, "parameters": own, "needs": [], "search": None},
        *(one.row for one in machine.links),
    ]
    readings = tuple(machine.readings)
    tables = {
        "catalogue": machine_catalogue(machine.effects),
        "layouts": (machine.layout,),
        "table": table,
        "targets": readings,
    }
    model = type("MachineModel", (MachineModel,), tables | {"__doc__": MachineModel.__doc__})
    deployed = {"coordinates": readings, "__doc__": MachineCalibration.__doc__}
    calibration = type("MachineCalibration", (MachineCalibration,), deployed)
    return Kind(
        machine.kind, machine, model, (machine.layout,), calibration, coordinates=readings,  # type: ignore[arg-type]
        called=f"the machine '{machine.name}'", example=machine,
    )  # fmt: skip


# -- The machine -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class Machine(MachineDescription):
    """A machine that its owner describes by one function, with the standing of a built-in robot.

    ``function(joints, p)`` gives the readings (n, m) for joint readings (n, k), p holding the parameters by name
    (``p.squareness``), all zero for the machine as drawn. ``joints`` and ``readings`` name the columns of its runs,
    with units at their ends (``x_axis_mm``, ``theta_rad``); readings share one unit. ``joints`` may map names to the
    range over which each goes: where not, ±100 mm or ±1 rad are taken; ``("y_left_mm", -3.0, 3.0)`` is one that stands
    within 3 mm of another, as two motors of one beam do, and poses that are proposed keep to that. ``parameters`` map
    names to unit and plausible size. ``derivative(joints, p)``, if given, is that of the readings by the parameters (n,
    m, p); left out, complex steps are taken where the function allows them, else differences. ``name`` is what the
    machine is called, by default the file in which the function stands. ``columns`` gives the names that its runs have
    by those of the machine, ``{"x_axis_mm": "X cmd"}``, where they are others
    (:func:`~sherkit.data.read_measurements`).

    Where readings are x, y and z of one point, mm (``x_mm``, or ``ball_x_mm`` …), the instrument may stand anywhere:
    the function says where the point is in the axes of the machine, and ``sensor_pose`` is ``"free"``, found with the
    parameters under the names ``sensor_turn_x`` … (rad) and ``sensor_shift_x`` … (mm). What a parameter of the
    function does of it by itself is left to that; base points that are all free stay where they are drawn as a whole.
    ``"held"`` is an instrument that reads in the function's own axes, as all other readings are; a
    :class:`~sherkit.model.sensor_pose.SensorPose` says how well it is known where it stands.

    Errors of joints, readings, time and temperature (:mod:`~sherkit.robots.machine.core`) need not be described: a
    diagnosis tries them by itself.

    Raises :class:`~sherkit.errors.RobotError` for names and units that do not fit together.

        machine = sk.Machine(
            forward, joints=("x_axis_mm", "y_axis_mm"), readings=("x_mm", "y_mm"),
            parameters={"squareness": ("rad", 1e-3)},
        )
        study = sk.Study(machine, "run.csv")
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        known = known_kinds().get(self.kind)
        if known is not None and not isinstance(known.robot, MachineDescription):
            raise RobotError(f"'{self.name}' is the name of a built-in kind of robot: give the machine another name")
        register(self.brings)

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy is this machine where it is known already, so that what was made for it fits."""
        return _known, tuple(portable(getattr(self, one.name)) for one in fields(self) if one.init)

    @cached_property
    def brings(self) -> Kind:
        """What it brings, as a kind of robot of its own; files and runs of it are known from now on."""
        return kind_for(self)


def _known(*given: Any) -> Machine:
    described = tuple(carried(one) for one in given)
    own = [one.name for one in fields(Machine) if one.init]
    held = known_kinds().get(described[own.index("name")])
    if held is not None and isinstance(held.robot, Machine):
        same = tuple(getattr(held.robot, name) for name in own)
        if same == described:
            return held.robot
    return Machine(*described)


# -- From a file --------------------------------------------------------------------------------------------------

_PYTHON = ".py"


def is_machine(path: str | os.PathLike[str]) -> bool:
    """Whether a path is that of a Python file, which would be run."""
    return Path(path).suffix.lower() == _PYTHON


def load_machine(path: str | os.PathLike[str]) -> Machine:
    """The machine that a Python file makes at its top level.

    Raises :class:`~sherkit.errors.RobotError` where the file is not there, fails, or makes none or several.
    """

    def take(module: ModuleType) -> Machine:
        found = {key: value for key, value in vars(module).items() if isinstance(value, Machine)}
        if len(found) != 1:
            has = f"makes {listed(found)}" if found else "makes none"
            raise RobotError(f"{path}: expected one machine at its top level, machine = sk.Machine(...); it {has}")
        return next(iter(found.values()))

    return run_python(path, "a machine", take, RobotError)


def robot_at(path: str | os.PathLike[str]) -> tuple[Robot, RobotLike]:
    """A robot by its file or a machine by its Python file, which is run; and what :func:`run_for` wants of either.

    Only for paths that a person has typed: no file of data names what is to be run. Raises as :func:`load_robot`.
    """
    if is_machine(path):
        made = load_machine(path)
        return made, made
    return load_robot(path), path
