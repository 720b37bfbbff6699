"""Motion controllers: axes, what is known of where they stand, and what every driver of axes must offer."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ...base.names import listed
from ...errors import InstrumentError, NotReferenced
from .base import Instrument, Reading

#: The letters that axes of a controller have.
LETTERS = "ABCDEFGH"
#: An axis that stands may be read so many times further from where it was left than an axis that arrives.
_STAYS = 5.0


@dataclass(frozen=True)
class Axis:
    """One motor: its ``letter`` A to H, encoder ``counts_per_unit`` (negative: counts the other way), soft limits.

    A joint stands at ``(counts - zero_counts) / counts_per_unit``, in ``unit``: mm, or rad for one that turns. No
    target outside ``limits`` (low, high), in the same unit, is ever sent. ``name`` is that of the joint, the letter if
    left out.
    """

    letter: str
    counts_per_unit: float
    limits: tuple[float, float]
    zero_counts: int = 0
    name: str = ""
    unit: str = "mm"

    def __post_init__(self) -> None:
        if self.letter not in LETTERS or len(self.letter) != 1:
            raise InstrumentError(f"axis '{self.letter}': expected one letter of {LETTERS}")
        if not (math.isfinite(self.counts_per_unit) and self.counts_per_unit != 0):
            raise InstrumentError(
                f"axis {self.letter}: counts_per_unit is {self.counts_per_unit}; expected a number not 0"
            )
        low, high = self.limits
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise InstrumentError(f"axis {self.letter}: limits are {low}, {high}; expected low, then high")

    @property
    def label(self) -> str:
        """What its values are called."""
        return self.name or self.letter

    def to_counts(self, position: float) -> int:
        """Encoder counts at ``position``."""
        return round(position * self.counts_per_unit) + self.zero_counts

    def to_position(self, counts: float) -> float:
        """Joint position, in its unit, at ``counts``."""
        return (counts - self.zero_counts) / self.counts_per_unit


@dataclass(frozen=True)
class Reference:
    """What a controller says of its axes before they move, in the order of their letters.

    ``said`` is whether it can tell at all that it was homed or zeroed since it was switched on. If so, ``mark`` is the
    number that tells one zeroing from the next, None where the zero is lost or was never set. ``positions`` are in the
    axes' unit; ``drives_on`` is for each axis, ``limits_set`` for each whether the controller's own limits are ours.
    """

    said: bool
    mark: int | None
    positions: tuple[float, ...]
    drives_on: tuple[bool, ...]
    limits_set: tuple[bool, ...]


class AxisController(Instrument):
    """The base of all drivers that move axes: nothing moves until where they stand is proven.

    A driver says how its controller is asked (:meth:`reference`) and how a zero is set (:meth:`set_reference`); it
    calls :meth:`require_reference` before each motion, and notes in ``left_at`` where the axes stood after it.
    """

    axes: tuple[Axis, ...]
    unit: str
    speed: float
    acceleration: float
    arrived_within: float

    #: The mark of the zero with which this program moves; None until it has asked.
    mark: int | None = None
    #: Where each axis stood after its last motion, by letter; without one that was stopped on its way.
    left_at: Mapping[str, float]
    #: Where the home switches are, one joint position for each axis; None where the controller cannot home by itself.
    home_at: tuple[float, ...] | None = None

    @abstractmethod
    def reference(self) -> Reference:
        """Asks the controller. Raises :class:`~sherkit.errors.InstrumentError`."""

    @abstractmethod
    def set_reference(self, positions: Sequence[float]) -> Reference:
        """Tells the controller that the axes, which stand, are at ``positions``, and marks the zero as set.

        Moves nothing. Raises :class:`~sherkit.errors.InstrumentError`.
        """

    @abstractmethod
    def home(self) -> Reference:
        """Drives all axes to their home switches and sets the reference there. Raises where it cannot."""

    @abstractmethod
    def check(self, target: Mapping[str, float] | Sequence[float]) -> dict[str, float]:
        """The target by letters. Raises :class:`~sherkit.errors.OutOfRange` outside the soft limits."""

    @abstractmethod
    def move(self, target: Mapping[str, float] | Sequence[float]) -> Reading:
        """Moves there and returns where the encoders then are. Nothing moves without :meth:`require_reference`."""

    @abstractmethod
    def is_moving(self) -> bool:
        """Whether any axis is on its way."""

    @abstractmethod
    def stop(self) -> None:
        """Stops all axes, and returns when they stand."""

    @abstractmethod
    def enable(self) -> None:
        """Switches the drives on, where they stand."""

    @property
    def braking(self) -> float:
        """How far an axis goes on at most after it was told to stop, in its unit."""
        return 0.5 * self.speed**2 / self.acceleration

    def require_reference(self, *, limits: bool) -> Reference:
        """Raises :class:`~sherkit.errors.NotReferenced` unless where the axes stand is proven; asked twice.

        It is, where the controller was zeroed since it was switched on and not by somebody else since this program
        began, its drives are on, every axis stands within its soft limits (give or take a way to brake) and where its
        last motion left it, and, with ``limits``, the controller's limits are ours.
        """
        found = self.reference()
        if self._doubts(found, limits):
            # a digit that the line has damaged is no doubt about the axes
            found = self.reference()
        if doubts := self._doubts(found, limits):
            raise self.not_referenced("; ".join(doubts))
        if off := [a.label for a, on in zip(self.axes, found.drives_on, strict=True) if not on]:
            raise self.fail(
                NotReferenced,
                f"the drive of {listed(off)} is off. Nothing was moved: look at the emergency stop and the amplifier, "
                "and switch the drives on",
            )
        self.mark = found.mark
        return found

    def not_referenced(self, why: str) -> NotReferenced:
        """The error for that reason, with what to do."""
        return self.fail(
            NotReferenced,
            f"{why}. Nothing was moved: its encoders may not say where the robot is. Run 'sherkit home' with the "
            "experiment's file, then go on with 'sherkit measure --resume'",
        )

    def _doubts(self, found: Reference, limits: bool) -> list[str]:
        said: list[str] = []
        if found.said and found.mark is None:
            said.append("has lost its zero, or was not zeroed since it was switched on")
        elif self.mark is not None and found.mark != self.mark:
            said.append("was zeroed anew while this program ran")
        for axis, at, ours in zip(self.axes, found.positions, found.limits_set, strict=True):
            low, high = axis.limits
            more = self.braking + self.arrived_within
            left = self.left_at.get(axis.letter)
            if not low - more <= at <= high + more:
                said.append(
                    f"{axis.label} stands at {at:.3f} {self.unit} by its encoder, and its limits are {low:g}, {high:g}"
                )
            elif left is not None and abs(at - left) > _STAYS * self.arrived_within + 2.0 / abs(axis.counts_per_unit):
                said.append(f"{axis.label} stands at {at:.3f} {self.unit} by its encoder; it was left at {left:.3f}")
            if limits and not ours:
                said.append(f"the controller's limits of {axis.label} are no longer those that were set")
        return said
