"""The columns of a run of a serial arm: its joints under their own names, and the target as a tracker shows it."""

from __future__ import annotations

from collections.abc import Sequence

from ...data.columns import Layout

POSITION = ("x_mm", "y_mm", "z_mm")


def layout_of_arm(joints: Sequence[tuple[str, str]]) -> Layout:
    """For joints by name and unit, rad or mm."""
    names = tuple(f"{name}_{unit}" for name, unit in joints)
    return Layout(names, POSITION, "µm", 1e3, velocities=tuple(f"{name}_per_s" for name in names))
