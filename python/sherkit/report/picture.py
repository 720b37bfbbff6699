"""A picture: glyphs bound to named tables. A new state fills the tables anew; the glyphs stay.

So one builder serves a notebook, the offline report (which holds the tables of several states) and the live page.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, Generic, TypeVar

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, gridplot
from bokeh.models import ColumnDataSource, CustomAction, CustomJS, LayoutDOM, UIElement

from ..base.types import Floats

# -- Residual maps as SVG -------------------------------------------------------------------------------------------

_PANEL, _GAP, _TOP = 300, 40, 70
_LOWER, _HIGHER = "#0072b2", "#d55e00"  # blue and orange, told apart by colour-blind people too
_MARGIN = 30


@dataclass(frozen=True, eq=False)
class Panel:
    """One map: where (n, 3) mm, the error there (n, 3) mm, and the length of the scale bar in µm."""

    title: str
    where_mm: Floats
    error_mm: Floats
    bar_um: float
    note: str = ""


def residual_maps(panels: Sequence[Panel], caption: str) -> str:
    """An SVG with the panels side by side on one scale of the workspace. Text is escaped."""
    reach = max(float(np.abs(p.where_mm[:, :2]).max(initial=1.0)) for p in panels)
    body = [_draw(p, _GAP + k * (_PANEL + _GAP), reach) for k, p in enumerate(panels)]
    width, height = _GAP + len(panels) * (_PANEL + _GAP), _TOP + _PANEL + 45
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" '
        'font-size="14">\n<style>.title{font-size:17px;font-weight:bold}</style>\n'
        f'<rect width="{width}" height="{height}" fill="#fafafa"/>\n'
        + "\n".join(body)
        + f'\n<text x="{_GAP}" y="{_TOP + _PANEL + 28}">{escape(caption)}</text>\n</svg>\n'
    )


def _draw(panel: Panel, x0: float, reach: float) -> str:
    centre = np.array([x0 + _PANEL / 2, _TOP + _PANEL / 2])
    per_um = 20.0 / panel.bar_um  # the bar is 20 pixels long
    rms = 1e3 * np.sqrt(np.mean(panel.error_mm**2)) if len(panel.error_mm) else 0.0
    note = panel.note or f"{rms:.1f} µm RMS; bar = {panel.bar_um:g} µm"
    parts = [
        f'<rect x="{x0}" y="{_TOP}" width="{_PANEL}" height="{_PANEL}" fill="#fff" stroke="#bbb"/>',
        f'<text x="{x0}" y="{_TOP - 32}" class="title">{escape(panel.title)}</text>',
        f'<text x="{x0}" y="{_TOP - 12}">{escape(note)}</text>',
    ]
    for point, error in zip(panel.where_mm, panel.error_mm * 1e3, strict=True):
        a = centre + point[:2] * [1, -1] * (_PANEL / 2 - _MARGIN) / reach
        b = a + error[:2] * [1, -1] * per_um
        strength = min(1.0, 0.25 + abs(float(error[2])) * per_um / 14)
        parts.append(
            f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}" '
            f'stroke="{_LOWER if error[2] < 0 else _HIGHER}" stroke-width="1.5" stroke-opacity="{strength:.2f}"/>'
            f'<circle cx="{a[0]:.1f}" cy="{a[1]:.1f}" r="1.2" fill="#444"/>'
        )
    right, bottom = x0 + _PANEL - 10, _TOP + _PANEL - 10
    parts.append(f'<line x1="{right - 20}" x2="{right}" y1="{bottom}" y2="{bottom}" stroke="#000" stroke-width="2"/>')
    return "\n".join(parts)


def round_bar(error_mm: Floats) -> float:
    """A round length for the scale bar, µm: near the largest error."""
    largest = 1e3 * float(np.abs(error_mm).max(initial=0.0))
    if largest <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(largest))
    return float(power * max(step for step in (1, 2, 5) if step * power <= largest))


# --------------------------------------------------------------------------------------------------------------

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

    def show(self, state: S) -> None:
        """Draws another state."""
        self.tune(state)
        for name, table in self.tables(state).items():
            self.sources[name].data = table


def sources_of(tables: Tables) -> dict[str, ColumnDataSource]:
    """A source for each table."""
    return {name: ColumnDataSource(table, name=name) for name, table in tables.items()}


def stacked(
    name: str, figures: list[Any], *, columns: int = 1, heading: UIElement | None = None, sizing_mode: Any = None
) -> LayoutDOM:
    """Figures in a grid with one toolbar, which saves the whole picture as PNG and SVG."""
    for one in figures:
        _lean(one)
    grid = gridplot(
        [figures[k : k + columns] for k in range(0, len(figures), columns)],
        merge_tools=True,
        sizing_mode=sizing_mode,
        toolbar_location="above",
        toolbar_options={"logo": None},
    )
    root: LayoutDOM = grid if heading is None else column(heading, grid, sizing_mode=sizing_mode)
    grid.toolbar.tools = [*grid.toolbar.tools, *_save_actions(name, root)]
    return root


def in_one_document(roots: Mapping[str, LayoutDOM]) -> dict[str, LayoutDOM]:
    """The same drawings in one document, made in one go: Bokeh would go through all of them again for each."""
    document = Document()
    # Bokeh looks for mistakes of who draws, among thousands of models: tests draw every picture, a reader waits
    document.validate = lambda: None
    with document.models.freeze():
        for root in roots.values():
            document.add_root(root)
    return dict(roots)


def single(name: str, figure: Any) -> LayoutDOM:
    """One figure whose toolbar saves it as PNG and SVG."""
    _lean(figure)
    figure.add_tools(*_save_actions(name, figure))
    root: LayoutDOM = figure
    return root


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


def thinned(count: int, most: int, keep: Any = None, seed: int = 0) -> Any:
    """Indices of rows to draw: all, or ``most`` of them at random (the same ones each time), ``keep`` among them."""
    if count <= most:
        return np.arange(count)
    rest = np.random.default_rng(seed).permutation(count)
    if keep is not None and len(keep):
        rest = np.concatenate([np.asarray(keep)[:most], rest[~np.isin(rest, keep)]])
    return np.sort(rest[:most])
