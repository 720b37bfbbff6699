"""How many readings it takes until it is known: ``sk.Adaptive`` on the second simulators of delta, sphere and arm.

python benchmarks/until_diagnosed.py [delta|spherical|arm|nothing|unknown|pairs|strategies|twins …] [--seeds 10]
                                     [--from 0]

Without a name all parts are run, which takes some hours on two cores; each line is printed when it is known.

*Right* is a verdict that names what was hidden, alone or in a tie of at most three, and of nothing hidden "adequate";
of an unknown kind it is "unexplained". *Wrong names* are effects named alone that were not hidden. Accuracy is the
share of 100 new places at which the fitted model is off by no more than was promised. *Twins* are no loops: which
effects of the spherical robot stand in for one another so well that as many readings as the budget has, without a
choice, cannot make one 10,000 times as likely as the other.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np

import sherkit as sk
from driven_worlds import UNKNOWN, DrivenArm, DrivenDelta, DrivenSpherical, World
from second_simulator.effects import CATALOGUE
from second_simulator.plans import grid, whole_grid
from second_simulator.spherical import SPHERICAL_EFFECTS
from sherkit.base.workers import processes
from test_serial import EFFECTS as ARM_EFFECTS

BUDGET, SPAN_MIN, RATIOS = 200, 30.0, (1.0, 2.0, 5.0)
WORLDS: dict[str, Callable[..., World]] = {"delta": DrivenDelta, "spherical": DrivenSpherical, "arm": DrivenArm}
#: What lives in time is judged by the run's clock, not by readings.
IN_TIME = {
    "drift",
    "thermal_growth",
    "thermal_shift",
    "link_growth",
    "slip",
    "joint_slip",
    "sensor_slip",
}
_NOT_OF_THE_ARM = {"payload_compliance", "reading_delay", "slip", "joint_slip", "sensor_slip", "sensor_scale"}
HIDDEN = {
    "delta": [n for n in CATALOGUE if n != "sensor_pose"],
    "spherical": [n for n in SPHERICAL_EFFECTS if n not in ("camera_delay", "sensor_pose")],
    # an arm that carries nothing and stands; of the scale of what reads it, its lengths take all
    "arm": [n for n in ARM_EFFECTS if n not in _NOT_OF_THE_ARM],
}
PAIRS = (("rail_lean", "backlash"), ("sensor_linearity", "encoder_cyclic"), ("joint_scale", "rail_lean"),
         ("rod_mismatch", "thermal_growth"), ("joint_scale", "drift"))  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One loop to run."""

    robot: str
    hidden: tuple[str, ...] = ()
    ratio: float = 2.0
    unknown: str = ""
    strategy: str = "its own"
    seed: int = 0
    span_min: float = SPAN_MIN


@dataclass(frozen=True)
class Outcome:
    """How it ended."""

    case: Case
    verdict: str
    right: bool
    wrong_name: bool
    readings: int
    minutes: float
    look_s: float
    held: float = float("nan")
    told: str = field(default="", repr=False)


def given(strategy: str, world: World, seed: int) -> Iterator[list[dict[str, Any]]]:
    """Rows of a plan that somebody made beforehand, in batches."""
    rng = np.random.default_rng([seed, 9])
    if strategy == "random poses":
        places = sk.Adaptive(world.robot, budget=BUDGET).region.anywhere(BUDGET, rng).targets
    else:
        points, repeats = (grid(20.0, 7, (-20.0, 0.0, 20.0)), 3) if strategy.startswith("147") else (whole_grid(), 5)
        places = np.tile(points, (repeats, 1))
        if strategy.endswith("shuffled"):
            places = rng.permutation(places)
    joints = world.robot.inverse_batch(places).require("pose")
    numbers = {tuple(np.round(q, 6)): k + 1 for k, q in enumerate(np.unique(joints, axis=0))}
    seen: dict[int, int] = {}
    for k in range(0, len(joints), 6):
        rows = []
        for q in joints[k : k + 6]:
            pose = numbers[tuple(np.round(q, 6))]
            seen[pose] = seen.get(pose, 0) + 1
            rows.append({"pose": pose, "repeat": seen[pose], **dict(zip(world.joints, q.tolist(), strict=True))})
        yield rows


def run(case: Case) -> Outcome | None:
    """One loop from the first reading to its end; None where such an effect leaves nothing to be seen."""
    warnings.simplefilter("ignore")
    try:
        more = {"unknown": case.unknown} if case.unknown else {}
        world = WORLDS[case.robot](case.seed, case.hidden, case.ratio, **more)
    except (ValueError, RuntimeError):
        return None
    loop = sk.Adaptive(world.robot, budget=BUDGET, span_min=case.span_min, seed=case.seed)
    plan = None if case.strategy == "its own" else given(case.strategy, world, case.seed)
    cpu = 0.0
    while True:
        began = time.process_time()
        done = loop.done
        asked = [] if done else loop.ask()
        cpu += time.process_time() - began
        if done or (plan is not None and not (asked := next(plan, []))):
            break
        rows = world.read(asked)
        began = time.process_time()
        loop.tell(rows)
        cpu += time.process_time() - began
    return judged(case, loop, world, cpu / max(len(loop.looks), 1))


def judged(case: Case, loop: sk.Adaptive, world: World, look_s: float) -> Outcome:
    """What is right about how a loop ended."""
    name, tie = " & ".join(sorted(case.hidden)), loop.indistinguishable[0] if loop.indistinguishable else ()
    alone = set(loop.effects) if not tie else set()
    if case.unknown:
        right = loop.verdict == "unexplained"
    elif not case.hidden:
        right = loop.verdict == "adequate"
    else:
        right = (loop.verdict == "explained" and alone == set(case.hidden)) or (name in tie and len(tie) <= 3)
    held = float("nan")
    if loop.accuracy_um is not None and loop.last is not None:
        places = loop.region.anywhere(100, np.random.default_rng([case.seed, 5]))
        effects = loop.effects if loop.verdict == "explained" else ()
        made = sk.calibrate(world.robot, loop.last.data, effects=effects, correction="none").calibration
        held = float(np.mean(1e3 * world.off(made, places.joints) <= loop.accuracy_um))
    told = f"{loop.verdict} {loop.effects} {loop.indistinguishable} {loop.why}"
    wrong = loop.verdict in ("explained", "partly explained") and bool(alone - set(case.hidden))
    return Outcome(case, loop.verdict, right, wrong, loop.readings, world.clock_s / 60.0, look_s, held, told)


def line(name: str, outcomes: Sequence[Outcome]) -> str:
    """A row of the table."""
    n = np.array([one.readings for one in outcomes])
    minutes = np.array([one.minutes for one in outcomes])
    held = [one.held for one in outcomes if np.isfinite(one.held)]
    return (
        f"| {name} | {len(outcomes)} | {np.mean([one.right for one in outcomes]):.3f} | "
        f"{sum(one.wrong_name for one in outcomes)} | {np.median(n):.0f}, {np.quantile(n, 0.95):.0f} | "
        f"{np.median(minutes):.0f}, {np.quantile(minutes, 0.95):.0f} | {np.median([o.look_s for o in outcomes]):.2f} | "
        f"{f'{np.mean(held):.3f}' if held else ''} |"
    )


def parts(chosen: Sequence[str], seeds: range) -> Iterator[tuple[str, list[Case]]]:
    """The rows of the table, with their cases."""
    for robot in ("delta", "spherical", "arm"):
        if robot in chosen:
            for ratio in RATIOS:
                for when in (False, True):
                    names = [n for n in HIDDEN[robot] if (n in IN_TIME) == when]
                    cases = [Case(robot, (n,), ratio, seed=s) for n in names for s in seeds]
                    yield f"{robot}, {'in time' if when else 'by place'}, {ratio:g} ×", cases
    if "pairs" in chosen:
        yield "delta, pairs, 3 ×", [Case("delta", pair, 3.0, seed=s) for pair in PAIRS for s in seeds]
    if "unknown" in chosen:
        for ratio in RATIOS:
            yield (
                f"delta, unknown kinds, {ratio:g} ×",
                [Case("delta", (), ratio, kind, seed=s) for kind in UNKNOWN for s in seeds],
            )
    if "nothing" in chosen:
        for robot in WORLDS:
            count = 300 if robot == "delta" else 100
            yield f"{robot}, nothing hidden", [Case(robot, seed=1000 + s) for s in range(count)]
    if "strategies" in chosen:
        fast = [n for n in HIDDEN["delta"] if n not in IN_TIME]
        for strategy in ("its own", "588 × 5, plane by plane", "588 × 5, shuffled", "147 × 3, plane by plane",
                         "147 × 3, shuffled", "random poses"):  # fmt: skip
            yield (
                f"delta, by place, 2 ×: {strategy}",
                # who reads without a pause is done before a span is over
                [Case("delta", (n,), 2.0, strategy=strategy, seed=s, span_min=1.0) for n in fast for s in seeds],
            )


def twins(name: str, ratio: float, seed: int) -> tuple[str, ...]:
    """Effects of the spherical robot that cannot be told from one: which, fitted to what it does at as many places as
    the budget has readings, leave less of it than the noise must tell."""
    warnings.simplefilter("ignore")
    world = DrivenSpherical(seed, (name,), ratio)
    sigma, world.noise = world.noise, 0.0
    joints = sk.Adaptive(world.robot, budget=BUDGET).region.anywhere(BUDGET, np.random.default_rng([seed, 6])).joints
    rows = [
        {"pose": k + 1, "repeat": 1, **dict(zip(world.joints, q.tolist(), strict=True))} for k, q in enumerate(joints)
    ]
    data = sk.from_frame(world.read(rows))
    out = []
    for other in HIDDEN["spherical"]:
        try:
            left = sk.identify(world.robot, data, effects=(other,)).residuals
        except sk.errors.SherkitError:  # it asks for what is not recorded, or for a period
            continue
        if float(np.nansum(np.square(left / sigma))) < 2.0 * np.log(1e4) and other != name:
            out.append(other)
    return tuple(out)


def main() -> None:
    """Runs the parts and prints the table."""
    every = ("delta", "spherical", "arm", "pairs", "unknown", "nothing", "strategies")
    reader = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    reader.add_argument("parts", nargs="*", choices=[*every, "twins", []], default=[])
    reader.add_argument("--seeds", type=int, default=10)
    reader.add_argument("--from", dest="first", type=int, default=0)
    reader.add_argument("--workers", type=int, default=2)
    asked = reader.parse_args()
    print("| hidden | loops | right | wrong names | readings: median, 95 % | minutes: the same | look, s | held |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    with processes(asked.workers) as pool:
        for name, cases in parts(asked.parts or every, range(asked.first, asked.first + asked.seeds)):
            outcomes = [one for one in pool.map(run, cases) if one is not None]
            if outcomes:
                print(line(name, outcomes), flush=True)
            for one in outcomes:
                if not one.right:
                    print(f"    {one.case}: {one.readings} readings, {one.told}", file=sys.stderr, flush=True)
    if "twins" in asked.parts:
        for ratio in RATIOS:
            for name in (n for n in HIDDEN["spherical"] if n not in IN_TIME):
                print(f"{name}, {ratio:g} ×: {', '.join(twins(name, ratio, asked.first)) or 'none'}", flush=True)


if __name__ == "__main__":
    main()
