"""Timing in turns, so that a noisy machine is noisy for both; medians and their ratio are printed."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable

from rich.console import Console
from rich.table import Table


def medians(pairs: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Median seconds of each, timed in turns."""
    times: dict[str, list[float]] = {name: [] for name in pairs}
    for run in pairs.values():
        run()
    gc.disable()
    for _ in range(rounds):
        for name, run in pairs.items():
            start = time.perf_counter()
            run()
            times[name].append(time.perf_counter() - start)
    gc.enable()
    return {name: statistics.median(t) for name, t in times.items()}


def show(title: str, goal: str, ours: str, times: dict[str, float]) -> None:
    """One table: medians, and how many times faster ours is."""
    table = Table("", "median", "ours is faster by", title=title, title_justify="left", caption=f"goal: {goal}")
    for name, t in times.items():
        table.add_row(name, f"{1e3 * t:.3f} ms", "" if name == ours else f"{t / times[ours]:.1f} ×")
    Console(width=100).print(table)
