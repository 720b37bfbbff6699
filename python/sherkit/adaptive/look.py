"""One look at the rows read so far: what they say of everything that may be missing.

The model is fitted, wrong rows are set aside, the noise is taken as the best explanation leaves it (of each axis, and
from one row to the next), every hypothesis is weighed, and the first of them are fitted in full beside the geometry:
what an effect leaves to first order about the drawing is no judgement on it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..data.noise import MAD, Noise, noise_of
from ..errors import SherkitError
from ..evidence.fitted_run import DIGITS
from ..evidence.whitening import Whitening, correlation_in_time, orthonormal
from ..fit.identify import Fit, identify
from ..model.effect import Effect
from .evidence import Evidence, log_bayes_at
from .family import Family
from .hypotheses import Key

#: A row farther off than so many robust deviations, beside the best explanation, is set aside.
GROSS = 7.0
_ROUNDS = 3
#: Readings beyond the parameters from which rows can be told to be wrong; noise that is the same.
_BEYOND, _SAME = 6, 0.1
#: Joints that are nearer than this part of half their range are at one pose.
_SAME_PLACE = 1e-4
#: Plausible sizes are knowledge where readings are fewer than so many times the parameters.
_FEW = 3.0
#: Readings from which the course of the noise is looked at, and how many stand for "all axes alike".
_ENOUGH, _ALIKE = 24, 20.0
#: Sets that are fitted in full: at most so many, within this of the best (a logarithm).
_FULL, _NEAR = 4, 12.0
#: An effect beside which the evidence is less leaves nothing (a logarithm).
_QUIET = np.log(20.0)
#: A shape of which an effect is a part counts for so much less (a logarithm); the part of it that it must hold.
WIDER, _HOLDS = np.log(1e3 / 20.0), 0.98
#: A set is far better than another where it is so much likelier (a logarithm).
FAR = np.log(1e4)

Keys = tuple[Key, ...]


@dataclass(frozen=True, eq=False)
class Fitted:
    """A set of effects in the model, fitted in full: ``log_bf`` against the model alone, ``rest`` what is left beside
    it, as the logarithm of a mean Bayes factor over all others, ``given`` those by name."""

    keys: Keys
    fit: Fit
    log_bf: float
    rest: float
    given: Mapping[str, float]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects, in the order of their names."""
        return tuple(sorted(name for name, _ in self.keys))


@dataclass(frozen=True, eq=False)
class Look:
    """What ``readings`` rows say: ``log_evidence`` that something is missing, ``sets`` with the logarithm of weight
    times Bayes factor, best first, ``fitted`` the first of them in full; ``aside`` (k,) are rows that are wrong,
    ``sigma`` (m,) the noise of the axes and ``rho`` how much of it one row hands on to the next."""

    family: Family
    data: Measurements
    fit: Fit
    log_evidence: float
    sets: tuple[tuple[Keys, float], ...]
    fitted: tuple[Fitted, ...]
    aside: Ints
    sigma: Floats
    rho: float
    evidence: Evidence

    @property
    def readings(self) -> int:
        """Rows that were read."""
        return len(self.data)

    def is_shape(self, keys: Keys) -> bool:
        """Whether a set is a shape of what is in no catalogue."""
        return any(self.family.by_name[name].is_shape for name, _ in keys)

    @cached_property
    def effects(self) -> tuple[tuple[Keys, float], ...]:
        """The sets that explain, best first."""
        return tuple((keys, value) for keys, value in self.sets if not self.is_shape(keys))

    @cached_property
    def shapes(self) -> tuple[tuple[Keys, float], ...]:
        """The sets with a shape in them, best first."""
        return tuple((keys, value) for keys, value in self.sets if self.is_shape(keys))

    def shape_beside(self, explaining: Sequence[Keys]) -> tuple[Keys, float]:
        """The best set with a shape that is not one of these and something besides. One that holds all that the first
        of them does is that once more, in a wider form: it counts for less."""
        names = [{name for name, _ in keys} for keys in explaining]
        best: tuple[Keys, float] = (), -np.inf
        for keys, value in self.shapes:
            if value <= best[1]:
                break
            if not any(one <= {name for name, _ in keys} for one in names):
                lower = value - WIDER if explaining and self.holds(keys, explaining[0]) else value
                best = max(best, (keys, lower), key=lambda one: one[1])
        return best

    def holds(self, wider: Keys, keys: Keys) -> bool:
        """Whether what a set takes of the readings could be taken by another one as well, whatever it takes."""
        taken = self._taken(keys)
        told = taken @ (taken.T @ self.evidence.residual)
        beside = self._taken(wider)
        return float(np.square(beside.T @ told).sum()) > _HOLDS * float(told @ told)

    def _taken(self, keys: Keys) -> Floats:
        known = [
            key for key in keys if key[0] in self.evidence.place and key[1] in self.family.by_name[key[0]].settings
        ]
        if len(known) < len(keys):
            return np.zeros((len(self.evidence.residual), 0))
        return orthonormal(np.concatenate([self.evidence.left(key) for key in known], axis=1))

    @cached_property
    def lead(self) -> Fitted | None:
        """The best of the sets that were fitted in full, one cause before two: a pair leads only where it is far better
        than each of its two, or both leave something."""
        for one in self.fitted:
            parts = [other for other in self.fitted if set(other.names) < set(one.names) and other.rest < _QUIET]
            if not any(self.value(other.keys) > self.value(one.keys) - FAR for other in parts):
                return one
        return self.fitted[0] if self.fitted else None

    @cached_property
    def leading(self) -> tuple[tuple[Keys, float], ...]:
        """What leads and the best two besides, the leader with something more aside: that is no rival of it."""
        first = self.lead.keys if self.lead is not None else self.sets[0][0] if self.sets else ()
        mine = {name for name, _ in first}
        others = [one for one in self.sets if not mine <= {name for name, _ in one[0]}]
        return ((first, self.value(first)), *others[:2]) if first else ()

    def value(self, keys: Keys) -> float:
        """The logarithm of weight times Bayes factor of a set."""
        return next((value for other, value in self.sets if other == keys), -np.inf)


def look(family: Family, data: Measurements, before: Look | None = None) -> Look:
    """Looks at rows in the order of time; the noise that the look ``before`` found is where it begins. Raises
    :class:`~sherkit.errors.FitError` where nothing can be fitted."""
    # where nobody knows from which side the first pose was approached, lost motion would make it another slip
    unsure = np.flatnonzero((data.direction == 0.0).all(axis=1)) if moved(data) else np.zeros(0, dtype=np.int64)
    aside = unsure if before is None else before.aside
    sigma, rho = (np.ones(len(family.axes)), 0.0) if before is None else (before.sigma, before.rho)
    for _ in range(_ROUNDS):
        view = _View(family, data.mark_outliers(aside) if len(aside) else data, sigma, rho)
        found = view.look(aside)
        best = found.lead.fit if found.lead and found.log_evidence > np.log(20.0) else found.fit
        wrong = np.union1d(view.gross(best), unsure)
        noise, follows = view.noise(best)
        settled = (np.abs(np.log(noise / sigma)) < _SAME).all() and abs(follows - rho) < _SAME
        if settled and np.array_equal(wrong, aside):
            break
        aside, sigma, rho = wrong, noise, follows
    return found


def moved(data: Measurements) -> bool:
    """Whether any joint moved while the rows were read."""
    return bool((data.direction != 0.0).any())


class _View:
    """Rows, and what weighs them."""

    def __init__(self, family: Family, data: Measurements, sigma: Floats, rho: float) -> None:
        self.family, self.data, self.sigma, self.rho = family, data, sigma, rho
        self.axes = list(family.axes)
        self.used: Bools = data.used[:, self.axes]
        self.whole = self.used.all(axis=1)
        declared = noise_of(data)
        each = declared.sigma[:, self.axes] if declared.origin == "declared" else np.ones((len(data), len(self.axes)))
        typical = np.exp(np.mean(np.log(each[self.used]))) if self.used.any() else 1.0
        #: What a reading is over, (n, m): one on average, so that coefficients stay in units of the reading.
        self.over = each / typical * (sigma / np.exp(np.mean(np.log(sigma))))

    def _noise(self) -> Noise:
        over = np.ones(self.data.used.shape)
        over[:, self.axes] = self.over
        return Noise(over, "unknown")

    def fit(self, model: object, start: Floats | None = None) -> Fit:
        """The model on these rows; with knowledge of plausible sizes where they are few."""
        parameters = len(model.parameters)  # type: ignore[attr-defined]
        few = self.used.sum() < _FEW * parameters
        return identify(model, self.data, noise=self._noise(), priors=bool(few), start=start)  # type: ignore[arg-type]

    def flat(self, values: Floats) -> Floats:
        """Values (n, m, …) over what they weigh, without what a row hands on, of readings that are used (N, …)."""
        shape = (*self.over.shape,) + (1,) * (values.ndim - 2)
        out = values / self.over.reshape(shape)
        if self.rho:
            rows = np.flatnonzero(self.whole)
            kept = Whitening(self.rho, np.concatenate([[1], np.diff(rows)]))(out[rows])
            return kept.reshape(-1, *values.shape[2:])
        return np.asarray(out[self.used])

    def residual(self, fit: Fit) -> Floats:
        """Measured minus predicted (n, m), zero where nothing was read."""
        return np.where(self.used, np.nan_to_num(fit.residuals[:, self.axes]), 0.0)

    def evidence(self, fit: Fit) -> Evidence:
        """Of everything that may be missing beside a fit."""
        columns = self.family.columns(self.data, fit.values, fit.model)
        tried = {name: self.flat(values) for name, values in columns.tried.items()}
        reach = [
            np.ptp(self.data.readings[self.used[:, k], a]) for k, a in enumerate(self.axes) if self.used[:, k].any()
        ]
        rounding = DIGITS * float(max(reach, default=0.0))
        left = self.flat(self.residual(fit))
        return Evidence(self.family, left, self.flat(columns.own), tried, rounding, self.poses())

    def poses(self) -> Ints:
        """A number for each reading that is used (N,), the same where a pose was read once more on the same axis."""
        _, joints = self.family.region.scaled(self.data.joints)
        apart = [self.data.covariates[name] for name in self.data.layout.apart if name in self.data.covariates]
        pose = np.unique(np.column_stack([np.round(joints / _SAME_PLACE), *apart]), axis=0, return_inverse=True)[1]
        each = pose.reshape(-1, 1) * len(self.axes) + np.arange(len(self.axes))
        kept = each[self.whole].ravel() if self.rho else each[self.used]
        return np.unique(kept, return_inverse=True)[1].astype(np.int64)

    def look(self, aside: Ints) -> Look:
        """All of it."""
        fit = self.fit(self.family.model)
        evidence = self.evidence(fit)
        sets = evidence.sets()
        first = sorted((keys for keys in sets if not any(self.family.by_name[n].is_shape for n, _ in keys)),
                       key=lambda keys: -sets[keys])  # fmt: skip
        fitted = []
        asked = [keys for keys in first[:_FULL] if sets[keys] > sets[first[0]] - _NEAR]
        # to first order a pair may make up for what one of its two does beyond that
        asked += [(key,) for keys in asked[:2] if len(keys) > 1 for key in keys if (key,) in sets]
        for keys in dict.fromkeys(asked if evidence.alone.log_mean > np.log(5.0) else ()):
            if (one := self._in_full(keys, fit, evidence)) is not None:
                weight = self._log_weight(keys)
                sets[keys] = max(sets[keys], weight + one.log_bf)
                fitted.append(replace(one, log_bf=sets[keys] - weight))
        for one in [one for one in fitted if len(one.keys) == 1]:
            self._beside(one, sets)
        fitted.sort(key=lambda one: -sets[one.keys])
        ordered = tuple(sorted(sets.items(), key=lambda one: -one[1]))
        return Look(
            self.family, self.data, fit, evidence.alone.log_mean, ordered, tuple(fitted), aside, self.sigma, self.rho,
            evidence,
        )  # fmt: skip

    def _beside(self, one: Fitted, sets: dict[Keys, float]) -> None:
        """What pairs with an effect are worth, by what that leaves once it is fitted in full."""
        ((name, _),) = one.keys
        for keys in [keys for keys in sets if len(keys) == 2 and name in (keys[0][0], keys[1][0])]:
            other = keys[1][0] if keys[0][0] == name else keys[0][0]
            given = self._log_weight(keys) + one.log_bf + one.given.get(other, 0.0)
            # where one effect leaves nothing, a second is worth what it adds to that
            sets[keys] = given if one.rest < _QUIET else max(sets[keys], given)

    def _log_weight(self, keys: Keys) -> float:
        return float(np.log(self.family.weight([name for name, _ in keys])))

    def _in_full(self, keys: Keys, alone: Fit, evidence: Evidence) -> Fitted | None:
        fit = self._settled(keys)
        if fit is None:
            return None
        beside = self.evidence(fit)
        effects = [h for h in self.family.effects if h.name in {name for name, _ in keys}]
        at = np.concatenate([_owned(fit, h.effect) for h in effects])
        scale = np.concatenate(
            [np.full(len(h.effect.parameters), self.family.scales[h.name]) for h in effects if h.effect]
        )
        scale = scale * [fit.parameters[k].size for k in at]
        own = beside.own
        others = orthonormal(np.delete(own, at, axis=1))
        mine = own[:, at] * scale
        mine = mine - others @ (others.T @ mine)
        base = float(evidence.residual @ evidence.residual)
        if not base > 0:
            return None
        settings = float(np.log([len(h.settings) for h in effects]).sum())
        # the readings as they are to first order about this fit, without what the rest of the model takes
        told = beside.raw_residual - others @ (others.T @ beside.raw_residual) + mine @ (fit.values[at] / scale)
        gained = log_bayes_at(mine.T @ mine, mine.T @ told, float(told @ told), base, evidence.free)
        weighed = beside.alone
        return Fitted(keys, fit, gained - settings, weighed.log_mean, weighed.log_bf)

    def _settled(self, keys: Keys) -> Fit | None:
        """The fit with a set in the model, each setting the best of those about it; None where there is none."""
        best: tuple[float, Fit] | None = None
        now = list(keys)
        for k, key in enumerate(keys):
            for other in (key, *self.family.near(key)):
                if best is not None and other == key:
                    continue
                trial = [*now[:k], other, *now[k + 1 :]]
                try:
                    model = self.family.model
                    for one in trial:
                        model = self.family.with_effect(model, one, self.data)
                    fit = self.fit(model)
                except SherkitError:
                    continue
                left = float(np.square(self.flat(self.residual(fit))).sum())
                if best is None or left < best[0]:
                    best, now = (left, fit), trial
        return None if best is None else best[1]

    # -- noise and gross errors --------------------------------------------------------------------------

    def _studentised(self, fit: Fit) -> tuple[Floats, Floats]:
        """What a fit leaves (n, m), each over what its own weight in the fit takes from it, and a basis (n m, k)."""
        own = fit.model.derivatives(self.data, fit.values)[:, self.axes] / self.over[:, :, None]
        own = np.where(self.used[:, :, None], own, 0.0)
        basis = orthonormal(own)
        lever = np.square(basis).sum(axis=1).reshape(self.used.shape)
        left = self.residual(fit) / self.over
        return left / np.sqrt((1.0 - lever).clip(0.02)), basis

    def gross(self, fit: Fit) -> Ints:
        """Rows (k,) that stand apart from all others, be they set aside already or not."""
        left, _ = self._studentised(fit)
        used = left[self.used]
        if len(used) <= len(fit.values) + _BEYOND:
            return np.zeros(0, dtype=np.int64)
        spread = MAD * float(np.median(np.abs(used)))
        if not spread > 0:
            return np.zeros(0, dtype=np.int64)
        taken = self.data.taken[:, self.axes]
        beside = np.where(taken, np.nan_to_num(fit.residuals[:, self.axes]), 0.0) / self.over
        off = np.where(self.used, left, beside)
        wrong = np.flatnonzero((np.abs(np.where(taken, off, 0.0)) > GROSS * spread).any(axis=1))
        # what most rows do is no accident of a few: a channel that sticks, one that is read a row late
        return wrong if 2 * len(wrong) <= len(off) else wrong[:0]

    def noise(self, fit: Fit) -> tuple[Floats, float]:
        """The noise of each axis (m,), drawn towards that of all while rows are few, and ρ from row to row."""
        left, basis = self._studentised(fit)
        scale = self.over / self.over.mean(axis=0) if len(self.over) else self.over
        squares = np.square(np.where(self.used, left * self.over / scale, 0.0))
        count = self.used.sum(axis=0).astype(float)
        free = np.maximum(count - basis.shape[1] / len(self.axes), 1.0)
        # residuals were made larger by their leverage already
        each = squares.sum(axis=0) / np.maximum(count, 1.0)
        pooled = float((each * count).sum() / max(count.sum(), 1.0))
        if not pooled > 0:
            return self.sigma, 0.0
        drawn = np.exp((free * np.log(np.maximum(each, 1e-12 * pooled)) + _ALIKE * np.log(pooled)) / (free + _ALIKE))
        sigma = np.sqrt(drawn / np.exp(np.mean(np.log(drawn))))
        rho = 0.0
        if self.data.time_s is not None and self.whole.sum() >= _ENOUGH and self.whole.all():
            rho = correlation_in_time(self.residual(fit) / self.over, basis)
        return sigma, rho


def _owned(fit: Fit, effect: Effect | None) -> Ints:
    """Where the parameters of an effect stand among the fitted ones."""
    assert effect is not None, "shapes are not fitted"
    own = {p.name for p in effect.qualified()}
    return np.array([k for k, p in enumerate(fit.parameters) if p.name in own], dtype=np.int64)
