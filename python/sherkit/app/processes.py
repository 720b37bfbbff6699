"""Processes as Linux tells of them: how long one waited for the processor, and the end of all that it began.

What a process begins has its environment, also where it detaches itself or its parent is gone: a mark in that finds it
(as Jenkins ends what a build leaves behind). On other systems only the process itself is ended.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock

_NAME = "SHERKIT_LINES"
_ONE_AT_A_TIME = Lock()


def waited_s(pid: int | None) -> float:
    """How long a process that could run had to wait for a processor; 0 where the system does not tell."""
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text(encoding="ascii").split()[1]) * 1e-9
    except (OSError, ValueError, IndexError):
        return 0.0


@contextmanager
def marked(mark: str) -> Iterator[None]:
    """Gives the mark to the processes that are begun meanwhile, and so to all that these begin."""
    with _ONE_AT_A_TIME:
        os.environ[_NAME] = mark
        try:
            yield
        finally:
            del os.environ[_NAME]


def end_marked(mark: str) -> None:
    """Ends every process that has the mark, but this one: stopped first, so that none begins another one meanwhile."""
    stopped: set[int] = set()
    while new := set(_with_mark(mark)) - stopped:
        for pid in new:
            _send(pid, "SIGSTOP")
        stopped |= new
    for pid in stopped:
        _send(pid, "SIGKILL")


def _with_mark(mark: str) -> Iterator[int]:
    wanted = f"{_NAME}={mark}\0".encode()
    for one in Path("/proc").glob("[0-9]*"):
        if int(one.name) != os.getpid():
            with suppress(OSError):
                if wanted in (one / "environ").read_bytes() + b"\0":
                    yield int(one.name)


def _send(pid: int, name: str) -> None:
    with suppress(OSError, AttributeError):
        os.kill(pid, getattr(signal, name))
