"""Instruments that fail at random while a run goes on: no wrong row is stored, nothing moves on, errors say why."""

from __future__ import annotations

import random
import time
from collections import Counter

import numpy as np
import pytest

from laboratories import experiment, laboratory
from sherkit.errors import Halted, InstrumentError
from sherkit.lab.experiment import RunFile, load_experiment, run
from sherkit.lab.laboratory import RunningLaboratory, load_laboratory

#: Every fault of the emulators; lasers have no limit switch, motors are never out of range.
OF_RAILS = ("drop", "garble", "stall", "disconnect", "misheard", "limit_switch")
OF_LASERS = ("drop", "garble", "stall", "disconnect", "misheard", "over_range")
STALL_S = 0.15
QUICK = {"timeout_s": 0.1, "retries": 1}
#: Half of the lasers' last digit, and as much for two readings that must agree.
CLOSE_MM = 0.0006


def polls_before_stop(error, log):
    """How many polls of a motion came between what made it fail and the word to stop; 0 where none was needed.

    What made it fail is the exchange that the error tells of. Where an axis did not arrive, it is the fault: a BG that
    was misheard, a switch that opened.
    """
    begun = max((k for k, (c, _, _) in enumerate(log) if c.startswith(b"BG")), default=0)
    stop = next((k for k, (c, _, _) in enumerate(log) if k > begun and c.startswith(b"ST")), None)
    if stop is None:
        return 0
    # a stop code may be damaged on its way, too: then the exchange itself is to blame
    causes = [
        k
        for k, (heard, _, fault) in enumerate(log[:stop])
        if (fault is not None and fault.kind in ("misheard", "limit_switch"))
        or (heard == error.sent and (fault is not None or not isinstance(error, Halted)))
    ]
    return sum(c.startswith(b"MG _BG") for c, _, _ in log[causes[-1] + 1 : stop]) if causes else 0


def attempt(chosen, file, disturb):
    """Connects and goes on with the run, as a person would. Returns what went wrong, None at the run's end."""
    try:
        with chosen.bench() as bench:
            assert run(chosen.plan, bench, file, report=disturb) == "complete"
    except InstrumentError as error:
        return error
    return None


def check_failure(error, lab, log):
    """The axes were told to stop within one poll of the fault and stand; the sentence says who, what and what came."""
    # an axis of a real machine would still be on its way: 10 ms here are 4 s there
    before = lab.world.joints()
    time.sleep(0.01)
    assert np.array_equal(before, lab.world.joints()), error
    assert polls_before_stop(error, log) <= 1, error
    said = str(error)
    assert error.instrument in lab.emulators, said
    assert error.port == lab.emulators[error.instrument].address, said
    assert said.startswith(f"{error.instrument} on {error.port}: ")
    # a port that cannot be opened was not yet asked anything; two readings that differ are both told
    whole = "; sent b'" in said and ", received " in said
    assert whole or any(w in said for w in ("cannot be opened", "readings differ", "moved by")), said


def failing_run(folder, steps, seed, link="pty"):
    """A run of ``steps`` with a fault at one answer of nearly every step. Returns what was raised, by kind."""
    rng = random.Random(seed)
    laboratory(folder, noise_mm=0.0, rails={"link": link, "pieces": 2}, lasers={"link": link, "pieces": 2})
    experiment(
        folder,
        plan={"repeats": -(-steps // 18), "seed": seed},
        rails={**QUICK, "poll_timeout_s": 0.1, "settle_s": 0.3},
        lasers=QUICK,
        check={"agree_within_mm": 0.0005, "plausible_mm": 20.0},
    )
    raised: Counter[str] = Counter()
    happened: Counter[str] = Counter()
    with RunningLaboratory(load_laboratory(folder / "lab.toml")) as lab:
        lab.write_ports(folder / "ports.json")
        chosen = load_experiment(folder / "experiment.toml")
        rails, lasers = lab.emulators["rails"], lab.emulators["lasers"]

        def disturb(now=None):
            # the next step has about thirty answers of the motors and six of the lasers
            who, kinds, answers = rng.choice(((rails, OF_RAILS, 30), (lasers, OF_LASERS, 6)))
            who.faults.schedule(rng.choice(kinds), rng.randrange(answers), STALL_S)

        with RunFile.create(folder / "run.sqlite", chosen.plan, chosen.about()) as file:
            disturb()
            for _ in range(3 * steps):
                begin = len(rails.log)
                error = attempt(chosen, file, disturb)
                if error is None:
                    break
                check_failure(error, lab, rails.log[begin:])
                raised[type(error).__name__] += 1
                disturb()
            else:
                raise AssertionError(f"never done: {raised}")
            for emulator in (rails, lasers):
                happened.update(f.kind for f in emulator.faults.happened)
            points = file.points()
            diary = file.diary()
    assert len(points) == len(chosen.plan)
    for point, step in zip(points, chosen.plan, strict=True):
        joints = np.array([point.values[f"q{k}_mm"] for k in (1, 2, 3)])
        seen = np.array([point.values[f"{a}_mm"] for a in "xyz"])
        assert np.abs(joints - step.joints).max() < 0.0101
        assert np.abs(seen - lab.bench.position(joints, 0.0)).max() < CLOSE_MM
    assert len(diary) <= sum(raised.values())
    return raised, happened, len(points)


@pytest.mark.slow
def test_no_fault_stores_a_wrong_row(tmp_path):
    """Catches a row read while the axes moved, a garbled digit that is stored, and a motion that outlives an error."""
    _, happened, stored = failing_run(tmp_path, 30, seed=1)
    assert stored >= 30
    assert len(happened) >= 4


@pytest.mark.slow
@pytest.mark.parametrize("link", ["pty", "tcp"])
def test_no_fault_in_a_thousand_steps_stores_a_wrong_row(tmp_path, link):
    """Catches what the short test does, where it is rare."""
    raised, happened, stored = failing_run(tmp_path, 1000, seed=2, link=link)
    assert stored >= 1000
    assert set(happened) == {*OF_RAILS, *OF_LASERS}
    print(f"{stored} rows on {link}; faults {dict(happened)}; raised {dict(raised)}")
