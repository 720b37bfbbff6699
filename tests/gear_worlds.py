"""Arms with gears that are not round, written apart: six joints by their frames, a period for each gear.

``python tests/gear_worlds.py [WORLDS] [CASE] [SEED]`` counts how often the ripple is named with its periods, and how
often where there is none. Nothing of sherkit makes the readings.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

import sherkit as sk
from sherkit.model.kinds import robot_from_tables

NOISE_MM = 0.02
ROWS, REPEATS = 212, 3
#: Distance (mm) of each joint's frame behind the one before it, and its axis there: a shop's arm, all frames parallel.
SHIFTS = np.array(
    [[0.0, 0, 450], [150, 0, 0], [0, 0, 600], [100, 0, 200], [450, 0, 0], [100, 0, 0]], dtype=float
)  # fmt: skip
AXES = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]], dtype=float)
TOOL = np.array([120.0, 40.0, -60.0])
#: Where the joints go, rad.
LOW = np.array([-1.2, -0.6, -0.9, -1.8, -1.3, -2.4])
HIGH = np.array([1.2, 0.8, 0.7, 1.8, 1.3, 2.4])
TURN = 2 * np.pi


@dataclass(frozen=True)
class World:
    """A run of an arm: ``joints`` (n, 6) and what a tracker read (n, 3) there; ``per_turn`` by the joint, from one, and
    by what part of the first wave there is a ``second`` in each period."""

    joints: np.ndarray
    read: np.ndarray
    per_turn: dict[int, float]
    second: float = 0.0


def turned(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Turns (n, 3, 3) about an axis by angles (n,)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    by_sin = np.sin(angle)[:, None, None] * cross
    return np.eye(3) + by_sin + (1 - np.cos(angle))[:, None, None] * (cross @ cross)


def tips(joints: np.ndarray, shifts: np.ndarray, axes: np.ndarray, tool: np.ndarray) -> np.ndarray:
    """Where the tool is (n, 3)."""
    turn, at = np.tile(np.eye(3), (len(joints), 1, 1)), np.zeros((len(joints), 3))
    for k in range(6):
        at = at + turn @ shifts[k]
        turn = turn @ turned(axes[k], joints[:, k])
    return at + turn @ tool


def world(
    seed: int, rippling: int, noises: float = 2.0, *, whole: bool = True, rows: int = ROWS, second: float = 0.0
) -> World:
    """An arm that is a little off its drawing, with ripple of so many gears: together so many ``noises`` at the tip,
    and a second wave in each period besides."""
    rng = np.random.default_rng([seed, rippling])
    joints = rng.uniform(LOW, HIGH, (rows, 6))
    shifts = SHIFTS + rng.normal(0, 0.3, SHIFTS.shape)
    axes = AXES + rng.normal(0, 1e-3, AXES.shape)
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    tool = TOOL + rng.normal(0, 0.3, 3)
    really = joints + rng.normal(0, 1e-3, 6)
    per_turn: dict[int, float] = {}
    for k in sorted(rng.choice(6, rippling, replace=False).tolist()):
        ratio = float(rng.integers(30, 251)) if whole else float(rng.uniform(30, 250))
        # as much at the tip for each, root of the mean square
        step = np.zeros(6)
        step[k] = 1e-5
        lever = np.linalg.norm(
            tips(joints + step, SHIFTS, AXES, TOOL) - tips(joints - step, SHIFTS, AXES, TOOL), axis=1
        )
        lever = float(np.sqrt((lever**2).mean())) / 2e-5
        size = noises * NOISE_MM / np.sqrt(rippling) / lever
        really[:, k] += np.sqrt(2.0) * size * np.sin(ratio * joints[:, k] + rng.uniform(0, TURN))
        if second:
            really[:, k] += np.sqrt(2.0) * second * size * np.sin(2 * ratio * joints[:, k] + rng.uniform(0, TURN))
        per_turn[k + 1] = ratio
    read = np.repeat(tips(really, shifts, axes, tool), REPEATS, axis=0)
    return World(np.repeat(joints, REPEATS, axis=0), read + rng.normal(0, NOISE_MM, read.shape), per_turn, second)


def drawing() -> dict[str, Any]:
    """The arm's file."""
    joints = []
    for k in range(6):
        low, high = np.rad2deg([LOW[k], HIGH[k]])
        joints.append({
            "name": f"J{k + 1}", "type": "revolute", "origin_mm": SHIFTS[k].tolist(), "rpy_deg": [0.0, 0.0, 0.0],
            "axis": AXES[k].tolist(), "limits_deg": [float(low) - 5, float(high) + 5],
        })  # fmt: skip
    return {"kind": "serial", "joint": joints, "tool": {"target_mm": TOOL.tolist(), "rpy_deg": [0.0, 0.0, 0.0]}}


def robot_of(tables: dict[str, Any] | None = None) -> Any:
    """The arm as sherkit reads it."""
    return robot_from_tables(drawing() if tables is None else tables, "arm.toml")


def run_of(made: World) -> sk.Measurements:
    """The run as sherkit reads it."""
    columns = dict(zip(robot_of().layout.joints, made.joints.T, strict=True))
    columns |= dict(zip(("x_mm", "y_mm", "z_mm"), made.read.T, strict=True))
    return sk.from_frame(pl.DataFrame(columns | {"pose": np.repeat(np.arange(len(made.read) // REPEATS) + 1, REPEATS)}))


def asked(made: World) -> tuple[dict[int, float], bool, list[str]]:
    """What a diagnosis says: gears with their ripples a turn, whether it names it, and what else."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = sk.diagnose(robot_of(), run_of(made))
    names = [*found.effects]
    found_periods: dict[int, float] = {}
    if "encoder_cyclic" in names:
        at = found.fit.model.period_rad
        each = at if isinstance(at, tuple) else (at,) * 6
        own = found.fit.model.owns(found.fit.model.known_effects["encoder_cyclic"])
        waves, std = (v[own].reshape(-1, 2) for v in (found.fit.values, found.fit.std))
        size = np.hypot(*waves.T) / np.hypot(*std.T)
        found_periods = {k + 1: TURN / each[k] for k in range(6) if size[k] > 3.0}
    return found_periods, "encoder_cyclic" in names, [*names, *found.notes]


def is_right(made: World, found: dict[int, float]) -> bool:
    """Whether each gear that ripples is said with its period within one percent."""
    return all(abs(found.get(k, 0.0) / ratio - 1) < 0.01 for k, ratio in made.per_turn.items())


def second_waves(made: World, said: list[str]) -> tuple[int, int]:
    """How many second waves are named of those that there are, and how many of which there are none."""
    named = {int(one.removeprefix("encoder_second_")) for one in said if one.startswith("encoder_second_")}
    there = set(made.per_turn) if made.second else set()
    return len(named & there), len(named - there)


#: Gears that ripple, by how many noises together, whether so often in a whole turn, the part of the second wave, and in
#: how many runs of as many.
CASES = (
    (1, 2.0, True, 0.0, 1),
    (2, 2.0, True, 0.0, 1),
    (4, 2.0, True, 0.0, 1),
    (4, 1.0, True, 0.0, 1),
    (4, 2.0, False, 0.0, 1),
    (1, 2.0, True, 0.4, 1),
    (2, 2.0, True, 0.4, 1),
    (4, 2.0, True, 0.4, 1),
    (0, 0.0, True, 0.0, 2),
)


if __name__ == "__main__":
    count, case, first = (int(given) for given in (*sys.argv[1:], *("20", "0", "0")[len(sys.argv) - 1 :]))
    for gears, noises, whole, second, times in CASES[case:]:
        right = named = waves = wrong = 0
        for seed in range(first, first + times * count):
            made = world(seed, gears, noises, whole=whole, second=second)
            found, is_named, said = asked(made)
            named, right = named + is_named, right + (is_named and is_right(made, found))
            there, none = second_waves(made, said)
            waves, wrong = waves + there, wrong + none
            if none or (is_named and not is_right(made, found)):
                print(seed, made.per_turn, *said, sep="\n    ")
        how = f"{gears} gears, {noises} noises, {'' if whole else 'not '}whole in a turn, second wave {second}"
        print(
            f"{how}: named {named}, right {right} of {times * count}; of {gears * times * count} second waves "
            f"{waves if second else 0}, where none is {wrong}",
            flush=True,
        )
