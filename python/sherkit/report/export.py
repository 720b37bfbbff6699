"""Pictures as files: HTML that opens without a network, PNG and SVG drawn by a browser of this machine."""

from __future__ import annotations

import base64
import html as escaping
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from ..data.files import write_whole
from ..errors import SherkitError
from .picture import Picture
from .policy import fresh_nonce, numbered, page_of

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
_TIMEOUT_S = 60
_TRIES = 3

_DRAW = """
<script>
(async () => {
  const wait = ms => new Promise(done => setTimeout(done, ms))
  let view = null
  for (let k = 0; k < 200 && !view?.is_idle; k++) { await wait(25); view = window.Bokeh?.index?.roots?.[0] ?? null }
  await wait(50)
  const blob = await view.export("KIND", true).to_blob()
  const bytes = new Uint8Array(await blob.arrayBuffer())
  let text = ""
  for (const byte of bytes) text += String.fromCharCode(byte)
  const drawn = btoa(text)
  document.body.innerHTML = `<pre id="drawn" data-size="${drawn.length}">${drawn}</pre>`
})()
</script>
"""


def save_picture(picture: Picture[Any], path: str | Path, *, width_px: int = 1100) -> None:
    """Writes HTML, PNG or SVG, by the ending of the name.

    PNG and SVG are drawn by Chromium. Raises :class:`~sherkit.errors.SherkitError` for another ending, or where no
    browser is found.
    """
    path = Path(path)
    kind = path.suffix.lower().lstrip(".")
    if kind == "html":
        write_whole(path, page_of(picture.root, picture.name))
        return
    if kind not in ("png", "svg"):
        raise SherkitError(f"{path}: a picture is written as .html, .png or .svg")
    write_whole(path, _drawn(picture, kind, width_px))


def browser() -> str | None:
    """The browser of this machine that can draw, or None."""
    return next((found for found in map(shutil.which, BROWSERS) if found), None)


def _drawn(picture: Picture[Any], kind: str, width_px: int) -> bytes:
    program = browser()
    if program is None:
        raise SherkitError(f"a picture as {kind.upper()} needs a browser: none of {', '.join(BROWSERS)} was found")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "picture.html"
        nonce = fresh_nonce()
        page, draw = page_of(picture.root, picture.name, nonce), numbered(_DRAW.replace("KIND", kind), nonce)
        write_whole(file, page.replace("</body>", f"{draw}</body>"))
        command = [
            program, "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder}/profile",
            f"--window-size={width_px},1000", "--virtual-time-budget=15000", "--dump-dom", file.as_uri(),
        ]  # fmt: skip
        for _ in range(_TRIES):
            done = _run(command, program)
            found = re.search(r'<pre id="drawn" data-size="(\d+)">([^<]*)</pre>', done.stdout)
            # on a busy machine the browser may end before it has drawn
            if found is not None and len(found[2]) == int(found[1]):
                return base64.b64decode(escaping.unescape(found[2]))
    said = done.stderr.strip().splitlines()
    raise SherkitError(f"{program} did not draw the picture{': ' + said[-1] if said else ''}")


def _run(command: list[str], program: str) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, capture_output=True, timeout=_TIMEOUT_S, check=False, text=True)
    except subprocess.TimeoutExpired:
        raise SherkitError(f"{program} did not draw the picture within {_TIMEOUT_S} s") from None
