"""Timing in turns, so that a noisy machine is noisy for both: medians, and the median of the ratios of the rounds.

Times are of the processor (all threads together) and of the wall. Work of a process of its own is timed and weighed by
the system's own account of that process, its peak of memory among it.
"""

from __future__ import annotations

import gc
import json
import math
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

#: A sample takes at least this long: what is faster is called several times.
_SAMPLE_S = 0.02


@dataclass(frozen=True)
class Timed:
    """Seconds of one call, and the peak of memory where it was a process of its own."""

    wall_s: float
    cpu_s: float
    peak_mb: float = math.nan

    def __str__(self) -> str:
        peak = "" if math.isnan(self.peak_mb) else f", {self.peak_mb:.0f} MB"
        return f"{seconds(self.wall_s)} ({seconds(self.cpu_s)}{peak})"


@dataclass(frozen=True)
class Row:
    """A piece of work: ours, what is compared with it and how many times more processor time that takes."""

    work: str
    ours: Timed
    others: Sequence[tuple[str, Timed, float]] = ()
    goal: str = ""


@dataclass
class Bench:
    """What was measured, in order; nothing in more rounds than ``most``."""

    most: int = 100
    rows: list[Row] = field(default_factory=list)

    def compare(self, work: str, runs: dict[str, Callable[[], object]], rounds: int = 9, goal: str = "") -> None:
        """Times all of these in turns; the first is ours."""
        calls = {}
        for name, run in runs.items():
            taken_s = _seconds_of(run)
            # the first call may load or compile; one that is slow even so is called once
            taken_s = taken_s if taken_s > 1.0 else _seconds_of(run)
            calls[name] = max(1, math.ceil(_SAMPLE_S / max(taken_s, 1e-7)))
        samples: dict[str, list[Timed]] = {name: [] for name in runs}
        for _ in range(min(rounds, self.most)):
            for name, run in runs.items():
                gc.collect()
                gc.disable()
                wall, cpu = time.perf_counter(), time.process_time()
                for _ in range(calls[name]):
                    run()
                taken = Timed((time.perf_counter() - wall) / calls[name], (time.process_time() - cpu) / calls[name])
                gc.enable()
                samples[name].append(taken)
        self.add(work, samples, goal)

    def processes(self, work: str, commands: dict[str, list[str]], rounds: int = 5, goal: str = "") -> None:
        """The same for whole processes."""
        samples: dict[str, list[Timed]] = {name: [] for name in commands}
        for _ in range(min(rounds, self.most)):
            for name, command in commands.items():
                samples[name].append(process(command))
        self.add(work, samples, goal)

    def add(self, work: str, samples: dict[str, list[Timed]], goal: str) -> None:
        """A row of samples that were taken in turns."""
        (first, ours), *others = samples.items()
        made = []
        for name, theirs in others:
            ratio = statistics.median(b.cpu_s / a.cpu_s for a, b in zip(ours, theirs, strict=True))
            made.append((name, _median(theirs), ratio))
        name = f"{work}" if first == "sherkit" else f"{work}: {first}"
        self.rows.append(Row(name, _median(ours), made, goal))
        print(lines_of(self.rows[-1]), flush=True)


#: Started before this program grows; see there.
_LAUNCHER = subprocess.Popen(
    [sys.executable, str(Path(__file__).with_name("launcher.py"))],
    stdin=subprocess.PIPE,
    stdout=subprocess.PIPE,
    text=True,
)


def process(command: Sequence[str]) -> Timed:
    """One process: its time and its own peak of memory. Fails where the process does."""
    assert _LAUNCHER.stdin is not None
    assert _LAUNCHER.stdout is not None
    print(json.dumps(list(command)), file=_LAUNCHER.stdin, flush=True)
    wall_s, cpu_s, peak_mb, code, said = json.loads(_LAUNCHER.stdout.readline())
    if code:
        raise RuntimeError(f"{' '.join(command)}: {said}")
    return Timed(wall_s, cpu_s, peak_mb)


def part(file: str, name: str, *arguments: object) -> list[str]:
    """The command that runs one function of a file of the bench in a process of its own."""
    return [sys.executable, file, name, *map(str, arguments)]


def seconds(s: float) -> str:
    """A time in a readable unit, three figures."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if s >= size:
            return f"{s / size:.3g} {unit}"
    return f"{1e9 * s:.3g} ns"


def lines_of(row: Row) -> str:
    """A row as Markdown: a line for each that is compared."""
    out = []
    for k, (name, theirs, ratio) in enumerate(row.others or (("", None, math.nan),)):
        first = (row.work, str(row.ours)) if k == 0 else ("", "")
        theirs_text, times = ("", "") if theirs is None else (str(theirs), f"{ratio:.2g} ×")
        out.append(f"| {first[0]} | {first[1]} | {name} | {theirs_text} | {times} | {row.goal if k == 0 else ''} |")
    return "\n".join(out)


def table_of(rows: Sequence[Row]) -> str:
    """All rows as one Markdown table."""
    head = "| work | sherkit: wall (CPU, peak) | instead | wall (CPU, peak) | its CPU over ours | goal |"
    return "\n".join([head, "| --- | --- | --- | --- | --- | --- |", *map(lines_of, rows)])


def _seconds_of(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def _median(samples: list[Timed]) -> Timed:
    return Timed(*(statistics.median(getattr(s, k) for s in samples) for k in ("wall_s", "cpu_s", "peak_mb")))
