"""How well a drawing holds, told by the readings: the part of the plausible sizes by which parameters are off it.

Sizes of a kind of robot are those of any shop's; one maker's arm may hold a tenth of them. Among parameters that the
readings tell, moves from the drawing show how large such moves are, and the others are held as closely: empirical Bayes
(Morris, "Parametric empirical Bayes inference", JASA 1983), by the evidence of one part for all parameters with where
the instrument stands projected out (restricted likelihood: Patterson and Thompson, Biometrika 1971), linear around a
fit. A part as plausible before any row is read as its own logarithm is near zero: where readings tell nothing, sizes
stay as they are.
"""

from __future__ import annotations

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Bools, Floats
from ..model.base import ModelWithEffects
from .error import FitLike
from .folds import blocks
from .regions import frame_of, some_of

#: Parts that are asked for: what is known better is measured, and says so in the robot's file; what is farther off is
#: another robot.
_LEAST, _MOST = 1e-2, 4.0
#: Part of a column's square that what projected it out must leave.
_LEFT = 1e-9


def scaled_sizes(model: ModelWithEffects, part: float) -> Floats:
    """Plausible sizes (p,), those of the drawing times a part."""
    size = np.array([p.size for p in model.parameters])
    return np.where(drawn_by(model), part * size, size) if part != 1.0 else size


def in_plausible_sizes(basis: Floats, model: ModelWithEffects, part: float) -> Floats:
    """Directions (m, p), orthonormal in sizes of which the drawing's are a part, in plausible sizes."""
    if not len(basis) or part in (0.0, 1.0):
        return basis
    turned, _ = linalg.qr((basis * scaled_sizes(model, part) / scaled_sizes(model, 1.0)).T)
    return np.asarray(turned.T)


def drawn_by(model: ModelWithEffects) -> Bools:
    """Which parameters (p,) a drawing states: none of an effect, of the instrument, or that somebody has measured."""
    drawn = np.array([not p.known for p in model.parameters], dtype=bool)
    drawn[len(model.bare) :] = False
    drawn[frame_of(model)] = False
    return drawn


def part_of(fit: FitLike) -> float:
    """The part of the plausible sizes that the readings of a fit find most likely."""
    own = drawn_by(fit.model)
    if not own.any():
        return 1.0
    gram, right, squares, free = _projected(fit, own)
    size = np.array([p.size for p in fit.model.parameters])[own]
    values, axes = linalg.eigh(gram * np.outer(size, size))
    seen = values > _LEFT * max(float(values[-1]), 1e-300)
    numbers, free = free, free - int(seen.sum())
    if free <= 0 or not seen.any():
        return 1.0
    told = values[seen]
    along = np.square(axes[:, seen].T @ (size * right)) / told
    rest = max(squares - float(along.sum()), 0.0)
    # readings scatter no less than they are known to
    least = 1.0 if fit.noise.origin != "unknown" else 1e-300

    def noise_at(ratio: float) -> float:
        """The likeliest variance of the readings where parts are ``ratio`` times their deviation."""
        return max((rest + float((along / (1.0 + told * ratio**2)).sum())) / numbers, least)

    def against(ratio: float) -> float:
        """Minus the logarithm of the evidence."""
        spread, noise = 1.0 + told * ratio**2, noise_at(ratio)
        of_noise = numbers * np.log(noise) + (rest + float((along / spread).sum())) / noise
        return 0.5 * float(of_noise + np.log(spread).sum() + np.log(ratio * np.sqrt(noise)) ** 2)

    deviation = np.sqrt(max(rest / free, least))
    bounds = (np.log(_LEAST / deviation), np.log(_MOST / deviation))
    found = scipy.optimize.minimize_scalar(lambda log: against(np.exp(log)), bounds=bounds, method="bounded")
    ratio = float(np.exp(found.x))
    return float(np.clip(ratio * np.sqrt(noise_at(ratio)), _LEAST, _MOST))


def _projected(fit: FitLike, own: Bools) -> tuple[Floats, Floats, float, int]:
    """Products of the columns of these parameters (k,) with each other (k, k) and with what was read beside the drawing
    (k,), its square, and how many numbers are left, over the noise; without what the other columns take."""
    model, data = fit.model, fit.data
    used = data.used & np.isfinite(fit.residuals)
    rows = some_of(data, np.flatnonzero(used.any(axis=1)))
    weight = np.where(used, 1.0 / fit.noise.sigma, 0.0)[rows]
    left = np.where(used, fit.residuals, 0.0)[rows]
    columns = model.linearised_by_blocks(data.select(rows), fit.values)
    total = np.zeros((len(own) + 1,) * 2)
    for some in blocks(len(rows)):
        by = columns(some).parameters
        beside = left[some] + by[:, :, own] @ fit.values[own]
        whole = np.concatenate([by, beside[:, :, None]], axis=2) * weight[some, :, None]
        whole = whole.reshape(-1, len(total))
        total += whole.T @ whole
    kept, other = np.append(np.flatnonzero(own), len(own)), np.flatnonzero(~own)
    length = np.sqrt(np.maximum(np.diag(total)[other], 1e-300))
    value, turn = linalg.eigh(total[np.ix_(other, other)] / np.outer(length, length))
    seen = value > _LEFT * max(float(value[-1]), 1e-300) if len(value) else np.zeros(0, dtype=bool)
    across = (turn[:, seen] / np.sqrt(value[seen])).T @ (total[np.ix_(other, kept)] / length[:, None])
    rest = total[np.ix_(kept, kept)] - across.T @ across
    return rest[:-1, :-1], rest[:-1, -1], float(rest[-1, -1]), int(used[rows].sum()) - int(seen.sum())
