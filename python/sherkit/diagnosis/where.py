"""Where the model fails: error against everything, each with its own test; what parameters hide, what would have been
found, and whether what is left is steady.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Floats
from ..data.columns import bare
from ..evidence.base import Base, chance_of, gain_asked, total
from ..evidence.blocks import Block
from ..evidence.design import squares_of, times_found
from ..evidence.fitted_run import FittedRun
from ..evidence.linearised import Linearised
from ..evidence.run import Run
from ..evidence.settings import columns_at
from ..evidence.thresholds import A_FEW, HARDLY, POWER, ROUNDING, TWIN
from ..evidence.whitening import orthonormal

_BINS = 6


@dataclass(frozen=True)
class Dependence:
    """Error against one variable: bin edges, RMS per bin (in the unit of the diagnosis, axes together), and the p that
    it is all the same mean, of the mean Bayes factor of the shapes of this variable."""

    variable: str
    edges: tuple[float, ...]
    rms: tuple[float, ...]
    p_value: float


def where(base: Base) -> tuple[Dependence, ...]:
    """One line for each variable (joints, coordinates, time, directions, covariates), the clearest first."""
    out = []
    family, run, view = base.family, base.family.run, base.family.run.view
    error = view.residual * run.sigma[list(run.of.axes)] * run.of.per_row
    for name, values in view.variables.items():
        alone = [i for i, one in enumerate(family.blocks) if one.effect is None and one.depends_on == (name,)]
        edges = np.unique(np.quantile(values, np.linspace(0, 1, _BINS + 1)))
        if not alone or len(edges) < 2:
            continue
        p = chance_of(total(base.log_bf[alone]) - float(np.log(len(alone))))
        which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
        rms = [float(np.sqrt(np.mean(error[which == k] ** 2))) for k in range(len(edges) - 1) if (which == k).any()]
        out.append(Dependence(name, tuple(edges.tolist()), tuple(rms), p))
    return tuple(sorted(out, key=lambda d: d.p_value))


def neighbour_correlation(view: Linearised) -> float:
    """Correlation of what is left at a pose with what is left at its nearest neighbour in the workspace."""
    names = view.place
    if not names:
        return 0.0
    group = np.unique(view.group, return_inverse=True)[1]
    count = np.bincount(group)
    if len(count) < 10:
        return 0.0
    place = np.stack([np.bincount(group, view.variables[n]) / count for n in names], axis=1)
    mean = np.stack([np.bincount(group, e) / count for e in view.residual.T], axis=1)
    mean -= mean.mean(axis=0)
    near = scipy.spatial.cKDTree(place).query(place, 2)[1]
    # where several poses are at the same place one may be found before itself
    other = mean[np.where(near[:, 0] == np.arange(len(place)), near[:, 1], near[:, 0])]
    return float((mean * other).sum() / max(float(np.sqrt((mean**2).sum() * (other**2).sum())), 1e-300))


# -- What hides: effects that other parameters take up almost entirely on these poses ------------------------------

#: Parameters that take up less than this part of what the first one does are not named.
_NAMED_FROM = 0.3


def confounded_with(run: Run) -> dict[str, tuple[str, ...]]:
    """Effects that hide, of those that were tried and of those in the model, and the parameters that take them up.

    What an effect leaves is judged by the combination of its parameters, in plausible sizes, of which most is to be
    seen: where even that is hidden, the effect is.
    """
    names = np.array([p.name for p in run.of.fit.parameters])
    fitted = run.flat(run.view.fitted(run.view.whole)) * np.array([p.size for p in run.of.fit.parameters])
    # lengths and angles among columns are those in the basis
    fitted = run.basis.T @ fitted
    every = run.flat(run.view.effects_in(run.view.whole))
    out = {}
    for effect, at in run.view.effects:
        columns = every[:, at] * np.array([p.size for p in effect.parameters])
        inside = run.basis.T @ columns
        whole = columns.T @ columns
        if hidden := _taken_up(whole, whole - inside.T @ inside, inside, fitted, names):
            out[effect.name] = hidden
    for effect in run.of.model.effects:
        own = np.zeros(len(names), dtype=bool)
        own[run.of.owns(effect)] = True
        within = orthonormal(fitted[:, ~own]).T @ fitted[:, own]
        whole = fitted[:, own].T @ fitted[:, own]
        if hidden := _taken_up(whole, whole - within.T @ within, fitted[:, own], fitted[:, ~own], names[~own]):
            out[effect.name] = hidden
    return out


def _taken_up(whole: Floats, left: Floats, columns: Floats, fitted: Floats, names: Floats) -> tuple[str, ...]:
    """The parameters, most first, that take up nearly all of some columns; empty where more of them is to be seen.

    ``whole`` (k, k) is the columns' Gram matrix and ``left`` that of what the parameters leave of them; ``fitted`` (r,
    p) are the parameters' columns in plausible sizes and ``columns`` (r, k) at least what of them lies in these.
    """
    value, vector = linalg.eigh(whole)
    root = vector[:, value > 1e-12 * value[-1]] / np.sqrt(value[value > 1e-12 * value[-1]])
    if not root.shape[1] or linalg.eigvalsh(root.T @ left @ root)[-1] > 1.0 - TWIN:
        return ()
    x = np.linalg.norm(linalg.lstsq(fitted, columns, rcond=1e-9)[0], axis=1)
    top = np.argsort(-x)[:A_FEW]
    return tuple(str(names[k]) for k in top if x[k] >= _NAMED_FROM * x[top[0]])


# -- What would have been found: silence without power is no answer ------------------------------------------------


def smallest_found(base: Base, block: Block, level: float) -> tuple[float, float]:
    """The effect that would have been found with 80 % power, its parameters in any direction: in plausible sizes, and
    as the RMS of what it leaves."""
    assert block.effect is not None, "shapes have no plausible size"
    family, run = base.family, base.family.run
    columns = run.flat(columns_at(run, block.effect, block.setting))
    columns = columns * [p.size for p in block.effect.parameters]
    left = columns - base.basis @ (base.basis.T @ columns)
    squares = squares_of(left.T @ left)
    rank, free, count = float(columns.shape[1]), base.free, len(base.residual)
    asked = -float(np.log(level) + family.log_weight[family.where(block)])
    gain = gain_asked(rank, free, count, asked)
    if np.square(left).sum() <= ROUNDING * np.square(columns).sum() or np.isinf(gain):
        return float("inf"), float("inf")
    times = times_found(POWER, squares, rank, float(scipy.special.chdtrc(rank, gain)))
    sigma = run.sigma[list(run.of.axes)]
    rms = times * float(np.sqrt(squares.mean() / count) * np.sqrt(np.mean(sigma**2)))
    return times, rms * run.of.per_row


# -- Whether what is left is steady, or wanders slowly, as no noise of single readings does ------------------------

#: Slow is what takes more rows than this for one swing; of so many swings in the run at least, and at most.
_ROWS, _FEWEST, _MOST = 30, 3, 30
#: Rows below which slow and quick are not told apart.
_LEAST = 60
#: The most that an instrument's readings have in common from row to row; what has more wanders.
_COMMON = 0.7


@dataclass(frozen=True)
class SlowDrift:
    """The axis that wanders most of those of which it is no chance, or else most surely; by how much, RMS, and what is
    left from row to row besides, both in the unit of errors; ``p`` over all axes."""

    axis: str
    p: float
    size: float
    beside: float

    @property
    def counts(self) -> bool:
        """Whether it is no chance."""
        return self.p <= HARDLY


def slow_drift_of(run: FittedRun) -> SlowDrift | None:
    """What is left of a run by the time at which it was read; None where that is not known, or for too few rows.

    Of the periodogram of what an autoregression of first order leaves, of no more than a few rows' memory, the slowest
    lines hold a share that is a beta variable for steady noise (Percival and Walden, *Spectral Analysis for Physical
    Applications*, 1993, ch. 6).
    """
    data = run.data
    rows = np.flatnonzero(run.whole)
    if data.time_s is None or len(rows) < _LEAST:
        return None
    # several targets are read at one time
    moments, at = np.unique(data.time_s[rows], return_inverse=True)
    count = np.bincount(at)
    if len(moments) < _LEAST:
        return None
    axes = list(run.axes)
    left = np.column_stack([np.bincount(at, run.residuals[rows, a]) / count for a in axes])
    p, size, beside = _slow(left - left.mean(axis=0))
    p = np.minimum(1.0, len(axes) * p)
    worst = int(np.argmax(np.where(p <= HARDLY, size, 0.0)) if (p <= HARDLY).any() else np.argmin(p))
    names = [bare(name) for name in run.names]
    return SlowDrift(
        names[axes[worst]], float(p[worst]), run.per_unit * float(size[worst]),
        run.per_unit * float(beside[worst]),
    )  # fmt: skip


def _slow(left: Floats) -> tuple[Floats, Floats, Floats]:
    """For each column of (n, m) in the order of time: the chance of so much that is slow in steady noise, its size
    beyond what steady noise would have there, and that of the rest."""
    n = len(left)
    lines = int(np.clip(n // _ROWS, _FEWEST, _MOST))
    power = (left[:-1] ** 2).sum(axis=0)
    rho = np.clip((left[1:] * left[:-1]).sum(axis=0) / np.where(power > 0, power, 1.0), 0.0, _COMMON)
    white = left[1:] - rho * left[:-1]
    every = (n - 2) // 2
    of_white = _periodogram(white)[1 : every + 1]
    total = of_white.sum(axis=0)
    p = np.ones(left.shape[1])
    for count in {_FEWEST, lines}:
        share = of_white[:count].sum(axis=0) / np.where(total > 0, total, 1.0)
        # the upper tail of the beta distribution; scipy.stats would take longer to import than all of this to say
        once = scipy.special.betainc(every - count, count, 1.0 - share)
        p = np.minimum(p, np.where(total > 0, 2.0 * once, 1.0))
    slow, quick = np.split(2.0 * _periodogram(left)[1:] / n**2, [lines])
    # steady noise is as strong in the slow lines as in others
    noise = quick.mean(axis=0) * lines
    return p, np.sqrt(np.maximum(slow.sum(axis=0) - noise, 0.0)), np.sqrt(quick.sum(axis=0) + noise)


def _periodogram(columns: Floats) -> Floats:
    return np.asarray(np.abs(np.fft.rfft(columns, axis=0)) ** 2)
