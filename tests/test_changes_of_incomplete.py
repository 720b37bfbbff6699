"""What all runs of a machine miss is nobody's change."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import sherkit as sk
from incomplete_worlds import GearErrors, RippledDelta, small_arm
from running import slow

Run = dict[str, Any]


@pytest.fixture(scope="module")
def arm() -> Any:
    """Its drawing."""
    return small_arm()


def of_poses(run: Run, some: Any) -> Run:
    """The rows at these poses."""
    kept = np.isin(run["pose"], some)
    return {name: values[kept] for name, values in run.items()}


def test_a_copy_is_unchanged_and_vouches_for_nothing(arm: Any) -> None:
    """Catches a change between a run and itself, and a copy that is taken for a second look."""
    world = GearErrors(1)
    run = world.run(world.postures("left"))
    found = sk.compare(arm, [run, run])
    assert (found.verdict, found.changed, found.smallest_found) == ("unchanged", (), None)
    assert "same rows" in found.headline
    assert "measure once more" in found.advice
    assert sk.history(arm, [run, run]).verdict == "unchanged"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 4, 5])
def test_a_run_against_itself(arm: Any, seed: int) -> None:
    """Catches gear errors that no effect describes taken for a change: by half of the reads of each pose (evidence of
    1e13 where functions of readings did not follow the noise of each run), and by half of the poses."""
    world = GearErrors(seed)
    whole = world.run(world.postures("left"))
    reads = np.arange(len(whole["pose"])) % 3 == 0
    for one, other in (
        ({k: v[~reads] for k, v in whole.items()}, {k: v[reads] for k, v in whole.items()}),
        (of_poses(whole, np.arange(1, 93, 2)), of_poses(whole, np.arange(2, 93, 2))),
    ):
        found = sk.compare(arm, [one, other], effects=[])
        assert (found.verdict, found.changed) == ("unchanged", ())


@pytest.mark.parametrize("seed", [1, *slow(3, 6)])
def test_other_places_are_no_change(arm: Any, seed: int) -> None:
    """Catches what a model lacks at one side of the table, and otherwise at the other, taken for a change (evidence of
    1e43, an eccentricity of 93 mrad)."""
    world = GearErrors(seed)
    found = sk.compare(arm, [world.run(world.postures("left")), world.run(world.postures("right"))], effects=[])
    assert (found.verdict, found.changed) == ("undecided", ())
    assert "what the model lacks differs there too" in found.headline


@pytest.mark.slow
def test_a_change_beside_what_is_missing(arm: Any) -> None:
    """Catches an incomplete model that hides a zero of a joint which moved by 1 mrad, at the same places and others."""
    world = GearErrors(2)
    first = world.run(world.postures("left"))
    found = sk.compare(arm, [first, world.run(world.postures("left"), {2: 1e-3})], effects=[])
    assert (found.verdict, found.changed) == ("changed", ("offset_3",))
    assert found.parameters[0].change == pytest.approx(1e-3, rel=0.2)


@pytest.mark.parametrize("seed", [2, *slow(*range(3, 8))])
@pytest.mark.parametrize("changed", [(), *slow((("rod_length_3",),))])
def test_an_incomplete_delta(changed: tuple[str, ...], seed: int) -> None:
    """Catches a ripple that both runs have taken for a change, and a change that it hides."""
    found = RippledDelta(seed, changed).compare(effects=[])
    assert (found.verdict == "unchanged") == (not changed)
    assert found.changed == changed


def test_runs_with_nothing_in_them(arm: Any) -> None:
    """Catches a change between runs of a machine that does exactly as it is drawn."""
    world = GearErrors(3)
    world.size[:] = 0.0
    found = sk.compare(arm, [world.run(world.postures("left")), world.run(world.postures("left"))], effects=[])
    assert found.verdict == "unchanged"


@pytest.mark.slow
def test_runs_with_nothing_in_them_read_once(arm: Any) -> None:
    """Catches a change between such runs without a repeat."""
    world = GearErrors(3)
    world.size[:] = 0.0
    found = sk.compare(arm, [world.run(world.postures("left"), reads=1) for _ in range(2)], effects=[])
    assert found.verdict == "unchanged"


def test_history_names_the_numbers_that_moved() -> None:
    """Catches numbers within their deviations of zero in a change: one rail of three leans since the second run."""
    world = RippledDelta(12, ("backlash",), 5.0)
    found = sk.history(world.robot, world.runs, effects=[])
    for one in found.changes:
        assert all(abs(value) > 2.0 * std for _, value, std, _ in one.parameters)
