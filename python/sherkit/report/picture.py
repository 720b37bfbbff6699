"""A picture: glyphs bound to named tables. A new state fills the tables anew; the glyphs stay.

So one builder serves a notebook, the offline report (which holds the tables of several states) and the live page.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, gridplot
from bokeh.models import (
    ColumnDataSource,
    CustomAction,
    CustomJS,
    LayoutDOM,
    UIElement,
)  # fmt: skip
from numpy.typing import NDArray

from ..base.figures import number as number

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


def float32(values: Any) -> NDArray[np.float32]:
    """Half the bytes; a pixel needs no more."""
    return np.asarray(values, dtype=np.float32)
