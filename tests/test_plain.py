"""Each clever part beside the plain one on the same runs: nowhere worse by more than a twentieth.

Deltas at random (`mistakes.random_delta`), their runs by the second simulator; errors are those at places that were
measured by nobody, against the truth. Every test prints its ratios (`pytest -s -m slow tests/test_plain.py`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

import sherkit as sk
from mistakes import random_delta
from second_simulator import Noise, Robot, draw_geometric_errors, make_plan, scaled_effect, simulate
from worlds import World

pytestmark = pytest.mark.slow

Floats = NDArray[np.float64]
SEEDS = range(12)
NOISE_MM = 0.005
WORST = 1.05


class Case:
    """A delta by its seed with an effect hidden or none: a run of 120 poses twice, and the truth at 200 places."""

    def __init__(self, seed: int, effect: str | None = None, rms_um: float = 40.0) -> None:
        self.settings = random_delta(seed)
        robot = Robot.from_dict(self.settings)
        rng = np.random.default_rng([seed, 41])
        half = 0.2 * min(self.settings["geometry"]["base_radius_mm"])
        errors = draw_geometric_errors(np.random.default_rng([seed, 1]))
        plan = make_plan(robot, rng.uniform(-half, half, (120, 3)), 2, "shuffled", seed)
        there = make_plan(robot, rng.uniform(-half, half, (200, 3)), seed=seed + 1)
        planted = scaled_effect(robot, plan, effect, rng, 1e-3 * rms_um, errors=errors) if effect else {}
        self.columns = simulate(robot, plan, errors, planted, Noise(sigma_mm=NOISE_MM), seed=seed)
        self.true = simulate(robot, there, errors, planted, Noise(sigma_mm=0.0), seed=seed)
        self.robot = World(self.settings, {}, 0.0).robot

    @property
    def run(self) -> sk.Measurements:
        return sk.from_frame(pl.DataFrame(self.columns))

    def error_mm(self, fit: Any) -> float:
        """RMS, in space, of a fit at the places where the truth is known."""
        data = sk.from_frame(pl.DataFrame(self.true))
        return rms(fit.model.predict(data, fit.values) - data.readings)


def rms(off: Floats) -> float:
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def compared(name: str, ours: list[float], plain: list[float]) -> float:
    """Ratio of errors over all runs, printed with those of single ones."""
    each = np.array(ours) / np.array(plain)
    ratio = float(np.sqrt(np.mean(np.square(ours)) / np.mean(np.square(plain))))
    print(f"\n{name}: {ratio:.3f} over all; single runs {each.min():.3f} to {each.max():.3f}")
    return ratio


@pytest.mark.parametrize("loss", ["huber", "tukey"])
def test_a_robust_fit_costs_little_on_clean_rows(loss: str) -> None:
    """Catches a robust loss that throws away good rows: it is as good as least squares where nothing is wrong."""
    cases = [Case(seed) for seed in SEEDS]
    ours = [c.error_mm(sk.identify(c.robot, c.run, loss=loss)) for c in cases]
    plain = [c.error_mm(sk.identify(c.robot, c.run)) for c in cases]
    assert compared(f"{loss} / least squares, clean", ours, plain) <= WORST


def test_identification_is_no_worse_than_scipy() -> None:
    """Catches a solver that stops early: SciPy's least squares on the same model and start reaches the same cost."""
    ours, plain = [], []
    for seed in SEEDS:
        case = Case(seed)
        fit, data = sk.identify(case.robot, case.run), case.run
        model = fit.model

        def off(values: Floats, model: Any = model, data: sk.Measurements = data) -> Floats:
            return np.asarray((model.predict(data, values) - data.readings).ravel() / NOISE_MM)

        sizes = np.array([p.size for p in model.parameters])
        found = least_squares(off, np.zeros(len(sizes)), x_scale=sizes, xtol=1e-12, ftol=1e-12, gtol=1e-12)
        ours.append(float(np.linalg.norm(off(fit.values))))
        plain.append(float(np.linalg.norm(found.fun)))
    # axes are weighed by repeats here, and alike there
    assert compared("identification / SciPy", ours, plain) <= 1.0001


def without_blocks(case: Case, sortings: Floats, blocks: int) -> float:
    """RMS of a coordinate on poses that were left out and fitted without, in blocks of them along each of some
    ``sortings`` (s, rows)."""
    data, squares = case.run, []
    for along in sortings:
        block = np.searchsorted(np.quantile(along, np.arange(1, blocks) / blocks), along)
        for k in range(blocks):
            fit = sk.identify(case.robot, data.select(np.flatnonzero(block != k)))
            out = data.select(np.flatnonzero(block == k))
            squares.append((fit.model.predict(out, fit.values) - out.readings)[:, :3].ravel() ** 2)
    return float(np.sqrt(np.concatenate(squares).mean()))


@pytest.mark.parametrize("effect", [None, "rail_lean", "encoder_cyclic", "limb_twist"])
def test_held_out_lies_between_two_plain_cross_validations(effect: str | None) -> None:
    """Catches an error held out that flatters, or frightens: it is no less than that of refits without poses that were
    measured one after the other, and no more than that without slices of the workspace."""
    ours, kind, harsh = [], [], []
    for seed in SEEDS:
        case = Case(seed, effect)
        ours.append(sk.diagnose(sk.identify(case.robot, case.run)).steps[0].error.rms * 1e-3 / np.sqrt(3.0))
        groups = case.run.groups
        of_pose = np.stack([case.run.readings[groups == g, :3].mean(axis=0) for g in groups.tolist()])
        first = np.array([np.argmax(groups == g) for g in groups.tolist()], dtype=float)
        kind.append(without_blocks(case, first[None], 10))
        harsh.append(without_blocks(case, np.random.default_rng(seed).normal(size=(5, 3)) @ of_pose.T, 8))
    assert compared(f"held out / without stretches of time, {effect}", ours, kind) >= 1.0 / WORST
    assert compared(f"held out / without slices of space, {effect}", ours, harsh) <= WORST


@pytest.mark.parametrize("effect", [None, "rail_lean", "encoder_cyclic", "sensor_linearity", "limb_twist"])
def test_a_calibration_is_no_worse_than_a_polynomial(effect: str | None) -> None:
    """Catches physics that do worse than thirty numbers without any: a cubic of what the drawing leaves."""
    ours, plain = [], []
    for seed in SEEDS:
        case = Case(seed, effect)
        data, true = case.run, sk.from_frame(pl.DataFrame(case.true))
        study = sk.Study(case.robot, data)
        found = study.diagnose()
        for name in found.effects:
            study.add(name)
        ours.append(case.error_mm(study.fit))
        model = sk.identify(case.robot, data).model
        drawn = np.zeros(len(model.parameters))

        def cubic(at: Floats, reach: float = float(np.abs(data.readings[:, :3]).max())) -> Floats:
            u = at / reach
            powers = [(i, j, k) for i in range(4) for j in range(4 - i) for k in range(4 - i - j)]
            return np.stack([u[:, 0] ** i * u[:, 1] ** j * u[:, 2] ** k for i, j, k in powers], axis=1)

        at, there = model.predict(data, drawn), model.predict(true, drawn)
        x = np.linalg.lstsq(cubic(at[:, :3]), data.readings - at)[0]
        plain.append(rms(there + cubic(there[:, :3]) @ x - true.readings))
    assert compared(f"calibration / cubic alone, {effect}", ours, plain) <= WORST
