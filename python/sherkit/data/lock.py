"""A lock beside a file: one who writes at a time, until it is given back or the process ends in whatever way."""

from __future__ import annotations

import os
import sys
import weakref
from contextlib import suppress
from pathlib import Path

from ..errors import NotWritten

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


def _locked(lock: Path) -> int:
    while True:
        try:
            # where everybody may write, a link could lead to a file of somebody's
            file = os.open(lock, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        except OSError as error:
            raise NotWritten(lock, error) from None
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
