"""Tasks in a pool of processes of which some die: what is done is kept, what kills is named."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import sherkit as sk
from running import cluster_of_two, slow
from sherkit.base import workers
from sherkit.base.workers import run_tasks
from sherkit.cli.demo import EXAMPLE
from sherkit.robots.delta.virtual import VirtualDelta

SPAWN = multiprocessing.get_context("spawn")
#: Every eighth pose of the paper: few enough for a fleet of hundreds.
FEW = sk.delta.paper_whole()[::8]


def do(task: tuple[int, str, str]) -> int:
    """A task by number: one that dies, one that dies the first time, one that fails, or a square."""
    number, what, folder = task
    marker = Path(folder) / f"{number}"
    if what == "dies" or (what == "dies once" and not marker.exists()):
        marker.touch()
        os._exit(9)
    if what == "fails":
        raise ValueError("no such thing")
    if what == "leaves":
        raise SystemExit(3)
    return number**2


def outcomes(folder: Path, executor: Executor, **what: str) -> tuple[dict[int, int], dict[int, str]]:
    """Answers and errors by number, of twelve tasks of which some do ``what``."""
    tasks = [(k, what.get(f"n{k}", ""), str(folder)) for k in range(12)]
    found = list(run_tasks(do, tasks, executor))
    assert sorted(one.number for one in found) == list(range(12))
    return (
        {one.number: one.answer for one in found if one.answer is not None},
        {one.number: type(one.error).__name__ for one in found if one.error is not None},
    )


@pytest.mark.slow
def test_one_task_that_kills_is_named_and_the_others_are_done(tmp_path: Path) -> None:
    """Catches a killed worker that takes the answers with it, a task that is blamed for what its neighbour did,
    one that was killed once by chance, and a failure that is not one of the task's own."""
    with ProcessPoolExecutor(2, SPAWN) as pool:
        done, lost = outcomes(tmp_path, pool, n3="dies", n5="fails", n8="dies", n9="leaves", n11="dies once")
    assert lost == {3: "WorkerLost", 5: "ValueError", 8: "WorkerLost", 9: "SystemExit"}
    assert done == {k: k**2 for k in range(12) if k not in lost}


class _Breaks(Executor):
    """An executor that breaks at the third task, and says it of all that wait: in ``submit``, or in the answers."""

    def __init__(self, at_once: bool) -> None:
        self.at_once, self.count = at_once, 0

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.count += 1
        if self.count > 2 and self.at_once:
            raise BrokenExecutor("gone")
        made: Future[Any] = Future()
        if self.count > 2:
            made.set_exception(BrokenExecutor("gone"))
        else:
            made.set_result(fn(*args, **kwargs))
        return made


@pytest.mark.slow
@pytest.mark.parametrize("at_once", [*slow(True), False])
def test_an_executor_that_says_not_how_many_it_takes_may_break_too(
    tmp_path: Path, at_once: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a mechanism for the pools of the standard library alone, and answers that are asked for twice."""
    monkeypatch.setattr(workers, "processes", lambda *_: ProcessPoolExecutor(2, SPAWN))
    done, lost = outcomes(tmp_path, _Breaks(at_once), n4="dies")
    assert lost == {4: "WorkerLost"}
    assert done == {k: k**2 for k in range(12) if k != 4}


def test_an_executor_that_was_closed_is_an_error_of_each(tmp_path: Path) -> None:
    """Catches a traceback where nobody takes a task, and a wait for ever."""
    pool = ThreadPoolExecutor(1)
    pool.shutdown()
    done, lost = outcomes(tmp_path, pool)
    assert not done
    assert set(lost.values()) == {"RuntimeError"}


# -- a fleet -----------------------------------------------------------------------------------------------------------


class Deadly(os.PathLike[str]):
    """The path of a run whose reader dies, in a worker."""

    def __fspath__(self) -> str:
        if multiprocessing.parent_process() is not None:
            os._exit(9)
        return "deadly.csv"


def few_poses(seed: int) -> sk.Measurements:
    """A run of one machine, of few poses."""
    drawn = VirtualDelta.draw(EXAMPLE, seed, sizes={"joint_offset": 0.02, "rod_length": 0.02}, noise_mm=0.005)
    return drawn.measure(FEW, repeats=2, order="shuffled", seed=seed)


@pytest.mark.slow
def test_a_fleet_names_the_run_that_kills(tmp_path: Path) -> None:
    """Catches a fleet whose verdicts are all lost by one run, a run that is lost without its name, and a fleet that
    never ends since its processes are copies of one whose threads held locks."""
    pl.read_csv(b"a\n1\n")  # whose threads are no longer there in a copy
    (tmp_path / "none.csv").write_text("q1_mm\n1\n")
    told: list[tuple[int, int]] = []
    runs = [str(tmp_path / "none.csv"), Deadly(), str(tmp_path / "nowhere.csv")]
    with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as pool:
        found = sk.fleet(runs, EXAMPLE, executor=pool, progress=lambda *n: told.append(n))
    assert told == [(k, 3) for k in range(4)]
    assert [m.run for m in found.machines] == [str(tmp_path / "none.csv"), "deadly.csv", str(tmp_path / "nowhere.csv")]
    assert "is missing" in str(found.machines[0].failed)
    assert str(found.machines[1].failed).startswith("deadly.csv: its process ended twice before it answered")
    assert "no such file" in str(found.machines[2].failed)


@pytest.mark.slow
def test_a_fleet_of_300_is_complete_where_a_worker_is_killed() -> None:
    """Catches verdicts that are lost, given twice or to the wrong machine since one process was killed on the way."""
    runs = [few_poses(k) for k in range(300)]
    killed: list[int] = []
    with ProcessPoolExecutor(2, SPAWN) as pool:

        def progress(done: int, total: int) -> None:
            if done == 60:
                killed.extend(list(pool._processes)[:1])
                os.kill(killed[0], signal.SIGKILL)

        found = sk.fleet(runs, EXAMPLE, executor=pool, progress=progress)
    assert killed
    assert [m.run for m in found.machines] == [f"run {k + 1}" for k in range(300)]
    assert [m.run for m in found.machines if m.failed] == []
    for machine, alone in zip(found.machines[58:66], sk.fleet(runs[58:66], EXAMPLE).machines, strict=True):
        assert (machine.verdict, machine.effects) == (alone.verdict, alone.effects)
        assert machine.after == pytest.approx(alone.after, rel=1e-9)
    assert np.ptp([m.rows for m in found.machines]) == 0


@pytest.mark.slow
def test_a_cluster_names_the_run_that_kills() -> None:
    """Catches a run that takes one worker of a cluster after the other, and the verdicts of all with them."""
    runs = [*(few_poses(k) for k in range(10)), Deadly(), *(few_poses(k) for k in range(10, 20))]
    with cluster_of_two() as (_, executor):
        found = sk.fleet(runs, EXAMPLE, executor=executor)
    failed = [m for m in found.machines if m.failed]
    assert [m.run for m in failed] == ["deadly.csv"]
    assert "died" in str(failed[0].failed)
