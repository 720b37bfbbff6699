"""The states of a study that a reader looks at and switches between, and how the error fell along them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from bokeh.models import FactorRange, Label, Range1d

from ..base.figures import state_with, told_apart
from ..base.types import Floats
from ..data.columns import bare
from ..diagnosis import Diagnosis
from ..diagnosis.selection import setting_for
from ..errors import SherkitError
from ..evidence.fitted_run import FittedRun
from ..fit.error import ErrorSize
from ..fit.identify import Fit
from ..model.kinds import required_um
from ..study import Study, StudyStep
from .picture import (
    COLOURS,
    FONT,
    FONT_SIZE,
    INK,
    MARKERS,
    Picture,
    Table,
    Tables,
    figure,
    hover,
    in_text,
    legend,
    rule,
    sources_of,
)
from .residual_against import Windows, gained, means, points, shown
from .residual_arrows import Change
from .residuals import ModelState, drawn

#: Effects that a reader can see added alone: those that would bring most.
_MOST_SINGLE = 5


def states_of(study: Study, found: Diagnosis, base: Fit) -> list[ModelState]:
    """The model as diagnosed, each single addition that could be fitted, then the steps of the study that have more.

    ``base`` is the diagnosed fit on the rows that are drawn. An effect that cannot be fitted alone is left out.
    """
    run, known = FittedRun(base), [e.name for e in base.model.effects]
    path = {s.effects: drawn(s.fit) for s in study.history if s.fit is not None and set(s.effects) > set(known)}
    out = [ModelState(state_with(known), base, found)]
    named = {e.name: e for e in (*run.catalogue, *study.own.values())}
    taken = {frozenset(added) for added in path}
    for candidate in found.candidates[:_MOST_SINGLE]:
        effect = named.get(candidate.effect)
        title = state_with([*known, candidate.effect])
        if effect is None or {*known, candidate.effect} in taken:
            continue
        setting = None
        try:
            if effect.search is not None:
                setting = setting_for(base, effect)
            out.append(ModelState(title, run.refit([(effect, setting)]).fit, found))
        except SherkitError:
            continue
    return out + [ModelState(state_with(added), fit, found) for added, fit in path.items()]


def packed(states: Sequence[ModelState], maps: Picture[Change]) -> dict[str, Any]:
    """What a page needs to move both pictures to any of the states, and the lower one to any variable.

    Keys are names of sources; only columns that change are held. Numbers are base64 of little-endian float32.
    """
    base = states[0].left
    variables = list(base.variables)
    out: dict[str, Any] = {"titles": [s.title for s in states], "variables": variables, "states": []}
    windows = {name: Windows.of(base, name) for name in variables}
    rows = shown(base)
    out["values"] = {name: in_text(values[rows]) for name, values in base.variables.items()}
    for state in states:
        change = Change(base, state.left, states[0].title, state.title)
        tables = {name: _text(t) for name, t in maps.tables(change).items() if name.startswith("after")}
        drawn_now = points(state.left).items()
        tables["points"] = {key: in_text(v) for key, v in drawn_now if key.startswith("r") and key != "row"}
        by_variable = {}
        for name, along in windows.items():
            lines = {"mean": means(state.left, along), "gained": gained(base, state.left, along)}
            by_variable[name] = {key: _text(table) for key, table in lines.items()}
        out["states"].append({"tables": tables, "against": by_variable})
    return out


def _text(table: Table) -> dict[str, Any]:
    """A table as text: floats packed, words as they are; what only a server needs is left out."""
    out: dict[str, Any] = {}
    for key, column in table.items():
        if key in ("rows", "lines", "n"):
            continue
        words = len(column) and isinstance(column[0], str)
        out[key] = list(column) if words else in_text(column)
    return out


# -- How the error fell along them ------------------------------------------------------------------------------------

_HEIGHT = 380
#: More steps than this have their numbers alone: hover says the names.
_NAMED = 9
#: Width of a letter with its part of the gap between names, px; names that are wider together stand aslant.
_LETTER = 8.4
#: Height of a line of them, px.
_LINE_PX = 22
#: The error, beside that of each reading.
_ERROR = "error"


@dataclass(frozen=True)
class ErrorOfStep:
    """One step: what was done, and the error it left, held out and of the rows that were fitted.

    ``short`` is what stands at the axis, where that is another name.
    """

    action: str
    held_out: ErrorSize
    fitted: ErrorSize
    short: str = ""

    @classmethod
    def of(cls, step: StudyStep, short: str = "") -> ErrorOfStep:
        """That of a step of a study."""
        return cls(step.action, step.error, step.fitted, short)


@dataclass(frozen=True)
class ErrorHistory:
    """Steps in order; ``noise`` as the error is counted (None where unknown), ``required`` the accuracy needed, both in
    ``unit``."""

    steps: Sequence[ErrorOfStep]
    noise: float | None
    unit: str
    required: float | None = None


def current_path(history: Sequence[StudyStep]) -> list[int]:
    """Steps (numbers) that lead to where a study stands: what was taken back, or done and undone, is left out.

    A step that leaves the same as an earlier one stands for that one, with nothing between them.
    """
    path: list[int] = []
    states: list[tuple[Any, ...]] = []
    for k, step in enumerate(history):
        left = tuple((name, f"{value:.6g}") for name, value in step.fitted.by_reading.items())
        state = (frozenset(step.effects), step.rows, left)
        if state in states:
            place = states.index(state)
            del path[place + 1 :], states[place + 1 :]
        else:
            path.append(k)
            states.append(state)
    return path


def states_so_far(study: Study, found: Diagnosis | None = None) -> dict[int, ModelState]:
    """By the number of its step, what a reader compares: the states of the current path whose rows are those of today,
    under names that tell them apart, beside the noise that a diagnosis ``found``; the last is where the study stands.
    """
    path = current_path(study.history)
    # of a loaded study the step that it came back to may have no fit
    fits = {k: study.history[k].fit for k in path} | {path[-1]: study.fit}
    known = {k: fit for k, fit in fits.items() if fit and len(fit.data) == len(study.data)}
    names = told_apart([study.history[k].action for k in known])
    return {k: ModelState(name, fit, found) for (k, fit), name in zip(known.items(), names, strict=True)}


def error_history_of(study: Study, found: Diagnosis | None = None) -> ErrorHistory:
    """The fall of a study, with the noise that a diagnosis knows."""
    steps = [ErrorOfStep.of(step) for step in study.history]
    known = found is not None and found.noise_origin != "unknown"
    unit = study.data.layout.unit
    # an accuracy in µm says nothing of pixels
    needed = required_um(study.robot) if unit == "µm" else None
    return ErrorHistory(steps, found.noise_size if found is not None and known else None, unit, needed)


def error_history(state: ErrorHistory, *, height_px: int = _HEIGHT, room_px: int = 860) -> Picture[ErrorHistory]:
    """The error at every step on a logarithmic scale, and beside it that of each reading.

    Filled marks are RMS on blocks of poses that the fit had not seen, open ones those on the rows it was fitted to; the
    heavy line is the error, its bar what 95 of 100 rows stay within. ``room_px`` is there for the names of steps.
    """
    names = _names(state)
    error = state.steps[-1].held_out
    sources = sources_of(_step_tables(state))
    made = figure(
        up=f"error, {state.unit}", height=height_px, y_axis_type="log", x_range=FactorRange(), y_range=Range1d()
    )
    renderers = []
    for k, name in enumerate([*names, _ERROR]):
        last = k == len(names)
        colour, marker = (INK, "plus") if last else (COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)])
        called = f"error {error.in_words}" if last else name
        made.line("step", f"held_{name}", source=sources["steps"], color=colour, line_width=4 if last else 2,
                  legend_label=called)  # fmt: skip
        filled = made.scatter(
            "step", f"held_{name}", source=sources["steps"], color=colour, marker=marker, size=13, legend_label=called
        )
        open_ = made.scatter(
            "step", f"fit_{name}", source=sources["steps"], line_color=colour, fill_color="white", marker=marker, size=9
        )
        renderers += [filled, open_]
    made.segment("step", f"held_{_ERROR}", "step", "p95", source=sources["steps"], color=INK, line_width=2)
    made.scatter("step", "p95", source=sources["steps"], color=INK, marker="dash", size=16, line_width=2)
    if state.required:
        rule(made, "width", state.required, line_color=INK, line_width=2, line_dash="dashed")
        _say(made, state.required, f"target: {state.required:g} {state.unit}")
    if state.noise:
        rule(made, "width", state.noise, line_color=INK, line_dash="dotted")
        _say(made, state.noise, "noise")
    made.add_tools(
        hover(
            renderers,
            ("step", "@action"),
            *((n, f"@held_{n}{{0.0}} held out, @fit_{n}{{0.0}} fitted") for n in [*names, _ERROR]),
            ("95 % within", "@p95{0.0}"),
        )
    )
    made.xgrid.grid_line_color = None
    legend(made)

    def tune(new: ErrorHistory) -> None:
        made.x_range.factors = _steps(new)
        made.y_range.start, made.y_range.end = _reach(new)
        made.xaxis.major_label_orientation = _slant(new, room_px)

    tune(state)
    note = (
        "Filled: RMS on blocks of poses that the fit had not seen. Open: on the rows it was fitted to."
        f" Black: the error {error.in_words}, its bar what 95 of 100 rows stay within, which is what is needed."
        f"{' Dotted: the noise; below it nothing can be gained.' if state.noise else ''}"
    )
    return Picture.of("fall", made, sources, _step_tables, tune, note=note)


def _say(made: Any, height: float, text: str) -> None:
    """Names a line at the left edge, whatever the steps are."""
    made.add_layout(
        Label(x=6, x_units="screen", y=height, y_offset=3, text=text, text_font_size=FONT_SIZE, text_font=FONT,
              text_color=INK, text_baseline="bottom", background_fill_color="white", background_fill_alpha=0.75)
    )  # fmt: skip


def _names(state: ErrorHistory) -> list[str]:
    """Readings, where there are several."""
    every = list(dict.fromkeys(bare(name) for step in state.steps for name in step.held_out.by_reading))
    return every if len(every) > 1 else []


def _reach(state: ErrorHistory) -> tuple[float, float]:
    """Lowest and highest error of the axis: every value has a place there, and so have noise and requirement."""
    sides = [side for step in state.steps for side in (step.held_out, step.fitted)]
    values = [v for side in sides for v in (side.rms, side.p95, *side.by_reading.values())]
    known = [v for v in (*values, state.noise or 0.0, state.required or 0.0) if np.isfinite(v) and v > 0] or [1.0]
    low, high = min(known), max(known)
    reach = max(high / low, 2.0)
    # the name of a line stands above it
    above = 0.2 if high in (state.required, state.noise) else 0.08
    return low / reach**0.08, high * reach**above


def _steps(state: ErrorHistory) -> list[str]:
    if len(state.steps) > _NAMED:
        return [str(k) for k in range(len(state.steps))]
    return told_apart([step.short or step.action for step in state.steps])


def _slant(state: ErrorHistory, room_px: int) -> float:
    """Angle of the names, rad: none where they fit, else as little as keeps them apart."""
    if _LETTER * sum(map(len, _steps(state))) <= room_px:
        return 0.0
    return min(_LINE_PX * len(state.steps) / room_px, 0.6)


def _step_tables(state: ErrorHistory) -> Tables:
    table: dict[str, object] = {"step": _steps(state), "action": [r.action for r in state.steps]}
    for key, sides in (("held", [r.held_out for r in state.steps]), ("fit", [r.fitted for r in state.steps])):
        each = [{bare(name): value for name, value in side.by_reading.items()} for side in sides]
        for name in _names(state):
            table[f"{key}_{name}"] = _on_log_axis([one.get(name, np.nan) for one in each])
        table[f"{key}_{_ERROR}"] = _on_log_axis([side.rms for side in sides])
    table["p95"] = _on_log_axis([r.held_out.p95 for r in state.steps])
    return {"steps": table}


def _on_log_axis(values: Sequence[float]) -> Floats:
    """On a logarithmic axis, which has no place for zero."""
    return np.array([v if v > 0 else np.nan for v in values])
