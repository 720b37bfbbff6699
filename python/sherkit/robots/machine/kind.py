"""What a machine brings: the parts of a kind of robot, made for its columns and parameters."""

from __future__ import annotations

from typing import Any

from ...model.kinds import Kind
from .calibration import MachineCalibration
from .described import Described
from .effects import catalogue_of
from .model import MachineModel


def kind_for(machine: Described) -> Kind:
    """A kind of its own: tables, columns and classes of this machine."""
    own = [
        {"name": p.name, "symbol": p.name, "unit": p.unit, "size": p.size, "lever_mm": None} for p in machine.own
    ]  # fmt: skip
    table: list[dict[str, Any]] = [
        {"name": machine.name, "link": "structure", "base": True, "parameters": own, "needs": [], "search": None},
        *(one.row for one in machine.effects),
    ]
    readings = tuple(machine.readings)
    tables = {
        "catalogue": catalogue_of(machine.effects), "layouts": (machine.layout,), "table": table, "targets": readings,
    }  # fmt: skip
    model = type("MachineModel", (MachineModel,), tables | {"__doc__": MachineModel.__doc__})
    deployed = {"coordinates": readings, "__doc__": MachineCalibration.__doc__}
    calibration = type("MachineCalibration", (MachineCalibration,), deployed)
    return Kind(
        machine.kind, machine, model, (machine.layout,), calibration, coordinates=readings,  # type: ignore[arg-type]
        called=f"the machine '{machine.name}'", example=machine,
    )  # fmt: skip
