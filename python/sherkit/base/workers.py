"""Tasks given to an executor of :mod:`concurrent.futures`, of which one may die: the others lose nothing by it.

A pool of processes is broken for good once one of them was killed, and says of every task that waits that it failed.
Here what was done is kept, the rest goes on in a new pool, and what was under way when the pool broke is tried again at
the end, alone: so the task that kills is told from those that were beside it.
"""

from __future__ import annotations

import concurrent.futures as futures
import os
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from ..errors import SherkitError, WorkerLost

if TYPE_CHECKING:
    from multiprocessing.context import BaseContext

_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")

_TWICE = "its process ended twice before it answered: killed, out of memory, or a crash of what it loads"
_NONE_LEFT = (
    "a worker process ended, and no other could be started; in a script of yours this is called below "
    "if __name__ == '__main__'"
)


@dataclass(frozen=True)
class Outcome(Generic[_Answer]):
    """What became of the task of this ``number``: an ``answer``, or the ``error`` that stands for it."""

    number: int
    answer: _Answer | None = None
    error: BaseException | None = None


def processes(
    workers: int | None = None, context: BaseContext | None = None,
    initializer: Callable[..., object] | None = None, arguments: Any = (),
) -> futures.Executor:  # fmt: skip
    """A pool of fresh processes: a copy of one that has threads can hang."""
    import multiprocessing  # only who has many tasks needs it

    fresh = context or multiprocessing.get_context("spawn")
    return futures.ProcessPoolExecutor(workers or os.cpu_count(), fresh, initializer, arguments)


def run_tasks(
    do: Callable[[_Task], _Answer], tasks: Sequence[_Task], executor: futures.Executor
) -> Generator[Outcome[_Answer], None, None]:
    """Outcomes of ``do`` for every task, once each, in the order in which they come.

    A task that ``executor`` did not answer, since its worker died or it could not be sent, is tried once more when all
    others are done, alone; a :class:`~sherkit.errors.SherkitError` of ``do`` is an answer of its kind. Never raises but
    for what interrupts it.
    """
    todo = deque(range(len(tasks)))
    again: deque[int] = deque()
    with _Workers(executor) as workers:
        while todo:
            for outcome in _through(workers, do, tasks, todo, again, workers.count):
                if outcome.error is None or isinstance(outcome.error, SherkitError):
                    yield outcome
                else:
                    again.append(outcome.number)
        while again:
            # those after it wait until it is known whether this one broke the pool
            ended: deque[int] = deque()
            yield from _through(workers, do, tasks, again, ended, 1)
            for number in ended:
                yield Outcome(number, error=WorkerLost(_TWICE))


def _through(
    workers: _Workers, do: Callable[[_Task], _Answer], tasks: Sequence[_Task], todo: deque[int], lost: deque[int],
    most: int | None,
) -> Generator[Outcome[_Answer], None, None]:  # fmt: skip
    """Takes from ``todo`` until it is empty or the pool broke, ``most`` at a time; what was under way then is in
    ``lost``, and a new pool is there."""
    finished: SimpleQueue[futures.Future[_Answer]] = SimpleQueue()
    under_way: dict[futures.Future[_Answer], int] = {}
    broken = False
    try:
        while under_way or (todo and not broken):
            while todo and not broken and (most is None or len(under_way) < most):
                try:
                    future = workers.pool.submit(do, tasks[todo[0]])
                except futures.BrokenExecutor:
                    broken = True
                except Exception as refused:  # an executor that was closed, a cluster that is gone
                    yield Outcome(todo.popleft(), error=refused)
                else:
                    under_way[future] = todo.popleft()
                    future.add_done_callback(finished.put)
            if not under_way:
                continue
            future = finished.get()
            number = under_way.pop(future)
            if future.cancelled():
                yield Outcome(number, error=futures.CancelledError("it was cancelled"))
                continue
            error = future.exception()
            if isinstance(error, futures.BrokenExecutor):
                broken = True
                # without a bound they were all under way at once: no suspicion, the new pool will tell
                (lost if most is not None else todo).append(number)
            elif error is not None:
                yield Outcome(number, error=error)
            else:
                yield Outcome(number, future.result())
        if broken and not workers.renew():
            while todo:
                yield Outcome(todo.popleft(), error=WorkerLost(_NONE_LEFT))
    finally:
        for future in under_way:
            future.cancel()


class _Workers:
    """The executor that was given, and after it broke one of our own."""

    def __init__(self, executor: futures.Executor) -> None:
        self.pool = executor
        #: How many tasks it does at a time; None where it does not say, as a cluster.
        self.count: int | None = getattr(executor, "_max_workers", None)
        self._stack = ExitStack()
        if _copies_this_one(executor):
            self._start_like(executor)

    def __enter__(self) -> _Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def renew(self) -> bool:
        """Another pool of as many processes; whether one of them could be started."""
        self._stack.close()
        self.count = self.count or os.cpu_count() or 1
        self._start_like(self.pool)
        try:
            self.pool.submit(os.getpid).result()
        except Exception:
            return False
        return True

    def _start_like(self, before: futures.Executor) -> None:
        if isinstance(before, futures.ProcessPoolExecutor):
            # as the person made it, who may prepare each process; but never of copies
            context = None if _copies_this_one(before) else getattr(before, "_mp_context", None)
            self.pool = processes(
                self.count, context, getattr(before, "_initializer", None), getattr(before, "_initargs", ())
            )
        else:
            self.pool = processes(self.count)
        self._stack.callback(self.pool.shutdown, cancel_futures=True)


def _copies_this_one(pool: futures.Executor) -> bool:
    """Whether it is a pool whose processes are forked: locks that a thread of polars or of a solver held while this one
    was copied stay locked in the copy for ever, and its task never ends."""
    context = getattr(pool, "_mp_context", None)
    return context is not None and context.get_start_method() == "fork"
