"""Known loads: one that is wrong, gratings in each other's columns, and a bench of one weight."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from sherkit.base.types import Floats
from sherkit.errors import SherkitWarning
from sherkit.robots.tool.bench_doubts import against_drawing, wrong_loads
from sherkit.robots.tool.bench_fit import AS_GOOD, BenchModel, Convention, fit_bench
from sherkit.robots.tool.calibration import Loads, calibrate_tool, loaded_rows
from sherkit.robots.tool.tool import FIBRES, FlexibleTool
from sherkit.robots.tool.virtual import VirtualTool

TOOL = FlexibleTool()
NINE = np.arange(9).reshape(3, 3)


@pytest.fixture(scope="module")
def sound() -> Loads:
    """A bench of a virtual tool."""
    return VirtualTool(TOOL).bench(seed=4)


def said(loads: Loads) -> tuple[list[int], list[str], list[str]]:
    """Rows whose load is wrong, what of them, and what of the columns."""
    rows = loaded_rows(TOOL, loads)
    bad, told = wrong_loads(TOOL, rows)
    return np.flatnonzero(loads.loaded)[bad].tolist(), told, against_drawing(TOOL, rows.some(~bad))


def in_order(loads: Loads, order: Floats) -> Loads:
    """With other gratings in the columns."""
    return replace(loads, wavelengths_nm=loads.wavelengths_nm[:, np.ravel(order).astype(int)])


def test_a_sound_bench_has_nothing_wrong(sound: Loads) -> None:
    """Catches large bends, or loads near a section, that pass for wrong loads."""
    assert said(sound) == ([], [], [])


@pytest.mark.parametrize(("times", "says"), [(1.3, "times as large"), (-1.0, "the other way: its sign seems wrong")])
def test_one_wrong_load_is_named(sound: Loads, times: float, says: str) -> None:
    """Catches one force of eighty that is 1.3 times too large: it was never named, took the wrong convention in half of
    the benches and the stiffness with it; and a wrong sign that is "1 times as large"."""
    for row in np.flatnonzero(sound.loaded)[[3, 41, 70]]:
        force = sound.force_mn.copy()
        force[row] *= times
        rows, told, columns = said(replace(sound, force_mn=force))
        assert (rows, columns) == ([row], [])
        assert says in told[0]


@pytest.mark.parametrize(
    ("order", "says"),
    [
        (NINE.ravel()[::-1], "in reverse order, from fbg9_nm to fbg1_nm"),
        (NINE.T, "by fibres (sections I, II, III of the first"),
        (NINE[[1, 0, 2]], "in the order of sections II, I, III"),
        (NINE[[2, 0, 1]], "in the order of sections III, I, II"),
        ([0, 6, 2, 3, 4, 5, 1, 7, 8], "fbg2_nm and fbg7_nm are exchanged"),
        ([0, 1, 4, 3, 2, 5, 6, 7, 8], "fbg3_nm and fbg5_nm are exchanged"),
    ],
)
def test_gratings_in_another_order_are_said(sound: Loads, order: Floats, says: str) -> None:
    """Catches gratings that stand from the last to the first, or fibre by fibre, and a sentence on gram-force."""
    _, _, columns = said(in_order(sound, order))
    assert len(columns) == 1
    assert says in columns[0]


@pytest.mark.parametrize(("a", "b"), [(0, 1), (0, 2), (1, 2), (3, 4), (3, 5), (4, 5)])
def test_columns_exchanged_within_a_section_are_said(sound: Loads, a: int, b: int) -> None:
    """Catches a section that runs about the shaft the other way than the rest, of a tool that is turned about its shaft
    against its drawing: no gains of another size show it."""
    order = np.arange(9)
    order[[a, b]] = b, a
    c, s = np.cos(2.0), np.sin(2.0)
    turned = replace(sound, force_mn=sound.force_mn @ np.array([[c, s], [-s, c]]))
    assert said(turned)[2] == []
    (told,) = said(in_order(turned, order))[2]
    assert f"section {'II' if a > 2 else 'I'} runs about the shaft the other way" in told
    assert told.endswith(f"{FIBRES[a]} and {FIBRES[b]} as it seems")


def one_weight(seed: int) -> Loads:
    """Sixty times one weight of 100 mN, to four sides, at heights along the unbent axis."""
    rng, tool = np.random.default_rng(seed), TOOL
    depth, turn = rng.uniform(1.0, 26.0, 60), 0.5 * np.pi * rng.integers(4, size=60)
    way = np.column_stack([np.cos(turn), np.sin(turn)])
    loads = Loads(100.0 * way, depth, np.tile(tool.reference_nm, (60, 1)), np.zeros(60))
    model = BenchModel(loaded_rows(tool, loads), tool, Convention("axis", "weight"), 1e-3)
    expected = model.residuals(np.append(np.zeros(8), model.drawn_rod))[1]
    shifts = [(expected[:, s, None] * way) @ np.linalg.pinv(np.array(tool.gains[s])).T for s in range(2)]
    rows = np.hstack([*shifts, np.zeros((60, 3))]) + np.array(tool.reference_nm)
    free = np.tile(tool.reference_nm, (20, 1))
    waves = np.vstack([rows, free]) + 1e-3 * rng.normal(size=(80, 9))
    none, off = np.zeros((20, 2)), rng.normal(size=(3, 60))
    return Loads(
        np.vstack([(100.0 + 0.2 * off[0])[:, None] * way, none]), np.append(depth + 0.05 * off[1], np.full(20, 5.0)),
        waves, np.append(expected[:, 2] + 0.02 * off[2], np.zeros(20)),
    )  # fmt: skip


def answers(loads: Loads) -> list[float]:
    """How far length and stiffness are off, in their deviations."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", SherkitWarning)
        told = calibrate_tool(TOOL, loads)
    assert told.length_mm
    assert told.stiffness_mn_mm2
    return [
        abs(value - true) / std
        for (value, std), true in ((told.length_mm, TOOL.length_mm), (told.stiffness_mn_mm2, TOOL.stiffness_mn_mm2))
    ]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_a_bench_of_one_weight_counts_how_it_may_be_read(seed: int) -> None:
    """Catches a stiffness that is 7 deviations off since the convention was taken that is likelier by chance, and an
    alarm that section II does not follow the model (three benches of six): what one weight leaves of its terms is the
    noise of its readings."""
    assert max(answers(one_weight(seed))) < 3.5


@pytest.mark.slow
def test_readings_that_may_be_it_widen_the_rest() -> None:
    """Catches deviations of one convention where several are as good."""
    loads = one_weight(0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SherkitWarning)
        told = calibrate_tool(TOOL, loads)
    assert sum(v < AS_GOOD for v in told.chi2.values()) > 1
    alone = fit_bench(BenchModel(loaded_rows(TOOL, loads), TOOL, told.convention, told.tool.noise_nm))
    assert told.length_mm
    assert told.length_mm[1] > 1.2 * np.sqrt(alone.covariance[10, 10])
