"""What is known after a fit: parameters with 95 % intervals, their correlations, the directions that the readings fix
worst; the accuracy to come over the workspace, and where to measure next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from textwrap import wrap
from typing import Any

import numpy as np
from bokeh.models import FactorRange, LinearColorMapper, Range1d, Whisker
from bokeh.transform import dodge, transform
from numpy.typing import NDArray

from ..base.types import Floats
from ..diagnosis.next_poses import SEPARATION
from ..fit.identify import Fit
from ..model.kinds import required_um
from ..robots.calibrated import Calibration
from .picture import (
    ADDED,
    DIVERGING_AREAS,
    INK,
    LETTERS,
    MUTED,
    REFUSED,
    SEQUENTIAL,
    Picture,
    Table,
    Tables,
    colour_bar,
    figure,
    float32,
    hover,
    padded,
    quantity,
    rule,
    sources_of,
)
from .residuals import Residuals

_ROW_HEIGHT, _AROUND = 26, 80
_CONFIDENCE = 1.959964
_MOST_CORRELATED = 40
_CELL = 24
#: Letters in a line of a direction's sentence, and height of a line and of a bar, px.
_LETTERS, _LINE, _BAR = 84, 20, 36


def parameters(fit: Fit) -> Picture[Fit]:
    """Every identified value with its 95 % interval, a panel for each unit.

    Dark: what the readings leave; pale: with what they do not tell at all, from plausible sizes.
    """
    sources = sources_of(_tables(fit))
    figures = []
    for unit in _units(fit):
        source = sources[f"unit_{unit}"]
        made = figure(f"identified error, {unit or 'relative'}", y_range=FactorRange(), x_range=Range1d())
        rule(made, "height", 0)
        for low, high, colour, width in (("low_all", "high_all", "#b5d3ea", 7), ("low", "high", ADDED, 3)):
            made.add_layout(
                Whisker(base="name", lower=low, upper=high, source=source, dimension="width", line_color=colour,
                        line_width=width, upper_head=None, lower_head=None)
            )  # fmt: skip
        dots = made.scatter("value", "name", source=source, size=7, color=INK)
        made.add_tools(
            hover([dots], ("parameter", "@name"), ("value", f"@value{{0.0000}} {unit}"), ("± readings", "@std{0.0000}"),
                  ("± total", "@std_all{0.0000}"))
        )  # fmt: skip
        figures.append(made)

    def tune(new: Fit) -> None:
        for table, made in zip(_tables(new).values(), figures, strict=False):
            names, reach = table["name"], padded(min(0.0, *table["low_all"]), max(0.0, *table["high_all"]))
            made.x_range.start, made.x_range.end = reach.start, reach.end
            made.y_range.factors = names[::-1]
            made.height = _ROW_HEIGHT * len(names) + _AROUND

    tune(fit)
    note = (
        "95 % intervals. Dark: what the readings leave. Pale: with what they do not tell at all, from plausible sizes."
    )
    return Picture.of("parameters", figures, sources, _tables, tune, note=note)


def _shown(unit: str) -> tuple[str, float]:
    """Angles are read in degrees."""
    return ("°", float(np.rad2deg(1.0))) if unit == "rad" else (unit, 1.0)


def _units(fit: Fit) -> list[str]:
    return list(dict.fromkeys(_shown(p.unit)[0] for p in fit.parameters))


def _tables(fit: Fit) -> Tables:
    out: Tables = {}
    for unit in _units(fit):
        rows = [k for k, p in enumerate(fit.parameters) if _shown(p.unit)[0] == unit]
        factor = np.array([_shown(fit.parameters[k].unit)[1] for k in rows])
        value = fit.values[rows] * factor
        table: Table = {"name": [fit.parameters[k].name for k in rows], "value": value}
        for ending, every in (("", fit.std_from_readings), ("_all", fit.std)):
            std = every[rows] * factor
            ends = {"low": value - _CONFIDENCE * std, "high": value + _CONFIDENCE * std, "std": std}
            table |= {f"{name}{ending}": column for name, column in ends.items()}
        out[f"unit_{unit}"] = table
    return out


def correlations(fit: Fit) -> Picture[Fit]:
    """Correlations of the identified values: what the readings cannot set apart, they set together."""
    names = [p.name for p in fit.parameters][:_MOST_CORRELATED]
    sources = sources_of(_correlation_tables(fit))
    mapper = LinearColorMapper(palette=DIVERGING_AREAS, low=-1, high=1)
    side = max(380, _CELL * len(names))
    made = figure(frame_width=side, frame_height=side, x_range=FactorRange(*names), y_range=FactorRange(*names[::-1]))
    cells = made.rect("a", "b", 1, 1, source=sources["cells"], fill_color=transform("value", mapper), line_color=None)
    made.xaxis.major_label_orientation = np.pi / 2
    made.grid.grid_line_color = None
    colour_bar(made, mapper, "correlation")
    made.add_tools(hover([cells], ("", "@a with @b"), ("correlation", "@value{0.000}")))
    note = (
        "Near 1 or -1: the readings tell the sum or the difference of two parameters, and hardly each of them. Blue: "
        "when one is larger, the other is smaller."
    )
    return Picture.of("correlations", made, sources, _correlation_tables, note=note)


def _correlation_tables(fit: Fit) -> Tables:
    names = [p.name for p in fit.parameters][:_MOST_CORRELATED]
    covariance = np.asarray(fit.covariance)[: len(names), : len(names)]
    std = np.sqrt(np.diag(covariance).clip(1e-300))
    matrix = np.clip(covariance / np.outer(std, std), -1.0, 1.0)
    a, b = zip(*product(names, names), strict=True)
    return {"cells": {"a": list(a), "b": list(b), "value": float32(matrix.ravel())}}


def directions(fit: Fit) -> Picture[Fit]:
    """Combinations of parameters that the readings fix worst, by how far one standard deviation moves them."""
    sources = sources_of(_direction_tables(fit))
    texts = sources["directions"].data["text"]
    # two sentences may be the same: rows have numbers
    lines = max((text.count("\n") + 1 for text in texts), default=1)
    row = _BAR + _LINE * lines
    made = figure(
        "one standard deviation, mm", height=row * max(len(texts), 1) + _AROUND, y_range=FactorRange(),
        x_range=Range1d(0.0, 1.0),
    )  # fmt: skip
    made.yaxis.visible = False
    made.ygrid.grid_line_color = None

    def tune(new: Fit) -> None:
        table = _direction_tables(new)["directions"]
        made.y_range.factors = table["row"][::-1]
        made.x_range.end = 1.08 * max([*table["std"], 1e-9])

    tune(fit)
    bar = 0.4 * _BAR / row
    # the bar lies low in its row; the sentence stands above it, since it may be long
    bars = made.hbar(
        dodge("row", -0.5 + 1.2 * bar, range=made.y_range), right="std", height=bar, source=sources["directions"],
        color=SEQUENTIAL[26],
    )  # fmt: skip
    made.text(
        0, dodge("row", -0.5 + 2.0 * bar, range=made.y_range), "text", source=sources["directions"],
        text_baseline="bottom", x_offset=4, **LETTERS,
    )  # fmt: skip
    made.add_tools(hover([bars], ("", "@text"), ("one standard deviation", "@std{0.0000} mm")))
    note = "A bar is as long as one standard deviation moves these parameters together: the readings hardly notice."
    return Picture.of("directions", made, sources, _direction_tables, tune, note=note)


def _direction_tables(fit: Fit) -> Tables:
    found = fit.badly_observed
    # the sentence ends in its size, which the bar shows
    texts = ["\n".join(wrap(str(d).rsplit(":", 1)[0], _LETTERS)) for d in found]
    rows = [str(k) for k in range(len(found))]
    return {"directions": {"row": rows, "text": texts, "std": [d.std for d in found]}}


# -- Where a robot is accurate, and where to measure next -------------------------------------------------------------

_PER_SIDE = 41
_PANEL = 240


@dataclass(frozen=True, eq=False)
class AccuracyMap:
    """Predicted accuracy (95 %), µm, on planes: ``value_um`` (planes, ny, nx), NaN out of reach, and ``unseen_um`` of
    it, which the poses could not show; ``measured`` likewise.

    ``x`` (nx,) and ``y`` (ny,) are places in the units of ``labels``, ``titles`` those of the planes.
    """

    x: Floats
    y: Floats
    labels: tuple[str, str]
    titles: tuple[str, ...]
    value_um: Floats
    unseen_um: Floats
    measured: NDArray[np.bool_]
    required_um: float | None


def accuracy_of(calibration: Calibration) -> AccuracyMap:
    """The accuracy of a calibration over the workspace, or over what was measured."""
    planes = calibration.planes(_PER_SIDE)
    value, unseen = np.full((2, len(planes.grid)), np.nan)
    promised = calibration.predicted_accuracies(np.ascontiguousarray(planes.grid[planes.inside]))
    value[planes.inside], unseen[planes.inside] = 1e3 * promised.total_mm, 1e3 * promised.addition_mm
    measured = calibration.measured_batch(planes.grid)
    shape = (len(planes.titles), len(planes.y), len(planes.x))
    return AccuracyMap(
        planes.x, planes.y, planes.labels, planes.titles, value.reshape(shape), unseen.reshape(shape),
        measured.reshape(shape), required_um(calibration.robot),
    )  # fmt: skip


def accuracy_map(state: AccuracyMap) -> Picture[AccuracyMap]:
    """A panel for each height: radius that holds the mean of many visits in 95 of 100 cases; the region within the
    requirement outlined.

    Hatched where no pose was measured: there it is extrapolation and holds only as far as the model does.
    """
    known = state.value_um[np.isfinite(state.value_um)]
    high = float(np.quantile(known, 0.99)) if len(known) else 0.0
    # from zero to beyond the requirement: a nearly even map must look even
    mapper = LinearColorMapper(palette=SEQUENTIAL, low=0.0, high=max(high, 1.5 * (state.required_um or 0.0)) or 1.0)
    mapper.nan_color = "rgba(0, 0, 0, 0)"
    sources = sources_of(_accuracies(state))
    x_range, y_range = padded(state.x[0], state.x[-1], 0.03), padded(state.y[0], state.y[-1], 0.03)
    figures = []
    for k, title in enumerate(state.titles):
        made = figure(*state.labels, frame_width=_PANEL, frame_height=_PANEL, x_range=x_range, y_range=y_range)
        made.title.text = title
        place = {"x": "x", "y": "y", "dw": "dw", "dh": "dh", "source": sources[f"plane_{k}"]}
        cells = made.image(image="um", color_mapper=mapper, **place)
        # hatched, not paler: pale means accurate
        made.quad(
            left="left", right="right", bottom="bottom", top="top", source=sources[f"beyond_{k}"], fill_color=None,
            line_color=None, hatch_pattern="right_diagonal_line", hatch_color=INK, hatch_alpha=0.6, hatch_scale=12,
            hatch_weight=1.0,
        )  # fmt: skip
        made.multi_line("xs", "ys", source=sources[f"outline_{k}"], line_color=REFUSED, line_width=3, line_cap="square")
        shown = (state.labels[0], "$x{0.0}"), (state.labels[1], "$y{0.0}"), ("95 % within", "@um{0.0} µm")
        made.add_tools(hover([cells], *shown, ("of it unseen", "@unseen{0.0} µm")))
        figures.append(made)
    colour_bar(figures[-1], mapper, "95 % within, µm")
    hidden = state.unseen_um[np.isfinite(state.unseen_um)]
    unseen = f" Of it up to {hidden.max():.1f} µm is what the poses could not show." if len(hidden) else ""
    outlined = ""
    if state.required_um:
        met = 100 * float(np.mean(known <= state.required_um)) if len(known) else 0.0
        outlined = f" Outlined: {state.required_um:g} µm or better ({met:.0f} % of what can be reached)."
    note = (
        "Radius around a commanded position within which the mean of many visits lies, in 95 of 100 cases; single "
        f"readings scatter about it.{outlined} Hatched: no pose was measured there.{unseen}"
    )
    return Picture.of("accuracy", figures, sources, _accuracies, note=note, columns=len(figures))


def _accuracies(state: AccuracyMap) -> Tables:
    out: Tables = {}
    (x0, dw), (y0, dh) = (_extent(v) for v in (state.x, state.y))
    for k in range(len(state.titles)):
        value = state.value_um[k]
        images = {"um": [float32(value)], "unseen": [float32(state.unseen_um[k])]}
        out[f"plane_{k}"] = images | {"x": [x0], "y": [y0], "dw": [dw], "dh": [dh]}
        out[f"beyond_{k}"] = _runs(state.x, state.y, ~state.measured[k] & np.isfinite(value))
        out[f"outline_{k}"] = _outline(state.x, state.y, value <= (state.required_um or 0.0))
    return out


def _extent(ticks: Floats) -> tuple[float, float]:
    """Lower edge and width of cells around ticks."""
    step = float(ticks[1] - ticks[0]) if len(ticks) > 1 and ticks[1] > ticks[0] else 1.0
    return float(ticks[0]) - 0.5 * step, step * len(ticks)


def _edges(ticks: Floats) -> Floats:
    """Those of the cells around ticks."""
    first, wide = _extent(ticks)
    return np.linspace(first, first + wide, len(ticks) + 1)


def _runs(x: Floats, y: Floats, inside: NDArray[np.bool_]) -> Table:
    """Cells that are inside, as one rectangle for every run of neighbours in a row."""
    across, up = _edges(x), _edges(y)
    row, edge = np.nonzero(np.diff(np.pad(inside, ((0, 0), (1, 1)))))
    # a run begins at every other edge of its row, and ends at the next
    row, first, end = row[::2], edge[::2], edge[1::2]
    return {"left": across[first], "right": across[end], "bottom": up[row], "top": up[row + 1]}


def _outline(x: Floats, y: Floats, inside: NDArray[np.bool_]) -> Table:
    """Edges of cells between inside and outside."""
    if len(x) < 2 or len(y) < 2:
        return {"xs": [], "ys": []}
    across, up = _edges(x), _edges(y)
    j, i = np.nonzero(np.diff(np.pad(inside, ((0, 0), (1, 1)))))
    upright = across[[i, i]], up[[j, j + 1]]
    j, i = np.nonzero(np.diff(np.pad(inside, ((1, 1), (0, 0))), axis=0))
    level = across[[i, i + 1]], up[[j, j]]
    xs, ys = (np.hstack(both).T.tolist() for both in zip(upright, level, strict=True))
    return {"xs": xs, "ys": ys}


@dataclass(frozen=True, eq=False)
class NextPoses:
    """Poses to measure next, in order, and where the run has been."""

    poses: Sequence[dict[str, float]]
    left: Residuals


def next_poses(state: NextPoses) -> Picture[NextPoses]:
    """Proposed poses, numbered in the order to measure them, seen from above and from the side."""
    sources = sources_of(_pose_tables(state))
    names = _drawn(state)
    pairs = [(names[0], names[1])] + ([(names[0], names[2])] if len(names) > 2 else [])
    figures = []
    spans = _spans(state, names)
    for k, (a, b) in enumerate(pairs):
        made = figure(
            quantity(a), quantity(b), frame_width=_PANEL + 60, frame_height=_PANEL + 60, x_range=Range1d(*spans[a]),
            y_range=Range1d(*spans[b]),
        )  # fmt: skip
        if a in sources["measured"].data and b in sources["measured"].data:
            made.scatter(a, b, source=sources["measured"], size=4, color=MUTED, alpha=0.5)
        if state.poses:
            dots = made.scatter(
                a, b, source=sources["next"], size=24, fill_color="white", line_color=REFUSED, line_width=2
            )
            made.text(
                "x", "y", "text", source=sources[f"orders_{k}"], text_align="center", text_baseline="middle", **LETTERS
            )
            made.add_tools(
                hover([dots], ("pose", "@order"), *((quantity(n), f"@{n}") for n in state.poses[0] if n != SEPARATION),
                      ("separation with it", "@separation_sigma{0.0} σ"))
            )  # fmt: skip
        figures.append(made)
    note = (
        "Numbered: poses to measure, in this order; 3× where three of them lie behind one another. Grey: poses of the "
        "run."
    )
    return Picture.of("next_poses", figures, sources, _pose_tables, note=note, columns=2)


def _drawn(state: NextPoses) -> list[str]:
    """What the poses are drawn by: what instruments show of the place, where the poses say it."""
    keys = [k for k in state.poses[0] if k != SEPARATION] if state.poses else list(state.left.place)[:2]
    return [k for k in keys if k in state.left.place] or keys


def _pose_tables(state: NextPoses) -> Tables:
    first = np.unique(state.left.group, return_index=True)[1][:2000]
    measured = {name: float32(v[first]) for name, v in state.left.place.items()}
    keys = list(state.poses[0]) if state.poses else []
    table: dict[str, Any] = {key: [pose[key] for pose in state.poses] for key in keys}
    table["order"] = [str(k) for k in range(1, len(state.poses) + 1)]
    out: Tables = {"measured": measured, "next": table}
    names = _drawn(state) if state.poses else []
    for k, (a, b) in enumerate([(0, 1), (0, 2)]):
        out[f"orders_{k}"] = _orders(table, names[a], names[b]) if len(names) > b else {"x": [], "y": [], "text": []}
    return out


def _orders(table: dict[str, Any], across: str, up: str) -> dict[str, list[Any]]:
    """The number of every pose; how many there are where they lie behind one another."""
    here: dict[tuple[float, float], list[str]] = {}
    for x, y, order in zip(table[across], table[up], table["order"], strict=True):
        here.setdefault((round(x, 2), round(y, 2)), []).append(order)
    texts = [orders[0] if len(orders) == 1 else f"{len(orders)}×" for orders in here.values()]
    return {"x": [x for x, _ in here], "y": [y for _, y in here], "text": texts}


def _spans(state: NextPoses, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Range of each coordinate; equally long where the units are the same, so that shapes are as they are."""
    ends: dict[str, tuple[float, float]] = {}
    for name in names:
        known = [*(pose[name] for pose in state.poses if name in pose), *state.left.place.get(name, ())]
        ends[name] = (float(min(known)), float(max(known))) if known else (0.0, 1.0)
    units = {quantity(name).partition(", ")[2] for name in names}
    longest = max((high - low for low, high in ends.values()), default=1.0)
    out = {}
    for name, (low, high) in ends.items():
        half = 0.58 * ((longest if len(units) == 1 else high - low) or 1.0)
        out[name] = (0.5 * (low + high) - half, 0.5 * (low + high) + half)
    return out
