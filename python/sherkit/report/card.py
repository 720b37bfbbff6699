"""The card of an effect: what it does to this machine as a drawing, what it is, how it shows, what to do in the
workshop, and what a fit and a diagnosis say of it.

:func:`effect_card` gives it as HTML that can stand in any page: in the report, in a cell, and in a page of widgets
(``Div(text=effect_card(...))``). The page needs :func:`~sherkit.report.scene.script` once, which brings the drawing to
life; :func:`~sherkit.report.policy.policy` says how it is let in. Every text is escaped, so that an effect of any name
can be shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from ..base.figures import sized, stated
from ..base.names import listed
from ..base.types import Floats
from ..diagnosis import Diagnosis
from ..errors import SherkitError
from ..fit.forms import Known, known
from ..fit.identify import Fit
from ..model.any import Model
from ..model.effect import Effect
from ..model.kinds import Robot
from .atlas import Atlas, Tile
from .exaggerated import Exaggerated, exaggerated
from .mechanism import scene_of
from .picture import Panel, residual_maps, round_bar
from .policy import fresh_nonce, policy
from .scene import script
from .style import number

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


def effect_card(
    effect: Effect, machine: Robot | Model | None, *, fit: Fit | None = None, found: Diagnosis | None = None,
    atlas: Atlas | None = None, without: float | None = None,
) -> str:  # fmt: skip
    """The card as HTML.

    ``machine`` is drawn, a robot or what a model describes, None where neither is known; ``fit`` says its values where
    the effect is in its model, and on which poses it is drawn; ``found`` what it would bring and what it ties with;
    ``atlas`` its pattern; ``without`` is the error on poses held out, in the unit of the diagnosis, that a model would
    leave without it.
    """
    left = [drawing_of(effect, machine, fit)]
    right = [
        what_it_is(effect, fit),
        _brings(effect, found, without),
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


def _known(effect: Effect, fit: Fit | None) -> Known | None:
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
    unit, factor = ("µm", 1e3) if shown.plain.unit == "mm" else (shown.plain.unit, 1.0)
    last = f" Beyond × {shown.factors[-1]:g} nothing could be told any more." if shown.factors[-1] < 100 else ""
    return (
        "Grey: as drawn. In colour: with the effect, so much larger that it can be seen (slider). Blue dot: where "
        f"the measured point is; orange ring: where a reading shows it. {size} it moves what is read by "
        f"{number(factor * shown.moves_mm)} {unit} here. "
        f"{shown.told}{last}"
    )


def _brings(effect: Effect, found: Diagnosis | None, without: float | None) -> str:
    said = ""
    if found is not None and effect.name in found.effects:
        k = next((k for k, s in enumerate(found.steps) if s.effect == effect.name), None)
        if k:
            before, after = found.steps[k - 1].error.rms, found.steps[k].error.rms
            said = f"Without it {number(before)} {found.unit}, with it {number(after)} {found.unit}"
    elif found is not None and without is not None:
        said = f"Without it {number(without)} {found.unit}"
    elif found is not None:
        one = next((c for c in found.candidates if c.effect == effect.name), None)
        if one is not None:
            said = (
                f"Added alone it would leave {number(one.held_out_rms)} of {number(found.steps[0].error.rms)} "
                f"{found.unit}"
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
    place = np.column_stack([atlas.x, atlas.y, np.zeros(len(atlas.x))])
    place[:, :2] -= 0.5 * (place[:, :2].min(axis=0) + place[:, :2].max(axis=0))
    panels = []
    for title, one in (("measured", atlas.tiles[0]), (f"{tile.title} at its best", tile)):
        shown = np.zeros((len(place), 3))
        shown[:, : min(3, one.error.shape[1])] = 1e-3 * one.error[:, :3]
        note = f"explains {100 * one.share:.0f} % of the squared error" if one is tile else atlas.plane
        panels.append(Panel(title, place, shown, round_bar(1e-3 * atlas.tiles[0].error), note))
    colour = f"; colour: {atlas.names[2]}" if len(atlas.names) > 2 else ""
    maps = residual_maps(panels, f"Arrows: {' and '.join(atlas.names[:2])}{colour}.")
    return f"<h4>Its pattern on these poses</h4>{maps}"
