"""The straightness experiment: how straight the robot goes where its picture should follow a line.

Source: Agand, Taghirad, Molaei, section V.C and Table III. A camera looks along the actuated axis; the robot is led so
that its picture should move along a line, with the kinematics as drawn and as identified. What counts is the root mean
square distance of the places from their own least-squares line: no position of camera or robot enters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import ShapeError, SherkitError
from ...types import Floats
from .camera import CameraView

Angles = tuple[float, float]


@dataclass(frozen=True)
class Line:
    """A line to follow, between two directions (φ, γ), rad."""

    start_rad: Angles
    end_rad: Angles


#: The paper's two cases. γ ends at 60°, as its calibration does: a marker further out is seen too slantwise from above.
PAPER_LINES: Mapping[str, Line] = {
    "vertical": Line((np.pi / 2, np.pi / 6), (np.pi / 2, np.pi / 3)),
    "horizontal": Line((np.pi / 3, np.pi / 4), (2 * np.pi / 3, np.pi / 4)),
}
#: Along a vertical line through the axis φ is constant, and the mean of the joints whatever α and β: it cannot show
#: them. A line across can.
DIAGONAL = Line((np.pi / 3, np.pi / 6), (2 * np.pi / 3, np.pi / 3))
_SAME_RAD = 1e-6
LINES: Mapping[str, Line] = {**PAPER_LINES, "diagonal": DIAGONAL}


def targets(camera: CameraView, radius_mm: float, line: Line, count: int = 41) -> Floats:
    """Directions φ, γ (count, 2), rad, whose pictures lie evenly on a straight line of the picture.

    ``camera`` is the one that watches the experiment, ``radius_mm`` of the sphere on which the marker is believed to
    move. Raises :class:`~sherkit.errors.SherkitError` where the camera does not see the line.
    """
    ends = []
    for phi, gamma in (line.start_rad, line.end_rad):
        axis = np.array([np.sin(gamma) * np.cos(phi), np.sin(gamma) * np.sin(phi), np.cos(gamma)])
        ends.append(camera.core.project(radius_mm * axis))
    share = np.linspace(0.0, 1.0, count)[:, None]
    pixels = np.ascontiguousarray(ends[0] + share * (ends[1] - ends[0]))
    angles, seen = camera.core.angles_batch(pixels, radius_mm)
    # beyond the rim a ray meets the near side first
    hidden = np.abs(angles[[0, -1]] - [line.start_rad, line.end_rad]).max(axis=1) > _SAME_RAD
    seen[[0, -1]] &= ~hidden
    if not seen.all():
        raise SherkitError(
            f"the camera does not see the sphere of {radius_mm:g} mm at {int((~seen).sum())} of {count} places of the "
            "line; move it away, or end the line before the sphere's rim"
        )
    return angles


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
    values = np.linalg.svd(x - x.mean(axis=0), compute_uv=False)
    return float(np.sqrt((values[1:] ** 2).sum() / len(x)))


def straightness_by(names: NDArray[np.str_] | list[str], places: ArrayLike) -> dict[str, float]:
    """:func:`straightness` of the rows of every line: ``names`` (n,) tells which line a row of ``places`` is on."""
    x, which = np.asarray(places, dtype=float), np.asarray(names)
    if len(which) != len(x):
        raise ShapeError(f"straightness: {len(which)} names for {len(x)} places")
    return {str(name): straightness(x[which == name]) for name in dict.fromkeys(which.tolist())}
