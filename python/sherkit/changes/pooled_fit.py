"""Several runs of one machine as one run over its noise, about the model as the first run has it.

What all runs share are the parameters; each later run has a stand of its own (:mod:`~.stand`) and noise of its own. A
change is what a parameter, or an effect, does in the course of the runs. Effects of the temperature are free beside it,
as large as they are plausible: a robot that is warmer has not changed. What the model misses in all runs is noise of
the comparison: an error of its own at each pose, which runs have in common where they were read at the same poses; one
error for all places of a run where the first run never was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..base.types import Floats
from ..data import Measurements
from ..errors import FitError
from ..evidence.linearised import Linearised
from ..evidence.run import Run
from ..evidence.thresholds import SAME_PLACE, SURE_SIGMA, WRONG
from ..evidence.whitening import InCommon, Whitening, orthonormal
from ..fit.identify import Fit
from ..model.effect import WITHIN, Effect
from .change_model import About, Change, ChangeRows
from .runs import OWN_NOISE, RunData, change_candidates, change_columns, growth_of, held_of, seen, zeros_of

#: Part of a joint's range up to which poses are one, and by which another run may go beyond it.
_BEYOND = 0.1


@dataclass(frozen=True, eq=False)
class _JoinedColumns:
    """Derivatives by what is free, by the joints, by every candidate."""

    free: Floats
    inputs: Floats | None
    candidates: Floats

    def fitted(self, rows: slice) -> tuple[Floats, Floats | None]:
        return self.free[rows], None if self.inputs is None else self.inputs[rows]

    def effects(self, rows: slice) -> Floats:
        return self.candidates[rows]


def rows_as_run(
    residual: Floats, free: Floats, candidates: Sequence[tuple[Effect, Floats]], white: Whitening, **around: Any
) -> Run:
    """Rows over their noise: a ``residual`` (n, m), columns (n, m, p) of what is ``free`` and of each candidate, and
    what is ``around`` them, as :class:`~sherkit.evidence.linearised.Linearised` has it."""
    ends = np.cumsum([0, *(columns.shape[2] for _, columns in candidates)]).tolist()
    each = [np.zeros((*residual.shape, 0)), *(columns for _, columns in candidates)]
    made = _JoinedColumns(free, around.pop("patterns", None), np.concatenate(each, axis=2))
    effects = tuple((e, slice(a, b)) for (e, _), a, b in zip(candidates, ends[:-1], ends[1:], strict=True))
    group = around.pop("group", np.arange(len(residual)))
    view = Linearised(residual, around.pop("variables", {}), group, group, made, effects=effects, **around)
    return Run(None, np.arange(len(residual)), np.ones(residual.shape[1]), view, white)


class Joined(ChangeRows):
    """Runs that were joined, and the ``candidates`` that may have changed in their course.

    ``fit`` is the model on the first of them, ``axes`` are the readings that are looked at; ``lasting`` (n, m, k) is
    what all runs lack alike. Raises :class:`~sherkit.errors.FitError` for a run that is too short or lies out of reach.
    """

    def __init__(
        self, fit: Fit, runs: Sequence[Measurements], axes: tuple[int, ...],
        moved: Sequence[tuple[Change, Floats]] = (), before: Joined | None = None, lasting: Floats | None = None,
    ) -> None:  # fmt: skip
        self.fit, self.axes, self.moved = fit, axes, tuple(moved)
        self.model, self.values = fit.model, fit.values
        self._data = [data.select(np.argsort(data.order, kind="stable")) for data in runs]
        self.growth: list[Effect] = growth_of(self.model, self._data) if before is None else before.growth
        self.candidates: list[Effect] = (
            change_candidates(self.model, self._data) if before is None else before.candidates
        )
        self._before, names = before, [p.name for p in self.model.parameters]
        self.runs: list[RunData] = [
            seen(*self.now(k), data, axes, names, [*self.candidates, *self.growth],
                 first=k == 0, before=None if before is None else before.runs[k])
            for k, data in enumerate(self._data)
        ]  # fmt: skip
        first = self.runs[0]
        self.takes_up = (
            zeros_of(self.candidates, {e.name: first.columns[e.name][first.rows] for e in self.candidates},
                     first.data.joints[first.rows]) if before is None else before.takes_up
        )  # fmt: skip
        known = [run.sigma for run in self.runs if run.sigma > 0]
        if not known:
            raise FitError(
                f"{runs[0].source}: no run has rows enough to tell the noise beside {len(fit.values)} parameters"
            )
        #: The noise of a run that does not tell its own.
        self.noise = float(np.exp(np.mean(np.log(known))))
        #: What is known of parameters stands in rows of its own, behind those that were read.
        self._known = [p.size for p in self.model.parameters] + [1.0 for e in self.growth for _ in e.parameters]
        self.count = sum(len(run.rows) for run in self.runs)
        self.lasting = np.zeros((self.count + self._more, len(axes), 0)) if lasting is None else lasting

    def at(self, about: About) -> Joined:
        """The same runs about a model in which these have changed, as large as they are."""
        return Joined(self.fit, self._data, self.axes, about.sized, self, self.lasting)

    def lacking(self, lasting: Floats) -> Joined:
        """The same runs, of which all lack these columns (n, m, k)."""
        return Joined(self.fit, self._data, self.axes, lasting=lasting)

    @property
    def known(self) -> tuple[str, ...]:
        """Effects that are in the model of all runs."""
        return tuple(one.name for one in self.model.effects if one.name not in WITHIN)

    @property
    def steps(self) -> list[Floats]:
        """Steps (R,) from each run on but the first: nothing before, all of it since."""
        return list(np.triu(np.ones((len(self.runs), len(self.runs))))[1:])

    # -- rows of all runs --------------------------------------------------------------------------------

    @property
    def _more(self) -> int:
        return -(-len(self._known) // len(self.axes))

    def sigma(self, run: RunData) -> float:
        """The noise of a reading in a run: where it has no repeats, without what is missed at its poses."""
        sigma, told = run.sigma or self.noise, [one.sigma for one in self.runs if one.repeats]
        if run.repeats or not told:
            return sigma
        return float(np.sqrt(max(sigma**2 - self.missed**2, min(float(np.mean(told)), sigma) ** 2)))

    def over(self, per_run: Sequence[Floats]) -> Floats:
        """Values (n, m, …) of each run over its noise, one run after the other; none of what is known of parameters."""
        flat = [values[run.rows] / self.sigma(run) for run, values in zip(self.runs, per_run, strict=True)]
        return np.concatenate([*flat, np.zeros((self._more, *flat[0].shape[1:]))])

    def by_row(self, per_run: Sequence[Any], beyond: Any = 0) -> Any:
        """One value, or the rows' own, of each run for all rows (n,)."""
        every = [np.broadcast_to(v, len(r.data))[r.rows] for r, v in zip(self.runs, per_run, strict=True)]
        return np.concatenate([*every, np.broadcast_to(beyond, self._more)])

    @cached_property
    def free(self) -> Floats:
        """Columns (n, m, p) of what needs no change: parameters of all runs, the stand of each, growth, what lasts."""
        shared = [self.over([run.own for run in self.runs])]
        shared += [self.over([run.columns[effect.name] for run in self.runs]) for effect in self.growth]
        known = np.concatenate(shared, axis=2)
        # a plausible size is knowledge: a reading of zero, as exact as that. Without it, what no run observes by itself
        # would be as large as makes good a change, where that has moved what is not observed
        at = np.arange(len(self._known))
        known[self.count + at // len(self.axes), at % len(self.axes), at] = 1.0 / np.array(self._known)
        blocks = [known, self.lasting]
        for run in self.runs:
            if width := run.stand.columns.shape[2]:
                mine = [r.stand.columns if r is run else np.zeros((*r.used.shape, width)) for r in self.runs]
                blocks.append(self.over(mine))
        return np.concatenate(blocks, axis=2)

    @cached_property
    def missed(self) -> float:
        """What the model misses at a pose of the first run (standard deviation of a reading, in its unit), beyond what
        repeats scatter by; none where nobody knows. What describes it was chosen from thousands of shapes: it counts as
        missed."""
        if self._before is not None:
            return self._before.missed
        first, told = self.runs[0], [run.sigma for run in self.runs if run.repeats]
        if not told:
            return 0.0
        noise = first.sigma if first.repeats else float(np.mean(told))
        own = [values[first.rows] for values in (first.own, *(first.columns[e.name] for e in self.growth))]
        basis = orthonormal(np.concatenate(own, axis=2))
        left = first.stand.residual[first.rows].ravel()
        left = left - basis @ (basis.T @ left)
        free = len(np.unique(first.data.standing[first.rows])) * len(self.axes) - basis.shape[1]
        more = float(left @ left) / max(len(left) - basis.shape[1], 1) - noise**2
        return float(np.sqrt(more)) if free >= OWN_NOISE and more > SURE_SIGMA * noise**2 * np.sqrt(2.0 / free) else 0.0

    @cached_property
    def elsewhere(self) -> tuple[float, ...]:
        """The part of the rows of each run that were read where the first run never was."""
        low, high = (of(self.runs[0].data.joints[self.runs[0].rows], axis=0) for of in (np.min, np.max))
        edge = _BEYOND * (high - low)
        every = [run.data.joints[run.rows] for run in self.runs]
        return tuple(float(np.mean(((q < low - edge) | (q > high + edge)).any(axis=1))) for q in every)

    def is_apart(self, number: int) -> bool:
        """Whether a run stands at other places than the first, and what the model lacks differs there."""
        return bool(self.missed > 0 and self.elsewhere[number] > WRONG)

    @cached_property
    def white(self) -> Whitening:
        """What weighs rows."""
        if self._before is not None:
            return self._before.white
        joints = np.concatenate([run.data.joints[run.rows] for run in self.runs])
        reach = SAME_PLACE * np.maximum(np.ptp(joints, axis=0), 1e-300)
        pose = np.unique(np.round(joints / reach), axis=0, return_inverse=True)[1].ravel()
        pose = np.concatenate([pose, pose.max() + 1 + np.arange(self._more)])
        poses = [len(np.unique(run.data.standing[run.rows])) for run in self.runs]
        size = self.missed * np.sqrt(1.0 + np.multiply(poses, self.elsewhere))
        steps = [np.maximum(np.diff(run.data.order[run.rows], prepend=-1), 1) for run in self.runs]
        lag = np.concatenate([*steps, np.ones(self._more)]).astype(np.int64)
        back = np.ones(len(lag), dtype=np.int64)
        back[np.cumsum([0, *(len(one) for one in steps[:-1])])] = 0
        back[self.count :] = 0
        # what is missed at a pose hands on to its repeats
        rho = 0.0 if self.missed else float(np.mean([run.rho for run in self.runs]))
        noises = self.by_row(list(size / [self.sigma(run) for run in self.runs]), 0.0)
        return Whitening(rho, lag, back, InCommon(pose, noises) if noises.any() else None)

    @cached_property
    def _around(self) -> dict[str, Any]:
        """What evidence asks of rows beside what is free."""
        joints, names = [run.data.joints for run in self.runs], self.runs[0].data.layout.joints
        places = [self.places(run) for run in self.runs]
        place = tuple(name for name in places[0] if all(name in one for one in places))
        found = {name: [q[:, k] for q in joints] for k, name in enumerate(names)}
        found |= {name: [one[name] for one in places] for name in place}
        every = {name: self.by_row(v, v[0][self.runs[0].rows[0]]) for name, v in found.items()}
        # errors of joints act at both ends of distances between places
        far = any(run.data.between_places[run.rows].any() for run in self.runs)
        there = [run.data.from_other_end.joints for run in self.runs] if far else []
        others = {name: self.by_row([q[:, k] for q in there], every[name][-1]) for k, name in enumerate(names) if far}
        wide = (1 + far) * len(names)
        inputs = [
            np.pad(one, ((0, 0), (0, 0), (0, len(names))))[:, :, :wide]
            for one in (run.inputs for run in self.runs)
            if one is not None
        ]
        moves = {name: values for name, values in every.items() if np.ptp(values) > 0}
        group = [run.data.standing + 1e9 * k for k, run in enumerate(self.runs)]
        pose = self.by_row(group, -1.0 - np.arange(self._more))
        return {
            "variables": moves,
            "group": np.unique(pose, return_inverse=True)[1].ravel(),
            "pattern_of": {name: name for name in names if name in moves} if len(inputs) == len(self.runs) else {},
            "place": tuple(name for name in place if name in moves),
            "inputs": {name: every[name] for name in names},
            "others": others,
            "patterns": self.over(inputs) if len(inputs) == len(self.runs) else None,
        }

    def run(self, changed: Floats | None = None) -> Run:
        """All rows as one run over its noise, with the columns (n, m, k) of what has ``changed`` in the model first."""
        free = self.free if changed is None else np.concatenate([changed, self.free], axis=2)
        candidates = [(e, self.over([run.columns[e.name] for run in self.runs])) for e in self.candidates]
        residual = self.over([run.stand.residual for run in self.runs])
        return rows_as_run(residual, free, candidates, self.white, **self._around)

    def places(self, run: RunData) -> Mapping[str, Floats]:
        """Where the machine stood in the rows of a run, by name (n,)."""
        return self.model.place(run.data, self.model.predict(run.data, self.fit.values), self.fit.values)

    # -- changes -----------------------------------------------------------------------------------------

    def holding(self) -> Joined:
        """As of any rows."""
        made, held = copy(self), held_of(self.model)
        made.candidates = [*self.candidates, *held]
        made.runs = [replace(run, columns={**run.columns, **self.held(k)}) for k, run in enumerate(self.runs)]
        return made

    def held(self, number: int) -> dict[str, Floats]:
        """Columns (n, m, k) of what the model holds at the drawing, of a run by its number."""
        run, model = self.runs[number], self.now(number)[0]
        found = change_columns(model, run.stand.values, run.data, self.axes, held_of(self.model))
        return {name: run.stand.in_model(one) for name, one in found.items()}

    def columns_of(self, effect: Effect, factors: Floats) -> Floats:
        """As of any rows."""
        every = [f * run.columns[effect.name] for f, run in zip(factors, self.runs, strict=True)]
        return self.over(every)[:, :, self.numbers(effect)]

    def lasting_of(self, changes: Sequence[Change]) -> list[Floats]:
        """As of any rows: what all runs have of them."""
        return [self.columns_of(effect, np.ones(len(self.runs))) for effect, _ in changes]
