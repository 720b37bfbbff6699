"""Where pictures come from: files, folders, a video, a live camera."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..errors import SherkitError
from .pictures import CameraPicture, frames_of, picture_in

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
