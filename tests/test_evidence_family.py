"""The family of a run: its columns, however they are stored, are what they say."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from sherkit.base.types import Floats
from sherkit.evidence.blocks import Visits
from sherkit.evidence.family import Family
from sherkit.evidence.linearised import Linearised
from sherkit.evidence.run import Run
from sherkit.evidence.whitening import Whitening, independent


class OneModel:
    """Derivatives by two constants, by two joints, and by no effect."""

    def __init__(self, joints: Floats) -> None:
        self.joints = joints

    def fitted(self, rows: slice) -> tuple[Floats, Floats]:
        """Each axis has an offset; a joint moves both axes, by how far the other is."""
        q = self.joints[rows]
        offsets = np.broadcast_to(np.eye(2), (len(q), 2, 2)).copy()
        inputs = np.stack([1.0 + 0.1 * q[:, ::-1], 0.3 * q], axis=1)
        return offsets, inputs

    def effects(self, rows: slice) -> Floats:
        return np.zeros((len(self.joints[rows]), 2, 0))


def run_of_two_joints(
    rows: int = 60, visits: int = 2, rho: float = 0.0, still: bool = False, time: Floats | None = None, **more: Any
) -> Run:
    """A run of two joints and two axes: each pose is visited so often, in passes."""
    rng = np.random.default_rng(1)
    poses = rng.uniform(-1.0, 1.0, (rows // visits, 2))
    if still:
        poses[:, 1] = 0.25
    joints = np.tile(poses, (visits, 1))
    pose = np.tile(np.arange(len(poses)), visits)
    time = 10.0 * np.arange(rows) + rng.uniform(0.0, 1.0, rows) if time is None else time
    inputs = {"q1_mm": joints[:, 0], "q2_mm": joints[:, 1]}
    varying: Mapping[str, Floats] = {k: v for k, v in inputs.items() if np.ptp(v) > 0}
    view = Linearised(
        residual=rng.normal(size=(rows, 2)), variables={**varying, "time_s": time}, group=pose, repeated=pose,
        derivatives=OneModel(joints), pattern_of={k: k for k in varying}, inputs=inputs, time=time, **more,
    )  # fmt: skip
    white = Whitening(rho, np.ones(rows, dtype=np.int64))
    return Run(None, np.arange(rows), np.ones(2), view, white)  # type: ignore[arg-type]


@pytest.mark.parametrize("rho", [0.0, 0.6])
@pytest.mark.parametrize("visits", [1, 2])
def test_products_are_those_of_the_columns(visits: int, rho: float) -> None:
    """Catches a sum over visits in the wrong order, a filter whose transpose is another one, numbers of columns that
    are not where their part says, and products within a block of another axis."""
    run = run_of_two_joints(visits=visits, rho=rho)
    family = Family(run)
    x = np.random.default_rng(2).normal(size=(len(run) * run.axes, 3))
    every = np.arange(len(family.columns))
    columns = family.columns.of(every)
    assert np.abs(columns.T @ x - family.columns.products(x)).max() < 1e-12
    length = np.linalg.norm(columns, axis=0)
    assert np.abs(length[length > 0] - 1.0).max() < 1e-9
    for _, at, grams in family.groups:
        for numbers, gram in zip(at, grams, strict=True):
            assert np.abs(columns[:, numbers].T @ columns[:, numbers] - gram).max() < 1e-12


def test_a_column_is_what_its_block_says() -> None:
    """Catches a wave of another period than is told, and one that is carried by another joint."""
    run = run_of_two_joints()
    family = Family(run)
    q = run.view.inputs["q2_mm"]
    block = next(b for b in family.blocks if b.shape == "periodic" and b.pattern == "q2_mm" and b.period < 0.5)
    angle = 2.0 * np.pi * q / block.period
    by_hand = np.stack([np.sin(angle), np.cos(angle)], axis=1) - np.stack([np.sin(angle), np.cos(angle)], axis=1).mean(
        0
    )
    basis = independent(np.einsum("nm,nk->nmk", run.view.patterns["q2_mm"], by_hand).reshape(-1, 2))
    columns = family.columns.of(block.at)
    assert np.abs(columns - basis @ (basis.T @ columns)).max() < 1e-9


def test_a_joint_that_stands_still_has_no_block() -> None:
    """Catches a column of nothing that is brought to unit length: rounding would be a rival of physics."""
    family = Family(run_of_two_joints(still=True))
    assert {"q1_mm", "time_s"} == {name for block in family.blocks for name in block.depends_on}
    assert all(np.isfinite(gram).all() for _, _, gram in family.groups)


def test_a_wave_that_is_zero_at_every_row_is_no_block() -> None:
    """Catches the rounding of a sine that is read in each of its zeros, as a wave: rows a second apart, whole waves."""
    rows = 61
    run = run_of_two_joints(rows=rows, visits=1, time=np.arange(rows, dtype=float))
    family = Family(run)
    # of thirty waves over sixty seconds the sine is nothing, of sixty the cosine does not vary either
    waves = {round(60 / b.period, 1): len(b.at) for b in family.blocks if b.shape == "periodic" and b.axis is None
             and b.depends_on == ("time_s",)}  # fmt: skip
    assert waves[29.5] == 4
    assert waves[30.0] == 2
    assert 60.0 not in waves


def test_weights_are_shared_by_settings() -> None:
    """Catches a cause that is likelier because it is tried at more settings, and shapes that outweigh effects."""
    family = Family(run_of_two_joints())
    each: dict[tuple[object, ...], float] = {}
    for block, weight in zip(family.blocks, np.exp(family.log_weight), strict=True):
        each[block.cause] = each.get(block.cause, 0.0) + weight
    assert len({round(weight, 12) for weight in each.values()}) == 1
    assert sum(each.values()) == pytest.approx(0.5)


def test_a_basis_does_not_hang_on_the_order_of_its_columns() -> None:
    """Catches a rank that is one with near-copies first and another with them last, and a basis that is not
    orthonormal where one direction is a millionth of the others."""
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(200, 6))
    columns = np.concatenate(
        [columns, columns[:, :2] * 7.0 + 1e-5 * rng.normal(size=(200, 2)), columns[:, 2:3]], axis=1
    )
    first = independent(columns)
    assert first.shape[1] == 8
    assert np.abs(first.T @ first - np.eye(8)).max() < 1e-12
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(9)
        other = independent(columns[:, order] * np.exp(rng.normal(size=9)))
        assert other.shape[1] == 8
        assert np.abs(first @ (first.T @ other) - other).max() < 1e-8


def test_poses_that_differ_in_the_last_digit_are_not_summed() -> None:
    """Catches visits that are taken for one pose where the machine stood elsewhere."""
    run = run_of_two_joints()
    assert len(Visits.of(run)) == 30
    run.view.inputs["q1_mm"][3] += 1e-6
    assert len(Visits.of(run)) == 60
