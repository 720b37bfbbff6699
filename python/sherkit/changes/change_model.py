"""What has changed, in the model of the rows that show it: how large it is, and what is left then."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, ClassVar

import numpy as np

from ..base import linalg
from ..base.figures import stated
from ..base.types import Floats
from ..data import Measurements
from ..evidence.run import Run
from ..evidence.thresholds import PLAUSIBLE, SEEN_SIGMA, TIED
from ..evidence.whitening import orthonormal
from ..model.base import ModelWithEffects
from ..model.effect import Effect, Parameter
from .runs import change_columns

#: Part of a column that must be left of it to be seen.
SEEN = 1e-5


@dataclass(frozen=True)
class ParameterChange:
    """A parameter that has changed: by how much, with its deviation, in its unit, since which run (from 0), and those
    that explain as much in its place."""

    name: str
    change: float
    std: float
    unit: str
    since: int = 1
    or_else: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.name} by {self.by}" + (f" (as well fits: {' or '.join(self.or_else)})" if self.or_else else "")

    @property
    def by(self) -> str:
        """The change with its deviation, in the unit in which people read it."""
        return stated(self.change, self.std, self.unit)

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {"name": self.name, "change": self.change, "std": self.std, "unit": self.unit, "since": self.since,
                "indistinguishable": list(self.or_else)}  # fmt: skip


#: An effect in a course: factors (R,) of the runs.
Change = tuple[Effect, Floats]


@dataclass(frozen=True, eq=False)
class About:
    """Changes in the model of joined runs, as evidence asks a fit: their ``columns`` (N, k) by plausible sizes, what is
    ``free`` beside them (N, p), and the ``residual`` (N,) without any of them."""

    changes: tuple[Change, ...]
    columns: Floats
    free: Floats
    residual: Floats
    #: Numbers of where targets sit, which another tool puts anywhere.
    targets_anywhere: tuple[str, ...]

    #: Of where the sensor stands nothing is among them.
    free_of_pose = ()
    #: Nor does any change go with another.
    catalogue: ClassVar[tuple[Effect, ...]] = ()

    @property
    def fit(self) -> Any:
        """Itself, as its model is."""
        return self

    model = fit

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of all changes."""
        return tuple(p for effect, _ in self.changes for p in effect.qualified())

    @cached_property
    def _found(self) -> tuple[Floats, Floats, float]:
        return estimated(self.columns, self.free, self.residual)

    @property
    def values(self) -> Floats:
        """Of all parameters, in their units."""
        return self._found[0] * [p.size for p in self.parameters]

    @property
    def sized(self) -> list[tuple[Change, Floats]]:
        """Each change with its values."""
        return [(one, self.values[self.of(k)]) for k, one in enumerate(self.changes)]

    @property
    def std_from_readings(self) -> Floats:
        """The deviations of these."""
        return self._found[1] * [p.size for p in self.parameters]

    @property
    def left(self) -> float:
        """What is left over the noise (root mean square)."""
        return self._found[2]

    @cached_property
    def told(self) -> list[list[tuple[Parameter, float, float]]]:
        """Of each change the numbers that moved, with values and deviations: one after another those that may as well
        be zero are taken out."""
        k = self.columns.shape[1]
        value, std = np.zeros(k), np.zeros(k)
        some = np.arange(k)
        while len(some):
            value[:], std[:] = 0.0, 0.0
            value[some], std[some], _ = estimated(self.columns[:, some], self.free, self.residual)
            far = np.abs(value[some]) - SEEN_SIGMA * std[some]
            if (far > 0).all() or len(some) == 1:
                break
            some = np.delete(some, np.argmin(far / std[some].clip(1e-300)))
        every = [(p, float(v * p.size), float(s * p.size)) for p, v, s in zip(self.parameters, value, std, strict=True)]
        return [[one for one in every[self.of(k)] if one[2] > 0] for k in range(len(self.changes))]

    def moved_by(self, which: Sequence[int]) -> float:
        """By how much changes, by their numbers, move the readings together beside what is free, in noises (root of the
        sum of squares)."""
        at = np.concatenate([np.arange(self.columns.shape[1])[self.of(k)] for k in which])
        moved, basis = self.columns[:, at] @ self._found[0][at], orthonormal(self.free)
        return float(np.linalg.norm(moved - basis @ (basis.T @ moved)))

    def of(self, number: int) -> slice:
        """Where the parameters of a change stand among them, by its number."""
        ends = np.cumsum([0, *(len(effect.parameters) for effect, _ in self.changes)]).tolist()
        return slice(ends[number], ends[number + 1])

    def owns(self, effect: Effect) -> slice:
        """The same by its effect."""
        return self.of([one for one, _ in self.changes].index(effect))

    def moved(self, names: Sequence[str]) -> tuple[ParameterChange, ...]:
        """The numbers that moved of the changes of these names."""
        return tuple(
            ParameterChange(p.name, value, std, p.unit, int(np.flatnonzero(factors)[0]))
            for (effect, factors), told in zip(self.changes, self.told, strict=True) if effect.name in names
            for p, value, std in told
        )  # fmt: skip

    def doubt(self, names: Sequence[str]) -> str:
        """In front of what to do: that a change of these effects is larger than is plausible, where one is."""
        large = []
        for (effect, factors), told in zip(self.changes, self.told, strict=True):
            if effect.frees or effect.name not in names:
                continue
            most = float(np.abs(factors).max())
            for p, value, std in told:
                if abs(value) * most > PLAUSIBLE * p.size + 2.0 * std * most:
                    large.append((abs(value) * most / p.size, ParameterChange(p.name, value, std, p.unit)))
        if not large:
            return ""
        _, most_so = max(large, key=lambda one: one[0])
        return f"{most_so} is more than such an effect plausibly does: look whether it stands for something else; "


class ChangeRows(ABC):
    """Rows of a machine, some of them later than others, which a ``model`` at its ``values`` describes on these
    ``axes`` but for what has ``moved``, and of which ``candidates`` may have changed."""

    model: ModelWithEffects
    values: Floats
    axes: tuple[int, ...]
    candidates: Sequence[Effect]
    moved: Sequence[tuple[Change, Floats]]
    #: By the name of a number of a candidate, the parameters that take up where it has its zero.
    takes_up: Mapping[str, list[Effect]]

    @abstractmethod
    def at(self, about: About) -> ChangeRows:
        """The same about a model in which these have changed, as large as they are."""

    @abstractmethod
    def run(self, changed: Floats | None = None) -> Run:
        """All rows as one run over its noise, with the columns (n, m, k) of what has ``changed`` in the model first."""

    @abstractmethod
    def columns_of(self, effect: Effect, factors: Floats) -> Floats:
        """Columns (n, m, k) of a candidate or a part of it, by plausible sizes, at factors (R,) of the runs."""

    def columns_at(self, data: Measurements) -> dict[str, Floats]:
        """Columns (n, m, k) of every candidate for other rows, by the model without what has moved."""
        return change_columns(self.model, self.values, data, self.axes, self.candidates)

    def lasting_of(self, changes: Sequence[Change]) -> Sequence[Floats]:
        """What all runs may have of changes, (n, m, k) each; none where it is known."""
        del changes
        return ()

    def candidate(self, name: str) -> Effect:
        """The candidate of that name."""
        return next(one for one in self.candidates if one.name == name)

    def numbers(self, effect: Effect) -> list[int]:
        """Which numbers of a candidate a part of it has, or all where it is one."""
        return [self.candidate(effect.name).parameters.index(p) for p in effect.parameters]

    def about(self, changes: Sequence[Change]) -> tuple[About, Run]:
        """With changes, each an effect in a course (R,), in the model, behind them where they have their zeros, and
        beside them what all runs have of them: as large as they are to first order about what has moved already."""
        lasting = self.lasting_of(changes)
        changes = [*changes, *self._zeros_moved(changes)]
        courses = [self.columns_of(effect, factors) for effect, factors in changes]
        run = self.run(np.concatenate([*courses, *lasting], axis=2) if courses else None)
        white = run.flat(run.view.fitted(run.view.whole))
        mine, free = np.split(white, [sum(one.shape[2] for one in courses)], axis=1)
        # what has moved are these changes, as large as they were
        before = [values / [p.size for p in e.parameters] for (e, _), values in self.moved]
        moved = np.concatenate(before) if before else np.zeros(mine.shape[1])
        about = About(tuple(changes), mine, free, run.residual + mine @ moved, self.model.targets_anywhere)
        return about, replace(run, of=about)

    def zeros(self, effect: Effect) -> list[Effect]:
        """The parameters that take up where a change has its zeros."""
        every = (one for p in effect.qualified() for one in self.takes_up.get(p.name, ()))
        return list({one.name: one for one in every}.values())

    def _zeros_moved(self, changes: Sequence[Change]) -> list[Change]:
        out: list[Change] = []
        for effect, factors in changes:
            for one in self.zeros(effect):
                there = (np.array_equal(f, factors) and one.name == e.name for e, f in (*changes, *out))
                if not any(there):
                    out.append((one, factors))
        return out

    def now(self, number: int) -> tuple[ModelWithEffects, Floats]:
        """The model of a run by its number, and its values: with what has moved since."""
        model, values = self.model, dict(zip((p.name for p in self.model.parameters), self.values, strict=True))
        for (effect, factors), moved in self.moved:
            if factors[number] == 0.0:
                continue
            if any(p.name not in values for p in effect.qualified()):
                model = model.adopting(self.candidate(effect.name))
            for p, by in zip(effect.qualified(), moved, strict=True):
                values[p.name] = values.get(p.name, 0.0) + factors[number] * by
        return model, np.array([values.get(p.name, 0.0) for p in model.parameters])

    def holding(self) -> ChangeRows:
        """The same with what the model holds at the drawing among the candidates."""
        return self

    def swaps(self, about: About) -> list[tuple[str, str]]:
        """Numbers that moved in changes, each with another of the same effect that explains as much in its place; those
        of another tool with what is held of the robot, as the zero of the joint that it turns with."""
        whole, _ = self.about([(self.candidate(effect.name), factors) for effect, factors in about.changes])
        moved = {one.name for some in about.told for one, _, _ in some}
        kept = [k for k, p in enumerate(whole.parameters) if p.name in moved]

        def left(some: Sequence[int]) -> float:
            return estimated(whole.columns[:, some], whole.free, whole.residual)[2] ** 2

        most, out = left(kept) * (1.0 + 2.0 * TIED / len(whole.residual)), []
        for number in range(len(whole.changes)):
            own = range(*whole.of(number).indices(len(whole.parameters)))
            for one, other in product((k for k in kept if k in own), (k for k in own if k not in kept)):
                if left([other if k == one else k for k in kept]) < most:
                    out.append((whole.parameters[one].name, whole.parameters[other].name))
        return [*out, *self._held_swaps(whole, moved, most)]

    def _held_swaps(self, whole: About, moved: Collection[str], most: float) -> list[tuple[str, str]]:
        """The same of another tool, where less than ``most`` (a square over the noise) is left."""
        out, rows = [], None
        for effect, factors in whole.changes:
            mine = [p.name for p in effect.qualified() if p.name in moved and p.name in self.model.targets_anywhere]
            if not mine:
                continue
            rows = rows or self.holding()
            others = [one for one in whole.changes if one[0] is not effect]
            for held in rows.candidates[len(self.candidates) :]:
                if rows.about([*others, (held, factors)])[0].left ** 2 < most:
                    out += [(name, held.parameters[0].name) for name in mine]
        return out


def estimated(columns: Floats, free: Floats, residual: Floats) -> tuple[Floats, Floats, float]:
    """Values (k,) of the coefficients of columns (N, k) beside all that is ``free`` (N, p), their deviations, zero of
    what is not observed, and what is left of a residual over the noise (root mean square)."""
    base = orthonormal(free)
    rest, left = (values - base @ (base.T @ values) for values in (columns, residual))
    length = np.linalg.norm(rest, axis=0)
    there = length > SEEN * np.linalg.norm(columns, axis=0)
    over = np.where(there, 1.0 / np.where(there, length, 1.0), 0.0)
    square, turn = linalg.eigh((rest * over).T @ (rest * over))
    inverse = (turn * np.where(square > SEEN**2, 1.0 / square.clip(SEEN**2), 0.0)) @ turn.T * np.outer(over, over)
    value = inverse @ (rest.T @ left)
    off = left - rest @ value
    scale = float(off @ off) / max(len(left) - base.shape[1] - int(there.sum()), 1)
    return value, np.sqrt(scale * np.diag(inverse).clip(0.0)), float(np.sqrt(scale))
