"""Where a run begins: before the hole, at it, or far inside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from second_tool import CONDITIONS, Recorded
from sherkit.robots.tool.consistency import known
from sherkit.robots.tool.filters import estimate
from sherkit.robots.tool.runs import ToolRun
from sherkit.robots.tool.tool import FlexibleTool
from sherkit.robots.tool.trust import trust
from tool_honesty import run_of, told, tool_of

WORLD = CONDITIONS["exact_rod_pivot"]


def begun(seed: int, *, felt: bool) -> tuple[FlexibleTool, ToolRun, np.ndarray]:
    """A run that begins far inside, with a force or between two."""
    recorded: Recorded = WORLD.run("phantom", seconds=30.0, seed=seed)
    run, depth = run_of(recorded), recorded.depth_mm
    assert depth is not None
    size = np.linalg.norm(recorded.force_mn, axis=1)
    usual = np.quantile(size, 0.8)
    here = (depth > 5.0) & ((size > usual) if felt else (size < 1e-9)) & (run.time_s < 15.0)
    first = int(np.argmax(np.where(here, depth, -1.0)))
    cut = replace(
        run,
        time_s=run.time_s[first:],
        position_mm=run.position_mm[first:],
        turn_rad=run.turn_rad[first:],
        wavelengths_nm=np.ascontiguousarray(run.wavelengths_nm[first:]),
        depth_mm=None,
        fibre_time_s=None if run.fibre_time_s is None else run.fibre_time_s[first:],
    )
    return tool_of(WORLD, seed), cut, depth[first:]


@pytest.mark.parametrize("seed", [51, 52])
@pytest.mark.parametrize("felt", [True, False])
def test_a_run_that_begins_inside(seed: int, felt: bool) -> None:
    """Catches a first row of "depth 0.00 ± 0.50" 24 mm inside, and moments that are looked at so far from where the
    hole is that the depth comes out at 51 ± 1."""
    tool, run, depth = begun(seed, felt=felt)
    e = estimate(replace(tool, start_depth_mm=0.0, start_std_mm=None), run)
    off = np.abs(e.depth.value[:, 0] - depth) / e.depth_std_mm
    assert off.max() < 4.0
    assert np.mean(off < 1.96) > 0.95
    if felt:
        # the first reading does not tell which gratings live
        assert e.depth_std_mm[1] < 5.0
    assert not any("began" in s for s in trust(e, known(e)).noticed)


@pytest.mark.parametrize("seed", [51, 52])
def test_a_start_that_the_file_has_wrong_is_said(seed: int) -> None:
    """Catches a tool file that says 0 ± 0.5 mm of a run that begins inside, without a word; and a sentence where the
    file is right."""
    tool, run, depth = begun(seed, felt=True)
    for start, wrong in ((0.0, True), (float(depth[0]), False)):
        said = told(replace(tool, start_depth_mm=start, start_std_mm=0.5), run)
        began = [s for s in said.noticed if s.startswith("By its first forces")]
        assert bool(began) == wrong, (start, began)
        assert (said.verdict == "unknown") == wrong


def test_nobody_knows_where_a_run_begins_unless_the_file_says_so() -> None:
    """Catches a tool file that claims to know the start because nobody said anything."""
    assert FlexibleTool().start_std_mm is None
    assert "start_std_mm" not in FlexibleTool().to_tables()["filter"]
    assert FlexibleTool(length_mm=90.0).start_known_mm == 30.0
