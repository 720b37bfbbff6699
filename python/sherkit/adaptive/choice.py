"""Where to measure next: places that show most of what may be missing, or that tell its rivals apart.

Before an alarm every effect counts: the gain of ``log det(I + 4 S)`` of each (D_s-optimal design; Atkinson, Donev and
Tobias, *Optimum Experimental Designs, with SAS*, 2007), S what the model leaves of its columns. After it those that are
nearly as likely as the best: the squared distance of what two of them predict over the variance of both (T-optimal;
Atkinson and Fedorov, 1975). One place in five is anywhere, for what nobody thought of, and every other is the best of
some dozens at random: corners tell most by the drawing and least of what is not in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..base import linalg
from ..base.types import Bools, Floats
from ..data import Measurements
from ..data.columns import TIME
from .hypotheses import Key
from .look import FAR, Keys, Look
from .region import Places, planned

#: Candidates for each batch, the share of places that are anywhere, and what a coefficient is expected to be, squared.
_CANDIDATES, _ANYWHERE, _EXPECTED = 240, 0.2, 4.0
#: At most so many rivals.
_MOST_RIVALS = 6
#: Until the evidence is so much, nothing being missing is a rival too (a logarithm).
_CERTAIN = np.log(1e4)
_RIDGE = 1e-9


@dataclass(frozen=True, eq=False)
class Chosen:
    """A place and why it is driven to."""

    places: Places
    reason: str


def rivals(found: Look) -> list[Keys]:
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


def choose(found: Look, count: int, alarmed: bool, rng: np.random.Generator, pace_s: float) -> list[Chosen]:
    """So many places, shuffled; ``pace_s`` is how much later each of them will be read."""
    family = found.family
    candidates = family.region.anywhere(_CANDIDATES, rng)
    rows = later(found.data, candidates, pace_s * count, rng)
    columns = family.columns(rows, found.fit.values, found.fit.model, before=found.readings)
    anywhere = int(rng.binomial(count, _ANYWHERE))
    against = rivals(found) if alarmed else []
    if alarmed and (len(against) > 1 or found.log_evidence < _CERTAIN):
        picked = _telling(found, columns.own, columns.tried, against, count - anywhere)
        reason = (
            "|".join(" & ".join(name for name, _ in keys) for keys in against[:2]) if len(against) > 1 else "confirm"
        )
    else:
        picked = _showing(found, columns.own, columns.tried, count - anywhere, against)
        reason = "confirm" if alarmed else "all"
    out = [Chosen(candidates.pick([k]), reason) for k in picked]
    free = [k for k in range(len(candidates)) if k not in picked][:anywhere]
    out += [Chosen(candidates.pick([k]), "explore") for k in free]
    return [out[k] for k in rng.permutation(len(out))]


def later(data: Measurements, places: Places, after_s: float, rng: np.random.Generator) -> Measurements:
    """Rows at these places a little later, approached from where the robot stands."""
    last = data.select(np.array([len(data) - 1]))
    columns: dict[str, Floats] = {}
    n = len(places)
    if data.time_s is not None:
        columns[TIME] = np.full(n, float(data.time_s.max()) + after_s)
    for name, values in data.covariates.items():
        columns[name] = rng.choice(values, n) if name in data.layout.apart else np.full(n, float(values[-1]))
    for k in range(places.joints.shape[1]):
        way = np.sign(places.joints[:, k] - last.joints[0, k])
        columns[f"direction_{k + 1}"] = np.where(way != 0, way, 1.0)
    rows = planned(places.joints, data.layout, columns)
    # times go on from the begin of the run
    return rows if data.time_s is None else replace(rows, begins_s=data.begins_s)


def _showing(found: Look, own: Floats, tried: Mapping[str, Floats], count: int, only: Sequence[Keys]) -> list[int]:
    """The candidates that show most of every effect, one after another."""
    names = [(h.name, h.settings[len(h.settings) // 2]) for h in found.family.effects] if not only else [
        key for keys in only for key in keys
    ]  # fmt: skip
    names = [key for key in names if key[0] in tried and key[0] in found.evidence.tried]
    over = _over(found)
    x = own / over[None, :, None]
    base = _information(found.evidence.own, _RIDGE)
    parts = [(np.concatenate([found.evidence.own, found.evidence.raw(key)], axis=1),
              np.concatenate([x, _at(found, tried, key) / over[None, :, None]], axis=2)) for key in names]  # fmt: skip
    infos = []
    for columns, _ in parts:
        info = _information(columns, _RIDGE)
        k = columns.shape[1] - x.shape[2]
        info[-k:, -k:] += np.eye(k) / _EXPECTED
        infos.append(info)
    return showing(x, base, [(info, z) for info, (_, z) in zip(infos, parts, strict=True)], count)


def showing(
    x: Floats, base: Floats, parts: Sequence[tuple[Floats, Floats]], count: int, *, first: int = 0
) -> list[int]:
    """Rows (k,), one after another, each that adds most to what all ``parts`` show beside what is free.

    ``x`` (n, m, p) are the columns of what is free and ``base`` (p, p) what is known of it; each part is what is known
    of it and one thing more (q, q), and the columns (n, m, q) of these. What is free counts by itself for the ``first``
    rows, and where there are no parts. Rows that what was fitted cannot reach (NaN) are never chosen.
    """
    reached: Bools = np.logical_and.reduce([np.isfinite(z).all(axis=(1, 2)) for z in (x, *(z for _, z in parts))])
    x = np.where(reached[:, None, None], x, 0.0)
    parts = [(info, np.where(reached[:, None, None], z, 0.0)) for info, z in parts]
    infos, picked = [info for info, _ in parts], list[int]()
    for k in range(min(count, int(reached.sum()))):
        alone = log_gain(x, base)
        gained = alone.copy() if k < first or not parts else np.zeros(len(x))
        for info, (_, z) in zip(infos, parts, strict=True):
            gained += log_gain(z, info) - alone
        gained[picked] = -np.inf
        gained[~reached] = -np.inf
        best = int(np.argmax(gained))
        picked.append(best)
        base = base + x[best].T @ x[best]
        infos = [info + z[best].T @ z[best] for info, (_, z) in zip(infos, parts, strict=True)]
    return picked


def _telling(found: Look, own: Floats, tried: Mapping[str, Floats], against: Sequence[Keys], count: int) -> list[int]:
    """The candidates at which what the rivals predict lies farthest apart."""
    sets: list[Keys] = list(against)
    if found.log_evidence < _CERTAIN or len(sets) < 2:
        sets.append(())
    gained = _apart(found, own, tried, sets)
    return [int(k) for k in np.argsort(-gained)[:count]]


def _apart(found: Look, own: Floats, tried: Mapping[str, Floats], sets: Sequence[Keys]) -> Floats:
    """How far apart (n,) the predictions of these sets lie at each candidate, over their own errors."""
    over = _over(found)
    predicted, variances = [], []
    noise: float | None = None
    for keys in sets:
        keys = tuple(key for key in keys if key[0] in tried and key[0] in found.evidence.tried)
        columns = np.concatenate([found.evidence.own, *(found.evidence.raw(key) for key in keys)], axis=1)
        there = np.concatenate([own, *(_at(found, tried, key) for key in keys)], axis=2) / over[None, :, None]
        info = _information(columns, _RIDGE)
        k = columns.shape[1] - own.shape[2]
        residual = found.evidence.raw_residual
        if k:
            info[-k:, -k:] += np.eye(k) / 36.0
        inverse = linalg.inv(info)
        at = inverse @ (columns.T @ residual)
        left = float(np.square(residual - columns @ at).sum()) / max(len(residual) - columns.shape[1], 1)
        noise = left if noise is None else min(noise, left)
        predicted.append(there @ at)
        variances.append(1.0 + np.einsum("nmp,pq,nmq->nm", there, inverse, there))
    gained = np.zeros(len(own))
    for i in range(len(sets)):
        for j in range(i):
            apart = np.square(predicted[i] - predicted[j]) / ((variances[i] + variances[j]) * max(noise or 1.0, 1e-300))
            gained += np.log1p(apart.sum(axis=1))
    return gained


def are_beyond(found: Look, tied: Sequence[Keys], budget: int, late_s: float, margin: float) -> bool:
    """Whether the readings that are left, wherever and whenever they are taken, would tell none of those tied from the
    first of them, by a ``margin``."""
    if budget <= found.readings:
        return False
    rng = np.random.default_rng(found.readings)
    others = tied[1:_MOST_RIVALS]
    ahead = np.array([found.value(tied[0]) - found.value(other) for other in others])
    far = np.zeros(len(others))
    for after_s in (0.0, late_s):
        rows = later(found.data, found.family.region.anywhere(_CANDIDATES, rng), after_s, rng)
        columns = found.family.columns(rows, found.fit.values, found.fit.model, before=found.readings)
        apart = [_apart(found, columns.own, columns.tried, (tied[0], other)).max() for other in others]
        far = np.maximum(far, np.expm1(apart))
    # half of a squared distance is what a reading adds to the logarithm of their ratio
    return bool((ahead + 0.5 * far * (budget - found.readings) < margin * _CERTAIN).all())


def _at(found: Look, tried: Mapping[str, Floats], key: Key) -> Floats:
    """Columns (n, m, k) of a hypothesis at a setting."""
    return tried[key[0]][:, :, found.family.by_name[key[0]].settings.index(key[1])]


def _over(found: Look) -> Floats:
    """What the axes (m,) weigh."""
    return found.sigma / np.exp(np.mean(np.log(found.sigma)))


def _information(columns: Floats, ridge: float) -> Floats:
    info = columns.T @ columns
    diagonal = np.diag(info)
    return np.asarray(info + np.diag(ridge * diagonal + 1e-300 + ridge * diagonal.max(initial=0.0) * 1e-6))


def log_gain(rows: Floats, information: Floats) -> Floats:
    """By how much the logarithm of the determinant grows with each of the rows (n, m, p)."""
    spread = np.einsum("nar,rs,nbs->nab", rows, linalg.inv(information), rows, optimize=True)
    return np.asarray(np.linalg.slogdet(np.eye(rows.shape[1]) + spread)[1])
