"""The page: above what is left and how it fell, on the left the effects, beside them where the model fails.

Bokeh widgets bound to a :class:`~sherkit.app.workbench.Workbench`; every control is a native one, so that a keyboard
reaches it.
"""

from __future__ import annotations

import base64
from collections.abc import Callable
from functools import partial
from html import escape
from typing import Any

from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import CustomJS, FileInput, TextAreaInput
from jinja2 import Environment, PackageLoader
from tornado.ioloop import IOLoop

from ..base.figures import listed
from ..diagnosis import template
from ..report.page import fresh_nonce, numbered, policy
from ..report.picture import number
from ..report.scene import script as scenes
from .controls import TYPE, Notices, Selection, button, text
from .page_state import EXPORTS, FILES, HISTORY, LINES, ROWS, PageState, Said
from .views import EffectList, Fall, Maps
from .workbench import Workbench, rights_of

_LEFT = 356
#: Between the answer to a click and the pictures below it.
_ANSWER_MS = 100
#: Where sentences about effects stand; the other places have the names of their controls.
_EFFECTS = "effects"
_TEMPLATE = Environment(loader=PackageLoader("sherkit.app"), autoescape=True).get_template("page.html")
_CODE = "textarea { font-family: monospace; font-size: 14px !important; white-space: pre; overflow-x: auto; }"
_LINES = '''import numpy as np
import sherkit as sk

@sk.effect(at="body", parameters={"amplitude": "mm"})
def floor_heave(rows, p):
    """The floor lifts the robot once a day."""
    return p.amplitude * np.outer(np.sin(2 * np.pi * rows.time / 86400), [0, 0, 1])
'''


class StudyPage:
    """One browser's view of a workbench. ``again`` is the command that starts the page anew."""

    def __init__(self, document: Document, bench: Workbench, links: str, again: str = "") -> None:
        self.document = document
        self.bench = bench
        self.page_state: PageState | None = None
        self._dropping = False
        self._notices = Notices(_EFFECTS, HISTORY, LINES, FILES, ROWS, EXPORTS)
        self._build(links)
        self._draw(bench.page_state)
        self._draw_below()
        self._told("progress", bench.progress)
        document.title = f"sherkit: {bench.page_state.data.source}"
        self._loop, self._over = IOLoop.current(), False
        self._end = bench.listen(lambda kind, value: self._later(lambda: self._told(kind, value)))
        place = self._notices.place[HISTORY]
        gone = CustomJS(args={"place": place, "said": _gone(again)}, code="place.text = said; place.visible = true")
        document.js_on_event("connection_lost", gone)
        document.on_session_destroyed(lambda _: self._left())
        if bench.page_state.diagnosis is None:
            bench.diagnose()

    def _later(self, work: Callable[[], None]) -> None:
        """Runs ``work`` on the document when its turn comes; may be called from any thread."""
        # a document's lists of callbacks are not for several threads: a word said at the wrong moment would be lost
        self._loop.add_callback(lambda: None if self._over else self.document.add_next_tick_callback(work))

    def _left(self) -> None:
        self._over = True
        self._end()

    # -- building ----------------------------------------------------------------------------------------

    def _build(self, links: str) -> None:
        bench, places = self.bench, self._notices.place
        self._numbers, self._headline = text("numbers"), text("headline")
        self._status = text("status", sizing_mode=None, margin=(12, 5, 5, 5))
        self._findings = text("findings")
        self._cancel = button("Cancel", "cancel", width=80, visible=False)
        self._cancel.on_click(bench.cancel)
        self._undo, self._redo = button("Undo", "undo", visible=False), button("Redo", "redo", visible=False)
        self._undo.on_click(lambda: self._do(bench.undo))
        self._redo.on_click(lambda: self._do(bench.redo))
        # a diagnosis that was cancelled, or that failed, can be asked for again
        self._ask = button("Diagnose", "diagnose", width=110, visible=False)
        self._ask.on_click(lambda: self._do(bench.diagnose))
        self._advised = button("", "advised", visible=False)
        self._advised.on_click(self._take_out)
        self._effects = EffectList(lambda name: self._do(lambda: bench.toggle(name)))
        self._selection = Selection(bench, self._notices, self._do)
        self._maps = Maps(lambda: self._selection.select(()), self._selection.watch)
        self._fall = Fall()
        self._space = text("space", visible=False)
        controls = row(
            self._undo, self._redo, self._advised, self._selection.put_back, self._ask, self._fall.unfold, self._cancel,
            self._status, text("exports", text=links, sizing_mode=None, margin=(12, 5, 5, 5)),
            styles={"flex-wrap": "wrap"},
        )  # fmt: skip
        # each of these is laid out by itself: a new line of progress must not draw every picture again
        roots: dict[str, Any] = {
            "top": column(self._numbers, self._headline, sizing_mode="stretch_width"),
            "controls": column(controls, places[HISTORY], places[EXPORTS], sizing_mode="stretch_width"),
            "findings": self._findings,
            "effects": column(places[_EFFECTS], self._effects.root, width=_LEFT),
            "own": self._own_lines(),
            "more": column(self._files(), places[FILES], sizing_mode="stretch_width"),
            "choices": self._maps.choices,
            "map": self._maps.map,
            "space": self._space,
            "variable": self._maps.variable,
            "against": self._maps.against,
            "rows": self._selection.root,
            "fall": self._fall.fall,
            "parameters": self._fall.parameters,
        }
        for name, root in roots.items():
            root.name = name
            self.document.add_root(root)
        self.document.template = _TEMPLATE
        nonce = fresh_nonce()
        self.document.template_variables.update(
            nonce=nonce, policy=policy(nonce, served=True), numbered=numbered, scenes=scenes
        )

    def _own_lines(self) -> Any:
        """The field in which effects are typed, folded."""
        place, typed = self._notices.place[LINES], self.bench.typed_path
        if self.bench.trusted:
            self._lines = TextAreaInput(
                name="lines", rows=14, value=typed.read_text(encoding="utf-8") if typed.exists() else _LINES,
                width=_LEFT - 16, max_length=20_000,
                title="Effects, as NumPy lines", stylesheets=[TYPE, _CODE],
            )  # fmt: skip
            run = button("Run these lines", "run_lines", width=160)
            run.on_click(lambda: self._do(lambda: self.bench.type_effect(self._lines.value)))
            shape = button("Fill in the shape", "fill_shape", width=150)
            shape.on_click(self._fill_shape)
            rights = text("rights", text=f"They run on this computer with the rights of <b>{escape(rights_of())}</b>, "
                          "in a process of their own.")  # fmt: skip
            inner = [rights, self._lines, row(run, shape)]
        else:
            inner = [text("rights", text="Effects cannot be typed: other machines can reach this page.")]
        own = column(*inner, visible=False, width=_LEFT)
        opener = button("An effect of your own …", "open_own", width=220)
        opener.on_click(lambda: setattr(own, "visible", not own.visible))
        return column(opener, own, place, width=_LEFT)

    def _files(self) -> FileInput:
        self._drop = FileInput(
            name="drop", accept=".csv,.parquet", title="Add measurements (choose or drop a file)", width=_LEFT - 16,
            stylesheets=[TYPE],
        )  # fmt: skip
        for attribute in ("filename", "value"):  # the same name again with other bytes is another file
            self._drop.on_change(attribute, lambda attr, old, new: self._drop_soon())
        return self._drop

    # -- what happens ------------------------------------------------------------------------------------

    def _told(self, kind: str, value: Any) -> None:
        self._together(self._tell, kind, value)

    def _together(self, work: Callable[..., None], *about: Any) -> None:
        """One message and one layout for everything that changes together."""
        self.document.hold("collect")
        try:
            work(*about)
        finally:
            self.document.unhold()

    def _tell(self, kind: str, value: Any) -> None:
        if kind == "moment":
            self._draw(value)
            # a browser paints the answer before it is given the rest
            self.document.add_timeout_callback(partial(self._together, self._draw_below), _ANSWER_MS)
        elif kind == "space":
            self.page_state = value
            self._show_space(value)
        elif kind == "progress":
            self._status.text = f"<i>{escape(value)} …</i>" if value else "Ready."
            self._cancel.visible = bool(value)
            self._ask.visible = not value and self.bench.page_state.diagnosis is None
        else:
            self._notices.show(value, _EFFECTS, wrong=kind == "error")

    def _do(self, work: Callable[[], object]) -> None:
        """Something a person asked for: what was wrong before is no longer of interest."""
        self._notices.clear()
        work()

    def _take_out(self) -> None:
        found = self.bench.page_state.diagnosis
        if found is not None and found.not_needed:
            self._do(lambda: self.bench.toggle(found.not_needed[0]))

    def _drop_soon(self) -> None:
        # name and bytes come one after the other
        if not self._dropping:
            self._dropping = True
            self._later(self._dropped)

    def _dropped(self) -> None:
        self._dropping = False
        name, content = str(self._drop.filename), str(self._drop.value)
        if name:
            self._do(lambda: self.bench.add_measurements(name, base64.b64decode(content)))
            # else the browser would not tell of the same file chosen again, once it is mended
            self._drop.clear()

    def _fill_shape(self) -> None:
        found = self.bench.page_state.diagnosis
        if found is None or found.signature is None:
            said = Said("there is no unexplained shape to fill in: every shape found has an effect", LINES)
            self._notices.show(said, LINES, wrong=True)
            return
        self._lines.value = template(found.signature, found.fit.data.layout, file=str(self.bench.typed_path))

    # -- drawing -----------------------------------------------------------------------------------------

    def _draw(self, page_state: PageState) -> None:
        self.page_state = page_state
        self._draw_numbers(page_state)
        self._draw_headline(page_state)
        self._effects.show(page_state)
        undoes, redoes = page_state.undoes, page_state.redoes
        for one, verb, action in ((self._undo, "Undo", undoes), (self._redo, "Redo", redoes)):
            one.visible, one.label = bool(action), f"{verb}: {action}" if action else verb
        idle = page_state.diagnosis.not_needed if page_state.diagnosis is not None else ()
        self._advised.visible = bool(idle)
        if idle:
            self._advised.label = f"Take out {idle[0]}: not needed"
        self._fall.show(page_state)

    def _draw_below(self) -> None:
        """What stands below the line and the fall: many times as much to draw, and looked at later."""
        if self.page_state is not None:
            self._selection.show(self.page_state)
            self._maps.show(self.page_state)
            self._fall.show_parameters(self.page_state)
            # that of the moment before stays until the new one is drawn
            if self.page_state.space:
                self._show_space(self.page_state)

    def _show_space(self, page_state: PageState) -> None:
        self._space.text, self._space.visible = page_state.space, bool(page_state.space)

    def _draw_numbers(self, page_state: PageState) -> None:
        left, last = page_state.now, page_state.history[-1]
        unit = escape(left.unit)
        beside = [f"in the model: {escape(listed(page_state.effects, 20)) or 'the geometry alone'}"]
        if page_state.required_um and left.unit == "µm":
            beside.insert(0, f"target {page_state.required_um:g} {unit}")
        if left.noise_origin != "unknown":
            beside.insert(0, f"noise {number(left.noise_size)} {unit}")
        self._numbers.text = (
            f'<span style="font-size:34px;line-height:1"><b id="error-now">{number(last.error.rms)}</b> {unit}</span>'
            f" RMS {last.error.in_words} is how far the model is off at poses that it was not fitted to;"
            f" 95 % are within {number(last.error.p95)} {unit}<br>{' · '.join(beside)}"
        )

    def _draw_headline(self, page_state: PageState) -> None:
        found, data = page_state.diagnosis, page_state.data
        rows = f"{escape(data.source.rpartition('/')[2])}: {len(data)} rows"
        wrong = page_state.left_out
        if wrong:
            named = f"{data.counted}{'s' if len(wrong) > 1 else ''} {listed(data.line[list(wrong)], 8)}"
            rows += f"; {escape(named)} left out as gross error{'s' if len(wrong) > 1 else ''}"
        if (marked := int(data.outlier.sum()) - len(wrong)) > 0:
            rows += f", {marked} marked"
        if found is None:
            self._headline.text, self._findings.text = rows, ""
            return
        said = {one.about: one.answer for one in found.findings}
        self._headline.text = (
            f"<b>{escape(said['cause'])}</b> {escape(said.get('brings', ''))}<br>"
            f'{rows} · verdict: <span id="verdict">{escape(found.headline)}</span>'
        )
        shown = [one.to_do for one in found.findings if one.about == "left_out"]
        shown += [one.answer for one in found.findings if one.about in ("elsewhere", "unread", "tie", "shape")]
        self._findings.text = "<br>".join(map(escape, shown))


def _gone(again: str) -> str:
    """What is said where the server does not answer any more."""
    start = f"start it again with <code>{escape(again)}</code>" if again else "start sherkit app again"
    return (
        '<b role="alert">The server of this page does not answer; the study is saved. If it was stopped, '
        f"{start} and open the address that it prints; else reload this page.</b>"
    )
