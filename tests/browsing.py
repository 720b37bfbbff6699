"""Pages in Chromium for the tests: network off, every request and every complaint recorded."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from sherkit.report.export import browser

needs_browser = pytest.mark.skipif(
    browser() is None, reason="no Chromium on this machine: pages and PNG/SVG are not drawn (Debian: chromium)"
)
#: What may be asked for: the page itself, and what it carries within it.
_WITHIN = ("data:", "blob:")
_IDLE = "window.Bokeh?.index?.roots.length > 0 && Bokeh.index.roots.every(view => view.is_idle)"
_TIMEOUT_MS = 600_000


@contextmanager
def opened(file: Path, *, width: int = 1200, height: int = 900, javascript: bool = True) -> Iterator[Any]:
    """A page of a file, without a network. Fails where it asks for anything else, or complains, or opens a dialog."""
    from playwright.sync_api import Page, sync_playwright

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

    with sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=browser(), args=["--no-sandbox"])
        try:
            context = chromium.new_context(
                viewport={"width": width, "height": height}, java_script_enabled=javascript, accept_downloads=True
            )
            context.route("**/*", asked)
            context.set_offline(True)
            page: Page = context.new_page()
            page.on("dialog", dialog)
            page.on("pageerror", lambda error: complaints.append(str(error)))
            page.on("console", lambda m: complaints.append(m.text) if m.type in ("error", "warning") else None)
            page.goto(address)
            if javascript:
                page.wait_for_function(_IDLE, timeout=_TIMEOUT_MS)
            yield page
        finally:
            chromium.close()
    assert outside == [], "the page asked for something outside itself"
    assert complaints == []


def settled(page: Any) -> None:
    """Waits until all pictures are drawn again."""
    page.wait_for_function(_IDLE, timeout=_TIMEOUT_MS)


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
