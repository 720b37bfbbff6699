"""What hides: effects that the other parameters take up almost entirely on these poses."""

from __future__ import annotations

import numpy as np

from ..base import linalg
from ..base.types import Floats
from .linearised import orthonormal
from .stage import Stage

#: Part of its square that an effect hides, whatever its parameters are to each other, to be called hidden.
_HIDDEN_FROM = 0.97
#: Parameters that take up less than this part of what the first one does are not named, nor more than that many.
_NAMED_FROM, _MOST_NAMED = 0.3, 6


def confounded_with(stage: Stage) -> dict[str, tuple[str, ...]]:
    """Effects that hide, of those that were tried and of those in the model, and the parameters that take them up.

    What an effect leaves is judged by the combination of its parameters, in plausible sizes, of which most is to be
    seen: where even that is hidden, the effect is.
    """
    names = np.array([p.name for p in stage.run.fit.parameters])
    size = np.array([p.size for p in stage.run.fit.parameters])
    fitted, scan = stage.scan.triangle, stage.scan
    out = {}
    for candidate in stage.candidates:
        scale = 1.0 if candidate.columns.functions else np.array([p.size for p in candidate.effect.parameters])
        columns = scan.of(candidate.columns)
        whole, left = (gram * np.multiply.outer(scale, scale) for gram in (columns.whole, columns.gram))
        # of the basis only what lies in it counts
        inside = fitted @ scan.root @ (columns.by_model.T * scale)
        if hidden := _taken_up(whole, left, inside, fitted * size, names):
            out[candidate.name] = hidden
    for effect in stage.run.model.effects:
        own = np.zeros(len(names), dtype=bool)
        own[stage.run.owns(effect)] = True
        columns, others = fitted[:, own] * size[own], fitted[:, ~own]
        basis = orthonormal(others)
        within = basis.T @ columns
        whole = columns.T @ columns
        if hidden := _taken_up(whole, whole - within.T @ within, columns, others * size[~own], names[~own]):
            out[effect.name] = hidden
    return out


def _taken_up(whole: Floats, left: Floats, columns: Floats, fitted: Floats, names: Floats) -> tuple[str, ...]:
    """The parameters, most first, that take up nearly all of some columns; empty where more of them is to be seen.

    ``whole`` (k, k) is the columns' Gram matrix and ``left`` that of what the parameters leave of them; ``fitted`` (r,
    p) are the parameters' columns in plausible sizes and ``columns`` (r, k) at least what of them lies in these.
    """
    value, vector = linalg.eigh(whole)
    root = vector[:, value > 1e-12 * value[-1]] / np.sqrt(value[value > 1e-12 * value[-1]])
    if not root.shape[1] or linalg.eigvalsh(root.T @ left @ root)[-1] > 1.0 - _HIDDEN_FROM:
        return ()
    x = np.linalg.norm(linalg.lstsq(fitted, columns, rcond=1e-9)[0], axis=1)
    top = np.argsort(-x)[:_MOST_NAMED]
    return tuple(str(names[k]) for k in top if x[k] >= _NAMED_FROM * x[top[0]])
