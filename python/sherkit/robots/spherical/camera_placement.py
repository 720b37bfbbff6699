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
    """What a camera sees from ``distance_mm`` from the centre of the sphere, all of its rim in the picture.

    ``half_angle_rad`` is the horizon, where rays touch the sphere, counted at the centre from the point below the
    camera. ``coverage`` is the share of the half circle inside the horizon. Areas as in Eq. 32; ``benefit_mm2`` is what
    was maximised.
    """

    distance_mm: float
    half_angle_rad: float
    coverage: float
    seen_mm2: float
    waste_mm2: float
    benefit_mm2: float


def camera_placement(
    radius_mm: float, lens_rad: float, *, weight: float = PAPER_WEIGHT, region: str = "half",
    distance_mm: float | None = None,
) -> Placement:  # fmt: skip
    """The best distance of a camera whose half angle of view is ``lens_rad``, or what is seen from ``distance_mm``.

    ``region`` is the part of the sphere that is worked on, ``"half"`` or ``"quarter"``. Eq. 32 takes the lens for wide
    enough to show the sphere's whole rim; what lies beside it in the picture is wasted.

    Raises :class:`~sherkit.errors.ShapeError` where it is not (:func:`picture_half_angle` says what such a lens shows),
    and for a lens, radius, weight or distance that make no picture of the sphere.
    """
    if region not in REGIONS:
        raise ShapeError(f"region: '{region}' is not known; choose {' or '.join(REGIONS)}")
    found = _core.spherical_camera_placement(radius_mm, lens_rad, weight, region, distance_mm)
    if found["waste_mm2"] < 0:
        distance = found["distance_mm"]
        lens, rim = np.rad2deg([lens_rad, np.arcsin(radius_mm / distance)])
        best = "" if distance_mm is not None else ", where the benefit would be largest"
        raise ShapeError(
            f"lens_rad: half an angle of view of {lens:.2f}° shows nothing but sphere from {distance:.1f} mm{best}: "
            f"its rim takes {rim:.2f}° there, and the area beside it would be negative; take a wider lens, or choose "
            "the distance by what picture_half_angle must show"
        )
    return Placement(**found)


def picture_half_angle(radius_mm: float, lens_rad: float, distance_mm: float) -> float:
    """How much of the sphere a picture shows whose half angle of view is ``lens_rad``, rad.

    Counted at the centre, from the point below the camera to the edge of the picture, or to the horizon where that is
    nearer (Eq. 13).

    Raises :class:`~sherkit.errors.ShapeError` for a camera within the sphere or a lens that is none.
    """
    if not (0.0 < radius_mm < distance_mm < np.inf and 0.0 < lens_rad < 0.5 * np.pi):
        raise ShapeError(
            "picture_half_angle: expected a camera outside the sphere and half an angle of view between 0 and π/2, got "
            f"radius_mm = {radius_mm:g}, distance_mm = {distance_mm:g}, lens_rad = {lens_rad:g}"
        )
    edge = distance_mm / radius_mm * np.sin(lens_rad)
    return float(np.arcsin(edge) - lens_rad if edge < 1.0 else np.arccos(radius_mm / distance_mm))
