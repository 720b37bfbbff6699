"""Delta printers: files of three firmwares, there and back; a plate that is bent; what their owner is told."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from second_printer import Firmware, Machine, Plate, Probe, duet_files, klipper_file, marlin_file, mesh_points, touched
from second_printer.trials import Trial
from sherkit import SherkitError, identify, load_robot, read_measurements
from sherkit.cli import main
from sherkit.errors import RobotError
from sherkit.fit.least_squares import iterate
from sherkit.model.effect import check_user_effect
from sherkit.robots.calibrated import Calibration
from sherkit.robots.printer import PrinterModel, Towers, import_duet, import_klipper, import_marlin
from sherkit.robots.printer.calibration import commands, held, klipper_config, towers_of
from sherkit.robots.printer.model import bed_shape, shapes_at
from sherkit.robots.printer.printer_diagnosis import examine, files_of
from sherkit.robots.printer.robot import ImportedPrinter

Floats = NDArray[np.float64]

BELIEVED = Firmware(150.0, (210.3, 329.8, 90.1), (340.0, 340.5, 339.7), (400.0, 400.2, 399.6))
OFFSET = (10.0, -20.0, 2.5)
REAL = Machine.of(
    np.array([150.4, 149.8, 150.1]),
    np.array([210.1, 330.1, 89.9]),
    np.array([340.3, 340.1, 339.9]),
    BELIEVED.top + np.array([0.1, -0.2, 0.15]),
)
TWISTED = replace(REAL, lean=np.array([[0.0, np.deg2rad(0.5)]] * 3))


def command(*arguments: str) -> int:
    """Runs sherkit."""
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    return int(ended.value.code or 0)


def probed(
    machine: Machine,
    firmware: Firmware,
    *,
    plate: Plate | None = None,
    noise: float = 0.0,
    seed: int = 0,
    count: int = 7,
) -> tuple[Floats, Floats, Floats]:
    """A round mesh: ticks and heights, NaN where it was not probed."""
    ticks, inside = mesh_points(120.0, count)
    x, y = np.meshgrid(ticks, ticks)
    z = np.full(inside.shape, np.nan)
    rng = np.random.default_rng(seed) if noise else None
    at = np.column_stack([x[inside], y[inside]])
    z[inside] = touched(machine, firmware, plate or Plate.flat(), Probe(OFFSET, noise=noise), at, rng)[0]
    return ticks, ticks, z


def as_klipper(folder: Path, firmware: Firmware, mesh: tuple[Floats, Floats, Floats]) -> ImportedPrinter:
    """Written by Klipper and read."""
    (folder / "printer.cfg").write_text(klipper_file(firmware, {"default": mesh}, offset=OFFSET))
    return import_klipper(folder / "printer.cfg")


def as_duet(folder: Path, firmware: Firmware, mesh: tuple[Floats, Floats, Floats]) -> ImportedPrinter:
    """Written by RepRapFirmware and read."""
    config, heights = duet_files(firmware, mesh, offset=OFFSET)
    (folder / "config.g").write_text(config)
    (folder / "heightmap.csv").write_text(heights)
    return import_duet(folder / "config.g", [folder / "heightmap.csv"])


def as_marlin(folder: Path, firmware: Firmware, mesh: tuple[Floats, Floats, Floats]) -> ImportedPrinter:
    """Written by Marlin and read."""
    (folder / "marlin.txt").write_text(marlin_file(firmware, mesh, offset=OFFSET))
    return import_marlin(folder / "marlin.txt")


WAYS = {"klipper": as_klipper, "reprapfirmware": as_duet, "marlin": as_marlin}
Way = Callable[[Path, Firmware, tuple[Floats, Floats, Floats]], ImportedPrinter]


# -- the second simulator ----------------------------------------------------------------------------------------------


def test_the_second_simulator_is_consistent() -> None:
    """Catches a machine of this test that does not stand where its firmware sends it."""
    perfect = Machine.of(np.full(3, BELIEVED.radius), np.array(BELIEVED.angle), np.array(BELIEVED.arm), BELIEVED.top)
    at = np.array([[10.0, 20.0, 5.0], [100.0, -50.0, 0.0]])
    assert np.abs(perfect.tip(BELIEVED.down(at), np.zeros(3)) - at).max() < 1e-10
    assert np.nanmax(np.abs(probed(perfect, BELIEVED)[2])) < 1e-10


def three_spheres(towers: Floats, heights: Floats, arms: Floats) -> Floats:
    """The lower point (3,) at these distances from three carriages: firmwares' forward kinematics in its plainest form,
    the two planes in which spheres meet, and one sphere."""
    centre = np.column_stack([towers, heights])
    normals = 2.0 * (centre[1:] - centre[0])
    right = arms[0] ** 2 - arms[1:] ** 2 + (centre[1:] ** 2).sum(axis=1) - (centre[0] ** 2).sum()
    along = np.cross(normals[0], normals[1])
    on = np.linalg.lstsq(normals, right, rcond=None)[0]
    d, a = on - centre[0], along @ along
    root = np.sqrt((along @ d) ** 2 - a * (d @ d - arms[0] ** 2))
    both = [on + along * (-(along @ d) + sign * root) / a for sign in (1, -1)]
    return min(both, key=lambda p: p[2])


@pytest.mark.parametrize("firmware", WAYS)
def test_the_robot_stands_where_the_firmware_has_it(firmware: str, tmp_path: Path) -> None:
    """Catches an angle, an end stop, a diagonal or a tilt of another sign than the firmware's own."""
    believed = replace(BELIEVED, tilt=(0.003, -0.002)) if firmware == "reprapfirmware" else BELIEVED
    found = WAYS[firmware](tmp_path, believed, probed(REAL, believed))
    robot = replace(found.robot, target_offset_mm=(0.0, 0.0, 0.0))
    rng = np.random.default_rng(3)
    for x, y, z in rng.uniform(-60, 60, (5, 3)):
        down = believed.down(np.array([[x, y, z]]))[0]
        nozzle = robot.forward(robot.towers.top_mm - down)
        plane = float(robot.plane_mm(np.array([x, y])))
        # four decimals of a millimetre are what a G-code has
        assert nozzle == pytest.approx([x, y, z + plane], abs=2e-3 if firmware == "marlin" else 2e-5)
    exact = PrinterModel(robot).robot.forward(robot.towers.top_mm - [150.0, 160.0, 170.0])
    feet = robot.towers.radius_mm * np.stack(
        [np.cos(np.deg2rad(robot.towers.angle_deg)), np.sin(np.deg2rad(robot.towers.angle_deg))], axis=1
    )
    other = three_spheres(feet, robot.towers.top_mm - [150.0, 160.0, 170.0], np.array(robot.towers.arm_mm))
    assert np.abs(exact - other).max() < 1e-9


# -- there and back ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", WAYS)
def test_the_numbers_that_go_back_make_the_plate_even(firmware: str, tmp_path: Path) -> None:
    """Catches numbers with a wrong sign, a probe's offset that is not used, and a mesh that is read across: with what
    goes back to the firmware, the same machine probes a plate that is even."""
    found = WAYS[firmware](tmp_path, BELIEVED, probed(REAL, BELIEVED))
    new = held(found.robot, identify(found.robot, found.measurements).by_name).towers
    after = replace(BELIEVED, radius=new.radius_mm, angle=new.angle_deg, arm=new.arm_mm, endstop=new.endstop_mm)
    before = np.nanmax(np.abs(probed(REAL, BELIEVED)[2]))
    assert before > 0.2
    # a mesh of three decimals leaves a few of the last one
    assert np.nanmax(np.abs(probed(REAL, after)[2])) < (1e-5 if firmware == "klipper" else 0.005)


@pytest.mark.parametrize("firmware", WAYS)
def test_reading_writing_and_reading_is_reading(firmware: str, tmp_path: Path) -> None:
    """Catches a digit, an option or a convention that is lost on the way back."""
    believed = replace(BELIEVED, tilt=(0.003, -0.002)) if firmware == "reprapfirmware" else BELIEVED
    mesh = probed(REAL, believed)
    found = WAYS[firmware](tmp_path, believed, mesh)
    again = towers_of(found.robot, {})
    if firmware == "klipper":
        text = klipper_config(tmp_path / "printer.cfg", again)
        assert text == (tmp_path / "printer.cfg").read_text()
        return
    lines = commands(found.robot, again)
    name = "config.g" if firmware == "reprapfirmware" else "marlin.txt"
    old = (tmp_path / name).read_text().splitlines()
    (tmp_path / name).write_text("\n".join([*(o for o in old if "M665" not in o and "M666" not in o), *lines]))
    back = import_duet(tmp_path / name, [tmp_path / "heightmap.csv"]) if name.endswith(".g") else import_marlin(
        tmp_path / name
    )  # fmt: skip
    assert np.allclose(back.robot.towers.endstop_mm, found.robot.towers.endstop_mm, atol=2e-4)
    assert np.allclose(back.robot.towers.arm_mm, found.robot.towers.arm_mm, atol=2e-4)
    assert np.allclose(back.robot.towers.angle_deg, found.robot.towers.angle_deg, atol=1e-4)
    assert back.robot.tilt == pytest.approx(found.robot.tilt, abs=1e-6)


def test_any_triangle_is_a_circle() -> None:
    """Catches towers of three different radii that come back as another machine."""
    rng = np.random.default_rng(1)
    feet = BELIEVED.towers + rng.normal(0, 2.0, (3, 2))
    towers = Towers.through(feet, np.array(BELIEVED.arm), BELIEVED.top)
    back = towers.radius_mm * np.exp(1j * np.deg2rad(towers.angle_deg))
    sides = np.abs(np.diff(feet[[0, 1, 2, 0]] @ [1, 1j]))
    assert np.abs(np.diff(back[[0, 1, 2, 0]])) == pytest.approx(sides, abs=1e-9)
    assert towers.angle_deg[2] == pytest.approx(90.0)
    assert towers.top_mm == pytest.approx(BELIEVED.top, abs=1e-9)


def test_save_config_as_klipper_does_it(tmp_path: Path) -> None:
    """Catches an option above the block that would hold against the one in it, and lines of others that are lost."""
    path = tmp_path / "printer.cfg"
    text = klipper_file(BELIEVED, {"default": probed(REAL, BELIEVED)}, offset=OFFSET)
    path.write_text(text.replace("[stepper_b]\n", "[stepper_b]\narm_length: 333 # by hand\n", 1))
    assert import_klipper(path).robot.towers.arm_mm[1] == 333.0
    new = Towers(151.0, (210.0, 330.0, 90.0), (341.0, 342.0, 343.0), (401.0, 402.0, 403.0))
    path.write_text(klipper_config(path, new))
    assert "#arm_length: 333 # by hand" in path.read_text()
    # the mesh was probed with the old numbers: loaded with the new ones it would bring their errors back
    with pytest.raises(SherkitError, match="holds no probing"):
        import_klipper(path)
    above, block = path.read_text().split("#*#", 1)
    mesh = text[text.index("#*# [bed_mesh default]") :]
    path.write_text(f"{above}#*#{block}{mesh}")
    back = import_klipper(path)
    assert back.robot.towers == new
    assert len(back.measurements) == 29


# -- the plate ---------------------------------------------------------------------------------------------------------


def test_the_shape_of_a_plate_turns_with_it(tmp_path: Path) -> None:
    """Catches a plate that is turned the wrong way round, a derivative that is none, and distances that the plate
    moves."""
    xy = np.random.default_rng(0).uniform(-100, 100, (20, 2))
    turn = np.deg2rad(37.0)
    ahead = xy @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    assert np.abs(shapes_at(ahead, 37.0) - shapes_at(xy, 0.0)).max() < 1e-12
    found = as_klipper(tmp_path, BELIEVED, probed(REAL, BELIEVED))
    model = PrinterModel(found.robot)
    check_user_effect(bed_shape, model.rows(found.measurements, np.zeros(12)), 1)


def test_heights_and_distances_count_alike(tmp_path: Path) -> None:
    """Catches distances that a diagnosis does not see, and the standard calibration of seven heights and twelve
    distances that ends in a traceback."""
    turn = np.deg2rad(60.0 * np.arange(6))
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    at = np.vstack([[0.0, 0.0], 110.0 * ring])
    _, down = touched(REAL, BELIEVED, Plate.flat(), Probe(OFFSET), at)
    ends = [(ring[k] * 5.0, ring[k] * 70.0) for k in range(6)] + [
        (ring[k] * 70.0, ring[(k + 1) % 6] * 70.0) for k in range(6)
    ]
    pairs = []
    for a, b in ends:
        both = BELIEVED.down(np.column_stack([np.vstack([a, b]), np.zeros(2)]))
        where = REAL.tip(both, np.zeros(3))
        pairs.append((float(np.linalg.norm(where[1] - where[0])), both[0], both[1]))
    path = tmp_path / "printer.cfg"
    path.write_text(klipper_file(BELIEVED, {}, offset=OFFSET, heights=[(OFFSET[2], d) for d in down], distances=pairs))
    found = import_klipper(path)
    assert len(found.measurements) == 19
    fit = identify(found.robot, found.measurements)
    # hundredths of a millimetre of callipers
    assert np.abs(fit.residuals).max() < 0.01
    e = examine(found)
    assert "7 heights and 12 distances" in e.sections[0][1][0]
    path.write_text(klipper_file(BELIEVED, {}, offset=OFFSET, heights=[(OFFSET[2], d) for d in down]))
    with pytest.raises(SherkitError, match=r"7 measurements .* cannot tell the 9 numbers of a delta.* probe a mesh"):
        examine(import_klipper(path))


@pytest.mark.parametrize("zero_mm", [0.0, 0.4])
def test_callipers_that_are_not_at_zero_are_named(zero_mm: float, tmp_path: Path) -> None:
    """Catches a length that all distances have too much as towers that lean, or doubts of callipers that are right."""
    rng = np.random.default_rng(3)
    turn = np.deg2rad(60.0 * np.arange(6))
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    pairs = []
    for k in range(6):
        for a, b in ((5.0 * ring[k], 70.0 * ring[k]), (70.0 * ring[k], 70.0 * ring[(k + 1) % 6])):
            both = BELIEVED.down(np.column_stack([np.vstack([a, b]), np.zeros(2)]))
            where = REAL.tip(both, np.zeros(3))
            length = float(np.linalg.norm(where[1] - where[0])) + zero_mm + 0.02 * rng.normal()
            pairs.append((length, both[0], both[1]))
    mesh = {"default": probed(REAL, BELIEVED, noise=0.005)}
    path = tmp_path / "printer.cfg"
    path.write_text(klipper_file(BELIEVED, mesh, offset=OFFSET, distances=pairs))
    e = examine(import_klipper(path))
    assert [one.names for one in e.suspects[:1]] == ([("bar_zero",)] if zero_mm else [])
    assert ("callipers" in e.answer.verdict) == (zero_mm > 0)


# -- what its owner is told --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_twist_is_said_in_its_direction_and_size(tmp_path: Path) -> None:
    """Catches a lean that is told the wrong way round, or at the wrong size."""
    meshes = {
        name: probed(TWISTED, BELIEVED, noise=0.006, seed=seed, count=9)
        for seed, name in enumerate(("default", "turned"))
    }
    path = tmp_path / "printer.cfg"
    path.write_text(klipper_file(BELIEVED, meshes, offset=OFFSET))
    e = examine(import_klipper(path, {"turned": 60.0}))
    # two rods of an arm that differ by as much as printers' do leave much the same where the probe is beside the nozzle
    assert ("rail_lean",) in [s.names for s in e.suspects]
    assert not any("bed_shape" in s.names for s in e.suspects)
    said = " ".join(e.sections[1][1])
    top = float(BELIEVED.top.mean())
    assert "anticlockwise seen from above" in said
    told = float(said.split("anticlockwise seen from above, ")[1].split(" ")[0])
    assert told == pytest.approx(np.deg2rad(0.5) * top, rel=0.1)
    lean = next(s for s in e.suspects if s.names == ("rail_lean",))
    left = held(e.found.robot, lean.fit.by_name)
    assert 0.01 < left.rms_mm < left.largest_mm < 0.3
    text = json.dumps(e.to_json())
    assert "retina" not in text


def test_a_height_that_is_wild_is_left_out_and_nothing_else_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a crumb of 0.6 mm on the plate of a perfect machine that is "the scatter of the probe", and a printer.cfg
    with other numbers beside "What to do: Nothing"."""
    perfect = Machine.of(np.full(3, BELIEVED.radius), np.array(BELIEVED.angle), np.array(BELIEVED.arm), BELIEVED.top)
    x, y, z = probed(perfect, BELIEVED, noise=0.01)
    z[len(y) // 2, len(x) // 2 + 1] += 0.6
    as_klipper(tmp_path, BELIEVED, (x, y, z))
    config, new = tmp_path / "printer.cfg", tmp_path / "new.cfg"
    assert command("printer", str(config), "-o", str(new)) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "1 of them is off at" in said
    assert "and left out: look what lies there" in said
    assert float(said.partition(" mm RMS over the plate")[0].split()[-1]) < 0.015
    assert not new.exists()


def test_a_turn_that_nobody_told_is_asked_for(tmp_path: Path) -> None:
    """Catches "nothing is wrong" where a bent plate was turned and two probings disagree."""
    trial = Trial.of("bent plate", 5, 1)
    (config,) = trial.write(tmp_path, "klipper", (0.0, 60.0), 5)
    e = examine(import_klipper(config))
    said = dict(e.sections)
    assert "a pattern that neither this plate nor a known fault of the machine makes" in " ".join(said["What is wrong"])
    assert "--plate at60=DEGREES" in " ".join(said["What to measure next"])


@pytest.mark.slow
def test_a_turn_that_was_told_names_the_plate(tmp_path: Path) -> None:
    """Catches a turn that is asked for and then not used."""
    (config,) = Trial.of("bent plate", 5, 1).write(tmp_path, "klipper", (0.0, 60.0), 5)
    told = examine(import_klipper(config, {"at60": 60.0}))
    assert [s.names for s in told.suspects] == [("bed_shape",)]
    assert "DEGREES" not in " ".join(dict(told.sections)["What to measure next"])


def test_the_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a command that ends in a traceback, numbers that are not written, and a lean that is passed over."""
    as_klipper(tmp_path, BELIEVED, probed(TWISTED, BELIEVED, noise=0.006, count=9))
    cfg, new = tmp_path / "printer.cfg", tmp_path / "new.cfg"
    assert command("printer", str(cfg), "-o", str(new), "--report", str(tmp_path / "page.html")) == 0
    said = capsys.readouterr().out
    titles = ("What is wrong", "How sure", "What to do", "What accuracy remains", "What to measure next")
    assert all(title in said for title in titles)
    assert "either" in said
    assert "meshes are left out of the new file" in " ".join(said.split())
    assert "[bed_mesh default]" not in new.read_text()
    told = float(new.read_text().split("delta_radius = ")[1].split()[0])
    assert told != pytest.approx(150.0, abs=0.01)
    assert "<svg" in (tmp_path / "page.html").read_text()
    assert command("printer", str(cfg), "--json") == 0
    assert json.loads(capsys.readouterr().out)["suspects"]
    assert command("import", "klipper", str(cfg), "-o", str(tmp_path)) == 0
    robot, run = tmp_path / "robot.toml", tmp_path / "run.csv"
    assert len(read_measurements(run)) == 49
    assert load_robot(robot) == import_klipper(cfg).robot
    out = tmp_path / "calibrated.toml"
    assert command("calibrate", str(robot), str(run), "--effect", "rail_lean", "-o", str(out)) == 0
    assert Calibration.load(out).whole.effects == ("rail_lean",)
    # of the height: where on its plate a printer prints is no error, and no probe tells
    assert 0.01 < Calibration.load(out).accuracy([0.0, 0.0, 0.0]) < 0.1
    capsys.readouterr()
    assert command("export", "klipper", str(out), "--config", str(cfg), "-o", str(new)) == 0
    assert "klipper cannot hold rail_lean" in capsys.readouterr().out
    before = cfg.read_text()
    assert command("export", "klipper", str(out), "--config", str(cfg), "-o", str(cfg)) == 1
    assert "is read by this command" in capsys.readouterr().err
    assert cfg.read_text() == before
    assert command("export", "reprapfirmware", str(out), "-o", str(tmp_path / "m665.g")) == 0
    assert (tmp_path / "m665.g").read_text().startswith("M665 L")
    capsys.readouterr()
    assert command("export", "klipper", str(out), "-o", str(new)) == 2
    assert "Missing option '--config'" in capsys.readouterr().err


# -- files of all sorts ------------------------------------------------------------------------------------------------


def test_files_that_mean_the_same(tmp_path: Path) -> None:
    """Catches Windows line ends, comments, a byte order mark, included files and a second mesh that are read as
    something else."""
    mesh = probed(REAL, BELIEVED)
    plain = as_klipper(tmp_path, BELIEVED, mesh)
    path, text = tmp_path / "printer.cfg", (tmp_path / "printer.cfg").read_text()
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert np.array_equal(import_klipper(path).measurements.readings, plain.measurements.readings)
    path.write_text(text.replace("kinematics: delta", "kinematics: delta   # a ; comment\n; and one\n# and another"))
    assert import_klipper(path).robot == plain.robot
    above, block = text.split("#*#", 1)
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "towers.cfg").write_text(above)
    path.write_text(f"[include parts/*.cfg]\n[include absent.cfg]\n#*#{block}")
    assert import_klipper(path).robot == plain.robot
    path.write_text(klipper_file(BELIEVED, {"default": mesh, "60": mesh}, offset=OFFSET))
    two = import_klipper(path, {"60": 60.0})
    assert two.robot.probings == ("default", "60")
    assert len(two.measurements) == 58
    assert len(np.unique(two.measurements.groups)) == 58
    flat = files_of(path, (), {})
    assert len(flat.measurements) == 58


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: t.replace("kinematics: delta", "kinematics: rotary_delta"), "not 'delta' but 'rotary_delta'"),
        (lambda t: t.replace("kinematics: delta", "kinematics: cartesian"), "not 'delta' but 'cartesian'"),
        (lambda t: t.split("#*# [bed_mesh")[0], "holds no probing"),
        (lambda t: t[: t.index("#*# [stepper_b]")] + "\nbehind: 1\n", "stands behind the SAVE_CONFIG block"),
        (lambda t: t[: t.index("arm_length")], "[stepper_a] arm_length is missing"),
        (lambda t: t[: t.index("x_count")], "[bed_mesh default] min_x is missing"),
        (
            lambda t: "[include towers.cfg]\n" + t.replace("#*# delta_radius", "#*# other"),
            "(towers.cfg, which it includes, is not there)",
        ),
        (lambda t: "[include printer.cfg]\n" + t, "does one include itself?"),
    ],
)
def test_files_that_lack_something(change: Callable[[str], str], says: str, tmp_path: Path) -> None:
    """Catches a traceback, or a half of a file that is read as a whole printer."""
    as_klipper(tmp_path, BELIEVED, probed(REAL, BELIEVED))
    path = tmp_path / "printer.cfg"
    path.write_text(change(path.read_text()))
    with pytest.raises(SherkitError) as refused:
        import_klipper(path)
    assert str(path) in str(refused.value)
    assert says in str(refused.value)


@pytest.mark.parametrize(
    ("name", "old", "new", "says"),
    [
        ("config.g", "M665", "M667", "has no M665"),
        ("config.g", "R150.000000", "", "M665 R is missing"),
        ("heightmap.csv", "RepRapFirmware", "Some", "is no height map"),
        ("heightmap.csv", ",7,7", ",7,6", "expected 6 rows of 7 heights"),
        ("heightmap.csv", ",7,7", f",7,{400 * '9'}", "line 3: expected a number for num1, found '999"),
        ("marlin.txt", "M665", "M667", "has no M665"),
        ("marlin.txt", "G29 L", "G28 L", "G29 L is missing"),
        ("marlin.txt", "Bilinear", "M503\nNothing", None),
        ("marlin.txt", " 0 ===", " x ===", "holds no report"),
    ],
)
def test_files_of_other_firmwares_that_lack_something(
    name: str, old: str, new: str, says: str | None, tmp_path: Path
) -> None:
    """Catches a traceback for a file that was cut or is of something else."""
    mesh = probed(REAL, BELIEVED)
    as_duet(tmp_path, BELIEVED, mesh)
    as_marlin(tmp_path, BELIEVED, mesh)
    path = tmp_path / name
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))

    def read() -> ImportedPrinter:
        return (
            import_marlin(path)
            if name == "marlin.txt"
            else import_duet(tmp_path / "config.g", [tmp_path / "heightmap.csv"])
        )

    if says is None:
        assert len(read().measurements) == 29
        return
    with pytest.raises(SherkitError) as refused:
        read()
    assert str(path) in str(refused.value)
    assert says in str(refused.value)


def test_marlin_g33(tmp_path: Path) -> None:
    """Catches points of G33 that are put under the wrong tower."""
    heights = {"c": 0.0, "x": 0.1, "y": 0.2, "z": 0.3, "yz": 0.4, "zx": 0.5, "xy": 0.6}
    text = marlin_file(BELIEVED, probed(REAL, BELIEVED), offset=(0, 0, 0)).split(">>>")[0]
    first = "  ".join(f"{k}:+{heights[k]:.2f}" for k in ("c", "x", "y", "z"))
    second = "  ".join(f"{k}:+{heights[k]:.2f}" for k in ("yz", "zx", "xy"))
    (tmp_path / "m.txt").write_text(f"{text}>>> G33 R100 P3 V3\n.    {first}\n.            {second}\nok\n")
    found = import_marlin(tmp_path / "m.txt")
    assert found.robot.probings == ("G33_1",)
    at = found.robot.forward_batch(found.measurements.joints).require()
    lobes = {round(float(-r), 2): p for r, p in zip(found.measurements.readings[:, 0], at, strict=True)}
    assert np.hypot(*lobes[0.1][:2]) == pytest.approx(100.0, abs=1e-6)
    assert (lobes[0.1][0] < 0) & (lobes[0.1][1] < 0)
    assert (lobes[0.4][0] > 0) & (lobes[0.4][1] > 0)
    assert lobes[0.6][1] == pytest.approx(-100.0, abs=1e-6)


class _Solver:
    """Asks three times, as the core's solver does, and counts what it was told."""

    def __init__(self) -> None:
        self.trial, self.asked, self.failed = np.zeros(1), 0, 0

    def clear(self) -> None:
        """Nothing is kept."""

    def fail(self) -> None:
        """The trial was none."""
        self.failed += 1

    def advance(self) -> str:
        """What is to be done next."""
        self.asked += 1
        return "evaluate" if self.asked < 3 else "converged"


def test_a_step_that_leaves_no_robot_is_damped() -> None:
    """Catches a fit with an effect in NumPy that ends with "the rod length must be positive" at a wild step, where the
    compiled one goes back."""
    solver = _Solver()

    def feed(trial: Floats) -> None:
        del trial
        if solver.asked == 1:
            raise RobotError("limb 1: the rod length must be positive")

    assert iterate(solver, feed) == "converged"  # type: ignore[arg-type]
    assert solver.failed == 1
