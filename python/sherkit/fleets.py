"""Many machines of one robot: what each is missing, what they share, and which of them stands out.

Every run is diagnosed by itself, wherever an executor of :mod:`concurrent.futures` takes it. Machines are compared by
what the readings say of them: the drawing is that of all, so what it adds to a value and to its deviation is no
difference of machines. Which of them stands out is asked of the farthest one beside all others, then of the next
(Rosner, "Percentage points for a generalized ESD many-outlier procedure", Technometrics 1983), at a chance for the
whole fleet. By how much the others differ is known from these few alone, and from what each is uncertain by, below
which they cannot be alike: :func:`_deviations`.
"""

from __future__ import annotations

import concurrent.futures as futures
import os
import uuid
import warnings
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import polars as pl
import scipy

from .base.arguments import Level, Seed, validate_arguments
from .base.figures import listed, sized
from .base.types import Floats, Ints
from .base.workers import Outcome, run_tasks
from .data.noise import MAD
from .data.reader import RunLike
from .diagnosis import diagnose
from .diagnosis.result import Summary
from .errors import FitError, SherkitError, SherkitWarning
from .fit.identify import identify
from .model.effect import Effect, effects_by_name
from .model.kinds import Robot, model_of
from .model.robot_file import RobotLike, columns_of, robot_of, run_for

#: Chance that a machine of a fleet in which none stands out is said to.
LEVEL = 0.05
#: A median of fewer machines says nothing of one of them.
FEWEST = 4
#: At most one of so many machines, beside one, stands out in a quantity.
_ONE_OF = 3
#: Deviations from the median within which nothing stands out.
_NEAR = 2.0
#: By how much machines may differ, as variances in that of the values told.
_DIFFER = np.logspace(-8.0, 4.0, 200)


@dataclass(frozen=True)
class FleetMember(Summary):
    """One run of the fleet, and what was found in it.

    ``failed`` is the sentence that says why there is no more, None where all went well. ``values``, their deviations
    (``std_from_readings``, and ``std`` with the drawing's) and ``units`` are those of the fitted parameters, with the
    effects that were found missing; those ``of_sensor`` say where the instrument stood and what it shows, and nothing
    of the machine. ``remarks`` are the warnings that were given.
    """

    run: str
    failed: str | None = None
    values: Mapping[str, float] | None = None
    std_from_readings: Mapping[str, float] | None = None
    std: Mapping[str, float] | None = None
    units: Mapping[str, str] | None = None
    of_sensor: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def row(self) -> dict[str, str | int | float | None]:
        """As that of a diagnosis, with the run; of one that failed the reason alone."""
        return {"run": self.run, "failed": self.failed} | ({} if self.failed else super().row())


@dataclass(frozen=True)
class Common:
    """What the fleet has of one quantity: a fitted parameter, or the error left (``error left``).

    ``spread`` is the standard deviation from machine to machine by the median absolute deviation, over ``machines``.
    """

    name: str
    unit: str
    median: float
    spread: float
    machines: int


@dataclass(frozen=True)
class StandsOut:
    """A machine that is not like the others in one quantity: so rare among them as ``deviations`` of a normal
    distribution, where ``threshold`` is rarely passed by chance. ``median`` is that of the fleet."""

    run: str
    name: str
    value: float
    median: float
    deviations: float
    threshold: float
    unit: str = ""

    def __str__(self) -> str:
        return (
            f"{self.run}: {self.name} is {sized(self.value, self.unit)}, the fleet's median "
            f"{sized(self.median, self.unit)}: "
            f"{self.deviations:+.1f} deviations, where {self.threshold:.1f} are rare"
        )


@dataclass(frozen=True)
class Fleet:
    """The machines in the order of their runs."""

    machines: tuple[FleetMember, ...]

    @cached_property
    def diagnosed(self) -> tuple[FleetMember, ...]:
        """The machines whose runs could be used."""
        return tuple(m for m in self.machines if m.failed is None)

    @cached_property
    def shared(self) -> dict[str, tuple[str, ...]]:
        """The runs in which each effect was found, effects that most share first."""
        found: dict[str, list[str]] = {}
        for machine in self.diagnosed:
            for name in machine.effects:
                found.setdefault(name, []).append(machine.run)
        return {name: tuple(runs) for name, runs in sorted(found.items(), key=lambda one: (-len(one[1]), one[0]))}

    @cached_property
    def common(self) -> tuple[Common, ...]:
        """Median and spread of every parameter that enough machines have, and of the error left."""
        out = []
        for name, of in self._quantities.items():
            if len(of) >= FEWEST:
                middle, spread = _robust(np.array([value for value, _ in of.values()]))
                out.append(Common(name, self._units[name], middle, spread, len(of)))
        return tuple(out)

    @cached_property
    def stands_out(self) -> tuple[StandsOut, ...]:
        """Machines unlike the others, the farthest first. With fewer than four machines none can be told."""
        out = []
        for c in self.common:
            runs, values, stds = zip(*((run, *one) for run, one in self._quantities[c.name].items()), strict=True)
            for k, deviations, threshold in _outlying(np.array(values), np.array(stds), LEVEL / len(self.common)):
                out.append(StandsOut(runs[k], c.name, values[k], c.median, deviations, threshold, c.unit))
        return tuple(sorted(out, key=lambda one: -abs(one.deviations)))

    @cached_property
    def _quantities(self) -> dict[str, dict[str, tuple[float, float]]]:
        """Values with what the readings leave of them uncertain, by quantity and run."""
        out: dict[str, dict[str, tuple[float, float]]] = {"error left": {}}
        for m in self.diagnosed:
            if m.after:
                # that of the root of a mean of squares, one of each row at least
                out["error left"][m.run] = (m.after, m.after / np.sqrt(2.0 * max(m.rows, 1)))
            for name, value in (m.values or {}).items():
                if name not in m.of_sensor:
                    out.setdefault(name, {})[m.run] = (value, (m.std_from_readings or {})[name])
        return out

    @cached_property
    def _units(self) -> dict[str, str]:
        units = {name: unit for m in self.diagnosed for name, unit in (m.units or {}).items()}
        return {"error left": next((m.unit for m in self.diagnosed), "")} | units

    def __repr__(self) -> str:
        lines = [f"{len(self.machines)} machines, {len(self.machines) - len(self.diagnosed)} of them failed"]
        for m in self.machines:
            said = m.failed or f"{m.verdict}{': ' + ', '.join(m.effects) if m.effects else ''}"
            lines.append(f"  {m.run:<24} {said}")
        lines += [f"  {name} in {len(runs)} of {len(self.diagnosed)}" for name, runs in self.shared.items()]
        return "\n".join([*lines, *(f"  {one}" for one in self.stands_out)])

    def to_frame(self) -> pl.DataFrame:
        """A polars frame with a row for each machine: its run, why it failed, and what its diagnosis says."""
        return pl.from_dicts([m.row() for m in self.machines], infer_schema_length=None)

    def to_json(self) -> dict[str, Any]:
        """For programs: no NaN, keys as the attributes."""

        def plain(value: Any) -> Any:
            if isinstance(value, dict):
                return {k: plain(v) for k, v in value.items()}
            return None if isinstance(value, float) and not np.isfinite(value) else value

        return {
            "machines": [plain(asdict(m)) for m in self.machines],
            "shared": {name: list(runs) for name, runs in self.shared.items()},
            "common": [plain(asdict(c)) for c in self.common],
            "stands_out": [plain(asdict(s)) for s in self.stands_out],
        }


@validate_arguments
def fleet(
    runs: Sequence[RunLike], robot: RobotLike, *, effects: Sequence[Effect | str] = (), own: Sequence[Effect] = (),
    level: Level = 0.01, seed: Seed = 0, executor: futures.Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Fleet:  # fmt: skip
    """Diagnoses runs of machines that are built alike, each by itself, and compares them.

    ``effects`` are in the model of all from the beginning, ``own`` are tried beside the catalogue; ``level`` and
    ``seed`` are those of :func:`~sherkit.diagnosis.diagnose`. ``executor`` takes the runs, one task each: a process
    pool, a cluster; without one they are done here, one after the other. What the tasks need is sent to them, so runs
    given by their paths must be readable there. ``progress`` is told how many of how many are done.

    A run that cannot be used is a machine that says why. So is one whose process was killed twice, the second time with
    nothing else to do: where a pool breaks, what is done is kept and the rest goes on in a new one. Raises
    :class:`~sherkit.errors.FitError` where there is no run, or two of one name; :class:`~sherkit.errors.RobotError` for
    a robot that is none.

        machines = sk.fleet(["demo/whole.csv", "demo/local.csv"], "demo/robot.toml")
        print(machines)
    """
    columns = columns_of(robot) or None
    nominal = robot_of(robot)
    names = [os.fspath(r) if isinstance(r, str | os.PathLike) else f"run {k + 1}" for k, r in enumerate(runs)]
    if not names:
        raise FitError("a fleet needs at least one run")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise FitError(f"{listed(twice)}: given more than once; each machine of a fleet has one run")
    plain = model_of(nominal)
    known = effects_by_name(plain.catalogue, [e for e in effects if isinstance(e, str)], own)
    inside = (*known, *(e for e in effects if isinstance(e, Effect)))
    call = uuid.uuid4().hex
    tasks = [
        _FleetTask(call, name, nominal, run, columns, inside, tuple(own), level, seed)
        for name, run in zip(names, runs, strict=True)
    ]
    told = progress or (lambda done, total: None)
    told(0, len(tasks))
    made: dict[int, FleetMember] = {}
    with closing(_here(tasks) if executor is None else run_tasks(_machine, tasks, executor)) as outcomes:
        for one in outcomes:
            name = names[one.number]
            made[one.number] = one.answer or FleetMember(name, failed=_unanswered(name, one.error))
            told(len(made), len(tasks))
    return Fleet(tuple(made[k] for k in range(len(tasks))))


@dataclass(frozen=True)
class _FleetTask:
    """What is sent to a worker. ``call`` is another one each time: a cluster that keeps answers by what was asked would
    give that of a file which has changed since."""

    call: str
    name: str
    robot: Robot
    run: RunLike
    columns: Mapping[str, str] | None
    inside: tuple[Effect, ...]
    own: tuple[Effect, ...]
    level: float
    seed: int


def _here(tasks: Sequence[_FleetTask]) -> Generator[Outcome[FleetMember], None, None]:
    for k, task in enumerate(tasks):
        yield Outcome(k, _machine(task))


def _unanswered(name: str, error: BaseException | None) -> str:
    """Why a machine has no verdict where no sentence on its run says so."""
    said = " ".join(str(error).split())
    return f"{name}: {said if isinstance(error, SherkitError) else f'{type(error).__name__}: {said}'}"


def _machine(task: _FleetTask) -> FleetMember:
    """Numbers and words alone come back: no rows travel."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", SherkitWarning)
        try:
            data = run_for(task.robot, task.run, task.columns)
            fit = identify(task.robot, data, effects=list(task.inside))
            found = diagnose(fit, effects=task.own, level=task.level, seed=task.seed)
        except SherkitError as error:
            return FleetMember(task.name, failed=str(error), remarks=_said(said))
        except (Exception, SystemExit) as error:  # an effect of the user's, memory: of this machine alone
            return FleetMember(task.name, failed=_unanswered(task.name, error), remarks=_said(said))
    if mistaken := [check.fails for check in found.checks if check.name == "set_up" and check.holds is False]:
        # what its numbers hold is the mistake, and no machine
        return FleetMember(task.name, failed=f"{task.name}: {mistaken[0]}", remarks=_said(said))
    names = [p.name for p in found.fit.parameters]
    return FleetMember(
        **vars(found.summary),
        run=task.name,
        values=dict(zip(names, found.fit.values.tolist(), strict=True)),
        std_from_readings=dict(zip(names, found.fit.std_from_readings.tolist(), strict=True)),
        std=dict(zip(names, found.fit.std.tolist(), strict=True)),
        units={p.name: p.unit for p in found.fit.parameters},
        of_sensor=tuple(name for name in names if name in found.fit.model.of_sensor),
        remarks=_said(said),
    )


def _said(caught: Sequence[warnings.WarningMessage]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(str(w.message) for w in caught if issubclass(w.category, SherkitWarning)))


def _robust(values: Any) -> tuple[float, float]:
    middle = float(np.median(values))
    return middle, MAD * float(np.median(np.abs(values - middle)))


def _outlying(values: Floats, stds: Floats, level: float) -> list[tuple[int, float, float]]:
    """Values (n,) that are unlike the others, each with its deviations from these and how many are rare at a chance
    ``level`` that any is said where none is.

    The farthest is taken out in turn; of these all up to the last that was too far stand out, so that two do not hide
    each other.
    """
    middle, spread = _robust(values)
    apart = np.abs(values - middle) / np.maximum(np.hypot(spread, stds), 1e-300)
    order = np.argsort(-apart, kind="stable")
    rounds = max((len(values) - 1) // _ONE_OF, 1)

    def away(k: int, others: Ints) -> float:
        return _deviations(float(values[k]), float(stds[k]), values[others], stds[others])

    def rare(others: Ints) -> float:
        return float(-scipy.special.ndtri(0.5 * level / rounds / (len(others) + 1)))

    tried = min(rounds, int((apart > _NEAR).sum()))
    last = max((j + 1 for j in range(tried) if abs(away(order[j], order[j + 1 :])) > rare(order[j + 1 :])), default=0)
    left = order[last:]
    return [(int(k), away(k, left), rare(left)) for k in order[:last]]


def _deviations(value: float, std: float, others: Floats, stds: Floats) -> float:
    """How rare a value with its ``std`` is among others (m,) with theirs, as deviations of a normal distribution.

    The predictive distribution of one more value: its mean is that of the others, weighed, and the variance by which
    machines differ is integrated over, with Jeffreys' prior of the whole variance, of which what the readings leave
    (``stds``) is known (Box and Tiao, *Bayesian Inference in Statistical Analysis*, 2.3 and 5.2). Where they tell all
    exactly it is Student's t of m - 1 degrees of freedom.
    """
    known = float(np.mean(stds**2))
    size = max(float(np.var(others)), known)
    if not size:
        return 0.0
    differ = size * _DIFFER
    weights = 1.0 / (differ[:, None] + stds**2)
    total = weights.sum(1)
    mean = weights @ others / total
    left = (weights * np.square(others - mean[:, None])).sum(1)
    likely = 0.5 * (np.log(weights).sum(1) - np.log(total) - left) + np.log(differ / (differ + known))
    apart = (value - mean) / np.sqrt(differ + 1.0 / total + std**2)
    sign = 1.0 if value > float(others.mean()) else -1.0
    tail = scipy.special.logsumexp(likely + scipy.special.log_ndtr(-sign * apart)) - scipy.special.logsumexp(likely)
    return sign * float(-scipy.special.ndtri_exp(tail))
