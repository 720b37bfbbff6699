"""Speed, side by side in one run. Run by ``make bench``; ``--write`` puts the table into ``benchmarks/README.md``.

The program and all it starts are held to one core; with ``--cores 2`` to two, and libraries to two threads. Names of
parts (``bench.py identification diagnosis``) run these alone; ``--rows N`` adds a diagnosis of so many rows.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import subprocess
import sys
from pathlib import Path

README = Path(__file__).with_name("README.md")
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "POLARS_MAX_THREADS", "NUMBA_NUM_THREADS")


def held_to(cores: int) -> bool:
    """Whether this program runs on so many cores already; NumPy must not be loaded before."""
    return all(os.environ.get(name) == str(cores) for name in THREADS)


def run(chosen: list[str], rows: int | None, rounds: int) -> str:
    """The parts in order, in so many rounds at most, and their table."""
    # first, and alone: it starts the launcher, which must be small
    from timing import Bench, table_of  # isort: skip
    import arm
    import diagnosing
    import fitting
    import kinematics
    import starting
    import tool

    parts = {
        "delta": kinematics.delta, "spherical": kinematics.spherical, "projection": kinematics.projection,
        "identification": fitting.identification, "study": fitting.study, "bernstein": fitting.bernstein,
        "streaming": fitting.streaming, "diagnosis": diagnosing.diagnosis, "growth": diagnosing.growth,
        "starting": starting.starting, "tables": starting.tables, "filter": tool.paper_filters, "loop": tool.control_loop,  # noqa: E501
        "arms": arm.arms,
    }  # fmt: skip
    bench = Bench(rounds)
    for name in chosen or parts:
        more = (rows // 588,) if name == "growth" and rows else ()
        parts[name](bench, *more)
    return table_of(bench.rows)


def main() -> None:
    """Reads the command line; starts itself again where threads are not held yet."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("parts", nargs="*")
    options.add_argument("--cores", type=int, default=1)
    options.add_argument("--rows", type=int)
    options.add_argument("--rounds", type=int, default=100, help="at most so many of each")
    options.add_argument("--write", action="store_true")
    given = options.parse_args()
    if not held_to(given.cores):
        environment = os.environ | dict.fromkeys(THREADS, str(given.cores))
        sys.exit(subprocess.run([sys.executable, *sys.argv], env=environment, check=False).returncode)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, set(sorted(os.sched_getaffinity(0))[: given.cores]))
    table = run(given.parts, given.rows, given.rounds)
    python = f"{platform.machine()}, Python {platform.python_version()}"
    made = f"{given.cores} core{'s' if given.cores > 1 else ''} of {os.cpu_count()}, {python}"
    if given.write:
        mark = "bench" if given.cores == 1 else f"bench-{given.cores}"
        text = README.read_text(encoding="utf-8")
        pattern = re.compile(rf"(<!-- {mark} -->\n).*?(<!-- /{mark} -->)", re.DOTALL)
        README.write_text(pattern.sub(lambda m: f"{m[1]}{made}.\n\n{table}\n{m[2]}", text), encoding="utf-8")
        print(f"\nthe table is in {README}")
    else:
        print(f"\n{made}\n\n{table}")


if __name__ == "__main__":
    main()
