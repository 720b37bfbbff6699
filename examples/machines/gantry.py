"""A gantry of three axes, squareness and tilt of its own; everything else is left to the diagnosis. Diagnosed by

sherkit diagnose examples/machines/gantry.py run.csv
"""

import numpy as np

import sherkit as sk


def forward(q, p):
    """Position of the tool, mm."""
    x, y, z = q.T
    return np.stack([x + p.squareness_xy * y, y, z + p.tilt * x], axis=1)


machine = sk.Machine(
    forward,
    joints={"x_axis_mm": (0, 400), "y_axis_mm": (0, 300), "z_axis_mm": (0, 200)},
    readings=("x_mm", "y_mm", "z_mm"),
    parameters={"squareness_xy": ("rad", 1e-3), "tilt": ("rad", 1e-3)},
)
