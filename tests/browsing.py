"""Pages in Chromium for the tests: network off, every request and every complaint recorded."""

from __future__ import annotations

from collections.abc import Iterator
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
def opened(file: Path, *, width: int = 1200, height: int = 900, javascript: bool = True) -> Iterator[Any]:
    """A page of a file, without a network. Fails where it asks for anything else, or complains, or opens a dialog."""
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
        if javascript:
            page.wait_for_function(_IDLE, timeout=_TIMEOUT_MS)
        yield page
    finally:
        context.close()
    assert outside == [], "the page asked for something outside itself"
    assert complaints == []


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
