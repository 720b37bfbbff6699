"""Galil DMC-41x3 and DMC-40x0 motion controllers, on a serial port or TCP: axes that move within limits.

Baud, hand-shake and TCP port differ between sources, so they are settings.
"""

from __future__ import annotations

import atexit
import math
import secrets
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import KW_ONLY, dataclass

from ...base.figures import listed
from ...errors import Disconnected, Garbled, Halted, InstrumentError, OutOfRange, Refused, Timeout
from .base import LETTERS, Axis, AxisReference, Reading, Target, middle_of
from .galil_line import LARGEST_COUNT, ZEROED, GalilLine
from .transport import deadline_in

#: Meanings of ``SC``.
STOP_CODES = {
    0: "still running",
    1: "stopped at its target",
    2: "stopped by the forward limit switch or soft limit",
    3: "stopped by the reverse limit switch or soft limit",
    4: "stopped by the command ST",
    6: "aborted by an input",
    7: "aborted by the command AB",
    8: "switched off by a position error",
    9: "stopped after finding an edge",
    10: "stopped after homing",
    15: "stopped by an error of the amplifier",
    99: "timed out",
}
#: The stop codes of a motion that arrived, of one that was told to stop, and after homing.
_DONE, BY_COMMAND, _HOMED = 1, 4, 10
#: So many zeros are told from each other.
_MARKS = 1_000_000_000
#: The profile is over, its stop code not yet written: asked again so often.
_SETTLE_POLL_S = 0.02


@dataclass(eq=False, repr=False)
class Galil(GalilLine):
    """A motion controller with its axes. Connecting moves nothing and switches no motor on.

    Targets are bounded by each axis' soft limits here and, with ``controller_limits``, by ``FL`` and ``BL`` in the
    controller, which hold when this program dies. A motion is stopped (``ST`` with axes, so that the controller's own
    program goes on) on any error, on Ctrl-C, on ``close`` and at exit; SIGKILL leaves it to the controller's limits.

    ``speed``, per s, and ``acceleration``, per s² (also the deceleration), hold for all axes. A move has arrived when
    the profile is over, its stop code is 1 and the encoder is within ``arrived_within``, for which it has
    ``settle_s``. ``poll_s`` is the pause between two looks at a motion, each of which must be answered in
    ``poll_timeout_s``. ``home_at`` says where the home switches are, one position for each axis, for :meth:`home` at
    ``home_speed``.

    Before each motion it is proven where the axes stand (:meth:`~sherkit.lab.instruments.base.AxisController.
    require_reference`): a controller that lost its power, or its zero, moves nothing.
    """

    kind = "Galil"

    axes: Sequence[Axis]
    _: KW_ONLY
    speed: float = 5.0
    acceleration: float = 50.0
    arrived_within: float = 0.01
    settle_s: float = 2.0
    poll_s: float = 0.05
    poll_timeout_s: float = 0.5
    stop_timeout_s: float = 5.0
    controller_limits: bool = True
    home_at: Sequence[float] | None = None
    home_speed: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        letters = [a.letter for a in self.axes]
        if not letters or len(set(letters)) != len(letters):
            raise InstrumentError(f"{self.name}: its axes are {listed(letters) or 'none'}; expected each letter once")
        if len({a.unit for a in self.axes}) != 1:
            raise InstrumentError(f"{self.name}: its axes have different units; give those a controller of their own")
        self._home_speed = 0.2 * self.speed if self.home_speed is None else self.home_speed
        speeds = {"speed": self.speed, "acceleration": self.acceleration, "home_speed": self._home_speed}
        for what, value in speeds.items():
            if not (math.isfinite(value) and value > 0):
                raise InstrumentError(f"{self.name}: {what} is {value}; expected a number above zero")
        self.axes = tuple(sorted(self.axes, key=lambda a: a.letter))
        self.unit = self.axes[0].unit
        self._apart = max(self.arrived_within, 2.0 / min(abs(a.counts_per_unit) for a in self.axes))
        if self.home_at is not None and len(self.home_at) != len(letters):
            raise InstrumentError(f"{self.name}: home_at has {len(self.home_at)} positions; expected {len(letters)}")
        for axis, place in zip(self.axes, self.home_at or (), strict=False):
            low, high = axis.limits
            if not low <= place <= high:
                raise InstrumentError(
                    f"{self.name}: the home switch of {axis.label} is at {place:g} {axis.unit}; expected "
                    f"a place within its limits {low:g} to {high:g}"
                )
        self.left_at = {}
        self._prepared = False
        self._moving: set[str] = set()
        #: how often each axis was told to stop: a motion that sees it change was stopped by another thread
        self._stops = dict.fromkeys(letters, 0)

    # --- what every instrument does

    def close(self) -> None:
        """Stops what this program moves, and gives the port back. Raises as :meth:`stop`."""
        with self._lock:
            try:
                if self._moving and self._transport is not None:
                    self.stop()
            finally:
                super().close()

    def _greet(self) -> None:
        # what was set before may be lost
        self._prepared = False
        super()._greet()

    # --- moving

    def enable(self) -> None:
        """Switches the motors on (``SH``), where they stand. Raises :class:`~sherkit.errors.InstrumentError`."""
        self._tell(f"SH{self._letters}")

    def disable(self) -> None:
        """Switches the motors off (``MO``). An axis that carries weight may fall."""
        self.left_at = {}
        self._tell(f"MO{self._letters}")

    def check(self, target: Target) -> dict[str, float]:
        """The target by letters, in their unit. Raises :class:`~sherkit.errors.OutOfRange` outside the soft limits."""
        targets = super().check(target)
        for letter, value in targets.items():
            if abs((axis := self._axis(letter)).to_counts(value)) > LARGEST_COUNT:
                raise self.fail(
                    OutOfRange,
                    f"axis {axis.label}: {value:g} {self.unit} are more counts than the controller has; check "
                    "counts_per_unit",
                )
        return targets

    def move(self, target: Target) -> Reading:
        """Moves the named axes (all, by a sequence) to ``target`` and returns where the encoders then are.

        Raises :class:`~sherkit.errors.OutOfRange` and :class:`~sherkit.errors.NotReferenced` before anything moves;
        :class:`~sherkit.errors.Halted` where the motion ended elsewhere (limit switch, ``stop`` by another thread);
        other :class:`~sherkit.errors.InstrumentError` where the line failed. After any of them the axes stand still, or
        the sentence says that they may not.
        """
        targets = self.check(target)
        if not targets:
            return self.read()
        with self._stopping(frozenset(targets)):
            stops = self._start(targets)
            self._wait(targets, stops)
            return self._settled(targets)

    def is_moving(self) -> bool:
        """Whether a profile of any axis is still running."""
        return any(self._repeat(lambda: self._running(self._letters, self.timeout_s)))

    def stop(self, letters: Iterable[str] | None = None) -> None:
        """Stops the axes (all if left out) with their deceleration, and returns when they stand.

        May be called from any thread. The command is sent again until the controller says that it stands; a lost
        connection is opened again for it. Raises :class:`~sherkit.errors.InstrumentError` where this failed for
        ``stop_timeout_s``: then the axes may still move.
        """
        which = sorted(set(self._letters if letters is None else letters))
        if unknown := [x for x in which if x not in self._stops]:
            raise self.fail(InstrumentError, f"has no axis {listed(unknown)}")
        self._brake(which, always=True)

    def _brake(self, which: Sequence[str], always: bool) -> None:
        """Stops the axes; without ``always``, nothing where another thread has done so and closed the port."""
        sent = f"ST{''.join(which)}\r".encode()
        was_closed = self._transport is None
        for letter in which:
            self._stops[letter] += 1
        end = deadline_in(self.stop_timeout_s)
        last: InstrumentError | None = None
        while True:
            try:
                with self._lock:
                    if self._transport is None:
                        if not always and not self._moving & set(which):
                            return
                        self._reopen()
                    with self._exchanging(sent) as port:
                        # at once: what else is on the line is sorted out afterwards
                        self._in_step = False
                        port.write(sent, deadline_in(self.poll_timeout_s))
                    running = self._running(which, self.poll_timeout_s)
                # looked at twice, since a wrong digit must not leave an axis moving
                if not any(running) and not any(self._running(which, self.poll_timeout_s)):
                    self._moving -= set(which)
                    if was_closed:
                        self._shut()
                    return
            except Disconnected as error:
                last = error
                self._shut()
            except (Timeout, Garbled, Refused) as error:
                last = error
            if time.monotonic() > end:
                why = f"; last: {last}" if last else ""
                raise self.fail(
                    Timeout,
                    f"may still move, not stopped in {self.stop_timeout_s:g} s: use the emergency stop{why}",
                    sent=sent,
                )
            time.sleep(min(self.poll_s, 0.05))

    # --- the zero

    def set_reference(self, positions: Sequence[float]) -> AxisReference:
        """Sets the counts of the axes where they stand (``DP``), and the variable ``zeroed``. Moves nothing.

        Raises :class:`~sherkit.errors.InstrumentError` for positions outside the limits, and while an axis moves.
        """
        targets = self.check([float(q) for q in positions])
        return self._set_reference([targets[a.letter] for a in self.axes])

    def home(self) -> AxisReference:
        """Drives all axes together to their home switches (``HM``) at ``home_speed`` and sets the reference there.

        The controller's soft limits are off until then: they mean nothing without a zero. Raises
        :class:`~sherkit.errors.InstrumentError` where ``home_at`` is not given, and where an axis did not get there;
        the axes then stand.
        """
        if self.home_at is None:
            raise self.fail(InstrumentError, "does not know where its home switches are; home_at is not set")
        letters = self._letters
        self._prepared = False
        self.left_at = {}
        # HM itself sets a zero at its end: should this program die before it has set the right one, there is none
        self._tell(f"{ZEROED}=0")
        self._set("FL", dict.fromkeys(letters, LARGEST_COUNT))
        self._set("BL", dict.fromkeys(letters, -LARGEST_COUNT - 1))
        self._set_speed(self._home_speed)
        try:
            self._acknowledged(f"HM{letters}")
            self._moving |= set(letters)
            self._acknowledged(f"BG{letters}", self.poll_timeout_s)
            self._wait_for_home(letters)
        except BaseException:
            self.stop()
            raise
        self._moving -= set(letters)
        return self._set_reference(self.home_at)

    def _wait_for_home(self, letters: str) -> None:
        # to the switch, back over it and once more: the whole way three times
        longest_s = 5.0 + 3.0 * max((a.limits[1] - a.limits[0]) / self._home_speed for a in self.axes)
        end = time.monotonic() + longest_s
        while any(self._running(letters, self.poll_timeout_s)):
            if time.monotonic() > end:
                raise self.fail(Timeout, f"did not find its home switches in {longest_s:.0f} s")
            time.sleep(self.poll_s)
        codes = self._operands([f"_SC{x}" for x in letters], self.poll_timeout_s)
        if bad := {a.label: code for a, code in zip(self.axes, codes, strict=True) if code != _HOMED}:
            who = listed(f"{label} (SC {code})" for label, code in bad.items())
            raise self.fail(Halted, f"did not end at its home switch: {who}", next(iter(bad.values())))

    def _set_reference(self, positions: Sequence[float]) -> AxisReference:
        if self.is_moving():
            raise self.fail(InstrumentError, "is moving; its zero is set where it stands")
        counts = {a.letter: a.to_counts(q) for a, q in zip(self.axes, positions, strict=True)}
        letters = LETTERS[: LETTERS.index(max(counts)) + 1]
        # a zero that is half set must not look like one
        self._tell(f"{ZEROED}=0")
        self.left_at = {}
        self._tell(f"DP {','.join(str(counts.get(x, '')) for x in letters)}")
        found = self.read_confirmed(self._apart)
        for axis, at, wanted in zip(self.axes, found.values, positions, strict=True):
            if abs(at - wanted) > self.arrived_within + 1.0 / abs(axis.counts_per_unit):
                raise self.fail(InstrumentError, f"{axis.label} was set to {wanted:g} {self.unit} and now reads {at:g}")
        mark = secrets.randbelow(_MARKS) + 1
        self._tell(f"{ZEROED}={mark}")
        now = self.reference()
        if now.mark != mark:
            raise self.fail(InstrumentError, f"the variable {ZEROED} was set to {mark} and is {now.mark}")
        self.mark = mark
        return now

    # --- the parts of a move

    @property
    def _letters(self) -> str:
        return "".join(a.letter for a in self.axes)

    def _tell(self, command: str) -> None:
        """Sends what may be sent again where its answer was lost."""
        self._repeat(lambda: self._acknowledged(command))

    @contextmanager
    def _stopping(self, letters: frozenset[str]) -> Iterator[None]:
        """Stops the axes on any way out but the good one, and at exit."""

        def at_exit() -> None:
            # a motion in a thread that nobody waited for
            if self.connected:
                self.stop(letters)

        atexit.register(at_exit)
        try:
            yield
        except BaseException as error:
            if letters & self._moving:
                try:
                    self._brake(sorted(letters), always=False)
                except InstrumentError as failed:
                    if isinstance(error, InstrumentError):
                        error.message += f" - and then {failed.message}"
                    else:
                        error.add_note(str(failed))
                if isinstance(error, Disconnected):
                    # the controller may have lost its zero: connect() takes it up again, nothing else
                    self._shut()
            raise
        finally:
            atexit.unregister(at_exit)

    def _prepare(self) -> None:
        if self._prepared:
            return
        self._set_speed(self.speed)
        if self.controller_limits:
            ends = {a.letter: self._limits(a) for a in self.axes}
            self._set("FL", {x: high for x, (_, high) in ends.items()})
            self._set("BL", {x: low for x, (low, _) in ends.items()})
        self._prepared = True

    def _set_speed(self, speed: float) -> None:
        for setting, value, step in (
            ("SP", speed, 2),
            ("AC", self.acceleration, 1024),
            ("DC", self.acceleration, 1024),
        ):
            # even numbers and multiples of 1024 are what the controller has; never faster than asked for
            counts = {a.letter: int(value * abs(a.counts_per_unit)) // step * step for a in self.axes}
            self._set(setting, {x: max(c, step) for x, c in counts.items()})

    def _start(self, targets: Mapping[str, float]) -> dict[str, int]:
        """Sends and verifies the targets, then begins. Returns how often each axis had been stopped before."""
        with self._lock:
            if self._transport is None:
                raise self.fail(Disconnected, "is not connected; call connect() first")
            self.require_reference(limits=self._prepared and self.controller_limits)
            self._prepare()
            stops = dict(self._stops)
            # asked back before anything moves: a wrong digit must not become a motion
            self._set("PA", {x: self._axis(x).to_counts(v) for x, v in targets.items()})
            self._moving |= set(targets)
            self.left_at = {x: at for x, at in self.left_at.items() if x not in targets}
            # not repeated: a second BG during motion would be refused
            self._acknowledged(f"BG{''.join(sorted(targets))}", self.poll_timeout_s)
            return stops

    def _wait(self, targets: Mapping[str, float], stops: Mapping[str, int]) -> None:
        """Polls until the profiles are over. Any error ends it: the caller stops the axes."""
        letters = sorted(targets)
        checked: set[str] = set()
        start = time.monotonic()
        longest_s = 5.0 + 2.0 * max(
            (a.limits[1] - a.limits[0]) / self.speed + self.speed / self.acceleration for a in self.axes
        )
        while True:
            if any(self._stops[x] != stops[x] for x in letters):
                why = f"the motion of {listed(letters)} was stopped from another part of the program"
                raise self.fail(Halted, why, BY_COMMAND, STOP_CODES[BY_COMMAND])
            running = self._running(letters, self.poll_timeout_s)
            ended = [x for x, r in zip(letters, running, strict=True) if not r and x not in checked]
            if ended:
                # looked at now, not when the last axis stands: the others must not go on without it
                self._check_ended(ended, targets)
                checked |= set(ended)
            if not any(running):
                break
            if time.monotonic() - start > longest_s:
                raise self.fail(
                    Timeout,
                    f"{listed(letters)} moved for {longest_s:.0f} s; expected less at {self.speed:g} {self.unit}/s",
                )
            time.sleep(self.poll_s)

    def _check_ended(self, letters: Sequence[str], targets: Mapping[str, float]) -> None:
        """Raises :class:`~sherkit.errors.Halted` where a profile that is over did not end at its target."""
        names = [f"_SC{x}" for x in letters] + [f"_RP{x}" for x in letters]
        values: tuple[int, ...] = ()
        for _ in range(5):
            values = self._operands(names, self.poll_timeout_s)
            if 0 not in values[: len(letters)]:
                break
            time.sleep(_SETTLE_POLL_S)
        codes = dict(zip(letters, values, strict=False))
        places = dict(zip(letters, values[len(letters) :], strict=True))
        bad = {x: f"{STOP_CODES.get(c, 'stopped')} (SC {c})" for x, c in codes.items() if c != _DONE}
        for x in letters:
            # an axis that never began has an old code, and an old place
            if x not in bad and places[x] != self._axis(x).to_counts(targets[x]):
                bad[x] = f"stands at {self._axis(x).to_position(places[x]):g} {self.unit}, as if it had not begun"
        if bad:
            where = listed(f"{self._axis(x).label} {why}" for x, why in bad.items())
            code = codes[next(iter(bad))]
            raise self.fail(
                Halted,
                f"the motion did not reach its target: {where}",
                code,
                STOP_CODES.get(code, ""),
                sent=f"MG {','.join(names)}\r".encode(),
                received=" ".join(map(str, values)).encode(),
            )

    def _settled(self, targets: Mapping[str, float]) -> Reading:
        end = deadline_in(self.settle_s)
        while True:
            reading = self.read()
            miss = {x: reading[self._axis(x).label] - v for x, v in targets.items()}
            # targets are whole counts: half a count of rounding is no miss
            if all(abs(m) <= self.arrived_within + 0.5 / abs(self._axis(x).counts_per_unit) for x, m in miss.items()):
                self._moving -= set(targets)
                # the axes stand: more readings cost little, and tell a wrong digit from a position; of two that agree
                # one may be off by as much as they may differ, of three the middle one is not
                stands = middle_of(reading, self.read_confirmed(self._apart), self.read())
                at = dict(zip((a.letter for a in self.axes), stands.values, strict=True))
                # those that another thread moves are elsewhere in a moment
                self.left_at = {x: q for x, q in at.items() if x not in self._moving}
                return stands
            if time.monotonic() > end:
                worst = max(miss, key=lambda x: abs(miss[x]))
                axis = self._axis(worst)
                raise self.fail(
                    Halted,
                    f"axis {axis.label} stands {miss[worst]:+.4f} {self.unit} from its target {targets[worst]:g} after "
                    f"{self.settle_s:g} s; expected within {self.arrived_within:g}",
                    sent=f"MG {','.join(f'_TP{a.letter}' for a in self.axes)}\r".encode(),
                    received=" ".join(f"{reading.details[f'counts_{a.letter}']:.0f}" for a in self.axes).encode(),
                )
            time.sleep(_SETTLE_POLL_S)
