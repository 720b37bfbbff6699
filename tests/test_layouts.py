"""The page of every verb as it lies on a screen: the answer first, nothing scrolls sideways, no text of a drawing lies
on another or is cut, in whichever font a machine has."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from browsing import FONTS, InEachFont, draw_in, has_font, needs_browser, opened, settled
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


#: Pages without a picture of Bokeh's.
STILL = ("printer", "effects")
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


def fits(page: Any, name: str, widths: Sequence[int]) -> None:
    """Nothing of an open page reaches out of a screen so wide, no text of a drawing out of it or over another."""
    for width in widths:
        page.set_viewport_size({"width": width, "height": 900})
        if name not in STILL:
            settled(page)
        assert page.evaluate("document.documentElement.scrollWidth") <= width, width
        assert page.evaluate(_TEXTS) == [], width


def answers_above(page: Any, name: str, width: int) -> None:
    """The first screen of an open page holds what was found, its size and what to type."""
    page.set_viewport_size({"width": width, "height": 900})
    seen = page.evaluate(_ABOVE, 900)
    assert seen["headline"], name
    assert not seen["headline"].endswith((".csv", ".toml")), name
    assert re.search(_SIZE, seen["size"]), (name, seen["size"])
    assert seen["command"].startswith("sherkit ") == (name in COMMANDS), (name, seen["command"])
    assert width < 1000 or not seen["cut"]


def test_a_page_fits_a_phone_and_a_laptop_in_the_widest_font(page_of: Callable[[str], Path]) -> None:
    """Catches what the next test does, on one page: all of them have its head, its tables and its pictures."""
    with opened(page_of("compare")) as page:
        for width in (1440, 390):
            answers_above(page, "compare", width)
        font = next(iter(FONTS))
        if has_font(page, font):
            draw_in(page, font)
        fits(page, "compare", (1440, 390))


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_a_page_fits_its_screen(name: str, page_of: Callable[[str], Path], in_each_font: InEachFont) -> None:
    """Catches a table, a picture or a word that makes a whole page scroll sideways, and texts of a drawing that a wider
    font lays on one another or cuts; a page that begins with its file, hides what to type below pictures, or cuts its
    contents."""
    with opened(page_of(name), pictures=name not in STILL) as page:
        if name != "effects":
            for width in (1440, 390):
                answers_above(page, name, width)
        in_each_font(page, lambda: fits(page, name, WIDTHS))
