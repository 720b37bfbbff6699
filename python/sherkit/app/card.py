"""An effect's card: the machine with it, what it is, how it shows, what to do about it, and its values beside plausible
ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from ..diagnosis import Diagnosis
from ..figures import in_people_units, with_error
from ..fit.identify import Fit
from ..model.effect import Effect
from ..names import listed
from ..report.card import drawing_of


def card(effect: Effect, fit: Fit | None, found: Diagnosis | None, *, opened: bool = False) -> str:
    """The card as HTML, folded unless ``opened``; every text from files is escaped.

    The machine is drawn where the card stands open, and with what is in the model: the others would cost the page a
    tenth of a second at every click. What was typed is not asked while the page waits.
    """
    told = (("", effect.physics), ("How it shows. ", effect.residuals), ("In the workshop. ", effect.workshop))
    parts = [f"<p><b>{head}</b>{escape(said)}</p>" for head, said in told if said]
    parts += [_values(effect, rows) for rows in [_of(effect, fit, found)] if rows]
    if found is not None:
        for others in _tied(effect, found):
            parts.append(f"<p>These poses cannot tell it from {escape(listed(others))}.</p>")
        hidden = found.hides_in.get(effect.name)
        parts += [f"<p>On these poses it hides almost entirely in {escape(listed(hidden))}.</p>"] if hidden else []
    if not parts:
        return ""
    if fit is not None and effect.function is None and (opened or effect.name in {e.name for e in fit.model.effects}):
        parts.insert(0, drawing_of(effect, fit.model, fit))
    return f"<details{' open' if opened else ''}><summary>what it is</summary>{''.join(parts)}</details>"


def _of(effect: Effect, fit: Fit | None, found: Diagnosis | None) -> Sequence[Mapping[str, Any]]:
    """Its values: of the model where it is there, else as the diagnosis would fit it."""
    if fit is not None and any(p.name.startswith(f"{effect.name}.") for p in fit.parameters):
        triples = zip(fit.parameters, fit.values.tolist(), fit.std.tolist(), strict=True)
        return [
            {"name": p.name.partition(".")[2], "value": v, "std": s, "unit": p.unit}
            for p, v, s in triples
            if p.name.startswith(f"{effect.name}.")
        ]
    named = () if found is None else found.candidates
    return next((c.parameters for c in named if c.effect == effect.name), ())


def _tied(effect: Effect, found: Diagnosis) -> list[list[str]]:
    return [[name for name in tie if name != effect.name] for tie in found.ties if effect.name in tie]


def _values(effect: Effect, rows: Sequence[Mapping[str, Any]]) -> str:
    plausible = {p.name: p.size for p in effect.parameters}
    lines = ""
    for one in rows:
        unit, factor = in_people_units(one["unit"])
        value, std = with_error(factor * one["value"], factor * one["std"])
        usual = f"{factor * plausible[one['name']]:.2g}" if one["name"] in plausible else ""
        lines += (
            f"<tr><td>{escape(one['name'])}</td><td>{value} ± {std}</td><td>{usual}</td><td>{escape(unit)}</td></tr>"
        )
    head = "<tr><th>value</th><th>fitted</th><th>plausible</th><th>unit</th></tr>"
    return f"<table>{head}{lines}</table>"
