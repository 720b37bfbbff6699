"""Short pages of their own: what has changed between runs, the course over the years, a run that chose its poses."""

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

from ..adaptive import Adaptive
from ..base.figures import in_people_units
from ..changes import Comparison, History
from ..data.files import write_whole
from ..errors import FitError
from .style import COLOURS, MUTED, figure, legend, quantity

_HEIGHT, _WIDE = 300, 420
_TEN = float(np.log(10.0))


def _page(path: Path, title: str, sentences: Sequence[str], figures: Sequence[Any]) -> None:
    """One HTML file that opens without a network."""
    told = "".join(f"<p>{escape(one)}</p>" for one in sentences)
    style = "<style>body{font-family:sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}</style>"
    head = Div(text=f"{style}<h1>{escape(title)}</h1>{told}")
    write_whole(path, file_html(column(head, *figures, sizing_mode="stretch_width"), INLINE, title))


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
            made = figure(height=_HEIGHT, width=_WIDE, y_range=(0.0, top))
            made.scatter(run[name], values, size=5, color=COLOURS[k % len(COLOURS)], alpha=0.7)
            made.xaxis.axis_label = quantity(name)
            made.yaxis.axis_label = f"left, {found.unit}"
            made.title.text = "before" if k == 0 else "after" if len(places) == 2 else f"run {k + 1}"
            pair.append(made)
        figures.append(row(*pair))
    told = [found.headline, *(f"{' or '.join(tie)}: these runs cannot tell" for tie in found.indistinguishable)]
    poses = [", ".join(f"{name} {value:.4g}" for name, value in pose.items()) for pose in found.next_poses]
    _page(path, title, [*told, found.advice, *poses], figures)


def write_history(path: Path, found: History, title: str) -> None:
    """The error of each run, and of what has changed its course with deviations; what stood still is left out."""
    dates = [f"{k + 1}: {run['date']}" for k, run in enumerate(found.runs)]
    errors = figure(height=_HEIGHT, x_range=dates, sizing_mode="stretch_width")
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
        made = figure(height=_HEIGHT, x_range=dates, sizing_mode="stretch_width")
        made.scatter(dates, middle, color=COLOURS[(k + 1) % len(COLOURS)], size=8)
        made.line(dates, middle, color=MUTED)
        made.add_layout(Whisker(base="x", lower="low", upper="high", source=ends))
        made.yaxis.axis_label = f"{name}, {shown}"
        figures.append(made)
    told = [f"{found.verdict}.", *map(str, found.changes), f"{len(found.stood_still)} others stood still."]
    _page(path, title, told, figures)


def write_adaptive(path: Path, loop: Adaptive, title: str) -> None:
    """The story of a run that chose its poses: the evidence of what led in the end, reading after reading."""
    looks = loop.looks
    made = figure(height=_HEIGHT + 60, sizing_mode="stretch_width")
    made.xaxis.axis_label, made.yaxis.axis_label = "readings", "evidence, powers of ten"
    readings = [one.readings for one in looks]
    made.line(readings, [one.log_evidence / _TEN for one in looks], color=MUTED, line_dash="dashed",
              legend_label="anything is missing")  # fmt: skip
    # what led, and what else would have done; the leader with something besides is no story
    lead = {name for name, _ in looks[-1].sets[0][0]} if looks else set()
    last = (
        [one for k, one in enumerate(looks[-1].sets) if not k or not lead <= {n for n, _ in one[0]}][:3]
        if looks
        else []
    )
    for k, (keys, _) in enumerate(last):
        names = frozenset(name for name, _ in keys)
        values = [max((v for other, v in one.sets if frozenset(n for n, _ in other) == names), default=np.nan) / _TEN
                  for one in looks]  # fmt: skip
        made.line(readings, values, color=COLOURS[k], line_width=2, legend_label=" & ".join(sorted(names)))
        made.scatter(readings, values, color=COLOURS[k], size=6)
    if last:
        legend(made)
    data = loop.data
    where = figure(height=_WIDE, width=_WIDE, sizing_mode="fixed")
    x, y = list(data.layout.coordinates)[:2]
    places = data.readings[:, :2]
    where.scatter(places[:, 0], places[:, 1], size=6, color=COLOURS[0], alpha=0.7)
    where.xaxis.axis_label, where.yaxis.axis_label = quantity(x), quantity(y)
    _page(path, title, [loop.sentence(), loop.why, *loop.told()], [made, where])
