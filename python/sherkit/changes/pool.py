"""The runs that can speak, as one object about the model of the first of them; the others are named and left out."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..adaptive.gate import TIMES, Power, Silent, silence
from ..base.answer import FILES
from ..base.figures import listed, number
from ..base.types import Floats
from ..data import Measurements
from ..data.called import Columns
from ..data.reader import RunLike
from ..diagnosis import diagnose
from ..diagnosis.outliers import gross_errors
from ..errors import FitError, SherkitError, SherkitWarning
from ..evidence.fitted_run import enough_of
from ..evidence.thresholds import ALARM, NEARLY_ALWAYS
from ..evidence.whitening import orthonormal
from ..fit.constant_columns import unread
from ..fit.error import axes_of
from ..fit.identify import identify
from ..model.effect import Effect
from ..model.kinds import Robot, model_of, required_um
from ..model.robot_file import RobotLike, read_robot, run_for
from ..model.sensor_pose import POSE
from .courses import lacking
from .pooled_fit import Joined
from .runs import held_of
from .vouching import Gate, error_in_another, held_in, stuck

#: How a copy is told.
_COPY = "holds the same rows as"
#: Rows of all runs together that are weighed, and of one at least.
_ROWS, _ROWS_OF_A_RUN = 4000, 200
#: Part of a column that is left at most where the instrument's stand does the same.
_AS_STAND = 0.05


@dataclass(frozen=True, eq=False)
class Pool:
    """Of ``names`` (R,), files or sources, those at ``numbers``: their rows ``data`` and, where there are two or more,
    the object ``joined``; ``silent`` are the others, and why. Errors are in ``unit``."""

    robot: Robot
    names: tuple[str, ...]
    numbers: tuple[int, ...]
    data: tuple[Measurements, ...]
    silent: dict[str, Silent]
    unit: str
    joined: Joined | None = None

    @classmethod
    def of(cls, robot: Robot, data: Sequence[Measurements], effects: Sequence[str | Effect] | None = None) -> Pool:
        """Those runs of a robot that may speak by their rows, and beside a first that tells what the robot was."""
        sources = [one.source for one in data]
        names = tuple(
            source if sources.count(source) == 1 else f"{k + 1}: {source}" for k, source in enumerate(sources)
        )
        silent, kept = _by_rows(robot, names, data)
        unit = data[0].layout.unit
        while len(kept) > 1:
            try:
                joined, used = _joined(robot, [data[k] for k in kept], effects)
            except FitError:
                # an encoder that was stuck before leads to a robot that does not reach what it later did
                held = held_in(data[kept[0]], [data[k] for k in kept[1:]])
                if not held:
                    raise
                silent[names[kept[0]]] = stuck(held, "and no model fits it and the later runs")
                kept = kept[1:]
                continue
            made = cls(robot, names, tuple(kept), tuple(used), dict(silent), unit, joined)
            why = made.gate.first()
            mute = {kept[0]: why} if why is not None else {kept[k]: one for k, one in made.gate.mute().items()}
            if not mute:
                return made
            silent |= {names[k]: one for k, one in mute.items()}
            kept = [k for k in kept if k not in mute]
        return cls(robot, names, tuple(kept), tuple(data[k] for k in kept), silent, unit)

    @property
    def needed(self) -> float | None:
        """The accuracy that the robot is for, in the unit of its readings; None where its file does not say so."""
        return required_um(self.robot) if self.unit == "µm" else None

    @property
    def unsaid(self) -> str:
        """The verdict where fewer than two runs can speak: copies of one run are as it is, and vouch for nothing."""
        copies = len(self.data) == 1 and all(one.why.startswith(_COPY) for one in self.silent.values())
        return "unchanged" if copies else "undecided"

    @property
    def why_silent(self) -> dict[str, str]:
        """Why each of the silent runs is."""
        return {name: one.why for name, one in self.silent.items()}

    @property
    def to_measure(self) -> list[str]:
        """What would let each of the silent runs speak."""
        return [f"{name}: {one.measure}" for name, one in self.silent.items()]

    @cached_property
    def gate(self) -> Gate:
        """What the runs could see: of what is needed, or else of what the first run shows of the model."""
        assert self.joined is not None, "asked of two runs or more"
        return Gate(self.joined, self.needed or float(self.joined.fit.error.rms), ALARM)

    @cached_property
    def powers(self) -> tuple[Power, ...]:
        """Of every later run."""
        return tuple(self.gate.power(k) for k in range(1, len(self.numbers)))

    @property
    def smallest(self) -> float | None:
        """The change, as an error where the robot works, that each of the later runs would have shown; None where one
        shows none."""
        found = max((one.smallest for one in self.powers), default=np.inf) if self.joined else np.inf
        return float(found) if np.isfinite(found) else None

    @property
    def unseen(self) -> tuple[tuple[str, float], ...]:
        """Candidates that a run would not have shown, with the chance."""
        worst: dict[str, float] = {}
        for one in self.powers if self.joined else ():
            for name, chance in one.chances.items():
                worst[name] = min(chance, worst.get(name, 1.0))
        return tuple((name, chance) for name, chance in worst.items() if chance < NEARLY_ALWAYS)

    def speaking(self) -> Pool:
        """Where nothing is seen: the runs that would have shown it. These, if all would."""
        joined = self.joined
        if joined is None:
            return self
        before, silent, kept = float(joined.fit.error.rms), dict(self.silent), [0]
        for k, power in enumerate(self.powers, 1):
            why = self.gate.later(k, power, before)
            if why is None:
                kept.append(k)
            else:
                silent[self.names[self.numbers[k]]] = why
        if len(kept) == len(self.numbers):
            return self
        numbers, data = tuple(self.numbers[k] for k in kept), tuple(self.data[k] for k in kept)
        rest = lacking(Joined(joined.fit, data, joined.axes)) if len(kept) > 1 else None
        return replace(self, numbers=numbers, data=data, silent=silent, joined=rest)


def unchanged_advice(before: float, needed: float | None, unit: str, joined: Joined) -> str:
    """What to do where nothing has changed: what is off by more than is needed was so before, or follows the
    temperature, as no change does."""
    off = max((error_in_another(run) for run in joined.runs[1:]), default=0.0)
    if joined.growth and off > max(needed or 0.0, TIMES * before):
        names = listed(effect.name for effect in joined.growth)
        return (
            "nothing has changed but the temperature: by the model of the first run another one is off by "
            f"{number(off)} {unit}, which follows it; have that in the model ({names})"
        )
    if needed is None or before <= needed:
        return f"nothing needs to be done: the calibration still describes the robot{_but_for_its_stand(joined)}"
    return (
        f"nothing has changed, but the model of the first run is off by {number(before)} {unit}, noise included, where "
        f"the target is {number(needed)}: diagnose that run"
    )


def _but_for_its_stand(joined: Joined) -> str:
    """What these runs cannot tell from where the instrument stands, behind the praise; empty where it is held."""
    run, number = joined.runs[-1], len(joined.runs) - 1
    stand = run.stand.columns[run.rows].reshape(-1, run.stand.columns.shape[2])
    if not set(POSE) <= {f"sensor_{name.rpartition('_')[0]}" for name in run.stand.moved}:
        return ""
    basis = orthonormal(stand)
    same = ["its base"]
    if run.data.layout.unit == "µm" and not joined.model.targets_anywhere:
        same.append("a tool that shifts all places alike")
    every = {**run.columns, **joined.held(number)}
    for effect in (one for one in (*joined.candidates, *held_of(joined.model)) if one.frees):
        columns = every[effect.name][run.rows].reshape(len(stand), -1)
        left = columns - basis @ (basis.T @ columns)
        if np.linalg.norm(left) < _AS_STAND * np.linalg.norm(columns):
            same += [p.name for p in effect.parameters]
    return (
        f". Where it stands as a whole no run tells from where the instrument does ({listed(same)}): programs in the "
        "frame of the base need a target on the base, or a place that is touched, to tell that"
    )


def calibrate_again(verdict: str, effects: Sequence[str]) -> str:
    """The command that calibrates the latest run with what is in the model of all; empty where nothing asks for it."""
    if verdict in ("unchanged", "undecided"):
        return ""
    inside = "".join(f" --effect {name}" for name in effects)
    return f"sherkit calibrate {FILES}{inside} -o calibrated.toml"


def left_out(silent: Mapping[str, object]) -> list[str]:
    """Runs that cannot speak, each with why."""
    return [f"Left out: {name}: {why}." for name, why in silent.items()]


def told_ties(ties: Sequence[Sequence[str]]) -> list[str]:
    """What these runs cannot tell apart."""
    return [f"these runs cannot tell {' from '.join(tie)}" for tie in ties]


def sees_of(smallest: float | None, unit: str) -> str:
    """What runs would have shown, in words; nothing where that is not asked."""
    if smallest is None:
        return ""
    return f"a change of {number(smallest)} {unit} RMS where the robot works would have been seen in 95 of 100 cases"


def read_runs(robot: RobotLike, runs: Sequence[RunLike]) -> list[Measurements]:
    """The rows of each run of a robot, under the names that its file gives."""
    model = model_of(read_robot(robot))
    return [rows_of(robot, model, run) for run in runs]


def rows_of(robot: RobotLike, model: Any, run: RunLike, columns: Columns | None = None) -> Measurements:
    """The rows of a run of a robot and its model; what none of them reads is said."""
    data = model.as_declared(run_for(robot, run, columns))
    for said in unread(data):
        warnings.warn(f"{data.source}: {said}", SherkitWarning, stacklevel=2)
    return data


def _by_rows(
    robot: Robot, names: Sequence[str], data: Sequence[Measurements]
) -> tuple[dict[str, Silent], list[int]]:  # fmt: skip
    """Runs that cannot speak by their rows alone, and the numbers of the others."""
    model: Any = model_of(robot)
    silent: dict[str, Silent] = {}
    kept: list[int] = []
    for k, one in enumerate(data):
        axes, drawn = axes_of(one), np.zeros(len(model.parameters))
        same = next((j for j in range(k) if data[j].digest == one.digest), None)
        # what is to be told: all of the robot from the first, where the sensor stands from another
        unknown = 2 * len(axes) if kept else len(model.parameters)
        if same is not None:
            silent[names[k]] = Silent(f"{_COPY} {names[same]}: nothing was measured in between", "measure once more")
        elif axes and (why := silence(one, axes, unknown, predicted(model, one, drawn))) is not None:
            silent[names[k]] = why
        else:
            kept.append(k)
    return silent, kept


def predicted(model: Any, data: Measurements, values: Floats) -> Floats | None:
    """What a model says of a run; None where it does not reach all of it."""
    try:
        return np.asarray(model.predict(data, values))
    except SherkitError:
        return None


def _joined(
    made: Robot, given: Sequence[Measurements], effects: Sequence[str | Effect] | None
) -> tuple[Joined, list[Measurements]]:
    """The runs as one object about the model of the first."""
    data = list(given)
    fit = identify(made, data[0], effects=() if effects is None else effects)
    if effects is None:
        found = diagnose(fit)
        # what was missing already is in all runs, with its period; a moment of the first says nothing of the others
        model, outliers = found.fit.model, found.outliers
        for effect in model.effects:
            if effect.search == "time_s" and effect.name in found.effects:
                model = model.without_effect(effect.name)
    else:
        model, outliers = fit.model, gross_errors(fit)
    if len(outliers) or model is not fit.model:
        data[0] = data[0].mark_outliers(outliers)
        fit = identify(model, data[0])
    most = max(_ROWS // len(data), _ROWS_OF_A_RUN)
    data = [one.select(enough_of(one, np.arange(len(one)), most)) for one in data]
    axes = tuple(a for a in axes_of(data[0]) if all(a in axes_of(one) for one in data))
    if not axes:
        raise FitError("compare: the runs have no reading in common")
    return lacking(Joined(fit, data, axes)), data
