"""What values show of themselves in a notebook: fits, diagnoses, studies, calibrations, estimates of a tool, robots,
effects and catalogues.

Every cell is a page of its own in a frame, as high as what it shows: it needs no extension and no network. Bokeh, which
is large, stands once in a notebook, packed in the first cell that needs it; the frames of all cells read it there.
"""

from __future__ import annotations

import base64
import gzip
import sys
from collections.abc import Callable
from html import escape
from importlib import import_module
from typing import Any

import numpy as np
from bokeh.layouts import column
from bokeh.models import Div
from bokeh.resources import Resources

from ..base.figures import CALIBRATED, state_with
from ..changes import Comparison, History, Verification
from ..diagnosis import Diagnosis
from ..errors import SherkitError
from ..fit.identify import Fit
from ..model.effect import Catalogue, Effect
from ..model.kinds import Robot, known_kinds
from ..robots.calibrated import Calibration
from ..study import Study
from .candidates import candidates
from .card import card_page, effect_card, scene_of_robot
from .page import LATER, fresh_nonce, page_of
from .parameters import accuracy_map, accuracy_of, parameters
from .picture import Picture
from .residual_arrows import Change
from .residual_map import residual_map
from .residuals import ModelState
from .scene import script as scenes
from .states import error_history, error_history_of, states_so_far

#: Where the frames find Bokeh.
_BROUGHT = "sherkit-bokeh"
_BORROW = """
<script nonce="NONCE">
(async function borrow(left) {
  const held = window.parent.document.getElementById("BROUGHT")
  if (!held && left) return setTimeout(borrow, 100, left - 1)
  const gone = "The cell that brought Bokeh to this notebook is gone: restart the kernel, run again."
  if (!held) return document.body.prepend(gone)
  const packed = Uint8Array.from(atob(held.textContent), c => c.charCodeAt(0))
  const text = await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"))).text()
  ;(0, eval)(text)
  const run = () => { for (const one of document.querySelectorAll("script.LATER")) {
    const made = document.createElement("script")
    made.nonce = "NONCE"
    made.textContent = one.textContent
    document.body.append(made)
  } }
  if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", run); else run()
})(100)
</script>
"""
#: A frame is as high as its page, now and when this changes.
_FIT = """
<style>html, body { height: auto !important }</style>
<script nonce="NONCE">
if (window.frameElement) {
  const fit = () => { window.frameElement.style.height = document.documentElement.offsetHeight + 24 + "px" }
  new ResizeObserver(fit).observe(document.documentElement)
  fit()
}
</script>
"""
#: Where a frame may not ask for its height.
_HEIGHT_PX = 560


class _Bringer:
    """Which cell of the running notebook holds Bokeh."""

    cell: str | None = None

    @classmethod
    def asks(cls, here: str) -> bool:
        """Whether the cell ``here`` is to hold it: the first one that asked, each time that it is run."""
        if cls.cell is None:
            cls.cell = here
        return cls.cell == here


def telling_pictures(value: Any) -> list[Picture[Any]]:
    """The pictures that say most about a value, the first one first. Raises ``TypeError`` for what has none."""
    if isinstance(value, Study):
        states = [*states_so_far(value).values()]
        return [error_history(error_history_of(value)), _map(states[0], states[-1])]
    if isinstance(value, Diagnosis):
        shown: list[Picture[Any]] = [candidates(value)] if value.candidates else []
        told = ((CALIBRATED, value.base), (state_with(value.effects), value.fit))
        return [*shown, _map(*(ModelState(title, fit, value) for title, fit in told))]
    if isinstance(value, Calibration):
        return [accuracy_map(accuracy_of(value))]
    if isinstance(value, Fit):
        return [_map(one := ModelState("left by the fit", value), one), parameters(value)]
    drawn_by: str = getattr(value, "drawn_by", "")
    if drawn_by:
        module, _, name = drawn_by.partition(":")
        return list(getattr(import_module(module), name)(value))
    raise TypeError(f"no picture is known for {type(value).__name__}")


def _map(before: ModelState, after: ModelState) -> Picture[Change]:
    """What two fits leave, or the one where they leave the same."""
    same = np.array_equal(before.fit.residuals, after.fit.residuals, equal_nan=True)
    return residual_map(Change(before.left, after.left, before.title, after.title), alone=same)


def cell(value: Any) -> str | None:
    """HTML of a value for a notebook: its text, then its pictures; None where it has none to show."""
    try:
        if isinstance(value, Catalogue):
            return _framed(card_page("", [_table(value)]))
        if isinstance(value, Effect):
            return _framed(card_page("", [effect_card(value, _example_with(value))]))
        if isinstance(value, Study | Diagnosis | Calibration | Fit) or bool(getattr(value, "drawn_by", "")):
            return _with_bokeh(value, telling_pictures(value), _cards(value) if isinstance(value, Diagnosis) else "")
        if isinstance(value, Comparison | History | Verification):
            return _framed(card_page("", [_text(value)]))
        return _framed(card_page("", [_text(value), scene_of_robot(value).html()]))
    except SherkitError:
        return None


def _cards(found: Diagnosis) -> str:
    """The cards of what a diagnosis names."""
    named = (effect for effect in found.fit.model.effects if effect.name in found.effects)
    return "".join(effect_card(effect, fit=found.fit, found=found) for effect in named)


def _with_bokeh(value: Any, pictures: list[Picture[Any]], cards: str = "") -> str:
    """Text, ``cards`` and pictures of a value."""
    parts: list[Any] = [Div(text=_text(value))]
    for one in pictures:
        parts += [one.root, Div(text=f"<p style='font-size:14px;color:#555'>{escape(one.note)}</p>", width=900)]
    here, nonce = _cell_that_runs(), fresh_nonce()
    borrowed = (
        "" if here is None else _BORROW.replace("NONCE", nonce).replace("BROUGHT", _BROUGHT).replace("LATER", LATER)
    )
    page = page_of(column(*parts, sizing_mode="stretch_width"), "", nonce, borrowed)
    if cards:
        head, body, tail = page.rpartition("<body>")  # Bokeh's own text has one before it
        page = f'{head}{body}{cards}<script nonce="{nonce}">{scenes()}</script>{tail}'
    brings = ""
    if here is not None and _Bringer.asks(here):
        source = ";\n".join(Resources(mode="inline", components=["bokeh", "bokeh-widgets"]).js_raw)
        packed = base64.b64encode(gzip.compress(source.encode(), mtime=0)).decode()
        brings = f'<pre hidden id="{_BROUGHT}">{packed}</pre>'
    return brings + _framed(page, nonce)


def _framed(page: str, nonce: str = "") -> str:
    """A page in a frame as high as it is; its scripts have this number, or that which the page says."""
    nonce = nonce or page.split("'nonce-", 1)[1].split("'", 1)[0]
    head, _, tail = page.rpartition("</body>")  # Bokeh's own text has another
    page = f"{head}{_FIT.replace('NONCE', nonce)}</body>{tail}"
    return f'<iframe srcdoc="{escape(page)}" style="width:100%;height:{_HEIGHT_PX}px;border:none"></iframe>'


def _cell_that_runs() -> str | None:
    """What the notebook calls the cell that is run; None where none is, or nobody says which."""
    # in a notebook it is loaded
    ask: Callable[[], Any] = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)
    shell = ask()
    header = getattr(shell, "parent_header", None) or {}
    told = header.get("metadata", {}).get("cellId") if isinstance(header, dict) else None
    return str(told) if told else None


def _text(value: Any) -> str:
    return f"<pre style='font-size:14px;white-space:pre-wrap'>{escape(str(value))}</pre>"


def _example_with(effect: Effect) -> Robot | None:
    """A robot to draw a built-in effect on: the example of the first kind that has it."""
    for kind in known_kinds().values():
        if kind.model.catalogue.get(effect.name) == effect and kind.example is not None:
            robot: Robot = kind.example
            return robot
    return None


def _table(catalogue: Catalogue) -> str:
    rows = "".join(
        f"<tr><td><b>{escape(e.name)}</b></td><td>{escape(e.link)}</td><td>{escape(e.physics)}</td>"
        f"<td>{escape(e.residuals)}</td></tr>"
        for e in catalogue.values()
    )
    style = "td, th { text-align: left; vertical-align: top; padding: 2px 14px 6px 0 } table { font-size: 15px }"
    head = "".join(f"<th>{text}</th>" for text in ("effect", "link", "what it is", "how it shows"))
    return f"<style>{style}</style><table><tr>{head}</tr>{rows}</table>"
