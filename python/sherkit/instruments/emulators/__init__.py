"""Emulated instruments: servers that speak the real ones' bytes on ports of this machine, behind one virtual robot.

Written apart from the drivers, which never import them and which they never import.
"""

from .ati import NetFtEmulator, NetFtPage
from .camera import CameraEmulator, CameraPage
from .faults import KINDS, Fault, Faults
from .galil import GalilEmulator
from .keyence import KeyenceEmulator
from .micron_optics import HyperionEmulator, Sm130Emulator
from .profile import Profile
from .server import Emulator
from .world import StillRobot, VirtualRobot, World

__all__ = [
    "KINDS",
    "CameraEmulator",
    "CameraPage",
    "Emulator",
    "Fault",
    "Faults",
    "GalilEmulator",
    "HyperionEmulator",
    "KeyenceEmulator",
    "NetFtEmulator",
    "NetFtPage",
    "Profile",
    "Sm130Emulator",
    "StillRobot",
    "VirtualRobot",
    "World",
]
