"""Markers to print: what :func:`~sherkit.vision.marker.find_marker` looks for, on paper in its right size."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..data.files import write_whole
from ..errors import SherkitError
from .marker import DICTIONARIES, KINDS

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
