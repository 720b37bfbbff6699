"""Tables in which nothing is wrong, of all robots, as people take them: coarse grids, planes, short runs, runs in the
order of their poses, a room that never changes, few digits, large physics; and the real ones."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import polars as pl

import mistakes
import sherkit as sk
import worlds
from second_machines import MACHINES, apart, run_of
from second_printer.trials import FAULTS, Trial
from second_simulator import grid
from sherkit.robots.printer import import_klipper
from test_arm_counted import OwnArm, arm_in
from test_telescope import DATA, mount

Tables = Iterator[tuple[str, sk.Measurements]]
#: A run as it was taken, and what may be different about it without anything being wrong.
ORDERS = ("planes", "repeats_together", "shuffled")
GRIDS = {
    "coarse": grid(18.0, 3, (-15.0, 0.0, 15.0)),
    "plane": grid(20.0, 7, (0.0,)),
    "upright plane": grid(20.0, 6, (-20.0, -10.0, 0.0, 10.0, 20.0))[:, [2, 0, 1]] * [0.0, 1.0, 1.0],
    "whole": worlds.GRID,
    "few": grid(20.0, 3, (-10.0, 10.0)),
}


def as_table(columns: worlds.Columns, digits: int | None = None) -> sk.Measurements:
    """As from a file with so many digits behind the point."""
    frame = pl.DataFrame(columns)
    if digits is not None:
        frame = frame.with_columns(
            pl.col(name).round(digits) for name in frame.columns if name.endswith(("_mm", "_px"))
        )
    return sk.from_frame(frame)


def deltas(seeds: range) -> Tables:
    """By the second simulator: grids, orders, physics up to 30 times the noise, digits, temperatures."""
    for seed in seeds:
        rng = np.random.default_rng([seed, 40])
        for name, points in GRIDS.items():
            order = ORDERS[(seed + len(name)) % 3]
            planted = {str(rng.choice(["rail_lean", "backlash", "drift", "thermal_growth"])): 60.0} if seed % 2 else {}
            world = worlds.delta_world(seed, planted, points=points, repeats=1 + seed % 3, order=order)
            columns = dict(world.columns)
            if seed % 4 == 1:
                columns["temperature_c"] = np.full(len(columns["pose"]), 20.0)
            if seed % 4 == 2:
                # a rig that is counted in raw units as well
                columns["counts_1"] = np.round(columns["q1_mm"] * 1000.0)
            yield f"delta {name} {order} {seed}", as_table(columns, (None, 6, 4, 3, 2)[seed % 5])


def randoms(seeds: range) -> Tables:
    """The robots on which mistakes are made, as they are without one."""
    for kind, (made, _) in mistakes.MISTAKES.items():
        for seed in seeds:
            yield f"{kind} {seed}", as_table(mistakes.file_of(made(seed)).columns, (None, 5)[seed % 2])


def machines(seeds: range) -> Tables:
    """Machines that a user describes: at random places, and driven along one axis after another."""
    with apart():
        for name, (_, joints, readings, _) in MACHINES.items():
            layout = sk.data.columns.Layout(tuple(joints), readings, "µm", 1e3)
            for seed in seeds:
                frame = run_of(name, seed, poses=40 + 30 * (seed % 4), repeats=1 + seed % 3)
                if seed % 3 == 2:
                    frame = frame.sort("pose", "time_s")
                columns = {one: frame[one].to_numpy() for one in frame.columns}
                yield f"{name} {seed}", sk.Measurements.from_columns(columns, name, layout=layout)


def arms(seeds: range) -> Tables:
    """A UR5 before a tracker, with the package's own postures."""
    with tempfile.TemporaryDirectory() as folder:
        arm = arm_in(Path(folder))
        for seed in seeds:
            joints = sk.robots.serial.postures(arm, 30 + 40 * (seed % 4), 0.4 + 0.5 * (seed % 2), seed)
            yield f"ur5 {seed}", OwnArm.made(seed).run(arm, np.tile(joints, (1 + seed % 3, 1)), seed, False)


def printers(seeds: range) -> Tables:
    """Probed beds, with a fault and without."""
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            fault = list(FAULTS)[seed % len(FAULTS)]
            (path,) = Trial.of(fault, 3, seed).write(Path(folder), "klipper", (0.0, 90.0)[: 1 + seed % 2], seed)
            yield f"printer {fault} {seed}", import_klipper(path).measurements


def real() -> Tables:
    """Telescopes and a printer that stand somewhere."""
    for file, read in ((mount.GEM, mount.read_gem), (mount.MMT, mount.read_mmt)):
        for name in sorted(pl.read_csv(DATA / file)["file"].unique()):
            yield name, read(DATA / file, name)
    yield "flsun", import_klipper(DATA / "delta_flsun_v400_b" / "printer.cfg").measurements


#: Where tables come from, and how many each gives of so many seeds.
SOURCES: dict[str, Callable[[range], Tables]] = {
    "deltas": deltas, "randoms": randoms, "machines": machines, "arms": arms, "printers": printers,
}  # fmt: skip
