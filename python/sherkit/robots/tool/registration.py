"""The rigid transform between two clouds of points (Eqs. 15 to 19; Besl and McKay 1992, Kabsch 1978)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

import sherkit._core as _core

from ...base.types import Floats
from ...errors import ShapeError


@dataclass(frozen=True, eq=False)
class Registration:
    """x_target = ``rotation`` x_source + ``translation_mm``.

    ``residuals_mm`` (n, 3) are target less transformed source. ``covariance`` (6, 6) is that of a small rotation (rad,
    about the target's axes) and of the translation (mm), for residuals of the size found.
    """

    rotation: Floats
    translation_mm: Floats
    residuals_mm: Floats
    covariance: Floats

    @property
    def rotation_rad(self) -> Floats:
        """The rotation as a vector (3,)."""
        return np.asarray(scipy.spatial.transform.Rotation.from_matrix(self.rotation).as_rotvec())

    @property
    def mean_error_mm(self) -> float:
        """Mean length of the residuals, as the paper prints it (Eq. 20)."""
        known = np.isfinite(self.residuals_mm).all(axis=1)
        return float(np.linalg.norm(self.residuals_mm[known], axis=1).mean())

    def apply(self, points_mm: ArrayLike) -> Floats:
        """Points (n, 3) of the source's frame in the target's."""
        return np.atleast_2d(np.asarray(points_mm, dtype=float)) @ self.rotation.T + self.translation_mm


def register(source_mm: ArrayLike, target_mm: ArrayLike, method: str = "quaternion") -> Registration:
    """The transform that takes points (n, 3) to points (n, 3), by ``"quaternion"`` or ``"svd"``; both agree.

    Raises :class:`~sherkit.errors.ShapeError` for clouds of unlike size, and :class:`~sherkit.errors.FitError` that
    says whether the points are too few or stand on a line.
    """
    a, b = (np.ascontiguousarray(np.atleast_2d(np.asarray(p, dtype=float))) for p in (source_mm, target_mm))
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 3:
        raise ShapeError(f"registration: expected two clouds (n, 3), got {a.shape} and {b.shape}")
    found = _core.register_points(a, b, method)
    return Registration(
        rotation=found["rotation"],
        translation_mm=found["translation_mm"],
        residuals_mm=found["residuals_mm"],
        covariance=found["unit_covariance"] * found["residual_variance"],
    )
