"""The page in a real browser: the command serves it, a person clicks."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sherkit as sk
from browsing import InEachFont, chromium, needs_browser, source
from sherkit import save_robot
from sherkit.base.figures import number
from sherkit.cli.demo import EXAMPLE
from sherkit.robots.delta.robot import grid
from sherkit.robots.delta.virtual import VirtualDelta

pytestmark = needs_browser
_WAIT_MS = 600_000
#: A ramp in x that no effect of the catalogue has, as lines that a person types.
OWN = '''import numpy as np
import sherkit as sk

@sk.effect(at="body", parameters={"slope": "mm"})
def floor_ramp(rows, p):
    """The floor sinks along x."""
    return p.slope * np.outer(np.sin(rows.position[:, 0] / 7.0), [0, 0, 1])
'''


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot, a small run with leaning rails and a bias in z that no effect of the catalogue has, and more of it."""
    folder = tmp_path_factory.mktemp("lab")
    save_robot(EXAMPLE, folder / "robot.toml")
    virtual = VirtualDelta.draw(EXAMPLE, 6, rail_lean_rad=8e-3, noise_mm=0.005)
    poses = grid(20.0, 6, (-18.0, 0.0, 18.0))
    virtual.measure(poses, repeats=2, seed=1).save(folder / "run.csv")
    more = virtual.measure(poses[::2], repeats=2, seed=2).to_frame()
    end = float(sk.read_measurements(folder / "run.csv").time_s.max())
    more.with_columns(more["time_s"] + end + 60.0).write_csv(folder / "more.csv")
    return folder


@dataclass
class Served:
    """The running command and its page's address."""

    process: subprocess.Popen[str]
    url: str


@contextmanager
def serving(lab: Path, *options: str, run: str = "run.csv") -> Iterator[Served]:
    """``sherkit app`` on a run of the lab, ended by Ctrl-C."""
    program = [sys.executable, "-X", "faulthandler", "-c", "from sherkit.cli import main; main()"]
    command = [*program, "app", "robot.toml", run]
    process = subprocess.Popen(
        [*command, "--no-open", "--port", "0", *options], cwd=lab, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        said = process.stdout.readline()
        found = re.search(r"http://\S+", said)
        if found is None:
            process.wait(600)
            raise AssertionError(said + process.stderr.read())
        yield Served(process, found[0])
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=120)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGABRT)  # says where each thread stands
            raise AssertionError("Ctrl-C did not end it:\n" + process.communicate()[1]) from None


@pytest.fixture(scope="module")
def app(lab: Path) -> Iterator[Served]:
    """One server for tests that leave its study as it began (see :func:`begun`): starting one takes seconds."""
    with serving(lab, "--study", "shared.study") as served:
        yield served


@contextmanager
def seen(url: str, *, ends: bool = False) -> Iterator[Any]:
    """The page in Chromium; no request may leave the machine, and nothing may complain.

    Where the server ``ends``, Chromium tells of the connection that is gone.
    """
    outside: list[str] = []
    complaints: list[str] = []
    host = url.split("/")[2]
    context = chromium().new_context(viewport={"width": 1720, "height": 1700}, accept_downloads=True)
    try:
        context.on(
            "request",
            lambda r: (
                None if r.url.startswith(("data:", "blob:")) or r.url.split("/")[2] == host else outside.append(r.url)
            ),
        )
        page = context.new_page()
        page.set_default_timeout(_WAIT_MS)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda m: complaints.append(m.text) if m.type == "error" else None)
        page.goto(url)
        yield page
    finally:
        context.close()
    assert outside == [], "a request left the machine"
    assert [c for c in complaints if not (ends and re.search("websocket|not connected", c, re.IGNORECASE))] == []


def text(page: Any, name: str) -> str:
    """What a named field of the page says, without markup."""
    said = page.evaluate("name => Bokeh.documents[0].get_model_by_name(name).text", name)
    return re.sub(r"<[^>]+>", " ", said)


def button(page: Any, label: str) -> Any:
    """A button by what stands on it."""
    return page.get_by_role("button", name=label, exact=True)


def wait_for(page: Any, name: str, part: str) -> None:
    """Waits until a named field says something."""
    page.wait_for_function(
        """([name, part]) => {
            const said = Bokeh.documents[0]?.get_model_by_name(name)?.text ?? ""
            return new DOMParser().parseFromString(said, "text/html").body.textContent.includes(part)
        }""",
        arg=[name, part],
    )


def diagnosed(page: Any) -> None:
    """Waits until nothing is being done."""
    page.wait_for_function("Bokeh.documents[0]?.get_model_by_name('status')?.text == 'Ready.'")
    page.wait_for_function("Bokeh.documents[0].get_model_by_name('headline').text.includes('verdict')")


#: What the button that takes a step back says, null where there is none.
_UNDOES = "(u => u.visible ? u.label : null)(Bokeh.documents[0].get_model_by_name('undo'))"


def begun(page: Any) -> None:
    """Takes back what an earlier test did to the study, and waits until nothing is being done."""
    diagnosed(page)
    while label := page.evaluate(_UNDOES):
        button(page, label).click()
        page.wait_for_function(f"said => {_UNDOES} != said", arg=label)
        diagnosed(page)


def arrows(page: Any) -> np.ndarray:
    """The arrows of the current state: error at each pose, µm."""
    columns = [source(page, f"after_{k}") for k in range(3)]
    return np.concatenate([np.stack([c["ex"], c["ey"], c["ez"]], axis=1) for c in columns])


def arrows_are_of(page: Any, fit: sk.fit.Fit) -> None:
    """That they are those of a fit: heights come to the page one after another."""
    expected, until = expected_arrows(fit), time.monotonic() + 60.0
    while not np.allclose(arrows(page), expected, atol=0.02) and time.monotonic() < until:
        page.wait_for_timeout(20)
    np.testing.assert_allclose(arrows(page), expected, atol=0.02)


def expected_arrows(fit: sk.fit.Fit) -> np.ndarray:
    """The same from the fit: means of what is left over the repeats of each pose, each height from above."""
    left, data = fit.residuals[:, :3] * 1e3, fit.data
    level = np.round(fit.predicted[:, 2] / 18.0)
    out = []
    for height in (1, 0, -1):
        for pose in np.unique(data.pose[level == height]):
            out.append(left[(data.pose == pose) & (level == height)].mean(axis=0))
    return np.array(out)


def test_the_hidden_effect_leads_and_a_click_adds_it(app: Served, lab: Path) -> None:
    """Catches a page whose list, number, map and fall do not move to the state that was chosen."""
    robot, data = sk.load_robot(lab / "robot.toml"), sk.read_measurements(lab / "run.csv")
    study = sk.Study(robot, data)
    with seen(app.url) as page:
        button(page, "+ rail_lean").wait_for()
        begun(page)
        first = page.get_by_role("button").filter(has_text=re.compile(r"^\+ ")).first
        assert first.inner_text() == "+ rail_lean"
        assert "explained" in text(page, "headline")
        assert f" {number(study.history[0].error.rms)} " in text(page, "numbers")
        arrows_are_of(page, study.fit)

        study.add("rail_lean")
        button(page, "+ rail_lean").click()
        button(page, "✓ rail_lean").wait_for()
        wait_for(page, "numbers", f"{study.history[-1].error.rms:.2f}")
        # the pictures come after the answer, one table after the other
        page.wait_for_function("Math.abs(Bokeh.documents[0].get_model_by_name('after_0').data.ex[0]) < 20")
        for _ in range(100):
            if np.allclose(arrows(page), expected_arrows(study.fit), atol=0.02):
                break
            page.wait_for_timeout(100)
        arrows_are_of(page, study.fit)
        page.wait_for_function("Bokeh.documents[0].get_model_by_name('steps').data.action.length == 2")
        steps = source(page, "steps")
        assert steps["action"] == ["geometry calibrated", "+ rail_lean"]
        np.testing.assert_allclose(steps["held_x"], [s.error.by_reading["x_mm"] for s in study.history], rtol=1e-6)
        diagnosed(page)
        assert "adequate" in text(page, "headline")

        # two states compared the other way round
        page.get_by_label("with", exact=True).select_option(label="geometry calibrated")
        page.wait_for_function(
            "Math.abs(Bokeh.documents[0].get_model_by_name('after_0').data.ex[0]) > 20", timeout=_WAIT_MS
        )
        arrows_are_of(page, study.history[0].fit)
        page.get_by_label("with", exact=True).select_option(label="+ rail_lean")

        # against another variable
        page.get_by_label("Residual against").select_option(label="time, s")
        page.wait_for_function("Math.max(...Bokeh.documents[0].get_model_by_name('points').data.v) > 200")
        np.testing.assert_allclose(sorted(source(page, "points")["v"]), np.sort(data.time_s), rtol=1e-5)


@pytest.mark.slow
def test_what_was_taken_back_is_there_again_and_folded(app: Served) -> None:
    """Catches a step that cannot be taken back, or made again, and a path that shows what was taken back unasked."""
    with seen(app.url) as page:
        button(page, "+ rail_lean").wait_for()
        begun(page)
        button(page, "+ rail_lean").click()
        button(page, "✓ rail_lean").wait_for()
        # click again: removed; undo: there again
        button(page, "✓ rail_lean").click()
        button(page, "+ rail_lean").wait_for()
        button(page, "Undo: − rail_lean").click()
        button(page, "✓ rail_lean").wait_for()
        button(page, "Redo: − rail_lean").wait_for()
        # what was taken back is folded
        page.wait_for_function("Bokeh.documents[0].get_model_by_name('steps').data.action.length == 2")
        button(page, "Show what was taken back").click()
        page.wait_for_function("Bokeh.documents[0].get_model_by_name('steps').data.action.length == 4")


@pytest.mark.slow
def test_nothing_is_cut_off_at_the_widths_of_screens(app: Served) -> None:
    """Catches what is pressed below the edge of a header whose answer is long, and maps cut at the right."""
    with seen(app.url) as page:
        begun(page)
        diagnosed(page)
        page.evaluate(
            "Bokeh.documents[0].get_model_by_name('headline').text = 'The model lacks this and that. '.repeat(40)"
        )
        for width in (1200, 1280, 1300, 1400, 1500, 1920):
            page.set_viewport_size({"width": width, "height": 900})
            at_rest(page, "() => document.querySelector('.top').offsetHeight", None)
            middles = page.evaluate("[...document.querySelectorAll('.middle')].map(e => e.scrollWidth - e.clientWidth)")
            assert max(middles) <= 0, width
            header, body, status = (page.locator(one).bounding_box() for one in (".top", ".body", "text=Ready."))
            assert status["y"] + status["height"] <= header["y"] + header["height"] <= body["y"], width


@pytest.mark.slow
def test_what_has_no_number_does_not_run(app: Served) -> None:
    """Catches a policy that lets a script run which is not the page's own."""
    with pytest.raises(AssertionError), seen(app.url) as page:  # noqa: PT012
        page.locator("#verdict").wait_for()
        page.evaluate(
            """() => {
                const made = document.createElement("script")
                made.textContent = "window.owned = 1"
                document.body.append(made)
                document.body.insertAdjacentHTML("beforeend", "<img src=x onerror='window.owned = 2'>")
            }"""
        )
        page.wait_for_timeout(300)
        owns = page.evaluate("window.owned")
    assert owns is None


def test_the_policy_comes_with_the_page(app: Served) -> None:
    """Catches a policy that is not there, and a page that stands in another one."""
    with urllib.request.urlopen(app.url, timeout=60) as answer:
        assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert answer.headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.slow
def test_what_was_typed_and_marked_outlives_a_crash(lab: Path) -> None:
    """Catches lines that do not become a button, wrong lines that break the page or change the study, rows that are
    listed wrongly, a mark that is lost, and a study that is not there after a crash."""
    with serving(lab, "--fresh") as app, seen(app.url, ends=True) as page:
        diagnosed(page)
        button(page, "An effect of your own …").click()
        lines = page.get_by_label("Effects, as NumPy lines")
        for wrong, part in (
            ("x = 1 / 0", "ZeroDivisionError"),
            ("def (", "SyntaxError"),
            ("x = 1", "defines no effect"),
            (OWN.replace("floor_ramp", "slip"), "built-in"),
            (OWN.replace("[0, 0, 1])", "[0, 0, 1]) + 1"), "not zero where its parameters are zero"),
        ):
            lines.fill(wrong)
            button(page, "Run these lines").click()
            wait_for(page, "error_lines", part)
        assert source(page, "steps")["action"] == ["geometry calibrated"]
        lines.fill(OWN)
        button(page, "Run these lines").click()
        button(page, "+ floor_ramp").wait_for()
        for name in ("floor_ramp", "rail_lean"):
            button(page, f"+ {name}").click()
            button(page, f"✓ {name}").wait_for()
        diagnosed(page)

        typed = page.get_by_label("Rows by their number")
        typed.fill("5, 9-11")
        typed.press("Enter")
        wait_for(page, "selection", "4 rows")
        shown = re.findall(
            r"<tr><td>(\d+)</td>", page.evaluate("Bokeh.documents[0].get_model_by_name('selection').text")
        )
        assert shown == ["5", "9", "10", "11"]
        # the workspace knows a pose by any of its lines
        data = sk.read_measurements(lab / "run.csv")
        poses = data.pose[np.isin(data.line, [5, 9, 10, 11])]
        assert page.evaluate("window.sherkitChosen") == data.line[np.isin(data.pose, poses)].tolist()
        button(page, "Mark as outliers").click()
        wait_for(page, "headline", "4 marked")
        typed.fill("twelve")
        typed.press("Enter")
        wait_for(page, "error_rows", "expected numbers such as 12, 40-45")
        diagnosed(page)

        app.process.send_signal(signal.SIGKILL)
        wait_for(page, "error_history", "start it again with sherkit app robot.toml")
    # lines that were typed are text in the folder: they run again only where someone says so
    with pytest.raises(AssertionError, match="--run-typed"), serving(lab):
        pass
    with serving(lab, "--run-typed") as app, seen(app.url) as page:
        for name in ("floor_ramp", "rail_lean"):
            button(page, f"✓ {name}").wait_for()
        wait_for(page, "headline", "4 marked")
        page.wait_for_function(
            "Bokeh.documents[0].get_model_by_name('steps').data.action.at(-1) == '4 rows marked as outliers'"
        )
        button(page, "Undo: 4 rows marked as outliers").click()
        page.wait_for_function("!Bokeh.documents[0].get_model_by_name('headline').text.includes('marked')")
        diagnosed(page)


#: Where two values stand in the picture of residuals, whose tool is the box.
_FRAME = """([from, to]) => {
    const view = Bokeh.index.find_one(Bokeh.documents[0].get_model_by_name('against')).child_views[0]
    const plot = [...view.child_views].map(v => v.grid_box_view ?? v).flatMap(v => v.child_views ?? [v])
        .find(v => v.model.type == 'Figure')
    plot.model.toolbar.tools.forEach(t => { if (t.type == 'BoxSelectTool') t.active = true })
    const box = plot.el.getBoundingClientRect(), frame = plot.frame
    const x = v => box.left + frame.x_scale.compute(v)
    return {x0: x(from), x1: x(to), top: box.top + frame.bbox.top + 2, bottom: box.top + frame.bbox.bottom - 2}
}"""


def at_rest(page: Any, what: str, given: Any) -> dict[str, float]:
    """What a script gives once it has given the same for half a second."""
    before, same = page.evaluate(what, given), 0
    while same < 5:
        page.wait_for_timeout(100)
        now = page.evaluate(what, given)
        before, same = now, same + 1 if now == before else 0
    out: dict[str, float] = before
    return out


def said_so(page: Any, expected: str) -> bool:
    """Whether the selection says this, a fifth of a second later."""
    page.wait_for_timeout(200)
    return expected in text(page, "selection")


@pytest.mark.slow
def test_points_are_brushed_with_the_mouse(app: Served, lab: Path, in_each_font: InEachFont) -> None:
    """Catches a brush that lists other rows than those inside its box, wherever a font puts the picture."""
    data = sk.read_measurements(lab / "run.csv")
    fit = sk.Study(sk.load_robot(lab / "robot.toml"), data).fit
    with seen(app.url) as page:
        begun(page)
        page.get_by_label("Residual against").select_option(label="z, mm")
        page.wait_for_function(
            """() => [...Bokeh.documents[0].get_model_by_name('against').references()]
                .some(m => typeof m.axis_label == 'string' && m.axis_label.startsWith('z, mm'))
                && Bokeh.index.roots.every(v => v.is_idle)"""
        )
        height = fit.predicted[:, 2]
        boxes = iter(((15.0, 25.0), (-5.0, 25.0), (-5.0, 5.0)))

        def brushed() -> None:
            ends = next(boxes)
            expected = f"{int(((height > ends[0]) & (height < ends[1])).sum())} rows"
            # pictures are laid out anew as they come in: the box is drawn where its frame has come to rest
            place = at_rest(page, _FRAME, ends)
            for _ in range(5):
                page.mouse.move(place["x0"], place["top"])
                page.mouse.down()
                page.mouse.move(place["x1"], place["bottom"], steps=8)
                page.mouse.up()
                # what the box before said stands until this one is heard; a layout that moved took it elsewhere
                if any(said_so(page, expected) for _ in range(100)):
                    break
                place = at_rest(page, _FRAME, ends)
            assert expected in text(page, "selection")

        in_each_font(page, brushed)


@pytest.mark.slow
def test_measurements_are_joined_and_bad_ones_refused(app: Served, lab: Path) -> None:
    """Catches a bad file that changes the study, and a good one whose rows are not fitted."""
    rows = len(sk.read_measurements(lab / "run.csv")) + len(sk.read_measurements(lab / "more.csv"))
    (lab / "bad.csv").write_text("q1_mm,q2_mm,q3_mm,x_mm\n1,2,3,four\n")
    with seen(app.url) as page:
        begun(page)
        (lab / "empty.csv").write_text("")
        page.locator("input[type=file]").set_input_files(lab / "empty.csv")
        wait_for(page, "error_files", "empty.csv: is empty")
        page.locator("input[type=file]").set_input_files(lab / "bad.csv")
        wait_for(page, "error_files", "'four' is not a number")
        page.locator("input[type=file]").set_input_files(lab / "run.csv")
        wait_for(page, "error_files", "are in")
        page.locator("input[type=file]").set_input_files(lab / "more.csv")
        wait_for(page, "headline", f"{rows} rows")
        page.wait_for_function(
            "Bokeh.documents[0].get_model_by_name('steps').data.action.at(-1).endsWith('rows joined')"
        )
        diagnosed(page)


@pytest.mark.slow
def test_what_is_exported_is_the_state_that_is_seen(app: Served, lab: Path, tmp_path: Path) -> None:
    """Catches a calibration, a report or a study of another state than the one on the page."""
    study = sk.Study(sk.load_robot(lab / "robot.toml"), sk.read_measurements(lab / "run.csv"))
    study.add("rail_lean")
    with seen(app.url) as page:
        begun(page)
        button(page, "+ rail_lean").click()
        button(page, "✓ rail_lean").wait_for()
        diagnosed(page)
        page.get_by_text("Export …").click()
        for name, title in (("calibration.toml", "calibration"), ("report.html", "report"), ("study.zip", "study")):
            with page.expect_download() as download:
                page.get_by_role("link", name=f"the {title}").click()
            assert download.value.suggested_filename == name
            download.value.save_as(tmp_path / name)
        loaded = sk.load_calibration(tmp_path / "calibration.toml")
        for x in ([0.0, 0.0, 0.0], [10.0, -8.0, 12.0]):
            np.testing.assert_allclose(loaded.inverse(x), study.calibration().inverse(x), atol=1e-9)
        report = (tmp_path / "report.html").read_text(encoding="utf-8")
        assert 'id="verdict"' in report
        assert "rail_lean" in report
        with zipfile.ZipFile(tmp_path / "study.zip") as archive:
            archive.extractall(tmp_path / "study")
        assert sk.Study.load(tmp_path / "study").effects == ("rail_lean",)
        # another path is no page, and another origin gets no socket
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(app.url.rsplit("/", 2)[0] + "/", timeout=600)


FOCUSED = """() => {
    let e = document.activeElement
    while (e?.shadowRoot?.activeElement) e = e.shadowRoot.activeElement
    return e?.innerText || e?.title || e?.tagName || ''
}"""


@pytest.mark.slow
def test_a_keyboard_is_enough(lab: Path) -> None:
    """Catches a control that only a mouse reaches, and a focus that is lost when the list is drawn anew."""
    with serving(lab, "--fresh") as app, seen(app.url) as page:
        diagnosed(page)

        def focused() -> str:
            return page.evaluate(FOCUSED)

        def tab_to(label: str) -> None:
            for _ in range(80):
                if label in focused():
                    return
                page.keyboard.press("Tab")
            raise AssertionError(f"'{label}' is not reached by Tab")

        tab_to("+ rail_lean")
        page.keyboard.press("Enter")
        button(page, "✓ rail_lean").wait_for()
        # the focus comes back with the new list
        page.wait_for_function(f"({FOCUSED})().includes('✓ rail_lean')")
        diagnosed(page)
        page.keyboard.press("Space")
        button(page, "+ rail_lean").wait_for()
        diagnosed(page)
        tab_to("Export …")
        page.keyboard.press("Enter")
        tab_to("the calibration")


@pytest.mark.slow
def test_axe_finds_nothing_serious(app: Served, in_each_font: InEachFont) -> None:
    """Catches text that cannot be read, a control without a name, a region that a keyboard does not reach; a page that
    scrolls sideways on a desk or a tablet, in whichever font."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed").Axe()
    with seen(app.url) as page:
        begun(page)
        button(page, "+ rail_lean").click()
        button(page, "✓ rail_lean").wait_for()
        diagnosed(page)
        button(page, "An effect of your own …").click()
        page.get_by_label("Effects, as NumPy lines").wait_for()
        for width, height, scheme in (
            (1440, 900, "light"), (1440, 900, "dark"), (1024, 768, "light"), (400, 800, "light"), (400, 800, "dark")
        ):  # fmt: skip
            page.set_viewport_size({"width": width, "height": height})
            page.emulate_media(color_scheme=scheme)
            found = axe.run(page).response["violations"]
            serious = [
                (one["id"], one["impact"], [node["html"][:200] for node in one["nodes"][:3]])
                for one in found
                if one["impact"] in ("serious", "critical")
            ]
            assert serious == [], (width, scheme)

        def fits() -> None:
            for width in (1440, 1024, 400):
                page.set_viewport_size({"width": width, "height": 900})
                at_rest(page, "() => document.documentElement.scrollWidth", None)
                assert page.evaluate("document.documentElement.scrollWidth") <= width

        in_each_font(page, fits)


@pytest.mark.slow
def test_typing_effects_is_off_beyond_loopback(lab: Path) -> None:
    """Catches a page on the network that runs whatever is typed into it."""
    with serving(lab, "--fresh", "--address", "0.0.0.0") as app:
        url = app.url.replace("0.0.0.0", "127.0.0.1")
        with seen(url) as page:
            button(page, "An effect of your own …").click()
            page.get_by_text("Effects cannot be typed").wait_for()
            assert page.get_by_label("Effects, as NumPy lines").count() == 0


@pytest.mark.slow
def test_a_run_that_grows_is_followed(lab: Path) -> None:
    """Catches a page that does not see new rows, and half a line taken for a row."""
    lines = (lab / "run.csv").read_text().splitlines(keepends=True)
    (lab / "growing.csv").write_text("".join(lines[:121]))
    with serving(lab, "--fresh", "--follow", run="growing.csv") as app, seen(app.url) as page:
        wait_for(page, "headline", "120 rows")
        with (lab / "growing.csv").open("a") as file:
            file.write("".join(lines[121:]))
        wait_for(page, "headline", f"{len(lines) - 1} rows")
        diagnosed(page)
