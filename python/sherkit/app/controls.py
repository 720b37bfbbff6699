"""Buttons, fields, texts and the rows that a person chose: one size of type, colours that can be read, a place for each
sentence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import Button, CustomJS, Div, TextInput

from ..report.picture import Picture
from .page_state import ROWS, PageState, Said
from .workbench import Workbench

#: Of a sentence about a mistake, as the page defines it for light and dark; on white it has a contrast of 7 (the orange
#: of the pictures has 3.9).
WRONG = "var(--wrong)"
#: One size of type for what is pressed, chosen and typed, and colours of buttons on which white can be read.
TYPE = """
:host, .bk-btn, .bk-input, .bk-input-group, label { font-size: 16px !important; }
:host, label { color: var(--ink); }
.bk-input { color: var(--ink) !important; background-color: var(--paper) !important; }
.bk-btn-success, .bk-btn-success:hover { background: #00664b !important; border-color: #00664b !important; }
.bk-btn-primary, .bk-btn-primary:hover { background: #005a8e !important; border-color: #005a8e !important; }
.bk-btn-default { color: #222 !important; border-color: #767676 !important; }
.bk-btn:disabled, .bk-btn[disabled] { opacity: 1 !important; color: #595959 !important; background: #eee !important; }
.bk-btn:focus-visible, .bk-input:focus-visible { outline: 3px solid var(--part) !important; outline-offset: 1px; }
"""
TEXT = {"font-size": "16px", "color": "var(--ink)"}


def button(label: str, name: str, **settings: Any) -> Button:
    """A button in the page's type."""
    return Button(label=label, name=name, stylesheets=[TYPE], **settings)


def text(name: str, **settings: Any) -> Div:
    """A text that changes."""
    settings.setdefault("sizing_mode", "stretch_width")
    return Div(name=name, styles=TEXT, **settings)


class Notices:
    """What is said beside the controls: one place for each of them, and the effects share one."""

    def __init__(self, *controls: str) -> None:
        self.place = {one: text(f"error_{one}", visible=False) for one in controls}

    def show(self, said: Said, elsewhere: str, *, wrong: bool) -> None:
        """Shows a sentence, ``elsewhere`` where no place is known for what it is about."""
        div = self.place.get(said.about, self.place[elsewhere])
        words = escape(said.text)
        div.text = (
            f'<b role="alert" style="color:{WRONG}">{words}</b>' if wrong else f'<span role="status">{words}</span>'
        )
        div.visible = True

    def clear(self) -> None:
        """What was wrong before is no longer of interest."""
        for div in self.place.values():
            div.visible = False


# -- The rows that a person chose -------------------------------------------------------------------------------------

_SHOWN = 40
_TELL = "window.sherkitChosen = cb_obj.tags; window.dispatchEvent(new Event('sherkit-chosen'))"
_NOTHING = "Select points in the pictures, or type their rows, to see which they are."


class Selection:
    """The chosen rows of a page."""

    def __init__(self, bench: Workbench, notices: Notices, do: Callable[[Callable[[], object]], None]) -> None:
        self._bench, self._notices, self._do = bench, notices, do
        self._page_state: PageState | None = None
        self._rows: tuple[int, ...] = ()
        #: Tables of the pictures in which rows can be chosen.
        self._brushable: list[Any] = []
        self._filling = False
        self._list = text("selection")
        self._list.js_on_change("tags", CustomJS(code=_TELL))
        self._mark = button("Mark as outliers", "mark", disabled=True, width=180)
        self._mark.on_click(self._marked)
        #: Stands beside what else changes the study.
        self.put_back = button("", "suspects", visible=False)
        self.put_back.on_click(lambda: do(bench.put_back))
        self._typed = TextInput(name="typed_rows", width=450, stylesheets=[TYPE])
        self._typed.on_change("value", lambda attr, old, new: self._select_typed())
        buttons = row(self._typed, self._mark, align="end", sizing_mode="stretch_width", styles={"flex-wrap": "wrap"})
        self.root = column(buttons, notices.place[ROWS], self._list, sizing_mode="stretch_width")

    def show(self, page_state: PageState) -> None:
        """Says what is suspected of a moment, and how rows are counted."""
        self._page_state = page_state
        count = len(page_state.left_out)
        self.put_back.visible, self.put_back.label = bool(count), f"Put back the {count} left out"
        lines = page_state.data.counted == "line"
        self._typed.title = f"Rows by their number {'in the file' if lines else 'from 0'}, such as 12, 40-45"
        self._draw()

    def watch(self, pictures: Mapping[str, Picture[Any]]) -> None:
        """Lets rows be chosen in these pictures."""
        self._brushable = [
            source
            for name, picture in pictures.items()
            for key, source in picture.sources.items()
            if (name == "map" and not key.endswith("_key")) or key == "points"
        ]
        for source in self._brushable:
            source.selected.on_change("indices", self._brush(source))

    def _brush(self, source: Any) -> Callable[[str, Any, list[int]], None]:
        def brushed(attr: str, old: Any, indices: list[int]) -> None:
            if not self._filling:
                members = _members(source)
                self.select([row for k in indices for row in members[k]], source)

        return brushed

    def select(self, rows: Sequence[int], brushed: Any = None) -> None:
        """Takes rows as chosen, lists them, and shows them in every picture but the one they were brushed in."""
        chosen = set(rows)
        self._rows = tuple(sorted(chosen))
        self._filling = True
        for source in self._brushable:
            if source is not brushed:
                found = enumerate(_members(source)) if chosen else ()
                source.selected.indices = [k for k, members in found if not chosen.isdisjoint(members)]
        self._filling = False
        # shows the workspace which poses are chosen: it knows each by one of its lines
        data = None if self._page_state is None else self._page_state.data
        here = [] if data is None else data.line[np.isin(data.groups, data.groups[list(self._rows)])].tolist()
        self._list.tags = here
        self._draw()

    def _select_typed(self) -> None:
        """Rows given by their numbers in the file."""
        page_state = self._page_state
        if page_state is None or not self._typed.value.strip():
            return
        line = page_state.data.line
        wanted = np.zeros(len(line), dtype=bool)
        for part in self._typed.value.split(","):
            low, dash, high = (one.strip() for one in part.partition("-"))
            if not _is_number(low) or (dash and not _is_number(high)):
                self._wrong(f"rows: expected numbers such as 12, 40-45, got '{part.strip()}'")
                return
            found = (line >= int(low)) & (line <= int(high or low))
            if not found.any():
                self._wrong(f"{page_state.data.source} has no row on {page_state.data.counted} {part.strip()}")
                return
            wanted |= found
        self._do(lambda: self.select(np.flatnonzero(wanted).tolist()))

    def _wrong(self, sentence: str) -> None:
        self._notices.show(Said(sentence, ROWS), ROWS, wrong=True)

    def _marked(self) -> None:
        rows = self._rows
        self._do(lambda: self._bench.mark_outliers(rows))
        self._typed.value = ""

    def _draw(self) -> None:
        self._mark.disabled = not self._rows
        page_state = self._page_state
        self._list.text = _NOTHING if page_state is None or not self._rows else _table(page_state, self._rows)


def _members(source: Any) -> Sequence[Sequence[int]]:
    """The rows of each mark in a picture."""
    data = source.data
    return data["rows"] if "rows" in data else np.asarray(data["row"])[:, None].tolist()


def _table(page_state: PageState, chosen: Sequence[int]) -> str:
    left = page_state.now
    index = {int(r): k for k, r in enumerate(left.row)}
    rows = [r for r in chosen if r in index]
    head = "".join(f"<th>{escape(n)}, {escape(left.unit)}</th>" for n in left.names)
    body = ""
    for r in rows[:_SHOWN]:
        k = index[r]
        cells = "".join(f"<td>{v:.1f}</td>" if np.isfinite(v) else "<td></td>" for v in left.values[k])
        marked = "marked" if left.outlier[k] else ""
        body += f"<tr><td>{int(left.line[k])}</td>{cells}<td>{marked}</td></tr>"
    more = f" (the first {_SHOWN} are listed)" if len(rows) > _SHOWN else ""
    return (
        f"<b>{len(chosen)} row{'s' if len(chosen) > 1 else ''}</b>{more}"
        "<table style='border-spacing:14px 2px'>"
        f"<tr><th>{escape(left.counted)}</th>{head}<th>mark</th></tr>{body}</table>"
    )


def _is_number(text: str) -> bool:
    """Whole, not negative, and no longer than a row can be."""
    return text.isdecimal() and len(text) <= 15
