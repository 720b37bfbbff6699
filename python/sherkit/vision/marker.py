"""A marker in a picture, to a small part of a pixel, or the reason why there is none.

``corner``: a disk of two black and two white quadrants, whose middle is the one corner where four fields meet. Harris'
detector proposes corners (Harris and Stephens, 1988); the one kept looks the same turned by half a turn and inverted
turned by a quarter. ``aruco`` and ``apriltag``: the middle of a tag of a dictionary.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from ..base import linalg
from ..base.types import Floats
from ..errors import SherkitError
from .pictures import CameraPicture, picture_of

KINDS = ("corner", "aruco", "apriltag")
#: The dictionaries of the tags, by their names and as OpenCV counts them.
DICTIONARIES = {
    "aruco": ("DICT_4X4_50", cv2.aruco.DICT_4X4_50),
    "apriltag": ("DICT_APRILTAG_36h11", cv2.aruco.DICT_APRILTAG_36h11),
}

#: Half the side of the patch that is compared with itself turned, px.
_PATCH = 7
#: Symmetric and antisymmetric correlation that a marker must reach, and its contrast in grey values.
_ALIKE = 0.8
_CONTRAST = 30.0
#: Corners closer than this are the same one, px.
_SAME = 8.0
_MOST_PROPOSED = 60
#: Width of the edges, px, from which a picture counts as blurred.
_BLURRED = 5.0
_WINDOW = (6, 6)
_MOST_STEPS = 15
#: Area of the blur that the refinement works on, in pixels: 4 π σ² at σ = 1.
_TIED = 12.6
#: What a corner of a tag is found to, px, as measured on rendered tags; the middle is found to half of it.
_TAG_CORNER_PX = 0.1
_ENOUGH = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)


@dataclass(frozen=True)
class Seen:
    """A marker's place ``u_px``, ``v_px`` with its standard deviation ``sigma_px``; NaN where there is none.

    ``why`` is empty where one marker was found, else a sentence: no marker, blurred, how many candidates, or a picture
    that could not be read.
    """

    u_px: float
    v_px: float
    sigma_px: float
    why: str = ""

    @property
    def found(self) -> bool:
        """Whether there is a place."""
        return not self.why


def _none(why: str) -> Seen:
    return Seen(float("nan"), float("nan"), float("nan"), why)


def find_marker(
    given: str | Path | NDArray[Any] | CameraPicture, kind: str = "corner", identity: int | None = None
) -> Seen:
    """The marker of a picture, or why there is none.

    ``identity`` is the number of the tag where several may be seen. Raises :class:`~sherkit.errors.SherkitError` for an
    unknown kind, or what is no picture.
    """
    if kind not in KINDS:
        raise SherkitError(f"marker: '{kind}' is not known; choose {', '.join(KINDS)}")
    picture = picture_of(given)
    if picture.why:
        return _none(picture.why)
    return _corner(picture.grey) if kind == "corner" else _tag(picture.grey, kind, identity)


def _corner(grey: NDArray[np.uint8]) -> Seen:
    proposed = cv2.goodFeaturesToTrack(
        grey, _MOST_PROPOSED, qualityLevel=0.05, minDistance=_SAME, blockSize=5, useHarrisDetector=True, k=0.04
    )
    if proposed is None:
        soft = any(_four_fields_anywhere(smaller) for smaller in _pyramid(grey))
        return _none("blurred: a marker is there, and its edges are too soft" if soft else "no marker was found")
    refined = cv2.cornerSubPix(grey, np.asarray(proposed, np.float32), _WINDOW, (-1, -1), _ENOUGH).reshape(-1, 2)
    best: list[tuple[float, float, float]] = []
    soft = False
    for u, v in refined.tolist():
        likeness = _four_fields(grey, u, v)
        if likeness < _ALIKE or any(np.hypot(u - a, v - b) < _SAME for _, a, b in best):
            continue
        if edge_width(grey, u, v) > _BLURRED:
            soft = True
            continue
        best.append((likeness, u, v))
    if not best:
        soft = soft or any(_four_fields_anywhere(smaller) for smaller in _pyramid(grey))
        return _none("blurred: a marker is there, and its edges are too soft" if soft else "no marker was found")
    if len(best) > 1:
        places = "; ".join(f"{u:.0f}, {v:.0f}" for _, u, v in sorted(best, reverse=True)[:4])
        return _none(f"{len(best)} candidates look like the marker, at {places}")
    _, u, v = best[0]
    return Seen(*_refined(grey, u, v))


def _pyramid(grey: NDArray[np.uint8]) -> Iterator[NDArray[np.uint8]]:
    """The picture at half and at a quarter of its size, where soft edges are sharp again."""
    for _ in range(2):
        grey = np.asarray(cv2.pyrDown(grey), np.uint8)
        yield grey


def _four_fields_anywhere(grey: NDArray[np.uint8]) -> bool:
    corners = cv2.goodFeaturesToTrack(grey, 20, qualityLevel=0.05, minDistance=_SAME, blockSize=5)
    return corners is not None and any(_four_fields(grey, u, v) >= _ALIKE for u, v in corners.reshape(-1, 2).tolist())


def _four_fields(grey: NDArray[np.uint8], u: float, v: float) -> float:
    """How much a patch looks like four fields about its middle: 1 for a marker, 0 for anything else."""
    size = 2 * _PATCH + 1
    if not (_PATCH + 1 <= u < grey.shape[1] - _PATCH - 1 and _PATCH + 1 <= v < grey.shape[0] - _PATCH - 1):
        return 0.0
    patch = np.asarray(cv2.getRectSubPix(grey, (size, size), (u, v)), dtype=float)
    inside = np.hypot(*np.mgrid[-_PATCH : _PATCH + 1, -_PATCH : _PATCH + 1]) <= _PATCH
    low, high = np.percentile(patch[inside], [10, 90])
    if high - low < _CONTRAST:
        return 0.0
    centred = np.where(inside, patch - patch[inside].mean(), 0.0)
    power = float((centred**2).sum())
    half = float((centred * np.rot90(centred, 2)).sum()) / power
    # seen at a slant the fields are no squares, and a quarter turn inverts them only in part
    quarter = -float((centred * np.rot90(centred)).sum()) / power
    return half if quarter > 0.2 else 0.0


def edge_width(grey: NDArray[np.uint8], u: float, v: float) -> float:
    """Width of the sharpest edges near a corner, px: contrast over the steepest slope."""
    reach = 2 * _PATCH
    top, left = max(int(v) - reach, 0), max(int(u) - reach, 0)
    part = grey[top : int(v) + reach + 1, left : int(u) + reach + 1].astype(float)
    low, high = np.percentile(part, [5, 95])
    slope = np.hypot(*np.gradient(part))
    steepest = float(np.percentile(slope, 98))
    return float((high - low) / steepest) if steepest > 0 else float("inf")


def _refined(grey: NDArray[np.uint8], u: float, v: float) -> tuple[float, float, float]:
    """The centre of half-turn symmetry near ``u, v``, and its standard deviation, px.

    Four fields look the same turned by half a turn about their middle, at any slant. The centre c minimises
    Σ w (I(c + x) − I(c − x))² by Gauss–Newton; its covariance follows from the noise that the differences show. (A
    corner refined by gradients alone keeps a bias of some hundredths of a pixel from the sampling of sharp edges.)
    """
    reach = _PATCH + 6
    row, column = round(v), round(u)
    part = grey[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
    smooth = scipy.ndimage.gaussian_filter(part.astype(float), 1.0, mode="nearest")
    spline = scipy.ndimage.spline_filter(smooth, order=3)
    slope_v, slope_u = np.gradient(smooth)
    centre = np.array([v - max(row - reach, 0), u - max(column - reach, 0)])
    y, x = np.mgrid[-_PATCH : _PATCH + 1, -_PATCH : _PATCH + 1].astype(float)
    inside = (np.hypot(x, y) <= _PATCH) & ((y > 0) | ((y == 0) & (x > 0)))
    offsets = np.stack([y[inside], x[inside]])
    weight = np.exp(-(offsets**2).sum(axis=0) / (2 * (0.6 * _PATCH) ** 2))

    def at(image: Floats, places: Floats, filtered: bool) -> Floats:
        order, again = (3, False) if filtered else (1, True)
        return np.asarray(scipy.ndimage.map_coordinates(image, places, order=order, prefilter=again, mode="nearest"))

    normal, left = np.eye(2), np.zeros(len(weight))
    for _ in range(_MOST_STEPS):
        one, other = centre[:, None] + offsets, centre[:, None] - offsets
        left = at(spline, one, True) - at(spline, other, True)
        jacobian = np.stack([at(g, one, False) - at(g, other, False) for g in (slope_v, slope_u)], axis=1)
        normal = jacobian.T @ (weight[:, None] * jacobian) + 1e-9 * np.eye(2)
        step = -linalg.solve(normal, jacobian.T @ (weight * left))
        centre = centre + np.clip(step, -1.0, 1.0)
        if float(np.abs(step).max()) < 1e-4:
            break
    variance = float((weight * left**2).sum() / weight.sum())
    # blurring ties neighbours together: about this many differences say the same
    spread = linalg.inv(normal) * variance * _TIED
    place = centre + np.array([max(row - reach, 0), max(column - reach, 0)])
    return float(place[1]), float(place[0]), float(np.sqrt(max(np.trace(spread) / 2.0, 1e-8)))


def _tag(grey: NDArray[np.uint8], kind: str, identity: int | None) -> Seen:
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(DICTIONARIES[kind][1]), settings)
    corners, ids, _ = detector.detectMarkers(grey)
    numbers = [] if ids is None else np.asarray(ids).ravel().tolist()
    wanted = [k for k, number in enumerate(numbers) if identity is None or number == identity]
    if not wanted:
        others = f"; others were seen: {', '.join(map(str, numbers))}" if numbers else ""
        return _none(f"no {kind} tag{'' if identity is None else f' {identity}'} was found{others}")
    if len(wanted) > 1:
        return _none(f"{len(wanted)} candidates: tags {', '.join(str(numbers[k]) for k in wanted)}")
    four = np.asarray(corners[wanted[0]], dtype=float).reshape(4, 2)
    u, v = _crossing(four)
    if min(edge_width(grey, a, b) for a, b in four) > _BLURRED:
        return _none("blurred: a tag is there, and its edges are too soft")
    return Seen(u, v, _TAG_CORNER_PX / 2.0)


def _crossing(four: Floats) -> tuple[float, float]:
    """Where the diagonals cross: the middle of a square stays there under perspective, the mean of corners does not."""
    a, c, b, d = four[0], four[2], four[1], four[3]
    s = linalg.solve(np.stack([c - a, b - d], axis=1), b - a)[0]
    middle = a + s * (c - a)
    return float(middle[0]), float(middle[1])
