"""The report: one HTML file that opens without a network and answers in the order in which a person asks.

Numbers and verdicts are plain HTML, so that it reads without JavaScript too; the pictures are Bokeh's, in the file.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.models import GridPlot

from ..base.figures import CALIBRATED, in_people_units, in_small_units, listed, state_with, stated, with_error
from ..calibration import Result
from ..data.files import write_whole
from ..diagnosis import Diagnosis
from ..diagnosis.findings import plausibility
from ..diagnosis.result import APART, NEXT
from ..errors import SherkitError
from ..fit.forms import known
from ..model.kinds import required_um
from ..robots.calibrated import Calibration, calibration_class
from ..robots.calibration_run import CalibrationRun
from ..study import Study
from .candidates import Atlas, atlas_of, candidates, signature_atlas
from .card import effect_card
from .page import Made, rendered
from .parameters import NextPoses, accuracy_map, accuracy_of, correlations, directions, next_poses, parameters
from .picture import Picture, number, quantity
from .residual_against import ResidualAgainst, noise_picture, residual_against, run_in_time
from .residual_arrows import Change
from .residual_map import residual_map, still
from .residuals import ModelState, Residuals, drawn, residuals_of, said
from .scene import space_of
from .states import error_history, error_history_of, packed, states_of

#: Cards of effects that cannot be told from those that are named.
_MOST_TIED = 3
#: Candidates that stand in the part that is open.
_MOST_OPEN = 5
#: Width of the maps beside one another: wider ones are higher, and the first screens are for what was found.
_MAPS_PX = 760
#: The parts, in the order in which a person asks.
_CONTENTS = (
    ("answer", "Answer"), ("maps", "Maps"), ("which", "What it is"), ("known", "Parameters"),
    ("rests", "What it rests on"), ("measured", "What was measured"), ("good", "How good the model was"),
    ("missing_from", "Is anything missing?"), ("where_it_shows", "Where it shows"), ("alike", "What else was tried"),
    ("apart", "What cannot be told apart"), ("history", "How the error fell"),
    ("next", "What to measure next"), ("use", "How to use it"), ("made", "How this was made"),
)  # fmt: skip
#: Height of a printed page as wide as the pictures (letter, which is the lower), with room for a note; what axis and
#: title take of a figure, px.
_PAGE_PX, _AXIS_PX = 1230, 62


@dataclass(frozen=True, eq=False)
class Report:
    """What a report tells. ``study`` is at the state that is told last; ``found`` was asked of ``found.base``.

    ``calibration`` is what the report says how to use; ``result`` a calibration run with its tables. ``simulated`` says
    so at the top. ``printed`` are the figures of a paper to stand beside, by run, by line of its table and by reading:
    RMS and deviation, in the unit that people read.
    """

    study: Study
    found: Diagnosis
    made: Made
    calibration: Calibration | None = None
    result: Result | None = None
    simulated: bool = False
    printed: Mapping[str, Mapping[str, Mapping[str, tuple[int, int]]]] = field(default_factory=dict)
    #: Lines that a command adds: what else was measured, in sentences.
    remarks: Sequence[str] = field(default_factory=tuple)


def write_report(report: Report, path: str | Path) -> None:
    """Writes the report as one HTML file. Raises :class:`~sherkit.errors.NotWritten`."""
    write_whole(path, html(report))


def html(report: Report) -> str:
    """The report as HTML. Every text from files is escaped."""
    pictures, swaps, atlas, maps = _pictures(report)
    cards, other_cards = _cards(report, atlas)
    roots = {name: one.root for name, one in pictures.items()}
    filters: dict[str, Callable[..., Any]] = {
        "p": _p, "quantity": quantity, "listed": listed, "plausibility": plausibility, "known": stated,
        "given": report.made.given,
    }  # fmt: skip
    told = report.found.to_json()
    told["findings"] = [
        one | {"command": report.made.given(one["command"])} if one.get("command") else one for one in told["findings"]
    ]
    return rendered(
        "report.html", report.found.answer, report.made, roots, filters,
        report=report,
        found=report.found,
        study=report.study,
        said=report.found.findings,
        questions={"APART": APART, "NEXT": NEXT},
        told={one.about: one for one in report.found.findings},
        contents=_CONTENTS,
        most=_MOST_OPEN,
        alone=_nothing_added(report),
        cards=cards,
        other_cards=other_cards,
        space=_space(report),
        lines=_error_lines(report),
        parameters=_parameter_lines(report),
        directions=[str(d) for d in getattr(report.study.fit, "badly_observed", ())],
        unobserved=[str(d) for d in getattr(report.study.fit, "unobserved", ())],
        accuracy=_accuracy_lines(report.calibration),
        coordinates=_together(report.calibration.coordinates) if report.calibration else "",
        printed_map=_printed(pictures["residual_map"]),
        example=_example(report.calibration),
        measured=_measured(report),
        notes={name: one.note for name, one in pictures.items()},
        swaps=_in_script(swaps) if swaps else None,
        variables=[(k, quantity(name)) for k, name in enumerate(swaps["variables"])] if swaps else [],
        titles=list(enumerate(swaps["titles"])) if swaps else [],
        still=maps,
        machine=_in_script(told),
        required=required_um(report.study.robot),
    )  # fmt: skip


def _nothing_added(report: Report) -> bool:
    """Whether the study stands where the diagnosis was asked: there is no second map then."""
    return {e.name for e in report.study.fit.model.effects} <= {e.name for e in report.found.base.model.effects}


def _in_script(value: Any) -> str:
    """JSON that can stand in a page: no text in it ends its script element or begins another."""
    return json.dumps(value, allow_nan=False).replace("<", "\\u003c")


def _p(value: float) -> str:
    return "< 1e-16" if value < 1e-16 else f"{value:.2g}"


def _printed(picture: Picture[Any]) -> str:
    """How much smaller a grid of figures is printed, so that it stands on one page."""
    grid = next(one for one in (picture.root, *picture.root.children) if isinstance(one, GridPlot))
    rows = {row: figure.frame_height + _AXIS_PX for figure, row, *_ in grid.children}
    return f"{min(1.0, _PAGE_PX / sum(rows.values())):.2f}"


def _together(names: Sequence[str]) -> str:
    """Quantities with the unit that they share said once: ``x, y and z in mm``."""
    pairs = [quantity(name).partition(", ")[::2] for name in names]
    units = {unit for _, unit in pairs}
    if len(units) > 1 or units == {""}:
        return listed([f"{label} in {unit}" if unit else label for label, unit in pairs])
    return f"{listed([label for label, _ in pairs])} in {units.pop()}"


def _cards(report: Report, atlas: Atlas | None) -> tuple[list[str], list[tuple[str, str]]]:
    """The cards of the effects that are missing; by name, those of effects that these poses cannot tell from them."""
    found, study = report.found, report.study
    every = {**found.base.model.known_effects, **found.base.model.held, **study.own}
    inside = {e.name: e for e in study.fit.model.effects}

    def card(name: str, atlas: Atlas | None = None) -> str:
        fit = study.fit if name in inside else found.fit
        return effect_card(inside.get(name, every[name]), fit=fit, found=found, atlas=atlas)

    tied = [name for tie in found.indistinguishable for name in tie if name not in found.effects]
    others = [name for name in dict.fromkeys(tied) if name in every][:_MOST_TIED]
    return [card(name) for name in found.effects if name in every], [(name, card(name, atlas)) for name in others]


def _space(report: Report) -> str:
    """The errors before and after in three dimensions; nothing where the run says no places."""
    last = ModelState(state_with(report.study.effects), report.study.fit)
    scene = space_of(ModelState(CALIBRATED, report.found.base), last, report.calibration)
    return "" if scene is None else scene.html()


def _pictures(report: Report) -> tuple[dict[str, Picture[Any]], dict[str, Any] | None, Atlas | None, str]:
    """All pictures that these rows allow, the tables to switch them by, what the effects look like, and the map for
    readers without JavaScript."""
    study, found = report.study, report.found
    base, last = drawn(found.base), drawn(study.fit)
    before, after = (residuals_of(one).with_noise_of(found) for one in (base, last))
    out: dict[str, Picture[Any]] = {}
    swaps, atlas = None, None
    states = states_of(study, found, base)
    # the first one where nothing was added to the model that was diagnosed
    now = next((k for k, s in enumerate(states) if s.title == state_with(study.effects)), 0)
    chosen = states[now]
    change = Change(before, chosen.left, states[0].title, chosen.title)
    out["residual_map"] = residual_map(change, planes_across=True, width_px=_MAPS_PX, alone=_nothing_added(report))
    if before.variables:
        variable = _leading(found, before)
        out["against"] = residual_against(ResidualAgainst(chosen.left, variable, before if now else None))
        swaps = packed(states, out["residual_map"]) | {"start": list(before.variables).index(variable), "state": now}
    if found.candidates:
        out["candidates"] = candidates(found)
        atlas = atlas_of(base, tuple(study.own.values()))
        out["atlas"] = signature_atlas(atlas)
    out["fall"] = error_history(error_history_of(study, found))
    out["parameters"] = parameters(study.fit)
    out["correlations"] = correlations(study.fit)
    if getattr(study.fit, "badly_observed", ()):
        out["directions"] = directions(study.fit)
    if report.calibration is not None:
        out["accuracy"] = accuracy_map(accuracy_of(report.calibration))
    if found.next_poses:
        out["next_poses"] = next_poses(NextPoses(found.next_poses, before))
    out["noise"] = noise_picture(after)
    if _in_time(found):
        out["run"] = run_in_time(after)
    for name in ("residual_map", "against", "atlas", "next_poses", "noise", "run"):
        if name in out:
            out[name].note += said(len(base.data), len(found.base.data))
    return out, swaps, atlas, still(change)


def _in_time(found: Diagnosis) -> bool:
    """Whether the run in time shows more than noise."""
    wanders = any(one.holds is False for one in found.checks if one.name in ("steady", "nothing_left"))
    return wanders or bool(found.correlation_in_time) or bool(len(found.outliers))


def _leading(found: Diagnosis, left: Residuals) -> str:
    """The variable on which the error depends most clearly."""
    known = [d.variable for d in found.where if d.variable in left.variables]
    return known[0] if known else next(iter(left.variables))


def _measured(report: Report) -> list[tuple[str, str]]:
    """What was measured, as pairs of a question and its answer."""
    data, left = report.study.data, residuals_of(report.study.fit)
    poses = len(np.unique(data.groups))
    repeats = f"{len(data) / poses:.3g} readings of each on average" if poses < len(data) else "each read once"
    out = [("run", data.source), ("rows", f"{len(data)} at {poses} poses, {repeats}")]
    for name, values in left.place.items():
        label, unit = quantity(name).partition(", ")[::2]
        out.append((f"range of {label}", f"{values.min():.4g} to {values.max():.4g} {unit}"))
    origin = {
        "declared": "as the file declares",
        "repeats": "from repeats of poses",
        "unknown": "unknown: neither repeats nor declared; this is what the model leaves",
    }[report.found.noise_origin]
    noise = ", ".join(f"{axis} {number(value)} {report.found.unit}" for axis, value in report.found.noise.items())
    out.append(("noise of a reading (1 σ)", f"{noise}, {origin}"))
    if report.found.correlation_in_time:
        out.append(("correlation of the noise", f"{report.found.correlation_in_time:.2f} from row to row"))
    columns = [n for n in left.variables if n not in left.place]
    out.append(("further columns", listed(columns, 20) or "none"))
    wrong = report.found.outliers
    marked = np.setdiff1d(np.flatnonzero(data.outlier), wrong)
    if len(marked):
        out.append(("marked as outliers, not fitted", f"{left.counted}s {listed(data.line[marked], 30)}"))
    if len(wrong):
        out.append(("left out as gross errors", f"{left.counted}s {listed(data.line[wrong], 30)}"))
    out += [(note.name, note.text) for note in calibration_class(report.study.robot).about(report.study.fit)]
    return out + [("remark", text) for text in report.remarks]


def _error_lines(report: Report) -> list[dict[str, Any]]:
    """Table I of every run: lines with their cells, the paper's beside them in a simulation of its experiments."""
    runs = [] if (result := report.result) is None else [("whole", result.whole), ("local", result.local)]
    return [_table_one(one, key, report.printed.get(key, {})) for key, one in runs if one is not None]


def _table_one(run: CalibrationRun, key: str, beside: Mapping[str, Mapping[str, tuple[int, int]]]) -> dict[str, Any]:
    lines = run.lines()
    axes = list(lines[0][3])
    rows: list[tuple[str, list[str], bool]] = []
    for name, printed, error, rms in lines:
        each = [f"{number(rms[a][0])} ± {number(rms[a][1])}" if a in rms else "" for a in axes]
        rows.append((name.strip(), [number(error.rms), number(error.p95), *each], False))
        figures = beside.get(printed, {})
        if figures:
            rows.append(("the paper's robot", ["", "", *(f"{v[0]} ± {v[1]}" for v in figures.values())], True))
    repeats = run.fit.repeatability
    if repeats:
        per_unit = run.fit.data.layout.per_unit
        cells = [f"± {number(per_unit * repeats.sigma[a])}" if a in repeats.sigma else "" for a in axes]
        rows.append(("repeatability (1 σ)", ["", "", *cells], False))
    title = {"whole": "the whole workspace", "local": "the region of interest"}[key]
    columns = [f"error {run.fit.error.in_words}", "95 % within", *(a.rsplit("_", 1)[0] for a in axes)]
    return {"title": title, "axes": columns, "unit": run.fit.data.layout.unit, "rows": rows}


def _parameter_lines(report: Report) -> list[tuple[str, str, str, str, str, str]]:
    fit = report.study.fit
    forms, told = known(fit), set[str]()
    out = []
    for p, v, r, s in zip(fit.parameters, fit.values, fit.std_from_readings, fit.std, strict=True):
        name = p.name.partition(".")[0]
        if one := forms.pop(name, None):
            for known_value in one.values:
                value, std = with_error(known_value.value, known_value.std)
                out.append((f"{name}: {one.where} {known_value.what}", "", value, std, std, known_value.unit))
            told.add(name)
        if "." in p.name and name in told:
            continue
        unit, factor = in_people_units(p.unit)
        value, readings, total = with_error(*(factor * x for x in (v, r, s)))
        out.append((p.name, p.symbol, value, readings, total, unit))
    return out


def _example(calibration: Calibration | None) -> str:
    """A place that can be written down in a few digits and reached: the last of those that a person would ask for."""
    if calibration is None:
        return ""
    places = [[round(float(v), 2) for v in place] for _, place in calibration.places()]
    reached = calibration.inverse_batch(places).reached
    return str(next((place for place, ok in zip(places[::-1], reached[::-1], strict=True) if ok), places[0]))


def _accuracy_lines(calibration: Calibration | None) -> list[tuple[str, str, str]]:
    """Predicted accuracy at places a person would ask for."""
    if calibration is None:
        return []
    out = []
    unit, factor = in_small_units(calibration.accuracy_unit)
    digits = ".1f" if unit == "µm" else ".3g"
    for name, place in calibration.places():
        try:
            predicted = calibration.predicted_accuracy(place)
            text = (
                f"{factor * predicted.total_mm:{digits}} {unit} (mean of many visits), of it "
                f"{factor * predicted.addition_mm:{digits}} unseen; {factor * predicted.visit_mm:{digits}} {unit} "
                "for a single reading"
            )
            text += f": mostly {predicted.effect}. {predicted.advice}" if predicted.matters else ""
            text += "" if calibration.measured(place) else " (extrapolated: no pose was measured there)"
        except SherkitError as error:
            text = str(error)
        out.append((name, ", ".join(f"{v:.4g}" for v in place), text))
    return out
