"""What has changed of a machine, as pictures: before and after on one scale, the mechanism with the change exaggerated,
and the course of what has changed over the runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from bokeh.models import Whisker

from ..base.figures import in_people_units, number
from ..changes import Comparison, History
from ..changes.joined import Joined
from ..errors import FitError, SherkitError
from ..model.drawing import drawing_of_readings
from ..model.kinds import draw_of
from .exaggerated import growing
from .picture import Picture, Tables, sources_of, stacked
from .scene import Scene
from .style import COLOURS, MUTED, figure, padded, quantity

_HEIGHT, _WIDE = 260, 460
#: Coordinates along which errors are drawn, poses among which the one is looked for where a change shows most.
_ALONG, _POSES = 3, 40
#: A change that moves less than this, mm, is not drawn.
_ROUNDING_MM = 1e-9


def _of(found: Comparison) -> Joined:
    if found.joined is None:
        raise FitError("a comparison without its runs cannot be drawn")
    return found.joined


def before_and_after(found: Comparison) -> Picture[Comparison]:
    """What the model of the first run leaves in each run, seen from where its sensor stands, along each coordinate:
    runs beside each other, on one scale.

    Raises :class:`~sherkit.errors.FitError` for a comparison that was read from a file, without its runs.
    """
    joined = _of(found)
    titles = ["before", "after"] if len(joined.runs) == 2 else [f"run {k + 1}" for k in range(len(joined.runs))]
    tables = _errors(found)
    sources = sources_of(tables)
    names = [name for name in tables["run_1"] if name != "error"]
    top = 1.05 * max(float(table["error"].max(initial=0.0)) for table in tables.values()) or 1.0
    figures = []
    for name in names:
        ends = np.concatenate([table[name] for table in tables.values()])
        across = padded(float(ends.min()), float(ends.max()))
        for k, (key, title) in enumerate(zip(tables, titles, strict=True)):
            made = figure(height=_HEIGHT, width=_WIDE, y_range=(0.0, top), x_range=across)
            made.scatter(name, "error", source=sources[key], size=5, color=COLOURS[k % len(COLOURS)], alpha=0.7)
            rms = float(np.sqrt(np.square(tables[key]["error"]).mean()))
            told = f": {number(rms)} {found.unit} (root mean square)" if name == names[0] else ""
            made.title.text = f"{title}{told}"
            made.xaxis.axis_label = quantity(name)
            made.yaxis.axis_label = f"error, {found.unit}" if not k else None
            figures.append(made)
    root = stacked("before_and_after", figures, columns=len(titles))
    note = "Each dot is a row: how far off it is by the model of the first run, seen from where the sensor stands."
    return Picture("before_and_after", root, sources, _errors, note=note)


def _errors(found: Comparison) -> Tables:
    """By run, the size of what is left of each row that is used, and where that was."""
    joined, out = _of(found), {}
    for k, run in enumerate(joined.runs):
        used = run.used.any(axis=1)
        left = np.linalg.norm(np.where(run.used, run.stand.residual, 0.0), axis=1)
        out[f"run_{k + 1}"] = {name: values[used] for name, values in list(joined.places(run).items())[:_ALONG]}
        out[f"run_{k + 1}"]["error"] = run.data.layout.per_unit * left[used]
    return out


def mechanism_with_change(found: Comparison) -> tuple[Scene, str] | None:
    """The machine as the first run has it, and with what has changed, exaggerated until it can be seen, at the pose of
    the last run where it shows most; how to read it. None where nothing was named, or no drawing shows it."""
    joined = found.joined
    if joined is None or not found.parameters:
        return None
    by = {one.name: one.change for one in found.parameters}
    model, inside = joined.model, {e.name for e in joined.model.effects}
    for one in joined.candidates:
        if one.effect is not None and one.effect.name not in inside and any(p.name in by for p in one.parameters):
            model = model.adopting(one.effect)
    known = dict(zip((p.name for p in joined.model.parameters), joined.fit.values, strict=True))
    values = np.array([known.get(p.name, 0.0) for p in model.parameters])
    change = np.array([by.get(p.name, 0.0) for p in model.parameters])
    draw, data = draw_of(model), joined.runs[-1].data
    if draw is drawing_of_readings:
        return None
    rows = data.select(np.linspace(0, len(data) - 1, min(len(data), _POSES)).astype(int))
    try:
        moved = np.linalg.norm(
            draw(model, rows, values + change, None).shown_mm - draw(model, rows, values, None).shown_mm, axis=1
        )
        best = int(np.argmax(np.nan_to_num(moved)))
        row = rows.select(np.array([best]))
        frames, begin = growing(lambda factor: draw(model, row, values + factor * change, None))
    except SherkitError:
        return None
    if not frames or not moved[best] > _ROUNDING_MM:
        return None
    plain = draw(model, row, values, None)
    names = " and ".join(found.changed)
    scene = Scene(f"The machine with {names} changed, exaggerated", [(0.0, plain), *frames], begin, unit=plain.unit)
    unit, times = ("µm", 1e3) if plain.unit == "mm" else (plain.unit, 1.0)
    read = (
        f"Grey: as before. In colour: with what has changed of {names}, so much larger that it can be seen (slider). "
        f"As it is, it moves what is read by {number(times * float(moved[best]))} {unit} at this pose, "
        f"{row.counted} {row.line[0]} of the last run."
    )
    return scene, read


def course(found: History) -> Picture[History]:
    """The error of each run by the model of the first, and beneath it how each of what has changed stands to the first
    run, with two standard deviations; what stood still is left out."""
    dates = _dates(found)
    tables = _course(found)
    sources = sources_of(tables)
    errors = figure(height=_HEIGHT, x_range=dates, sizing_mode="stretch_width")
    _line(errors, sources["error"], COLOURS[0])
    errors.y_range.start = 0.0
    errors.yaxis.axis_label = f"error, {found.unit}"
    errors.title.text = "Error by the model of the first run"
    figures = [errors]
    for k, name in enumerate(found.values):
        across = padded(float(tables[name]["low"].min()), float(tables[name]["high"].max()))
        made = figure(height=_HEIGHT, x_range=dates, y_range=across, sizing_mode="stretch_width")
        _line(made, sources[name], COLOURS[(k + 1) % len(COLOURS)])
        made.add_layout(Whisker(base="date", lower="low", upper="high", source=sources[name], level="annotation"))
        made.yaxis.axis_label = _unit(found, name)[0]
        made.title.text = "; ".join(str(replace(one, or_else=())) for one in found.changes if one.name == name)
        figures.append(made)
    root = stacked("course", figures, sizing_mode="stretch_width")
    return Picture("course", root, sources, _course, note="Bars are two standard deviations.")


def _line(made: Any, source: Any, colour: str) -> None:
    made.line("date", "value", source=source, color=MUTED)
    made.scatter("date", "value", source=source, color=colour, size=9)


def _dates(found: History) -> list[str]:
    return [f"{k + 1}: {run['date']}" for k, run in enumerate(found.runs)]


def _unit(found: History, name: str) -> tuple[str, float]:
    """The unit of a course, and how many of it one of the parameter's is."""
    unit = next(u for one in found.changes if one.name == name for _, _, _, u in one.parameters)
    shown, times = in_people_units(unit)
    return shown, times


def _course(found: History) -> Tables:
    dates: Sequence[str] = _dates(found)
    out: Tables = {"error": {"date": dates, "value": [run["error"] for run in found.runs]}}
    for name, values in found.values.items():
        times = _unit(found, name)[1]
        at, off = (times * np.array(values)).T
        out[name] = {"date": dates, "value": at, "low": at - 2.0 * off, "high": at + 2.0 * off}
    return out
