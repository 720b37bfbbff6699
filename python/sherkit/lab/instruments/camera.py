"""A camera: OpenCV's ``VideoCapture``, or any other source of frames with its ``read``.

A driver's ``read`` may block for ever when a cable is pulled. It runs in a thread of its own, so that a grab ends at
its deadline.
"""

from __future__ import annotations

import http.client
import math
import queue
import threading
import time
import urllib.request
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...errors import Disconnected, Garbled, InstrumentError, OutOfRange, Timeout
from .base import Identity, Instrument, Reading
from .transport import now_s

Picture = NDArray[np.uint8]

#: Bytes of a picture that comes over the network.
_MOST_BYTES = 1 << 26


class FrameSource(Protocol):
    """What OpenCV's ``VideoCapture`` offers of it."""

    def isOpened(self) -> bool:  # noqa: N802
        """Whether frames can be read."""
        ...

    def read(self) -> tuple[bool, Any]:
        """Whether there is a frame, and the frame: (rows, columns) or (rows, columns, 3) of bytes."""
        ...

    def release(self) -> None:
        """Gives the camera back."""
        ...


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture of bytes, and the host's time at which it came, s since 1970."""

    picture: Picture
    time_s: float


@dataclass(frozen=True)
class Snapshots:
    """A camera that hands out single pictures at an address (PNG or JPEG over HTTP), as many network cameras do.

    Each read asks anew, so that no picture comes from a buffer. Anything else than a picture is no frame.
    """

    address: str
    timeout_s: float = 5.0

    def __post_init__(self) -> None:
        if not self.address.startswith(("http://", "https://")):
            # an address of another kind could be a file of this machine
            raise InstrumentError(f"'{self.address}': expected http://<address of the picture>")

    def isOpened(self) -> bool:  # noqa: N802
        """Whether there is a picture."""
        return self.read()[0]

    def read(self) -> tuple[bool, Any]:
        """Whether there is a picture, and the picture (rows, columns)."""
        try:
            with urllib.request.urlopen(self.address, timeout=self.timeout_s) as answer:
                data = answer.read(_MOST_BYTES)
        except (OSError, http.client.HTTPException):
            return False, None
        import cv2

        found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
        return found is not None, found

    def release(self) -> None:
        """Nothing is held open."""


def parse_frame(ok: bool, given: object, size_px: tuple[int, int] | None) -> Picture:
    """The picture of a ``read``. Raises :class:`~sherkit.errors.Garbled` for what is none of ``size_px``."""
    if not ok or given is None:
        raise Garbled("the camera gave no picture; check its cable and that no other program uses it")
    if not isinstance(given, np.ndarray) or given.dtype != np.uint8 or given.ndim not in (2, 3) or not given.size:
        what = f"{given.dtype} of shape {given.shape}" if isinstance(given, np.ndarray) else type(given).__name__
        raise Garbled(f"the camera gave {what}; expected a picture of bytes")
    if given.ndim == 3 and given.shape[2] not in (1, 3, 4):
        raise Garbled(f"the camera gave {given.shape[2]} values a pixel; expected 1, 3 or 4")
    if size_px is not None and (given.shape[1], given.shape[0]) != tuple(size_px):
        raise Garbled(f"the camera gave {given.shape[1]} × {given.shape[0]} px; expected {size_px[0]} × {size_px[1]}")
    return given


@dataclass(eq=False, repr=False)
class VideoCamera(Instrument):
    """A camera by its number or address (``"0"``, a file, a stream's address) or by a function that opens a source.

    ``find`` gives the place (u, v) of the marker in a picture, px, NaN where there is none. ``discard`` frames are
    read and left out first: those that the camera took before it was asked. ``size_px`` is (width, height).
    """

    kind = "camera"

    address: str = "0"
    _: KW_ONLY
    source: Callable[[], FrameSource] | None = None
    find: Callable[[Picture], tuple[float, float]] | None = None
    size_px: tuple[int, int] | None = None
    discard: int = 4
    timeout_s: float = 5.0
    _worker: _Worker | None = field(default=None, init=False)

    @property
    def connected(self) -> bool:
        """Whether the camera is open."""
        return self._worker is not None

    def identify(self) -> Identity:
        """The size of its pictures: cameras do not name themselves."""
        rows, columns = self.grab().picture.shape[:2]
        return Identity(self.kind, f"{columns} × {rows} px", self.address)

    def grab(self) -> Frame:
        """A picture taken after this was called. Raises :class:`~sherkit.errors.InstrumentError`."""
        return self._repeat(self._grab)

    def read(self) -> Reading:
        """The marker's place (u, v), px. Raises :class:`~sherkit.errors.OutOfRange` where it is not seen."""
        if self.find is None:
            raise self.fail(InstrumentError, "has no finder; pass find=")
        frame = self.grab()
        u, v = self.find(frame.picture)
        if not (math.isfinite(u) and math.isfinite(v)):
            raise self.fail(OutOfRange, "the marker is not seen; check light and view")
        return Reading(self.name, ("u", "v"), (float(u), float(v)), ("px", "px"), frame.time_s)

    def _grab(self) -> Frame:
        with self._explained():
            if self._worker is None:
                raise Disconnected("is not connected; call connect() first")
            end = time.monotonic() + self.timeout_s
            for _ in range(self.discard + 1):
                ok, given = self._worker.call(lambda s: s.read(), end)
                picture = parse_frame(ok, given, self.size_px)
        return Frame(picture, now_s())

    def _reopen(self) -> None:
        self._shut()
        self._worker = _Worker(self.source or partial(_opencv, self.address))
        try:
            with self._explained():
                if not self._worker.call(lambda s: s.isOpened(), time.monotonic() + self.timeout_s):
                    raise Disconnected("cannot be opened; check its number, cable, and that no other program uses it")
        except InstrumentError:
            self._shut()
            raise

    def _shut(self) -> None:
        if self._worker is not None:
            self._worker.close()
            self._worker = None


class _Worker:
    """A thread that owns the source. One that hangs is left behind, as a daemon, and releases it when it comes back."""

    def __init__(self, make: Callable[[], FrameSource]) -> None:
        self._tasks: queue.SimpleQueue[Callable[[FrameSource], Any] | None] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[tuple[Any, Exception | None]] = queue.SimpleQueue()
        threading.Thread(target=self._run, args=(make,), daemon=True, name="camera").start()

    def call(self, task: Callable[[FrameSource], Any], end: float) -> Any:
        self._tasks.put(task)
        try:
            value, error = self._answers.get(timeout=max(end - time.monotonic(), 0.0))
        except queue.Empty:
            raise Timeout("the camera gave no picture in time") from None
        if isinstance(error, InstrumentError):
            raise error
        if error is not None:
            raise Disconnected(f"the camera's driver failed: {error}")
        return value

    def close(self) -> None:
        self._tasks.put(None)

    def _run(self, make: Callable[[], FrameSource]) -> None:
        source: FrameSource | None = None
        while (task := self._tasks.get()) is not None:
            try:
                if source is None:
                    source = make()
                self._answers.put((task(source), None))
            # whatever a driver raises is this camera's failure, told to who waits for it
            except Exception as error:
                self._answers.put((None, error))
        if source is not None:
            source.release()


def _opencv(address: str) -> FrameSource:
    try:
        import cv2
    except ImportError:
        raise InstrumentError('cameras need OpenCV: pip install "sherkit[vision]"') from None
    capture: FrameSource = cv2.VideoCapture(int(address) if address.isdigit() else address)
    return capture
