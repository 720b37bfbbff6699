"""A machine as a model for identification: the parameters of its function, and the effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy

from ...base.types import Floats
from ...data import Measurements
from ...data.columns import unit_in
from ...errors import EffectError
from ...model.base import Reachable
from ...model.chain import ChainModel
from ...model.effect import Effect
from .core import MachineCore
from .described import Described

#: Poses from which the next ones are chosen.
_POSES = 400
_DIGITS = {"mm": 2, "rad": 4, "deg": 2, "px": 1}


@dataclass(frozen=True)
class MachineModel(ChainModel):
    """A machine with its parameters and effects to identify. Its tables are those of a subclass for each machine
    (:mod:`~sherkit.robots.machine`)."""

    robot: Described
    slip_time_s: float = 0.0
    joint_slip_time_s: float = 0.0
    thermal_shift_lag_s: float = 0.0
    time_origin_s: float = 0.0
    period_mm: float | None = None
    period_rad: float | None = None

    one_posture: ClassVar = False

    def __reduce__(self) -> tuple[Any, ...]:
        """Its class is made again with the machine."""
        return _again, (self.robot, self.free, self.effects, self.settings())

    def lever_mm(self, name: str) -> float:
        """In plausible sizes: units differ."""
        (size,) = (p.size for p in self.robot.own if p.name == name)
        return 1.0 / size

    @property
    def sensitivities(self) -> tuple[Floats, str]:
        """Plausible sizes."""
        return np.array([1.0 / p.size for p in self.parameters]), "plausible sizes"

    @property
    def default(self) -> tuple[str, ...]:
        """All of them."""
        return tuple(p.name for p in self.robot.own)

    def settings(self) -> dict[str, float | None]:
        """Moments of the slips, lag of the stands, origin of time, and the period of the encoders where all joints have
        one."""
        times: dict[str, float | None] = {
            "slip_time_s": self.slip_time_s,
            "joint_slip_time_s": self.joint_slip_time_s,
            "thermal_shift_lag_s": self.thermal_shift_lag_s,
            "time_origin_s": self.time_origin_s,
        }
        own = {"period_mm": self.period_mm, "period_rad": self.period_rad}
        searched = {one.search for one in self.robot.effects}
        return times | {name: value for name, value in own.items() if name in searched}

    @cached_property
    def core(self) -> MachineCore:
        """The chain."""
        period = self.period_mm or self.period_rad or 1.0
        return MachineCore(
            self.robot.asked,
            self.robot.effects,
            2.0 * np.pi / period,
            self.time_origin_s,
            self.slip_time_s,
            self.joint_slip_time_s,
        )

    def check_effect(self, effect: Effect, data: Measurements, values: Floats) -> None:
        """As of any model; and a displacement asks for readings that are those of a point."""
        if effect.link == "body" and len(self.robot.readings) != 3:
            raise EffectError(
                f"effect '{effect.name}': this machine's readings are no point that could be moved; "
                "at='sensor' adds to them"
            )
        super().check_effect(effect, data, values)

    def reachable(self, data: Measurements, values: Floats) -> Reachable | None:
        """Joints spread evenly over where the run was, rounded to what a person types."""
        low, high = data.joints.min(axis=0), data.joints.max(axis=0)
        spread = scipy.stats.qmc.Halton(len(low), scramble=False).random(_POSES + 1)[1:]
        digits = [_DIGITS.get(unit_in(name), 4) for name in self.robot.joint_names]
        joints = np.column_stack([np.round(c, d) for c, d in zip((low + (high - low) * spread).T, digits, strict=True)])
        rows = data.unmeasured(joints)
        shown, reached = self.core_for(rows).predict(self.full(values), self.block(rows))
        if not reached.any():
            return None
        rows = data.unmeasured(joints[reached])
        return Reachable(dict(zip(self.robot.readings, shown[reached].T, strict=True)), rows)

    def reason(self, data: Measurements, row: int, values: Floats) -> str:
        """A function that gives no number, or a column that is not there."""
        shown = self.robot.asked(data.joints[row : row + 1], np.asarray(values)[: len(self.bare)])
        if not np.isfinite(shown).all():
            return f"the model's function '{self.robot.name}' gives no number there"
        return "an effect that is at work needs a column that these rows lack"


def _again(
    machine: Any, free: tuple[str, ...], effects: tuple[Effect, ...], settings: Mapping[str, Any]
) -> MachineModel:
    made: MachineModel = machine.brings.model(machine, free, effects, **settings)
    return made
