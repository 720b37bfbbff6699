"""The card of an effect: what it does to this machine as a drawing, what it is, how it shows, what to do in the
workshop, and what a fit and a diagnosis say of it.

:func:`effect_card` gives it as HTML that can stand in any page: in the report, in a cell, and in a page of widgets
(``Div(text=effect_card(...))``). The page needs :func:`~sherkit.report.scene.script` once, which brings the drawing to
life; :func:`~sherkit.report.page.policy` says how it is let in. Every text is escaped, so that an effect of any name
can be shown.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from ..base.figures import listed, sized, stated
from ..base.types import Floats
from ..data import Measurements
from ..data.columns import TEMPERATURE, TIME, unit_in
from ..diagnosis import Diagnosis
from ..errors import SherkitError
from ..fit.forms import SimplestForm, known
from ..fit.identify import Fit
from ..model.any import Model
from ..model.base import ModelWithEffects, missing_columns
from ..model.drawing import Drawing
from ..model.effect import Effect
from ..model.kinds import Kind, Robot, draw_of, kind_of, model_of
from .candidates import Atlas, Tile
from .page import fresh_nonce, policy
from .picture import number, spread_over
from .residual_arrows import Change
from .residual_map import still
from .residuals import Residuals
from .scene import Scene, script

# -- What an effect does, exaggerated until it can be seen ------------------------------------------------------------

#: Times the effect as it is.
FACTORS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
#: Poses among which the one is looked for where the effect shows most.
_POSES = 40
#: A drawing that is off by more than this part of the machine's size shows no machine any more; one that is off by this
#: much is easily seen.
_MOST, _SEEN = 0.8, 0.12
#: What an effect needs besides the joints, in a row that nobody measured: an hour after the start, five degrees warmer,
#: after a motion upwards, at this speed, under a load of one.
_HOUR_S, _WARM_C = 3600.0, 25.0
_SPEED = {"mm": 20.0, "rad": 0.5, "deg": 30.0}
#: Period of an encoder's error where nobody gave one.
_PERIOD = {"mm": 2.0, "rad": 0.5, "deg": 30.0}


@dataclass(frozen=True, eq=False)
class Exaggerated:
    """A machine as drawn and with an effect at ``factors`` (k,) times its size: ``drawings`` of one pose each,
    ``plain`` without it.

    ``moves_mm`` is how far the effect as it is moves what is read at this pose; ``factor`` is
    the one to begin with, at which it is easily seen. ``told`` says of which pose and moment this is.
    """

    effect: Effect
    values: Floats
    plain: Drawing
    factors: tuple[float, ...]
    drawings: tuple[Drawing, ...]
    moves_mm: float
    factor: float
    told: str
    #: The model with the effect and the pose at which it is drawn.
    model: Any
    row: Measurements


def plausible(effect: Effect) -> Floats:
    """All parameters at their plausible size, signs alternating: what limbs have in common often does little."""
    sizes = np.array([p.size for p in effect.parameters])
    return np.asarray(sizes * np.where(np.arange(len(sizes)) % 2 == 0, 1.0, -1.0))


def exaggerated(
    effect: Effect, machine: Robot | Model, *, values: Floats | None = None, data: Measurements | None = None,
    at: float | None = None,
) -> Exaggerated:  # fmt: skip
    """The effect on a robot, or on a machine that a model describes, at the pose where it shows most: of ``data`` where
    this has what it needs, or of what the robot's kind has to simulate.

    ``values`` (p,) of its parameters are by default plausible ones; ``at`` is the moment or period that is searched for
    besides them. Raises :class:`~sherkit.errors.SherkitError` where it can be drawn at no pose.
    """
    plain: ModelWithEffects = model_of(machine)
    draw = draw_of(plain)
    values = plausible(effect) if values is None else np.asarray(values, dtype=float)
    rows, measured = _rows(effect, plain, data)
    if at is None and effect.search == "time_s":
        at = 0.0 if rows.time_s is None else float(np.median(rows.time_s))
    first = plain.known_effects.get(effect.goes_with, effect)
    if at is None and first.is_periodic and plain.setting_of(first) is None:
        at = _PERIOD.get((first.search or "").removeprefix("period_"), 1.0)
    model = plain if effect.name in {e.name for e in plain.effects} else plain.with_effect(effect, at=at)
    place = model.owns(effect)

    def drawn(these: Measurements, factor: float) -> Drawing:
        full = np.zeros(len(model.parameters))
        full[place] = factor * values
        return draw(model, these, full, None)

    row, moves_mm, frames, begin = growing(drawn, rows)
    if len(frames) == 1:
        raise SherkitError(f"{effect.name} of this size leaves no machine to be drawn")
    (_, nominal), *grown = frames
    factors, drawings = zip(*grown, strict=True)
    where = f"at {row.counted} {row.line[0]} of the run" if measured else "at the pose where it shows most"
    told = f"This is the machine {where}{_moment(effect, row, measured)}."
    return Exaggerated(effect, values, nominal, factors, drawings, moves_mm, begin, told, model, row)


def growing(
    drawn: Callable[[Measurements, float], Drawing], rows: Measurements
) -> tuple[Measurements, float, list[tuple[float, Drawing]], float]:
    """A machine at the one of the rows where what it is ``drawn`` with shows most: that row; how far what is read moves
    there, mm; the machine without it and with more and more of it, as long as it is one; and the
    factor at which that is easily seen."""
    plain = drawn(rows, 0.0)
    moved = np.linalg.norm(drawn(rows, 1.0).shown_mm - plain.shown_mm, axis=1)
    best = int(np.argmax(np.nan_to_num(moved)))
    row = rows.select(np.array([best]))
    frames = [(0.0, drawn(row, 0.0))]
    points = frames[0][1].points_mm[0]
    # one that nobody knows how it is joined is as large as what it reaches
    size = float(np.linalg.norm(np.ptp(points, axis=0)) or np.linalg.norm(np.ptp(plain.target_mm, axis=0))) or 1.0
    begin, last = 0.0, 0.0
    for factor in FACTORS:
        try:
            one = drawn(row, factor)
        except SherkitError:
            break
        away = float(np.linalg.norm(one.points_mm[0] - points, axis=1).max())
        # what comes nearer again has turned once round
        if not np.isfinite(away) or (len(frames) > 1 and not last <= away <= _MOST * size):
            break
        frames.append((factor, one))
        if last < _SEEN * size:
            begin = factor
        last = away
    return row, float(moved[best]), frames, begin


def _moment(effect: Effect, row: Measurements, measured: bool) -> str:
    """What of a row, besides the joints, an effect depends on."""
    said = []
    if "time_s" in effect.needs and effect.search != "time_s":
        said.append(f"{float(row.time_s[0]) / 60:.3g} min into the run" if measured else "an hour into the run")  # type: ignore[index]
    if effect.search == "time_s":
        said.append("after it happened")
    if TEMPERATURE in effect.needs:
        said.append(f"at {row.covariates[TEMPERATURE][0]:.3g} °C")
    for name in row.layout.loads:
        if name in effect.needs:
            said.append(f"under {row.covariates[name][0]:.3g} {unit_in(name)}")
    return f", {', '.join(said)}" if said else ""


def _rows(effect: Effect, model: ModelWithEffects, data: Measurements | None) -> tuple[Measurements, bool]:
    """Some rows at which the effect acts, and whether they were measured."""
    if data is not None and not missing_columns(effect, data):
        whole = np.flatnonzero(~data.is_distance & ~data.outlier)
        if effect.search == "time_s" and data.time_s is not None:
            whole = whole[data.time_s[whole] >= np.median(data.time_s)]
        if len(whole):
            return data.select(spread_over(whole, _POSES)), True
    if model.robot is None:
        raise SherkitError("no run says where this machine has been")
    kind = kind_of(model.robot)
    joints = joints_over(model.robot, kind)
    layout, n = kind.layout, len(joints)
    units = [unit_in(name) for name in layout.joints]
    extra: dict[str, Any] = {TIME: np.full(n, _HOUR_S), TEMPERATURE: np.full(n, _WARM_C)}
    extra |= {name: np.ones(n) for name in (*layout.directions, *layout.loads)}
    extra |= {name: np.full(n, _SPEED.get(u, 1.0)) for name, u in zip(layout.velocities, units, strict=False)}
    return Measurements.planned(joints, layout, "drawing", **extra), False


def joints_over(robot: Any, kind: Kind) -> Floats:
    """Joint readings (n, k) over the workspace: those of a simulated run, or anywhere between the limits of a machine
    that has no simulation; the middle of the workspace where the robot comes nowhere else."""
    if kind.virtual is not None and kind.areas:
        try:
            poses = spread_over(next(iter(kind.areas.values()))(robot), _POSES)
            still = kind.virtual.simulated(robot, 0, 0.0, dict.fromkeys(kind.virtual.OPTIONS, 0.0))
            return still.measure(poses, repeats=1, order="shuffled", seed=0).joints
        except SherkitError:
            pass
    elif (box := getattr(robot, "box", None)) is not None:
        low, high = np.asarray(box).T
        return np.asarray(np.random.default_rng(0).uniform(low, high, (_POSES, len(low))))
    return np.asarray(robot.inverse(robot.middle))[None]


# -- As a scene -------------------------------------------------------------------------------------------------------


def scene_of(shown: Exaggerated) -> Scene:
    """The scene: pale as the drawing has it, in colour with the effect."""
    frames = [(0.0, shown.plain), *zip(shown.factors, shown.drawings, strict=True)]
    label = f"The machine with {shown.effect.name} exaggerated, behind it the machine as drawn"
    return Scene(label, frames, shown.factor)


def scene_of_robot(robot: Robot) -> Scene:
    """The machine as drawn, amid the poses that it reaches. Raises :class:`~sherkit.errors.SherkitError` where it
    reaches none."""
    kind, model = kind_of(robot), model_of(robot)
    rows = Measurements.planned(joints_over(robot, kind), kind.layout, "drawing")
    values = np.zeros(len(model.parameters))
    targets = kind.drawing(model, rows, values, None).target_mm
    middle = int(np.argmin(np.linalg.norm(targets - targets.mean(axis=0), axis=1)))
    drawn = kind.drawing(model, rows.select(np.array([middle])), values, None)
    return Scene(f"{kind.title[:1].upper()}{kind.title[1:]}, as drawn", [(0.0, drawn)])


# -- The card ---------------------------------------------------------------------------------------------------------

_STYLE = """<style>
.effect-card { display: grid; grid-template-columns: minmax(0, 11fr) minmax(0, 10fr); gap: 6px 26px;
  font: 16px/1.42 sans-serif; border: 1px solid #9aa; border-radius: 5px; padding: 10px 16px 12px; margin: 0.8em 0;
  break-inside: avoid; color: inherit; max-width: 1040px; box-sizing: border-box }
.effect-card h3 { grid-column: 1 / -1; margin: 0; font-size: 19px }
.effect-card h3 small { font-weight: normal; opacity: 0.75; font-size: 15px; margin-left: 0.6em }
.effect-card h4 { margin: 0.55em 0 0; font-size: 15px } .effect-card h4:first-child { margin-top: 0 }
.effect-card p { margin: 0.1em 0 } .effect-card .note { opacity: 0.75; font-size: 14px }
.effect-card table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 15px;
  display: block; overflow-x: auto; max-width: 100% }
.effect-card td, .effect-card th { text-align: right; padding: 0 0 0 9px; border: 0; white-space: nowrap }
.effect-card td:first-child, .effect-card th:first-child { text-align: left; padding-left: 0 }
.effect-card svg { max-width: 100%; height: auto }
@media (max-width: 640px) { .effect-card { grid-template-columns: minmax(0, 1fr) } }
</style>"""
#: What moves less than this does not move.
_ROUNDING_MM = 1e-9
#: So many parameters are listed; what limbs have in common stands in words above them.
_MOST_LISTED = 9
#: Width of a small map, px.
_PATTERN_PX = 220


def effect_card(
    effect: Effect, machine: Robot | Model | None = None, *, fit: Fit | None = None, found: Diagnosis | None = None,
    atlas: Atlas | None = None,
) -> str:  # fmt: skip
    """The card as HTML.

    ``machine`` is drawn, a robot or what a model describes, that of the fit unless it is given; nothing where none is
    known. ``fit`` says its values where the effect is in its model, and on which poses it is drawn; ``found`` what it
    would bring and what it ties with; ``atlas`` its pattern.
    """
    if machine is None and fit is not None:
        machine = fit.model.robot or getattr(fit.model, "plain", None)
    left = [drawing_of(effect, machine, fit)]
    right = [
        what_it_is(effect, fit),
        _brings(effect, found),
        its_numbers(effect, fit),
        indistinguishable(effect, found),
    ]
    tile = None if atlas is None else next((t for t in atlas.tiles if t.title == effect.name), None)
    if atlas is not None and tile is not None:
        left.append(_pattern(atlas, tile))
    acts = {"joints": "acts at the joints", "structure": "acts in the structure", "body": "moves the measured point",
            "sensor": "acts in the instrument"}.get(effect.link, f"acts at the link {effect.link}")  # fmt: skip
    return (
        f'<section class="effect-card" aria-label="{escape(effect.name)}">{_STYLE}'
        f"<h3>{escape(effect.name)}<small>{escape(acts)}</small></h3>"
        f"<div>{''.join(left)}</div><div>{''.join(right)}</div></section>"
    )


def card_page(title: str, cards: Sequence[str]) -> str:
    """Cards as a page of their own, which opens without a network."""
    nonce = fresh_nonce()
    heading = f"<h1>{escape(title)}</h1>" if title else ""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy(nonce)}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>:root {{ color-scheme: light dark }} "
        "body { font: 17px/1.5 sans-serif; max-width: 1060px; margin: 1.5em auto; padding: 0 1em }</style></head>"
        f'<body>{heading}{"".join(cards)}<script nonce="{nonce}">{script()}</script></body></html>\n'
    )


def _fitted(effect: Effect, fit: Fit | None) -> tuple[Floats, Floats] | None:
    """Values and deviations of its parameters, where it is in the model that was fitted."""
    if fit is None or effect.name not in {e.name for e in fit.model.effects}:
        return None
    place = fit.model.owns(effect)
    return np.asarray(fit.values[place]), np.asarray(fit.std[place])


def what_it_is(effect: Effect, fit: Fit | None) -> str:
    """What it is, how it shows and what to do about it, as HTML."""
    one = _known(effect, fit)
    told = (
        ("What it is", effect.physics), ("How it shows", effect.residuals),
        ("How to fix it", effect.remedy if one is None else one.remedy),
    )  # fmt: skip
    return "".join(f"<h4>{title}</h4><p>{escape(text)}</p>" for title, text in told if text)


def _known(effect: Effect, fit: Fit | None) -> SimplestForm | None:
    return None if fit is None or _fitted(effect, fit) is None else known(fit).get(effect.name)


def drawing_of(effect: Effect, machine: Robot | Model | None, fit: Fit | None) -> str:
    """The machine with and without the effect, of which a slider says how far it is exaggerated, as HTML."""
    if machine is None:
        return ""
    values = _fitted(effect, fit)
    own = None if values is None else values[0]
    try:
        setting = None if values is None or fit is None else fit.model.setting_of(effect)
        shown = exaggerated(effect, machine, values=own, data=None if fit is None else fit.data, at=setting)
    except SherkitError as error:
        return f'<p class="note">It cannot be drawn here: {escape(str(error))}</p>'
    if not shown.moves_mm > _ROUNDING_MM:
        return '<p class="note">It moves nothing that a drawing of this machine shows.</p>'
    return scene_of(shown).html() + f'<p class="note">{escape(_read(shown, fitted=own is not None))}</p>'


def _read(shown: Exaggerated, *, fitted: bool) -> str:
    """How to read the drawing, in two sentences."""
    size = "As it was fitted" if fitted else "At a plausible size"
    last = f" Beyond × {shown.factors[-1]:g} nothing could be told any more." if shown.factors[-1] < 100 else ""
    return (
        "Grey: as drawn. In colour: with the effect, so much larger that it can be seen (slider). Blue dot: where "
        f"the measured point is; orange ring: where a reading shows it. {size} it moves what is read by "
        f"{number(1e3 * shown.moves_mm)} µm here. "
        f"{shown.told}{last}"
    )


def _brings(effect: Effect, found: Diagnosis | None) -> str:
    said = ""
    if found is None:
        return said
    if effect.name in found.effects:
        k = next((k for k, s in enumerate(found.steps) if s.effect == effect.name), None)
        if k:
            before, after = found.steps[k - 1].error.rms, found.steps[k].error.rms
            said = f"Without it {number(before)} {found.unit}, with it {number(after)} {found.unit}"
    elif (one := next((c for c in found.candidates if c.effect == effect.name), None)) is not None:
        said = (
            f"Added alone it would leave {number(one.held_out_rms)} of {number(found.steps[0].error.rms)} {found.unit}"
        )
        said += "" if one.plausible else ", at a size that is not plausible"
    return f"<h4>What it brings</h4><p>{escape(said)}, on poses held out.</p>" if said else ""


def its_numbers(effect: Effect, fit: Fit | None, found: Diagnosis | None = None) -> str:
    """What is known in words; values beside plausible sizes, the latter alone where there are none, as HTML. Values are
    those of the fit that has it in its model, else those with which ``found`` tried it."""
    if not effect.parameters:
        return ""
    last = None if found is None else found.fit
    values = _fitted(effect, fit) or _fitted(effect, last) or _tried(effect, found)
    one = _known(effect, fit)
    head = "<tr><th></th>" + ("<th>fitted</th>" if values else "") + "<th>plausible size</th></tr>"
    rows = []
    for k, p in enumerate(effect.parameters[:_MOST_LISTED]):
        cell = "" if values is None else f"<td>{_with_std(values[0][k], values[1][k], p.unit)}</td>"
        rows.append(f"<tr><td>{escape(p.name)}</td>{cell}<td>± {_with_std(p.size, None, p.unit)}</td></tr>")
    more = len(effect.parameters) - len(rows)
    rest = f'<p class="note">and {more} more</p>' if more > 0 else ""
    form = f"<p>{escape(one.short)}</p>" if one is not None and one.short else ""
    return f"<h4>Its numbers</h4>{form}<table>{head}{''.join(rows)}</table>{rest}"


def _tried(effect: Effect, found: Diagnosis | None) -> tuple[Floats, Floats] | None:
    """Values and deviations of its parameters, as a diagnosis tried it."""
    named = () if found is None else found.candidates
    rows = next((c.parameters for c in named if c.effect == effect.name), ())
    if len(rows) != len(effect.parameters):
        return None
    return np.array([row["value"] for row in rows]), np.array([row["std"] for row in rows])


def _with_std(value: float, std: float | None, unit: str) -> str:
    """A number as everywhere in a report: rounded to its deviation where it has one."""
    if std is None or not np.isfinite(std) or std <= 0:
        return escape(sized(value, unit))
    said = stated(value, std, unit)
    return escape(said if said.startswith("-") else f"+{said}")


def indistinguishable(effect: Effect, found: Diagnosis | None) -> str:
    """What the poses of a diagnosis cannot tell it from, as HTML."""
    if found is None:
        return ""
    others = sorted({name for tie in found.indistinguishable if effect.name in tie for name in tie} - {effect.name})
    hidden = found.confounded_with.get(effect.name, ())
    told = [f"These poses cannot tell it from {listed(others)}."] if others else []
    told += [f"On these poses it is confounded with {listed(hidden)}."] if hidden else []
    return f"<h4>What it ties with</h4><p>{escape(' '.join(told))}</p>" if told else ""


def _pattern(atlas: Atlas, tile: Tile) -> str:
    """Its map on the measured poses, small."""
    place = {atlas.across: atlas.x} | ({atlas.up: atlas.y} if atlas.up else {})
    measured, own = (Residuals.at(place, one.error, atlas.names, atlas.unit) for one in (atlas.tiles[0], tile))
    maps = still(Change(measured, own, "measured", tile.title), width_px=_PATTERN_PX)
    at = f" at {atlas.plane}" if atlas.plane else ""
    told = f"At its best it explains {100 * tile.share:.0f} % of the squared error{at}."
    return f'<h4>Its pattern on these poses</h4>{maps}<p class="note">{escape(told)}</p>'
