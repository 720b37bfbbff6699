"""A bench of dead weights: each hangs across the unbent axis, and has no part along it as what pushes the shaft has."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sherkit.robots.tool.bench_fit import AS_GOOD, Convention
from sherkit.robots.tool.calibration import Loads, calibrate_tool
from sherkit.robots.tool.dead_weight import hung
from sherkit.robots.tool.tool import FlexibleTool
from test_tool import TOOL, Floats

EI, LENGTH_MM = TOOL.stiffness_mn_mm2, TOOL.length_mm


def elastica(angle: float, arc_mm: float, sections_mm: tuple[float, float]) -> tuple[float, ...]:
    """Of a shaft that a weight bends by an ``angle`` where it hangs: the weight, its height above the tip, moments at
    sections, deflection. From the load on, where nothing bends, to where the shaft points as it is clamped."""

    def clamped(_: float, y: Floats) -> float:
        return float(y[0])

    clamped.terminal = True  # type: ignore[attr-defined]
    # in lengths of 1 / √q
    made = solve_ivp(
        lambda _, y: [y[1], -np.cos(y[0]), np.cos(y[0]), np.sin(y[0])], (0.0, 5.0), [angle, 0.0, 0.0, 0.0],
        events=clamped, dense_output=True, rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    unit = (LENGTH_MM - arc_mm) / made.t[-1]
    moments = (-made.sol((s - arc_mm) / unit)[1] * EI / unit if s > arc_mm else 0.0 for s in sections_mm)
    return EI / unit**2, LENGTH_MM - made.y[2, -1] * unit, *moments, made.y[3, -1] * unit


def bench(seed: int, *, by_height: bool) -> Loads:
    """60 weights from all around, and rows without."""
    rng, zeros = np.random.default_rng(seed), 20
    angle, arc = rng.uniform(0.02, 0.35, 60), rng.uniform(2.0, 26.0, 60)
    made = np.array([elastica(*one, TOOL.distances_mm) for one in zip(angle, arc, strict=True)])
    weight, height, moments, bend = made[:, 0], made[:, 1], made[:, 2:4], made[:, 4]
    turn = rng.uniform(0.0, 2 * np.pi, 60)
    way = np.column_stack([np.cos(turn), np.sin(turn)])
    shifts = [(moments[:, s, None] * way) @ np.linalg.pinv(np.array(TOOL.gains[s])).T for s in range(2)]
    waves = np.tile(TOOL.reference_nm, (60 + zeros, 1)) + rng.normal(0.0, 1e-3, (60 + zeros, 9))
    waves[:60, :6] += np.hstack(shifts)
    depth = (height if by_height else arc) + rng.normal(0.0, 0.02, 60)
    none = np.zeros((zeros, 2))
    return Loads(
        np.vstack([weight[:, None] * way, none]), np.append(depth, np.full(zeros, 5.0)), waves,
        np.append(bend + rng.normal(0.0, 0.01, 60), np.zeros(zeros)),
    )  # fmt: skip


@pytest.mark.parametrize("by_height", [True, False])
def test_a_weight_bends_the_shaft_as_the_elastica_says(by_height: bool) -> None:
    """Catches a family of rods that is tabled wrongly, for bends from nothing to 60 degrees."""
    some = [(1e-4, 3.0), (0.01, 20.0), (0.2, 1.0), (0.5, 12.0), (1.05, 8.0)]
    made = np.array([elastica(*one, TOOL.distances_mm) for one in some])
    angle, arc = np.array(some).T
    depth = made[:, 1] if by_height else arc
    found = hung(LENGTH_MM, EI, made[:, 0], depth, np.array(TOOL.distances_mm), by_height=by_height)
    np.testing.assert_allclose(found[:, 1], arc, atol=1e-3)
    np.testing.assert_allclose(found[:, 0], made[:, 0] * np.cos(angle), rtol=1e-6)
    np.testing.assert_allclose(found[:, 2:], made[:, 2:], rtol=2e-5)


@pytest.mark.parametrize(("seed", "by_height"), [(1, True), pytest.param(2, False, marks=pytest.mark.slow)])
def test_dead_weights_are_told_from_what_pushes(seed: int, by_height: bool) -> None:
    """Catches weights that are read as what pushes the shaft, with friction of 0.1 that nobody has: the wrong
    convention in 6 of 20 benches, "χ² 401 against 369"."""
    told = calibrate_tool(TOOL, bench(seed, by_height=by_height))
    assert told.convention == Convention("axis" if by_height else "arc", "weight")
    # what is said agrees with what was taken
    assert told.chi2[told.convention] == 0.0
    assert min(v for c, v in told.chi2.items() if c != told.convention) > AS_GOOD
    assert "its forces dead weights across that axis: χ² is less by" in told.read_as
    assert told.lack_of_fit == ()
    assert told.scatter.friction < 0.05
    assert told.stiffness_mn_mm2
    assert abs(told.stiffness_mn_mm2[0] - EI) < 4.0 * told.stiffness_mn_mm2[1]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::sherkit.errors.SherkitWarning")
def test_readings_that_are_as_good_are_said() -> None:
    """Catches a convention that is taken without a word where bends are too small to tell."""
    small = FlexibleTool(bending="small")
    told = calibrate_tool(small, bench(3, by_height=True))
    assert told.convention.force == "normal"
    assert "or as well" in told.read_as
