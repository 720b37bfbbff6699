"""Short pages of their own: what has changed of a machine, the course over the years, a run that chose its poses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.models import DataRange1d, Whisker

from ..adaptive import Adaptive
from ..base.figures import brief, in_people_units, number
from ..changes import Comparison, History
from ..changes.pooled_fit import Joined
from ..changes.vouching import errors_of
from ..errors import FitError, SherkitError
from ..model.drawing import drawing_of_readings
from ..model.kinds import draw_of
from .card import growing
from .page import Made, Section, html_sentences, html_table, write_page
from .picture import COLOURS, MUTED, Picture, Tables, figure, legend, padded, quantity, sources_of, spread_over
from .scene import Scene

_HEIGHT, _WIDE = 260, 460
#: Letters of a name in a legend: more do not lie on a phone.
_CALLED = 36
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
    off = errors_of(joined)
    titles = ["before", "after"] if len(joined.runs) == 2 else [run.data.source for run in joined.runs]
    tables = _errors(found)
    sources = sources_of(tables)
    names = [name for name in tables["run_1"] if name != "error"]
    top = 1.05 * max(float(table["error"].max(initial=0.0)) for table in tables.values()) or 1.0
    figures = []
    for name in names:
        ends = np.concatenate([table[name] for table in tables.values()])
        across = padded(float(ends.min()), float(ends.max()))
        for k, (key, title) in enumerate(zip(tables, titles, strict=True)):
            up = f"error, {found.unit}" if not k else None
            made = figure(quantity(name), up, height=_HEIGHT, width=_WIDE, y_range=(0.0, top), x_range=across)
            # before and after in the colours of the bars
            colour = COLOURS[{0: 1, 1: 0}.get(k, k) % len(COLOURS)]
            made.scatter(name, "error", source=sources[key], size=5, color=colour, alpha=0.7)
            told = f": {number(off[k])} {found.unit} (root mean square)" if name == names[0] else ""
            made.title.text = f"{title}{told}"
            figures.append(made)
    note = "Each dot is a row: how far off it is by the model of the first run, seen from where the sensor stands."
    return Picture.of("before_and_after", figures, sources, _errors, note=note, columns=len(titles))


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
        if not one.frees and one.name not in inside and any(p.name in by for p in one.qualified()):
            model = model.adopting(one)
    known = dict(zip((p.name for p in joined.model.parameters), joined.fit.values, strict=True))
    values = np.array([known.get(p.name, 0.0) for p in model.parameters])
    change = np.array([by.get(p.name, 0.0) for p in model.parameters])
    draw, data = draw_of(model), joined.runs[-1].data
    if draw is drawing_of_readings:
        return None
    rows = data.select(spread_over(np.arange(len(data)), _POSES))
    try:
        row, moves, frames, begin = growing(
            lambda these, factor: draw(model, these, values + factor * change, None), rows
        )
    except SherkitError:
        return None
    if len(frames) == 1 or not moves > _ROUNDING_MM:
        return None
    names = " and ".join(found.changed)
    scene = Scene(f"The machine with {names} changed, exaggerated", frames, begin)
    read = (
        f"Grey: as before. In colour: with what has changed of {names}, so much larger that it can be seen (slider). "
        f"As it is, it moves what is read by {number(1e3 * moves)} µm at this pose, "
        f"{row.counted} {row.line[0]} of the last run."
    )
    return scene, read


def course(found: History) -> Picture[History]:
    """The error of each run by the model of the first, and beneath it how each of what has changed stands to the first
    run, with two standard deviations; what stood still is left out."""
    dates = _dates(found)
    tables = _course(found)
    sources = sources_of(tables)
    errors = figure(up=f"error, {found.unit}", height=_HEIGHT, x_range=dates)
    _line(errors, sources["error"], COLOURS[0])
    errors.y_range.start = 0.0
    errors.title.text = "Error by the model of the first run"
    figures = [errors]
    for k, name in enumerate(found.values):
        across = padded(float(tables[name]["low"].min()), float(tables[name]["high"].max()))
        unit = _unit(found, name)[0]
        # a turned ° is a dot
        made = figure(up="degrees" if unit == "°" else unit, height=_HEIGHT, x_range=dates, y_range=across)
        _line(made, sources[name], COLOURS[(k + 1) % len(COLOURS)])
        made.add_layout(Whisker(base="date", lower="low", upper="high", source=sources[name], level="annotation"))
        made.title.text = name
        figures.append(made)
    return Picture.of("course", figures, sources, _course, note="Bars are two standard deviations.")


def _line(made: Any, source: Any, colour: str) -> None:
    # dates lie on one another on a phone
    made.xaxis.major_label_orientation = 0.5
    made.line("date", "value", source=source, color=MUTED)
    made.scatter("date", "value", source=source, color=colour, size=9)


def _dates(found: History) -> list[str]:
    return [f"{k + 1}: {run['date']}" for k, run in enumerate(found.runs) if run["error"] is not None]


def _unit(found: History, name: str) -> tuple[str, float]:
    """The unit of a course, and how many of it one of the parameter's is."""
    return in_people_units(next(u for one in found.changes for n, _, _, u in one.parameters if n == name))


def _course(found: History) -> Tables:
    dates: Sequence[str] = _dates(found)
    out: Tables = {"error": {"date": dates, "value": [r["error"] for r in found.runs if r["error"] is not None]}}
    for name, values in found.values.items():
        times = _unit(found, name)[1]
        at, off = (times * np.array(values)).T
        out[name] = {"date": dates, "value": at, "low": at - 2.0 * off, "high": at + 2.0 * off}
    return out


# -- A run that chose its poses ---------------------------------------------------------------------------------------

#: Until it is done a browser reads the page anew after so many seconds.
_AGAIN_S = 5
_LOOP_HEIGHT, _SQUARE = 300, 380
_TEN = float(np.log(10.0))
#: What several rows are driven for is one colour.
_KINDS = ("start", "all", "what tells rivals apart", "confirm", "explore", "again", "time")


def write_adaptive(path: Path, loop: Adaptive, made: Made) -> None:
    """Writes the evidence of what led, reading after reading, how far off the models were at readings that they did
    not know yet, and where and why the robot was driven. Until the loop is done the page renews itself."""
    sections = []
    if loop.looks:
        sections += [
            Section("Evidence", html_sentences(loop.sentence()), _evidence(loop),
                    "Of what is missing, as powers of ten to one; above the dashed line something leads."),
            Section("Error", "", _error_lines(loop), "At readings that no fit knew yet; what is promised."),
        ]  # fmt: skip
    if loop.readings:
        sections.append(Section("Where it was driven", "", _places(loop), "By why."))
    write_page(path, loop.answer, sections, made, again_s=0 if loop.done else _AGAIN_S)


def _evidence(loop: Adaptive) -> Any:
    looks = loop.looks
    made = figure("readings", "evidence, powers of ten", height=_LOOP_HEIGHT + 60)
    readings = [one.readings for one in looks]
    made.line(readings, [one.log_evidence / _TEN for one in looks], color=MUTED, line_dash="dashed",
              legend_label="anything is missing")  # fmt: skip
    for k, name in enumerate(list(looks[-1].causes)[:3]):
        values = [one.causes.get(name, np.nan) / _TEN for one in looks]
        made.line(readings, values, color=COLOURS[k], line_width=2, legend_label=brief(name, _CALLED))
        made.scatter(readings, values, color=COLOURS[k], size=6)
    legend(made, "below")
    return made


def _error_lines(loop: Adaptive) -> Any:
    steps = loop.progress
    readings = [one.readings for one in steps]
    made = figure("readings", f"error, {loop.layout.unit}", height=_LOOP_HEIGHT, y_range=DataRange1d(start=0.0))
    lines: tuple[tuple[str, Sequence[float | None], str], ...] = (
        ("new readings, by the geometry alone", [one.by_geometry for one in steps], MUTED),
        ("new readings, with what leads", [one.by_lead for one in steps], COLOURS[0]),
        ("anywhere, 95 of 100, by the fit alone", [one.accuracy_um for one in steps], COLOURS[1]),
    )
    for name, values, colour in lines:
        if any(value is not None and np.isfinite(value) for value in values):
            made.line(readings, values, color=colour, line_width=2, legend_label=name)
            made.scatter(readings, values, color=colour, size=6)
    if loop.done and loop.accuracy_um is not None:
        made.scatter(readings[-1:], [loop.accuracy_um], color=COLOURS[1], size=10, marker="diamond",
                     legend_label="anywhere, promised by a calibration")  # fmt: skip
    legend(made, "below")
    return made


def _places(loop: Adaptive) -> Any:
    """Where the robot was driven, by why."""
    data = loop.data
    reached = loop.region.reached_at(data.joints)
    placed = dict(zip(loop.region.targets, reached.T, strict=True))
    x, y = list(placed)[:2]
    why = [_kind(one) for one in loop.reasons] or ["all"] * len(data)
    made = figure(quantity(x), quantity(y), frame_width=_SQUARE, frame_height=_SQUARE, match_aspect=True)
    for k, kind in enumerate(_KINDS):
        at = [i for i, one in enumerate(why) if one == kind]
        if at:
            made.scatter(placed[x][at], placed[y][at], size=7, color=COLOURS[k % len(COLOURS)], alpha=0.8,
                         legend_label=kind)  # fmt: skip
    legend(made, "below")
    return made


def _kind(reason: str) -> str:
    return _KINDS[2] if "|" in reason else reason if reason in _KINDS else "all"


# -- As pages ---------------------------------------------------------------------------------------------------------


def write_comparison(path: Path, found: Comparison, made: Made) -> None:
    """Before and after beside each other on one scale, and the mechanism with what has changed, exaggerated.

    Raises :class:`~sherkit.errors.FitError` for a comparison that was read from a file, without its runs.
    """
    if found.joined is None and found.silent:
        write_page(path, found.answer, [], made)
        return
    sections, drawn = [], mechanism_with_change(found)
    if found.parameters:
        rows = [(one.name, one.by, str(one.since + 1)) for one in found.parameters]
        sections.append(Section("What has changed", html_table(("parameter", "change", "since run"), rows)))
    if drawn is not None:
        sections.append(Section("On the machine", f"{drawn[0].html()}{html_sentences(drawn[1])}"))
    picture = before_and_after(found)
    sections.append(Section("Before and after", "", picture.root, picture.note))
    if found.next_poses:
        poses = [[f"{value:.4g}" for value in pose.values()] for pose in found.next_poses]
        heads = [quantity(name) for name in found.next_poses[0]]
        sections.append(Section("Poses that would tell", html_table(heads, poses)))
    write_page(path, found.answer, sections, made)


def write_history(path: Path, found: History, made: Made) -> None:
    """The error of each run, and of what has changed its course with deviations; what stood still is left out."""
    rows = [(str(run["run"]), str(run["date"]), str(run["rows"]),
             "left out" if run["error"] is None else number(run["error"])) for run in found.runs]  # fmt: skip
    sections = []
    if any(run["error"] is not None for run in found.runs):
        picture = course(found)
        sections.append(Section("The course", "", picture.root, picture.note))
    sections.append(Section("Runs", html_table(("run", "date", "rows", f"error, {found.unit}"), rows)))
    write_page(path, found.answer, sections, made)
