"""Hypothesis strategies: random linear deltas and poses that they can take, and the example robot of the tests."""

from __future__ import annotations

import hypothesis.strategies as st
import numpy as np
from hypothesis import assume
from numpy.typing import NDArray

from sherkit.robots.delta import Delta

Floats = NDArray[np.float64]

#: The example robot: that of the second simulator, so that both can be compared.
EXAMPLE = Delta(
    base_radius_mm=(90.0, 90.0, 90.0), base_angle_deg=(90.0, 210.0, 330.0), platform_radius_mm=(30.0, 30.0, 30.0),
    platform_angle_deg=(90.0, 210.0, 330.0), rod_length_mm=(120.0, 120.0, 120.0), rod_spacing_mm=40.0,
    target_offset_mm=(0.0, 0.0, -25.0), pole_pitch_mm=2.0, workspace_radius_mm=30.0, workspace_z_mm=(-22.0, 22.0),
    region_half_width_mm=10.0,
)  # fmt: skip
#: Poses nearer to a singularity than this, as a part of the shortest rod, are not drawn.
_FROM_SINGULAR = 0.05


def between(low: float, high: float) -> st.SearchStrategy[float]:
    """Finite floats of an interval."""
    return st.floats(low, high, allow_nan=False, allow_infinity=False)


def triples(low: float, high: float) -> st.SearchStrategy[tuple[float, float, float]]:
    """Three floats of an interval."""
    return st.tuples(between(low, high), between(low, high), between(low, high))


def anchors(robot: Delta) -> Floats:
    """Horizontal rail minus platform joint of each limb (3, 2), mm: the anchor of its rod."""
    base, platform = (
        np.array(radius)[:, None] * np.stack([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))], axis=1)
        for radius, angle in (
            (robot.base_radius_mm, robot.base_angle_deg),
            (robot.platform_radius_mm, robot.platform_angle_deg),
        )
    )
    return base - platform


@st.composite
def deltas(draw: st.DrawFn, assembly_modes: tuple[str, ...] = ("below", "above")) -> Delta:
    """Any delta that a workshop could build, limbs in either order of rotation and unlike each other."""
    base = draw(between(60.0, 150.0))
    platform = draw(between(10.0, min(50.0, 0.6 * base)))
    first, order = draw(between(-180.0, 180.0)), draw(st.sampled_from((1, -1)))
    base_angle = tuple(first + order * 120.0 * k + draw(between(-15.0, 15.0)) for k in range(3))
    frame = {
        "base_radius_mm": tuple(base * f for f in draw(triples(0.9, 1.1))),
        "base_angle_deg": base_angle,
        "platform_radius_mm": tuple(platform * f for f in draw(triples(0.9, 1.1))),
        "platform_angle_deg": tuple(a + draw(between(-5.0, 5.0)) for a in base_angle),
    }
    span = np.linalg.norm(anchors(Delta(**frame, rod_length_mm=(1.0, 1.0, 1.0))), axis=1)
    ratio = draw(triples(1.5, 3.0))
    return Delta(
        **frame,
        rod_length_mm=tuple(float(s * r) for s, r in zip(span, ratio, strict=True)),
        target_offset_mm=draw(triples(-40.0, 40.0)),
        assembly_mode=draw(st.sampled_from(assembly_modes)),
    )


def reach_mm(robot: Delta, direction: Floats) -> float:
    """How far the platform centre can go from the axis in a horizontal direction (2,) before a rod is short."""
    a = anchors(robot)
    along = a @ direction
    return float(np.min(along + np.sqrt(along**2 - (a**2).sum(axis=1) + np.square(robot.rod_length_mm))))


def height_over_carriages_mm(robot: Delta, position_mm: Floats) -> float:
    """Distance of the platform from the plane of its rods' upper ends, on the assembled side; zero is singular."""
    sign = 1.0 if robot.assembly_mode == "below" else -1.0
    x = position_mm - np.array(robot.target_offset_mm)
    flat = anchors(robot) - x[:2]
    rods = np.column_stack([flat, sign * np.sqrt(np.square(robot.rod_length_mm) - (flat**2).sum(axis=1))])
    normal = np.cross(rods[1] - rods[0], rods[2] - rods[0])
    return float(sign * np.sign(normal[2]) * (rods[0] @ normal) / np.linalg.norm(normal))


@st.composite
def poses(draw: st.DrawFn, robot: Delta, most: float = 0.9, height_mm: float = 200.0) -> Floats:
    """A position (3,) of the measured point: up to ``most`` of the way to where a rod gets short, not singular."""
    turn = draw(between(0.0, 2.0 * np.pi))
    direction = np.array([np.cos(turn), np.sin(turn)])
    flat = direction * reach_mm(robot, direction) * draw(between(0.0, most))
    position = np.array([*flat, draw(between(-height_mm, height_mm))]) + np.array(robot.target_offset_mm)
    assume(height_over_carriages_mm(robot, position) > _FROM_SINGULAR * min(robot.rod_length_mm))
    return position


@st.composite
def posed_deltas(
    draw: st.DrawFn,
    count: int = 1,
    most: float = 0.9,
    height_mm: float = 200.0,
    assembly_modes: tuple[str, ...] = ("below", "above"),
) -> tuple[Delta, Floats]:
    """A delta and ``count`` positions (count, 3) that it can take."""
    robot = draw(deltas(assembly_modes))
    return robot, np.stack([draw(poses(robot, most, height_mm)) for _ in range(count)])
