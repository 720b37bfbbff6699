"""A linear delta printer: a delta whose measured point is the tip of its probe, as its firmware has it; what the
firmware can hold, and what was probed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np

from ...base import linalg
from ...base.types import Floats
from ...data import Measurements
from ...data.columns import Layout
from ...data.declared import key
from ...data.toml import Table
from ...errors import MeasurementError, OutOfReach, RobotError
from ..delta.robot import JOINTS, TO_JOINTS, Delta, Triple

# -- What a firmware can hold -------------------------------------------------------------------------------------

#: Where the towers A, B, C stand unless the firmware says otherwise, degrees.
ANGLES: Triple = (210.0, 330.0, 90.0)


@dataclass(frozen=True)
class Towers:
    """The calibration of a firmware, mm and degrees: one radius; an angle, an arm and an end stop for each tower.

    Klipper (``klippy/kinematics/delta.py``), RepRapFirmware (``LinearDeltaKinematics.cpp``) and Marlin (``delta.cpp``)
    agree: tower i stands at ``radius · (cos angle_i, sin angle_i)``, degrees anticlockwise from +x seen from above,
    nominally 210 (front left), 330 (front right) and 90 (back), and its carriage for the nozzle at (x, y, z) at ``z +
    sqrt(arm_i² − d²)`` with d the horizontal distance. A carriage at its end stop stands at ``endstop_i + sqrt(arm_i² −
    radius²)``: Klipper's ``position_endstop``; H plus the tower's number of M666 in RepRapFirmware; H minus it in
    Marlin.
    """

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
        # as far from the first as from each of the others
        squares = (feet**2).sum(axis=1)
        out = feet - linalg.solve(2.0 * (feet[1:] - feet[0]), squares[1:] - squares[0])
        radius = float(np.hypot(*out.T).mean())
        angle = np.rad2deg(np.arctan2(out[:, 1], out[:, 0]))
        angle = (angle - angle[2] + third_deg) % 360.0
        return cls(radius, triple(angle), triple(arms), triple(tops - np.sqrt(np.square(arms) - radius**2)))


def triple(values: Sequence[float] | Floats) -> Triple:
    """Three numbers of Python's own."""
    a, b, c = (float(v) for v in values)
    return (a, b, c)


# -- The columns of a run of a printer ------------------------------------------------------------------------------

#: Where the carriages were sent; how high above the middle plane of the bed the probe's tip then was, or, in a row that
#: has another end, how far apart the two places are. One reading a row, so that distances count as heights do.
PROBED = Layout(JOINTS, ("measured_mm",), "µm", 1e3, None, TO_JOINTS, follows=False)
#: How far the plate was turned, degrees anticlockwise seen from above, and which of the probings a row is from.
PLATE, PROBING = "plate_deg", "probing"
#: What the reading of a row is multiplied by, so that distances have the noise of heights (:mod:`.callipers`).
WEIGHT = "weight"


# -- The printer -----------------------------------------------------------------------------------------------------

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


# -- What was probed, as the rows of a run ------------------------------------------------------------------------


@dataclass(frozen=True)
class ImportedPrinter:
    """A printer as its firmware has it, and the run of what it measured."""

    robot: Printer
    measurements: Measurements


#: Of a row that is no distance.
_NO_END = np.full(3, np.nan)


@dataclass(eq=False)
class ProbedRows:
    """Collects the rows of a printer; ``source`` is the file, for messages.

    A firmware says at which height it believed the probe to touch the plate. The row has it as it was measured: the
    carriages where they are commanded for the touch at height zero, and as reading how high above the plate the tip
    would be there. Between that place and the touch lie tenths of a millimetre, over which a height commanded and one
    reached differ by parts in a thousand: below a micrometre.
    """

    robot: Printer
    source: str
    #: Joints, those of the other end, reading, turn of the plate, what it is, and of which probing.
    _rows: list[tuple[Floats, Floats, float, float, str, str]] = field(default_factory=list)

    def touch(self, xy: Sequence[float] | Floats, height: float, probing: str, plate_deg: float, where: str) -> None:
        """The tip touched the plate at ``xy``, mm, where the firmware believed it to be at ``height``."""
        plane = float(self.robot.plane_mm(np.array(xy)))
        try:
            joints = self.robot.inverse((float(xy[0]), float(xy[1]), plane))
        except OutOfReach as error:
            raise RobotError(f"{where} the point {xy[0]:g}, {xy[1]:g} mm cannot be: {error}") from None
        self._rows.append((joints, _NO_END, plane - height, plate_deg, probing, probing))

    def touch_at(self, joints: Floats, tip_mm: float, what: str, probing: str, where: str) -> None:
        """The carriages stood at ``joints`` when the tip was ``tip_mm`` above the bed, by the probe or a gauge."""
        try:
            x, y, z = self.robot.forward(joints)
            at = self.robot.inverse((x, y, tip_mm))
        except OutOfReach as error:
            raise RobotError(f"{where} cannot be: {error}") from None
        self._rows.append((at, _NO_END, tip_mm - (z - tip_mm), 0.0, what, probing))

    def distance(self, start: Floats, end: Floats, length_mm: float) -> None:
        """Two places of the nozzle are so far apart on a part."""
        self._rows.append((start, end, length_mm, 0.0, "distance", ""))

    def found(self, nothing: str) -> ImportedPrinter:
        """Robot and run. Raises :class:`~sherkit.errors.MeasurementError`, which says ``nothing``, without a row."""
        if not self._rows:
            raise MeasurementError(f"{self.source}: {nothing}")
        joints, ends, readings, plates, what, of = map(np.array, zip(*self._rows, strict=True))
        names = tuple(dict.fromkeys(name for name in of.tolist() if name))
        number = np.array([float(names.index(name)) if name else 0.0 for name in of.tolist()])
        # the same place under a plate that was turned, or probed another time, is none that was read twice
        place = np.column_stack([joints, np.nan_to_num(ends), plates, number])
        columns: dict[str, Any] = {
            **dict(zip((*PROBED.joints, *PROBED.to_joints), (*joints.T, *ends.T), strict=True)),
            PROBED.coordinates[0]: readings,
            "pose": np.unique(place, axis=0, return_inverse=True)[1].ravel(),
            PLATE: plates,
            PROBING: number,
            "what": what,
        }
        robot = replace(self.robot, probings=names)
        return ImportedPrinter(robot, Measurements.from_columns(columns, self.source, layout=PROBED))
