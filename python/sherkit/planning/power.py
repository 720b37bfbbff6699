"""Studies over many simulated robots: how often an effect is in fact found by a plan.

Every simulated run is a robot with errors of its own, the effect, and noise, all drawn from the study's seed and the
run's number; it is fitted without the effect and with it, as :func:`~sherkit.fit.identify.identify` does, and the
F-test is taken. A run depends on nothing else, so that any ``concurrent.futures.Executor`` gives the same numbers: a
process pool, or a cluster's (dask.distributed: ``Client.get_executor()``). Results are written down as they come, and a
study that was interrupted goes on.
"""

from __future__ import annotations

import concurrent.futures as futures
import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from ..base.types import Floats
from ..base.workers import processes, run_tasks
from ..data import Measurements
from ..data.columns import Layout
from ..data.files import write_whole
from ..data.noise import ReadingNoise
from ..errors import ExperimentError, FitError, SherkitError
from ..fit.identify import identify
from ..model.chain import ChainModel
from ..model.effect import Setting
from ..model.kinds import model_of, robot_from_tables
from .effect_power import Planning

#: Runs of one effect that go to a worker together: what is sent is larger than what comes back.
_TOGETHER = 10
#: Robots that are drawn for one run until one of them can go where the plan sends it.
_ATTEMPTS = 50


@dataclass(frozen=True)
class EffectSize:
    """An effect in a simulated robot, with its parameters, mm and rad."""

    name: str
    values: Mapping[str, float]


@dataclass(frozen=True)
class DetectionCount:
    """In how many of ``runs`` simulated runs an effect was found, beside the ``power`` that the plan promises."""

    name: str
    power: float
    found: int
    runs: int

    @property
    def share(self) -> float:
        """The share of runs in which it was found."""
        return self.found / self.runs if self.runs else float("nan")


@dataclass(frozen=True)
class _PowerTask:
    """What a worker needs: plain values, so that any executor can send them."""

    robot: Mapping[str, Any]
    free: tuple[str, ...]
    effects: tuple[str, ...]
    settings: Mapping[str, Setting | None]
    joints: Floats
    layout: Layout
    columns: Mapping[str, Floats]
    sigma: Floats
    errors: float
    sought: EffectSize
    seed: int
    runs: tuple[int, ...]


def study_power(
    planning: Planning,
    sought: Sequence[EffectSize],
    *,
    runs: int = 200,
    seed: int = 0,
    errors: float = 1.0,
    executor: futures.Executor | None = None,
    workers: int | None = None,
    path: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[DetectionCount, ...]:
    """Simulates ``runs`` runs for each of the effects, and counts how often each is found.

    ``errors`` is the size of the robots' own errors, 1 = plausible. ``executor`` runs them (a pool of ``workers``
    processes if left out). ``path`` keeps the results; a file of the same study is gone on with. ``progress`` hears how
    many of how many are done. Raises :class:`~sherkit.errors.ExperimentError` for a file of another study. Ctrl-C ends
    it; what is done is kept.
    """
    promised = [planning.power(one.name, one.values) for one in sought]
    key = _key(planning, sought, seed, errors)
    p_values = _known(Path(path), key) if path is not None else {}
    total = runs * len(sought)
    todo = [
        (k, tuple(rest))
        for k in range(len(sought))
        for rest in _parts([r for r in range(runs) if (k, r) not in p_values])
    ]
    done = sum((k, r) in p_values for k in range(len(sought)) for r in range(runs))
    if progress is not None:
        progress(done, total)
    tasks = [_task(planning, sought[k], seed, errors, numbers) for k, numbers in todo]
    with (
        _pool(executor, workers) as pool,
        _kept(path, key) as keep,
        closing(run_tasks(_simulated, tasks, pool)) as outcomes,
    ):
        for one in outcomes:
            if one.answer is None:
                raise one.error or AssertionError
            k, numbers = todo[one.number]
            fresh = {(k, r): p for r, p in zip(numbers, one.answer, strict=True)}
            keep(fresh)
            p_values |= fresh
            done += len(fresh)
            if progress is not None:
                progress(done, total)
    levels = [planning.level_of(one.name) for one in sought]
    return tuple(
        DetectionCount(one.name, power, sum(p_values[k, r] < levels[k] for r in range(runs)), runs)
        for k, (one, power) in enumerate(zip(sought, promised, strict=True))
    )


# -- one run -------------------------------------------------------------------------------------------------


def _task(planning: Planning, sought: EffectSize, seed: int, errors: float, runs: tuple[int, ...]) -> _PowerTask:
    rows = planning.rows
    columns = {f"direction_{k + 1}": d for k, d in enumerate(rows.direction.T) if np.isfinite(d).all()}
    columns |= dict(rows.covariates)
    if rows.time_s is not None:
        columns["time_s"] = rows.time_s
    model = planning.with_effect(planning.effect(sought.name))
    return _PowerTask(
        robot=model.robot.to_tables(),
        free=model.free,
        effects=tuple(e.name for e in planning.model.effects),
        settings=model.settings(),
        joints=rows.joints,
        layout=rows.layout,
        columns=columns,
        sigma=planning.sigma,
        errors=errors,
        sought=sought,
        seed=seed,
        runs=runs,
    )


def _simulated(task: _PowerTask) -> list[float]:
    """p values of the runs. Runs in a worker."""
    robot = robot_from_tables(dict(task.robot), "study")
    plain = model_of(robot, task.free)
    known = plain.known_effects
    settings: dict[str, Any] = dict(task.settings)
    columns: dict[str, Any] = dict(task.columns)
    base = replace(plain, effects=tuple(known[name] for name in task.effects), **settings)
    full = base.with_effect(known[task.sought.name])
    rows = Measurements.planned(task.joints, task.layout, **columns)
    return [_p_value(task, base, full, rows, run) for run in task.runs]


def _p_value(task: _PowerTask, base: ChainModel, full: ChainModel, rows: Measurements, run: int) -> float:
    effect = next(e for e in full.effects if e.name == task.sought.name)
    m = rows.coordinates
    sigma = np.ones(rows.readings.shape)
    sigma[:, :m] = task.sigma
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([task.seed, run, attempt])
        values = np.array([p.size for p in full.parameters]) * task.errors * rng.normal(size=len(full.parameters))
        values[full.owns(effect)] = [task.sought.values.get(p.name, 0.0) for p in effect.parameters]
        try:
            readings = full.predict(rows, values)
            readings[:, :m] += rng.normal(size=(len(rows), m)) * task.sigma
            data = replace(rows, readings=np.where(rows.taken, readings, 0.0))
            noise = ReadingNoise(sigma, "declared")
            fits = [identify(model, data, noise=noise) for model in (base, full)]
        except SherkitError:
            # a robot that cannot go where the plan sends it is none that would be measured: another one is drawn
            continue
        break
    else:
        raise FitError(
            f"{_ATTEMPTS} simulated robots in turn cannot go where the plan sends them; study smaller errors, or "
            "another plan"
        )
    sums = [float(np.nansum((fit.residuals / sigma) ** 2)) for fit in fits]
    more = fits[1].rank - fits[0].rank
    free = len(rows) * m - fits[1].rank
    if more <= 0 or free <= 0:
        return 1.0
    return float(scipy.special.fdtrc(more, free, max(sums[0] - sums[1], 0.0) / more / (sums[1] / free)))


# -- workers and files ---------------------------------------------------------------------------------------


def _parts(numbers: list[int]) -> list[list[int]]:
    return [numbers[k : k + _TOGETHER] for k in range(0, len(numbers), _TOGETHER)]


@contextmanager
def _pool(executor: futures.Executor | None, workers: int | None) -> Iterator[futures.Executor]:
    if executor is not None:
        # whose it is closes it
        yield executor
        return
    with processes(workers) as pool:
        yield pool


def _key(planning: Planning, sought: Sequence[EffectSize], seed: int, errors: float) -> str:
    """What a study is about: only the same one goes on."""
    tasks = [_task(planning, one, seed, errors, ()) for one in sought]
    about = [
        [t.robot, t.free, t.effects, t.settings, t.joints.tolist(), {k: v.tolist() for k, v in t.columns.items()},
         t.sigma.tolist(), t.errors, [t.sought.name, dict(t.sought.values)], t.seed]
        for t in tasks
    ]  # fmt: skip
    return hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()


def _known(path: Path, key: str) -> dict[tuple[int, int], float]:
    """Results of an earlier beginning. A last line that was cut off by a crash is left out."""
    if not path.exists():
        return {}
    out: dict[tuple[int, int], float] = {}
    lines = path.read_text(encoding="utf-8").split("\n")
    try:
        head = json.loads(lines[0]) if lines[0] else {"study": key}
        if head.get("study") != key:
            raise ExperimentError(f"{path}: holds another study; give this one a file of its own")
        for line in lines[1:-1]:
            for k, run, p in json.loads(line):
                out[int(k), int(run)] = float(p)
    except (ValueError, TypeError, AttributeError) as error:
        raise ExperimentError(f"{path}: holds no study: {error}") from None
    return out


@contextmanager
def _kept(path: str | Path | None, key: str) -> Iterator[Callable[[Mapping[tuple[int, int], float]], None]]:
    """A function that writes results down, a line at a time and at once."""
    if path is None:
        yield lambda _: None
        return
    path = Path(path)
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    whole = text[: text.rfind("\n") + 1] or json.dumps({"study": key}) + "\n"
    if whole != text:
        write_whole(path, whole)
    with path.open("a", encoding="utf-8") as file:

        def keep(fresh: Mapping[tuple[int, int], float]) -> None:
            file.write(json.dumps([[k, run, p] for (k, run), p in fresh.items()]) + "\n")
            file.flush()
            os.fsync(file.fileno())

        yield keep
