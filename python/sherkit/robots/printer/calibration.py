"""The calibrated printer: where its nozzle is, and what of that its firmware can hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, cast

import numpy as np

from ...base.types import Floats
from ...fit.identify import Fit
from ...model.chain import ChainModel
from ...model.kinds import Robot
from ..calibrated import Note
from ..calibration_run import CalibrationRun
from ..delta.calibration import DeltaCalibration, DeltaPart
from .model import distances
from .robot import Printer


@dataclass(frozen=True, eq=False)
class PrinterPart(DeltaPart):
    """One identified model of a printer."""

    @classmethod
    def of(cls, run: CalibrationRun) -> PrinterPart:
        """The part that a run gives: heights say how far off it is, the same on every axis."""
        fit = run.fit
        left, scatter = run.left_alike(np.isfinite(run.held_out), run.held_out)
        tips = fit.model.tips(fit.data)[~distances(fit.data) & ~fit.data.outlier]
        return cls.identified(fit, 3, uncorrected_covariance=left, correction=None).leaving(left, scatter, tips)

    def model(self, robot: Robot) -> ChainModel:
        """The model that was identified, without the zeros of its probings."""
        return super().model(replace(cast(Printer, robot), probings=()))


@dataclass(frozen=True, eq=False, repr=False)
class PrinterCalibration(DeltaCalibration):
    """A calibrated printer, as :class:`~sherkit.robots.delta.DeltaCalibration`. The plate is none of it."""

    part: ClassVar = PrinterPart

    robot: Printer

    @classmethod
    def of(cls, whole: CalibrationRun, local: CalibrationRun | None = None) -> PrinterCalibration:
        """From a run of heights and distances."""
        del local
        return cls(robot=whole.fit.model.robot, whole=PrinterPart.of(whole))

    @classmethod
    def from_runs(cls, whole: CalibrationRun, local: CalibrationRun | None = None) -> PrinterCalibration:
        """:meth:`of` these runs: what a probe does not show of an effect a printer's owner cannot ask."""
        return cls.of(whole, local)

    def spread(self, coordinates: Floats, joints: Floats) -> Floats:
        """Covariance (n, 3, 3), mm², of the height alone: along the plate a probe sees nothing, and where on it a print
        stands is no error."""
        out = super().spread(coordinates, joints)
        out[:, :2] = out[:, :, :2] = 0.0
        return out

    def notes(self) -> Sequence[Note]:
        """Of what it is known how far it is off."""
        said = "of the height over the plate; how true the sizes of prints are callipers tell"
        return (Note("predicted accuracy", said, {}),)

    @classmethod
    def may_correct(cls, fit: Fit) -> bool:
        """A firmware has a mesh for that."""
        del fit
        return False
