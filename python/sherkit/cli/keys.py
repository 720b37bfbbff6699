"""Single keys of a terminal, while something runs."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import threading
from collections.abc import Callable, Iterator

_POLL_S = 0.1


@contextlib.contextmanager
def listening(pressed: Callable[[str], None]) -> Iterator[bool]:
    """Calls ``pressed`` with every key, from a thread; yields whether there is a terminal to hear keys from.

    Ctrl-C stays what it is. The terminal is as before afterwards.
    """
    try:
        import termios
        import tty
    except ImportError:  # no terminals of this kind here: the run goes on without keys
        yield False
        return
    if not sys.stdin or not sys.stdin.isatty():
        yield False
        return
    where = sys.stdin.fileno()
    before = termios.tcgetattr(where)
    ended = threading.Event()

    def listen() -> None:
        while not ended.is_set():
            if select.select([where], [], [], _POLL_S)[0]:
                for key in os.read(where, 16).decode("ascii", "ignore"):
                    pressed(key)

    thread = threading.Thread(target=listen, daemon=True, name="keys")
    try:
        tty.setcbreak(where)
        thread.start()
        yield True
    finally:
        ended.set()
        thread.join(2.0)
        termios.tcsetattr(where, termios.TCSADRAIN, before)
