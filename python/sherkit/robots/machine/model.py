"""A machine as a model for identification: the parameters of its function, and the effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy

from ...base import linalg
from ...base.types import Floats
from ...data import Measurements
from ...data.columns import unit_in
from ...errors import EffectError, FitError
from ...model.base import Reachable
from ...model.chain import ChainModel
from ...model.effect import Effect, Setting
from ...model.sensor_pose import seen_from
from .core import MachineCore
from .described import MachineDescription
from .generic_effects import home_of

#: Poses from which the next ones are chosen.
_POSES = 400
#: Rows and steps by which one walks to where a sensor stands; the rank by which a step is made; and how near one must
#: come, of how far the places lie apart.
_WALKED, _STEPS, _RANK, _NEAR = 100, 12, 1e-8, 1e-2
#: The settings that are the period of the encoders, in the unit of the joints.
_PERIODS = ("period_mm", "period_rad", "period_deg", "period_mrad", "period_urad", "period_arcmin", "period_arcsec")
_DIGITS = {"mm": 2, "rad": 4, "deg": 2, "px": 1}


@dataclass(frozen=True)
class MachineModel(ChainModel):
    """A machine with its parameters and effects to identify. Its tables are those of a subclass for each machine
    (:mod:`~sherkit.robots.machine`). Scales and couplings of joints count from ``home``; None: as :func:`home_of`
    has it of their ranges."""

    robot: MachineDescription
    slip_time_s: float = 0.0
    joint_slip_time_s: float = 0.0
    thermal_shift_lag_s: float = 0.0
    sensor_slip_time_s: float = 0.0
    time_origin_s: float = 0.0
    home: Setting | None = None
    period_mm: Setting | None = None
    period_rad: Setting | None = None
    period_deg: Setting | None = None
    period_mrad: Setting | None = None
    period_urad: Setting | None = None
    period_arcmin: Setting | None = None
    period_arcsec: Setting | None = None

    one_posture: ClassVar = False
    waves_are: ClassVar = "gear ripple"

    def __reduce__(self) -> tuple[Any, ...]:
        """Its class is made again with the machine."""
        return _again, (self.robot, self.free, self.effects, self.settings() | {"set_ups": self.set_ups})

    def lever_mm(self, name: str) -> float:
        """In plausible sizes: units differ."""
        of_pose = [one for link in self.robot.links if link.is_base for one in link.parameters]
        sizes = {p.name: p.size for p in self.robot.own} | {one: size for one, _, size in of_pose}
        return 1.0 / sizes[name]

    @property
    def sensitivities(self) -> tuple[Floats, str]:
        """Plausible sizes."""
        return np.array([1.0 / p.size for p in self.parameters]), "plausible sizes"

    @property
    def default(self) -> tuple[str, ...]:
        """All of them, and what is open of the sensor's pose."""
        return tuple(p.name for p in self.base)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.home is None:
            object.__setattr__(self, "home", home_of(self.robot.box))

    def settings(self) -> dict[str, Setting | None]:
        """Moments of the slips, lag of the stands, origin of time, home, and the period of the encoders where all
        joints have one."""
        times: dict[str, Setting | None] = {
            "slip_time_s": self.slip_time_s,
            "joint_slip_time_s": self.joint_slip_time_s,
            "thermal_shift_lag_s": self.thermal_shift_lag_s,
            "time_origin_s": self.time_origin_s,
        }
        if len(self.robot.box):
            times["home"] = self.home
        searched = {one.search for one in self.robot.effects}
        if self.robot.pose is not None:
            times["sensor_slip_time_s"] = self.sensor_slip_time_s
        return times | {name: getattr(self, name) for name in _PERIODS if name in searched}

    @cached_property
    def core(self) -> MachineCore:
        """The chain."""
        waves = 2.0 * np.pi / self.periods(self.layouts[0].joints, 1.0)
        times = (self.time_origin_s, self.slip_time_s, self.joint_slip_time_s, self.sensor_slip_time_s)
        home, count = self.home, len(self.robot.box)
        if isinstance(home, tuple) and len(home) != count:
            raise EffectError(f"home: expected one number, or {count}, one for each joint; found {len(home)}")
        zeros = home if isinstance(home, tuple) else (home or 0.0,) * count
        return MachineCore(self.robot.asked, self.robot.links, self.robot.pose, tuple(waves.tolist()), zeros, *times)

    def joint_ranges(self) -> dict[str, tuple[float, float]]:
        """Each joint's own, where they were given."""
        if not isinstance(self.robot.joints, Mapping):
            return {}
        return {name: (low, high) for name, (low, high) in zip(self.robot.joints, self.robot.box.tolist(), strict=True)}

    # -- where a fit begins --------------------------------------------------------------------------------

    def reads_places(self, data: Measurements) -> bool:
        """Whether its owner says so."""
        del data
        return self.robot.pose is not None

    def start(self, data: Measurements) -> Floats:
        """As of any model; where the machine's own parameters are a part of the sensor's pose, one walks to where it
        stands with them and what is left of it."""
        out = super().start(data)
        if self.robot.pose is None or self.stands_anywhere or np.isfinite(self.pose_sd).any():
            return out
        found = self.registration(data)
        return out if found is None else self._walked(data, found, out)

    def _walked(self, data: Measurements, off: Floats, start: Floats) -> Floats:
        """The values by which the drawing is seen from ``off`` (6,), in steps from where it is seen at the ``start``;
        that, where they do not lead there."""
        rows = data.select(np.unique(np.linspace(0, len(data) - 1, min(len(data), _WALKED)).astype(int)))
        pose, sizes = self.sensor_pose, np.array([p.size for p in self.parameters])
        seen, reached = self.drawn(rows)
        base, values = (seen - pose.origin_mm) @ pose.turn, start
        for share in np.linspace(0.0, 1.0, _STEPS + 1)[1:].repeat(2):
            there = seen_from(pose, share * off, base)
            columns = self.derivatives(rows, values)[reached].reshape(-1, len(values)) * sizes
            step = linalg.pinv(columns, rcond=_RANK) @ (there - self.predict(rows, values))[reached].ravel()
            values = values + sizes * step
        missed = (seen_from(pose, off, base) - self.predict(rows, values))[reached]
        near = np.sqrt((missed**2).mean()) <= _NEAR * np.sqrt(base[reached].var(axis=0).sum())
        return values if near else start

    def require_own(self, data: Measurements) -> None:
        """As of any model; and where nothing moves, a course in time or a column is what tells anything."""
        super().require_own(data)
        if not data.layout.joints and data.time_s is None and not data.covariates:
            raise FitError(
                f"{data.source}: of a machine without joints a run needs time_s, or a column that its readings may "
                "follow"
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
        """Joints of the run and such as lie between two of its poses, rounded to what a person types: those that go
        together, as the two motors of a gantry's beam, go together there, and a box of their ranges would rack it."""
        one, other, part = scipy.stats.qmc.Halton(3, scramble=False).random(_POSES + 1)[1:].T
        went = data.joints[~data.outlier] if not data.outlier.all() else data.joints
        first, second = (went[(each * len(went)).astype(np.int64)] for each in (one, other))
        # every second one is where the run was, so that its ends are among them
        share = np.where(np.arange(_POSES) % 2, part, 0.0)[:, None]
        digits = [_DIGITS.get(unit_in(name), 4) for name in self.robot.joint_names]
        between = first + share * (second - first)
        joints = np.column_stack([np.round(c, d) for c, d in zip(between.T, digits, strict=True)])
        rows = data.unmeasured(joints)
        shown, reached = self.core_for(rows).predict(self.full(values), self.block(rows))
        if not reached.any():
            return None
        rows = data.unmeasured(joints[reached])
        return Reachable(dict(zip(self.robot.readings, shown[reached].T, strict=True)), rows)

    def reason(self, data: Measurements, row: int, values: Floats) -> str:
        """A function that gives no number, or a column that is not there."""
        shown = self.robot.asked(data.joints[row : row + 1], np.asarray(values)[: len(self.robot.own)])
        if not np.isfinite(shown).all():
            return f"the model's function '{self.robot.name}' gives no number there"
        return "an effect that is at work needs a column that these rows lack"


def _again(
    machine: Any, free: tuple[str, ...], effects: tuple[Effect, ...], settings: Mapping[str, Any]
) -> MachineModel:
    made: MachineModel = machine.brings.model(machine, free, effects, **settings)
    return made
