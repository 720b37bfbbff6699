"""Several set-ups of one instrument in a run: a tracker that was moved between sessions sees one robot from as many
places. What earlier ones read is brought into the axes of the last, by the registration of each to the drawing; what
that leaves of their poses is six numbers each, with columns in their own rows alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..base.figures import listed
from ..base.types import Bools, Floats
from ..data import Measurements
from ..data.columns import SETUP
from ..data.set_up import JoinedSetUp, Triple
from ..errors import FitError
from .effect import Effect
from .rows import EffectRows, handed_on_run
from .sensor_pose import POSE, SHIFTS, Registered, as_places, left_jacobian, rotation_matrix

#: How the name of a set-up begins among parameters.
SETUP_PREFIX = f"{SETUP}="
#: A turn by so little, rad, moves no coordinate into another.
_NO_TURN = 1e-9
#: A mirror is one where it leaves less than this part of what is left without.
_MIRRORED = 0.1


# -- The numbers of a set-up ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class InSetUp:
    """What the pose of a set-up adds to its readings: they are turned about ``middle_mm``, then shifted."""

    name: str
    middle_mm: Triple

    def __call__(self, rows: EffectRows, p: Any) -> Floats:
        """(n, m) mm."""
        mine, at, turn = self._seen(rows, p)
        out = np.zeros_like(rows.position)
        off = at @ rotation_matrix(turn).T - at + [getattr(p, name[7:], 0.0) for name in SHIFTS]
        out[mine] = off[:, : out.shape[1]]
        return out

    def derivative(self, rows: EffectRows, p: Any) -> Floats:
        """(n, m, k) by the numbers that are free, in their order."""
        mine, at, turn = self._seen(rows, p)
        size, names = rows.position.shape[1], list(vars(p))
        by_turn = np.cross(left_jacobian(turn)[None], (at @ rotation_matrix(turn).T)[:, None, :], axisa=1)
        by = np.concatenate([by_turn.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (len(at), 3, 3))], axis=2)
        out = np.zeros((len(rows), size, len(names)))
        out[mine] = by[:, :size, [POSE.index(f"sensor_{name}") for name in names]]
        return out

    def _seen(self, rows: EffectRows, p: Any) -> tuple[Bools, Floats, Floats]:
        """Rows of this set-up, where they are seen from its middle (k, 3), and the turn (3,)."""
        names = handed_on_run(rows).set_up
        mine = np.zeros(len(rows), dtype=bool) if names is None else np.asarray(names == self.name)
        at = np.zeros((int(mine.sum()), 3))
        # what the model cannot compute says its row elsewhere
        at[:, : rows.position.shape[1]] = np.nan_to_num(rows.position[mine])
        turn = np.array([getattr(p, f"turn_{axis}", 0.0) for axis in "xyz"])
        return mine, at - self.middle_mm, turn


def effect_of(model: Any, one: JoinedSetUp) -> Effect:
    """The numbers of a set-up that are free, or known, as an effect of its rows. What is known of the pose of each of
    two set-ups is known of where one stands from the other with the variance of both."""
    made = [
        replace(p, name=p.name.removeprefix("sensor_"), size=p.size * 2**0.5 if p.known else p.size)
        for p in model.bare if p.name in POSE
    ]  # fmt: skip
    function = InSetUp(one.name, one.middle_mm)
    return Effect(
        name=f"{SETUP_PREFIX}{one.name}", link="sensor", parameters=tuple(made), function=function,
        derivative=function.derivative, physics="The instrument stood elsewhere in this set-up.",
    )  # fmt: skip


# -- All readings as the last set-up would have shown them ------------------------------------------------------------


def seen_from_the_last(model: Any, data: Measurements) -> Measurements:
    """The rows as the set-up that is last would have shown them; as they are where there is one set-up, or the robot's
    file holds the pose.

    Raises :class:`~sherkit.errors.FitError` for a set-up whose rows are too few to tell where the instrument stood,
    and for readings that are no places.
    """
    if data.set_up is None or data.set_ups or not {*POSE} & {p.name for p in model.bare}:
        return data
    used = np.asarray(data.used[:, : data.coordinates].any(axis=1))
    names = [str(one) for one in dict.fromkeys(data.set_up[used].tolist())]
    last = data.select(np.flatnonzero(used)).last_set_up if used.any() else ""
    if len(names) < 2:
        return data
    if not model.reads_places(data):
        raise FitError(
            f"{data.source}: column 'setup': the places of an instrument are told apart where it reads places (x, y, z "
            f"in mm); of {', '.join(data.layout.coordinates)} give the rows of each set-up a run of its own"
        )
    where = {name: used & np.asarray(data.set_up == name) for name in names}
    frames = _registered(model, data, where) if model.stands_anywhere else None
    if frames is None:
        frames = {name: (np.eye(3), _shifted(model, data, rows)) for name, rows in where.items()}
    to_turn, to_shift = frames[last]
    made, readings, variances = [], data.readings.copy(), np.square(np.stack([data.sigma, data.pose_sigma]))
    for name in names:
        if name == last:
            continue
        turn = to_turn @ frames[name][0].T
        shift = to_shift - turn @ frames[name][1]
        rows = np.flatnonzero(data.set_up == name)
        _require_whole(data, rows, turn, name)
        size = data.coordinates
        readings[rows, :size] = np.where(
            data.taken[rows, :size], (as_places(data.readings[rows, :size]) @ turn.T + shift)[:, :size], 0.0
        )
        square = np.square(turn[:size, :size]).T
        variances[:, rows, :size] = variances[:, rows, :size] @ square
        middle = as_places(readings[rows[used[rows]], :size]).mean(axis=0)
        made.append(JoinedSetUp(name, last, _rows_of(turn), _triple(shift), _triple(middle)))
    sigma, pose_sigma = np.sqrt(variances)
    return replace(data, readings=readings, sigma=sigma, pose_sigma=pose_sigma, set_ups=tuple(made))


def _registered(model: Any, data: Measurements, where: dict[str, Bools]) -> dict[str, tuple[Floats, Floats]] | None:
    """From the base to each set-up, by the drawing: a turn (3, 3) and a shift (3,); None where no two coordinates are
    read together, as heights alone. Columns that are exchanged mirror what all set-ups saw: so do then all turns."""
    axes = np.flatnonzero(data.used[:, : data.coordinates].any(axis=0))
    size = len(axes)
    if size < 2 or axes.tolist() != list(range(size)):
        return None
    read = data.layout.coordinates[:size]
    every = {name: np.flatnonzero(rows & data.taken[:, :size].all(axis=1)) for name, rows in where.items()}
    found: dict[bool, dict[str, Registered]] = {}
    missed = {False: 0.0, True: 0.0}
    for mirrored in missed:
        for name, rows in every.items():
            one = model.registered(data.select(rows), size, mirrored=mirrored) if len(rows) else None
            if one is None:
                raise FitError(
                    f"{data.source}: setup '{name}' has {len(rows)} rows with {listed(read)}: these do not tell where "
                    "the instrument stood (four or more, at poses that are not in a line); measure more poses in it, "
                    "or leave its rows out (outlier = 1)"
                )
            found.setdefault(mirrored, {})[name] = one
            missed[mirrored] += one.missed_mm * len(rows)
    best = found[missed[True] < _MIRRORED * missed[False]]
    return {name: (one.turn, one.shift_mm) for name, one in best.items()}


def _shifted(model: Any, data: Measurements, rows: Bools) -> Floats:
    """By how much the readings of a set-up are shifted (3,) along the axes in which that is free: the middle one."""
    shown, reached = model.drawn(data)
    out = np.zeros(3)
    for k, name in enumerate(SHIFTS[: data.coordinates]):
        use = rows & data.taken[:, k] & reached
        if name in model.free_of_pose and use.any():
            out[k] = float(np.median(data.readings[use, k] - shown[use, k]))
    return out


def _require_whole(data: Measurements, rows: Any, turn: Floats, name: str) -> None:
    """Refuses a row with some of its coordinates where what is turned needs all of them."""
    size = data.coordinates
    read = data.used[:, :size].any(axis=0)
    part = data.used[rows][:, :size][:, read]
    torn = rows[part.any(axis=1) & ~part.all(axis=1)]
    if len(torn) and not np.allclose(turn, np.eye(3), rtol=0, atol=_NO_TURN):
        raise FitError(
            f"{data.place(torn)}: setup '{name}': one coordinate says nothing once the instrument was turned; give all "
            "that were read, or leave the row out (outlier = 1)"
        )


def _triple(values: Floats) -> Triple:
    x, y, z = values.tolist()
    return (x, y, z)


def _rows_of(turn: Floats) -> tuple[Triple, Triple, Triple]:
    x, y, z = (_triple(row) for row in turn)
    return (x, y, z)
