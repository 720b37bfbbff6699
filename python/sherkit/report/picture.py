"""Pictures and how they look: glyphs bound to named tables. A new state fills the tables anew; the glyphs stay.

So one builder serves a notebook, the offline report (which holds the tables of several states) and the live page.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from bokeh.core.properties import value
from bokeh.document import Document
from bokeh.layouts import gridplot
from bokeh.models import (
    BasicTickFormatter,
    ColorBar,
    ColumnDataSource,
    CustomAction,
    CustomJS,
    FixedTicker,
    HoverTool,
    LayoutDOM,
    LogAxis,
    Range1d,
    Span,
    Title,
)
from bokeh.palettes import interp_palette
from bokeh.plotting import figure as bokeh_figure
from numpy.typing import NDArray

from ..base.figures import number as number

# -- Style -------------------------------------------------------------------------------------------------------------
# How pictures look: one size of type, colours that colour-blind people tell apart, the same tools on every figure.

#: One size for everything that is read, large enough for a projector.
FONT_SIZE = "16px"
FONT = "sans-serif"
INK, MUTED, RULE = "#222222", "#666666", "#d9d9d9"
#: How glyphs of text are written.
LETTERS: dict[str, Any] = {"text_font_size": FONT_SIZE, "text_font": value(FONT), "text_color": INK}
#: Okabe and Ito's colours, which people with any colour vision tell apart; a marker of its own goes with each.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
MARKERS = ("circle", "triangle", "square", "diamond", "inverted_triangle", "hex")
ADDED, PLAIN, REFUSED = "#0072b2", "#8a8a8a", "#d55e00"
#: From below to above, dark in the middle so that small arrows stay visible on white.
DIVERGING = list(interp_palette(["#56b4e9", "#0072b2", "#3a3a3a", "#d55e00", "#f0a020"], 41))
#: The same with white in the middle, for areas.
DIVERGING_AREAS = list(interp_palette(["#0072b2", "#ffffff", "#d55e00"], 41))
SEQUENTIAL = list(interp_palette(["#f7fbff", "#9ecae1", "#2b8cbe", "#084081", "#1a1a2e"], 64))


_LOG_TICKS = [m * 10.0**k for k in range(-6, 9) for m in (1, 2, 5)]


def ticks_between(low: float, high: float) -> list[float]:
    """Of a logarithmic axis that reaches from ``low`` to ``high``: 1, 2, 5 of each decade; round numbers evenly apart
    where fewer than three of these lie between."""
    if sum(low <= tick <= high for tick in _LOG_TICKS) > 2:
        return _LOG_TICKS
    step = 10.0 ** np.floor(np.log10((high - low) / 3.0)) * np.array([1.0, 2.0, 5.0])
    step = float(step[step <= (high - low) / 3.0 * (1 + 1e-9)][-1])
    return [k * step for k in range(int(np.ceil(low / step)), int(high / step) + 1)]


def figure(across: str | None = None, up: str | None = None, **settings: Any) -> Any:
    """A Bokeh figure in the style of the house with what its axes say, as wide as there is room unless ``settings`` say
    how wide. Hover is the caller's; wheel zoom waits until it is asked for."""
    if not settings.keys() & {"width", "frame_width"}:
        settings.setdefault("sizing_mode", "stretch_width")
    settings.setdefault("tools", "pan,box_zoom,wheel_zoom,reset")
    settings.setdefault("active_drag", None)
    # a low figure has no room for its tools on the right
    settings.setdefault("toolbar_location", "above")
    made = bokeh_figure(**settings)
    made.xaxis.axis_label, made.yaxis.axis_label = across, up
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
            axis.ticker = FixedTicker(ticks=_LOG_TICKS)
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


def rule(made: Any, dimension: str, at: float, **line: Any) -> Span:
    """A line through the whole of a figure, along its "width" or "height"."""
    made.add_layout(one := Span(location=at, dimension=dimension, **{"line_color": MUTED, **line}))
    return one


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


def shortened(text: str, most: int) -> str:
    """A text of at most so many letters."""
    return text if len(text) <= most else text[: most - 1] + "…"


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


# -- Picture -----------------------------------------------------------------------------------------------------------

S = TypeVar("S")
Table = dict[str, Any]
Tables = dict[str, Table]

_SAVE = """
Bokeh.index.find_one(picture).export(kind, true).to_blob().then(blob => {
  const link = document.createElement("a")
  link.href = URL.createObjectURL(blob)
  link.download = name + "." + kind
  link.click()
})
"""


@dataclass(eq=False)
class Picture(Generic[S]):
    """A drawing and how a state fills it.

    ``root`` is what Bokeh shows; ``sources`` are its tables by name; ``tables`` computes their columns from a state;
    ``tune`` does what tables cannot (axis names), on a live page alone. ``note`` says in a sentence or two how to read
    it.
    """

    name: str
    root: LayoutDOM
    sources: Mapping[str, ColumnDataSource]
    tables: Callable[[S], Tables]
    tune: Callable[[S], None] = lambda _: None
    note: str = ""
    #: Figures that show what was before; a page hides them where there is nothing to compare with.
    before: Sequence[Any] = ()

    @classmethod
    def of(
        cls, name: str, figures: Any, sources: Mapping[str, ColumnDataSource], tables: Callable[[S], Tables],
        tune: Callable[[S], None] = lambda _: None, *, note: str = "", columns: int = 1, before: Sequence[Any] = (),
    ) -> Picture[S]:  # fmt: skip
        """A picture of one figure, or of a list in a grid of so many ``columns``; its toolbar saves it as PNG and
        SVG."""
        if isinstance(figures, list):
            root = stacked(name, figures, columns=columns, sizing_mode=figures[0].sizing_mode)
        else:
            _lean(figures)
            figures.add_tools(*_save_actions(name, figures))
            root = figures
        return Picture(name, root, sources, tables, tune, note, before)

    def show(self, state: S) -> None:
        """Draws another state."""
        self.tune(state)
        for name, table in self.tables(state).items():
            self.sources[name].data = table


def sources_of(tables: Tables) -> dict[str, ColumnDataSource]:
    """A source for each table."""
    return {name: ColumnDataSource(table, name=name) for name, table in tables.items()}


def stacked(name: str, figures: list[Any], *, columns: int = 1, sizing_mode: Any = None) -> LayoutDOM:
    """Figures in a grid, or None for a free place, with one toolbar, which saves the whole picture as PNG and SVG."""
    for one in filter(None, figures):
        _lean(one)
    grid = gridplot(
        [figures[k : k + columns] for k in range(0, len(figures), columns)],
        merge_tools=True,
        sizing_mode=sizing_mode,
        toolbar_location="above",
        toolbar_options={"logo": None},
    )
    grid.toolbar.tools = [*grid.toolbar.tools, *_save_actions(name, grid)]
    return grid


def in_one_document(roots: Mapping[str, LayoutDOM]) -> dict[str, LayoutDOM]:
    """The same drawings in one document, made in one go: Bokeh would go through all of them again for each."""
    document = Document()
    # Bokeh looks for mistakes of who draws, among thousands of models: tests draw every picture, a reader waits
    document.validate = lambda: None
    with document.models.freeze():
        for root in roots.values():
            document.add_root(root)
    return dict(roots)


def _lean(figure: Any) -> None:
    """Leaves to the browser what it makes by itself: how each glyph looks muted, or beside a selection where none was
    asked for. A seventh of all that would be written."""
    for one in figure.renderers:
        if one.muted_glyph != "auto":
            one.muted_glyph = "auto"
        aside = one.nonselection_glyph
        if aside != "auto" and all(getattr(aside, name, _ASIDE) == _ASIDE for name in ("line_alpha", "fill_alpha")):
            one.nonselection_glyph = "auto"


def _save_actions(name: str, picture: Any) -> list[CustomAction]:
    out = []
    for kind in ("png", "svg"):
        callback = CustomJS(args={"picture": picture, "kind": kind, "name": name}, code=_SAVE)
        # the icon says what is saved
        icon = f"data:image/svg+xml;utf8,{_ICON.format(text=kind.upper())}"
        out.append(CustomAction(icon=icon, description=f"save as {kind.upper()}", callback=callback))
    return out


#: Bokeh's own opacity of what is not selected.
_ASIDE = 0.1

_ICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="24" height="24">'
    '<text x="12" y="16" font-size="10" font-family="sans-serif" font-weight="bold" text-anchor="middle" '
    'fill="dimgray">{text}</text></svg>'
)


def rows_to_draw(count: int, most: int, keep: Any = None) -> Any:
    """Indices of rows to draw: all, or ``most`` of them at random (the same ones each time), ``keep`` among them."""
    if count <= most:
        return np.arange(count)
    rest = np.random.default_rng(0).permutation(count)
    if keep is not None and len(keep):
        rest = np.concatenate([np.asarray(keep)[:most], rest[~np.isin(rest, keep)]])
    return np.sort(rest[:most])


def spread_over(rows: Any, most: int) -> Any:
    """At most so many of the rows, evenly among them."""
    return rows[np.linspace(0, len(rows) - 1, min(len(rows), most)).astype(int)]


def float32(values: Any) -> NDArray[np.float32]:
    """Half the bytes; a pixel needs no more."""
    return np.asarray(values, dtype=np.float32)


def in_text(values: Any) -> str:
    """Numbers as a page holds them: base64 of little-endian float32."""
    return base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode("ascii")
