"""A page of its own: what it may run and ask for, the one page of every verb, and pictures as files (HTML, PNG, SVG).

Its own scripts, known by a number used once, and nothing from elsewhere.

Every text from a file is escaped where it is written. This is the second lock: a script that came in by a name that was
not escaped has no number, and does not run. Source: Content Security Policy Level 3 (W3C).
"""

from __future__ import annotations

import base64
import hashlib
import html as escaping
import platform
import re
import secrets
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any

from bokeh.embed import components, file_html
from bokeh.models import LayoutDOM, UIElement
from bokeh.resources import INLINE, Resources
from jinja2 import Environment, PackageLoader, StrictUndefined

import sherkit._core as _core

from ..base.answer import FILES, Answer, as_sentence
from ..base.figures import number
from ..data.files import write_whole
from ..errors import SherkitError
from .picture import Picture, in_one_document
from .scene import script as scene_script

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


# -- The page of a verb -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SourceFile:
    """A file that a page was made from, with the SHA-256 of its bytes."""

    name: str
    sha256: str

    @classmethod
    def of(cls, path: str | Path) -> SourceFile:
        """Reads and hashes a file."""
        return cls(str(path), hashlib.sha256(Path(path).read_bytes()).hexdigest())


@dataclass(frozen=True)
class Made:
    """How a page was made: the ``command`` that makes it again from ``sources``; ``given`` puts their names, and the
    options of a command line, into a command that is proposed."""

    about: str
    command: str = ""
    sources: Sequence[SourceFile] = ()
    given: Callable[[str], str] = str

    @classmethod
    def of(
        cls, paths: Sequence[Path], command: str, given: Callable[[str], str] | None = None, about: str = ""
    ) -> Made:
        """Of files, by their names; the first two of them stand in what is proposed unless ``given`` says otherwise."""
        names = shlex.join(map(str, paths[:2])) if len(paths) > 1 else FILES
        sources = [SourceFile.of(path) for path in paths]
        return cls(
            about or ", ".join(path.name for path in paths),
            command,
            sources,
            given or (lambda line: line.replace(FILES, names)),
        )


@dataclass(frozen=True)
class Section:
    """A part of a page: a picture of Bokeh's, HTML, or both below a note on how to read it."""

    title: str
    html: str = ""
    root: LayoutDOM | None = None
    note: str = ""

    @property
    def name(self) -> str:
        """By what the contents find it."""
        return re.sub(r"\W+", "_", self.title.lower()).strip("_")


def html_table(heads: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "") -> str:
    """A table as HTML, its texts escaped."""

    def line(tag: str, cells: Sequence[str]) -> str:
        return "<tr>" + "".join(f"<{tag}>{escaping.escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    above = f"<caption>{escaping.escape(caption)}</caption>" if caption else ""
    return f"<table>{above}{line('th', heads)}{''.join(line('td', cells) for cells in rows)}</table>"


def html_sentences(*texts: str) -> str:
    """Sentences as HTML, one below the other."""
    return "".join(f"<p>{escaping.escape(one)}</p>" for one in texts)


def write_page(path: Path, answer: Answer, sections: Sequence[Section], made: Made, *, again_s: int = 0) -> None:
    """One HTML file that opens without a network, the answer first. A browser reads it anew every ``again_s`` seconds,
    unless that is 0. Raises :class:`~sherkit.errors.NotWritten`."""
    roots = {one.name: one.root for one in sections if one.root is not None}
    contents = [("answer", "Answer"), *((one.name, one.title) for one in sections), ("made", "How this was made")]
    known: dict[str, Any] = {"sections": sections, "contents": contents, "short": True, "again_s": again_s}
    write_whole(path, rendered("page.html", answer, made, roots, **known))


def rendered(
    template: str, answer: Answer, made: Made, roots: Mapping[str, LayoutDOM],
    filters: Mapping[str, Callable[..., Any]] = MappingProxyType({}), **known: Any,
) -> str:  # fmt: skip
    """A page by its template, under the policy of a file that asks nothing of a network; every text from a file is
    escaped."""
    nonce = fresh_nonce()
    script, places = components(in_one_document(roots)) if roots else ("", {})
    bokeh = Resources(mode="inline", components=["bokeh"]).render_js() if roots else ""
    environment = Environment(
        loader=PackageLoader("sherkit.report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {"number": number, "sentence": as_sentence, **filters}
    versions = [("sherkit", _core.__version__), ("Python", platform.python_version()),
                *((name, version(name)) for name in ("numpy", "scipy", "polars", "bokeh"))]  # fmt: skip
    every = {
        "answer": answer, "made": made, "nonce": nonce, "policy": policy(nonce), "places": places,
        "script": numbered(script, nonce), "bokeh": numbered(bokeh, nonce), "scene_script": scene_script(),
        "versions": versions, "now": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"), "short": False, "again_s": 0,
        **known,
    }  # fmt: skip
    return environment.get_template(template).render(every)


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
