"""One run of a machine as the model of another sees it: where its sensor stands, its noise, its wrong rows, and columns
of everything that may change.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
import scipy

from ..base import linalg
from ..base.figures import sized
from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..data.columns import TEMPERATURE, bare, unit_in
from ..data.noise import MAD
from ..errors import FitError, SherkitError
from ..evidence.thresholds import FAR_SIGMA, ROUNDS
from ..evidence.whitening import correlation_in_time, orthonormal
from ..model.base import ModelWithEffects
from ..model.effect import Effect, freeing
from ..model.sensor_pose import POSE, rotation_matrix
from ..model.set_ups import SETUP_PREFIX

# -- Where the sensor stands -------------------------------------------------------------------------------------------
# Where the sensor stands: what may differ from run to run and is no change of the robot.
#
# A tracker or a stage of lasers that was stationed anew shows every place turned and shifted: found by the best
# turn of one cloud of points onto the other (Kabsch, 1976). A camera that was moved is found by its pose. Of other
# readings the zero is free.

#: Multiple of the median from which on rows are left out of the turn.
_FAR = 5.0


@dataclass(frozen=True, eq=False)
class RunPose:
    """How a run is seen: its ``residual`` (n, m) to the model once the sensor is where it stands, the ``columns``
    (n, m, s) of what is left to move it by, and how far it was moved, by name with its unit. The model has its
    ``values`` there; ``axes`` (m, m) turns what is seen in those of the model into what the sensor sees."""

    residual: Floats
    columns: Floats
    moved: dict[str, float]
    values: Floats
    axes: Floats | None = None

    def in_model(self, columns: Floats) -> Floats:
        """Columns (n, m, k) of what the sensor sees, in the axes of the model."""
        return columns if self.axes is None else np.einsum("ij,nik->njk", self.axes, columns)


def moved_in_words(moved: Mapping[str, float]) -> str:
    """How far the sensor of a run was moved, as :class:`RunPose` has it."""
    return ", ".join(f"{name.rpartition('_')[0]} {sized(by, unit_in(name))}" for name, by in moved.items())


def stand_of(
    model: ModelWithEffects,
    data: Measurements,
    values: Floats,
    axes: tuple[int, ...],
    used: Bools,
    corrected: Floats | None = None,
) -> RunPose:
    """The stand from which these rows were read, of a model at these values, ``corrected`` by so much (n, m). Raises
    :class:`~sherkit.errors.FitError` for rows that are too few to tell it."""
    by = np.zeros(used.shape) if corrected is None else corrected
    if len(parts := _set_ups(data)) > 1:
        stands = [stand_of(model, data.select(rows), values, axes, used[rows], by[rows]) for rows in parts]
        return _each(parts, stands, used, values)
    chosen = list(axes)
    names = [data.layout.readings[a] for a in axes]
    at = [k for k, p in enumerate(model.parameters) if p.name in POSE]
    if len(axes) == 3 and all(unit_in(name) == "mm" for name in names):
        if used.all(axis=1).sum() < 4:
            raise FitError(f"{data.source}: expected four rows or more with all of {', '.join(names)}")
        return _rigid(model, data, values, chosen, used, by, at if len(at) == len(POSE) else [])
    predicted = model.predict(data, values)[:, chosen] + by
    seen = np.where(used, data.readings[:, chosen], predicted)
    if at:
        return _camera(model, data, values, chosen, seen, used, at)
    zero = np.array(
        [np.median((seen - predicted)[used[:, k], k]) if used[:, k].any() else 0.0 for k in range(len(axes))]
    )
    columns = np.broadcast_to(np.eye(len(axes)), (len(seen), len(axes), len(axes))).copy()
    moved = {f"zero_{bare(name)}_{unit_in(name)}": float(v) for name, v in zip(names, zero, strict=True)}
    return RunPose(np.where(used, seen - predicted - zero, 0.0), columns, moved, values)


def _set_ups(data: Measurements) -> list[Ints]:
    """The rows of each set-up of the instrument, the last in the end; all of them where there is one."""
    if data.set_up is None:
        return [np.arange(len(data))]
    every = [str(one) for one in dict.fromkeys(data.set_up.tolist()) if one != data.last_set_up]
    return [np.flatnonzero(data.set_up == name) for name in (*every, data.last_set_up)]


def _each(parts: Sequence[Ints], stands: Sequence[RunPose], used: Bools, values: Floats) -> RunPose:
    """The stands of set-ups as one: each moves its own rows alone; how far, is said of the last."""
    residual = np.zeros(used.shape)
    columns = np.zeros((*used.shape, sum(one.columns.shape[2] for one in stands)))
    first = 0
    for rows, one in zip(parts, stands, strict=True):
        end = first + one.columns.shape[2]
        residual[rows], columns[rows, :, first:end] = one.residual, one.columns
        first = end
    return RunPose(residual, columns, stands[-1].moved, values)


def _rigid(
    model: ModelWithEffects, data: Measurements, values: Floats, axes: list[int], used: Bools, corrected: Floats,
    at: list[int],
) -> RunPose:  # fmt: skip
    """Readings turned and shifted onto what is predicted. Where the model has the sensor's pose, in its places ``at``,
    it stands there in the model: an instrument's own errors turn with it."""
    from scipy.spatial.transform import Rotation

    told: list[float] = []
    whole, ways, values = np.asarray(used.all(axis=1)), np.eye(3), np.array(values, dtype=float)
    for last in (False, True) if at else (True,):
        predicted = model.predict(data, values)[:, axes] + corrected @ ways.T
        seen = np.where(used, data.readings[:, axes], predicted)
        near = whole
        for _ in range(ROUNDS):
            middle, there = seen[near].mean(axis=0), predicted[near].mean(axis=0)
            u, _, v = linalg.svd((seen[near] - middle).T @ (predicted[near] - there))
            turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
            onto = (seen - middle) @ turn + there
            missed = np.linalg.norm(onto - predicted, axis=1)
            kept = whole & (missed <= _FAR * max(float(np.median(missed[whole])), 1e-300))
            if np.array_equal(kept, near) or kept.sum() < 4:
                break
            near = kept
        told = told or [*(middle - there), *(1e3 * Rotation.from_matrix(turn).as_rotvec())]
        if not last:
            ways = turn
            values[at[:3]] = Rotation.from_matrix(turn @ rotation_matrix(values[at[:3]])).as_rotvec()
            then = model.predict(data, values)[:, axes] + corrected @ ways.T
            values[at[3:]] += np.mean((seen - then)[near], axis=0)
    arms = (onto - there) @ ways
    turns = np.cross(np.eye(3), arms[:, None]).transpose(0, 2, 1)
    columns = np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], axis=2)
    names = [*(f"shift_{a}_mm" for a in "xyz"), *(f"turn_{a}_mrad" for a in "xyz")]
    moved = dict(zip(names, map(float, told), strict=True))
    return RunPose((onto - predicted) @ ways, columns, moved, values, ways)


def _camera(
    model: ModelWithEffects, data: Measurements, values: Floats, axes: list[int], seen: Floats, used: Bools,
    at: list[int],
) -> RunPose:  # fmt: skip
    """The pose of the camera alone, from where it stood."""
    size = np.array([model.parameters[k].size for k in at])

    def now(by: Floats) -> Floats:
        then = np.array(values, dtype=float)
        then[at] += by * size
        return then

    def columns(by: Floats) -> Floats:
        return np.asarray(model.derivatives(data, now(by))[:, axes][:, :, at])

    def left(by: Floats) -> Floats:
        try:
            return np.where(used, seen - model.predict(data, now(by))[:, axes], 0.0)
        except SherkitError:
            # the camera would not see the marker from there
            return np.full(used.shape, np.inf)

    by = scipy.optimize.least_squares(
        lambda by: left(by)[used], np.zeros(len(at)), lambda by: -columns(by)[used] * size, xtol=1e-10, ftol=1e-12
    ).x
    told = zip((model.parameters[k] for k in at), by * size, strict=True)
    moved = {f"{p.name.removeprefix('sensor_')}_{p.unit}": float(v) for p, v in told}
    return RunPose(left(by), columns(by), moved, now(by))


# -- Runs and their rows -----------------------------------------------------------------------------------------------

#: Readings beyond what is free from which a run tells its own noise, and that it follows itself.
OWN_NOISE, _OWN_COURSE = 10, 40
#: Readings of a row that tell a direction; the part up to which columns are alike; rows that show it.
_TELLS, _ALIKE, _ENOUGH = 2, 1e-2, 300
#: Parameters that say where the sensor stands, by how their names begin.
_OF_STAND = ("datum", "sensor_turn", "sensor_shift", "sensor_slip", "sensor_drift", SETUP_PREFIX)


@dataclass(frozen=True, eq=False)
class RunData:
    """One run in the order of time: rows of which all readings are ``used`` (n, m), its stand, the derivatives ``own``
    (n, m, p) by what all runs share and ``inputs`` (n, m, j) by the joints, ``columns`` (n, m, k) of candidates, the
    noise ``sigma`` that it shows by itself (zero where it is too short), whether that is of ``repeats``, how much one
    row hands on to the next, and the rows ``aside`` that are wrong."""

    data: Measurements
    used: Bools
    stand: RunPose
    own: Floats
    inputs: Floats | None
    columns: Mapping[str, Floats]
    sigma: float
    repeats: bool
    rho: float
    aside: Ints

    @property
    def rows(self) -> Ints:
        """The rows that are looked at."""
        return np.flatnonzero(self.used[:, 0])


def seen(
    model: ModelWithEffects, values: Floats, data: Measurements, axes: tuple[int, ...], shared: Sequence[str],
    candidates: Sequence[Effect], *, first: bool, before: RunData | None = None,
) -> RunData:  # fmt: skip
    """A run by a model at these values, of whose parameters all runs have the ``shared`` ones; the sensor of the
    ``first`` stands where the model has it. What is wrong and what is noise is as it was seen ``before``: beside a
    change that is none, good rows would look wrong."""
    chosen = list(axes)
    used = data.used[:, chosen] if before is None else before.used
    used = used & np.all(used, axis=1, keepdims=True)
    places = {p.name: k for k, p in enumerate(model.parameters)}

    def standing() -> RunPose:
        if not first:
            return stand_of(model, data, values, axes, used)
        left = np.where(used, data.readings[:, chosen] - model.predict(data, values)[:, chosen], 0.0)
        return RunPose(left, np.zeros((*used.shape, 0)), {}, values)

    stand = standing()
    derivatives = model.linearised(data, stand.values)
    every = stand.in_model(derivatives.parameters[:, chosen])
    columns = {
        name: stand.in_model(one) for name, one in change_columns(
            model, stand.values, data, axes, candidates, derivatives.parameters[:, chosen]
        ).items()
    }  # fmt: skip
    inputs = None if derivatives.inputs is None else stand.in_model(derivatives.inputs[:, chosen])
    own = every[:, :, [places[name] for name in shared]]
    if stand.axes is not None:
        # what is not known of where the first sensor stands is of its own axes
        pose = [k for k, name in enumerate(shared) if name in POSE]
        own[:, :, pose] = model.linearised(data, values).parameters[:, chosen][:, :, [places[shared[k]] for k in pose]]

    if before is not None:
        return RunData(data, used, stand, own, inputs, columns, before.sigma, before.repeats, before.rho, before.aside)
    aside, sigma, rho = np.zeros(0, dtype=np.int64), 0.0, 0.0
    for _ in range(ROUNDS):
        free = orthonormal(np.where(used[:, :, None], np.concatenate([every, stand.columns], axis=2), 0.0))
        flat = np.where(used, stand.residual, 0.0).reshape(-1)
        left = (flat - free @ (free.T @ flat)).reshape(used.shape)
        freedom = int(used.sum()) - free.shape[1]
        sigma = float(np.sqrt(np.square(left[used]).sum() / freedom)) if freedom >= OWN_NOISE else 0.0
        if freedom < 2 * OWN_NOISE:
            break
        if data.time_s is not None and used.all() and freedom >= _OWN_COURSE:
            rho = correlation_in_time(np.where(used, stand.residual, 0.0), free)
        lever = np.square(free).sum(axis=1).reshape(used.shape)
        each = np.where(used, np.abs(left) / np.sqrt((1.0 - lever).clip(0.05)), 0.0)
        # the worst first: what they did to the fit makes others look wrong
        limit = max(FAR_SIGMA * MAD * float(np.median(each[used])), 0.5 * float(each.max(initial=0.0)))
        wrong = np.flatnonzero((each > limit).any(axis=1))
        if not len(wrong):
            break
        aside = np.union1d(aside, wrong)
        used = used & ~np.isin(np.arange(len(used)), wrong)[:, None]
        stand = standing()
    told = noise_of_repeats(data.mark_outliers(aside), axes)
    return RunData(data, used, stand, own, inputs, columns, told or sigma, told > 0, rho, aside)


def noise_of_repeats(data: Measurements, axes: Sequence[int]) -> float:
    """The noise of a reading as repeats of poses show it: what differs between poses is none; 0 where too few do."""
    repeats = data.repeatability
    if repeats is None:
        return 0.0
    names = [data.layout.readings[a] for a in axes]
    free = np.array([repeats.degrees_of_freedom.get(name, 0) for name in names], dtype=float)
    if free.sum() < 2 * OWN_NOISE:
        return 0.0
    squares = np.array([np.nan_to_num(repeats.sigma[name]) ** 2 if name in repeats.sigma else 0.0 for name in names])
    return float(np.sqrt((free * squares).sum() / free.sum()))


# -- What may change ---------------------------------------------------------------------------------------------------


def change_candidates(model: ModelWithEffects, runs: Sequence[Measurements]) -> list[Effect]:
    """Every parameter that does not say where the sensor stands, as an effect that frees it, those of a target together
    (another tool), and every effect that does not live in time."""
    inside = {e.name: model.owns(e) for e in model.effects}
    mine = [
        p for k, p in enumerate(model.parameters)
        if not p.name.startswith(_OF_STAND) and not any(at.start <= k < at.stop for at in inside.values())
    ]  # fmt: skip
    out = [Effect(p.name, "structure", (p,), frees=True) for p in mine if p.name not in model.targets_anywhere]
    targets = groupby((p for p in mine if p.name in model.targets_anywhere), lambda p: p.name.rpartition("_")[0])
    out += [Effect(name, "structure", tuple(those), frees=True) for name, those in targets]
    for effect in (*model.effects, *model.known_effects.values(), *model.held.values()):
        if any(one.name == effect.name for one in out):
            continue
        # a moment or a delay belongs to one run; a period is the robot's
        if effect.search is not None and not (effect.is_periodic and model.setting_of(effect) is not None):
            continue
        if TEMPERATURE in effect.needs or "time_s" in effect.needs:
            continue
        if effect.name in inside or _possible(model, effect, runs):
            out.append(effect)
    return out


def held_of(model: ModelWithEffects) -> list[Effect]:
    """What the model holds at its drawing, but for where the sensor stands, each as an effect that frees it."""
    return [freeing(p) for p in model.fixed if p.name not in POSE]


def zeros_of(candidates: Sequence[Effect], columns: Mapping[str, Floats], joints: Floats) -> dict[str, list[Effect]]:
    """Of each number of a candidate, by its name in a model, the parameters that take up where it has its zero.

    A lean of a rail turns it about a height, a scale counts from a zero: which one is a convention, and in one run the
    geometry takes up any. Of what has changed since, it is a number more: no rail leans about the height of a
    convention. Columns (n, m, k) of such a number are those of a parameter times a joint reading of ``joints``
    (n, J), and some of it.
    """
    out: dict[str, list[Effect]] = {}
    if next(iter(columns.values())).shape[1] < _TELLS:
        return out
    some = slice(None, None, max(len(joints) // _ENOUGH, 1))
    columns, joints = {name: one[some] for name, one in columns.items()}, joints[some]
    numbers = [p.name for effect in candidates if not effect.frees for p in effect.qualified()]
    every = [columns[effect.name] for effect in candidates if not effect.frees]
    flat = np.concatenate([one.reshape(-1, one.shape[2]) for one in every], axis=1) if every else np.zeros((0, 0))
    length = np.linalg.norm(flat, axis=0)
    for parameter in (effect for effect in candidates if effect.frees):
        own = columns[parameter.name]
        alone = orthonormal(own)
        moves = np.linalg.norm(flat - alone @ (alone.T @ flat), axis=0)
        for joint in joints.T:
            both = np.concatenate([own, own * (joint - joint.mean())[:, None, None]], axis=2)
            basis = orthonormal(both)
            if basis.shape[1] < both.shape[2]:
                continue
            left = np.linalg.norm(flat - basis @ (basis.T @ flat), axis=0)
            for k in np.flatnonzero((left < _ALIKE * length) & (moves > _ALIKE * length)):
                out.setdefault(numbers[k], []).append(parameter)
    return out


def growth_of(model: ModelWithEffects, runs: Sequence[Measurements]) -> list[Effect]:
    """Effects of the temperature that are not in the model, where every run recorded it."""
    if not all(TEMPERATURE in data.covariates for data in runs):
        return []
    inside = {e.name for e in model.effects}
    every = [e for e in model.known_effects.values() if TEMPERATURE in e.needs and e.name not in inside]
    return [e for e in every if e.search is None and _possible(model, e, runs)]


def _possible(model: ModelWithEffects, effect: Effect, runs: Sequence[Measurements]) -> bool:
    return all(bool(model.is_testable([effect], data)[0]) for data in runs)


def change_columns(
    model: Any, values: Floats, data: Measurements, axes: Sequence[int], candidates: Sequence[Effect],
    own: Floats | None = None,
) -> dict[str, Floats]:  # fmt: skip
    """Columns (n, m, k) of candidates by plausible sizes; ``own`` (n, m, p) are those of the model's parameters."""
    if own is None:
        own = model.linearised(data, values).parameters[:, list(axes)]
    places = {p.name: k for k, p in enumerate(model.parameters)}
    asked = [one for one in candidates if one.qualified()[0].name not in places]
    tried = model.tried(data, values, asked)
    columns = tried.columns(slice(0, len(data)))[:, list(axes)]
    out = {e.name: columns[:, :, at] for e, at in tried.effects}
    for one in candidates:
        if one not in asked:
            out[one.name] = own[:, :, [places[p.name] for p in one.qualified()]]
    return {one.name: out[one.name] * [p.size for p in one.parameters] for one in candidates}
