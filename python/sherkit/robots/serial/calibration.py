"""The calibrated serial arm: where its target is in the base frame, joints that bring it somewhere, and how well."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
import scipy
from numpy.typing import ArrayLike

import sherkit._core as _core

from ...base.types import Floats
from ...model.batch import Batch
from ..accuracy import Planes
from ..calibrated import MIDDLE, Calibration
from ..calibration_run import CalibrationRun
from ..deployed import BASE, SENSOR
from ..identified_model import IdentifiedModel, at_rest
from .robot import POSITION, Serial

#: Poses of the run from which a way to a place is looked for.
_NEAREST = 4


@dataclass(frozen=True, eq=False, repr=False)
class SerialCalibration(Calibration):
    """A calibrated serial arm. Positions, mm, are those of the target in the frame of the base, which first axis and
    tracker define together: programs of an arm are written in it, and nothing of the tracker is in it. Where the frame
    of the sensor is asked for they are as the tracker reads them, errors and all, from where it stood at last.

    A place leaves open how the arm stands there: joints are those to which damped steps lead from a start.
    """

    coordinates: ClassVar = POSITION
    called: ClassVar = ("position", "positions")
    frame: ClassVar = BASE
    no_other: ClassVar = "distances alone do not tell where an instrument stands; leave the frame out"

    robot: Serial
    whole: IdentifiedModel

    @classmethod
    def of(cls, whole: CalibrationRun, local: CalibrationRun | None = None) -> Self:
        """From a run; there is no local one."""
        del local
        fit, held_out = whole.fit, whole.deployed(whole.held_out)
        size = len(POSITION)
        counted = np.isfinite(held_out) & fit.data.used
        use = counted[:, :size].all(axis=1)
        made = cls(fit.model.robot, IdentifiedModel.identified(fit, size))
        where = made.forward_batch(fit.data.joints[counted.any(axis=1)]).require("row")
        if use.any() or not counted.any():
            # where the tracker saw it, in the axes of the base
            left, scatter = whole.left(lambda missed: missed[use][:, :size] @ made.sensor_frame[0], held_out)
        else:
            # distances alone: their errors are along every direction
            left, scatter = whole.left_alike(counted, held_out)
        return replace(made, whole=made.whole.leaving(left, scatter, where))

    @property
    def frames(self) -> tuple[str, ...]:
        """That of the base, and that of the tracker where one read."""
        return (BASE, SENSOR) if self.robot.has_tracker else (BASE,)

    def _made_in(self, frame: str) -> _core.SerialCalibrated:
        low, high = self.robot.ranges
        full = self.model.full(self.whole.values)
        full = full if self.model.plates is None else self.model.plates.own(full)
        return _core.SerialCalibrated(self.model.core, full, low.copy(), high.copy(), frame)

    def forward(
        self, joints: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None,
        direction: ArrayLike | None = None, payload_kg: float = 0.0,
    ) -> Floats:  # fmt: skip
        """Position (3,), mm, of the target with ``payload_kg`` hanging there, nothing unless it is given. Other
        arguments and errors as :meth:`Deployed.forward`."""
        return self._one(joints, frame, temperature_c, direction, payload_kg)[0]

    def jacobian(
        self, joints: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None,
        direction: ArrayLike | None = None, payload_kg: float = 0.0,
    ) -> Floats:  # fmt: skip
        """d position / d joints (3, k) of the whole corrected model. Arguments and errors as :meth:`forward`."""
        return self._one(joints, frame, temperature_c, direction, payload_kg)[1]

    def _now(
        self, temperature_c: float | None = None, direction: ArrayLike | None = None, payload_kg: float = 0.0
    ) -> list[float]:
        """With what hangs at the target: nothing unless it is said."""
        return [*super()._now(temperature_c, direction), float(payload_kg)]

    def inverse(
        self, coordinates: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None,
        direction: ArrayLike | None = None, payload_kg: float = 0.0, start: ArrayLike | None = None,
    ) -> Floats:  # fmt: skip
        """Joint readings (k,) within their limits at which the target is at ``coordinates`` (3,), to 1e-9 mm.

        Of many postures that to which damped steps lead from ``start`` (k,); left out, from the pose of the run whose
        place is nearest, of which :meth:`accuracy` speaks, or where no way leads from the nearest few as
        :meth:`Serial.inverse`. Other arguments as :meth:`forward`. Raises :class:`~sherkit.errors.OutOfReach` with how
        near it comes.
        """
        now = self._now(temperature_c, direction, payload_kg)
        core, place = self.core_in(frame), self._place(coordinates)
        near = self._found_near(place[None], frame, now) if start is None else None
        if near is not None and near.reached[0]:
            made: Floats = near.values[0]
        else:
            made = self.robot.found_from(lambda x, q: core.inverse(x, now, q), place, start)
        self._went_to(place, frame)
        return made

    def inverse_batch(
        self, coordinates: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None,
        direction: ArrayLike | None = None, payload_kg: float = 0.0, starts: ArrayLike | None = None,
    ) -> Batch:  # fmt: skip
        """Joint readings (n, k) for positions (n, 3), each from its own of ``starts`` (n, k), left out as
        :meth:`inverse`; those out of reach are marked. ``direction`` (k,) and ``payload_kg`` as :meth:`forward`."""
        core, now = self.core_in(frame), self._now(temperature_c, direction, payload_kg)
        places = self._places(coordinates)
        if starts is not None:
            return Batch(*self.robot.all_found_from(lambda x, q: core.inverse_batch(x, now, q), places, starts))
        made = self._found_near(places, frame, now)
        missing = np.flatnonzero(~made.reached)
        if len(missing):
            others = self.robot.all_found_from(lambda x, q: core.inverse_batch(x, now, q), places[missing], None)
            made.values[missing], made.reached[missing] = others
        return made

    def _found_near(self, places: Floats, frame: str | None, now: list[float]) -> Batch:
        """Joints (n, k) to places (n, 3) from the poses of the run whose places are nearest, the nearest first."""
        poses, core = self.whole.poses, self.core_in(frame)
        joints, reached = np.full((len(places), self._joints), np.nan), np.zeros(len(places), dtype=bool)
        if len(poses):
            there = self.from_sensor(places) if self.frame_of(frame) == SENSOR else places
            nearest = self._places_of_run.query(there, k=range(1, min(_NEAREST, len(poses)) + 1))[1]
            for begin in nearest.T:
                rows = np.flatnonzero(~reached)
                joints[rows], reached[rows] = core.inverse_batch(places[rows], now, poses[begin[rows]])
        return Batch(joints, reached)

    @cached_property
    def _places_of_run(self) -> scipy.spatial.KDTree:
        """Where the poses of the run are, base frame."""
        return scipy.spatial.KDTree(self.forward_batch(self.whole.poses).values)

    # -- accuracy ----------------------------------------------------------------------------------------

    def by_values(self, part: IdentifiedModel, joints: Floats, now: list[float]) -> Floats:
        """Of positions (n, 3, p), in the axes of the base; what is the tracker's as it reads them."""
        del part
        columns, _ = self.core.by_parameters_batch(joints, now, self.model.indices)
        names = [self.model.core_parameters[k].name for k in self.model.indices]
        its = [k for k, name in enumerate(names) if name in self.model.of_sensor]
        if its and SENSOR in self.frames:
            turn, _ = self.sensor_frame
            known = np.array([[*now[: 2 + self._joints]]] * len(joints))
            seen, _, _ = at_rest(self.model, self.whole.values, self.whole.readings, joints, known)
            columns[:, :, its] = turn.T @ seen[:, : len(POSITION), its]
        return np.asarray(columns)

    def carried(self, joints: Floats, by_joints: Floats, missed: Floats) -> Floats:
        """In the axes of the base."""
        del joints, by_joints
        return self.sensor_frame[0].T @ missed[:, : len(self.coordinates)]

    def places(self) -> list[tuple[str, Floats]]:
        """Where the target is at home, and at the poses of the run that are nearest to the middle of their joints and
        farthest from it: positions (3,), mm."""
        low, high, poses = self.whole.low, self.whole.high, self.whole.poses
        middle, far = 0.5 * (low + high), np.where(np.abs(high) > np.abs(low), high, low)
        if len(poses):
            # between poses a place may have joints that are like none of them
            spread = poses.std(axis=0)
            off = np.linalg.norm((poses - poses.mean(axis=0)) / np.where(spread > 0, spread, np.inf), axis=1)
            middle, far = (self.forward(poses[k]) for k in (np.argmin(off), np.argmax(off)))
        return [("home", self.forward(self.robot.home)), (MIDDLE, middle), ("its far side", far)]

    def planes(self, per_side: int) -> Planes:
        """The lowest, middle and highest plane of what was measured."""
        return Planes.horizontal(self.whole.low, self.whole.high, per_side, ".0f")
