"""A third kind of robot, brought by one folder (``tests/planar_arm``) and one line of registration, has all that the
built-in ones have. What is hidden in its runs comes from ``planar_arm/virtual.py``, which shares no formula with the
model that is fitted."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sherkit as sk
from consistency import named
from planar_arm import KIND, PlanarArm, VirtualPlanarArm
from planar_arm.pose_sets import fan
from planar_arm.virtual import anywhere
from second_machines import apart
from sherkit import errors
from sherkit.cli import main
from sherkit.cli.demo import EXAMPLE
from sherkit.data import columns
from sherkit.lab.experiment import RunFile, load_experiment
from sherkit.lab.experiment import run as run_experiment
from sherkit.lab.laboratory import RunningLaboratory, load_laboratory
from sherkit.model import kinds
from sherkit.model.sentences import COMMON
from sherkit.planning.effect_power import planning_of

ROBOT = """
kind = "planar"
[geometry]
length_mm = [250.0, 180.0]
height_mm = 40.0
[joints]
limits_deg = [-170.0, 170.0]
"""
GEOMETRY: dict[str, Any] = {"length_error_mm": (0.8, -0.6), "offset_rad": (0.01, -0.015), "noise_mm": 0.005}
#: What is hidden, by the effect that it is: a fifth to four times the plausible size.
HIDDEN: dict[str, dict[str, Any]] = {
    "encoder_eccentricity": {"ring_rad": (5e-4, -3e-4)},
    "encoder_cyclic": {"lines_rad": (5e-4, -3e-4), "per_turn": 2.0},
    "backlash": {"play_rad": (4e-4, 2e-4)},
    "droop": {"fall_mm": 0.15},
    "thermal_growth": {"warmth_per_c": 3e-5},
    "drift": {"rate_mm_h": (0.4, 0.2, -0.4)},
    "slip": {"step_mm": (0.05, -0.03, 0.04)},
}


@pytest.fixture(autouse=True)
def planar() -> Iterator[None]:
    """The kind is known while a test of this file runs, and to no other."""
    with apart():
        kinds.register(KIND)
        yield


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where a person stands: the file of an arm, and a run in which it droops."""
    (tmp_path / "robot.toml").write_text(ROBOT)
    measured(sk.load_robot(tmp_path / "robot.toml"), "droop").save(tmp_path / "run.csv")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def measured(robot: Any, hidden: str = "", seed: int = 1, stands: dict[str, Any] | None = None) -> sk.Measurements:
    """A run over its workspace in which this effect is hidden, read from anywhere unless it is said."""
    stands = anywhere(seed) if stands is None else stands
    made = VirtualPlanarArm(robot, **GEOMETRY, **HIDDEN.get(hidden, {}), **stands)
    return made.measure(fan(robot, 8), repeats=3, seed=seed)


def test_where_it_could_be_sent_next() -> None:
    """Catches a kind whose poses come without joints or coordinates, or beyond its limits."""
    robot = PlanarArm((250.0, 180.0), joint_limits_deg=(-60.0, 60.0))
    data = measured(robot)
    found = kinds.model_of(robot).reachable(data, sk.identify(robot, data).values)
    assert tuple(found.targets) == KIND.coordinates
    assert np.abs(found.rows.joints).max() <= np.deg2rad(60.0)
    there = np.array([robot.forward(q) for q in found.rows.joints])
    np.testing.assert_allclose(there, np.column_stack(list(found.targets.values())), atol=0.02)


def said(capsys: pytest.CaptureFixture[str], code: int, *arguments: str) -> str:
    """What the command prints, beside errors if it ends with one."""
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    shown = capsys.readouterr()
    assert (ended.value.code or 0) == code, shown.err
    return shown.err if code else shown.out


# -- what every robot has --------------------------------------------------------------------------------------


def test_files_are_read_and_written(folder: Path) -> None:
    """Catches a robot file or a run that only the built-in kinds can have, and a run that is taken for a delta's."""
    robot = sk.load_robot("robot.toml")
    assert isinstance(robot, PlanarArm)
    sk.save_robot(robot, "again.toml")
    assert sk.load_robot("again.toml") == robot
    run = sk.read_measurements("run.csv")
    assert run.layout is KIND.layout
    assert run.joints.shape[1] == 2


def test_the_geometry_is_found(folder: Path) -> None:
    """Catches levers, sizes or units of another robot in the fit, and a deviation that is not one."""
    fit = sk.identify("robot.toml", "run.csv", effects=["droop"])
    assert fit.converged
    truth = {"length_1": 0.8, "length_2": -0.6, "offset_2": -0.015, "droop.fall": 0.15}
    for p, value, std in zip(fit.parameters, fit.values, fit.std, strict=True):
        if p.name in truth:
            # a tilt of the instrument takes a part of what a fall with the reach shows
            known = 0.1 if p.name == "droop.fall" else 0.05
            assert abs(value - truth[p.name]) < 5 * std < known * abs(truth[p.name]), p.name
    turn, shift = sk.model.kinds.model_of(sk.load_robot("robot.toml")).sensor_frame(fit.values[:-1])
    stood = VirtualPlanarArm(sk.load_robot("robot.toml"), **anywhere(1))
    axes = stood.seen(np.eye(3)) - stood.seen(np.zeros((1, 3)))
    first = np.array([[np.cos(0.01), -np.sin(0.01), 0.0], [np.sin(0.01), np.cos(0.01), 0.0], [0.0, 0.0, 1.0]])
    # the shoulder's zero is a turn of what the instrument sees
    assert np.abs(turn - axes.T @ first).max() < 2e-4
    assert np.abs(shift - stood.seen(np.zeros((1, 3)))[0]).max() < 0.05
    assert fit.scale == pytest.approx(1.0, abs=0.1)


def test_derivatives_are_exact(folder: Path) -> None:
    """Catches a column of the arm's stand-in for a core that is not that of its readings."""
    run = sk.read_measurements("run.csv").select(np.arange(6))
    model = kinds.model_of(sk.load_robot("robot.toml"))
    for effect in model.catalogue.values():
        model = model.with_effect(effect, at=0.3 if effect.is_periodic else None)
    sizes = np.array([p.size for p in model.parameters])
    columns_ = model.derivatives(run, 0.3 * sizes)
    for k, size in enumerate(sizes):
        step = np.where(np.arange(len(sizes)) == k, 1e-3 * size, 0.0)
        change = model.predict(run, 0.3 * sizes + step) - model.predict(run, 0.3 * sizes - step)
        np.testing.assert_allclose(columns_[:, :, k] * 2e-3 * size, change, rtol=1e-5, atol=1e-10)


#: What takes longest, or is another's neighbour.
LONG = ("slip", "drift", "encoder_cyclic")


@pytest.mark.parametrize("name", [pytest.param(one, marks=[pytest.mark.slow] * (one in LONG)) for one in HIDDEN])
def test_what_is_hidden_is_found(name: str, folder: Path) -> None:
    """Catches an effect of a link that does not serve a new mechanism, or a cause that is taken for another."""
    found = sk.diagnose("robot.toml", measured(sk.load_robot("robot.toml"), name))
    assert found.verdict == "explained"
    # what let go of the point leaves what a shift of the instrument leaves, which is said first
    assert found.effects == (("sensor_slip",) if name == "slip" else (name,))
    assert name in named(found)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_where_nothing_is_hidden_nothing_is_found(seed: int, folder: Path) -> None:
    """Catches an alarm on an arm that only its geometry differs from the drawing."""
    found = sk.diagnose("robot.toml", measured(sk.load_robot("robot.toml"), seed=seed))
    assert found.verdict == "adequate"
    assert found.effects == ()


@pytest.mark.slow
def test_a_run_without_heights(folder: Path) -> None:
    """Catches three coordinates where an instrument shows two: in tests, pictures and the calibration."""
    robot = sk.load_robot("robot.toml")
    # an instrument that shows two coordinates is set up level; about the vertical it may be turned as it likes
    level = {"seen_turned_rad": (0.0, 0.0, 1.8), "seen_from_mm": (120.0, -240.0, 0.0)}
    flat = sk.from_frame(measured(robot, "backlash", stands=level).to_frame().drop("z_mm"))
    found = sk.diagnose(robot, flat)
    assert (found.verdict, found.effects) == ("explained", ("backlash",))
    study = sk.Study(robot, flat)
    study.add("backlash")
    assert set(study.history[-1].error.by_reading) == {"x_mm", "y_mm"}
    # from a side that is known; from either, half of what is lost counts
    made = study.calibration()
    assert made.accuracy([300.0, 100.0], direction=[1.0, 1.0]) < 0.02 < made.accuracy([300.0, 100.0])
    assert "<svg" in _report(study)


def test_a_users_effect_is_one_like_the_others(folder: Path) -> None:
    """Catches three joints where a robot has two, and millimetres where it turns."""

    @sk.effect(at="joints", parameters={"amplitude": ("rad", 1e-3)})
    def gear(rows: Any, p: Any) -> Any:
        return p.amplitude * np.sin(9.0 * rows.joints)

    robot, plain = sk.load_robot("robot.toml"), measured(sk.load_robot("robot.toml"))
    turned = plain.joints + 5e-4 * np.sin(9.0 * plain.joints)
    true = VirtualPlanarArm(robot, **GEOMETRY, **anywhere(1))
    run = plain.with_readings(plain.readings + true.noise_free(turned) - true.noise_free(plain.joints))
    found = sk.diagnose(robot, run, effects=[gear])
    assert (found.verdict, found.effects) == ("explained", ("gear",))
    with_it = sk.identify(robot, run, effects=[gear])
    assert with_it.by_name["gear.amplitude"] == pytest.approx(5e-4, rel=0.02)


# -- study, calibration, report, page --------------------------------------------------------------------------


def test_a_study_is_led_and_kept(folder: Path) -> None:
    """Catches a study that cannot be opened again because it does not know the robot, its effects or its settings."""
    study = sk.Study("robot.toml", measured(sk.load_robot("robot.toml"), "slip"))
    before = study.history[0].error.rms
    study.add("slip")
    assert study.history[-1].error.rms < 0.6 * before
    study.add("droop")
    study.undo()
    study.save("study")
    again = sk.Study.load("study")
    assert again.effects == ("slip",)
    np.testing.assert_array_equal(again.fit.values, study.fit.values)
    again.undo()
    assert again.effects == ()
    assert "slip" in named(again.diagnose())


def test_a_calibration_is_deployed(folder: Path) -> None:
    """Catches a calibration that does not bring the arm where it was asked to be, or promises what it does not hold."""
    robot = sk.load_robot("robot.toml")
    sk.calibrate(robot, "run.csv", effects=["droop"], correction="none").calibration.save("calibrated.toml")
    made = sk.load_calibration("calibrated.toml")
    true = VirtualPlanarArm(robot, **GEOMETRY)
    places = fan(robot, 5, 0.8)
    sent = made.inverse_batch(places).require("place")
    np.testing.assert_allclose(made.forward_batch(sent).values, places, atol=1e-9)
    # the base of the calibration is turned about the shoulder's axis by what its encoder's zero is off
    turn = GEOMETRY["offset_rad"][0]
    drawn_x, drawn_y = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    off = true.tips(sent)[:, :2] @ np.column_stack([drawn_x, drawn_y]) - places
    missed = np.hypot(*off.T)
    assert (missed < made.accuracy_batch(places).values).all()
    drawn = robot.inverse_batch(places).values
    assert np.hypot(*(true.tips(drawn)[:, :2] - places).T).min() > 100 * missed.max()


@pytest.mark.slow
def test_the_command_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a table, a JSON or a report that has a place for three joints, or for what is not measured."""
    files = ("robot.toml", "run.csv")
    assert "droop.fall" in said(capsys, 0, "calibrate", *files, "--effect", "droop", "-o", "cal.toml")
    told = json.loads(said(capsys, 0, "calibrate", *files, "--json", "--report", "cal.html"))
    assert set(told["whole"]["rms_um"]["after"]) == {"x", "y", "z"}
    html = Path("cal.html").read_text()
    # the example of use is a place that the arm can reach
    example = json.loads(html.split("robot.inverse(")[1].split(")")[0])
    assert sk.load_calibration("cal.toml").inverse(example).shape == (2,)
    found = json.loads(said(capsys, 0, "diagnose", *files, "--json", "--report", "found.html"))
    assert found["verdict"] == "explained"
    assert "droop" in Path("found.html").read_text()
    shown = said(capsys, 0, "effects", "--robot", "robot.toml")
    assert "Effects of the planar robot" in shown
    assert "rail_lean" not in shown
    said(capsys, 0, "simulate", "robot.toml", "-o", "virtual.csv", "--truth", "truth.toml", "--poses", "local")
    assert "Verdict: adequate" in said(capsys, 0, "diagnose", "robot.toml", "virtual.csv")


def test_its_own_errors_can_be_simulated(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches options of ``sherkit simulate`` that were read before the kind was known."""
    assert "Planar: of the tip at full reach" in " ".join(said(capsys, 0, "simulate", "-h").split())
    said(capsys, 0, "simulate", "robot.toml", "-o", "virtual.csv", "--truth", "truth.toml", "--fall-mm", "0.25")
    assert "0.25" in Path("truth.toml").read_text()


def test_every_sentence_that_robots_share_is_used() -> None:
    """Catches a common sentence that every robot replaces by its own."""
    for name, words in COMMON.items():
        every = [e for kind in kinds.known_kinds().values() for e in kind.model.catalogue.values()]
        # the second wave is one of each joint
        having = [e for e in every if e.name == name or (e.goes_with and e.name.startswith(name))]
        assert any((e.physics, e.residuals, e.remedy) == (words.physics, words.residuals, words.remedy)
                   for e in having), name  # fmt: skip


def test_an_experiment_is_planned(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a plan or a power that knows poses, joints or units of the built-in robots alone."""
    Path("experiment.toml").write_text(
        'robot = "robot.toml"\n[plan]\nposes = "fan"\nper_side = 6\nrepeats = 2\norder = "shuffled"\n'
        '[[instrument]]\nkind = "galil"\ncounts_per_rad = 100000\n'
        '[[instrument]]\nkind = "keyence"\n'
    )
    shown = said(capsys, 0, "plan", "robot.toml", "experiment.toml")
    assert "droop" in shown
    run = sk.read_measurements("run.csv")
    effect_powers = {
        o.name: o for o in planning_of(kinds.model_of(sk.load_robot("robot.toml")), run, 0.005).effect_powers
    }
    assert effect_powers["droop"].power > 0.99


@pytest.mark.slow
def test_an_experiment_is_measured(folder: Path) -> None:
    """Catches a laboratory, a bench or a run file that takes lasers for a delta's and two motors for three."""
    motors = '[[instrument]]\nname = "joints"\nkind = "galil"\ncounts_per_rad = 2000000\n'
    lasers = '[[instrument]]\nname = "lasers"\nkind = "keyence"\n'
    Path("lab.toml").write_text(
        'robot = "robot.toml"\nseed = 6\ntime_scale = 400.0\n[hidden]\nerrors = 1.0\nfall_mm = 0.15\n'
        f"{motors}{lasers}noise_mm = 0.005\nnoise_of_place = true\n"
    )
    Path("experiment.toml").write_text(
        'robot = "robot.toml"\nports = "ports.json"\n[plan]\nposes = "fan"\nper_side = 5\norder = "shuffled"\n'
        f"[settle]\nseconds = 0.0\n{motors}poll_s = 0.002\n{lasers}"
    )
    with RunningLaboratory(load_laboratory(Path("lab.toml"))) as lab:
        lab.write_ports(Path("ports.json"))
        chosen = load_experiment(Path("experiment.toml"))
        with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
            assert run_experiment(chosen.plan, bench, file) == "complete"
            data = file.measurements()
    assert data.layout is KIND.layout
    fit = sk.identify("robot.toml", data, effects=["droop"])
    hidden = lab.laboratory.virtual
    assert fit.by_name["droop.fall"] == pytest.approx(0.15, abs=0.02)
    assert fit.by_name["length_1"] == pytest.approx(hidden.length_error_mm[0], abs=0.02)
    assert fit.by_name["offset_2"] == pytest.approx(hidden.offset_rad[1], abs=2e-4)


def _report(study: sk.Study) -> str:
    from sherkit.report.document import Report, html
    from sherkit.report.page import Made

    return html(Report(study, study.diagnose(), Made("run.csv")))


@pytest.mark.slow
def test_the_page(folder: Path) -> None:
    """Catches a page that cannot be drawn, changed or left for a robot that is not built in."""
    from bokeh.document import Document

    from sherkit.app import server
    from sherkit.app.page import StudyPage
    from sherkit.app.workbench import Workbench

    bench = Workbench.open(Path("robot.toml"), Path("run.csv"), Path("study"))
    told: list[tuple[str, Any]] = []
    bench.listen(lambda kind, value: told.append((kind, value)))
    try:
        StudyPage(Document(), bench, "")
        bench.toggle("droop")
        bench.ask("waiting", lambda study, step: None).result(600.0)
        assert not [value for kind, value in told if kind == "error"]
        assert bench.page_state.effects == ("droop",)
        assert bench.page_state.diagnosis.verdict == "adequate"
        StudyPage(Document(), bench, "")
        made = bench.ask("saving", server._calibration).result(600.0)
        Path("page.toml").write_bytes(made)
        assert sk.load_calibration("page.toml").whole.effects == ("droop",)
    finally:
        bench.close()
    again = Workbench.open(Path("robot.toml"), Path("run.csv"), Path("study"))
    assert again.page_state.effects == ("droop",)
    again.close()


# -- what it has not -------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_without_a_calibration_everything_else_works(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a diagnosis, a study or a report that needs what only deployment does; and half a calibration."""
    monkeypatch.setitem(kinds.KINDS, "planar", replace(KIND, calibration=None, virtual=None, poses={}, areas={}))
    assert "Verdict: explained" in said(capsys, 0, "diagnose", "robot.toml", "run.csv")
    study = sk.Study("robot.toml", "run.csv")
    study.add("droop")
    assert "<svg" in _report(study)
    for work in (study.calibration, lambda: sk.calibrate("robot.toml", "run.csv")):
        with pytest.raises(errors.CalibrationError, match="a planar robot has no calibration"):
            work()
    for arguments in (
        ("calibrate", "robot.toml", "run.csv"),
        ("simulate", "robot.toml", "-o", "virtual.csv"),
        ("effects", "droop", "--robot", "robot.toml", "--picture", "droop.svg"),
    ):
        refused(said(capsys, 1, *arguments))


def refused(text: str, *words: str) -> None:
    """One sentence that says so, and no trace of the inside."""
    lines = [line for line in text.strip().splitlines() if line]
    assert len(lines) == 1, text
    assert lines[0].startswith("error: ")
    for word in words:
        assert word in lines[0]


#: What another robot has and this one has not: what is asked for, and what is said to be missing.
NOT_ITS_OWN: dict[str, tuple[tuple[str, ...], str]] = {
    "region": (("calibrate", "robot.toml", "run.csv", "--local", "run.csv"), "no region of interest"),
    "correction": (("calibrate", "robot.toml", "run.csv", "--correction", "paper"), "no correction"),
    "effect": (("calibrate", "robot.toml", "run.csv", "--effect", "rail_lean"), "'rail_lean' is not a known effect"),
    "parameter": (("calibrate", "robot.toml", "run.csv", "--free", "rod_length_1"), "not a parameter of this robot"),
    "error": (("simulate", "robot.toml", "-o", "x.csv", "--rail-lean-mrad", "1"), "--rail-lean-mrad is not for"),
    "pictures": (("simulate", "robot.toml", "-o", "x.csv", "--pictures", "p"), "--pictures is not for that kind"),
    "drawing": (("effects", "droop", "--robot", "robot.toml", "--picture", "x.svg"), "--picture draws on a delta"),
    "noise": (("plan", "robot.toml", "e.toml", "--noise-px", "1"), "--noise-um"),
    "run": (("diagnose", "robot.toml", "delta.csv"), "is no run of a planar robot"),
    "robot": (("diagnose", "delta.toml", "run.csv"), "is no run of a delta robot"),
    "key": (("diagnose", "radius.toml", "run.csv"), "radius_mm"),
}


@pytest.mark.parametrize("what", NOT_ITS_OWN)
def test_it_is_never_taken_for_another(what: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a verb that does to a planar arm what is right for a delta or a spherical robot."""
    sk.save_robot(EXAMPLE, "delta.toml")
    sk.delta.VirtualDelta(EXAMPLE).measure(sk.delta.grid(10.0, 3, (0.0,)), repeats=2).save("delta.csv")
    Path("radius.toml").write_text(ROBOT.replace("height_mm = 40.0", "radius_mm = 40.0"))
    arguments, says = NOT_ITS_OWN[what]
    refused(said(capsys, 1, *arguments), says)


def test_a_kind_that_nobody_made_known(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a traceback, or another robot's model, for a robot whose folder was never registered."""
    robot, run = sk.load_robot("robot.toml"), sk.read_measurements("run.csv")
    with apart():
        del kinds.KINDS["planar"]
        columns.LAYOUTS.remove(KIND.layout)
        works: tuple[Callable[[], object], ...] = (
            lambda: sk.identify(robot, run),
            lambda: sk.diagnose(robot, run),
            lambda: sk.calibrate(robot, run),
            lambda: sk.Study(robot, run),
        )
        for work in works:
            with pytest.raises(errors.SherkitError, match=r"planar|PlanarArm"):
                work()
        refused(said(capsys, 1, "diagnose", "robot.toml", "run.csv"), "kind", "delta", "spherical")
