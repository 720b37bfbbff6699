"""What a loop is to do: the robot, where it may go, how well and over what time it is judged, what may be spent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import polars as pl

from ..base.arguments import Count, Level, NotNegative, Positive, Seed, validate_arguments
from ..model.kinds import kind_of, model_of
from ..model.kinds import required_um as stated_um
from ..model.robot_file import RobotLike, read_robot
from ..planning.region import Region

#: Readings in a batch and in all, unless it is said.
BATCH, BUDGET = 4, 400


class Task:
    """As :class:`~.loop.Adaptive` has it, and the table of what was told."""

    @validate_arguments
    def __init__(
        self,
        robot: RobotLike,
        *,
        required_um: Positive | None = None,
        budget: Count = BUDGET,
        span_min: NotNegative = 0.0,
        box: Mapping[str, Sequence[float]] | None = None,
        level: Level = 0.01,
        batch: Count = BATCH,
        seed: Seed = 0,
        minutes: Positive | None = None,
    ) -> None:
        self.robot = read_robot(robot)
        self.model = model_of(self.robot)
        self.layout = kind_of(self.robot).layout
        self.required_um = required_um if required_um is not None else stated_um(self.robot)
        self.budget, self.span_min, self.level, self.batch, self.seed = budget, span_min, level, batch, seed
        self.minutes = minutes
        self.box = {name: [float(end) for end in ends] for name, ends in (box or {}).items()}
        self.region = Region.of(self.model, self.layout, self.box)
        self.frame = pl.DataFrame()
        self._begin_anew()

    def _begin_anew(self) -> None:
        """Forgets what was made of the rows."""
