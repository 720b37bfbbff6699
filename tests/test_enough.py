"""Long runs: the rows that a diagnosis looks at are spread evenly, and the answer is of all rows.

Would catch: poses left out, repeats of a pose gone, a run of whole passes torn apart, an answer whose fit, noise or
outliers are those of the rows looked at.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import second_simulator as simulator
import sherkit as sk
from sherkit.cli.demo import EXAMPLE as ROBOT
from sherkit.evidence.fitted_run import enough_of


def measured(repeats: int, order: str = "shuffled", noise: float = 0.005, seed: int = 3) -> sk.Measurements:
    """588 poses with a leaning rail."""
    there = simulator.Robot.from_dict()
    plan = simulator.make_plan(there, simulator.whole_grid(), repeats=repeats, order=order, seed=1)
    rng = np.random.default_rng(5)
    errors = simulator.draw_geometric_errors(rng)
    hidden = simulator.scaled_effect(there, plan, "rail_lean", rng, 0.02, errors=errors)
    return sk.from_frame(simulator.simulate(there, plan, errors=errors, effects=hidden, noise=noise, seed=seed))


DATA = measured(3)


@given(
    visits=st.lists(st.integers(1, 9), min_size=12, max_size=60), most=st.integers(24, 120), seed=st.integers(0, 2**16)
)
def test_every_pose_is_seen_as_often_as_any_other(visits: list[int], most: int, seed: int) -> None:
    pose = np.random.default_rng(seed).permutation(np.repeat(np.arange(len(visits)), visits))
    n = len(pose)
    data = replace(DATA.select(np.arange(n)), pose=pose, order=np.arange(n))
    rows = enough_of(data, np.arange(n), most)
    assert len(rows) <= most
    assert (np.diff(rows) > 0).all()
    if n <= most:
        assert len(rows) == n
        return
    kept = np.bincount(pose[rows], minlength=len(visits))
    there = kept[kept > 0]
    # as many as of any other, or all it has; two at least where it has two
    most_kept = there.max()
    assert all(k in (min(v, most_kept), 0) for k, v in zip(kept, visits, strict=True))
    assert most_kept >= min(2, max(visits))
    if np.minimum(visits, 2).sum() <= most:
        assert (kept > 0).all()
        # no pose could be seen once more
        assert np.minimum(visits, most_kept + 1).sum() > most


def test_whole_passes_stay_whole() -> None:
    poses, passes = 40, 12
    rng = np.random.default_rng(0)
    pose = np.concatenate([rng.permutation(poses) for _ in range(passes)])
    data = replace(DATA.select(np.arange(len(pose))), pose=pose, order=np.arange(len(pose)))
    rows = enough_of(data, np.arange(len(pose)), 4 * poses)
    assert sorted({int(r) // poses for r in rows}) == [0, 3, 6, 9]
    assert len(rows) == 4 * poses


def test_the_answer_is_of_all_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = DATA.readings.copy()
    wrong[700] += 4.0
    data = DATA.with_readings(wrong)
    fit = sk.identify(ROBOT, data)
    whole = sk.diagnose(fit)
    monkeypatch.setattr(enough_of, "__defaults__", (2 * 588,))
    part = sk.diagnose(fit)
    assert part.verdict == whole.verdict == "explained"
    assert part.effects == whole.effects == ("rail_lean",)
    assert part.outliers.tolist() == whole.outliers.tolist() == [700]
    assert len(part.fit.data) == len(data)
    assert part.fit.data.outlier.sum() == 1
    # the same optimum, reached from another start: to a small part of each deviation
    assert (np.abs(part.fit.values - whole.fit.values) <= 0.05 * whole.fit.std).all()
    assert (np.abs(part.base.values - whole.base.values) <= 0.05 * whole.base.std).all()
    assert part.noise == pytest.approx(whole.noise, rel=1e-6)
    assert any("of 1763 rows are searched" in note for note in part.notes)
    assert not any("are searched" in note for note in whole.notes)
