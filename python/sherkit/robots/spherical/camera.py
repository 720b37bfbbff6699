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
