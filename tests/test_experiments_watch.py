"""Sensors held against joints while a run goes on: what fails is found, told and marked; what is only not as drawn is
measured to its end."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

import planar_arm
from dummies import dummy_bench, faults
from laboratories import ROBOT, SPHERICAL
from running import slow
from second_machines import apart
from sherkit.errors import Implausible, InstrumentError
from sherkit.lab.experiment import RunFile, plan_of_poses, run
from sherkit.lab.laboratory import HiddenEffects, RobotOnTheBench
from sherkit.model import kinds
from sherkit.model.kinds import kind_of, model_of, robot_from_tables
from sherkit.robots.delta.virtual import TABLE_II_SIZES, VirtualDelta
from sherkit.robots.spherical.virtual import PAPER_ERRORS, VirtualSpherical

POSES = 100
#: Poses that may be taken after a fault, its own among them: a tenth of the run.
AFTER = POSES // 10


def delta(rng, poses):
    """A delta with geometric errors as in the paper's Table II, leaning rails and slanted beams."""
    robot = robot_from_tables(ROBOT, "test")
    seed = int(rng.integers(1 << 30))
    size = float(rng.choice([0.3, 1.0, 1.5]))
    sizes = {name: size * s for name, s in TABLE_II_SIZES.items()}
    virtual = VirtualDelta.draw(robot, seed, sizes=sizes, rail_lean_rad=8e-3, beam=1e-3 * size, noise_mm=0.0)
    wide = float(rng.choice([8.0, 15.0, 25.0]))
    places = rng.uniform(-wide, wide, (poses, 3)) * [1.0, 1.0, 0.6]
    return robot, virtual, places, 0.005, 0.6 * wide


def spherical(rng, poses):
    """A spherical robot with errors as the paper identified, or up to twice those, seen in pixels."""
    robot = robot_from_tables(SPHERICAL, "test")
    errors = {name: float(rng.uniform(-2.0, 2.0)) * v for name, v in PAPER_ERRORS.items()}
    virtual = VirtualSpherical(
        robot, errors, joint_offset_rad=0.01 * rng.normal(size=2), unequal_limbs_rad=0.005 * rng.normal(size=2),
        noise_px=0.0,
    )  # fmt: skip
    places = np.deg2rad(rng.uniform([70.0, 30.0], [110.0, 60.0], (poses, 2)))
    return robot, virtual, places, 0.1, 120.0


def world(kind, seed, poses=POSES):
    """A robot of that kind with hidden errors, and a plan: robot, where it is at joints, plan, noise, spread."""
    rng = np.random.default_rng([seed, len(kind)])
    robot, virtual, places, noise, spread = {"delta": delta, "spherical": spherical}[kind](rng, poses)
    plan = plan_of_poses(robot.inverse_batch(places).require("pose"), robot.inverse(robot.middle))
    hidden = HiddenEffects()
    model = model_of(robot)
    chosen = [
        e for e in model.catalogue.values()
        if not (e.search or e.goes_with) and rng.random() < 0.25 and e.name not in _NO_PART
    ]  # fmt: skip
    if chosen:
        hidden = HiddenEffects({p.name: p.size * rng.normal() for e in chosen for p in e.qualified()})
    bench = RobotOnTheBench(virtual, hidden)
    last = [np.array(plan.start)] * 2

    def place(joints):
        if not np.array_equal(joints, last[1]):
            last[:] = [last[1], np.array(joints)]
        return bench.position(joints, 0.0)

    bench.left = lambda: last[0]
    return robot, place, plan, noise, spread


#: Errors that the virtual robots have of their own, or what needs a column that these runs lack.
_NO_PART = (
    "datum", "sensor_pose", "camera_delay", "lens_distortion", "focal_length", "thermal_growth", "unequal_limbs",
)  # fmt: skip


def watched_run(kind, seed, folder, name=None, *, poses=POSES):
    """A run with one fault. Returns the error, instrument at fault, how many poses were taken with it, and marks."""
    rng = np.random.default_rng([seed, 99])
    robot, place, plan, noise, spread = world(kind, seed, poses)
    bench = dummy_bench(robot, place, plan.start, noise=noise, seed=seed)
    who, fault = None, None
    at = int(rng.integers(2, poses - AFTER))
    if name is not None:
        layout = kind_of(robot).layout
        who, fault = faults(rng, len(layout.coordinates), robot.joint_unit, spread)[name]

    def report(now):
        if now.step == at and fault is not None:
            fault(bench)

    error = None
    path = folder / f"{kind}-{seed}-{name}.sqlite"
    with RunFile.create(path, plan, {}) as file, bench:
        try:
            run(plan, bench, file, report=report)
        except InstrumentError as raised:
            error = raised
        taken = max((s for s in range(poses) if s in file.done() | set(file.doubts())), default=-1) - at
        marks = file.doubts()
        kept = len(file.done()) + len(marks)
    path.unlink()
    assert error is not None or kept == poses
    return error, who, taken, marks, at


FAULTS = tuple(faults(np.random.default_rng(0), 3, "mm", 1.0))


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
@pytest.mark.parametrize("kind", ["delta", "spherical"])
def test_a_robot_that_is_not_as_drawn_is_measured_to_its_end(kind, seed, tmp_path):
    """Catches a false stop: real calibration errors and effects that are taken for a sensor at fault."""
    error, *_ = watched_run(kind, seed, tmp_path, poses=40)
    assert error is None, error


#: Faults that take longer to be seen than others of their sort; some are also asked at a real port.
LONG = ("one column frozen", "one sign turned", "another unit", "all columns shift", "one column lags by a pose",
        "noise explodes", "read in coarse steps", "all encoders slipped")  # fmt: skip


@pytest.mark.parametrize("name", [pytest.param(one, marks=[pytest.mark.slow] * (one in LONG)) for one in FAULTS])
def test_a_fault_ends_the_run_and_is_told(name, tmp_path):
    """Catches a frozen, mirrored or swapped sensor, or an encoder that slipped, that goes through to "complete"."""
    kind = ("delta", "spherical")[FAULTS.index(name) % 2]
    error, who, taken, marks, at = watched_run(kind, 3, tmp_path, name, poses=60)
    assert isinstance(error, InstrumentError), name
    assert taken <= 6, (name, taken)
    assert who in error.instrument, (name, str(error))
    if taken:
        # of the rows that were taken with the fault at least the last one is marked, and none long before it
        assert at + taken in marks, (name, marks)
        assert min(marks) > at - 5


@pytest.mark.parametrize("name", ["one sign turned", "columns swapped", "all columns frozen", "another unit"])
def test_a_sensor_that_was_wrong_from_the_first_row_is_found(name, tmp_path):
    """Catches a watch that learns the fault from the first rows, and takes it for noise or for the robot."""
    for kind in ("delta", "spherical"):
        robot, place, plan, noise, spread = world(kind, 301, 20)
        bench = dummy_bench(robot, place, plan.start, noise=noise)
        layout = kind_of(robot).layout
        who, fault = faults(np.random.default_rng(1), len(layout.coordinates), robot.joint_unit, spread)[name]
        fault(bench)
        with RunFile.create(tmp_path / f"{kind}.sqlite", plan, {}) as file, bench:
            with pytest.raises(Implausible) as told:
                run(plan, bench, file)
            assert who in told.value.instrument, (kind, str(told.value))
            assert len(file.done()) + len(file.doubts()) <= AFTER, kind


def test_a_row_without_a_reading_says_nothing(tmp_path):
    """Catches an empty cell that ends a run, or throws the fit away since no such robot could be there."""
    robot, place, plan, noise, _ = world("delta", 300, 20)

    def sometimes(joints):
        true = np.array(place(joints), dtype=float)
        return true if joints[0] < 130.0 else np.full_like(true, np.nan)

    bench = dummy_bench(robot, sometimes, plan.start, noise=noise)
    with RunFile.create(tmp_path / "run.sqlite", plan, {}) as file, bench:
        assert run(plan, bench, file) == "complete"
        empty = sum(np.isnan(p.values["x_mm"]) for p in file.points())
    assert 0 < empty < 20


@pytest.fixture
def planar():
    """The kind is known while a test runs, and to no other."""
    with apart():
        kinds.register(planar_arm.KIND)
        yield


@pytest.mark.slow
def test_the_smallest_robot_is_watched_too(planar, tmp_path):
    """Catches a watch that knows the delta's columns: a robot from the tests' own folder has others."""
    robot = planar_arm.PlanarArm((250.0, 180.0), joint_limits_deg=(-120.0, 120.0))
    rng = np.random.default_rng(5)
    virtual = planar_arm.VirtualPlanarArm.simulated(robot, 1, 1.0, {"noise_um": 0.0, "fall_mm": 0.3})
    middle = np.array(robot.middle)
    places = middle + 0.1 * np.abs(middle).max() * rng.uniform(-1.0, 1.0, (40, len(middle)))
    plan = plan_of_poses(robot.inverse_batch(places).require("pose"), robot.inverse(robot.middle))
    for turned in (False, True):
        bench = dummy_bench(robot, lambda q: virtual.noise_free(q)[0], plan.start, noise=0.002)

        def report(now, turned=turned, bench=bench):
            if turned and now.step == 20:
                bench.sensors[0].instrument.spoil = lambda values: values[::-1]

        with RunFile.create(tmp_path / f"{turned}.sqlite", plan, {}) as file, bench:
            if not turned:
                assert run(plan, bench, file) == "complete"
                continue
            with pytest.raises(Implausible, match="eyes"):
                run(plan, bench, file, report=report)
            assert set(file.doubts()) == {21}


def test_rows_in_doubt_are_marked_kept_and_taken_again(tmp_path):
    """Catches a row in doubt that is fitted, one that is lost when it is taken again, marks that cannot be undone."""
    robot, place, plan, noise, _ = world("delta", 4, 30)
    bench = dummy_bench(robot, place, plan.start, noise=noise)
    eyes = bench.sensors[0].instrument

    def report(now):
        if now.step == 14:
            eyes.spoil = lambda values: values * [1.0, -1.0, 1.0]

    path = tmp_path / "run.sqlite"
    with RunFile.create(path, plan, {}) as file, bench:
        with pytest.raises(Implausible, match=r"y_mm is .* --resume") as told:
            run(plan, bench, file, report=report)
        assert told.value.instrument == "eyes"
        marked = set(file.doubts())
        assert 15 in marked
        assert marked.isdisjoint(file.done())
        frame = file.frame()
        assert set(frame.filter(frame["outlier"] == 1)["step"]) == marked
        assert file.measurements().outlier.sum() == len(marked)
        # the fault is still there: nothing moves
        moves = bench.motion.moves
        with pytest.raises(Implausible, match="nothing was moved"):
            run(plan, bench, file)
        assert bench.motion.moves == moves
        eyes.spoil = lambda values: values
        eyes._last = None
    with RunFile.resume(path, plan, {}) as file, bench:
        assert run(plan, bench, file) == "complete"
        assert file.done() == set(range(30))
        assert file.doubts() == {}
        former = file._db.execute("SELECT step, instrument FROM former").fetchall()
        assert former == [(s, "eyes") for s in sorted(marked)]
        file.doubt([3, 4], "eyes", "a test")
        assert file.accept() == 2
        assert file.done() == set(range(30))


# -- campaigns -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_no_false_stop_in_two_hundred_clean_runs(tmp_path):
    """Catches a stop where nothing failed: a night that is lost for a robot that is only not as drawn."""
    stopped = []
    for seed in range(200):
        kind = "spherical" if seed % 4 == 3 else "delta"
        error, *_ = watched_run(kind, 1000 + seed, tmp_path)
        if error is not None:
            stopped.append((kind, seed, str(error)))
    print(f"{len(stopped)} of 200 clean runs of {POSES} poses were stopped")
    assert not stopped, stopped


@pytest.mark.slow
def test_twenty_kinds_of_faults_are_found_in_time(tmp_path):
    """Catches a kind of fault that is found late, never, or with another instrument accused."""
    runs = 10
    found, named, poses = Counter(), Counter(), []
    for name in FAULTS:
        for seed in range(runs):
            kind = "spherical" if seed % 4 == 3 else "delta"
            error, who, taken, _, _ = watched_run(kind, 5000 + seed, tmp_path, name)
            if error is not None and 0 <= taken <= AFTER:
                found[name] += 1
                named[name] += who in error.instrument
                poses.append(taken)
        print(f"{name}: found {found[name]} of {runs}, right instrument {named[name]}", flush=True)
    total = runs * len(FAULTS)
    right = sum(named.values())
    print(
        f"{sum(found.values())} of {total} found within {AFTER} poses, {np.mean(poses):.1f} in the mean; {right} named"
    )
    assert sum(found.values()) >= 0.95 * total
    assert sum(named.values()) >= 0.9 * sum(found.values())
