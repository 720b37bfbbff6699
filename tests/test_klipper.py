"""Klipper's printer.cfg: a simulated printer of known errors, broken files, and a real one."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray

from second_printer.firmware import Firmware
from second_printer.trials import Trial
from sherkit import Measurements, SherkitError, diagnose, identify, load_robot, read_measurements
from sherkit.cli import main
from sherkit.robots.printer import PrinterModel, import_klipper
from sherkit.robots.printer.printer_diagnosis import examine

Floats = NDArray[np.float64]

REAL = Path(__file__).parent / "data" / "delta_flsun_v400_b"


# -- a printer, written from Klipper's documentation and not from the importer -------------------------------


class Printer(Firmware):
    """A delta as Klipper sees it: one radius; angle, arm and end stop per tower."""

    def carriages(self, at: Floats) -> Floats:
        """Heights of the carriages (3,) with the nozzle at ``at`` (3,), mm."""
        return at[2] + np.sqrt(np.square(self.arm) - ((self.towers - at[:2]) ** 2).sum(axis=1))

    def nozzle(self, carriages: Floats) -> Floats:
        """Where the nozzle is (3,), mm, by Newton's method."""
        at = np.array([0.0, 0.0, carriages.mean() - np.sqrt(np.mean(self.arm) ** 2 - self.radius**2)])
        for _ in range(8):
            rod = np.column_stack([at[:2] - self.towers, at[2] - carriages])
            at = at - np.linalg.solve(2 * rod, (rod**2).sum(axis=1) - np.square(self.arm))
        return at


SAVED = Printer(100.0, (210.5, 329.7, 90.0), (220.1, 219.6, 220.4), (250.2, 249.9, 250.4))
TRUE = Printer(101.2, (210.1, 330.4, 90.6), (221.3, 219.9, 219.5), (249.1, 250.5, 250.1))
#: Distance of the arms' joints from the middle of the effector that a printer is believed to have, mm.
EFFECTOR = 30.0


def feet_of_the_base() -> Floats:
    """Where the importer's robot has the true towers, as complex numbers: further out by the effector's joints."""
    out = EFFECTOR * np.exp(1j * np.deg2rad(SAVED.angle))
    return TRUE.towers @ np.array([1, 1j]) + out


#: What the importer's robot lacks to be the true one.
ERRORS = {
    **{f"base_radius_{i + 1}": abs(feet_of_the_base()[i]) - SAVED.radius - EFFECTOR for i in range(3)},
    **{
        f"base_angle_{i + 1}": float(np.angle(feet_of_the_base()[i] * np.exp(-1j * np.deg2rad(SAVED.angle[i]))))
        for i in range(3)
    },
    **{f"rod_length_{i + 1}": TRUE.arm[i] - SAVED.arm[i] for i in range(3)},
    **{f"joint_offset_{i + 1}": float(TRUE.top[i] - SAVED.top[i]) for i in range(3)},
}
#: 200 full steps · 16 · 5/40, 400 · 32/(40), 200 · 16 / 32: three ways to say it.
STEPS = np.array([400.0, 320.0, 100.0])
STEPS_TEXT = (
    "microsteps: 16\nrotation_distance: 40\ngear_ratio: 80:16",
    "microsteps = 32   ; half as fine\nfull_steps_per_rotation = 400\nrotation_distance = 40",
    "microsteps: 16\nrotation_distance: 32 # mm",
)
EDGE, COUNT = 69.99, 7  # of a mesh of radius 70: Klipper rounds its step down to hundredths


def steps(true: Printer, at: Floats) -> str:
    """Steps down from the end stops at a true position, as Klipper writes them."""
    return ",".join(f"{v:.3f}" for v in (true.top - true.carriages(at)) * STEPS)


def touched(true: Printer, saved: Printer, x: float, y: float) -> float:
    """Where the printer believes the nozzle to be when it touches the bed at commanded x, y."""
    z = 0.0
    for _ in range(6):
        # the printer counts from the end stops, where it believes the carriages to be at its own top
        z -= float(true.nozzle(saved.carriages(np.array([x, y, z])) - saved.top + true.top)[2])
    return z


@cache
def config(true: Printer, saved: Printer, *, square: bool = False) -> str:
    """A printer.cfg after DELTA_CALIBRATE, BED_MESH_CALIBRATE and SAVE_CONFIG."""
    lines = ["[printer]", "kinematics: delta", "#delta_radius: 99 ; old", "print_radius: 80"]
    for name, text in zip("abc", STEPS_TEXT, strict=True):
        lines += ["", f"[stepper_{name}]", "step_pin: PE3 # not read", "#arm_length: 1", text]
    lines += ["", "[bed_mesh]", "mesh_min: -60, -50\nmesh_max: 60, 50" if square else "mesh_radius: 70", ""]
    block = ["[printer]", f"delta_radius = {saved.radius:.6f}", ""]
    for k, name in enumerate("abc"):
        block += [f"[stepper_{name}]", f"angle = {saved.angle[k]:.6f}", f"arm_length = {saved.arm[k]:.6f}"]
        block += [f"position_endstop = {saved.endstop[k]:.6f}", ""]
    block.append("[delta_calibrate]")
    for k, at in enumerate(heights()):
        block += [f"height{k} = {at[2]}", f"height{k}_pos = {steps(true, at)}"]
    block += ["manual_height0 = 12.5", f"manual_height0_pos = {steps(true, np.array([20.0, -30.0, 12.5]))}"]
    for k, (start, end) in enumerate(distances()):
        block += [f"distance{k} = {np.linalg.norm(start - end)}"]
        block += [f"distance{k}_pos1 = {steps(true, start)}", f"distance{k}_pos2 = {steps(true, end)}"]
    block += ["", "[bed_mesh default]", "version = 1", "points ="]
    across, along = mesh(square=square)
    for y in along:
        # Klipper fills each row of a round mesh up with copies of its ends
        probed = [x for x in across if square or math.hypot(x, y) <= 70.0]
        ends = [min(max(x, probed[0]), probed[-1]) for x in across]
        block.append("\t" + ", ".join(f"{touched(true, saved, x, y):.6f}" for x in ends))
    block += [f"min_x = {across[0]}", f"max_x = {across[-1]}", f"min_y = {along[0]}", f"max_y = {along[-1]}"]
    saved_lines = ["<---------------------- SAVE_CONFIG ---------------------->", "DO NOT EDIT", "", *block]
    return "\n".join(lines) + "\n" + "".join(f"#*# {line}".rstrip() + "\n" for line in saved_lines)


def heights() -> list[Floats]:
    """Probed points of a known height: twelve, so that two-digit numbers are sorted as numbers."""
    turn = np.deg2rad(30.0 * np.arange(12))
    return [np.array([(40 + 3 * k) * np.cos(t), (40 + 3 * k) * np.sin(t), 8.5]) for k, t in enumerate(turn)]


def distances() -> list[tuple[Floats, Floats]]:
    """Ends of measured distances on the bed."""
    turn = np.deg2rad(60.0 * np.arange(6))
    ends = [np.array([np.cos(t), np.sin(t), 0.0]) for t in turn]
    return [(4.5 * e, 69.5 * e) for e in ends] + [(60.0 * a, 60.0 * b) for a, b in zip(ends, ends[2:], strict=False)]


def mesh(*, square: bool = False) -> tuple[Floats, Floats]:
    """x and y of the probed grid."""
    if square:
        return np.linspace(-60.0, 60.0, 5), np.linspace(-50.0, 50.0, 3)
    return np.linspace(-EDGE, EDGE, COUNT), np.linspace(-EDGE, EDGE, COUNT)


def saved(folder: Path, text: str | bytes) -> Path:
    """A printer.cfg in ``folder``."""
    path = folder / "printer.cfg"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def command(*arguments: str) -> int:
    """Runs sherkit."""
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    return int(ended.value.code or 0)


def misses(data: Measurements, predicted: Floats) -> Floats:
    """Readings minus predictions where something was read, mm."""
    return (data.readings - predicted)[data.taken]


# -- the simulated printer -----------------------------------------------------------------------------------


def test_the_printer_is_consistent() -> None:
    """Catches a mistake in this file's printer, with which the others would agree or disagree for nothing."""
    at = np.array([30.0, -20.0, 5.0])
    assert np.abs(TRUE.nozzle(TRUE.carriages(at)) - at).max() < 1e-10
    z = touched(TRUE, SAVED, 30.0, 40.0)
    assert abs(z) > 0.1
    assert abs(TRUE.nozzle(SAVED.carriages(np.array([30.0, 40.0, z])) - SAVED.top + TRUE.top)[2]) < 1e-10


def test_a_calibrated_printer_reads_as_nominal(tmp_path: Path) -> None:
    """Catches wrong towers, end stops, gears or steps: a printer without errors predicts all that it measured."""
    found = import_klipper(saved(tmp_path, config(TRUE, TRUE)))
    data = found.measurements
    model = PrinterModel(found.robot)
    # steps are written to a thousandth, probed heights to a nanometre
    assert np.abs(misses(data, model.predict(data, np.zeros(len(model.parameters))))).max() < 2e-5
    assert found.robot.workspace_radius_mm == 80.0


@pytest.mark.parametrize("square", [False, True])
def test_errors_of_the_saved_calibration_reproduce_the_rows(square: bool, tmp_path: Path) -> None:
    """Catches rows that are right only for a perfect printer: steps count from the end stop, meshes do not."""
    found = import_klipper(saved(tmp_path, config(TRUE, SAVED, square=square)))
    data = found.measurements
    model = PrinterModel(found.robot, tuple(ERRORS))
    # the mesh has no zero of its own here
    values = np.array([*ERRORS.values(), 0.0])
    assert np.abs(misses(data, model.predict(data, values))).max() < 2e-5
    assert np.sqrt(np.mean(misses(data, model.predict(data, 0 * values)) ** 2)) > 0.1
    fit = identify(found.robot, data)
    assert np.nanmax(np.abs(fit.residuals)) < 2e-5


@pytest.mark.parametrize(("square", "points"), [(False, 29), (True, 15)])
def test_kinds_of_rows(square: bool, points: int, tmp_path: Path) -> None:
    """Catches copies in the corners of a round mesh taken for probed, and manual heights left out."""
    found = import_klipper(saved(tmp_path, config(TRUE, SAVED, square=square)))
    kinds, counts = np.unique(found.measurements.labels["what"], return_counts=True)
    assert dict(zip(kinds.tolist(), counts.tolist(), strict=True)) == {
        "distance": 10, "height": 12, "manual_height": 1, "default": points,
    }  # fmt: skip
    believed = found.robot.forward_batch(found.measurements.joints[found.measurements.labels["what"] == "default"])
    across, along = mesh(square=square)
    assert np.unique(believed.require()[:, 0].round(6)).tolist() == pytest.approx(across)
    assert np.unique(believed.require()[:, 1].round(6)).tolist() == pytest.approx(along)


def test_what_stands_above_the_saved_block_counts(tmp_path: Path) -> None:
    """Catches the saved block preferred to a value set by hand, where Klipper itself prefers the latter."""
    text = config(TRUE, SAVED).replace("#arm_length: 1", "arm_length: 230", 1)
    assert import_klipper(saved(tmp_path, text)).robot.rod_length_mm == (230.0, SAVED.arm[1], SAVED.arm[2])


def test_towers_are_like_the_first_where_nothing_is_said(tmp_path: Path) -> None:
    """Catches a printer refused for leaving out what Klipper does not ask for."""
    text = config(TRUE, SAVED)
    for k in (1, 2):
        text = text.replace(f"#*# arm_length = {SAVED.arm[k]:.6f}\n", "")
        text = text.replace(f"#*# position_endstop = {SAVED.endstop[k]:.6f}\n", "")
    found = import_klipper(saved(tmp_path, re.sub(r"#\*# angle = .*\n", "", text)))
    assert found.robot.rod_length_mm == (SAVED.arm[0],) * 3
    assert found.robot.base_angle_deg == (210.0, 330.0, 90.0)


def test_the_command_writes_what_the_function_reads(tmp_path: Path) -> None:
    """Catches rows lost between ``sherkit import`` and ``sherkit calibrate``."""
    path = saved(tmp_path, config(TRUE, SAVED))
    assert command("import", "klipper", str(path), "-o", str(tmp_path / "out")) == 0
    found = import_klipper(path)
    assert load_robot(tmp_path / "out" / "robot.toml") == found.robot
    read = read_measurements(tmp_path / "out" / "run.csv")
    assert np.array_equal(read.joints, found.measurements.joints)
    assert np.array_equal(read.readings, found.measurements.readings)
    assert np.array_equal(read.taken, found.measurements.taken)
    assert read.labels["what"].tolist() == found.measurements.labels["what"].tolist()


def test_thirteen_points_decide_nothing(tmp_path: Path) -> None:
    """Catches an effect named, or a printer praised, by points that hardly outnumber the parameters: a mesh of five
    across, as printers come, of printers without a fault; that of seed 47 once had a leaning rail."""
    for seed in (0, 1, 47):
        trial = dataclasses.replace(Trial.of("none", 3, seed), count=5)
        (path,) = trial.write(tmp_path, "klipper", (0.0,), seed)
        found = import_klipper(path)
        d = diagnose(found.robot, found.measurements)
        assert len(found.measurements) == 13
        assert d.effects == ()
        assert "13 poses fix" in d.headline
        assert d.verdict == "undecided" or seed == 47, d.headline


# -- files that are refused ----------------------------------------------------------------------------------

Change = Callable[[str], str]


def swap(old: str, new: str) -> Change:
    """Replaces a piece of the config that must be there."""

    def change(text: str) -> str:
        assert old in text
        return text.replace(old, new, 1)

    return change


def without(stem: str) -> Change:
    """Leaves out the saved lines that start with ``stem``."""
    return lambda text: re.sub(rf"#\*# {stem}.*\n", "", text)


def test_a_round_mesh_may_be_rounded_in_one_way_more(tmp_path: Path) -> None:
    """Catches a mesh a little narrower than high, whose first row has no point within its radius."""
    text = config(TRUE, SAVED)
    rows = len(import_klipper(saved(tmp_path, text)).measurements)
    assert len(import_klipper(saved(tmp_path, text.replace("max_x = 69.99", "max_x = 69.9"))).measurements) == rows


def test_corners_of_a_round_mesh_need_not_be_reached(tmp_path: Path) -> None:
    """Catches "the point −156, 156 mm cannot be": corners that are no copies of the ends of their rows, as an older
    Klipper or an interpolation leaves them, and that no arm reaches, lie outside ``mesh_radius``."""
    text = config(TRUE, SAVED)
    rows = len(import_klipper(saved(tmp_path, text)).measurements)
    first = re.search(r"#\*# \t(.*)\n", text)
    other = ", ".join(f"{0.1 * k:.6f}" for k in range(COUNT))
    found = import_klipper(saved(tmp_path, text.replace(first[1], other, 1)))
    assert len(found.measurements) == rows
    far = text.replace(first[1], other, 1)
    for end in ("max_x", "max_y"):
        far = far.replace(f"{end} = {EDGE}", f"{end} = 110.0")
    for end in ("min_x", "min_y"):
        far = far.replace(f"{end} = {-EDGE}", f"{end} = -110.0")
    far = far.replace("mesh_radius: 70", "mesh_radius: 110")
    assert len(import_klipper(saved(tmp_path, far)).measurements) == rows


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (swap("kinematics: delta", "kinematics: corexy"), "[printer] kinematics is not 'delta'"),
        (lambda _: "", "has no 'kinematics' in a section [printer]; expected the printer.cfg"),
        (without("delta_radius"), "[printer] delta_radius is missing"),
        (swap("delta_radius = 100.000000", "delta_radius = 0"), "[printer] delta_radius: expected a number above zero"),
        (without("arm_length"), "[stepper_a] arm_length is missing"),
        (without("position_endstop"), "[stepper_a] position_endstop is missing"),
        (
            swap("arm_length = 219.6", "arm_length = 100.0"),
            "[stepper_b] arm_length 100 is not longer than delta_radius",
        ),
        (swap("arm_length = 219.6", "arm_length = long"), "[stepper_b] arm_length: expected 1 number(s), found 'long"),
        (swap("arm_length = 219.6", "arm_length = nan "), "[stepper_b] arm_length: expected 1 number(s), found 'nan"),
        (swap("rotation_distance = 40", ""), "[stepper_b] rotation_distance is missing"),
        (swap("rotation_distance = 40", "rotation_distance = 0"), "[stepper_b] 12800 steps move 0 mm"),
        (swap("microsteps = 32", "microsteps = -32"), "[stepper_b] -12800 steps move 40 mm"),
        (swap("80:16", "80"), "[stepper_a] gear_ratio: expected pairs like 80:16, found '80'"),
        (swap("80:16", "80:0"), "[stepper_a] gear_ratio: expected pairs like 80:16, found '80:0'"),
        (swap("height3_pos =", "height3_pos = 1,"), "[delta_calibrate] height3_pos: expected 3 number(s)"),
        (without("height3_pos"), "[delta_calibrate] height3_pos is missing"),
        (without("distance2_pos2"), "[delta_calibrate] distance2_pos2 is missing"),
        (swap("distance2 =", "distance2 = about"), "[delta_calibrate] distance2: expected 1 number(s), found 'about"),
        (without("min_x"), "[bed_mesh default] min_x is missing"),
        (swap("points =\n", "points =\n#*# \t0.1, 0.2\n"), "[bed_mesh default] points: expected rows of numbers"),
        (swap("max_x = 69.99", "max_x = -400"), "[bed_mesh default] min_x, max_x, min_y, max_y: expected a mesh from"),
        (swap("points =\n", "points =\n#*# \thigh\n"), "[bed_mesh default] points: expected rows of numbers"),
        (
            lambda text: swap("max_x = 69.99", "max_x = 400")(text.replace("mesh_radius: 70", "")),
            "[bed_mesh default] the point 165.005, -69.99 mm cannot be",
        ),
        (
            lambda text: re.sub(r"#\*# \[(delta_calibrate|bed_mesh)[^\0]*", "", text),
            "holds no probing; expected [delta_calibrate]",
        ),
    ],
)
def test_bad_configs_are_refused_in_words(change: Change, says: str, tmp_path: Path) -> None:
    """Catches a crash, or a printer read wrongly, and messages without file, section and option."""
    path = saved(tmp_path, change(config(TRUE, SAVED)))
    with pytest.raises(SherkitError) as refused:
        import_klipper(path)
    assert str(refused.value).startswith(f"{path}: ")
    assert says in str(refused.value)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    """Catches a traceback for a wrong name, a folder or a picture."""
    for path in (tmp_path / "other.cfg", tmp_path):
        with pytest.raises(SherkitError, match=re.escape(f"{path}: cannot be read")):
            import_klipper(path)
    with pytest.raises(SherkitError, match="is not a text file, expected a Klipper"):
        import_klipper(saved(tmp_path, b"\x89PNG\r\n\x1a\n\xff"))


# -- the real printer ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def real() -> Path:
    """The folder of the real printer."""
    return REAL


def test_the_real_printer_is_read_as_it_was_saved(real: Path) -> None:
    """Catches a robot that is not the one that the printer itself saved."""
    towers = import_klipper(real / "printer.cfg").robot.towers
    told = json.loads((real / "saved_parameters.json").read_text())
    assert towers.radius_mm == pytest.approx(told["delta_radius_mm"], abs=1e-12)
    assert list(towers.angle_deg) == told["tower_angle_deg"]
    assert list(towers.arm_mm) == told["arm_length_mm"]
    assert list(towers.endstop_mm) == told["position_endstop_mm"]


def test_the_real_rows_are_those_read_by_hand(real: Path) -> None:
    """Catches rows swapped, lost or converted by another rule than the one that made the three tables."""
    found = import_klipper(real / "printer.cfg")
    data, what = found.measurements, found.measurements.labels["what"]
    told = json.loads((real / "saved_parameters.json").read_text())
    arm, radius = np.array(told["arm_length_mm"]), told["delta_radius_mm"]
    top = np.array(told["position_endstop_mm"]) + np.sqrt(arm**2 - radius**2)

    def columns(table: pl.DataFrame, *names: str) -> Floats:
        return table.select(names).to_numpy()

    heights_, distances_, mesh_ = (pl.read_csv(real / f"{n}.csv") for n in ("heights", "distances", "meshes"))
    rows = what == "height"
    down = columns(heights_, "steps_a", "steps_b", "steps_c") / columns(heights_, "steps_per_mm")
    # the row is straight above or below the touch, as much as the reading is off the height of the gauge
    risen = data.joints[rows] - (top - down)
    assert np.ptp(risen, axis=1).max() < 1e-9
    z_offset = 16.0
    assert np.abs(data.readings[rows, 0] - (heights_["height_mm"].to_numpy() - z_offset + risen[:, 0])).max() < 1e-9
    rows = what == "distance"
    for joints, end in ((data.joints, "p1"), (data.to_joints, "p2")):
        down = columns(distances_, *(f"{end}_steps_{a}" for a in "abc")) / columns(distances_, "steps_per_mm")
        assert np.abs(joints[rows] - (top - down)).max() < 1e-9
    assert data.readings[rows, 0].tolist() == distances_["distance_mm"].to_list()
    rows = what == "default"
    # the table has the carriages for the nozzle where the mesh has the tip of the probe, 16 mm lower; a mesh's z is how
    # high the plate is, its row how high the tip would be above it
    travel = columns(mesh_, "travel_a_mm", "travel_b_mm", "travel_c_mm") - mesh_["z_probe_mm"].to_numpy()[:, None]
    assert np.ptp(top - data.joints[rows] - travel, axis=1).max() < 1e-5  # five decimals in the table
    assert np.abs(data.readings[rows, 0] + mesh_["z_probe_mm"].to_numpy()).max() < 1e-12
    assert len(data) == len(heights_) + len(distances_) + len(mesh_)
    assert found.robot.probings == ("DELTA_CALIBRATE", "default")


def test_the_real_printer_is_calibrated(real: Path, tmp_path: Path) -> None:
    """Catches a fit that does not end, keeps silent on what heights do not tell, or is worse than Klipper's own."""
    found = import_klipper(real / "printer.cfg")
    fit = identify(found.robot, found.measurements)
    # nine numbers of a delta and the zero of the mesh; where the middle of the bed is and what it faces is no error
    assert fit.converged
    assert fit.rank == 10
    assert len(fit.unobserved) == 3
    assert np.nansum(fit.residuals**2) < 0.5 * np.nansum(fit.nominal_residuals**2)


def test_the_real_printer_is_not_twisted(real: Path) -> None:
    """Catches a machine blamed for the scatter of its probe and callipers: of this one a model of others' making names
    no lean either."""
    e = examine(import_klipper(real / "printer.cfg"))
    assert not e.suspects
    assert e.diagnosis.p_missing > 0.01
    assert not e.better_numbers
