"""Devices of other libraries as they are: what is called in this thread, and what wants an event loop (ophyd-async)."""

from __future__ import annotations

import asyncio
import inspect
import threading
from collections.abc import Callable
from typing import Any

_LOCK = threading.Lock()
_LOOP: asyncio.AbstractEventLoop | None = None


def _loop() -> asyncio.AbstractEventLoop:
    """An event loop in a thread of its own, which ends with the program."""
    global _LOOP
    with _LOCK:
        if _LOOP is None:
            _LOOP = asyncio.new_event_loop()
            threading.Thread(target=_LOOP.run_forever, daemon=True, name="devices").start()
        return _LOOP


def is_async(device: object) -> bool:
    """Whether a device answers in coroutines, as those of ophyd-async do."""
    return any(inspect.iscoroutinefunction(getattr(device, name, None)) for name in ("connect", "read", "set"))


def begun(device: object, function: Callable[..., Any], *arguments: Any, timeout_s: float = 10.0) -> Any:
    """Calls a method of a device, without waiting for what it began: a status, a task, or None where it is done."""
    if not is_async(device):
        return function(*arguments)

    async def begin() -> Any:
        made = function(*arguments)
        return asyncio.ensure_future(made) if inspect.iscoroutine(made) else made

    return asyncio.run_coroutine_threadsafe(begin(), _loop()).result(timeout_s)


def waited(device: object, function: Callable[..., Any], *arguments: Any, timeout_s: float) -> Any:
    """Calls a method of a device and waits for its end. Raises what the device raises, or ``TimeoutError``."""
    if is_async(device):

        async def wait() -> Any:
            made = function(*arguments)
            return await asyncio.wait_for(_ended(made), timeout_s) if inspect.isawaitable(made) else made

        return asyncio.run_coroutine_threadsafe(wait(), _loop()).result(timeout_s + 1.0)
    made = function(*arguments)
    if hasattr(made, "wait") and hasattr(made, "done"):
        made.wait(timeout_s)
        return None
    return made


async def _ended(made: Any) -> Any:
    return await made


def is_done(status: Any) -> bool:
    """Whether what :func:`begun` gave has ended; None always has."""
    if status is None:
        return True
    done = status.done
    return bool(done() if callable(done) else done)


def error_of(status: Any) -> BaseException | None:
    """What went wrong in what has ended, or None."""
    if status is None or not hasattr(status, "exception"):
        return None
    error: BaseException | None = status.exception()
    return error
