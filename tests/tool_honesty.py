"""How honest the tool's estimates are on the second simulator: coverage of depth and tip by condition.

python tests/tool_honesty.py [--seeds 4] [--faults] [CONDITION ...]
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import polars as pl
import tomli_w
from numpy.typing import NDArray

from second_tool import CONDITIONS, FAULTS, Honesty, Recorded, WideRun, World, honesty, pooled, write_csv
from sherkit.errors import MeasurementError, SherkitWarning
from sherkit.fit.identify import Fit, identify
from sherkit.robots.tool.calibration import Loads, read_loads
from sherkit.robots.tool.consistency import known
from sherkit.robots.tool.filters import Estimate, estimate
from sherkit.robots.tool.model import ToolModel
from sherkit.robots.tool.runs import ToolRun, tool_run_of
from sherkit.robots.tool.tare import tare
from sherkit.robots.tool.tool import FlexibleTool, ToolDoubt, load_tool
from sherkit.robots.tool.trust import Trust, trust


def tool_from(tables: dict[str, Any]) -> FlexibleTool:
    """The tool of a file with these tables."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "tool.toml"
        path.write_text(tomli_w.dumps(tables), encoding="utf-8")
        return load_tool(path)


def loads_from(bench: dict[str, NDArray[np.float64]]) -> Loads:
    """The loads of a file with these columns."""
    with TemporaryDirectory() as folder:
        write_csv(bench, Path(folder) / "bench.csv")
        return read_loads(Path(folder) / "bench.csv")


def run_of(recorded: Recorded | WideRun, source: str = "run") -> ToolRun:
    """What the reader makes of a recorded run."""
    frame = pl.DataFrame(recorded.columns())
    return tool_run_of(frame.with_columns(pl.col(pl.Float64).fill_nan(None)), source)


def without_fibres(run: ToolRun, rows: NDArray[np.bool_]) -> ToolRun:
    """The same run with the wavelengths of some rows (n,) lost."""
    return replace(run, wavelengths_nm=np.where(rows[:, None], np.nan, run.wavelengths_nm))


def without_camera(run: ToolRun) -> ToolRun:
    """The same run, which no camera saw."""
    return replace(run, camera_time_s=run.camera_time_s[:0], camera_mm=run.camera_mm[:0])


def told(tool: FlexibleTool, run: ToolRun) -> Trust:
    """What is said of a run."""
    e = estimate(tool, run)
    return trust(e, known(e))


def fitted(model: ToolModel, *names: str) -> Fit:
    """A model fitted with these effects."""
    return identify(model, model.readings, effects=[e for e in model.candidates if e.name in names])


def tool_of(world: World, seed: int = 0) -> FlexibleTool:
    """The tool as its file says, with the world's own bending and the doubt by which its file was drawn."""
    tool = tool_from(world.file(seed))
    doubt = ToolDoubt(
        depth=_of_depth(world, np.array(tool.gains)), turn_rad=0.0, force=world.gain_error,
        reference_nm=world.reference_error_nm, mean=0.003,
    )  # fmt: skip
    return replace(tool, bending="exact" if world.rod.exact else "small", doubt=doubt)


def _of_depth(world: World, gains: NDArray[np.float64]) -> tuple[tuple[float, float, float], ...]:
    """Covariance of the terms of a depth that gains (2, 2, 3) put off which are drawn as the world draws them: 4,000
    draws
    in eight directions."""
    rng, (near, far) = np.random.default_rng(0), world.gratings.from_tip_mm[:2]
    depth = np.linspace(1.0, 25.0, 9)
    basis = np.stack([np.ones(9), depth / 10.0, (depth / 10.0) ** 2], axis=1)
    terms = []
    for angle in np.pi / 4 * np.arange(8):
        way = np.array([np.cos(angle), np.sin(angle)])
        off = world.gain_error * rng.standard_normal((500, *gains.shape))
        made = np.stack([np.linalg.pinv(gains[s]) @ way for s in range(2)])
        relative = np.einsum("nsak,sak,sk,a->ns", off, gains, made, way)
        error = (relative[:, 1] - relative[:, 0])[:, None] * (near - depth) * (far - depth) / (far - near)
        terms.append(error @ np.linalg.pinv(basis).T)
    covariance = np.cov(np.concatenate(terms).T)
    a, b, c = (tuple(float(v) for v in row) for row in np.atleast_2d(covariance))
    return a, b, c  # type: ignore[return-value]


def warmed_of(world: World, seed: int = 0) -> FlexibleTool:
    """The same, whose fibres' answers to warmth were learnt while it warmed, untouched."""
    return tare(tool_of(world, seed), run_of(world.run("warm_up", seed=seed)), untouched=True).tool


def loads_of(world: World, seed: int = 0, **bench: float) -> Loads:
    """A bench of known loads."""
    return loads_from(world.bench(seed=seed, **bench))  # type: ignore[arg-type]


def honest(e: Estimate, truth: Recorded) -> dict[str, Honesty]:
    """Of every estimate whose truth is known: depth and tip, by the filter. The first second is the start's."""
    on = truth.time_s >= 1.0
    found: dict[str, Honesty] = {}
    tips = {"tip": (e.tip.value, e.tip.covariance),
            "tip of both": (e.together.value[:, 1:], e.together.covariance[:, 1:, 1:])}  # fmt: skip
    depths = {"depth": (e.depth.value, e.depth.covariance),
              "depth of both": (e.together.value[:, :1], e.together.covariance[:, :1, :1])}  # fmt: skip
    if truth.depth_mm is not None:
        for name, (value, covariance) in depths.items():
            found[name] = honesty(value[on], covariance[on], truth.depth_mm[on])
    for name, (value, covariance) in tips.items():
        found[name] = honesty(value[on], covariance[on], truth.tip_mm[on])
    return found


def measured(
    world: World, seeds: int, experiment: str = "phantom", seconds: float = 60.0,
    made: Callable[[World, int], FlexibleTool] = tool_of,
) -> dict[str, Honesty]:  # fmt: skip
    """Pooled over seeds."""
    every: dict[str, list[Honesty]] = {}
    for seed in range(seeds):
        truth = world.run(experiment, seconds=seconds, seed=seed)
        for name, one in honest(estimate(made(world, seed), run_of(truth)), truth).items():
            every.setdefault(name, []).append(one)
    return {name: pooled(some) for name, some in every.items()}


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("conditions", nargs="*")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--faults", action="store_true")
    parser.add_argument("--experiment", default="phantom")
    asked = parser.parse_args()
    worlds = FAULTS if asked.faults else CONDITIONS
    warnings.simplefilter("ignore", SherkitWarning)
    names = ("depth", "tip", "tip of both")
    print(f"{'':<18}" + "".join(f"{n + ': 95 %, NEES, max':>30}{'>5':>8}{'mm':>8}" for n in names))
    rows = [(name, made) for name in asked.conditions or worlds for made in (tool_of, warmed_of)]
    for name, made in rows:
        if made is warmed_of and not worlds[name].temperature_c:
            continue
        try:
            found = measured(worlds[name], asked.seeds, asked.experiment, made=made)
        except MeasurementError as refused:
            print(f"{name:<18}{refused}", flush=True)
            continue
        name += ", learnt" if made is warmed_of else ""
        cells = [
            f"{h.coverage:>14.3f}{h.nees:>8.2f}{h.largest:>8.1f}{h.beyond_5:>8}{h.mean_error_mm:>8.3f}"
            for h in (found[n] for n in names if n in found)
        ]
        print(f"{name:<18}" + "".join(cells), flush=True)


if __name__ == "__main__":
    main()
