"""The course of a machine over many runs: what stepped and when, what wears and how fast, what goes with the season.

The same candidates as in a comparison of two runs, each in four courses: a step from one run on, in one run alone, a
ramp by date, and with the temperature at which the runs were read. They are added one after another, as long as the
evidence that something is still left exceeds one hundred.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from os import PathLike
from typing import Any

import numpy as np

from ..adaptive.hypotheses import Key
from ..adaptive.look import FAR
from ..base import linalg
from ..base.arguments import as_annotated
from ..base.figures import finite
from ..base.notebook import Shown
from ..base.types import Floats
from ..data import Measurements
from ..data.columns import TEMPERATURE
from ..data.reader import RunLike
from ..errors import FitError, MeasurementError
from ..model.effect import Effect
from ..model.kinds import required_um
from ..model.robot_file import RobotLike, load_robot
from .comparison import ALARM, SHAPES, joined_runs
from .joined import Joined, told_as

STEP, ONCE, RAMP, SEASON = "", "once", "ramp", "season"
_MOST = 4
#: What cannot be told from a change is named, as far as so many.
_MOST_TIED = 4
_MONTH_S = 30.4375 * 86400.0
#: The columns in which a run may say when it was taken.
_DATES = ("date", "datetime", "taken_at")


@dataclass(frozen=True, eq=False)
class Course:
    """One change: of ``name``, a ``step`` (since run ``since``, from 0, on ``date``), ``once`` (in that run alone), a
    ``ramp`` (``change`` by month) or with the ``season`` (by °C), with its deviations, parameter by parameter."""

    name: str
    kind: str
    since: int | None
    date: str
    parameters: tuple[tuple[str, float, float, str], ...]
    exceeds: str = ""
    #: What these runs cannot tell from it: the same or another change, in another course.
    or_else: tuple[str, ...] = ()

    def __str__(self) -> str:
        told = []
        per = {"step": "", "once": "", "ramp": " per month", "season": " per °C"}[self.kind]
        for name, value, std, unit in self.parameters:
            times, shown = {"rad": (1e3, "mrad"), "mm": (1e3, "µm")}.get(unit, (1.0, unit))
            told.append(f"{name} {times * value:+.3g} ± {times * std:.2g} {shown}{per}")
        when = f" at {self.date}" if self.date else ""
        end = f"; beyond what is needed {self.exceeds}" if self.exceeds else ""
        other = f"; these runs cannot tell it from {', '.join(self.or_else)}" if self.or_else else ""
        return f"{self.kind}{when}: {'; '.join(told)}{end}{other}"

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "name": self.name, "kind": self.kind, "since": self.since, "date": self.date, "exceeds": self.exceeds,
            "indistinguishable": list(self.or_else),
            "parameters": [{"name": n, "change": v, "std": s, "unit": u} for n, v, s, u in self.parameters],
        }  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class History(Shown):
    """The course of a machine: ``changes`` in the order in which they were found, ``verdict`` as of a comparison,
    ``runs`` with date and error of each by the model of the first (``error``) and with what was found (``left``), in
    ``unit``; ``stood_still`` names candidates of which nothing was seen."""

    verdict: str
    changes: tuple[Course, ...]
    runs: tuple[dict[str, Any], ...]
    unit: str
    values: dict[str, list[tuple[float, float]]]
    stood_still: tuple[str, ...]

    def __repr__(self) -> str:
        return "\n".join([self.verdict, *(f"  {one}" for one in self.changes)])

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "verdict": self.verdict, "changes": [one.to_json() for one in self.changes], "runs": list(self.runs),
            "unit": self.unit, "values": {k: [list(p) for p in v] for k, v in self.values.items()},
            "stood_still": list(self.stood_still),
        }  # fmt: skip


@as_annotated
@linalg.one_thread()
def history(
    robot: RobotLike, runs: Sequence[RunLike], *, dates: Sequence[str | float] = (),
    effects: Sequence[str | Effect] | None = None,
) -> History:  # fmt: skip
    """The course over runs of one machine. ``dates`` are ISO dates or seconds, one for each run; left out, those of a
    column ``date``, or the runs' own clocks where these are seconds since 1970, else their order, a month apart.

    Raises :class:`~sherkit.errors.FitError` for fewer than two runs and
    :class:`~sherkit.errors.MeasurementError` for dates that are none.

        found = sk.history("demo/robot.toml", ["demo/whole.csv", "demo/local.csv"], dates=["2026-01-10", "2026-04-09"])
        print(found)
    """
    if len(runs) < 2:
        raise FitError(f"history: expected two runs or more, got {len(runs)}")
    if dates and len(dates) != len(runs):
        raise MeasurementError(f"dates: expected one for each of {len(runs)} runs, got {len(dates)}")
    robot = load_robot(robot) if isinstance(robot, str | PathLike) else robot
    joined, data = joined_runs(robot, runs, effects)
    at_s, told = _dates(data, dates)
    order = np.argsort(at_s, kind="stable")
    if not np.array_equal(order, np.arange(len(order))):
        return history(robot, [runs[k] for k in order], dates=[float(at_s[k]) for k in order], effects=effects)
    return _told(joined, data, at_s, told, required_um(robot))


def _dates(data: Sequence[Measurements], given: Sequence[str | float]) -> tuple[Floats, list[str]]:
    """When each run was taken (R,), s since 1970, and how that is told."""
    if given:
        at = [_seconds(one) for one in given]
    else:
        at = []
        for k, one in enumerate(data):
            named = next((name for name in _DATES if name in one.labels), None)
            if named is not None:
                at.append(_seconds(str(one.labels[named][0])))
            elif one.begins_s > 1e8:
                at.append(one.begins_s)
            else:
                at.append(k * _MONTH_S)
    values = np.array(at)
    known = values.min() > 1e8
    told = [datetime.fromtimestamp(v, UTC).date().isoformat() if known else f"run {k + 1}" for k, v in enumerate(at)]
    return values, told


def _seconds(one: str | float) -> float:
    if isinstance(one, str):
        try:
            made = datetime.fromisoformat(one)
        except ValueError:
            raise MeasurementError(f"dates: '{one}' is no date; expected 2026-03-31") from None
        return (made if made.tzinfo else made.replace(tzinfo=UTC)).timestamp()
    return float(one)


def _told(
    joined: Joined, data: Sequence[Measurements], at_s: Floats, dates: Sequence[str], needed: float | None
) -> History:
    count = len(data)
    steps = [np.array([float(k >= since) for k in range(count)]) for since in range(1, count)]
    courses: dict[str, Sequence[Floats]] = {STEP: steps}
    if count > 2:
        # the first or the last run alone is a step
        courses[ONCE] = [np.eye(count)[k] for k in range(1, count - 1)]
    months = (at_s - at_s[0]) / _MONTH_S
    if count > 2 and np.ptp(months) > 0:
        courses[RAMP] = [months]
    temperatures = np.array(
        [float(d.covariates[TEMPERATURE].mean()) if TEMPERATURE in d.covariates else np.nan for d in data]
    )
    if count > 2 and np.isfinite(temperatures).all() and np.ptp(temperatures) > 0.5:
        courses[SEASON] = [temperatures - temperatures[0]]
    factors = {name: list(values) for name, values in courses.items()}
    called = {told_as(c.name, k): f"{c.name} as a {k or 'step'}" if k != ONCE else f"{c.name} in one run alone"
              for c in joined.candidates for k in courses}  # fmt: skip
    found: list[tuple[str, str, int, Floats]] = []
    tied: list[tuple[str, ...]] = []
    evidence = joined.evidence(courses, waves=False)
    taken: list[Key] = []
    verdict = "unchanged" if evidence.alone.log_mean < ALARM else "unexplained"
    for _ in range(_MOST):
        weighed = evidence.alone if not taken else evidence.beside(taken)
        if weighed.log_mean < ALARM:
            break
        by_name = evidence.family.by_name
        value = {n: v + float(np.log(by_name[n].weight)) for n, v in weighed.log_bf.items()}
        causes = sorted((n for n in value if not by_name[n].is_shape), key=lambda n: -value[n])
        shape = max((v for n, v in value.items() if by_name[n].is_shape), default=-np.inf)
        if not causes or value[causes[0]] < shape + SHAPES:
            verdict = "partly explained" if taken else "unexplained"
            break
        name, setting = causes[0], weighed.setting[causes[0]]
        taken.append((name, setting))
        bare, course = next((c.name, k) for c in joined.candidates for k in courses if told_as(c.name, k) == name)
        found.append((bare, course, int(setting or 0), factors[course][int(setting or 0)]))
        tied.append(tuple(called[other] for other in causes[1:] if value[other] > value[name] - FAR)[:_MOST_TIED])
        verdict = "changed"
    changes = tuple(
        replace(one, or_else=other)
        for one, other in zip(_courses(joined, found, dates, months, needed), tied, strict=True)
    )
    values = {bare: _by_run(joined, bare) for bare, _, _, _ in found}
    still = [c.name for c in joined.candidates if c.name not in values]
    return History(
        verdict=verdict, changes=changes, runs=_runs(joined, data, dates), unit=data[0].layout.unit, values=values,
        stood_still=tuple(still),
    )  # fmt: skip


def _courses(
    joined: Joined, found: Sequence[tuple[str, str, int, Floats]], dates: Sequence[str], months: Floats,
    needed: float | None,
) -> tuple[Course, ...]:  # fmt: skip
    if not found:
        return ()
    blocks = [joined.columns_of(name, factors) for name, _, _, factors in found]
    value, covariance, _ = joined.estimate(np.concatenate(blocks, axis=1))
    std, out, k = np.sqrt(np.diag(covariance).clip(0.0)), [], 0
    for (name, course, setting, factors), block in zip(found, blocks, strict=True):
        width = block.shape[1]
        parameters = joined.candidate(name).parameters
        told = tuple((p.name, float(value[k + j] * p.size), float(std[k + j] * p.size), p.unit)
                     for j, p in enumerate(parameters[:width]))  # fmt: skip
        kind = course or "step"
        since = setting + 1 if kind in ("step", ONCE) else None
        grows = float(np.linalg.norm(block @ value[k : k + width]) / max(np.sqrt(len(block)), 1.0))
        out.append(Course(name, kind, since, dates[since] if since is not None else "", told,
                          _exceeds(kind, grows, months, factors, needed, joined)))  # fmt: skip
        k += width
    return tuple(out)


def _exceeds(kind: str, rms: float, months: Floats, factors: Floats, needed: float | None, joined: Joined) -> str:
    """When a ramp alone will be more than what is needed."""
    unit = joined.runs[0].data.layout
    if kind != "ramp" or needed is None or unit.unit != "µm" or rms <= 0:
        return ""
    per_month = rms * unit.per_unit * np.sqrt(len(joined.axes)) / max(float(np.sqrt(np.mean(factors**2))), 1e-300)
    left = needed / per_month - months[-1]
    return "already" if left <= 0 else f"in {left:.0f} months"


def _by_run(joined: Joined, name: str) -> list[tuple[float, float]]:
    """How far a candidate's first parameter stands from the first run in each run, with its deviation."""
    count = len(joined.runs)
    parameter = joined.candidate(name).parameters[0]
    blocks = [joined.columns_of(name, np.eye(count)[k]) for k in range(1, count)]
    width = blocks[0].shape[1]
    value, covariance, _ = joined.estimate(np.concatenate(blocks, axis=1))
    std = np.sqrt(np.diag(covariance).clip(0.0))
    later = [
        (float(value[k * width] * parameter.size), float(std[k * width] * parameter.size)) for k in range(count - 1)
    ]
    return [(0.0, 0.0), *later]


def _runs(joined: Joined, data: Sequence[Measurements], dates: Sequence[str]) -> tuple[dict[str, Any], ...]:
    out = []
    for run, given, date in zip(joined.runs, data, dates, strict=True):
        left = np.where(run.used, run.stand.residual, 0.0)
        rms = float(np.sqrt(np.square(left).sum() / max(int(run.used.any(axis=1).sum()), 1)))
        out.append({"run": given.source, "date": date, "rows": len(given), "error": finite(rms * given.layout.per_unit),
                    "stand": run.stand.moved})  # fmt: skip
    return tuple(out)
