"""Chosen poses: that they observe what a whole grid observes, with a tenth of the driving."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sherkit.cli.demo import EXAMPLE
from sherkit.data import Measurements
from sherkit.errors import ShapeError
from sherkit.fit.identify import identify
from sherkit.planning.poses import choose_poses, design_of
from sherkit.robots.delta import grid, paper_whole
from sherkit.robots.delta.model import CATALOGUE, DeltaModel
from sherkit.robots.delta.robot import DELTA
from sherkit.robots.delta.virtual import VirtualDelta

TWELVE = tuple(n for n in DeltaModel(EXAMPLE).default if not n.startswith("sensor_"))


def rows(poses):
    return Measurements.planned(EXAMPLE.inverse_batch(poses).require("pose"), DELTA)


@pytest.mark.parametrize("free", [(), TWELVE], ids=["with the sensor's pose", "the twelve alone"])
def test_sixty_chosen_poses_do_the_work_of_a_grid(free):
    """Catches poses that observe less than the paper's 588 would with as many readings."""
    model = DeltaModel(EXAMPLE, free)
    whole = design_of(model, rows(paper_whole()))
    chosen = choose_poses(model, rows(paper_whole()), 60)
    assert len(set(chosen.rows.tolist())) == 60
    assert chosen.rank == whole.rank == (12 if free else 14)
    lever = np.array([p.lever_mm for p in model.parameters])[:12]
    per_reading = np.sqrt(588 / 60) * (whole.std[:12] * lever).max()
    found = (chosen.std[:12] * lever).max()
    print(f"largest standard deviation: {found / per_reading:.2f} of that of the grid scaled to as many readings")
    assert found <= 1.10 * per_reading
    # it is in fact much better
    assert found <= 0.75 * per_reading
    assert chosen.o1 > 1.2 * whole.o1


def test_the_standard_deviations_are_those_of_an_identification():
    """Catches a design that promises something else than the fit then gives."""
    poses = grid(20.0, 9, (-20.0, 0.0, 20.0))
    model = DeltaModel(EXAMPLE)
    chosen = choose_poses(model, rows(poses), 40, sigma=0.005)
    virtual = VirtualDelta(EXAMPLE, noise_mm=0.005)
    data = virtual.measure(poses[chosen.rows], repeats=1, seed=3)
    fit = identify(EXAMPLE, data, priors=False)
    ratio = fit.std_from_readings / chosen.std
    # the fit takes the noise from its own residuals
    assert 0.8 < ratio.mean() < 1.2
    assert ratio == pytest.approx(np.full(18, ratio.mean()), rel=0.02)


def test_a_design_is_better_than_chance():
    """Catches an exchange that stops at the first choice, or that takes the worst pose."""
    model = DeltaModel(EXAMPLE)
    every = rows(grid(20.0, 9, (-20.0, 0.0, 20.0)))
    chosen = choose_poses(model, every, 20)
    rng = np.random.default_rng(0)
    by_chance = [design_of(model, every.select(rng.permutation(len(every))[:20])).o1 for _ in range(200)]
    own = design_of(model, every.select(chosen.rows)).o1
    assert own > 1.05 * max(by_chance)


def test_noise_of_each_coordinate_counts():
    """Catches noise that is put on the wrong coordinate: a blind z must not be relied on."""
    model = DeltaModel(EXAMPLE)
    every = rows(grid(20.0, 5, (-20.0, 0.0, 20.0)))
    plain = choose_poses(model, every, 30)
    noisy = choose_poses(model, every, 30, sigma=np.array([1.0, 1.0, 10.0]))
    assert (noisy.std > plain.std * 0.95).all()
    datum = [p.name for p in model.parameters].index("sensor_shift_z")
    assert noisy.std[datum] > 2.0 * plain.std[datum]


def test_effects_take_part_in_a_design():
    """Catches a design for a model with an effect that cannot observe it."""
    plain = DeltaModel(EXAMPLE)
    model = replace(plain, effects=(CATALOGUE["rail_lean"],))
    every = rows(grid(20.0, 7, (-20.0, 0.0, 20.0)))
    chosen = choose_poses(model, every, 60)
    assert chosen.rank > choose_poses(plain, every, 60).rank
    assert np.isfinite(chosen.std).all()


def test_the_order_is_random_and_the_same_by_its_seed():
    """Catches poses in the order in which they were chosen: drift would look like what is chosen first."""
    model = DeltaModel(EXAMPLE)
    every = rows(grid(20.0, 5, (-20.0, 0.0, 20.0)))
    first, again, other = (choose_poses(model, every, 30, seed=s).rows for s in (1, 1, 2))
    assert first.tolist() == again.tolist()
    assert first.tolist() != other.tolist()
    assert sorted(first) == sorted(other)
    assert first.tolist() != sorted(first)


@pytest.mark.parametrize("count", [0, 3, 76])
def test_designs_that_cannot_be_are_refused(count):
    """Catches fewer poses than parameters need, and more than there are."""
    with pytest.raises(ShapeError, match="count: expected 5 to 75 poses"):
        choose_poses(DeltaModel(EXAMPLE), rows(grid(20.0, 5, (-20.0, 0.0, 20.0))), count)
