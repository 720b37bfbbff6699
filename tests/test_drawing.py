"""Machines as drawn: their points against kinematics written apart, how effects move them, scenes, cards, cells."""

from __future__ import annotations

import json
import re
from contextlib import closing
from html import unescape
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import sherkit as sk
from browsing import InEachFont, chromium, needs_browser
from second_simulator import NOMINAL_CONFIG, Robot, grid, make_plan, platform_pose, simulate, truth
from second_simulator.effects import EFFECTS as SIMULATED
from second_simulator.effects import draw_effect
from sherkit.cli import main
from sherkit.data import Measurements
from sherkit.errors import SherkitError
from sherkit.model.effect import Effect
from sherkit.model.kinds import kind_of, known_kinds, model_of
from sherkit.report import notebook
from sherkit.report.card import (
    FACTORS,
    card_page,
    drawing_of,
    effect_card,
    exaggerated,
    joints_over,
    scene_of,
    scene_of_robot,
)  # fmt: skip
from sherkit.report.residuals import ModelState
from sherkit.report.scene import Arrows, Scene, space_of
from strategies import EXAMPLE

Floats = NDArray[np.float64]

BUILT_IN = ("delta", "spherical", "serial")
EVERY = [
    (k, name)
    for k in BUILT_IN
    for name in model_of(known_kinds()[k].example).known_effects
    # what a bar reads moves no place
    if name not in ("datum", "sensor_pose", "bar_zero")
]
SECOND = Robot.from_dict(NOMINAL_CONFIG)
#: What the whole weight (5 N) does instead of a newton.
UNITS = {"gravity_sag": 5.0, "drive_compliance": 5.0}


def example(kind: str) -> tuple[Any, Any, Measurements]:
    """A robot, its model, and rows over its workspace."""
    robot = known_kinds()[kind].example
    mine = kind_of(robot)
    return robot, model_of(robot), Measurements.planned(joints_over(robot, mine), mine.layout)


def drawn(model: Any, data: Measurements, values: Floats | None = None) -> Any:
    values = np.zeros(len(model.parameters)) if values is None else values
    return kind_of(model.robot).drawing(model, data, values, None)


# -- points ----------------------------------------------------------------------------------------------------


def test_delta_is_drawn_as_it_stands() -> None:
    """Catches a carriage beside its rail, a rod of another length, a platform of another size, swapped limbs."""
    robot, model, data = example("delta")
    shown = drawn(model, data)
    assert np.abs(shown.target_mm - robot.forward_batch(data.joints).values).max() < 1e-9
    assert np.abs(shown.shown_mm - shown.target_mm).max() < 1e-9
    centre = shown.named("arm to the measured point")[:, 0]
    assert np.abs(centre + robot.target_offset_mm - shown.target_mm).max() < 1e-9
    for k in range(3):
        angle = np.deg2rad(robot.base_angle_deg[k])
        carriage = shown.named(f"joint {k + 1}")[:, 0]
        foot = robot.base_radius_mm[k] * np.array([np.cos(angle), np.sin(angle)])
        assert np.abs(carriage - np.column_stack([np.tile(foot, (len(data), 1)), data.joints[:, k]])).max() < 1e-9
        a, b = np.moveaxis(shown.named(f"rail {k + 1}"), 1, 0)
        assert np.abs(np.cross(carriage - a, b - a)).max() < 1e-9 * np.linalg.norm(b - a) ** 2
        for side in "ab":
            ends = shown.named(f"rod {k + 1}{side}")
            assert np.abs(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) - robot.rod_length_mm[k]).max() < 1e-9
        width = np.linalg.norm(np.diff(shown.named(f"carriage {k + 1}"), axis=1), axis=2)
        assert np.abs(width - robot.rod_spacing_mm).max() < 1e-9
    around = shown.named("platform")[:, :-1] - centre[:, None]
    assert np.abs(np.linalg.norm(around, axis=2) - np.hypot(30.0, 20.0)).max() < 1e-9


def test_spherical_is_drawn_as_it_stands() -> None:
    """Catches arcs of other lengths, an elbow that is not where its joint turned it, a marker off its sphere."""
    robot, model, data = example("spherical")
    shown = drawn(model, data)
    assert np.abs(shown.target_mm - robot.point(robot.forward_batch(data.joints).values)).max() < 1e-9
    assert np.abs(shown.shown_mm - shown.target_mm).max() < 1e-6  # through pixels and back
    end = shown.named("tool")[:, 1] / robot.radius_mm
    alpha, beta = np.deg2rad([robot.alpha_deg, robot.beta_deg])
    for k in range(2):
        elbow = shown.named(f"elbow axis {k + 1}")[:, 1] / robot.radius_mm
        turn = data.joints[:, k]
        where = np.column_stack(
            [np.sin(alpha) * np.cos(turn), np.sin(alpha) * np.sin(turn), np.full(len(turn), np.cos(alpha))]
        )
        assert np.abs(elbow - where).max() < 1e-9
        assert np.abs((elbow * end).sum(axis=1) - np.cos(beta)).max() < 1e-9
        for name, arc in (("proximal", alpha), ("distal", beta)):
            line = shown.named(f"{name} link {k + 1}")
            radius = np.linalg.norm(line, axis=2)
            assert np.ptp(radius) < 1e-9 * radius.max()
            steps = np.linalg.norm(np.diff(line, axis=1), axis=2) / radius.max()
            assert np.abs(2.0 * np.arcsin(steps / 2.0).sum(axis=1) - arc).max() < 1e-9
    eye, look = shown.named("where the camera looks")[0]
    assert np.linalg.norm(np.cross(look - eye, eye)) < 1e-6 * np.linalg.norm(eye) ** 2  # at the centre


def test_arm_is_drawn_as_it_stands() -> None:
    """Catches a joint that is drawn before its turn, an axis along another coordinate, links in another order."""
    robot, model, data = example("serial")
    shown = drawn(model, data)
    assert np.abs(shown.target_mm - robot.forward_batch(data.joints).values).max() < 1e-9
    for row in (0, len(data) - 1):
        frame = np.eye(4)
        for k, joint in enumerate(robot.joints):
            fixed = np.eye(4)
            fixed[:3, :3] = Rotation.from_euler("xyz", joint.rpy_deg, degrees=True).as_matrix()
            fixed[:3, 3] = joint.origin_mm
            frame = frame @ fixed
            axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
            a, b = shown.named(f"axis {k + 1}")[row]
            assert np.abs(shown.named(f"joint {k + 1}")[row, 0] - frame[:3, 3]).max() < 1e-9
            assert np.abs((b - a) / np.linalg.norm(b - a) - frame[:3, :3] @ axis).max() < 1e-9
            turned = np.eye(4)
            turned[:3, :3] = Rotation.from_rotvec(axis * data.joints[row, k]).as_matrix()
            frame = frame @ turned
        tip = frame @ [*robot.target_mm, 1.0]
        assert np.abs(shown.named("tool")[row, 1] - tip[:3]).max() < 1e-9


# -- effects -----------------------------------------------------------------------------------------------------


#: Of a usual size they would not be seen.
SMALL = (
    "rail_lean", "joint_scale", "drift", "slip", "joint_slip", "thermal_shift", "thermal_growth", "link_growth",
)  # fmt: skip


@pytest.mark.parametrize(
    "name", [n for n in SIMULATED if n in sk.delta.CATALOGUE and n not in ("datum", "sensor_pose")]
)
def test_exaggerated_delta_is_that_of_the_second_simulator(name: str) -> None:
    """Catches a drawing that moves another way, or by another amount, than the effect's formula written apart: of what
    is read, of the carriages, of the platform and of its tilt."""
    times = 20.0 if name in SMALL else 3.0
    planted = draw_effect(name, np.random.default_rng(5), 300.0)
    planted[: SIMULATED[name].amplitudes] *= times
    plan = make_plan(SECOND, grid(15.0, 3, (-12.0, 12.0)), repeats=1, order="shuffled", seed=2)
    columns = simulate(SECOND, plan, None, {name: planted})
    data = sk.from_frame(pl.DataFrame(columns))
    effect = sk.delta.CATALOGUE[name]
    model = sk.delta.DeltaModel(EXAMPLE).with_effect(effect, at=planted[-1] if SIMULATED[name].fixed else None)
    values = np.zeros(len(model.parameters))
    values[model.owns(effect)] = UNITS.get(name, 1.0) * planted[: len(effect.parameters)]
    shown = drawn(model, data, values)
    assert np.abs(shown.shown_mm - truth(SECOND, columns, None, {name: planted})).max() < 1e-8
    carriages, centre, turn = platform_pose(SECOND, columns, None, {name: planted})
    for k in range(3):
        assert np.abs(shown.named(f"joint {k + 1}")[:, 0] - carriages[:, k]).max() < 1e-8
    assert np.abs(shown.named("arm to the measured point")[:, 0] - centre).max() < 1e-8
    tip = centre + turn @ SECOND.target_offset
    assert np.abs(shown.named("arm to the measured point")[:, 1] - tip).max() < 1e-8


@pytest.mark.parametrize(("kind", "name"), EVERY)
def test_every_effect_moves_its_drawing(kind: str, name: str) -> None:
    """Catches an effect whose drawing stands still or turns back, a factor that is not one, an effect of the instrument
    that moves the machine, one of the machine that moves the instrument's reading alone, and a measured place that
    moves otherwise than the columns by which the effect is identified."""
    robot, plain, _ = example(kind)
    effect = plain.known_effects[name]
    made = exaggerated(effect, robot)
    assert made.factors[0] == 1.0
    assert made.factors == FACTORS[: len(made.factors)]
    assert len(made.factors) >= 4
    assert made.factor in made.factors
    assert made.moves_mm > 0
    moved = [d.points_mm[0] - made.plain.points_mm[0] for d in made.drawings]
    sizes = [np.linalg.norm(m, axis=1).max() for m in moved]
    assert all(b >= a for a, b in pairwise(sizes))
    # the first drawings are the derivative's, twice as much of it twice as far
    parts = {p.name: p.path_mm[0] for p in made.drawings[0].parts}
    read = made.drawings[0].shown_mm[0] - made.plain.shown_mm[0]
    twice = made.drawings[1].shown_mm[0] - made.plain.shown_mm[0]
    cosine = read @ twice / (np.linalg.norm(read) * np.linalg.norm(twice))
    assert cosine > 0.99
    assert parts
    own = made.drawings[-1].target_mm[0] - made.plain.target_mm[0]
    if effect.link == "sensor":
        assert np.abs(own).max() == 0.0 or "delay" in name
    else:
        assert np.linalg.norm(own) > 0
    model, row, at = made.model, made.row, 1e-4
    full = np.zeros(len(model.parameters))
    full[model.owns(effect)] = at * made.values
    none = np.zeros(len(model.parameters))
    step = model.derivatives(row, none)[0] @ full
    read = model.predict(row, full)[0] - model.predict(row, none)[0]
    assert np.abs(read - step).max() <= 0.02 * np.abs(step).max() + 1e-12
    a = kind_of(robot).drawing(model, row, full, None).shown_mm[0]
    b = kind_of(robot).drawing(model, row, none, model.predict(row, none) + step).shown_mm[0]
    start = made.plain.shown_mm[0]
    assert np.linalg.norm(a - b) <= 0.03 * np.linalg.norm(a - start) + 1e-9


def test_any_machine_is_drawn() -> None:
    """Catches a machine of the user's without a drawing, and an effect that does not move it."""

    def forward(joints: Any, p: Any) -> Any:
        x, y = joints.T
        return np.column_stack([x + p.square * y, y])

    machine = sk.Machine(forward, ("a_mm", "b_mm"), ("x_mm", "y_mm"), {"square": ("rad", 1e-3)}, name="drawn table")
    for effect in model_of(machine).known_effects.values():
        made = exaggerated(effect, machine)
        assert made.moves_mm > 0, effect.name
        assert {part.look for part in made.plain.parts} == {"ray", "target", "shown"}
        assert len(made.factors) > 1
    assert "<sherkit-scene" in scene_of_robot(machine).html()


def test_what_reads_no_places_is_not_drawn() -> None:
    """Catches wires drawn as axes of a space, and a linkage that nobody described."""

    def forward(joints: Any, p: Any) -> Any:
        x, y = joints.T
        return np.column_stack([np.hypot(x + 300.0 + p.left, y), np.hypot(x - 300.0, y - 40.0)])

    readings = ("wire_left_mm", "wire_right_mm")
    machine = sk.Machine(forward, ("a_mm", "b_mm"), readings, {"left": ("mm", 1.0)}, name="wires")
    joints = np.random.default_rng(0).uniform(-50.0, 50.0, (30, 2))
    read = forward(joints, SimpleNamespace(left=0.1))
    fit = sk.identify(machine, sk.from_frame(pl.DataFrame(np.hstack([joints, read]), ("a_mm", "b_mm", *readings))))
    assert space_of(ModelState("before", fit), ModelState("now", fit)) is None
    said = drawing_of(model_of(machine).known_effects["backlash"], machine, None)
    assert "It cannot be drawn here: what is read (wire_left_mm, wire_right_mm) is no place" in said
    with pytest.raises(SherkitError, match="nobody says how the machine is joined"):
        scene_of_robot(machine)


# -- pages -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def study() -> sk.Study:
    """A small run with leaning rails, and the study that found them."""
    virtual = sk.delta.VirtualDelta.draw(EXAMPLE, 3, rail_lean_rad=8e-3, noise_mm=0.005)
    from sherkit.robots.delta.robot import grid as poses

    data = virtual.measure(poses(18.0, 5, (-15.0, 0.0, 15.0)), repeats=2, order="shuffled", seed=1)
    made = sk.Study(EXAMPLE, data)
    made.add("rail_lean")
    return made


def test_hostile_texts_stay_texts() -> None:
    """Catches a name or a sentence of an effect that becomes an element of the page, in the card or in its scene."""
    hostile = "</script><img src=x onerror=alert(1)>\"'&"
    effect = sk.effect(at="body", parameters={"a": "mm"}, physics=hostile, remedy=hostile)(
        lambda rows, p: p.a * np.ones((len(rows), 3))
    )
    effect = Effect(**{**vars(effect), "name": hostile})
    page = card_page(hostile, [effect_card(effect, EXAMPLE)])
    assert "<img" not in page
    assert page.count("</script>") == 1
    told = json.loads(unescape(re.findall(r'data-scene="([^"]*)"', page)[0]))
    assert hostile in told["label"]


def test_errors_stand_where_they_were_measured(study: sk.Study) -> None:
    """Catches arrows of another sign or scale, of another row, and a mean over other poses."""
    before = next(s.fit for s in study.history if s.fit is not None)
    scene = space_of(ModelState("geometry calibrated", before), ModelState("now", study.fit))
    assert scene.arrows is not None
    a, data = scene.arrows, study.data
    assert len(a.where_mm) == 75
    turn, shift = before.model.sensor_frame(before.values)
    seen = (data.readings[:, :3] - shift) @ turn
    for k in (0, 40, 74):
        rows = np.flatnonzero(data.groups == data.groups[np.flatnonzero(data.line == a.line[k])[0]])
        assert np.abs(a.where_mm[k] - seen[rows].mean(axis=0)).max() < 1e-9
        for fit, errors in ((before, a.errors_mm[0]), (study.fit, a.errors_mm[1])):
            assert np.abs(errors[k] - fit.residuals[rows, :3].mean(axis=0) @ turn).max() < 1e-9
    assert set(np.argsort(-np.linalg.norm(a.errors_mm[0], axis=1))[:5]) == set(a.worst[0].astype(int))
    assert len(a.slabs) == 3


def test_the_machine_stands_amid_its_errors(study: sk.Study) -> None:
    """Catches a machine drawn at its base, and its errors where a tracker that stands far off saw them."""
    readings = study.data.readings[:, :3] @ Rotation.from_rotvec([0.3, -0.4, 0.5]).as_matrix().T + [200.0, -120.0, 77.0]
    columns = {f"{axis}_mm": readings[:, k] for k, axis in enumerate("xyz")}
    far = sk.Study(EXAMPLE, sk.from_frame(study.data.to_frame().with_columns(**columns), "far"))
    far.add("rail_lean")
    near, away = (
        space_of(ModelState("geometry calibrated", next(s.fit for s in one.history if s.fit is not None)),
                 ModelState("now", one.fit)) for one in (study, far)
    )  # fmt: skip
    assert near.arrows is not None
    assert away.arrows is not None
    np.testing.assert_allclose(away.arrows.where_mm, near.arrows.where_mm, atol=0.2)
    np.testing.assert_allclose(away.arrows.errors_mm[0], near.arrows.errors_mm[0], atol=4e-3)
    assert np.abs(near.arrows.where_mm).max() < 40.0


@needs_browser
def test_scenes_move(study: sk.Study, tmp_path: Path, in_each_font: InEachFont) -> None:
    """Catches a scene that stays empty, a slider that moves nothing, a hover without the row's number or beside its
    point where words above it are wider, and a page that scrolls sideways."""
    before = next(s.fit for s in study.history if s.fit is not None)
    scene = space_of(ModelState("geometry calibrated", before), ModelState("now", study.fit))
    card = effect_card(study.fit.model.effects[0], EXAMPLE, fit=study.fit)
    file = tmp_path / "card.html"
    file.write_text(card_page("cards", [card, scene.html()]), encoding="utf-8")
    complaints: list[str] = []
    with closing(chromium().new_page(viewport={"width": 1100, "height": 900})) as page:
        page.on("console", lambda m: complaints.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda e: complaints.append(str(e)))
        page.goto(file.resolve().as_uri())

        def pixels(k: int) -> str:
            page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
            return str(
                page.evaluate(
                    "k => document.querySelectorAll('sherkit-scene')[k].shadowRoot.querySelector('canvas').toDataURL()",
                    k,
                )
            )

        for k, slider in ((0, 0), (1, 0), (1, 1)):
            was = pixels(k)
            page.evaluate(
                """([k, n]) => { const s = document.querySelectorAll('sherkit-scene')[k].shadowRoot
                  const input = s.querySelectorAll('input[type=range]')[n]
                  input.value = n ? 1 : input.max / (k ? 1 : 3); input.dispatchEvent(new Event('input')) }""",
                [k, slider],
            )
            assert pixels(k) != was

        def hovered() -> None:
            said = page.evaluate(
                """() => { const e = document.querySelectorAll('sherkit-scene')[1], c = e.canvas.getBoundingClientRect()
                  e.slab = -1; e.draw()
                  e.hover({clientX: c.left + e.from[0], clientY: c.top + e.from[1]}); return e.tip.textContent }"""
            )
            assert re.match(r"pose at row \d+\ngeometry calibrated: [\d.]+ µm\nnow: [\d.]+ µm$", said), said
            assert page.evaluate("document.documentElement.scrollWidth") <= 1100

        in_each_font(page, hovered)
    assert complaints == []


# -- notebook ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_bokeh_stands_once_in_a_notebook(study: sk.Study, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches cells that each bring two megabytes, and a first cell that brings nothing when it is run again."""
    running = SimpleNamespace(parent_header={"metadata": {"cellId": "one"}})
    monkeypatch.setattr(notebook, "_cell_that_runs", lambda: running.parent_header["metadata"]["cellId"])
    monkeypatch.setattr(notebook._Bringer, "cell", None)
    first = study.fit._repr_html_()
    running.parent_header["metadata"]["cellId"] = "two"
    second = study.fit._repr_html_()
    running.parent_header["metadata"]["cellId"] = "one"
    again = study.fit._repr_html_()
    assert first is not None
    assert second is not None
    assert again is not None
    assert 6e5 < len(first) < 1.1e6
    assert len(second) < 2e5
    assert len(again) > 6e5
    assert first.startswith('<pre hidden id="sherkit-bokeh">')
    assert "srcdoc" in second


@pytest.mark.slow
def test_eleven_cells_are_less_than_three_megabytes(study: sk.Study, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a cell of a study or a diagnosis that brings Bokeh again."""
    monkeypatch.setattr(notebook, "_cell_that_runs", iter(["one", "two", "three", "three"]).__next__)
    monkeypatch.setattr(notebook._Bringer, "cell", None)
    first, second = study._repr_html_(), study.fit._repr_html_()
    assert first is not None
    assert second is not None
    last = study._repr_html_()
    assert last is not None
    found = sk.diagnose(study.history[0].fit)._repr_html_()
    assert found is not None
    assert "What it brings" in found
    assert len(first) + 4 * len(second) + 3 * len(found) + 3 * len(last) < 3e6


@pytest.mark.slow
@needs_browser
def test_cells_borrow_bokeh(
    study: sk.Study, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, in_each_font: InEachFont
) -> None:
    """Catches a cell that stays empty because what the first one brought lacks a part, and a frame that is too low."""
    where = iter(["one", "two"])
    monkeypatch.setattr(notebook, "_cell_that_runs", lambda: next(where))
    monkeypatch.setattr(notebook._Bringer, "cell", None)
    cells = f"{study._repr_html_()}<hr>{study.fit._repr_html_()}<hr>{EXAMPLE._repr_html_()}"
    file = tmp_path / "notebook.html"
    file.write_text(f"<!DOCTYPE html><meta charset='utf-8'>{cells}", encoding="utf-8")
    with closing(chromium().new_page(viewport={"width": 1200, "height": 900})) as page:
        page.set_default_timeout(300_000)
        page.goto(file.resolve().as_uri())
        for frame in page.frames[1:3]:
            frame.wait_for_selector(".bk-Figure canvas", state="attached")
        page.frames[3].wait_for_selector("sherkit-scene canvas")
        page.wait_for_timeout(1500)

        def high_enough() -> None:
            for frame, held in zip(page.frames[1:], page.query_selector_all("iframe"), strict=True):
                high = held.bounding_box()
                assert 0 <= high["height"] - frame.evaluate("document.documentElement.offsetHeight") < 40

        in_each_font(page, high_enough)


def test_the_command_draws_a_card(tmp_path: Path) -> None:
    """Catches a command that draws another robot than the effect's, and a page without its drawing."""
    for name in ("rail_lean", "axis_offset", "joint_coupling", "tool_stiffness"):
        with pytest.raises(SystemExit) as ended:
            main(["effects", name, "--picture", str(tmp_path / f"{name}.html")])
        assert ended.value.code == 0
        page = (tmp_path / f"{name}.html").read_text(encoding="utf-8")
        assert name in page
        assert ('<sherkit-scene data-scene="{' in page) == (name != "tool_stiffness")


@pytest.mark.parametrize("kind", BUILT_IN)
def test_robots_and_catalogues_are_cells(kind: str) -> None:
    """Catches a robot, an effect or a catalogue that a notebook shows as code."""
    robot, model, _ = example(kind)
    cell = robot._repr_html_()
    assert "sherkit-scene" in cell
    assert len(cell) < 1e5
    table = type(model).catalogue._repr_html_()
    effect = next(iter(type(model).catalogue.values()))
    assert effect.name in table
    assert "sherkit-scene" in effect._repr_html_()


def test_many_arrows_are_a_small_file() -> None:
    """Catches a scene that outgrows its report: 3000 arrows of two states are 220 kB of text."""
    rng = np.random.default_rng(0)
    where, errors = rng.normal(size=(3000, 3)), 1e-3 * rng.normal(size=(3000, 3))
    arrows = Arrows(where, [errors, 0.1 * errors], ("a", "b"), np.arange(3000.0), "line", [np.arange(5.0)] * 2, [], "z",
                    "µm", 1e3, 1e-3)  # fmt: skip
    assert len(Scene("many", arrows=arrows).html()) < 5e5


def test_a_scene_of_an_effect_begins_where_it_is_seen() -> None:
    """Catches a slider that begins at a factor which was not drawn."""
    made = exaggerated(sk.delta.CATALOGUE["rail_lean"], EXAMPLE)
    scene = scene_of(made)
    assert scene.begin in [at for at, _ in scene.frames]
    assert scene.still().count("<polyline") > 20


def test_a_drawing_that_shows_nothing_is_not_shown(tmp_path: Path) -> None:
    """Catches a card with a slider that does nothing: of a printer a number is read, and no place."""
    picture = tmp_path / "lean.html"
    with pytest.raises(SystemExit):
        main(["effects", "rail_lean", "--picture", str(picture)])
    cards = picture.read_text(encoding="utf-8").split('<section class="effect-card"')[1:]
    assert ["data-scene" in card.partition("</section>")[0] for card in cards] == [True, False]
    assert "It cannot be drawn here: what is read (measured_mm) is no place" in cards[1]
