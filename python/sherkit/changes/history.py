"""The course of a machine over many runs: what stepped and when, what wears and how fast, what goes with the season.

The same candidates as in a comparison of two runs, each in four courses: a step from one run on, in one run alone, a
ramp by date, and with the temperature at which the runs were read. They are added one after another, as long as the
evidence that something is still left exceeds one hundred.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime, timedelta
from typing import Any

import numpy as np

from ..base import linalg
from ..base.answer import AFTER, BEFORE, Answer, Bar, ToDo
from ..base.arguments import validate_arguments
from ..base.figures import finite, listed, stated
from ..base.notebook import Shown
from ..base.types import Floats
from ..data import Measurements
from ..data.columns import TEMPERATURE
from ..data.reader import RunLike
from ..errors import FitError, MeasurementError
from ..evidence.base import Base
from ..evidence.blocks import Block
from ..evidence.sets import FIRSTS, ONE_MORE, described, likeliest
from ..evidence.thresholds import A_FEW, ALARM, SURE, TIED
from ..model.effect import Effect
from ..model.robot_file import RobotLike, read_robot
from .change_model import About
from .courses import MEASURE_MORE, Courses, change_verdict
from .pool import Pool, calibrate_again, left_out, read_runs, sees_of, unchanged_advice
from .pooled_fit import Joined
from .vouching import errors_of

STEP, ONCE, RAMP, SEASON = "step", "once", "ramp", "season"
_MOST = 4
#: Runs with which wear may have begun.
_ONSETS = 10
_MONTH_S = 30.4375 * 86400.0
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
#: A clock that shows more counts from 1970 (one that was set to zero would have run for three years).
_CLOCK_S = 1e8
#: What to do, by the verdict; of what was found it is said with it.
_ADVICE = {
    "undecided": MEASURE_MORE,
    "changed": "calibrate again",
    "partly explained": "calibrate again, all of it: what is named does not explain all that is seen",
    "unexplained": "calibrate again, all of it: no change explains what is seen",
}
#: The columns in which a run may say when it was taken.
_DATES = ("date", "datetime", "taken_at")


@dataclass(frozen=True, eq=False)
class Course:
    """One change: of ``name``, a ``step`` (since run ``since``, from 0, on ``date``), ``once`` (in that run alone), a
    ``ramp`` (``change`` by month, from that run on or from the first) or with the ``season`` (by °C), with its
    deviations, parameter by parameter."""

    name: str
    kind: str
    since: int | None
    date: str
    parameters: tuple[tuple[str, float, float, str], ...]
    exceeds: str = ""
    #: What these runs cannot tell from it: the same or another change, in another course.
    or_else: tuple[str, ...] = ()

    @property
    def is_plain(self) -> bool:
        """Whether it is said in one line."""
        return len(self.parameters) == 1 and not self.exceeds and not self.or_else

    def __str__(self) -> str:
        end = f"; beyond what is needed {self.exceeds}" if self.exceeds else ""
        other = f"; these runs cannot tell it from {', '.join(self.or_else)}" if self.or_else else ""
        return f"{self.course}: {self.sizes}{end}{other}"

    @property
    def course(self) -> str:
        """Its kind, and when it began."""
        return f"{self.kind} {'from' if self.kind == RAMP else 'at'} {self.date}" if self.date else self.kind

    @property
    def sizes(self) -> str:
        """By how much each of its parameters changes."""
        per = {"step": "", "once": "", "ramp": " per month", "season": " per °C"}[self.kind]
        return "; ".join(f"{name} by {stated(value, std, unit)}{per}" for name, value, std, unit in self.parameters)

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
    ``runs`` with date and error of each by the model of the first (``error``), in ``unit``, and why it was
    ``left_out``; ``stood_still`` names candidates of which nothing was seen, ``silent`` the runs that cannot speak.
    ``unchanged`` are runs that would have shown an error of ``smallest_found`` where the robot works in 95 of 100
    cases."""

    verdict: str
    changes: tuple[Course, ...]
    runs: tuple[dict[str, Any], ...]
    unit: str
    values: dict[str, list[tuple[float, float]]]
    stood_still: tuple[str, ...]
    smallest_found: float | None = None
    silent: dict[str, str] = field(default_factory=dict)
    advice: str = ""
    #: Effects that are in the model of all runs.
    known: tuple[str, ...] = ()

    @property
    def headline(self) -> str:
        """The verdict in one line, and which runs cannot speak."""
        return "; ".join([self.verdict_and_what, *(f"{name}: {why}" for name, why in self.silent.items())])

    @property
    def verdict_and_what(self) -> str:
        """The verdict, and what has changed, in which course."""
        if len(self.changes) == 1 and self.changes[0].is_plain:
            only = self.changes[0]
            return f"{self.verdict}: {only.sizes} ({only.course})"
        told = [f"{one.name} ({one.course})" for one in self.changes]
        return f"{self.verdict}: {', '.join(told)}" if told else self.verdict

    @property
    def answer(self) -> Answer:
        """What it says for whoever reads nothing else."""
        told = [*left_out(self.silent), *([self.sees] if self.sees else [])]
        # the first line has said of a single change what there is to say
        told += [] if len(self.changes) == 1 and self.changes[0].is_plain else map(str, self.changes)
        if self.verdict != "undecided":
            told.append(f"{len(self.stood_still)} other parameters and effects stood still")
        errors = [run["error"] for run in self.runs if run["error"] is not None]
        bars = () if len(errors) < 2 else (
            Bar(BEFORE, "first run", errors[0]), Bar(AFTER, "last, by the model of the first", errors[-1])
        )  # fmt: skip
        gone = _is_gone(self.verdict, self.changes)
        to_do = ToDo(self.advice, "" if gone else calibrate_again(self.verdict, self.known))
        return Answer(self.verdict_and_what, "", tuple(told), (to_do,), bars, self.unit)

    @property
    def sees(self) -> str:
        """What these runs would have shown, where they show nothing."""
        return sees_of(self.smallest_found, self.unit)

    def __repr__(self) -> str:
        return str(self.answer)

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "verdict": self.verdict, "changes": [one.to_json() for one in self.changes], "runs": list(self.runs),
            "unit": self.unit, "values": {k: [list(p) for p in v] for k, v in self.values.items()},
            "stood_still": list(self.stood_still), "smallest_found": self.smallest_found, "silent": self.silent,
            "advice": self.advice,
        }  # fmt: skip


@validate_arguments
@linalg.one_thread()
def history(
    robot: RobotLike, runs: Sequence[RunLike], *, dates: Sequence[str | float | date] = (),
    effects: Sequence[str | Effect] | None = None,
) -> History:  # fmt: skip
    """The course over runs of one machine. ``dates`` are ISO dates or seconds since 1970, one for each run; left out,
    those of a column ``date``, or the runs' own clocks where these are such seconds; where no run knows its date, their
    order, a month apart.

    Raises :class:`~sherkit.errors.FitError` for fewer than two runs and
    :class:`~sherkit.errors.MeasurementError` for dates that are none, and where some runs know theirs and some do not.

        found = sk.history("demo/robot.toml", ["demo/whole.csv", "demo/local.csv"], dates=["2026-01-10", "2026-04-09"])
        print(found)
    """
    if len(runs) < 2:
        raise FitError(f"history: expected two runs or more, got {len(runs)}")
    if dates and len(dates) != len(runs):
        raise MeasurementError(f"dates: expected one for each of {len(runs)} runs, got {len(dates)}")
    made, data = read_robot(robot), read_runs(robot, runs)
    at_s, told = _dates(data, dates)
    order = [int(k) for k in np.argsort(at_s, kind="stable")]
    given = [data[k] for k in order]
    return concluded(Pool.of(made, given, effects), given, at_s[order], [told[k] for k in order])


def _dates(data: Sequence[Measurements], given: Sequence[str | float | date]) -> tuple[Floats, list[str]]:
    """When each run was taken (R,), s since 1970, or in their order, and how that is told."""
    at = [_seconds(one, "dates") for one in given] if given else [_own_date(one) for one in data]
    known = [one for one in at if one is not None]
    if not known:
        return _MONTH_S * np.arange(len(data), dtype=float), [f"run {k + 1}" for k in range(len(data))]
    if len(known) < len(at):
        without = [one.source for one, when in zip(data, at, strict=True) if when is None]
        raise MeasurementError(
            f"history: {listed(without)} {'says' if len(without) == 1 else 'say'} no date, the other runs do; give one "
            f"for each (--dates 2026-01-10,…)"
        )
    return np.array(known), [(_EPOCH + timedelta(seconds=one)).date().isoformat() for one in known]


def _own_date(data: Measurements) -> float | None:
    """When a run says that it was taken, s since 1970."""
    named = next((name for name in _DATES if name in data.labels), None)
    if named is not None:
        return _seconds(str(data.labels[named][0]), f"{data.source}: {named}")
    return data.begins_s if data.begins_s > _CLOCK_S else None


def _seconds(one: str | float | date, where: str) -> float:
    try:
        if isinstance(one, date):
            one = one.isoformat()
        if not isinstance(one, str):
            _EPOCH + timedelta(seconds=float(one))
            return float(one)
        made = datetime.fromisoformat(one)
    except (ValueError, OverflowError):
        raise MeasurementError(f"{where}: '{one}' is no date; expected 2026-03-31") from None
    return ((made if made.tzinfo else made.replace(tzinfo=UTC)) - _EPOCH).total_seconds()


def concluded(pool: Pool, every: Sequence[Measurements], at_s: Floats, dates: Sequence[str]) -> History:
    """What follows from runs in the order of time: of those that can speak."""
    if pool.joined is None:
        return History(
            verdict=pool.unsaid, changes=(), runs=_runs(pool, every, dates), unit=pool.unit, values={}, stood_still=(),
            silent=pool.why_silent, advice="; ".join(pool.to_measure),
        )  # fmt: skip
    found = _told(pool, at_s, dates)
    if found.verdict in ("unchanged", "undecided") and (speaking := pool.speaking()) is not pool:
        # what says nothing may hide what others say
        return concluded(speaking, every, at_s, dates)
    return replace(found, runs=_runs(pool, every, dates))


def _told(pool: Pool, every_s: Floats, every_date: Sequence[str]) -> History:
    joined, data, needed = pool.joined, pool.data, pool.needed
    assert joined is not None, "asked of two runs or more"
    count, at_s, dates = len(data), every_s[list(pool.numbers)], [every_date[k] for k in pool.numbers]
    courses = [(STEP, k + 1, one) for k, one in enumerate(joined.steps)]
    # the first or the last run alone is a step
    courses += [(ONCE, k, np.eye(count)[k]) for k in range(1, count - 1)]
    months = (at_s - at_s[0]) / _MONTH_S
    if count > 2 and np.ptp(months) > 0:
        courses.append((RAMP, 0, months))
        # wear that began later; from the run before the last on it is a step
        later = np.unique(np.linspace(1, count - 3, min(max(count - 3, 0), _ONSETS)).astype(np.int64)).tolist()
        courses += [(RAMP, k, np.maximum(months - months[k], 0.0)) for k in later if months[k] < months[-1]]
    temperatures = np.array(
        [float(d.covariates[TEMPERATURE].mean()) if TEMPERATURE in d.covariates else np.nan for d in data]
    )
    if count > 2 and np.isfinite(temperatures).all() and np.ptp(temperatures) > 0.5:
        courses.append((SEASON, 0, temperatures - temperatures[0]))
    made = Courses.of(joined, [factors for _, _, factors in courses], waves=False)
    base = made.base
    slow = [k for k, (kind, _, _) in enumerate(courses) if kind in (RAMP, SEASON)]
    found, left = ([], base) if made.quiet else _found(base, slow)
    verdict = made.quiet or change_verdict(found, explains=left.evidence < ALARM)
    tied: list[tuple[str, ...]] = []
    for k, block in enumerate(found):
        called = {(one.name, courses[one.since][0]): None for one in _instead(base, found, k)}
        called.pop((block.name, courses[block.since][0]), None)
        tied.append(tuple(_called(*one) for one in called)[:A_FEW])
    changes = []
    about = joined.about([(b.effect, courses[b.since][2]) for b in found if b.effect])[0]
    swaps = joined.swaps(about)
    for number, (block, told, other) in enumerate(zip(found, about.told, tied, strict=False)):
        kind, since, _ = courses[block.since]
        changes.append(Course(
            block.name, kind, pool.numbers[since] if since else None, dates[since] if since else "",
            tuple((p.name, value, std, p.unit) for p, value, std in told),
            _exceeds(about, number, months - months[since], needed, joined) if kind == RAMP else "",
            (*(b for a, b in swaps if a in [p.name for p, _, _ in told]), *other)[:A_FEW],
        ))  # fmt: skip
    # of each change the number that moved most is followed through all runs
    values = _by_run(
        joined, found, [max(one, key=lambda x: abs(x[1]) / x[2])[0].name for one in about.told[: len(found)] if one]
    )
    seen = {block.name for block in found}
    still = [c.name for c in joined.candidates if c.name not in seen]
    quiet = verdict == "unchanged"
    if quiet:
        advice = unchanged_advice(float(joined.fit.error.rms), needed, pool.unit, joined)
    elif _is_gone(verdict, changes):
        days = listed([f"in {data[pool.numbers.index(one.since)].source}" for one in changes if one.since is not None])
        advice = f"look for what was different {days}: it is gone since, and the calibration of the other runs holds"
    else:
        advice = about.doubt([*seen]) + _ADVICE[verdict]
    if sum(one.kind in (STEP, ONCE) for one in changes) > 1 and np.isnan(temperatures).any():
        advice += (
            "; not all of these runs recorded temperature_c: what goes with the season looks like steps, too, so "
            "record it before something is taken for several accidents"
        )
    return History(
        verdict=verdict, changes=tuple(changes), runs=(), unit=pool.unit, values=values, stood_still=tuple(still),
        known=joined.known,
        smallest_found=pool.smallest if quiet else None, silent=pool.why_silent,
        advice="; ".join([advice, *pool.to_measure]),
    )  # fmt: skip


def _is_gone(verdict: str, changes: Sequence[Course]) -> bool:
    """Whether all that has changed did so for one run."""
    return verdict == "changed" and all(one.kind == ONCE for one in changes)


def _found(base: Base, slow: Sequence[int]) -> tuple[list[Block], Base]:
    """The changes in the order in which they were found, and what is left.

    From several beginnings: an effect of many numbers imitates two of one each, and wear with a service in between a
    few of runs alone, so that ``slow`` courses are among them. Of those that explain all, and no worse than shapes do,
    the likeliest; else each as long as it says clearly more than a shape.
    """
    first = likeliest(base.family, base.each, FIRSTS)
    every = [_added(base, block) for block in first]
    if min((len(one[1]) for one in every if one[2].evidence < ALARM), default=_MOST) > 2:
        every += [_added(base, b) for b in base.family.blocks if b.name == first[0].name and b.since in slow]
    whole = [one for one in every if one[2].evidence < ALARM]
    value, found, _ = max(whole, key=lambda one: one[0], default=(-np.inf, [], base))
    if value <= described(base).evidence - SURE:
        found = _added(base)[1]
    # a change with which others began may say nothing beside them, and a part of it may be enough
    for block in found if len(found) > 1 else ():
        beside = base.beside(*(one for one in found if one is not block))
        each = np.where([one.name == block.name for one in base.family.blocks], beside.effects, -np.inf)
        best = [base.family.blocks[int(np.argmax(each))]] if each.max() > 0 else []
        at = found.index(block)
        found = [*found[:at], *best, *found[at + 1 :]]
    return found, base.beside(*found)


def _added(base: Base, first: Block | None = None) -> tuple[float, list[Block], Base]:
    """What the readings say of changes, these, and what is left: one after another as long as something is. From a
    ``first`` on each that the readings favour, else those alone that say clearly more than a shape."""
    value, found = -ONE_MORE, list[Block]()
    while base.evidence >= ALARM and len(found) < _MOST:
        block = first if first and not found else base.family.blocks[int(np.argmax(base.effects))]
        says = float(base.effects[base.family.where(block)])
        if says < (0.0 if first else base.shapes.max(initial=-np.inf) + SURE):
            break
        found.append(block)
        value += says + ONE_MORE
        base = base.beside(block)
    # what two parts of an effect did alike, all of it did
    at = [(one.name, one.since) for one in found]
    whole = {key: (at.count(key) > 1 and base.all_or_part(one)) or one for key, one in zip(at, found, strict=True)}
    return value, list(whole.values()), base


def _instead(base: Base, found: Sequence[Block], k: int) -> list[Block]:
    """What would say as much in the place of one of those that were found, beside the others."""
    beside = base.beside(*(one for one in found if one is not found[k]))
    least = beside.effects[base.family.where(found[k])] - TIED
    return [base.family.blocks[i] for i in np.argsort(-beside.effects).tolist() if beside.effects[i] > least]


def _called(name: str, kind: str) -> str:
    return f"{name} in one run alone" if kind == ONCE else f"{name} as a {kind}"


def _exceeds(about: About, number: int, months: Floats, needed: float | None, joined: Joined) -> str:
    """When a ramp alone will be more than what is needed."""
    unit = joined.runs[0].data.layout
    effect = about.changes[number][0]
    by = about.values[about.of(number)] / [p.size for p in effect.parameters]
    shown = joined.columns_of(effect, np.ones(len(joined.runs)))[: joined.count] @ by
    noise = joined.by_row([joined.sigma(run) for run in joined.runs])[: joined.count, None]
    per_month = unit.per_unit * float(np.sqrt(np.square(shown * noise).sum() / joined.count))
    if needed is None or unit.unit != "µm" or per_month <= 0:
        return ""
    left = needed / per_month - months[-1]
    return "already" if left <= 0 else f"in {left:.0f} months"


def _by_run(joined: Joined, found: Sequence[Block], names: Sequence[str]) -> dict[str, list[tuple[float, float]]]:
    """How far parameters of these ``names`` stand from the first run in each run, with their deviations, where all
    that was ``found`` may be another in each."""
    later = np.eye(len(joined.runs))[1:]
    about, _ = joined.about([(block.effect, one) for block in found if block.effect for one in later])
    told = [*zip(about.parameters, about.values.tolist(), about.std_from_readings.tolist(), strict=True)]
    return {name: [(0.0, 0.0), *((by, std) for p, by, std in told if p.name == name)] for name in names}


def _runs(pool: Pool, every: Sequence[Measurements], dates: Sequence[str]) -> tuple[dict[str, Any], ...]:
    """All runs; of those that were left out there is no error."""
    joined = pool.joined
    seen = (
        {} if joined is None else dict(zip(pool.numbers, zip(joined.runs, errors_of(joined), strict=True), strict=True))
    )
    out = []
    for k, (given, when) in enumerate(zip(every, dates, strict=True)):
        run, error = seen.get(k, (None, None))
        out.append({"run": given.source, "date": when, "rows": len(given),
                    "error": None if error is None else finite(error),
                    "stand": {} if run is None else run.stand.moved,
                    "left_out": pool.why_silent.get(pool.names[k], "")})  # fmt: skip
    return tuple(out)
