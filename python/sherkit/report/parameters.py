"""Parameters with 95 % intervals, their correlations, and the directions that the readings fix worst."""

from __future__ import annotations

from textwrap import wrap

import numpy as np
from bokeh.core.properties import value
from bokeh.models import FactorRange, LinearColorMapper, Range1d, Span, Whisker
from bokeh.transform import dodge, transform

from ..fit.identify import Fit
from .picture import Picture, Table, Tables, single, sources_of, stacked
from .style import ADDED, DIVERGING_AREAS, FONT, FONT_SIZE, INK, MUTED, SEQUENTIAL, colour_bar, figure, hover, padded

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
    tables = _tables(fit)
    sources = sources_of(tables)
    figures = []
    for unit in _units(fit):
        source = sources[_key(unit)]
        made = figure(
            height=_ROW_HEIGHT * len(source.data["name"]) + _AROUND, sizing_mode="stretch_width",
            y_range=FactorRange(*source.data["name"][::-1]), x_range=_reach(source.data),
        )  # fmt: skip
        made.xaxis.axis_label = f"identified error, {unit}" if unit else "identified error, relative"
        made.add_layout(Span(location=0, dimension="height", line_color=MUTED))
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
        for unit, made in zip(_units(new), figures, strict=False):
            table = _tables(new)[_key(unit)]
            names, reach = table["name"], _reach(table)
            made.x_range.start, made.x_range.end = reach.start, reach.end
            made.y_range.factors = names[::-1]
            made.height = _ROW_HEIGHT * len(names) + _AROUND

    note = (
        "95 % intervals. Dark: what the readings leave. Pale: with what they do not tell at all, from plausible sizes."
    )
    root = stacked("parameters", figures, sizing_mode="stretch_width")
    return Picture("parameters", root, sources, _tables, tune, note=note)


def _reach(table: Table) -> Range1d:
    return padded(min(0.0, *table["low_all"]), max(0.0, *table["high_all"]))


def _shown(unit: str) -> tuple[str, float]:
    """Angles are read in degrees."""
    return ("°", float(np.rad2deg(1.0))) if unit == "rad" else (unit, 1.0)


def _units(fit: Fit) -> list[str]:
    return list(dict.fromkeys(_shown(p.unit)[0] for p in fit.parameters))


def _key(unit: str) -> str:
    return f"unit_{unit}"


def _tables(fit: Fit) -> Tables:
    out: Tables = {}
    for unit in _units(fit):
        rows = [k for k, p in enumerate(fit.parameters) if _shown(p.unit)[0] == unit]
        factor = np.array([_shown(fit.parameters[k].unit)[1] for k in rows])
        value, std, std_all = (np.asarray(v)[rows] * factor for v in (fit.values, fit.std_from_readings, fit.std))
        out[_key(unit)] = {
            "name": [fit.parameters[k].name for k in rows],
            "value": value, "std": std, "std_all": std_all,
            "low": value - _CONFIDENCE * std, "high": value + _CONFIDENCE * std,
            "low_all": value - _CONFIDENCE * std_all, "high_all": value + _CONFIDENCE * std_all,
        }  # fmt: skip
    return out


def correlations(fit: Fit) -> Picture[Fit]:
    """Correlations of the identified values: what the readings cannot set apart, they set together."""
    names = [p.name for p in fit.parameters][:_MOST_CORRELATED]
    sources = sources_of(_correlation_tables(fit))
    mapper = LinearColorMapper(palette=DIVERGING_AREAS, low=-1, high=1)
    side = max(380, _CELL * len(names))
    made = figure(
        frame_width=side, frame_height=side, x_range=FactorRange(*names), y_range=FactorRange(*names[::-1]),
    )  # fmt: skip
    cells = made.rect("a", "b", 1, 1, source=sources["cells"], fill_color=transform("value", mapper), line_color=None)
    made.xaxis.major_label_orientation = np.pi / 2
    made.grid.grid_line_color = None
    colour_bar(made, mapper, "correlation")
    made.add_tools(hover([cells], ("", "@a with @b"), ("correlation", "@value{0.000}")))
    note = (
        "Near 1 or -1: the readings tell the sum or the difference of two parameters, and hardly each of them. Blue: "
        "when one is larger, the other is smaller."
    )
    return Picture("correlations", single("correlations", made), sources, _correlation_tables, note=note)


def _correlation_tables(fit: Fit) -> Tables:
    names = [p.name for p in fit.parameters][:_MOST_CORRELATED]
    covariance = np.asarray(fit.covariance)[: len(names), : len(names)]
    std = np.sqrt(np.diag(covariance).clip(1e-300))
    matrix = np.clip(covariance / np.outer(std, std), -1.0, 1.0)
    count = len(names)
    return {
        "cells": {
            "a": [names[k] for k in np.repeat(np.arange(count), count)],
            "b": [names[k] for k in np.tile(np.arange(count), count)],
            "value": matrix.ravel().astype(np.float32),
        }
    }


def directions(fit: Fit) -> Picture[Fit]:
    """Combinations of parameters that the readings fix worst, by how far one standard deviation moves them."""
    sources = sources_of(_direction_tables(fit))
    texts = sources["directions"].data["text"]
    # two sentences may be the same: rows have numbers
    lines = max((text.count("\n") + 1 for text in texts), default=1)
    row = _BAR + _LINE * lines
    made = figure(height=row * max(len(texts), 1) + _AROUND, sizing_mode="stretch_width", y_range=FactorRange())
    made.xaxis.axis_label = "one standard deviation, mm"
    made.yaxis.visible = False
    made.ygrid.grid_line_color = None

    def tune(new: Fit) -> None:
        table = _direction_tables(new)["directions"]
        made.y_range.factors = table["row"][::-1]
        made.x_range.end = 1.08 * max([*table["std"], 1e-9])

    made.x_range = Range1d(0.0, 1.0)
    tune(fit)
    bar = 0.4 * _BAR / row
    # the bar lies low in its row; the sentence stands above it, since it may be long
    bars = made.hbar(
        dodge("row", -0.5 + 1.2 * bar, range=made.y_range), right="std", height=bar, source=sources["directions"],
        color=SEQUENTIAL[26],
    )  # fmt: skip
    made.text(
        0, dodge("row", -0.5 + 2.0 * bar, range=made.y_range), "text", source=sources["directions"],
        text_font_size=FONT_SIZE, text_font=value(FONT), text_color=INK, text_baseline="bottom", x_offset=4,
    )  # fmt: skip
    made.add_tools(hover([bars], ("", "@text"), ("one standard deviation", "@std{0.0000} mm")))
    note = "A bar is as long as one standard deviation moves these parameters together: the readings hardly notice."
    return Picture("directions", single("directions", made), sources, _direction_tables, tune, note=note)


def _direction_tables(fit: Fit) -> Tables:
    found = fit.badly_observed
    # the sentence ends in its size, which the bar shows
    texts = ["\n".join(wrap(str(d).rsplit(":", 1)[0], _LETTERS)) for d in found]
    rows = [str(k) for k in range(len(found))]
    return {"directions": {"row": rows, "text": texts, "std": [d.std for d in found]}}
