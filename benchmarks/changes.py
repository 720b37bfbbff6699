"""How often a change of a machine is named: ``sk.compare`` and ``sk.verify`` on the second simulators.

python benchmarks/changes.py [nothing|parameters|effects|pairs|unknown|arm|spherical|verify …] [--seeds 6] [--from 0]

Before and after have other poses, other noise and another room; the sensor stands elsewhere. *Right* names what has
changed, alone or in a tie that holds it; of nothing it is "unchanged", of what is in no catalogue anything but
"changed". *False names* are changes that were named alone and are none.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np

import sherkit as sk
from changed_worlds import (
    ARM_MECHANICAL,
    ARM_PARAMETERS,
    MECHANICAL,
    PARAMETERS,
    SPHERICAL_MECHANICAL,
    SPHERICAL_PARAMETERS,
    ArmPair,
    DeltaPair,
    SphericalPair,
)
from sherkit.base.workers import processes

PAIRS = (("base_angle_2", "backlash"), ("rod_length_1", "rail_lean"), ("rod_length_1", "base_radius_3"),
         ("joint_scale", "gravity_sag"), ("base_angle_1", "limb_twist"))  # fmt: skip
#: Interim checks: how many times the promise the deployed model is off, from and to, and what else is told of the run.
CHECKS: tuple[tuple[str, tuple[float, float], dict[str, Any]], ...] = (
    ("still as calibrated", (0.0, 0.0), {}),
    ("off by 1.5 × the promise", (1.5, 1.5), {}),
    ("off by 1.5 × the promise, poses read four times", (1.5, 1.5), {"repeats": 4}),
    ("off by 1.5 × the promise, poses read six times", (1.5, 1.5), {"repeats": 6}),
    ("off by 1.5 × the promise, poses read nine times", (1.5, 1.5), {"repeats": 9}),
    ("off by 2 × the promise", (2.0, 2.0), {}),
    ("off by 1.5 to 6 × the promise", (1.5, 6.0), {}),
    ("off by 2 × the promise, in no catalogue", (2.0, 2.0), {"unknown": "saddle"}),
)
_ROUNDS = 4
#: The radius of 95 of 100 over the root mean square of an axis, of three alike (χ², three degrees of freedom).
_TO_95 = 2.795


@dataclass(frozen=True)
class Outcome:
    """One comparison: whether it was right, whether a name was false, seconds, what was said, and whether a check says
    that it can tell 1.5 promises."""

    right: bool
    false_name: bool
    seconds: float
    told: str
    able: bool = False


def compared(make: Callable[[int], Any], changed: tuple[str, ...], kind: str, seed: int) -> Outcome | None:
    """One pair of runs; None where such a change leaves nothing to be seen."""
    warnings.simplefilter("ignore")
    try:
        world = make(seed)
    except (ValueError, RuntimeError):
        return None
    began = time.process_time()
    found = world.compare()
    seconds = time.process_time() - began
    # numbers within one effect or one tool that are alike are no tie of effects
    tied = next((t for t in found.indistinguishable if not any("." in n or n.startswith("tool_") for n in t)), ())
    changed = tuple("tool" if name.startswith("tool_") else name for name in changed)
    alone = set(found.changed) if not tied else set()
    if kind == "nothing":
        right = found.verdict == "unchanged"
    elif kind == "unknown":
        right = found.verdict not in ("changed", "unchanged")
    else:
        right = found.verdict == "changed" and (alone == set(changed) or " & ".join(sorted(changed)) in tied)
    wrong = found.verdict == "changed" and bool(alone - set(changed))
    return Outcome(right, wrong, seconds, f"seed {seed}: {found.headline}; ranked {found.ranked[:2]}")


def verified(times: tuple[float, float], settings: dict[str, Any], seed: int) -> Outcome | None:
    """An interim check of a calibrated delta, by a dozen poses. What has moved makes the deployed model off, in truth,
    by so many ``times`` its promise, evenly between two of them; by none nothing has moved, and then it is valid."""
    warnings.simplefilter("ignore")
    name = (*PARAMETERS, *MECHANICAL)[seed % (len(PARAMETERS) + len(MECHANICAL))]
    aim = float(np.exp(np.random.default_rng([seed, 4]).uniform(*np.log(times)))) if times[1] else 0.0
    changed = () if not aim or "unknown" in settings else (name,)
    try:
        world = DeltaPair(seed, poses=(60, 12))
        made = sk.calibrate(world.robot, world.runs[0], correction="none").calibration
        poses = sk.changes.verifying_poses(made, 12, seed=seed)
        places = np.array([[p["x_mm"], p["y_mm"], p["z_mm"]] for p in poses])
        promised = (
            float(np.sqrt(np.mean(np.square(made.predicted_accuracies(made.to_sensor(places)).radius_mm)))) / _TO_95
        )

        def changed_by(ratio: float) -> DeltaPair:
            """The same machine, with a change that leaves so many noises."""
            quiet = {key: value for key, value in settings.items() if ratio or key != "unknown"}
            return DeltaPair(seed, changed if ratio else (), ratio, places=poses, poses=(60, 12), **quiet)

        ratio, still = aim * promised / world.noise, changed_by(0.0).missed(made).ravel()
        world = changed_by(ratio)
        for _ in range(_ROUNDS if aim else 0):
            # the calibration is off by itself: how much of the change fills that up to what is asked
            by = (world.missed(made).ravel() - still) / ratio
            a, b, c = by @ by, by @ still, still @ still - len(still) * (aim * promised) ** 2
            ratio = float((np.sqrt(max(b * b - a * c, 0.0)) - b) / a)
            world = changed_by(ratio)
    except (ValueError, RuntimeError):
        return None
    began = time.process_time()
    found = sk.verify(made, world.runs[1])
    seconds = time.process_time() - began
    false_name = bool(set(found.changed) - set(changed)) and not found.indistinguishable
    told = f"seed {seed} {' '.join(changed)}: {found.headline}"
    least, promise = found.error["smallest_found"], found.error["promised"]
    able = least is not None and promise is not None and least <= 1.5 * promise * (1.0 + 1e-9)
    return Outcome(found.valid is (not aim), false_name, seconds, told, able)


def row(name: str, outcomes: Sequence[Outcome | None]) -> str:
    """A line of the table."""
    known = [one for one in outcomes if one is not None]
    for one in known:
        if not one.right:
            print(f"    {name}: {one.told}", file=sys.stderr, flush=True)
    return (
        f"| {name} | {len(known)} | {np.mean([one.right for one in known]):.3f} | "
        f"{sum(one.false_name for one in known)} | {np.median([one.seconds for one in known]):.2f} |"
    )


def main() -> None:
    """Runs the parts and prints the table."""
    every = ("nothing", "parameters", "effects", "pairs", "unknown", "arm", "spherical", "verify")
    reader = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    reader.add_argument("parts", nargs="*", default=[])
    reader.add_argument("--seeds", type=int, default=6)
    reader.add_argument("--from", dest="first", type=int, default=0)
    reader.add_argument("--workers", type=int, default=2)
    asked = reader.parse_args()
    chosen, seeds = asked.parts or every, range(asked.first, asked.first + asked.seeds)
    print("| changed | runs | right | false names | s |\n| --- | ---: | ---: | ---: | ---: |")
    with processes(asked.workers) as pool:

        def show(name: str, work: Callable[[int], Outcome | None], over: range) -> None:
            outcomes = list(pool.map(work, over))
            print(row(name, outcomes), flush=True)
            able = [one for one in outcomes if one is not None and one.able]
            if able:
                print(row(f"{name}: those that say that they can tell 1.5 ×", able), flush=True)

        def group(name: str, works: Sequence[Callable[[int], Outcome | None]]) -> None:
            done = [pool.submit(work, seed) for work in works for seed in seeds]
            print(row(name, [one.result() for one in done]), flush=True)

        if "nothing" in chosen:
            many = range(1000 + asked.first, 1000 + asked.first + 25 * asked.seeds)
            for name, settings in (
                ("nothing", {}),
                ("nothing, another temperature", {"warmer_c": 6.0}),
                ("nothing, a dozen poses after", {"poses": (60, 12)}),
            ):
                show(name, partial(compared, partial(_delta, (), 1.0, settings), (), "nothing"), many)
        for part, names in (("parameters", PARAMETERS), ("effects", MECHANICAL)):
            if part in chosen:
                for ratio in (2.0, 5.0):
                    group(f"one of the {part}, {ratio:g} ×", [
                        partial(compared, partial(_delta, (n,), ratio, {}), (n,), part) for n in names
                    ])  # fmt: skip
        if "pairs" in chosen:
            group("two at once, 4 ×", [partial(compared, partial(_delta, p, 4.0, {}), p, "pairs") for p in PAIRS])
        if "unknown" in chosen:
            for ratio in (2.0, 5.0):
                group(f"what is in no catalogue, {ratio:g} ×", [
                    partial(compared, partial(_delta, (), ratio, {"unknown": n}), (), "unknown")
                    for n in ("saddle", "ripple", "bow", "cable")
                ])  # fmt: skip
        for robot, (make, parameters, effects) in OTHERS.items():
            if robot not in chosen:
                continue
            many = range(1000 + asked.first, 1000 + asked.first + 10 * asked.seeds)
            show(f"{robot}, nothing", partial(compared, partial(make, "", 0.0), (), "nothing"), many)
            for part, names in (("parameters", parameters), ("effects", effects)):
                for ratio in (2.0, 5.0):
                    group(f"{robot}, one of the {part}, {ratio:g} ×", [
                        partial(compared, partial(make, n, ratio), (n,), part) for n in names
                    ])  # fmt: skip
        if "verify" in chosen:
            for name, times, settings in CHECKS:
                many = range(asked.first, asked.first + 16 * asked.seeds)
                show(f"verify: {name}", partial(verified, times, settings), many)


def _delta(changed: tuple[str, ...], ratio: float, settings: dict[str, Any], seed: int) -> DeltaPair:
    return DeltaPair(seed, changed, ratio, **settings)


def _arm(changed: str, ratio: float, seed: int) -> ArmPair:
    return ArmPair(seed, changed, ratio=ratio)


def _spherical(changed: str, ratio: float, seed: int) -> SphericalPair:
    return SphericalPair(seed, changed, ratio)


#: Robots other than the delta: how a pair of runs is made, and what may change of it.
OTHERS: dict[str, tuple[Callable[[str, float, int], Any], tuple[str, ...], tuple[str, ...]]] = {
    "arm": (_arm, ARM_PARAMETERS, ARM_MECHANICAL),
    "spherical": (_spherical, SPHERICAL_PARAMETERS, SPHERICAL_MECHANICAL),
}


if __name__ == "__main__":
    main()
