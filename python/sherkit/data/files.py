"""Files that are whole or not there: all that sherkit writes is written by :func:`write_whole`; and what is no file."""

from __future__ import annotations

import os
import secrets
import stat
import sys
from contextlib import suppress
from pathlib import Path

from ..errors import NotWritten, SherkitError


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Writes bytes, or a text as UTF-8, in the place of ``path``: a crash leaves the old file or the new one.

    What was written is on the disk before it has the name, and the name before this returns. A link is followed; what
    is no file (a pipe, a device, the standard output) is written to as it is. Raises
    :class:`~sherkit.errors.NotWritten`, and leaves the file that stood there as it was.
    """
    path = Path(path)
    written = content.encode("utf-8") if isinstance(content, str) else content
    try:
        if is_output(path) or (path.exists() and not path.is_file() and not path.is_dir()):
            _pour(written, path)
        else:
            _replace(Path(os.path.realpath(path)), written)
    except BrokenPipeError:
        raise  # who reads has gone
    except OSError as error:
        raise NotWritten(path, error) from None


def _replace(path: Path, content: bytes) -> None:
    fresh = path.with_name(f".{path.name[:100]}.{secrets.token_hex(4)}.new")
    try:
        with fresh.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        with suppress(FileNotFoundError):
            # who may read the file does not change with what is in it
            fresh.chmod(path.stat().st_mode & 0o777)
        fresh.replace(path)
    except BaseException:
        with suppress(OSError):
            fresh.unlink()
        raise
    _sync(path.parent)


def _sync(folder: Path) -> None:
    """Puts the names of a folder on the disk; where a system cannot, it does so by itself."""
    with suppress(OSError):
        opened = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(opened)
        finally:
            os.close(opened)


#: What is no file, by what the system calls it.
_NO_FILES = ((stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"), (stat.S_ISSOCK, "a socket"))
_PIPE = (stat.S_ISFIFO, "a pipe")


def refuse_device(path: str | os.PathLike[str], error: type[SherkitError], *, pipes: bool = False) -> None:
    """Raises ``error`` for a device or a socket, which may never end; with ``pipes`` for a pipe too, which can be read
    but once. Files, folders and what is not there pass."""
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return
    for is_one, called in (*_NO_FILES, *([_PIPE] if pipes else [])):
        if is_one(mode):
            first = "; write what comes out of it into a file first" if is_one is stat.S_ISFIFO else ""
            raise error(f"{path}: is {called}, expected a file{first}")


def of_demo(path: str | os.PathLike[str]) -> str:
    """What to say of a file that is not there, and that documents use as an example; empty of all others."""
    return "; sherkit demo makes it" if Path(path).parts[-2:-1] == ("demo",) else ""


def bag_in(folder: Path) -> str:
    """What to say of a folder that holds a bag where a file was expected; empty where it holds none."""
    is_bag = any(folder.glob("*.db3")) or any(folder.glob("*.mcap"))
    return "; it looks like a ROS 2 bag, which sk.from_rosbag and sherkit import rosbag read" if is_bag else ""


def is_output(path: str | os.PathLike[str]) -> bool:
    """Whether a path is the standard output of this process, by whatever name."""
    try:
        return os.path.samestat(os.stat(path), os.fstat(1))
    except (OSError, ValueError):
        return False


def _pour(content: bytes, path: Path) -> None:
    if not is_output(path):
        with path.open("wb") as file:
            file.write(content)
        return
    # opened by its name it would be written from its beginning, over what was printed before
    sys.stdout.flush()
    with os.fdopen(os.dup(1), "wb") as file:
        file.write(content)
