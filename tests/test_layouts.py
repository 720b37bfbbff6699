"""The page of every verb as it lies on a screen: the answer first, nothing scrolls sideways, no text of a drawing lies
on another or is cut, in whichever font a machine has."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from browsing import InEachFont, needs_browser, opened, settled
from pages_of_verbs import COMMANDS, PAGES

pytestmark = needs_browser
#: Screens: a phone held upright, a tablet, laptops, a desk.
WIDTHS = (390, 800, 1200, 1440, 1920)
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


#: What of the answer ends above a line of the page, px, and whether the contents are cut on the left.
_ABOVE = """most => {
    const ends = e => e.getBoundingClientRect().bottom + scrollY <= most && e.getBoundingClientRect().left >= 0
    const said = selector => [...document.querySelectorAll(selector)].filter(ends).map(e => e.innerText).join("\\n")
    return {headline: said("h1"), size: said("h1, .answer p, .bars b"), command: said("pre.command"),
            cut: [...document.querySelectorAll(".contents a")].filter(e => e.getBoundingClientRect().left < 0).length}
}"""
#: A number with its unit.
_SIZE = r"\d\S*( ± \S+)? ?(µm|mm|°|mrad|px)"


@pytest.fixture(scope="module")
def page_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The page of a verb, made once."""

    @cache
    def made(name: str) -> Path:
        folder = tmp_path_factory.mktemp(name)
        PAGES[name](folder)
        return folder / "page.html"

    return made


@pytest.mark.parametrize("name", PAGES)
def test_a_page_fits_its_screen(name: str, page_of: Callable[[str], Path], in_each_font: InEachFont) -> None:
    """Catches a table, a picture or a word that makes a whole page scroll sideways, and texts of a drawing that a wider
    font lays on one another or cuts."""
    drawn = name not in ("printer", "effects")
    with opened(page_of(name), pictures=drawn) as page:

        def fits() -> None:
            for width in WIDTHS:
                page.set_viewport_size({"width": width, "height": 900})
                if drawn:
                    settled(page)
                assert page.evaluate("document.documentElement.scrollWidth") <= width, width
                assert page.evaluate(_TEXTS) == [], width

        in_each_font(page, fits)


@pytest.mark.parametrize("width", [1440, 390])
@pytest.mark.parametrize("name", [name for name in PAGES if name != "effects"])
def test_the_answer_is_above_the_fold(name: str, width: int, page_of: Callable[[str], Path]) -> None:
    """Catches a page that begins with its file, hides what to type below pictures, or cuts its contents."""
    with opened(page_of(name), width=width, height=900, pictures=name != "printer") as page:
        seen = page.evaluate(_ABOVE, 900)
        assert seen["headline"], name
        assert not seen["headline"].endswith((".csv", ".toml")), name
        assert re.search(_SIZE, seen["size"]), (name, seen["size"])
        assert seen["command"].startswith("sherkit ") == (name in COMMANDS), (name, seen["command"])
        assert width < 1000 or not seen["cut"]
