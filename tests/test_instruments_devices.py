"""Devices under bluesky's own RunEngine, and by their protocols."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from sherkit.errors import Halted, InstrumentError, OutOfRange
from sherkit.lab.emulators import Faults, GalilEmulator, KeyenceEmulator, World
from sherkit.lab.instruments import Axis, Galil, Keyence
from sherkit.lab.instruments.devices import Detector, GalilAxes, GalilAxis, KeyenceDetector, Status


@pytest.fixture
def lab():
    """Motors and lasers on their emulators; lasers read the joints."""
    world = World((1.0, 2.0, 3.0), time_scale=5.0)
    axes = [Axis(x, 10000.0, (-50.0, 50.0), name=f"q{k}") for k, x in enumerate("ABC", 1)]
    faults = Faults()
    with (
        GalilEmulator(world, faults=faults) as ge,
        KeyenceEmulator(world) as ke,
        Galil(ge.address, axes, poll_s=0.01, timeout_s=5.0, poll_timeout_s=2.0) as g,
        Keyence(ke.address, timeout_s=5.0) as k,
    ):
        yield world, g, k, faults


def test_status_calls_each_callback_once():
    """Catches a callback that is lost when it is added late, or called twice; and an end of the wait without a word."""
    status = Status()
    called = []
    status.add_callback(called.append)
    assert not status.done
    assert not status.success
    with pytest.raises(TimeoutError, match=r"has not ended within 0\.01 s"):
        status.wait(0.01)
    status.finish()
    status.add_callback(called.append)
    assert called == [status, status]
    assert status.success
    assert status.exception() is None
    failed = Status()
    failed.finish(OutOfRange("x"))
    assert failed.done
    assert not failed.success
    with pytest.raises(OutOfRange):
        failed.wait(1.0)


def test_an_axis_moves_stops_and_tells_its_failure(lab):
    """Catches a set that blocks, a stop that is no failure, and a limit that is found only when moving."""
    world, g, _, _ = lab
    axis = GalilAxis(g, "q2")
    with pytest.raises(OutOfRange):
        axis.check_value(51.0)
    with pytest.raises(OutOfRange):
        axis.set(51.0)
    with pytest.raises(InstrumentError):
        GalilAxis(g, "q9")
    status = axis.set(5.0)
    status.wait(600.0)
    assert axis.locate() == {"setpoint": 5.0, "readback": pytest.approx(5.0, abs=1e-3)}
    assert set(axis.read()) == set(axis.describe()) == {"q2"}
    assert axis.describe()["q2"]["units"] == "mm"
    for success in (False, True):
        status = axis.set(-45.0 if success else 45.0)
        while not g.is_moving():
            time.sleep(0.005)
        with pytest.raises(InstrumentError, match="still moving"):
            axis.set(0.0)
        axis.stop(success=success)
        before = world.joints()
        error = status.exception(600.0)
        assert np.array_equal(before, world.joints())
        assert (error is None) == success
        if not success:
            assert isinstance(error, Halted)


def test_axes_move_together_and_apart(lab):
    """Catches a stop of one axis that stops the others, and columns without their axis."""
    world, g, _, _ = lab
    every = GalilAxes(g, "rails")
    every.set((4.0, 5.0, 6.0)).wait(600.0)
    assert every.position == pytest.approx((4.0, 5.0, 6.0), abs=1e-3)
    assert list(every.read()) == list(every.describe()) == ["rails_q1", "rails_q2", "rails_q3"]
    with pytest.raises(OutOfRange):
        every.check_value((0.0, 0.0, 99.0))
    a, b = GalilAxis(g, "A"), GalilAxis(g, "B")
    moving = a.set(40.0)
    other = b.set(-40.0)
    while not world.joints()[1] < 4.0:
        time.sleep(0.005)
    b.stop(success=False)
    assert isinstance(other.exception(600.0), Halted)
    moving.wait(600.0)
    assert world.joints()[0] == pytest.approx(40.0, abs=1e-3)
    assert world.joints()[1] > -40.0


def test_a_detector_hands_a_reading_over_once(lab):
    """Catches an old reading that is handed over again."""
    world, _, k, _ = lab
    detector = KeyenceDetector(k, "laser")
    detector.trigger().wait(600.0)
    world.set_joint(0, lambda _: 9.0)
    assert detector.read()["laser_out1"]["value"] == 1.0
    assert detector.read()["laser_out1"]["value"] == 9.0
    assert detector.describe()["laser_out3"]["units"] == "mm"
    assert isinstance(detector, Detector)


@pytest.fixture
def engine():
    """bluesky's RunEngine, and the documents that it gave out."""
    bluesky = pytest.importorskip("bluesky")
    documents = []
    run_engine = bluesky.RunEngine({}, call_returns_result=False)
    run_engine.subscribe(lambda name, document: documents.append((name, document)))
    yield run_engine, documents
    # its loop runs in a thread of its own; left open it would be a warning, in whichever test comes next
    loop = run_engine.loop
    loop.call_soon_threadsafe(loop.stop)
    while loop.is_running():
        time.sleep(0.005)
    loop.close()


def events(documents):
    return [d["data"] for name, d in documents if name == "event"]


def test_devices_satisfy_blueskys_protocols(lab):
    """Catches a method that bluesky looks for and does not find."""
    protocols = pytest.importorskip("bluesky.protocols")
    _, g, k, _ = lab
    mover = ("Movable", "Readable", "Stoppable", "Pausable", "Stageable", "Locatable", "Checkable", "HasHints")
    for device in (GalilAxis(g, "A"), GalilAxes(g)):
        for name in (*mover, "HasName", "HasParent", "Configurable"):
            assert isinstance(device, getattr(protocols, name)), name
    for name in ("Readable", "Triggerable", "Stageable", "HasHints", "HasName", "HasParent", "Configurable"):
        assert isinstance(KeyenceDetector(k), getattr(protocols, name)), name
    assert isinstance(Status(), protocols.Status)


def test_bluesky_scans(lab, engine):
    """Catches rows whose lasers were read before the axis stood."""
    plans = pytest.importorskip("bluesky.plans")
    _, g, k, _ = lab
    run, documents = engine
    run(plans.scan([KeyenceDetector(k, "laser")], GalilAxis(g, "q1"), -5.0, 5.0, 5))
    rows = events(documents)
    assert [r["q1"] for r in rows] == pytest.approx([-5.0, -2.5, 0.0, 2.5, 5.0], abs=1e-3)
    assert [r["laser_out1"] for r in rows] == pytest.approx([r["q1"] for r in rows], abs=2e-4)
    assert [n for n, _ in documents][-1] == "stop"
    assert documents[-1][1]["exit_status"] == "success"


def test_bluesky_pauses_and_resumes(lab, engine):
    """Catches an axis that moves on in a pause, and a scan that lacks a row or has one twice after it."""
    plans = pytest.importorskip("bluesky.plans")
    utils = pytest.importorskip("bluesky.utils")
    world, g, k, _ = lab
    run, documents = engine

    def pause():
        while not world.joints()[0] > 6.0:
            time.sleep(0.002)
        run.request_pause()

    pauser = threading.Thread(target=pause)
    pauser.start()
    with pytest.raises(utils.RunEngineInterrupted):
        run(plans.scan([KeyenceDetector(k, "laser")], GalilAxis(g, "q1"), 0.0, 40.0, 3))
    pauser.join(600.0)
    assert run.state == "paused"
    before = world.joints()
    time.sleep(0.1)
    assert np.array_equal(before, world.joints())
    assert before[0] < 39.0
    run.resume()
    rows = events(documents)
    assert [r["q1"] for r in rows] == pytest.approx([0.0, 20.0, 40.0], abs=1e-3)
    assert [r["laser_out1"] for r in rows] == pytest.approx([0.0, 20.0, 40.0], abs=2e-3)
    assert documents[-1][1]["exit_status"] == "success"


def test_bluesky_ends_at_a_limit_switch(lab, engine):
    """Catches a failed motion that the plan does not hear of: its row would be of another pose."""
    stubs = pytest.importorskip("bluesky.plan_stubs")
    utils = pytest.importorskip("bluesky.utils")
    world, g, k, faults = lab
    run, documents = engine
    axis = GalilAxis(g, "q1")
    detector = KeyenceDetector(k, "laser")

    def plan():
        yield from stubs.open_run()
        yield from stubs.mv(axis, 5.0)
        # among the polls of the next motion
        faults.schedule("limit_switch", 14)
        yield from stubs.mv(axis, 45.0)
        yield from stubs.trigger_and_read([detector, axis])
        yield from stubs.close_run()

    with pytest.raises((utils.FailedStatus, Halted)):
        run(plan())
    assert not events(documents)
    before = world.joints()
    assert before[0] < 44.0
    time.sleep(0.1)
    assert np.array_equal(before, world.joints())
