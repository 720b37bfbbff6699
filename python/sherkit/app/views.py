"""What the page shows: the effects in the order of what each would leave, with a switch and a card for each; the maps,
what is left against a column, the fall, the parameters.

A place in the list shows whatever effect belongs there: nothing is laid out anew where the order changes, and the order
in which Tab goes is the one that is seen.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from html import escape
from typing import Any

from bokeh.layouts import column, row
from bokeh.models import Button, CustomJS, Div, Select

from ..diagnosis import Diagnosis
from ..model.effect import WITHIN, Effect
from ..report.card import drawing_of, indistinguishable, its_numbers, what_it_is
from ..report.parameters import parameters
from ..report.picture import MUTED, Picture, number, quantity
from ..report.residual_against import ResidualAgainst, residual_against
from ..report.residual_against import note as against_note
from ..report.residual_arrows import Change
from ..report.residual_map import residual_map
from ..report.states import ErrorHistory, ErrorOfStep, current_path, error_history
from .controls import TYPE, button
from .page_state import PageState

# -- The effects ------------------------------------------------------------------------------------------------------

_BUTTON, _LIST_WIDTH = 190, 356
#: An effect that leaves more, in % of what there is, has no bar.
_BRINGS_NOTHING = 97.0
_CARD = """
details { font-size: 15px; margin: 0 0 6px 6px; color: var(--ink); } summary { cursor: pointer; color: var(--link); }
summary:focus-visible { outline: 3px solid var(--part); } p { margin: 2px 0; line-height: 1.3; } h4 { margin: 5px 0 0; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 14px; }
th, td { text-align: right; padding: 1px 8px 1px 0; } th:first-child, td:first-child { text-align: left; }
"""
#: Bokeh makes a button anew where its label changes: who works with the keyboard must not lose the effect.
_KEEP_FOCUS = """
if (window.focusedEffect == button.label.slice(2)) setTimeout(() => {
    const free = document.activeElement == null || document.activeElement == document.body
    if (free) Bokeh.index.find_one(button)?.shadow_el?.querySelector("button")?.focus()
}, 50)
"""


class _Folding(ABC):
    """What shows a part of a moment, and all of it once its button was pressed."""

    def __init__(self, name: str, width: int) -> None:
        self._all = False
        self._page_state: PageState | None = None
        self.unfold = button("", name, width=width, visible=False)
        self.unfold.on_click(self._unfolded)

    def _unfolded(self) -> None:
        self._all = not self._all
        if self._page_state is not None:
            self.show(self._page_state)

    @abstractmethod
    def show(self, page_state: PageState) -> None:
        """Draws a moment."""


class EffectList(_Folding):
    """Switches for all effects; ``pressed`` is told which one a person wants in the model, or out of it."""

    def __init__(self, pressed: Callable[[str], object]) -> None:
        super().__init__("unfold_effects", _LIST_WIDTH - 12)
        self._pressed = pressed
        self._places: list[_Place] = []
        #: What each would leave, as a diagnosis said last, and which would not help: until the next one both stay.
        self._would: dict[str, float] = {}
        self._idle: frozenset[str] = frozenset()
        self._list = column(width=_LIST_WIDTH)
        self.root = column(self._list, self.unfold, width=_LIST_WIDTH)

    def show(self, page_state: PageState) -> None:
        """Draws the list of a moment."""
        self._page_state = page_state
        if page_state.diagnosis is not None:
            self._would = {c.effect: c.held_out_rms for c in page_state.diagnosis.candidates}
            self._idle = idle(page_state.diagnosis)
        every = ordered(page_state, self._would)
        folded = self._idle.intersection(every).difference(page_state.effects, page_state.own)
        names = every if self._all else [name for name in every if name not in folded]
        self.unfold.visible = bool(folded)
        self.unfold.label = f"{'Hide' if self._all else 'Show'} {len(folded)} that would not help"
        while len(self._places) < len(names):
            self._places.append(_Place(self._pressed))
        self._list.children = [place.root for place in self._places[: len(names)]]
        for name, place in zip(names, self._places, strict=False):
            place.show(name, page_state)


def idle(found: Diagnosis) -> frozenset[str]:
    """Effects that would leave no less than there is, as far as the blocks held out can tell, or cannot be tried.

    One that is named, or tied with one, is none of them.
    """
    kept = {*found.effects, *(name for tie in found.indistinguishable for name in tie)}
    now = found.steps[0].error.rms
    out = {c.effect for c in found.candidates if c.held_out_rms + 2 * c.held_out_std >= now}
    return frozenset({*out, *found.untestable} - kept)


def ordered(page_state: PageState, would: Mapping[str, float]) -> list[str]:
    """Effects in the model, then those that are named as missing, then by what each ``would`` leave; one that goes with
    another, as a second wave does, only beside that."""
    found, inside = page_state.diagnosis, page_state.effects
    names = [
        name for name, effect in page_state.known.items()
        if name not in WITHIN and (not effect.goes_with or {name, effect.goes_with} & {*inside})
    ]  # fmt: skip

    def order(name: str) -> tuple[int, float]:
        if name in page_state.effects:
            return 0, page_state.effects.index(name)
        if found is not None and name in found.effects:
            return 1, found.effects.index(name)
        return (2, would[name]) if name in would else (3, names.index(name))

    return sorted(names, key=order)


class _Place:
    """A place in the list, and the effect that it shows now."""

    def __init__(self, pressed: Callable[[str], object]) -> None:
        self._name = ""
        self._button = Button(width=_BUTTON, margin=(4, 5, 0, 5), stylesheets=[TYPE])
        self._button.on_click(lambda: pressed(self._name))
        self._button.js_on_change("label", CustomJS(args={"button": self._button}, code=_KEEP_FOCUS))
        self._text = Div(
            width=_LIST_WIDTH - _BUTTON - 12, margin=(5, 0, 0, 2), styles={"font-size": "15px", "line-height": "1.15"}
        )
        self._card = Div(width=_LIST_WIDTH - 8, margin=(0, 0, 0, 5), stylesheets=[_CARD])
        self.root = column(row(self._button, self._text, margin=0), self._card, width=_LIST_WIDTH, margin=0, spacing=0)

    def show(self, name: str, page_state: PageState) -> None:
        found, inside = page_state.diagnosis, name in page_state.effects
        known, self._name = name == self._name, name
        lead = found is not None and name in found.effects
        self._button.label = f"✓ {name}" if inside else f"+ {name}"
        self._button.button_type = "primary" if inside else "success" if lead else "default"
        self._button.disabled = not inside and found is not None and name in found.untestable
        self._text.text = _said(name, page_state)
        # a card that is being read stays until there is more to say
        if not known or found is not None:
            self._card.text = _card(page_state.known[name], page_state, opened=lead)


def _card(effect: Effect, page_state: PageState, *, opened: bool) -> str:
    """What it is, folded unless ``opened``.

    The machine is drawn where the card stands open, and with what is in the model: the others would cost the page a
    tenth of a second at every click.
    """
    fit, found = page_state.history[-1].fit, page_state.diagnosis
    if opened and found is not None:
        fit = found.fit  # it is in this one
    parts = [what_it_is(effect, fit), its_numbers(effect, fit, found), indistinguishable(effect, found)]
    if effect.function is not None:  # a person's lines may do anything: the page does not ask them
        parts.insert(0, page_state.drawings.get(effect.name, ""))
    elif fit is not None and (opened or effect.name in page_state.effects):
        parts.insert(0, drawing_of(effect, fit.model, fit))
    return f"<details{' open' if opened else ''}><summary>what it is</summary>{''.join(parts)}</details>"


def _said(name: str, page_state: PageState) -> str:
    """What stands beside a switch."""
    found, unit = page_state.diagnosis, escape(page_state.now.unit)
    if name in page_state.effects:
        idle = found is not None and name in found.not_needed
        if name not in page_state.without:
            return "in the model"
        return f"without it <b>{number(page_state.without[name])}</b> {unit}{' · not needed' if idle else ''}"
    if found is None:
        return ""
    if name in found.untestable:
        return f'<span style="color:var(--muted)">{escape(found.untestable[name])}</span>'
    would = next((c for c in found.candidates if c.effect == name), None)
    if would is None:
        return ""
    scale = found.steps[0].error.rms
    part = 100 * min(would.held_out_rms / scale, 1.0) if scale > 0 else 100
    tied = any(name in tie for tie in found.indistinguishable)
    note = " · tied" if tied else "" if would.plausible else " · implausible"
    leaves = f"leaves <b>{number(would.held_out_rms)}</b> {unit}{note}"
    if part > _BRINGS_NOTHING:
        return leaves
    bar = f'<div style="background:var(--part);height:5px;width:{part:.0f}%"></div>'
    return f'{leaves}<div style="background:var(--whole);height:5px;width:130px">{bar}</div>'


# -- The pictures -----------------------------------------------------------------------------------------------------

_WIDTH, _FALL_HEIGHT, _FALL_ROOM = 850, 232, 350
#: The colour scale stands beside the panels of the map.
_BESIDE = 120
_SCALES = [("shared", "one scale for both"), ("own", "each its own scale"), ("noise", "in units of the noise")]
_MARKED, _MARKED_SHORT = " marked as outliers", " marked"


#: What a canvas shows, for those who do not see it.
_CALLED = {
    "map": "maps of the error at every pose, before and after",
    "against": "what is left against a chosen column",
    "fall": "the fall of the error, step by step",
    "parameters": "identified parameters with their intervals",
}


class _Frame:
    """The place of a picture, and what the picture was built for: for anything else it is built anew."""

    def __init__(self, name: str, **size: Any) -> None:
        self.name = name
        self.place = column(name=name, **size)
        self.picture: Picture[Any] | None = None
        self._built_for: object = None

    def show(self, state: Any, built_for: object, build: Callable[[], Picture[Any]], note: str | None = "") -> bool:
        """Draws a state, above a note (that of the picture where it is None); returns whether it was built anew."""
        if self.picture is not None and self._built_for == built_for:
            self.picture.show(state)
            return False
        self.picture, self._built_for = build(), built_for
        self.picture.root.html_attributes = {"role": "group", "aria-label": _CALLED[self.name]}
        said = self.picture.note if note is None else note
        below = [Div(text=escape(said), width=_WIDTH, styles={"font-size": "14px", "color": MUTED})] if said else []
        self.place.children = [self.picture.root, *below]
        return True


class Maps:
    """Two states of the study beside one another, as a person chose them."""

    def __init__(self, selected: Callable[[], None], watch: Callable[[dict[str, Picture[Any]]], None]) -> None:
        self._selected, self._watch = selected, watch
        self._page_state: PageState | None = None
        self._map, self._against = _Frame("map", width=_WIDTH), _Frame("against", width=_WIDTH)
        self.map, self.against = self._map.place, self._against.place
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
        self.choices = row(self._before, self._after, self._scale, styles={"flex-wrap": "wrap"}, visible=False)
        self.variable = row(self._variable)

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
        width = _WIDTH - _BESIDE
        anew = self._map.show(change, key, lambda: residual_map(change, planes_across=True, width_px=width), None)
        anew |= self._against.show(lines, key, lambda: residual_against(lines), against_note(page_state.now))
        pictures = {one.name: one.picture for one in (self._map, self._against) if one.picture is not None}
        if anew:
            self._watch(pictures)
        for made in pictures["map"].before:
            made.visible = before is not after
        self._selected()


class Fall(_Folding):
    """The fall of the error along the steps that led to where the study stands, and how well parameters are known."""

    def __init__(self) -> None:
        super().__init__("unfold", 250)
        self._fall, self._known = _Frame("fall", sizing_mode="stretch_width"), _Frame("parameters", width=_WIDTH)
        self.fall, self.parameters = self._fall.place, self._known.place

    def show(self, page_state: PageState) -> None:
        """Draws the fall of a moment."""
        self._page_state = page_state
        path = current_path(page_state.history)
        folded = len(page_state.history) - len(path)
        self.unfold.visible = bool(folded)
        # that one step was taken back are two in the history: how many, nobody asks
        self.unfold.label = "Fold what was taken back" if self._all else "Show what was taken back"
        chosen = [s for k, s in enumerate(page_state.history) if self._all or k in path]
        steps = [ErrorOfStep.of(s, _short(s.action)) for s in chosen]
        left = page_state.now
        noise = left.noise_size if left.noise_origin != "unknown" else None
        state = ErrorHistory(steps, noise, left.unit, page_state.required_um if left.unit == "µm" else None)
        # other readings need another picture, and so does the line at another noise
        self._fall.show(
            state, noise and number(noise), lambda: error_history(state, height_px=_FALL_HEIGHT, room_px=_FALL_ROOM)
        )

    def show_parameters(self, page_state: PageState) -> None:
        """Draws how well the parameters of a moment are known."""
        if (fit := page_state.history[-1].fit) is not None:
            self._known.show(fit, tuple(dict.fromkeys(p.unit for p in fit.parameters)), lambda: parameters(fit))


def _short(action: str) -> str:
    return action.replace(_MARKED, _MARKED_SHORT)
