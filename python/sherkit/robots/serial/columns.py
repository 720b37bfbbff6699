"""The columns of a run of a serial arm: its joints under their own names; where a tracker sees a target, or how far it
is from a fixed centre or plane."""

from __future__ import annotations

from collections.abc import Sequence

from ...data.columns import Layout

POSITION = ("x_mm", "y_mm", "z_mm")
#: Number of the target, from 1, where an arm carries several, and of the centre or plane from which a distance counts.
TARGET, CENTRE, PLANE = "target", "centre", "plane"
#: What hangs at the first target besides the arm's own weight, kg.
PAYLOAD = "payload_kg"


def layout_of_arm(joints: Sequence[tuple[str, str]]) -> Layout:
    """For joints by name and unit, rad or mm."""
    names = tuple(f"{name}_{unit}" for name, unit in joints)
    velocities = tuple(f"{name}_per_s" for name in names)
    return Layout(
        names,
        POSITION,
        "µm",
        1e3,
        "distance_mm",
        (CENTRE, PLANE),
        velocities,
        apart=(TARGET, CENTRE, PLANE),
        from_fixed=True,
        loads=(PAYLOAD,),
        own_joints=True,
    )
