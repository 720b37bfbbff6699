"""Every effect as an addition to a fit: what it would bring on rows held out, its parameters, how plausible it is."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..base import linalg
from ..base.types import Floats, Ints
from ..evidence.base import Base, chance_of, total
from ..evidence.blocks import Block
from ..evidence.fitted_run import FittedRun
from ..evidence.settings import columns_at
from ..evidence.thresholds import TOLD, is_plausible
from ..fit.error import ErrorSize, known_of
from ..fit.folds import Beside
from .result import CandidateReport

#: Part of the error held out by which an effect must lower it for a sentence of its own.
_LOWERS = 0.05
#: Part of a column's square below which what is left of it is rounding.
_ROUNDING = 1e-14


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
        lowers = one.held_out_rms < (1.0 - _LOWERS) * error.rms and one.p_value < level
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
    squares = np.maximum(np.diag(gram), np.maximum(_ROUNDING * np.square(flat).sum(axis=0), 1e-300))
    np.fill_diagonal(gram, squares)
    length = np.sqrt(squares)
    value, vector = linalg.eigh(gram / np.outer(length, length))
    keep = value > 1e-10
    inverse = (vector[:, keep] / value[keep]) @ vector[:, keep].T / np.outer(length, length)
    x = inverse @ (over.T @ base.residual)
    std = np.sqrt(np.maximum(np.diag(inverse), 0.0))
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

    known = known_of(run.of.fit)
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
