"""Short pages of their own: what has changed between runs, and the course over the years."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.embed import file_html
from bokeh.layouts import column, row
from bokeh.models import Div, Whisker
from bokeh.models.sources import ColumnDataSource
from bokeh.resources import INLINE

from ..base.figures import in_people_units
from ..changes import Comparison, History
from ..data.files import write_whole
from ..errors import FitError
from .style import COLOURS, MUTED, figure, quantity

HEIGHT, _WIDE = 300, 420
_PAGE = {"max-width": "68rem", "margin": "1rem auto", "padding": "0 1rem"}


def write_page(path: Path, title: str, sentences: Sequence[str], figures: Sequence[Any], *, again_s: int = 0) -> None:
    """One HTML file that opens without a network; a browser reads it anew every ``again_s`` seconds, unless 0."""
    told = "".join(f"<p>{escape(one)}</p>" for one in sentences)
    head = Div(text=f"<h1>{escape(title)}</h1>{told}", styles={"font-size": "16px", "max-width": "60rem"})
    html = file_html(column(head, *figures, sizing_mode="stretch_width", styles=_PAGE), INLINE, title)
    if again_s:
        html = html.replace("<head>", f'<head><meta http-equiv="refresh" content="{again_s}">', 1)
    write_whole(path, html)


def write_comparison(path: Path, found: Comparison, title: str) -> None:
    """Before and after beside each other on one scale: what the model of the first run leaves, along each coordinate.

    Raises :class:`~sherkit.errors.FitError` for a comparison that was read from a file, without its runs.
    """
    joined = found.joined
    if joined is None:
        raise FitError("a comparison without its runs cannot be drawn")
    per_unit = joined.runs[0].data.layout.per_unit
    left = [per_unit * np.linalg.norm(np.where(run.used, run.stand.residual, 0.0), axis=1) for run in joined.runs]
    places = [joined.places(run) for run in joined.runs]
    top = 1.05 * max(float(v.max(initial=0.0)) for v in left)
    figures = []
    for name in list(places[0])[:3]:
        pair = []
        for k, (run, values) in enumerate(zip(places, left, strict=True)):
            made = figure(height=HEIGHT, width=_WIDE, y_range=(0.0, top))
            made.scatter(run[name], values, size=5, color=COLOURS[k % len(COLOURS)], alpha=0.7)
            made.xaxis.axis_label = quantity(name)
            made.yaxis.axis_label = f"left, {found.unit}"
            made.title.text = "before" if k == 0 else "after" if len(places) == 2 else f"run {k + 1}"
            pair.append(made)
        figures.append(row(*pair))
    told = [found.headline, *(f"{' or '.join(tie)}: these runs cannot tell" for tie in found.indistinguishable)]
    poses = [", ".join(f"{name} {value:.4g}" for name, value in pose.items()) for pose in found.next_poses]
    write_page(path, title, [*told, found.advice, *poses], figures)


def write_history(path: Path, found: History, title: str) -> None:
    """The error of each run, and of what has changed its course with deviations; what stood still is left out."""
    dates = [f"{k + 1}: {run['date']}" for k, run in enumerate(found.runs)]
    errors = figure(height=HEIGHT, x_range=dates, sizing_mode="stretch_width")
    errors.line(dates, [run["error"] for run in found.runs], color=COLOURS[0], line_width=2)
    errors.scatter(dates, [run["error"] for run in found.runs], color=COLOURS[0], size=8)
    errors.yaxis.axis_label = f"error by the model of the first run, {found.unit}"
    figures = [errors]
    for k, (name, values) in enumerate(found.values.items()):
        unit = next(u for one in found.changes if one.name == name for _, _, _, u in one.parameters)
        shown, times = in_people_units(unit)
        middle = [times * value for value, _ in values]
        ends = ColumnDataSource({
            "x": dates, "low": [times * (v - 2 * s) for v, s in values],
            "high": [times * (v + 2 * s) for v, s in values],
        })  # fmt: skip
        made = figure(height=HEIGHT, x_range=dates, sizing_mode="stretch_width")
        made.scatter(dates, middle, color=COLOURS[(k + 1) % len(COLOURS)], size=8)
        made.line(dates, middle, color=MUTED)
        made.add_layout(Whisker(base="x", lower="low", upper="high", source=ends))
        made.yaxis.axis_label = f"{name}, {shown}"
        figures.append(made)
    told = [f"{found.verdict}.", *map(str, found.changes), f"{len(found.stood_still)} others stood still."]
    write_page(path, title, told, figures)
