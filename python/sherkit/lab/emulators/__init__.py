"""Emulated instruments: servers that speak the real ones' bytes on ports of this machine, behind one virtual robot.

Written apart from the drivers, which never import them and which they never import.
"""

from .ati import NetFtEmulator
from .camera import CameraEmulator, NetworkCamera
from .galil import GalilEmulator
from .keyence import KeyenceEmulator
from .micron_optics import HyperionEmulator, Sm130Emulator
from .scpi import ScpiEmulator
from .server import Emulator
from .world import FAULTS, Faults, InjectedFault, Profile, StillRobot, World

__all__ = [
    "FAULTS",
    "CameraEmulator",
    "Emulator",
    "Faults",
    "GalilEmulator",
    "HyperionEmulator",
    "InjectedFault",
    "KeyenceEmulator",
    "NetFtEmulator",
    "NetworkCamera",
    "Profile",
    "ScpiEmulator",
    "Sm130Emulator",
    "StillRobot",
    "World",
]
