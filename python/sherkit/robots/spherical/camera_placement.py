"""Where to put the one camera that looks at a spherical robot: near enough to see small angles, far enough to see all.

Source: Agand, Taghirad, Molaei, Eqs. 29 to 33: what is seen of the sphere against what of the picture is wasted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import sherkit._core as _core

from ...errors import ShapeError

REGIONS = ("half", "quarter")
#: The paper's weight of seen against wasted.
PAPER_WEIGHT = 5.0


@dataclass(frozen=True)
class Placement:
    """What a camera sees from ``distance_mm`` from the centre of the sphere.

    Angles are counted at the centre, from the point below the camera. ``half_angle_rad`` is the horizon, where rays
    touch the sphere (the paper's limit, which takes the lens for wide enough); ``picture_half_angle_rad`` is what the
    lens lets through of it. ``coverage`` is the share of the half circle inside the horizon. Areas as in Eq. 32;
    ``benefit_mm2`` is what was maximised.
    """

    distance_mm: float
    half_angle_rad: float
    picture_half_angle_rad: float
    coverage: float
    seen_mm2: float
    waste_mm2: float
    benefit_mm2: float


def camera_placement(
    radius_mm: float, lens_rad: float, *, weight: float = PAPER_WEIGHT, region: str = "half",
    distance_mm: float | None = None,
) -> Placement:  # fmt: skip
    """The best distance of a camera whose half angle of view is ``lens_rad``, or what is seen from ``distance_mm``.

    ``region`` is the part of the sphere that is worked on, ``"half"`` or ``"quarter"``. Raises
    :class:`~sherkit.errors.ShapeError` for a lens, radius, weight or distance that make no picture of the sphere.
    """
    if region not in REGIONS:
        raise ShapeError(f"region: '{region}' is not known; choose {' or '.join(REGIONS)}")
    found = _core.spherical_camera_placement(radius_mm, lens_rad, weight, region, distance_mm)
    # Eq. 13 for the ray at the edge of the picture
    edge = found["distance_mm"] / radius_mm * np.sin(lens_rad)
    through = float(np.arcsin(edge) - lens_rad) if edge < 1.0 else found["half_angle_rad"]
    return Placement(**found, picture_half_angle_rad=through)
