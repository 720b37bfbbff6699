"""A marker in a picture, to a small part of a pixel, or the reason why there is none; and markers to print.

``corner``: a disk of two black and two white quadrants, whose middle is the one corner where four fields meet. Harris'
detector proposes corners (Harris and Stephens, 1988); the one kept looks the same turned by half a turn and inverted
turned by a quarter. ``aruco`` and ``apriltag``: the middle of a tag of a dictionary.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from ..base import linalg
from ..base.types import Floats
from ..data.files import write_whole
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
class SeenMarker:
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


def _none(why: str) -> SeenMarker:
    return SeenMarker(float("nan"), float("nan"), float("nan"), why)


def find_marker(
    given: str | Path | NDArray[Any] | CameraPicture, kind: str = "corner", identity: int | None = None
) -> SeenMarker:
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


def _corner(grey: NDArray[np.uint8]) -> SeenMarker:
    proposed = cv2.goodFeaturesToTrack(
        grey, _MOST_PROPOSED, qualityLevel=0.05, minDistance=_SAME, blockSize=5, useHarrisDetector=True, k=0.04
    )
    corners = np.zeros((0, 1, 2)) if proposed is None else proposed
    if len(corners):
        corners = cv2.cornerSubPix(grey, np.asarray(corners, np.float32), _WINDOW, (-1, -1), _ENOUGH)
    best: list[tuple[float, float, float]] = []
    soft = False
    for u, v in corners.reshape(-1, 2).tolist():
        likeness = _four_fields(grey, u, v)
        if likeness < _ALIKE or any(np.hypot(u - a, v - b) < _SAME for _, a, b in best):
            continue
        if edge_width(grey, u, v) > _BLURRED:
            soft = True
            continue
        best.append((likeness, u, v))
    if not best:
        # at half and at a quarter of its size, soft edges are sharp again
        half = np.asarray(cv2.pyrDown(grey), np.uint8)
        soft = soft or _four_fields_anywhere(half) or _four_fields_anywhere(np.asarray(cv2.pyrDown(half), np.uint8))
        return _none("blurred: a marker is there, and its edges are too soft" if soft else "no marker was found")
    if len(best) > 1:
        places = "; ".join(f"{u:.0f}, {v:.0f}" for _, u, v in sorted(best, reverse=True)[:4])
        return _none(f"{len(best)} candidates look like the marker, at {places}")
    _, u, v = best[0]
    return SeenMarker(*_refined(grey, u, v))


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


def _tag(grey: NDArray[np.uint8], kind: str, identity: int | None) -> SeenMarker:
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
    if min(edge_width(grey, a, b) for a, b in four) > _BLURRED:
        return _none("blurred: a tag is there, and its edges are too soft")
    # where the diagonals cross: the middle of a square stays there under perspective, the mean of corners does not
    a, b, c, d = four
    u, v = (a + linalg.solve(np.stack([c - a, b - d], axis=1), b - a)[0] * (c - a)).tolist()
    return SeenMarker(u, v, _TAG_CORNER_PX / 2.0)


# -- markers to print, on paper in their right size -------------------------------------------------------------------

#: About as many pixels to a millimetre of paper: finer than printers are.
_PER_MM = 40.0
#: White around the marker, the bar that a ruler checks, and what stands between them, mm.
_MARGIN_MM, _BAR_MM, _LINE_MM = 8.0, 50.0, 5.0
_A4_MM = (210.0, 297.0)
_POINT_MM = 25.4 / 72.0
#: A marker larger than this does not fit on the paper.
_LARGEST_MM = 180.0


def save_marker(path: str | Path, kind: str = "corner", *, size_mm: float, identity: int = 0) -> str:
    """Writes a marker of ``size_mm`` to print: PDF (a page of A4) or PNG (with its pixels per metre), by the ending.

    ``corner`` is a disk of that diameter; ``aruco`` and ``apriltag`` are tags whose black square has that side, with
    the number ``identity`` of the dictionary that is looked for. A bar of 50 mm tells whether the printer kept the
    size. Returns what is printed, in words. Raises :class:`~sherkit.errors.SherkitError` for what cannot be printed.
    """
    path = Path(path)
    if kind not in KINDS:
        raise SherkitError(f"marker: '{kind}' is not known; choose {', '.join(KINDS)}")
    if not 0.0 < size_mm <= _LARGEST_MM:
        raise SherkitError(f"--size-mm: expected more than 0 and at most {_LARGEST_MM:g} mm, got {size_mm:g}")
    drawn, said = _drawn(kind, size_mm, identity)
    if path.suffix.lower() == ".pdf":
        write_whole(path, _pdf(drawn, size_mm, said))
    elif path.suffix.lower() == ".png":
        write_whole(path, _png(drawn, size_mm, said))
    else:
        raise SherkitError(f"{path}: expected a name that ends in .pdf or .png")
    return said


def _drawn(kind: str, size_mm: float, identity: int) -> tuple[NDArray[np.uint8], str]:
    """Black and white (side, side), and what it is in words."""
    if kind == "corner":
        side = 2 * int(np.ceil(0.5 * size_mm * _PER_MM))
        # pixels count from their middles
        off = np.arange(side) - 0.5 * (side - 1)
        inside = np.hypot(*np.meshgrid(off, off)) <= 0.5 * side
        black = inside & ((off[:, None] > 0) == (off > 0))
        return np.where(black, 0, 255).astype(np.uint8), f"corner marker, {size_mm:g} mm across"
    name, number = DICTIONARIES[kind]
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    count = len(dictionary.bytesList)
    if not 0 <= identity < count:
        raise SherkitError(f"--identity: {name} has the tags 0 to {count - 1}, got {identity}")
    # with its black border of one cell on each side; all cells of as many pixels
    cells = dictionary.markerSize + 2
    side = cells * int(np.ceil(size_mm * _PER_MM / cells))
    drawn = np.asarray(dictionary.generateImageMarker(identity, side), np.uint8)
    return drawn, f"{kind} tag {identity} of {name}, black square of {size_mm:g} mm"


def _notes(said: str) -> tuple[str, ...]:
    return (f"sherkit {said}", "print at 100 % (actual size); the bar is 50 mm long")


def _pdf(drawn: NDArray[np.uint8], size_mm: float, said: str) -> bytes:
    """A page of A4 with the marker near its top, the bar and the notes below it."""
    width, height = (side / _POINT_MM for side in _A4_MM)
    size, margin, bar, line = (v / _POINT_MM for v in (size_mm, 15.0, _BAR_MM, _LINE_MM))
    top = height - margin - size
    bits = np.packbits(drawn > 127, axis=1).tobytes()
    below = top - margin
    text = " ".join(f"({note.replace('(', chr(92) + '(').replace(')', chr(92) + ')')}) '" for note in _notes(said))
    page = (
        f"q {size:.4f} 0 0 {size:.4f} {margin:.4f} {top:.4f} cm /M Do Q\n"
        f"{margin:.4f} {below:.4f} {bar:.4f} {0.3 / _POINT_MM:.4f} re f\n"
        f"BT /F 10 Tf {line:.4f} TL {margin:.4f} {below:.4f} Td {text} ET\n"
    ).encode("ascii")
    side = len(drawn)
    packed = zlib.compress(bits, 9)
    objects = (
        b"<< /Type /Catalog /Pages 2 0 R >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.3f} {height:.3f}] /Contents 4 0 R /Resources "
        "<< /XObject << /M 5 0 R >> /Font << /F 6 0 R >> >> >>".encode("ascii"),
        f"<< /Length {len(page)} >>\nstream\n".encode("ascii") + page + b"endstream",
        f"<< /Type /XObject /Subtype /Image /Width {side} /Height {side} /ColorSpace /DeviceGray /BitsPerComponent 1 "
        f"/Filter /FlateDecode /Length {len(packed)} >>\nstream\n".encode("ascii")
        + packed
        + b"\nendstream",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    )
    out, places = b"%PDF-1.4\n", []
    for number, content in enumerate(objects, start=1):
        places.append(len(out))
        out += f"{number} 0 obj\n".encode("ascii") + content + b"\nendobj\n"
    table = "".join(f"{place:010d} 00000 n \n" for place in places)
    count = len(objects) + 1
    end = f"xref\n0 {count}\n0000000000 65535 f \n{table}trailer\n<< /Size {count} /Root 1 0 R >>\n"
    return out + f"{end}startxref\n{len(out)}\n%%EOF\n".encode("ascii")


def _png(drawn: NDArray[np.uint8], size_mm: float, said: str) -> bytes:
    """The marker with white around it, the bar and the notes, and how many of its pixels make a metre."""
    side = len(drawn)
    per_mm = side / size_mm
    margin, bar, line = (round(v * per_mm) for v in (_MARGIN_MM, _BAR_MM, _LINE_MM))
    scale = 2.5 * per_mm / 22.0  # letters of 22 pixels at scale 1
    pen = max(1, round(0.25 * per_mm))
    widths = [cv2.getTextSize(note, cv2.FONT_HERSHEY_SIMPLEX, scale, pen)[0][0] for note in _notes(said)]
    page = np.full((side + 2 * margin + 3 * line + margin // 2, 2 * margin + max(side, bar, *widths)), 255, np.uint8)
    page[margin : margin + side, margin : margin + side] = drawn
    below = 2 * margin + side
    page[below : below + pen, margin : margin + bar] = 0
    for k, note in enumerate(_notes(said), start=1):
        cv2.putText(page, note, (margin, below + k * line), cv2.FONT_HERSHEY_SIMPLEX, scale, 0, pen, cv2.LINE_AA)
    made = cv2.imencode(".png", page)[1].tobytes()
    # how many pixels make a metre stands in a chunk of its own, after the first one (PNG, second edition, 11.3.5.3)
    chunk = b"pHYs" + struct.pack(">IIB", round(1e3 * per_mm), round(1e3 * per_mm), 1)
    first = 8 + 4 + 4 + 13 + 4
    return made[:first] + struct.pack(">I", 9) + chunk + struct.pack(">I", zlib.crc32(chunk)) + made[first:]
