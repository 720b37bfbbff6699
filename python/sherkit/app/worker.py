"""One thread that does one thing after another; what a person asked for can be cancelled, begun or not."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from ..errors import SherkitError

T = TypeVar("T")


class Cancelled(SherkitError):
    """Work that a person stopped, or that gave way to what a person did."""


class Worker:
    """Runs work in order in a thread of its own. ``rest`` is called when nothing is left to do.

    Work gets a number when it is asked for; cancelling is a number too, up to which all is cancelled. So nothing that
    is asked for later is lost, and nothing that was cancelled begins.
    """

    def __init__(self, rest: Callable[[], None]) -> None:
        self._rest = rest
        self._threads = ThreadPoolExecutor(1, thread_name_prefix="study")
        self._lock = threading.Lock()
        self._asked = self._running = 0
        self._cancelled = -1
        #: Work that is not done.
        self.pending = 0
        #: Of it, work before which a diagnosis gives way.
        self.first = 0
        self._gives_way = False

    def submit(self, run: Callable[[], T], *, first: bool = False, gives_way: bool = False) -> Future[T]:
        """Queues work. What ``gives_way`` is cancelled where other work comes that goes ``first``."""
        with self._lock:
            self._asked += 1
            self.pending += 1
            self.first += first
            number = self._asked

        def work() -> T:
            self._running, self._gives_way = number, gives_way
            with self._lock:
                self.first -= first
            try:
                return run()
            finally:
                with self._lock:
                    self.pending -= 1
                    last = not self.pending
                if last:
                    self._rest()

        return self._threads.submit(work)

    def look(self) -> None:
        """Asked often by the work that runs. Raises :class:`Cancelled` where nobody wants it any more."""
        if self.unwanted:
            raise Cancelled("stopped")

    @property
    def unwanted(self) -> bool:
        """Whether the work that runs was cancelled, or gives way."""
        return self.cancelled or (self._gives_way and self.first > 0)

    @property
    def cancelled(self) -> bool:
        """Whether a person cancelled the work that runs."""
        return self._running <= self._cancelled

    def cancel(self) -> None:
        """Cancels all that was asked for so far; it ends where it looks next."""
        with self._lock:
            self._cancelled = self._asked

    def close(self) -> None:
        """Cancels everything and waits for its end."""
        self.cancel()
        self._threads.shutdown(wait=True)
