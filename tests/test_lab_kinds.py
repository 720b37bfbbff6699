"""The table of instruments, what measuring loads, and a robot that is neither delta nor spherical in a laboratory."""

from __future__ import annotations

import inspect
import json
import math
import subprocess
import sys
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import tomli_w

import sherkit as sk
from sherkit.data.columns import Layout
from sherkit.errors import ExperimentError, OutOfRange, RobotError, SherkitError
from sherkit.lab.emulators import Emulator
from sherkit.lab.experiment import RunFile, load_experiment, run
from sherkit.lab.kinds import INSTRUMENTS
from sherkit.lab.laboratory import RunningLaboratory, load_laboratory
from sherkit.model.batch import Batch
from sherkit.model.kinds import KINDS, Kind, Option

# -- the table -----------------------------------------------------------------------------------------------


def test_measuring_loads_no_emulator():
    """Catches a driver's table that imports the emulators, and a command that loads those of another."""
    code = """
import sherkit.lab.experiment, sherkit as sk, sys, json
sk.lab.load_experiment, sk.lab.run, sk.lab.RunFile, sk.lab.read_ports
from sherkit.cli import main
try:
    main(["measure", "nowhere.toml"])
except SystemExit:
    pass
print(json.dumps([m for m in sys.modules if m.startswith("sherkit.")]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = json.loads(done.stdout)
    assert {"sherkit.lab.experiment", "sherkit.lab.verbs.measure"} <= set(loaded)
    assert [m for m in loaded if "emulators" in m or "laboratory" in m] == []


@pytest.mark.parametrize("name", [name for name, row in INSTRUMENTS.items() if not row.own])
def test_a_row_names_an_emulator_that_is_there(name):
    """Catches a row whose emulator is misspelt, has other ports, or does not take what the laboratory reads for it."""
    row = INSTRUMENTS[name]
    made = row.emulator_class()
    taken = {p for one in made.__mro__ if one is not object for p in inspect.signature(one.__init__).parameters}
    assert {"world", "link", "host", "port", "faults", "seed"} <= taken
    if issubclass(made, Emulator):
        assert made.links == row.links
    robot = KINDS["spherical" if row.place_unit == "px" else "delta"]
    empty = sk.lab.laboratory.Table({}, "a test")
    assert set(row.emulated(empty, type("Robot", (), {"kind": robot.name, "joint_unit": "mm"})())) <= taken


# -- a third robot -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Arm:
    """Two links in a plane, lengths in mm: joints that turn, and a place that lasers read."""

    first_mm: float = 100.0
    second_mm: float = 80.0
    joint_unit: ClassVar[str] = "rad"
    joint_limits: ClassVar = (-3.0, 3.0)
    middle: ClassVar = (120.0, 40.0)
    kind: ClassVar[str] = "planar"

    @classmethod
    def from_table(cls, table):
        return cls(table.number("first_mm", 100.0), table.number("second_mm", 80.0))

    def to_tables(self):
        return {"kind": self.kind, "first_mm": self.first_mm, "second_mm": self.second_mm}

    def forward(self, joints):
        a, b = joints[0], joints[0] + joints[1]
        return np.array([self.first_mm * math.cos(a) + self.second_mm * math.cos(b),
                         self.first_mm * math.sin(a) + self.second_mm * math.sin(b)])  # fmt: skip

    def inverse(self, place):
        x, y = place
        bend = math.acos((x * x + y * y - self.first_mm**2 - self.second_mm**2) / (2 * self.first_mm * self.second_mm))
        turn = math.atan2(self.second_mm * math.sin(bend), self.first_mm + self.second_mm * math.cos(bend))
        return np.array([math.atan2(y, x) - turn, bend])

    def inverse_batch(self, places):
        return Batch(np.array([self.inverse(one) for one in places]), np.ones(len(places), dtype=bool), lambda row: "")


@dataclass(frozen=True)
class VirtualArm:
    """One whose second link is longer than drawn."""

    OPTIONS: ClassVar = {"longer_um": Option(0.0, "a second link that is longer")}
    robot: Arm
    longer_mm: float

    @classmethod
    def simulated(cls, robot, seed, errors, sizes):
        return cls(robot, 1e-3 * sizes["longer_um"])

    @classmethod
    def hidden(cls, robot, seed, table):
        return cls(robot, 1e-3 * table.number("longer_um", 0.0))

    def noise_free(self, joints):
        true = Arm(self.robot.first_mm, self.robot.second_mm + self.longer_mm)
        return (true.forward(joints) - true.forward(self.robot.inverse(self.robot.middle)))[None]


class NoModel:
    """A chain without effects, as far as a laboratory asks."""

    def __init__(self, robot, free):
        pass

    def settings(self):
        return {}


def places(robot, table):
    return np.array(table.rows("list_mm", 2))


LAYOUT = Layout(("j1_rad", "j2_rad"), ("x_mm", "y_mm"), "µm", 1e3)


@pytest.fixture
def planar(monkeypatch):
    def known(**more):
        values = {"virtual": VirtualArm, "coordinates": LAYOUT.coordinates, "poses": {"list": places}, **more}
        monkeypatch.setitem(KINDS, "planar", Kind("planar", Arm, NoModel, (LAYOUT,), object, **values))

    known()
    return known


def files(folder, **plan):
    motor = {"name": "motors", "kind": "galil", "counts_per_rad": 500000.0}
    (folder / "robot.toml").write_text(tomli_w.dumps(Arm().to_tables()))
    lab = {"robot": "robot.toml", "time_scale": 200.0, "hidden": {"longer_um": 500.0},
           "instrument": [motor, {"name": "lasers", "kind": "keyence"}]}  # fmt: skip
    (folder / "lab.toml").write_text(tomli_w.dumps(lab))
    values = {
        "robot": "robot.toml",
        "ports": "ports.json",
        "plan": plan or {"poses": "list", "list_mm": [[120.0, 45.0], [110.0, 30.0]]},
        "settle": {"seconds": 0.0},
        "check": {"plausible_mm": 400.0},
        "instrument": [{**motor, "poll_s": 0.002}, {"name": "lasers", "kind": "keyence", "outputs": [1, 2]}],
    }
    (folder / "experiment.toml").write_text(tomli_w.dumps(values))
    return folder / "experiment.toml"


def test_a_third_robot_is_measured_as_it_is(tmp_path, planar):
    """Catches three axes for two, µm of a delta, pixels since the joints turn, and the columns of another robot."""
    path = files(tmp_path)
    with RunningLaboratory(load_laboratory(tmp_path / "lab.toml")) as lab:
        lab.write_ports(tmp_path / "ports.json")
        chosen = load_experiment(path)
        assert chosen.checks.agree_within == 0.05
        assert chosen.checks.moved_within == 5e-5
        with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
            assert [a.name for a in bench.motion.axes] == ["j1", "j2"]
            assert run(chosen.plan, bench, file) == "complete"
            frame = file.frame()
        # readings count from home here, the drawing's coordinates do not
        path.write_text(path.read_text().replace("plausible_mm = 400.0", "plausible_mm = 20.0"))
        with load_experiment(path).bench() as bench, pytest.raises(OutOfRange, match=r"x_mm .* by the drawing"):
            bench.measure(chosen.plan.steps[0])
    joints = frame.select("j1_rad", "j2_rad").to_numpy()
    true = np.array([lab.laboratory.virtual.noise_free(q)[0] for q in joints])
    assert np.abs(frame.select("x_mm", "y_mm").to_numpy() - true).max() < 1e-3
    assert np.abs(true - (np.array([[120.0, 45.0], [110.0, 30.0]]) - Arm.middle)).max() > 1e-2


def test_what_a_third_robot_lacks_is_one_sentence(tmp_path, planar):
    """Catches poses, instruments and commands of a delta that a robot of another kind is given silently."""
    (tmp_path / "ports.json").write_text("{}")
    with pytest.raises(ExperimentError, match="'list', 'diagnosis'"):
        load_experiment(files(tmp_path, poses="paper_local"))
    planar(poses={}, coordinates=())
    with pytest.raises(ExperimentError, match="planar robots know no poses"):
        load_experiment(files(tmp_path))
    planar(virtual=None)
    with pytest.raises(RobotError, match="planar robots have no virtual one"):
        load_laboratory(tmp_path / "lab.toml")
    planar()
    lab = (tmp_path / "lab.toml").read_text()
    (tmp_path / "lab.toml").write_text(lab.replace('"keyence"', '"camera"'))
    with pytest.raises(
        ExperimentError, match="'galil', 'keyence', 'scpi', 'sm130', 'hyperion', 'net_ft', found 'camera'"
    ):
        load_laboratory(tmp_path / "lab.toml")
    (tmp_path / "lab.toml").write_text(lab + "\n[tool]\ndepth_mm = 5.0\n")
    with pytest.raises(ExperimentError, match="unknown key tool"):
        load_laboratory(tmp_path / "lab.toml")


def test_commands_do_not_take_it_for_another(tmp_path, planar):
    """Catches a simulation of a delta's errors, and a noise in pixels, for a robot that has neither."""
    from sherkit.cli.effects import _run
    from sherkit.lab.verbs.plan import _noise

    with pytest.raises(SherkitError, match="no poses 'whole'"):
        _run(tmp_path, Arm(), "whole", 1, "planes", 1.0, 0, {"pictures": None})
    with pytest.raises(SherkitError, match="--rail-lean-mrad is not for that kind"):
        _run(tmp_path, Arm(), "whole", 1, "planes", 1.0, 0, {"rail_lean_mrad": 1.0})
    with pytest.raises(SherkitError, match="its noise is --noise-um"):
        _noise(tmp_path, Arm(), {"µm": None, "px": 0.1})
    assert _noise(tmp_path, Arm(), {"µm": None, "px": None}) == 5.0
