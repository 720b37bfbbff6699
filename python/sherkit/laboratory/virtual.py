"""The virtual robot of a laboratory: what its instruments would see, were they without noise.

Geometric errors, leaning rails and beams that are not square come from :class:`~sherkit.simulation.VirtualDelta`, which
shares no code with the core. What that one does not know (backlash, drift, …) is added as the core has it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..errors import EffectError, OutOfReach, RobotError
from ..instruments.emulators import StillRobot
from ..measurements import Measurements
from ..measurements.columns import JOINTS, POSITION, SPHERICAL_JOINTS, TEMPERATURE, TIME
from ..model import DeltaModel
from ..names import nearest
from ..robots.spherical import Spherical
from ..simulation import VirtualDelta
from ..spherical_simulation import VirtualSpherical
from ..tool_simulation import VirtualTool

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


@dataclass(frozen=True)
class ToolInHole:
    """A tool on the platform, in a hole of the bench: where the robot goes aside, the hole bends it.

    At home the shaft is ``depth_mm`` deep and in the middle; ``clearance_mm`` is how far it is free. The load cell
    feels the force, the gratings the bending: three fibres, each on a channel of its own, with three gratings.
    """

    virtual: VirtualTool
    depth_mm: float = 10.0
    clearance_mm: float = 0.05

    def felt(self, position_mm: Floats) -> tuple[Floats, Floats]:
        """Force (2,), mN, and wavelengths (9,), nm, with the platform at ``position_mm`` (3,) from home."""
        depth = np.array([max(self.depth_mm - float(position_mm[2]), 0.0)])
        force, waves = self.virtual.pressed(-position_mm[None, :2], depth, self.clearance_mm)
        return force[0], waves[0]


class DeltaOnTheBench(StillRobot):
    """A virtual delta with a cube on its platform, on which three lasers look; zeroed at its home, as in the paper.

    ``left`` tells where the joints came from (:meth:`~sherkit.instruments.emulators.World.left`): backlash depends
    on it.
    """

    def __init__(
        self, virtual: VirtualDelta, hidden: HiddenEffects | None = None, tool: ToolInHole | None = None
    ) -> None:
        robot = virtual.robot
        self.virtual = virtual
        self.tool = tool
        self.home_joints = robot.inverse([0.0, 0.0, 0.0])
        self._home = virtual.true_reading(self.home_joints)[0]
        self._plain = DeltaModel(robot)
        self._zero = np.zeros(len(self._plain.parameters))
        self._effects = hidden.model(self._plain) if hidden is not None and hidden.parameters else None
        self.left: Callable[[], Floats] = lambda: self.home_joints
        self._last: tuple[tuple[float, ...], Floats] | None = None

    def lasers_mm(self, joints: Floats, time_s: float) -> Sequence[float]:
        """x, y, z of the cube from its place at home, mm; NaN where the robot cannot be."""
        return [float(v) for v in self.position(joints, time_s)]

    def wrench(self, joints: Floats, time_s: float) -> Sequence[float]:
        """The force on the tool at its hole, N; no torque."""
        place = self.position(joints, time_s)
        if self.tool is None or not np.isfinite(place).all():
            return super().wrench(joints, time_s)
        force, _ = self.tool.felt(place)
        return [1e-3 * float(force[0]), 1e-3 * float(force[1]), 0.0, 0.0, 0.0, 0.0]

    def wavelengths_nm(self, joints: Floats, time_s: float) -> Sequence[Sequence[float]]:
        """The gratings of sections I, II and III on one channel for each of three fibres."""
        place = self.position(joints, time_s)
        if self.tool is None or not np.isfinite(place).all():
            return super().wavelengths_nm(joints, time_s)
        _, waves = self.tool.felt(place)
        return [[float(v) for v in fibre] for fibre in waves.reshape(3, 3).T] + [[]]

    def position(self, joints: Floats, time_s: float) -> Floats:
        """The same as an array (3,)."""
        key = (*map(float, joints), *map(float, self.left()))
        known = self._last
        # three outputs are asked one after the other where nothing moves; time matters to effects alone
        if known is not None and known[0] == key and self._effects is None:
            return known[1]
        try:
            with np.errstate(all="ignore"):
                place = self.virtual.true_reading(joints)[0] - self._home
        except (OutOfReach, np.linalg.LinAlgError):
            return np.full(3, np.nan)
        if self._effects is not None:
            model, values = self._effects
            row = self._row(joints, time_s)
            place = place + (model.predict(row, values) - self._plain.predict(row, self._zero))[0, :3]
        self._last = (key, place)
        return place

    def _row(self, joints: Floats, time_s: float) -> Measurements:
        way = np.sign(np.round(np.asarray(joints) - self.left(), 6))
        columns = {
            TIME: np.array([time_s]),
            TEMPERATURE: np.array([_ROOM_C]),
            **{name: np.array([q]) for name, q in zip(JOINTS, joints, strict=True)},
            **{name: np.zeros(1) for name in POSITION},
            # a joint that has not moved yet stands as if it had come from below
            **{f"direction_{k + 1}": np.array([w or 1.0]) for k, w in enumerate(way)},
        }
        return Measurements.from_columns(columns, "laboratory")


class SphericalOnTheBench(StillRobot):
    """A virtual spherical robot with a marker on its tool, at which its camera looks.

    It begins in the middle of its workspace. Pictures are drawn anew at each place, with grey noise of that place:
    where the robot comes back to by the same way, the camera sees the same. Needs the extra ``sherkit[vision]``.
    """

    def __init__(self, virtual: VirtualSpherical, *, noise_grey: float = 2.0, seed: int = 0) -> None:
        self.virtual = virtual
        self.home_joints = virtual.robot.inverse(middle_of(virtual.robot))
        self.noise_grey = noise_grey
        self.seed = seed
        self.left: Callable[[], Floats] = lambda: self.home_joints
        self._last: tuple[tuple[float, ...], NDArray[np.uint8]] | None = None

    def picture(self, joints: Floats, time_s: float) -> NDArray[np.uint8]:
        """What the camera sees; grey where the robot cannot be."""
        del time_s
        key = (*map(float, joints), *map(float, self.left()))
        if self._last is not None and self._last[0] == key:
            return self._last[1]
        width, height = self.virtual.eye.size_px
        places = [int(v * 1e6) & 0xFFFFFFFF for v in key]
        try:
            columns = {name: np.array([q]) for name, q in zip(SPHERICAL_JOINTS, joints, strict=True)}
            columns[TIME] = np.zeros(1)
            seed = int(np.random.SeedSequence([self.seed, *places]).generate_state(1)[0])
            (drawn,) = self.virtual.pictures(columns, seed=seed, noise_grey=self.noise_grey)
            picture = drawn.grey
        except OutOfReach:
            picture = np.full((height, width), 128, np.uint8)
        self._last = (key, picture)
        return picture

    def position(self, joints: Floats, time_s: float) -> Floats:
        """Where the marker is in truth (2,), px."""
        del time_s
        return self.virtual.true_reading(joints)[0]


def middle_of(robot: Spherical) -> Floats:
    """The middle of a spherical robot's workspace, φ and γ, rad. Raises :class:`~sherkit.errors.RobotError`."""
    if robot.phi_deg is None or robot.gamma_deg is None:
        raise RobotError("the robot file needs [workspace] phi_deg and gamma_deg: that is where it may be sent")
    return np.deg2rad([np.mean(robot.phi_deg), np.mean(robot.gamma_deg)])
