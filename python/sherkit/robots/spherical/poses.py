"""Sets of poses of the spherical robot: grids over the workspace in φ and γ, lines, and what a plan or a simulation can
name.

Lines are those of the straightness experiment: how straight the robot goes where its picture should follow a line.

Source: Agand, Taghirad, Molaei, section V.C and Table III. A camera looks along the actuated axis; the robot is led
along a line with the kinematics as drawn and as identified. What counts is the root mean square distance of the places
in the picture from their own least-squares line: no position of camera or robot enters.

The paper leads φ constant in its first case and γ constant in its second. Neither shows an error of α or β of two equal
limbs: φ is the mean of the joints and γ a function of their difference, so that the robot keeps on a line of constant φ
and on one of constant γ whatever its arcs. The second is no line in the picture but an arc, on a sphere of 20 cm 0.6 cm
RMS off a straight one, which is about what the paper prints after its calibration (0.59 cm). Lines that are straight in
the picture and cross both do show such errors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base import linalg
from ...base.types import Floats
from ...data.toml import Table
from ...errors import RobotError, ShapeError, SherkitError
from ...model.kinds import MOST_IN_LINE, MOST_PER_SIDE
from .robot import CameraView, Spherical, axes_at

# -- Lines --------------------------------------------------------------------------------------------------------

Angles = tuple[float, float]


@dataclass(frozen=True)
class Line:
    """A line to follow, between two directions (φ, γ), rad: straight in the ``"picture"``, or in the ``"angles"``."""

    start_rad: Angles
    end_rad: Angles
    straight_in: str = "picture"


#: The paper's two cases. γ ends at 60°, as its calibration does: a marker further out is seen too slantwise from above.
PAPER_LINES: Mapping[str, Line] = {
    "vertical": Line((np.pi / 2, np.pi / 6), (np.pi / 2, np.pi / 3), "angles"),
    "horizontal": Line((np.pi / 3, np.pi / 4), (2 * np.pi / 3, np.pi / 4), "angles"),
}
#: Straight in the picture: between the ends of the paper's second case, and across both.
OWN_LINES: Mapping[str, Line] = {
    "chord": Line((np.pi / 3, np.pi / 4), (2 * np.pi / 3, np.pi / 4)),
    "diagonal": Line((np.pi / 3, np.pi / 6), (2 * np.pi / 3, np.pi / 3)),
}
_SAME_RAD = 1e-6
LINES: Mapping[str, Line] = {**PAPER_LINES, **OWN_LINES}


def targets(camera: CameraView, radius_mm: float, line: Line, count: int = 41) -> Floats:
    """Directions φ, γ (count, 2), rad, that lie evenly on a line: on a straight one of the picture, or of the angles.

    ``camera`` is the one that watches the experiment, ``radius_mm`` of the sphere on which the marker is believed to
    move. Raises :class:`~sherkit.errors.SherkitError` where the camera does not see the line.
    """
    share = np.linspace(0.0, 1.0, count)[:, None]
    start, end = np.array(line.start_rad), np.array(line.end_rad)
    led = start + share * (end - start)
    pixels, _ = camera.core.project_batch(radius_mm * axes_at(led))
    if line.straight_in == "picture":
        pixels = np.ascontiguousarray(pixels[0] + share * (pixels[-1] - pixels[0]))
        known = np.array([0, count - 1])
    else:
        known = np.arange(count)
    angles, seen = camera.core.angles_batch(pixels, radius_mm)
    # beyond the rim a ray meets the near side first
    seen[known] &= np.abs(angles[known] - led[known]).max(axis=1) <= _SAME_RAD
    if not seen.all():
        raise SherkitError(
            f"the camera does not see the sphere of {radius_mm:g} mm at {int((~seen).sum())} of {count} places of the "
            "line; move it away, or end the line before the sphere's rim"
        )
    return angles if line.straight_in == "picture" else led


def straightness(places: ArrayLike) -> float:
    """Root mean square distance of places (n, d) from their least-squares line, in their own unit.

    The line is that of total least squares (Pearson 1901): distances are counted at right angles to it. Raises
    :class:`~sherkit.errors.ShapeError` for fewer than three places, or numbers that are not finite.
    """
    x = np.asarray(places, dtype=float)
    if x.ndim != 2 or len(x) < 3 or x.shape[1] < 2:
        raise ShapeError(f"straightness: expected at least 3 places of 2 or 3 numbers, got an array of shape {x.shape}")
    if not np.isfinite(x).all():
        row = int(np.argmax(~np.isfinite(x).all(axis=1)))
        raise ShapeError(f"straightness: row {row} holds a number that is not finite")
    values = linalg.singular_values(x - x.mean(axis=0))
    return float(np.sqrt((values[1:] ** 2).sum() / len(x)))


def straightness_by(names: NDArray[np.str_] | list[str], places: ArrayLike) -> dict[str, float]:
    """:func:`straightness` of the rows of every line: ``names`` (n,) tells which line a row of ``places`` is on."""
    x, which = np.asarray(places, dtype=float), np.asarray(names)
    if len(which) != len(x):
        raise ShapeError(f"straightness: {len(which)} names for {len(x)} places")
    return {str(name): straightness(x[which == name]) for name in dict.fromkeys(which.tolist())}


# -- Grids --------------------------------------------------------------------------------------------------------


def sphere_patch(robot: Spherical, per_side: int, share: float = 1.0) -> Floats:
    """Directions φ, γ (n, 2), rad: a grid over the middle ``share`` of a spherical robot's workspace, row by row.

    Rows are walked back and forth. Raises :class:`~sherkit.errors.RobotError` where the robot has no workspace.
    """
    if robot.phi_deg is None or robot.gamma_deg is None:
        raise RobotError("a grid over the workspace needs [workspace] phi_deg and gamma_deg in the robot file")
    ticks = []
    for low, high in (robot.phi_deg, robot.gamma_deg):
        middle, half = 0.5 * (low + high), 0.5 * share * (high - low)
        ticks.append(np.deg2rad(np.linspace(middle - half, middle + half, per_side)))
    phi, gamma = ticks
    return np.array([(a, b) for j, b in enumerate(gamma) for a in (phi if j % 2 == 0 else phi[::-1])], dtype=float)


# -- By name ------------------------------------------------------------------------------------------------------


def _patch(robot: Spherical, table: Table) -> Floats:
    return sphere_patch(
        robot, table.whole("per_side", least=1, most=MOST_PER_SIDE), table.number("share", 1.0, positive=True)
    )


def _line(robot: Spherical, table: Table) -> Floats:
    # the straightness experiment
    line = LINES[table.text("line", tuple(LINES))]
    return targets(robot.seen, robot.radius_mm, line, table.whole("count", 41, least=3, most=MOST_IN_LINE))


def _list(robot: Spherical, table: Table) -> Floats:
    del robot
    rows = table.rows("list_deg", 2)
    if not rows:
        raise table.fail("list_deg", "at least one direction")
    return np.deg2rad(np.array(rows))


#: Directions φ, γ (n, 2), rad, by the name that the plan gives them.
POSES: Mapping[str, Callable[[Spherical, Table], Floats]] = {"patch": _patch, "line": _line, "list": _list}
#: The whole workspace, and the middle half of it.
AREAS: Mapping[str, Callable[[Spherical], Floats]] = {
    "whole": lambda robot: sphere_patch(robot, 12),
    "local": lambda robot: sphere_patch(robot, 8, 0.5),
}
