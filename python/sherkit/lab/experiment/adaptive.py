"""A run whose poses nobody planned: a loop chooses them, the runner drives them, its file keeps why.

What the loop holds follows from the rows of the run file, so that a run that was interrupted goes on as if nothing had
been.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...adaptive import Adaptive
from ...adaptive.loop import BATCH, BUDGET
from ...data.columns import POSE, REASON, REPEAT, TIME
from ...data.toml import Table
from ...model.kinds import Robot, kind_of
from .plan import Plan, PlanStep
from .run_file import RunFile


def adaptive_settings(table: Table, robot: Robot) -> dict[str, Any]:
    """What ``[adaptive]`` says, as :class:`~sherkit.Adaptive` takes it. Raises
    :class:`~sherkit.errors.ExperimentError` naming the key."""
    kind = kind_of(robot)
    box: dict[str, list[float]] = {}
    with table.table("box", optional=True) as inner:
        for name in dict.fromkeys((*kind.layout.joints, *kind.coordinates)):
            ends = inner.numbers(name, 2, (0.0, 1.0))
            if inner.has(name):
                box[name] = list(ends)
    required = table.positive("required_um")
    minutes = table.positive("minutes")
    return {
        "required_um": required,
        "budget": table.whole("budget", BUDGET, least=1),
        "minutes": minutes,
        "span_min": table.number("span_min", 0.0),
        "box": box or None,
        "level": table.number("level", 0.01, positive=True),
        "batch": table.whole("batch", BATCH, least=1),
        "seed": table.whole("seed", 0, least=0),
    }


class AdaptiveRun:
    """A loop and the run file that it fills: :meth:`more` is what the runner asks when all steps are taken."""

    def __init__(self, robot: Robot, settings: Mapping[str, Any]) -> None:
        self.robot, self.settings = robot, dict(settings)
        self.loop = Adaptive(robot, **self.settings)

    def first(self) -> Plan:
        """The poses to begin with, from the middle of the robot's workspace."""
        start = np.asarray(self.robot.inverse(self.robot.middle), dtype=float)
        return Plan(self._steps(), tuple(start.tolist()))

    def _steps(self) -> tuple[PlanStep, ...]:
        joints = kind_of(self.robot).layout.joints
        return tuple(
            PlanStep(
                row[POSE], row[REPEAT], tuple(row[name] for name in joints), (), row["not_before_s"], row["reason"]
            )
            for row in self.loop.ask()
        )

    def take(self, file: RunFile) -> None:
        """Tells the loop what stands in the run file; what it knows already is no news."""
        why = {(step.pose, step.repeat): step.reason for step in file.plan.steps}
        points = [(p, why.get((p.pose, p.repeat), "")) for p in file.points()]
        if points:
            self.loop.tell([{POSE: p.pose, REPEAT: p.repeat, TIME: p.time_s, **p.values, REASON: reason}
                            for p, reason in points])  # fmt: skip

    def more(self, file: RunFile, plan: Plan) -> Plan | None:
        """The plan that goes on, or None where it is known."""
        self.take(file)
        return plan.longer(self._steps()) if not self.loop.done else None
