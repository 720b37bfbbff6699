"""A camera: its intrinsics from pictures of a board, and the pictures that it would take of a marker on a robot.

Intrinsics are those of a chessboard or a ChArUco board (Zhang, PAMI 2000; OpenCV does the work). The virtual robot's
eyes are NumPy and OpenCV alone: every pixel's ray is followed back through the distorted lens to the marker's plane.
Nothing of it is shared with the core's camera, so that the way from pixels is tested against another.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..base.figures import listed
from ..base.types import Floats, Ints
from ..errors import SherkitError
from .pictures import CameraPicture, picture_in, picture_of

#: A camera has nine unknowns and each picture adds six: fewer pictures than this fix them badly.
_FEWEST = 4
_FEWEST_CORNERS = 6
_WINDOW = (5, 5)
_ENOUGH = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera with Brown–Conrady distortion, in OpenCV's convention.

    ``focal_px`` (x, y), ``centre_px`` (u, v), ``distortion`` (k1, k2, p1, p2), ``size_px`` (width, height). ``std`` has
    the standard deviations of focal_px, centre_px and distortion in this order; ``rms_px`` is what the corners leave,
    ``without`` are the pictures that gave nothing, by name, each with its reason.
    """

    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, float, float, float]
    size_px: tuple[int, int]
    std: tuple[float, ...] = ()
    rms_px: float = float("nan")
    pictures: int = 0
    without: Mapping[str, str] = field(default_factory=dict)

    @property
    def matrix(self) -> Floats:
        """The camera matrix (3, 3)."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def chessboard_intrinsics(
    pictures: Sequence[str | Path | NDArray[Any]], corners: tuple[int, int], square_mm: float
) -> Intrinsics:
    """Intrinsics from pictures of a chessboard with ``corners`` (columns, rows) inner corners.

    Raises :class:`~sherkit.errors.SherkitError` naming pictures without the board, or where too few show it.
    """
    board = np.zeros((corners[0] * corners[1], 3), np.float32)
    board[:, :2] = np.mgrid[0 : corners[0], 0 : corners[1]].T.reshape(-1, 2) * square_mm

    def find(picture: CameraPicture) -> tuple[Any, Any] | None:
        found, points = cv2.findChessboardCorners(picture.grey, corners)
        if not found:
            return None
        return board, cv2.cornerSubPix(picture.grey, points, _WINDOW, (-1, -1), _ENOUGH)

    return _calibrated(pictures, find, f"a chessboard of {corners[0]} × {corners[1]} inner corners")


def charuco_intrinsics(
    pictures: Sequence[str | Path | NDArray[Any]], squares: tuple[int, int], square_mm: float, marker_mm: float,
    dictionary: int = cv2.aruco.DICT_5X5_100,
) -> Intrinsics:  # fmt: skip
    """Intrinsics from pictures of a ChArUco board with ``squares`` (columns, rows); a part of it is enough.

    Raises as :func:`chessboard_intrinsics`.
    """
    board = cv2.aruco.CharucoBoard(squares, square_mm, marker_mm, cv2.aruco.getPredefinedDictionary(dictionary))
    detector = cv2.aruco.CharucoDetector(board)

    def find(picture: CameraPicture) -> tuple[Any, Any] | None:
        points, ids, _, _ = detector.detectBoard(picture.grey)
        if ids is None or len(ids) < _FEWEST_CORNERS:
            return None
        return np.asarray(board.getChessboardCorners())[np.asarray(ids).ravel()], points

    return _calibrated(pictures, find, f"a ChArUco board of {squares[0]} × {squares[1]} squares")


def _calibrated(pictures: Sequence[Any], find: Any, what: str) -> Intrinsics:
    known: list[Any] = []
    seen: list[Any] = []
    missing: dict[str, str] = {}
    size: tuple[int, int] | None = None
    for k, given in enumerate(pictures):
        picture = picture_in(given) if isinstance(given, str | Path) else picture_of(given, f"picture {k}")
        if picture.why:
            missing[picture.name] = picture.why
            continue
        if size is not None and picture.size_px != size:
            raise SherkitError(
                f"{picture.name}: is {picture.size_px[0]} × {picture.size_px[1]} px, the others {size[0]} × {size[1]}; "
                "one camera at one resolution is expected"
            )
        size = picture.size_px
        found = find(picture)
        if found is None:
            missing[picture.name] = "the board was not found"
            continue
        known.append(np.asarray(found[0], np.float32).reshape(-1, 1, 3))
        seen.append(np.asarray(found[1], np.float32).reshape(-1, 1, 2))
    if len(known) < _FEWEST or size is None:
        lost = f"; not in {listed(f'{name} ({why})' for name, why in missing.items())}" if missing else ""
        raise SherkitError(f"{what} was found in {len(known)} pictures; expected {_FEWEST} or more{lost}")
    flags = cv2.CALIB_FIX_K3
    rms, matrix, distortion, _, _, std, _, _ = cv2.calibrateCameraExtended(known, seen, size, None, None, flags=flags)
    spread = np.asarray(std).ravel()
    d = np.asarray(distortion).ravel()
    return Intrinsics(
        focal_px=(float(matrix[0, 0]), float(matrix[1, 1])),
        centre_px=(float(matrix[0, 2]), float(matrix[1, 2])),
        distortion=(float(d[0]), float(d[1]), float(d[2]), float(d[3])),
        size_px=size,
        std=tuple(float(s) for s in spread[:8]),
        rms_px=float(rms),
        pictures=len(known),
        without=missing,
    )


# -- pictures that a camera would take --------------------------------------------------------------------------------

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
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    # the marker's own axes in its plane
    axes = np.array([[cos, sin], [-sin, cos]]) @ [first, np.cross(axis, first)]
    angle = np.linspace(0, 2 * np.pi, 60)
    rim = centre + 1.2 * radius_mm * np.column_stack([np.cos(angle), np.sin(angle)]) @ axes
    if (rim[:, 2] > 0).all():
        i = view.intrinsics
        around = cv2.projectPoints(rim, np.zeros(3), np.zeros(3), i.matrix, np.array(i.distortion))[0].reshape(-1, 2)
        low = np.clip(np.floor(around.min(axis=0)).astype(int), 0, [width, height])
        high = np.clip(np.ceil(around.max(axis=0)).astype(int) + 1, 0, [width, height])
        if (high > low).all():
            picture[low[1] : high[1], low[0] : high[0]] = _patch(i, low, high, centre, axis, axes, radius_mm)
    if blur_px > 0:
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), blur_px))
    picture = picture + noise * rng.standard_normal(picture.shape)
    return np.asarray(np.clip(np.round(picture), 0, 255), dtype=np.uint8)


def _patch(
    i: Intrinsics, low: Ints, high: Ints, centre: Floats, axis: Floats, axes: Floats, radius_mm: float
) -> Floats:
    """Grey values of a rectangle, each the mean of several rays."""
    # a lens bends rays so little over a pixel that those between its corners follow from these
    corners = np.stack(np.meshgrid(*(np.arange(a, b + 1) - 0.5 for a, b in zip(low, high, strict=True))), axis=-1)
    ray = cv2.undistortPoints(
        corners.reshape(-1, 1, 2), i.matrix, np.array(i.distortion),
        criteria=(cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-12),
    ).reshape(corners.shape)  # fmt: skip
    ray = _between(_between(ray).swapaxes(0, 1)).swapaxes(0, 1)
    shape = (high[1] - low[1], _SAMPLES, high[0] - low[0], _SAMPLES)
    ray = np.column_stack([ray.reshape(-1, 2), np.ones(np.prod(shape))])
    facing = ray @ axis
    meets = np.abs(facing) > 1e-9
    reach = np.where(meets, (centre @ axis) / np.where(meets, facing, 1.0), np.inf)
    a, b = axes @ (ray * reach[:, None] - centre).T
    inside = (np.hypot(a, b) <= radius_mm) & (reach > 0)
    grey = np.where(inside, np.where((a > 0) == (b > 0), _BLACK, _WHITE), _PAPER)
    return np.asarray(grey.reshape(shape).mean(axis=(1, 3)))


def _between(corners: Floats) -> Floats:
    """Samples of each pixel (n · samples, …) between corners (n + 1, …), along the first axis."""
    part = ((np.arange(_SAMPLES) + 0.5) / _SAMPLES).reshape(-1, 1, 1)
    each = (1.0 - part) * corners[:-1, None] + part * corners[1:, None]
    return np.asarray(each.reshape(-1, *corners.shape[1:]))
