"""Power that goes at any moment, axes of which nobody knows where they stand: nothing moves wrongly, no row is lost."""

from __future__ import annotations

import random
import sqlite3
import threading
import time
from collections import Counter

import numpy as np
import pytest

from dummies import dummy_bench
from laboratories import ROBOT, experiment, laboratory
from sherkit.cli import main
from sherkit.errors import ExperimentError, Implausible, InstrumentError, NotReferenced, SherkitError, SherkitWarning
from sherkit.lab.experiment import Control, RunFile, load_experiment, plan_of_poses, run
from sherkit.lab.instruments import Galil, transport
from sherkit.lab.laboratory import RunningLaboratory, load_laboratory
from sherkit.model.kinds import robot_from_tables

#: Where the home switches sit: within the limits of 60 to 200 mm.
HOME = [190.0, 190.0, 190.0]
#: 5 mm/s against 50 mm/s².
BRAKING_MM = 0.25


@pytest.fixture
def lab(tmp_path):
    """A running laboratory whose controller can home, and an experiment of 18 poses."""
    experiment(tmp_path, rails={"home_at_mm": HOME, "home_speed_mm_s": 5.0})
    with RunningLaboratory(load_laboratory(laboratory(tmp_path, noise_mm=0.0, rails={"home_mm": HOME}))) as running:
        running.write_ports(tmp_path / "ports.json")
        yield running


def interrupted(chosen, after=5):
    """A run that a person has ended after so many steps."""
    control = Control()
    with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:

        def report(now):
            if now.step == after:
                control.end()

        assert run(chosen.plan, bench, file, control=control, report=report) == "ended"


def go_on(chosen, **more):
    with RunFile.resume(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
        return run(chosen.plan, bench, file, **more)


def check_rows(lab, chosen):
    """Every row is there, once, and says where the robot really was."""
    with RunFile.open(chosen.run_path) as file:
        assert file.done() == set(range(len(chosen.plan)))
        points = file.points()
    for point, step in zip(points, chosen.plan, strict=True):
        joints = np.array([point.values[f"q{k}_mm"] for k in (1, 2, 3)])
        seen = np.array([point.values[f"{a}_mm"] for a in "xyz"])
        assert np.abs(joints - step.joints).max() < 0.0101
        assert np.abs(seen - lab.bench.position(joints, 0.0)).max() < 0.002


def command(*arguments):
    """A command that goes well."""
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    assert ended.value.code == 0


def power_cut(emulator):
    emulator.switch_off()
    emulator.switch_on()


def test_after_a_power_cut_of_the_controller_nothing_moves_until_it_is_homed(lab, tmp_path, capsys):
    """Catches the run that went on at 281 mm: a controller that counts from 0 where the robot stands at 130 mm."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    interrupted(chosen)
    power_cut(lab.emulators["rails"])
    before = lab.world.joints()
    with pytest.raises(NotReferenced, match=r"lost its zero.*Nothing was moved.*sherkit home"):
        go_on(chosen)
    assert np.array_equal(before, lab.world.joints())
    command("home", tmp_path / "experiment.toml", "--yes")
    said = capsys.readouterr().out
    assert "was not zeroed since it was switched on" in said
    assert "zero set" in said
    assert np.abs(lab.world.joints() - chosen.plan.start).max() < 0.01
    assert go_on(chosen) == "complete"
    check_rows(lab, chosen)
    with RunFile.open(chosen.run_path) as file:
        assert any("set anew" in what for _, _, what in file.diary())


def test_a_retry_does_not_move_a_controller_that_lost_its_zero(lab, tmp_path):
    """Catches new connections that take up whatever the controller now counts."""
    laboratory(tmp_path / "tcp", noise_mm=0.0, rails={"link": "tcp"})
    experiment(tmp_path / "tcp", retry={"attempts": 3}, rails={"timeout_s": 1.0})
    with RunningLaboratory(load_laboratory(tmp_path / "tcp" / "lab.toml")) as other:
        other.write_ports(tmp_path / "tcp" / "ports.json")
        chosen = load_experiment(tmp_path / "tcp" / "experiment.toml")
        where = []

        def report(now):
            if now.step == 4:
                power_cut(other.emulators["rails"])
                where.append(other.world.joints())

        with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
            with pytest.raises(NotReferenced, match="lost its zero"):
                run(chosen.plan, bench, file, attempts=3, report=report)
            assert file.done() == set(range(5))
        assert np.array_equal(where[0], other.world.joints())


def test_a_power_cut_that_the_line_does_not_show_is_seen_before_the_next_motion(lab, tmp_path):
    """Catches a serial line that stays open over it, with the program none the wiser."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    with chosen.bench() as bench:
        bench.drive(chosen.plan.start)
        bench.drive(chosen.plan.steps[0].joints)
        power_cut(lab.emulators["rails"])
        # EO 0 was burnt into its memory: it answers as before
        lab.emulators["rails"].echo = False
        before = lab.world.joints()
        bench.motion.enable()
        with pytest.raises(NotReferenced):
            bench.drive(chosen.plan.steps[1].joints)
        assert np.array_equal(before, lab.world.joints())


@pytest.mark.parametrize(
    ("said", "disturb"),
    [
        ("outside|by its encoder, and its limits", lambda g: g.command("DP 0,0,0")),
        ("it was left at", lambda g: g.command("DP 1300000,1300000,1300000")),
        ("limits of q2 are no longer", lambda g: g.command("FL ,2147483647")),
        ("zeroed anew", lambda g: g.command("zeroed=77")),
        ("drive of q1, q2, q3 is off", lambda g: g.command("MOABC")),
    ],
)
def test_what_another_program_changed_is_seen_before_the_next_motion(lab, tmp_path, said, disturb):
    """Catches a zero, a limit or a drive that somebody else has set while the run stood still."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    with chosen.bench() as bench:
        bench.drive(chosen.plan.start)
        disturb(bench.motion)
        before = lab.world.joints()
        with pytest.raises(NotReferenced, match=said):
            bench.drive(chosen.plan.steps[0].joints)
        assert np.array_equal(before, lab.world.joints())


def test_a_robot_that_stands_elsewhere_than_its_run_left_it_is_not_moved(lab, tmp_path):
    """Catches a zero that was moved between two sessions, by a program that left the mark alone."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    interrupted(chosen)
    with chosen.motion() as motion:
        motion.command("DP 1500000,1500000,1500000")
    before = lab.world.joints()
    with pytest.raises(NotReferenced, match=r"expected .* or the way from there"):
        go_on(chosen)
    assert np.array_equal(before, lab.world.joints())
    # a person knows where it stands, and says so
    stands = ",".join(f"{q:.4f}" for q in before)
    command("home", tmp_path / "experiment.toml", "--yes", "--at", stands)
    assert go_on(chosen) == "complete"
    check_rows(lab, chosen)


def test_home_asks_before_it_moves_and_refuses_what_it_does_not_understand(lab, tmp_path, capsys):
    """Catches axes that drive to their switches unasked, and a place with a number too few."""
    path = str(tmp_path / "experiment.toml")
    before = lab.world.joints()
    for arguments in ([], ["--at", "130,130"], ["--at", "a,b,c", "--yes"], ["--at", "10,130,130", "--yes"]):
        with pytest.raises(SystemExit):
            main(["home", path, *arguments])
        assert np.array_equal(before, lab.world.joints())
    assert "expected 3 numbers" in capsys.readouterr().err


def test_homing_that_fails_stops_and_leaves_no_zero(lab, tmp_path):
    """Catches axes that go on to their switches after a fault, and a zero that is then taken for one."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    power_cut(lab.emulators["rails"])
    with chosen.motion() as motion:
        motion.enable()
        lab.emulators["rails"].faults.schedule("drop", 14)
        try:
            motion.home()
        except InstrumentError:
            before = lab.world.joints()
            time.sleep(0.05)
            assert np.array_equal(before, lab.world.joints())
            assert motion.reference().mark is None
        else:
            assert motion.reference().mark is not None


def test_a_controller_that_cannot_say_is_held_to_where_it_has_to_stand(tmp_path):
    """Catches a driver without a word for "zeroed" that is believed anywhere within its limits."""
    robot = robot_from_tables(ROBOT, "test")
    start = robot.inverse([0.0, 0.0, 0.0])
    plan = plan_of_poses(robot.inverse_batch(np.eye(3)).require("pose"), start)
    for stands, moves in ((start, True), (start + 5.0, False)):
        bench = dummy_bench(robot, lambda q: robot.forward(q), stands, said=False)
        with bench, RunFile.create(tmp_path / f"{moves}.sqlite", plan, {}) as file:
            if moves:
                assert run(plan, bench, file) == "complete"
            else:
                with pytest.raises(NotReferenced, match="or the way from there"):
                    run(plan, bench, file)
                assert bench.motion.moves == 0


def test_an_encoder_that_slips_while_it_stands_is_seen_before_the_next_motion(lab, tmp_path):
    """Catches 2 mm that go through to "complete", within every limit and plausible by the drawing."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
        with pytest.raises(NotReferenced, match=r"q2 stands at .* by its encoder; it was left at"):
            run(chosen.plan, bench, file, report=lambda now: lab.emulators["rails"].slip(1, 2.0))
        assert file.done() == {0}


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("mirrored", "as if its sign were turned"),
        ("slipped", "q2_mm is not where"),
        pytest.param("frozen", "has not changed since step", marks=pytest.mark.slow),
    ],
)
def test_what_fails_at_a_real_port_is_told_by_its_name(lab, tmp_path, name, said):
    """Catches a laser or an encoder at fault that no check of a single instrument can see."""
    experiment(tmp_path, check={"plausible_mm": 20.0, "agree_within_mm": 0.001}, plan={"repeats": 2})
    chosen = load_experiment(tmp_path / "experiment.toml")
    position = lab.bench.position
    frozen = []

    def at_fault(joints, time_s):
        true = position(joints, time_s).copy()
        frozen.append(true[1])
        true[1] = frozen[0] if name == "frozen" else -true[1]
        return true

    def report(now):
        if now.step == 12 and name == "slipped":
            lab.emulators["rails"].slip(1, 2.0)
            # it slipped on the way, where nobody could see it
            bench.motion.left_at = {}
        elif now.step == 12:
            lab.bench.position = at_fault

    with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
        with pytest.raises(Implausible, match=said) as told:
            run(chosen.plan, bench, file, report=report)
        assert told.value.instrument == ("rails" if name == "slipped" else "lasers")
        assert told.value.port
        assert 12 < max(file.doubts()) <= 15
        assert said in file.diary()[-1][2]


# -- the run file --------------------------------------------------------------------------------------------


def test_a_run_has_one_runner(lab, tmp_path):
    """Catches two programs that measure into one file, and a lock that outlives its program."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    with RunFile.create(chosen.run_path, chosen.plan, chosen.about()):
        with pytest.raises(ExperimentError, match="measured by another program"):
            RunFile.resume(chosen.run_path, chosen.plan, chosen.about())
        # who only reads may
        RunFile.open(chosen.run_path).close()
    RunFile.resume(chosen.run_path, chosen.plan, chosen.about()).close()


def test_a_run_of_an_earlier_version_is_read_and_not_gone_on_with(lab, tmp_path):
    """Catches a run without marks and wall clock that is taken for one of today, or that can no longer be exported."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    interrupted(chosen)
    with sqlite3.connect(chosen.run_path) as old:
        old.execute("UPDATE run SET value = '1' WHERE key = 'format'")
        old.execute("DROP TABLE doubt")
    old.close()
    with RunFile.open(chosen.run_path) as file:
        assert len(file.points()) == len(file.frame()) == 6
    with pytest.raises(ExperimentError, match="earlier version; it can be exported"):
        RunFile.resume(chosen.run_path, chosen.plan, chosen.about())


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"rails": {"counts_per_mm": 5000}}, r"rails counts_per_unit = 10000\.0; now it is 5000"),
        ({"rails": {"zero_counts": [1, 2, 3]}}, "rails zero_counts"),
        ({"lasers": {"outputs": [2, 1, 3]}}, "lasers outputs"),
        ({"lasers": {"columns": ["y_mm", "x_mm", "z_mm"]}}, "lasers columns"),
        ({"lasers": {"unit": "um"}}, "lasers unit"),
        ({"lasers": {"name": "eyes", "address": "tcp://127.0.0.1:9"}}, "without the instrument 'eyes'"),
    ],
)
def test_a_run_goes_on_only_where_its_numbers_mean_the_same(lab, tmp_path, change, said):
    """Catches rows of two scales, zeros or orders of columns in one run."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    RunFile.create(chosen.run_path, chosen.plan, chosen.about()).close()
    experiment(tmp_path, rails={"poll_s": 0.003, "speed_mm_s": 4.0, "timeout_s": 3.0})
    same = load_experiment(tmp_path / "experiment.toml")
    RunFile.resume(same.run_path, same.plan, same.about()).close()
    experiment(tmp_path, **change)
    other = load_experiment(tmp_path / "experiment.toml")
    with pytest.raises(ExperimentError, match=said):
        RunFile.resume(other.run_path, other.plan, other.about())


def test_another_instrument_under_the_same_name_is_refused(lab, tmp_path):
    """Catches a controller that was exchanged between two sessions: its zero is another."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    interrupted(chosen)
    lab.emulators["rails"].serial_number = 99
    before = lab.world.joints()
    with pytest.raises(ExperimentError, match=r"rails identity = .*serial number 4183; now it is .*99"):
        go_on(chosen)
    assert np.array_equal(before, lab.world.joints())


def test_a_clock_that_was_set_is_said_and_does_not_reach_the_rows(lab, tmp_path, monkeypatch):
    """Catches rows whose time goes back: drift would be fitted to it."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    wall = time.time

    def report(now):
        if now.step == 5:
            monkeypatch.setattr(time, "time", lambda: wall() - 3600.0)
        if now.step == 11:
            raise KeyboardInterrupt

    with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
        with pytest.warns(SherkitWarning, match="set back by 3600 s"), pytest.raises(KeyboardInterrupt):
            run(chosen.plan, bench, file, report=report)
        assert any("set back by 3600 s during the run" in what for _, _, what in file.diary())
    # the next program begins with the clock as it now is
    monkeypatch.setattr(transport, "_WALL_S", transport._WALL_S - 3600.0)
    with pytest.warns(SherkitWarning, match="set back by 360"):
        assert go_on(chosen) == "complete"
    with RunFile.open(chosen.run_path) as file:
        times = file.frame()["time_s"].to_numpy()
    assert (np.diff(times) > 0).all()


# -- campaign ------------------------------------------------------------------------------------------------


class HostDied(BaseException):
    """The computer of the program lost its power."""


def die(bench):
    """From now on the program says nothing any more, not even to stop."""

    def dead(*_, **__):
        raise HostDied

    bench.motion._brake = lambda *_, **__: None
    for one in bench.instruments:
        one._exchanging = dead


def run_with_cuts(lab, chosen, rng):
    """A run during which something loses its power at random moments, and a person who does what the sentences say.

    Returns what was cut and what was raised, and the furthest that any joint ever was outside its limits, mm."""
    counted: Counter[str] = Counter()
    furthest = [0.0]
    over = threading.Event()

    def look():
        while not over.is_set():
            at = lab.world.joints()
            furthest[0] = max(furthest[0], float((60.0 - at).max()), float((at - 200.0).max()))
            time.sleep(0.001)

    watcher = threading.Thread(target=look)
    watcher.start()
    try:
        for attempt in range(12):
            timer = None
            with RunFile.resume(chosen.run_path, chosen.plan, chosen.about()) as file:
                bench = chosen.bench()
                who = rng.choice(("controller", "host", "instrument")) if attempt < 3 else ""
                if who:
                    counted[who] += 1
                    emulator = lab.emulators["rails" if who == "controller" else "lasers"]
                    task = (lambda b=bench: die(b)) if who == "host" else (lambda e=emulator: power_cut(e))
                    timer = threading.Timer(rng.uniform(0.0, 1.2), task)
                    timer.start()
                try:
                    with bench:
                        if run(chosen.plan, bench, file, attempts=2) == "complete":
                            break
                except (SherkitError, HostDied) as error:
                    counted[type(error).__name__] += 1
                    refused = isinstance(error, NotReferenced)
                finally:
                    if timer is not None:
                        timer.join()
            if refused:
                with chosen.motion() as motion:
                    assert isinstance(motion, Galil)
                    motion.enable()
                    motion.home()
                    motion.move(chosen.plan.start)
        else:
            raise AssertionError(f"never done: {counted}")
    finally:
        over.set()
        watcher.join()
    check_rows(lab, chosen)
    return counted, furthest[0]


def power_cuts(folder, runs, seed):
    """So many runs with cuts, each in a laboratory of its own."""
    rng = random.Random(seed)
    counted: Counter[str] = Counter()
    furthest = 0.0
    for n in range(runs):
        here = folder / str(n)
        rails = {"link": rng.choice(("pty", "tcp")), "home_mm": HOME}
        laboratory(here, noise_mm=0.0, time_scale=150.0, rails=rails)
        experiment(
            here, per_side=2, plan={"seed": n},
            rails={"home_at_mm": HOME, "home_speed_mm_s": 5.0, "timeout_s": 0.5, "poll_timeout_s": 0.5},
            lasers={"timeout_s": 0.5},
        )  # fmt: skip
        with RunningLaboratory(load_laboratory(here / "lab.toml")) as lab:
            lab.write_ports(here / "ports.json")
            more, out = run_with_cuts(lab, load_experiment(here / "experiment.toml"), rng)
        counted += more
        furthest = max(furthest, out)
        assert furthest < BRAKING_MM, n
    return counted, furthest


def test_power_cuts_move_nothing_wrongly_and_lose_no_row(tmp_path):
    """Catches a joint beyond its limits, a row that is wrong and one that is lost, whoever loses the power and when."""
    counted, _ = power_cuts(tmp_path, 3, seed=1)
    assert counted["NotReferenced"] or counted["HostDied"] or counted["controller"]


@pytest.mark.slow
def test_two_hundred_runs_with_power_cuts_move_nothing_wrongly_and_lose_no_row(tmp_path):
    """Catches what the short test does, where it is rare."""
    counted, furthest = power_cuts(tmp_path, 200, seed=2)
    print(f"200 runs: {dict(counted)}; at most {furthest:.3f} mm outside the limits")
