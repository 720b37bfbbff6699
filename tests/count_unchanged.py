"""Counts how often a machine that did not change is said to have changed, where its model lacks something.

    python tests/count_unchanged.py --worlds 34

prints for each kind of machine (delta, arm, machine of one's own) how many comparisons of a run with itself, with a
second run at the same places and with one at other places were *changed*. What each lacks is drawn anew: a ripple over
joints, gear errors of harmonics that no effect is, a bow of an axis. Shares no code with what it counts but the door.
"""

from __future__ import annotations

import argparse
from collections import Counter
from typing import Any

import numpy as np

import sherkit as sk
from changed_worlds import somewhere
from incomplete_worlds import GearErrors, RippledDelta, small_arm

Run = dict[str, Any]


def of_arm(seed: int) -> tuple[Any, Run, Run, Run]:
    """The arm before its tracker: a run, the same postures again, and postures on the other side of the table."""
    world = GearErrors(seed)
    postures = world.postures("left", 60)
    return small_arm(), world.run(postures), world.run(postures), world.run(world.postures("right", 60))


def of_delta(seed: int) -> tuple[Any, Run, Run, Run]:
    """A delta with a ripple: a run, one at the same places, one elsewhere."""
    pair = RippledDelta(seed)
    places = somewhere(np.random.default_rng([seed, 21]), 60)
    again = RippledDelta(seed, places=[dict(zip(("x_mm", "y_mm", "z_mm"), at, strict=True)) for at in places])
    return pair.robot, pair.runs[0], again.runs[1], pair.runs[1]


def of_machine(seed: int) -> tuple[Any, Run, Run, Run]:
    """A gantry of two axes whose model lacks a bow of one and a wave of the other."""
    rng = np.random.default_rng(seed)
    bow, wave, period, turn = rng.normal(0, 2e-7), rng.normal(0, 0.01), rng.uniform(7, 40), rng.uniform(0, 6.28)
    scale, square = rng.normal(0, 1e-4, 2)

    def run(low: float, high: float) -> Run:
        q = np.repeat(rng.uniform(low, high, (40, 2)), 3, axis=0)
        x = q[:, 0] * (1 + scale) + square * q[:, 1] + wave * np.sin(2 * np.pi * q[:, 1] / period + turn)
        y = q[:, 1] + bow * (q[:, 0] - 200.0) ** 2
        return {
            "pose": np.repeat(np.arange(40), 3), "a_mm": q[:, 0], "b_mm": q[:, 1],
            "x_mm": x + rng.normal(0, 1e-3, len(q)), "y_mm": y + rng.normal(0, 1e-3, len(q)),
        }  # fmt: skip

    machine = sk.Machine(
        lambda q, p: np.column_stack([q[:, 0] * (1 + p.scale) + p.square * q[:, 1] + p.x, q[:, 1] + p.y]),
        joints=("a_mm", "b_mm"), readings=("x_mm", "y_mm"), name="gantry",
        parameters={"scale": ("1", 1e-3), "square": ("rad", 1e-3), "x": ("mm", 1.0), "y": ("mm", 1.0)},
    )  # fmt: skip
    return machine, run(0.0, 200.0), run(0.0, 200.0), run(200.0, 400.0)


KINDS = {"delta": of_delta, "arm": of_arm, "machine": of_machine}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=10)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=list(KINDS))
    parser.add_argument("--only", nargs="*", choices=("itself", "again", "elsewhere"), default=None)
    given = parser.parse_args()
    for kind in given.kinds:
        found: dict[str, Counter[str]] = {}
        for seed in range(given.first, given.first + given.worlds):
            robot, run, again, elsewhere = KINDS[kind](seed)
            for what, other in (("itself", run), ("again", again), ("elsewhere", elsewhere)):
                if given.only and what not in given.only:
                    continue
                one = sk.compare(robot, [run, other])
                found.setdefault(what, Counter())[one.verdict] += 1
                if one.verdict == "changed":
                    print(f"  {kind} {seed} {what}: {', '.join(one.changed)}", flush=True)
        for what, counted in found.items():
            print(
                f"{kind}, {what}: {', '.join(f'{n} {verdict}' for verdict, n in sorted(counted.items()))}", flush=True
            )


if __name__ == "__main__":
    main()
