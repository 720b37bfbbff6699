"""Pictures that a camera would take of a marker on a robot: the virtual robot's eyes, in NumPy and OpenCV alone.

Every pixel's ray is followed back through the distorted lens to the marker's plane. Nothing here is shared with the
core's camera, so that the way from pixels is tested against another.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..base.types import Floats
from .intrinsics import Intrinsics

_SAMPLES = 4
_PAPER, _BLACK, _WHITE = 128.0, 25.0, 230.0


@dataclass(frozen=True)
class View:
    """Where the camera stands: x_camera = R(``rotation_rad``) x + ``translation_mm``, OpenCV's convention."""

    intrinsics: Intrinsics
    rotation_rad: tuple[float, float, float]
    translation_mm: tuple[float, float, float]

    @property
    def rotation(self) -> Floats:
        """The rotation (3, 3)."""
        return np.asarray(cv2.Rodrigues(np.array(self.rotation_rad))[0])


def draw_marker(
    view: View, at_mm: Floats, normal: Floats, radius_mm: float, rng: np.random.Generator, *,
    turn_rad: float = 0.0, blur_px: float = 0.7, noise: float = 2.0,
) -> NDArray[np.uint8]:  # fmt: skip
    """A picture (height, width) of a corner marker: a disk of ``radius_mm`` about ``at_mm`` (3,) that faces ``normal``.

    ``turn_rad`` turns it in its plane; ``blur_px`` is the lens's, ``noise`` that of the grey values (1 σ).
    """
    width, height = view.intrinsics.size_px
    picture = np.full((height, width), _PAPER)
    rotation, shift = view.rotation, np.array(view.translation_mm)
    centre = rotation @ at_mm + shift
    axis = rotation @ (normal / np.linalg.norm(normal))
    first = np.cross(axis, [0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    first, second = (
        np.cos(turn_rad) * first + np.sin(turn_rad) * second,
        -np.sin(turn_rad) * first + np.cos(turn_rad) * second,
    )
    angle = np.linspace(0, 2 * np.pi, 60)
    rim = centre + 1.2 * radius_mm * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)
    if (rim[:, 2] > 0).all():
        i = view.intrinsics
        around = cv2.projectPoints(rim, np.zeros(3), np.zeros(3), i.matrix, np.array(i.distortion))[0].reshape(-1, 2)
        low = np.clip(np.floor(around.min(axis=0)).astype(int), 0, [width, height])
        high = np.clip(np.ceil(around.max(axis=0)).astype(int) + 1, 0, [width, height])
        if (high > low).all():
            picture[low[1] : high[1], low[0] : high[0]] = _patch(
                view, low, high, centre, axis, first, second, radius_mm
            )
    if blur_px > 0:
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), blur_px))
    picture = picture + noise * rng.standard_normal(picture.shape)
    return np.asarray(np.clip(np.round(picture), 0, 255), dtype=np.uint8)


def _patch(
    view: View, low: NDArray[np.int64], high: NDArray[np.int64], centre: Floats, axis: Floats, first: Floats,
    second: Floats, radius_mm: float,
) -> Floats:  # fmt: skip
    """Grey values of a rectangle, each the mean of several rays."""
    # a lens bends rays so little over a pixel that those between its corners follow from these
    corners = np.stack(np.meshgrid(*(np.arange(a, b + 1) - 0.5 for a, b in zip(low, high, strict=True))), axis=-1)
    i = view.intrinsics
    ray = cv2.undistortPoints(
        corners.reshape(-1, 1, 2), i.matrix, np.array(i.distortion),
        criteria=(cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-12),
    ).reshape(corners.shape)  # fmt: skip
    ray = _between(_between(ray).swapaxes(0, 1)).swapaxes(0, 1)
    shape = (high[1] - low[1], _SAMPLES, high[0] - low[0], _SAMPLES)
    ray = np.column_stack([ray.reshape(-1, 2), np.ones(np.prod(shape))])
    facing = ray @ axis
    reach = np.where(np.abs(facing) > 1e-9, (centre @ axis) / np.where(np.abs(facing) > 1e-9, facing, 1.0), np.inf)
    hit = ray * reach[:, None] - centre
    a, b = hit @ first, hit @ second
    inside = (np.hypot(a, b) <= radius_mm) & (reach > 0)
    grey = np.where(inside, np.where((a > 0) == (b > 0), _BLACK, _WHITE), _PAPER)
    return np.asarray(grey.reshape(shape).mean(axis=(1, 3)))


def _between(corners: Floats) -> Floats:
    """Samples of each pixel (n · samples, …) between corners (n + 1, …), along the first axis."""
    part = ((np.arange(_SAMPLES) + 0.5) / _SAMPLES).reshape(-1, 1, 1)
    each = (1.0 - part) * corners[:-1, None] + part * corners[1:, None]
    return np.asarray(each.reshape(-1, *corners.shape[1:]))
