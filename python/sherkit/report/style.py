"""How pictures look: one size of type, colours that colour-blind people tell apart, the same tools on every figure."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.models import BasicTickFormatter, ColorBar, FixedTicker, HoverTool, LogAxis, Range1d, Title
from bokeh.palettes import interp_palette
from bokeh.plotting import figure as bokeh_figure

from ..base.figures import number as number

#: One size for everything that is read, large enough for a projector.
FONT_SIZE = "16px"
FONT = "sans-serif"
INK, MUTED, RULE = "#222222", "#666666", "#d9d9d9"
#: Okabe and Ito's colours, which people with any colour vision tell apart; a marker of its own goes with each.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
MARKERS = ("circle", "triangle", "square", "diamond", "inverted_triangle", "hex")
ADDED, PLAIN, REFUSED = "#0072b2", "#8a8a8a", "#d55e00"
#: From below to above, dark in the middle so that small arrows stay visible on white.
DIVERGING = list(interp_palette(["#56b4e9", "#0072b2", "#3a3a3a", "#d55e00", "#f0a020"], 41))
#: The same with white in the middle, for areas.
DIVERGING_AREAS = list(interp_palette(["#0072b2", "#ffffff", "#d55e00"], 41))
SEQUENTIAL = list(interp_palette(["#f7fbff", "#9ecae1", "#2b8cbe", "#084081", "#1a1a2e"], 64))


def figure(**settings: Any) -> Any:
    """A Bokeh figure in the style of the house. Hover is the caller's; wheel zoom waits until it is asked for."""
    settings.setdefault("tools", "pan,box_zoom,wheel_zoom,reset")
    settings.setdefault("active_drag", None)
    # a low figure has no room for its tools on the right
    settings.setdefault("toolbar_location", "above")
    made = bokeh_figure(**settings)
    made.toolbar.logo = None
    made.toolbar.autohide = False
    for axis in (*made.xaxis, *made.yaxis):
        axis.axis_label_text_font_size = axis.major_label_text_font_size = FONT_SIZE
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_text_color = axis.major_label_text_color = INK
        axis.axis_label_text_font = axis.major_label_text_font = FONT
        axis.axis_line_color = axis.major_tick_line_color = MUTED
        axis.minor_tick_line_color = None
        if isinstance(axis, LogAxis):
            axis.ticker = FixedTicker(ticks=[m * 10.0**k for k in range(-6, 9) for m in (1, 2, 5)])
            axis.formatter = BasicTickFormatter(use_scientific=False)
    made.grid.grid_line_color = "#eeeeee"
    made.title.text_font_size = FONT_SIZE
    made.title.text_font = FONT
    made.title.text_color = INK
    made.outline_line_color = RULE
    return made


def hover(renderers: list[Any], *lines: tuple[str, str]) -> HoverTool:
    """Numbers on hover for these glyphs."""
    return HoverTool(renderers=renderers, tooltips=list(lines), description="numbers on hover", visible=False)


def legend(made: Any, place: str = "right") -> None:
    """A readable legend outside the data; a click hides a series. Below it leaves a narrow screen to the data."""
    for one in made.legend:
        one.label_text_font_size = FONT_SIZE
        one.label_text_font = FONT
        one.click_policy = "hide"
        one.border_line_color = None
        one.margin = 16 if place == "right" else 4
        one.background_fill_alpha = 0.0
        made.add_layout(one, place)


def colour_bar(made: Any, mapper: Any, text: str, **settings: Any) -> Title:
    """The meaning of colours on the right of a figure, named like an axis by what is returned."""
    made.add_layout(
        ColorBar(color_mapper=mapper, width=14, major_label_text_font_size=FONT_SIZE, major_label_text_font=FONT,
                 major_label_text_color=INK, **settings),
        "right",
    )  # fmt: skip
    title = Title(
        text=text, align="center", text_font_size=FONT_SIZE, text_font=FONT, text_font_style="normal", text_color=INK
    )
    made.add_layout(title, "right")
    return title


def padded(low: float, high: float, part: float = 0.06) -> Range1d:
    """A range with some room on both sides; some width even where all values are equal."""
    if not (np.isfinite(low) and np.isfinite(high)):
        low, high = 0.0, 1.0
    room = part * (high - low) or max(abs(high), 1.0) * part
    return Range1d(low - room, high + room)


def quantity(name: str) -> str:
    """A column's name as an axis label: ``x_mm`` becomes ``x, mm``."""
    for unit, text in _UNITS:
        if name.endswith("_" + unit):
            return f"{name[: -len(unit) - 1].replace('_', ' ')}, {text}"
    return name.replace("_", " ")


_UNITS = (
    ("rad_s", "rad/s"), ("mm", "mm"), ("um", "µm"), ("rad", "rad"), ("deg", "°"), ("s", "s"), ("c", "°C"), ("C", "°C"),
    ("px", "px"), ("mN", "mN"), ("N", "N"), ("kg", "kg"), ("h", "h"), ("arcsec", "″"),
)  # fmt: skip
