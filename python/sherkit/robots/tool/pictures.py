"""An estimate over time: the filter's value with its band, the raw sensor, the truth, and the force below; and the page
of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bokeh.models import Span
from numpy.typing import NDArray

from ...base.answer import Answer
from ...base.types import Floats
from ...diagnosis import Diagnosis
from ...report.notebook import telling_pictures
from ...report.page import Made, Section, html_sentences, write_page
from ...report.picture import (
    ADDED,
    COLOURS,
    INK,
    MUTED,
    PLAIN,
    Picture,
    Tables,
    figure,
    hover,
    legend,
    sources_of,
    stacked,
)
from .filters import Estimate

_HEIGHT, _BELOW = 320, 190
#: More steps than this are drawn as the extremes of equal stretches, so that no spike of any line is lost.
_MOST = 4000
_TWO_SIDED_95 = 1.959964
#: The force below which the paper trusts no depth, drawn for orientation.
_THRESHOLD_MN = 50.0
#: Innovations are drawn as their mean over this, s.
_MEAN_S = 1.0


@dataclass(frozen=True, eq=False)
class EstimateOverTime:
    """Values over ``time_s`` (n,): ``estimate`` and its ``std`` (n,) in ``unit``.

    ``others`` are further lines in the same unit by name (the sensor alone, the truth), NaN where there is none;
    ``force_mN`` (n,) stands below with the ``threshold_mN`` at which the sensor says little, and below that the
    ``innovation`` (n,): its square over its variance, mean over a while, 1 where the filter is right.
    """

    time_s: Floats
    estimate: Floats
    std: Floats
    name: str
    unit: str
    others: Mapping[str, Floats]
    force_mN: Floats | None = None
    threshold_mN: float | None = None
    innovation: Floats | None = None


def depth_over_time(e: Estimate) -> EstimateOverTime:
    """The depth of a tool's run, for the picture."""
    others = {"gratings": e.fibre_depth_mm}
    if e.run.depth_mm is not None:
        others["truth"] = e.run.depth_mm
    return EstimateOverTime(
        time_s=e.run.time_s, estimate=e.depth.value[:, 0], std=e.depth.std[:, 0], name="insertion depth", unit="mm",
        others=others, force_mN=np.linalg.norm(np.nan_to_num(e.force_mn), axis=1), threshold_mN=_THRESHOLD_MN,
        innovation=_innovations(e),
    )  # fmt: skip


def pictures_of_estimate(e: Estimate) -> list[Picture[EstimateOverTime]]:
    """What a notebook shows of it."""
    return [estimate_picture(depth_over_time(e))]


def _innovations(e: Estimate) -> Floats:
    """NIS of the depth per degree of freedom, mean over a while (n,); NaN where nothing was measured."""
    rows = max(1, round(_MEAN_S / e.run.step_s))
    window = np.ones(min(rows, len(e.run)))
    total, degrees = (np.convolve(v.astype(float), window, mode="same") for v in (e.depth.nis, e.depth.degrees))
    return np.where(degrees > 0.5, total / np.maximum(degrees, 1.0), np.nan)


def estimate_picture(state: EstimateOverTime, headline: str = "") -> Picture[EstimateOverTime]:
    """The estimate with its 95 % band, the other lines, and the force on the same axis of time, below a headline."""
    sources = sources_of(_tables(state))
    made = figure(height=_HEIGHT, sizing_mode="stretch_width")
    made.yaxis.axis_label = f"{state.name}, {state.unit}"
    made.varea("t", "low", "high", source=sources["run"], fill_color=ADDED, fill_alpha=0.22, legend_label="95 % band")
    for k, name in enumerate(state.others):
        truth = name == "truth"
        made.line(
            "t", f"other_{k}", source=sources["run"], color=INK if truth else (PLAIN, *COLOURS[1:])[k % 4],
            line_width=2, line_dash="dashed" if truth else "solid", legend_label=name,
            level="annotation" if truth else "glyph",  # above an estimate that is right
        )  # fmt: skip
    line = made.line("t", "estimate", source=sources["run"], color=ADDED, line_width=3.5, legend_label="estimate")
    made.add_tools(hover([line], ("time", "@t{0.00} s"), ("estimate", f"@estimate{{0.000}} {state.unit}")))
    made.legend.orientation = "horizontal"
    legend(made, "above")
    # what blows up where the force is small must not squeeze the rest
    made.y_range.start, made.y_range.end = _window(state)
    figures = [made]
    for column, label, colour, level in (
        ("force", "force, mN", COLOURS[1], state.threshold_mN), ("innovation", "innovation²", COLOURS[0], 1.0)
    ):  # fmt: skip
        if column in sources["run"].data:
            lower = figure(height=_BELOW, sizing_mode="stretch_width", x_range=made.x_range)
            lower.yaxis.axis_label = label
            lower.line("t", column, source=sources["run"], color=colour, line_width=2)
            if level is not None:
                lower.add_layout(Span(location=level, dimension="width", line_color=MUTED, line_dash="dotted"))
            figures.append(lower)
    figures[-1].xaxis.axis_label = "time, s"
    n = len(state.time_s)
    few = f" Of {n} steps the first, lowest and highest of equal stretches are drawn." if n > _MOST else ""
    below = " Below the dotted line the force says little." if state.threshold_mN is not None else ""
    if state.innovation is not None:
        below += " Innovations squared, over their variance, are 1 on average where the filter's noise is right."
        if not np.isfinite(state.innovation).all():
            below += f" Their line breaks where for {_MEAN_S:g} s no reading was used."
    note = f"The band holds the truth in 95 of 100 steps.{below}{few}"
    if headline:
        figures[0].title.text = headline
    return Picture("estimate", stacked("estimate", figures, sizing_mode="stretch_width"), sources, _tables, note=note)


def _window(state: EstimateOverTime) -> tuple[float, float]:
    values = [state.estimate, *(v for name, v in state.others.items() if name == "truth")]
    known = np.concatenate([v[np.isfinite(v)] for v in values])
    if not len(known):
        return 0.0, 1.0
    low, high = np.quantile(known, [0.002, 0.998])
    room = 0.15 * (high - low) or 1.0
    return float(low - room), float(high + room)


def _tables(state: EstimateOverTime) -> Tables:
    band = _TWO_SIDED_95 * state.std
    lines = {"estimate": state.estimate, "low": state.estimate - band, "high": state.estimate + band}
    lines |= {f"other_{k}": v for k, v in enumerate(state.others.values())}
    if state.force_mN is not None:
        lines["force"] = state.force_mN
    keep = _drawn(list(lines.values()))
    lines["t"] = state.time_s
    if state.innovation is not None:
        lines["innovation"] = state.innovation
    return {"run": {name: values[keep] for name, values in lines.items()}}


def _drawn(lines: Sequence[Floats]) -> NDArray[np.int64]:
    """Rows to draw: all, or the first of equal stretches with the lowest and the highest of every line."""
    n = len(lines[0])
    if n <= _MOST:
        return np.arange(n)
    starts = np.linspace(0, n, _MOST // 3, endpoint=False).astype(np.int64)
    keep = [starts]
    for values in lines:
        for filler, extreme in ((np.inf, np.minimum), (-np.inf, np.maximum)):
            filled = np.where(np.isfinite(values), values, filler)
            best = np.repeat(extreme.reduceat(filled, starts), np.diff([*starts, n]))
            # the first row of each stretch that has the extreme
            hit = np.flatnonzero(filled == best)
            stretch = np.searchsorted(starts, hit, side="right")
            keep.append(hit[np.unique(stretch, return_index=True)[1]])
    return np.unique(np.concatenate(keep))


def write_estimate(
    path: Path, answer: Answer, over_time: EstimateOverTime, tables: Sequence[str], made: Made,
    found: Diagnosis | None = None,
) -> None:  # fmt: skip
    """Depth and tip over a run, ``tables`` of their errors, and what a diagnosis ``found``, where one was asked. Raises
    :class:`~sherkit.errors.NotWritten`."""
    drawn = estimate_picture(over_time)
    sections = [Section(f"{over_time.name.capitalize()} over the run", "", drawn.root, drawn.note)]
    if any(tables):
        sections.append(Section("Errors", "".join(tables)))
    for k, picture in enumerate(telling_pictures(found) if found is not None else ()):
        title = "What is missing" if not k else f"What the camera sees, {k}"
        sections.append(Section(title, "", picture.root, picture.note))
    if found is not None:
        sections.append(Section("What the verdict rests on", html_sentences(*map(str, found.checks))))
    write_page(path, answer, sections, made)
