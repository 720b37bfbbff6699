"""Short pages of their own: what has changed between runs, and the course over the years."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from bokeh.layouts import column
from bokeh.models import Div

from ..changes import Comparison, History
from ..data.files import write_whole
from .changed import before_and_after, course, mechanism_with_change
from .policy import fresh_nonce, page_of
from .scene import script


def write_page(
    path: Path, title: str, sentences: Sequence[str], figures: Sequence[Any], scene: str = "", again_s: int = 0
) -> None:
    """One HTML file that opens without a network; ``scene`` is HTML that follows what is told. A browser reads the page
    anew every ``again_s`` seconds, unless that is 0."""
    told = "".join(f"<p>{escape(one)}</p>" for one in sentences)
    style = "<style>:host{font:15px/1.45 sans-serif}p{margin:.5em 0}</style>"
    head = Div(text=f"{style}<h1>{escape(title)}</h1>{told}{scene}", sizing_mode="stretch_width")
    nonce = fresh_nonce()
    whole = column(head, *figures, sizing_mode="stretch_width", margin=(10, 30, 30, 30))
    # a library of Bokeh's holds the end of a body in a text
    page, _, end = page_of(whole, title, nonce).rpartition("</body>")
    moving = f'<script nonce="{nonce}">{script()}</script>' if "<sherkit-scene" in scene else ""
    if again_s:
        page = page.replace("<head>", f'<head><meta http-equiv="refresh" content="{again_s}">', 1)
    write_whole(path, f"{page}{moving}</body>{end}")


def write_comparison(path: Path, found: Comparison, title: str) -> None:
    """Before and after beside each other on one scale, and the mechanism with what has changed, exaggerated.

    Raises :class:`~sherkit.errors.FitError` for a comparison that was read from a file, without its runs.
    """
    picture = before_and_after(found)
    told = [found.headline, *(f"{' or '.join(tie)}: these runs cannot tell" for tie in found.indistinguishable)]
    poses = [", ".join(f"{name} {value:.4g}" for name, value in pose.items()) for pose in found.next_poses]
    drawn = mechanism_with_change(found)
    scene = "" if drawn is None else f"<h2>What has changed</h2>{drawn[0].html()}<p>{escape(drawn[1])}</p>"
    scene += f"<h2>Before and after</h2><p>{escape(picture.note)}</p>"
    write_page(path, title, [*told, found.advice, *poses], [picture.root], scene)


def write_history(path: Path, found: History, title: str) -> None:
    """The error of each run, and of what has changed its course with deviations; what stood still is left out."""
    told = [f"{found.verdict}.", *map(str, found.changes), f"{len(found.stood_still)} others stood still."]
    write_page(path, title, told, [course(found).root])
