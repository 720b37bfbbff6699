"""Readings that stand some rows away from their joints, and what of a set-up is said where it is calibrated."""

from __future__ import annotations

import re

import numpy as np
import pytest

import sherkit as sk
import worlds
from running import slow
from strategies import EXAMPLE


@pytest.mark.slow
@pytest.mark.parametrize("first", [120, *slow(24, 60, 93)])
def test_a_reading_that_was_lost_half_way_is_said(first: int) -> None:
    """Catches an instrument "knocked, and put back", or an instrument that moved, where one reading was lost and all
    after it stand one row too high."""
    world = worlds.clean(4)
    columns = {name: np.array(values) for name, values in world.columns.items()}
    for name in ("x_mm", "y_mm", "z_mm"):
        columns[name][first:-1] = columns[name][first + 1 :].copy()
    found = sk.diagnose(world.robot, sk.from_frame(columns))
    assert not found.effects
    assert "stand 1 row above the joints that they belong to, as where one was lost" in found.headline
    assert int(re.search(r"from (?:row|line) (\d+)", found.headline)[1]) == pytest.approx(first + 2, abs=3)  # type: ignore[index]


@pytest.mark.parametrize("name", ["x_mm", *slow("y_mm", "z_mm")])
def test_one_column_a_row_too_high_is_said_of_that_column(name: str) -> None:
    """Catches sensor_linearity "explained" beside 30 mm that are left, where one column was pasted one row too high."""
    world = worlds.clean(4)
    columns = {each: np.array(values) for each, values in world.columns.items()}
    columns[name] = np.roll(columns[name], -1)
    found = sk.diagnose(world.robot, sk.from_frame(columns))
    assert not found.effects
    assert f"{name} looks shifted: it stands 1 row above its row" in found.headline


def test_a_set_up_that_is_wrong_is_said_where_it_is_calibrated() -> None:
    """Catches a calibration that misses by a tenth of a metre without a word where a diagnosis knows that two columns
    are swapped."""
    run = sk.delta.VirtualDelta.draw(EXAMPLE, 3).measure(sk.delta.paper_whole()[::12], repeats=2, seed=3)
    frame = run.to_frame()
    frame = frame.with_columns(q2_mm=frame["q3_mm"], q3_mm=frame["q2_mm"])
    with pytest.warns(sk.SherkitWarning, match="q2_mm and q3_mm look swapped"):
        sk.calibrate(EXAMPLE, sk.from_frame(frame), correction="none")
