"""What the firmware of a linear delta printer can hold: one radius; an angle, an arm and an end stop for each tower.

Klipper (``klippy/kinematics/delta.py``), RepRapFirmware (``LinearDeltaKinematics.cpp``) and Marlin (``delta.cpp``)
agree: tower i stands at ``radius · (cos angle_i, sin angle_i)``, degrees anticlockwise from +x seen from above,
nominally 210 (front left), 330 (front right) and 90 (back), and its carriage for the nozzle at (x, y, z) at ``z +
sqrt(arm_i² − d²)`` with d the horizontal distance. A carriage at its end stop stands at ``endstop_i + sqrt(arm_i² −
radius²)``: Klipper's ``position_endstop``; H plus the tower's number of M666 in RepRapFirmware; H minus it in Marlin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from ...base.types import Floats
from ..delta.robot import Triple

#: Where the towers A, B, C stand unless the firmware says otherwise, degrees.
ANGLES: Triple = (210.0, 330.0, 90.0)


@dataclass(frozen=True)
class Towers:
    """The calibration of a firmware, mm and degrees."""

    radius_mm: float
    angle_deg: Triple
    arm_mm: Triple
    endstop_mm: Triple

    @property
    def top_mm(self) -> Floats:
        """Heights of the carriages (3,) at their end stops, mm."""
        return np.array(self.endstop_mm) + np.sqrt(np.square(self.arm_mm) - self.radius_mm**2)

    @classmethod
    def through(cls, feet: Floats, arms: Floats, tops: Floats, third_deg: float = 90.0) -> Self:
        """The same machine as towers at any three points ``feet`` (3, 2), mm, with these arms (3,) and carriage heights
        at the end stops (3,): any triangle has a circle through its corners, and where the middle of the bed is and
        what direction it faces is the firmware's own choice. Tower C is put at ``third_deg``."""
        (ax, ay), (bx, by), (cx, cy) = feet
        d = 2.0 * (ax * (by - cy) + bx * (cy - ay) + cx * (ay - by))
        squares = (feet**2).sum(axis=1)
        middle = np.array([squares @ [by - cy, cy - ay, ay - by] / d, squares @ [cx - bx, ax - cx, bx - ax] / d])
        out = feet - middle
        radius = float(np.hypot(*out.T).mean())
        angle = np.rad2deg(np.arctan2(out[:, 1], out[:, 0]))
        angle = (angle - angle[2] + third_deg) % 360.0
        return cls(
            radius,
            _triple(angle),
            _triple(arms),
            _triple(tops - np.sqrt(np.square(arms) - radius**2)),
        )


def _triple(values: Floats) -> Triple:
    a, b, c = (float(v) for v in values)
    return (a, b, c)
