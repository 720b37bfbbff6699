"""An estimate over time: the filter's value with its band, the raw sensor, the truth, and the force below."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from bokeh.models import Span
from numpy.typing import NDArray

from .picture import Picture, Tables, sources_of, stacked
from .style import ADDED, COLOURS, INK, MUTED, PLAIN, figure, hover, legend

Floats = NDArray[np.float64]

_HEIGHT, _BELOW = 320, 190
#: More steps than this are drawn as the extremes of equal stretches, so that no spike is lost.
_MOST = 4000
_TWO_SIDED_95 = 1.959964


@dataclass(frozen=True, eq=False)
class Estimate:
    """Values over ``time_s`` (n,): ``estimate`` and its ``std`` (n,) in ``unit``.

    ``others`` are further lines in the same unit by name (the sensor alone, the truth), NaN where there is none;
    ``force_mN`` (n,) stands below with the ``threshold_mN`` at which the sensor says little.
    """

    time_s: Floats
    estimate: Floats
    std: Floats
    name: str
    unit: str
    others: Mapping[str, Floats]
    force_mN: Floats | None = None
    threshold_mN: float | None = None


def estimate_picture(state: Estimate) -> Picture[Estimate]:
    """Estimate with its 95 % band, the other lines, and the force on the same axis of time."""
    sources = sources_of(_tables(state))
    made = figure(height=_HEIGHT, sizing_mode="stretch_width")
    made.yaxis.axis_label = f"{state.name}, {state.unit}"
    made.varea("t", "low", "high", source=sources["run"], fill_color=ADDED, fill_alpha=0.22, legend_label="95 % band")
    for k, name in enumerate(state.others):
        truth = name == "truth"
        made.line(
            "t", f"other_{k}", source=sources["run"], color=INK if truth else (PLAIN, *COLOURS[1:])[k % 4],
            line_width=2, line_dash="dashed" if truth else "solid", legend_label=name,
        )  # fmt: skip
    line = made.line("t", "estimate", source=sources["run"], color=ADDED, line_width=2.5, legend_label="estimate")
    made.add_tools(hover([line], ("time", "@t{0.00} s"), ("estimate", f"@estimate{{0.000}} {state.unit}")))
    legend(made)
    # what blows up where the force is small must not squeeze the rest
    made.y_range.start, made.y_range.end = _window(state)
    figures = [made]
    if state.force_mN is not None:
        lower = figure(height=_BELOW, sizing_mode="stretch_width", x_range=made.x_range)
        lower.yaxis.axis_label = "force, mN"
        lower.line("t", "force", source=sources["run"], color=COLOURS[1], line_width=2)
        if state.threshold_mN is not None:
            lower.add_layout(Span(location=state.threshold_mN, dimension="width", line_color=MUTED, line_dash="dotted"))
        figures.append(lower)
    figures[-1].xaxis.axis_label = "time, s"
    return Picture("estimate", stacked("estimate", figures, sizing_mode="stretch_width"), sources, _tables)


def _window(state: Estimate) -> tuple[float, float]:
    values = [state.estimate, *(v for name, v in state.others.items() if name == "truth")]
    known = np.concatenate([v[np.isfinite(v)] for v in values])
    if not len(known):
        return 0.0, 1.0
    low, high = np.quantile(known, [0.002, 0.998])
    room = 0.15 * (high - low) or 1.0
    return float(low - room), float(high + room)


def _tables(state: Estimate) -> Tables:
    keep = _drawn(state.estimate)
    band = _TWO_SIDED_95 * state.std
    table: dict[str, Any] = {
        "t": state.time_s[keep],
        "estimate": state.estimate[keep],
        "low": (state.estimate - band)[keep],
        "high": (state.estimate + band)[keep],
    }
    table |= {f"other_{k}": v[keep] for k, v in enumerate(state.others.values())}
    if state.force_mN is not None:
        table["force"] = state.force_mN[keep]
    return {"run": table}


def _drawn(values: Floats) -> NDArray[np.int64]:
    """Rows to draw: all, or the first, the lowest and the highest of equal stretches."""
    n = len(values)
    if n <= _MOST:
        return np.arange(n)
    stretches = np.array_split(np.arange(n), _MOST // 3)
    filled = np.nan_to_num(values)
    keep = [(s[0], s[np.argmin(filled[s])], s[np.argmax(filled[s])]) for s in stretches]
    return np.unique(np.array(keep))
