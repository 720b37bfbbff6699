"""What has changed between runs of the same machine: whether, where, which, what it cannot be told from, what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..base import linalg
from ..base.answer import AFTER, BEFORE, TARGET, Answer, Bar, ToDo
from ..base.arguments import validate_arguments
from ..base.figures import finite, number, odds
from ..base.notebook import Shown
from ..data import Measurements
from ..data.columns import bare, unit_in
from ..data.reader import RunLike
from ..errors import FitError
from ..evidence.base import Base
from ..evidence.sets import EffectSet
from ..evidence.thresholds import ALARM, ROUNDING
from ..model.effect import Effect
from ..model.robot_file import RobotLike, read_robot
from .change_model import ParameterChange
from .courses import MEASURE_MORE, ChangeSets, Courses, change_verdict, named_changes
from .pool import Pool, calibrate_again, left_out, read_runs, sees_of, told_ties, unchanged_advice
from .pooled_fit import Joined
from .vouching import errors_of

#: Changes that a line holds; of more the clearest stands for all.
_FEW = 2
#: Poses that are proposed, of how many.
_POSES, _CANDIDATES = 8, 200


#: Medians by which a zero surely moved.
_SURELY = 10.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison(Shown):
    """The answers, in the order a person asks.

    ``verdict`` is ``unchanged``, ``changed``, ``partly explained``, ``unexplained`` or ``undecided``. ``silent`` says
    by run why it cannot speak; such runs are left out. ``unchanged`` are runs that would have shown an error of
    ``smallest_found`` at the places where the robot works in 95 of 100 cases; ``unseen`` are candidates that would not
    have shown as often at three times what is needed, with the chance.
    ``changed`` names parameters and effects, the leading ones where others explain as well; ``indistinguishable`` are
    groups that these runs cannot tell apart. ``stand`` says by run how far the sensor was moved. ``error`` has the
    errors ``before`` (rows held out of the first run), ``after`` (later runs by the model of the first, seen from where
    the sensor now stands) and what is ``needed``, in ``unit``. ``parameters`` are the changes with their deviations,
    ``evidence`` that anything has changed (a power of ten) and ``ranked`` the leading candidates, likewise.
    """

    verdict: str
    changed: tuple[str, ...]
    indistinguishable: tuple[tuple[str, ...], ...]
    stand: dict[str, dict[str, float]]
    error: dict[str, float | None]
    unit: str
    parameters: tuple[ParameterChange, ...]
    next_poses: tuple[dict[str, float], ...]
    evidence: float
    ranked: tuple[tuple[str, float], ...]
    where: str
    advice: str
    smallest_found: float | None = None
    unseen: tuple[tuple[str, float], ...] = ()
    silent: dict[str, str] = field(default_factory=dict)
    #: Effects that are in the model of all runs.
    known: tuple[str, ...] = ()
    aside: dict[str, int] = field(default_factory=dict)
    joined: Joined | None = field(default=None, repr=False)

    @property
    def verdict_and_what(self) -> str:
        """The verdict, and what has changed."""
        told, moved = ", ".join(self.changed), self.parameters
        if 0 < len(moved) <= _FEW:
            told = "; ".join(map(str, moved))
        elif moved:
            # by the size of its own that each has moved
            most = max(moved, key=lambda one: abs(one.change) / max(one.std, 1e-300))
            told += f", most clearly {most}"
        return f"{self.verdict}: {told}" if told else self.verdict

    @property
    def answer(self) -> Answer:
        """What it says for whoever reads nothing else."""
        before, after, needed = (self.error[name] for name in ("before", "after", "needed"))
        bars = ((BEFORE, "first run", before), (AFTER, "later, by the model of the first", after),
                (TARGET, "target", needed))  # fmt: skip
        return Answer(
            self.verdict_and_what, "", (*left_out(self.silent), *self.rests_on, *told_ties(self.indistinguishable)),
            (ToDo(self.advice, calibrate_again(self.verdict, self.known)),),
            tuple(Bar(what, name, value) for what, name, value in bars if value), self.unit,
        )  # fmt: skip

    @property
    def rests_on(self) -> tuple[str, ...]:
        """What the verdict rests on, in sentences."""
        before, after = self.error["before"], self.error["after"]
        said = [self.sees] if self.sees else []
        if before is not None and after is not None:
            said.append(
                f"The model of the first run is off by {number(after)} {self.unit} on later ones, {number(before)} on "
                f"its own; the odds that something has changed are {odds(self.evidence)}."
            )
        return (*said, *([f"It shows: {self.where}."] if self.where else []))

    @property
    def headline(self) -> str:
        """The same in one line with the runs that cannot speak."""
        return "; ".join([self.verdict_and_what, *(f"{name}: {why}" for name, why in self.silent.items())])

    @property
    def sees(self) -> str:
        """What these runs would have shown, where they show nothing."""
        return sees_of(self.smallest_found, self.unit)

    def __repr__(self) -> str:
        return str(self.answer)

    def to_json(self) -> dict[str, Any]:
        """For programs: the keys that the documents name."""
        return {
            "verdict": self.verdict,
            "changed": list(self.changed),
            "indistinguishable": [list(tie) for tie in self.indistinguishable],
            "stand": self.stand,
            "error": {name: None if value is None else finite(value) for name, value in self.error.items()},
            "unit": self.unit,
            "parameters": [one.to_json() for one in self.parameters],
            "next_poses": list(self.next_poses),
            "evidence": finite(self.evidence),
            "ranked": [{"name": name, "evidence": finite(value)} for name, value in self.ranked],
            "where": self.where,
            "advice": self.advice,
            "smallest_found": self.smallest_found,
            "unseen": [{"name": name, "chance": chance} for name, chance in self.unseen],
            "silent": self.silent,
            "left_out": self.aside,
        }


@validate_arguments
@linalg.one_thread()
def compare(robot: RobotLike, runs: Sequence[RunLike], *, effects: Sequence[str | Effect] | None = None) -> Comparison:
    """Compares runs of one machine, the first of them before, and says what has changed since.

    ``runs`` are files, frames or measurements, in the order of time; they may have other poses, noise and order, and
    the sensor may stand elsewhere. ``effects`` are in the model of all runs; left out, those that a diagnosis of the
    first run names. Raises :class:`~sherkit.errors.FitError` for fewer than two runs, or one that is too short.

        found = sk.compare("demo/robot.toml", ["demo/whole.csv", "demo/local.csv"])
        print(found.headline)
    """
    if len(runs) < 2:
        raise FitError(f"compare: expected two runs or more, the first of them before; got {len(runs)}")
    return concluded(Pool.of(read_robot(robot), read_runs(robot, runs), effects))


def concluded(pool: Pool) -> Comparison:
    """What follows from runs that were joined."""
    joined, data = pool.joined, pool.data
    if joined is None:
        return _nothing_said(pool)
    made = Courses.of(joined, joined.steps)
    # every shape counts here, those too that are an effect once more: sets take the weight of these only beside them
    if made.quiet and (speaking := pool.speaking()) is not pool:
        # what says nothing may hide what others say
        return concluded(speaking)
    sets = ChangeSets(joined, made.courses, made.base)
    names = None if made.quiet else named_changes(sets)
    lead, named = (names.lead, names.named) if names else (None, ())
    verdict = made.quiet or change_verdict(named, explains=bool(names and names.explains))
    ties = names.alike if names else ()
    moved = lead.run.of.moved(named) if lead else ()
    swaps = joined.swaps(lead.run.of) if lead else []
    moved = tuple(
        replace(one, since=pool.numbers[one.since], or_else=tuple(b for a, b in swaps if a == one.name))
        for one in moved
    )
    tied = names.tied if names else ()
    before = joined.fit.error
    rows = [len(run.rows) for run in joined.runs[1:]]
    # each seen from where its sensor stands
    first, *later = errors_of(joined)
    after = float(np.sqrt(np.average(np.square(later), weights=rows)))
    poses = next_poses(joined, ties) if len(ties) > 1 else ()
    error = {"before": first, "after": after, "needed": pool.needed}
    called = [f"{number + 1}: {one.source}" for one, number in zip(data, pool.numbers, strict=True)]
    if verdict == "unchanged":
        to_do = _zeros_moved(joined) or [unchanged_advice(float(before.rms), pool.needed, before.unit, joined)]
    else:
        what = _advice(verdict, named, tied, bool(poses), lead.run.of.left if lead else 1.0)
        to_do = [*differing(data, called), (lead.run.of.doubt(named) if lead else "") + what]
    return Comparison(
        verdict=verdict,
        changed=tuple(sorted(named)),
        indistinguishable=(*tied, *swaps),
        stand={name: joined.runs[k].stand.moved for k, name in enumerate(called) if k},
        error=error,
        unit=before.unit,
        parameters=moved,
        next_poses=poses,
        evidence=made.evidence / float(np.log(10.0)),
        ranked=tuple((" & ".join(one.names), one.value / float(np.log(10.0))) for one in sets.every[:5]),
        where=_where(made.base) if verdict in ("partly explained", "unexplained") else "",
        advice="; ".join([*to_do, *pool.to_measure]),
        smallest_found=pool.smallest if verdict == "unchanged" else None,
        unseen=pool.unseen if verdict == "unchanged" else (),
        silent=pool.why_silent,
        aside={name: len(joined.runs[k].aside) + int(data[k].outlier.sum()) for k, name in enumerate(called)},
        known=joined.known,
        joined=joined,
    )


def _zeros_moved(joined: Joined) -> list[str]:
    """Readings that are off by a constant since the first run, where the model has a parameter that is no other."""
    out = []
    for run in joined.runs[1:]:
        columns = joined.model.derivatives(run.data, joined.fit.values)[:, list(joined.axes)]
        for a, reading in enumerate(run.data.layout.readings[k] for k in joined.axes):
            off = run.stand.moved.get(f"zero_{bare(reading)}_{unit_in(reading)}")
            noise = float(np.median(np.abs(run.stand.residual[:, a]))) / np.sqrt(len(run.data))
            if off is None or abs(off) < _SURELY * noise:
                continue
            most = np.abs(columns[:, a]).max(axis=0)
            elsewhere = np.abs(np.delete(columns, a, axis=1)).max(axis=(0, 1), initial=0.0)
            alike = (most > 0) & (np.maximum(np.ptp(columns[:, a], axis=0), elsewhere) <= ROUNDING * most)
            names = [p.name for p, one in zip(joined.fit.parameters, alike, strict=True) if one]
            if names:
                out.append(
                    f"{reading} is off by {off:.4g} {unit_in(reading)} throughout: either its instrument was set anew, "
                    f"or {' or '.join(names)} changed; these runs cannot tell which, and one of the two is to be set"
                )
    return out


def differing(data: Sequence[Measurements], called: Sequence[str]) -> list[str]:
    """Columns of the runs that were never in one what they were in another: what follows them may be all the change."""
    out = []
    for name, first in data[0].covariates.items():
        if name in data[0].layout.velocities or name in data[0].layout.apart:
            continue
        for one, then in zip(data[1:], called[1:], strict=True):
            values = one.covariates.get(name)
            if values is None or (first.min() <= values.max() and values.min() <= first.max()):
                continue
            out.append(
                f"{name} is {np.mean(first):.4g} in {called[0]} and {np.mean(values):.4g} in {then}: what follows it "
                "shows as a change; compare runs in which it is the same, or diagnose both in one run"
            )
    return out


def _nothing_said(pool: Pool) -> Comparison:
    """Where fewer than two runs can speak."""
    return Comparison(
        verdict=pool.unsaid, changed=(), indistinguishable=(), stand={},
        error={"before": None, "after": None, "needed": pool.needed}, unit=pool.unit, parameters=(), next_poses=(),
        evidence=0.0, ranked=(), where="", advice="; ".join(pool.to_measure),
        silent=pool.why_silent,
    )  # fmt: skip


def _where(base: Base) -> str:
    """Along what the change shows: the shape that describes it best."""
    i = int(np.argmax(base.shapes)) if len(base.shapes) else -1
    if i < 0 or base.shapes[i] < ALARM:
        return ""
    block = base.family.blocks[i]
    return f"{block.shape} in {' and '.join(block.depends_on)}"


def _advice(verdict: str, names: tuple[str, ...], tied: Sequence[tuple[str, ...]], proposed: bool, left: float) -> str:
    if verdict == "undecided":
        return MEASURE_MORE
    if verdict == "changed" and tied:
        more = "measure the poses below as well" if proposed else "measure other poses as well"
        return f"{more}: these runs cannot tell {' from '.join(tied[0][:3])}; or calibrate again"
    if verdict == "changed":
        return f"calibrate again; with {' and '.join(names)} changed, what is left is {left:.2g} times the noise"
    return "calibrate again, all of it: no single change explains what is seen"


def next_poses(joined: Joined, ties: Sequence[EffectSet]) -> tuple[dict[str, float], ...]:
    """Poses at which the tied changes, as they were estimated, would show farthest apart."""
    reachable = joined.model.reachable(joined.runs[-1].data, joined.fit.values)
    if reachable is None:
        return ()
    rows = reachable.rows.select(np.arange(min(len(reachable.rows), _CANDIDATES)))
    columns = joined.columns_at(rows)
    told = []
    for about in (tie.run.of for tie in ties[:3]):
        every = np.concatenate([columns[e.name][:, :, joined.numbers(e)] for e, _ in about.changes], axis=2)
        told.append(every @ (about.values / [p.size for p in about.parameters]))
    apart = np.max([np.linalg.norm(a - told[0], axis=1) for a in told[1:]], axis=0)
    names = {**dict(zip(rows.layout.joints, rows.joints.T, strict=True))}
    names |= {name: values[: len(rows)] for name, values in reachable.targets.items()}
    best = np.argsort(-apart)[:_POSES]
    return tuple({name: float(values[k]) for name, values in names.items()} for k in best)
