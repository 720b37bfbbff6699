"""The rows of an interim check, in which something may have changed since a calibration of which little is unknown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..errors import SherkitError
from ..evidence.base import Base
from ..evidence.family import Family, everything
from ..evidence.run import Run
from ..evidence.thresholds import ACCIDENT, LOUDER, NEARLY_ALWAYS, WRONG
from ..evidence.whitening import MOST_IN_COMMON, InCommon, Whitening
from ..model.base import ModelWithEffects
from ..model.effect import Effect
from ..model.kinds import required_um
from ..robots.calibrated import Calibration, load_calibration
from ..robots.deployed import SENSOR
from .change_model import About, Change, ChangeRows
from .courses import in_parts, zeros_at
from .pooled_fit import rows_as_run
from .runs import RunPose, change_candidates, change_columns, noise_of_repeats, stand_of, zeros_of

#: What a model lacks has about so many shapes among the poses of a check.
_SHAPES = 6
#: A run tells what its model leaves no better than this part of its noise.
_BY_CHANCE = 0.5
#: A row is wild that is off by so many times the median of all.
_WILD = 12.0
#: Degrees of freedom of a noise that a calibration knows.
_OF_CALIBRATION = 200
#: Nothing has changed at the calibration, all of it since.
SINCE = np.array([0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Known:
    """A calibration as a model about which little is unknown."""

    calibration: Calibration
    model: Any
    values: Floats
    root: Floats

    @classmethod
    def of(cls, calibration: Calibration | str | PathLike[str]) -> Known:
        """Of a calibration, or its file."""
        if isinstance(calibration, str | PathLike):
            calibration = load_calibration(Path(calibration))
        part: Any = calibration.parts_made[0]
        model = part.model(calibration.robot)
        count = len(part.values)
        values = np.zeros(len(model.parameters))
        values[:count] = part.values
        size = np.array([p.size for p in model.parameters])
        covariance = np.diag(size**2)
        covariance[:count, :count] = part.covariance
        # each in its own deviation: where an instrument stands metres away a turn of it is a shift to many digits
        std = np.sqrt(np.diag(covariance).clip(1e-300))
        value, vector = linalg.eigh(covariance / np.outer(std, std))
        return cls(calibration, model, values, std[:, None] * vector * np.sqrt(value.clip(0.0)))

    def corrected(self, data: Measurements, axes: tuple[int, ...]) -> Floats | None:
        """What is deployed beside the model (n, m), as the sensor saw it; None where nothing is."""
        by = self.calibration.corrects(data.joints)
        return by if by is None or by.shape[1] == len(axes) else None

    def wild(self, data: Measurements, axes: tuple[int, ...]) -> Ints:
        """Rows (k,) that are accidents: so far off from where nearly all others are that no change of a robot is that
        of one place, and, where their pose was read again, off from what was read then."""
        used = data.used[:, list(axes)]
        try:
            stand = stand_of(self.model, data, self.values, axes, used, self.corrected(data, axes))
        except SherkitError:
            return np.zeros(0, dtype=np.int64)
        off = np.linalg.norm(np.where(used, stand.residual, 0.0), axis=1)
        far = off > _WILD * np.median(off[used.any(axis=1)])
        # a pose that is off whenever it is read is no accident
        visits = np.bincount(data.groups)
        far &= ~((visits > 1) & (np.bincount(data.groups, far) == visits))[data.groups]
        rows = np.flatnonzero(far)
        return rows if len(rows) <= WRONG * len(data) else rows[:0]

    def promised(self, data: Measurements, axes: tuple[int, ...]) -> tuple[float | None, bool]:
        """What the calibration promises of a reading at the places of these rows (root mean square, in its unit), as
        its sensor saw them: what nobody knows of the base no reading shows. And whether most of that is what its model
        lacked on the day of its run."""
        made = self.calibration
        frame = SENSOR if SENSOR in made.frames else None
        there = made.forward_batch(data.joints, frame=frame)
        if not there.reached.any():
            return None, False
        places = there.values[there.reached]
        radius = made.predicted_accuracies(places, frame=frame).radius_mm
        left, noise = made.left_of(made.parts_made[0], places)
        # what the model lacked, beyond what a run tells of that by chance, was as large on average; at these places, a
        # few shapes of it, it may be larger
        left = np.sqrt(np.maximum(left**2 - (_BY_CHANCE * noise) ** 2, 0.0)) if noise > 0 else np.zeros(len(left))
        more = float(scipy.special.fdtri(_SHAPES, _OF_CALIBRATION, 1.0 - ACCIDENT)) - 1.0
        left, radius = left[np.isfinite(radius)], radius[np.isfinite(radius)]
        if not len(radius):
            return None, False
        lacked = bool(np.mean(left**2) > 0.5 * np.mean(radius**2))
        radius = np.sqrt(radius**2 + more * np.minimum(left, radius) ** 2)
        per_axis = float(np.sqrt(np.mean(radius**2) / scipy.special.chdtri(3, 1.0 - NEARLY_ALWAYS)))
        if data.layout.unit == "µm":
            return per_axis, lacked
        # where readings are no lengths, by how far a joint moves either
        inputs = self.model.linearised(data, self.values).inputs
        if inputs is None:
            return None, lacked
        read = float(np.sqrt(np.mean(np.square(inputs[:, list(axes)]).sum(axis=(1, 2)))))
        lever = float(getattr(self.calibration, "reach_mm", 1.0))
        return per_axis * read / max(lever * np.sqrt(inputs.shape[2]), 1e-300), lacked


@dataclass(frozen=True, eq=False)
class CheckRows(ChangeRows):
    """Rows of which all readings are ``used`` (n, m), over what readings scatter by, ``unit``, without the ``part`` of
    their variance that repeats of a pose share."""

    known: Known
    data: Measurements
    axes: tuple[int, ...]
    part: float
    unit: float
    model: ModelWithEffects
    values: Floats
    candidates: Sequence[Effect]
    moved: Sequence[tuple[Change, Floats]] = ()
    takes_up: Mapping[str, list[Effect]] = field(default_factory=dict)

    @classmethod
    def of(cls, known: Known, data: Measurements, axes: tuple[int, ...], noise: float, part: float) -> CheckRows:
        """As the calibration has them, with the ``noise`` of a reading; where nobody knows it, what is left."""
        model = known.model.for_run(data)
        made = cls(known, data, axes, part, 1.0, model, known.values, change_candidates(model, [data]))
        left = float(np.sqrt(np.square(made.stand.residual[made.rows]).mean()))
        if left <= LOUDER * scattered_then(known, axes):
            # lost motion that visits of a pose scattered by on that day is none since
            made = replace(made, candidates=[one for one in made.candidates if "direction" not in one.needs])
        columns = {name: one[made.rows] for name, one in made._columns[1].items()}
        takes_up = zeros_of(made.candidates, columns, data.joints[made.rows])
        return replace(made, unit=noise * float(np.sqrt(1.0 - part)) or left or 1.0, takes_up=takes_up)

    @property
    def used(self) -> Bools:
        """Which readings are."""
        return np.asarray(self.data.used[:, list(self.axes)])

    @property
    def rows(self) -> Any:
        """The rows of which all are."""
        return np.flatnonzero(self.used.all(axis=1))

    @cached_property
    def stand(self) -> RunPose:
        """Where the sensor stands, with what has moved in the model."""
        model, values = self.now(1)
        return stand_of(model, self.data, values, self.axes, self.used, self.known.corrected(self.data, self.axes))

    def at(self, about: About) -> CheckRows:
        """As of any rows."""
        return replace(self, moved=about.sized)

    def over(self, each: Floats) -> Floats:
        """Values (n, m, …) over the noise; none of what is known of parameters, which stands in rows of its own."""
        beyond = -(-len(self.known.root) // len(self.axes))
        return np.concatenate([each[self.rows] / self.unit, np.zeros((beyond, *each.shape[1:]))])

    @cached_property
    def _columns(self) -> tuple[Floats, dict[str, Floats]]:
        model, values, stand = self.now(1)[0], self.stand.values, self.stand
        every = model.linearised(self.data, values).parameters[:, list(self.axes)]
        columns = change_columns(model, values, self.data, self.axes, self.candidates, every)
        places = [p.name for p in model.parameters]
        own = every[:, :, [places.index(p.name) for p in self.model.parameters]]
        return stand.in_model(own), {name: stand.in_model(one) for name, one in columns.items()}

    def columns_of(self, effect: Effect, factors: Floats) -> Floats:
        """As of any rows."""
        return self.over(factors[1] * self._columns[1][effect.name][:, :, self.numbers(effect)])

    def run(self, changed: Floats | None = None) -> Run:
        """As of any rows."""
        own, columns = self._columns
        count, m, n = len(self.known.root), len(self.axes), len(self.rows)
        # what is not known of a parameter is a reading of zero, as exact as that
        unknown, at = self.over(own @ self.known.root), np.arange(count)
        unknown[n + at // m, at % m, at] = 1.0
        beyond = len(unknown) - n
        shared = InCommon(
            np.concatenate([self.data.groups[self.rows], self.data.groups.max() + 1 + np.arange(beyond)]),
            np.repeat([np.sqrt(self.part / (1.0 - self.part)), 0.0], [n, beyond]),
        )
        free = [unknown, self.over(self.stand.columns)]
        return rows_as_run(
            self.over(self.stand.residual), np.concatenate(free if changed is None else [changed, *free], axis=2),
            [(e, self.over(columns[e.name])) for e in self.candidates],
            Whitening(0.0, np.ones(n + beyond, dtype=np.int64), None, shared if self.part else None),
        )  # fmt: skip

    @cached_property
    def base(self) -> Base:
        """What is not known, and every change since the calibration."""
        run = self.run()
        columns, blocks = everything(run, shapes=False)
        every = in_parts(blocks)
        made = [
            replace(block, at=np.concatenate([block.at, at]), zeros=len(at))
            for block, at in zip(every, zeros_at(self, every), strict=True)
        ]
        return Base.of(Family(run, made=(columns, made)), run)

    def required(self, promised: float) -> float:
        """What an error where the robot works must not be more than: what is needed, and what is promised."""
        known, data, axes = self.known, self.data, self.axes
        needed = required_um(known.calibration.robot) if data.layout.unit == "µm" else None
        if needed is None:
            # as where runs are compared: what was left of the run that it was calibrated with
            part: Any = known.calibration.parts_made[0]
            left = part.residual_covariance + (part.scatter if part.scatter.size else 0.0)
            same = len(left) == len(axes) and part.readings == data.layout.coordinates
            needed = float(np.sqrt(np.trace(left))) * data.layout.per_unit if same else 0.0
        return max(needed, promised * float(np.sqrt(len(axes))) * data.layout.per_unit)


def scattered_then(known: Known, axes: tuple[int, ...]) -> float:
    """By how much a reading of its own run was off the calibration, visits of a pose and all; 0 where nobody knows."""
    part: Any = known.calibration.parts_made[0]
    if not part.scatter.size or len(part.residual_covariance) != len(axes):
        return 0.0
    return float(np.sqrt(np.trace(part.residual_covariance + part.scatter) / len(axes)))


def noise_of(known: Known, data: Measurements, axes: tuple[int, ...]) -> tuple[float, int, float]:
    """The noise of a reading, with its degrees of freedom, and the part of its variance that repeats of a pose share:
    of this run's repeats and what it declares, else as the calibration knows it; 0 where neither does."""
    own = noise_of_repeats(data, axes)
    if own and data.repeatability is not None:
        names = [data.layout.readings[a] for a in axes]
        shared = float(np.square(data.pose_sigma[:, list(axes)]).mean())
        freedom = sum(data.repeatability.degrees_of_freedom.get(name, 0) for name in names)
        return float(np.hypot(own, np.sqrt(shared))), freedom, min(shared / (own**2 + shared), MOST_IN_COMMON)
    part: Any = known.calibration.parts_made[0]
    scatter = np.diag(part.scatter) if part.scatter.size else np.zeros(1)
    if not scatter.any():
        scatter = np.diag(part.residual_covariance)
    same = len(scatter) == len(axes) and part.readings == data.layout.coordinates
    return float(np.sqrt(scatter.mean())) if same else 0.0, _OF_CALIBRATION, 0.0
