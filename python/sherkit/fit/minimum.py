"""The way to the minimum of a fit: where it begins, by how much noise is larger than assumed, and past small steps of a
cost that is not smooth."""

from __future__ import annotations

import numpy as np

import sherkit._core as _core

from ..base.types import Floats
from ..data import Measurements
from ..errors import FitError, RobotError
from ..model.base import ModelWithEffects
from .least_squares import LeastSquaresProblem, reached, scale

#: Evaluations of a fit that begins at the minimum of another: it is near its own, or has none.
NEAR = 25
#: Evaluations after which noise is told to a tenth there.
ROUGHLY = 6
#: Rounds in which noise settles, at most; it has settled where it falls to no less than this part.
_ROUNDS, _NEARLY_SETTLED = 30, 0.9


def beginning(model: ModelWithEffects, data: Measurements, weights: Floats) -> Floats:
    """Where a fit begins: at the drawing; with effects at the fit without them, beside which none of them can end
    worse."""
    plain = model
    for name in {effect.name for effect in model.effects} - set(model.within):
        plain = plain.without_effect(name)
    if plain is model:
        return model.start(data)
    before, _ = LeastSquaresProblem(plain, data).solve(weights, plain.start(data))
    known = dict(zip((p.name for p in plain.parameters), before.trial.tolist(), strict=True))
    return np.array([known.get(p.name, 0.0) for p in model.parameters])


def noise_ratio(
    problem: LeastSquaresProblem, weights: Floats, values: Floats, *, loss: str, priors: bool, linear: bool, most: int
) -> tuple[float, Floats]:
    """By how much the noise is larger than was assumed, where only residuals tell it: a prior is weighed against it;
    and where a fit with it begins. ``most`` evaluations are allowed in each round."""
    if not priors:
        loose, _ = problem.solve(weights, values, linear=linear)
        return max(scale(problem.residuals(loose.trial), weights, loose.result()["rank"], loss), 1e-12), values
    # from the drawing down: without it a fit may leave nothing, as where constant distances make a robot shrink
    ratio = max(scale(problem.residuals(values), weights, 0, loss), 1e-12)
    for _ in range(_ROUNDS):
        solver, _ = problem.solve(weights / ratio, values, priors=True, max_evaluations=most)
        values, before = solver.trial, ratio
        ratio = max(scale(problem.residuals(values), weights, solver.result()["rank"], loss), 1e-12)
        if ratio > _NEARLY_SETTLED * before:
            break
    return ratio, values


def over_the_wall(
    problem: LeastSquaresProblem, weights: Floats, solver: _core.Solver, ended: str, *, priors: bool
) -> tuple[_core.Solver, str]:
    """Goes on from behind a small step of the cost, where a model is not smooth: a whole step from where every damped
    one went up. Where that leads nowhere better, all stays."""
    there = problem.solve(weights, solver.trial, priors=priors, linear=True)[0].trial
    try:
        other, how = problem.solve(weights, there, priors=priors, max_evaluations=NEAR)
    except (FitError, RobotError):
        return solver, ended
    before, after = solver.result(), other.result()
    variance = before["cost"] / max(before["rows"] - before["rank"], 1)
    # where the cost jumps, a minimum may lie a little above the point beside the wall
    better = after["cost"] <= before["cost"] + (variance if reached(how, after) else 0.0)
    return (other, how) if better else (solver, ended)
