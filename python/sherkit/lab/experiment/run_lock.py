"""One runner for one run file: the locks that it holds."""

from __future__ import annotations

import os
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Self

from ...data.files import opened_lock
from ...errors import ExperimentError

#: The byte that is locked lies behind the text, which others may read.
_BYTE = 1 << 20


class RunLock:
    """Holds ``<run file>.lock`` until :meth:`release`, or the program's end, and a lock for the file whatever its name.

    Beside the run file and not in it, since SQLite has locks of its own there. The other one, for hard links, stands
    among the temporary files under the file's device and inode. It is the locks that count, not their files, which go
    with them; those of a program that was killed stay until the run goes on. Raises
    :class:`~sherkit.errors.ExperimentError` where another program, or another part of this one, has either.
    """

    def __init__(self, path: Path) -> None:
        # a link is another name, not another run
        self.path = Path(f"{path.resolve()}.lock")
        file = self._locked(self.path, path)
        self._files = [(self.path, file)]
        os.ftruncate(file, 0)
        os.write(file, f"{os.getpid()}\n".encode())
        try:
            stat = path.stat()
            name = f"sherkit-run-{stat.st_dev:x}-{stat.st_ino:x}.lock"
            lock = Path(tempfile.gettempdir()) / name
            self._files.append((lock, self._locked(lock, path)))
        except OSError:
            pass  # another user's, or no place for temporary files: the lock beside the run file is the one that counts
        except BaseException:
            self.release()
            raise

    @staticmethod
    def _locked(lock: Path, run: Path) -> int:
        while True:
            file = opened_lock(lock)
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
                    f"{run}: is being measured by another program{f' (process {who})' if who.isdigit() else ''}; one "
                    "run has one runner. End that one first"
                ) from None
            # who had it may have taken its file away meanwhile: then it is a lock of nothing
            with suppress(OSError):
                if os.path.samestat(os.fstat(file), os.lstat(lock)):
                    return file
            os.close(file)

    def release(self) -> None:
        """Gives it back; twice does no harm."""
        while self._files:
            _leave(*self._files.pop())

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

    def _leave(lock: Path, file: int) -> None:
        os.close(file)
        with suppress(OSError):  # open in another program, which takes it
            lock.unlink()

else:
    import fcntl

    def _take(file: int) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _leave(lock: Path, file: int) -> None:
        with suppress(OSError):  # while it is held, so that nobody else's is taken away
            lock.unlink()
        os.close(file)
