"""What was probed and measured of a printer, as the rows of a run.

A firmware says at which height it believed the probe to touch the plate. The row has it as it was measured: the
carriages where they are commanded for the touch at height zero, and as reading how high above the plate the tip would
be there. Between that place and the touch lie tenths of a millimetre, over which a height commanded and one reached
differ by parts in a thousand: below a micrometre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...base.types import Floats
from ...data import Measurements
from ...errors import MeasurementError, OutOfReach, RobotError
from .robot import PLATE, PROBED, PROBING, Printer


@dataclass(frozen=True)
class Found:
    """A printer as its firmware has it, and the run of what it measured."""

    robot: Printer
    measurements: Measurements


@dataclass(eq=False)
class Rows:
    """Collects the rows of a printer; ``source`` is the file, for messages."""

    robot: Printer
    source: str
    _joints: list[Floats] = field(default_factory=list)
    _others: list[tuple[Floats | None, float, float, str, str]] = field(default_factory=list)

    def touch(self, xy: Sequence[float] | Floats, height: float, probing: str, plate_deg: float, where: str) -> None:
        """The tip touched the plate at ``xy``, mm, where the firmware believed it to be at ``height``."""
        plane = float(self.robot.plane_mm(np.array(xy)))
        try:
            joints = self.robot.inverse((float(xy[0]), float(xy[1]), plane))
        except OutOfReach as error:
            raise RobotError(f"{where} the point {xy[0]:g}, {xy[1]:g} mm cannot be: {error}") from None
        self._add(joints, None, plane - height, plate_deg, probing, probing)

    def touch_at(self, joints: Floats, tip_mm: float, what: str, probing: str, where: str) -> None:
        """The carriages stood at ``joints`` when the tip was ``tip_mm`` above the bed, by the probe or a gauge."""
        try:
            x, y, z = self.robot.forward(joints)
            at = self.robot.inverse((x, y, tip_mm))
        except OutOfReach as error:
            raise RobotError(f"{where} cannot be: {error}") from None
        self._add(at, None, tip_mm - (z - tip_mm), 0.0, what, probing)

    def distance(self, start: Floats, end: Floats, length_mm: float) -> None:
        """Two places of the nozzle are so far apart on a part."""
        self._add(start, end, length_mm, 0.0, "distance", "")

    def _add(self, joints: Floats, to: Floats | None, reading: float, plate: float, what: str, probing: str) -> None:
        self._joints.append(joints)
        self._others.append((to, reading, plate, what, probing))

    def found(self, nothing: str) -> Found:
        """Robot and run. Raises :class:`~sherkit.errors.MeasurementError`, which says ``nothing``, without a row."""
        if not self._joints:
            raise MeasurementError(f"{self.source}: {nothing}")
        ends, readings, plates, what, of = zip(*self._others, strict=True)
        names = tuple(dict.fromkeys(name for name in of if name))
        number = np.array([float(names.index(name)) if name else 0.0 for name in of])
        joints = np.array(self._joints)
        to = np.array([np.full(3, np.nan) if end is None else end for end in ends])
        # the same place under a plate that was turned, or probed another time, is none that was read twice
        place = np.column_stack([joints, np.nan_to_num(to), plates, number])
        columns: dict[str, Any] = {
            **{name: joints[:, k] for k, name in enumerate(PROBED.joints)},
            **{name: to[:, k] for k, name in enumerate(PROBED.to_joints)},
            PROBED.coordinates[0]: np.array(readings),
            "pose": np.unique(place, axis=0, return_inverse=True)[1].ravel(),
            PLATE: np.array(plates, dtype=float),
            PROBING: number,
            "what": np.array(what),
        }
        robot = replace(self.robot, probings=names)
        return Found(robot, Measurements.from_columns(columns, self.source, layout=PROBED))
