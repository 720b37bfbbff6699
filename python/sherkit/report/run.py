"""The run in time: what was left, reading after reading, with the temperature or any other covariate below it."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.models import Span

from .picture import Picture, Tables, sources_of, stacked, thinned
from .residuals import Residuals, at_the_rim
from .style import COLOURS, MARKERS, MUTED, figure, hover, legend, quantity

_HEIGHT, _BELOW = 320, 150
MOST_POINTS = 4000
#: Fewer readings than this are drawn larger.
_FEW = 300
#: That stand beside a low figure.
_LETTERS = 15


def run_in_time(left: Residuals) -> Picture[Residuals]:
    """All readings in the order they were taken; outliers larger. Covariates that vary stand below on the same axis."""
    sources = sources_of(_tables(left))
    made = figure(height=_HEIGHT, sizing_mode="stretch_width", tools="pan,box_zoom,wheel_zoom,box_select,reset")
    made.yaxis.axis_label = f"residual, {left.unit}"
    made.add_layout(Span(location=0, dimension="width", line_color=MUTED))
    for k, name in enumerate(left.names):
        dots = made.scatter(
            "t", f"r{k}", source=sources["run"], color=COLOURS[k % len(COLOURS)], marker=MARKERS[k % len(MARKERS)],
            size="size", alpha=0.8 if len(left) < _FEW else 0.45, legend_label=name,
        )  # fmt: skip
        made.add_tools(
            hover([dots], ("", name), ("residual", f"@r{k}{{0.0}} {left.unit}@beyond"), (left.counted, "@line"))
        )
    legend(made)
    figures = [made]
    for name in _below(left):
        lower = figure(height=_BELOW, sizing_mode="stretch_width", x_range=made.x_range)
        label = quantity(name)
        lower.yaxis.axis_label = label if len(label) <= _LETTERS else label[: _LETTERS - 1] + "…"
        lower.yaxis.ticker.desired_num_ticks = 3
        lower.scatter("t", name, source=sources["run"], size=4, color=MUTED)
        figures.append(lower)
    figures[-1].xaxis.axis_label = "time, s" if "time_s" in left.variables else "reading"
    n = len(left)
    drawn = (
        f"{MOST_POINTS} of {n} rows, chosen at random, marked outliers first" if n > MOST_POINTS else f"all {n} rows"
    )
    note = f"What the model leaves, in the order of the run: {drawn}. Rows that are left out stand at the rim."
    return Picture("run", stacked("run", figures, sizing_mode="stretch_width"), sources, _tables, note=note)


def _below(left: Residuals) -> list[str]:
    """Covariates, not coordinates, joints, directions or time; at most two."""
    known = {*left.place, "time_s"}
    names = [
        n for n in left.variables if n not in known and not n.startswith(("direction_", "q1", "q2", "q3", "theta"))
    ]
    return names[:2]


def _tables(left: Residuals) -> Tables:
    rows = np.asarray(thinned(len(left), MOST_POINTS, np.flatnonzero(left.outlier)))
    time = left.variables.get("time_s", left.row.astype(float))
    table: dict[str, Any] = {"t": time[rows], "line": left.line[rows].astype(np.int32)}
    table["size"] = np.where(left.outlier[rows], 11, 7 if len(left) < _FEW else 4)
    values, beyond = at_the_rim(left, left.values)
    table |= {f"r{k}": values[rows, k].astype(np.float32) for k in range(len(left.names))}
    table["beyond"] = [beyond[row] for row in rows]
    table |= {name: left.variables[name][rows] for name in _below(left)}
    return {"run": table}
