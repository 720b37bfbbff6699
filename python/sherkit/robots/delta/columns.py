"""The columns of a run of the linear delta."""

from __future__ import annotations

from ...data.columns import Layout

JOINTS = ("q1_mm", "q2_mm", "q3_mm")
TO_JOINTS = ("to_q1_mm", "to_q2_mm", "to_q3_mm")
POSITION = ("x_mm", "y_mm", "z_mm")
DISTANCE = "distance_mm"

#: Carriages, coordinates of the measured point, distances between two of its places.
DELTA = Layout(JOINTS, POSITION, "µm", 1e3, DISTANCE, TO_JOINTS)
