"""Time from a click on an effect to the page drawn again, in a real browser.

``python benchmarks/page.py [ROWS ...]`` (default: 2940 and 20000 rows, five readings of a pose) needs Chromium and
Playwright. One effect is put into the model and taken out in turn. *Redrawn*: the number and the fall have what is new,
and two frames are painted; *maps*: so have the maps; *verdict*: the new diagnosis stands there too. *Computed* is the
processor time that server and the browser's main thread spent until it was redrawn, one after the other: on a machine
that does nothing else it takes about as long, and other load changes it less.
"""

from __future__ import annotations

import os
import re
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright

from sherkit import save_robot
from sherkit.cli.demo import EXAMPLE
from sherkit.report.page import browser
from sherkit.robots.delta.robot import paper_whole
from sherkit.robots.delta.virtual import VirtualDelta

_CLICKS, _REPEATS = 20, 5
_EFFECT = "rail_lean"
#: Milliseconds until the named fields and tables are new and painted, and until the verdict is.
_TIMED = """async name => {
    const from = performance.now(), d = Bokeh.documents[0]
    const after = signal => new Promise(done => {
        const slot = () => { signal.disconnect(slot); done() }
        signal.connect(slot)
    })
    const painted = () => new Promise(
        done => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 0))))
    const fresh = Promise.all([
        after(d.get_model_by_name('numbers').properties.text.change),
        after(d.get_model_by_name('steps').properties.data.change)])
    const maps = after(d.get_model_by_name('after_0').properties.data.change)
    const at = () => performance.now() - from
    window.mapped = maps.then(painted).then(at)
    const headline = d.get_model_by_name('headline')
    window.judged = fresh.then(async () => {
        while (!headline.text.includes('verdict')) await after(headline.properties.text.change)
        await painted()
        return at()
    })
    const model = [...d._all_models.values()].find(m => m.label?.slice(2) == name)
    Bokeh.index.find_one(model).el.shadowRoot.querySelector('button').click()
    await fresh
    await painted()
    return at()
}"""


def main() -> None:
    """Prints a line for each number of rows."""
    for rows in [int(word) for word in sys.argv[1:]] or [2940, 20_000]:
        with tempfile.TemporaryDirectory() as folder:
            redrawn, maps, verdict, computed = zip(*clicks(Path(folder), rows), strict=True)
        print(
            f"{rows} rows, {len(redrawn)} clicks: redrawn after {said(redrawn)}, of it computed {said(computed)}, "
            f"maps after {said(maps)}, verdict after {said(verdict)}",
            flush=True,
        )


def said(times_ms: tuple[float, ...]) -> str:
    """Median and range."""
    low, middle, high = (1e-3 * f(times_ms) for f in (min, statistics.median, max))
    return f"{middle:.2f} s ({low:.2f} to {high:.2f})"


def clicks(folder: Path, rows: int) -> list[tuple[float, float, float, float]]:
    """Times of each click, ms: redrawn, with maps, with a verdict, computed until redrawn."""
    save_robot(EXAMPLE, folder / "robot.toml")
    grid = paper_whole()
    poses = rows // _REPEATS
    if poses != len(grid):
        grid = np.random.default_rng(3).uniform(-20, 20, (poses, 3))
    virtual = VirtualDelta.draw(EXAMPLE, 6, rail_lean_rad=8e-3, noise_mm=0.005)
    virtual.measure(grid, repeats=_REPEATS, seed=6).save(folder / "run.csv")
    command = [sys.executable, "-c", "from sherkit.cli import main; main()", "app", "robot.toml", "run.csv"]
    server = subprocess.Popen(
        [*command, "--no-open", "--port", "0"], cwd=folder, stdout=subprocess.PIPE, text=True
    )  # fmt: skip
    try:
        assert server.stdout is not None
        url = re.search(r"http://\S+", server.stdout.readline())
        assert url is not None
        with sync_playwright() as playwright:
            chromium = playwright.chromium.launch(executable_path=browser(), args=["--no-sandbox"])
            page = chromium.new_page(viewport={"width": 1440, "height": 900})
            page.set_default_timeout(600_000)
            page.goto(url[0])
            metrics = page.context.new_cdp_session(page)
            metrics.send("Performance.enable")
            rested(page)
            out = []
            for _ in range(_CLICKS):
                before = computed_ms(server.pid, metrics)
                redrawn = page.evaluate(_TIMED, _EFFECT)
                computed = computed_ms(server.pid, metrics) - before
                out.append((redrawn, page.evaluate("window.mapped"), page.evaluate("window.judged"), computed))
                rested(page)
            chromium.close()
        return out
    finally:
        server.terminate()
        server.wait()


def computed_ms(server: int, metrics: Any) -> float:
    """Processor time of the server and of the page's main thread, so far."""
    fields = Path(f"/proc/{server}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    ticks = int(fields[11]) + int(fields[12])
    named = {one["name"]: one["value"] for one in metrics.send("Performance.getMetrics")["metrics"]}
    return 1e3 * (ticks / os.sysconf("SC_CLK_TCK") + named["ThreadTime"])


def rested(page: Any) -> None:
    """Waits until a diagnosis is shown and nothing is being done."""
    page.wait_for_function("Bokeh.documents[0]?.get_model_by_name('status')?.text == 'Ready.'")
    page.wait_for_function("Bokeh.documents[0].get_model_by_name('headline').text.includes('verdict')")
    page.wait_for_timeout(300)


if __name__ == "__main__":
    main()
