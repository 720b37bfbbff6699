"""What the command does before it loads anything that takes time.

Ctrl-C while it loads is one sentence, as later. And the linear algebra below NumPy is held to one thread where nobody
said otherwise: our matrices are narrow, and threads that wait for each other by turning cost more than they bring.
"""

import os
import signal
import sys
import threading


def _end(number: int, frame: object) -> None:
    # no clean-up: nothing has begun, and half of an import is nothing to go on with
    os.write(2, b"error: interrupted\n")
    os._exit(130)


def _is_command() -> bool:
    name = os.path.basename(sys.argv[0]) if sys.argv else ""
    return name.removesuffix(".exe") == "sherkit" and threading.current_thread() is threading.main_thread()


if _is_command():
    for _library in ("OPENBLAS", "MKL"):
        os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
if _is_command() and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, _end)


def loaded() -> None:
    """Ctrl-C is from now on what it is to every program."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)
