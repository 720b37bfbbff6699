"""A machine tool of three axes with its 21 geometric errors (ISO 230-1), each to lowest order: how far an axis goes
(linear), how straight (quadratic) and how it tilts (linear), and three squarenesses. A ball or tracker reads the tool.
"""

import numpy as np

import sherkit as sk

SPAN, OVERHANG = 300.0, np.array([0.0, 0.0, -120.0])  # mm; from the spindle's nose to the tool
AXES = "xyz"


def forward(q, p):
    """Position of the tool, mm: each axis moves, errs and tilts what it carries, in the order x, y, z."""
    tool = 0 * q + OVERHANG
    for k in (2, 1, 0):
        part = q[:, k] / SPAN
        tilt = np.stack([getattr(p, f"{turn}_{AXES[k]}") * part for turn in ("rx", "ry", "rz")], axis=1)
        err = [getattr(p, f"{d}_{AXES[k]}") * (part if d == AXES[k] else part**2) for d in AXES]
        tool = tool + np.cross(tilt, tool) + np.stack(err, axis=1) + np.eye(3)[k] * q[:, k, None]
    square = np.stack([p.square_xy * q[:, 1] + p.square_xz * q[:, 2], p.square_yz * q[:, 2], 0 * q[:, 0]], axis=1)
    return tool + square - OVERHANG


machine = sk.Machine(
    forward,
    joints={f"{axis}_axis_mm": (0.0, SPAN) for axis in AXES},
    readings=("x_mm", "y_mm", "z_mm"),
    parameters={
        **{f"{error}_{axis}": ("mm", 0.05) for axis in AXES for error in AXES},
        **{f"{turn}_{axis}": ("rad", 1e-4) for axis in AXES for turn in ("rx", "ry", "rz")},
        **{f"square_{pair}": ("rad", 1e-4) for pair in ("xy", "xz", "yz")},
    },
)
