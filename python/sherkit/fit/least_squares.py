"""A fit's rows as the solver takes them: by the core where the model is compiled throughout, else from NumPy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

import sherkit._core as _core

from ..base.types import Floats
from ..data import Measurements
from ..data.noise import MAD
from ..errors import FitError, RobotError
from ..model.base import ModelWithEffects
from ..model.chain import ChainModel

# -- The iteration of a fit whose rows come from Python -------------------------------------------------------------

#: Part of the variance of the noise that is not worth a step: it would go by a tenth of a deviation.
_NOTHING = 1e-2
#: So many steps that leave what the model can compute say that it ends on the way to the minimum.
_EDGE = 12


def iterate(solver: _core.Solver, feed: Callable[[Floats], None]) -> str:
    """Runs the solver to its end and says which: ``converged`` or ``exhausted``.

    ``feed`` gives the solver every row at the parameters asked for. A step that leaves what the model can compute
    (:class:`~sherkit.errors.FitError`, or :class:`~sherkit.errors.RobotError` where it leaves no robot) is damped,
    until there were a dozen; where the start does already, the error is raised.
    """
    evaluations, outside, over = 0, 0, ""
    while True:
        solver.clear()
        if over:
            # the solver goes back to where it stands by finding no further step
            solver.fail()
        else:
            try:
                feed(solver.trial)
            except (FitError, RobotError):
                if not evaluations:
                    raise
                solver.fail()
                outside += 1
        evaluations += 1
        ended = solver.advance()
        if ended != "evaluate":
            return over or ended
        if outside >= _EDGE:
            over = "exhausted"


def reached(ended: str, result: Mapping[str, Any]) -> bool:
    """Whether a solver that ``ended`` so stands at the minimum, by its ``result``.

    Along a combination that the rows hardly tell, steps stay long however small their use, and the curvature of the
    rows makes them miss: there it is enough that next to nothing is left to gain.
    """
    variance = result["cost"] / max(result["rows"] - result["rank"], 1)
    return ended == "converged" or bool(result["to_gain"] <= _NOTHING * variance)


# -- Robust losses --------------------------------------------------------------------------------------------------

LOSSES = ("linear", "huber", "cauchy", "tukey")


def spread(residuals: Floats, weights: Floats) -> Floats:
    """Robust spread of the weighted residuals (n, m), one per reading column, (m,)."""
    u = residuals * weights
    out = np.ones(weights.shape[1])
    for k in range(weights.shape[1]):
        used = weights[:, k] > 0
        if used.any():
            mad = MAD * float(np.median(np.abs(u[used, k])))
            out[k] = mad if mad > 0 else 1.0
    return out


def scale(residuals: Floats, weights: Floats, rank: int, loss: str) -> float:
    """Ratio of the residuals (n, m) to the assumed noise, by which the deviations grow.

    With a robust loss, Huber's correction (Huber and Ronchetti, *Robust Statistics*, Eq. 7.81).
    """
    u = (residuals * weights)[weights > 0]
    free = len(u) - rank
    if free <= 0:
        return 1.0
    if loss == "linear":
        return float(np.sqrt((u**2).sum() / free))
    wide = np.broadcast_to(spread(residuals, weights), weights.shape)[weights > 0]
    psi, slope = _influence(u / wide, loss)
    mean_slope = float(slope.mean())
    if mean_slope <= 0:
        return float(np.sqrt((u**2).sum() / free))
    correction = 1 + rank / len(u) * float(slope.var()) / mean_slope**2
    return float(correction * np.sqrt(((psi * wide) ** 2).sum() / free) / mean_slope)


def _influence(u: Floats, loss: str) -> tuple[Floats, Floats]:
    """ψ and ψ' of the losses, with the constants of the core."""
    if loss == "huber":
        inside = np.abs(u) <= 1.345
        return np.clip(u, -1.345, 1.345), inside.astype(float)
    if loss == "cauchy":
        t = (u / 2.385) ** 2
        return u / (1 + t), (1 - t) / (1 + t) ** 2
    t = np.minimum((u / 4.685) ** 2, 1.0)
    return u * (1 - t) ** 2, np.where(t < 1, (1 - t) * (1 - 5 * t), 0.0)


# -- The rows --------------------------------------------------------------------------------------------------------


class LeastSquaresProblem:
    """A model and rows: what the solver is asked, by the core where the model is compiled throughout.

    ``sizes`` (p,) are the plausible sizes of the parameters, unless others are given.
    """

    def __init__(self, model: ModelWithEffects, data: Measurements, sizes: Floats | None = None) -> None:
        self.model = model
        self.data = data
        self.sizes = np.array([p.size for p in model.parameters]) if sizes is None else sizes
        self._last: tuple[Floats, Floats] | None = None

    def predicted(self, values: Floats) -> Floats:
        """Predicted readings (n, m); those asked for last are remembered."""
        if self._last is None or not np.array_equal(self._last[0], values):
            self._last = values.copy(), self.model.predict(self.data, values)
        return self._last[1]

    def residuals(self, values: Floats) -> Floats:
        """Measured minus predicted (n, m)."""
        return self.data.readings - self.predicted(values)

    def solve(
        self, weights: Floats, start: Floats, *, priors: bool = False, linear: bool = False, **settings: Any
    ) -> tuple[_core.Solver, str]:
        """The minimum from ``start``, and whether it was reached; with ``priors`` all plausible sizes are known."""
        model, data = self.model, self.data
        known = model.known(drawn=priors)
        solver = _core.Solver(start, self.sizes, single_step=linear, known=known, **settings)
        inside = model.in_sockets(data)
        if isinstance(model, ChainModel) and not (model.own or model.relations or inside):
            return solver, model.solve(solver, data, weights)
        names, lengths = [p.name for p in model.parameters], weights.copy()
        if inside:
            lengths[inside.rows] = 0.0

        def feed(values: Floats) -> None:
            push(solver, model, data, lengths, values)
            if inside:
                off, columns = inside.at(values)
                # each of three directions has a third of the square of a length
                each = np.repeat(np.sqrt(3.0) * weights[inside.rows, -1:], 3, axis=1)
                solver.push(np.ascontiguousarray(columns), -off, each)
            for one in model.relations:
                columns, missing = one.row(names, values)
                solver.push(columns[None, None, :], np.array([[missing]]), np.array([[1.0 / one.sd_mm]]))
            solver.push_priors()

        return solver, iterate(solver, feed)

    def information(self, weights: Floats, values: Floats, *, priors: bool = False) -> dict[str, Any]:
        """What the readings say at ``values``; with ``priors`` the plausible sizes too."""
        return self.solve(weights, values, priors=priors, max_evaluations=1)[0].result()


def push(solver: _core.Solver, model: ModelWithEffects, data: Measurements, weights: Floats, values: Floats) -> None:
    """Gives the solver these rows as a model in NumPy has them. Raises as the model's ``predict``."""
    left = np.where(weights > 0, data.readings - model.predict(data, values), 0.0)
    solver.push(np.ascontiguousarray(model.derivatives(data, values)), left, weights)


# -- The way to the minimum --------------------------------------------------------------------------------------------
# The way to the minimum of a fit: where it begins, by how much noise is larger than assumed, and past small steps
# of a cost that is not smooth.

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
