"""The page: effects on the left, where the model fails in the middle, the fall of the error on the right.

Bokeh widgets bound to a :class:`~sherkit.app.workbench.Workbench`; every control is a native one, so that a keyboard
reaches it.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from html import escape
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import Button, CustomJS, Div, FileInput, Select, TextAreaInput, TextInput
from jinja2 import Environment, PackageLoader
from tornado.ioloop import IOLoop

from ..diagnosis import sentence, template
from ..diagnosis.outliers import sentences
from ..names import listed
from ..report.error_history import ErrorHistory, ErrorOfStep, error_history
from ..report.parameters import parameters
from ..report.picture import Picture
from ..report.policy import fresh_nonce, numbered, policy
from ..report.residual_against import ResidualAgainst, residual_against
from ..report.residual_against import note as against_note
from ..report.residual_map import Change, residual_map
from ..report.residuals import Residuals
from ..report.scene import script as scenes
from ..report.style import INK, MUTED, REFUSED, number, quantity
from ..robots.accuracy import REQUIREMENT_UM
from .workbench import Moment, Workbench, rights_of

_LEFT, _MIDDLE, _RIGHT = 322, 880, 430
#: The colour scale stands beside the panels of the map.
_BESIDE = 80
_SHOWN_ROWS = 40
_TEMPLATE = Environment(loader=PackageLoader("sherkit.app"), autoescape=True).get_template("page.html")
#: One size of type for what is pressed, chosen and typed too.
_TYPE = ":host, .bk-btn, .bk-input, .bk-input-group, label { font-size: 16px !important; }"
_CODE = "textarea { font-family: monospace; font-size: 14px !important; white-space: pre; overflow-x: auto; }"
_LINES = '''import numpy as np
import sherkit as sk

@sk.effect(at="body", parameters={"amplitude": "mm"})
def floor_heave(rows, p):
    """The floor lifts the robot once a day."""
    return p.amplitude * np.outer(np.sin(2 * np.pi * rows.time / 86400), [0, 0, 1])
'''


class StudyPage:
    """One browser's view of a workbench."""

    def __init__(self, document: Document, bench: Workbench, links: str) -> None:
        self.document = document
        self.bench = bench
        self.moment: Moment | None = None
        self.selected: tuple[int, ...] = ()
        #: Tables of the pictures in which rows can be chosen.
        self._brushable: list[Any] = []
        self._pictures: dict[str, Picture[Any]] = {}
        #: What the pictures of the middle and of the right were built for; other rows or units need new ones.
        self._middle_of: tuple[Any, ...] = ()
        self._right_of: tuple[Any, ...] = ()
        self._drawn: tuple[Any, ...] = ()
        self._filling = False
        self._dropping = False
        self._build(links)
        self._draw(bench.moment)
        self._told("progress", bench.progress)
        document.title = f"sherkit: {bench.moment.data.source}"
        self._loop, self._over = IOLoop.current(), False
        self._end = bench.listen(lambda kind, value: self._later(lambda: self._told(kind, value)))
        gone = CustomJS(args={"error": self.error, "said": _GONE}, code="error.text = said; error.visible = true")
        document.js_on_event("connection_lost", gone)
        document.on_session_destroyed(lambda _: self._gone())
        if bench.moment.diagnosis is None:
            bench.diagnose()

    def _later(self, work: Callable[[], None]) -> None:
        """Runs ``work`` on the document when its turn comes; may be called from any thread."""
        # a document's lists of callbacks are not for several threads: a word said at the wrong moment would be lost
        self._loop.add_callback(lambda: None if self._over else self.document.add_next_tick_callback(work))

    def _gone(self) -> None:
        self._over = True
        self._end()

    # -- building ----------------------------------------------------------------------------------------

    def _build(self, links: str) -> None:
        text = {"styles": {"font-size": "16px", "color": INK}}
        self.headline = Div(name="headline", width=_LEFT, **text)
        self.status = Div(name="status", width=_LEFT - 90, **text)
        self.cancel = Button(stylesheets=[_TYPE], label="Cancel", name="cancel", width=80, visible=False)
        self.cancel.on_click(self.bench.cancel)
        self.error = Div(name="error", width=_LEFT, visible=False, styles={"font-size": "16px", "color": REFUSED})
        self.undo = Button(stylesheets=[_TYPE], label="Undo", name="undo", width=100)
        self.undo.on_click(lambda: self._do(self.bench.undo))
        # a diagnosis that was cancelled, or that failed, can be asked for again
        self.ask = Button(stylesheets=[_TYPE], label="Diagnose", name="diagnose", width=110, visible=False)
        self.ask.on_click(lambda: self._do(self.bench.diagnose))
        self.effects = column(name="effects", width=_LEFT)
        self._buttons: dict[str, tuple[Button, Div]] = {}
        self._rows: dict[str, Any] = {}
        self._sorted = False
        rights = f"These lines run on this computer with the rights of <b>{escape(rights_of())}</b>."
        self.lines = TextAreaInput(stylesheets=[_TYPE, _CODE],
            name="lines", value=self._typed_before(), rows=14, width=_LEFT - 10, max_length=20_000,
            title="Effects, as NumPy lines",
        )  # fmt: skip
        run_lines = Button(stylesheets=[_TYPE], label="Run these lines", name="run_lines", width=160)
        run_lines.on_click(lambda: self._do(lambda: self.bench.type_effect(self.lines.value)))
        shape = Button(stylesheets=[_TYPE], label="Fill in the shape", name="fill_shape", width=150)
        shape.on_click(self._fill_shape)
        typed: list[Any] = (
            [Div(text=rights, width=_LEFT, **text), self.lines, row(run_lines, shape)]
            if self.bench.trusted
            else [Div(text="Effects cannot be typed: other machines can reach this page.", width=_LEFT, **text)]
        )
        own = column(*typed, visible=False)
        opener = Button(stylesheets=[_TYPE], label="An effect of your own …", name="open_own", width=220)
        opener.on_click(lambda: setattr(own, "visible", not own.visible))
        self.drop = FileInput(stylesheets=[_TYPE],
            name="drop", accept=".csv,.parquet", title="Add measurements (choose or drop a CSV)",
            width=_LEFT - 10,
        )  # fmt: skip
        for attribute in ("filename", "value"):  # the same name again with other bytes is another file
            self.drop.on_change(attribute, lambda attr, old, new: self._drop_soon())
        self.links = Div(name="exports", text=links, width=_LEFT, **text)
        self.before = Select(stylesheets=[_TYPE], title="Compare", name="before", width=240)
        self.after = Select(stylesheets=[_TYPE], title="with", name="after", width=240)
        self.variable = Select(stylesheets=[_TYPE], title="Residual against", name="variable", width=200)
        for one in (self.before, self.after, self.variable):
            one.on_change("value", lambda attr, old, new: self._redraw_pictures())
        self.map_place = column(name="map", width=_MIDDLE)
        self.against_place = column(name="against", width=_MIDDLE)
        self.selection = Div(name="selection", width=_MIDDLE, **text)
        self.mark = Button(stylesheets=[_TYPE], label="Mark as outliers", name="mark", disabled=True, width=180)
        self.mark.on_click(self._mark)
        self.suspects = Button(stylesheets=[_TYPE], label=_SUSPECTS, name="suspects", disabled=True, width=220)
        self.suspects.on_click(lambda: self._do(self.bench.mark_suspects))
        self.typed_rows = TextInput(stylesheets=[_TYPE],
            name="typed_rows", width=360
        )  # fmt: skip
        self.typed_rows.on_change("value", lambda attr, old, new: self._select_typed())
        self.fall_place = column(name="fall", width=_RIGHT)
        self.numbers = Div(name="numbers", width=_LEFT, **text)
        self.parameters_place = column(name="parameters", width=_RIGHT)
        # each of these is laid out by itself: a new line of progress must not draw every picture again
        roots = {
            "top": column(
                self.numbers, self.headline, row(self.status, self.cancel), self.error, row(self.undo, self.ask)
            ),
            "effects": self.effects,
            "own": column(opener, own),
            "more": column(self.drop, self.links),
            "choices": row(self.before, self.after, self.variable),
            "map": self.map_place,
            "against": self.against_place,
            "rows": column(row(self.typed_rows, self.mark, self.suspects, align="end"), self.selection),
            "fall": self.fall_place,
            "parameters": self.parameters_place,
        }
        for name, root in roots.items():
            root.name = name
            self.document.add_root(root)
        self.document.template = _TEMPLATE
        nonce = fresh_nonce()
        self.document.template_variables.update(
            nonce=nonce, policy=policy(nonce, served=True), numbered=numbered, scenes=scenes
        )

    def _typed_before(self) -> str:
        path = self.bench.typed_path
        return path.read_text(encoding="utf-8") if path.exists() else _LINES

    # -- what happens ------------------------------------------------------------------------------------

    def _told(self, kind: str, value: Any) -> None:
        # one message and one layout for everything that changes together
        self.document.hold("collect")
        try:
            self._tell(kind, value)
        finally:
            self.document.unhold()

    def _tell(self, kind: str, value: Any) -> None:
        if kind == "moment":
            self._draw(value)
        elif kind == "progress":
            self.status.text = f"<i>{escape(value)} …</i>" if value else "Ready."
            self.cancel.visible = bool(value)
            self.ask.visible = not value and self.bench.moment.diagnosis is None
        else:
            said = f"<b>{escape(value)}</b>" if kind == "error" else f'<span style="color:{INK}">{escape(value)}</span>'
            self.error.text, self.error.visible = said, True

    def _do(self, work: Callable[[], object]) -> None:
        """Something a person asked for: what was wrong before is no longer of interest."""
        self.error.visible = False
        work()

    def _pressed(self, name: str) -> None:
        self._do(lambda: self.bench.toggle(name))

    def _drop_soon(self) -> None:
        # name and bytes come one after the other
        if not self._dropping:
            self._dropping = True
            self._later(self._dropped)

    def _dropped(self) -> None:
        self._dropping = False
        name, content = str(self.drop.filename), str(self.drop.value)
        if name and content:
            self._do(lambda: self.bench.add_measurements(name, base64.b64decode(content)))
            # else the browser would not tell of the same file chosen again, once it is mended
            self.drop.clear()

    def _fill_shape(self) -> None:
        found = self.bench.moment.diagnosis
        if found is None or found.signature is None:
            self._told("error", "there is no unexplained shape to fill in: every shape found has an effect")
            return
        self.lines.value = template(found.signature, found.fit.data.layout, file=str(self.bench.typed_path))

    # -- drawing -----------------------------------------------------------------------------------------

    def _draw(self, moment: Moment) -> None:
        # steps that follow a growing run take the place of one another
        changed = self.moment is None or self.moment.history != moment.history
        self.moment = moment
        self._draw_effects(moment)
        self._draw_headline(moment)
        self.undo.disabled = not moment.can_undo
        if changed:
            self._fill_selects(moment)
            self._redraw_pictures()
        self._draw_right(moment)

    def _draw_headline(self, moment: Moment) -> None:
        found = moment.diagnosis
        title = f"<b>{escape(moment.data.source)}</b>: {len(moment.data)} rows"
        if moment.data.outlier.any():
            title += f", {int(moment.data.outlier.sum())} marked"
        suspected = 0 if found is None else len(found.outliers)
        self.suspects.disabled = not suspected
        self.suspects.label = f"Mark the {suspected} suspected" if suspected else _SUSPECTS
        if found is None:
            self.headline.text = title
            return
        wrong = "".join(f"<br>{escape(said)}" for said in sentences(moment.data, found.outliers))
        shape = f"<br>left over: {escape(sentence(found.signature))}" if found.signature is not None else ""
        ties = "".join(f"<br>these rows cannot tell {escape(' from '.join(tie))}" for tie in found.ties)
        self.headline.text = f'{title}<br><span id="verdict">{escape(found.headline)}</span>{wrong}{ties}{shape}'

    def _draw_effects(self, moment: Moment) -> None:
        """A button for every effect: those in the model, then by what each would bring."""
        found = moment.diagnosis
        would = {c.effect: c for c in found.candidates} if found is not None else {}
        names = [n for n in (*moment.catalogue, *moment.own) if n != "datum"]
        untestable = found.untestable if found is not None else {}

        def order(name: str) -> tuple[int, float]:
            if name in moment.effects:
                return 0, moment.effects.index(name)
            if found is not None and name in found.effects:
                return 1, found.effects.index(name)
            return (2, would[name].held_out_rms) if name in would else (3, names.index(name))

        scale = found.steps[0].held_out_rms if found is not None else 1.0
        rows = []
        for name in sorted(names, key=order):
            if name not in self._buttons:
                self._buttons[name] = self._effect_row(name)
                self._rows[name] = row(*self._buttons[name])
            button, text = self._buttons[name]
            inside = name in moment.effects
            lead = found is not None and name in found.effects
            button.label = f"✓ {name}" if inside else f"+ {name}"
            button.button_type = "primary" if inside else "success" if lead else "default"
            button.disabled = name in untestable and not inside
            text.text = self._effect_text(name, inside, would.get(name), untestable.get(name), scale, found)
            rows.append(self._rows[name])
        shown = list(self.effects.children)
        if len(rows) != len(shown) or (found is not None and not self._sorted):
            # a new list makes Bokeh walk through every model of the page: once, and for an effect that is typed
            self.effects.children = rows
            self._sorted = found is not None
        for place, one in enumerate(rows):
            # the order in which they are seen; the one pressed keeps the focus
            if one.styles.get("order") != str(place):
                one.styles = {"order": str(place)}

    def _effect_row(self, name: str) -> tuple[Button, Div]:
        button = Button(stylesheets=[_TYPE], name=f"effect_{name}", width=185)
        button.on_click(lambda: self._pressed(name))
        # Bokeh makes a button anew where its label changes: who works with the keyboard must not lose the place
        button.js_on_event("button_click", CustomJS(args={"button": button}, code="window.pressed = button.id"))
        button.js_on_change("label", CustomJS(args={"button": button}, code=_KEEP_FOCUS))
        return button, Div(width=_LEFT - 200, styles={"font-size": "15px", "line-height": "1.15"})

    @staticmethod
    def _effect_text(name: str, inside: bool, would: Any, why: str | None, scale: float, found: Any) -> str:
        if inside:
            return "in the model" if found is None or name not in found.not_needed else "in the model, not needed"
        if why is not None:
            return f'<span style="color:{MUTED}">{escape(why)}</span>'
        if would is None:
            return ""
        part = 100 * min(would.held_out_rms / scale, 1.0) if scale > 0 else 100
        tied = any(name in tie for tie in found.ties)
        note = " · tied" if tied else "" if would.plausible else " · implausible size"
        return (
            f"→ <b>{number(would.held_out_rms)}</b> {escape(found.unit)}{note}"
            f'<div style="background:#e5e5e5;height:5px;width:110px"><div style="background:#0072b2;height:5px;'
            f'width:{part:.0f}%"></div></div>'
        )

    def _fill_selects(self, moment: Moment) -> None:
        steps = [
            (str(k), f"{k}. {s.action}")
            for k, (s, left) in enumerate(zip(moment.history, moment.residuals, strict=True))
            if left
        ]
        self.before.options, self.after.options = steps, steps
        # values set here must not redraw one after the other
        self._quiet(self.before, steps[0][0] if len(steps) == 1 else str(self._step_before(moment)))
        self._quiet(self.after, steps[-1][0])
        lines = moment.data.counted == "line"
        self.typed_rows.title = f"Rows by their number {'in the file' if lines else 'from 0'}, such as 12, 40-45"
        variables = list(moment.now.variables)
        self.variable.options = [(name, quantity(name)) for name in variables]
        if self.variable.value not in variables:
            found = moment.diagnosis
            known = [d.variable for d in found.where if d.variable in variables] if found is not None else variables
            self._quiet(self.variable, (known or variables)[0])

    @staticmethod
    def _step_before(moment: Moment) -> int:
        """The first state that can still be shown: the fall is seen from where it began."""
        return next(k for k, left in enumerate(moment.residuals) if left is not None)

    def _quiet(self, select: Select, value: str) -> None:
        self._filling = True
        select.value = value
        self._filling = False

    def _redraw_pictures(self) -> None:
        moment = self.moment
        if moment is None or self._filling:
            return
        before, after = self._left(moment, self.before.value), self._left(moment, self.after.value)
        # a browser says again what it was told to show
        wanted = (before, after, self.variable.value)
        if before is None or after is None or wanted == self._drawn:
            return
        self._drawn = wanted
        titles = dict(self.after.options)
        change = Change(before, after, titles[self.before.value], titles[self.after.value])
        lines = ResidualAgainst(after, str(self.variable.value), before if before is not after else None)
        key = (len(after), tuple(after.names), tuple(after.place))
        if self._middle_of != key:
            self._middle_of = key
            self._place("map", self.map_place, residual_map(change, planes_across=True, width_px=_MIDDLE - _BESIDE))
            self._place("against", self.against_place, residual_against(lines))
            self._watch_selection()
        else:
            self._pictures["map"].show(change)
            self._pictures["against"].show(lines)
        for one in self._pictures["map"].before:
            if one.visible != (before is not after):
                one.visible = before is not after
        self._select(())

    @staticmethod
    def _left(moment: Moment, which: str) -> Residuals | None:
        return moment.residuals[int(which)] if which else None

    def _place(self, name: str, place: Any, picture: Picture[Any]) -> None:
        self._pictures[name] = picture
        text = against_note(self.moment.now) if name == "against" and self.moment else picture.note
        place.children = [
            picture.root, Div(text=escape(text), width=_MIDDLE, styles={"font-size": "14px", "color": MUTED})
        ]  # fmt: skip

    def _draw_right(self, moment: Moment) -> None:
        steps = [
            ErrorOfStep(s.action, {k.rsplit("_", 1)[0]: v for k, v in s.held_out_rms.items()},
                 {k.rsplit("_", 1)[0]: v for k, v in s.training_rms.items()})
            for s in moment.history
        ]  # fmt: skip
        left = moment.now
        known = left.noise_origin != "unknown"
        noise = dict(zip(left.names, left.noise.tolist(), strict=True)) if known else {}
        state = ErrorHistory(steps, noise, left.unit, REQUIREMENT_UM if left.unit == "µm" else None)
        last = moment.history[-1]
        floor = f"noise {number(float(np.sqrt(np.mean(left.noise**2))))} {escape(left.unit)}<br>" if known else ""
        self.numbers.text = (
            f'<span style="font-size:30px"><b id="error-now">{number(last.held_out)}</b> {escape(left.unit)}</span>'
            f" RMS on poses held out<br>{floor}"
            f"in the model: {escape(listed(moment.effects, 20)) or 'the geometry alone'}"
        )
        fit = last.fit
        units = tuple(dict.fromkeys(p.unit for p in fit.parameters)) if fit is not None else ()
        if self._right_of != (tuple(noise), units):
            self._right_of = (tuple(noise), units)
            self._pictures["fall"] = error_history(state)
            self.fall_place.children = [self._pictures["fall"].root]
            if fit is not None:
                self._pictures["parameters"] = parameters(fit)
                self.parameters_place.children = [self._pictures["parameters"].root]
        else:
            self._pictures["fall"].show(state)
            if fit is not None:
                self._pictures["parameters"].show(fit)
        # in so narrow a picture the names of two steps already meet
        self._pictures["fall"].root.xaxis.major_label_orientation = 0.5 if len(steps) > 1 else 0.0

    # -- rows --------------------------------------------------------------------------------------------

    def _watch_selection(self) -> None:
        self._brushable = [
            source
            for name in ("map", "against")
            for key, source in self._pictures[name].sources.items()
            if (name == "map" and not key.endswith("_key")) or key == "points"
        ]
        for source in self._brushable:
            source.selected.on_change("indices", self._brush(source))

    def _brush(self, source: Any) -> Callable[[str, Any, list[int]], None]:
        return lambda attr, old, new: self._brushed(source, new)

    def _brushed(self, source: Any, indices: list[int]) -> None:
        if self._filling:
            return
        data = source.data
        if "rows" in data:
            rows = [r for k in indices for r in data["rows"][k]]
        else:
            rows = [int(data["row"][k]) for k in indices]
        self._select(rows, source)

    def _select(self, rows: Sequence[int], brushed: Any = None) -> None:
        """Takes rows as chosen, lists them, and shows them in every picture but the one they were brushed in."""
        self.selected = tuple(sorted(set(rows)))
        chosen = set(self.selected)
        self._filling = True
        for source in self._brushable:
            if source is brushed:
                continue
            data = source.data
            if not chosen:
                indices = []
            elif "rows" in data:
                indices = [k for k, members in enumerate(data["rows"]) if not chosen.isdisjoint(members)]
            else:
                indices = np.flatnonzero(np.isin(data["row"], self.selected)).tolist()
            if source.selected.indices != indices:
                source.selected.indices = indices
        self._filling = False
        self._draw_selection()

    def _select_typed(self) -> None:
        """Rows given by their numbers in the file."""
        moment = self.moment
        if moment is None or not self.typed_rows.value.strip():
            return
        line = moment.data.line
        wanted = np.zeros(len(line), dtype=bool)
        for part in self.typed_rows.value.split(","):
            low, dash, high = (one.strip() for one in part.partition("-"))
            if not _is_number(low) or (dash and not _is_number(high)):
                self._told("error", f"rows: expected numbers such as 12, 40-45, got '{part.strip()}'")
                return
            found = (line >= int(low)) & (line <= int(high or low))
            if not found.any():
                self._told("error", f"{moment.data.source} has no row on {moment.data.counted} {part.strip()}")
                return
            wanted |= found
        self._do(lambda: self._select(np.flatnonzero(wanted).tolist()))

    def _mark(self) -> None:
        rows = self.selected
        self._do(lambda: self.bench.mark_outliers(rows))
        self.typed_rows.value = ""

    def _draw_selection(self) -> None:
        self.mark.disabled = not self.selected
        moment = self.moment
        if moment is None or not self.selected:
            self.selection.text = "Select points in the pictures, or type their rows, to see which they are."
            return
        left = moment.now
        index = {int(r): k for k, r in enumerate(left.row)}
        rows = [r for r in self.selected if r in index]
        head = "".join(f"<th>{escape(n)}, {escape(left.unit)}</th>" for n in left.names)
        body = ""
        for r in rows[:_SHOWN_ROWS]:
            k = index[r]
            cells = "".join(f"<td>{v:.1f}</td>" if np.isfinite(v) else "<td></td>" for v in left.values[k])
            marked = "marked" if left.outlier[k] else ""
            body += f"<tr><td>{int(left.line[k])}</td>{cells}<td>{marked}</td></tr>"
        more = f" (the first {_SHOWN_ROWS} are listed)" if len(rows) > _SHOWN_ROWS else ""
        self.selection.text = (
            f"<b>{len(self.selected)} row{'s' if len(self.selected) > 1 else ''}</b>{more}"
            "<table style='border-spacing:14px 2px'>"
            f"<tr><th>{escape(left.counted)}</th>{head}<th></th></tr>{body}</table>"
        )


_SUSPECTS = "No rows are suspected"
_GONE = (
    "<b>The server of this page does not answer; the study is saved. Reload the page, or start sherkit app again.</b>"
)
_KEEP_FOCUS = """
if (window.pressed == button.id) setTimeout(() => {
    const free = document.activeElement == null || document.activeElement == document.body
    if (free) Bokeh.index.find_one(button)?.shadow_el?.querySelector("button")?.focus()
}, 50)
"""


def _is_number(text: str) -> bool:
    """Whole, not negative, and no longer than a row can be."""
    return text.isdecimal() and len(text) <= 15
