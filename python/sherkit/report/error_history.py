"""The fall of the error: held out and fitted, step by step and axis by axis, against noise and requirement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from bokeh.models import FactorRange, Label, Range1d, Span

from ..diagnosis import Diagnosis
from ..model.kinds import required_um
from ..study import Study
from ..study_step import StudyStep
from .picture import Picture, Tables, single, sources_of
from .style import COLOURS, FONT, FONT_SIZE, INK, MARKERS, figure, hover, legend

_HEIGHT = 380
#: More steps than this have their numbers alone: hover says the names.
_NAMED = 9
#: Width of a letter with its part of the gap between names, px; names that are wider together stand aslant.
_LETTER = 8.4
#: Height of a line of them, px.
_LINE_PX = 22
#: What all readings leave together, beside each of them.
_ALL = "all"


@dataclass(frozen=True)
class ErrorOfStep:
    """One step: what was done, and the error it left on each axis, held out and fitted, in the unit of the fall.

    ``short`` is what stands at the axis, where that is another name.
    """

    action: str
    held_out: Mapping[str, float]
    fitted: Mapping[str, float]
    short: str = ""


@dataclass(frozen=True)
class ErrorHistory:
    """Steps in order; ``noise`` by axis (empty where unknown), ``required`` the accuracy needed, both in ``unit``."""

    steps: Sequence[ErrorOfStep]
    noise: Mapping[str, float]
    unit: str
    required: float | None = None


def current_path(history: Sequence[StudyStep]) -> list[int]:
    """Steps (numbers) that lead to where a study stands: what was taken back, or done and undone, is left out.

    A step that leaves the same as an earlier one stands for that one, with nothing between them.
    """
    path: list[int] = []
    states: list[tuple[Any, ...]] = []
    for k, step in enumerate(history):
        left = tuple((name, f"{value:.6g}") for name, value in step.training_rms.items())
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
    steps = [
        ErrorOfStep(
            s.action,
            {name.rsplit("_", 1)[0]: v for name, v in s.held_out_rms.items()},
            {name.rsplit("_", 1)[0]: v for name, v in s.training_rms.items()},
        )
        for s in study.history
    ]
    known = found is not None and found.noise_origin != "unknown"
    unit = study.data.layout.unit
    # an accuracy in µm says nothing of pixels
    needed = required_um(study.robot) if unit == "µm" else None
    return ErrorHistory(steps, found.noise if found is not None and known else {}, unit, needed)


def error_history(state: ErrorHistory, *, height_px: int = _HEIGHT, room_px: int = 860) -> Picture[ErrorHistory]:
    """RMS of single readings at every step on a logarithmic scale.

    Filled marks are errors on blocks of poses that the fit had not seen, open ones those on the rows it was fitted to;
    the heavy line is that of all readings together. ``room_px`` is there for the names of steps.
    """
    names = _names(state)
    together = [_ALL] if len(names) > 1 else []
    sources = sources_of(_tables(state))
    made = figure(
        height=height_px, sizing_mode="stretch_width", y_axis_type="log", x_range=FactorRange(*_steps(state)),
        y_range=Range1d(*_reach(state)),
    )  # fmt: skip
    made.yaxis.axis_label = f"RMS error, {state.unit}"
    made.xaxis.major_label_orientation = _slant(state, room_px)
    renderers = []
    for k, name in enumerate([*names, *together]):
        last = k == len(names)
        colour, marker = (INK, "plus") if last else (COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)])
        made.line("step", f"held_{name}", source=sources["steps"], color=colour, line_width=4 if last else 2,
                  legend_label=name)  # fmt: skip
        filled = made.scatter(
            "step", f"held_{name}", source=sources["steps"], color=colour, marker=marker, size=13, legend_label=name
        )
        open_ = made.scatter(
            "step", f"fit_{name}", source=sources["steps"], line_color=colour, fill_color="white", marker=marker, size=9
        )
        renderers += [filled, open_]
        if name in state.noise:
            made.add_layout(Span(location=state.noise[name], dimension="width", line_color=colour, line_dash="dotted"))
    if state.required:
        made.add_layout(
            Span(location=state.required, dimension="width", line_color=INK, line_width=2, line_dash="dashed")
        )
        _say(made, state.required, f"needed: {state.required:g} {state.unit}")
    if state.noise:
        _say(made, float(np.mean(list(state.noise.values()))), "noise")
    made.add_tools(
        hover(
            renderers,
            ("step", "@action"),
            *((n, f"@held_{n}{{0.0}} held out, @fit_{n}{{0.0}} fitted") for n in [*names, *together]),
        )
    )
    made.xgrid.grid_line_color = None
    legend(made)

    def tune(new: ErrorHistory) -> None:
        made.x_range.factors = _steps(new)
        made.y_range.start, made.y_range.end = _reach(new)
        made.xaxis.major_label_orientation = _slant(new, room_px)

    note = (
        "Filled: on blocks of poses that the fit had not seen. Open: on the rows it was fitted to."
        f"{' Black: all readings together.' if together else ''}"
        f"{' Dotted: the noise of each axis; below it nothing can be gained.' if state.noise else ''}"
    )
    return Picture("fall", single("fall", made), sources, _tables, tune, note=note)


def _say(made: Any, height: float, text: str) -> None:
    """Names a line at the left edge, whatever the steps are."""
    made.add_layout(
        Label(x=6, x_units="screen", y=height, y_offset=3, text=text, text_font_size=FONT_SIZE, text_font=FONT,
              text_color=INK, text_baseline="bottom", background_fill_color="white", background_fill_alpha=0.75)
    )  # fmt: skip


def _names(state: ErrorHistory) -> list[str]:
    return list(dict.fromkeys(name for step in state.steps for name in step.held_out))


def _reach(state: ErrorHistory) -> tuple[float, float]:
    """Lowest and highest error of the axis: every value has a place there, and so have noise and requirement."""
    values = [v for step in state.steps for side in (step.held_out, step.fitted) for v in side.values()]
    known = [v for v in (*values, *state.noise.values(), state.required or 0.0) if np.isfinite(v) and v > 0] or [1.0]
    low, high = min(known), max(known)
    reach = max(high / low, 2.0)
    # the name of a line stands above it
    above = 0.2 if high == state.required or high in state.noise.values() else 0.08
    return low / reach**0.08, high * reach**above


def _steps(state: ErrorHistory) -> list[str]:
    if len(state.steps) > _NAMED:
        return [str(k) for k in range(len(state.steps))]
    return [f"{k}. {step.short or step.action}" for k, step in enumerate(state.steps)]


def _slant(state: ErrorHistory, room_px: int) -> float:
    """Angle of the names, rad: none where they fit, else as little as keeps them apart."""
    if _LETTER * sum(map(len, _steps(state))) <= room_px:
        return 0.0
    return min(_LINE_PX * len(state.steps) / room_px, 0.6)


def _tables(state: ErrorHistory) -> Tables:
    table: dict[str, object] = {"step": _steps(state), "action": [r.action for r in state.steps]}
    for name in _names(state):
        for key, values in (("held", [r.held_out.get(name) for r in state.steps]),
                            ("fit", [r.fitted.get(name) for r in state.steps])):  # fmt: skip
            # a logarithmic axis has no place for zero
            table[f"{key}_{name}"] = np.array([v if v is not None and v > 0 else np.nan for v in values])
    for key in ("held", "fit"):
        each = np.array([table[f"{key}_{name}"] for name in _names(state)])
        table[f"{key}_{_ALL}"] = np.sqrt(np.mean(each**2, axis=0))
    return {"steps": table}
