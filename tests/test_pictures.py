"""Every picture on three runs: what it shows against numbers computed another way; that it is drawn and exported."""

from __future__ import annotations

import io
import itertools
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from bokeh.document import Document
from bokeh.embed import json_item
from bokeh.models import Axis, CategoricalAxis, ColorBar, GlyphRenderer, Label, Legend, Plot, Span, Title
from numpy.typing import NDArray
from scipy import stats

import sherkit as sk
from browsing import InEachFont, needs_browser, opened, settled
from running import slow
from sherkit.diagnosis import Diagnosis
from sherkit.fit.error import ErrorSize
from sherkit.model.sensor_pose import ANYWHERE, HELD, SensorPose
from sherkit.report import picture as style
from sherkit.report.candidates import atlas_of, candidates, signature_atlas
from sherkit.report.page import save_picture
from sherkit.report.parameters import (
    NextPoses,
    accuracy_map,
    accuracy_of,
    correlations,
    directions,
    next_poses,
    parameters,
)
from sherkit.report.picture import Picture
from sherkit.report.residual_against import ResidualAgainst, noise_picture, residual_against, run_in_time
from sherkit.report.residual_arrows import SCALES, Change, Sheet, cut
from sherkit.report.residual_map import Reprojection, reprojection, residual_map, still
from sherkit.report.residuals import ModelState, Residuals, residuals_of
from sherkit.report.states import (
    ErrorHistory,
    ErrorOfStep,
    current_path,
    error_history,
    error_history_of,
    states_so_far,
)
from sherkit.robots.delta.robot import paper_whole
from sherkit.robots.tool.pictures import EstimateOverTime, estimate_picture
from sherkit.study import StudyStep
from strategies import EXAMPLE

Floats = NDArray[np.float64]
#: Read along the robot's own axes, so that an arrow's length is that of the error on hover.
ALONG = replace(EXAMPLE, required_um=20.0, sensor_pose=SensorPose(turn_sd_deg=HELD))
#: Radius of a two-dimensional Gaussian that holds 95 of 100.
CIRCLE = float(np.sqrt(stats.chi2.ppf(0.95, 2)))
#: Half a 95 % interval, in standard deviations.
Z = float(stats.norm.ppf(0.975))


@dataclass(eq=False)
class Run:
    """A run with what was found on it, before and after the named effects were added: those that a diagnosis names,
    or ``named``, where a test asks for none."""

    data: sk.Measurements
    named: tuple[str, ...] | None = None
    robot: sk.Delta = ALONG

    @cached_property
    def found(self) -> Diagnosis:
        return sk.Study(self.robot, self.data).diagnose()

    @cached_property
    def study(self) -> sk.Study:
        study = sk.Study(self.robot, self.data)
        self.fit = study.fit
        for name in self.found.effects if self.named is None else self.named:
            study.add(name)
        return study

    @cached_property
    def before(self) -> Residuals:
        assert self.study
        return residuals_of(self.fit)

    @cached_property
    def after(self) -> Residuals:
        return residuals_of(self.study.fit)

    @cached_property
    def calibration(self) -> sk.delta.DeltaCalibration:
        return self.study.calibration()

    fit: sk.Fit = None  # type: ignore[assignment]


def virtual() -> sk.delta.VirtualDelta:
    """The demo's robot, with rails that lean."""
    return sk.delta.VirtualDelta.draw(EXAMPLE, 6, rail_lean_rad=8e-3, noise_mm=0.005)


@pytest.fixture(scope="module")
def demo() -> Run:
    """147 poses in three planes, two readings of each, the last twenty marked as outliers."""
    data = virtual().measure(paper_whole()[::4], repeats=2, seed=6)
    return Run(data.mark_outliers(np.arange(len(data) - 20, len(data))))


@pytest.fixture(scope="module")
def plane() -> Run:
    """32 poses of one plane, each read once: the noise is unknown."""
    place = np.random.default_rng(3).uniform(-20, 20, (32, 2))
    return Run(virtual().measure(np.column_stack([place, np.zeros(32)]), repeats=1, seed=6))


@pytest.fixture(scope="module")
def many() -> Run:
    """2000 poses anywhere, three readings of each, with a temperature."""
    data = virtual().measure(np.random.default_rng(3).uniform(-20, 20, (2000, 3)), repeats=3, seed=6)
    warm = pl.Series("temperature_c", 20 + np.sin(np.arange(len(data)) / 3000.0))
    return Run(sk.from_frame(data.to_frame().with_columns(warm), "many"), ("rail_lean",))


def change(run: Run) -> Change:
    return Change(run.before, run.after, "geometry calibrated", "with what was found")


PICTURES: dict[str, Callable[[Run], Picture[Any]]] = {
    "residual_map": lambda r: residual_map(change(r)),
    "planes_across": lambda r: residual_map(change(r), planes_across=True, width_px=800),
    "against": lambda r: residual_against(ResidualAgainst(r.after, "q1_mm", r.before)),
    "against_plain": lambda r: residual_against(ResidualAgainst(r.before, "direction_1")),
    "fall": lambda r: error_history(error_history_of(r.study, r.found)),
    "candidates": lambda r: candidates(r.found),
    "atlas": lambda r: signature_atlas(atlas_of(r.fit)),
    "parameters": lambda r: parameters(r.study.fit),
    "correlations": lambda r: correlations(r.study.fit),
    "directions": lambda r: directions(r.study.fit),
    "accuracy": lambda r: accuracy_map(accuracy_of(r.calibration)),
    "next_poses": lambda r: next_poses(NextPoses(r.found.next_poses, r.before)),
    "noise": lambda r: noise_picture(r.after),
    "run": lambda r: run_in_time(r.after),
}


def tool(count: int = 2000) -> EstimateOverTime:
    """An estimate with spikes of one step, some of them in lines beside it."""
    rng = np.random.default_rng(0)
    time_s = np.linspace(0.0, 20.0, count)
    value, raw, force = (rng.normal(size=count) for _ in range(3))
    return EstimateOverTime(
        time_s, value, np.full(count, 0.1), "depth", "mm", {"sensor": raw, "truth": 0 * value}, force, 2.0
    )


def camera(count: int = 100) -> Reprojection:
    """A picture that is white in its upper left quarter."""
    rng = np.random.default_rng(1)
    image = np.zeros((480, 640), dtype=np.uint8)
    image[:240, :320] = 255
    seen = rng.uniform((0, 0), (640, 480), (count, 2))
    return Reprojection(seen, 0.5 * rng.normal(size=(count, 2)), (640, 480), np.arange(count), image)


@pytest.fixture(params=["plane", *slow("demo", "many")])
def run(request: pytest.FixtureRequest) -> Run:
    found: Run = request.getfixturevalue(request.param)
    assert found.study
    return found


def plots(picture: Picture[Any]) -> list[Any]:
    return list(picture.root.select({"type": Plot}))


def table(picture: Picture[Any], name: str) -> dict[str, Any]:
    return {k: np.asarray(v) if not isinstance(v[0] if len(v) else 0, list) else v
            for k, v in picture.sources[name].data.items()}  # fmt: skip


# -- drawing -------------------------------------------------------------------------------------------------


@needs_browser
def test_draws_all(
    run: Run, request: pytest.FixtureRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    in_each_font: InEachFont,
) -> None:  # fmt: skip
    """Catches a picture that cannot be built, serialised or drawn on a small, flat or large run, or is no picture in
    another font. Prints how long each takes: built, and drawn in Chromium."""
    from bokeh.resources import INLINE

    left = tmp_path / "empty.html"
    items: dict[str, Any] = {}
    built: dict[str, float] = {}
    for name, make in PICTURES.items():
        started = time.perf_counter()
        made = make(run)
        Document().add_root(made.root)
        items[name] = json_item(made.root)
        built[name] = time.perf_counter() - started
        json.dumps(items[name])
        assert made.note or name in ("fall",), name
    first = style.figure(width=300, height=300)
    first.line([0, 1], [0, 1])
    start = json_item(first)
    left.write_text(
        f"<!DOCTYPE html><html><head><meta charset='utf-8'>{INLINE.render()}</head>"
        f"<body><div id='here' style='width:1000px'></div><div id='first'></div>"
        f"<script>Bokeh.embed.embed_item({json.dumps(start)}, 'first')</script></body></html>",
        encoding="utf-8",
    )
    drawn = {}
    with opened(left) as page:
        for name, item in items.items():
            took = page.evaluate(
                """async ([name, item]) => {
                    const place = document.createElement("div"), start = performance.now()
                    place.id = name
                    document.getElementById("here").append(place)
                    await Bokeh.embed.embed_item(item, name)
                    const idle = () => Bokeh.index.roots.every(v => v.is_idle)
                    while (!idle()) await new Promise(done => setTimeout(done, 5))
                    await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))
                    return performance.now() - start
                }""",
                [name, item],
            )
            drawn[name] = took / 1e3

        def all_there() -> None:
            settled(page)
            for name in items:
                box = page.locator(f"#{name} > :first-child").bounding_box()
                assert box["width"] > 200, name
                assert box["height"] > 100, name

        in_each_font(page, all_there)
    with capsys.disabled():
        print(f"\n{request.node.callspec.id}, {len(run.data)} rows: built + drawn, s: "
              + ", ".join(f"{n} {built[n]:.2f} + {drawn[n]:.2f}" for n in PICTURES))  # fmt: skip


@pytest.mark.parametrize("name", PICTURES)
def test_axes_have_units_and_one_size(plane: Run, name: str) -> None:
    """Catches an axis without a unit, a text in another size, and a text that a projector would not show."""
    assert plane.study
    made = PICTURES[name](plane)
    ends = (*(f", {unit}" for unit in ("mm", "µm", "σ", "s", "°", "mm/mm")), "per σ", "σ of the rest itself")
    for axis in made.root.select({"type": Axis}):
        if axis.visible:
            assert axis.major_label_text_font_size in (style.FONT_SIZE, "0px")
        if axis.visible and axis.axis_label and name != "against_plain":
            assert axis.axis_label.endswith(ends), axis.axis_label
        elif axis.visible and not isinstance(axis, CategoricalAxis):
            # only where the axis below says it for both
            assert axis.major_label_text_font_size == "0px" or name in ("run", "estimate", "against_plain"), name
    for one in made.root.select({"type": Legend}):
        assert one.label_text_font_size == style.FONT_SIZE
    for one in made.root.select({"type": ColorBar}):
        assert one.major_label_text_font_size == style.FONT_SIZE
    for one in (*made.root.select({"type": Label}), *made.root.select({"type": Title})):
        assert one.text_font_size == style.FONT_SIZE
    for plot in plots(made):
        for renderer in plot.renderers:
            if hasattr(renderer.glyph, "text_font_size"):
                assert renderer.glyph.text_font_size == {"type": "value", "value": style.FONT_SIZE} or (
                    renderer.glyph.text_font_size == style.FONT_SIZE
                )


# -- colours -------------------------------------------------------------------------------------------------

#: Machado, Oliveira and Fernandes (2009), severity 1, on linear RGB.
EYES = {
    "any": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
#: CIE 1976. 2.3 is just noticeable side by side; six times as much stays apart for marks that lie far from each other,
#: which here differ in shape as well. Areas and the ends of a scale stand for opposite answers and need more.
APART, OPPOSITE = 15.0, 40.0


def lab(colour: str, eye: Any) -> Floats:
    """CIE L*a*b* (D65) of a colour as an eye sees it."""
    c = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    linear = np.clip(np.asarray(eye) @ np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4), 0, 1)
    to_xyz = [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
    f = np.array(to_xyz) @ linear / [0.95047, 1.0, 1.08883]
    f = np.where(f > 0.008856, np.cbrt(f), 7.787 * f + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("eye", EYES)
def test_colours_stay_apart(eye: str) -> None:
    """Catches colours that people with a colour deficiency confuse, with each other or with the paper."""

    def apart(a: str, b: str) -> float:
        return float(np.linalg.norm(lab(a, EYES[eye]) - lab(b, EYES[eye])))

    for group in (style.COLOURS, (style.ADDED, style.PLAIN, style.REFUSED)):
        assert min(apart(a, b) for a, b in itertools.combinations(group, 2)) > APART
        assert min(apart(a, "#ffffff") for a in group) > 2 * APART
    assert len(set(style.MARKERS)) == len(style.COLOURS)
    for palette in (style.DIVERGING, style.DIVERGING_AREAS):
        middle = len(palette) // 2
        assert min(apart(palette[0], palette[-1]), apart(palette[0], palette[middle])) > OPPOSITE
        assert apart(palette[-1], palette[middle]) > OPPOSITE
        # signs are told apart from a quarter of the scale on
        assert min(apart(palette[middle - k], palette[middle + k]) for k in range(middle // 4, middle + 1)) > APART
    light = [lab(colour, EYES[eye])[0] for colour in style.SEQUENTIAL]
    assert np.all(np.diff(light) < 0.5)
    assert light[0] - light[-1] > 80


# -- residual map --------------------------------------------------------------------------------------------


def arrows(picture: Picture[Any], moment: str) -> dict[str, Floats]:
    """All arrows of a moment, panel after panel."""
    tables = [table(picture, name) for name in picture.sources if name.startswith(moment) and not name.endswith("key")]
    return {k: np.concatenate([t[k] for t in tables]) for k in ("x", "y", "x1", "y1", "ex", "ey", "ez", "n")}


def test_arrows_are_means_of_poses(demo: Run, plane: Run) -> None:
    """Catches single readings or outliers in an arrow, swapped axes, metres for micrometres, a sign."""
    for one in (demo, plane):
        made = residual_map(change(one))
        data = one.data
        for moment, fit in (("before", one.fit), ("after", one.study.fit)):
            left = 1e3 * fit.residuals[:, :3]
            use = ~data.outlier
            expected = {
                tuple(np.round(left[use & (data.groups == g)].mean(axis=0), 2)): int((use & (data.groups == g)).sum())
                for g in np.unique(data.groups[use])
            }
            a = arrows(made, moment)
            shown = np.stack([a["ex"], a["ey"], a["ez"]], axis=1)
            keys = np.array(sorted(expected))
            assert len(shown) == len(keys)
            order = shown[np.lexsort(np.round(shown, 2).T[::-1])]
            np.testing.assert_allclose(np.sort(order, axis=0), np.sort(keys, axis=0), atol=0.02)
            assert a["n"].sum() == use.sum()


def test_arrows_stand_where_poses_are(demo: Run) -> None:
    """Catches arrows at another pose than theirs, panels that mix planes, and heads that point elsewhere."""
    made = residual_map(change(demo))
    before = demo.fit
    for k, plane_mm in enumerate((20.0, 0.0, -20.0)):
        t = table(made, f"before_{k}")
        for j in (0, 20, 40):
            rows = np.asarray(t["rows"][j])
            assert len(set(demo.data.pose[rows])) == 1
            np.testing.assert_allclose(t["ex"][j], 1e3 * before.residuals[rows, 0].mean(), atol=1e-3)
            place = demo.fit.model.place(demo.data, before.predicted, before.values)
            np.testing.assert_allclose(t["x"][j], place["x_mm"][rows].mean(), atol=1e-4)
            assert abs(place["z_mm"][rows].mean() - plane_mm) < 5
        scale = (t["x1"] - t["x"]) / t["ex"]
        far = np.abs(t["ex"]) > 20
        if far.any():
            np.testing.assert_allclose(scale[far], np.median(scale[far]), rtol=1e-3)
            assert np.median(scale[far]) > 0


def test_arrows_point_where_the_robot_went(plane: Run) -> None:
    """Catches arrows along the axes of a tracker that stands turned, at places in those of the robot: however it
    stands, the picture is the same."""
    anywhere = replace(ALONG, sensor_pose=ANYWHERE)
    table_ = plane.data.to_frame()
    x, y, z = (table_[name] for name in ("x_mm", "y_mm", "z_mm"))
    seen = {"x_mm": 200 - y, "y_mm": x, "z_mm": z - 90}
    turned = sk.from_frame(table_.with_columns(**seen), "far")
    plain, far = (
        arrows(residual_map(change(Run(data, ("rail_lean",), anywhere))), "before") for data in (plane.data, turned)
    )
    for name in ("x", "y"):
        np.testing.assert_allclose(far[name], plain[name], atol=1e-3)
        np.testing.assert_allclose(far[name + "1"] - far[name], plain[name + "1"] - plain[name], atol=2e-3)
    np.testing.assert_allclose(far["ex"], -plain["ey"], atol=1e-2)
    assert np.abs(plain["ex"]).max() > 1.0


def test_one_scale_with_a_true_bar_and_circle(demo: Run) -> None:
    """Catches panels on scales of their own, a bar of another length than it says, and a circle of another noise."""
    made = residual_map(change(demo))
    per_um = set()
    for moment in ("before", "after"):
        for k in range(3):
            key, t = table(made, f"{moment}_{k}_key"), table(made, f"{moment}_{k}")
            length = float(str(key["bar_text"][0]).split()[0])
            assert str(key["bar_text"][0]).endswith(" µm")
            per = (key["bar_x1"][0] - key["bar_x0"][0]) / length
            per_um.add(round(float(per), 9))
            big = np.abs(t["ex"]) > 3
            np.testing.assert_allclose((t["x1"] - t["x"])[big], per * t["ex"][big], atol=2e-5)
            noise = np.sqrt(np.mean([demo.found.noise[a] ** 2 for a in "xy"]))
            repeats = t["n"].sum() / len(t["n"])
            np.testing.assert_allclose(key["noise_r"][0], per * CIRCLE * noise / np.sqrt(repeats), rtol=2e-3)
    assert len(per_um) == 1
    figures = plots(made)
    assert len({(f.x_range.id, f.y_range.id) for f in figures}) == 1
    for f in figures:
        # a millimetre is as long upwards as across
        ratio = (f.y_range.end - f.y_range.start) / (f.x_range.end - f.x_range.start)
        assert ratio == pytest.approx(f.frame_height / f.frame_width, rel=0.01)


def test_planes_side_by_side_share_an_axis(demo: Run) -> None:
    """Catches an axis for each panel of a row, which makes the row wider than a window."""
    figures = [one for one, _, _ in residual_map(change(demo), planes_across=True, width_px=730).root.children]
    assert [one.yaxis[0].visible for one in figures] == 2 * [True, False, False]
    assert sum(one.frame_width for one in figures[:3]) <= 730


@pytest.mark.parametrize("planes", [3, 5])
def test_panels_stand_where_there_is_room_and_say_all(planes: int) -> None:
    """Catches panels beyond the edge, a colour scale that is off the page with them, titles that are cut, ticks that
    run into one another, and places at any height taken for planes."""
    rng = np.random.default_rng(planes)
    place = rng.uniform(-70.0, 70.0, (60, 3))
    wide = Residuals.at(dict(zip(("x_mm", "y_mm", "z_mm"), place.T, strict=True)), place, ("x", "y", "z"), "µm")
    assert len(cut(wide).names) == 3
    flat = replace(wide, place={**wide.place, "z_mm": np.repeat(20.0 * np.arange(planes), 60 // planes)})
    called = ("geometry calibrated", "+ rail_lean + thermal_growth")
    for left, count in ((wide, 3), (flat, planes)):
        made = residual_map(Change(left, left, *called), planes_across=True, width_px=730)
        grid = made.root.children
        assert len(grid) == 2 * count
        rows = {row: [one for one, at, *_ in grid if at == row] for _, row, *_ in grid}
        for row in rows.values():
            assert sum(one.frame_width for one in row) <= 730
            assert row[0].yaxis[0].visible
            assert row[0].frame_width / row[0].xaxis[0].ticker.desired_num_ticks > 50
        assert len([row for row in rows.values() if list(row[-1].select({"type": ColorBar}))]) == 2
        for k in range(count):
            for moment, title in zip(("before", "after"), called, strict=True):
                *said, _ = (lines := made.sources[f"{moment}_{k}_key"].data["title"][0].split("\n"))
                assert max(map(len, lines)) <= row[0].frame_width / 10
                assert " ".join(said).startswith(title)


def test_no_circle_where_the_noise_is_unknown(plane: Run) -> None:
    """Catches a noise that nobody knows, drawn."""
    made = residual_map(change(plane))
    assert table(made, "before_0_key")["noise_r"][0] == 0
    assert table(made, "before_0_key")["noise_text"][0] == ""
    assert "circle" not in made.note


def test_cells_count_every_reading(many: Run) -> None:
    """Catches rows that are dropped where arrows become means of cells, or a thinning that is not told."""
    made = residual_map(change(many))
    a = arrows(made, "after")
    assert a["n"].sum() == len(many.data)
    assert len(a["n"]) <= 3 * 225
    mean = (a["n"][:, None] * np.stack([a["ex"], a["ey"], a["ez"]], axis=1)).sum(axis=0) / a["n"].sum()
    np.testing.assert_allclose(mean, 1e3 * many.study.fit.residuals[:, :3].mean(axis=0), atol=1e-3)
    assert "mean of a cell" in made.note


# -- against -------------------------------------------------------------------------------------------------


def test_thinned_points_and_means_of_all(many: Run) -> None:
    """Catches a mean of the drawn rows alone, a note that hides the rest, points of other rows."""
    made = residual_against(ResidualAgainst(many.before, "direction_1"))
    assert "3000 of 6000 are drawn" in made.note
    points, mean = table(made, "points"), table(made, "mean")
    assert len(points["r0"]) == 3000
    left = 1e3 * many.fit.residuals[:, :3]
    np.testing.assert_allclose(points["r2"], left[points["row"], 2], atol=1e-3)
    np.testing.assert_allclose(points["v"], many.data.direction[points["row"], 0])
    for at, value in zip(mean["v"], mean["m1"], strict=True):
        assert value == pytest.approx(left[many.data.direction[:, 0] == at, 1].mean(), abs=1e-3)


def test_running_mean_of_all_rows(many: Run) -> None:
    """Catches a window of another width, rows counted twice, and a band that counts repeats as independent."""
    made = residual_against(ResidualAgainst(many.before, "q2_mm"))
    mean = table(made, "mean")
    v, left = many.data.joints[:, 1], 1e3 * many.fit.residuals[:, :3]
    ordered = np.sort(v)
    n = len(v)
    for j in range(5, len(mean["v"]) - 5, 7):
        # as wide as a twelfth of the rows around it, as an ordered list gives them
        middle = np.searchsorted(ordered, mean["v"][j])
        half = 0.5 * (ordered[int(middle + n / 24)] - ordered[int(middle - n / 24)])
        window = np.flatnonzero(np.abs(v - mean["v"][j]) <= half)
        se = left[window, 0].std() / np.sqrt(len(np.unique(many.data.groups[window])))
        assert mean["m0"][j] == pytest.approx(left[window, 0].mean(), abs=0.3 * se)
        assert 0.25 * (mean["high0"][j] - mean["low0"][j]) == pytest.approx(se, rel=0.1)


def test_what_the_effect_explains(demo: Run) -> None:
    """Catches a dashed line of another sign or of another effect."""
    made = residual_against(ResidualAgainst(demo.after, "time_s", demo.before))
    gained, mean_before = table(made, "gained"), table(residual_against(ResidualAgainst(demo.before, "time_s")), "mean")
    mean_after = table(made, "mean")
    for k in range(3):
        np.testing.assert_allclose(gained[f"g{k}"], mean_before[f"m{k}"] - mean_after[f"m{k}"], atol=1e-3)
    (panel,) = (f for f in plots(made) if f.yaxis[0].axis_label == "x, µm")
    lines = [s.location for s in panel.select({"type": Span})]
    assert sorted(lines) == pytest.approx([-2 * demo.found.noise["x"], 0, 2 * demo.found.noise["x"]])


def test_the_noise_is_the_diagnosis_s_in_every_state(demo: Run) -> None:
    """Catches lines of the noise that stay where they were drawn first, and a state beside the noise of its own fit:
    with play in the machine that holds what the play moves."""
    study = demo.study
    known = replace(demo.found, noise={axis: 1.1 * one for axis, one in demo.found.noise.items()})
    before, after = (ModelState("", fit, known).left for fit in (demo.fit, study.fit))
    assert before.noise.tolist() == after.noise.tolist() == list(known.noise.values())
    assert {one.left.noise_size for one in states_so_far(study, known).values()} == {known.noise_size}
    assert ModelState("", demo.fit).left is demo.before
    made = residual_against(ResidualAgainst(demo.after, "time_s", demo.before))
    made.show(ResidualAgainst(after, "time_s", before))
    for panel in plots(made):
        noise = known.noise[panel.yaxis[0].axis_label[0]]
        lines = sorted(one.location for one in panel.select({"type": Span}))
        assert lines == pytest.approx([-2 * noise, 0, 2 * noise])


def test_marked_outliers_stay_in_sight(demo: Run) -> None:
    """Catches outliers that are thinned away or drawn like the others."""
    points = table(residual_against(ResidualAgainst(demo.after, "q1_mm")), "points")
    large = points["row"][points["size"] > 8]
    assert set(large) == set(np.flatnonzero(demo.data.outlier))
    points = table(run_in_time(demo.after), "run")
    assert (points["size"] > 8).sum() == 20


def test_rows_that_are_left_out_stand_at_the_rim(demo: Run) -> None:
    """Catches a scale that one wrong row decides, and one that is drawn where it is not without a word."""
    values = demo.after.values.copy()
    row = int(np.flatnonzero(demo.data.outlier)[0])
    values[row] = [25e3, -25e3, 0.0]
    left = replace(demo.after, values=values)
    counted = values[~left.outlier]
    for made, name in ((residual_against(ResidualAgainst(left, "q1_mm")), "points"), (run_in_time(left), "run")):
        t = table(made, name)
        for k in range(3):
            span = np.ptp(np.append(counted[:, k], 0.0))
            assert np.abs(t[f"r{k}"]).max() <= np.abs(counted[:, k]).max() + 0.07 * span
        assert "left out" in t["beyond"][list(t["line"]).index(left.line[row])]
        assert sum(map(bool, t["beyond"])) <= left.outlier.sum()


def test_run_in_time(many: Run) -> None:
    """Catches readings in another order, hidden thinning, and a temperature that is not below."""
    made = run_in_time(many.after)
    t = table(made, "run")
    assert len(t["t"]) == 4000
    assert "4000 of 6000" in made.note
    assert np.all(np.diff(t["t"]) > 0)
    row = np.searchsorted(many.data.time_s, t["t"])
    np.testing.assert_allclose(t["r1"], 1e3 * many.study.fit.residuals[row, 1], atol=1e-3)
    assert {f.yaxis[0].axis_label for f in plots(made)} == {"residual, µm", "temperature, °C"}


# -- fall, candidates, parameters, noise, workspace ----------------------------------------------------------


def test_fall_is_the_history(demo: Run) -> None:
    """Catches steps in another order, fitted for held out, and lines of noise or need that are off the picture."""
    made = error_history(error_history_of(demo.study, demo.found))
    t = table(made, "steps")
    assert t["step"].tolist() == [s.action for s in demo.study.history]
    assert t["held_error"].tolist() == [s.error.rms for s in demo.study.history]
    for axis in "xyz":
        assert t[f"held_{axis}"].tolist() == [s.error.by_reading[f"{axis}_mm"] for s in demo.study.history]
        assert t[f"fit_{axis}"].tolist() == [s.fitted.by_reading[f"{axis}_mm"] for s in demo.study.history]
    figure = plots(made)[0]
    lines = [s.location for s in figure.select({"type": Span})]
    assert sorted(lines) == pytest.approx(sorted([20.0, demo.found.noise_size]))
    values = [v for k, column in t.items() if k.startswith(("held", "fit", "p95")) for v in column]
    assert figure.y_range.start < min(values + lines)
    assert figure.y_range.end > max(values + lines)


def test_the_path_leaves_out_what_was_taken_back() -> None:
    """Catches a step of the path that is folded, an undone one that is drawn, and numbers where names have room."""

    def step(action: str, effects: tuple[str, ...], left: float, rows: int = 9) -> StudyStep:
        return StudyStep(action, effects, size(left), size(left), {}, rows, None)

    def size(left: float) -> ErrorSize:
        return ErrorSize(left, left, left, left, "µm", held_out=True, by_reading={"x_mm": left})

    plain, lean = step("geometry calibrated", (), 130.0), step("+ rail_lean", ("rail_lean",), 5.0)
    marked = step("1 rows marked as outliers", ("rail_lean",), 4.9)
    undone, slip = step("undone: + rail_lean", (), 130.0), step("+ slip", ("slip",), 120.0)
    assert current_path([plain, lean, marked]) == [0, 1, 2]
    assert current_path([plain, lean, undone]) == [0]
    assert current_path([plain, lean, marked, step("undone", ("rail_lean",), 5.0)]) == [0, 1]
    assert current_path([plain, slip, undone, lean, marked]) == [0, 3, 4]
    assert current_path([plain, lean, step("redone: added rail_lean", ("rail_lean",), 5.0)]) == [0, 1]
    many = ErrorHistory([ErrorOfStep(f"step {k}", size(9.0 - 0.1 * k), size(8.0)) for k in range(23)], None, "µm")
    made = error_history(many)
    assert plots(made)[0].x_range.factors == [str(k) for k in range(23)]
    assert table(made, "steps")["action"][22] == "step 22"
    made.show(ErrorHistory(many.steps[:3], {}, "µm"))
    assert plots(made)[0].x_range.factors == ["step 0", "step 1", "step 2"]


@pytest.mark.parametrize("scale", SCALES)
def test_each_scale_says_what_it_shows(demo: Run, scale: str) -> None:
    """Catches arrows after that are no longer than a point on their own scale, a bar that belongs to the other moment,
    a unit that is not the one drawn, and numbers on hover that change with the scale."""
    made = residual_map(replace(change(demo), scale=scale))
    before, after = table(made, "before_0"), table(made, "after_0")
    keys = {moment: table(made, f"{moment}_0_key") for moment in ("before", "after")}
    lengths = {m: np.hypot(t["x1"] - t["x"], t["y1"] - t["y"]) for m, t in (("before", before), ("after", after))}
    if scale == "shared":
        assert lengths["after"].max() < 0.2 * lengths["before"].max()
    else:
        assert lengths["after"].max() > 0.4 * lengths["before"].max()
    shared = table(residual_map(change(demo)), "after_0")
    np.testing.assert_allclose(after["ex"], shared["ex"], rtol=1e-5)
    noise = float(demo.after.noise[0]) if scale == "noise" else 1.0
    for moment, t in (("before", before), ("after", after)):
        key = keys[moment]
        bar = float(key["bar_text"][0].split()[0])
        per_unit = (key["bar_x1"][0] - key["bar_x0"][0]) / bar
        np.testing.assert_allclose(t["x1"] - t["x"], per_unit * t["ex"] / noise, atol=1e-3 * lengths[moment].max())
        assert key["bar_text"][0].endswith("σ" if scale == "noise" else "µm")


@pytest.mark.parametrize(("low", "high"), [(0.143, 0.192), (0.012, 0.0131), (0.004, 3.0), (1.9, 2.3)])
def test_an_axis_has_numbers_however_narrow(low: float, high: float) -> None:
    """Catches candidates within a few micrometres of each other on an axis without a number."""
    inside = [tick for tick in style.ticks_between(low, high) if low <= tick <= high]
    assert 3 <= len(inside) <= 12
    assert all(float(f"{tick:.4g}") == pytest.approx(tick) for tick in inside)


def test_bracket_holds_what_is_tied(plane: Run, demo: Run) -> None:
    """Catches a bracket around others, one where nothing is tied, and an implausible size that looks plausible."""
    assert plane.study
    assert plane.found.indistinguishable
    made = candidates(plane.found)
    shown = [str(e) for e in table(made, "effects")["effect"]]
    lines = table(made, "brackets")
    stems = [(str(a), str(b)) for a, b, x, y in zip(lines["y0"], lines["y1"], lines["x0"], lines["x1"], strict=True)
             if a != b and x == y]  # fmt: skip
    assert len(stems) == len(plane.found.indistinguishable)
    for (first, last), tie in zip(stems, plane.found.indistinguishable, strict=True):
        assert set(shown[shown.index(first) : shown.index(last) + 1]) == set(tie)
    assert demo.study
    assert not demo.found.indistinguishable
    assert len(table(candidates(demo.found), "brackets")["x0"]) == 0
    t = table(made, "effects")
    by_name = {c.effect: c for c in plane.found.candidates}
    for name, error, std, marker, fill in zip(t["effect"], t["error"], t["std"], t["marker"], t["fill"], strict=True):
        c = by_name[str(name)]
        assert (error, std) == (pytest.approx(c.held_out_rms), c.held_out_std)
        assert (marker == "x") == (not c.plausible and c.effect not in plane.found.effects)
        assert (fill == style.ADDED) == (c.effect in plane.found.effects)


def test_atlas_puts_the_cause_first(demo: Run) -> None:
    """Catches tiles of another size or order, and a signature that the fitted parameters had not had their share of."""
    assert demo.study
    atlas = atlas_of(demo.fit)
    assert [tile.title for tile in atlas.tiles[:2]] == ["measured", "rail_lean"]
    assert atlas.tiles[1].share > 0.99
    shares = [tile.share for tile in atlas.tiles[1:]]
    assert shares == sorted(shares, reverse=True)
    measured, lean = (tile.error for tile in atlas.tiles[:2])
    assert np.corrcoef(measured.ravel(), lean.ravel())[0, 1] > 0.99


def test_parameters_with_their_intervals(plane: Run) -> None:
    """Catches one standard deviation for 95 %, radians for degrees, and parameters that are lost."""
    fit = plane.study.fit
    made = parameters(fit)
    tables = [table(made, name) for name in made.sources]
    rows = {str(n): (t["value"][k], t["low"][k], t["high_all"][k]) for t in tables for k, n in enumerate(t["name"])}
    assert set(rows) == {p.name for p in fit.parameters}
    for p, v, r, s in zip(fit.parameters, fit.values, fit.std_from_readings, fit.std, strict=True):
        factor = np.rad2deg(1.0) if p.unit == "rad" else 1.0
        np.testing.assert_allclose(rows[p.name], np.array([v, v - Z * r, v + Z * s]) * factor, rtol=1e-4, atol=1e-9)
    cells = table(correlations(fit), "cells")
    std = np.sqrt(np.diag(fit.covariance))
    np.testing.assert_allclose(cells["value"].reshape(len(std), -1), fit.covariance / np.outer(std, std), atol=1e-5)
    rows_ = table(directions(fit), "directions")
    assert rows_["std"].tolist() == [d.std for d in fit.badly_observed]


def test_quantiles_of_the_noise(demo: Run, plane: Run) -> None:
    """Catches residuals over another axis' noise, outliers among them, and a Gaussian of another width."""
    made = noise_picture(demo.before)
    t = table(made, "quantiles")
    u = 1e3 * demo.fit.residuals[~demo.data.outlier, 1] / demo.found.noise["y"]
    level = stats.norm.cdf(t["gauss"])
    for j in (0, 10, 100, 199):
        below = np.mean(u <= t["q_1"][j])
        assert below == pytest.approx(level[j], abs=1.5 / len(u))
    bins = table(made, "bins")
    assert np.sum(bins["density_0"]) * (bins["at"][1] - bins["at"][0]) == pytest.approx(1.0)
    labels = [f.xaxis[0].axis_label for f in plots(noise_picture(plane.after))]
    assert "residual, σ of the rest itself" in labels
    assert "noise is not known" in noise_picture(plane.after).note


def test_accuracy_map_is_the_calibration(demo: Run) -> None:
    """Catches swapped axes, an outline around what misses the requirement, and hatching of what was measured."""
    state = accuracy_of(demo.calibration)
    z = np.linspace(EXAMPLE.workspace_z_mm[1], EXAMPLE.workspace_z_mm[0], 3)
    rng = np.random.default_rng(0)
    for _ in range(12):
        k, j, i = rng.integers(3), rng.integers(len(state.y)), rng.integers(len(state.x))
        base = np.array([state.x[i], state.y[j], z[k]])
        place = demo.calibration.whole.at_sensor(base[None, :])[0]
        assert state.measured[k, j, i] == demo.calibration.measured(place)
        if np.isfinite(state.value_um[k, j, i]):
            assert state.value_um[k, j, i] == pytest.approx(1e3 * demo.calibration.accuracy(place))
        else:
            assert np.hypot(base[0], base[1]) > EXAMPLE.workspace_radius_mm - 1
    made = accuracy_map(state)
    step_x, step_y = state.x[1] - state.x[0], state.y[1] - state.y[0]
    hatched = table(made, "beyond_0")
    area = np.sum((hatched["right"] - hatched["left"]) * (hatched["top"] - hatched["bottom"]))
    beyond = ~state.measured[0] & np.isfinite(state.value_um[0])
    assert area == pytest.approx(beyond.sum() * step_x * step_y)
    good = np.nan_to_num(state.value_um[0], nan=np.inf) <= 20.0
    edge = np.pad(good, 1).astype(int)
    assert (
        len(table(made, "outline_0")["xs"]) == np.abs(np.diff(edge, axis=0)).sum() + np.abs(np.diff(edge, axis=1)).sum()
    )


def test_next_poses_are_numbered(plane: Run) -> None:
    """Catches numbers at other poses, and numbers on top of each other."""
    assert plane.study
    made = next_poses(NextPoses(plane.found.next_poses, plane.before))
    above, side = table(made, "orders_0"), table(made, "orders_1")
    places = [(pose["x_mm"], pose["y_mm"]) for pose in plane.found.next_poses]
    for k, (x, y) in enumerate(places, 1):
        here = (above["x"] == x) & (above["y"] == y)
        many = places.count((x, y))
        # poses on top of each other are counted, not numbered
        assert above["text"][here].tolist() == [str(k) if many == 1 else f"{many}×"]
    assert len({(x, y) for x, y in zip(side["x"], side["y"], strict=True)}) == len(side["x"])
    assert sum(int(str(t)[:-1]) if str(t).endswith("×") else 1 for t in side["text"]) == len(plane.found.next_poses)


# -- tool and camera -----------------------------------------------------------------------------------------


def test_thinning_keeps_every_spike() -> None:
    """Catches a spike of one step that is thinned away, in the estimate or in any line beside it."""
    state = tool(50_000)
    rng = np.random.default_rng(2)
    at = rng.choice(50_000, 12, replace=False)
    state.estimate[at[:3]], state.others["sensor"][at[3:6]], state.others["truth"][at[6:9]] = 9.0, -9.0, 7.0
    state.force_mN[at[9:]] = 8.0
    t = table(estimate_picture(state), "run")
    assert len(t["t"]) < 20_000
    assert np.all(np.diff(t["t"]) > 0)
    for column, value, count in (("estimate", 9.0, 3), ("other_0", -9.0, 3), ("other_1", 7.0, 3), ("force", 8.0, 3)):
        assert (t[column] == value).sum() == count
    np.testing.assert_allclose(t["high"] - t["low"], 2 * 1.959964 * 0.1, rtol=1e-6)


def test_estimate_says_that_it_is_thinned() -> None:
    """Catches a picture of many steps that does not say what it leaves out."""
    assert "50000" in estimate_picture(tool(50_000)).note
    assert "lowest and highest" in estimate_picture(tool(50_000)).note
    assert "lowest and highest" not in estimate_picture(tool(500)).note


def test_the_truth_is_seen_and_a_break_is_said() -> None:
    """Catches a truth that an estimate which is right hides, and a line that breaks without a word."""
    state = tool(500)
    (truth,) = estimate_picture(state).root.select({"type": GlyphRenderer, "level": "annotation"})
    assert truth.glyph.y == f"other_{[*state.others].index('truth')}"
    told = replace(state, innovation=np.ones(500))
    assert "breaks" not in estimate_picture(told).note
    told.innovation[100:200] = np.nan
    assert "breaks where" in estimate_picture(told).note


def test_estimate_without_numbers() -> None:
    """Catches a picture that fails where the sensor dropped out for long."""
    state = tool(20_000)
    state.estimate[:] = np.nan
    json_item(estimate_picture(state).root)


@needs_browser
def test_the_camera_picture_is_the_right_way_up(tmp_path: Path) -> None:
    """Catches a picture that is drawn upside down, mirrored, or outside its axes, and arrows on another scale."""
    image = pytest.importorskip("PIL.Image")
    made = reprojection(camera())
    save_picture(made, tmp_path / "camera.png")
    with image.open(tmp_path / "camera.png") as opened_:
        pixels = np.asarray(opened_.convert("L"), dtype=float)
    high, wide = 480 * 820 / 640, 820
    # the frame is at the upper right of the axes' labels: find its edges by the grey of the dark quarters
    grey = np.abs(pixels - 255 * 0.55) < 12
    columns, rows = np.flatnonzero(grey.sum(axis=0) > 0.3 * high), np.flatnonzero(grey.sum(axis=1) > 0.3 * wide)
    top, left = rows[-1] - high, columns[-1] - wide
    quarter = {}
    for v, u in itertools.product((0.25, 0.75), repeat=2):
        row, column = int(top + v * high), int(left + u * wide)
        quarter[v, u] = np.median(pixels[row - 20 : row + 20, column - 20 : column + 20])
    assert quarter[0.25, 0.25] > 240
    assert max(v for place, v in quarter.items() if place != (0.25, 0.25)) < 200
    t = table(made, "marks")
    by = float(made.note.split(" times")[0].split()[-1])
    np.testing.assert_allclose(t["u1"] - t["u"], by * t["eu"])
    np.testing.assert_allclose(t["v1"] - t["v"], by * t["ev"])


# -- files and notebooks -------------------------------------------------------------------------------------


def test_readers_without_scripts_see_the_same_map(demo: Run, plane: Run) -> None:
    """Catches an SVG with arrows, scales or errors of its own, and one that draws the same moment twice."""
    both, drawn = change(demo), still(change(demo))
    figures = residual_map(both).sources
    keys = [source.data for name, source in figures.items() if name.endswith("_key")]
    assert len(keys) == 6
    # a narrow panel has a longer bar of scale
    bars = [key["bar_text"][0] for name, key in Sheet(both, 290).tables(both).items() if name.endswith("_key")]
    for key, bar in zip(keys, bars, strict=True):
        for line in (*key["title"][0].split("\n"), bar):
            assert f">{line}</text>" in drawn
    assert drawn.count("L") - len(keys) == sum(
        len(table(residual_map(both), f"{m}_{k}")["x"]) for m in ("before", "after") for k in range(3)
    )
    assert still(Change(plane.before, plane.before)).count("<circle") == 1


@pytest.mark.slow
@needs_browser
def test_saves_png_and_svg(demo: Run, tmp_path: Path) -> None:
    """Catches an empty or cut picture, a format that is another one, and an SVG that is a bitmap."""
    assert demo.study
    image = pytest.importorskip("PIL.Image")
    made = candidates(demo.found)
    save_picture(made, tmp_path / "a.png")
    with image.open(io.BytesIO((tmp_path / "a.png").read_bytes())) as png:
        assert png.format == "PNG"
        assert png.width > 900
        assert len(png.convert("RGB").getcolors(1 << 20) or ()) > 20
    save_picture(candidates(demo.found), tmp_path / "a.svg")
    svg = (tmp_path / "a.svg").read_text(encoding="utf-8")
    assert "<svg" in svg[:300]
    assert "rail_lean" in svg
    assert "held out" in svg
    save_picture(made, tmp_path / "a.html")
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert text.index("Content-Security-Policy") < text.index("<script")
    with opened(tmp_path / "a.html") as page:
        assert page.locator("[title='save as PNG']").count() == 1


def test_another_ending_is_refused(demo: Run, tmp_path: Path) -> None:
    """Catches a picture in a format that its name does not say."""
    assert demo.study
    with pytest.raises(sk.SherkitError, match=r"a\.jpg: a picture is written as \.html, \.png or \.svg$"):
        save_picture(candidates(demo.found), tmp_path / "a.jpg")
    assert not (tmp_path / "a.jpg").exists()


@needs_browser
@pytest.mark.parametrize("what", ["fit", *slow("study", "found", "calibration")])
def test_notebook_cells(plane: Run, what: str, tmp_path: Path, in_each_font: InEachFont) -> None:
    """Catches a cell that needs an extension, a network or another cell, and one without its text."""
    value = getattr(plane.study, what, None) or {"study": plane.study, "found": plane.found, "calibration": None}[what]
    if what == "calibration":
        value = plane.calibration
    html = value._repr_html_()
    assert html.startswith("<iframe ")
    assert html.endswith("</iframe>")
    assert html.count("<iframe") == 1
    assert html.index("Content-Security-Policy") < html.index("&lt;script")
    (tmp_path / "cell.html").write_text(f"<!DOCTYPE html><meta charset='utf-8'>{html}", encoding="utf-8")
    from html import unescape

    inside = tmp_path / "inside.html"
    inside.write_text(unescape(html.split('srcdoc="', 1)[1].rsplit('" style', 1)[0]), encoding="utf-8")
    with opened(inside) as page:
        assert page.locator(".bk-Figure").count() > 0
        assert page.locator("pre").inner_text().strip() == str(value).strip()

        def fits() -> None:
            settled(page)
            assert page.evaluate("document.documentElement.scrollWidth") <= 1200

        in_each_font(page, fits)
