"""The virtual robot of a laboratory: what its instruments would see, were they without noise.

Geometric errors, leaning rails and beams that are not square come from :class:`~sherkit.simulation.VirtualDelta`, which
shares no code with the core. What that one does not know (backlash, drift, …) is added as the core has it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..errors import EffectError, OutOfReach
from ..instruments.emulators import StillRobot
from ..measurements import Measurements
from ..measurements.columns import JOINTS, POSITION, TEMPERATURE, TIME
from ..model import DeltaModel
from ..names import nearest
from ..simulation import VirtualDelta

Floats = NDArray[np.float64]

_ROOM_C = 20.0


@dataclass(frozen=True)
class HiddenEffects:
    """Effects of the catalogue by the names of their parameters (as in a calibration), mm, rad and their settings."""

    parameters: Mapping[str, float] = field(default_factory=dict)
    period_mm: float | None = None
    slip_time_s: float = 0.0

    def model(self, plain: DeltaModel) -> tuple[DeltaModel, Floats]:
        """A model with these effects alone, and its values. Raises :class:`~sherkit.errors.EffectError`."""
        owners = {p.name: e for e in plain.core_order for p in e.qualified()}
        for name in self.parameters:
            if name not in owners:
                raise EffectError(f"no effect has a parameter '{name}'{nearest(name, owners)}")
        effects = tuple(dict.fromkeys(owners[name] for name in self.parameters))
        made = DeltaModel(
            plain.robot, plain.free, effects, period_mm=self.period_mm, slip_time_s=self.slip_time_s
        )  # fmt: skip
        values = np.array([self.parameters.get(p.name, 0.0) for p in made.parameters])
        return made, values


class DeltaOnTheBench(StillRobot):
    """A virtual delta with a cube on its platform, on which three lasers look; zeroed at its home, as in the paper.

    ``left_mm`` tells where the joints came from (:meth:`~sherkit.instruments.emulators.World.left_mm`): backlash
    depends on it.
    """

    def __init__(self, virtual: VirtualDelta, hidden: HiddenEffects | None = None) -> None:
        robot = virtual.robot
        self.virtual = virtual
        self.home_joints_mm = robot.inverse([0.0, 0.0, 0.0])
        self._home = virtual.true_reading(self.home_joints_mm)[0]
        self._plain = DeltaModel(robot)
        self._zero = np.zeros(len(self._plain.parameters))
        self._effects = hidden.model(self._plain) if hidden is not None and hidden.parameters else None
        self.left_mm: Callable[[], Floats] = lambda: self.home_joints_mm
        self._last: tuple[tuple[float, ...], Floats] | None = None

    def lasers_mm(self, joints_mm: Floats, time_s: float) -> Sequence[float]:
        """x, y, z of the cube from its place at home, mm; NaN where the robot cannot be."""
        return [float(v) for v in self.position(joints_mm, time_s)]

    def position(self, joints_mm: Floats, time_s: float) -> Floats:
        """The same as an array (3,)."""
        key = (*map(float, joints_mm), *map(float, self.left_mm()))
        known = self._last
        # three outputs are asked one after the other where nothing moves; time matters to effects alone
        if known is not None and known[0] == key and self._effects is None:
            return known[1]
        try:
            with np.errstate(all="ignore"):
                place = self.virtual.true_reading(joints_mm)[0] - self._home
        except (OutOfReach, np.linalg.LinAlgError):
            return np.full(3, np.nan)
        if self._effects is not None:
            model, values = self._effects
            row = self._row(joints_mm, time_s)
            place = place + (model.predict(row, values) - self._plain.predict(row, self._zero))[0, :3]
        self._last = (key, place)
        return place

    def _row(self, joints_mm: Floats, time_s: float) -> Measurements:
        way = np.sign(np.round(np.asarray(joints_mm) - self.left_mm(), 6))
        columns = {
            TIME: np.array([time_s]),
            TEMPERATURE: np.array([_ROOM_C]),
            **{name: np.array([q]) for name, q in zip(JOINTS, joints_mm, strict=True)},
            **{name: np.zeros(1) for name in POSITION},
            # a joint that has not moved yet stands as if it had come from below
            **{f"direction_{k + 1}": np.array([w or 1.0]) for k, w in enumerate(way)},
        }
        return Measurements.from_columns(columns, "laboratory")
