"""Files that are whole or not there: all that sherkit writes is written by :func:`write_whole`; what is no file;
and locks."""

from __future__ import annotations

import os
import secrets
import stat
import sys
import weakref
from contextlib import suppress
from pathlib import Path

from ..errors import NotWritten, SherkitError

# -- Whole files -------------------------------------------------------------------------------------------------------


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


# -- A lock beside a file ----------------------------------------------------------------------------------------------
# A lock beside a file: one who writes at a time, until it is given back or the process ends in whatever way.

#: The byte that is locked lies behind the text, which others may read.
_BYTE = 1 << 20


class FileLock:
    """Holds ``<path>.lock``; :meth:`release` gives it back and takes that file away.

    Raises :class:`~sherkit.errors.NotWritten` where there can be none, and ``BlockingIOError``, with the process that
    has it, where somebody else does, in this process or another.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        # a link is another name, not another file
        self.held = Path(os.path.realpath(path))
        lock = Path(f"{self.held}.lock")
        file = _locked(lock)
        os.ftruncate(file, 0)
        os.write(file, f"{os.getpid()}\n".encode())
        # who forgets it, or ends, has given it back; a forked child has not
        self._end = weakref.finalize(self, _given_back, file, lock, os.getpid())

    def is_of(self, path: str | os.PathLike[str]) -> bool:
        """Whether it is the lock of this file, and held."""
        return self._end.alive and Path(os.path.realpath(path)) == self.held

    def release(self) -> None:
        """Gives it back; twice does no harm."""
        self._end()


def opened_lock(lock: Path) -> int:
    """The file of a lock, open for reading and writing. Raises :class:`~sherkit.errors.NotWritten`."""
    try:
        # where everybody may write, a link could lead to a file of somebody's
        return os.open(lock, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
    except OSError as error:
        raise NotWritten(lock, error) from None


def _locked(lock: Path) -> int:
    while True:
        file = opened_lock(lock)
        try:
            _take(file)
            with suppress(FileNotFoundError):
                # who had it before may have taken the file away in between
                if os.path.samestat(os.fstat(file), os.stat(lock)):
                    return file
        except OSError as error:
            who = os.read(file, 64).decode("ascii", "replace").strip()
            os.close(file)
            if not isinstance(error, BlockingIOError | PermissionError):
                raise NotWritten(lock, error) from None
            raise BlockingIOError(f"process {who}" if who.isdigit() else "another process") from None
        os.close(file)


def _given_back(file: int, lock: Path, owner: int) -> None:
    if os.getpid() == owner:
        with suppress(OSError):
            lock.unlink()
    with suppress(OSError):
        os.close(file)


if sys.platform == "win32":
    import msvcrt

    def _take(file: int) -> None:
        os.lseek(file, _BYTE, os.SEEK_SET)
        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        os.lseek(file, 0, os.SEEK_SET)

else:
    import fcntl

    def _take(file: int) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
