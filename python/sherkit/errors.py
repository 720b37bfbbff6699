"""What can go wrong, as sentences a lab user can act on. All derive from :class:`SherkitError`."""

from __future__ import annotations

import math
import os
from typing import Any


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


class NotWritten(SherkitError, OSError):
    """A file that could not be written (no space, no right, no folder). What stood there before still does."""

    def __init__(self, path: str | os.PathLike[str], error: OSError) -> None:
        super().__init__(error.errno, error.strerror or str(error), os.fspath(path))

    def __str__(self) -> str:
        kept = "; the file that stands there is as it was" if os.path.isfile(self.filename) else ""
        return f"{self.filename}: cannot be written: {self.strerror}{kept}"

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.filename, OSError(self.errno, self.strerror))


class ArgumentError(SherkitError, ValueError, TypeError):
    """An argument that is not what the function takes: names it, and says what was expected."""


class ShapeError(SherkitError, ValueError):
    """An array of the wrong shape or a name that is not known."""


class NotFinite(SherkitError, ValueError):
    """NaN or infinity where a number is needed."""


class Singular(SherkitError):
    """What fixes nothing: joints that do not fix the position here, a matrix that has no inverse."""


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

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.limb, self.miss_mm, self.miss_rad)


class NotSeen(SherkitError):
    """A point or a pixel that camera and sphere have no answer for: behind, past the sphere, beyond the lens' fold."""


class ExperimentError(SherkitError):
    """A laboratory, an experiment or a run file that cannot be used as it is."""


class WorkerLost(SherkitError):
    """A process that was to do a task ended before it answered, and the next one too."""


#: Bytes of an exchange that a sentence shows; the attributes keep them all.
_SHOWN_BYTES = 60


def _shown(data: bytes) -> str:
    rest = len(data) - _SHOWN_BYTES
    return f"{data[:_SHOWN_BYTES]!r} and {rest} more bytes" if rest > 0 else repr(data)


class InstrumentError(SherkitError):
    """An instrument that did not do what it was asked.

    ``instrument`` and ``port`` say which one, ``sent`` what it was asked, ``received`` what came back (bytes, empty
    where there was nothing). All of them are part of the sentence.
    """

    def __init__(
        self, message: str, *, instrument: str = "", port: str = "", sent: bytes = b"", received: bytes = b""
    ) -> None:
        super().__init__(message)
        self.message = message
        self.instrument = instrument
        self.port = port
        self.sent = sent
        self.received = received

    def complete(self, *, instrument: str, port: str, sent: bytes = b"") -> None:
        """Fills in what was not known where the error was raised."""
        self.instrument = self.instrument or instrument
        self.port = self.port or port
        self.sent = self.sent or sent

    def __str__(self) -> str:
        who = " on ".join(w for w in (self.instrument, self.port) if w)
        sentence = f"{who}: {self.message}" if who else self.message
        if self.sent:
            sentence += f"; sent {_shown(self.sent)}, received {_shown(self.received) if self.received else 'nothing'}"
        elif self.received:
            sentence += f"; received {_shown(self.received)}"
        return sentence


class Timeout(InstrumentError):
    """No answer, or not the whole of it, in time."""


class Refused(InstrumentError):
    """The instrument understood and said no. ``code`` and ``text`` are its own words, None and "" if it gave none."""

    def __init__(self, message: str, code: int | None = None, text: str = "", **where: Any) -> None:
        super().__init__(message, **where)
        self.code = code
        self.text = text


class Halted(Refused):
    """A motion that ended before its target. ``code`` is the controller's stop code, ``text`` its meaning."""


class NotReferenced(InstrumentError):
    """Axes of which it is not proven where they stand: nothing was moved. ``sherkit home`` sets their reference."""


class Implausible(InstrumentError):
    """A reading that does not fit where the joints say the robot is, or the other way round."""


class OutOfRange(InstrumentError):
    """No reading to be had here (beam lost, sensor saturated), or a target outside the soft limits."""


class Disconnected(InstrumentError):
    """The port is not there, not open, or was closed by the other end."""


class Garbled(InstrumentError):
    """An answer that is none of those that the instrument can give."""
