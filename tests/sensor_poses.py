"""Whether anybody is blamed for where an instrument stands: worlds of delta, arm, planar machine and sphere, each with
its sensor's pose at random, asked with nothing, one effect and two effects hidden.

PYTHONPATH=python python tests/sensor_poses.py [--worlds 200] [--first 0] [--only delta]
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from scipy import stats

import sherkit as sk
from consistency import contradictions, named
from second_machines import MACHINES, Hidden, apart, run_of, seen_from, shift, stand_of, turn, zeros_of
from sherkit.base.workers import processes, run_tasks
from sherkit.fit.error import radius_95
from sherkit.model.robot_file import run_for
from sherkit.model.sensor_pose import POSE
from sherkit.robots.machine import load_machine
from standing_worlds import SCARA, WORLDS, Standing
from test_frames import arm_held, calibrated, delta_held

RATIOS = (2, 5)
#: Two processes, each of one thread; after so many worlds the table is printed.
WORKERS, OFTEN = 2, 20
#: Length, in noise, at which what is left of something shows in 80 % of runs: one column of the 200 that are tried
#: together at a level of 1 %, on the two thirds of the rows that are searched.
SEEN = float(stats.norm.isf(0.01 / 200 / 2) + stats.norm.isf(0.2)) * np.sqrt(1.5)
#: What is counted, and the least share that is right.
BARS = {
    "nothing hidden: nobody blamed": 0.98, "an effect at 2 × the noise: named or tied": 0.98,
    "an effect at 5 × the noise: named or tied": 0.98, "two effects at 2 × the noise: both named": 0.95,
    "the pose within two deviations": 0.95, "accuracy covered, sensor": 0.93, "accuracy covered, base": 0.93,
}  # fmt: skip
NOTHING, AT_2, AT_5, PAIR, POSE_FOUND, IN_SENSOR, IN_BASE = BARS
#: How much longer a diagnosis may take for it, median.
LONGER = 1.05


@dataclass
class Counted:
    """What became of one world: ``shares`` by what is counted, ``said`` of what went wrong, and how many times as long
    a diagnosis took as with the pose held."""

    kind: str
    number: int
    shares: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    said: list[str] = field(default_factory=list)
    longer: float = np.nan

    def count(self, what: str, right: bool, told: Callable[[], str]) -> None:
        """One more."""
        self.shares[what].append(float(right))
        if not right:
            self.said.append(f"{self.kind} {self.number}, {what}: {told()}")


def blames_nobody(d: sk.diagnosis.Diagnosis) -> bool:
    """Whether nothing is found."""
    return d.verdict in ("adequate", "undecided") and not d.effects and d.signature is None


def is_told(d: sk.diagnosis.Diagnosis, names: set[str]) -> bool:
    """Whether one of these leads or is tied, with others or with the geometry while nothing else is blamed."""
    absorbed = d.verdict in ("adequate", "undecided") and names <= {*d.confounded_with, *d.taken_by_pose}
    return bool(names & named(d)) or absorbed


def as_well(world: Standing, hidden: dict[str, float], d: sk.diagnosis.Diagnosis) -> bool:
    """Whether what was found explains what was planted but for less than can be seen, in linear approximation."""
    exact = world.exact_run(hidden)
    missed = (exact.readings - d.fit.model.predict(exact, d.fit.values))[exact.taken]
    columns = d.fit.model.derivatives(exact, d.fit.values)[exact.taken]
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    left = missed - columns @ np.linalg.lstsq(columns, missed, rcond=1e-10)[0]
    return bool(np.linalg.norm(left) < SEEN * world.noise)


def in_words(d: sk.diagnosis.Diagnosis) -> str:
    """What a diagnosis says."""
    tied, shape = d.indistinguishable, d.signature and (d.signature["depends_on"], d.signature["shape"])
    return f"{d.verdict} {d.effects} tied {tied} shape {shape} p {d.p_missing:.2g}"


def pose_found(world: Standing, fit: sk.fit.Fit) -> list[tuple[str, float]]:
    """By how many deviations each number of the sensor's pose is off what it is, in the directions that readings tell,
    those that they do not left as they are. Where no file says which they are, the fit of a run without noise does: it
    is what these readings tell of the pose, since nothing is left of that run."""
    names = [p.name for p in fit.parameters]
    at = [names.index(name) for name in POSE if name in names]
    if (stands := world.where_it_stands()) is not None:
        return [(names[k], (fit.values[k] - stands[names[k]]) / fit.std[k]) for k in at]
    truth = sk.identify(fit.model.robot, world.exact_run())
    assert np.nanmax(np.abs(truth.residuals)) < 1e-3 * world.noise, "without noise nothing is left"
    size, basis = np.array([p.size for p in fit.parameters]), fit.unobserved_basis
    off = (fit.values - truth.values) / size
    off = (off - basis.T @ (basis @ off)) * size
    # of a number that only goes with others there is a deviation of rounding, and no more
    told = [k for k in at if fit.std_from_readings[k] > 1e-9 * size[k]]
    return [(names[k], off[k] / fit.std_from_readings[k]) for k in told]


def scara_held(seed: int) -> dict[str, float]:
    """Of a SCARA whose parameters are of plausible size, the share of places that are missed by no more than promised,
    by frame."""
    rng, true, out = np.random.default_rng([seed, 56]), MACHINES["scara"][0], {}
    machine, zeros = load_machine(SCARA), zeros_of("scara", seed)
    c, q = calibrated(machine, run_for(machine, run_of("scara", seed, poses=60))), rng.uniform(*machine.box.T, (20, 3))
    places = np.array([true(one + zeros, np.zeros(3), 0.0, 0.0, Hidden()) for one in q])
    # zeros of shoulder and quill are where the base is
    base = seen_from(np.linalg.inv(turn(2, zeros[0]) @ shift(0.0, 0.0, -zeros[2])), places)
    for frame, at in (("base", base), ("sensor", seen_from(stand_of(seed), places))):
        told = c.forward_batch(q, frame=frame).require()
        spread = c.spread(c.forward_batch(q).require(), q, frame=frame)
        out[frame] = float(np.mean(np.linalg.norm(told - at, axis=1) <= radius_95(spread)))
    return out


def sphere_held(seed: int) -> dict[str, float]:
    """Of a sphere before a camera that stands within what is known of it; its tool points in the base alone."""
    world = WORLDS["sphere"](4 * seed)
    assert isinstance(world, Standing)
    c = calibrated(world.robot, sk.from_frame(world.columns()))
    rng = np.random.default_rng([seed, 57])
    joints = np.column_stack([world.plan[f"theta{i}_rad"] for i in (1, 2)])[rng.choice(len(world.plan["pose"]), 20)]
    (phi, gamma), told = world.real.angles(joints).T, c.forward_batch(joints).require()
    turned = np.angle(np.exp(1j * (phi - told[:, 0]))) * np.sin(gamma)
    off = c.radius_mm * np.hypot(turned, gamma - told[:, 1])
    return {"base": float(np.mean(off <= c.predicted_accuracies(told).radius_mm))}


PROMISED: dict[str, Callable[[int], dict[str, float]]] = {
    "delta": delta_held, "arm": arm_held, "planar machine": scara_held, "sphere": sphere_held,
}  # fmt: skip


def timed(ask: Callable[[], Any]) -> tuple[Any, float]:
    """An answer, and the time of the processor that it took."""
    began = time.process_time()
    return ask(), time.process_time() - began


def counted(task: tuple[str, int]) -> Counted:
    """One world, asked whatever is counted."""
    kind, number = task
    out = Counted(kind, number)
    with apart(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        world = WORLDS[kind](number)
        for ask in (nothing, singles, pair):
            ask(world, out)
        for frame, share in PROMISED[kind](number).items():
            out.shares[IN_BASE if frame == "base" else IN_SENSOR].append(share)
    return out


def nothing(world: Standing, out: Counted) -> None:
    """Nothing hidden: who is blamed, where the instrument is said to stand, and how long that took."""
    run, held = world.run(), world.held
    asks = {"free": (world.robot, run), "held": (held, world.run_of(held))}
    # who is asked first also pays for what is made once
    order = ("free", "held") if world.number // len(WORLDS) % 2 else ("held", "free")
    answers = {name: timed(partial(sk.diagnose, *asks[name])) for name in order}
    d, out.longer = answers["free"][0], answers["free"][1] / answers["held"][1]
    out.count(NOTHING, blames_nobody(d), lambda: in_words(d))
    told(world, d, {}, out)
    for name, off in pose_found(world, d.base):
        out.count(POSE_FOUND, abs(off) <= 2.0, lambda name=name, off=off: f"{name} off by {off:.2f} deviations")


def singles(world: Standing, out: Counted) -> None:
    """Two effects in turn, each at twice and five times the noise."""
    names = world.askable
    for k in range(2 * (len(names) > 0)):
        name = names[(2 * (world.number // len(WORLDS)) + k) % len(names)]
        for ratio, what in zip(RATIOS, (AT_2, AT_5), strict=True):
            hidden = {name: float(ratio)}
            d = sk.diagnose(world.robot, world.run(hidden, 10 * k + ratio))
            out.count(
                what,
                is_told(d, world.effects[name]),
                lambda name=name, d=d, hidden=hidden: (
                    f"{name}: {in_words(d)}{' (as well)' if as_well(world, hidden, d) else ''}"
                ),
            )
            told(world, d, hidden, out)


def pair(world: Standing, out: Counted) -> None:
    """Two effects at twice the noise; where what was named explains both but for less than can be seen, nobody can
    tell, and it does not count."""
    names = world.askable
    if len(names) < 2:
        return
    one, other = np.random.default_rng([world.number, 532]).choice(len(names), 2, replace=False).tolist()
    hidden = {names[one]: 2.0, names[other]: 2.0}
    d = sk.diagnose(world.robot, world.run(hidden, 30))
    both = all(world.effects[name] & named(d) for name in hidden)
    told(world, d, hidden, out)
    if both or not as_well(world, hidden, d):
        out.count(PAIR, both, lambda: f"{' and '.join(hidden)}: {in_words(d)}")
    else:
        out.said.append(f"{out.kind} {out.number}: {' and '.join(hidden)} as well by {in_words(d)}")


def told(world: Standing, d: sk.diagnosis.Diagnosis, hidden: dict[str, float], out: Counted) -> None:
    """A diagnosis that contradicts itself is always said."""
    out.said += [f"{out.kind} {out.number} {hidden}: CONTRADICTION {one}" for one in contradictions(d)]


def tasks(worlds: int, first: int, kinds: Sequence[str]) -> list[tuple[str, int]]:
    """Worlds in turn."""
    return [(kinds[k % len(kinds)], k) for k in range(first, first + worlds)]


def of_all(worlds: int, first: int, kinds: Sequence[str], workers: int = WORKERS) -> Iterator[Counted]:
    """Every world, in the order in which they come."""
    todo = tasks(worlds, first, kinds)
    with processes(workers) as pool:
        for outcome in run_tasks(counted, todo, pool):
            if outcome.error is not None:
                print(f"{todo[outcome.number]}: {outcome.error!r}", flush=True)
            elif outcome.answer is not None:
                yield outcome.answer


def table_of(done: Sequence[Counted]) -> str:
    """Shares by kind, beside the bar."""
    kinds = [kind for kind in WORLDS if any(one.kind == kind for one in done)]
    lines = [f"{'':<44}{'all':>16}{'bar':>7}" + "".join(f"{kind:>16}" for kind in kinds)]
    for what, bar in BARS.items():
        cells = []
        for some in (done, *([one for one in done if one.kind == kind] for kind in kinds)):
            every = [share for one in some for share in one.shares.get(what, ())]
            cells.append(f"{np.mean(every):.3f} of {len(every)}" if every else "-")
        lines.append(f"{what:<44}{cells[0]:>16}{bar:>7.2f}" + "".join(f"{cell:>16}" for cell in cells[1:]))
    longer = [np.nanmedian([one.longer for one in done if kind in (None, one.kind)]) for kind in (None, *kinds)]
    lines.append(
        f"{'time, pose free over held, median':<44}{longer[0]:>16.3f}{LONGER:>7.2f}"
        + "".join(f"{one:>16.3f}" for one in longer[1:])
    )
    return "\n".join(lines)


def main() -> None:
    """Prints what went wrong as it comes, then the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--worlds", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", choices=list(WORLDS))
    parser.add_argument("--workers", type=int, default=WORKERS)
    asked = parser.parse_args()
    done = []
    for one in of_all(asked.worlds, asked.first, [asked.only] if asked.only else list(WORLDS), asked.workers):
        done.append(one)
        for sentence in one.said:
            print(sentence, flush=True)
        if not len(done) % OFTEN:
            print(table_of(done), flush=True)
    if len(done) % OFTEN:
        print(table_of(done))


if __name__ == "__main__":
    main()
