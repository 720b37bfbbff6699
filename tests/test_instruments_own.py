"""Instruments that a user brings as Python, as devices of other libraries, or through VISA."""

from __future__ import annotations

import json
import math
import threading
import time
import tomllib

import numpy as np
import pytest
import tomli_w

import sherkit as sk
from laboratories import experiment, laboratory
from sherkit.errors import ExperimentError, Garbled, InstrumentError, OutOfRange, Timeout
from sherkit.lab.emulators import Faults, ScpiEmulator, World
from sherkit.lab.instruments import Axis, OwnAxes, OwnSensor, Scpi
from sherkit.lab.instruments.base import Reading
from sherkit.lab.instruments.devices import Status
from sherkit.lab.instruments.user_driver import run_code

MM = ("x_mm", "y_mm", "z_mm")


def sensor(made, columns=MM, **more):
    return OwnSensor(lambda: made, columns, name="dial", **more)


# -- sensors -----------------------------------------------------------------------------------------------------


class Readable:
    """A device as bluesky wants it, with a status that ends in a thread."""

    name = "eye"

    def __init__(self):
        self.values = {"eye_x": 1000.0, "eye_y": 2000.0, "eye_z": 3000.0, "eye_count": 7}
        self.staged = 0
        self.triggered = 0

    def stage(self):
        self.staged += 1
        return [self]

    def unstage(self):
        self.staged -= 1
        return [self]

    def trigger(self):
        status = Status()

        def end():
            self.triggered += 1
            status.finish()

        threading.Timer(0.01, end).start()
        return status

    def read(self):
        return {k: {"value": v, "timestamp": 0.0} for k, v in self.values.items()}

    def describe(self):
        return {k: {"units": "um", "dtype": "number", "shape": [], "source": ""} for k in self.values}


def test_whatever_a_user_has_reads():
    """Catches a function, a mapping, a class or a device whose values end in another column, or in another unit."""

    class Mine:
        closed = 0

        def read(self):
            return [1.0, None, 3]

        def close(self):
            self.closed += 1

    mine, eye = Mine(), Readable()
    with sensor(lambda: (1, 2.0, np.float32(3))) as one:
        assert one.read().values == (1.0, 2.0, 3.0)
        assert one.read().units == ("mm",) * 3
        assert "test_whatever" in one.identify().text
    with sensor(lambda: {"z_mm": 3.0, "x_mm": 1.0, "y_mm": 2.0, "more": 4}) as one:
        assert one.read().values == (1.0, 2.0, 3.0)
    with sensor(lambda: 21.5, ("temperature_c",)) as one:
        assert one.read().units == ("c",)
    with sensor(mine) as one:
        assert one.read().values == pytest.approx((1.0, math.nan, 3.0), nan_ok=True)
    assert mine.closed == 1
    with sensor(lambda: None) as one:
        assert np.isnan(one.read().values).all()
    with sensor(eye, fields=("eye_x", "eye_y", "eye_z")) as one:
        assert eye.staged == 1
        reading = one.read()
        assert reading.values == (1000.0, 2000.0, 3000.0)
        assert reading.units == ("um",) * 3
        assert eye.triggered == 1
    assert eye.staged == 0


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda: 1 / 0, "ZeroDivisionError"),
        (lambda: (1.0, 2.0), "2 values"),
        (lambda: {"x_mm": 1.0}, "gave no y_mm, z_mm"),
        (lambda: (1.0, "two", 3.0), "'two' for 'y_mm'"),
        (lambda: (1.0, math.inf, 3.0), "inf for 'y_mm'"),
        (Readable(), "4 columns|fields"),
    ],
)
def test_what_a_users_code_does_wrong_is_a_sentence(made, said):
    """Catches a traceback of the user's code, a reading too few, and a number that is none."""
    with sensor(made) as one, pytest.raises(InstrumentError, match=said) as found:
        one.read()
    assert "dial" in str(found.value)
    with pytest.raises(InstrumentError, match="expected a function that reads"):
        sensor(5).connect()
    with pytest.raises(InstrumentError, match="what makes it raised OSError: no dongle"):
        OwnSensor(fails, MM, name="dial").connect()


def fails():
    raise OSError("no dongle")


def test_a_device_that_never_ends_is_told():
    """Catches a run that waits for ever for a trigger whose status never ends, and a late reading that is taken."""

    class Silent(Readable):
        def trigger(self):
            return Status()

    late = sensor(lambda: time.sleep(0.06) or (1.0, 2.0, 3.0), timeout_s=0.05)
    with late as one, pytest.raises(Timeout, match=r"took \d+\.\d s for a reading; timeout_s is 0\.05"):
        one.read()
    with sensor(Silent(), timeout_s=0.05) as one, pytest.raises(Timeout, match="trigger did not end"):
        one.read()


# -- axes --------------------------------------------------------------------------------------------------------


class Slide:
    """An axis that drives in a thread, and counts its stops."""

    def __init__(self, place=130.0, speed=400.0, wrong=None):
        self.position = place
        self.speed = speed
        self.stops = 0
        self.wrong = wrong
        self._halt = threading.Event()

    def set(self, value):
        status = Status()
        self._halt.clear()

        def drive():
            while abs(value - self.position) > 1e-9 and not self._halt.is_set():
                self.position += float(np.clip(value - self.position, -0.01 * self.speed, 0.01 * self.speed))
                time.sleep(0.01)
            status.finish(RuntimeError(self.wrong) if self.wrong else None)

        threading.Thread(target=drive, daemon=True).start()
        return status

    def stop(self):
        self.stops += 1
        self._halt.set()


def axes(parts, limits=(60.0, 200.0), **more):
    made = [Axis(letter, 1e4, limits, name=f"q{k}") for k, letter in enumerate("ABC", 1)]
    settings = {"speed": 100.0, "acceleration": 1000.0, "arrived_within": 0.01, "settle_s": 5.0, **more}
    return OwnAxes(lambda: parts, made, name="slides", **settings)


def test_a_users_axes_move_together_and_stop_on_any_error():
    """Catches a target outside the limits that is sent, an axis that goes on after another failed, or that is forgotten
    where the status never ends."""
    parts = [Slide(), Slide(), Slide()]
    with axes(parts) as one:
        assert one.move((131.0, 132.0, 133.0)).values == pytest.approx((131.0, 132.0, 133.0))
        with pytest.raises(OutOfRange):
            one.move((131.0, 132.0, 300.0))
        assert [p.position for p in parts] == pytest.approx([131.0, 132.0, 133.0])
        parts[1].wrong = "the belt is off"
        with pytest.raises(InstrumentError, match="q2 did not arrive: RuntimeError: the belt is off"):
            one.move((130.0, 130.0, 130.0))
        assert all(p.stops == 1 for p in parts)
        with pytest.raises(InstrumentError, match=r"has no home\(\)"):
            one.home()
    slow = [Slide(speed=0.1), Slide(), Slide()]
    with axes(slow, settle_s=0.1, speed=1000.0) as one, pytest.raises(Timeout, match="was stopped"):
        one.move((190.0, 130.0, 130.0))
    assert slow[0].position < 131.0
    assert slow[0].stops == 1
    with pytest.raises(InstrumentError, match="2 axes were given; expected 3"):
        axes(parts[:2]).connect()
    with pytest.raises(InstrumentError, match=r"q1: .*object has no set, stop, position"):
        axes([object()] * 3).connect()


# -- in an experiment ------------------------------------------------------------------------------------------

CODE = """
import sherkit as sk


def lasers(address, outputs):
    one = sk.lab.instruments.Keyence(address, outputs, timeout_s=20.0)
    one.connect()
    return lambda: one.read().values


class Slides(list):
    pass


def rails():
    from test_instruments_own import Slide
    return [Slide(), Slide(), Slide()]
"""


def own_lasers(folder, *, rails=False):
    """An experiment whose lasers, or rails too, are the user's own Python."""
    path = experiment(folder, per_side=2, planes=(0.0,))
    values = tomllib.loads(path.read_text(encoding="utf-8"))
    values["instrument"][1] = {
        "name": "lasers", "kind": "python", "make": "lasers", "columns": list(MM), "with": {"outputs": [1, 2, 3]},
    }  # fmt: skip
    if rails:
        values["instrument"][0] = {"name": "rails", "kind": "python_axes", "make": "rails"}
    path.write_text(tomli_w.dumps(values), encoding="utf-8")
    (folder / "my_lab.py").write_text(CODE, encoding="utf-8")
    return path


def test_a_run_is_measured_by_own_code_that_was_named(tmp_path):
    """Catches an own sensor that the runner cannot read, and code that runs though nobody has named it."""
    lab = laboratory(tmp_path)
    path = own_lasers(tmp_path)
    with sk.lab.RunningLaboratory(sk.lab.load_laboratory(lab)) as running:
        running.write_ports(tmp_path / "ports.json")
        with pytest.raises(
            ExperimentError, match=r"'lasers' is made by Python code, and no Python file was named.*--python"
        ):
            sk.lab.load_experiment(path)
        chosen = sk.lab.load_experiment(path, python=[tmp_path / "my_lab.py"])
        with sk.lab.RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
            assert sk.lab.run(chosen.plan, bench, file) == "complete"
            rows = file.measurements()
            meaning = json.loads(chosen.about()["meaning"])
    assert len(rows) == 4
    assert np.abs(rows.readings[:, :3]).max() > 1.0
    assert meaning["lasers"]["with"]["outputs"] == [1, 2, 3]
    assert sk.lab.load_experiment(path, offline=True).seconds > 0


def test_own_axes_are_an_experiments_motors(tmp_path):
    """Catches a kind that moves and is not taken for the motors, or whose limits are not the robot's."""
    laboratory(tmp_path)
    path = own_lasers(tmp_path, rails=True)
    (tmp_path / "ports.json").write_text("{}", encoding="utf-8")
    motion = sk.lab.load_experiment(path, python=[tmp_path / "my_lab.py"]).motion()
    assert isinstance(motion, OwnAxes)
    assert [a.label for a in motion.axes] == ["q1", "q2", "q3"]
    with motion:
        with pytest.raises(OutOfRange, match="soft limits are 60 to 200"):
            motion.move((30.0, 130.0, 130.0))
        assert motion.move((129.0, 130.0, 131.0)).values == pytest.approx((129.0, 130.0, 131.0))


def test_code_that_cannot_be_used_is_a_sentence(tmp_path):
    """Catches a traceback of the user's file, and a file that defines nothing."""
    for text, said in (("import nowhere_at_all", "ModuleNotFoundError"), ("x = 1", "defines no function")):
        (tmp_path / "bad.py").write_text(text, encoding="utf-8")
        with pytest.raises(ExperimentError, match=said):
            run_code([tmp_path / "bad.py"])
    with pytest.raises(ExperimentError, match="no such Python file"):
        run_code([tmp_path / "nowhere.py"])


# -- SCPI and VISA -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("visa", [False, True])
def test_scpi_reads_through_any_port(visa):
    """Catches SCPI's infinity taken for a reading, an answer too short, and a port that only one driver has."""
    if visa:
        pytest.importorskip("pyvisa_py")
    world, faults = World((1.0, 2.0, 3.0)), Faults()
    with ScpiEmulator(world, faults=faults) as emulator:
        host, port = emulator.address.removeprefix("tcp://").split(":")
        address = f"visa://TCPIP0::{host}::{port}::SOCKET@py" if visa else emulator.address
        with Scpi(address, names=MM, timeout_s=5.0) as one:
            assert one.identify().text == "SHERKIT,EMULATED,0,1.0"
            assert one.read() == Reading("SCPI", MM, (1.0, 2.0, 3.0), ("mm",) * 3, pytest.approx(time.time(), abs=60))
            faults.schedule("over_range")
            with pytest.raises(OutOfRange, match="no value"):
                one.read()
        with (
            Scpi(address, names=("a", "b"), timeout_s=5.0, retries=0) as one,
            pytest.raises(Garbled, match="3 numbers; expected 2"),
        ):
            one.read()
        with Scpi(address, "MEAS?", names=MM, timeout_s=0.2, retries=0) as one, pytest.raises(Timeout):
            one.read()
    with pytest.raises(InstrumentError, match="ends in"):
        Scpi("tcp://127.0.0.1:1", "DRIVE 5")


def test_visa_that_is_not_there_is_a_sentence():
    """Catches a traceback of a VISA library."""
    pytest.importorskip("pyvisa_py")
    for address in ("visa://nonsense@py", "visa://TCPIP0::127.0.0.1::1::SOCKET@py", "visa://X@nowhere.yaml@sim"):
        with pytest.raises(InstrumentError, match=r"^SCPI on visa://[^\n]{9,200}$"):
            Scpi(address, timeout_s=0.5, retries=0).connect().identify()


# -- libraries that others use -----------------------------------------------------------------------------------


def test_ophyd_devices_read_and_move_as_they_are():
    """Catches a device of ophyd whose trigger, units or motion is not understood."""
    sim = pytest.importorskip("ophyd.sim")
    made = sim.hw()
    with OwnSensor(lambda: made.det1, ("x_mm",), fields=("det1",)) as one:
        assert math.isfinite(one.read().values[0])
    parts = [sim.SynAxis(name=f"m{k}", value=130.0) for k in range(3)]
    with axes(parts) as one:
        assert one.move((131.0, 129.0, 130.0)).values == (131.0, 129.0, 130.0)


def test_ophyd_async_devices_read_and_move_as_they_are():
    """Catches a coroutine that nobody awaits, and a status that is begun outside its loop."""
    sim = pytest.importorskip("ophyd_async.sim")
    parts = [sim.SimMotor(name=f"m{k}", instant=True) for k in range(3)]
    with axes(parts, limits=(-10.0, 10.0)) as one:
        assert one.move((1.0, -2.0, 3.0)).values == pytest.approx((1.0, -2.0, 3.0))
        with OwnSensor(lambda: parts[1], ("x_mm",), fields=("m1",)) as eye:
            assert eye.read().values == pytest.approx((-2.0,))
