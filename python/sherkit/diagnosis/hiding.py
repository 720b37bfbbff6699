"""What hides: effects that the other parameters take up almost entirely on these poses."""

from __future__ import annotations

import numpy as np
import scipy

from ..types import Floats
from .linearised import orthonormal
from .stage import Candidate, Stage

#: Part of its square that an effect hides, whatever its parameters are to each other, to be called hidden.
_HIDDEN_FROM = 0.97
#: Parameters that take up less than this part of what the first one does are not named, nor more than that many.
_NAMED_FROM, _MOST_NAMED = 0.3, 6


def hides_in(stage: Stage) -> dict[str, tuple[str, ...]]:
    """Effects that hide, of those that were tried and of those in the model, and the parameters that take them up.

    What an effect leaves is judged by the combination of its parameters, in plausible sizes, of which most is to be
    seen: where even that is hidden, the effect is.
    """
    names = np.array([p.name for p in stage.run.fit.parameters])
    size = np.array([p.size for p in stage.run.fit.parameters])
    fitted = stage.view.fitted.reshape(stage.scan.n * stage.scan.m, -1)
    out = {}
    for candidate in stage.candidates:
        if hidden := _taken_up(_columns(stage, candidate), fitted, names, size):
            out[candidate.name] = hidden
    for effect in stage.run.model.effects:
        own = np.zeros(len(names), dtype=bool)
        own[stage.run.owns(effect)] = True
        if hidden := _taken_up(fitted[:, own] * size[own], fitted[:, ~own], names[~own], size[~own]):
            out[effect.name] = hidden
    return out


def _columns(stage: Stage, candidate: Candidate) -> Floats:
    """Columns (n·m, k) of a candidate in the order of the rows, in plausible sizes where it has its own."""
    taken = stage.scan.take(candidate.columns)
    rows: Floats = stage.scan.in_time(taken.reshape(stage.scan.n, stage.scan.m, -1))
    scale = 1.0 if candidate.columns.functions else np.array([p.size for p in candidate.effect.parameters])
    return rows.reshape(taken.shape) * scale


def _taken_up(columns: Floats, fitted: Floats, names: Floats, size: Floats) -> tuple[str, ...]:
    """The parameters, most first, that take up nearly all of some columns; empty where more of them is to be seen."""
    basis = orthonormal(fitted)
    inside = basis.T @ columns
    whole, left = columns.T @ columns, columns.T @ columns - inside.T @ inside
    value, vector = np.linalg.eigh(whole)
    root = vector[:, value > 1e-12 * value[-1]] / np.sqrt(value[value > 1e-12 * value[-1]])
    if not root.shape[1] or np.linalg.eigvalsh(root.T @ left @ root)[-1] > 1.0 - _HIDDEN_FROM:
        return ()
    x = np.linalg.norm(scipy.linalg.lstsq(fitted * size, columns, cond=1e-9)[0], axis=1)
    top = np.argsort(-x)[:_MOST_NAMED]
    return tuple(str(names[k]) for k in top if x[k] >= _NAMED_FROM * x[top[0]])
