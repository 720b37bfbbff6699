"""Blocks of what is tried: of effects, and of generic shapes, as which a residual may look when no effect of the
catalogue is behind it.

Shapes say whether something is left, and describe it; they never compete for the name of a cause.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from sherkit._core import play

from ..base.types import Floats
from .linearised import Linearised
from .made import CYCLIC, Maker, Piece, distinguishable_waves, wave_table, waves_along, waves_in_time, waves_over_place
from .run import unit

# -- Effects -----------------------------------------------------------------------------------------------------------
# Blocks of effects: those of the catalogue and the user's own, at every setting that is searched for.

#: Time constants that are tried, each half of the one before, and the fewest readings in one of them.
_LAGS, _READINGS_BEHIND = 8, 4.0


def blocks_of_effects(made: Maker) -> None:
    """Adds a block for each effect that can be tried, and for each setting of those that have one."""
    view = made.view
    every = view.effects_in(view.whole)
    for effect, at in view.effects:
        made.add("effect", (), [made.whole(every[:, :, at])], effect=effect)
    moments = made.moments
    after = np.stack([made.since(moment) for moment in moments], axis=1) if moments else np.zeros((len(view), 0))
    for effect, place in view.in_time:
        if not moments:
            continue
        # a step of each reading, or of the columns of the effect
        carriers = np.ones((len(view), 1)) if place is None else every[:, :, place]
        wide = view.axes if place is None else carriers.shape[-1]
        part = made.part(after, carriers)
        for k, moment in enumerate(moments):
            made.add("effect", (), [(part, k * wide + np.arange(wide))], effect=effect, setting=moment)
    for effect, behind in view.lagging:
        for lag in lags_of(made.like):
            made.add("effect", (), [made.whole(behind(lag)(view.whole))], effect=effect, setting=lag)
    # a period that the robot file declares may be wrong
    for effect, _ in view.periodic:
        names = view.waving(effect)
        reach = max(float(np.ptp(made.like.stood[name])) for name in names)
        if not reach > 0:
            continue
        counts = max((waves_along(made.like.stood[name], CYCLIC) for name in names), key=len)
        parts = [made.waves_of(name, 2.0 * np.pi * view.stood[name] / reach, counts) for name in names]
        for k, count in enumerate(counts.tolist()):
            pieces: list[Piece] = [(part, np.array([k, len(counts) + k])) for part in parts]
            made.add("effect", (), pieces, effect=effect, setting=reach / count)


def lags_of(view: Linearised) -> list[float]:
    """Time constants, s, that are tried, from the length of the run to a few readings: what is slower goes by what the
    temperature has summed up to; what is quicker has followed."""
    if view.time is None:
        return []
    length = float(np.ptp(view.time))
    least = max(_READINGS_BEHIND * length / len(view), length / 2.0**_LAGS)
    return [float(lag) for lag in length / 2.0 ** np.arange(_LAGS) if lag >= least]


def stepped(columns: Floats, cut: int) -> Floats:
    """Columns (n, m, k) from a row on."""
    return np.where((np.arange(len(columns)) >= cut)[:, None, None], columns, 0.0)


# -- Shapes ------------------------------------------------------------------------------------------------------------

#: Order of polynomials, and the fewest different values of a variable that has a shape, or waves.
_ORDERS, _FEWEST, _FEWEST_FOR_WAVES, _FEWEST_ALONG = 3, 2, 5, 9
#: Time constants of what dies away, in parts of the run; widths of play, in the unit of the joint.
_DYING, _PLAY = (0.06, 0.12, 0.25, 0.5), (0.02, 0.1, 0.5, 2.0)
#: Places, over a joint's range of -1 … 1, from which on its error may have another slope, or about which it may have
#: a bump, and how wide that is.
_PLACES, _WIDE = tuple(np.linspace(-0.75, 0.75, 13).tolist()), (0.12, 0.18, 0.26, 0.37, 0.53)
#: Waves in time that are also looked for on one axis alone: up to so many over the run.
_ON_ONE_AXIS = 12.0


def blocks_of_shapes(made: Maker) -> None:
    """Adds slopes, curves, waves, products, play and steps of every variable of the rows, which
    :attr:`~.linearised.Linearised.variables` has, and what differs in every other row."""
    view = made.view
    count = {name: len(np.unique(made.like.variables[name])) for name in view.variables if name in made.like.variables}
    u = {name: made.unit(name) for name in count if count[name] >= _FEWEST}
    # errors of joints are of where these stood at each end of a row
    count |= {name: len(np.unique(made.like.stood[name])) for name in view.pattern_of}
    joints = {
        name: made.unit(name, at_ends=True) for name in view.pattern_of if view.patterns and count[name] >= _FEWEST
    }
    poses = [name for name in u if name in joints or name in view.place]
    for name in dict.fromkeys([*u, *joints]):
        _smooth(made, name, u.get(name), joints.get(name), min(_ORDERS, count[name] - 1))
    if "time_s" in u:
        _in_time(made, u)
        powers = [_power(u["time_s"], order) for order in range(1, _ORDERS + 1)]
        powers = [np.tile(power, view.ends) for power in powers]
        for name in joints if made.reference is None else ():
            # a motor that warms up moves its own joint
            made.add("smooth", ("time_s",), [made.along(name, one) for one in powers], order=_ORDERS, pattern=name)
    for name in dict.fromkeys([*poses, *joints]):
        if name in joints:
            if count[name] >= _FEWEST_ALONG:
                _along(made, name, joints[name])
                _kinks_and_bumps(made, name, joints[name])
        elif count[name] >= _FEWEST_FOR_WAVES:
            _over_place(made, name, u[name])
    _products(made, u, joints, poses)
    for name in joints if view.ends == 1 else ():
        _play(made, name, u[name])
    if made.reference is None:
        for name, values in view.way.items():
            made.on_axes("smooth", (name,), [made.function(unit(values))], order=1)
        fit = made.run.of
        if fit is not None and not fit.data.series.any():
            every_other = fit.data.order[made.run.rows] % 2
            made.on_axes("alternating", ("row",), [made.function(2.0 * every_other - 1.0)])
    for moment in made.moments:
        step = made.function(made.since(moment))
        made.on_axes("step", ("time_s",), [step], each=False, setting=moment)


def _smooth(made: Maker, name: str, t: Floats | None, of_joint: Floats | None, orders: int) -> None:
    """Of a variable on axes, and of a joint at the ends of the rows as its error arrives."""
    if t is not None:
        functions = [made.function(_power(t, order)) for order in range(1, orders + 1)]
        made.on_axes("smooth", (name,), functions[:1], order=1)
        if orders > 1:
            made.on_axes("smooth", (name,), functions, order=orders)
    if of_joint is not None and orders > 1:
        pieces = [made.along(name, _power(of_joint, order)) for order in range(1, orders + 1)]
        made.add("smooth", (name,), pieces, order=orders, pattern=name)


def _in_time(made: Maker, u: Mapping[str, Floats]) -> None:
    """What dies away, and waves, by themselves and in proportion to the place."""
    view, t = made.view, u["time_s"]
    length = float(np.ptp(made.like.variables["time_s"]))
    for part in _DYING:
        dying = made.function(np.exp(-0.5 * (t + 1) / part))
        made.on_axes("smooth", ("time_s",), [dying], each=False, setting=part * length)
    counts, places = waves_in_time(), [u[name] for name in view.place if name in u]
    if made.reference is not None:
        # a run that chooses its poses goes on: what is quicker is told by place
        counts, places = counts[counts <= _ON_ONE_AXIS], []
    part = made.waves(np.pi * (t + 1), counts, np.stack([np.ones(len(t)), *places], axis=1))
    wide, m = 1 + len(places), view.axes
    for k, count in enumerate(counts.tolist()):
        both = np.array([k, len(counts) + k])
        by_itself: list[Piece] = [(part, one * wide * m + np.arange(m)) for one in both]
        made.on_axes("periodic", ("time_s",), by_itself, each=count <= _ON_ONE_AXIS, period=length / count)
        if places:
            there = both[:, None] * wide * m + np.arange(m, wide * m)
            made.add("periodic", ("time_s",), [(part, there.ravel())], period=length / count)


def _along(made: Maker, name: str, t: Floats) -> None:
    """Waves of a joint, as an error of it arrives at the readings."""
    # of a shape nobody knows a period to look for: on evenly spread values one looks like a slower one
    counts, reach = waves_along(made.like.stood[name], per_value=0.5), float(np.ptp(made.like.stood[name]))
    part = made.waves_of(name, np.pi * (t + 1), counts)
    for k, count in enumerate(counts.tolist()):
        at = np.array([k, len(counts) + k])
        made.add("periodic", (name,), [(part, at)], pattern=name, period=reach / count)


def _kinks_and_bumps(made: Maker, name: str, t: Floats) -> None:
    """Another slope of a joint's error from a place on: of scales, racks or rails in two pieces; or a bump about it: of
    a worn stretch, a dent, a rail that is not straight."""
    values = made.view.stood[name]
    half = 0.5 * float(np.ptp(values))

    def of(error: Floats) -> list[Piece]:
        # nothing elsewhere: the zero of a joint need not be in the model
        return [made.whole(made.view.arriving(name, error[:, None]))]

    for place in _PLACES if made.reference is None else ():
        at = float(values.min()) + (place + 1.0) * half
        made.add("kink", (name,), of(np.maximum(t - place, 0.0)), pattern=name, setting=at)
        for wide in _WIDE:
            bump = np.exp(-0.5 * np.square((t - place) / wide))
            made.add("bump", (name,), of(bump), pattern=name, setting=(at, wide * half))


def _over_place(made: Maker, name: str, t: Floats) -> None:
    reach, counts = float(np.ptp(made.like.variables[name])), waves_over_place()
    tried = (
        distinguishable_waves(made.view.variables[name], counts)
        if made.reference is None
        else np.ones(len(counts), dtype=bool)
    )
    table = wave_table(np.pi * (t + 1), counts)
    for k, count in zip(np.flatnonzero(tried).tolist(), counts[tried].tolist(), strict=True):
        both = [made.function(table[:, one]) for one in (k, len(counts) + k)]
        made.on_axes("periodic", (name,), both, each=False, period=reach / count)


def _products(made: Maker, u: Mapping[str, Floats], joints: Mapping[str, Floats], poses: list[str]) -> None:
    for k, a in enumerate(poses):
        for b in poses[k + 1 :]:
            if (a in joints) == (b in joints):
                made.on_axes("interaction", (a, b), [made.function(u[a] * u[b])])
    for a in u:
        for b in poses:
            if a not in poses and b not in joints:
                made.on_axes("interaction", (a, b), [made.function(u[a] * u[b])])
    for a in joints:
        for b in joints:
            if a != b:
                ta, tb = joints[a], joints[b]
                pieces = [made.along(a, one) for one in (tb, tb**2, ta * tb)]
                made.add("interaction", (a, b), pieces, pattern=a)


def _play(made: Maker, name: str, t: Floats) -> None:
    """Which way a joint came, also where that does more at one end of it, and play of several widths."""
    q = made.view.variables[name]
    step = np.sign(np.diff(q, prepend=q[:1]))
    came = step[np.maximum.accumulate(np.where(step != 0, np.arange(len(q)), 0))]
    made.on_axes("hysteretic", (name,), [made.function(came)], setting=0.0)
    made.add("hysteretic", (name,), [made.along(name, came)], pattern=name, setting=0.0)
    made.add("hysteretic", (name,), [made.along(name, one) for one in (came, came * t)], pattern=name, order=1)
    for width in _PLAY:
        behind = play_operator(q, width) - q
        if np.ptp(behind):
            made.add("hysteretic", (name,), [made.along(name, behind)], pattern=name, setting=width)


def play_operator(q: Floats, width: float) -> Floats:
    """The play operator: what follows ``q`` with a dead zone of ``width`` (Visintin, *Differential Models of
    Hysteresis*, 1994)."""
    return play(np.ascontiguousarray(q, dtype=float), width)


@dataclass(frozen=True, eq=False)
class Smooth:
    """A slope, a curve or a product of variables, as an error of a ``joint`` at the ends of the rows; where there is
    none, on an axis alone."""

    joint: str | None
    of: Callable[[], Floats]

    @property
    def values(self) -> Floats:
        """Values (n,), or (e n,), of zero mean and unit length: made when they are asked for, since a long run has much
        of them."""
        off = self.of()
        off = off - off.mean()
        return np.asarray(off / max(float(np.linalg.norm(off)), 1e-300))


def smooth_shapes(view: Linearised) -> list[Smooth]:
    """Slopes, curves and products of all variables: those on an axis alone first."""
    u = {name: unit(values) for name, values in view.variables.items() if np.ptp(values) > 0}
    joints = {name: unit(view.stood[name]) for name in view.pattern_of} if view.patterns else {}
    poses = [name for name in u if name in joints or name in view.place]
    out = [Smooth(None, partial(_power, t, order)) for t in u.values() for order in range(1, _ORDERS + 1)]
    pairs = [(a, b) for k, a in enumerate(poses) for b in poses[k + 1 :] if (a in joints) == (b in joints)]
    pairs += [(a, b) for a in u if a not in poses for b in poses if b not in joints]
    out += [Smooth(None, partial(np.multiply, u[a], u[b])) for a, b in pairs]
    out += [Smooth(a, partial(_power, t, order)) for a, t in joints.items() for order in range(1, _ORDERS + 1)]
    for a in joints:
        for b in joints:
            if a != b:
                out += [Smooth(a, partial(_power, joints[b], 1)), Smooth(a, partial(np.square, joints[b]))]
                out.append(Smooth(a, partial(np.multiply, joints[a], joints[b])))
    return out


def _power(t: Floats, order: int) -> Floats:
    """Legendre's polynomial of order 1 to 3."""
    return np.asarray((t, 1.5 * t**2 - 0.5, (2.5 * t**2 - 1.5) * t)[order - 1])
