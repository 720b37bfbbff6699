"""Nothing is vouched for that was not looked at: compare, history and verify say "unchanged" or "valid" only of runs
that would have shown a change of three times the required error."""

from __future__ import annotations

import re
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import sherkit as sk
from plain_delta import CARELESS, JOINTS, ROBOT, Delta, Run, places, run
from running import command
from sherkit.errors import MeasurementError
from sherkit.model.kinds import robot_from_tables

#: A change of so many times what is needed must be seen.
TIMES = 3.0
GOOD = ("unchanged", "valid")


@pytest.fixture(scope="module")
def robot() -> Any:
    """The drawing, which needs 20 µm."""
    return robot_from_tables(deepcopy(ROBOT), "plain delta")


@pytest.fixture(scope="module")
def calibration(robot: Any) -> Any:
    """Of the machine as it was."""
    return sk.calibrate(robot, first_run(), correction="none").calibration


def first_run(count: int = 60) -> Run:
    """Of the machine as it was, along its own axes."""
    return run(Delta(1), 1, count, turned=0.0)


def compared(robot: Any, *runs: Run) -> sk.changes.Comparison:
    """By the geometry alone: these machines miss nothing."""
    return sk.compare(robot, list(runs), effects=[])


# -- compare ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "case", [pytest.param(one, marks=[pytest.mark.slow] * (one == "another robot")) for one in CARELESS]
)
def test_compare_does_not_vouch_for_a_careless_run(robot: Any, case: str) -> None:
    """Catches "unchanged" of a run that shows nothing, and a run that cannot speak and is not named."""
    found = compared(robot, first_run(), CARELESS[case](Delta(1), 2))
    assert found.verdict not in GOOD
    assert "nothing needs to be done" not in found.advice
    if case != "another robot":
        assert (found.verdict, found.changed) == ("undecided", ())
        assert len(found.silent) == 1
        assert found.advice.count("measure") + found.advice.count("readings") >= 1


@pytest.mark.parametrize("case", [case for case in CARELESS if case != "another robot"])
def test_nothing_is_held_against_a_careless_run(robot: Any, case: str) -> None:
    """Catches false names where the run before does not say what the robot was (three poses: evidence of 1e181)."""
    if case == "six poses":
        asked_all = sk.compare(robot, [CARELESS[case](Delta(1), 2), first_run()])
        assert (asked_all.verdict, asked_all.changed) == ("undecided", ())
        assert "cannot tell" in str(asked_all.silent)
    found = compared(robot, CARELESS[case](Delta(1), 2), first_run())
    assert (found.verdict, found.changed, found.indistinguishable) == ("undecided", (), ())
    assert found.advice


def test_the_same_rows_are_no_second_look(robot: Any) -> None:
    """Catches a copy, in another order, that vouches for its robot; between these rows nothing has changed."""
    first = first_run()
    order = np.random.default_rng(0).permutation(len(first["time_s"]))
    found = compared(robot, first, {name: values[order] for name, values in first.items()})
    assert (found.verdict, found.smallest_found, found.unseen) == ("unchanged", None, ())
    assert "same rows" in found.headline
    assert "nothing needs to be done" not in found.advice


def test_runs_that_speak_are_heard_beside_one_that_cannot(robot: Any) -> None:
    """Catches a whole comparison that is undecided for one bad run of three, and one that hides a change."""
    frozen = CARELESS["frozen"](Delta(1), 3)
    same = compared(robot, first_run(), frozen, run(Delta(1), 2))
    assert same.verdict == "unchanged"
    assert list(same.silent.values()) == ["its encoders do not move"]
    assert same.smallest_found is not None
    assert same.smallest_found <= TIMES * 20.0
    moved = compared(robot, first_run(), frozen, run(Delta(1).with_moved("rod_length_2", 0.05), 2))
    assert (moved.verdict, moved.changed) == ("changed", ("rod_length_2",))
    # the third run of those that were given
    assert moved.parameters[0].since == 2


def error_of(machine: Delta, changed: Delta) -> float:
    """How far a change moves the machine over its workspace (root mean square, µm), beside a tracker's stand."""
    made = run(machine, 9, 200, 1, 0.0)
    joints = np.column_stack([made[name] for name in JOINTS])
    before, after = machine.at(joints), changed.at(joints)
    arms = before - before.mean(axis=0)
    rigid = [np.tile(axis, len(before)) for axis in np.eye(3)] + [np.cross(axis, arms).ravel() for axis in np.eye(3)]
    basis, _ = np.linalg.qr(np.stack(rigid, axis=1))
    flat = (after - before).ravel()
    return 1e3 * float(np.linalg.norm(flat - basis @ (basis.T @ flat)) / np.sqrt(len(before)))


CHANGES = ("base_angle_1", "rod_length_2", "base_radius_3", "rod_length_1", "base_angle_3")


def moved_by(machine: Delta, name: str, error_um: float) -> Delta:
    """The machine with a change of one number that moves it so far."""
    return machine.with_moved(name, 1e-3 * error_um / error_of(machine, machine.with_moved(name, 1e-3)))


@pytest.mark.slow
def test_what_may_vouch_would_have_seen_it(robot: Any, calibration: Any) -> None:
    """Catches a power that is claimed and not there: of 20 runs that would be called unchanged and valid, changed by
    three times what is required, 20 must be refused (level: 0.36 where each is in 95 of 100, so two may be missed:
    0.075)."""
    machine, first = Delta(1), first_run()
    seen = []
    for k in range(20):
        settings = {"count": 8 + 4 * (k % 3), "noise_um": (5.0, 10.0)[k % 2]}
        still = run(machine, 100 + k, **settings)
        changed = run(moved_by(machine, CHANGES[k % 5], TIMES * 20.0), 100 + k, **settings)
        if compared(robot, first, still).verdict == "unchanged":
            seen.append(compared(robot, first, changed).verdict != "unchanged")
        if sk.verify(calibration, still).valid:
            seen.append(sk.verify(calibration, changed).valid is False)
    assert len(seen) > 30
    assert sum(seen) >= len(seen) - 2


# -- history ----------------------------------------------------------------------------------------------------------


MONTHS = [
    pytest.param(case, marks=[pytest.mark.slow] if case != "frozen" else [])
    for case in CARELESS if case != "another robot"
]  # fmt: skip


@pytest.mark.parametrize("case", MONTHS)
def test_a_careless_month_hides_nothing(robot: Any, case: str) -> None:
    """Catches a step that a frozen run in the middle hides, one at another run, and one that such a run makes."""
    moved = Delta(1).with_moved("rod_length_2", 0.05)
    months = [first_run(24), CARELESS[case](Delta(1), 2), run(Delta(1), 3, 24), run(moved, 4, 24)]
    found = sk.history(robot, months, effects=[])
    assert [(c.name, c.kind, c.since, c.date) for c in found.changes] == [("rod_length_2", "step", 3, "run 4")]
    assert found.changes[0].parameters[0][1] == pytest.approx(0.05, rel=0.2)


@pytest.mark.parametrize("case", MONTHS)
def test_a_careless_month_makes_no_step(robot: Any, case: str) -> None:
    """Catches a step that a run makes which says nothing, and a history that is undecided for it alone."""
    found = sk.history(robot, [first_run(24), CARELESS[case](Delta(1), 2), run(Delta(1), 3, 24)], effects=[])
    assert (found.verdict, len(found.silent)) == ("unchanged", 1)
    assert [one["error"] is None for one in found.runs] == [False, True, False]


def test_a_history_of_careless_runs_says_nothing(robot: Any) -> None:
    """Catches "unchanged" where only the first run can speak, and a run that is given twice."""
    months = [first_run(), CARELESS["frozen"](Delta(1), 2), CARELESS["one pose"](Delta(1), 3), first_run()]
    found = sk.history(robot, months, effects=[])
    assert (found.verdict, found.changes, len(found.silent)) == ("undecided", (), 3)
    assert "same rows" in found.headline
    assert found.advice


def test_dates_are_all_known_or_none(robot: Any) -> None:
    """Catches undated runs that are months since 1970, so that another run becomes the reference; dates before 1973,
    which were run numbers; and dates that no calendar has."""
    runs = [run(Delta(1), k) for k in (1, 2, 3)]
    dated = [pl.DataFrame(one).with_columns(date=pl.lit(f"2026-0{k}-01")) for k, one in enumerate(runs, 1)]
    with pytest.raises(MeasurementError, match="says no date, the other runs do"):
        sk.history(robot, [dated[0], pl.DataFrame(runs[1]), dated[2]], effects=[])
    old = sk.history(robot, runs[:2], dates=["1971-05-01", "1968-05-01"], effects=[])
    assert [one["date"] for one in old.runs] == ["1968-05-01", "1971-05-01"]
    assert [one["date"] for one in sk.history(robot, dated[:2], effects=[]).runs] == ["2026-01-01", "2026-02-01"]
    for wrong in (1e300, "", "soon"):
        with pytest.raises(MeasurementError, match="is no date"):
            sk.history(robot, runs[:2], dates=["2026-01-01", wrong], effects=[])


# -- verify -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", CARELESS)
def test_verify_does_not_vouch_for_a_careless_run(calibration: Any, case: str) -> None:
    """Catches "valid" by a run that could not have shown otherwise."""
    found = sk.verify(calibration, CARELESS[case](Delta(1), 2))
    assert found.verdict not in GOOD
    assert "nothing needs to be done" not in found.advice
    if case == "one encoder stuck":
        assert "q2_mm" in found.advice
    elif case != "another robot":
        assert found.verdict == "undecided"
        assert found.silent


def test_verify_vouches_for_a_careful_run(calibration: Any) -> None:
    """Catches a gate that nobody passes, and a change of three times what is needed behind it."""
    dozen = places(np.random.default_rng(5), 12)
    assert sk.verify(calibration, run(Delta(1), 2, at=dozen)).verdict == "valid"
    moved = moved_by(Delta(1), "rod_length_2", TIMES * 20.0)
    assert sk.verify(calibration, run(moved, 2, at=dozen)).verdict == "not valid"


@pytest.mark.slow
def test_a_long_run_is_verified(calibration: Any) -> None:
    """Catches draws as long as the run: 800 of 30,000 rows took 2.2 GB. (What it takes is counted by tracemalloc.)"""
    import tracemalloc

    long = run(Delta(1), 2, 10_000, 1)
    tracemalloc.start()
    try:
        found = sk.verify(calibration, long)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found.verdict == "valid"
    assert most < 250e6


# -- what is printed, drawn and shown ---------------------------------------------------------------------------------


@pytest.fixture
def folder(robot: Any, calibration: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Robot, calibration and runs as files."""
    sk.save_robot(robot, tmp_path / "robot.toml")
    calibration.save(tmp_path / "calibrated.toml")
    for name, made in {"good": first_run(), "after": run(Delta(1), 2), "frozen": CARELESS["frozen"](Delta(1), 3),
                       "corner": CARELESS["three poses"](Delta(1), 4)}.items():  # fmt: skip
        pl.DataFrame(made).write_csv(tmp_path / f"{name}.csv")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said(*typed: str) -> tuple[int, str]:
    """Exit code and all that a command prints."""
    code, out, err = command(Path(), *typed)
    return code, out + err


def test_commands_pages_and_notebooks_say_the_same(folder: Path) -> None:
    """Catches a page or a terminal that says less than the verdict, and a run that is left out without its name."""
    code, text = said("compare", "robot.toml", "good.csv", "frozen.csv", "--report", "page.html")
    page = (folder / "page.html").read_text(encoding="utf-8")
    assert code == 0
    assert all(
        "frozen.csv: its encoders do not move" in one and "undecided" in one for one in (" ".join(text.split()), page)
    )
    code, text = said("history", "robot.toml", "good.csv", "frozen.csv", "after.csv", "--report", "page.html")
    page = (folder / "page.html").read_text(encoding="utf-8")
    assert code == 0
    for one in (" ".join(text.split()), page):
        assert "frozen.csv: its encoders do not move" in one
        assert "would have been seen in 95 of 100 cases" in one
    code, text = said("verify", "calibrated.toml", "corner.csv")
    assert code == 0
    assert text.startswith("Verdict: undecided: ")
    assert "corner.csv: it would show" in text
    code, text = said("verify", "calibrated.toml", "after.csv")
    # what the run can see stands beside what it saw
    assert re.match(r"Verdict: valid: [^\n]*\n *(These rows cannot tell|An error of)", text)
    assert "95 of 100" in " ".join(text.split())


def test_values_show_themselves_in_a_notebook(robot: Any, calibration: Any) -> None:
    """Catches a cell that ends in a traceback."""
    pytest.importorskip("bokeh", reason="notebooks need Bokeh")
    runs = [first_run(), run(Delta(1), 2)]
    for value in (compared(robot, *runs), sk.history(robot, runs, effects=[]), sk.verify(calibration, runs[1])):
        assert str(value).splitlines()[0].split()[0] in (value._repr_html_() or "")


def test_a_plan_of_a_check_takes_no_experiment(folder: Path) -> None:
    """Catches an experiment that is ignored without a word."""
    code, text = said("plan", "calibrated.toml", "experiment.toml", "--verify")
    assert code != 0
    assert "experiment.toml" in text
    assert "--verify" in text
