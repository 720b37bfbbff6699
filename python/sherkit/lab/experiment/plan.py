"""Plans: which poses are measured, in which order, and from which side they are approached."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...base.figures import listed
from ...base.types import Floats
from ...errors import ExperimentError

# -- What is read at a step -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Point:
    """What was read at a step: its pose and repeat, the host's time (s since 1970), and values by column name."""

    pose: int
    repeat: int
    time_s: float
    values: Mapping[str, float]


# -- The plan --------------------------------------------------------------------------------------------------------

#: As listed, pass after pass; drawn anew for each pass; from the last to the first; to and fro, pass by pass.
ORDERS = ("planes", "shuffled", "reversed", "alternating")
#: A month of readings; a plan that is longer is a slip of the finger.
_MOST_STEPS = 100_000


@dataclass(frozen=True)
class PlanStep:
    """One reading: pose number and repeat (from 1), where the joints go, and the places they go through before.

    ``joints`` and ``via`` are in the robot's units (mm or rad). It is not read before the host's clock shows
    ``not_before_s``; ``reason`` says why it is in the plan, where a loop has chosen it.
    """

    pose: int
    repeat: int
    joints: tuple[float, ...]
    via: tuple[tuple[float, ...], ...] = ()
    not_before_s: float = 0.0
    reason: str = ""


@dataclass(frozen=True)
class Plan:
    """Steps in the order in which they are taken; a step is known by its place, from 0. ``start`` is where it begins.

    Every run drives to ``start`` first, so that the first reading is approached as in any other run.
    """

    steps: tuple[PlanStep, ...]
    start: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.steps:
            raise ExperimentError("the plan has no step")
        width = len(self.start)
        seen: dict[tuple[int, int], int] = {}
        for number, step in enumerate(self.steps):
            for place in (step.joints, *step.via):
                if len(place) != width or not np.isfinite(place).all():
                    raise ExperimentError(f"step {number}: expected {width} finite joint readings, got {list(place)}")
            before = seen.setdefault((step.pose, step.repeat), number)
            if before != number:
                raise ExperimentError(
                    f"steps {before} and {number}: both are pose {step.pose}, repeat {step.repeat}; number repeats of "
                    "a pose 1, 2, 3, …"
                )

    def __len__(self) -> int:
        return len(self.steps)

    def __iter__(self) -> Iterator[PlanStep]:
        return iter(self.steps)

    def longer(self, steps: Sequence[PlanStep]) -> Plan:
        """The plan that goes on with these steps."""
        return Plan((*self.steps, *steps), self.start)

    def places(self) -> Floats:
        """Every place that the joints are sent to (n, k), the start and those on the way among them."""
        return np.array([self.start, *(p for s in self.steps for p in (*s.via, s.joints))])

    @cached_property
    def _way(self) -> tuple[list[tuple[float, ...]], list[int]]:
        """Every place on the way, in order, and which of them comes before each step."""
        way, first = [self.start], []
        for step in self.steps:
            first.append(len(way))
            way += [*step.via, step.joints]
        return way, first

    def lead_in(self, number: int) -> tuple[tuple[float, ...], ...]:
        """Places to drive through so that step ``number`` is then approached as planned, by every joint.

        Goes back along the plan as far as it takes until each joint has moved: where it came from last is its history.
        """
        way, first = self._way
        end = first[number]
        moved = np.zeros(len(self.start), dtype=bool)
        # from the step's own place backwards
        for k in range(end, 0, -1):
            moved |= np.not_equal(way[k], way[k - 1])
            if moved.all() or k == 1:
                return tuple(way[k - 1 : end])
        return ()

    @cached_property
    def directions(self) -> Floats:
        """Sign of the last motion of each joint before each reading (n, k); +1 where it has not moved yet."""
        way, first = self._way
        change = np.sign(np.diff(np.array(way), axis=0))
        for k in range(1, len(change)):
            change[k] = np.where(change[k] != 0, change[k], change[k - 1])
        # a reading is taken at the last place of its step
        at = [after - 2 for after in (*first[1:], len(way))]
        return np.where(change[at] != 0, change[at], 1.0)

    def to_json(self) -> str:
        """What :meth:`from_json` reads, without loss."""
        chosen = any(s.reason for s in self.steps)
        steps = [
            [s.pose, s.repeat, s.joints, s.via, *([s.not_before_s, s.reason] if chosen else [])] for s in self.steps
        ]
        return json.dumps({"start": self.start, "steps": steps})

    @classmethod
    def from_json(cls, text: str) -> Plan:
        """Raises :class:`~sherkit.errors.ExperimentError` where the text holds no plan."""

        def place(given: Sequence[Any]) -> tuple[float, ...]:
            return tuple(map(float, given))

        def step(pose: Any, repeat: Any, joints: Any, via: Any, not_before_s: Any = 0.0, reason: Any = "") -> PlanStep:
            return PlanStep(
                int(pose), int(repeat), place(joints), tuple(map(place, via)), float(not_before_s), str(reason)
            )

        try:
            values = json.loads(text)
            return cls(tuple(step(*one) for one in values["steps"]), place(values["start"]))
        except (ValueError, TypeError, KeyError) as error:
            raise ExperimentError(f"this is no plan: {error}") from None


def plan_of_poses(
    joints: ArrayLike,
    start: Sequence[float],
    *,
    repeats: int = 1,
    order: str = "planes",
    seed: int = 0,
    approach: float | None = None,
) -> Plan:
    """A plan over the joint readings (n, k) of n poses, ``repeats`` times.

    ``approach`` (in the robot's units) takes every reading twice, coming from that far below in all joints and from
    that far above: what differs is backlash. Repeats are then counted in pairs. Raises
    :class:`~sherkit.errors.ExperimentError`.
    """
    places = np.atleast_2d(np.asarray(joints, dtype=float))
    if order not in ORDERS:
        raise ExperimentError(f"order: '{order}' is not known; choose {listed(ORDERS)}")
    if repeats < 1:
        raise ExperimentError(f"repeats: expected at least 1, got {repeats}")
    if len(places) * repeats > _MOST_STEPS:
        raise ExperimentError(
            f"the plan has {len(places)} poses, {repeats} times each; expected {_MOST_STEPS} steps at most"
        )
    rng = np.random.default_rng(seed)
    sides = [()] if approach is None else [(-approach,), (approach,)]
    steps: list[PlanStep] = []
    for one in range(repeats):
        walk = np.arange(len(places))
        if order == "shuffled":
            walk = rng.permutation(walk)
        elif order == "reversed" or (order == "alternating" and one % 2):
            walk = walk[::-1]
        for number in walk.tolist():
            target = tuple(places[number].tolist())
            for repeat, side in enumerate(sides, len(sides) * one + 1):
                via = tuple(tuple(q + off for q in target) for off in side)
                steps.append(PlanStep(number + 1, repeat, target, via))
    return Plan(tuple(steps), tuple(float(q) for q in start))
