"""Instruments at their ports: motion controllers, lasers, fibre gratings, forces, cameras.

Each has ``connect``, ``identify``, ``read`` (values with units and the host's time) and ``close``; what goes wrong is
an :class:`~sherkit.errors.InstrumentError` that says which instrument, what was sent and what came back. Serial ports
need pyserial (``pip install "sherkit[lab]"``).
"""

from .ati import NetFT, Scale, fetch_scale
from .base import Axis, AxisController, AxisReference, Identity, Instrument, Reading
from .camera import Frame, Snapshots, VideoCamera
from .galil import Galil
from .keyence import Keyence
from .micron_optics import Hyperion, Sm130
from .scpi import Scpi
from .user_driver import OwnAxes, OwnSensor

__all__ = [
    "Axis",
    "AxisController",
    "AxisReference",
    "Frame",
    "Galil",
    "Hyperion",
    "Identity",
    "Instrument",
    "Keyence",
    "NetFT",
    "OwnAxes",
    "OwnSensor",
    "Reading",
    "Scale",
    "Scpi",
    "Sm130",
    "Snapshots",
    "VideoCamera",
    "fetch_scale",
]
