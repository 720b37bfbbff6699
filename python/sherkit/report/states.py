"""States of one run that a reader can switch between without a server: the calibrated geometry, with each single effect
added, and every step of the chosen path. Packed as numbers in text, for the offline report.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.names import state_with
from ..diagnosis import Diagnosis
from ..diagnosis.fitted_run import FittedRun
from ..diagnosis.named import at_its_setting
from ..errors import SherkitError
from ..fit.identify import Fit
from ..model.effect import Effect
from .picture import Picture, Table
from .residual_against import Windows, gained, means, points, shown
from .residual_map import Change
from .residuals import Residuals, residuals_of

#: Effects that a reader can see added alone: those that would bring most.
_MOST_SINGLE = 5


@dataclass(frozen=True, eq=False)
class State:
    """A fit to look at: its title and what it leaves."""

    title: str
    left: Residuals


def states_of(
    found: Diagnosis,
    known: Sequence[str],
    path: Mapping[tuple[str, ...], Any],
    effects: Sequence[Effect] = (),
    base: Fit | None = None,
) -> list[State]:
    """The model as diagnosed, each single addition that could be fitted, then the steps of ``path``: effects and fit.

    ``known`` are the effects that the diagnosed model had already.

    ``effects`` are the user's own. An effect that cannot be fitted alone is left out. ``base`` is the diagnosed fit on
    the rows to look at, where they are not all.
    """
    base = found.base if base is None else base
    run = FittedRun(base)
    out = [State(state_with(known), residuals_of(base))]
    named = {e.name: e for e in (*run.catalogue, *effects)}
    taken = {frozenset(added) for added in path}
    for candidate in found.candidates[:_MOST_SINGLE]:
        effect = named.get(candidate.effect)
        title = state_with([*known, candidate.effect])
        if effect is None or {*known, candidate.effect} in taken:
            continue
        setting = None
        try:
            if effect.search is not None:
                at = at_its_setting(run, effect)
                if at is None:
                    continue
                setting = at.setting
            out.append(State(title, residuals_of(run.refit([(effect, setting)]).fit)))
        except SherkitError:
            continue
    return out + [State(state_with(added), residuals_of(fit)) for added, fit in path.items()]


def packed(states: Sequence[State], maps: Picture[Change]) -> dict[str, Any]:
    """What a page needs to move both pictures to any of the states, and the lower one to any variable.

    Keys are names of sources; only columns that change are held. Numbers are base64 of little-endian float32.
    """
    base = states[0].left
    variables = list(base.variables)
    out: dict[str, Any] = {"titles": [s.title for s in states], "variables": variables, "states": []}
    windows = {name: Windows.of(base, name) for name in variables}
    out["values"] = {name: _numbers(_at(base, name)) for name in variables}
    for state in states:
        change = Change(base, state.left, states[0].title, state.title)
        tables = {name: _text(t) for name, t in maps.tables(change).items() if name.startswith("after")}
        rows = points(state.left)
        tables["points"] = {key: _numbers(rows[key]) for key in rows if key.startswith("r") and key != "row"}
        by_variable = {
            name: {
                "mean": _text(means(state.left, name, along)),
                "gained": _text(gained(base, state.left, name, along)),
            }
            for name, along in windows.items()
        }
        out["states"].append({"tables": tables, "against": by_variable})
    return out


def _at(left: Residuals, name: str) -> Any:
    return left.variables[name][shown(left)]


def _text(table: Table) -> dict[str, Any]:
    """A table as text: floats packed, words as they are; what only a server needs is left out."""
    out: dict[str, Any] = {}
    for key, column in table.items():
        if key in ("rows", "lines", "n"):
            continue
        out[key] = (
            list(column) if column is not None and len(column) and isinstance(column[0], str) else _numbers(column)
        )
    return out


def _numbers(values: Any) -> str:
    return base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode("ascii")
