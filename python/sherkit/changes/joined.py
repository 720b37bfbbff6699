"""Several runs of one machine as one linear object, about the model as the first run has it.

What all runs share are the parameters; each later run has a stand of its own (:mod:`~.stand`) and noise of its own. A
change is what a parameter, or an effect, does in the course of the runs. Effects of the temperature are free beside it,
as large as they are plausible: a robot that is warmer has not changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..adaptive.evidence import Evidence
from ..adaptive.hypotheses import Hypotheses, Hypothesis, Key, Rows, shapes, weighted
from ..base import linalg
from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..data.columns import TEMPERATURE
from ..data.noise import MAD
from ..errors import FitError
from ..evidence.whitening import Whitening, correlation_in_time, orthonormal
from ..fit.identify import Fit
from ..model.base import ModelWithEffects
from ..model.effect import Effect, Parameter
from ..model.set_ups import SETUP_PREFIX
from .stand import Stand, stand_of

#: A row farther off than so many robust deviations is left out; rounds in which such rows are looked for.
_GROSS, _ROUNDS = 7.0, 8
#: Readings beyond what is free from which a run tells its own noise, and that it follows itself.
_OWN_NOISE, _OWN_COURSE = 10, 40
#: Shapes that all runs may have in common, changes beside which they are looked for, and the evidence (a logarithm)
#: from which there is one; what has begun with a run must be so much likelier.
_MOST_LASTING, _MOST_BESIDE, _LASTS, _SIMPLER = 8, 3, np.log(100.0), np.log(1e4)
LASTS = "in all runs"
#: A part of a column that is rounding.
_ROUNDING = 1e-5
#: Parameters that say where the sensor stands, by how their names begin.
_OF_STAND = ("datum", "sensor_turn", "sensor_shift", "sensor_slip", SETUP_PREFIX)


@dataclass(frozen=True, eq=False)
class Candidate:
    """What may have changed: a parameter of the model, or all of an effect."""

    name: str
    effect: Effect | None
    parameters: tuple[Parameter, ...]


@dataclass(frozen=True, eq=False)
class Moved:
    """A candidate that has moved: by ``values`` (k,) in the units of its parameters, times ``factors`` (R,) of the
    runs."""

    name: str
    values: Floats
    factors: Floats


@dataclass(frozen=True, eq=False)
class SeenRun:
    """One run in the order of time: ``used`` (n, m) readings, its stand, the derivatives ``own`` (n, m, p) by what all
    runs share, columns (n, m, k) of each candidate, the noise ``sigma`` that it shows by itself (zero where it is too
    short), how much one row hands on to the next, and the rows ``aside`` that are wrong."""

    data: Measurements
    used: Bools
    stand: Stand
    own: Floats
    columns: Mapping[str, Floats]
    sigma: float
    rho: float
    aside: Ints


class Joined:
    """Runs that were joined, and what may have changed in their course.

    ``fit`` is the model on the first of them, ``axes`` are the readings that are looked at. Raises
    :class:`~sherkit.errors.FitError` for a run that is too short or lies out of reach.
    """

    def __init__(
        self, fit: Fit, runs: Sequence[Measurements], axes: tuple[int, ...], moved: Sequence[Moved] = (),
        seen: Sequence[SeenRun] = (), lasting: Sequence[Floats] = (),
    ) -> None:  # fmt: skip
        self.fit, self.axes, self.model = fit, axes, fit.model
        self._data = [data.select(np.argsort(data.order, kind="stable")) for data in runs]
        self.growth = _growth(self.model, self._data)
        self.candidates = candidates_of(self.model, self._data)
        self.moved = tuple(moved)
        self._before, self._lasting = tuple(seen), tuple(lasting)
        self.runs = [self._seen(data, k) for k, data in enumerate(self._data)]
        known = [run.sigma for run in self.runs if run.sigma > 0]
        if not known:
            raise FitError(
                f"{runs[0].source}: no run has rows enough to tell the noise beside {len(fit.values)} parameters"
            )
        self.noise = float(np.exp(np.mean(np.log(known))))

    def at(self, moved: Sequence[Moved]) -> Joined:
        """The same runs about a model in which these have changed."""
        return Joined(self.fit, self._data, self.axes, moved, self.runs, self._lasting)

    def with_what_lasts(self) -> Joined:
        """The same runs, and free in all of them alike what the model misses from the first on: as long as a shape that
        lasts is nearly as likely as all that may have begun with a later run, beside the changes that are far likelier.
        What was missing already is no change."""
        now, count = self, len(self.runs)
        steps = [np.array([float(k >= since) for k in range(count)]) for since in range(1, count)]
        for _ in range(_MOST_LASTING):
            found = _lasting(now.evidence({"": steps, LASTS: [np.ones(count)]}))
            if found is None:
                break
            now = Joined(now.fit, now._data, now.axes, now.moved, now.runs, (*now._lasting, found))
        return now

    # -- one run -----------------------------------------------------------------------------------------

    def _now(self, number: int) -> tuple[ModelWithEffects, Floats]:
        """The model of a run and its values: those of the first, but for what has moved since."""
        model, values = self.model, dict(zip((p.name for p in self.model.parameters), self.fit.values, strict=True))
        for one in self.moved:
            if one.factors[number] == 0.0:
                continue
            candidate = self.candidate(one.name)
            if candidate.effect is not None and candidate.effect.name not in {e.name for e in model.effects}:
                model = model.adopting(candidate.effect)
            for p, by in zip(candidate.parameters, one.values, strict=True):
                values[p.name] = values.get(p.name, 0.0) + one.factors[number] * by
        return model, np.array([values.get(p.name, 0.0) for p in model.parameters])

    def _seen(self, data: Measurements, number: int) -> SeenRun:
        axes, (model, values) = list(self.axes), self._now(number)
        # what is wrong is judged once: beside a change that is none, good rows would look so
        before = self._before[number] if self._before else None
        used = data.used[:, axes] if before is None else before.used
        places = {p.name: k for k, p in enumerate(model.parameters)}
        every = model.linearised(data, values).parameters[:, axes]
        own = every[:, :, [places[p.name] for p in self.model.parameters]]
        aside = np.zeros(0, dtype=np.int64) if before is None else before.aside
        sigma = rho = 0.0
        stand = Stand(np.zeros(used.shape), np.zeros((*used.shape, 0)), {})
        for _ in range(_ROUNDS):
            if number == 0:
                left = np.where(used, data.readings[:, axes] - model.predict(data, values)[:, axes], 0.0)
                stand = Stand(left, np.zeros((*used.shape, 0)), {})
            else:
                stand = stand_of(model, data, values, self.axes, used)
            free = orthonormal(np.where(used[:, :, None], np.concatenate([every, stand.columns], axis=2), 0.0))
            flat = np.where(used, stand.residual, 0.0).reshape(-1)
            left = (flat - free @ (free.T @ flat)).reshape(used.shape)
            freedom = int(used.sum()) - free.shape[1]
            sigma = float(np.sqrt(np.square(left[used]).sum() / freedom)) if freedom >= _OWN_NOISE else 0.0
            if freedom < 2 * _OWN_NOISE or before is not None:
                break
            if _follows(data, used, freedom):
                rho = correlation_in_time(np.where(used, stand.residual, 0.0), free)
            lever = np.square(free).sum(axis=1).reshape(used.shape)
            each = np.abs(left) / np.sqrt((1.0 - lever).clip(0.05))
            each = np.where(used, each, 0.0)
            # the worst first: what they did to the fit makes others look wrong
            limit = max(_GROSS * MAD * float(np.median(each[used])), 0.5 * float(each.max(initial=0.0)))
            wrong = np.flatnonzero((each > limit).any(axis=1))
            if not len(wrong):
                break
            aside = np.union1d(aside, wrong)
            used = used & ~np.isin(np.arange(len(used)), wrong)[:, None]
        columns = self._columns(data, model, values, every)
        own_sigma = noise_of_repeats(data.mark_outliers(aside), axes) or sigma
        sigma, rho = (own_sigma, rho) if before is None else (before.sigma, before.rho)
        return SeenRun(data, used, stand, own, columns, sigma, rho, aside)

    def _columns(self, data: Measurements, model: ModelWithEffects, values: Floats, own: Floats) -> dict[str, Floats]:
        """Columns (n, m, k) of every candidate and of growth, by plausible sizes."""
        everybody = [*self.candidates, *(Candidate(e.name, e, e.qualified()) for e in self.growth)]
        return columns_of(model, values, data, self.axes, everybody, own)

    def columns_at(self, data: Measurements) -> dict[str, Floats]:
        """Columns of every candidate for other rows, by the model as the first run has it."""
        own = self.model.linearised(data, self.fit.values).parameters[:, list(self.axes)]
        return self._columns(data, self.model, self.fit.values, own)

    # -- all of them -------------------------------------------------------------------------------------

    def _sigma(self, run: SeenRun) -> float:
        return run.sigma or self.noise

    def _flat(self, run: SeenRun, values: Floats) -> Floats:
        """Values (n, m, …) of a run over its noise, in units of that of all, of readings that are used (N, …)."""
        over = values * (self.noise / self._sigma(run))
        if run.rho and run.used.all():
            over = Whitening(run.rho, np.ones(len(over), dtype=np.int64))(over)
        return np.asarray(over[run.used])

    def over_runs(self, per_run: Sequence[Floats]) -> Floats:
        """Values (n, m, …) of each run as one column (N, …), with rows for what is known of parameters at the end."""
        flat = [self._flat(run, values) for run, values in zip(self.runs, per_run, strict=True)]
        return np.concatenate([*flat, np.zeros((self._known, *flat[0].shape[1:]))])

    @property
    def _known(self) -> int:
        return len(self.model.parameters) + sum(len(e.parameters) for e in self.growth)

    @cached_property
    def base(self) -> Floats:
        """Columns (N, p) of what needs no change: parameters of all runs, the stand of each, growth as is plausible."""
        shared = self.over_runs([run.own for run in self.runs])
        count = len(self.model.parameters)
        # a plausible size is knowledge: a reading of zero, as exact as that. Without it, what no run observes by itself
        # would be as large as makes good a change, where that has moved what is not observed
        at = len(shared) - self._known
        shared[at : at + count] = np.diag([self.noise / p.size for p in self.model.parameters])
        blocks = [shared]
        for run in self.runs:
            width = run.stand.columns.shape[2]
            if width:
                mine = [r.stand.columns if r is run else np.zeros((*r.used.shape, width)) for r in self.runs]
                blocks.append(self.over_runs(mine))
        at += count
        for effect in self.growth:
            grown = self.over_runs([run.columns[effect.name] for run in self.runs])
            for j in range(grown.shape[1]):
                grown[at, j] = self.noise
                at += 1
            blocks.append(grown)
        blocks += self._lasting
        return np.concatenate(blocks, axis=1)

    @cached_property
    def residual(self) -> Floats:
        """What the model of the first run leaves (N,), each run seen from its own stand."""
        return self.over_runs([run.stand.residual for run in self.runs])

    def evidence(self, courses: Mapping[str, Sequence[Floats]], *, waves: bool = True) -> Evidence:
        """Of every candidate in the courses of the runs: a name ("" for steps) to its factors (R,) at each setting,
        only shapes in :data:`LASTS`; without ``waves`` no shape that has settings of its own is among them."""
        made: list[Hypothesis] = []
        tried: dict[str, Floats] = {}
        base = orthonormal(self.base)

        def take(
            name: str, effect: Effect | None, shape: Any, per_run: Sequence[Floats], factors: Sequence[Floats]
        ) -> None:
            settings = per_run[0].shape[2] if per_run[0].ndim == 4 else 1
            every = [
                self.over_runs([f * (c[:, :, s] if c.ndim == 4 else c) for f, c in zip(one, per_run, strict=True)])
                for one in factors for s in range(settings)
            ]  # fmt: skip
            left = [columns - base @ (base.T @ columns) for columns in every]
            kept = [k for k, (rest, whole) in enumerate(zip(left, every, strict=True))
                    if np.square(rest).sum() > _ROUNDING**2 * np.square(whole).sum() > 0]  # fmt: skip
            if not kept:
                return
            # a coefficient of one leaves a root mean square of one where it acts
            scaled = []
            for k in kept:
                rows = np.abs(every[k]).max(axis=1) > 0
                scaled.append(every[k] * np.sqrt(rows.sum() / np.square(left[k]).sum()))
            made.append(Hypothesis(name, effect, shape, tuple(float(k) for k in kept), in_time=False))
            tried[name] = np.stack(scaled, axis=1)

        for course, factors in courses.items():
            for one in self.candidates if course != LASTS else ():
                columns = [run.columns[one.name] for run in self.runs]
                take(told_as(one.name, course), one.effect, None, columns, factors)
        rows = [self._rows(run) for run in self.runs]
        layout = self.runs[0].data.layout
        readings = tuple(layout.names[a] for a in self.axes)
        patterns = all(r.patterns is not None for r in rows)
        for shape in shapes(self._places, layout.joints, readings, (), timed=False, patterns=patterns):
            if len(shape.settings) > 1 and not waves:
                continue
            at = np.array(shape.settings, dtype=float)
            per_run = [shape.columns(r, at) for r in rows]
            for course, factors in courses.items():
                take(told_as(shape.name, course), None, shape, per_run, factors)
        return Evidence(Hypotheses(weighted(made)), self.residual, self.base, tried)

    def places(self, run: SeenRun) -> dict[str, Floats]:
        """Where the machine stood in the rows of a run, by name (n,)."""
        return dict(self.model.place(run.data, self.model.predict(run.data, self.fit.values), self.fit.values))

    @property
    def _places(self) -> tuple[str, ...]:
        return tuple(
            self.model.place(self.runs[0].data, self.model.predict(self.runs[0].data, self.fit.values), self.fit.values)
        )

    def _rows(self, run: SeenRun) -> Rows:
        """The rows of a run as shapes see them, on the scale of all runs."""

        def scaled(values: Floats, every: Sequence[Floats]) -> Floats:
            low = np.min([v.min(axis=0) for v in every], axis=0)
            high = np.max([v.max(axis=0) for v in every], axis=0)
            return np.asarray((values - 0.5 * (low + high)) / np.maximum(0.5 * (high - low), 1e-300))

        def place(one: SeenRun) -> Floats:
            found = self.model.place(one.data, self.model.predict(one.data, self.fit.values), self.fit.values)
            return np.column_stack([found[name] for name in self._places])

        inputs = self.model.linearised(run.data, self.fit.values).inputs
        data = run.data
        direction = np.where(np.isfinite(data.direction), data.direction, 1.0)
        return Rows(
            scaled(place(run), [place(r) for r in self.runs]),
            scaled(data.joints, [r.data.joints for r in self.runs]),
            None if inputs is None else inputs[:, list(self.axes)],
            direction, None, np.arange(len(data)), {}, len(self.axes),
        )  # fmt: skip

    def estimate(self, columns: Floats) -> tuple[Floats, Floats, float]:
        """Values and covariance of the coefficients of columns (N, k) beside all that needs no change, and what is left
        (root mean square over the noise)."""
        base = orthonormal(self.base)
        rest = columns - base @ (base.T @ columns)
        left = self.residual - base @ (base.T @ self.residual)
        gram = rest.T @ rest
        inverse = linalg.inv(gram + 1e-12 * np.eye(len(gram)) * np.trace(gram))
        value = inverse @ (rest.T @ left)
        off = left - rest @ value
        free = max(len(left) - base.shape[1] - rest.shape[1], 1)
        scale = float(off @ off) / free
        return value, inverse * scale, float(np.sqrt(scale)) / self.noise

    def columns_of(self, name: str, factors: Floats) -> Floats:
        """Columns (N, k) of a candidate, by plausible sizes, at factors (R,) of the runs."""
        return self.over_runs([f * run.columns[name] for f, run in zip(factors, self.runs, strict=True)])

    def candidate(self, name: str) -> Candidate:
        """The candidate of that name."""
        return next(one for one in self.candidates if one.name == name)


def _lasting(evidence: Evidence) -> Floats | None:
    """Columns (N, k) of the shape that lasts, where one is likelier than what may have changed beside some changes."""
    taken: list[Key] = []
    while len(taken) <= _MOST_BESIDE:
        found = evidence.beside(taken) if taken else evidence.alone
        by_name = evidence.family.by_name
        value = {name: bf + float(np.log(by_name[name].weight)) for name, bf in found.log_bf.items()}
        lasts = max((n for n in value if n.endswith(told_as("", LASTS))), key=lambda n: value[n], default="")
        if lasts and value[lasts] > max(_LASTS, max(value.values()) - _SIMPLER):
            return evidence.raw((lasts, found.setting[lasts]))
        causes = [name for name in value if not by_name[name].is_shape]
        lead = max(causes, key=lambda name: value[name], default="")
        if not lead or value[lead] < _LASTS:
            return None
        taken.append((lead, found.setting[lead]))
    return None


def columns_of(
    model: ModelWithEffects,
    values: Floats,
    data: Measurements,
    axes: Sequence[int],
    candidates: Sequence[Candidate],
    own: Floats,
) -> dict[str, Floats]:
    """Columns (n, m, k) of candidates by plausible sizes; ``own`` (n, m, p) are those of the model's parameters."""
    places = {p.name: k for k, p in enumerate(model.parameters)}
    asked = [one.effect for one in candidates if one.effect is not None and one.parameters[0].name not in places]
    tried = model.tried(data, values, asked)
    columns = tried.columns(slice(0, len(data)))[:, list(axes)]
    out = {e.name: columns[:, :, at] for e, at in tried.effects}
    out |= {one.name: own[:, :, [places[p.name] for p in one.parameters]] for one in candidates if one.name not in out}
    return {one.name: out[one.name] * [p.size for p in one.parameters] for one in candidates}


def told_as(name: str, course: str) -> str:
    """What a change in a course is called; a step by the candidate's name alone."""
    return f"{name} ({course})" if course else name


def noise_of_repeats(data: Measurements, axes: Sequence[int]) -> float:
    """The noise of a reading as repeats of poses show it: what differs between poses is none; 0 where too few do."""
    repeats = data.repeatability
    if repeats is None:
        return 0.0
    names = [data.layout.readings[a] for a in axes]
    free = np.array([repeats.degrees_of_freedom.get(name, 0) for name in names], dtype=float)
    if free.sum() < 2 * _OWN_NOISE:
        return 0.0
    squares = np.array([np.nan_to_num(repeats.sigma[name]) ** 2 if name in repeats.sigma else 0.0 for name in names])
    return float(np.sqrt((free * squares).sum() / free.sum()))


def _follows(data: Measurements, used: Bools, freedom: int) -> bool:
    return data.time_s is not None and bool(used.all()) and freedom >= _OWN_COURSE


def _growth(model: ModelWithEffects, runs: Sequence[Measurements]) -> list[Effect]:
    """Effects of the temperature that are not in the model, where every run recorded it."""
    if not all(TEMPERATURE in data.covariates for data in runs):
        return []
    inside = {e.name for e in model.effects}
    every = [e for e in model.known_effects.values() if TEMPERATURE in e.needs and e.name not in inside]
    return [e for e in every if e.search is None and _possible(model, e, runs)]


def _possible(model: ModelWithEffects, effect: Effect, runs: Sequence[Measurements]) -> bool:
    return all(bool(model.can_be_tried([effect], data)[0]) for data in runs)


def candidates_of(model: ModelWithEffects, runs: Sequence[Measurements]) -> list[Candidate]:
    """Every parameter that does not say where the sensor stands, and every effect that does not live in time."""
    inside = {e.name: model.owns(e) for e in model.effects}
    out = [
        Candidate(p.name, None, (p,)) for k, p in enumerate(model.parameters)
        if not p.name.startswith(_OF_STAND) and not any(at.start <= k < at.stop for at in inside.values())
    ]  # fmt: skip
    for effect in (*model.effects, *model.known_effects.values(), *model.held.values()):
        if any(one.name == effect.name for one in out):
            continue
        # a moment or a delay belongs to one run; a period is the robot's
        if effect.search is not None and not (effect.is_periodic and model.setting_of(effect) is not None):
            continue
        if TEMPERATURE in effect.needs or "time_s" in effect.needs:
            continue
        if effect.name in inside or _possible(model, effect, runs):
            out.append(Candidate(effect.name, effect, effect.qualified()))
    return out
