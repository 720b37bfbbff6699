"""Damaged files of every kind: a value or a sentence, in time, and no NaN that goes on."""

from __future__ import annotations

import contextlib
import functools
import json
import os
import random
import sqlite3
import tomllib
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import tomli_w

import sherkit as sk
from laboratories import SPHERICAL, experiment, laboratory, spherical_laboratory
from mutations import Campaign, as_json, damaged_bytes, damaged_tree, in_memory, plain, watched
from second_printer.trials import Trial
from sherkit.cli.demo import EXAMPLE
from sherkit.lab.experiment import Plan, RunFile, export_run, load_experiment
from sherkit.lab.experiment.bench import Point
from sherkit.lab.kinds import read_ports
from sherkit.lab.laboratory import load_laboratory
from sherkit.robots.delta.robot import grid
from sherkit.robots.delta.virtual import VirtualDelta
from sherkit.robots.printer import import_klipper
from sherkit.robots.printer.gcode import import_duet, import_marlin
from sherkit.robots.serial import Serial
from sherkit.robots.serial.imported import import_dh, import_urdf
from sherkit.robots.tool.calibration import read_loads
from sherkit.robots.tool.runs import read_tool_run
from sherkit.robots.tool.tool import FlexibleTool, load_tool
from sherkit.robots.tool.virtual import VirtualTool
from test_klipper import SAVED, TRUE, config
from test_other_programs import COLUMNS, OURS, bag, told
from test_serial import UR5, URDF
from trials import forked

FAST = 80
#: What a campaign of ``make test-slow`` tries of each format; ``SHERKIT_FUZZ`` sets another.
SLOW = int(os.environ.get("SHERKIT_FUZZ", "100000"))


@dataclass(frozen=True)
class Format:
    """A file that is damaged: its name, whole and as a tree where it is one, and what reads it."""

    path: Path
    reads: Callable[[Path], object]
    tree: Any = None
    dump: Callable[[Any], bytes] | None = None

    def damaged(self, whole: bytes, rng: random.Random) -> bytes:
        """One input: half of them damaged in what they hold, if that is known, half in their bytes."""
        if self.tree is not None and self.dump is not None and rng.random() < 0.6:
            with contextlib.suppress(ValueError, TypeError, OverflowError):  # TOML has no such value
                return self.dump(damaged_tree(self.tree, rng))
        return damaged_bytes(whole, rng)


def toml(tree: Any) -> bytes:
    return tomli_w.dumps(plain(tree)).encode("utf-8", "replace")


def finite(value: Any) -> None:
    """No NaN goes on: in what was read nothing is NaN that no file can have said."""
    assert np.isfinite(np.asarray(value, dtype=float)).all()


def run_is_read(path: Path) -> None:
    data = sk.read_measurements(path)
    finite(data.joints)
    finite(data.readings)
    finite(data.time_s if data.time_s is not None else 0.0)
    for column in data.covariates.values():
        finite(column)
    assert data.taken.any(axis=1).all()


def robot_is_read(path: Path) -> None:
    robot = sk.load_robot(path)
    finite(getattr(robot, "geometry", 0.0))
    assert tomli_w.dumps(robot.to_tables())


def calibration_is_read(path: Path) -> None:
    made = sk.load_calibration(path)
    joints = made.robot.inverse(made.robot.middle)
    place = made.forward(joints)
    finite(place)
    finite(made.jacobian(joints))
    # a calibration that makes no robot may be refused here, never answered with joints that lead elsewhere
    np.testing.assert_allclose(made.forward(made.inverse(place)), place, rtol=1e-7, atol=1e-5)
    assert 0.0 < made.accuracy(place) < 1e6


def tool_run_is_read(path: Path) -> None:
    run = read_tool_run(path)
    finite(run.time_s)
    finite(run.position_mm)


def run_file_is_read(path: Path, plan: Plan, about: dict[str, str]) -> None:
    for ending in ("-wal", "-shm"):
        Path(f"{path}{ending}").unlink(missing_ok=True)
    with RunFile.open(path) as run:
        assert len(run.plan) >= 0
        assert len(run.points()) >= len(run.done()) - 1
        run.diary()
        run.instruments()
    export_run(path, path.with_name("out.csv"))
    RunFile.resume(path, plan, about).close()


def study_is_read(path: Path) -> None:
    study = sk.Study.load(path.parent)
    finite(study.fit.values)
    assert repr(study)


def printer_is_read(path: Path) -> None:
    found = import_klipper(path)
    if found.measurements is not None:
        finite(found.measurements.joints)


def arm_is_read(arm: Serial) -> None:
    finite(arm.forward(np.zeros(len(arm.joints))))
    assert tomli_w.dumps(arm.to_tables())


def documents_are_read(path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sk.SherkitWarning)
        run = sk.from_bluesky(path, columns=COLUMNS)
    finite(run.joints)
    finite(run.readings)


def bag_is_read(path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sk.SherkitWarning)
        run = sk.from_rosbag(path.parent, OURS, "/tracker")
    finite(run.joints)
    finite(run.readings)


def lines_run() -> sk.Measurements:
    virtual = VirtualDelta.draw(EXAMPLE, 6, noise_mm=0.005)
    return virtual.measure(grid(20.0, 3, (-15.0, 15.0)), repeats=2, seed=1)


@functools.cache
def formats(folder: Path) -> dict[str, Format]:
    """Every file that sherkit reads, small and whole, in ``folder``."""
    sk.save_robot(EXAMPLE, folder / "delta.toml")
    (folder / "spherical.toml").write_bytes(toml(SPHERICAL))
    tool = FlexibleTool()
    tool.save(folder / "tool.toml")
    data = lines_run()
    data.save(folder / "run.csv")
    data.save(folder / "run.parquet")
    frame = data.to_frame().with_columns(pl.lit(20.5).alias("temperature_c"), sigma_x_mm=0.005)
    semicolons = frame.write_csv(separator=";").replace(".", ",")
    (folder / "semicolons.csv").write_text("# made on Monday\n" + semicolons)
    VirtualTool(tool).free_motion(seconds=0.1, seed=1).save(folder / "free.csv")
    VirtualTool(tool).bench(loads=12, unloaded=5, seed=1).save(folder / "loads.csv")
    study = sk.Study(EXAMPLE, data)
    study.add("rail_lean")
    study.mark_outliers([1])
    study.save(folder / "study")
    calibration = study.calibration()
    # of the effects that the poses could not show three are enough: one is periodic, one has a setting, one has none
    few = list({one.effect: one for one in calibration.whole.unobserved_effects}.values())[:3]
    replace(calibration, whole=replace(calibration.whole, unobserved_effects=tuple(few))).save(
        folder / "calibrated.toml"
    )
    lab = laboratory(folder / "lab")
    planned = experiment(folder / "lab", goal={"std_um": 10.0}, retry={"attempts": 2})
    (folder / "seen").mkdir()
    spherical_laboratory(folder / "seen")
    ports = {"rails": {"kind": "galil", "address": "tcp://127.0.0.1:1"}}
    ports["lasers"] = {"kind": "keyence", "address": "tcp://127.0.0.1:2"}
    (folder / "lab" / "ports.json").write_bytes(as_json(ports))
    chosen = load_experiment(planned)
    with RunFile.create(folder / "run.sqlite", chosen.plan, chosen.about()) as run:
        run.begin({"rails": {"kind": "galil", "identity": "x", "port": "y", "settings": {"a": 1}}})
        for step, one in enumerate(chosen.plan):
            values = {f"q{k + 1}_mm": q for k, q in enumerate(one.joints)} | {
                "x_mm": 0.1,
                "y_mm": 0.2,
                "z_mm": float("nan"),
            }
            run.store(step, Point(one.pose, one.repeat, 100.0 + step, values))
        run.note("paused")
        run.end("complete")
    with contextlib.closing(sqlite3.connect(folder / "run.sqlite")) as db:
        db.execute("PRAGMA journal_mode = DELETE")
    (folder / "printer.cfg").write_text(config(TRUE, SAVED))
    printer = Trial.of("bent plate", 1, 1)
    for firmware in ("reprapfirmware", "marlin"):
        printer.write(folder, firmware, (0.0,), 1)
    (folder / "dh.csv").write_text(UR5)
    (folder / "small.urdf").write_text(URDF)
    (folder / "run.jsonl").write_text("\n".join(json.dumps(pair) for pair in told()))
    bag(folder / "bag")

    def of(name: str, reads: Callable[[Path], object]) -> Format:
        path = folder / name
        if path.suffix == ".toml":
            return Format(path, reads, tomllib.loads(path.read_text()), toml)
        if path.suffix == ".json":
            return Format(path, reads, json.loads(path.read_text()), as_json)
        return Format(path, reads)

    return {
        "run": of("run.csv", run_is_read),
        "decimal commas": of("semicolons.csv", run_is_read),
        "parquet": of("run.parquet", run_is_read),
        "delta": of("delta.toml", robot_is_read),
        "spherical": of("spherical.toml", robot_is_read),
        "tool": of("tool.toml", load_tool),
        "tool run": of("free.csv", tool_run_is_read),
        "loads": of("loads.csv", read_loads),
        "calibration": of("calibrated.toml", calibration_is_read),
        "laboratory": Format(lab, load_laboratory, tomllib.loads(lab.read_text()), toml),
        "experiment": Format(planned, load_experiment, tomllib.loads(planned.read_text()), toml),
        "experiment of a camera": of("seen/experiment.toml", lambda p: load_experiment(p, offline=True)),
        "laboratory of a camera": of("seen/lab.toml", load_laboratory),
        "ports": of("lab/ports.json", read_ports),
        "run file": of("run.sqlite", lambda p: run_file_is_read(p, chosen.plan, chosen.about())),
        "study": of("study/study.json", study_is_read),
        "printer": of("printer.cfg", printer_is_read),
        "config.g": of("config.g", lambda path: import_duet(path, [folder / "at0.csv"])),
        "height map": of("at0.csv", lambda path: import_duet(folder / "config.g", [path])),
        "Marlin": of("marlin.txt", import_marlin),
        "DH": of("dh.csv", lambda path: arm_is_read(import_dh(path))),
        "URDF": of("small.urdf", lambda path: arm_is_read(import_urdf(path, tip="tip"))),
        "bluesky": of("run.jsonl", documents_are_read),
        "bag": of(next((folder / "bag").glob("*.db3")).relative_to(folder).as_posix(), bag_is_read),
        "bag's index": of("bag/metadata.yaml", bag_is_read),
    }


NAMES = (
    "run", "decimal commas", "parquet", "delta", "spherical", "tool", "tool run", "loads", "calibration", "laboratory",
    "experiment", "experiment of a camera", "laboratory of a camera", "ports", "run file", "study", "printer",
    "config.g", "height map", "Marlin", "DH", "URDF", "bluesky", "bag", "bag's index",
)  # fmt: skip


@pytest.fixture(scope="module")
def whole() -> Iterator[dict[str, Format]]:
    with in_memory() as folder:
        yield formats(folder)


def tried(one: Format, count: int, seed: str) -> Campaign:
    """Damages a file so often, beside its whole one, which every input stands in for."""
    rng, content, campaign = random.Random(seed), one.path.read_bytes(), Campaign()
    one.reads(one.path)
    fresh = one.path
    try:
        with watched():
            for _ in range(count):
                damaged = one.damaged(content, rng)
                fresh.write_bytes(damaged)
                campaign.try_one(one.path.name, damaged, lambda: one.reads(fresh))
    finally:
        fresh.write_bytes(content)
    return campaign


@pytest.mark.parametrize("name", NAMES)
def test_a_damaged_file_is_read_or_refused_in_a_sentence(name: str, whole: dict[str, Format]) -> None:
    """Catches a KeyError, a panic, a hang, a NaN that goes on, in place of what is wrong with the file."""
    tried(whole[name], 3 if name == "parquet" else FAST, name).over()


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_many_damaged_files(name: str, whole: dict[str, Format], monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches the same where it is rare."""
    seed = os.urandom(8).hex() if os.environ.get("SHERKIT_RANDOM") else name
    with forked(monkeypatch):
        campaign = tried(whole[name], SLOW, f"{seed} many")
    print(f"{name}: seed {seed}: {campaign.read} read, {campaign.refused} refused")
    campaign.over()
