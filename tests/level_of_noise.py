"""How often something is said to be missing where nothing is: noise of six sorts, on a small delta in the order of a
raster and shuffled, or on the sphere and the planar machine of ``standing_worlds``.

PYTHONPATH=python python tests/level_of_noise.py [--runs 1000] [--first 0] [--robot delta] [--noise "AR 0.7"]
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy import stats

import sherkit as sk
from conventions import written_otherwise
from second_machines import apart
from second_simulator import Noise, Robot, draw_geometric_errors, draw_pose, grid, make_plan, room_temperature, simulate
from sherkit.base.workers import processes, run_tasks
from sherkit.model.robot_file import run_for
from standing_worlds import WORLDS, Columns
from strategies import EXAMPLE

#: Of a standard deviation of one; the rim of the workspace scatters three times as much as its middle.
NOISES = {
    "normal": Noise(1.0), "t(3)": Noise(1.0, student=True), "uneven by pose": Noise(1.0, rim_factor=3.0),
    "AR 0.5": Noise(1.0, rho=0.5), "AR 0.7": Noise(1.0, rho=0.7), "2 % outliers": Noise(1.0, outlier_fraction=0.02),
}  # fmt: skip
ROBOTS = ("delta", "sphere", "machine")
STANDING = {"sphere": "sphere", "machine": "planar machine"}
#: Poses of the delta and repeats of each; noise of a reading.
GRID, REPEATS, SIGMA_MM = grid(20.0, 5, (-20.0, 0.0, 20.0)), 3, 5e-3
ORDERS: tuple[Literal["planes", "shuffled"], ...] = ("planes", "shuffled")
#: Worlds of which no joint stands still: three of four of each sixteen.
MOVING, OF = 12, 16
#: Of the interval of a share, on one side.
CONFIDENCE = 0.95
WORKERS, OFTEN = 2, 100


@dataclass(frozen=True)
class Heard:
    """What is said of a run with nothing hidden."""

    robot: str
    noise: str
    number: int
    verdict: str
    effects: tuple[str, ...]
    shape: str
    cpu_s: float

    @property
    def alarm(self) -> bool:
        """Any verdict but adequate."""
        return self.verdict.split(",")[0] != "adequate"


def plain(robot: str, number: int) -> tuple[Any, Columns, tuple[str, ...], float]:
    """A robot, its run without noise, the names of its readings, and how large their noise is to be."""
    if robot in STANDING:
        world: Any = WORLDS[STANDING[robot]](number // MOVING * OF + number % MOVING)
        return world.robot, world.exact({}), world.readings, world.noise
    rng, real = np.random.default_rng([number, 550]), Robot.from_dict()
    plan = make_plan(real, GRID, REPEATS, ORDERS[number % 2], number)
    plan["temperature_c"] = room_temperature(rng, plan["time_s"])
    columns = simulate(real, plan, draw_geometric_errors(rng), {"sensor_pose": draw_pose(rng)})
    return replace(EXAMPLE, region_half_width_mm=None), columns, ("x_mm", "y_mm", "z_mm"), SIGMA_MM


def heard(task: tuple[str, str, int]) -> Heard:
    """One run."""
    robot, noise, number = task
    with apart(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        one, columns, readings, size = plain(robot, number)
        exact = np.zeros((len(columns["time_s"]), 3))
        exact[:, : len(readings)] = np.stack([columns[name] for name in readings], axis=1)
        from_middle = (exact - exact.mean(axis=0)) / np.maximum(np.ptp(exact, axis=0) / 2, 1e-12)
        rng = np.random.default_rng([number, 551, list(NOISES).index(noise)])
        drawn = size * NOISES[noise].draw(rng, from_middle, np.asarray(columns["time_s"]), 1.0)
        noisy = {name: exact[:, k] + drawn[:, k] for k, name in enumerate(readings)}
        table, names = written_otherwise(dict(columns) | noisy, number)
        run = run_for(one, sk.from_frame(table, columns=names))
        began = time.process_time()
        d = sk.diagnose(one, run)
        took = time.process_time() - began
    shape = f"{d.signature['depends_on']} {d.signature['shape']}" if d.signature else ""
    return Heard(robot, noise, number, d.verdict, tuple(d.effects), shape, took)


def of_all(
    robot: str, noises: Sequence[str], runs: int, first: int, workers: int = WORKERS
) -> Iterator[Heard]:  # fmt: skip
    """Every run, noises in turn, in the order in which they come."""
    todo = [(robot, noise, number) for number in range(first, first + runs) for noise in noises]
    if workers == 1:
        yield from map(heard, todo)
        return
    with processes(workers) as pool:
        for outcome in run_tasks(heard, todo, pool):
            if outcome.error is not None:
                print(f"{todo[outcome.number]}: {outcome.error!r}", flush=True)
            elif outcome.answer is not None:
                yield outcome.answer


def at_most(count: int, of: int) -> float:
    """The share that is not exceeded, by Clopper and Pearson, on one side."""
    return 1.0 if count >= of else float(stats.beta.ppf(CONFIDENCE, count + 1, of - count))


def table_of(done: Sequence[Heard]) -> str:
    """False alarms by noise, each with the bound of its share."""
    lines = [f"{'':<26}{'not adequate':>14}{'at most':>9}{'a name':>12}{'at most':>9}{'CPU s':>8}  verdicts"]
    for noise in (noise for noise in NOISES if any(one.noise == noise for one in done)):
        some = [one for one in done if one.noise == noise]
        alarms, blamed = sum(one.alarm for one in some), sum(bool(one.effects) for one in some)
        cells = [f"{f'{k}/{len(some)}':>{w}}{at_most(k, len(some)):>9.4f}" for k, w in ((alarms, 14), (blamed, 12))]
        verdicts = dict(Counter(one.verdict.split(":")[0] for one in some).most_common())
        took = np.median([one.cpu_s for one in some])
        lines.append(f"{some[0].robot + ', ' + noise:<26}{''.join(cells)}{took:>8.2f}  {verdicts}")
    return "\n".join(lines)


def main() -> None:
    """Prints false alarms as they come, then the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000, help="of each noise")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--robot", choices=ROBOTS, default="delta")
    parser.add_argument("--noise", choices=list(NOISES))
    parser.add_argument("--workers", type=int, default=WORKERS)
    asked = parser.parse_args()
    done: list[Heard] = []
    noises = [asked.noise] if asked.noise else list(NOISES)
    for one in of_all(asked.robot, noises, asked.runs, asked.first, asked.workers):
        done.append(one)
        if one.alarm or one.effects:
            print(f"{one.robot}, {one.noise}, {one.number}: {one.verdict} {list(one.effects)} {one.shape}", flush=True)
        if not len(done) % (OFTEN * len(noises)):
            print(table_of(done), flush=True)
    if len(done) % (OFTEN * len(noises)):
        print(table_of(done))


if __name__ == "__main__":
    main()
