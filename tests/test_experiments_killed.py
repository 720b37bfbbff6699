"""SIGKILL at random moments of a run: nothing that was acknowledged is lost, nothing is there twice."""

from __future__ import annotations

import random
import re
import signal
import subprocess
import sys
import time

import pytest

from laboratories import experiment, laboratory
from sherkit.lab.experiment import RunFile, load_experiment, run
from sherkit.lab.laboratory import RunningLaboratory, load_laboratory

COMMAND = [sys.executable, "-c", "from sherkit.cli import main; main()", "measure", "experiment.toml", "--resume"]
#: From the start of the program to its first step, and on to the last: kills fall anywhere in it.
LONGEST_S = 6.0


def acknowledged(text):
    return [int(n) for n in re.findall(r"^stored (\d+):", text, re.MULTILINE)]


def rows(path):
    """The rows of a run without what the clock says."""
    with RunFile.open(path) as file:
        return file.frame().drop("time_s")


def undisturbed(folder):
    """A run of the same experiment, in a laboratory of its own, that nobody killed."""
    with RunningLaboratory(load_laboratory(folder / "lab.toml")) as lab:
        lab.write_ports(folder / "ports.json")
        chosen = load_experiment(folder / "experiment.toml")
        with (
            RunFile.create(folder / "undisturbed.sqlite", chosen.plan, chosen.about()) as file,
            chosen.bench() as bench,
        ):
            assert run(chosen.plan, bench, file) == "complete"
    return rows(folder / "undisturbed.sqlite")


def killed_run(folder, kills, seed):
    """One run, killed up to ``kills`` times and resumed each time. Returns how often it was killed, and how often
    while the motors moved."""
    rng = random.Random(seed)
    # a busy machine is no fault here
    experiment(folder, plan={"repeats": 4, "seed": seed}, rails={"poll_timeout_s": 10.0, "timeout_s": 10.0})
    expected = undisturbed(folder)
    path = folder / "experiment.sqlite"
    killed = moving = 0
    known: set[int] = set()
    with RunningLaboratory(load_laboratory(folder / "lab.toml")) as lab:
        lab.write_ports(folder / "ports.json")
        while True:
            process = subprocess.Popen(COMMAND, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            if killed < kills:
                # half of them at any time, half once it measures: starting takes longest
                if rng.random() < 0.5:
                    first = process.stdout.readline()
                    time.sleep(rng.uniform(0.0, 1.0))
                else:
                    first = ""
                    time.sleep(rng.uniform(0.0, LONGEST_S / 3))
                process.send_signal(signal.SIGKILL)
            else:
                first = ""
            said, wrong = process.communicate(timeout=600)
            said = first + said
            with RunFile.open(path) if path.exists() and path.stat().st_size else _Nothing() as file:
                done = file.done()
            said_before = acknowledged(said)
            assert len(set(said_before)) == len(said_before)
            assert not known & set(said_before), "a step that was stored was measured again"
            known |= set(said_before)
            # every acknowledged row is in the file; one more may have been stored and not yet told
            assert known <= done
            if process.returncode == 0:
                break
            assert process.returncode == -signal.SIGKILL, wrong
            killed += 1
            before = lab.world.joints()
            time.sleep(0.001)
            moving += bool((before != lab.world.joints()).any())
            known |= done
    found = rows(path)
    assert found["step"].to_list() == list(range(len(expected)))
    assert found.equals(expected)
    return killed, moving


class _Nothing:
    """A run file that was not yet made."""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def done(self):
        return set()


@pytest.mark.slow
def test_a_killed_run_loses_nothing(tmp_path):
    """Catches a row that was told and not stored, a step taken twice, and a resumed run that reads something else."""
    laboratory(tmp_path)
    killed, _ = killed_run(tmp_path, kills=3, seed=1)
    assert killed


@pytest.mark.slow
def test_a_run_killed_at_a_hundred_moments_loses_nothing(tmp_path):
    """Catches what the short test does, where it is rare: between a commit and its word, in the making of the file."""
    killed = moving = seed = 0
    while killed < 100:
        seed += 1
        folder = tmp_path / str(seed)
        # slow enough for the motors to be on their way at many of the moments
        laboratory(folder, time_scale=40.0)
        more, on_the_way = killed_run(folder, kills=min(12, 100 - killed), seed=seed)
        killed, moving = killed + more, moving + on_the_way
    print(f"killed {killed} times in {seed} runs, {moving} of them while the motors moved")
