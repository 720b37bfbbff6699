"""The report of a long run: it draws some of the rows, says so, and loses no extreme."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sherkit as sk
from sherkit.cli.demo import EXAMPLE
from sherkit.report.residual_against import Windows, means
from sherkit.report.residuals import drawn, residuals_of, said
from sherkit.robots import delta
from sherkit.robots.delta.virtual import VirtualDelta


@pytest.fixture(scope="module")
def fit() -> sk.fit.Fit:
    """588 poses read five times, with a wild row and one that is marked."""
    run = VirtualDelta(EXAMPLE, noise_mm=0.005).measure(delta.paper_whole(), repeats=5, order="planes", seed=3)
    readings = run.readings.copy()
    readings[1234, 1] += 0.5
    return sk.identify(EXAMPLE, replace(run, readings=readings).mark_outliers(np.array([77])))


def test_what_is_drawn_is_whole_poses_and_every_extreme(fit: sk.fit.Fit) -> None:
    """Catches thinning that takes repeats apart, drops the wild row that a person looks for, or a marked one."""
    few = drawn(fit, 600)
    lines = set(few.data.line.tolist())
    assert 500 < len(few.data) < 700
    assert fit.data.line[1234] in lines
    assert fit.data.line[77] in lines
    size = np.unique(few.data.groups, return_counts=True)[1]
    assert (size == 5).sum() > 100
    np.testing.assert_array_equal(few.values, fit.values)
    at = np.searchsorted(fit.data.line, few.data.line)
    np.testing.assert_allclose(few.residuals, fit.residuals[at], rtol=0, atol=0)
    assert drawn(fit, 600).data.line.tolist() == few.data.line.tolist()
    assert drawn(fit) is fit


def test_one_pose_read_over_and_over_is_thinned_too() -> None:
    """Catches a run of one pose, whose rows would all be drawn since they are repeats."""
    run = VirtualDelta(EXAMPLE, noise_mm=0.005).measure(delta.paper_whole()[:2], repeats=2000, order="planes", seed=3)
    made = sk.identify(EXAMPLE, run, priors=True)
    assert 400 < len(drawn(made, 400).data) < 450


def test_a_thinned_picture_says_so() -> None:
    """Catches a picture of a part of the rows that looks like one of all."""
    assert "6000 of the 300000 rows" in said(6000, 300_000)
    assert said(2940, 2940) == ""


def test_running_means_are_those_of_a_plain_loop(fit: sk.fit.Fit) -> None:
    """Catches windows that miss a row at their edges, count an outlier, or take readings for poses in the band."""
    left = residuals_of(fit)
    values = left.values.copy()
    values[10:40, 0] = np.nan
    left = replace(left, values=values)
    windows = Windows.of(left, "q1_mm")
    table = means(left, windows)
    v = left.variables["q1_mm"]
    half = {at: np.unique(v[windows.row[windows.place == j]]) for j, at in enumerate(windows.at)}
    for j, at in enumerate(windows.at):
        inside = ~left.outlier & np.isfinite(values[:, 0]) & (v >= half[at].min()) & (v <= half[at].max())
        r, group = values[inside, 0], left.group[inside]
        assert half[at].min() <= at <= half[at].max()
        assert table["m0"][j] == pytest.approx(r.mean(), rel=1e-5)
        error = np.sqrt(sum((r[group == g] - r.mean()).sum() ** 2 for g in np.unique(group))) / len(r)
        assert table["high0"][j] - table["low0"][j] == pytest.approx(4 * error, rel=1e-4)
