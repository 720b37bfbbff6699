"""A fit on its rows, as diagnosis sees it, whatever the machine; of a long run, on as many rows as tell."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from ..base.notebook import Saved
from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..data.columns import bare
from ..data.in_time import DRAWN_C, Room
from ..data.noise import ReadingNoise, noise_of
from ..errors import FitError
from ..fit.error import axes_of
from ..fit.folds import BLOCK
from ..fit.identify import Fit, identify, is_absurd
from ..model.base import Derivatives, ModelWithEffects, column_slices
from ..model.effect import Effect, Setting
from .linearised import Linearised, last_asked
from .thresholds import ROUNDING


class FittedRun(Saved):
    """A fit on its rows.

    ``names`` are those of the reading columns and ``axes`` the columns looked at: coordinates that were taken.
    ``used`` (n, columns) tells the readings that were taken and are not marked as outliers, ``residuals`` (n, columns)
    measured minus predicted. Raises :class:`~sherkit.errors.FitError` for rows without any coordinate.
    """

    def __init__(self, fit: Fit, before: tuple[FittedRun, frozenset[str]] | None = None) -> None:
        data = fit.data
        self.fit = fit
        self.model: ModelWithEffects = fit.model
        self.data = data
        self.names = data.layout.names
        self.axes = axes_of(data)
        if not self.axes:
            raise FitError(f"{data.source}: diagnosis needs coordinates; these rows are distances only")
        self._before = before
        self._last: tuple[Ints, tuple[Effect, ...], Floats, Linearised] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Without what was asked for last and what it came from: a copy computes it again."""
        return super().__getstate__() | {"_last": None, "_before": None}

    @property
    def unit(self) -> str:
        """Errors are reported in this unit, of which one unit of a reading has :attr:`per_unit`."""
        return self.data.layout.unit

    @property
    def per_unit(self) -> float:
        """What turns a reading into :attr:`unit`."""
        return self.data.layout.per_unit

    @property
    def per_row(self) -> float:
        """What turns a root mean square of single readings over all axes into that of rows, the error, in
        :attr:`unit`: each row counts by the length of all that is read of it (:mod:`~sherkit.fit.error`)."""
        return self.per_unit * float(np.sqrt(len(self.axes)))

    @property
    def catalogue(self) -> tuple[Effect, ...]:
        """Effects tried without being asked for, and what is held at the drawing."""
        return (*self.model.known_effects.values(), *self.model.held.values())

    @property
    def used(self) -> Bools:
        """Readings (n, columns) that were taken, in rows that are not marked as outliers."""
        return self.data.used

    @property
    def residuals(self) -> Floats:
        """Measured minus predicted (n, columns), in the unit of the readings."""
        return self.fit.residuals

    @cached_property
    def whole(self) -> Bools:
        """Rows (n,) that can be tested: all readings there, no outlier."""
        return np.logical_and.reduce(self.used[:, self.axes], axis=1)

    @cached_property
    def noise(self) -> tuple[Floats, str]:
        """Noise per reading column (columns,), and where it is known from: declared, repeats or unknown."""
        noise = self.fit.noise
        sigma = np.ones(len(self.names))
        for a in self.axes:
            sigma[a] = float(np.sqrt(np.mean(noise.sigma[self.used[:, a], a] ** 2)))
        return sigma, noise.origin

    @cached_property
    def scatter(self) -> Floats:
        """What the fit leaves per reading column (columns,), its standard deviation: never zero."""
        sigma = np.ones(len(self.names))
        for a in self.axes:
            sigma[a] = max(float(np.std(self.residuals[self.used[:, a], a])), 1e-12)
        return sigma

    @cached_property
    def digits(self) -> Floats:
        """What of each reading column (columns,) is no more than its digits: no noise is smaller."""
        out = np.ones(len(self.names))
        for a in self.axes:
            used = self.data.readings[self.used[:, a], a]
            out[a] = max(ROUNDING * float(np.ptp(used)) if len(used) else 0.0, 1e-12)
        return out

    def owns(self, effect: Effect) -> slice:
        """Where the parameters of an effect that is in the model stand among the fitted ones."""
        return self.model.owns(effect)

    @cached_property
    def is_exact(self) -> bool:
        """Whether what is left is nothing but rounding: readings that were computed, not measured."""
        axes, rows = list(self.axes), self.whole
        reach = np.ptp(self.data.readings[rows][:, axes], axis=0) if rows.any() else np.zeros(len(axes))
        left = np.abs(self.residuals[rows][:, axes]).max(axis=0, initial=0.0)
        return bool((left <= np.maximum(ROUNDING * reach, 1e-12)).all())

    # -- other fits --------------------------------------------------------------------------------------

    @cached_property
    def _refits(self) -> WeakValueDictionary[tuple[tuple[Effect, Setting | None], ...], FittedRun]:
        """Fits with more effects that somebody still has."""
        return WeakValueDictionary()

    @property
    def _is_minimum(self) -> bool:
        """Whether the fit is that of its rows by their noise alone, which any other way to it would find again."""
        return self.fit.loss == "linear" and not self.fit.priors and self.fit.converged

    def refit(self, added: Sequence[tuple[Effect, Setting | None]]) -> FittedRun:
        """The full fit with more effects, each at its setting, from where this fit came to rest. Raises
        :class:`~sherkit.errors.SherkitError`."""
        if (made := self._refits.get(tuple(added))) is not None:
            return made
        model = self.model
        for effect, setting in added:
            model = model.with_effect(effect, at=setting)
        before = (self, frozenset(effect.name for effect, _ in added)) if self._is_minimum else None
        known = dict(zip((p.name for p in self.model.parameters), self.fit.values.tolist(), strict=True))
        start = np.array([known.get(p.name, 0.0) for p in model.parameters])
        # with more in it, it is asked anew whether readings contradict the drawing: what lacked most did not
        fit = identify(model, self.data, noise=self.fit.noise, start=start, priors=None if self.fit.priors else 0.0)
        if not fit.priors and (not fit.converged or (is_absurd(fit) and not is_absurd(self.fit))):
            # more may be more than the readings decide
            fit = identify(model, self.data, noise=self.fit.noise, start=start, priors=True)
        made = self._refits[tuple(added)] = FittedRun(fit, before)
        return made

    def without_effects(self, names: Collection[str]) -> FittedRun:
        """The full fit without these effects of the model, the others from their values. Raises as :meth:`refit`."""
        if self._before is not None and self._before[1] == set(names):
            return self._before[0]
        model, taken = self.model, np.zeros(len(self.fit.values), dtype=bool)
        for effect in self.model.effects:
            if effect.name in names or effect.goes_with in names:
                taken[self.owns(effect)] = True
                model = model.without_effect(effect.name)
        return FittedRun(
            # without what explained them readings may be told by a machine that nobody built
            identify(
                model, self.data, noise=self.fit.noise, start=self.fit.values[~taken], priors=self.fit.priors or None
            )
        )

    def on(self, rows: Ints, sigma: Floats | None = None) -> FittedRun:
        """The full fit on these rows alone, with this noise (columns,) or that which each row has, from the values of
        this one."""
        data = self.data.select(rows)
        each = self.fit.noise.sigma[rows] if sigma is None else np.where(data.taken, sigma, 1.0)
        noise = ReadingNoise(each, self.fit.noise.origin)
        every = np.array_equal(rows, np.arange(len(self.data)))
        if every and self._is_minimum and np.allclose(each, self.fit.noise.sigma, rtol=ROUNDING, atol=0.0):
            return self
        return FittedRun(identify(self.model, data, noise=noise, start=self.fit.values, priors=self.fit.priors))

    def as_in(self, other: FittedRun) -> FittedRun:
        """The full fit of the rows of ``other`` to this model, from the values of this one."""
        return FittedRun(
            identify(self.model, other.data, noise=other.fit.noise, start=self.fit.values, priors=self.fit.priors)
        )

    def without(self, rows: Ints) -> FittedRun:
        """The full fit with these rows marked as outliers, from the drawing: where no reading tells, what they did to
        this fit must not stay."""
        data = self.data.mark_outliers(rows)
        # outlying repeats told of too much noise
        noise = noise_of(data) if self.fit.noise.origin == "repeats" else self.fit.noise
        return FittedRun(identify(self.model, data, noise=noise))

    # -- what can be looked at ---------------------------------------------------------------------------

    @property
    def turn_of_readings(self) -> Floats | None:
        """The turn (m, m) from the axes of places to those of what is fitted; None where they are the same, or where
        not all coordinates were read."""
        turn = self.model.axes_of_readings(self.data, self.fit.values)
        return turn if turn is not None and tuple(self.axes) == tuple(range(len(turn))) else None

    def variables(self, rows: Ints) -> tuple[dict[str, Floats], tuple[str, ...]]:
        """What the residuals of these rows may depend on (rows,), and the names of those that say where it was."""
        part = self.data.select(rows)
        place = self.model.place(part, self.fit.predicted[rows], self.fit.values)
        out = {name: part.joints[:, k] for k, name in enumerate(part.layout.joints)}
        out = {k: v for k, v in (out | place | self.model.covariates(part)).items() if np.ptp(v) > 0}
        return out, tuple(name for name in place if name in out)

    def derivatives(self, rows: Ints) -> Callable[[slice], Derivatives]:
        """Derivatives of stretches of these rows by what is fitted, and by the inputs: of a short run made once."""
        if len(self.data) > BLOCK:
            return self.model.linearised_by_blocks(self.data.select(rows), self.fit.values)
        return lambda some: self._derivatives.on(rows[some])

    @cached_property
    def _derivatives(self) -> Derivatives:
        return self.model.linearised(self.data, self.fit.values)

    def linearised(self, rows: Ints, effects: Sequence[Effect], sigma: Floats) -> Linearised:
        """These rows, in this order, over the noise ``sigma`` (m,) of the axes: residuals, and what gives derivatives
        by what is fitted, by every effect that can be tried, and by the inputs. The last are remembered."""
        last, effects = self._last, tuple(effects)
        if last and np.array_equal(last[0], rows) and last[1] == effects and np.array_equal(last[2], sigma):
            return last[3]
        axes, over = list(self.axes), sigma[:, None]
        part = self.data.select(rows)
        tried, untestable = self.model.is_testable(effects, part)
        periodic = [(e, self.model.setting_of(e)) for e in tried if e.function is None and e.is_periodic]
        unknown = [e for e, period in periodic if period is None]
        asked = [e for e in tried if e not in unknown]
        every = self.model.tried(part, self.fit.values, asked)
        variables, place = self.variables(rows)
        # those that step at a searched time behind the others
        ordered = sorted(every.effects, key=lambda one: one[0].search == "time_s")
        order = np.concatenate([np.arange(0), *(np.arange(at.start, at.stop) for _, at in ordered)])
        columns = column_slices((effect, at.stop - at.start) for effect, at in ordered)
        # a step of a point whose coordinates are read is one of each reading alone
        alone = [effect.link == "body" and every.reads_point for effect, _ in columns]
        known = self.model.inputs_known

        def lagging(effect: Effect) -> Callable[[float], Callable[[slice], Floats]]:
            """Columns of an effect at any lag: those of a stand that is warmer by a degree, by how much it is."""
            warmer = replace(part, room=Room(np.zeros(1), np.array([DRAWN_C + 1.0])))
            of_degree = self.model.with_settings(effect, 1.0).tried(warmer, self.fit.values, [effect])
            per_degree = _PerDegree(lambda some: of_degree.columns(some)[:, axes] / over)

            def at(lag_s: float) -> Callable[[slice], Floats]:
                later = part.later(lag_s)
                assert later is not None, "a room has a temperature"
                degrees = later - DRAWN_C
                return lambda some: per_degree.columns(some) * degrees[some, None, None]

            return at

        names = part.layout.joints
        inputs = {name: np.ascontiguousarray(part.joints[:, k]) for k, name in enumerate(names)}
        there = part.from_other_end.joints
        others = {name: there[:, k] for k, name in enumerate(names)} if known and part.between_places.any() else {}
        moved = [name for name in inputs if name in variables or np.ptp(np.append(inputs[name], others.get(name, ())))]
        out = Linearised(
            residual=(part.readings - self.fit.predicted[rows])[:, axes] / sigma,
            variables=variables,
            group=part.standing,
            repeated=part.groups,
            derivatives=_OverNoise(self.derivatives(rows), every.columns, axes, over, order),
            pattern_of=dict(zip(moved, moved, strict=True)) if known else {},
            place=place,
            inputs=inputs,
            others=others,
            way=way_to(part, {name: variables[name] for name in place}),
            time=part.time_s,
            effects=tuple((effect, at) for effect, at in columns if effect.search != "time_s"),
            in_time=tuple(
                (effect, None if one else at)
                for (effect, at), one in zip(columns, alone, strict=True)
                if effect.search == "time_s"
            ),
            periodic=tuple(periodic) if known else (),
            # what no time says cannot be told to come later
            lagging=tuple((e, lagging(e)) for e in asked if e.is_lagging) if part.room is not None else (),
            untestable=untestable | every.refused,
        )
        self._last = rows, effects, sigma, out
        return out


@dataclass(frozen=True, eq=False)
class _PerDegree:
    """Columns (b, m, k) of a stretch of rows where what follows the room is warmer by a degree."""

    of: Callable[[slice], Floats]

    @last_asked
    def columns(self, rows: slice) -> Floats:
        return self.of(rows)


@dataclass(frozen=True, eq=False)
class _OverNoise:
    """Derivatives of stretches of rows on some axes, over the noise ``over`` (m, 1); the columns of effects in this
    ``order``."""

    own: Callable[[slice], Derivatives]
    every: Callable[[slice], Floats]
    axes: list[int]
    over: Floats
    order: Ints

    def fitted(self, rows: slice) -> tuple[Floats, Floats | None]:
        found = self.own(rows)
        return self._put(found.parameters), None if found.inputs is None else self._put(found.inputs)

    def effects(self, rows: slice) -> Floats:
        columns = self.every(rows)
        # all at once: as many small stretches take ten times as long
        out = np.take(columns if self.all_axes(columns) else columns[:, self.axes], self.order, axis=2)
        out /= self.over
        return out

    def _put(self, columns: Floats) -> Floats:
        return (columns if self.all_axes(columns) else columns[:, self.axes]) / self.over

    def all_axes(self, columns: Floats) -> bool:
        return len(self.axes) == columns.shape[1]


def way_to(data: Measurements, place: Mapping[str, Floats]) -> dict[str, Floats]:
    """How the machine came to rows in the order of time: the inputs of the row before, and the direction of the last
    motion of the point, a unit vector. ``place`` are its coordinates (n,)."""
    n = len(data)
    before = data.joints[np.maximum(np.arange(n) - 1, 0)]
    out = {f"before_{name}": before[:, k] for k, name in enumerate(data.layout.joints)}
    if place:
        # the place of the pose, not of the reading: what is predicted moves with time and direction as well
        group = np.unique(data.groups, return_inverse=True)[1].ravel()
        count = np.bincount(group)
        points = np.column_stack([(np.bincount(group, values) / count)[group] for values in place.values()])
        steps = np.diff(points, axis=0, prepend=points[:1])
        moved = np.linalg.norm(steps, axis=1)
        # where nothing moved, the motion before still holds
        last = np.maximum.accumulate(np.where(moved > 0, np.arange(n), 0))
        way = (steps / np.where(moved > 0, moved, 1.0)[:, None])[last]
        out |= {f"came_{bare(name)}": way[:, k] for k, name in enumerate(place)}
    return {name: np.asarray(v, dtype=float) for name, v in out.items() if np.isfinite(v).all() and np.ptp(v) > 0}


# -- Rows of a long run that are looked at: all poses, and of each as many visits as tell --------------------------

#: Rows beyond which more of them would only show what is smaller than a twentieth of the noise.
ENOUGH = 8192
#: Visits of a pose without which nothing tells its noise.
_REPEATED = 2


def enough_of(data: Measurements, rows: Ints, most: int = ENOUGH) -> Ints:
    """Those of these ``rows`` (k,) that are looked at, in the order of time: at most ``most``.

    Of each pose as many visits as of any other, evenly from first to last: of a run of whole passes these are whole
    passes. Where the poses are too many for that, one by lot stands for its neighbours in time.
    """
    if len(rows) <= most:
        return rows
    rows = rows[np.argsort(data.order[rows], kind="stable")]
    pose = np.unique(data.standing[rows], return_inverse=True)[1].ravel()
    count = np.bincount(pose)
    visit = np.empty(len(rows), dtype=np.int64)
    visit[np.argsort(pose, kind="stable")] = np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)
    each = least = min(_REPEATED, int(count.max()))
    while np.minimum(count, each + 1).sum() <= most:
        each += 1
    taken = np.minimum(count, each)
    keep = (visit * taken[pose]) % count[pose] < taken[pose]
    if taken.sum() > most:
        in_time = pose[np.sort(np.unique(pose, return_index=True)[1])]
        edges = np.linspace(0, len(in_time), most // least + 1).astype(np.int64)
        keep &= np.isin(pose, in_time[np.random.default_rng(0).integers(edges[:-1], edges[1:])])
    return rows[keep]
