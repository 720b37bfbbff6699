"""Candidates: the error that each effect would leave if it were added, with its uncertainty."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.core.properties import value
from bokeh.models import FactorRange, Range1d, Span, Whisker

from ..diagnosis import Diagnosis, largest
from .picture import Picture, Tables, single, sources_of
from .style import ADDED, FONT, FONT_SIZE, INK, MUTED, PLAIN, REFUSED, figure, hover

_ROW_HEIGHT, _AROUND = 30, 110


def candidates(found: Diagnosis) -> Picture[Diagnosis]:
    """A line for every effect that could be tried: error on poses held out, with two standard errors.

    Blue: named by the diagnosis. Grey: tried. Crosses: only at an implausible size. Effects that the rows cannot
    tell apart stand together behind a bracket. Dashed: the error without any of them; dotted: the noise.
    """
    sources = sources_of(_tables(found))
    names = _names(found)
    low, high = _reach(found)
    made = figure(
        height=_ROW_HEIGHT * len(names) + _AROUND, sizing_mode="stretch_width", x_axis_type="log",
        y_range=FactorRange(*names[::-1]), x_range=Range1d(low, high),
    )  # fmt: skip
    made.xaxis.axis_label = f"RMS error {found.error.in_words} on poses held out with it in the model, {found.unit}"
    made.add_layout(
        Whisker(base="effect", lower="low", upper="high", source=sources["effects"], dimension="width",
                line_color=MUTED, upper_head=None, lower_head=None, line_width=2)
    )  # fmt: skip
    marks = made.scatter(
        "error", "effect", source=sources["effects"], size=13, marker="marker", fill_color="fill", line_color="line",
        line_width=2,
    )  # fmt: skip
    made.add_layout(Span(location=found.steps[0].error.rms, dimension="height", line_color=INK, line_dash="dashed"))
    noise = _noise(found)
    if noise:
        made.add_layout(Span(location=noise, dimension="height", line_color=MUTED, line_dash="dotted", line_width=2))
    made.segment("x0", "y0", "x1", "y1", source=sources["brackets"], line_color=INK, line_width=2)
    text: dict[str, Any] = {"text_font_size": FONT_SIZE, "text_font": value(FONT), "text_color": INK}
    made.text("x", "y", "text", source=sources["tied"], text_baseline="middle", x_offset=6, **text)
    made.add_tools(
        hover([marks], ("effect", "@effect (@link)"), ("held out", f"@error{{0.00}} ± @std{{0.00}} {found.unit}"),
              ("p", "@p{0.0e}"), ("largest parameter", "@largest"), ("size", "@size"))
    )  # fmt: skip
    made.ygrid.grid_line_color = None

    def tune(new: Diagnosis) -> None:
        made.y_range.factors = _names(new)[::-1]
        made.x_range.start, made.x_range.end = _reach(new)
        made.height = _ROW_HEIGHT * len(_names(new)) + _AROUND

    note = (
        "Error with two standard errors. Blue: named by the diagnosis; grey: tried; a cross: only at an implausible "
        f"size. Dashed: the error without any of them.{' Dotted: the noise.' if noise else ''}"
        f"{' Behind a bracket: effects that these rows cannot tell apart.' if found.indistinguishable else ''}"
    )
    return Picture("candidates", single("candidates", made), sources, _tables, tune, note=note)


def _order(found: Diagnosis) -> list[Any]:
    """Effects as reported, with those tied to one right behind it."""
    reports = {c.effect: c for c in found.candidates}
    out: list[str] = []
    for c in found.candidates:
        tied = next((t for t in found.indistinguishable if c.effect in t), (c.effect,))
        out += [name for name in tied if name in reports and name not in out]
    return [reports[name] for name in out]


def _names(found: Diagnosis) -> list[str]:
    return [c.effect for c in _order(found)]


def _noise(found: Diagnosis) -> float:
    if found.noise_origin == "unknown":
        return 0.0
    return found.noise_size


def _reach(found: Diagnosis) -> tuple[float, float]:
    values = [max(c.held_out_rms, 1e-12) for c in found.candidates] + [found.steps[0].error.rms]
    # an addition that overfits a small run may hold out absurdly badly; it need not set the scale
    top = min(max(values), 5 * found.steps[0].error.rms)
    low = min([*values, *map(_lowest, found.candidates), _noise(found) or np.inf])
    return 0.85 * low, 1.1 * top * (top / low) ** 0.2


def _lowest(candidate: Any) -> float:
    """Lower end of the interval; a logarithmic axis has no place for zero."""
    return float(max(candidate.held_out_rms - 2 * candidate.held_out_std, 0.3 * candidate.held_out_rms, 1e-12))


def _tables(found: Diagnosis) -> Tables:
    order = _order(found)
    high = _reach(found)[1]
    named = set(found.effects)
    colours = [ADDED if c.effect in named else PLAIN if c.plausible else REFUSED for c in order]
    table = {
        "effect": [c.effect for c in order],
        "link": [c.link for c in order],
        "error": [min(c.held_out_rms, 0.98 * high) for c in order],
        "std": [c.held_out_std for c in order],
        "low": [_lowest(c) for c in order],
        "high": [min(c.held_out_rms + 2 * c.held_out_std, high) for c in order],
        "p": [c.p_value for c in order],
        "largest": [largest(found, c) for c in order],
        "size": ["plausible" if c.plausible else "implausible" for c in order],
        "fill": [
            colour if c.plausible or c.effect in named else "white" for c, colour in zip(order, colours, strict=True)
        ],
        "line": colours,
        "marker": ["circle" if c.plausible or c.effect in named else "x" for c in order],
    }
    return {"effects": table} | _brackets(found, [c.effect for c in order])


def _brackets(found: Diagnosis, order: list[str]) -> Tables:
    """A bracket at the right edge for every group that the rows cannot tell apart."""
    low, high = _reach(found)
    stem, tick = (low * (high / low) ** part for part in (0.89, 0.875))
    lines: list[tuple[float, str, float, str]] = []
    texts: list[tuple[float, str, str]] = []
    for tie in found.indistinguishable:
        here = [name for name in order if name in tie]
        if len(here) > 1:
            lines += [(stem, here[0], stem, here[-1]), *((tick, name, stem, name) for name in here)]
            texts.append((stem, here[0], "tied"))
    return {
        "brackets": dict(zip(("x0", "y0", "x1", "y1"), map(list, zip(*lines, strict=True)), strict=True))
        if lines
        else {key: [] for key in ("x0", "y0", "x1", "y1")},
        "tied": {key: [text[k] for text in texts] for k, key in enumerate(("x", "y", "text"))},
    }
