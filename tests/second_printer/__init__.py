"""A second simulator of delta printers: machine, plate, probe, and what three firmwares write of them.

It shares no code with sherkit, which is never imported here. The machine is six rods between carriages and effector,
whose pose is found by Newton's method on their six lengths; the firmwares count from their end stops as their sources
have it."""

from .firmware import Firmware, duet_files, klipper_file, marlin_file
from .machine import Machine
from .plate import Plate
from .probing import Probe, mesh_points, touched

__all__ = [
    "Firmware", "Machine", "Plate", "Probe", "duet_files", "klipper_file", "marlin_file", "mesh_points", "touched",
]  # fmt: skip
