"""What may be missing, as columns of one scale: the effects of the catalogue, and shapes for what is in none.

All of it is fixed before readings are looked at: which hypotheses there are, their scales and their weights. Only so is
the weighted mean of their Bayes factors an e-process (:mod:`~.evidence`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..base.types import Floats
from ..data import Measurements
from ..data.columns import TIME
from ..data.lagged import DRAWN_C, Room
from ..evidence.whitening import orthonormal
from ..model.base import ModelWithEffects
from ..model.effect import Effect
from .evidence import ROUGH
from .hypotheses import CUTS, WAVES, Covariate, Hypotheses, Hypothesis, Key, Rows, Shape, shapes, weighted
from .region import Region, planned

#: Rows of the reference on which columns are scaled; a part of a column that is rounding.
_REFERENCE, _ROUNDING = 160, 1e-4
#: A shape of which one effect holds this part is that effect once more.
_TWIN = 0.97
#: Delays behind the room, s.
_LAGS_S = (15.0, 60.0, 120.0, 240.0, 480.0, 960.0, 1920.0, 3840.0)


@dataclass(frozen=True, eq=False)
class Columns:
    """Derivatives of rows: ``own`` (n, m, p) by what the model fits, ``tried`` (n, m, s, k) by each hypothesis at its
    settings."""

    own: Floats
    tried: dict[str, Floats]


@dataclass(frozen=True, eq=False)
class Family(Hypotheses):
    """All hypotheses about a robot in a region. A coefficient of one leaves, beside what the model fits, a root mean
    square of one unit of the readings over the reference; ``scales`` see to it."""

    model: ModelWithEffects
    region: Region
    axes: tuple[int, ...]
    covariates: tuple[Covariate, ...]
    untestable: Mapping[str, str]
    scales: Mapping[str, float]
    #: Of each effect the mean squares (k, k) of its columns over the reference, beside what the model fits.
    reference: Mapping[str, Floats]

    @classmethod
    def of(
        cls, model: ModelWithEffects, region: Region, data: Measurements, axes: tuple[int, ...], span_s: float
    ) -> Family:
        """What can be missing where rows have the columns of ``data``; ``span_s`` is over what time it is judged."""
        every = (*model.known_effects.values(), *model.held.values())
        effects, untestable = model.can_be_tried(every, data)
        apart = {*data.layout.apart, *data.layout.loads}
        covariates = tuple(
            Covariate.of(name, values) for name, values in data.covariates.items()
            if name not in apart and np.isfinite(values).all()
        )  # fmt: skip
        joints, readings = data.layout.joints, tuple(data.layout.names[a] for a in axes)
        patterns = model.linearised(data.select(np.zeros(1, dtype=np.int64)), np.zeros(len(model.parameters))).inputs
        made = shapes(
            region.names, joints, readings, tuple(c.name for c in covariates), timed=data.time_s is not None,
            patterns=patterns is not None,
        )  # fmt: skip
        known = {c.name for c in covariates} | {TIME}
        hypotheses = [
            Hypothesis(e.name, e, None, _settings(e, model), bool(known.intersection(e.needs)) or e.search == TIME)
            for e in effects
        ]
        hypotheses += [Hypothesis(shape.name, None, shape, shape.settings, shape.in_time) for shape in made]
        whole = cls(tuple(hypotheses), model, region, axes, covariates, untestable, {}, {})
        return whole._scaled(_reference(region, data, span_s))

    def _scaled(self, reference: Measurements) -> Family:
        """With scales, without what the model fits anyway and without shapes that are effects."""
        raw = self.columns(reference, np.zeros(len(self.model.parameters)), scaled=False)
        n = len(reference) * len(self.axes)
        own = orthonormal(raw.own)
        left: dict[str, Floats] = {}
        scales: dict[str, float] = {}
        for h in self.hypotheses:
            # of several settings the middle one stands for all
            if h.name not in raw.tried:
                continue
            flat = raw.tried[h.name][:, :, len(h.settings) // 2].reshape(n, -1)
            rest = flat - own @ (own.T @ flat)
            whole, there = float(np.square(flat).sum()), float(np.square(rest).sum())
            if there > _ROUNDING**2 * whole > 0:
                scales[h.name], left[h.name] = float(np.sqrt(n / there)), rest
        bases = [(h, orthonormal(left[h.name])) for h in self.hypotheses if h.effect is not None and h.name in left]
        for h in [h for h, _ in bases if h.effect is not None and h.effect.is_lagging]:
            # what follows the room at once is that with the shortest delay
            flat = raw.tried[h.name][:, :, 0].reshape(n, -1)
            bases.append((replace(h, settings=(None,)), orthonormal(flat - own @ (own.T @ flat))))

        def is_twin(h: Hypothesis) -> bool:
            rest = left[h.name]
            return h.shape is not None and any(
                np.square(basis.T @ rest).sum() > _TWIN * np.square(rest).sum() for effect, basis in bases
                if len(effect.settings) == 1 or effect.settings == h.settings
            )  # fmt: skip

        kept = [h for h in self.hypotheses if h.name in scales and not is_twin(h)]
        kept.append(Hypothesis(ROUGH, None, Shape(ROUGH, lambda rows, _: np.zeros((0,))), (None,), in_time=False))
        taken = {h.name: "what the model fits anyway takes all of it" for h in self.hypotheses
                 if h.effect is not None and h.name not in scales}  # fmt: skip
        return replace(
            self,
            hypotheses=weighted(kept),
            untestable={**self.untestable, **taken},
            scales=scales,
            reference={h.name: scales[h.name] ** 2 * left[h.name].T @ left[h.name] / n for h in kept if h.effect},
        )

    # -- columns -----------------------------------------------------------------------------------------

    def columns(
        self, data: Measurements, values: Floats, model: ModelWithEffects | None = None, *, before: int = 0,
        scaled: bool = True,
    ) -> Columns:  # fmt: skip
        """Derivatives of these rows, ``before`` which so many were read, at the values of a model: that of the family,
        unless another with effects in it is given."""
        model = model or self.model
        axes = list(self.axes)
        derived = model.linearised(data, values)
        inputs = None if derived.inputs is None else derived.inputs[:, axes]
        rows = Rows.of(data, self.region, inputs, len(axes), self.covariates, before)
        tried = _tried(model, data, values, self.effects, rows, self.region, axes)
        tried |= {
            h.name: h.shape.columns(rows, np.array(h.settings, dtype=float))
            for h in self.hypotheses if h.shape and h.name != ROUGH
        }  # fmt: skip
        if scaled:
            tried = {name: columns * self.scales[name] for name, columns in tried.items()}
        return Columns(derived.parameters[:, axes], tried)

    def near(self, key: Key) -> tuple[Key, ...]:
        """The same hypothesis at settings about this one: between it and those beside it in the list."""
        name, setting = key
        h = self.by_name[name]
        if setting is None or h.effect is None:
            return ()
        if h.effect.search == TIME:
            beside = (setting + one for one in (-2.0, -1.0, 1.0, 2.0))
            return tuple((name, cut) for cut in beside if cut >= CUTS[0] - 1.0)
        if h.effect.is_lagging:
            return tuple((name, setting * one) for one in (0.5**0.5, 0.5**0.25, 2.0**0.25, 2.0**0.5))
        return tuple((name, setting + one) for one in (-0.3, -0.15, 0.15, 0.3))

    def with_effect(self, model: ModelWithEffects, key: Key, data: Measurements) -> ModelWithEffects:
        """The model with an effect of the catalogue at its setting, as a fit to these rows takes it."""
        name, setting = key
        effect = self.by_name[name].effect
        assert effect is not None, "shapes are not fitted"
        if effect.search == TIME and setting is not None:
            assert data.time_s is not None, "it needs times"
            times = np.sort(data.time_s)
            cut = min(max(int(setting), 1), len(times) - 1)
            setting = float(0.5 * (times[cut - 1] + times[cut]))
        elif effect.is_periodic and setting is not None:
            setting = self._period(setting)
        return model.adopting(effect, at=setting)

    def _period(self, waves: float) -> float:
        """The period of so many waves over the range of the joints."""
        return 2.0 * float(np.max(self.region.joint_half)) / waves


def _settings(effect: Effect, model: ModelWithEffects) -> tuple[float | None, ...]:
    if effect.search == TIME:
        return tuple(CUTS.tolist())
    if effect.is_lagging:
        return _LAGS_S
    if effect.is_periodic and effect.function is None and model.setting_of(effect) is None:
        return tuple(WAVES.tolist())
    return (None,)


def _tried(
    model: ModelWithEffects, data: Measurements, values: Floats, hypotheses: Sequence[Hypothesis], rows: Rows,
    region: Region, axes: list[int],
) -> dict[str, Floats]:  # fmt: skip
    """Columns (n, m, s, k) of effects that are not in the model, by plausible sizes."""
    inside = {e.name for e in model.effects} | {p.name for p in model.parameters}
    asked = {h.name: h.effect for h in hypotheses if h.effect is not None and h.name not in inside
             and not (h.effect.frees and h.effect.parameters[0].name in inside)}  # fmt: skip
    settings = {h.name: np.array(h.settings, dtype=float) for h in hypotheses}
    out: dict[str, Floats] = {}

    def take(model: ModelWithEffects, some: Sequence[Effect]) -> dict[str, Floats]:
        found = model.tried(data, values, some)
        columns = found.columns(slice(0, len(data)))[:, axes]
        return {e.name: columns[:, :, at] * [p.size for p in e.parameters] for e, at in found.effects}

    def waves(effect: Effect) -> bool:
        return effect.is_periodic and len(settings[effect.name]) > 1

    for name, columns in take(model, [e for e in asked.values() if not e.is_lagging and not waves(e)]).items():
        out[name] = columns[:, :, None]
        if asked[name].search == TIME:
            out[name] = out[name] * (rows.number[:, None] >= settings[name])[:, None, :, None]
    for name, effect in asked.items():
        if effect.is_lagging:
            # of what is warmer by a degree, by how many degrees it is
            warmer = replace(data, room=Room(np.zeros(1), np.array([DRAWN_C + 1.0])))
            found = model.with_settings(effect, 1.0).tried(warmer, values, [effect])
            stand = [data.later(lag_s) for lag_s in settings[name].tolist()]
            if found.effects and data.room is not None:
                of_degree = found.columns(slice(0, len(data)))[:, axes] * [p.size for p in effect.parameters]
                degrees = np.stack([one for one in stand if one is not None], axis=1) - DRAWN_C
                out[name] = of_degree[:, :, None] * degrees[:, None, :, None]
        elif waves(effect):
            turns = np.pi * rows.joints * (region.joint_half / region.joint_half.max())
            both = [
                rows.along(k, np.stack([of(turns[:, k, None] * settings[name]) for of in (np.sin, np.cos)], axis=-1))
                for k in effect.waving(data.layout.joints)
            ]
            out[name] = effect.parameters[0].size * np.concatenate(both, axis=3)
    return out


def _reference(region: Region, data: Measurements, span_s: float) -> Measurements:
    """Rows over all of the region and the span, in a room that swings by a degree, that came from either side."""
    rng = np.random.default_rng(0)
    places = region.spread(_REFERENCE, 0)
    part = np.arange(_REFERENCE) / _REFERENCE
    columns: dict[str, Floats] = {}
    if data.time_s is not None:
        columns[TIME] = part * span_s
    for number, (name, values) in enumerate(data.covariates.items()):
        if name in data.layout.apart or name in data.layout.loads:
            columns[name] = rng.choice(values, _REFERENCE)
        else:
            swing = Covariate.of(name, values).width
            # each in a course of its own: what swings alike could not be told apart
            columns[name] = float(values[0]) + swing * np.sin(2.0 * np.pi * (1.0 + 0.37 * number) * part + number)
    for k in range(places.joints.shape[1]):
        columns[f"direction_{k + 1}"] = rng.choice([-1.0, 1.0], _REFERENCE)
    return planned(places.joints, data.layout, columns)
