"""Whether rows can vouch that nothing is wrong: only where something was looked at.

First what a run says by itself (:func:`silence`): joints that stand still, readings that do not change, fewer places
than unknowns. Then the power (:func:`power_of`): how often an error of a given size, at the places where the robot
works, made by any of the candidates, would have raised the alarm. It is counted on draws of the Bayes factor itself,
with its unknown noise; all that a draw needs are the coordinates of the error along the candidate's columns (normal)
and the square of the rest (χ²), so that it costs the same for ten rows and for a million.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..base import linalg
from ..base.figures import listed
from ..base.types import Bools, Floats
from ..data import Measurements
from ..evidence.thresholds import NEARLY_ALWAYS, ROUNDING, SAME_PLACE, SCALES

#: An error of so many times what is required must have been seen.
TIMES = 3.0
#: Errors, in what is required, of which it is asked from which on they would have been seen.
_ERRORS = np.array([0.25, 0.35, 0.5, 0.7, 1.0, 1.5, 2.0, TIMES, 4.0, 6.0, 10.0, 20.0, 50.0, 100.0])
_DRAWS = 256
#: A reading should move where it would by more than this part of the others.
_MOVES = 1e-2


@dataclass(frozen=True)
class Silent:
    """A run that cannot speak: ``why``, and what to ``measure`` instead."""

    why: str
    measure: str

    def __str__(self) -> str:
        return self.why


def silence(data: Measurements, axes: Sequence[int], unknown: int, predicted: Floats | None = None) -> Silent | None:
    """Why a run says nothing of its robot, by its rows alone; None where it may. ``unknown`` are the numbers that are
    to be told from it, ``predicted`` (n, m) what a model says of its readings."""
    used = data.used[:, list(axes)]
    rows = used.any(axis=1)
    if not rows.any():
        return Silent("none of its rows is used", "measure it again")
    joints = data.joints[rows]
    # of a machine without joints each row is a moment of its own
    moves = joints.shape[1] > 0
    if moves and still(joints).all():
        one = data.pose is not None and len(np.unique(data.pose[rows])) == 1
        what = f"all of its {len(joints)} rows are at one place" if one else "its encoders do not move"
        return Silent(what, "measure at a dozen places or more, over the whole workspace, with the joints read at each")
    stuck = _stuck(data, axes, used, predicted)
    if stuck:
        verb = "does" if len(stuck) == 1 else "do"
        why = f"its {listed(stuck)} {verb} not change while the joints move"
        return Silent(why, "look at the sensor, and measure again")
    grid = SAME_PLACE * np.maximum(np.ptp(joints, axis=0), 1e-300)
    places = len(np.unique(np.round((joints - joints.min(axis=0)) / grid), axis=0)) if moves else len(joints)
    if places * len(axes) <= unknown:
        return Silent(
            f"its {len(joints)} rows are at {places} place{'s' if places > 1 else ''}, which cannot tell {unknown} "
            f"unknown numbers", "measure at a dozen places or more, over the whole workspace",
        )  # fmt: skip
    return None


def still(values: Floats) -> Bools:
    """Which columns (k,) of values (n, k) are the same in all rows."""
    return np.asarray(np.ptp(values, axis=0) <= ROUNDING * np.maximum(np.abs(values).max(axis=0), 1.0))


def _stuck(data: Measurements, axes: Sequence[int], used: Bools, predicted: Floats | None) -> list[str]:
    """Readings that never change, although they should."""
    spread = [
        np.inf if predicted is None else float(np.ptp(predicted[used[:, k], a])) if used[:, k].any() else 0.0
        for k, a in enumerate(axes)
    ]
    return [
        data.layout.readings[a] for k, a in enumerate(axes)
        if used[:, k].sum() > 1 and still(data.readings[used[:, k], a][:, None])[0]
        and (predicted is None or spread[k] > _MOVES * max(spread) > 0)
    ]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Sight:
    """What rows see of one candidate: its columns ``left`` (N, k) by what else is free, over the noise of a reading,
    on how many readings it acts, its share of the ``weight``, and ``there`` (k, k): the mean square of the error that
    it makes where the robot works."""

    left: Floats
    acts: int
    weight: float
    there: Floats

    def chances(self, errors: Floats, free: int, alarm: float) -> Floats:
        """How often errors (e,), root mean squares where the robot works, raise the alarm, a logarithm, beside the
        noise of ``free`` readings; directions at random."""
        squares = self.left.T @ self.left
        width = len(squares)
        if free <= width or not np.trace(squares) > 0:
            return np.zeros(len(errors))
        rng = np.random.default_rng(0)
        value, vector = linalg.eigh(squares)
        value = value.clip(0.0)
        ways = rng.normal(size=(_DRAWS, width))
        ways = ways / np.sqrt(np.einsum("di,ij,dj->d", ways, self.there, ways).clip(1e-300))[:, None]
        along = errors[:, None, None] * (ways @ vector * np.sqrt(value)) + rng.normal(size=ways.shape)
        whole = np.square(along).sum(axis=2) + rng.chisquare(free - width, _DRAWS)
        # as evidence has them: a coefficient of one leaves a root mean square of one where it acts
        value = value * self.acts / value.sum()
        each = []
        for size in SCALES.tolist():
            taken = (np.square(along) * (size**2 * value / (1.0 + size**2 * value))).sum(axis=2) / whole
            each.append(-0.5 * np.log1p(size**2 * value).sum() - 0.5 * free * np.log1p(-taken.clip(0.0, 1.0 - 1e-12)))
        top = np.max(each, axis=0)
        found = top + np.log(np.mean(np.exp(each - top), axis=0)) + np.log(self.weight)
        return np.asarray((found >= alarm).mean(axis=1))


@dataclass(frozen=True)
class Power:
    """How often an error of :data:`TIMES` what is ``required`` would have been seen: of each candidate (``chances``)
    and over all of them alike (``chance``), and the ``smallest`` error that would be in 95 of 100 cases, over
    all of them (infinite where none)."""

    required: float
    chances: Mapping[str, float]
    chance: float
    smallest: float

    @property
    def speaks(self) -> bool:
        """Whether silence of these rows says something."""
        return self.chance >= NEARLY_ALWAYS


def power_of(sights: Mapping[str, Sight], required: float, free: int, alarm: float) -> Power:
    """The power of rows to see an error, of any of the candidates alike."""
    if not sights or not required > 0:
        return Power(required, {}, 0.0, float("inf"))
    chances = {name: one.chances(required * _ERRORS, free, alarm) for name, one in sights.items()}
    mean = np.mean(list(chances.values()), axis=0)
    at, enough = int(np.argmin(np.abs(_ERRORS - TIMES))), mean >= NEARLY_ALWAYS
    smallest = float(required * _ERRORS[np.argmax(enough)]) if enough.any() else float("inf")
    return Power(required, {name: float(one[at]) for name, one in chances.items()}, float(mean[at]), smallest)
