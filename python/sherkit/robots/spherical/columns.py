"""The columns of a run of the spherical robot: seen by a camera, or as angles that vision has found already."""

from __future__ import annotations

from ...data.columns import Layout

SPHERICAL_JOINTS = ("theta1_rad", "theta2_rad")
_VELOCITIES = ("theta1_rad_per_s", "theta2_rad_per_s")

SPHERICAL_PIXELS = Layout(SPHERICAL_JOINTS, ("u_px", "v_px"), "px", 1.0, velocities=_VELOCITIES)
SPHERICAL_ANGLES = Layout(SPHERICAL_JOINTS, ("phi_rad", "gamma_rad"), "mrad", 1e3, velocities=_VELOCITIES)
