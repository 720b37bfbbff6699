"""What can go wrong, as sentences a lab user can act on. All derive from :class:`SherkitError`."""

from __future__ import annotations

import math


class SherkitError(Exception):
    """Base of everything that sherkit raises on purpose."""


class SherkitWarning(UserWarning):
    """Something looks wrong but the work can go on."""


class RobotError(SherkitError):
    """A robot description that is no robot: names file, table and key."""


class MeasurementError(SherkitError):
    """A table of measurements that cannot be used: names file, row and column."""


class FitError(SherkitError):
    """An identification that cannot be carried out on these rows."""


class EffectError(SherkitError):
    """An effect that is not known, lacks what it needs, or is not what an effect must be."""


class CalibrationError(SherkitError):
    """A calibration file that cannot be loaded."""


class ShapeError(SherkitError, ValueError):
    """An array of the wrong shape or a name that is not known."""


class NotFinite(SherkitError, ValueError):
    """NaN or infinity where a number is needed."""


class Singular(SherkitError):
    """The joints do not fix the position here."""


class NotConverged(SherkitError):
    """An iteration that did not settle."""


class OutOfReach(SherkitError):
    """A pose that the robot cannot take.

    ``limb`` counts from one, zero where both limbs of a spherical robot are meant. ``miss_mm`` is what a rod of the
    delta lacks (negative: has too much), ``miss_rad`` by what angle a spherical robot's axes are too far apart
    (negative: too near); the other of the two is NaN.
    """

    def __init__(self, message: str, limb: int, miss_mm: float, miss_rad: float = math.nan) -> None:
        super().__init__(message)
        self.limb = limb
        self.miss_mm = miss_mm
        self.miss_rad = miss_rad


class NotSeen(SherkitError):
    """A point or a pixel that camera and sphere have no answer for: behind, past the sphere, beyond the lens' fold."""
