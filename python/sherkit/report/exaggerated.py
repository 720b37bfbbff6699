"""What an effect does to a machine, exaggerated until it can be seen: the same model with more and more of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.types import Floats
from ..data import Measurements
from ..data.columns import TEMPERATURE, TIME, unit_in
from ..errors import SherkitError
from ..model.any import Model
from ..model.base import ModelWithEffects, missing_columns
from ..model.drawing import Drawing
from ..model.effect import Effect
from ..model.kinds import Kind, Robot, draw_of, kind_of, model_of

#: Times the effect as it is.
FACTORS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
#: Poses among which the one is looked for where the effect shows most.
_POSES = 40
#: A drawing that is off by more than this part of the machine's size shows no machine any more; one that is off by this
#: much is easily seen.
_MOST, _SEEN = 0.8, 0.12
#: What an effect needs besides the joints, in a row that nobody measured: an hour after the start, five degrees warmer,
#: after a motion upwards, at this speed, under a load of one.
_HOUR_S, _WARM_C = 3600.0, 25.0
_SPEED = {"mm": 20.0, "rad": 0.5, "deg": 30.0}
#: Period of an encoder's error where nobody gave one.
_PERIOD = {"mm": 2.0, "rad": 0.5, "deg": 30.0}


@dataclass(frozen=True, eq=False)
class Exaggerated:
    """A machine as drawn and with an effect at ``factors`` (k,) times its size: ``drawings`` of one pose each,
    ``plain`` without it.

    ``moves_mm`` is how far the effect as it is moves what is read at this pose, in the drawing's unit; ``factor`` is
    the one to begin with, at which it is easily seen. ``told`` says of which pose and moment this is.
    """

    effect: Effect
    values: Floats
    plain: Drawing
    factors: tuple[float, ...]
    drawings: tuple[Drawing, ...]
    moves_mm: float
    factor: float
    told: str
    #: The model with the effect and the pose at which it is drawn.
    model: Any
    row: Measurements


def plausible(effect: Effect) -> Floats:
    """All parameters at their plausible size, signs alternating: what limbs have in common often does little."""
    sizes = np.array([p.size for p in effect.parameters])
    return np.asarray(sizes * np.where(np.arange(len(sizes)) % 2 == 0, 1.0, -1.0))


def exaggerated(
    effect: Effect, machine: Robot | Model, *, values: Floats | None = None, data: Measurements | None = None,
    at: float | None = None,
) -> Exaggerated:  # fmt: skip
    """The effect on a robot, or on a machine that a model describes, at the pose where it shows most: of ``data`` where
    this has what it needs, or of what the robot's kind has to simulate.

    ``values`` (p,) of its parameters are by default plausible ones; ``at`` is the moment or period that is searched for
    besides them. Raises :class:`~sherkit.errors.SherkitError` where it can be drawn at no pose.
    """
    plain: ModelWithEffects = model_of(machine)
    draw = draw_of(plain)
    values = plausible(effect) if values is None else np.asarray(values, dtype=float)
    rows, measured = _rows(effect, plain, data)
    if at is None and effect.search == "time_s":
        at = 0.0 if rows.time_s is None else float(np.median(rows.time_s))
    elif at is None and effect.is_periodic and plain.setting_of(effect) is None:
        at = _PERIOD.get((effect.search or "").removeprefix("period_"), 1.0)
    model = plain if effect.name in {e.name for e in plain.effects} else plain.with_effect(effect, at=at)
    place = model.owns(effect)

    def drawn(these: Measurements, factor: float) -> Drawing:
        full = np.zeros(len(model.parameters))
        full[place] = factor * values
        return draw(model, these, full, None)

    everywhere = drawn(rows, 0.0)
    moved = np.linalg.norm(drawn(rows, 1.0).shown_mm - everywhere.shown_mm, axis=1)
    best = int(np.argmax(np.nan_to_num(moved)))
    row = rows.select(np.array([best]))
    frames, begin = growing(lambda factor: drawn(row, factor))
    if not frames:
        raise SherkitError(f"{effect.name} of this size leaves no machine to be drawn")
    factors, drawings = zip(*frames, strict=True)
    nominal = drawn(row, 0.0)
    where = f"at {row.counted} {row.line[0]} of the run" if measured else "at the pose where it shows most"
    told = f"This is the machine {where}{_moment(effect, row, measured)}."
    return Exaggerated(effect, values, nominal, factors, drawings, float(moved[best]), begin, told, model, row)


def growing(drawn: Callable[[float], Drawing]) -> tuple[list[tuple[float, Drawing]], float]:
    """A machine at one pose, drawn at more and more of :data:`FACTORS` as long as it is one, and the factor at which
    what becomes of it is easily seen."""
    points = drawn(0.0).points_mm[0]
    size = float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
    frames: list[tuple[float, Drawing]] = []
    begin, last = 0.0, 0.0
    for factor in FACTORS:
        try:
            one = drawn(factor)
        except SherkitError:
            break
        away = float(np.linalg.norm(one.points_mm[0] - points, axis=1).max())
        # what comes nearer again has turned once round
        if not np.isfinite(away) or (frames and not last <= away <= _MOST * size):
            break
        frames.append((factor, one))
        if last < _SEEN * size:
            begin = factor
        last = away
    return frames, begin


def _moment(effect: Effect, row: Measurements, measured: bool) -> str:
    """What of a row, besides the joints, an effect depends on."""
    said = []
    if "time_s" in effect.needs and effect.search != "time_s":
        said.append(f"{float(row.time_s[0]) / 60:.3g} min into the run" if measured else "an hour into the run")  # type: ignore[index]
    if effect.search == "time_s":
        said.append("after it happened")
    if TEMPERATURE in effect.needs:
        said.append(f"at {row.covariates[TEMPERATURE][0]:.3g} °C")
    for name in row.layout.loads:
        if name in effect.needs:
            said.append(f"under {row.covariates[name][0]:.3g} {unit_in(name)}")
    return f", {', '.join(said)}" if said else ""


def _rows(effect: Effect, model: ModelWithEffects, data: Measurements | None) -> tuple[Measurements, bool]:
    """Some rows at which the effect acts, and whether they were measured."""
    if data is not None and not missing_columns(effect, data):
        whole = np.flatnonzero(~data.is_distance & ~data.outlier)
        if effect.search == "time_s" and data.time_s is not None:
            whole = whole[data.time_s[whole] >= np.median(data.time_s)]
        if len(whole):
            return data.select(whole[np.linspace(0, len(whole) - 1, min(len(whole), _POSES)).astype(int)]), True
    if model.robot is None:
        raise SherkitError("no run says where this machine has been")
    kind = kind_of(model.robot)
    joints = joints_over(model.robot, kind)
    layout, n = kind.layout, len(joints)
    units = [unit_in(name) for name in layout.joints]
    extra: dict[str, Any] = {TIME: np.full(n, _HOUR_S), TEMPERATURE: np.full(n, _WARM_C)}
    extra |= {name: np.ones(n) for name in (*layout.directions, *layout.loads)}
    extra |= {name: np.full(n, _SPEED.get(u, 1.0)) for name, u in zip(layout.velocities, units, strict=False)}
    return Measurements.planned(joints, layout, "drawing", **extra), False


def joints_over(robot: Any, kind: Kind) -> Floats:
    """Joint readings (n, k) over the workspace: those of a simulated run, or anywhere between the limits of a machine
    that has no simulation; the middle of the workspace where the robot comes nowhere else."""
    if kind.virtual is not None and kind.areas:
        try:
            poses = next(iter(kind.areas.values()))(robot)
            poses = poses[np.linspace(0, len(poses) - 1, min(len(poses), _POSES)).astype(int)]
            without = dict.fromkeys(kind.virtual.OPTIONS, 0.0)
            return (
                kind.virtual.simulated(robot, 0, 0.0, without)
                .measure(poses, repeats=1, order="shuffled", seed=0)
                .joints
            )
        except SherkitError:
            return np.asarray(robot.inverse(robot.middle))[None]
    box = getattr(robot, "box", None)
    if box is None:
        return np.asarray(robot.inverse(robot.middle))[None]
    low, high = np.asarray(box).T
    return np.asarray(np.random.default_rng(0).uniform(low, high, (_POSES, len(low))))
