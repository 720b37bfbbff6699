"""The tool's filter beside the paper's on families of worlds that its makers did not have in mind.

python tests/tool_families.py [--seeds 4] [--first 0] [FAMILY ...]
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import dataclass

import numpy as np

from second_tool.wide_families import FAMILIES
from sherkit.errors import SherkitWarning
from sherkit.robots.tool.filters import Estimate, estimate
from wide_honesty import SECONDS, Score, plain, run_of, scored, tool_of

EXPERIMENTS = ("phantom", "vessels")


@dataclass(frozen=True)
class Judged:
    """One run: both filters on one calibrated tool; ``lost``: share of rows in which a sound grating was left out, the
    worst of nine; ``says``: what the screens would say."""

    family: str
    seed: int
    experiment: str
    ours: Score
    paper: Score
    lost: float
    says: str

    @property
    def ratios(self) -> tuple[float, float]:
        """Depth and tip over the paper's."""
        return self.ours.over(self.paper)


def said(e: Estimate) -> str:
    """What was noticed, in short."""
    along = f"along {100 * e.goes_along[-1]:.0f} %" if e.goes_along[-1] else ""
    return "; ".join(x for x in (along, f"lags {100 * float(np.median(e.lags)):.2f} %") if x)


def judged(family: str, seed: int, experiment: str) -> Judged:
    """One run of a family."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SherkitWarning)
        world = FAMILIES[family](seed)
        truth = world.run(experiment, seconds=SECONDS)
        tool, run = tool_of(world), run_of(truth)
        e = estimate(tool, run)
    out = e.left_out[np.isfinite(run.wavelengths_nm).all(axis=1)]
    both = e.together
    return Judged(
        family, seed, experiment, scored(run, truth, both.value, both.covariance),
        scored(run, truth, plain(tool, run), None), float(out.mean(axis=0).max()), said(e),
    )  # fmt: skip


def line(name: str, some: list[Judged]) -> str:
    """A row of the table: medians and worst, what is covered and the least of it."""
    depth, tip = np.array([j.ratios for j in some]).T
    cover = np.array([[j.ours.depth_covered, j.ours.tip_covered] for j in some])
    return (
        f"| {name} | {np.median(depth):.2f} ({depth.max():.2f}) | {np.median(tip):.3f} ({tip.max():.2f}) | "
        f"{cover[:, 0].mean():.2f} ({cover[:, 0].min():.2f}) | {cover[:, 1].mean():.2f} ({cover[:, 1].min():.2f}) | "
        f"{max(j.lost for j in some):.3f} |"
    )


def main() -> None:
    """Prints the table, in Markdown; with ``--each`` every run before it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("families", nargs="*")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--each", action="store_true")
    asked = parser.parse_args()
    lines, every = [], []
    for family in asked.families or FAMILIES:
        seeds = range(asked.first, asked.first + asked.seeds)
        some = [judged(family, seed, experiment) for seed in seeds for experiment in EXPERIMENTS]
        for j in some if asked.each else ():
            print(f"{j.family} {j.seed} {j.experiment}: depth {j.ours.depth_mm:.3f} mm, {j.ratios[0]:.2f} x "
                  f"({j.ours.depth_covered:.2f}); tip {j.ours.tip_mm:.4f} mm, {j.ratios[1]:.3f} x "
                  f"({j.ours.tip_covered:.2f}); lost {j.lost:.3f}; {j.says}", flush=True)  # fmt: skip
        lines.append(line(family, some))
        every += some
    print(
        "| family | depth, x the paper's (worst) | tip (worst) | 95 % covers depth (least) | tip (least) | left out |"
    )
    print("|---|---|---|---|---|---|")
    print("\n".join([*lines, line("all", every)]))


if __name__ == "__main__":
    main()
