"""The linear delta: three vertical prismatic joints, three rod pairs, a platform.

Source: Xiao et al., ISMR 2022. The nominal geometry is the user's; the example in the tests is an example.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

import sherkit._core as _core

from ...base.notebook import Saved, Shown
from ...base.types import Floats
from ...data.columns import Layout
from ...data.declared import Declared, Inner, key
from ...data.toml import Table
from ...errors import ShapeError, Singular
from ...model.batch import Batch, matrix, vector, why
from ...model.kinds import MOST_IN_LINE, MOST_PER_SIDE
from ...model.sensor_pose import ANYWHERE, SensorPose
from ...model.tolerances import NOT_STATED, Stated, Stating

# -- The columns of a run -----------------------------------------------------------------------------------------

JOINTS = ("q1_mm", "q2_mm", "q3_mm")
TO_JOINTS = ("to_q1_mm", "to_q2_mm", "to_q3_mm")
POSITION = ("x_mm", "y_mm", "z_mm")
DISTANCE = "distance_mm"

#: Carriages, coordinates of the measured point, distances between two of its places.
DELTA = Layout(JOINTS, POSITION, "µm", 1e3, DISTANCE, TO_JOINTS)


# -- The robot ----------------------------------------------------------------------------------------------------

Triple = tuple[float, float, float]

ASSEMBLY_MODES = ("below", "above")

# the order in which the core holds a limb's parameters
LIMB_PARAMETERS = ("base_radius", "base_angle", "joint_offset", "rod_length", "platform_radius", "platform_angle")


@dataclass(frozen=True)
class Delta(Declared, Stating, Saved, Shown):
    """Nominal linear delta. Lengths in mm, angles in degrees as on a drawing, one value per limb.

    ``target_offset_mm`` points from the platform centre to the measured point. ``rod_spacing_mm`` is the
    distance of the two rods of a limb, ``pole_pitch_mm`` the period of the encoders' scales; both are 0 where there is
    none, None where nobody said. ``assembly_mode`` is ``"below"`` where the platform hangs under its
    carriages, ``"above"`` where it stands on them. Joint readings are carriage heights along +z;
    ``joint_limits_mm`` (low, high) are those that no motor may leave, ``required_um`` the accuracy that it is for.
    ``sensor_pose`` is where the instrument that reads it stands.
    """

    base_radius_mm: Triple
    base_angle_deg: Triple
    platform_radius_mm: Triple
    platform_angle_deg: Triple
    rod_length_mm: Triple
    rod_spacing_mm: float | None = None
    target_offset_mm: Triple = (0.0, 0.0, 0.0)
    pole_pitch_mm: float | None = None
    workspace_radius_mm: float | None = None
    workspace_z_mm: tuple[float, float] | None = None
    region_half_width_mm: float | None = None
    required_um: float | None = None
    joint_limits_mm: tuple[float, float] | None = None
    assembly_mode: str = "below"
    sensor_pose: SensorPose = ANYWHERE
    tolerances: Stated = NOT_STATED
    known: Stated = NOT_STATED
    kind: str = field(default="delta", init=False)

    TABLES: ClassVar = {
        "geometry": {
            "base_radius_mm": key(Table.numbers, 3, positive=True),
            "base_angle_deg": key(Table.numbers, 3),
            "platform_radius_mm": key(Table.numbers, 3),
            "platform_angle_deg": key(Table.numbers, 3),
            "rod_length_mm": key(Table.numbers, 3, positive=True),
            "rod_spacing_mm": key(Table.positive, or_zero=True),
            "target_offset_mm": key(Table.numbers, 3),
            "assembly_mode": key(Table.text, ASSEMBLY_MODES).quiet,
        },
        "joints": {
            "pole_pitch_mm": key(Table.positive, or_zero=True),
            "limits_mm": key(Table.heights).of("joint_limits_mm"),
        },
        "workspace": {
            "radius_mm": key(Table.positive).of("workspace_radius_mm"),
            "z_mm": key(Table.heights).of("workspace_z_mm"),
            "required_um": key(Table.positive),
        },
        "region_of_interest": {"half_width_mm": key(Table.positive).of("region_half_width_mm")},
        "sensor_pose": Inner(SensorPose, "sensor_pose"),
        "tolerances": Inner(Stated, "tolerances"),
        "known": Inner(Stated, "known"),
    }

    @classmethod
    def check(cls, name: str, table: Table, values: Mapping[str, Any]) -> None:
        """Refuses what cannot be a delta before the kinematics would say so less clearly."""
        if name == "geometry":
            _check_shape(table, values)

    def __post_init__(self) -> None:
        self.kinematics()  # refuses a geometry that is no robot

    # -- what an experiment asks --------------------------------------------------------------------------

    @property
    def joint_unit(self) -> str:
        """Unit of the joint readings."""
        return "mm"

    @property
    def joint_limits(self) -> tuple[float, float] | None:
        """Lowest and highest carriage height, mm, to which a motor may go; None where the file names none."""
        return self.joint_limits_mm

    @property
    def middle(self) -> Triple:
        """Where an experiment begins and ends, mm: the origin of the drawing."""
        return (0.0, 0.0, 0.0)

    # -- kinematics --------------------------------------------------------------------------------------

    @cached_property
    def geometry(self) -> Floats:
        """The 18 geometric parameters, limb by limb, in the order of :data:`LIMB_PARAMETERS`."""
        angle, platform_angle = np.deg2rad(self.base_angle_deg), np.deg2rad(self.platform_angle_deg)
        columns = (self.base_radius_mm, angle, np.zeros(3), self.rod_length_mm, self.platform_radius_mm, platform_angle)
        return np.array(columns, dtype=float).T.ravel().copy()

    def workspace_box(self, places_mm: Floats) -> tuple[Floats, Floats]:
        """Corners (3,) of the workspace; along what the file does not say of it those of places (n, 3)."""
        low, high = places_mm.min(axis=0), places_mm.max(axis=0)
        if self.workspace_radius_mm:
            low[:2], high[:2] = -self.workspace_radius_mm, self.workspace_radius_mm
        if self.workspace_z_mm:
            low[2], high[2] = self.workspace_z_mm
        return low, high

    def kinematics(self, errors: Mapping[str, float] | None = None) -> _core.DeltaKinematics:
        """Kinematics of the platform centre with the given geometric errors (by parameter name)."""
        p = self.geometry.copy()
        names = self.parameter_names
        for name, value in (errors or {}).items():
            if name not in names:
                raise ShapeError(f"'{name}' is not a geometric parameter of a delta")
            p[names.index(name)] += value
        return _core.DeltaKinematics(p, self.assembly_mode)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the 18 geometric parameters, in the order of :attr:`geometry`."""
        return tuple(f"{name}_{limb}" for limb in (1, 2, 3) for name in LIMB_PARAMETERS)

    def drawn_values(self) -> Mapping[str, float]:
        """Radii, angles (rad) and rods by the name of their parameter; joints are counted from zero."""
        return dict(zip(self.parameter_names, self.geometry.tolist(), strict=True))

    def forward(self, joints_mm: ArrayLike) -> Floats:
        """Measured point (3,) for joint readings (3,), mm, base frame.

        Raises :class:`~sherkit.errors.OutOfReach` naming limb and distance, :class:`NotFinite`.
        """
        q = vector(joints_mm, "joint readings")
        return self._nominal.forward(q) + np.array(self.target_offset_mm)

    def inverse(self, position_mm: ArrayLike) -> Floats:
        """Joint readings (3,) that bring the measured point to ``position_mm`` (3,). Raises as :meth:`forward`."""
        x = vector(position_mm, "position") - np.array(self.target_offset_mm)
        return self._nominal.inverse(x)

    def forward_batch(self, joints_mm: ArrayLike) -> Batch:
        """Measured points (n, 3) for joint readings (n, 3); rows out of reach are marked."""
        q = matrix(joints_mm, "joint readings")
        x, reached = self._nominal.forward_batch(q)
        x += np.array(self.target_offset_mm)
        return Batch(x, reached, why(self._nominal.forward, q, reached))

    def inverse_batch(self, positions_mm: ArrayLike) -> Batch:
        """Joint readings (n, 3) for measured points (n, 3); rows out of reach are marked."""
        x = matrix(positions_mm, "positions") - np.array(self.target_offset_mm)
        q, reached = self._nominal.inverse_batch(x)
        return Batch(q, reached, why(self._nominal.inverse, x, reached))

    def jacobian(self, joints_mm: ArrayLike) -> Floats:
        """Velocity Jacobian (3, 3) d position / d joints. Raises as :meth:`forward`, and ``Singular``."""
        q = vector(joints_mm, "joint readings")
        values, _, reached = self._nominal.derivatives_batch(q[None, :])
        if not reached[0]:
            self._nominal.forward(q)  # raises the reason
            raise Singular("singular: the three rods lie in one plane here")
        return values[0]

    def parameter_jacobian(self, joints_mm: ArrayLike) -> Batch:
        """Derivative of the position by the 18 geometric parameters (n, 3, 18), mm per mm or rad (Eq. 8)."""
        q = matrix(joints_mm, "joint readings")
        _, values, reached = self._nominal.derivatives_batch(q)
        return Batch(values, reached, why(self._nominal.forward, q, reached))

    @cached_property
    def _nominal(self) -> _core.DeltaKinematics:
        return self.kinematics()


def _check_shape(table: Table, geometry: Mapping[str, Any]) -> None:
    if min(geometry["platform_radius_mm"]) < 0:
        raise table.fail("platform_radius_mm", "3 numbers, none below zero")
    spans = np.array(geometry["base_radius_mm"]) * np.exp(1j * np.deg2rad(geometry["base_angle_deg"]))
    spans -= np.array(geometry["platform_radius_mm"]) * np.exp(1j * np.deg2rad(geometry["platform_angle_deg"]))
    for limb, (rod, span) in enumerate(zip(geometry["rod_length_mm"], np.abs(spans), strict=True), start=1):
        if rod <= span:
            raise table.fail(
                "rod_length_mm",
                f"rod {limb} longer than {span:.3f} mm, the horizontal distance it spans at the centre",
            )
    first, second = spans[1] - spans[0], spans[2] - spans[0]
    area = abs(first.real * second.imag - first.imag * second.real)
    if area <= 1e-6 * max(geometry["rod_length_mm"]) ** 2:
        raise table.fail(
            "base_radius_mm",
            "rails at three corners of a triangle as seen from the platform's joints; these lie in line",
        )


# -- Sets of poses ------------------------------------------------------------------------------------------------


def grid(half_width_mm: float, per_side: int, planes_mm: Sequence[float]) -> Floats:
    """Points (n, 3), mm: square grids of ``per_side``² over ±``half_width_mm``, one per height, plane by plane.

    Rows are walked back and forth, so that neighbours in the list are neighbours in space.
    """
    ticks = np.linspace(-half_width_mm, half_width_mm, per_side)
    plane = [(x, y) for j, y in enumerate(ticks) for x in (ticks if j % 2 == 0 else ticks[::-1])]
    return np.array([(x, y, z) for z in planes_mm for x, y in plane], dtype=float).reshape(-1, 3)


def paper_whole() -> Floats:
    """588 poses: planes z = -20, 0, 20 mm of 14 × 14 over ±20 mm (Xiao et al. 2022, section III)."""
    return grid(20.0, 14, (-20.0, 0.0, 20.0))


def paper_local() -> Floats:
    """363 poses: planes z = -10, 0, 10 mm of 11 × 11 over ±10 mm. The paper's text counts 393."""
    return grid(10.0, 11, (-10.0, 0.0, 10.0))


# -- By name ------------------------------------------------------------------------------------------------------


def _grid(robot: Delta, table: Table) -> Floats:
    del robot
    half, per_side = table.number("half_width_mm", positive=True), table.whole("per_side", least=1, most=MOST_PER_SIDE)
    return grid(half, per_side, table.some_numbers("planes_mm", (0.0,)))


def _line(robot: Delta, table: Table) -> Floats:
    del robot
    begin, end = table.numbers("from_mm", 3), table.numbers("to_mm", 3)
    return np.linspace(begin, end, table.whole("count", 41, least=2, most=MOST_IN_LINE))


def _list(robot: Delta, table: Table) -> Floats:
    del robot
    rows = table.rows("list_mm", 3)
    if not rows:
        raise table.fail("list_mm", "at least one place")
    return np.array(rows)


#: Places (n, 3), mm, by the name that the plan gives them.
POSES: Mapping[str, Callable[[Delta, Table], Floats]] = {
    "paper_local": lambda robot, table: paper_local(),
    "paper_whole": lambda robot, table: paper_whole(),
    "grid": _grid,
    "line": _line,
    "list": _list,
}
#: The paper's experiments.
AREAS: Mapping[str, Callable[[Delta], Floats]] = {
    "whole": lambda robot: paper_whole(),
    "local": lambda robot: paper_local(),
}
