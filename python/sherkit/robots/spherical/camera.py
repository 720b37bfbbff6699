"""The camera that looks at the spherical robot: calibrated before, and placed by the robot's file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

import sherkit._core as _core

from ...base.saved import Saved
from ...base.types import Floats
from ...data.toml import Table
from ...errors import ShapeError

Pair = tuple[float, float]
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class CameraView(Saved):
    """A calibrated camera and where it stands: x_camera = R(``rotation_rad``) x + ``translation_mm``, as in OpenCV.

    ``distortion`` holds k1, k2, p1, p2, k3 (Brown and Conrady). Pixels, mm, rad. ``marker_sigma_px`` is the standard
    deviation of where a marker is found, along u and v, by which poses differ and repeats of one do not: its edges fall
    on the pixels another way at every pose. None where it is not declared.
    """

    size_px: tuple[int, int]
    focal_px: Pair
    centre_px: Pair
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    rotation_rad: Triple = (0.0, 0.0, 0.0)
    translation_mm: Triple = (0.0, 0.0, 0.0)
    marker_sigma_px: float | None = None

    @classmethod
    def facing(
        cls, phi_rad: float, gamma_rad: float, distance_mm: float, *, size_px: tuple[int, int], focal_px: Pair,
        centre_px: Pair | None = None, distortion: tuple[float, float, float, float, float] = (0.0,) * 5,
        marker_sigma_px: float | None = None,
    ) -> CameraView:  # fmt: skip
        """A camera at (φ, γ), ``distance_mm`` from the centre of the sphere, that looks at it; γ grows downwards."""
        centre = centre_px or ((size_px[0] - 1) / 2.0, (size_px[1] - 1) / 2.0)
        inner = np.array([*focal_px, *centre])
        made = _core.Camera.facing(phi_rad, gamma_rad, distance_mm, inner)
        turn, shift = made[9:12].tolist(), made[12:15].tolist()
        return cls(
            size_px, focal_px, centre, distortion, (turn[0], turn[1], turn[2]), (shift[0], shift[1], shift[2]),
            marker_sigma_px,
        )  # fmt: skip

    @property
    def parameters(self) -> Floats:
        """The 15 numbers of the core: focal lengths, centre, distortion, rotation, translation."""
        return np.array(
            [*self.focal_px, *self.centre_px, *self.distortion, *self.rotation_rad, *self.translation_mm], dtype=float
        )

    @cached_property
    def core(self) -> _core.Camera:
        """The compiled camera."""
        return _core.Camera(self.parameters)

    @classmethod
    def from_table(cls, table: Table) -> CameraView:
        """Reads the table [camera]: placed by ``phi_deg``, ``gamma_deg`` and ``distance_mm``, or by pose."""
        size = table.numbers("size_px", 2, positive=True)
        inner: dict[str, Any] = {
            "size_px": (round(size[0]), round(size[1])),
            "focal_px": table.numbers("focal_px", 2, positive=True),
            "centre_px": table.numbers("centre_px", 2, ((size[0] - 1) / 2.0, (size[1] - 1) / 2.0)),
            "distortion": table.numbers("distortion", 5, (0.0,) * 5),
            "marker_sigma_px": table.positive("marker_sigma_px"),
        }
        if table.has("distance_mm"):
            distance = table.number("distance_mm", positive=True)
            phi, gamma = (float(np.deg2rad(table.number(key))) for key in ("phi_deg", "gamma_deg"))
            return cls.facing(phi, gamma, distance, **inner)
        return cls(
            **inner,
            rotation_rad=table.numbers("rotation_rad", 3),  # type: ignore[arg-type]
            translation_mm=table.numbers("translation_mm", 3),  # type: ignore[arg-type]
        )

    def to_table(self) -> dict[str, Any]:
        """What :meth:`from_table` reads, without loss."""
        return {
            "size_px": list(self.size_px),
            "focal_px": list(self.focal_px),
            "centre_px": list(self.centre_px),
            "distortion": list(self.distortion),
            "rotation_rad": list(self.rotation_rad),
            "translation_mm": list(self.translation_mm),
            **({} if self.marker_sigma_px is None else {"marker_sigma_px": self.marker_sigma_px}),
        }


# -- Where to put the one camera that looks at a spherical robot ----------------------------------------------------

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
