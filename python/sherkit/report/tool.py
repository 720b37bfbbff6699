"""A run of the flexible tool as one HTML file: what was found, in words, then estimate and residuals as pictures."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from bokeh.layouts import column
from bokeh.models import Div

from ..data.files import write_whole
from ..diagnosis import Diagnosis
from .estimate import EstimateOverTime, estimate_picture
from .notebook import pictures_of
from .policy import page_of


def write_tool_report(
    path: str | Path, title: str, found: Diagnosis, estimate: EstimateOverTime, said: Sequence[str] = (), *,
    command: str = "",
) -> None:  # fmt: skip
    """Writes it; it opens without a network. ``said`` are sentences that a command adds. Raises
    :class:`~sherkit.errors.NotWritten`."""
    lines = [
        f"<h1>{escape(title)}</h1>",
        f"<p><b>{escape(found.headline)}</b></p>",
        *(f"<p>{escape(s)}</p>" for s in (*(f"This run cannot tell {' from '.join(t)}." for t in found.ties), *said)),
        "<h2>What the verdict rests on</h2><ul>",
        *(f"<li>{escape(str(claim))}</li>" for claim in found.claims),
        "</ul>",
        *(f"<p>{escape(note)}</p>" for note in found.notes),
        f"<p>Made by <code>{escape(command)}</code></p>" if command else "",
    ]
    pictures = [estimate_picture(estimate), *pictures_of(found)]
    page = column(Div(text="".join(lines), sizing_mode="stretch_width"), *(p.root for p in pictures),
                  sizing_mode="stretch_width")  # fmt: skip
    write_whole(path, page_of(page, title))
