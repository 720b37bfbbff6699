"""A laboratory from its file: what it starts, what its robot hides, who can reach it; and the commands around it."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
import tomllib

import numpy as np
import polars as pl
import pytest
import tomli_w
from click.testing import CliRunner

from laboratories import ROBOT, experiment, laboratory
from sherkit.cli.verbs import cli
from sherkit.errors import EffectError, ExperimentError, RobotError
from sherkit.lab.experiment import RunFile, load_experiment, run
from sherkit.lab.instruments import Axis, Galil, Hyperion, Keyence, NetFT, Sm130, fetch_scale
from sherkit.lab.kinds import read_ports
from sherkit.lab.laboratory import RunningLaboratory, load_laboratory
from sherkit.robots.delta.model import DeltaModel
from sherkit.robots.delta.virtual import VirtualDelta

COMMAND = [sys.executable, "-c", "from sherkit.cli import main; main()"]
ALL = [
    {"kind": "galil", "link": "tcp"}, {"kind": "keyence", "link": "tcp", "latency_s": 0.002, "pieces": 3},
    {"kind": "sm130"}, {"kind": "hyperion"}, {"kind": "net_ft"},
]  # fmt: skip


def test_every_instrument_of_a_laboratory_answers(tmp_path):
    """Catches a kind that cannot be started from a file, and an address that its driver does not take."""
    path = laboratory(tmp_path, instrument=ALL)
    with RunningLaboratory(load_laboratory(path)) as lab:
        lab.write_ports(tmp_path / "ports.json")
        ports = read_ports(tmp_path / "ports.json")
        assert list(ports) == ["galil", "keyence", "sm130", "hyperion", "net_ft"]
        at = {name: one["address"] for name, one in ports.items()}
        axes = [Axis(x, 10000.0, (60.0, 200.0)) for x in "ABC"]
        with (
            Galil(at["galil"], axes) as galil,
            Keyence(at["keyence"]) as keyence,
            Sm130(at["sm130"], (1,)) as sm130,
            Hyperion(at["hyperion"], (1,)) as hyperion,
            NetFT(at["net_ft"], fetch_scale(ports["net_ft"]["page"])) as net_ft,
        ):
            assert galil.read().values == pytest.approx(lab.bench.home_joints, abs=1e-3)
            assert keyence.read().values == pytest.approx([0.0] * 3, abs=0.03)
            assert sm130.read().values == hyperion.read().values == (1550.0,)
            assert net_ft.read()["fx"] == 0.0


def test_every_instrument_can_be_read_in_an_experiment(tmp_path):
    """Catches a kind that a laboratory starts and an experiment cannot read, and a column in another unit."""
    laboratory(
        tmp_path, instrument=[{"name": "rails", "kind": "galil"}, {"name": "lasers", "kind": "keyence"}, *ALL[2:]]
    )
    path = experiment(tmp_path)
    values = tomllib.loads(path.read_text())
    values["instrument"] += [
        {"kind": "sm130", "gratings": [1], "columns": ["first_nm"]},
        {"kind": "hyperion", "gratings": [1], "columns": ["second_nm"]},
        {
            "kind": "net_ft",
            "columns": [f"{f}_mN" for f in ("fx", "fy", "fz")] + [f"{t}_Nmm" for t in ("tx", "ty", "tz")],
        },
    ]
    path.write_text(tomli_w.dumps(values))
    with RunningLaboratory(load_laboratory(tmp_path / "lab.toml")) as lab:
        lab.bench.wrench = lambda joints, time_s: [0.25, 0.0, 0.0, 7.0, 0.0, 0.0]
        lab.write_ports(tmp_path / "ports.json")
        chosen = load_experiment(path)
        with chosen.bench() as bench:
            point = bench.measure(chosen.plan.steps[0])
    assert point.values["first_nm"] == point.values["second_nm"] == 1550.0
    assert point.values["fx_mN"] == pytest.approx(250.0)
    assert point.values["tx_Nmm"] == pytest.approx(7.0)


@pytest.mark.slow
def test_a_tool_is_calibrated_by_driving_it_aside(tmp_path):
    """Catches fibres that are mixed up, a force that is not the one that bends, and a depth from the wrong end."""
    from sherkit.robots.tool.calibration import Loads, calibrate_tool
    from sherkit.robots.tool.tool import FIBRES, FlexibleTool

    kinds = [{"name": "rails", "kind": "galil"}, {"name": "lasers", "kind": "keyence"}]
    gratings = {"kind": "sm130", "noise_nm": 2e-4}
    laboratory(
        tmp_path, instrument=[*kinds, gratings, {"kind": "net_ft"}], hidden={"errors": 0.0},
        tool={"depth_mm": 12.0, "clearance_mm": 0.05},
    )  # fmt: skip
    # the robot as drawn: known forces at a known depth
    around = [[1.6 * np.cos(a), 1.6 * np.sin(a), z] for z in (-6.0, 0.0, 6.0) for a in np.arange(8) * np.pi / 4]
    places = [*around, *[[0.0, 0.0, z] for z in (-6.0, -3.0, 0.0, 3.0, 6.0, 8.0)]]
    path = experiment(tmp_path)
    values = tomllib.loads(path.read_text())
    values["plan"] = {"poses": "list", "list_mm": [[float(v) for v in p] for p in places], "order": "shuffled"}
    values["check"] = {"agree_within_mm": 0.01}
    # each fibre is a channel with gratings at sections I, II and III
    fibres = [FIBRES[3 * section + fibre] for fibre in range(3) for section in range(3)]
    forces = ["force_x_mn", "force_y_mn", "force_z_mn", "tx_Nmm", "ty_Nmm", "tz_Nmm"]
    values["instrument"] += [
        {"kind": "sm130", "gratings": [3, 3, 3], "columns": fibres},
        {"kind": "net_ft", "columns": forces},
    ]
    path.write_text(tomli_w.dumps(values))
    with RunningLaboratory(load_laboratory(tmp_path / "lab.toml")) as lab:
        lab.write_ports(tmp_path / "ports.json")
        chosen = load_experiment(path)
        with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
            assert run(chosen.plan, bench, file) == "complete"
            frame = file.frame()
    depth = 12.0 - frame["z_mm"].to_numpy()
    force = frame.select("force_x_mn", "force_y_mn").to_numpy()
    assert 20.0 < np.linalg.norm(force, axis=1).max() < 500.0
    loads = Loads(force, depth, frame.select(FIBRES).to_numpy(), np.full(len(frame), np.nan))
    found = calibrate_tool(FlexibleTool(gains=(((1000.0,) * 3,) * 2,) * 2), loads)
    assert found.unloaded == 6
    true, fitted = np.array(FlexibleTool().gains), np.array(found.tool.gains)
    assert np.abs(fitted - true).max() < 0.05 * np.abs(true).max()


def test_the_lasers_see_the_hidden_robot(tmp_path):
    """Catches lasers that see the robot as drawn, or from another zero than its home."""
    path = laboratory(tmp_path)
    with RunningLaboratory(load_laboratory(path)) as lab:
        robot = lab.laboratory.robot
        virtual = VirtualDelta.draw(robot, 6, rail_lean_rad=8e-3)
        joints = robot.inverse([5.0, -3.0, 2.0])
        expected = virtual.true_reading(joints) - virtual.true_reading(robot.inverse([0.0, 0.0, 0.0]))
        assert lab.bench.position(joints, 0.0) == pytest.approx(expected[0])
        assert np.abs(expected[0] - [5.0, -3.0, 2.0]).max() > 0.1
        assert np.isnan(lab.bench.position(np.array([0.0, 400.0, 0.0]), 0.0)).all()


def test_effects_of_the_catalogue_can_be_hidden(tmp_path):
    """Catches backlash that does not ask where the joints came from, and drift that does not ask for the time."""
    names = [p.name for p in DeltaModel(load_laboratory(laboratory(tmp_path)).robot).core_parameters]
    width = next(n for n in names if "backlash" in n)
    rate = next(n for n in names if "drift" in n and n.endswith("x"))
    path = laboratory(tmp_path, hidden={"parameters": {width: 0.1, rate: 0.5}})
    with RunningLaboratory(load_laboratory(path)) as lab:
        home = lab.bench.home_joints
        lab.bench.left = lambda: home - 1.0
        below = lab.bench.position(home, 0.0)
        lab.bench.left = lambda: home + 1.0
        above = lab.bench.position(home, 0.0)
        assert 0.02 < np.abs(below - above).max() < 0.2
        later = lab.bench.position(home, 3600.0)
        assert np.abs(later - above).max() > 0.1
    path = laboratory(tmp_path, hidden={"parameters": {width + "x": 0.1}})
    with pytest.raises(EffectError, match=width), RunningLaboratory(load_laboratory(path)):
        pass


def test_noise_of_place_is_that_of_the_way_there(tmp_path):
    """Catches noise that depends on when it is read: a run that was resumed could not equal one that was not."""
    values = []
    for order in ((1, 2, 1), (2, 1)):
        with RunningLaboratory(load_laboratory(laboratory(tmp_path))) as lab:
            axes = [Axis(x, 10000.0, (60.0, 200.0)) for x in "ABC"]
            at = lab.ports()
            with Galil(at["rails"]["address"], axes, poll_s=0.002) as galil, Keyence(at["lasers"]["address"]) as lasers:
                for k in order:
                    galil.move(lab.laboratory.robot.inverse([float(k), 0.0, 0.0]))
                    first = lasers.read().values
                    assert lasers.read().values == first
                values.append(first)
                galil.move(lab.laboratory.robot.inverse([3.0, 0.0, 0.0]))
                galil.move(lab.laboratory.robot.inverse([1.0, 0.0, 0.0]))
                values.append(lasers.read().values)
    assert values[0] == values[2]
    assert values[1] == values[3]
    assert values[0] != values[1]


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ({"instrument": []}, r"has no \[\[instrument\]\]"),
        ({"instrument": [{"kind": "laser"}]}, "instrument 1.*kind"),
        ({"instrument": [{"kind": "net_ft", "link": "pty"}]}, "link"),
        ({"instrument": [{"kind": "keyence", "noise": 1.0}]}, "unknown key.*noise"),
        ({"instrument": [{"kind": "keyence"}, {"kind": "keyence"}]}, "a name that no other instrument has"),
        ({"instrument": [{"kind": "keyence", "faults": {"dropp": 0.1}}]}, "dropp"),
        ({"time_scale": 0.0}, "time_scale"),
        ({"hidden": {"error": 1.0}}, "errors"),
    ],
)
def test_laboratories_that_cannot_be_are_refused(tmp_path, tables, said):
    """Catches a misspelt key that is passed over: the laboratory would hide something else than was meant."""
    with pytest.raises(ExperimentError, match=said):
        load_laboratory(laboratory(tmp_path, **tables))


def test_ports_that_are_none_are_refused(tmp_path):
    """Catches a file of ports that is anything else."""
    with pytest.raises(ExperimentError, match="is the laboratory running"):
        read_ports(tmp_path / "ports.json")
    for text in ("", "[]", '{"a": "tcp://x:1"}'):
        (tmp_path / "ports.json").write_text(text)
        with pytest.raises(ExperimentError):
            read_ports(tmp_path / "ports.json")


# -- who can reach it, and what is run -------------------------------------------------------------------------


def listening(pid):
    """Local addresses on which a process listens, TCP and UDP."""
    psutil = pytest.importorskip("psutil")
    found = psutil.Process(pid).net_connections()
    return {c.laddr.ip for c in found if c.status in ("LISTEN", "NONE") and c.laddr}


def test_emulators_listen_on_this_machine_alone(tmp_path):
    """Catches a port that others on the network could drive."""
    path = laboratory(tmp_path, instrument=ALL)
    with started("lab", path.name, "--json", folder=tmp_path) as (process, said):
        ports = json.loads(said("}\n}"))
        assert len(ports) == 5
        assert listening(process.pid) == {"127.0.0.1"}
    with RunningLaboratory(load_laboratory(path)) as lab:
        assert all(re.match(r"(tcp|udp)://127\.0\.0\.1:", p["address"]) for p in lab.ports().values())


@pytest.mark.slow
def test_without_a_file_there_is_an_example(tmp_path):
    """Catches a first try that ends in a question."""
    with started("lab", "--json", "--ports", "ports.json", folder=tmp_path) as (_, said):
        assert list(json.loads(said("}\n}"))) == ["rails", "lasers"]
        assert list(read_ports(tmp_path / "ports.json")) == ["rails", "lasers"]


@pytest.mark.slow
def test_another_address_is_told(tmp_path):
    """Catches a laboratory that is open to others without a word."""
    path = laboratory(tmp_path, instrument=[{"kind": "keyence", "link": "tcp"}])
    with started("lab", path.name, "--host", "0.0.0.0", folder=tmp_path, wrong=True) as (process, said):
        assert "every machine that reaches it" in said("drive them")
        end = time.monotonic() + 600
        while not (found := listening(process.pid)):
            assert time.monotonic() < end
            time.sleep(0.02)
        assert found == {"0.0.0.0"}


def test_no_file_runs_code(tmp_path):
    """Catches a run file whose schema calls functions, and a pickle that is opened under another name."""
    marker = tmp_path / "was_run"
    payload = f"cos\nsystem\n(S'touch {marker}'\ntR.".encode()
    for name in ("run.sqlite", "lab.toml", "experiment.toml", "ports.json"):
        (tmp_path / name).write_bytes(payload)
    for read in (
        lambda: RunFile.open(tmp_path / "run.sqlite"),
        lambda: load_laboratory(tmp_path / "lab.toml"),
        lambda: read_ports(tmp_path / "ports.json"),
    ):
        with pytest.raises(ExperimentError):
            read()
    assert not marker.exists()
    # and no module of the laboratory knows how to
    files = list(pathlib_of("sherkit.lab").rglob("*.py"))
    assert len(files) > 20
    for file in files:
        text = file.read_text(encoding="utf-8")
        assert not re.search(r"\b(pickle|marshal|shelve|yaml|load_extension|eval\(|exec\()", text), file


def pathlib_of(name):
    import importlib
    from pathlib import Path

    return Path(importlib.import_module(name).__file__).parent


# -- the commands --------------------------------------------------------------------------------------------


@contextlib.contextmanager
def started(*arguments, folder, wrong=False):
    """A command that goes on; ``said(end)`` waits until it has said so much. Interrupted at the end."""
    process = subprocess.Popen(
        [*COMMAND, *arguments], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    stream = process.stderr if wrong else process.stdout

    def said(end):
        text = ""
        while end not in text:
            piece = stream.read(1)
            assert piece, text + (process.stderr.read() if not wrong else "")
            text += piece
        return text

    try:
        yield process, said
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=6000)
    assert process.returncode == 0


@pytest.mark.slow
def test_lab_measure_and_export_from_the_command_line(tmp_path):
    """Catches commands that do not fit together, a run that cannot be ended politely, and an export that lacks rows."""
    laboratory(tmp_path, time_scale=30.0)
    experiment(tmp_path, planes=(-8.0, 0.0, 8.0), goal={"std_um": 40.0})
    with started("lab", "lab.toml", "--ports", "ports.json", folder=tmp_path) as (_, said):
        assert "rails" in said("Ctrl-C")
        measure = [*COMMAND, "measure", "experiment.toml"]
        first = subprocess.Popen(measure, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(5):
            first.stdout.readline()
        first.send_signal(signal.SIGTERM)
        out, err = first.communicate(timeout=600)
        assert first.returncode == 128 + signal.SIGTERM, (out, err)
        again = subprocess.run(measure, cwd=tmp_path, capture_output=True, text=True, timeout=600, check=False)
        assert again.returncode == 1
        assert "--resume" in again.stderr
        rest = subprocess.run(
            [*measure, "--resume", "--live"], cwd=tmp_path, capture_output=True, text=True, timeout=600, check=False
        )
        assert rest.returncode == 0, rest.stderr
        assert "27 of 27 steps" in rest.stdout
        assert "further poses no longer help" in rest.stdout
        assert re.search(r"residual [\d.]+ µm, [xyz] ±", rest.stdout)
    with RunFile.open(tmp_path / "experiment.sqlite") as file:
        assert "SystemExit" in [line[2] for line in file.diary()]
    for name in ("run.csv", "run.parquet"):
        # in this process: starting another takes longer than the export
        done = CliRunner().invoke(cli, ["export", str(tmp_path / "experiment.sqlite"), "-o", str(tmp_path / name)])
        assert "27 rows" in done.output, done.output
    assert pl.read_csv(tmp_path / "run.csv").equals(pl.read_parquet(tmp_path / "run.parquet"))


def test_keys_pause_and_end_a_run(tmp_path):
    """Catches keys that nobody hears, and a terminal that is left without its echo."""
    laboratory(tmp_path, time_scale=20.0)
    experiment(tmp_path, plan={"repeats": 20})
    with RunningLaboratory(load_laboratory(tmp_path / "lab.toml")) as lab:
        lab.write_ports(tmp_path / "ports.json")
        master, slave = pty.openpty()
        process = subprocess.Popen(
            [*COMMAND, "measure", "experiment.toml"], cwd=tmp_path, stdin=slave, stdout=slave, stderr=slave
        )
        text = b""

        def until(word):
            nonlocal text
            end = time.monotonic() + 600
            while word not in text:
                assert time.monotonic() < end, text
                if select.select([master], [], [], 0.2)[0]:
                    text += os.read(master, 65536)

        until(b"left")
        os.write(master, b"p")
        until(b"paused")
        # the motion that was under way ends first
        before = None
        while not np.array_equal(before, lab.world.joints()):
            before = lab.world.joints()
            drain(master, 0.5)
        drain(master, 0.5)
        assert np.array_equal(before, lab.world.joints())
        text = b""
        os.write(master, b"p")
        until(b"measuring")
        os.write(master, b"q")
        until(b"--resume")
        drain(master, 0.5)
        assert process.wait(600) == 0
        os.close(slave)
        os.close(master)


def drain(master, seconds):
    """Reads on, so that the terminal does not fill up."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if select.select([master], [], [], 0.05)[0]:
            os.read(master, 65536)


@pytest.mark.slow
def test_the_demo_compensates_what_was_hidden(tmp_path):
    """Catches a demo that no longer finds the effect, or a calibration that does not help when it is driven with."""
    from sherkit.lab.verbs.lab import lab_demo

    lab_demo(tmp_path, repeats=1, time_scale=400.0)
    missed = {}
    for name in ("check_drawn", "check_twelve", "check_calibrated"):
        with RunFile.open(tmp_path / f"{name}.sqlite") as file:
            seen = np.array([[p.values[f"{a}_mm"] for a in "xyz"] for p in file.points()])
        targets = np.array(tomllib.loads((tmp_path / f"{name}.toml").read_text())["plan"]["list_mm"])
        missed[name] = 1e3 * np.linalg.norm(seen - targets, axis=1)
    drawn, twelve, calibrated = (float(np.sqrt(np.mean(one**2))) for one in missed.values())
    # a lean that all rails share is the tracker's, and what is left of it within a centimetre is near the noise
    assert drawn > 100.0 > 10.0 > calibrated
    assert twelve > 1.3 * calibrated
    assert missed["check_calibrated"].max() < 20.0
    assert "rail_lean" in (tmp_path / "calibrated.toml").read_text()


def test_a_robot_without_a_workspace_is_refused(tmp_path):
    """Catches a laboratory that would start around a robot that it cannot put anywhere, and eyes on the wrong robot."""
    path = laboratory(tmp_path)
    spherical = {
        "kind": "spherical",
        "geometry": {"alpha_deg": 45.0, "beta_deg": 45.0, "radius_mm": 50.0, "gravity": [0, 0, -1]},
    }
    (tmp_path / "robot.toml").write_text(tomli_w.dumps(spherical))
    with pytest.raises(RobotError, match="workspace"):
        load_laboratory(path)
    with pytest.raises(ExperimentError, match="camera"):
        load_laboratory(laboratory(tmp_path, instrument=[{"kind": "camera"}]))
    assert ROBOT["kind"] == "delta"
