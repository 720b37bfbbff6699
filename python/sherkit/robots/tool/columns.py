"""The column names of the tool's tables: a recorded run, and the rows of a load bench."""

from __future__ import annotations

from ...data.columns import TIME

POSITION = ("robot_x_mm", "robot_y_mm", "robot_z_mm")
#: A rotation vector, tool to base.
TURN = ("robot_rx_rad", "robot_ry_rad", "robot_rz_rad")
#: Three fibres at each of the sections I, II, III.
FIBRES = tuple(f"fbg{k + 1}_nm" for k in range(9))
#: When the interrogator took the row's wavelengths, by the robot's clock; without the column, at the row's own time.
FIBRE_TIME = "fbg_time_s"
CAMERA = ("camera_x_mm", "camera_y_mm", "camera_z_mm")
#: The paper's l: from the hole to the unbent tip along the unbent axis; and the length of shaft beyond the hole.
DEPTH, ARC = "depth_mm", "arc_mm"
#: All of a run.
KNOWN = (TIME, *POSITION, *TURN, *FIBRES, FIBRE_TIME, *CAMERA, DEPTH)
#: Sclera force in the tool's frame, and the deflection at the contact along it.
FORCE = ("force_x_mn", "force_y_mn")
DEFLECTION = "deflection_mm"
