"""The tool's filter beside the paper's on families of worlds that its makers did not have in mind.

python tests/tool_families.py [--seeds 4] [--first 0] [FAMILY ...]
"""

from __future__ import annotations

import argparse

import numpy as np

from second_tool.wide_families import FAMILIES
from wide_honesty import Healthy, healthy

EXPERIMENTS = ("phantom", "vessels")


def line(name: str, some: list[Healthy]) -> str:
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
        runs = [(seed, e) for seed in range(asked.first, asked.first + asked.seeds) for e in EXPERIMENTS]
        some = [healthy(FAMILIES[family](seed), experiment) for seed, experiment in runs]
        for (seed, experiment), j in zip(runs, some, strict=True) if asked.each else ():
            print(f"{family} {seed} {experiment}: depth {j.ours.depth_mm:.3f} mm, {j.ratios[0]:.2f} x "
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
