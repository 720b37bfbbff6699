"""A robot with a compiled chain as a case: effects of its catalogue at every link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..chain import ChainModel, axes_of, carry, lacks
from ..effects import Effect, check_user_effect
from ..errors import EffectError, FitError
from ..identification import Fit, identify
from ..measurements import Measurements
from ..noise import Noise, noise_of
from ..validation import spatial_blocks
from .case import Case, Seen
from .next_poses import next_poses
from .view import View

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class ChainCase(Case):
    """The fit of a robot with a compiled chain."""

    def __init__(self, fit: Fit) -> None:
        data = fit.data
        self.names = data.layout.names
        self.unit, self.per_unit = data.layout.unit, data.layout.per_unit
        self.catalogue = tuple(fit.model.catalogue.values())
        self.fit: Fit = fit
        self.axes = _used_axes(data)
        self.source = data.source
        self.time_s = data.time_s
        self.groups = data.groups
        self.order = data.order
        self.used = data.taken & ~data.outlier[:, None]

    @property
    def residuals(self) -> Floats:
        """Measured minus predicted (n, m)."""
        return self.fit.residuals

    def noise(self) -> tuple[Floats, str]:
        """Noise per reading column and its origin."""
        noise = noise_of(self.fit.data)
        sigma = np.ones(len(self.names))
        for a in self.axes:
            sigma[a] = float(np.sqrt(np.mean(noise.sigma[self.used[:, a], a] ** 2)))
        return sigma, noise.origin

    def blocks(self, folds: int, seed: int) -> Ints:
        """Tiles of the workspace, dealt to folds."""
        return spatial_blocks(
            self.fit.data, np.nan_to_num(self.fit.predicted[:, : self.fit.data.coordinates]), folds, seed
        )

    def refit(self, added: Sequence[tuple[Effect, Mapping[str, float]]]) -> ChainCase:
        """From the drawing, with the noise of this fit."""
        model = self.fit.model
        for effect, settings in added:
            own = {"slip_time_s": settings["time_s"]} if "time_s" in settings else {}
            model = model.with_effect(effect, **own)
        return ChainCase(identify(model, self.fit.data, noise=self.fit.noise))

    def on(self, rows: Ints, sigma: Floats) -> ChainCase:
        """From the values of this fit."""
        data = self.fit.data.select(rows)
        noise = Noise(np.where(data.taken, sigma, 1.0), self.fit.noise.origin)
        return ChainCase(identify(self.fit.model, data, noise=noise, start=self.fit.values))

    def without(self, rows: Ints) -> ChainCase:
        """From the values of this fit."""
        data = self.fit.data.mark_outliers(rows)
        return ChainCase(identify(self.fit.model, data, noise=self.fit.noise, start=self.fit.values))

    def left_on(self, rows: Ints, other: Case) -> Floats:
        """Measured minus predicted."""
        data = self.fit.data.select(rows)
        return data.readings - other.fit.model.predict(data, other.fit.values)

    def owns(self, effect: Effect) -> slice:
        """As the model says."""
        return self.fit.model.owns(effect)

    def next_poses(self, rivals: Sequence[Case], sigma: Floats) -> tuple[dict[str, float], ...]:
        """Reachable poses, in the order to measure them."""
        return next_poses(self.fit, [r.fit for r in rivals], sigma)

    def check(self, effect: Effect) -> None:
        """What a user's effect must pass on these rows."""
        if effect.name in self.fit.model.catalogue:
            raise EffectError(f"'{effect.name}' is the name of a built-in effect; give yours another")
        if not lacks(effect, self.fit.data):
            data = self.fit.data
            check_user_effect(effect, self.fit.model.rows(data, self.fit.values), axes_of(effect, data))

    def see(self, rows: Ints, effects: Sequence[Effect], sigma: Floats) -> Seen:
        """Everything at once: derivatives by what is fitted, by every effect, and by the joints."""
        fit, axes = self.fit, self.axes
        part = fit.data.select(rows)
        residual = (part.readings - fit.model.predict(part, fit.values))[:, axes] / sigma
        tried, untestable = _can_be_tried(fit.model, effects, part)
        built_in = [e for e in tried if e.function is None and e.search != "time_s"]
        own = [e for e in tried if e.function is not None]
        everything = fit.model
        for effect in built_in:
            everything = everything.with_effect(effect)
        values = dict(zip((p.name for p in fit.parameters), fit.values.tolist(), strict=True))
        start = np.array([values.get(p.name, 0.0) for p in everything.parameters])
        full = everything.full(start)
        columns, by_joints, by_body, _ = everything.core.derivatives(full, everything.block(part), everything.indices)
        scaled = columns[:, axes] / sigma[:, None]
        fitted_names = {p.name for p in fit.parameters}
        in_core = {p.name for p in everything.core_parameters}
        is_fitted = np.array([p.name in fitted_names for p in everything.parameters if p.name in in_core])
        fitted = scaled[:, :, is_fitted]
        rows_view = everything.rows(part, start)
        if everything.own:
            extra = everything.own_columns(part, rows_view, start, by_joints, by_body)
            fitted = np.concatenate([fitted, *[c[:, axes] / sigma[:, None] for c in extra]], axis=2)
        out = [(effect, scaled[:, :, everything.owns(effect)]) for effect in built_in]
        for effect in own:
            try:
                zero = np.zeros(len(effect.parameters))
                inner = carry(effect, effect.columns(rows_view, zero, axes_of(effect, part)), part, by_joints, by_body)
            except EffectError as error:
                untestable[effect.name] = str(error)
                continue
            out.append((effect, inner[:, axes] / sigma[:, None]))
        view = _view(part, residual, fitted, by_joints[:, axes] / sigma[:, None], fit)
        return Seen(view, out, [e for e in tried if e.search == "time_s"], untestable)


def _used_axes(data: Measurements) -> tuple[int, ...]:
    """Readings that diagnosis looks at: the coordinates that were taken."""
    axes = tuple(k for k in range(data.coordinates) if data.taken[:, k].any())
    if not axes:
        raise FitError(f"{data.source}: diagnosis needs coordinates; these rows are distances only")
    return axes


def _can_be_tried(
    model: ChainModel, effects: Sequence[Effect], data: Measurements
) -> tuple[list[Effect], dict[str, str]]:
    """Effects that are not in the model and whose columns are there; the others with the reason."""
    active = {e.name for e in model.effects}
    tried: list[Effect] = []
    untestable: dict[str, str] = {}
    for effect in effects:
        if effect.name in active or effect.name == "datum":
            continue
        missing = lacks(effect, data)
        if missing:
            untestable[effect.name] = f"it needs the column {' and '.join(missing)}"
        else:
            tried.append(effect)
    return tried, untestable


def _view(part: Measurements, residual: Floats, fitted: Floats, by_joints: Floats, fit: Fit) -> View:
    position = fit.model.predict(part, fit.values)
    joints, coordinates = part.layout.joints, part.layout.coordinates
    variables: dict[str, Floats] = {name: part.joints[:, k] for k, name in enumerate(joints)}
    variables |= {name: position[:, k] for k, name in enumerate(coordinates)}
    variables |= fit.model.covariates(part)
    patterns = {name: by_joints[:, :, k] for k, name in enumerate(joints)}
    constant = [name for name, v in variables.items() if not np.ptp(v) > 0]
    for name in constant:
        del variables[name]
    return View(
        residual=residual,
        fitted=fitted,
        variables=variables,
        patterns=patterns,
        group=part.groups,
        pattern_of={name: name for name in joints if name in variables},
        place=tuple(name for name in coordinates if name in variables),
        time=part.time_s,
    )
