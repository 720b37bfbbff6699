"""How long a person waits: import, commands, a table read, a report written."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import polars as pl
from timing import Bench

import sherkit as sk
from sherkit.cli.demo import EXAMPLE as ROBOT

COMMAND = [sys.executable, "-c", "from sherkit.cli import main; main()"]


def starting(bench: Bench) -> None:
    """Processes of their own."""
    python = [sys.executable, "-c"]
    runs = {"sherkit": [*python, "import sherkit"], "import numpy": [*python, "import numpy"]}
    bench.processes("`import sherkit`", runs, goal="0.35 s")
    everything = "import sherkit as sk; sk.read_measurements, sk.identify, sk.diagnose, sk.load_robot"
    runs = {"sherkit": [*python, everything], "import numpy, polars": [*python, "import numpy, polars"]}
    bench.processes("and all that a diagnosis needs", runs)
    runs = {"sherkit": [*COMMAND, "--version"], "import click": [*python, "import click"]}
    bench.processes("`sherkit --version`", runs, goal="0.08 s")
    with TemporaryDirectory() as folder:
        robot, run, report = (Path(folder) / name for name in ("robot.toml", "run.csv", "report.html"))
        sk.save_robot(ROBOT, robot)
        hidden = sk.delta.VirtualDelta.draw(ROBOT, 6, rail_lean_rad=0.002)
        hidden.measure(sk.delta.paper_whole(), repeats=5, seed=6).save(run)
        command = [*COMMAND, "diagnose", str(robot), str(run)]
        bench.processes("`sherkit diagnose`, 588 × 5 rows", {"sherkit": command}, 3, goal="0.8 s")
        bench.processes("the same with `--report`", {"sherkit": [*command, "--report", str(report)]}, 3, goal="+ 2 s")


def tables(bench: Bench) -> None:
    """A run of 300,000 rows as CSV."""
    data = sk.delta.VirtualDelta.draw(ROBOT, 1).measure(sk.delta.paper_whole(), repeats=1, seed=1).to_frame()
    rows, rng = 300_000, np.random.default_rng(0)
    long = pl.concat([data.with_columns(pl.col("pose") + 1000 * k) for k in range(rows // len(data) + 1)]).head(rows)
    long = long.with_columns(
        [pl.col(name) + rng.normal(0, 0.003, rows) for name in ("x_mm", "y_mm", "z_mm")]
    ).with_columns(pl.Series("time_s", 0.1 * np.arange(rows)))
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        path = Path(folder) / "run.csv"
        long.write_csv(path)
        runs = {
            "sherkit": lambda: sk.read_measurements(path),
            "polars.read_csv, which checks nothing": lambda: pl.read_csv(path),
        }
        bench.compare("300,000 rows of CSV", runs, 5, goal="twice polars")
