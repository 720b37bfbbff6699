"""The held-out error that people are shown, wherever they see it: every row predicted by a fit that did not see its
block, in several ways to cut the run into blocks; and what of the model, or beside it, is worth its place by that.

All is linear around the full fit, so that a fit without a block is a subtraction of Gram matrices.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Floats, Ints
from ..errors import SherkitError
from ..evidence.base import Base, chance_of, total
from ..evidence.blocks import Block
from ..evidence.fitted_run import FittedRun
from ..evidence.linearised import Linearised
from ..evidence.plausible import is_plausible
from ..evidence.run import in_time
from ..evidence.settings import columns_at
from ..evidence.thresholds import DIFFERENCES, LEVEL, TOLD
from ..fit.error import ErrorSize, held_out_error, known_deviations
from ..fit.folds import Beside, Folds, roots_of
from ..model.effect import Effect
from .result import CandidateReport

# -- The error held out ------------------------------------------------------------------------------------------------

#: Readings for each parameter from which on what noise does to the parameters is next to nothing in any block.
_ENOUGH = 200
#: Noises that are drawn to know what they leave on rows held out.
_DRAWS = 999


def error_held_out(run: FittedRun, sigma: Floats, repeated_folds: Sequence[Ints]) -> ErrorSize:
    """The error of a fit on rows held out. ``sigma`` (columns,) weighs the readings."""
    refit = run.fit.refitted if run.model.in_sockets(run.data) else None
    return held_out_error(run.fit, refit=refit, sigma=sigma, repeated_folds=repeated_folds, derivatives=run.derivatives)


def rms(squares: Floats, scale: Floats) -> float:
    """Of squared errors (…, m) over the noise ``scale`` (m,)."""
    return float(np.sqrt(np.mean(squares * scale**2)))


def folds_of(view: Linearised, fold: Ints, known: Floats | None = None) -> Folds:
    """What was fitted, by folds (repetitions, n)."""
    return Folds.of(view.fitted, view.residual, fold, known)


def squares_of(view: Linearised, fold: Ints, known: Floats | None = None) -> Floats:
    """Squared errors (repetitions, n, m) of rows that were held out in turn."""
    folds = folds_of(view, fold, known)
    parts = [folds.errors(view.fitted(rows), view.residual[rows], rows) for rows in view.blocks]
    return np.concatenate(parts, axis=1) ** 2


def noise_quantile(run: FittedRun, sigma: Floats, repeated_folds: Sequence[Ints], level: float, seed: int) -> float:
    """Root of the mean square, in noises, below which rows held out stay with a chance of 1 - ``level`` where the model
    lacks nothing.

    Few poses fix a model loosely, and a block that is held out lies beyond them: its error is noise and, of noise too,
    that of the parameters. ``sigma`` (columns,) is the noise; where repeats told it, it is itself uncertain. Of the
    noise all that counts are its products with the columns, normal with the Gram matrices as covariances: these are
    drawn.
    """
    rows = in_time(run, np.flatnonzero(run.whole))
    if len(rows) * len(run.axes) > _ENOUGH * run.fit.rank:
        return 1.0
    folds = folds_of(
        run.linearised(rows, (), sigma[list(run.axes)]),
        np.stack([fold[rows] for fold in repeated_folds]),
        known_deviations(run.fit),
    )
    rng = np.random.default_rng(seed)
    each = [_drawn(folds.repetition(k), rng) for k in range(len(repeated_folds))]
    told = run.data.repeatability if run.noise[1] == "repeats" else None
    if told is not None:
        free = max(sum(told.degrees_of_freedom.values()), 1)
        each = [one * free / rng.chisquare(free, size=_DRAWS) for one in each]
    return float(np.sqrt(np.mean(np.quantile(each, 1.0 - level, axis=1))))


def _drawn(folds: Folds, rng: np.random.Generator) -> Floats:
    """Mean squares (draws,) of unit noise on rows held out."""
    root = _square_root(folds.grams)
    z = rng.normal(size=(_DRAWS, *root.shape[:2]))
    right = np.einsum("fkl,dfl->dfk", root, z)
    outside = roots_of(folds.outside[0])
    x = np.einsum("fkl,fml,dfm->dfk", outside, outside, right.sum(axis=1, keepdims=True) - right, optimize=True)
    seen = (root != 0.0).any(axis=1)
    beside = np.maximum(folds.counts - seen.sum(axis=1), 0)
    squares = (z**2 * seen).sum(axis=2) + rng.chisquare(np.maximum(beside, 1), size=x.shape[:2]) * (beside > 0)
    squares += np.einsum("dfk,fkl,dfl->df", x, folds.grams, x, optimize=True) - 2.0 * (x * right).sum(axis=2)
    return np.asarray(squares.sum(axis=1) / folds.counts.sum())


def _square_root(grams: Floats) -> Floats:
    """Matrices (f, k, k) whose products with their transposes are these."""
    value, vector = linalg.eigh(grams)
    return vector * np.sqrt(np.where(value > 1e-12 * value[:, -1:], value, 0.0))[:, None, :]


# -- Whether an effect of a model earns its place -------------------------------------------------------------------


@dataclass(frozen=True)
class HeldOutGain:
    """What an effect brings on rows held out: RMS ``without`` it and ``with_it`` in the unit of the run, and the
    one-sided ``p`` of that."""

    effect: str
    without: float
    with_it: float
    p: float

    @property
    def holds(self) -> bool:
        """Whether the effect lowers the error on rows held out, and not by chance."""
        return self.with_it < self.without and self.p <= LEVEL


def held_out_gain(
    run: FittedRun,
    effect: Effect,
    *,
    sigma: Floats,
    repeated_folds: Sequence[Ints],
    also: Collection[str] = (),
) -> HeldOutGain:
    """What ``effect``, which is in the model of ``run``, brings given all others of the model but those of ``also``.

    ``repeated_folds`` are folds (n,) of all rows of the data. An effect without which the rows cannot be fitted earns
    its place.
    """
    axes = list(run.axes)
    rows = in_time(run, np.flatnonzero(run.whole))
    scale = sigma[axes]
    fold = np.stack([fold[rows] for fold in repeated_folds])
    try:
        full = run.without_effects(also) if also else run
        less = full.without_effects((effect.name,))
        views = tuple(one.linearised(rows, (), scale) for one in (full, less))
    except SherkitError:
        return HeldOutGain(effect.name, np.inf, 0.0, 0.0)
    with_it, without = (
        squares_of(v, fold, known_deviations(one.fit)) for v, one in zip(views, (full, less), strict=True)
    )
    gain = without.sum(axis=2) - with_it.sum(axis=2)
    return HeldOutGain(
        effect.name,
        without=rms(without, scale) * run.per_row,
        with_it=rms(with_it, scale) * run.per_row,
        p=_by_chance(gain.mean(axis=0), views[0].group),
    )


def _by_chance(gain: Floats, pose: Ints) -> float:
    """One-sided p of a positive sum of paired gains (n,), of which those of one pose are one witness: normal, with the
    variance that signs at random of whole poses would have."""
    sums = np.bincount(np.unique(pose, return_inverse=True)[1].ravel(), gain)
    spread = float(np.sqrt(np.square(sums).sum()))
    return float(scipy.special.ndtr(-sums.sum() / spread)) if spread > 0 else 1.0


# -- Which parameters are enough: on few poses most may bring next to nothing on rows held out ---------------------

#: Part of the parameters above which that is not worth a word.
_WORTH = 0.7


@dataclass(frozen=True)
class Elimination:
    """``names`` of the parameters that are enough, of ``every`` many; what they leave on rows held out, ``error``, and
    what all of them leave, ``of_all``, in ``unit``."""

    names: tuple[str, ...]
    every: int
    error: float
    of_all: float
    unit: str

    def __str__(self) -> str:
        few = len(self.names)
        return (
            f"{few} of the {self.every} parameters are enough for these poses: with {', '.join(self.names)} alone "
            f"rows held out are off by {self.error:.3g} {self.unit}, with all of them by {self.of_all:.3g}"
        )


def backward_elimination(run: FittedRun, sigma: Floats, repeated_folds: Sequence[Ints]) -> Elimination | None:
    """The fewest parameters that predict rows held out as well as any set, to first order; None where nearly all are
    needed. ``sigma`` (columns,) weighs the readings.

    Of all that are free the one that is told least beside its deviation is held at its drawing, again and again
    (backward elimination: Miller, *Subset Selection in Regression*, 2002, 3.3); rows held out say where that ends.
    """
    if run.is_exact:
        return None
    rows = in_time(run, np.flatnonzero(run.whole))
    scale = sigma[list(run.axes)]
    view = run.linearised(rows, (), scale)
    off = run.fit.values - run.model.start(run.data)
    drawn = np.concatenate([view.residual[part] + view.fitted(part) @ off for part in view.blocks])
    folds = Folds.of(view.fitted, drawn, np.stack([fold[rows] for fold in repeated_folds]))
    one = len(folds) // len(repeated_folds)
    gram, right = folds.grams[:one].sum(axis=0), folds.right[:one].sum(axis=0)
    free = list(range(len(off)))
    steps: list[tuple[float, list[int]]] = []
    while free:
        steps.append((_rms(folds.some(free), scale, run), list(free)))
        root = roots_of(gram[np.ix_(free, free)])
        inverse = root @ root.T
        told = (inverse @ right[free]) ** 2 / np.maximum(np.diag(inverse), 1e-300)
        # what the rows do not tell at all goes first
        free.pop(int(np.argmin(np.where(np.diag(inverse) > 0, told, -1.0))))
    if not steps:
        return None
    least = min(error for error, _ in steps)
    error, few = next(step for step in reversed(steps) if step[0] <= (1.0 + LOWERS) * least)
    if len(few) > _WORTH * len(off):
        return None
    names = tuple(run.fit.parameters[k].name for k in few)
    return Elimination(names, len(off), error, steps[0][0], run.unit)


def _rms(folds: Folds, scale: Floats, run: FittedRun) -> float:
    squares = float(folds.held_out.sum() / folds.counts.sum())
    return float(np.sqrt(max(squares, 0.0) * np.mean(scale**2))) * run.per_row


# -- Every effect as an addition ---------------------------------------------------------------------------------------
# Every effect as an addition to a fit: what it would bring on rows held out, its parameters, how plausible it is.

#: Part of the error held out by which an effect must lower it for a sentence of its own.
LOWERS = 0.05


def strongest(base: Base, given: Sequence[Block] = ()) -> dict[str, Block]:
    """One block for each effect by its name: the one that is given, else that of the setting at which it takes most."""
    best: dict[str, tuple[float, Block]] = {}
    for gain, block in zip(base.gains[0].tolist(), base.family.blocks, strict=True):
        if block.effect is not None and (block.name not in best or gain > best[block.name][0]):
            best[block.name] = gain, block
    return {name: block for name, (_, block) in best.items()} | {block.name: block for block in given}


def candidates_of(
    base: Base,
    repeated_folds: Sequence[Ints],
    named: Sequence[Block],
    fits: Mapping[str, FittedRun],
    alone: Mapping[str | None, float],
) -> tuple[CandidateReport, ...]:
    """A report for each effect that could be tried, the ``named`` ones first, then by held-out error: in linear
    approximation, but for those that have full ``fits``, by name.

    ``repeated_folds`` are folds (n,) of all rows of the run; ``alone`` are errors held out of full fits, by name.
    """
    run = base.family.run
    blocks = list(strongest(base, named).values())
    columns = [columns_at(run, block.effect, block.setting) for block in blocks if block.effect is not None]
    errors = _held_out(base, columns, np.stack([fold[run.rows] for fold in repeated_folds]))
    names = [block.name for block in named]
    out = []
    for block, its, error in zip(blocks, columns, errors, strict=True):
        effect = block.effect
        assert effect is not None, "shapes are no candidates"
        same = [i for i, one in enumerate(base.family.blocks) if one.name == block.name]
        ways = np.array([base.family.blocks[i].ways for i in same])
        p = chance_of(total(base.log_bf[same] - ways) - float(np.log(len(same))))
        values, std, plausible = _parameters(base, block, its, fits.get(block.name))
        parameters = tuple(
            {"name": q.name, "value": v, "std": s, "size": q.size, "unit": q.unit}
            for q, v, s in zip(effect.parameters, values.tolist(), std.tolist(), strict=True)
        )
        rms = alone.get(block.name, error.rms)
        out.append(CandidateReport(block.name, effect.link, rms, error.std, p, plausible, parameters))
    out.sort(key=lambda c: (names.index(c.effect) if c.effect in names else len(names), c.held_out_rms))
    return tuple(out)


def unnamed(
    reports: Sequence[CandidateReport], spoken_of: Collection[str], error: ErrorSize, level: float
) -> list[str]:
    """A sentence on each effect that by itself would lower the ``error`` held out of all that is named, and of which
    nothing is said yet, ``spoken_of`` aside."""
    out = []
    for one in reports:
        lowers = one.held_out_rms < (1.0 - LOWERS) * error.rms and one.p_value < level
        if one.effect in spoken_of or not lowers:
            continue
        why = (
            "these readings do not tell it from what else may be missing" if one.plausible
            else "it would be larger than such an error is in any robot"
        )  # fmt: skip
        out.append(
            f"{one.effect} would bring the error held out from {error.rms:.3g} to {one.held_out_rms:.3g} {error.unit} "
            f"and is not named: {why}"
        )
    return out


def _parameters(base: Base, block: Block, columns: Floats, fit: FittedRun | None) -> tuple[Floats, Floats, bool]:
    """Values, deviations and plausibility of an effect: from its full fit, else in linear approximation."""
    effect, run = block.effect, base.family.run
    assert effect is not None, "shapes have no parameters"
    if fit is not None:
        place = fit.owns(effect)
        return fit.fit.values[place], fit.fit.std[place], is_plausible(fit, effect, TOLD)
    flat = run.flat(columns)
    over = flat - base.basis @ (base.basis.T @ flat)
    gram = over.T @ over
    # of a column that the fit holds rounding is left: whatever that says of its size, the deviation is larger
    squares = np.maximum(np.diag(gram), np.maximum(DIFFERENCES**2 * np.square(flat).sum(axis=0), 1e-300))
    np.fill_diagonal(gram, squares)
    length = np.sqrt(squares)
    value, vector = linalg.eigh(gram / np.outer(length, length))
    keep = value > 1e-10
    inverse = (vector[:, keep] / value[keep]) @ vector[:, keep].T / np.outer(length, length)
    right = over.T @ base.residual
    x = inverse @ right
    # by what is left beside it, as a full fit counts them
    left = max(base.rss - float(right @ x), 0.0) / max(base.free - int(np.count_nonzero(keep)), 1)
    std = np.sqrt(np.maximum(np.diag(inverse), 0.0) * left)
    size = np.array([p.size for p in effect.parameters])
    return x, std, bool((np.abs(x) - 2 * std <= TOLD * size).all())


@dataclass(frozen=True)
class _HeldOutError:
    """Root mean square error of rows held out and its standard error, from how much the blocks differ."""

    rms: float
    std: float


def _held_out(base: Base, columns: Sequence[Floats], fold: Ints) -> list[_HeldOutError]:
    """Held-out error, in the unit of the run, axes together, with each set of columns (n, m, k) in the model.

    ``fold`` (repetitions, n) is the fold of each row in each repetition.
    """
    run, view = base.family.run, base.family.run.view
    sigma = run.sigma[list(run.of.axes)]
    every = np.concatenate([np.zeros((*view.residual.shape, 0)), *columns], axis=2)

    def of(rows: slice) -> Floats:
        # in the unit of the readings, so that axes count by their error
        return np.concatenate([view.fitted(rows), every[rows]], axis=2) * sigma[:, None]

    known = known_deviations(run.of.fit)
    known = None if known is None else known * np.square(sigma).mean()
    folds = Beside(of, [one.shape[2] for one in columns], view.residual * sigma, fold, known)
    return [_error(folds, squares, run.of.per_row) for squares in folds.held_out]


def _error(folds: Beside, squares: Floats, unit: float) -> _HeldOutError:
    """What blocks left out in turn show. Every repetition is of the same rows: it is known no better than from one."""
    repetitions, count = len(folds.place), int(folds.counts.sum())
    rms = float(np.sqrt(max(float(squares.sum()), 0.0) / count))
    apart = squares - rms**2 * folds.counts
    per_repetition = len(folds) / repetitions
    variance = float((apart**2).sum()) * per_repetition / max(per_repetition - 1, 1) * repetitions / count**2
    # the error of a mean square is twice the root's size
    return _HeldOutError(unit * rms, unit * np.sqrt(variance) / (2 * rms) if rms > 0 else 0.0)
