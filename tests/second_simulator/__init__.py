"""Independent NumPy simulator of a linear delta robot with hidden physical effects.

It shares nothing with the calibration tool whose tests use it; agreement is then evidence.
"""

from .effects import CATALOGUE, EFFECTS, OUTSIDE_CATALOGUE, draw_effect, draw_pose
from .geometry import (
    FITTED_SIZES,
    NOMINAL_CONFIG,
    Robot,
    draw_geometric_errors,
    draw_zeros,
    inverse_kinematics,
    with_errors,
    write_robot_toml,
)
from .noise import Noise
from .plans import grid, local_grid, make_plan, room_temperature, whole_grid, write_csv
from .simulate import fitted_directions, platform_pose, scaled_effect, simulate, truth

__all__ = [
    "CATALOGUE", "EFFECTS", "FITTED_SIZES", "NOMINAL_CONFIG", "OUTSIDE_CATALOGUE", "Noise", "Robot", "draw_effect",
    "draw_geometric_errors",
    "draw_pose", "draw_zeros", "fitted_directions", "grid", "inverse_kinematics", "local_grid", "make_plan",
    "platform_pose", "room_temperature", "scaled_effect", "simulate", "truth", "whole_grid", "with_errors", "write_csv",
    "write_robot_toml",
]  # fmt: skip
