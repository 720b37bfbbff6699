"""Runs as people bring them: a joint that stands still or only jitters, units at random, columns that never change,
columns of text, few rows, one pose, readings that never change, rows in any order.

PYTHONPATH=python python tests/odd_runs.py [--runs 1000] [--first 0]
"""

from __future__ import annotations

import argparse
import json
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import polars as pl

import sherkit as sk
from conventions import written_otherwise
from sherkit.model.kinds import kind_of
from sherkit.model.robot_file import run_for
from standing_worlds import STILL, WORLDS

Columns = dict[str, Any]
Odd = Callable[[Columns, list[str], np.random.Generator], Columns]

#: rad or mm, as encoders of a joint that is held show it.
JITTER = 1e-4


def still(columns: Columns, joints: list[str], rng: np.random.Generator) -> Columns:
    """As it is: of these worlds every one has a joint that stands still."""
    return columns


def jitters(columns: Columns, joints: list[str], rng: np.random.Generator) -> Columns:
    """The joint that stands still is read with its noise."""
    name = min(joints, key=lambda one: float(np.ptp(columns[one])))
    return columns | {name: columns[name] + JITTER * rng.normal(size=len(columns[name]))}


def frozen(columns: Columns, joints: list[str], rng: np.random.Generator) -> Columns:
    """What writes the joints stopped."""
    return columns | {name: np.full(len(columns[name]), columns[name][0]) for name in joints}


def few(columns: Columns, joints: list[str], rng: np.random.Generator) -> Columns:
    """The first rows."""
    count = int(rng.integers(1, 40))
    return {name: values[:count] for name, values in columns.items()}


def one_pose(columns: Columns, joints: list[str], rng: np.random.Generator) -> Columns:
    """The first row again and again, readings with their noise."""
    scatter = {name: 1e-3 * rng.normal(size=30) for name in columns if name.startswith(("x_", "y_", "z_", "u_", "v_"))}
    return {name: np.repeat(values[:1], 30) + scatter.get(name, 0.0) for name, values in columns.items()}


def held_reading(columns: Columns, joints: list[str], rng: np.random.Generator) -> Columns:
    """A reading that never changes."""
    some = [name for name in columns if name.startswith(("x_", "y_", "z_", "u_", "v_"))]
    return columns | {some[-1]: np.full(len(columns[some[-1]]), columns[some[-1]][0])}


def without_times(columns: Columns, joints: list[str], rng: np.random.Generator) -> Columns:
    """No time, no numbers of poses."""
    return {name: values for name, values in columns.items() if name not in ("time_s", "pose", "repeat")}


def rounded(columns: Columns, joints: list[str], rng: np.random.Generator) -> Columns:
    """Readings of few digits."""
    digits = int(rng.integers(0, 3))
    some = [name for name in columns if name.startswith(("x_", "y_", "z_", "u_", "v_"))]
    return columns | {name: np.round(columns[name], digits) for name in some}


def sorted_by_joint(columns: Columns, joints: list[str], rng: np.random.Generator) -> Columns:
    """Rows sorted by a joint, as a spreadsheet does it."""
    order = np.argsort(columns[joints[0]], kind="stable")
    return {name: np.asarray(values)[order] for name, values in columns.items()}


ODD: tuple[Odd, ...] = (
    still, jitters, frozen, few, one_pose, held_reading, without_times, rounded, sorted_by_joint,
)  # fmt: skip


def asked(number: int) -> tuple[str, str]:
    """What is odd about a run, and what is said: a verdict, the first words of a refusal, or all of a traceback."""
    names = list(WORLDS)
    make, odd = WORLDS[names[number % len(names)]], ODD[number // len(names) % len(ODD)]
    # numbers of worlds in which a joint stands still
    world = make(4 * (STILL * (number // len(names)) + STILL - 1) + number % 4)
    rng = np.random.default_rng([number, 55])
    joints = [name for name in kind_of(world.robot).layout.joints if name in world.columns()]

    def run(ask: int) -> sk.Measurements:
        columns = odd(dict(world.columns(ask=ask)), joints, np.random.default_rng([number, ask]))
        n = len(next(iter(columns.values())))
        columns["payload_kg"] = np.zeros(n)
        if rng.random() < 0.5:
            columns["temperature_c"] = np.full(n, 21.0)
        table, called = written_otherwise(columns, number)
        table = table.with_columns(pl.Series("operator", rng.choice(["Anna", "Bo"], size=n)))
        return run_for(world.robot, sk.from_frame(table, columns=called))

    with warnings.catch_warnings():
        # NumPy must not warn either
        warnings.simplefilter("ignore", sk.SherkitWarning)
        warnings.simplefilter("error", RuntimeWarning)
        try:
            found = sk.diagnose(world.robot, run(0))
            said = found.verdict
            text = f"{found}{found.headline}{json.dumps(found.to_json(), allow_nan=False)}"
            if number % 5 == 0:
                compared = sk.compare(world.robot, [run(0), run(1)])
                said = f"{said}, compare {compared.verdict}"
                text += f"{compared}{json.dumps(compared.to_json(), allow_nan=False)}"
            if any(word in text.split() for word in ("nan", "inf")):
                return odd.__name__, f"FAULT {number}: nan or inf in {text[:200]}"
        except sk.SherkitError as error:
            return odd.__name__, f"refused: {type(error).__name__}"
        except Exception:
            return odd.__name__, f"FAULT {number}: {traceback.format_exc()}"
    return odd.__name__, said


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    counts: Counter[tuple[str, str]] = Counter()
    for number in range(given.first, given.first + given.runs):
        odd, said = asked(number)
        if said.startswith("FAULT"):
            print(said, flush=True)
            said = "FAULT"
        counts[odd, said] += 1
    for (odd, said), count in sorted(counts.items()):
        print(f"{odd:18s} {count:5d}  {said}")


if __name__ == "__main__":
    main()
