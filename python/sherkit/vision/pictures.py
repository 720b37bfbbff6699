"""Pictures: grey values with a name, from files, arrays and videos."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import SherkitError

_UNREADABLE = "is not a picture that can be read"


@dataclass(frozen=True, eq=False)
class CameraPicture:
    """Grey values (height, width), 0 to 255, with a name for messages and the moment of the exposure, s.

    ``why`` says in words why a picture could not be read; it then has no grey values.
    """

    grey: NDArray[np.uint8]
    name: str
    time_s: float = float("nan")
    why: str = ""

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height."""
        return int(self.grey.shape[1]), int(self.grey.shape[0])


def picture_of(
    given: str | Path | NDArray[Any] | CameraPicture, name: str = "picture", time_s: float = float("nan")
) -> CameraPicture:
    """A picture from a file or an array, grey (h, w) or colour in OpenCV's order (h, w, 3).

    Raises :class:`~sherkit.errors.SherkitError` where it is none.
    """
    if isinstance(given, CameraPicture):
        return given
    if isinstance(given, str | Path):
        path = Path(given)
        if not path.is_file():
            raise SherkitError(f"{path}: there is no such picture")
        try:
            read = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        except cv2.error as error:  # a header that promises more than a picture may have
            raise SherkitError(f"{path}: {_UNREADABLE} ({error.err})") from None
        if read is None:
            raise SherkitError(f"{path}: {_UNREADABLE}")
        return CameraPicture(np.asarray(read, np.uint8), str(path), time_s)
    array = np.asarray(given)
    if array.ndim == 3 and array.shape[2] == 3:
        array = np.asarray(cv2.cvtColor(array, cv2.COLOR_BGR2GRAY))
    if array.ndim != 2 or array.dtype != np.uint8:
        raise SherkitError(f"{name}: expected grey values (height, width) as uint8, got {array.shape} of {array.dtype}")
    return CameraPicture(array, name, time_s)


def picture_in(path: str | Path) -> CameraPicture:
    """The picture of a file; one that cannot be read says why, so that it does not stop the others of a batch."""
    try:
        return picture_of(path)
    except SherkitError as error:
        why = str(error).removeprefix(f"{path}: ")
        return CameraPicture(np.zeros((0, 0), np.uint8), str(path), why=why)


def frames_of(video: str | Path | int) -> Iterator[CameraPicture]:
    """The pictures of a video file, or of a live camera by its number, with their time in s.

    A file's times are those it holds, from its start; a live camera's are the host's, from the first picture. Raises
    :class:`~sherkit.errors.SherkitError` where it cannot be opened.
    """
    live = isinstance(video, int)
    if not live and not Path(str(video)).is_file():
        raise SherkitError(f"{video}: there is no such video")
    capture = cv2.VideoCapture(video if isinstance(video, int) else str(video))
    if not capture.isOpened():
        raise SherkitError(f"{'camera ' if live else ''}{video}: cannot be opened as a video")
    try:
        started = cv2.getTickCount()
        number = 0
        while True:
            moment = (cv2.getTickCount() - started) / cv2.getTickFrequency() if live else None
            there, frame = capture.read()
            if not there:
                return
            if moment is None:
                # OpenCV tells the time of the picture that was just read
                moment = capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
            yield picture_of(np.asarray(frame), f"{video}: picture {number}", float(moment))
            number += 1
    finally:
        capture.release()


# -- Where pictures come from ---------------------------------------------------------------------------------------

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm")
VIDEOS = (".avi", ".mp4", ".mkv", ".mov", ".m4v", ".mjpg")


def picture_files(sources: Sequence[str | Path]) -> list[Path]:
    """Files of pictures: those named, and those of folders in the order of their names.

    Raises :class:`~sherkit.errors.SherkitError` for what is not there, or a folder without pictures.
    """
    out: list[Path] = []
    for source in map(Path, sources):
        if source.is_dir():
            inside = sorted(p for p in source.iterdir() if p.suffix.lower() in PICTURES)
            if not inside:
                raise SherkitError(f"{source}: holds no pictures; expected files ending in {', '.join(PICTURES)}")
            out += inside
        elif source.is_file():
            out.append(source)
        else:
            raise SherkitError(f"{source}: there is no such picture or folder")
    return out


def pictures_from(sources: Sequence[str], seconds: float | None = None) -> tuple[Iterator[CameraPicture], bool]:
    """The pictures of ``sources``, and whether they carry times: one video, a live camera's number, or files.

    ``seconds`` ends a live camera. A file that cannot be read comes as a picture that says why. Raises
    :class:`~sherkit.errors.SherkitError` for an empty or mixed choice.
    """
    if not sources:
        raise SherkitError("expected pictures, folders of pictures, one video, or the number of a camera")
    moving = [s for s in sources if s.isdecimal() or Path(s).suffix.lower() in VIDEOS]
    if moving:
        if len(sources) > 1:
            raise SherkitError(f"{moving[0]}: is a video or a camera; give it alone")
        if not moving[0].isdecimal():
            return frames_of(moving[0]), True
        if seconds is None:
            raise SherkitError(f"camera {moving[0]}: say for how long, with --seconds")
        return _for(frames_of(int(moving[0])), seconds), True
    return (picture_in(path) for path in picture_files(sources)), False


def _for(frames: Iterator[CameraPicture], seconds: float) -> Iterator[CameraPicture]:
    end = time.monotonic() + seconds
    for picture in frames:
        yield picture
        if time.monotonic() >= end:
            return
