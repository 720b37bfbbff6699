"""Speed and memory of the diagnosis, against what a user would do by hand, and how both grow."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import numpy_candidates
import scipy_candidates
from timing import Bench, part, process

import sherkit as sk
from sherkit.cli.demo import EXAMPLE as ROBOT

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import second_simulator as simulator

#: Repeats of 588 poses: from 2,940 to 299,880 rows. Longer runs are asked for by hand: ``bench.py --rows 1000000``.
REPEATS = (5, 17, 51, 510)


def run_with_lean(repeats: int) -> sk.Measurements:
    """588 poses read so often by the tests' simulator, with a leaning rail."""
    there = simulator.Robot.from_dict()
    plan = simulator.make_plan(there, simulator.whole_grid(), repeats=repeats, order="shuffled", seed=1)
    rng = np.random.default_rng(5)
    errors = simulator.draw_geometric_errors(rng)
    hidden = simulator.scaled_effect(there, plan, "rail_lean", rng, 0.02, errors=errors)
    return sk.from_frame(simulator.simulate(there, plan, errors=errors, effects=hidden, noise=0.005, seed=3))


def diagnosis(bench: Bench) -> None:
    """All of it: tested at its level, named, held out, what it cannot be told from, which poses next. By hand: only
    which candidate explains most."""
    data = run_with_lean(5)
    fit = sk.identify(ROBOT, data)
    assert sk.diagnose(fit).effects == ("rail_lean",)
    assert numpy_candidates.diagnose(ROBOT, data) == ("rail_lean", 1 / (1 + numpy_candidates.FLIPS))
    left = scipy_candidates.refit_all(ROBOT, data)
    assert min(left, key=lambda name: left[name]) == "rail_lean"
    runs = {
        "sherkit": lambda: sk.diagnose(fit),
        "SciPy: nine candidates refitted, as usually written": lambda: scipy_candidates.refit_all(ROBOT, data),
        "NumPy: nine candidates tested linearly under 199 flips": lambda: numpy_candidates.diagnose(ROBOT, data),
    }
    bench.compare("full diagnosis of 588 × 5 rows, the whole catalogue", runs, 3, goal="80 ms")
    own = {"sherkit": lambda: sk.diagnose(fit, effects=tuple(waves(90)))}
    bench.compare("the same with 90 candidates more", own, 3)


def waves(count: int) -> list[sk.Effect]:
    """Effects of a user: waves of the joints with these many periods."""

    def wave(period_mm: float) -> sk.Effect:
        def waviness(rows, p):  # type: ignore[no-untyped-def]
            return p.amplitude * np.sin(2 * np.pi * rows.joints / period_mm)

        waviness.__name__ = f"wave_{str(round(period_mm, 3)).replace('.', '_')}"
        return sk.effect(at="joints", parameters={"amplitude": ("mm", 0.01)}, physics="A wave.")(waviness)

    return [wave(2.0 + 0.1 * k) for k in range(count)]


def growth(bench: Bench, *more: int) -> None:
    """Longer runs, in a process of its own for its memory; what the simulator and the imports take is the row ``0``."""
    for repeats in (*REPEATS, *more):
        with_diagnosis = [process(part(__file__, "diagnose", repeats)) for _ in range(1)]
        without = [process(part(__file__, "simulate", repeats))]
        samples = {"sherkit": with_diagnosis, "without the diagnosis": without}
        bench.add(f"a process that simulates and diagnoses {588 * repeats:,} rows", samples, "6 s for 300,000, 500 MB")


if __name__ == "__main__":
    made = run_with_lean(int(sys.argv[2]))
    if sys.argv[1] == "diagnose":
        assert sk.diagnose(sk.identify(ROBOT, made)).effects == ("rail_lean",)
