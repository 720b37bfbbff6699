"""Where the axes of a Galil controller are: readings, and whether they mean anything since it was switched on.

The controller has no word for "homed". A variable of its own (``zeroed``) does as well: it is set with the zero, and is
gone with it when the power goes, since variables live in the same memory as the positions and are kept only by ``BV``.
A program of the controller that homes by itself can set it, too: ``zeroed=1`` at its end.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Sequence

from ...base.names import listed
from ...errors import Halted, InstrumentError, Refused, Timeout
from .axes import Axis, AxisController, Reference
from .base import Identity, Reading
from .galil_line import LARGEST_COUNT, NUMBER, GalilLine
from .transport import now_s

#: The controller's variable that says that its zero was set.
ZEROED = "zeroed"
_MARKS = 1_000_000_000
#: Stop code after homing.
_HOMED = 10


class GalilReference(GalilLine, AxisController):
    """What a controller says of its axes, and how their zero is set. Only :meth:`home` moves."""

    home_speed: float
    poll_s: float
    poll_timeout_s: float
    #: Whether speed and limits were set since the connection was made.
    _prepared: bool
    #: Letters of what this program moves.
    _moving: set[str]

    def identify(self) -> Identity:
        """Model, firmware and serial number, as far as the controller tells; "unknown" where it tells nothing."""

        def answer(command: str, *, is_number: bool) -> str:
            data = self.command(command).strip()
            # a late answer of the other question would make it another instrument
            if data and bool(NUMBER.fullmatch(data)) is not is_number:
                raise self._garbled(f"expected {'a number' if is_number else 'a name'}", command, data)
            return data

        def asked(command: str, *, is_number: bool) -> str:
            try:
                return self._repeat(lambda: answer(command, is_number=is_number))
            except Refused:
                return ""

        text, number = asked("\x12\x16", is_number=False), asked("MG _BN", is_number=True)
        serial = f"serial number {number.partition('.')[0]}" if number else ""
        return Identity(self.kind, ", ".join(filter(None, (text, serial))) or "unknown", self.address)

    def read(self) -> Reading:
        """Encoder positions of all axes, in their unit, in the order of their letters. Also while moving."""
        return self._reading("_TP")

    def read_commanded(self) -> Reading:
        """Where the profiles of all axes are, in their unit (``RP``)."""
        return self._reading("_RP")

    def reference(self) -> Reference:
        """The variable ``zeroed``, encoders, motors, and ``FL`` and ``BL``. Raises as every question."""
        n = len(self.axes)
        values = self._repeat(
            lambda: self._operands([f"_{o}{a.letter}" for o in ("TP", "MO", "FL", "BL") for a in self.axes],
                                   self.timeout_s)
        )  # fmt: skip
        counts, off, forward, reverse = (values[k * n : (k + 1) * n] for k in range(4))
        ours = [(low, high) == self._limits(a) for a, low, high in zip(self.axes, reverse, forward, strict=True)]
        return Reference(
            True,
            self._repeat(self._mark),
            tuple(a.to_position(c) for a, c in zip(self.axes, counts, strict=True)),
            tuple(not o for o in off),
            tuple(ours),
        )

    def set_reference(self, positions: Sequence[float]) -> Reference:
        """Sets the counts of the axes where they stand (``DP``), and the variable ``zeroed``. Moves nothing.

        Raises :class:`~sherkit.errors.InstrumentError` for positions outside the limits, and while an axis moves.
        """
        targets = self.check([float(q) for q in positions])
        return self._set_reference([targets[a.letter] for a in self.axes])

    def home(self) -> Reference:
        """Drives all axes together to their home switches (``HM``) at ``home_speed`` and sets the reference there.

        The controller's soft limits are off until then: they mean nothing without a zero. Raises
        :class:`~sherkit.errors.InstrumentError` where ``home_at`` is not given, and where an axis did not get there;
        the axes then stand.
        """
        if self.home_at is None:
            raise self.fail(InstrumentError, "does not know where its home switches are; home_at is not set")
        letters = [a.letter for a in self.axes]
        mask = "".join(letters)
        self._prepared = False
        self.left_at = {}
        # HM itself sets a zero at its end: should this program die before it has set the right one, there is none
        self._repeat(lambda: self._acknowledged(f"{ZEROED}=0"))
        self._set("FL", dict.fromkeys(letters, LARGEST_COUNT))
        self._set("BL", dict.fromkeys(letters, -LARGEST_COUNT - 1))
        for setting, value, step in (("SP", self.home_speed, 2), ("AC", self.acceleration, 1024),
                                     ("DC", self.acceleration, 1024)):  # fmt: skip
            counts = {a.letter: int(value * abs(a.counts_per_unit)) // step * step for a in self.axes}
            self._set(setting, {x: max(c, step) for x, c in counts.items()})
        try:
            self._acknowledged(f"HM{mask}")
            self._moving |= set(letters)
            self._acknowledged(f"BG{mask}", self.poll_timeout_s)
            self._wait_for_home(letters)
        except BaseException:
            self.stop()
            raise
        self._moving -= set(letters)
        return self._set_reference(self.home_at)

    # --- the parts of it

    def _wait_for_home(self, letters: Sequence[str]) -> None:
        # to the switch, back over it and once more: the whole way three times
        longest_s = 5.0 + 3.0 * max((a.limits[1] - a.limits[0]) / self.home_speed for a in self.axes)
        end = time.monotonic() + longest_s
        while any(self._running(letters, self.poll_timeout_s)):
            if time.monotonic() > end:
                raise self.fail(Timeout, f"did not find its home switches in {longest_s:.0f} s")
            time.sleep(self.poll_s)
        codes = self._operands([f"_SC{x}" for x in letters], self.poll_timeout_s)
        bad = {x: c for x, c in zip(letters, codes, strict=True) if c != _HOMED}
        if bad:
            who = listed(f"{self._axis(x).label} (SC {c})" for x, c in bad.items())
            raise self.fail(Halted, f"did not end at its home switch: {who}", next(iter(bad.values())))

    def _set_reference(self, positions: Sequence[float]) -> Reference:
        if self.is_moving():
            raise self.fail(InstrumentError, "is moving; its zero is set where it stands")
        counts = {a.letter: a.to_counts(q) for a, q in zip(self.axes, positions, strict=True)}
        # a zero that is half set must not look like one
        self._repeat(lambda: self._acknowledged(f"{ZEROED}=0"))
        self.left_at = {}
        self._repeat(lambda: self._acknowledged(f"DP {','.join(str(counts.get(x, '')) for x in self._lettered())}"))
        found = self.read_confirmed(max(self.arrived_within, 2.0 / min(abs(a.counts_per_unit) for a in self.axes)))
        for axis, at, wanted in zip(self.axes, found.values, positions, strict=True):
            if abs(at - wanted) > self.arrived_within + 1.0 / abs(axis.counts_per_unit):
                raise self.fail(InstrumentError, f"{axis.label} was set to {wanted:g} {self.unit} and now reads {at:g}")
        mark = secrets.randbelow(_MARKS) + 1
        self._repeat(lambda: self._acknowledged(f"{ZEROED}={mark}"))
        now = self.reference()
        if now.mark != mark:
            raise self.fail(InstrumentError, f"the variable {ZEROED} was set to {mark} and is {now.mark}")
        self.mark = mark
        return now

    def _lettered(self) -> str:
        last = max(a.letter for a in self.axes)
        return "".join(chr(c) for c in range(ord("A"), ord(last) + 1))

    def _mark(self) -> int | None:
        """The variable's value; None where there is none."""
        try:
            data = self.command(f"MG {ZEROED}")
        except Refused:
            return None
        (mark,) = self._parsed(data, 1, f"MG {ZEROED}")
        return mark or None

    def _limits(self, axis: Axis) -> tuple[int, int]:
        """``BL`` and ``FL``, in counts."""
        low, high = sorted(axis.to_counts(v) for v in axis.limits)
        return max(low, -LARGEST_COUNT), min(high, LARGEST_COUNT)

    def _axis(self, letter: str) -> Axis:
        return next(a for a in self.axes if a.letter == letter)

    def _reading(self, operand: str) -> Reading:
        def ask() -> Reading:
            counts = self._operands([operand + a.letter for a in self.axes], self.timeout_s)
            port = self._transport
            return Reading(
                self.name,
                tuple(a.label for a in self.axes),
                tuple(a.to_position(c) for a, c in zip(self.axes, counts, strict=True)),
                (self.unit,) * len(self.axes),
                port.arrived_s if port is not None else now_s(),
                {f"counts_{a.letter}": float(c) for a, c in zip(self.axes, counts, strict=True)},
            )

        return self._repeat(ask)

    def _running(self, letters: Sequence[str], timeout_s: float) -> list[bool]:
        flags = self._operands([f"_BG{x}" for x in letters], timeout_s)
        if not all(f in (0, 1) for f in flags):
            asked = f"MG {','.join(f'_BG{x}' for x in letters)}"
            raise self._garbled(
                f"_BG of {listed(letters)} is {flags}; expected 0 or 1", asked, " ".join(map(str, flags))
            )
        return [f == 1 for f in flags]
