"""Diagnosed runs per second of a fleet: here, in a process pool, and on a Dask cluster of 1 and 2 workers. Part of
``make bench``; ``python benchmarks/fleet_workers.py 40`` takes so many runs.

Workers are warm: each has diagnosed one run before the clock starts, as in a fleet of thousands.
"""

from __future__ import annotations

import multiprocessing
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from diagnosing import ROBOT, run_with_lean

import sherkit as sk

_ROUNDS = 3


@contextmanager
def pool(workers: int) -> Iterator[Executor]:
    """A process pool."""
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as made:
        yield made


@contextmanager
def cluster(workers: int) -> Iterator[Executor]:
    """A Dask cluster on this computer."""
    import distributed

    with (
        distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
        ) as made,
        distributed.Client(made) as client,
        client.get_executor() as executor,
    ):
        yield executor


def rate(runs: list[str], executor: Executor | None) -> float:
    """Runs per second, median."""
    sk.fleet(runs[:4], ROBOT, executor=executor)
    took = []
    for _ in range(_ROUNDS):
        began = time.perf_counter()
        sk.fleet(runs, ROBOT, executor=executor)
        took.append(time.perf_counter() - began)
    return len(runs) / statistics.median(took)


def main(count: int) -> None:
    """Prints the table."""
    with tempfile.TemporaryDirectory() as folder:
        runs = []
        for k in range(count):
            run_with_lean(1).save(Path(folder) / f"machine_{k:03d}.csv")
            runs.append(str(Path(folder) / f"machine_{k:03d}.csv"))
        alone = rate(runs, None)
        print("| a fleet of runs of 588 rows | runs per s | against one after the other |\n| --- | --- | --- |")
        print(f"| here, one after the other | {alone:.2f} | 1 × |")
        for name, made in (("process pool", pool), ("Dask", cluster)):
            for workers in (1, 2):
                with made(workers) as executor:
                    found = rate(runs, executor)
                print(f"| {name}, {workers} worker{'s' if workers > 1 else ''} | {found:.2f} | {found / alone:.2f} × |")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
