"""The linear delta as a model for identification: twelve errors, the sensor's pose, effects, and how its rows reach
the core.

The table of the effects is `rust/core/src/delta/effects.rs`; here are the sentences on them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

import sherkit._core as _core

from ...base.types import Bools, Floats
from ...data import Measurements
from ...errors import SherkitError
from ...model.chain import SLACK, ChainModel
from ...model.effect import Effect, Parameter, Sentences, Setting
from ...model.sensor_pose import POSE
from ...model.sentences import catalogue_of
from .robot import DELTA, POSITION, Delta

# -- Effects ------------------------------------------------------------------------------------------------------

_OWN = {
    "joint_scale": Sentences(
        physics="Each encoder counts too many or too few millimetres: its scale is a few parts in ten thousand off.",
        residuals="Grows in proportion to the travel of one joint; zero at the home position.",
        remedy="Compare each axis with a gauge block or laser over its travel; correct counts per millimetre.",
        sizes={"scale": "encoder {k} counts {size} too much/little"},
    ),
    "rail_lean": Sentences(
        physics="The rails are not parallel: each leans outwards (radial) or sideways (tangential).",
        residuals="A shear that grows with height; the common tangential part twists the frame. A lean common "
        "to all rails "
        "is a tilt of the instrument, where that may stand anywhere.",
        remedy="Square the rails to the base with a level or autocollimator; shim the feet.",
        sizes={
            "radial": "rail {k} leans outwards/inwards by {size}",
            "tangential": "rail {k} leans sideways by {size}",
        },
    ),
    "rod_mismatch": Sentences(
        physics="The two rods of a limb differ in length, so the platform tilts and carries the measured point with "
        "it.",
        residuals="Quadratic in position, nearly all of it hidden in radii and rod lengths: a small rest, a large "
        "cause.",
        remedy="Measure rods in pairs on one fixture and match them; shorten the lever from platform to tool.",
        sizes={"difference": "the two rods of limb {k} differ by {size}"},
    ),
    "limb_twist": Sentences(
        physics="The joint axis of a limb at its carriage is turned against that at the platform, as a rail at a wrong "
        "base angle turns it: the limb is no parallelogram, and the platform tilts as it moves.",
        residuals="The tilt times the lever from platform to tool, growing from the middle outwards. A turn common to "
        "all limbs hides in the base geometry: differences between limbs are what shows.",
        remedy="Align the axes of each limb with a bar through both joints; turn each carriage with its rail.",
        sizes={"twist": "limb {k} is twisted by {size}"},
    ),
    "drive_compliance": Sentences(
        physics="Belt, screw or controller let a carriage give way along its rail under what its limb pulls with; the "
        "value is the way under the platform's whole weight.",
        residuals="A joint error that follows the limb's share of the weight: most where that limb carries most.",
        remedy="Stiffen belt and controller, balance the platform's weight, or read the carriage and not the motor.",
        sizes={"yield": "carriage {k} gives way by {size}"},
    ),
    "gravity_sag": Sentences(
        physics="Limbs stretch under the platform's weight, the more the more of it they carry; the value is the "
        "stretch of a limb under all of it.",
        residuals="Smooth over the workspace, deeper where one limb hangs steep; mostly hidden in rod lengths.",
        remedy="Stiffen joints and rods, or balance the platform's weight.",
        sizes={"compliance": "limb {k} stretches by {size}"},
    ),
    "link_growth": Sentences(
        physics="Rods, frame and rails expand with temperature, each by its own part: carbon rods between steel rails, "
        "a warm frame around cool rods. Where all parts are equal, it is thermal_growth.",
        residuals="Proportional to the deviation of temperature from 20 °C: rods that grow push the platform along "
        "the rails, a frame that grows pulls it back, rails that grow stretch the heights.",
        remedy="Warm up before measuring; hold the temperature; rods and frame of one material, or of Invar.",
        sizes={
            "rods": "the rods grow/shrink by {size}",
            "frame": "the frame grows/shrinks by {size}",
            "rails": "the rails grow/shrink by {size}",
        },
    ),
    "slip": Sentences(
        physics="Something let go at one moment: a clamp, a magnet, the calibration cube.",
        residuals="A step over time: all readings before it agree, all after it agree.",
        remedy="Tighten clamp and cube; measure again from the moment on.",
    ),
    "bar_zero": Sentences(
        physics="Every distance between two places is read too long or too short by the same length: the bar's own "
        "length, the radius of its balls, the zero of callipers.",
        residuals="The same in every distance, whatever its length and direction.",
        remedy="Calibrate the bar on a gauge of known length; close the callipers and set them to zero.",
        sizes={"length": "every distance reads {size} too long/short"},
    ),
    "beam_alignment": Sentences(
        physics="The laser beams are not square to the faces of the cube, or a "
        "sensor's scale is off: each reading shows a little of the other coordinates.",
        residuals="Linear in the coordinates.",
        remedy="Square the beams to the cube with a mirror; compare sensor scales on a gauge block.",
    ),
}

#: The effects by name, in the order of the chain.
CATALOGUE: dict[str, Effect] = catalogue_of(_core.DeltaModel.CATALOGUE, _OWN)


# -- The model ----------------------------------------------------------------------------------------------------

#: How far a robot goes whose file does not say it, mm.
_WORKSPACE_MM = 20.0
#: Poses along each axis from which the next ones are chosen.
_GRID = (7, 7, 5)
#: What acts on distances between places alone; and why these tell nothing of what acts on both of their ends alike, or
#: on neither, nor of play.
BAR = "bar_zero"
_NO_BEAM = "these rows are distances between places, which it changes none of"
_NO_SIDE = "these rows are distances between places: nobody knows from which side their ends were reached"
#: What moves the measured point alike wherever it is.
_ALIKE = ("drift", "slip")
#: Effects that grow from where the base has its origin.
_ABOUT_THE_ORIGIN = ("thermal_growth", "link_growth")


@dataclass(frozen=True)
class DeltaModel(ChainModel):
    """A nominal delta with named errors and effects to identify.

    ``free`` names what is identified: by default the paper's twelve geometric errors (Eq. 9) and the pose of the
    sensors (``sensor_turn_x`` …, ``sensor_shift_x`` …), as far as the robot's file leaves that open. The platform's
    radii and angles can be freed as well; they are exactly dependent on the base's. All parameters of ``effects`` are
    free. ``period_mm``, ``slip_time_s``, ``joint_slip_time_s``, ``sensor_slip_time_s``, ``thermal_shift_lag_s`` and
    ``time_origin_s`` are the settings of the effects that have one; ``period_mm`` is the robot's pole pitch unless
    another is given, and None where neither is: then a cyclic error is refused. Readings have four columns: x, y, z,
    distance.
    """

    robot: Delta
    period_mm: Setting | None = None
    slip_time_s: float = 0.0
    joint_slip_time_s: float = 0.0
    sensor_slip_time_s: float = 0.0
    thermal_shift_lag_s: float = 0.0
    time_origin_s: float = 0.0

    catalogue: ClassVar = CATALOGUE
    layouts: ClassVar = (DELTA,)
    period_in_file: ClassVar = "pole_pitch_mm under [joints]"
    table: ClassVar = _core.DeltaModel.CATALOGUE
    targets: ClassVar = POSITION

    def __post_init__(self) -> None:
        object.__setattr__(self, "period_mm", self.period_mm or self.robot.pole_pitch_mm or None)
        super().__post_init__()

    def lever_mm(self, name: str) -> float:
        """An angle of base or platform moves what stands at its radius; a turn of the sensors all of the workspace."""
        if name in POSE:
            return self.robot.workspace_radius_mm or _WORKSPACE_MM
        radii = self.robot.base_radius_mm if name.startswith("base") else self.robot.platform_radius_mm
        return radii[int(name[-1]) - 1] or 1.0

    @property
    def default(self) -> tuple[str, ...]:
        """The paper's twelve and what the robot's file leaves open of the sensors' pose."""
        names = (p.name for p in self.base if not p.name.startswith("platform"))
        return tuple(name for name in names if not self.held_of_pose(name))

    def as_known(self, parameter: Parameter) -> Parameter:
        """As of any model. Where a sensor stands anywhere, readings do not tell where base and joints are counted from
        but by what warms about that origin: so little that the base would be turned by half a right angle for it.
        There it is known as well as a drawing is."""
        warms = any(one.name in _ABOUT_THE_ORIGIN for one in self.effects)
        if warms and np.isinf(self.pose_sd).all() and parameter.name.startswith(("base_", "joint_offset_")):
            return replace(super().as_known(parameter), known=True)
        return super().as_known(parameter)

    def is_testable(self, effects: Sequence[Effect], data: Measurements) -> tuple[list[Effect], dict[str, str]]:
        """As of any model, by what distances between places can tell."""
        tried, untestable = super().is_testable(effects, data)
        if not data.between_places.all():
            return tried, untestable
        of_both = {e.name for e in tried if e.function is None and (e.link == "sensor" or e.name in _ALIKE)} - {BAR}
        untestable |= dict.fromkeys(of_both, _NO_BEAM) | {e.name: _NO_SIDE for e in tried if "direction" in e.needs}
        return [e for e in tried if e.name not in untestable], untestable

    @property
    def may_be_off(self) -> Mapping[str, Effect]:
        """As of any model; a bar moves no place."""
        return {name: one for name, one in self.known_effects.items() if name != BAR}

    def settings(self) -> dict[str, Setting | None]:
        """Period of the encoders, moments of the slips, lag of the stands, origin of time."""
        return {one.name: getattr(self, one.name) for one in fields(self)[len(fields(ChainModel)) :]}

    @cached_property
    def core(self) -> _core.DeltaModel:
        """The compiled model."""
        r = self.robot
        # without a cyclic error the period does not matter
        times = (self.time_origin_s, self.slip_time_s, self.joint_slip_time_s, self.sensor_slip_time_s)
        settings = np.array([r.rod_spacing_mm or 0.0, 1.0, *self.home_mm, *times], dtype=float)
        offset, periods = np.array(r.target_offset_mm), self.periods(DELTA.joints, 1.0)
        return _core.DeltaModel(r.geometry, offset, r.assembly_mode, r.sensor_pose.numbers, settings, periods)

    @cached_property
    def home_mm(self) -> tuple[float, float, float]:
        """Joint readings of the home position, where the measured point is at zero, or as near as can be."""
        try:
            q = self.robot.inverse((0.0, 0.0, 0.0))
        except SherkitError:
            # a robot whose frame lies elsewhere: the rods' rise over their widest span
            q = np.array(self.robot.rod_length_mm)
        return (float(q[0]), float(q[1]), float(q[2]))

    def grid(self, data: Measurements) -> Floats | None:
        """Places (k, 3), mm, over the workspace, or over where the run was."""
        robot = self.robot
        where = robot.forward_batch(data.joints)
        if not where.reached.any():
            return None
        axes = [
            np.linspace(a, b, n)
            for a, b, n in zip(*robot.workspace_box(where.values[where.reached]), _GRID, strict=True)
        ]
        places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        if robot.workspace_radius_mm:
            places = places[np.hypot(places[:, 0], places[:, 1]) <= robot.workspace_radius_mm * (1 + 1e-9)]
        return places

    def allowed(self, coordinates: Floats, slack: float = SLACK) -> Bools:
        """Which places (k, 3) lie in the workspace of the robot file."""
        robot, inside = self.robot, np.ones(len(coordinates), dtype=bool)
        if robot.workspace_radius_mm:
            inside &= np.hypot(coordinates[:, 0], coordinates[:, 1]) <= robot.workspace_radius_mm * (1 + slack)
        if robot.workspace_z_mm:
            low, high = robot.workspace_z_mm
            size = max(high - low, robot.workspace_radius_mm or 0.0)
            inside &= (coordinates[:, 2] >= low - slack * size) & (coordinates[:, 2] <= high + slack * size)
        return inside

    def reason(self, data: Measurements, row: int, values: Floats) -> str:
        """Which limb cannot reach, by how much; or what else is wrong."""
        names = self.robot.parameter_names
        errors = dict(zip(names, self.full(values)[: len(names)], strict=True))
        try:
            kinematics = self.robot.kinematics(errors)
            for joints in (data.joints[row], data.to_joints[row]):
                if np.isfinite(joints).all():
                    kinematics.forward(joints)
        except SherkitError as error:
            return str(error)
        return "an effect that is at work needs a column that these rows lack"
