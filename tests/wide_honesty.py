"""The tool's filter beside the paper's on worlds drawn whole from a seed: error, coverage, faults, what each rung is
worth.

python tests/wide_honesty.py [--seeds 4] [--first 0] [--faults | --rungs] [FAULT ...]
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from plain_tool import plain_calibration, plain_filter
from second_tool import Wide, WideRun, honesty
from second_tool.wide import EXPERIMENTS
from second_tool.wide import FAULTS as FAULTS
from sherkit.errors import SherkitWarning
from sherkit.robots.tool.calibration import calibrate_tool
from sherkit.robots.tool.filters import estimate
from sherkit.robots.tool.runs import ToolRun
from sherkit.robots.tool.tool import FlexibleTool, ToolDoubt
from tool_honesty import loads_from, run_of, tool_from

Floats = NDArray[np.float64]

#: Bends to 10 mm and 300 mN, and half of both.
SIZES = {"half": 0.5, "full": 1.0}
SINCE_S, SECONDS = 30.0, 60.0
#: Processes at a time.
WORKERS = int(os.environ.get("SHERKIT_WORKERS", "2"))
#: The robot's own noise, an axis.
_POSE_MM = 2e-3


@lru_cache(maxsize=4)
def tool_of(world: Wide) -> FlexibleTool:
    """Calibrated on the world's bench, from file to file."""
    return tool_from(calibrate_tool(tool_from(world.drawing()), loads_from(world.bench())).tool.to_tables())


@dataclass(frozen=True)
class Score:
    """Depth and tip: RMSE (mm) and coverage of 95 %."""

    depth_mm: float
    tip_mm: float
    depth_covered: float = float("nan")
    tip_covered: float = float("nan")

    def over(self, other: Score) -> tuple[float, float]:
        """Ratios of the errors of depth and tip."""
        return self.depth_mm / other.depth_mm, self.tip_mm / other.tip_mm


def scored(run: ToolRun, truth: WideRun, value: Floats, covariance: Floats | None, since_s: float = 1.0) -> Score:
    """Of depth and tip (n, 4)."""
    rows = np.searchsorted(truth.time_s, run.time_s)
    on = run.time_s >= since_s
    l_mm, tip_mm = truth.l_mm[rows], truth.tip_mm[rows]
    there = on & np.isfinite(l_mm)
    off = value[:, 0] - l_mm, np.linalg.norm(value[:, 1:] - tip_mm, axis=1)
    rmse = [float(np.sqrt(np.mean(one[where] ** 2))) for one, where in zip(off, (there, on), strict=True)]
    if covariance is None:
        return Score(*rmse)
    own = covariance + _POSE_MM**2 * np.eye(4)
    depth = honesty(value[there, :1], own[there, :1, :1], l_mm[there])
    tip = honesty(value[on, 1:], own[on, 1:, 1:], tip_mm[on])
    return Score(*rmse, depth.coverage, tip.coverage)


def plain_of(world: Wide) -> FlexibleTool:
    """The tool as the paper calibrates it, by the drawing and small bends, on the same bench."""
    tool = tool_from(world.drawing())
    bench = world.bench()
    waves = np.column_stack([bench[f"fbg{k + 1}_nm"] for k in range(9)])
    force = np.column_stack([bench["force_x_mn"], bench["force_y_mn"]])
    made = plain_calibration(
        force, bench["depth_mm"], waves, bench["deflection_mm"], np.array(tool.distances_mm), tool.length_mm
    )
    gains, reference = made.gains.tolist(), tuple(made.reference_nm.tolist())
    return replace(tool, gains=gains, reference_nm=reference, stiffness_mn_mm2=made.stiffness)


def plain(tool: FlexibleTool, run: ToolRun) -> Floats:
    """Depth and tip (n, 4) by the paper's filters, written apart."""
    out = plain_filter(
        np.array(tool.gains), np.array(tool.distances_mm), tool.length_mm, tool.stiffness_mn_mm2,
        np.array(tool.reference_nm), run.rotations, run.position_mm, run.wavelengths_nm, tool.start_depth_mm,
        tool.start_known_mm**2,
    )  # fmt: skip
    return np.column_stack([out.depth_mm, out.tip_mm])


@dataclass(frozen=True)
class Healthy:
    """A run without a fault by both filters on one calibrated tool; ``lost``: share of rows in which a sound grating
    was left out, the worst of nine; ``says``: what was noticed, in short."""

    ours: Score
    plain: Score
    lost: float
    says: str

    @property
    def ratios(self) -> tuple[float, float]:
        """Depth and tip over the paper's."""
        return self.ours.over(self.plain)


def healthy(world: Wide, experiment: str) -> Healthy:
    """One run of a world."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SherkitWarning)
        truth = world.run(experiment, seconds=SECONDS)
        tool, run = tool_of(world), run_of(truth)
        e = estimate(tool, run)
    out = e.left_out[np.isfinite(run.wavelengths_nm).all(axis=1)]
    along = f"along {100 * e.goes_along[-1]:.0f} %" if e.goes_along[-1] else ""
    says = "; ".join(x for x in (along, f"lags {100 * float(np.median(e.lags)):.2f} %") if x)
    ours = scored(run, truth, e.together.value, e.together.covariance)
    return Healthy(ours, scored(run, truth, plain(tool, run), None), float(out.mean(axis=0).max()), says)


@dataclass(frozen=True)
class Faulty:
    """A run with a fault from 30 s on; scores from then on. ``right``: whether at the end, and for most of the time in
    which anything was left out since, what is left out is what is bad; ``after_s``: time of bending (force above 20 mN)
    from the fault to when that began."""

    seed: int
    experiment: str
    fault: str
    named: frozenset[int]
    bad: frozenset[int]
    after_s: float
    ours: Score
    well: Score
    plain: Score
    depth_covered: float

    @property
    def right(self) -> bool:
        """A fault whose gratings are named, and no others."""
        return self.named == self.bad


def faulty(seed: int, experiment: str, fault: str) -> Faulty:
    """One run of the table of faults."""
    warnings.simplefilter("ignore", SherkitWarning)
    world = Wide(seed)
    truth = world.run(experiment, seconds=SECONDS, fault=fault, since_s=SINCE_S)
    sound = world.run(experiment, seconds=SECONDS)
    tool, run, without = tool_of(world), run_of(truth), run_of(sound)
    e, well = estimate(tool, run), estimate(tool, without)
    late = run.time_s >= SINCE_S
    bits = e.left_out & late[:, None]
    rows = np.searchsorted(truth.time_s, run.time_s)
    bent = np.linalg.norm(truth.force_mn[rows], axis=1) > 20.0
    # named: left out for most of what is left after it was first left out for good
    last = run.time_s >= run.time_s[-1] - 5.0
    named = frozenset(np.flatnonzero(bits[last].mean(axis=0) > 0.5).tolist())
    bad = truth.bad
    exactly = np.array([frozenset(np.flatnonzero(row).tolist()) == bad for row in bits])
    since = np.flatnonzero(late & ~exactly)
    first = int(since[-1]) + 1 if len(since) and bad else int(np.argmax(late))
    after = float((bent & late & (np.arange(len(late)) < first)).sum() * run.step_s)
    score = scored(run, truth, e.together.value, e.together.covariance, SINCE_S)
    return Faulty(
        seed, experiment, fault, named, bad, after, score,
        scored(without, sound, well.together.value, None, SINCE_S), scored(run, truth, plain(tool, run), None, SINCE_S),
        score.depth_covered,
    )  # fmt: skip


def _none(tool: FlexibleTool) -> FlexibleTool:
    sure = ToolDoubt(turn_rad=0.0, mean=tool.doubt.mean, unlike=tool.doubt.unlike, warmth=0.0)
    return replace(tool, doubt=sure, clearance_mm=0.0, clearance_std_mm=0.0)


def _clearance(tool: FlexibleTool) -> FlexibleTool:
    return replace(_none(tool), clearance_mm=tool.clearance_mm, clearance_std_mm=tool.clearance_std_mm)


def _offsets(tool: FlexibleTool) -> FlexibleTool:
    d, with_it = tool.doubt, _clearance(tool)
    return replace(with_it, doubt=replace(with_it.doubt, reference_nm=d.reference_nm, warmth=d.warmth))


def _turn(tool: FlexibleTool) -> FlexibleTool:
    d, with_it = tool.doubt, _offsets(tool)
    return replace(with_it, doubt=replace(with_it.doubt, turn_rad=d.turn_rad, deeper_mm=d.deeper_mm))


#: Each learns or knows what those before it do, and one thing more.
RUNGS: dict[str, Callable[[FlexibleTool], FlexibleTool]] = {
    "elastica, the hole carried as a pivot, its drift and give learnt": _none,
    "+ clearance of the hole learnt": _clearance,
    "+ offsets of the references learnt": _offsets,
    "+ turn of the gratings and the bench's zero learnt": _turn,
    "+ what the calibration leaves open considered": lambda tool: tool,
}


def true_tool(tool: FlexibleTool, world: Wide, experiment: str) -> FlexibleTool:
    """The tool with everything true but the state: what no calibration could do better."""
    d = world.drawn
    answers = d.glass.answers(d.rod.stiffness_mn_mm2)[:2]
    apart = np.eye(3) - 1.0 / 3.0
    gains = [(np.linalg.pinv(apart @ one) @ apart).tolist() for one in answers]
    warmth = d.glass.warmth_nm_k.reshape(3, 3)[:2]
    return replace(
        tool, length_mm=d.rod.length_mm, stiffness_mn_mm2=d.rod.stiffness_mn_mm2, gains=gains,
        distances_mm=tuple(d.glass.from_tip_mm[:2].tolist()), means=answers.mean(axis=1).tolist(),
        warmth=(warmth / warmth.mean(axis=1, keepdims=True) - 1.0).tolist(),
        reference_nm=tuple(d.glass.rest_nm.tolist()), noise_nm=d.glass.noise_nm,
        clearance_mm=d.clearance_mm[experiment], clearance_std_mm=0.0,
        doubt=ToolDoubt(turn_rad=0.0, mean=1e-3, warmth=0.0),
    )  # fmt: skip


def rungs(seed: int, experiment: str, size: str) -> tuple[Score, dict[str, Score]]:
    """The paper's filter and every rung on one run."""
    warnings.simplefilter("ignore", SherkitWarning)
    world = Wide(seed, size=SIZES[size])
    truth = world.run(experiment, seconds=SECONDS)
    tool, run = tool_of(world), run_of(truth)
    told: dict[str, Score] = {}
    for name, made in RUNGS.items():
        e = estimate(made(tool), run)
        told[name] = scored(run, truth, e.together.value, e.together.covariance)
    e = estimate(true_tool(tool, world, experiment), run)
    told["all true but the state"] = scored(run, truth, e.together.value, e.together.covariance)
    return scored(run, truth, plain(tool, run), None), told


def _every(function: Callable[..., object], runs: Iterable[tuple[object, ...]]) -> list[object]:
    with multiprocessing.get_context("spawn").Pool(WORKERS) as pool:
        return pool.starmap(function, list(runs), chunksize=1)


def _healthy_runs(first: int, seeds: int) -> list[tuple[int, str, str]]:
    return [(s, e, z) for s in range(first, first + seeds) for z in SIZES for e in EXPERIMENTS]


def print_healthy(first: int, seeds: int) -> None:
    """Every run, and the summary by kind."""
    runs = _healthy_runs(first, seeds)
    done: list[Healthy] = _every(healthy, [(Wide(s, size=SIZES[z]), e) for s, e, z in runs])  # type: ignore[assignment]
    print(f"{'':<22}{'depth mm':>9}{'/ paper':>8}{'95 %':>6}{'tip mm':>9}{'/ paper':>8}{'95 %':>6}{'lost':>7}")
    for (seed, experiment, size), h in zip(runs, done, strict=True):
        (d, t), o = h.ratios, h.ours
        print(f"{seed:>3} {experiment:<10}{size:<8}{o.depth_mm:>9.3f}{d:>8.3f}{o.depth_covered:>6.2f}"
              f"{o.tip_mm:>9.4f}{t:>8.3f}{o.tip_covered:>6.2f}{h.lost:>7.3f}")  # fmt: skip
    for kind in EXPERIMENTS:
        some = [h for (_, experiment, _), h in zip(runs, done, strict=True) if experiment == kind]
        depth, tip = np.array([h.ratios for h in some]).T
        cover = np.array([[h.ours.depth_covered, h.ours.tip_covered] for h in some])
        print(f"{kind}: depth / paper's {np.median(depth):.3f} (worst {depth.max():.3f}), tip {np.median(tip):.3f} "
              f"({tip.max():.3f}); 95 % covers {cover[:, 0].mean():.3f} (least {cover[:, 0].min():.3f}), tip "
              f"{cover[:, 1].mean():.3f} ({cover[:, 1].min():.3f}); most lost {max(h.lost for h in some):.4f}")  # fmt: skip  # noqa: E501


def print_faults(first: int, seeds: int, faults: Iterable[str]) -> None:
    """Every fault on phantom and vessels."""
    faults = list(faults)
    runs = [(s, e, f) for f in faults for s in range(first, first + seeds) for e in ("phantom", "vessels")]
    done: list[Faulty] = _every(faulty, runs)  # type: ignore[assignment]
    for h in done:
        if not h.right or max(h.ours.over(h.plain)) > 1.0 or max(h.ours.over(h.well)) > 2.0:
            print(f"{h.fault} {h.seed} {h.experiment}: named {sorted(h.named)} of {sorted(h.bad)} after {h.after_s:.1f} s; depth "  # noqa: E501
                  f"{h.ours.depth_mm:.3f} well {h.well.depth_mm:.3f} plain {h.plain.depth_mm:.3f}; tip {h.ours.tip_mm:.4f} "  # noqa: E501
                  f"well {h.well.tip_mm:.4f} plain {h.plain.tip_mm:.4f}; 95 % {h.depth_covered:.2f}")  # fmt: skip
    print(
        f"{'':<10}{'right':>6}{'after s':>9}{'depth / well':>13}{'worst':>7}{'/ plain':>9}{'worst':>7}{'tip / well':>12}{'worst':>7}{'/ plain':>9}{'worst':>7}{'95 %':>7}"  # noqa: E501
    )
    for fault in faults:
        some = [h for h in done if h.fault == fault]
        (dw, tw), (dp, tp) = (
            np.array([h.ours.over(o(h)) for h in some]).T for o in (lambda h: h.well, lambda h: h.plain)
        )
        right = np.mean([h.right for h in some])
        after = np.median([h.after_s for h in some])
        cells = "".join(f"{np.median(v):>{w}.2f}{v.max():>7.2f}" for v, w in ((dw, 13), (dp, 9), (tw, 12), (tp, 9)))
        print(f"{fault:<10}{right:>6.2f}{after:>9.1f}{cells}{np.mean([h.depth_covered for h in some]):>7.2f}")


def table_of_rungs(first: int, seeds: int) -> str:
    """In Markdown: medians, worst runs and coverage over all kinds of runs; of the depth by kind as well."""
    done: list[tuple[Score, dict[str, Score]]] = _every(rungs, _healthy_runs(first, seeds))  # type: ignore[assignment]
    lines = ["| rung | depth, × the paper's | worst run | tip, × the paper's | worst run | 95 % covers depth | tip |",
             "|---|---|---|---|---|---|---|"]  # fmt: skip
    for name in done[0][1]:
        depth, tip = np.array([told[name].over(plainly) for plainly, told in done]).T
        cover = np.mean([[told[name].depth_covered, told[name].tip_covered] for _, told in done], axis=0)
        lines.append(f"| {name} | {np.median(depth):.2f} | {depth.max():.2f} | {np.median(tip):.3f} | {tip.max():.2f} | "  # noqa: E501
                     f"{cover[0]:.2f} | {cover[1]:.2f} |")  # fmt: skip
    return "\n".join(lines)


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("chosen", nargs="*")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--faults", action="store_true")
    parser.add_argument("--rungs", action="store_true")
    asked = parser.parse_args()
    if asked.faults:
        print_faults(asked.first, asked.seeds, asked.chosen or FAULTS)
    elif asked.rungs:
        print(table_of_rungs(asked.first, asked.seeds))
    else:
        print_healthy(asked.first, asked.seeds)


if __name__ == "__main__":
    main()
