"""Uses an installed sherkit as a new user would, in an empty folder: the demo, a deployed position, a loop in C.

``python .ci/use_wheel.py``; needs nothing but the wheel, and a C compiler for the loop, which is left out without one.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys

import sherkit as sk

SHERKIT = [sys.executable, "-m", "sherkit"]


def said(*command: str) -> str:
    """What a command prints; it must go well."""
    return subprocess.run(command, check=True, capture_output=True, text=True, encoding="utf-8").stdout


def main() -> None:
    """Raises where anything goes wrong."""
    os.environ.setdefault("PYTHONUTF8", "1")
    print(said(*SHERKIT, "doctor"))
    said(*SHERKIT, "demo")
    robot = sk.load_calibration("demo/calibrated.toml")
    place = robot.forward(robot.inverse([1.0, -2.0, 3.0]))
    assert max(abs(a - b) for a, b in zip(place, [1.0, -2.0, 3.0], strict=True)) < 1e-5, place
    compiler = next((path for name in ("cc", "gcc", "clang") if (path := shutil.which(name))), None)
    if compiler is None or sys.platform == "win32":
        print("no C compiler, or Windows: the loop in C is not built")
        return
    said(*SHERKIT, "c", "--example", "loop")
    said(*SHERKIT, "export", "c", "demo/calibrated.toml", "-o", "loop/robot.h")
    for more in ([], ["--shared"]):
        words = shlex.split(said(*SHERKIT, "c", "--cflags", "--libs", *more))
        said(compiler, "-O2", "loop/loop.c", *words, "-o", "loop/loop")
        print(said("loop/loop", "1"))


if __name__ == "__main__":
    main()
