"""The columns of a run of the planar arm: two angles, and the coordinates of the tip that an instrument shows."""

from __future__ import annotations

from sherkit.data.columns import Layout

JOINTS = ("shoulder_rad", "elbow_rad")
#: What the arm's kinematics gives; instruments show the height as well.
TIP = ("x_mm", "y_mm")

PLANAR = Layout(JOINTS, (*TIP, "z_mm"), "µm", 1e3)
