"""Short pages of their own as they lie on a screen: nothing scrolls sideways, no text of a drawing lies on another or
is cut, in whichever font a machine has."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import sherkit as sk
from browsing import InEachFont, needs_browser, opened, settled
from changed_worlds import DeltaPair
from test_docs import sherkit

pytestmark = needs_browser
#: Screens: a phone held upright, a tablet, laptops, a desk.
WIDTHS = (400, 800, 1200, 1920)
#: Texts of drawings that lie on one another, or reach out of their drawing.
_TEXTS = """() => [...document.querySelectorAll("svg")].flatMap(svg => {
    const frame = svg.getBoundingClientRect()
    const texts = [...svg.querySelectorAll("text")].filter(t => t.textContent.trim())
        .map(t => ({text: t.textContent.trim(), box: t.getBoundingClientRect()}))
    const out = texts.filter(({box}) => box.left < frame.left - 1 || box.right > frame.right + 1)
        .map(({text}) => "cut: " + text)
    texts.forEach((a, k) => texts.slice(k + 1).forEach(b => {
        const across = Math.min(a.box.right, b.box.right) - Math.max(a.box.left, b.box.left)
        const down = Math.min(a.box.bottom, b.box.bottom) - Math.max(a.box.top, b.box.top)
        if (across > 1 && down > 4) out.push(a.text + " lies on " + b.text)
    }))
    return out
})"""


@pytest.fixture(scope="module")
def bumped() -> sk.changes.Comparison:
    """A delta one of whose rails was turned."""
    return DeltaPair(3, ("base_angle_2",), 4.0, poses=(60, 40)).compare()


def printer(made: Path, file: Path, _: sk.changes.Comparison) -> None:
    sherkit(["printer", str(made / "printer.cfg"), "--report", str(file)], file.parent)


def card(made: Path, file: Path, _: sk.changes.Comparison) -> None:
    sherkit(["effects", "rail_lean", "--robot", str(made / "robot.toml"), "--picture", str(file)], file.parent)


def comparison(_: Path, file: Path, found: sk.changes.Comparison) -> None:
    from sherkit.report.stories import write_comparison

    write_comparison(file, found, "What has changed of the robot since before.csv?")


def course(_: Path, file: Path, __: sk.changes.Comparison) -> None:
    from sherkit.report.stories import write_history

    world = DeltaPair(3, ("base_angle_2",), 4.0, poses=(60, 40))
    found = sk.history(world.robot, world.runs, dates=["2026-01-31", "2026-02-28"])
    write_history(file, found, "The course of the robot")


PAGES: dict[str, Callable[[Path, Path, sk.changes.Comparison], None]] = {
    one.__name__: one for one in (printer, card, comparison, course)
}


@pytest.mark.parametrize("name", PAGES)
def test_a_page_fits_its_screen(
    name: str, made: Path, bumped: sk.changes.Comparison, tmp_path: Path, in_each_font: InEachFont
) -> None:
    """Catches a table, a picture or a word that makes a whole page scroll sideways, and texts of a drawing that a wider
    font lays on one another or cuts."""
    PAGES[name](made, tmp_path / "page.html", bumped)
    with opened(tmp_path / "page.html", pictures=name in ("comparison", "course")) as page:

        def fits() -> None:
            for width in WIDTHS:
                page.set_viewport_size({"width": width, "height": 900})
                if name in ("comparison", "course"):
                    settled(page)
                assert page.evaluate("document.documentElement.scrollWidth") <= width, width
                assert page.evaluate(_TEXTS) == [], width

        in_each_font(page, fits)
