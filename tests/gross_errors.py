"""Poses that are wrong in all their repeats: what a robust fit by rows cannot see, since the repeats agree."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from worlds import Floats, World, clean, spherical_clean

SHARES = (0.01, 0.05, 0.10)
SIZES = (5.0, 20.0, 100.0, 1000.0)
KINDS = ("scattered", "block", "wrong index")
READINGS = {"delta": ("x_mm", "y_mm", "z_mm"), "spherical": ("u_px", "v_px")}
#: Noise in the unit of the file: µm are read by people, mm stand in the file.
PER_UNIT = {"delta": 1e-3, "spherical": 1.0}


@dataclass(frozen=True, eq=False)
class Spoiled:
    """A world in which ``poses`` are wrong, and the same one without that."""

    world: World
    clean: World
    poses: frozenset[int]
    name: str

    @property
    def marked(self) -> World:
        """The clean world without these poses, as a person marks them who knows: nobody can do better."""
        wrong = np.isin(self.clean.columns["pose"], list(self.poses)).astype(np.int64)
        return replace(self.clean, columns=self.clean.columns | {"outlier": wrong})


def shift(world: World, poses: Floats, by: Floats) -> World:
    """The world with ``by`` (k, m), unit of the file, added to the readings of each of the ``poses`` (k,)."""
    columns = dict(world.columns)
    for axis, name in enumerate(READINGS[world.settings["kind"]]):
        columns[name] = columns[name].copy()
        for pose, vector in zip(poses, by, strict=True):
            columns[name][columns["pose"] == pose] += vector[axis]
    return replace(world, columns=columns)


def directions(rng: np.random.Generator, count: int, axes: int) -> Floats:
    """Random unit vectors (count, axes)."""
    v = rng.normal(size=(count, axes))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def scattered(world: World, share: float, size: float, seed: int) -> Spoiled:
    """Poses here and there, each off in a direction of its own by ``size`` times the noise (a cube was knocked)."""
    rng = np.random.default_rng([seed, 10])
    every = np.unique(world.columns["pose"])
    poses = rng.choice(every, max(1, round(share * len(every))), replace=False)
    kind = world.settings["kind"]
    by = size * world.noise * PER_UNIT[kind] * directions(rng, len(poses), len(READINGS[kind]))
    return Spoiled(shift(world, poses, by), world, frozenset(poses.tolist()), "scattered")


def block(world: World, share: float, size: float, seed: int) -> Spoiled:
    """Poses that follow one another in the plan, all off by the same (the stage was bumped and put back)."""
    rng = np.random.default_rng([seed, 11])
    every = np.unique(world.columns["pose"])
    count = max(1, round(share * len(every)))
    start = int(rng.integers(0, len(every) - count + 1))
    poses = every[start : start + count]
    kind = world.settings["kind"]
    by = size * world.noise * PER_UNIT[kind] * directions(rng, 1, len(READINGS[kind]))
    return Spoiled(shift(world, poses, np.repeat(by, count, axis=0)), world, frozenset(poses.tolist()), "block")


def wrong_index(world: World, share: float, seed: int) -> Spoiled:
    """Readings that were written beside the joints of another pose: some poses change places all round.

    How far they are off is what lies between the poses, thousands of times the noise.
    """
    rng = np.random.default_rng([seed, 12])
    every = np.unique(world.columns["pose"])
    poses = rng.choice(every, max(2, round(share * len(every))), replace=False)
    columns = {name: values.copy() for name, values in world.columns.items()}
    for pose, other in zip(poses, np.roll(poses, 1), strict=True):
        here = np.flatnonzero(world.columns["pose"] == pose)
        there = np.flatnonzero(world.columns["pose"] == other)
        for name in READINGS[world.settings["kind"]]:
            columns[name][here] = world.columns[name][there[: len(here)]]
    return Spoiled(replace(world, columns=columns), world, frozenset(poses.tolist()), "wrong index")


def far_away(world: World, seed: int) -> Spoiled:
    """One pose off by metres, or by thousands of pixels."""
    spoiled = scattered(world, 0.0, 3e6 / (world.noise if world.settings["kind"] == "delta" else 1e3), seed)
    return replace(spoiled, name="one, far away")


def every_error(kind: str, seeds: range) -> Iterator[tuple[str, Spoiled]]:
    """All sorts of gross errors on one kind of robot, with a label for a table; each seed is another run."""
    make = {"delta": clean, "spherical": spherical_clean}[kind]
    for seed in seeds:
        world = make(seed)
        yield "one, far away", far_away(world, seed)
        for share in SHARES:
            yield f"wrong index {share:.0%}", wrong_index(world, share, seed)
            for size, spoil in product(SIZES, (scattered, block)):
                yield f"{spoil.__name__} {share:.0%} × {size:g}", spoil(world, share, size, seed)


def poses_listed(world: World, outliers: Floats) -> frozenset[int]:
    """Poses of which at least half of the rows are listed as outliers."""
    pose = world.columns["pose"]
    listed = np.zeros(len(pose), dtype=bool)
    listed[outliers] = True
    return frozenset(int(p) for p in np.unique(pose) if listed[pose == p].mean() >= 0.5)
