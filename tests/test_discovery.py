"""Hidden physics, found again: effects planted in an independent simulator, named through the public interface."""

from __future__ import annotations

import importlib.util
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy import stats

import sherkit as sk
from second_simulator import (
    CATALOGUE,
    Noise,
    Robot,
    draw_geometric_errors,
    grid,
    local_grid,
    make_plan,
    scaled_effect,
    simulate,
    whole_grid,
)
from sherkit.diagnosis import template
from strategies import EXAMPLE

Floats = NDArray[np.float64]

ROBOT = Robot.from_dict()
DELTA = EXAMPLE
NOISE_UM = 5.0
EFFECTS = tuple(name for name in CATALOGUE if name != "datum")
GRIDS = {"whole": whole_grid(), "local": local_grid(), "small": grid(20.0, 8, (-20.0, 0.0, 20.0))}
RATIOS = (1, 2, 5)
LEVEL = 0.01
#: Chance with which a correct program fails one of the counts below.
RARE = 1e-3
#: Largest ratio that each grid lets the simulator reach: the twelve parameters hide nearly all of these effects, so
#: that more of them left over would need sizes (centimetres of stretch or of difference) at which no pose exists.
CAPS = {("gravity_sag", "local"): 2.0}


@dataclass
class Run:
    """One simulated run and what was planted in it."""

    data: sk.Measurements
    errors: dict[str, float]
    effects: dict[str, Any] = field(default_factory=dict)

    def diagnose(self, effects: tuple[sk.Effect, ...] = ()) -> sk.Diagnosis:
        """As a user does."""
        return sk.diagnose(sk.identify(DELTA, self.data), effects=effects)


def measured(
    points: Floats,
    seed: int,
    effects: Mapping[str, ArrayLike] | None = None,
    *,
    scaled: Mapping[str, float] | None = None,
    repeats: int = 3,
    order: Any = "shuffled",
    noise: Noise | None = None,
    add: Mapping[str, Any] | None = None,
) -> Run:
    """A run over ``points``. ``scaled`` effects are drawn so that a geometric fit leaves the given RMS, µm; ``add``
    maps a column to a function of the columns that is added to it."""
    plan = make_plan(ROBOT, points, repeats=repeats, order=order, seed=seed)
    errors = draw_geometric_errors(np.random.default_rng([seed, 1]))
    planted: dict[str, Any] = dict(effects or {})
    for k, (name, rms_um) in enumerate((scaled or {}).items()):
        rng = np.random.default_rng([seed, 2, k])
        planted |= scaled_effect(ROBOT, plan, name, rng, 1e-3 * rms_um, errors=errors)
    noise = noise or Noise(sigma_mm=1e-3 * NOISE_UM)
    columns = simulate(ROBOT, plan, errors, planted, noise=noise, seed=1000 + seed)
    for name, function in (add or {}).items():
        columns[name] = columns[name] + function(columns)
    return Run(sk.from_frame(pl.DataFrame(columns)), errors, planted)


def named(d: sk.Diagnosis) -> set[str]:
    """Effects that lead or are tied with one that does."""
    return set(d.effects).union(*d.ties)


def ratio_of(name: str, where: str, ratio: float) -> float:
    return min(ratio, CAPS.get((name, where), np.inf))


def hidden(name: str, ratio: float, where: str, seed: int) -> sk.Diagnosis:
    """The diagnosis of a run with one effect whose visible part is ``ratio`` times the noise."""
    return measured(GRIDS[where], seed, scaled={name: ratio_of(name, where, ratio) * NOISE_UM}).diagnose()


@dataclass(frozen=True)
class Case:
    """A kind of noise under which nothing must be found."""

    repeats: int = 3
    order: str = "shuffled"
    noise: Noise = field(default_factory=lambda: Noise(sigma_mm=1e-3 * NOISE_UM))


SIGMA = 1e-3 * NOISE_UM
CASES = {
    "1 repeat": Case(1),
    "3 repeats": Case(3),
    "5 repeats": Case(5),
    "outliers": Case(noise=Noise(SIGMA, outlier_fraction=0.02)),
    "unequal": Case(noise=Noise((0.003, 0.005, 0.009), rim_factor=3.0)),
    "student": Case(noise=Noise(SIGMA, student=True)),
    "correlated 0.3": Case(noise=Noise(SIGMA, rho=0.3)),
    "correlated 0.7": Case(noise=Noise(SIGMA, rho=0.7)),
    "1 repeat, unequal": Case(1, noise=Noise((0.003, 0.005, 0.009), rim_factor=3.0)),
    "1 repeat, student": Case(1, noise=Noise(SIGMA, student=True)),
    "1 repeat, outliers": Case(1, noise=Noise(SIGMA, outlier_fraction=0.02)),
    "1 repeat in order, correlated 0.3": Case(1, "planes", Noise(SIGMA, rho=0.3)),
    "1 repeat in order, correlated 0.7": Case(1, "planes", Noise(SIGMA, rho=0.7)),
    "3 repeats in order, correlated 0.7": Case(3, "planes", Noise(SIGMA, rho=0.7)),
}


def silent(case: Case, seed: int) -> sk.Diagnosis:
    """The diagnosis of a run with nothing hidden."""
    return measured(GRIDS["small"], seed, repeats=case.repeats, order=case.order, noise=case.noise).diagnose()
