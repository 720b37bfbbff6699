"""Draws docs/pictures/page*.png: the page on the demo's run, as each step of its story shows it.

``make pictures``, or ``python docs/draw_page.py`` in the folder that holds ``demo/``; needs Chromium and Playwright.
Each picture carries what the page said in it, so that a test sees without a browser whether it is stale.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image
from PIL.PngImagePlugin import PngInfo
from playwright.sync_api import sync_playwright

from sherkit.report.page import browser

OUT = Path(__file__).parent / "pictures"
#: Under this name a picture keeps what the page said.
SAID = "said"
#: Widths and heights of windows, px, with what is added to the name of a picture.
SIZES = {"": (1440, 900), "_tablet": (1024, 768), "_phone": (400, 800)}
_ADD, _ADDED = "+ rail_lean", "✓ rail_lean"


def main() -> None:
    for ending, size in SIZES.items():
        with served() as url, sync_playwright() as playwright:
            chromium = playwright.chromium.launch(executable_path=browser(), args=["--no-sandbox"])
            page = chromium.new_page(viewport=dict(zip(("width", "height"), size, strict=True)))
            page.set_default_timeout(600_000)
            page.goto(url)
            rested(page, _ADD)
            shoot(page, f"page_found{ending}")
            page.get_by_role("button", name=_ADD).click()
            rested(page, _ADDED)
            shoot(page, f"page{ending}")
            chromium.close()


@contextmanager
def served() -> Iterator[str]:
    """The page of a new study of the demo, and its address."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable, "-c", "from sherkit.cli import main; main()", "app", "demo/robot.toml", "demo/whole.csv",
            "--no-open", "--port", "0", "--study", f"{folder}/study",
        ]  # fmt: skip
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            assert server.stdout is not None
            url = re.search(r"http://\S+", server.stdout.readline())
            assert url is not None
            yield url[0]
        finally:
            server.terminate()
            server.wait()


def rested(page: Any, label: str) -> None:
    """Waits until a switch is there and nothing is being done."""
    page.get_by_role("button", name=label).wait_for()
    page.wait_for_function(
        "Bokeh.documents[0].get_model_by_name('status').text == 'Ready.' && "
        "Bokeh.documents[0].get_model_by_name('headline').text.includes('verdict')"
    )
    page.wait_for_timeout(2000)


def shoot(page: Any, name: str) -> None:
    """The window as PNG, with what the page says in it."""
    path = OUT / f"{name}.png"
    page.screenshot(path=path)
    said = PngInfo()
    text = "name => Bokeh.documents[0].get_model_by_name(name).text"
    said.add_itxt(SAID, "\n".join(page.evaluate(text, one) for one in ("numbers", "headline")))
    # a few colours are enough, and a third of the bytes
    few = Image.open(path).convert("RGB").quantize(160, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few.save(path, optimize=True, pnginfo=said)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
