"""The course of a machine over the years."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

import sherkit as sk
from changed_worlds import DeltaPair, SphericalPair
from running import slow
from sherkit.errors import MeasurementError


def years(kind: str) -> tuple[Any, list[dict[str, Any]], list[str]]:
    """Five runs, three months apart: a step of one parameter before the fourth, or a ramp of it."""
    worlds = [DeltaPair(30 + k, poses=(50, 30)) for k in range(5)]
    first = worlds[0]
    dates = [f"2025-{1 + 3 * k:02d}-10" if k < 4 else "2026-01-10" for k in range(5)]
    runs = []
    for k in range(5):
        by = 0.12 * (k >= 3) if kind == "step" else 0.03 * k if kind == "ramp" else 0.0
        runs.append(first.run_with({"rod_length_2": by}, seed=k))
    return first.robot, runs, dates


@pytest.mark.slow
def test_a_step_has_its_date() -> None:
    """Catches a step at another run, another parameter, or as wear."""
    robot, runs, dates = years("step")
    found = sk.history(robot, runs, dates=dates)
    assert found.verdict == "changed"
    assert [(c.name, c.kind, c.since, c.date) for c in found.changes] == [("rod_length_2", "step", 3, "2025-10-10")]
    assert found.changes[0].parameters[0][1] == pytest.approx(0.12, rel=0.1)
    assert set(found.values) == {"rod_length_2"}


@pytest.mark.slow
def test_a_step_has_its_date_whatever_the_order_of_the_runs() -> None:
    """Catches dates that are taken for the order in which runs are given."""
    robot, runs, dates = years("step")
    shuffled = sk.history(robot, [runs[k] for k in (3, 0, 4, 1, 2)], dates=[dates[k] for k in (3, 0, 4, 1, 2)])
    assert [(c.name, c.since) for c in shuffled.changes] == [("rod_length_2", 3)]


@pytest.mark.slow
def test_wear_is_a_rate() -> None:
    """Catches wear that is told as steps, or with a rate that is not the true one (0.03 mm in three months)."""
    robot, runs, dates = years("ramp")
    found = sk.history(robot, runs, dates=dates)
    assert [(c.name, c.kind) for c in found.changes] == [("rod_length_2", "ramp")]
    assert found.changes[0].parameters[0][1] == pytest.approx(0.01, rel=0.1)


def test_two_courses_of_two_numbers_have_their_dates() -> None:
    """Catches "unexplained", and one of them with a bent instrument for the other, as in 39 of 47 histories in which
    two numbers of a delta had changed, each at its time."""
    world = DeltaPair(6)
    dates = [f"2025-{1 + k:02d}-10" for k in range(7)]
    runs = [world.run_with({"rod_length_2": 0.02 * k, "base_radius_3": 0.15 * (k >= 4)}, seed=60 + k) for k in range(7)]
    found = sk.history(world.robot, runs, dates=dates)
    assert found.verdict == "changed"
    assert {(c.name, c.kind, c.date) for c in found.changes} == {
        ("rod_length_2", "ramp", ""), ("base_radius_3", "step", "2025-05-10"),
    }  # fmt: skip
    assert "calibrate again" in found.advice


@pytest.mark.slow
@pytest.mark.parametrize(
    ("worn", "expected"),
    [
        (lambda k: 0.03 * k - 0.2 * (k >= 6), {("ramp", ""), ("step", "2025-07-10")}),
        *slow((lambda k: 0.03 * max(k - 4, 0), {("ramp", "2025-05-10")})),
    ],
)  # fmt: skip
def test_wear_and_the_service_that_put_it_back(worn: Callable[[int], float], expected: set[tuple[str, str]]) -> None:
    """Catches four runs in which something else happened each, in the place of wear that was put right once, or that
    began late: neither the wear nor the service leads by itself."""
    world = DeltaPair(6)
    runs = [world.run_with({"rod_length_2": worn(k)}, seed=60 + k) for k in range(10)]
    found = sk.history(world.robot, runs, dates=[f"2025-{1 + k:02d}-10" for k in range(10)])
    assert found.verdict == "changed"
    assert {(c.kind, c.date) for c in found.changes} == expected
    assert {c.name for c in found.changes} == {"rod_length_2"}
    assert "(ramp from 2025-05-10)" in found.headline or len(expected) > 1


def test_what_was_there_once_asks_for_no_new_calibration() -> None:
    """Catches "calibrate again what has changed" of a day that is gone: the calibration in use still holds."""
    world = DeltaPair(9)
    runs = [world.run_with({"joint_offset_1": 0.1 * (k == 2)}, seed=90 + k) for k in range(5)]
    found = sk.history(world.robot, runs, dates=[f"2025-{1 + k:02d}-10" for k in range(5)])
    assert [(c.name, c.kind, c.date) for c in found.changes] == [("joint_offset_1", "once", "2025-03-10")]
    assert "the calibration of the other runs holds" in found.advice
    assert "sherkit calibrate" not in str(found.answer)


def test_what_stood_still() -> None:
    """Catches a course where there is none, dates that are none, and dates for other runs."""
    robot, runs, dates = years("")
    found = sk.history(robot, runs, dates=dates)
    assert (found.verdict, found.changes) == ("unchanged", ())
    assert "rod_length_2" in found.stood_still
    with pytest.raises(MeasurementError, match="one for each"):
        sk.history(robot, runs, dates=dates[:2])
    with pytest.raises(MeasurementError, match="is no date"):
        sk.history(robot, runs, dates=["soon"] * 5)


@pytest.mark.slow
def test_a_limb_that_leans_pays_for_no_other_over_the_years() -> None:
    """Catches in a history a third change beside these two, with which the search began and which says nothing beside
    them."""
    world = DeltaPair(56006)
    runs = [world.run_with({}, 60)]
    runs[1:] = [
        world.run_with(
            {"rod_length_3": 0.043 * (k >= 2)}, 61 + k,
            {"rail_lean": [0.0, 0.0, 0.0, -0.0043 * k / 4, 0.0, 0.0]}, -150.0,
        )
        for k in range(1, 5)
    ]  # fmt: skip
    years = sk.history(world.robot, runs)
    assert years.verdict == "changed"
    assert {(one.name, one.kind) for one in years.changes} == {("rail_lean", "ramp"), ("rod_length_3", "step")}
    assert all(len(one.parameters) == 1 for one in years.changes)


@pytest.mark.slow
def test_the_other_joint_that_fits_as_well_stands_in_a_history() -> None:
    """Catches the same over the years, where as many had no tie."""
    pair, names = SphericalPair(7700, "joint_offset", 5.0), {"joint_offset.offset_1", "joint_offset.offset_2"}
    (course,) = sk.history(pair.robot, pair.runs).changes
    assert {course.parameters[0][0], *course.or_else} >= names
