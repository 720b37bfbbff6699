"""What was identified of a robot in one run: values and covariance of its errors, what is left, and its table."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from ..base.names import listed
from ..base.types import Floats
from ..data.columns import TEMPERATURE
from ..data.toml import Table
from ..fit.identify import Fit
from ..model.chain import ChainModel
from ..model.effect import effects_by_name
from ..model.kinds import Robot, catalogue_of, kind_of, model_of
from .unobserved_effects import UnobservedEffect

#: So many plausible sizes are no identified error any more.
_ABSURD = 1e4
#: Readings that are further off than this (mm, px, rad) say nothing.
_LARGEST_RESIDUAL = 1e4


@dataclass(frozen=True, eq=False)
class Part:
    """One identified model: errors by name, their covariance, and what it leaves.

    ``free`` and ``effects`` say what was identified, ``settings`` the settings of the effects; effects given in NumPy
    do not run in a control loop and are listed in ``left_out``. ``now`` holds time, temperature and a direction for
    each joint that stand for the covariates where the loop does not give its own: the end of the run, its mean
    temperature, the middle of the backlash. ``covariance`` (p, p) in the order of ``values``; ``residual_covariance``
    (k, k) of what poses held out miss beyond noise and parameters, ``noise_covariance`` (k, k) of how single readings
    scatter about their pose, both in the unit of the coordinates; where the noise is not known it is in the first.
    ``low`` and ``high`` (k,) are the corners of the box in which the run measured, as coordinates. ``readings`` are the
    columns that instruments showed; ``unobserved_effects`` is what the poses could not show, by effect, and ``untried``
    are effects of which nothing can be said: the run lacks a column that they need.
    """

    free: tuple[str, ...]
    effects: tuple[str, ...]
    settings: dict[str, float]
    left_out: tuple[str, ...]
    now: tuple[float, ...]
    values: Floats
    covariance: Floats
    residual_covariance: Floats
    low: Floats
    high: Floats
    made_from: str
    rows: int
    noise_covariance: Floats | None = field(default=None, kw_only=True)
    readings: tuple[str, ...] = field(default=(), kw_only=True)
    unobserved_effects: tuple[UnobservedEffect, ...] = field(default=(), kw_only=True)
    untried: tuple[str, ...] = field(default=(), kw_only=True)

    @classmethod
    def identified(cls, fit: Fit, size: int, *, shrink: float = 1.0, **own: Any) -> Self:
        """What a fit alone says, of ``size`` coordinates: as if it left nothing, about zero. :meth:`leaving` says the
        rest. ``shrink`` is the part of the readings' own share of the covariance that counts, ``own`` what a kind's
        part has besides."""
        model, data, core = fit.model, fit.data, len(fit.model.indices)
        time, temperature = data.time_s, data.covariates.get(TEMPERATURE)
        return cls(
            free=model.free,
            effects=tuple(e.name for e in model.built_in),
            settings={name: value or 0.0 for name, value in model.settings().items()},
            left_out=tuple(e.name for e in model.own),
            now=(
                float(time.max()) if time is not None else 0.0,
                float(temperature.mean()) if temperature is not None else 20.0,
                *(0.0 for _ in data.layout.joints),
            ),
            values=fit.values[:core],
            covariance=(fit.covariance * shrink + fit.unobserved_covariance)[:core, :core],
            residual_covariance=np.zeros((size, size)),
            low=np.zeros(size),
            high=np.zeros(size),
            made_from=data.source,
            rows=len(data),
            readings=data.layout.coordinates,
            **own,
        )

    def leaving(self, left: Floats, scatter: Floats, where: Floats) -> Self:
        """With what poses held out miss (k, k), how single readings scatter (k, k), and the places (n, k) of the run;
        what is not finite in these is none, and without any the box stays."""
        known = where[np.isfinite(where).all(axis=1)]
        box = {"low": known.min(axis=0), "high": known.max(axis=0)} if len(known) else {}
        return replace(self, residual_covariance=left, noise_covariance=scatter, **box)

    @property
    def scatter(self) -> Floats:
        """Covariance (k, k) of single readings about their pose, zero where it is not known."""
        return np.zeros_like(self.residual_covariance) if self.noise_covariance is None else self.noise_covariance

    def model(self, robot: Robot) -> ChainModel:
        """The model that was identified."""
        chosen = effects_by_name(catalogue_of(robot), self.effects)
        return kind_of(robot).model(robot, self.free, chosen, **self.settings)

    def spread(self, by_values: Floats) -> Floats:
        """Covariance (n, k, k) of places that depend on the values by these derivatives (n, k, p), with what is
        left."""
        return by_values @ self.covariance @ by_values.transpose(0, 2, 1) + self.residual_covariance

    def functions(self, coordinates: Floats) -> Floats:
        """Values (n, c) of the functions that a smooth correction is a sum of; it has none of them by default."""
        return np.zeros((len(coordinates), 0))

    @property
    def corrects(self) -> bool:
        """Whether there is a smooth correction."""
        return self.functions(self.low[None, :]).shape[1] > 0

    def to_table(self, robot: Robot, coordinates: tuple[str, ...]) -> dict[str, Any]:
        """For TOML, without loss."""
        unit, now = _unit(coordinates), _now_names(robot)
        std = np.sqrt(np.diag(self.covariance).clip(0.0))
        return {
            "made_from": self.made_from,
            "rows": self.rows,
            "effects": list(self.effects),
            "left_out": list(self.left_out),
            **({"settings": dict(self.settings)} if self.settings else {}),
            "now": dict(zip(now, self.now, strict=True)),
            "parameters": [
                {"name": p.name, "value": float(v), "std": float(s), "unit": p.unit}
                for p, v, s in zip(self.model(robot).parameters, self.values, std, strict=True)
            ],
            "covariance": self.covariance.tolist(),
            f"residual_covariance_{unit}2": self.residual_covariance.tolist(),
            **({} if self.noise_covariance is None else {f"noise_covariance_{unit}2": self.noise_covariance.tolist()}),
            **self._own_table(unit),
            f"low_{unit}": self.low.tolist(),
            f"high_{unit}": self.high.tolist(),
            "readings": list(self.readings),
            "untried": list(self.untried),
            "unobserved_effects": [one.to_table() for one in self.unobserved_effects],
        }

    def _own_table(self, unit: str) -> dict[str, Any]:
        del unit
        return {}

    @classmethod
    def from_table(cls, table: Table, robot: Robot, coordinates: tuple[str, ...]) -> Self:
        """Back from :meth:`to_table`. Raises :class:`~sherkit.errors.CalibrationError` with the key."""
        unit, size = _unit(coordinates), len(coordinates)
        names, values, told = [], [], []
        for p in table.tables("parameters", optional=False):
            names.append(p.words("name"))
            values.append(p.number("value"))
            # they follow from covariance and model, and must agree with them
            told.append((p.words("unit", empty=True), p.number("std")))
        settings = {}
        known = model_of(robot).settings()
        if known:
            with table.table("settings") as s:
                # what came with a later version was not there
                settings = {name: s.number(name, 0.0) for name in known}
        with table.table("now") as n:
            now = tuple(n.number(name) for name in _now_names(robot))
        low, high = table.array(f"low_{unit}", size), table.array(f"high_{unit}", size)
        if (low > high).any():
            raise table.fail(f"low_{unit}", f"nothing above high_{unit}")
        made = cls(
            free=tuple(name for name in names if "." not in name),
            effects=table.texts("effects"),
            settings=settings,
            left_out=table.texts("left_out"),
            now=now,
            values=np.array(values, dtype=float),
            covariance=table.covariance("covariance", len(values)),
            residual_covariance=table.covariance(f"residual_covariance_{unit}2", size),
            low=low,
            high=high,
            made_from=table.words("made_from", empty=True),
            rows=table.whole("rows", least=0),
            noise_covariance=(
                table.covariance(f"noise_covariance_{unit}2", size) if table.has(f"noise_covariance_{unit}2") else None
            ),
            readings=table.texts("readings"),
            untried=table.texts("untried"),
            **cls._own_fields(table, unit, size),
        )
        expected = [p.name for p in made.model(robot).parameters]
        if names != expected:
            wrong = next((f for f, e in zip(names, expected, strict=False) if f != e), "a missing one")
            raise table.refuse(f"parameters: expected {listed(expected, 30)}; '{wrong}' does not belong there")
        made._check(table, robot, told)
        model = made.model(robot)
        if made.readings not in [(), *(one.coordinates for one in model.layouts)]:
            raise table.fail("readings", f"one of {listed(' '.join(one.coordinates) for one in model.layouts)}")
        functions = made.functions(low[None, :]).shape[1]
        unobserved_effects = tuple(
            UnobservedEffect.from_table(one, model, functions, size) for one in table.tables("unobserved_effects")
        )
        for k, one in enumerate(unobserved_effects):
            sizes, far = one.largest(model)
            if sizes > _ABSURD or far > _LARGEST_RESIDUAL:
                raise table.refuse(f"unshown: entry {k + 1} ({one.effect}): larger than any robot")
        return replace(made, unobserved_effects=unobserved_effects)

    def _check(self, table: Table, robot: Robot, told: list[tuple[str, float]]) -> None:
        """Refuses numbers that no identification gave: in other units, or absurd beside what is plausible."""
        known = np.sqrt(np.diag(self.covariance).clip(0.0))
        for p, (unit, std), value, sigma in zip(self.model(robot).parameters, told, self.values, known, strict=True):
            if unit != p.unit:
                raise table.refuse(f"parameters: {p.name} is in {p.unit or 'no unit'}, found '{unit}'")
            if abs(std - sigma) > 1e-3 * max(sigma, std):
                raise table.refuse(f"parameters: {p.name}: std = {std:g}, by the covariance it is {sigma:g}")
            if max(abs(value), sigma) > _ABSURD * p.size:
                raise table.refuse(f"parameters: {p.name} = {value:g} ± {sigma:g} {p.unit}: no robot is so far off")
        if np.diag(self.residual_covariance).max() > _LARGEST_RESIDUAL**2:
            raise table.refuse("residual_covariance: larger than any robot")

    @classmethod
    def _own_fields(cls, table: Table, unit: str, size: int) -> dict[str, Any]:
        del table, unit, size
        return {}


def _unit(coordinates: tuple[str, ...]) -> str:
    return coordinates[0].rpartition("_")[2]


def _now_names(robot: Robot) -> tuple[str, ...]:
    return ("time_s", "temperature_c", *kind_of(robot).layout.directions)
