"""Draws docs/pictures/page.png: the page on the demo's run, with the effect that was found added.

``python docs/draw_page.py`` in the folder that holds ``demo/``; needs Chromium and Playwright.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from sherkit.report.export import browser

OUT = Path(__file__).parent / "pictures" / "page.png"


def main() -> None:
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
            draw(url[0])
        finally:
            server.terminate()
            server.wait()


def draw(url: str) -> None:
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser(), args=["--no-sandbox"])
        page = chromium.new_page(viewport={"width": 1440, "height": 900})
        page.goto(url)
        page.get_by_role("button", name="+ rail_lean").wait_for()
        page.wait_for_timeout(2000)
        page.get_by_role("button", name="+ rail_lean").click()
        page.get_by_role("button", name="✓ rail_lean").wait_for()
        page.wait_for_timeout(3000)
        page.screenshot(path=OUT)
        chromium.close()
    # a few colours are enough, and a third of the bytes
    Image.open(OUT).convert("RGB").quantize(128).save(OUT, optimize=True)


if __name__ == "__main__":
    main()
