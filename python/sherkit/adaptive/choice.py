"""Where to measure next: places that show most of what may be missing, or that tell its rivals apart.

Before an alarm every effect counts: the gain of ``log det(I + 4 S)`` of each (D_s-optimal design; Atkinson, Donev and
Tobias, *Optimum Experimental Designs, with SAS*, 2007), S what the model leaves of its columns. After it those that are
nearly as likely as the best: the squared distance of what two of them predict over the variance of both (T-optimal;
Atkinson and Fedorov, 1975). One place in five is anywhere, for what nobody thought of, and every other is the best of
some dozens at random: corners tell most by the drawing and least of what is not in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..base import linalg
from ..base.types import Floats
from ..errors import FitError
from ..evidence.blocks import Block
from ..evidence.design import showing
from ..evidence.family import Family
from .known import run_at
from .look import FAR, InterimAnalysis, Keys
from .region import PosesToDrive

#: Candidates for each batch, the share of places that are anywhere, and what a coefficient is expected to be, and may
#: be, squared.
_CANDIDATES, _ANYWHERE, _EXPECTED, _AT_MOST = 240, 0.2, 4.0, 36.0
#: At most so many rivals.
_MOST_RIVALS = 6
_RIDGE = 1e-9


def rivals(found: InterimAnalysis) -> list[Keys]:
    """What is nearly as likely as the best, the best first; the best shape is always among them."""
    shapes, lead = found.shapes, found.lead
    first = lead.keys if lead is not None else found.effects[0][0] if found.effects else None
    if first is None:
        return [keys for keys, _ in shapes[:1]]
    shape, value = found.shape_beside([first])
    best = max(found.value(first), value)
    mine = {name for name, _ in first}
    # the leader and something besides is no rival of it: what it leaves tells of that
    near = [keys for keys, likely in found.effects
            if keys != first and likely > best - FAR and not mine <= {name for name, _ in keys}]  # fmt: skip
    return [first, *near[: _MOST_RIVALS - 1], *([shape] if value > best - 2.0 * FAR else [])]


@dataclass(frozen=True, eq=False)
class _There:
    """Places as the model sees them a little later: ``own`` (n, m, p) by what it fits, and by what may be missing."""

    found: InterimAnalysis
    places: PosesToDrive
    family: Family
    own: Floats

    @classmethod
    def of(cls, found: InterimAnalysis, after_s: float, rng: np.random.Generator, *, shapes: bool) -> _There:
        """Some places anywhere that what was fitted can reach."""
        known, fit = found.known, found.fit
        places = known.region.anywhere(_CANDIDATES, rng)
        rows = known.later(found.data, places, after_s, rng)
        reached = np.isfinite(fit.model.predict(rows, fit.values)[:, known.axes]).all(axis=1)[-len(places) :]
        if not reached.all():
            places = places.pick(reached)
            if not len(places):
                raise FitError("the robot, as it was fitted, reaches nothing")
            rows = known.later(found.data, places, after_s, rng)
        run = run_at(replace(fit, data=rows), found.run.sigma)
        own = run.view.fitted(run.view.whole)[-len(places) :]
        return cls(found, places, Family(run, known.reference, shapes=shapes), own)

    def columns(self, blocks: Sequence[Block]) -> Floats:
        """Columns (n, m, p + k) of what the model fits and of these."""
        more = self.found.raw(*blocks, at=self.family)
        more = more.reshape(len(self.family.run), self.own.shape[1], more.shape[1])
        return np.concatenate([self.own, more[-len(self.own) :]], axis=2)


def choose(
    found: InterimAnalysis, count: int, alarmed: bool, rng: np.random.Generator, pace_s: float
) -> list[tuple[PosesToDrive, str]]:
    """So many places, shuffled, and why; ``pace_s`` is how much later each of them will be read."""
    against = rivals(found) if alarmed else []
    telling = alarmed and (len(against) > 1 or found.log_evidence < FAR)
    there = _There.of(found, pace_s * count, rng, shapes=telling)
    anywhere = int(rng.binomial(count, _ANYWHERE))
    if telling:
        picked = _telling(there, against, count - anywhere)
        reason = (
            "|".join(" & ".join(name for name, _ in keys) for keys in against[:2]) if len(against) > 1 else "confirm"
        )
    else:
        picked = _showing(there, count - anywhere, against)
        reason = "confirm" if alarmed else "all"
    out = [(there.places.pick([k]), reason) for k in picked]
    free = [k for k in range(len(there.places)) if k not in picked][:anywhere]
    out += [(there.places.pick([k]), "explore") for k in free]
    return [out[k] for k in rng.permutation(len(out))]


def _now(found: InterimAnalysis, blocks: Sequence[Block], most: float) -> tuple[Floats, Floats]:
    """Columns (N, p + k) of what the model fits and of these in the rows read, and what they tell where coefficients
    have the variance ``most``."""
    run = found.run
    own = run.flat(run.view.fitted(run.view.whole))
    more = found.raw(*blocks)
    columns = np.concatenate([own, more], axis=1)
    info = _information(columns, _RIDGE)
    k = own.shape[1]
    info[k:, k:] += np.eye(more.shape[1]) / most
    return columns, info


def _showing(there: _There, count: int, only: Sequence[Keys]) -> list[int]:
    """The places that show most of every effect, one after another."""
    found = there.found
    every = [block for keys in only for block in found.of(keys)] or list(found.by_effect.values())
    known = {block.name for block in there.family.blocks}
    parts = [(_now(found, [one], _EXPECTED)[1], there.columns([one])) for one in every if one.name in known]
    return showing(there.own, _now(found, (), _EXPECTED)[1], parts, count)


def _telling(there: _There, against: Sequence[Keys], count: int) -> list[int]:
    """The places at which what the rivals predict lies farthest apart."""
    sets: list[Keys] = list(against)
    if there.found.log_evidence < FAR or len(sets) < 2:
        sets.append(())
    return [int(k) for k in np.argsort(-_apart(there, sets))[:count]]


def _apart(there: _There, sets: Sequence[Keys]) -> Floats:
    """How far apart (n,) the predictions of these sets lie at each place, over their own errors."""
    residual, predicted, variances, noise = there.found.run.residual, [], [], np.inf
    for keys in sets:
        blocks = there.found.of(keys)
        (columns, info), at_place = _now(there.found, blocks, _AT_MOST), there.columns(blocks)
        inverse = linalg.inv(info)
        at = inverse @ (columns.T @ residual)
        left = float(np.square(residual - columns @ at).sum()) / max(len(residual) - columns.shape[1], 1)
        noise = min(noise, left)
        predicted.append(at_place @ at)
        variances.append(1.0 + np.einsum("nmp,pq,nmq->nm", at_place, inverse, at_place))
    gained = np.zeros(len(there.own))
    for i in range(len(sets)):
        for j in range(i):
            apart = np.square(predicted[i] - predicted[j]) / ((variances[i] + variances[j]) * max(noise, 1e-300))
            gained += np.log1p(apart.sum(axis=1))
    return gained


def are_beyond(found: InterimAnalysis, tied: Sequence[Keys], budget: int, late_s: float, margin: float) -> bool:
    """Whether the readings that are left, wherever and whenever they are taken, would tell none of those tied from the
    first of them, by a ``margin``."""
    if budget <= found.readings:
        return False
    rng = np.random.default_rng(found.readings)
    others = tied[1:_MOST_RIVALS]
    ahead = np.array([found.value(tied[0]) - found.value(other) for other in others])
    far = np.zeros(len(others))
    for after_s in (0.0, late_s):
        there = _There.of(found, after_s, rng, shapes=False)
        far = np.maximum(far, np.expm1([_apart(there, (tied[0], other)).max() for other in others]))
    # half of a squared distance is what a reading adds to the logarithm of their ratio
    return bool((ahead + 0.5 * far * (budget - found.readings) < margin * FAR).all())


def _information(columns: Floats, ridge: float) -> Floats:
    info = columns.T @ columns
    diagonal = np.diag(info)
    return np.asarray(info + np.diag(ridge * diagonal + 1e-300 + ridge * diagonal.max(initial=0.0) * 1e-6))
