"""Any model with three methods as a case. Effects are its candidates and the user's, added to the readings.

There are no joints here: shapes of an error at one input, and hysteresis, are for machines whose inputs are known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..effects import Effect, check_user_effect
from ..errors import EffectError
from ..readings import ModelFit, fit_model, noise_of_readings
from ..validation import deal_tiles
from .case import Case, Seen
from .view import View

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class ModelCase(Case):
    """The fit of a model of any machine."""

    per_unit = 1.0
    # readings of angles may be off by half a turn, in rows that lie together: they would draw neighbours with them
    worst_first = 0.5

    def __init__(self, fit: ModelFit) -> None:
        data = fit.data
        self.fit: ModelFit = fit
        self.names = data.names
        self.axes = tuple(range(len(data.names)))
        self.unit = data.unit
        self.source = data.source
        self.time_s = data.time_s
        self.groups = data.groups
        self.order = data.line
        self.used = data.used
        self.catalogue = tuple(getattr(fit.model.plain, "candidates", ()))

    @property
    def residuals(self) -> Floats:
        """Measured minus predicted (n, m), in the unit of the readings."""
        return self.fit.residuals

    def noise(self) -> tuple[Floats, str]:
        """Noise per reading column and its origin."""
        sigma, origin = noise_of_readings(self.fit.data)
        return np.array([np.sqrt(np.mean(s[u] ** 2)) for s, u in zip(sigma.T, self.used.T, strict=True)]), origin

    def blocks(self, folds: int, seed: int) -> Ints:
        """As the rows say, or tiles of the place, dealt to folds."""
        if self.fit.data.block is not None:
            names, block = np.unique(self.fit.data.block, return_inverse=True)
            deal = np.arange(len(names), dtype=np.int64) % folds
            np.random.default_rng(seed).shuffle(deal)
            return deal[block.ravel()]
        return deal_tiles(np.stack(list(self.fit.data.place.values()), axis=1), self.groups, folds, seed)

    def refit(self, added: Sequence[tuple[Effect, Mapping[str, float]]]) -> ModelCase:
        """From zero, with the noise of this fit."""
        fit = self.fit
        effects = [effect for effect, _ in added]
        return ModelCase(fit_model(fit.model, fit.data, effects=effects, noise=(fit.sigma, fit.origin)))

    def on(self, rows: Ints, sigma: Floats) -> ModelCase:
        """From the values of this fit."""
        data = self.fit.data.select(rows)
        noise = np.broadcast_to(sigma, data.readings.shape), self.fit.origin
        return ModelCase(fit_model(self.fit.model, data, start=self.fit.values, noise=noise))

    def without(self, rows: Ints) -> ModelCase:
        """From the values of this fit."""
        fit = self.fit
        data = fit.data.mark_outliers(rows)
        return ModelCase(fit_model(fit.model, data, start=fit.values, noise=(fit.sigma, fit.origin)))

    def left_on(self, rows: Ints, other: Case) -> Floats:
        """Measured minus predicted, in the unit of the readings."""
        data = self.fit.data.select(rows)
        return data.readings - other.fit.model.predict(data, other.fit.values)

    def owns(self, effect: Effect) -> slice:
        """As the model says."""
        return self.fit.model.owns(effect)

    def check(self, effect: Effect) -> None:
        """What a user's effect must pass on these rows."""
        if effect.name in {e.name for e in self.catalogue}:
            raise EffectError(f"'{effect.name}' is the name of one of the model's candidates; give yours another")
        if not self._lacks(effect):
            check_user_effect(effect, self.fit.data, len(self.names))

    def _lacks(self, effect: Effect) -> list[str]:
        """Columns that an effect needs and the rows do not have."""
        data = self.fit.data
        known = {*data.place, *data.covariates} | ({"time_s"} if data.time_s is not None else set())
        return [name for name in effect.needs if name not in known]

    def see(self, rows: Ints, effects: Sequence[Effect], sigma: Floats) -> Seen:
        """What is fitted, and every effect at zero."""
        model, values = self.fit.model, self.fit.values
        part = self.fit.data.select(rows)
        residual = (part.readings - model.predict(part, values)) / sigma
        fitted = model.derivatives(part, values) / sigma[:, None]
        active = {e.name for e in model.effects}
        covariates = model.covariates(part)
        columns: list[tuple[Effect, Floats]] = []
        untestable: dict[str, str] = {}
        for effect in effects:
            if effect.name in active:
                continue
            missing = self._lacks(effect)
            if missing:
                untestable[effect.name] = f"it needs the column {' and '.join(missing)}"
                continue
            try:
                inner = effect.columns(part, np.zeros(len(effect.parameters)), len(self.names))
            except EffectError as error:
                untestable[effect.name] = str(error)
                continue
            columns.append((effect, inner / sigma[:, None]))
        variables = {k: v for k, v in {**part.place, **covariates}.items() if np.ptp(v) > 0}
        view = View(
            residual=residual,
            fitted=fitted,
            variables=variables,
            patterns={},
            group=part.groups,
            place=tuple(name for name in part.place if name in variables),
            time=part.time_s,
        )
        return Seen(view, columns, (), untestable)
