"""A linear delta printer: a delta whose measured point is the tip of its probe, as its firmware has it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np

from ...base.types import Floats
from ...data.columns import Layout
from ...data.declared import key
from ...data.toml import Table
from ..delta.columns import JOINTS, POSITION, TO_JOINTS
from ..delta.robot import Delta, Triple
from .towers import Towers

# -- The columns of a run of a printer ------------------------------------------------------------------------------

#: Where the carriages were sent; how high above the middle plane of the bed the probe's tip then was, or, in a row that
#: has another end, how far apart the two places are. One reading a row, so that distances count as heights do.
PROBED = Layout(JOINTS, ("measured_mm",), "µm", 1e3, None, TO_JOINTS, follows=False)
#: How far the plate was turned, degrees anticlockwise seen from above, and which of the probings a row is from.
PLATE, PROBING = "plate_deg", "probing"

__all__ = ["PLATE", "POSITION", "PROBED", "PROBING"]


# --------------------------------------------------------------------------------------------------------------

#: What no firmware knows, as it usually is, mm: the distance of the two rods of an arm, and that of the arms' joints
#: from the middle of the effector. They matter where an effector tilts alone: how far follows from the difference of
#: two rods over their distance, so that another one is another difference and no other tilt.
ROD_SPACING_MM, EFFECTOR_MM = 50.0, 30.0
FIRMWARES = ("klipper", "reprapfirmware", "marlin")


@dataclass(frozen=True)
class Printer(Delta):
    """A linear delta printer.

    A :class:`~sherkit.robots.delta.Delta` with towers A, B, C, carriages that are read from their motors, and the tip
    of the probe, or the nozzle, as measured point. ``endstop_mm`` are the heights above the bed at which the firmware
    has its end stops. ``tilt`` (x, y), mm/mm, is that of the bed which RepRapFirmware can hold besides. ``probings``
    names what was probed, each with a zero of its own: the probe's offset may have been set anew between them."""

    endstop_mm: Triple = (0.0, 0.0, 0.0)
    tilt: tuple[float, float] = (0.0, 0.0)
    probings: tuple[str, ...] = ()
    firmware: str = "klipper"
    kind: str = field(default="printer", init=False)

    TABLES: ClassVar = {
        **Delta.TABLES,
        "printer": {
            "firmware": key(Table.text, FIRMWARES),
            "endstop_mm": key(Table.numbers, 3).needed,
            "tilt": key(Table.numbers, 2).quiet,
            "probings": key(Table.texts).needed,
        },
    }

    @classmethod
    def with_towers(cls, towers: Towers, **others: Any) -> Self:
        """The printer that a firmware's calibration describes."""
        return cls(
            base_radius_mm=(towers.radius_mm + EFFECTOR_MM,) * 3,
            base_angle_deg=towers.angle_deg,
            platform_radius_mm=(EFFECTOR_MM,) * 3,
            platform_angle_deg=towers.angle_deg,
            rod_length_mm=towers.arm_mm,
            rod_spacing_mm=ROD_SPACING_MM,
            pole_pitch_mm=0.0,  # steppers without encoders
            endstop_mm=towers.endstop_mm,
            **others,
        )

    @property
    def towers(self) -> Towers:
        """The calibration that the firmware has."""
        radius = self.base_radius_mm[0] - self.platform_radius_mm[0]
        return Towers(radius, self.base_angle_deg, self.rod_length_mm, self.endstop_mm)

    def plane_mm(self, xy: Floats) -> Floats:
        """Height (n,) of the bed that the firmware assumes at places (n, 2), mm, in the frame of the towers."""
        return np.asarray(xy, dtype=float) @ np.array(self.tilt)
