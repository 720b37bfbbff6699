"""How well a model of plausible parameters fits rows: what a mistake of the set-up is judged by.

A free fit is no judge: base angles turn by 120° and swallow joints that were counted from another limb, and gross
errors draw it away. Here the plausible sizes are priors that a large residual cannot outvote, because all rows together
count for no more than a few readings, and the loss is Cauchy's, whose width is taken from the residuals in each round
(Holland and Welsch, "Robust regression using iteratively reweighted least-squares", 1977).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.types import Bools, Floats
from ..data import Measurements
from ..data.noise import MAD
from ..errors import SherkitError
from ..model.base import ModelWithEffects
from ..model.chain import ChainModel
from .least_squares import LeastSquaresProblem

#: As many readings as all rows together count for: their residuals are not independent where something is wrong.
COUNTED = 20.0
#: A parameter is as far from the drawing as this many plausible sizes, sd.
SIZES = 2.0
#: More rows than this say nothing new about a mistake.
_MOST_ROWS = 300
_ROUNDS = 12
#: What a model may raise where it is asked for what it was not made for.
NOT_COMPUTED = (SherkitError, ArithmeticError, LookupError, ValueError)
_EVALUATIONS = 6
#: Another round is worth its time where the misfit falls by more than this.
_WORTH = 0.2
#: Residuals are not looked at below this part of the readings' spread.
_SMALLEST = 1e-6
#: A turn of a sensor may be any.
_ANY_TURN = 10.0
#: Rows whose joints are compared with those that the robot's file gives for the same place.
_COMPARED = 12
#: What joints that the file never gives cost, so that no fit makes up for them.
_NEVER_GIVEN = 100.0


@dataclass(frozen=True, eq=False)
class Plausible:
    """A fit with plausible parameters ``values`` (p,).

    ``rms`` and ``spread`` (m,) are those of residuals and readings in each column, robust and in the unit of the
    readings; NaN where nothing was taken. ``moved`` is how far the parameters are from the drawing, as half the sum of
    squares over the plausible sizes; ``elsewhere`` the part of rows whose joints the robot's file does not give for the
    place where they are: its elbows are on the other side.
    """

    values: Floats
    rms: Floats
    spread: Floats
    moved: float
    elsewhere: float

    @property
    def relative(self) -> float:
        """RMS over the spread of the readings, geometric mean over the columns."""
        with np.errstate(invalid="ignore"):
            return float(np.exp(np.nanmean(np.log(np.maximum(self.rms / self.spread, _SMALLEST)))))

    @property
    def misfit(self) -> float:
        """The logarithm of how much less likely this is than a perfect fit of the drawing."""
        return COUNTED * float(np.log(self.relative)) + self.moved + _NEVER_GIVEN * self.elsewhere

    @property
    def rms_of_all(self) -> float:
        """RMS over all columns."""
        return float(np.sqrt(np.nanmean(self.rms**2)))

    @property
    def error(self) -> float:
        """RMS of rows, each by the length of all that is read of it."""
        return float(np.sqrt(np.nansum(self.rms**2)))


def plausible_fit(model: ModelWithEffects, data: Measurements, datum: Bools, rounds: int = _ROUNDS) -> Plausible | None:
    """The fit with plausible parameters; None where the model cannot compute the rows.

    ``datum`` (p,) tells the parameters that may be anything (:func:`may_be_anything`). One of the ``rounds`` is enough
    to see what is hopeless.
    """
    data = thinned(data)
    used = data.used
    spread = spread_of(data)
    sizes = plausible_sizes(model)
    far = [
        _ANY_TURN if p.unit == "rad" else 1e3 * (np.nanmax(spread) + np.abs(data.readings).max())
        for p in model.parameters
    ]
    freed = np.where(datum, far, sizes)
    counted = np.sqrt(min(1.0, COUNTED / max(int(used.sum()), 1)))
    problem = LeastSquaresProblem(model, data, counted * freed)
    values = model.start(data)
    elsewhere = part_elsewhere(model, data)
    taken = used.any(axis=0)
    smallest = _SMALLEST * np.where(taken, spread, 1.0)
    best: Plausible | None = None
    try:
        with np.errstate(all="ignore"):
            rms = robust_rms(problem.residuals(values), used, centred=bool(datum.any()))
            for _ in range(rounds):
                weights = np.where(used, 1.0 / np.maximum(np.where(taken, rms, 1.0), smallest), 0.0)
                solver, _ = problem.solve(weights, values, priors=True, loss="cauchy", max_evaluations=_EVALUATIONS)
                values = solver.trial
                rms = robust_rms(problem.residuals(values), used)
                now = Plausible(values, rms, spread, moved_by(values, sizes, datum), elsewhere)
                if not np.isfinite(rms[taken]).all() or (best is not None and now.misfit > best.misfit - _WORTH):
                    break
                best = now
    except NOT_COMPUTED:
        return best
    return best


def as_fitted(model: ModelWithEffects, data: Measurements, values: Floats) -> Plausible:
    """Any fit, judged in the same way, as if its zeros had to be plausible too, but for where a sensor stands that may
    stand anywhere, and where targets sit. Raises as the model's ``predict``."""
    data = thinned(data)
    rms = robust_rms(data.readings - model.predict(data, values), data.used)
    datum = of_set_up(model)
    return Plausible(
        values, rms, spread_of(data), moved_by(values, plausible_sizes(model), datum), part_elsewhere(model, data)
    )


def plausible_sizes(model: ModelWithEffects) -> Floats:
    """How far a parameter may be from the drawing (p,), sd."""
    return SIZES * np.array([p.size for p in model.parameters])


def moved_by(values: Floats, sizes: Floats, datum: Bools) -> float:
    """Half the sum of squares of the parameters over ``sizes``, those that only shift readings left out."""
    return 0.5 * float(((values / sizes)[~datum] ** 2).sum())


def of_set_up(model: ModelWithEffects) -> Bools:
    """Parameters (p,) of the pose of a sensor that may stand anywhere, and of where the targets sit on the tool."""
    anywhere = {*model.stands_anywhere, *model.targets_anywhere}
    return np.array([p.name in anywhere for p in model.parameters], dtype=bool)


def may_be_anything(model: ModelWithEffects, data: Measurements) -> Bools:
    """Parameters (p,) that may be anything: where a sensor stands that is free, where targets sit, and those whose
    derivative is the same in every row, zeros of an instrument.

    Raises as the model's ``derivatives``.
    """
    data = thinned(data)
    columns = model.derivatives(data, np.zeros(len(model.parameters)))
    used = data.used[:, :, None]
    high = np.max(columns, axis=0, initial=-np.inf, where=used)
    low = np.min(columns, axis=0, initial=np.inf, where=used)
    taken = used.any(axis=0)
    with np.errstate(invalid="ignore"):
        same = (high - low <= 1e-9 * np.abs(high)) | ~taken
    return of_set_up(model) | np.asarray(same.all(axis=0) & (taken & (np.abs(high) > 0)).any(axis=0))


def thinned(data: Measurements, most: int = _MOST_ROWS) -> Measurements:
    """Rows enough to see a mistake, at ``most`` so many, spread over the run."""
    if len(data) <= most:
        return data
    return data.select(np.unique(np.linspace(0, len(data) - 1, most).astype(np.int64)))


def robust_rms(left: Floats, used: Bools, *, centred: bool = False) -> Floats:
    """RMS (m,) of most residuals (n, m), by the median; NaN where nothing was taken."""
    out = np.full(left.shape[1], np.nan)
    for k in range(left.shape[1]):
        u = left[used[:, k], k]
        if len(u):
            out[k] = MAD * float(np.median(np.abs(u - np.median(u) if centred else u)))
    return out


def spread_of(data: Measurements) -> Floats:
    """How far each reading moves (m,), robust; NaN where nothing was taken."""
    out = np.full(data.readings.shape[1], np.nan)
    for k in range(len(out)):
        u = data.readings[data.used[:, k], k]
        if len(u):
            low, high = np.percentile(u, [15.0, 85.0])
            out[k] = (high - low) / 2.0
    most = float(np.nanmax(out))
    return np.maximum(out, _SMALLEST * most if most > 0 else 1.0)


def part_elsewhere(model: ModelWithEffects, data: Measurements) -> float:
    """The part of rows whose joints are not those that the robot's file gives for the same place; zero where the robot
    is not known or its file leaves open which joints it takes."""
    robot = model.robot
    if not isinstance(model, ChainModel) or not model.one_posture:
        return 0.0
    rows = np.unique(np.linspace(0, len(data) - 1, _COMPARED).astype(np.int64))
    joints, places = [], []
    for row in rows:
        try:
            places.append(robot.forward(data.joints[row]))
        except SherkitError:
            continue
        joints.append(data.joints[row])
    if not places:
        return 0.0
    back = robot.inverse_batch(np.array(places))
    off = np.abs(back.values - np.array(joints))
    if robot.joint_unit == "rad":
        off = np.abs((off + np.pi) % (2 * np.pi) - np.pi)
    # a hundredth of a turn or a millimetre is another branch, not rounding
    return float(((off > 0.01).any(axis=1) & back.reached).mean())
