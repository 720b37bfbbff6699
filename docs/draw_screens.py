"""Draws target/screens/*.png: page and report of the demo at three widths, light and dark, to be looked at.

``make pictures``, or ``python docs/draw_screens.py`` in the folder that holds ``demo/``; needs Chromium and Playwright.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

from draw_page import rested, served
from playwright.sync_api import sync_playwright

from sherkit.report.page import browser

OUT = Path("target/screens")
#: Widths and heights of windows, px.
SIZES = ((1920, 1080), (1440, 900), (390, 844))
SCHEMES: tuple[Any, ...] = ("light", "dark")
_DRAWN = "window.Bokeh?.index?.roots.length > 0 && Bokeh.index.roots.every(view => view.is_idle)"


def main() -> None:
    OUT.mkdir(parents=True, exist_ok=True)
    with served() as url, sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser(), args=["--no-sandbox"])
        for (width, height), scheme in product(SIZES, SCHEMES):
            page = chromium.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
            page.set_default_timeout(600_000)
            page.goto(url)
            rested(page, "+ rail_lean")
            page.screenshot(path=OUT / f"page_{width}_{scheme}.png")
            page.goto(Path("demo/report.html").resolve().as_uri())
            page.wait_for_function(_DRAWN)
            page.screenshot(path=OUT / f"report_{width}_{scheme}.png")
            page.screenshot(path=OUT / f"report_{width}_{scheme}_whole.png", full_page=True)
            page.close()
        chromium.close()


if __name__ == "__main__":
    main()
