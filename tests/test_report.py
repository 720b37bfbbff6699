"""The offline report: what it says against ``--json``, without a network, without JavaScript, with hostile texts."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from collections.abc import Sequence
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import sherkit as sk
from browsing import InEachFont, needs_browser, opened, settled, source, unfold
from running import command
from sherkit import save_robot
from sherkit.base.answer import Answer
from sherkit.base.figures import in_people_units, with_error
from sherkit.model.effect import effects_by_name
from sherkit.report.page import Made
from sherkit.report.picture import number
from sherkit.robots.delta import CATALOGUE
from sherkit.robots.delta.robot import grid
from sherkit.robots.tool.pictures import EstimateOverTime, write_estimate
from strategies import EXAMPLE

HOSTILE = ("<script>alert(1)</script>", "</script><img src=x onerror=alert(2)>\"'")
EFFECT = '''
import numpy as np
import sherkit as sk


@sk.effect(at="body", parameters={"amplitude": "mm"}, physics="</script><script>alert(3)</script> & 'quotes\\"")
def heave(rows, p):
    """</script><b id="bold">bold</b>"""
    return p.amplitude * np.outer(np.sin(rows.position[:, 0]), [0, 0, 1])
'''


def done(folder: Path, *arguments: str) -> str:
    """What the command printed; it went well."""
    code, out, err = command(folder, *arguments)
    assert code == 0, err
    return out


def agrees(text: str, value: float, unit: str = "") -> None:
    """A printed figure is ``value`` as far as its digits go."""
    figure = re.fullmatch(rf"([-+]?\d+(\.(\d+))?(e[-+]\d+)?){unit}", text.strip())
    assert figure, text
    digits = figure[1].lstrip("+-0.").replace(".", "").split("e")[0]
    last = 0.5 * 10.0 ** -len(figure[3] or "") if not figure[4] else 0.0
    # general format: as many digits as are printed
    assert abs(float(figure[1]) - value) <= max(last, 0.5 * 10.0 ** -max(len(digits) - 1, 0) * abs(value)) * 1.001


def cells(page: Any, table: str) -> list[list[str]]:
    """Texts of a table of the page, row by row, without its head."""
    rows: list[list[str]] = page.evaluate(
        "id => [...document.getElementById(id).rows].map(r => [...r.querySelectorAll('td')].map(c => c.innerText))",
        table,
    )
    return [row for row in rows if row]


def virtual(seed: int, lean: float) -> sk.delta.VirtualDelta:
    """A robot that is not as drawn, read with 5 µm noise."""
    return sk.delta.VirtualDelta.draw(EXAMPLE, seed, rail_lean_rad=lean, noise_mm=0.005)


@pytest.fixture
def demo(made: Path) -> Path:
    """The folder in which ``sherkit demo`` was run."""
    return made


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Small runs of every kind that a report may be asked of."""
    folder = tmp_path_factory.mktemp("runs")
    save_robot(EXAMPLE, folder / "robot.toml")
    poses = grid(18.0, 6, (-15.0, 0.0, 15.0))
    leaning = virtual(3, 8e-3)
    leaning.measure(poses, repeats=2, order="shuffled", seed=1).save(folder / "leaning.csv")
    leaning.measure(grid(9.0, 5, (-8.0, 0.0, 8.0)), repeats=2, order="shuffled", seed=2).save(folder / "local.csv")
    plain = virtual(3, 0.0).measure(poses, repeats=2, order="shuffled", seed=1)
    plain.save(folder / "plain.csv")
    frame = plain.to_frame()
    frame.select("q1_mm", "q2_mm", "q3_mm", "z_mm").write_csv(folder / "heights.csv")
    half = len(frame) // 2
    between = (frame[f"{a}_mm"].to_numpy() for a in "xyz")
    apart = np.sqrt(sum((v[:half] - v[half : 2 * half]) ** 2 for v in between))
    ends = {f"to_q{k}_mm": frame[f"q{k}_mm"][half : 2 * half] for k in (1, 2, 3)}
    starts = {f"q{k}_mm": frame[f"q{k}_mm"][:half] for k in (1, 2, 3)}
    pl.DataFrame({**starts, **ends, "distance_mm": apart}).write_csv(folder / "distances.csv")
    dense = virtual(3, 0.0).measure(grid(18.0, 7, (-15.0, 0.0, 15.0)), repeats=2, order="shuffled", seed=1)
    waves = 0.05 * (pl.col("x_mm") / 2.1).sin()
    dense.to_frame().with_columns(pl.col("y_mm") + waves).write_csv(folder / "strange.csv")
    place = np.random.default_rng(3).uniform(-20, 20, (32, 2))
    plane = virtual(6, 8e-3).measure(np.column_stack([place, np.zeros(len(place))]), repeats=1, seed=6)
    plane.save(folder / "plane.csv")
    return folder


# -- the demo ------------------------------------------------------------------------------------------------


def test_no_address_leaves_the_file(demo: Path) -> None:
    """Catches a script, style sheet, picture or font that is fetched, and a report that outgrows e-mail."""
    file = demo / "demo" / "report.html"
    assert file.stat().st_size < 5e6
    text = file.read_text(encoding="utf-8")
    tags = re.findall(r"<(?!/)[a-z][^>]*>", re.sub(r"<script\b.*?</script>", "", text, flags=re.S), flags=re.S)
    for tag in tags:
        for address in re.findall(r"""(?:src|href|action|srcset|poster)\s*=\s*["']?([^"'\s>]+)""", tag):
            assert address.startswith(("#", "data:")), tag
    for style in re.findall(r"<style\b.*?</style>", text, flags=re.S):
        assert "@import" not in style
        assert all(a.startswith("data:") for a in re.findall(r"url\(['\"]?([^)]*)", style))
    assert not re.findall(r"<script[^>]*\bsrc=", text)


@pytest.mark.slow
@needs_browser
def test_report_says_what_the_json_says(demo: Path) -> None:
    """Catches figures of another model, of other rows or in another unit, a table in another order, a lost row."""
    found = json.loads(done(demo, "diagnose", "demo/robot.toml", "demo/whole.csv", "--json"))
    calibrate = ("calibrate", "demo/robot.toml", "demo/whole.csv", "--correction", "none", "--json")
    plain = json.loads(done(demo, *calibrate))["whole"]
    added = [a for name in found["effects"] for a in ("--effect", name)]
    last = json.loads(done(demo, *calibrate, *added))["whole"]
    study = sk.Study(demo / "demo" / "robot.toml", demo / "demo" / "whole.csv")
    for name in found["effects"]:
        study.add(name)
    with opened(demo / "demo" / "report.html") as page:
        unfold(page)
        verdict = page.inner_text("#verdict")
        assert verdict.startswith(found["verdict"] + ":")
        assert all(name in verdict for name in found["effects"])
        agrees(page.inner_text("#bar_before"), found["steps"][0]["error"]["rms"], " µm")
        agrees(page.inner_text("#bar_after"), found["steps"][-1]["error"]["rms"], " µm")
        agrees(page.inner_text("#bar_noise"), math.hypot(*found["noise_um"].values()), " µm")
        assert found["p_missing"] < 1e-16
        assert "p = < 1e-16" in page.inner_text("#missing")
        rows = cells(page, "candidates") + cells(page, "candidates_more")
        assert [row[0] for row in rows] == [c["effect"] for c in found["candidates"]]
        for row, c in zip(rows, found["candidates"], strict=True):
            error, std = row[2].split(" ± ")
            agrees(error, c["held_out_rms_um"])
            agrees(std, c["held_out_std_um"])
            assert ("implausible" in row[4]) != c["plausible"]
            agrees(row[4].split()[0], c["plausible_sizes"])
            agrees(row[5].split()[1], in_people_units(c["parameters"][0]["unit"])[1] * c["parameters"][0]["value"])
        assert [row[0] for row in cells(page, "where")] == [d["variable"] for d in found["where"]]
        for row, one, step in zip(cells(page, "fall"), (plain, last), study.history, strict=True):
            agrees(row[1], step.error.rms)
            agrees(row[2], step.error.p95)
            for cell, axis in zip(row[3:], "xyz", strict=True):
                agrees(cell, step.error.by_reading[f"{axis}_mm"])
                # another deal of blocks
                assert float(cell) == pytest.approx(one["rms_um"]["held_out"][axis], rel=0.1)
        assert study.history[0].error.rms == pytest.approx(found["steps"][0]["error"]["rms"], rel=1e-9)
        assert study.history[-1].error.rms == pytest.approx(found["steps"][-1]["error"]["rms"], rel=1e-3)
        rows = cells(page, "parameters")
        assert [row[0] for row in rows] == [p["name"] for p in last["parameters"]]
        for row, p in zip(rows, last["parameters"], strict=True):
            factor = 180 / math.pi if p["unit"] == "rad" else 1.0
            assert row[5] == ("°" if p["unit"] == "rad" else p["unit"])
            for text, key in zip(row[2:5], ("value", "std_from_readings", "std"), strict=True):
                agrees(text, factor * p[key])
        assert inside(demo / "demo" / "report.html") == found
        assert "sherkit demo" in page.inner_text("#command")


@needs_browser
def test_switches_move_the_pictures(demo: Path) -> None:
    """Catches numbers of another state or variable, swapped axes, rows in another order, and a stale title."""
    robot, data = sk.load_robot(demo / "demo/robot.toml"), sk.read_measurements(demo / "demo/whole.csv")
    fits = {
        "+ beam_alignment": sk.identify(
            sk.delta.DeltaModel(robot, effects=effects_by_name(CATALOGUE, ("beam_alignment",))), data, priors=False
        ),
        "geometry calibrated": sk.identify(sk.delta.DeltaModel(robot), data),
    }
    base = 1e3 * fits["geometry calibrated"].residuals[:, :3]
    with opened(demo / "demo" / "report.html") as page:
        unfold(page)
        assert page.eval_on_selector("#state", "s => s.options[s.selectedIndex].text") == "+ rail_lean"
        for title, fit in fits.items():
            page.select_option("#state", label=title)
            page.select_option("#variable", label="q2, mm")
            settled(page)
            left = 1e3 * fit.residuals[:, :3]
            points = source(page, "points")
            np.testing.assert_allclose(points["v"], data.joints[:, 1], rtol=1e-6)
            for k in range(3):
                np.testing.assert_allclose(points[f"r{k}"], left[:, k], atol=1e-3)
            arrows = [source(page, f"after_{k}") for k in range(3)]
            poses = np.unique(data.pose)
            expected = np.array([left[data.pose == pose].mean(axis=0) for pose in poses])
            shown = np.concatenate([np.stack([a["ex"], a["ey"], a["ez"]], axis=1) for a in arrows])
            # as sets: panels hold poses in an order of their own
            order = [np.lexsort(np.round(v, 1).T) for v in (expected, shown)]
            np.testing.assert_allclose(shown[order[1]].sum(axis=0), expected.sum(axis=0), atol=0.05)
            np.testing.assert_allclose(np.sort(shown, axis=0), np.sort(expected, axis=0), atol=1e-3)
            assert source(page, "after_0_key")["title"][0].startswith(title)
            before = source(page, "earlier")
            if title == "geometry calibrated":
                assert len(before["r0"]) == len(source(page, "gained")["v"]) == 0
            else:
                np.testing.assert_allclose(before["r1"], base[:, 1], atol=1e-3)
                np.testing.assert_allclose(before["v"], data.joints[:, 1], rtol=1e-6)
        assert (
            page.evaluate("Bokeh.documents.map(d => d.get_model_by_name('against_axis')).find(Boolean).axis_label")
            == "q2, mm"
        )


@pytest.mark.slow
@needs_browser
def test_what_has_no_number_does_not_run(demo: Path, tmp_path: Path) -> None:
    """Catches a policy that lets a script run which came in by a name, or one that is not there; see the others for one
    that keeps Bokeh from drawing."""
    text = (demo / "demo" / "report.html").read_text(encoding="utf-8")
    owned = "<script>window.owned = 1</script><img src=x onerror='window.owned = 2'><a href='javascript:owned = 3'></a>"
    (tmp_path / "owned.html").write_text(text.replace("<h2>Where", f"{owned}<h2>Where", 1), encoding="utf-8")
    with pytest.raises(AssertionError), opened(tmp_path / "owned.html") as page:  # noqa: PT012
        page.evaluate("document.querySelector('a[href^=javascript]').click()")
        settled(page)
        owns = page.evaluate("window.owned")
    assert owns is None
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)
    assert "default-src &#39;none&#39;" in policy[1]
    assert text.index(policy[0]) < text.index("<script")


@needs_browser
def test_the_report_of_a_tool_has_the_same_policy(tmp_path: Path) -> None:
    """Catches a page of its own making: without a policy, or with one under which Bokeh draws nothing."""
    t = np.linspace(0.0, 1.0, 50)
    drawn = EstimateOverTime(
        time_s=t, estimate=t, std=0.1 * t, name="insertion depth", unit="mm", others={}, force_mN=t, threshold_mN=50.0
    )
    answer = Answer("a </title> tool", "<img src=x onerror='owned = 1'>")
    write_estimate(tmp_path / "tool.html", answer, drawn, [], Made("<script>owned = 2</script>"))
    text = (tmp_path / "tool.html").read_text(encoding="utf-8")
    assert text.index("Content-Security-Policy") < text.index("<script")
    with opened(tmp_path / "tool.html") as page:
        assert page.evaluate("Bokeh.documents.length") == 1
        assert page.evaluate("window.owned") is None


@needs_browser
def test_reads_without_javascript(demo: Path) -> None:
    """Catches a verdict, a figure or a table that only a script writes, and a page without any picture then."""
    with opened(demo / "demo" / "report.html", javascript=False) as page:
        assert page.inner_text("#answer").startswith("The model lacks rail_lean.")
        assert page.inner_text("pre.command").startswith("sherkit calibrate ")
        # a long command is read to its end, on paper too
        wide = """() => {
            const made = document.querySelector("#command"); made.closest("details").open = true
            made.textContent += " run_of_another_day.csv".repeat(40)
            return made.clientWidth > 300 ? made.scrollWidth - made.clientWidth : "not shown"
        }"""
        for media in ("print", "screen"):
            page.emulate_media(media=media)
            assert page.evaluate(wide) == 0, media
        assert "µm" in page.inner_text("#bar_before")
        assert len(cells_without(page, "#candidates")) == 6
        page.locator("summary", has_text="What the verdict rests on").click()
        assert page.inner_text("#verdict").startswith("explained:")
        box = page.locator("noscript svg").bounding_box()
        assert box["width"] > 300
        assert box["height"] > 100


def cells_without(page: Any, table: str) -> Sequence[str]:
    """Rows of a table where the page runs no script."""
    return page.locator(f"{table} tr").all_inner_texts()


@pytest.mark.slow
@needs_browser
def test_the_page_as_it_is_opened(demo: Path, tmp_path: Path, in_each_font: InEachFont) -> None:
    """Catches an answer that must be scrolled to, and parts that nobody asked for and are open: the first screen says
    what is missing, how much it brings and what to do, three and a half hold all that is open, in the widest font too;
    the contents lead to what is folded. A table or picture that makes the whole page scroll sideways. A button of the
    toolbar that saves nothing, or an empty picture."""
    with opened(demo / "demo" / "report.html") as page:

        def top(selector: str) -> float:
            return float(page.evaluate(f"document.querySelector('{selector}').getBoundingClientRect().top"))

        def fits() -> None:
            for width, height in ((800, 900), (1200, 900), (1920, 1080), (1440, 900)):
                page.set_viewport_size({"width": width, "height": height})
                settled(page)
                assert page.evaluate("document.documentElement.scrollWidth") <= width
                if width > 1200:
                    for one in ("#answer", "pre.command", "#bar_after"):
                        assert 0 < top(one) < height - 50
                    assert top(".folded") <= 3.5 * height

        in_each_font(page, fits)
        for kind, start in (("PNG", b"\x89PNG"), ("SVG", b"<svg")):
            with page.expect_download() as saved:
                page.locator(f"[title='save as {kind}']").first.click()
            saved.value.save_as(tmp_path / kind)
            content = (tmp_path / kind).read_bytes()
            assert content.startswith(start)
            assert len(content) > 5000
        page.locator(".contents a", has_text="What it rests on").click()
        assert page.locator("#rests[open] #verdict").is_visible()
        assert -1 < top("#rests") < 900


# -- other runs ----------------------------------------------------------------------------------------------


def report(folder: Path, name: str, *arguments: str) -> str:
    """The text of a report that a command wrote."""
    done(folder, *arguments, "--report", name)
    return words(folder / name)


def words(file: Path) -> str:
    """The text of a report, without its scripts."""
    text = file.read_text(encoding="utf-8")
    return re.sub(
        r"\s+", " ", unescape(re.sub(r"<[^>]*>", " ", re.sub(r"<(script|style).*?</\1>", "", text, flags=re.S)))
    )


def inside(file: Path, name: str = "diagnosis") -> Any:
    """JSON that a report carries; that of the diagnosis is what ``--json`` prints, see above."""
    found = re.search(rf'id="{name}">(.*?)</script>', file.read_text(encoding="utf-8"), flags=re.S)
    return json.loads(found[1])


@pytest.mark.slow
def test_calibration_with_a_local_run_an_effect_and_a_loss(runs: Path) -> None:
    """Catches a report that refits with another loss or without the effect, or hides the second run."""
    arguments = (
        "calibrate", "robot.toml", "leaning.csv", "--local", "local.csv", "--effect", "rail_lean", "--loss", "huber",
    )  # fmt: skip
    told = json.loads(done(runs, *arguments, "--json", "--report", "calibrated.html"))
    text = words(runs / "calibrated.html")
    rod = next(p for p in told["whole"]["parameters"] if p["name"] == "rod_length_1")
    assert f"rod_length_1 δl₁ {with_error(rod['value'], rod['std'])[0]}" in text
    assert "the region of interest" in text
    assert f"{number(told['local']['rms_um']['before']['x'])} ±" in text
    assert "adequate: no effect is missing" in text
    assert "with rail_lean" in text
    assert "geometry calibrated: " not in text
    assert "local.csv SHA-256" in text
    assert "sk.load_calibration" in text


@pytest.mark.slow
def test_calibration_of_some_parameters(runs: Path) -> None:
    """Catches a report that frees other parameters than the command did."""
    # nothing else is wrong with it: for all that the others would take, a search through pairs of effects would go
    only = sk.delta.VirtualDelta.draw(EXAMPLE, 3, sizes={"rod_length": 0.5}, noise_mm=0.005)
    only.measure(grid(18.0, 6, (-15.0, 0.0, 15.0)), repeats=2, order="shuffled", seed=1).save(runs / "rods.csv")
    arguments = ("calibrate", "robot.toml", "rods.csv", "--free", "rod_length_1,rod_length_2,rod_length_3")
    text = report(runs, "free.html", *arguments)
    part = text[text.index("The parameters, and how well") : text.index("What the verdict rests on")]
    assert "rod_length_3" in part
    assert "base_radius_1 δ" not in part


def test_nothing_missing(runs: Path) -> None:
    """Catches a picture that shows an effect as added where none was, and a lost table of what would be found."""
    text = report(runs, "plain.html", "diagnose", "robot.toml", "plain.csv")
    assert "adequate: no effect is missing" in text
    assert "would have been found" in text
    assert inside(runs / "plain.html", "swaps")["state"] == 0


@pytest.mark.slow
def test_a_tie_and_an_unknown_noise(runs: Path) -> None:
    """Catches a tie that is not told, poses that are not listed, and a noise that nobody knows given as a figure."""
    text = report(runs, "plane.html", "diagnose", "robot.toml", "plane.csv")
    found = inside(runs / "plane.html")
    assert found["indistinguishable"]
    for tie in found["indistinguishable"]:
        assert f"{' or '.join(tie)} : these poses cannot tell" in text
    pose = found["next_poses"][0]
    numbers = [f"{v:.6g}" for name, v in pose.items() if name != "separation_sigma"]
    assert list(pose)[:3] == ["q1_mm", "q2_mm", "q3_mm"]
    assert f"1 {' '.join(numbers)} {pose['separation_sigma']:.1f}" in text
    assert "unknown: neither repeats nor declared" in text
    assert "noise of a reading 1" not in text
    assert "Dotted: the noise" not in text
    assert "would leave 95 of 100 arrows" not in text


@pytest.mark.slow
def test_what_no_effect_explains(runs: Path) -> None:
    """Catches a signature that is not told, and a verdict that claims more."""
    text = report(runs, "strange.html", "diagnose", "robot.toml", "strange.csv")
    found = inside(runs / "strange.html")
    assert found["signature"] is not None
    assert f"{found['verdict']}:" in text
    assert "What no effect explains:" in text
    assert "--template my_effects.py" in text


@pytest.mark.slow
@needs_browser
def test_heights_alone(runs: Path) -> None:
    """Catches pictures that need three coordinates."""
    text = report(runs, "heights.html", "diagnose", "robot.toml", "heights.csv")
    assert "An arrow and its colour show the error in z" in text
    with opened(runs / "heights.html") as page:
        a = source(page, "after_0")
        assert max(map(abs, a["ex"])) == 0
        assert a["ey"] == a["ez"] == a["colour"]
        assert max(map(abs, a["ey"])) > 1


@pytest.mark.slow
@needs_browser
def test_distances_alone(runs: Path) -> None:
    """Catches pictures that need coordinates, all arrows at one place, and words of readings that were not taken."""
    text = report(runs, "distances.html", "diagnose", "robot.toml", "distances.csv")
    assert "An arrow and its colour show the error in distance" in text
    with opened(runs / "distances.html") as page:
        a = source(page, "after_0")
        assert max(map(abs, a["ex"])) == 0
        assert np.ptp(a["x"]) > 20
        assert np.ptp(a["y"]) > 20


@pytest.mark.slow
@needs_browser
def test_twenty_thousand_rows(runs: Path) -> None:
    """Catches a report that grows with the run, or hides that it thins."""
    poses = np.random.default_rng(3).uniform(-20, 20, (4000, 3))
    virtual(6, 8e-3).measure(poses, repeats=5, seed=6).save(runs / "many.csv")
    text = report(runs, "many.html", "diagnose", "robot.toml", "many.csv")
    # whole poses of the run, and of these as many points as can be told apart
    kept = re.search(r"Drawn are (\d+) of the 20000 rows", text)
    assert 6000 <= int(kept[1]) < 6050
    assert f"3000 of {kept[1]} are drawn" in text
    assert "it is the mean of a cell" in text
    assert (runs / "many.html").stat().st_size < 5e6
    with opened(runs / "many.html") as page:
        assert page.text_content("#verdict").strip().startswith("explained:")


@pytest.mark.slow
@needs_browser
def test_texts_of_files_are_texts(runs: Path) -> None:
    """Catches names of files, columns or effects, and descriptions, that become markup or scripts."""
    frame = sk.read_measurements(runs / "leaning.csv").to_frame()
    rng = np.random.default_rng(0)
    name = "it's \"<b id=bold>&amp;.csv"
    frame.with_columns(*(pl.Series(c, rng.normal(size=len(frame))) for c in HOSTILE)).write_csv(runs / name)
    (runs / "my_effects.py").write_text(EFFECT, encoding="utf-8")
    done(
        runs, "diagnose", "robot.toml", name, "--effects", "my_effects.py", "--effect", "heave", "--report",
        "hostile.html",
    )  # fmt: skip
    with opened(runs / "hostile.html") as page:
        assert name in page.inner_text("h1 + .note")
        assert page.locator("#bold, img, b[id]:not(.bars b)").count() == 0
        options = page.locator("#variable option").all_text_contents()
        assert set(HOSTILE) <= set(options)
        unfold(page)
        page.select_option("#variable", label=HOSTILE[1])
        settled(page)
        assert len(source(page, "points")["v"]) == len(frame)
        assert "+ heave" in page.inner_text("#state")
        assert "'it'\"'\"'s " in page.inner_text("#command")


# -- without Bokeh -------------------------------------------------------------------------------------------


#: Python in which Bokeh is not installed; the demo with fewer poses than the paper has.
_WITHOUT = """
import importlib, sys
sys.modules["bokeh"] = None
import sherkit as sk
from sherkit.cli import main
poses = sk.delta.paper_whole()[::5]
demo = importlib.import_module("sherkit.cli.demo")
demo.paper_whole, demo.paper_local = lambda: poses, lambda: poses / 2
for arguments in (["calibrate", "missing.toml", "missing.csv", "--report", "x.html"], ["demo", "-o", "bare"]):
    try: main(arguments)
    except SystemExit as end: print("ended with", end.code, file=sys.stderr)
study = sk.Study(sk.load_robot("robot.toml"), sk.read_measurements("leaning.csv"))
print("a notebook shows", study._repr_html_(), study.fit._repr_html_())
"""


@pytest.mark.slow
def test_without_bokeh(runs: Path) -> None:
    """Catches an import of Bokeh by what works without it, and a report that fails only after minutes of work."""
    told = subprocess.run(
        [sys.executable, "-W", "error", "-c", _WITHOUT], cwd=runs, capture_output=True, encoding="utf-8", timeout=600
    )
    assert told.returncode == 0, told.stderr
    assert "Traceback" not in told.stderr
    report, demo, _ = re.split(r"(?<=ended with \d\n)", told.stderr)
    assert "pictures need the extra 'view' (bokeh is not installed): pip install \"sherkit[view]\"" in report
    assert report.endswith("ended with 1\n")
    assert "no report was written" in demo
    assert demo.endswith("ended with 0\n")
    assert (runs / "bare" / "calibrated.toml").exists()
    assert not (runs / "bare" / "report.html").exists()
    # a notebook shows the study's text and the fit's table where there is nothing to draw with
    assert "a notebook shows None <pre>fit " in told.stdout
