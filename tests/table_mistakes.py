"""Mistakes that a table shows before a model is fitted to it, on robots of all sorts: five for each rule, and what a
right answer says.

A run is clean, or has physics in it that nobody may blame for the mistake; the changes know columns by what they are
(joints, readings), not by their names.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

import mistakes
import sherkit as sk
import worlds
from second_machines import MACHINES, Hidden, run_of, seen_from, stand_of, zeros_of
from second_simulator.spherical import spherical_plan
from sherkit.robots.machine import load_machine
from test_arm_counted import NOISE_MM, OwnArm, arm_in
from worlds import Answer, Columns, Floats

Words = tuple[tuple[str, ...], ...]


@dataclass(frozen=True, eq=False)
class Run:
    """``columns`` of a run of a ``robot``, whose ``joints`` and ``readings`` have these names; ``noise`` is the sd of a
    reading in the unit that people read, of which a unit of the file has ``per_unit``. ``line`` measures along a
    direction instead."""

    robot: Any
    columns: Columns
    joints: tuple[str, ...]
    readings: tuple[str, ...]
    noise: float
    per_unit: float
    line: Callable[[Floats], Columns] | None = None

    @property
    def sigma(self) -> float:
        """The noise in the unit of the file."""
        return self.noise / self.per_unit

    def __len__(self) -> int:
        return len(self.columns[self.joints[0]])

    def with_columns(self, **columns: Any) -> Run:
        return replace(self, columns=self.columns | columns)

    def rows(self, which: Any) -> Run:
        return replace(self, columns={k: v[which] for k, v in self.columns.items()})

    def ask(self) -> Answer:
        """What a person hears who has this table."""
        return worlds.heard(lambda: sk.diagnose(self.robot, pl.DataFrame(self.columns)))


# -- robots --------------------------------------------------------------------------------------------------------


def _of_world(world: worlds.World, kind: str, per_unit: float, line: Callable[[Floats], worlds.World]) -> Run:
    joints = mistakes.JOINTS["delta" if kind == "delta" else "spherical"]
    readings = mistakes.READINGS.get(kind, ("phi_rad", "gamma_rad"))

    def bare(world: worlds.World) -> Columns:
        return {k: v for k, v in mistakes.file_of(world).columns.items() if not k.startswith("sigma_")}

    return Run(world.robot, bare(world), joints, readings, world.noise, per_unit, lambda way: bare(line(way)))


def delta(seed: int) -> Run:
    def line(way: Floats) -> worlds.World:
        points = np.linspace(-15.0, 15.0, 40)[:, None] * way
        return worlds.delta_world(
            seed, points=points, noise_um=1e3 * mistakes.SIGMA_MM, config=mistakes.random_delta(seed)
        )

    return _of_world(mistakes.delta_run(seed), "delta", 1e3, line)


def spherical(seed: int) -> Run:
    settings = mistakes.random_spherical(seed)

    def line(way: Floats) -> worlds.World:
        robot, patch = worlds.real_spherical(settings, seed), worlds.spherical_joints(settings, 9)
        joints = patch.mean(axis=0) + np.linspace(-0.2, 0.2, 40)[:, None] * way[:2]
        plan = spherical_plan(joints, 3, "shuffled", seed)
        columns = robot.run(plan, noise_px=worlds.NOISE_PX, seed=seed)
        return worlds.World(settings, columns, worlds.NOISE_PX)

    return _of_world(mistakes.spherical_run(seed), "spherical", 1.0, line)


@cache
def ur5() -> Any:
    with tempfile.TemporaryDirectory() as folder:
        return arm_in(Path(folder))


def arm(seed: int) -> Run:
    """A UR5 before a tracker, 90 postures, twice each, in another order the second time."""
    rng, robot = np.random.default_rng([seed, 50]), ur5()
    postures = sk.robots.serial.postures(robot, 90, 0.9, seed)
    pose = np.concatenate([rng.permutation(90) for _ in range(2)])
    frame = OwnArm.made(seed).run(robot, postures[pose], seed, False).to_frame()
    columns = {name: frame[name].to_numpy() for name in frame.columns} | {"pose": pose + 1}
    columns["time_s"] = np.cumsum(rng.uniform(3.0, 5.0, len(pose)))
    return Run(robot, columns, robot.layout.joints, robot.layout.coordinates, 1e3 * NOISE_MM, 1e3)


@cache
def _gantry() -> Any:
    return load_machine(Path(__file__).parents[1] / "examples" / "machines" / "gantry.py")


def gantry(seed: int) -> Run:
    """A machine that a user describes, its rows as they were read: mistakes are made in that order."""
    true, joints, readings, noise = MACHINES["gantry"]
    frame = run_of("gantry", seed, in_order=True)
    columns = {name: frame[name].to_numpy() for name in frame.columns}
    columns["time_s"] = np.cumsum(np.random.default_rng([seed, 51]).uniform(8.0, 12.0, len(frame)))

    def line(way: Floats) -> Columns:
        rng = np.random.default_rng([seed, 52])
        q = np.array([200.0, 150.0, 100.0]) + np.linspace(-60.0, 60.0, 40)[:, None] * way
        places = [true(row, np.ones(3), 0.0, 0.0, Hidden()) for row in q + zeros_of("gantry", seed)]
        seen = seen_from(stand_of(seed), np.array(places)) + noise * rng.normal(size=(40, 3))
        return dict(zip((*joints, *readings), [*q.T, *seen.T], strict=True))

    return Run(_gantry(), columns, tuple(joints), readings, 1e3 * noise, 1e3, line)


ROBOTS: dict[str, Callable[[int], Run]] = {"delta": delta, "spherical": spherical, "arm": arm, "gantry": gantry}


# -- mistakes ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Slip:
    """``change`` makes the mistake with a generator; ``words`` are those of a right answer, ``{0}`` and ``{-1}`` in
    them readings, ``{j0}`` and ``{j1}`` joints."""

    rule: str
    name: str
    words: Words
    change: Callable[[Run, np.random.Generator], Run]
    #: An honest run may look the same: it is said beside the verdict, and decides nothing.
    undecidable: bool = False

    def words_for(self, run: Run) -> Words:
        names = {"0": run.readings[0], "1": run.readings[1], "-1": run.readings[-1]}
        names |= {"j0": run.joints[0], "j1": run.joints[1]}
        out = []
        for group in self.words:
            words = []
            for word in group:
                for key, name in names.items():
                    word = word.replace(f"{{{key}}}", name)
                words.append(word)
            out.append(tuple(words))
        return tuple(out)


SAME = ("same as", "times")
LOST = ("lost", "elsewhere")


def _set(name: Callable[[Run], str], values: Callable[[Run, np.random.Generator], Any]) -> Any:
    return lambda run, rng: run.with_columns(**{name(run): values(run, rng)})


def _some(run: Run, rng: np.random.Generator, share: float) -> Any:
    return rng.random(len(run)) < share


def _lost(k: slice, value: float, share: float) -> Any:
    def change(run: Run, rng: np.random.Generator) -> Run:
        where = _some(run, rng, share)
        return run.with_columns(**{n: np.where(where, value, run.columns[n]) for n in run.readings[k]})

    return change


def _clipped(low: float, high: float) -> Any:
    def change(run: Run, _: np.random.Generator) -> Run:
        values = run.columns[run.readings[0]]
        return run.with_columns(**{run.readings[0]: np.clip(values, *np.quantile(values, [low, high]))})

    return change


def _stuck(run: Run, rng: np.random.Generator) -> Run:
    first = int(rng.integers(10, len(run) // 2))
    values = run.columns[run.readings[-1]].copy()
    order = np.argsort(run.columns["time_s"])
    values[order[first : first + len(run) // 5]] = values[order[first]]
    return run.with_columns(**{run.readings[-1]: values})


def _again(part: float, *, later: bool) -> Any:
    """A stretch of rows once more at the end."""

    def change(run: Run, rng: np.random.Generator) -> Run:
        n, length = len(run), int(part * len(run))
        first = int(rng.integers(0, n - length))
        out = run.rows(np.concatenate([np.arange(n), np.arange(first, first + length)]))
        drop = ["repeat", *(["time_s"] if later else [])]
        return replace(out, columns={k: v for k, v in out.columns.items() if k not in drop})

    return change


def _averages(part: float, digits: int | None = None, *, first: bool = False) -> Any:
    def change(run: Run, rng: np.random.Generator) -> Run:
        group = np.unique(run.columns["pose"], return_inverse=True)[1]
        there = (rng.random(group.max() + 1) < part)[group]
        out = {}
        for name in run.readings:
            values = run.columns[name]
            if first:
                mean = values[np.unique(group, return_index=True)[1]][group]
            else:
                mean = (np.bincount(group, values) / np.bincount(group))[group]
            out[name] = np.where(there, mean, values)
            if digits is not None:
                out[name] = np.round(out[name], digits)
        return run.with_columns(**out)

    return change


def _cut(which: str, how: Callable[[Floats], Floats], steps: float) -> Any:
    """Digits cut off to steps of so many noises of a reading, or of a joint that moves it by as much."""

    def change(run: Run, _: np.random.Generator) -> Run:
        out, error = {}, 0.0
        for name in run.readings if which == "readings" else run.joints:
            reach = np.ptp(run.columns[run.readings[0]]) / np.ptp(run.columns[name]) if which == "joints" else 1.0
            step = _round_number(steps * run.sigma / reach)
            out[name] = how(run.columns[name] / step) * step
            if which == "readings":
                # of an instrument with these digits that is the error
                error = run.per_unit * step / np.sqrt(12.0)
        return replace(run.with_columns(**out), noise=float(np.hypot(run.noise, error)))

    return change


def _round_number(step: float) -> float:
    power = 10.0 ** np.floor(np.log10(step))
    return float(power * min([1.0, 2.0, 5.0], key=lambda m: abs(np.log(step / power / m))))


def _temperature(change: Callable[[Floats, np.random.Generator], Floats]) -> Any:
    return lambda run, rng: run.with_columns(temperature_c=change(_room(run, rng), rng))


def _room(run: Run, rng: np.random.Generator) -> Floats:
    return np.asarray(run.columns.get("temperature_c", 20.0 + 0.3 * rng.normal(size=len(run))), dtype=float)


def _declared(factor: float, *columns: int) -> Any:
    def change(run: Run, _: np.random.Generator) -> Run:
        names = run.readings if not columns else [run.readings[k] for k in columns]
        sigma = {f"sigma_{n}": np.full(len(run), run.sigma) for n in run.readings}
        return run.with_columns(**sigma).with_columns(**{f"sigma_{n}": factor * sigma[f"sigma_{n}"] for n in names})

    return change


def _sorted(key: Callable[[Run], tuple[str, ...]], *, even: bool, back: bool = False) -> Any:
    """Sorted by columns, with times written anew."""

    def change(run: Run, rng: np.random.Generator) -> Run:
        order = np.lexsort([run.columns[name] for name in reversed(key(run))])
        out = run.rows(order[::-1] if back else order)
        steps = np.full(len(run), 10.0) if even else rng.uniform(8.0, 12.0, len(run))
        return out.with_columns(time_s=np.cumsum(steps))

    return change


def _with_physics(after: Any, physics: str) -> Any:
    """The mistake in a run in which readings drift, or lag behind the motion."""

    def change(run: Run, rng: np.random.Generator) -> Run:
        order = np.argsort(run.columns["time_s"])
        time = run.columns["time_s"] / np.ptp(run.columns["time_s"])
        came = np.empty(len(run))
        came[order] = np.sign(np.diff(run.columns[run.joints[0]][order], prepend=-1e9))
        shift = 6 * run.sigma * (time if physics == "drift" else came)
        name = run.readings[0]
        return after(run.with_columns(**{name: run.columns[name] + shift}), rng)  # type: ignore[no-any-return]

    return change


def _along(x: float, y: float, z: float) -> Any:
    way = np.array([x, y, z])

    def change(run: Run, _: np.random.Generator) -> Run:
        return run if run.line is None else replace(run, columns=run.line(way / np.linalg.norm(way)))

    return change


def _pose(_: Run) -> tuple[str, ...]:
    return ("pose", "time_s")


def _reading(k: int) -> Callable[[Run], tuple[str, ...]]:
    return lambda run: (run.readings[k],)


TIMES = ("written anew",)
SLIPS = [
    Slip("alike", "a reading holds another", (("{1}",), ("{0}",), SAME),
         _set(lambda r: r.readings[1], lambda r, _: r.columns[r.readings[0]])),
    Slip("alike", "a reading in inches of another", (("{-1}",), ("{0}",), SAME),
         _set(lambda r: r.readings[-1], lambda r, _: r.columns[r.readings[0]] / 25.4)),
    Slip("alike", "a joint holds another", (("{j1}",), ("{j0}",), SAME),
         _set(lambda r: r.joints[1], lambda r, _: r.columns[r.joints[0]])),
    Slip("alike", "a reading holds a temperature", (("{0}",), ("temperature_c",), SAME),
         lambda r, g: r.with_columns(temperature_c=(room := _room(r, g)), **{r.readings[0]: room})),
    Slip("alike", "a reading holds a joint", (("{0}",), ("{j0}",), SAME),
         _set(lambda r: r.readings[0], lambda r, _: r.columns[r.joints[0]])),
    Slip("piled", "zeros in a fifth of a reading", (("{0}",), LOST), _lost(slice(0, 1), 0.0, 0.2)),
    Slip("piled", "zeros in a quarter of all readings", (("{0}",), LOST), _lost(slice(None), 0.0, 0.25)),
    Slip("piled", "-999 in a seventh", (("{-1}",), ("-999",), LOST), _lost(slice(-1, None), -999.0, 0.15)),
    Slip("piled", "saturated above", (("{0}",), ("saturated", "clipped")), _clipped(0.0, 0.85)),
    Slip("piled", "saturated below", (("{0}",), ("saturated", "clipped")), _clipped(0.12, 1.0)),
    Slip("piled", "a display that stuck", (("{-1}",), LOST), _stuck),
    Slip("repeats", "a stretch of rows twice", (("copies",), ("earlier",)), _again(0.25, later=False)),
    Slip("repeats", "a stretch twice, no times", (("copies", "equal to the last digit"),), _again(0.3, later=True)),
    Slip("repeats", "averages as repeats", (("repeats",), ("average",)), _averages(1.0)),
    Slip("repeats", "averages of most", (("repeats",), ("average",)), _averages(0.92)),
    Slip("repeats", "the first for each repeat", (("repeats",), ("average", "copies")), _averages(1.0, first=True)),
    Slip("repeats", "averages of five digits", (("repeats",), ("average",)), _averages(1.0, 5)),
    Slip("digits", "readings cut a little towards zero", (("{0}",), ("steps of",), ("cut off",)),
         _cut("readings", np.trunc, 2.5)),
    Slip("digits", "readings cut downwards", (("{0}",), ("steps of",)), _cut("readings", np.floor, 20.0)),
    Slip("digits", "readings cut towards zero", (("{0}",), ("steps of",)), _cut("readings", np.trunc, 20.0)),
    Slip("digits", "readings of few digits", (("{0}",), ("steps of",)), _cut("readings", np.round, 50.0)),
    Slip("digits", "joints cut downwards", (("{j0}",), ("steps of",)), _cut("joints", np.floor, 20.0)),
    Slip("digits", "joints cut towards zero", (("{j0}",), ("steps of",)), _cut("joints", np.trunc, 20.0)),
    Slip("values", "kelvin", (("temperature_c",), ("kelvin",)), _temperature(lambda t, _: t + 273.15)),
    Slip("values", "Fahrenheit", (("temperature_c",), ("Fahrenheit",)), _temperature(lambda t, _: 1.8 * t + 32.0)),
    Slip("values", "a thermometer's zeros", (("temperature_c",), ("lost",)),
         _temperature(lambda t, g: np.where(g.random(len(t)) < 0.1, 0.0, t))),
    Slip("values", "deviations in µm", (("sigma_{0}",), ("unit",)), _declared(1e3)),
    Slip("values", "deviations in metres", (("sigma_{0}",), ("unit",)), _declared(1e-3)),
    Slip("values", "one deviation in µm", (("sigma_{-1}",), ("unit",)), _declared(1e3, -1)),
    Slip("order", "sorted by pose", (TIMES,), _sorted(_pose, even=True), undecidable=True),
    Slip("order", "sorted by a reading", (TIMES,), _sorted(_reading(0), even=False)),
    Slip("order", "sorted downwards", (TIMES,), _sorted(_reading(-1), even=True, back=True)),
    Slip("order", "sorted by pose, drift", (TIMES,), _with_physics(_sorted(_pose, even=True), "drift"),
         undecidable=True),
    Slip("order", "sorted by a reading, lag", (TIMES,), _with_physics(_sorted(_reading(0), even=True), "lag")),
    Slip("order", "sorted by pose, lag", (TIMES,), _with_physics(_sorted(_pose, even=True), "lag"), undecidable=True),
    Slip("places", "a line along x", (("one line",),), _along(1.0, 0.0, 0.0)),
    Slip("places", "a line along y", (("one line",),), _along(0.0, 1.0, 0.0)),
    Slip("places", "a line upwards", (("one line",),), _along(0.05, 0.1, 1.0)),
    Slip("places", "a diagonal", (("one line",),), _along(1.0, 1.0, 0.0)),
    Slip("places", "a line askew", (("one line",),), _along(1.0, -0.6, 0.4)),
]  # fmt: skip


# -- outcomes ------------------------------------------------------------------------------------------------------


def outcome(slip: Slip, run: Run, seed: int) -> tuple[str, str]:
    """How a mistake was answered, in a word, and the answer in short.

    A ``lie`` explains by physics, or praises where the error held out is not that of the instrument; ``accused`` names
    an effect as a part; ``named`` says what was done wrong; ``honest`` says that something is wrong or open, and not
    what; ``harmless`` is praise that is true.
    """
    wrong = slip.change(run, np.random.default_rng([seed, 60]))
    answer = wrong.ask()
    d = answer.diagnosis
    if d is None:
        known = not answer.sentences[-1].split(" ")[0].endswith(("Error", "Warning"))
        return ("named" if answer.says(*slip.words_for(run)) else "refused" if known else "crash"), answer.short()
    leaked = [s for s in answer.sentences if "invalid value" in s or "divide by zero" in s]
    if leaked:
        return "crash", leaked[0]
    small = d.steps[-1].error.rms / np.sqrt(d.error.axes) <= 1.5 * wrong.noise
    if slip.undecidable and answer.says(*slip.words_for(run)):
        return "named", answer.short()
    if d.verdict == "explained" or (d.verdict == "adequate" and not small):
        return "lie", answer.short()
    if d.effects:
        return "accused", answer.short()
    if answer.says(*slip.words_for(run)):
        return "named", answer.short()
    return ("harmless" if d.verdict == "adequate" else "honest"), answer.short()


def every(seeds: range, robots: tuple[str, ...] = tuple(ROBOTS)) -> Iterator[tuple[Slip, str, int, str, str]]:
    """All mistakes on these robots: which, where, and how each was answered."""
    for name in robots:
        for seed in seeds:
            run = ROBOTS[name](seed)
            for slip in (s for s in SLIPS if s.rule != "places" or run.line is not None):
                yield slip, name, seed, *outcome(slip, run, seed)
