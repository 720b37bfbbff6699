"""The paper's Table I beside these filters on the second simulator: an exact rod that turns about its hole.

python tests/tool_table_one.py [--seeds 4]
"""

from __future__ import annotations

import argparse
import runpy
from dataclasses import replace
from pathlib import Path

from second_tool import CONDITIONS
from sherkit.robots.tool.runs import ToolRun
from sherkit.robots.tool.tool import FlexibleTool
from tool_honesty import run_of, tool_of

EXAMPLE = Path(__file__).parents[1] / "examples" / "flexible_tool.py"
#: By mean errors over the whole run, over T0 and over T1, of every signal in every experiment.
TableOne = dict[str, dict[str, tuple[float, float, float]]]


def recorded(experiment: str, seed: int) -> tuple[FlexibleTool, ToolRun]:
    """A tool whose file is right, and a run of the exact rod before a camera with smooth errors."""
    world = replace(CONDITIONS["exact_rod_pivot"], camera_warp_mm=0.25)
    return tool_of(world, seed), run_of(world.run(experiment, seed=seed))


def table_one(seeds: int) -> TableOne:
    """Prints it, and returns its figures."""
    told: TableOne = runpy.run_path(str(EXAMPLE))["main"](seeds, recorded)
    return told


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4, help="runs of each experiment")
    table_one(parser.parse_args().seeds)
