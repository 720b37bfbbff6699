"""One runner for one run file: a lock of the operating system, which ends with the program however that ends."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Self

from ...errors import ExperimentError

#: The byte that is locked lies behind the text, which others may read.
_BYTE = 1 << 20


class RunLock:
    """Holds ``<run file>.lock`` until :meth:`release`, or the program's end.

    Beside the run file and not in it, since SQLite has locks of its own there. The file stays: it is the lock that
    counts. Raises :class:`~sherkit.errors.ExperimentError` where another program, or another part of this one, has it.
    """

    def __init__(self, path: Path) -> None:
        # a link is another name, not another run
        self.path = Path(f"{path.resolve()}.lock")
        try:
            self._file = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            raise ExperimentError(f"{self.path}: cannot be written: {error.strerror}") from None
        try:
            _take(self._file)
        except OSError as error:
            if not isinstance(error, BlockingIOError | PermissionError):
                os.close(self._file)
                self._file = -1
                raise ExperimentError(
                    f"{self.path}: cannot be locked: {error.strerror}; put the run file on a disk of this computer"
                ) from None
            who = os.read(self._file, 64).decode("ascii", "replace").strip()
            os.close(self._file)
            self._file = -1
            raise ExperimentError(
                f"{path}: is being measured by another program{f' (process {who})' if who.isdigit() else ''}; one run "
                "has one runner. End that one first"
            ) from None
        os.ftruncate(self._file, 0)
        os.write(self._file, f"{os.getpid()}\n".encode())

    def release(self) -> None:
        """Gives it back; twice does no harm."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


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
