"""What a fit, a diagnosis, a study and a calibration show of themselves in a notebook.

Every cell is a page of its own in a frame: it needs no extension, no network, and nothing of the other cells.
"""

from __future__ import annotations

from html import escape
from typing import Any

from bokeh.layouts import column
from bokeh.models import Div

from ..diagnosis import Diagnosis
from ..errors import SherkitError
from ..fit.identify import Fit
from ..robots.calibrated import Calibration
from ..study import Study
from .candidates import candidates
from .error_history import error_history, error_history_of
from .parameters import parameters
from .picture import Picture
from .policy import page_of
from .residual_map import Change, residual_map
from .residuals import residuals_of
from .workspace import accuracy_map, accuracy_of

_HEIGHT_PX = 560


def pictures_of(value: Any) -> list[Picture[Any]]:
    """The pictures that say most about a value, the first one first. Raises ``TypeError`` for what has none."""
    if isinstance(value, Study):
        before = next((s.fit for s in value.history if s.fit is not None), value.fit)
        change = Change(
            residuals_of(before), residuals_of(value.fit), value.history[0].action, value.history[-1].action
        )
        return [error_history(error_history_of(value)), residual_map(change)]
    if isinstance(value, Diagnosis):
        change = Change(
            residuals_of(value.base), residuals_of(value.fit), "as it came", " and ".join(value.effects) or "the same"
        )
        shown: list[Picture[Any]] = [candidates(value)] if value.candidates else []
        return [*shown, residual_map(change)]
    if isinstance(value, Calibration):
        return [accuracy_map(accuracy_of(value))]
    if isinstance(value, Fit):
        left = residuals_of(value)
        return [residual_map(Change(left, left, "left by the fit", "left by the fit")), parameters(value)]
    raise TypeError(f"no picture is known for {type(value).__name__}")


def cell(value: Any) -> str | None:
    """HTML of a value for a notebook: its text, then its pictures; None where it has none to show."""
    try:
        pictures = pictures_of(value)
    except SherkitError:
        return None
    parts: list[Any] = [Div(text=f"<pre style='font-size:14px;white-space:pre-wrap'>{escape(str(value))}</pre>")]
    for one in pictures:
        parts += [one.root, Div(text=f"<p style='font-size:14px;color:#555'>{escape(one.note)}</p>", width=900)]
    page = page_of(column(*parts, sizing_mode="stretch_width"), "")
    return f'<iframe srcdoc="{escape(page)}" style="width:100%;height:{_HEIGHT_PX}px;border:none"></iframe>'
