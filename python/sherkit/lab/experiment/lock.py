"""One runner for one run file: a lock of the operating system, which ends with the program however that ends."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import Self

from ...errors import ExperimentError, NotWritten

#: The byte that is locked lies behind the text, which others may read.
_BYTE = 1 << 20


class RunLock:
    """Holds ``<run file>.lock`` until :meth:`release`, or the program's end, and a lock for the file whatever its name.

    Beside the run file and not in it, since SQLite has locks of its own there. The other one, for hard links, stands
    among the temporary files under the file's device and inode. The files stay: it is the locks that count. Raises
    :class:`~sherkit.errors.ExperimentError` where another program, or another part of this one, has either.
    """

    def __init__(self, path: Path) -> None:
        # a link is another name, not another run
        self.path = Path(f"{path.resolve()}.lock")
        self._files = [self._locked(self.path, path)]
        os.ftruncate(self._files[0], 0)
        os.write(self._files[0], f"{os.getpid()}\n".encode())
        try:
            stat = path.stat()
            name = f"sherkit-run-{stat.st_dev:x}-{stat.st_ino:x}.lock"
            self._files.append(self._locked(Path(tempfile.gettempdir()) / name, path))
        except OSError:
            pass  # another user's, or no place for temporary files: the lock beside the run file is the one that counts
        except BaseException:
            self.release()
            raise

    @staticmethod
    def _locked(lock: Path, run: Path) -> int:
        try:
            # where everybody may write, a link could lead to a file of somebody's
            file = os.open(lock, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        except OSError as error:
            raise NotWritten(lock, error) from None
        try:
            _take(file)
        except OSError as error:
            who = os.read(file, 64).decode("ascii", "replace").strip()
            os.close(file)
            if not isinstance(error, BlockingIOError | PermissionError):
                raise ExperimentError(
                    f"{lock}: cannot be locked: {error.strerror}; put the run file on a disk of this computer"
                ) from None
            raise ExperimentError(
                f"{run}: is being measured by another program{f' (process {who})' if who.isdigit() else ''}; one run "
                "has one runner. End that one first"
            ) from None
        return file

    def release(self) -> None:
        """Gives it back; twice does no harm."""
        while self._files:
            os.close(self._files.pop())

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
