"""A run of the flexible tool as one HTML file: what was found, in words, then estimate and residuals as pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from bokeh.layouts import column
from bokeh.models import Div

from ..data.files import write_whole
from ..diagnosis import Diagnosis
from .estimate import EstimateOverTime, estimate_picture
from .notebook import pictures_of
from .policy import page_of

#: Text and tables of the page.
_STYLE = """
<style>
.said { max-width: 62em; font-size: 15px; line-height: 1.45 } .said h1 { font-size: 26px }
.said h2 { font-size: 19px; margin: 1.2em 0 0.3em } .said li { margin: 0.25em 0 } .said .note { color: #555 }
.said table { border-collapse: collapse; margin: 0.6em 0 } .said caption { text-align: left; font-weight: bold }
.said th, .said td { padding: 3px 14px 3px 0; text-align: right; border-bottom: 1px solid #ddd }
.said th:first-child, .said td:first-child { text-align: left }
</style>
"""


@dataclass(frozen=True)
class Rows:
    """A table of the report: its caption, the heads of its columns, cells by row."""

    caption: str
    heads: tuple[str, ...]
    cells: tuple[tuple[str, ...], ...]

    def __str__(self) -> str:
        def row(tag: str, cells: Sequence[str]) -> str:
            return "<tr>" + "".join(f"<{tag}>{escape(c)}</{tag}>" for c in cells) + "</tr>"

        rows = "".join(row("td", cells) for cells in self.cells)
        return f"<table><caption>{escape(self.caption)}</caption>{row('th', self.heads)}{rows}</table>"


def write_tool_report(
    path: str | Path, title: str, found: Diagnosis, estimate: EstimateOverTime, said: Sequence[str] = (), *,
    tables: Sequence[Rows] = (), command: str = "",
) -> None:  # fmt: skip
    """Writes it; it opens without a network. ``said`` are sentences and ``tables`` what a command adds. Raises
    :class:`~sherkit.errors.NotWritten`."""
    indistinguishable = (f"This run cannot tell {' from '.join(t)}." for t in found.indistinguishable)
    over_time, *others = estimate_picture(estimate), *pictures_of(found)
    parts = [
        _text(
            f"<h1>{escape(title)}</h1><p><b>{escape(found.headline)}</b></p>",
            *(f"<p>{escape(s)}</p>" for s in (*indistinguishable, *found.notes, *said)),
            f"<h2>{escape(estimate.name.capitalize())} over the run</h2>",
        ),
        over_time.root,
        _text(f'<p class="note">{escape(over_time.note)}</p>', *(str(t) for t in tables)),
        _text("<h2>What is missing, and what the camera sees beside the model</h2>"),
    ]
    for picture in others:
        parts += [picture.root, _text(f'<p class="note">{escape(picture.note)}</p>')]
    parts.append(
        _text(
            "<h2>What the verdict rests on</h2><ul>",
            *(f"<li>{escape(str(check))}</li>" for check in found.checks),
            "</ul>",
            f"<p>Made by <code>{escape(command)}</code></p>" if command else "",
        )
    )
    page = column(*parts, sizing_mode="stretch_width", styles={"padding": "0 24px", "box-sizing": "border-box"})
    write_whole(path, page_of(page, title))


def _text(*lines: str) -> Div:
    """A block of text between pictures; a Div stands alone, so that each brings its style."""
    return Div(text=f'{_STYLE}<div class="said">{"".join(lines)}</div>', sizing_mode="stretch_width")
