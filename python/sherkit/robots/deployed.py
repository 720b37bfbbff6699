"""What a control loop runs: where the tool of a calibrated robot is, how to bring it there, and where it was measured:
that ends where the poses end."""

from __future__ import annotations

import warnings
from abc import ABC
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..base.figures import nearest
from ..base.notebook import Saved
from ..base.types import Bools, Floats
from ..data.columns import unit_in
from ..errors import CalibrationError, SherkitWarning
from ..model.batch import Batch, matrix, vector
from ..model.kinds import Robot
from .identified_model import IdentifiedModel
from .poses_hull import MARGIN, beyond

#: Where places are counted from: the base of the robot, as its drawing has it; or the instrument, where that stood.
BASE, SENSOR = "base", "sensor"

#: A place is far from the poses of a run from this many times their extent on.
_FAR = 1.0


@dataclass(frozen=True, eq=False)
class Deployed(Saved, ABC):
    """A robot with ``whole``, what was identified over its workspace.

    Coordinates are those of :attr:`coordinates`, joint readings those of the robot. Covariates of the control loop
    (``temperature_c``, and ``direction``: the sign of the last motion of each joint) matter only where the model holds
    an effect that needs them; left out, :attr:`Part.now` stands for them.

    Places are given in :attr:`frame` unless another of :attr:`frames` is asked for by name: that of the robot's
    ``base``, as its drawing has it, where nothing of the instrument counts; or that of the ``sensor``, as the
    instrument reads that measured it, from where it stood at last.
    """

    #: The frame of places unless another is asked for, and why there is no other where there is none.
    frame: ClassVar[str] = BASE
    no_other: ClassVar[str] = "its kind knows no other frame"

    #: What :meth:`forward` gives, with units.
    coordinates: ClassVar[tuple[str, ...]]
    #: What one and many of them are called in messages.
    called: ClassVar[tuple[str, str]]
    #: Whether several postures lead to a place, so that the core takes where it begins; a delta has one.
    many_postures: ClassVar[bool] = False

    robot: Robot
    whole: IdentifiedModel

    def __post_init__(self) -> None:
        _ = self.core  # refuses numbers that do not fit together

    @cached_property
    def core(self) -> Any:
        """The compiled model: the same code that a control loop runs."""
        return self._made_in(self.frame)

    # -- frames ------------------------------------------------------------------------------------------------------

    @property
    def frames(self) -> tuple[str, ...]:
        """The frames in which places can be given, that of :attr:`frame` first."""
        return (self.frame,)

    def frame_of(self, frame: str | None) -> str:
        """The frame of this name, by default :attr:`frame`. Raises :class:`~sherkit.errors.CalibrationError`."""
        if frame is None or frame in self.frames:
            return frame or self.frame
        if frame in (BASE, SENSOR):
            raise CalibrationError(
                f"frame '{frame}': the places of this {self.robot.kind} robot are those of the frame '{self.frame}' "
                f"alone: {self.no_other}"
            )
        raise CalibrationError(
            f"frame: expected '{BASE}' or '{SENSOR}', found '{frame}'{nearest(str(frame), (BASE, SENSOR))}"
        )

    def core_in(self, frame: str | None = None) -> Any:
        """:attr:`core` with places in a frame. Raises as :meth:`frame_of`."""
        return self.core if self.frame_of(frame) == self.frame else self._core_elsewhere

    @cached_property
    def _core_elsewhere(self) -> Any:
        """The compiled model with places in the other frame."""
        return self._made_in(BASE if self.frame == SENSOR else SENSOR)

    def _made_in(self, frame: str) -> Any:
        """The compiled model with places in one of :attr:`frames`."""
        raise CalibrationError(f"{self.no_other} ({frame})")

    @cached_property
    def sensor_frame(self) -> tuple[Floats, Floats]:
        """From the base to the sensor as identified, where it stood at last: the turn (3, 3) and the shift (3,), mm."""
        made: tuple[Floats, Floats] = self.model.sensor_frame(self.whole.values, slipped=True)
        return made

    def from_sensor(self, readings_mm: ArrayLike) -> Floats:
        """What the sensor shows (n, 3), mm, in the frame of the base, from where it was found to stand.

        Raises :class:`~sherkit.errors.CalibrationError` for a robot of one frame.
        """
        self._require_both()
        turn, shift = self.sensor_frame
        made: Floats = (matrix(readings_mm, "readings") - shift) @ turn
        return made

    def to_sensor(self, places_mm: ArrayLike) -> Floats:
        """Places (n, 3), mm, of the base's frame as the sensor sees them from where it was found to stand. Raises as
        :meth:`from_sensor`."""
        self._require_both()
        turn, shift = self.sensor_frame
        made: Floats = matrix(places_mm, "places") @ turn.T + shift
        return made

    def _require_both(self) -> None:
        for frame in (BASE, SENSOR):
            self.frame_of(frame)

    def _own(self, places: Floats, frame: str) -> Floats:
        """Places (n, k) of a frame in :attr:`frame`."""
        if frame == self.frame:
            return places
        return np.ascontiguousarray(self.to_sensor(places) if frame == BASE else self.from_sensor(places))

    # -- what a loop asks ----------------------------------------------------------------------------------------------

    @cached_property
    def model(self) -> Any:
        """The model that was identified over the workspace, a :class:`~sherkit.model.chain.ChainModel`."""
        return self.whole.model(self.robot)

    @cached_property
    def by_name(self) -> dict[str, float]:
        """Its values by the names of their parameters."""
        return dict(zip((p.name for p in self.model.parameters), self.whole.values.tolist(), strict=True))

    def forward(
        self, joints: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None,
        direction: ArrayLike | None = None,
    ) -> Floats:  # fmt: skip
        """Coordinates (k,) in a ``frame`` for joint readings (j,). Raises :class:`~sherkit.errors.OutOfReach` with what
        is wrong, :class:`~sherkit.errors.CalibrationError` for a frame that there is not."""
        return self._one(joints, frame, temperature_c, direction)[0]

    def jacobian(
        self, joints: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None,
        direction: ArrayLike | None = None,
    ) -> Floats:  # fmt: skip
        """d coordinates / d joints (k, j) of the whole corrected model. Arguments and errors as :meth:`forward`."""
        return self._one(joints, frame, temperature_c, direction)[1]

    def inverse(
        self, coordinates: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None,
        direction: ArrayLike | None = None, start: ArrayLike | None = None,
    ) -> Floats:  # fmt: skip
        """Joint readings (j,) at which the corrected model gives ``coordinates`` (k,), to 1e-6 mm or 1e-12 rad.

        Of many postures, where a machine has them, that to which steps lead from the joints ``start`` (j,). Other
        arguments as :meth:`forward`. Raises as that, or :class:`~sherkit.errors.NotConverged` where a correction folds
        over. Warns once (:class:`~sherkit.errors.SherkitWarning`) of a place that is farther from the poses of the run
        than these lie apart.
        """
        x, now = self._place(coordinates), self._now(temperature_c, direction)
        begin = None if start is None else vector(start, "start", self._joints)
        made: Floats = self.core_in(frame).inverse(x, now, *self._beginning(begin))
        self._went_to(x, frame)
        return made

    def forward_batch(
        self, joints: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None,
        direction: ArrayLike | None = None,
    ) -> Batch:  # fmt: skip
        """Coordinates (n, k) in a ``frame`` for joint readings (n, j), all reached in one ``direction`` (j,) if given;
        rows out of reach are marked."""
        values, _, reached = self._rows(joints, frame, temperature_c, direction)
        return Batch(values, reached)

    def jacobian_batch(
        self, joints: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None,
        direction: ArrayLike | None = None,
    ) -> Batch:  # fmt: skip
        """Jacobians (n, k, j) for joint readings (n, j). Arguments as :meth:`forward_batch`."""
        _, values, reached = self._rows(joints, frame, temperature_c, direction)
        return Batch(values, reached)

    def inverse_batch(
        self, coordinates: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None,
        direction: ArrayLike | None = None, starts: ArrayLike | None = None,
    ) -> Batch:  # fmt: skip
        """Joint readings (n, j) for coordinates (n, k), all reached in one ``direction`` (j,) if given, each from its
        own of ``starts`` (n, j) as in :meth:`inverse`; rows out of reach are marked."""
        x, now = self._places(coordinates), self._now(temperature_c, direction)
        begin = None if starts is None else matrix(starts, "starts", self._joints)
        if begin is not None and len(begin) != len(x):
            raise CalibrationError(f"starts: expected one for each of {len(x)} places, got {len(begin)}")
        values, reached = self.core_in(frame).inverse_batch(x, now, *self._beginning(begin))
        return Batch(values, reached)

    # -- where the run measured, and what grows outside it ---------------------------------------------------------

    def measured(self, coordinates: ArrayLike, *, frame: str | None = None) -> bool:
        """Whether ``coordinates`` (k,) of a ``frame`` lie where poses were measured: in the box of their places, and
        the joints that lead there (:meth:`inverse_batch`) in their convex hull, both give or take a tenth."""
        return bool(self.measured_batch(self._place(coordinates)[None, :], frame=frame)[0])

    def measured_batch(self, coordinates: ArrayLike, *, frame: str | None = None) -> Bools:
        """:meth:`measured` of every one of ``coordinates`` (n, k), as (n,); what is out of reach was not."""
        x = self._own(self._places(coordinates), self.frame_of(frame))
        inside = np.zeros(len(x), dtype=bool)
        for part, here in self._ruled(x):
            margin = 0.1 * (part.high - part.low)
            inside |= here & ((x >= part.low - margin) & (x <= part.high + margin)).all(axis=1)
        asked = np.flatnonzero(inside)
        if len(asked):
            there = self.inverse_batch(np.ascontiguousarray(x[asked]))
            inside[asked] = there.reached
            reached = np.flatnonzero(there.reached)
            inside[asked[reached]] = self.beyond_poses(x[asked[reached]], there.values[reached]) <= MARGIN
        return inside

    def beyond_poses(self, coordinates: Floats, joints: Floats) -> Floats:
        """How far outside the hull of the poses (:func:`~sherkit.robots.poses_hull.beyond`) the ``joints`` (n, j) lie
        that lead to ``coordinates`` (n, k) of :attr:`frame`: (n,), zero inside."""
        out = np.zeros(len(joints))
        for part, here in self._ruled(coordinates):
            out[here] = beyond(part.poses, joints[here])
        return out

    def grown(self, part: IdentifiedModel, far: Floats) -> Floats:
        """By what factor (n,) the covariance of what a part leaves grows so ``far`` (n,) outside the poses: from a
        tenth of the range on it is at least what regions show that were left out whole, and farther out it grows with
        the distance, as that of differences does of what has no scale of its own (a linear variogram: Matheron,
        Economic Geology 1963)."""
        return 1.0 + np.minimum(far / MARGIN, 1.0) * (part.elsewhere**2 * (1.0 + far) - 1.0)

    def part_at(self, coordinates: Floats) -> IdentifiedModel:
        """The part that rules at ``coordinates`` (k,)."""
        del coordinates
        return self.whole

    def _ruled(self, coordinates: Floats) -> list[tuple[Any, Bools]]:
        """The parts that rule at ``coordinates`` (n, k) of :attr:`frame`, each with the rows (n,) where it does."""
        parts = [self.part_at(one) for one in coordinates]
        return [(p, np.array([one is p for one in parts])) for p in {id(one): one for one in parts}.values()]

    # -- as the core has it --------------------------------------------------------------------------------------------

    def _beginning(self, joints: Floats | None) -> tuple[Floats, ...]:
        """What the core takes beside places and covariates: joints to begin at, where that matters."""
        return () if joints is None or not self.many_postures else (joints,)

    def _went_to(self, x: Floats, frame: str | None) -> None:
        """Says once that it is asked where nothing like the place was measured: quick, for control loops."""
        if frame is not None and frame != self.frame:
            x = self._own(x[None, :], frame)[0]
        for value, (low, high) in zip(x.tolist(), self._near, strict=True):
            if not low <= value <= high:
                return self._say_far(x)
        return None

    @cached_property
    def _near(self) -> list[tuple[float, float]]:
        """Places (k) that the poses of the run are near to, coordinate by coordinate."""
        low, high = self.whole.low, self.whole.high
        extent = float((high - low).max())
        # a single pose says of no place that it is far
        reach = _FAR * extent if extent > 0 else np.inf
        return list(zip((low - reach).tolist(), (high + reach).tolist(), strict=True))

    def _say_far(self, x: Floats) -> None:
        low, high, unit = self.whole.low, self.whole.high, unit_in(self.coordinates[0])
        beyond, extent = float(np.maximum(low - x, x - high).max()), float((high - low).max())
        warnings.warn(
            f"{', '.join(f'{v:.4g}' for v in x)} {unit} is {beyond:.3g} {unit} beyond the poses of "
            f"{self.whole.made_from}, which cover {extent:.3g} {unit}: what is so far outside is extrapolated, and no "
            "accuracy is promised there; measure nearer to it",
            SherkitWarning,
            stacklevel=4,
        )
        self.__dict__["_near"] = [(-np.inf, np.inf)] * len(x)

    def _one(self, joints: ArrayLike, frame: str | None, *now: Any) -> tuple[Floats, Floats]:
        q = vector(joints, "joint readings", self._joints)
        made: tuple[Floats, Floats] = self.core_in(frame).forward(q, self._now(*now))
        return made

    def _rows(self, joints: ArrayLike, frame: str | None = None, *now: Any) -> tuple[Floats, Floats, Bools]:
        """Coordinates, Jacobians, and which rows are within reach."""
        q = matrix(joints, "joint readings", self._joints)
        made: tuple[Floats, Floats, Bools] = self.core_in(frame).forward_batch(q, self._now(*now))
        return made

    def _now(self, temperature_c: float | None = None, direction: ArrayLike | None = None) -> list[float]:
        """Covariates for the core: those given, else those that stand in for them."""
        now = list(self.whole.now)
        if temperature_c is not None:
            now[1] = float(temperature_c)
        if direction is not None:
            now[2:] = [float(d) for d in vector(direction, "direction", self._joints)]
        return now

    def moment_of(self, part: Any, now: list[float]) -> list[float]:
        """These covariates at the end of a part's own run: each counts from when it was measured."""
        return [part.now[0], *now[1:]]

    @property
    def _joints(self) -> int:
        return len(self.whole.now) - 2

    def _place(self, coordinates: ArrayLike) -> Floats:
        return vector(coordinates, self.called[0], len(self.coordinates))

    def _places(self, coordinates: ArrayLike) -> Floats:
        return matrix(coordinates, self.called[1], len(self.coordinates))
