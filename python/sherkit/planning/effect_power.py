"""Planning before measuring: what a plan could find, at what size, what it could not tell apart, what it would know.

All of it follows from the derivatives of the readings at the plan's poses. An effect is looked for with the F-test of
its parameters beside the free ones (Seber and Wild, *Nonlinear Regression*, 5.3): its chance to be found is the tail of
the noncentral F distribution, whose noncentrality is what the free parameters leave of the effect, squared, in units of
the noise. The model is taken as linear about the drawing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from ..base import linalg
from ..base.figures import nearest
from ..base.types import Floats
from ..data import Measurements
from ..errors import EffectError, FitError
from ..evidence.base import gain_asked
from ..evidence.design import power, squares_of, times_found
from ..evidence.family import EFFECTS
from ..evidence.thresholds import DIFFERENCES, LEVEL, POWER, TWIN
from ..evidence.whitening import independent
from ..model.base import missing_columns
from ..model.chain import ChainModel
from ..model.effect import Effect, Parameter
from .poses import PoseDesign, design_of


@dataclass(frozen=True)
class EffectPower:
    """What the plan promises of one effect.

    ``power`` is the chance to find it at its plausible size, ``times`` the multiple of that size at which the chance is
    0.8 (the parameters in any direction, each of its size in the mean of squares), ``values`` these sizes, ``left_um``
    the root mean square that it then leaves of a row, in the unit that people read. ``absorbed`` is the
    share of its squared displacements that the fitted parameters would take. ``indistinguishable`` name effects
    that would explain it as well: with one of them in the model, it is no longer found at its plausible size.
    ``missing_columns`` names columns without which it cannot be tried at all; the rest then says nothing.
    """

    name: str
    link: str
    power: float
    times: float
    values: Mapping[str, float]
    left_um: float
    absorbed: float
    indistinguishable: tuple[str, ...]
    missing_columns: tuple[str, ...]

    @property
    def is_absorbed(self) -> bool:
        """Whether the fitted parameters would take most of it."""
        return self.absorbed > TWIN


@dataclass(frozen=True, eq=False)
class Planning:
    """A model, the rows that a plan would give (their readings are still to come), and the noise of each coordinate.

    ``sigma`` (m,) is in the unit of the readings. ``level`` is that of a diagnosis.
    """

    model: ChainModel
    rows: Measurements
    sigma: Floats
    level: float = LEVEL

    def __post_init__(self) -> None:
        sigma = np.broadcast_to(np.asarray(self.sigma, dtype=float), (self.rows.coordinates,)).copy()
        if not (np.isfinite(sigma).all() and (sigma > 0).all()):
            raise FitError(f"sigma: expected positive numbers, got {sigma.tolist()}")
        object.__setattr__(self, "sigma", sigma)

    # -- the free parameters -----------------------------------------------------------------------------

    @property
    def readings(self) -> int:
        """How many single readings the plan gives."""
        return len(self.rows) * self.rows.coordinates

    @cached_property
    def design(self) -> PoseDesign:
        """How well the free parameters would be known."""
        return design_of(self.model, self.rows, sigma=self.sigma)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters."""
        return self.model.parameters

    @cached_property
    def _basis(self) -> Floats:
        """An orthonormal basis (readings, rank) of what the free parameters can move."""
        return independent(self.columns_of(self.model), DIFFERENCES)

    def columns_of(self, model: ChainModel) -> Floats:
        """Derivatives (readings, p) in units of the noise, by plausible sizes."""
        by = model.derivatives(self.rows, np.zeros(len(model.parameters)))[:, : self.rows.coordinates]
        size = np.array([p.size for p in model.parameters])
        return (by * size / self.sigma[:, None]).reshape(-1, len(size))

    # -- effects -----------------------------------------------------------------------------------------

    @cached_property
    def candidates(self) -> dict[str, Effect]:
        """The effects of the catalogue that are not in the model."""
        inside = {e.name for e in self.model.effects} | self.model.within
        known = self.model.known_effects.items()
        return {name: e for name, e in known if name not in inside and e.goes_with in (*inside, "")}

    def effect(self, name: str) -> Effect:
        """The candidate of that name. Raises :class:`~sherkit.errors.EffectError`."""
        if name not in self.candidates:
            raise EffectError(f"'{name}' is no effect to look for here{nearest(name, self.candidates)}")
        return self.candidates[name]

    def with_effect(self, effect: Effect) -> ChainModel:
        """The model with the effect; a slip is taken to happen in the middle of the run, a cyclic error whose period
        nobody gave to repeat ten times over the range of the joints."""
        at = None
        if effect.search == "time_s" and self.rows.time_s is not None:
            at = float(np.median(self.rows.time_s))
        if effect.is_periodic and self.model.setting_of(effect) is None:
            at = float(np.ptp(self.rows.joints, axis=0).max()) / 10.0
        return self.model.with_effect(effect, at=at)

    @cached_property
    def effect_columns(self) -> dict[str, Floats]:
        """Columns of every effect that can be tried, by plausible sizes and in units of the noise."""
        out = {}
        for name, effect in self.candidates.items():
            if not missing_columns(effect, self.rows):
                model = self.with_effect(effect)
                out[name] = self.columns_of(model)[:, model.owns(effect)]
        return out

    def _left(self, name: str, beside: Floats | None = None) -> Floats:
        """What the free parameters (and ``beside``, an orthonormal basis) leave of an effect's columns."""
        raw = columns = self.effect_columns[name]
        # twice: the first leaves some rounding
        for basis in 2 * [self._basis] + (2 * [beside] if beside is not None else []):
            columns = columns - basis @ (basis.T @ columns)
        kept = np.linalg.norm(columns, axis=0) > DIFFERENCES * np.linalg.norm(raw, axis=0)
        return np.asarray(columns * kept)

    def power(self, name: str, values: Mapping[str, float]) -> float:
        """The chance to find an effect with these parameters (those left out are zero). Raises as :meth:`effect`."""
        effect = self.effect(name)
        left = self._left(name)
        own = {p.name for p in effect.parameters}
        if unknown := [k for k in values if k not in own]:
            raise EffectError(f"'{name}' has no parameter '{unknown[0]}'{nearest(unknown[0], own)}")
        share = np.array([values.get(p.name, 0.0) / p.size for p in effect.parameters])
        return power(float(((left @ share) ** 2).sum()), *self._test(left, name))

    def found_along(self, name: str, values: Mapping[str, float]) -> dict[str, float]:
        """These parameters so many times as large that the effect is found in 80 of 100 cases; infinite where never."""
        effect = self.effect(name)
        left = self._left(name)
        share = np.array([values.get(p.name, 0.0) / p.size for p in effect.parameters])
        at, whole = (float(((columns @ share) ** 2).sum()) for columns in (left, self.effect_columns[name]))
        # along a direction that the parameters take wholly, what is left is rounding
        seen = at > DIFFERENCES**2 * whole
        times = times_found(POWER, np.array([at]), *self._test(left, name)) if seen else float("inf")
        return {name: times * value for name, value in values.items()}

    def _test(self, left: Floats, name: str, beside: int = 0) -> tuple[int, float, int]:
        """Of the test the degrees of freedom of the effect, the level, and the degrees of freedom of the noise."""
        rank = _rank(left, self.effect_columns[name])
        free = self.readings - self._basis.shape[1] - beside
        return rank, self._level_of(rank, free), free - rank

    def _level_of(self, rank: int, free: int) -> float:
        """The level of the F-test that finds what a diagnosis finds at :attr:`level`: an effect among all that it
        tries, by odds of one to the level."""
        if rank <= 0 or free <= rank:
            return self.level
        weight = EFFECTS / max(len(self.candidates), 1)
        # of what is left once the effect is in the model
        gain = gain_asked(rank, free, self.readings, -float(np.log(self.level * weight)))
        return float(scipy.special.fdtrc(rank, free - rank, gain * (free - rank) / (free * rank)))

    def level_of(self, name: str) -> float:
        """Below which chance of an F-test a diagnosis finds an effect. Raises as :meth:`effect`."""
        self.effect(name)
        return self._test(self._left(name), name)[1]

    @cached_property
    def effect_powers(self) -> tuple[EffectPower, ...]:
        """What the plan promises of every effect, in the order of the chain."""
        return tuple(self._outlook(name) for name in self.candidates)

    def _outlook(self, name: str) -> EffectPower:
        effect = self.candidates[name]
        missing = missing_columns(effect, self.rows)
        if missing:
            nan = float("nan")
            return EffectPower(name, effect.link, nan, nan, {}, nan, nan, (), missing)
        raw, left = self.effect_columns[name], self._left(name)
        test = self._test(left, name)
        squares = squares_of(left.T @ left)
        at_size = float((left**2).sum()) if test[0] else 0.0
        times = times_found(POWER, squares, *test)
        whole = float((raw**2).sum())
        # of rows, as errors are told
        unit = self.rows.layout.per_unit * float(np.sqrt(np.sum(self.sigma**2)))
        return EffectPower(
            name=name,
            link=effect.link,
            power=power(squares, *test),
            times=times,
            values={p.name: times * p.size for p in effect.parameters},
            left_um=unit * times * float(np.sqrt(squares.mean() / self.readings)) if np.isfinite(times) else np.inf,
            absorbed=max(1.0 - at_size / whole, 0.0) if whole > 0 else 1.0,
            indistinguishable=self._ties(name) if times <= 1.0 else (),
            missing_columns=(),
        )

    def _ties(self, name: str) -> tuple[str, ...]:
        out = []
        for other in self.effect_columns:
            if other == name:
                continue
            others = self._left(other)
            if _rank(others, self.effect_columns[other]) == 0:
                continue
            basis = independent(others, DIFFERENCES)
            left = self._left(name, basis)
            if power(squares_of(left.T @ left), *self._test(left, name, basis.shape[1])) < POWER:
                out.append(other)
        return tuple(out)


@linalg.one_thread()
def planning_of(
    model: ChainModel, rows: Measurements, sigma: float | Floats, *, effects: tuple[str, ...] = ()
) -> Planning:
    """A planning with ``effects`` (names) in the model already, as after a first diagnosis."""
    known = model.known_effects
    for name in effects:
        if name not in known:
            raise EffectError(f"'{name}' is not a known effect{nearest(name, known)}")
    inside = replace(model, effects=(*model.effects, *(known[name] for name in effects)))
    return Planning(inside, rows, np.asarray(sigma, dtype=float))


def _rank(left: Floats, raw: Floats) -> int:
    """How many directions of an effect are left: what is as small as rounding is none."""
    size = np.linalg.norm(raw, axis=0)
    scaled = left / np.where(size > 0, size, 1.0)
    return int((linalg.singular_values(scaled) > DIFFERENCES).sum())
