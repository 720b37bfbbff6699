"""The pictures of the page: maps before and after, what is left against a column, the fall, the parameters."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from typing import Any

from bokeh.layouts import column, row
from bokeh.models import Div, Select

from ..report.parameters import parameters
from ..report.picture import Picture
from ..report.residual_against import ResidualAgainst, residual_against
from ..report.residual_against import note as against_note
from ..report.residual_arrows import Change
from ..report.residual_map import residual_map
from ..report.states import ErrorHistory, ErrorOfStep, current_path, error_history
from ..report.style import MUTED, quantity
from .controls import TYPE, button
from .page_state import PageState

_WIDTH, _FALL_HEIGHT, _FALL_ROOM = 1000, 232, 350
#: The colour scale stands beside the panels of the map.
_BESIDE = 160
_SCALES = [("shared", "one scale for both"), ("own", "each its own scale"), ("noise", "in units of the noise")]
_MARKED, _MARKED_SHORT = " marked as outliers", " marked"


class Maps:
    """Two states of the study beside one another, as a person chose them."""

    def __init__(self, selected: Callable[[], None], watch: Callable[[dict[str, Picture[Any]]], None]) -> None:
        self._selected, self._watch = selected, watch
        self._page_state: PageState | None = None
        self._pictures: dict[str, Picture[Any]] = {}
        #: What the pictures were built for; other rows need new ones.
        self._built_for: tuple[Any, ...] = ()
        self._drawn: tuple[Any, ...] = ()
        self._history: tuple[Any, ...] = ()
        self._filling = False
        self._before = Select(title="Compare", name="before", width=250, stylesheets=[TYPE])
        self._after = Select(title="with", name="after", width=250, stylesheets=[TYPE])
        self._scale = Select(
            title="Arrows", name="scale", width=200, options=_SCALES, value="shared", stylesheets=[TYPE]
        )
        self._variable = Select(title="Residual against", name="variable", width=200, stylesheets=[TYPE])
        for one in (self._before, self._after, self._scale, self._variable):
            one.on_change("value", lambda attr, old, new: self._draw())
        self.choices = row(
            self._before, self._after, self._scale, styles={"flex-wrap": "wrap"}, visible=False
        )  # fmt: skip
        self.map = column(name="map", width=_WIDTH)
        self.variable = row(self._variable)
        self.against = column(name="against", width=_WIDTH)

    def show(self, page_state: PageState) -> None:
        """Goes to the state of a moment, where that is another one."""
        self._page_state = page_state
        if self._history != page_state.history:
            self._history = page_state.history
            self._fill(page_state)
            self._draw()

    def _fill(self, page_state: PageState) -> None:
        steps = [(str(k), state.title) for k, state in page_state.states.items()]
        self._before.options, self._after.options = steps, steps
        # one state alone is compared with nothing
        if self.choices.visible != (len(steps) > 1):
            self.choices.visible = len(steps) > 1
        self._quiet(self._before, steps[0][0])
        self._quiet(self._after, steps[-1][0])
        variables = list(page_state.now.variables)
        self._variable.options = [(name, quantity(name)) for name in variables]
        if self._variable.value not in variables:
            found = page_state.diagnosis
            first = [d.variable for d in found.where if d.variable in variables] if found is not None else variables
            self._quiet(self._variable, (first or variables)[0])

    def _quiet(self, select: Select, value: str) -> None:
        """Values set here must not redraw one after the other."""
        self._filling = True
        select.value = value
        self._filling = False

    def _draw(self) -> None:
        page_state = self._page_state
        if page_state is None or self._filling:
            return
        states = {str(k): state for k, state in page_state.states.items()}
        if not {self._before.value, self._after.value} <= set(states):
            return
        one, other = states[self._before.value], states[self._after.value]
        before, after = one.left, other.left
        # a browser says again what it was told to show
        wanted = (before, after, self._variable.value, self._scale.value)
        if wanted == self._drawn:
            return
        self._drawn = wanted
        change = Change(before, after, _short(one.title), _short(other.title), str(self._scale.value))
        lines = ResidualAgainst(after, str(self._variable.value), before if before is not after else None)
        key = (len(after), tuple(after.names), tuple(after.place))
        if self._built_for != key:
            self._built_for = key
            self._place("map", self.map, residual_map(change, planes_across=True, width_px=_WIDTH - _BESIDE))
            self._place("against", self.against, residual_against(lines))
            self._watch(self._pictures)
        else:
            self._pictures["map"].show(change)
            self._pictures["against"].show(lines)
        for made in self._pictures["map"].before:
            if made.visible != (before is not after):
                made.visible = before is not after
        self._selected()

    def _place(self, name: str, place: Any, picture: Picture[Any]) -> None:
        self._pictures[name] = picture
        note = against_note(self._page_state.now) if name == "against" and self._page_state else picture.note
        _name(picture, name)
        place.children = [
            picture.root, Div(text=escape(note), width=_WIDTH, styles={"font-size": "14px", "color": MUTED})
        ]  # fmt: skip


class Fall:
    """The fall of the error along the steps that led to where the study stands, and how well parameters are known."""

    def __init__(self) -> None:
        self._page_state: PageState | None = None
        self._pictures: dict[str, Picture[Any]] = {}
        #: What the pictures were built for; other readings or units need new ones.
        self._fall_for: bool | None = None
        self._parameters_for: tuple[str, ...] | None = None
        self._all = False
        self.fall = column(name="fall", sizing_mode="stretch_width")
        self.parameters = column(name="parameters", width=_WIDTH)
        self.unfold = button("", "unfold", width=250, visible=False)
        self.unfold.on_click(self._unfolded)

    def _unfolded(self) -> None:
        self._all = not self._all
        if self._page_state is not None:
            self.show(self._page_state)

    def show(self, page_state: PageState) -> None:
        """Draws the fall of a moment."""
        self._page_state = page_state
        path = current_path(page_state.history)
        folded = len(page_state.history) - len(path)
        self.unfold.visible = bool(folded)
        count = f"{folded} step{'s' if folded > 1 else ''}"
        self.unfold.label = f"Fold the {count} taken back" if self._all else f"Show {count} taken back"
        chosen = [s for k, s in enumerate(page_state.history) if self._all or k in path]
        steps = [ErrorOfStep.of(s, _short(s.action)) for s in chosen]
        left = page_state.now
        noise = left.noise_size if left.noise_origin != "unknown" else None
        state = ErrorHistory(steps, noise, left.unit, page_state.required_um if left.unit == "µm" else None)
        if self._fall_for != (noise is None):
            self._fall_for = noise is None
            self._put("fall", self.fall, error_history(state, height_px=_FALL_HEIGHT, room_px=_FALL_ROOM))
        else:
            self._pictures["fall"].show(state)

    def show_parameters(self, page_state: PageState) -> None:
        """Draws how well the parameters of a moment are known."""
        fit = page_state.history[-1].fit
        if fit is None:
            return
        units = tuple(dict.fromkeys(p.unit for p in fit.parameters))
        if self._parameters_for != units:
            self._parameters_for = units
            self._put("parameters", self.parameters, parameters(fit))
        else:
            self._pictures["parameters"].show(fit)

    def _put(self, name: str, place: Any, picture: Picture[Any]) -> None:
        self._pictures[name] = picture
        _name(picture, name)
        place.children = [picture.root]


def _short(action: str) -> str:
    return action.replace(_MARKED, _MARKED_SHORT)


#: What a canvas shows, for those who do not see it.
_CALLED = {
    "map": "maps of the error at every pose, before and after",
    "against": "what is left against a chosen column",
    "fall": "the fall of the error, step by step",
    "parameters": "identified parameters with their intervals",
}


def _name(picture: Picture[Any], name: str) -> None:
    picture.root.html_attributes = {"role": "group", "aria-label": _CALLED[name]}
