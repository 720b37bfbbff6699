"""What has changed between runs of the same machine: whether, where, which, what it cannot be told from, what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Any

import numpy as np

from ..adaptive.evidence import Evidence
from ..adaptive.hypotheses import Hypothesis
from ..adaptive.look import FAR, Keys
from ..adaptive.rule import fewest
from ..base import linalg
from ..base.arguments import as_annotated
from ..base.figures import finite
from ..base.notebook import Shown
from ..base.types import Floats
from ..data import Measurements
from ..data.reader import RunLike
from ..errors import FitError, SherkitError
from ..evidence.sizes import PLAUSIBLE
from ..evidence.whitening import orthonormal
from ..fit.error import ErrorSize, of_residuals
from ..model.effect import Effect
from ..model.robot_file import RobotLike, load_robot
from .joined import Joined
from .joined import Moved as Shift
from .pool import ALARM, Pool, read_runs, sees_of, unchanged_advice

#: Evidence (a logarithm) of no change, and of a name ahead of a shape; of another name it is FAR.
QUIET, SHAPES = np.log(20.0), np.log(1e3)
#: A change of one unit of the noise must be seen with readings of so many beyond what is free.
_FEWEST = 12
_MOST_TIED = 8
#: Changes that are fitted in full, and steps of that.
_FULL, _REFITS = 3, 3
#: Part by which a fit in full may leave more than to first order.
_WORSE = 0.02
#: Poses that are proposed, of how many.
_POSES, _CANDIDATES = 8, 200


@dataclass(frozen=True)
class Moved:
    """A parameter that has changed: by how much, with its deviation, in its unit, since which run (from 0)."""

    name: str
    change: float
    std: float
    unit: str
    since: int = 1

    def __str__(self) -> str:
        times, unit = {"rad": (1e3, "mrad"), "mm": (1e3, "µm")}.get(self.unit, (1.0, self.unit))
        return f"{self.name} by {times * self.change:.3g} ± {times * self.std:.2g} {unit}".rstrip()

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {"name": self.name, "change": self.change, "std": self.std, "unit": self.unit, "since": self.since}


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
    parameters: tuple[Moved, ...]
    next_poses: tuple[dict[str, float], ...]
    evidence: float
    ranked: tuple[tuple[str, float], ...]
    where: str
    advice: str
    smallest_found: float | None = None
    unseen: tuple[tuple[str, float], ...] = ()
    silent: dict[str, str] = field(default_factory=dict)
    aside: dict[str, int] = field(default_factory=dict)
    joined: Joined | None = field(default=None, repr=False)

    @property
    def verdict_and_what(self) -> str:
        """The verdict, and what has changed."""
        told = "; ".join(map(str, self.parameters)) or ", ".join(self.changed)
        return f"{self.verdict}: {told}" if told else self.verdict

    @property
    def headline(self) -> str:
        """The same in one line with the runs that cannot speak."""
        return "; ".join([self.verdict_and_what, *(f"{name}: {why}" for name, why in self.silent.items())])

    @property
    def sees(self) -> str:
        """What these runs would have shown, where they show nothing."""
        return sees_of(self.smallest_found, self.unit)

    def __repr__(self) -> str:
        lines = [self.headline, *(f"  {' or '.join(tie)}: these runs cannot tell" for tie in self.indistinguishable)]
        lines.append(f"  before {_told(self.error['before'])}, after {_told(self.error['after'])} {self.unit}")
        return "\n".join([*lines, *([f"  {self.sees}"] if self.sees else []), f"  {self.advice}"])

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


def _told(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.4g}"


@as_annotated
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
    made = load_robot(robot) if isinstance(robot, str | PathLike) else robot
    return concluded(Pool.of(made, read_runs(made, runs), effects))


def concluded(pool: Pool) -> Comparison:
    """What follows from runs that were joined."""
    joined, data = pool.joined, pool.data
    if joined is None:
        return _nothing_said(pool)
    count = len(joined.runs)
    steps = [np.array([float(k >= since) for k in range(count)]) for since in range(1, count)]
    evidence = joined.evidence({"": steps})
    if evidence.alone.log_mean < ALARM and (speaking := pool.speaking()) is not pool:
        # what says nothing may hide what others say
        return concluded(speaking)
    sets = evidence.sets() if evidence.alone.log_bf else {}
    verdict, lead, ties, about = verdict_of(joined, evidence, sets, steps)
    names = tuple(sorted(name for name, _ in lead))
    moved, left = estimated(about, lead, steps)
    moved = tuple(replace(one, since=pool.numbers[one.since]) for one in moved)
    large = [one for one in moved if _is_large(joined, names, one)] if verdict != "unexplained" else []
    tied = tuple(_named(keys) for keys in ties)
    fit = joined.fit
    after = errors_after(joined)
    before = fit.error
    ranked = sorted(
        ((_named(keys), value / float(np.log(10.0))) for keys, value in sets.items()), key=lambda one: -one[1]
    )
    poses = next_poses(joined, ties, steps) if len(ties) > 1 else ()
    error = {"before": float(before.rms), "after": None if after is None else float(after.rms), "needed": pool.needed}
    called = [_called(one, number) for one, number in zip(data, pool.numbers, strict=True)]
    return Comparison(
        verdict=verdict,
        changed=names if verdict in ("changed", "partly explained") else (),
        indistinguishable=(tied,) if len(tied) > 1 and verdict in ("changed", "partly explained") else (),
        stand={name: joined.runs[k].stand.moved for k, name in enumerate(called) if k},
        error=error,
        unit=before.unit,
        parameters=moved if verdict in ("changed", "partly explained") else (),
        next_poses=poses,
        evidence=evidence.alone.log_mean / float(np.log(10.0)),
        ranked=tuple(ranked[:5]),
        where=_where(evidence) if verdict not in ("unchanged", "undecided") else "",
        advice="; ".join(
            [
                unchanged_advice(float(before.rms), pool.needed, before.unit)
                if verdict == "unchanged"
                else _doubt(large) + _advice(verdict, names, tied, bool(poses), left),
                *pool.to_measure,
            ]
        ),
        smallest_found=pool.smallest if verdict == "unchanged" else None,
        unseen=pool.unseen if verdict == "unchanged" else (),
        silent={name: str(one) for name, one in pool.silent.items()},
        aside={name: len(joined.runs[k].aside) + int(data[k].outlier.sum()) for k, name in enumerate(called)},
        joined=joined,
    )


def _nothing_said(pool: Pool) -> Comparison:
    """Where fewer than two runs can speak."""
    return Comparison(
        verdict="undecided", changed=(), indistinguishable=(), stand={},
        error={"before": None, "after": None, "needed": pool.needed}, unit=pool.unit, parameters=(), next_poses=(),
        evidence=0.0, ranked=(), where="", advice="; ".join(pool.to_measure),
        silent={name: str(one) for name, one in pool.silent.items()},
    )  # fmt: skip


def _called(data: Measurements, number: int) -> str:
    return f"{number + 1}: {data.source}"


def _named(keys: Keys) -> str:
    return " & ".join(sorted(name for name, _ in keys))


def in_full(joined: Joined, keys: Keys, steps: Sequence[Floats]) -> Joined:
    """The runs about the model with a set of changes in it, as large as they then are."""
    values = [np.zeros(len(joined.candidate(name).parameters)) for name, _ in keys]
    now = joined
    for _ in range(_REFITS):
        blocks = [now.columns_of(name, steps[int(at or 0)]) for name, at in keys]
        found, _, _ = now.estimate(np.concatenate(blocks, axis=1))
        ends = np.cumsum([0, *(block.shape[1] for block in blocks)])
        for k, (name, _) in enumerate(keys):
            values[k] = values[k] + found[ends[k] : ends[k + 1]] * [p.size for p in joined.candidate(name).parameters]
        moved = [Shift(name, v, steps[int(at or 0)]) for (name, at), v in zip(keys, values, strict=True)]
        try:
            now = joined.at(moved)
        except SherkitError:
            # as far as that the robot does not reach its own poses
            return now
    return now


@dataclass(frozen=True, eq=False)
class Weighed:
    """A set of changes in the model: the runs about it, what all others say beside it, and by name."""

    joined: Joined
    rest: float
    given: Mapping[str, float]
    gained: float


def _weighed(joined: Joined, evidence: Evidence, keys: Keys, steps: Sequence[Floats]) -> Weighed:
    full = in_full(joined, keys, steps)
    after = full.evidence({"": steps})
    seen = [key for key in keys if key[0] in after.tried]
    linear, exact = evidence.left_of(keys), after.left_of(seen)
    if not exact <= linear * (1.0 + _WORSE):
        # it leads nowhere as a change of that size: what it says to first order stands
        beside = evidence.beside(keys)
        return Weighed(joined, beside.log_mean, beside.log_bf, 0.0)
    beside = after.beside(seen) if seen else after.alone
    gained = 0.5 * evidence.free * float(np.log(max(linear, 1e-300) / max(exact, 1e-300)))
    return Weighed(full, beside.log_mean, beside.log_bf, max(gained, 0.0))


def verdict_of(
    joined: Joined, evidence: Evidence, sets: Mapping[Keys, float], steps: Sequence[Floats]
) -> tuple[str, Keys, list[Keys], Joined]:
    """Verdict, the leading set of changes, those that cannot be told from it, itself first, and the runs about it."""
    readings = sum(int(run.used.sum()) for run in joined.runs[1:])
    free = sum(run.stand.columns.shape[2] for run in joined.runs[1:])
    enough = readings - free >= _FEWEST and evidence.free >= _FEWEST
    alone = evidence.alone.log_mean
    if alone < ALARM or not sets:
        return ("unchanged" if alone < QUIET and enough else "undecided"), (), [], joined
    by_name = evidence.family.by_name
    values = dict(sets)
    causes = [keys for keys in values if not any(by_name[name].is_shape for name, _ in keys)]
    if not causes:
        return "unexplained", (), [], joined
    full: dict[Keys, Weighed] = {}
    singles = sorted((keys for keys in causes if len(keys) == 1), key=lambda keys: -values[keys])
    for keys in singles[:_FULL]:
        full[keys] = one = _weighed(joined, evidence, keys, steps)
        values[keys] += one.gained
        # what a second change is worth beside it, be it a shape
        for pair in [pair for pair in values if len(pair) == 2 and keys[0] in pair]:
            other = pair[0] if pair[1] == keys[0] else pair[1]
            weight = float(np.log(evidence.family.weight([name for name, _ in pair])))
            bf = values[keys] - float(np.log(evidence.family.weight([keys[0][0]])))
            given = weight + bf + one.given.get(other[0], 0.0)
            values[pair] = given if one.rest < QUIET else max(values[pair], given)
    lead = _lead(values, causes, full)
    if lead not in full:
        full[lead] = _weighed(joined, evidence, lead, steps)
    mine, own, rest = {name for name, _ in lead}, values[lead], full[lead].rest
    shape = max(
        (value for keys, value in values.items()
         if any(by_name[name].is_shape for name, _ in keys) and not mine <= {name for name, _ in keys}),
        default=-np.inf,
    )  # fmt: skip
    ties = fewest(lead, {keys: values[keys] for keys in causes if keys == lead or values[keys] > own - FAR})
    about = full[lead].joined
    margin = SHAPES if len(lead) == 1 else FAR
    # one change before two: however many pairs would do as well, a change alone is a name
    many = sum(len(keys) <= len(lead) for keys in ties) > _MOST_TIED
    if shape > own or many or (rest >= QUIET and own - shape <= FAR):
        certain = _in_all(values, by_name)
        if certain:
            return "partly explained", certain, [certain], in_full(joined, certain, steps)
        return "unexplained", lead, ties, about
    if rest >= QUIET:
        return "partly explained", lead, ties, about
    return ("changed" if own - shape >= margin else "partly explained"), lead, ties, about


def _in_all(values: Mapping[Keys, float], by_name: Mapping[str, Hypothesis]) -> Keys:
    """The change without which no set is likely, whatever stands beside it."""
    best = max(values.values())
    near = [dict(keys) for keys, value in values.items() if value > best - FAR]
    return tuple(
        (name, at) for name, at in near[0].items()
        if not by_name[name].is_shape and all(name in other for other in near)
    )[:1]  # fmt: skip


def _lead(values: Mapping[Keys, float], causes: Sequence[Keys], full: Mapping[Keys, Weighed]) -> Keys:
    """The likeliest set, one change before two: a pair leads only where it is far likelier than each of its two, or
    that leaves something."""
    ordered = sorted(causes, key=lambda keys: -values[keys])
    for keys in ordered:
        parts = [(key,) for key in keys if len(keys) > 1 and (key,) in full and full[(key,)].rest < QUIET]
        if not any(values[part] > values[keys] - FAR for part in parts):
            return keys
    return ordered[0]


def estimated(joined: Joined, lead: Keys, steps: Sequence[Floats]) -> tuple[tuple[Moved, ...], float]:
    """The changes with their deviations, and what is left over the noise."""
    if not lead:
        return (), 1.0
    blocks = [joined.columns_of(name, steps[int(at or 0)]) for name, at in lead]
    value, covariance, left = joined.estimate(np.concatenate(blocks, axis=1))
    std = np.sqrt(np.diag(covariance).clip(0.0))
    held = {(one.name, p.name): by for one in joined.moved
            for p, by in zip(joined.candidate(one.name).parameters, one.values, strict=True)}  # fmt: skip
    out, k = [], 0
    for (name, at), block in zip(lead, blocks, strict=True):
        for p in joined.candidate(name).parameters[: block.shape[1]]:
            by = held.get((name, p.name), 0.0) + float(value[k] * p.size)
            out.append(Moved(p.name, by, float(std[k] * p.size), p.unit, 1 + int(at or 0)))
            k += 1
    return tuple(out), left


def _is_large(joined: Joined, names: Sequence[str], one: Moved) -> bool:
    """Whether an effect is larger than is plausible: it may then stand for something else."""
    sizes = {
        p.name: p.size for name in names if joined.candidate(name).effect for p in joined.candidate(name).parameters
    }
    return one.name in sizes and abs(one.change) > PLAUSIBLE * sizes[one.name] + 2.0 * one.std


def errors_after(joined: Joined) -> ErrorSize | None:
    """How far the model of the first run is off in the later ones, each seen from where its sensor stands."""
    parts = []
    for run in joined.runs[1:]:
        columns = np.where(run.used[:, :, None], run.stand.columns, 0.0)
        flat = np.where(run.used, run.stand.residual, 0.0).reshape(-1)
        basis = orthonormal(columns)
        flat = flat - basis @ (basis.T @ flat)
        full = np.zeros(run.data.readings.shape)
        full[:, list(joined.axes)] = flat.reshape(run.used.shape)
        parts.append((run.data, full, int(run.used.any(axis=1).sum())))
    if not parts:
        return None
    sizes = [(of_residuals(data, left, held_out=False), n) for data, left, n in parts]
    total = sum(n for _, n in sizes)
    rms = float(np.sqrt(sum(n * size.rms**2 for size, n in sizes) / max(total, 1)))
    return replace(sizes[0][0], rms=rms)


def _where(evidence: Evidence) -> str:
    """Along what the change shows: the shape that describes it best."""
    shapes = {name: value for name, value in evidence.alone.log_bf.items() if evidence.family.by_name[name].is_shape}
    return max(shapes, key=lambda name: shapes[name]) if shapes and max(shapes.values()) > ALARM else ""


def _doubt(large: Sequence[Moved]) -> str:
    """That a change is larger than is plausible, in front of what to do."""
    if not large:
        return ""
    most = max(large, key=lambda one: abs(one.change))
    return f"{most} is more than such an effect plausibly does: look whether it stands for something else; "


def _advice(verdict: str, names: tuple[str, ...], tied: tuple[str, ...], proposed: bool, left: float) -> str:
    if verdict == "undecided":
        return "measure more poses: these are too few to say whether anything has changed"
    if verdict == "changed" and len(tied) > 1:
        more = "measure the poses below as well" if proposed else "measure other poses as well"
        return f"{more}: these runs cannot tell {' from '.join(tied[:3])}; or calibrate again"
    if verdict == "changed":
        return f"calibrate again {' and '.join(names)} alone: what is then left is {left:.2g} times the noise"
    return "calibrate again, all of it: no single change explains what is seen"


def next_poses(joined: Joined, ties: Sequence[Keys], steps: Sequence[Floats]) -> tuple[dict[str, float], ...]:
    """Poses at which the tied changes, as they were estimated, would show farthest apart."""
    last = joined.runs[-1]
    reachable = joined.model.reachable(last.data, joined.fit.values)
    if reachable is None:
        return ()
    rows = reachable.rows.select(np.arange(min(len(reachable.rows), _CANDIDATES)))
    columns = joined.columns_at(rows)
    told = []
    for keys in ties[:3]:
        blocks = [joined.columns_of(name, steps[int(at or 0)]) for name, at in keys]
        value, _, _ = joined.estimate(np.concatenate(blocks, axis=1))
        there = np.concatenate([columns[name] for name, _ in keys], axis=2)
        told.append(there @ value)
    apart = np.max([np.linalg.norm(a - told[0], axis=1) for a in told[1:]], axis=0)
    names = {**dict(zip(rows.layout.joints, rows.joints.T, strict=True))}
    names |= {name: values[: len(rows)] for name, values in reachable.targets.items()}
    best = np.argsort(-apart)[:_POSES]
    return tuple({name: float(values[k]) for name, values in names.items()} for k in best)
