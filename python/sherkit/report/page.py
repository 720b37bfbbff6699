"""A page of its own: what it may run and ask for, how it is written, and pictures as files (HTML, PNG, SVG).

Its own scripts, known by a number used once, and nothing from elsewhere.

Every text from a file is escaped where it is written. This is the second lock: a script that came in by a name that was
not escaped has no number, and does not run. Source: Content Security Policy Level 3 (W3C).
"""

from __future__ import annotations

import base64
import html as escaping
import re
import secrets
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from bokeh.embed import file_html
from bokeh.layouts import column
from bokeh.models import Div, UIElement
from bokeh.resources import INLINE

from ..data.files import write_whole
from ..errors import SherkitError
from .picture import Picture
from .scene import script

#: Bokeh's own page with a policy.
_PAGE = """
{% block preamble %}<meta http-equiv="Content-Security-Policy" content="{{ policy }}">{% endblock %}
{% block js_resources %}{{ (borrowed or numbered(bokeh_js, nonce)) | safe }}{% endblock %}
{% block inner_body %}
{{ self.contents() }}
{{ numbered(later(plot_script) if borrowed else plot_script, nonce) | safe }}
{% endblock %}
"""
#: The class of scripts that wait.
LATER = "later"
_RUNS = re.compile(r'^(\s*)<script(?: type="text/javascript")?>', flags=re.MULTILINE)
_OPENING = re.compile(r"^(\s*)<script\b", flags=re.MULTILINE)


def fresh_nonce() -> str:
    """A number that nobody can guess, for one page."""
    return secrets.token_urlsafe(16)


def policy(nonce: str, *, served: bool = False) -> str:
    """The policy of a file that opens without a network; of a page that talks to its own server where ``served``.

    Bokeh makes functions of the code in its models (``CustomJS``), which is ours: hence ``unsafe-eval``.
    """
    own = " 'self'" if served else ""
    return "; ".join(
        (
            "default-src 'none'",
            f"script-src 'nonce-{nonce}' 'unsafe-eval'{own}",
            f"style-src 'unsafe-inline'{own}",
            f"img-src data: blob:{own}",
            f"font-src data:{own}",
            "connect-src" + (own or " 'none'"),
            "base-uri 'none'",
            "form-action 'none'",
        )
    )


def numbered(scripts: str, nonce: str) -> str:
    """Script elements that Bokeh wrote, each at the beginning of a line, with their number.

    Texts in them are JSON, in which no line begins: nothing from a file gets a number.
    """
    return _OPENING.sub(rf'\1<script nonce="{nonce}"', scripts)


def page_of(root: UIElement, title: str, nonce: str = "", borrowed: str = "") -> str:
    """A page of what Bokeh draws, under the policy of a file that asks nothing of a network.

    Scripts that are added to it need its ``nonce``, which is fresh unless given. ``borrowed`` are scripts that bring
    Bokeh where the page shall not hold it itself, and then run what draws, which waits as text.
    """
    nonce = nonce or fresh_nonce()
    known = {"nonce": nonce, "policy": policy(nonce), "numbered": numbered, "borrowed": borrowed, "later": _later}
    return file_html(root, INLINE, title, template=_PAGE, template_variables=known)


def _later(scripts: str) -> str:
    """Scripts as text of the page, for whoever runs them once what they need is there."""
    return _RUNS.sub(rf'\1<script type="text/plain" class="{LATER}">', scripts)


def write_page(
    path: Path, title: str, sentences: Sequence[str], figures: Sequence[Any], scene: str = "", again_s: int = 0
) -> None:
    """One HTML file that opens without a network, the first of its ``sentences``, the answer, bold; ``scene`` is HTML
    that follows what is told. A browser reads the page anew every ``again_s`` seconds, unless that is 0."""
    told = "".join(
        f"<p><b>{escape(one)}</b></p>" if k == 0 else f"<p>{escape(one)}</p>" for k, one in enumerate(sentences)
    )
    style = "<style>:host{font:15px/1.45 sans-serif}p{margin:.5em 0}</style>"
    head = Div(text=f"{style}<h1>{escape(title)}</h1>{told}{scene}", sizing_mode="stretch_width")
    nonce = fresh_nonce()
    # what is wider than the screen is moved by itself, and not the page with its sentences
    framed = [column(one, sizing_mode="stretch_width", styles={"overflow-x": "auto"}) for one in figures]
    whole = column(head, *framed, sizing_mode="stretch_width", margin=(10, 30, 30, 30))
    # a library of Bokeh's holds the end of a body in a text
    page, _, end = page_of(whole, title, nonce).rpartition("</body>")
    moving = f'<script nonce="{nonce}">{script()}</script>' if "<sherkit-scene" in scene else ""
    if again_s:
        page = page.replace("<head>", f'<head><meta http-equiv="refresh" content="{again_s}">', 1)
    write_whole(path, f"{page}{moving}</body>{end}")


# -- As a file --------------------------------------------------------------------------------------------------------

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
    write_whole(path, _by_browser(picture, kind, width_px))


def browser() -> str | None:
    """The browser of this machine that can draw, or None."""
    return next((found for found in map(shutil.which, BROWSERS) if found), None)


def _by_browser(picture: Picture[Any], kind: str, width_px: int) -> bytes:
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
        return subprocess.run(
            command, capture_output=True, timeout=_TIMEOUT_S, check=False, encoding="utf-8", errors="replace"
        )
    except subprocess.TimeoutExpired:
        raise SherkitError(f"{program} did not draw the picture within {_TIMEOUT_S} s") from None
