"""Plans, run files, the runner, and identification while the rows come in."""

from __future__ import annotations

import errno
import json
import os
import sqlite3
import threading
from dataclasses import replace

import numpy as np
import polars as pl
import pytest
import tomli_w

from laboratories import ROBOT, experiment, laboratory
from sherkit import load_robot, read_measurements
from sherkit.errors import ExperimentError, Halted, InstrumentError, MeasurementError, OutOfRange, SherkitWarning
from sherkit.lab.experiment import (
    Control,
    Goal,
    Live,
    Plan,
    PlanStep,
    Point,
    RunFile,
    export_run,
    load_experiment,
    plan_of_poses,
    run,
    run_lock,
)
from sherkit.lab.experiment.bench import Sensor
from sherkit.lab.instruments import transport
from sherkit.lab.instruments.base import Reading
from sherkit.lab.instruments.keyence import Keyence
from sherkit.lab.laboratory import RunningLaboratory, load_laboratory

JOINTS = np.array([[100.0, 101.0, 102.0], [110.0, 111.0, 100.0], [105.0, 111.0, 104.0]])
START = (90.0, 90.0, 90.0)


# -- plans ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("order", "poses"),
    [
        ("planes", [1, 2, 3, 1, 2, 3]),
        ("reversed", [3, 2, 1, 3, 2, 1]),
        ("alternating", [1, 2, 3, 3, 2, 1]),
    ],
)
def test_the_order_of_a_plan(order, poses):
    """Catches passes that go the wrong way round, and repeats that are numbered by place and not by pass."""
    plan = plan_of_poses(JOINTS, START, repeats=2, order=order)
    assert [s.pose for s in plan] == poses
    assert [s.repeat for s in plan] == [1, 1, 1, 2, 2, 2]
    assert all(s.joints == tuple(JOINTS[s.pose - 1]) for s in plan)


def test_a_shuffled_plan_is_drawn_anew_and_the_same_by_its_seed():
    """Catches an order that is the same in every pass, which drift would follow, or another one after a resume."""
    joints = np.arange(60.0).reshape(-1, 3)
    plan = plan_of_poses(joints, START, repeats=2, order="shuffled", seed=4)
    passes = [s.pose for s in plan][:20], [s.pose for s in plan][20:]
    assert sorted(passes[0]) == sorted(passes[1]) == list(range(1, 21))
    assert passes[0] != passes[1]
    assert plan == plan_of_poses(joints, START, repeats=2, order="shuffled", seed=4)
    assert plan != plan_of_poses(joints, START, repeats=2, order="shuffled", seed=5)


def test_a_pose_is_approached_from_both_sides():
    """Catches a second reading that comes from the same side, and a direction that is that of the way there."""
    plan = plan_of_poses(JOINTS, START, approach=0.5)
    assert [(s.pose, s.repeat) for s in plan] == [(1, 1), (1, 2), (2, 1), (2, 2), (3, 1), (3, 2)]
    assert plan.steps[0].via == ((99.5, 100.5, 101.5),)
    assert plan.steps[1].via == ((100.5, 101.5, 102.5),)
    assert plan.directions.tolist() == [[1.0] * 3, [-1.0] * 3] * 3


def test_directions_and_the_way_back_into_a_plan():
    """Catches a resumed run whose joints come from another side than planned, where one of them did not move last."""
    plan = plan_of_poses(JOINTS, START)
    assert plan.directions.tolist() == [[1, 1, 1], [1, 1, -1], [-1, 1, 1]]
    assert plan.lead_in(0) == (START,)
    assert plan.lead_in(1) == (tuple(JOINTS[0]),)
    # the second joint does not move on the way to the third pose: it came there with the second
    assert plan.lead_in(2) == (tuple(JOINTS[0]), tuple(JOINTS[1]))


def test_a_plan_survives_its_text():
    """Catches a plan that a resumed run reads back otherwise."""
    plan = plan_of_poses(JOINTS / 3.0, START, repeats=2, approach=0.1)
    assert Plan.from_json(plan.to_json()) == plan
    for text in ("", "{}", '{"start": [1], "steps": [[1, 1]]}', '{"start": [1], "steps": []}'):
        with pytest.raises(ExperimentError):
            Plan.from_json(text)


def test_plans_that_are_none_are_refused():
    """Catches a pose and repeat that are there twice: the run file would refuse the second after hours."""
    with pytest.raises(ExperimentError, match="both are pose 1, repeat 1"):
        Plan((PlanStep(1, 1, (1.0,)), PlanStep(1, 1, (2.0,))), (0.0,))
    with pytest.raises(ExperimentError, match="finite"):
        Plan((PlanStep(1, 1, (float("nan"),)),), (0.0,))
    with pytest.raises(ExperimentError, match="finite"):
        Plan((PlanStep(1, 1, (1.0, 2.0)),), (0.0,))
    with pytest.raises(ExperimentError, match="no step"):
        Plan((), (0.0,))
    with pytest.raises(ExperimentError, match="order"):
        plan_of_poses(JOINTS, START, order="wild")
    with pytest.raises(ExperimentError, match="repeats"):
        plan_of_poses(JOINTS, START, repeats=0)


# -- run files -----------------------------------------------------------------------------------------------

PLAN = plan_of_poses(JOINTS, START)
ABOUT = {"robot": "kind = 'delta'", "experiment": ""}


def point(pose, **values):
    return Point(pose, 1, 1000.0 + pose, {"q1_mm": 1.5, "x_mm": 0.1 + pose, "y_mm": float("nan"), **values})


def test_a_run_file_gives_back_what_it_was_given(tmp_path):
    """Catches a digit that is lost, an empty cell that becomes zero, and columns in another order."""
    with RunFile.create(tmp_path / "a.sqlite", PLAN, ABOUT) as file:
        file.begin({"rails": {"kind": "Galil", "identity": "x", "port": "tcp://a:1", "settings": {"speed": 1}}})
        file.store(1, point(2, z_mm=1 / 3))
        file.store(0, point(1, z_mm=1e-17))
        file.note("paused", 2)
        file.end("ended")
    with RunFile.open(tmp_path / "a.sqlite") as file:
        assert file.done() == {0, 1}
        assert file.plan == PLAN
        frame = file.frame()
        assert frame.columns == ["step", "time_s", "pose", "repeat", "q1_mm", "x_mm", "y_mm", "z_mm"]
        assert frame["z_mm"].to_list() == [1e-17, 1 / 3]
        assert frame["y_mm"].to_list() == [None, None]
        assert [p.pose for p in file.points()] == [1, 2]
        assert file.diary()[0][1:] == (2, "paused")
        assert file.instruments() == [(1, "rails", "Galil", "x", "tcp://a:1")]


def test_a_step_is_stored_once_and_whole(tmp_path):
    """Catches a step that is stored twice, or of which half is there after a failure."""
    with RunFile.create(tmp_path / "a.sqlite", PLAN, ABOUT) as file:
        file.begin({})
        file.store(0, point(1))
        with pytest.raises(ExperimentError, match="step 0 is stored already"):
            file.store(0, point(1, x_mm=9.0))
        with pytest.raises(ExperimentError):
            file.store(1, point(1))
        assert file.done() == {0}
        assert file.points()[0].values["x_mm"] == 1.1


def test_a_full_disk_is_a_sentence(tmp_path):
    """Catches a traceback of SQLite from what is not a row: a session, the diary, a mark, a reference."""
    with RunFile.create(tmp_path / "a.sqlite", PLAN, ABOUT) as file:
        file.begin({})
        file.store(0, point(1))
        file._db.execute(f"PRAGMA max_page_count = {file._db.execute('PRAGMA page_count').fetchone()[0]}")
        much = "x" * 100_000
        for write in (
            lambda: file.note(much),
            lambda: file.doubt([0], "beam", much),
            lambda: file.end(much),
            lambda: file.begin({"rails": {"kind": much, "identity": "x", "port": "", "settings": {}}}),
        ):
            with pytest.raises(ExperimentError, match=r"a\.sqlite: cannot be written: .*full"):
                write()
        assert file.done() == {0}


def test_a_full_disk_is_not_a_damaged_run(tmp_path):
    """Catches a person who throws a whole run away since there was no room to read it in."""

    class Full:
        def execute(self, *_):
            error = sqlite3.OperationalError("database or disk is full")
            error.sqlite_errorname = "SQLITE_FULL"
            raise error

    with RunFile.create(tmp_path / "a.sqlite", PLAN, ABOUT) as file:
        whole, file._db = file._db, Full()
        with pytest.raises(ExperimentError, match=r"a\.sqlite: cannot be read now: database or disk is full"):
            file.done()
        file._db = whole


def test_a_run_keeps_its_own_time(tmp_path, monkeypatch):
    """Catches rows that are judged at another time than they are stored with, after the clock was set back."""
    with RunFile.create(tmp_path / "a.sqlite", PLAN, ABOUT) as file:
        file.begin({})
        file.store(0, replace(point(1), time_s=transport.now_s()))
    monkeypatch.setattr(transport, "_WALL_S", transport._WALL_S - 3600.0)
    with RunFile.resume(tmp_path / "a.sqlite", PLAN, ABOUT) as file:
        with pytest.warns(SherkitWarning, match="set back by 360"):
            file.begin({})
        now = file.store(1, replace(point(2), time_s=transport.now_s()))
        assert [p.time_s for p in file.points()][1] == now.time_s > file.points()[0].time_s


def test_a_disk_that_cannot_lock_is_not_another_runner(tmp_path, monkeypatch):
    """Catches a person who is sent to look for a program that is not there: some network disks have no locks."""

    def none(_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(run_lock, "_take", none)
    with pytest.raises(ExperimentError, match=r"a\.sqlite\.lock: cannot be locked: No locks available"):
        RunFile.create(tmp_path / "a.sqlite", PLAN, ABOUT)


def test_a_second_name_of_a_run_is_the_same_run(tmp_path):
    """Catches a second runner through a hard link, whose log takes rows away that the first one acknowledged."""
    with RunFile.create(tmp_path / "a.sqlite", PLAN, ABOUT) as file:
        file.begin({})
        (tmp_path / "elsewhere").mkdir()
        os.link(tmp_path / "a.sqlite", tmp_path / "elsewhere" / "b.sqlite")
        with pytest.raises(ExperimentError, match=r"b\.sqlite: is being measured by another program"):
            run_lock.RunLock(tmp_path / "elsewhere" / "b.sqlite")
        os.symlink(tmp_path / "a.sqlite", tmp_path / "c.sqlite")
        with pytest.raises(ExperimentError, match="one run has one runner"):
            run_lock.RunLock(tmp_path / "c.sqlite")
    run_lock.RunLock(tmp_path / "elsewhere" / "b.sqlite").release()


def test_the_run_file_is_as_safe_as_it_says(tmp_path):
    """Catches a write-ahead log or a synchronous mode that a change of libraries has switched off."""
    with RunFile.create(tmp_path / "a.sqlite", PLAN, ABOUT) as file:
        assert file._db.execute("PRAGMA journal_mode").fetchone()[0] == "wal"
        assert file._db.execute("PRAGMA synchronous").fetchone()[0] == 2
        assert file._db.execute("PRAGMA trusted_schema").fetchone()[0] == 0


def test_files_that_are_no_run_are_refused_and_left_alone(tmp_path):
    """Catches another program's database that is written to, and a run that goes on with another plan."""
    (tmp_path / "text.sqlite").write_text("no database at all, but long enough to be looked at as one" * 20)
    other = sqlite3.connect(tmp_path / "other.sqlite")
    other.execute("CREATE TABLE theirs (x)")
    other.commit()
    other.close()
    before = (tmp_path / "other.sqlite").read_bytes()
    for name in ("text.sqlite", "other.sqlite"):
        for make in (RunFile.create, RunFile.resume):
            with pytest.raises(ExperimentError, match=name):
                make(tmp_path / name, PLAN, ABOUT)
        with pytest.raises(ExperimentError, match=name):
            RunFile.open(tmp_path / name)
    assert (tmp_path / "other.sqlite").read_bytes() == before
    with pytest.raises(ExperimentError, match="no such run file"):
        RunFile.open(tmp_path / "none.sqlite")
    RunFile.create(tmp_path / "a.sqlite", PLAN, ABOUT).close()
    with pytest.raises(ExperimentError, match="--resume"):
        RunFile.create(tmp_path / "a.sqlite", PLAN, ABOUT)
    with pytest.raises(ExperimentError, match="another plan"):
        RunFile.resume(tmp_path / "a.sqlite", plan_of_poses(JOINTS + 1, START), ABOUT)
    with pytest.raises(ExperimentError, match="another robot"):
        RunFile.resume(tmp_path / "a.sqlite", PLAN, {**ABOUT, "robot": "kind = 'other'"})
    RunFile.resume(tmp_path / "a.sqlite", PLAN, {**ABOUT, "experiment": "poll_s = 1"}).close()


def test_a_file_that_a_program_left_empty_is_begun(tmp_path):
    """Catches a run that cannot be resumed since the program died while it made the file."""
    (tmp_path / "a.sqlite").write_bytes(b"")
    with RunFile.resume(tmp_path / "a.sqlite", PLAN, ABOUT) as file:
        assert file.done() == set()


def test_export_reads_a_run_that_goes_on(tmp_path):
    """Catches an export that waits for the run's end, one that is half written, and a format that is guessed."""
    with RunFile.create(tmp_path / "a.sqlite", PLAN, ABOUT) as file:
        file.begin({})
        with pytest.raises(ExperimentError, match="no row"):
            export_run(tmp_path / "a.sqlite", tmp_path / "a.csv")
        file.store(0, point(1, q2_mm=2.0, q3_mm=3.0, z_mm=0.25))
        assert export_run(tmp_path / "a.sqlite", tmp_path / "a.csv") == 1
        assert export_run(tmp_path / "a.sqlite", tmp_path / "a.parquet") == 1
    assert pl.read_parquet(tmp_path / "a.parquet")["time_s"].to_list() == [0.0]
    data = read_measurements(tmp_path / "a.csv")
    assert data.readings[0, 2] == 0.25
    assert not data.taken[0, 1]
    with pytest.raises(ExperimentError, match=r"\.csv or \.parquet"):
        export_run(tmp_path / "a.sqlite", tmp_path / "a.pickle")


def test_a_run_file_is_no_table(tmp_path):
    """Catches a run file handed to calibrate that is refused without the word that helps."""
    with sqlite3.connect(tmp_path / "run.sqlite") as made:
        made.execute("create table anything (x)")
    with pytest.raises(
        MeasurementError, match=r"is the run file of an experiment; sherkit export run\.sqlite -o run\.csv"
    ):
        read_measurements(tmp_path / "run.sqlite")


# -- experiments ---------------------------------------------------------------------------------------------


@pytest.fixture
def lab(tmp_path):
    """A running laboratory, whose files and an experiment of 18 poses are in the folder."""
    experiment(tmp_path)
    with RunningLaboratory(load_laboratory(laboratory(tmp_path))) as running:
        running.write_ports(tmp_path / "ports.json")
        yield running


def test_a_run_stores_what_the_robot_did(lab, tmp_path):
    """Catches a reading under another pose, joints that are the targets and not the encoders, directions left out."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    seen = []
    with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
        assert run(chosen.plan, bench, file, report=seen.append) == "complete"
        assert run(chosen.plan, bench, file) == "complete"
        frame = file.frame()
        names = {row[1]: row[3] for row in file.instruments()}
    assert [p.step for p in seen] == list(range(18))
    assert seen[-1].stored == seen[-1].total == 18
    assert "DMC" in names["rails"]
    joints = frame.select("q1_mm", "q2_mm", "q3_mm").to_numpy()
    true = np.array([lab.bench.position(q, 0.0) for q in joints])
    noise = frame.select("x_mm", "y_mm", "z_mm").to_numpy() - true
    assert 0.003 < noise.std() < 0.008
    assert np.abs(joints - [s.joints for s in chosen.plan]).max() < 1e-3
    assert frame.select("direction_1", "direction_2", "direction_3").to_numpy().tolist() == (
        chosen.plan.directions.tolist()
    )
    assert np.abs(true - chosen.targets[frame["pose"].to_numpy() - 1]).max() > 0.1


def test_a_run_pauses_goes_on_and_ends(lab, tmp_path):
    """Catches a pause that moves on, an end that loses the step, and a resumed run that begins anew."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    control = Control()
    paused = threading.Event()

    def report(now):
        if now.step == 4:
            control.pause()
            paused.set()
        if now.step == 9:
            control.end()

    def go_on():
        paused.wait(600.0)
        before = lab.world.joints()
        stood.append(not threading.Event().wait(0.3) and np.array_equal(before, lab.world.joints()))
        control.resume()

    stood = []
    other = threading.Thread(target=go_on)
    other.start()
    with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
        assert run(chosen.plan, bench, file, control=control, report=report) == "ended"
        other.join(600.0)
        assert stood == [True]
        assert file.done() == set(range(10))
        assert [line[2] for line in file.diary()] == ["paused", "resumed"]
    with RunFile.resume(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
        again = []
        assert run(chosen.plan, bench, file, report=again.append) == "complete"
    assert [p.step for p in again] == list(range(10, 18))


def test_a_failure_stops_is_told_and_can_be_resumed(lab, tmp_path):
    """Catches a beam that is lost for one pose and stored as the last value, and an error that the file forgets."""
    chosen = load_experiment(tmp_path / "experiment.toml")

    def report(now):
        if now.step == 6:
            lab.emulators["lasers"].faults.schedule("over_range", 2)

    with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
        with pytest.raises(OutOfRange, match="lasers"):
            run(chosen.plan, bench, file, report=report)
        assert file.done() == set(range(7))
        assert file.diary()[-1][1] == 7
        assert "lasers" in file.diary()[-1][2]
        assert run(chosen.plan, bench, file) == "complete"
        assert file.done() == set(range(18))


def test_a_step_is_tried_again_where_a_line_failed(lab, tmp_path):
    """Catches a night that is lost for one time-out, and a limit switch that is driven into again and again."""
    experiment(tmp_path, retry={"attempts": 3}, lasers={"timeout_s": 2.0, "retries": 0})
    chosen = load_experiment(tmp_path / "experiment.toml")

    def report(now):
        if now.step in (3, 9):
            lab.emulators["lasers"].faults.schedule("drop" if now.step == 3 else "disconnect", 2)
        if now.step == 12:
            # how many answers come before the axes move depends on the machine; at rest the switch does nothing
            for k in range(40):
                lab.emulators["rails"].faults.schedule("limit_switch", k)

    with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
        with pytest.raises(Halted, match="limit switch"):
            run(chosen.plan, bench, file, attempts=chosen.attempts, report=report)
        lab.emulators["rails"].faults.clear()
        assert file.done() == set(range(13))
        told = [(step, what) for _, step, what in file.diary()]
        assert [step for step, _ in told] == [4, 10, 13]
        assert "tried again after: lasers on" in told[0][1]
        assert run(chosen.plan, bench, file, attempts=chosen.attempts) == "complete"


def test_ctrl_c_stops_the_motors(tmp_path):
    """Catches an interrupt that leaves the motors on their way."""
    laboratory(tmp_path, time_scale=2.0)
    experiment(tmp_path)
    with RunningLaboratory(load_laboratory(tmp_path / "lab.toml")) as lab:
        lab.write_ports(tmp_path / "ports.json")
        chosen = load_experiment(tmp_path / "experiment.toml")
        bench = chosen.bench()
        watch = bench.motion._running

        def interrupted(letters, timeout_s):
            if lab.world.joints().tolist() != lab.bench.home_joints.tolist():
                bench.motion._running = watch
                raise KeyboardInterrupt
            return watch(letters, timeout_s)

        bench.motion._running = interrupted
        with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file:
            with pytest.raises(KeyboardInterrupt), bench:
                run(chosen.plan, bench, file)
            before = lab.world.joints()
            threading.Event().wait(0.1)
            assert np.array_equal(before, lab.world.joints())
            assert not np.allclose(before, chosen.plan.steps[0].joints, atol=0.01)
            assert "KeyboardInterrupt" in file.diary()[-1][2]


def test_warming_up_moves_and_reads_nothing(lab, tmp_path):
    """Catches a warm-up that stores rows or does not move."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    read = len(lab.emulators["lasers"].log)
    begin = sum(c.startswith(b"BG") for c, _, _ in lab.emulators["rails"].log)
    control = Control()
    control.end()
    with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
        run(chosen.plan, bench, file, warm_up_s=0.3, control=control)
        assert file.done() == set()
        # they are asked who they are, and looked at once before anything moves
        assert len(lab.emulators["lasers"].log) - read < 20
        control = Control()
        run(chosen.plan, bench, file, warm_up_s=2.0, control=control, report=lambda _: control.end())
        assert file.done() == {0}
    assert sum(c.startswith(b"BG") for c, _, _ in lab.emulators["rails"].log) - begin > 4


def test_settling_waits_until_the_reading_is_still(lab, tmp_path):
    """Catches a reading of a robot that still swings, and one that never comes to rest and is taken all the same."""
    experiment(tmp_path, settle={"seconds": 0.0, "within_mm": 0.002, "longest_s": 3.0})
    chosen = load_experiment(tmp_path / "experiment.toml")
    position = lab.bench.position
    swings = {"left": 12}

    def swinging(joints, time_s):
        swings["left"] -= 1
        return position(joints, time_s) + (0.05 * (swings["left"] % 7) if swings["left"] > 0 else 0.0)

    lab.bench.position = swinging
    with chosen.bench() as bench:
        seen = bench.measure(chosen.plan.steps[0])
        true = position(np.array([seen.values[f"q{k}_mm"] for k in (1, 2, 3)]), 0.0)
        assert np.abs(np.array([seen.values[f"{a}_mm"] for a in "xyz"]) - true).max() < 0.03
        swings["left"] = 10**9
        with pytest.raises(InstrumentError, match="does not stand still"):
            bench.measure(chosen.plan.steps[1])


def test_a_position_that_cannot_be_is_not_stored(lab, tmp_path):
    """Catches a beam on the wrong face of the cube, whose readings look like any others."""
    experiment(tmp_path, check={"plausible_mm": 5.0})
    chosen = load_experiment(tmp_path / "experiment.toml")
    position = lab.bench.position
    lab.bench.position = lambda joints, time_s: position(joints, time_s) + 40.0
    with chosen.bench() as bench, pytest.raises(OutOfRange, match="by the drawing"):
        bench.measure(chosen.plan.steps[0])


# -- files ---------------------------------------------------------------------------------------------------


def changed(tmp_path, **tables):
    experiment(tmp_path, **tables)
    (tmp_path / "robot.toml").write_text(tomli_w.dumps(ROBOT))
    ports = {n: {"kind": "x", "address": "tcp://127.0.0.1:9"} for n in ("rails", "lasers")}
    (tmp_path / "ports.json").write_text(json.dumps(ports))
    return tmp_path / "experiment.toml"


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ({"plan": {"half_width_mm": 60.0}}, "cannot|reach"),
        ({"plan": {"planes_mm": [80.0]}}, "the plan sends a joint to"),
        ({"plan": {"order": "wild"}}, "order"),
        ({"plan": {"pose": "grid"}}, "pose"),
        ({"lasers": {"columns": ["a_mm", "b_mm", "c_mm"]}}, "no instrument reads any"),
        ({"lasers": {"kind": "laser"}}, "kind"),
        ({"lasers": {"name": "other"}}, "has no address"),
        ({"rails": {"counts_per_mm": 0}}, "other than 0"),
        ({"goal": {"std": 1.0}}, "std_um"),
    ],
)
def test_experiments_that_cannot_be_are_refused(tmp_path, tables, said):
    """Catches a mistake in a file that would be found when the motors already move."""
    path = changed(tmp_path, **tables)
    with pytest.raises(Exception, match=said) as caught:
        load_experiment(path)
    assert type(caught.value).__name__ in ("ExperimentError", "OutOfReach")


def test_nothing_moves_without_soft_limits(tmp_path):
    """Catches a robot file without limits that is driven all the same."""
    path = changed(tmp_path)
    (tmp_path / "robot.toml").write_text(tomli_w.dumps({**ROBOT, "joints": {"pole_pitch_mm": 2.0}}))
    with pytest.raises(ExperimentError, match="limits_mm is missing"):
        load_experiment(path)
    (tmp_path / "robot.toml").write_text(
        tomli_w.dumps({**ROBOT, "joints": {"pole_pitch_mm": 2.0, "limits_mm": [125.0, 130.0]}})
    )
    with pytest.raises(ExperimentError, match="the plan sends a joint to"):
        load_experiment(path)


@pytest.mark.parametrize(
    ("plan", "count"),
    [
        ({"poses": "paper_local"}, 363),
        ({"poses": "paper_whole"}, 588),
        ({"poses": "line", "from_mm": [-5, 0, 0], "to_mm": [5, 0, 0], "count": 11}, 11),
        ({"poses": "list", "list_mm": [[1, 2, 3], [0, 0, 0]]}, 2),
        ({"poses": "diagnosis", "file": "found.json"}, 2),
        ({"poses": "designed", "half_width_mm": 15.0, "per_side": 5, "planes_mm": [-9, 0, 9], "count": 20}, 20),
    ],
)
def test_the_poses_that_a_plan_can_name(tmp_path, plan, count):
    """Catches poses of a diagnosis in another order, and grids that are not the paper's."""
    found = {"next_poses": [{"x_mm": k, "y_mm": 0, "z_mm": 0, "separation_sigma": 1} for k in (1, 2)]}
    (tmp_path / "found.json").write_text(json.dumps(found))
    path = changed(tmp_path)
    values = {**load_toml(path), "plan": {"repeats": 2, **plan}}
    path.write_text(tomli_w.dumps(values))
    chosen = load_experiment(path)
    assert len(chosen.plan) == 2 * count
    robot = load_robot(tmp_path / "robot.toml")
    assert np.allclose(robot.forward_batch([s.joints for s in chosen.plan]).require("x"),
                       np.tile(chosen.targets, (2, 1)), atol=1e-9)  # fmt: skip


def load_toml(path):
    import tomllib

    return tomllib.loads(path.read_text())


# -- live ----------------------------------------------------------------------------------------------------


def simulated(robot, seed=0, count=120, noise_mm=0.005):
    """Points of a virtual delta over a shuffled grid, and their plan."""
    from sherkit.robots.delta import VirtualDelta, grid

    virtual = VirtualDelta.draw(robot, seed, noise_mm=0.0)
    plan = plan_of_poses(
        robot.inverse_batch(grid(15.0, 6, (-15.0, 0.0, 15.0))).require("pose"), robot.inverse([0, 0, 0]),
        repeats=2, order="shuffled",
    )  # fmt: skip
    home = virtual.true_reading(robot.inverse([0, 0, 0]))[0]
    rng = np.random.default_rng(seed)
    points = []
    for k, step in enumerate(plan.steps[:count]):
        seen = virtual.true_reading(step.joints)[0] - home + noise_mm * rng.normal(size=3)
        values = {f"q{n + 1}_mm": q for n, q in enumerate(step.joints)}
        points.append(Point(step.pose, step.repeat, 1e9 + k, {**values, **dict(zip(("x_mm", "y_mm", "z_mm"), seen,
                                                                                   strict=True))}))  # fmt: skip
    return plan, points


def test_live_identification_says_when_it_is_enough(tmp_path):
    """Catches a verdict after too few rows, a forecast that is far off, and a residual of rows that were fitted."""
    (tmp_path / "robot.toml").write_text(tomli_w.dumps(ROBOT))
    robot = load_robot(tmp_path / "robot.toml")
    plan, points = simulated(robot)
    live = Live(robot, plan, Goal(2.5))
    enough_at = forecast = None
    for k, one in enumerate(points):
        live.add(one)
        if k < 3:
            assert live.worst is None
            assert not live.enough
        if k == 40:
            forecast = live.rows + live.rows_to_go
        if live.enough and enough_at is None:
            enough_at = k + 1
    assert enough_at is not None
    assert forecast is not None
    assert abs(forecast - enough_at) < 0.35 * enough_at
    # three axes of 5 µm each
    assert 2.0 < live.residual < 25.0
    assert "further poses no longer help" in live.sentence()
    # what it says of the positions is true of them
    later = Live(robot, plan)
    for one in points[:30]:
        later.take(one)
    later.refit()
    assert later.worst[1] > 1.5 * live.worst[1]
    everywhere = simulated(robot, count=108, noise_mm=0.0)[1]
    left = [later._residual(one) for one in everywhere]
    assert 0.2 * later.worst[1] < max(left) < 3.0 * np.sqrt(3) * later.worst[1]


def test_without_a_fit_the_residual_is_that_of_the_drawing(tmp_path):
    """Catches a residual that is not told while a run is measured, or one of a robot that was not drawn."""
    (tmp_path / "robot.toml").write_text(tomli_w.dumps(ROBOT))
    robot = load_robot(tmp_path / "robot.toml")
    plan, points = simulated(robot, count=20)
    live = Live(robot, plan, fitting=False)
    for one, step in zip(points, plan, strict=False):
        live.add(one)
        away = np.array([one.values[f"{a}_mm"] for a in "xyz"]) - robot.forward(step.joints)
        assert live.residual == pytest.approx(1e3 * np.linalg.norm(away), rel=1e-9)
    assert live.fit is None
    assert live.short().endswith("µm from the drawing")


def test_live_identification_is_the_identification(tmp_path):
    """Catches a fit of the rows so far that is not what identify makes of the exported run."""
    from sherkit import identify

    (tmp_path / "robot.toml").write_text(tomli_w.dumps(ROBOT))
    robot = load_robot(tmp_path / "robot.toml")
    plan, points = simulated(robot, count=60)
    live = Live(robot, plan, Goal(1.0, of="parameters"))
    with RunFile.create(tmp_path / "run.sqlite", plan, ABOUT) as file:
        file.begin({})
        for k, one in enumerate(points):
            live.add(one)
            file.store(k, one)
        live.refit()
        fit = identify(robot, file.measurements())
    assert np.allclose(live.fit.values, fit.values, atol=1e-7)
    assert live.worst[1] == pytest.approx(1e3 * max(fit.std_from_readings * [p.lever_mm for p in fit.parameters]))
    assert not live.enough
    assert live.rows_to_go > 0


@pytest.mark.parametrize(
    ("unit", "column", "value"),
    [("mN", "force_x_mn", 120.0), ("N", "force_x_mn", 120e3), ("um", "x_mm", 0.12), ("mm", "x_mm", 120.0)],
)
def test_values_are_converted_to_the_unit_of_their_column(unit: str, column: str, value: float) -> None:
    """Catches an instrument in the very unit of the column that is refused, since columns spell it in small letters."""
    reading = Reading("cell", ("x",), (120.0,), (unit,), 0.0)
    assert Sensor(Keyence("tcp://127.0.0.1:1", (1,)), (column,)).named(reading) == {column: pytest.approx(value)}
