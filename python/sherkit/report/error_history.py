"""The fall of the error: held out and fitted, step by step and axis by axis, against noise and requirement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from bokeh.models import FactorRange, Label, Range1d, Span

from ..base.names import told_apart
from ..base.types import Floats
from ..data.columns import bare
from ..diagnosis import Diagnosis
from ..fit.error import ErrorSize
from ..model.kinds import required_um
from ..study import Study, StudyStep
from .picture import Picture, Tables, single, sources_of
from .style import COLOURS, FONT, FONT_SIZE, INK, MARKERS, figure, hover, legend

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
    sources = sources_of(_tables(state))
    made = figure(
        height=height_px, sizing_mode="stretch_width", y_axis_type="log", x_range=FactorRange(*_steps(state)),
        y_range=Range1d(*_reach(state)),
    )  # fmt: skip
    made.yaxis.axis_label = f"error, {state.unit}"
    made.xaxis.major_label_orientation = _slant(state, room_px)
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
        made.add_layout(
            Span(location=state.required, dimension="width", line_color=INK, line_width=2, line_dash="dashed")
        )
        _say(made, state.required, f"needed: {state.required:g} {state.unit}")
    if state.noise:
        made.add_layout(Span(location=state.noise, dimension="width", line_color=INK, line_dash="dotted"))
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

    note = (
        "Filled: RMS on blocks of poses that the fit had not seen. Open: on the rows it was fitted to."
        f" Black: the error {error.in_words}, its bar what 95 of 100 rows stay within, which is what is needed."
        f"{' Dotted: the noise; below it nothing can be gained.' if state.noise else ''}"
    )
    return Picture("fall", single("fall", made), sources, _tables, tune, note=note)


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


def _tables(state: ErrorHistory) -> Tables:
    table: dict[str, object] = {"step": _steps(state), "action": [r.action for r in state.steps]}
    for key, sides in (("held", [r.held_out for r in state.steps]), ("fit", [r.fitted for r in state.steps])):
        each = [{bare(name): value for name, value in side.by_reading.items()} for side in sides]
        for name in _names(state):
            table[f"{key}_{name}"] = _drawn([one.get(name, np.nan) for one in each])
        table[f"{key}_{_ERROR}"] = _drawn([side.rms for side in sides])
    table["p95"] = _drawn([r.held_out.p95 for r in state.steps])
    return {"steps": table}


def _drawn(values: Sequence[float]) -> Floats:
    """On a logarithmic axis, which has no place for zero."""
    return np.array([v if v > 0 else np.nan for v in values])
