"""Draws target/screens/*.png: the page of every verb that writes one, and the page of the demo, at three widths, light
and dark, to be looked at.

``make pictures``, or ``python docs/draw_screens.py`` in the folder that holds ``demo/``; needs Chromium and Playwright.
"""

from __future__ import annotations

import sys
import tempfile
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
_DRAWN = "!window.Bokeh || Bokeh.index.roots.length > 0 && Bokeh.index.roots.every(view => view.is_idle)"


def main() -> None:
    """Writes them."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    from pages_of_verbs import PAGES

    OUT.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as there, sync_playwright() as playwright:
        folders = {name: Path(there) / name for name in PAGES}
        for name, folder in folders.items():
            folder.mkdir()
            PAGES[name](folder)
        chromium = playwright.chromium.launch(executable_path=browser(), args=["--no-sandbox"])
        with served() as url:
            for (width, height), scheme in product(SIZES, SCHEMES):
                page = chromium.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
                page.set_default_timeout(600_000)
                page.goto(url)
                rested(page, "+ rail_lean")
                page.screenshot(path=OUT / f"app_{width}_{scheme}.png")
                for name, folder in folders.items():
                    page.goto((folder / "page.html").as_uri())
                    page.wait_for_function(_DRAWN)
                    page.screenshot(path=OUT / f"{name}_{width}_{scheme}.png")
                    page.screenshot(path=OUT / f"{name}_{width}_{scheme}_whole.png", full_page=True)
                page.close()
        chromium.close()


if __name__ == "__main__":
    main()
