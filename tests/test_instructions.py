"""How many instructions the hot paths take: a measure of work that no other program on the machine disturbs."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hot_paths import REPEATS

#: Millions of instructions for each walk, from Python to Python, on the processor with AVX2 that valgrind shows.
MILLIONS = {"forward": 2.077, "inverse": 10.58, "identify": 5.36, "bernstein": 89.0, "tool": 7.03}
#: Part by which they may grow: compilers and libraries differ a little.
ALLOWED = 0.05


def counted(name: str, repeats: int) -> int:
    """Instructions of a process that walks a path so often."""
    script = Path(__file__).with_name("hot_paths.py")
    command = [
        "valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", sys.executable, script, name, str(repeats),
    ]  # fmt: skip
    alone = {"PYTHONHASHSEED": "0", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    told = subprocess.run(command, check=True, capture_output=True, text=True, env=os.environ | alone).stderr
    return int(re.findall(r"Collected : (\d+)", told)[-1])


@pytest.mark.slow
@pytest.mark.parametrize("name", REPEATS)
def test_hot_paths_take_no_more_instructions(name: str) -> None:
    """Catches a hot path that got slower, such as vectors that are no longer inlined.

    Where it got faster on purpose, or compiler and libraries changed, the new figure goes into the table.
    """
    if shutil.which("valgrind") is None:
        pytest.skip("valgrind is missing, which counts the instructions (Debian: apt-get install valgrind)")
    repeats = REPEATS[name]
    millions = (counted(name, repeats) - counted(name, 0)) / repeats / 1e6
    assert millions < MILLIONS[name] * (1 + ALLOWED), f"{name}: {millions:.3f} million instructions"
