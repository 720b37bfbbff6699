"""A SCARA: two arms that turn, a quill that slides; a tracker, which may stand anywhere, reads the tool. Diagnosed by

sherkit diagnose examples/machines/scara.py run.csv
"""

import numpy as np

import sherkit as sk


def forward(q, p):
    """Position of the tool, mm, in the frame of the base."""
    first = q[:, 0]
    second = first + q[:, 1] + p.elbow_zero
    x = (250 + p.upper_arm) * np.cos(first) + (200 + p.forearm) * np.cos(second)
    y = (250 + p.upper_arm) * np.sin(first) + (200 + p.forearm) * np.sin(second)
    return np.stack([x, y, -q[:, 2]], axis=1)


machine = sk.Machine(
    forward,
    joints={"shoulder_rad": (-2.0, 2.0), "elbow_rad": (0.3, 2.4), "quill_mm": (0.0, 150.0)},
    readings=("x_mm", "y_mm", "z_mm"),
    parameters={"upper_arm": ("mm", 0.5), "forearm": ("mm", 0.5), "elbow_zero": ("rad", 0.01)},
)
