"""Pages in Chromium for the tests: network off, every request and every complaint recorded; the fonts in which layouts
are looked at."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from sherkit.report.page import browser

needs_browser = pytest.mark.skipif(
    browser() is None, reason="no Chromium on this machine: pages and PNG/SVG are not drawn (Debian: chromium)"
)
#: What may be asked for: the page itself, and what it carries within it.
_WITHIN = ("data:", "blob:")
_IDLE = "window.Bokeh?.index?.roots.length > 0 && Bokeh.index.roots.every(view => view.is_idle)"
_TIMEOUT_MS = 600_000


#: What ``in_each_font`` of conftest.py is.
InEachFont = Callable[[Any, Callable[[], None]], None]
#: Fonts that a layout is looked at in, the widest first, and the package that brings each (Debian): what a machine
#: draws in that has no other, what Chromium asks for, and a narrow one; and letters of one width that go with them.
FONTS = {"DejaVu Sans": "fonts-dejavu-core", "Liberation Sans": "fonts-liberation",
         "Liberation Sans Narrow": "fonts-liberation, or fonts-liberation-sans-narrow"}  # fmt: skip
_OF_ONE_WIDTH = {"DejaVu Sans": "DejaVu Sans Mono"}
_HAS = """async font => {
    try { await new FontFace("tried", `local("${font}")`).load(); return true } catch { return false }
}"""
_WIDTHS = """async font => {
    await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))
    const pen = document.createElement("canvas").getContext("2d")
    return ["sans-serif", `"${font}"`].map(f => { pen.font = `100px ${f}`; return pen.measureText("Wide ij").width })
}"""
# widgets of Bokeh name fonts of their own, unless a page says which
_WIDGETS = ":root { --bokeh-base-font: sans-serif; --bokeh-mono-font: monospace }"


_running: list[Any] = []


def chromium() -> Any:
    """Chromium without a page, the same one for all tests of a module: to start it takes longer than to look."""
    if not _running:
        from playwright.sync_api import sync_playwright

        play = sync_playwright().start()
        _running.append(play)
        _running.append(play.chromium.launch(executable_path=browser(), args=["--no-sandbox"]))
    return _running[1]


def close() -> None:
    """Ends it: while it runs, no test can have a loop of events of its own."""
    if _running:
        _running[1].close()
        _running[0].stop()
        _running.clear()


@contextmanager
def opened(
    file: Path, *, width: int = 1200, height: int = 900, javascript: bool = True, pictures: bool = True
) -> Iterator[Any]:
    """A page of a file, without a network, once its ``pictures`` are drawn, if it has any of Bokeh's. Fails where it
    asks for anything else, or complains, or opens a dialog."""
    address = file.resolve().as_uri()
    outside: list[str] = []
    complaints: list[str] = []

    def asked(route: Any) -> None:
        url = route.request.url
        if url.split("#")[0] == address or url.startswith(_WITHIN):
            route.continue_()
        else:
            outside.append(url)
            route.abort()

    def dialog(shown: Any) -> None:
        complaints.append(f"dialog: {shown.message}")
        shown.dismiss()

    context = chromium().new_context(
        viewport={"width": width, "height": height}, java_script_enabled=javascript, accept_downloads=True
    )
    try:
        context.route("**/*", asked)
        context.set_offline(True)
        page = context.new_page()
        page.on("dialog", dialog)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda m: complaints.append(m.text) if m.type in ("error", "warning") else None)
        page.goto(address)
        if javascript and pictures:
            page.wait_for_function(_IDLE, timeout=_TIMEOUT_MS)
        yield page
    finally:
        context.close()
    assert outside == [], "the page asked for something outside itself"
    assert complaints == []


def has_font(page: Any, font: str) -> bool:
    """Whether this machine has a font: a browser takes another one for it without a word."""
    return bool(page.evaluate(_HAS, font))


def draw_in(page: Any, font: str) -> None:
    """Lays an open page out anew, in a font that this machine has, whatever its own are."""
    session = page.context.new_cdp_session(page)
    families = dict.fromkeys(("standard", "serif", "sansSerif"), font)
    session.send("Page.enable")
    session.send(
        "Page.setFontFamilies",
        {"fontFamilies": {**families, "fixed": _OF_ONE_WIDTH.get(font, "Liberation Mono")}},
    )
    session.detach()
    page.add_style_tag(content=_WIDGETS)
    page.evaluate("dispatchEvent(new Event('resize'))")
    drawn, wanted = page.evaluate(_WIDTHS, font)
    assert drawn == wanted, f"the page is not drawn in {font}"


def settled(page: Any) -> None:
    """Waits until all pictures are drawn again."""
    page.wait_for_function(_IDLE, timeout=_TIMEOUT_MS)


def unfold(page: Any) -> None:
    """Opens all that is folded."""
    page.evaluate("document.querySelectorAll('details.part').forEach(one => { one.open = true })")
    settled(page)


def source(page: Any, name: str) -> dict[str, list[Any]]:
    """The columns of a named table of the page's pictures, as they are now."""
    found: dict[str, list[Any]] = page.evaluate(
        """name => {
            const models = Bokeh.documents.map(d => d.get_model_by_name(name)).filter(Boolean)
            return Object.fromEntries(Object.entries(models[0].data).map(([k, v]) => [k, Array.from(v)]))
        }""",
        name,
    )
    return found
