"""Buttons, fields and texts of the page: one size of type, colours that can be read, a place for each sentence."""

from __future__ import annotations

from html import escape
from typing import Any

from bokeh.models import Button, Div

from .page_state import Said

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
            if div.visible:
                div.visible = False
