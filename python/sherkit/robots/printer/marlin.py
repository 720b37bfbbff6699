"""Marlin: what its terminal says to M503, G29 and G33, pasted into a text file.

As in ``delta.cpp``: X, Y, Z of M665 are degrees that a tower stands further round, anticlockwise seen from above; A, B,
C what its diagonal is longer than L; an end stop stands at H minus its number of M666, none of which is above zero.
M851 is where the probe is from the nozzle. G29 prints how high the bed is on a grid, row by row from the front; it does
not print where, so the command stands above with its limits, as typed: ``G29 L-100 R100 F-100 B100``. On a delta what
lies outside the circle is extrapolated, not probed. G33 prints heights at the middle, before the towers (x, y, z) and
between them, at the radius of the command: ``G33 R100``."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ...errors import MeasurementError, RobotError
from .gcode import one, words
from .klipper import text_of
from .probings import Found, Rows
from .robot import Printer
from .towers import ANGLES, Towers

_ROW = re.compile(r"^\s*(?:[A-Za-z]+:\s*)?(\d+)((?:\s+(?:[-+]\d+\.\d+|=+|nan))+)\s*$", re.IGNORECASE)
_POINT = re.compile(r"(?<![A-Za-z])(c|xy|yz|zx|x|y|z):\s*([-+]\d+\.\d+)")
#: Directions of the points of G33, degrees.
_AROUND = {"x": 210.0, "y": 330.0, "z": 90.0, "yz": 30.0, "zx": 150.0, "xy": 270.0}


def import_marlin(path: str | Path, plates: Mapping[str, float] | None = None) -> Found:
    """Reads a pasted text; the grids in it are the probings ``G29_1``, ``G29_2`` …, under which the plate was turned by
    the degrees of ``plates``.

    Raises :class:`~sherkit.errors.RobotError` for a printer that is no linear delta, and
    :class:`~sherkit.errors.MeasurementError` where no report is in it.
    """
    path = Path(path)
    lines = text_of(path, "what Marlin's terminal said, as text").splitlines()
    rows = Rows(_printer(path, lines), str(path))
    turned = dict(plates or {})
    for name, points in _reports(path, lines):
        for x, y, z in points:
            rows.touch((x, y), z, name, turned.get(name, 0.0), f"{path}: {name}:")
    found = rows.found("holds no report of G29 or G33; paste what the terminal says to 'G29 L-100 R100 F-100 B100'")
    if unknown := [name for name in turned if name not in found.robot.probings]:
        raise MeasurementError(f"{path}: has no probing '{unknown[0]}'; it has {', '.join(found.robot.probings)}")
    return found


def _printer(path: Path, lines: list[str]) -> Printer:
    found, ends, probe = (words(lines, command) for command in ("M665", "M666", "M851"))
    source = str(path)
    if not found:
        raise RobotError(f"{source}: has no M665; paste what the terminal says to M503, of a delta")
    radius, arm = one(found, "R", "M665", source), one(found, "L", "M665", source)
    arms = [arm + one(found, letter, "M665", source, 0.0) for letter in "ABC"]
    if radius <= 0 or min(arms) <= radius:
        raise RobotError(f"{source}: M665 L{min(arms):g} is not longer than R{radius:g}, above zero")
    height = one(found, "H", "M665", source)
    angle = [a + one(found, letter, "M665", source, 0.0) for a, letter in zip(ANGLES, "XYZ", strict=True)]
    stop = [height - one(ends, letter, "M666", source, 0.0) for letter in "XYZ"]
    x, y, z = (one(probe, letter, "M851", source, 0.0) for letter in "XYZ")
    return Printer.with_towers(
        Towers(radius, (angle[0], angle[1], angle[2]), (arms[0], arms[1], arms[2]), (stop[0], stop[1], stop[2])),
        target_offset_mm=(x, y, z),
        workspace_radius_mm=0.8 * radius,
        firmware="marlin",
    )


def _reports(path: Path, lines: list[str]) -> Iterator[tuple[str, list[tuple[float, float, float]]]]:
    """Names and points of every report, in their order."""
    made = {"G29": 0, "G33": 0}
    k = 0
    while k < len(lines):
        grid: list[list[float]] = []
        while k < len(lines) and (row := _ROW.match(lines[k])) and int(row[1]) == len(grid):
            grid.append([float(v) if v[0] in "+-" else np.nan for v in row[2].split()])
            k += 1
        around = dict(_POINT.findall(lines[k])) if not grid and k < len(lines) else {}
        if "c" in around or (around and k + 1 < len(lines) and "yz" in dict(_POINT.findall(lines[k + 1]))):
            k += 1
            if k < len(lines) and "yz" in (more := dict(_POINT.findall(lines[k]))):
                around |= more
            made["G33"] += 1
            yield f"G33_{made['G33']}", _ring(path, lines[:k], around)
        if len(grid) > 1:
            made["G29"] += 1
            yield f"G29_{made['G29']}", _grid(path, lines[:k], grid)
        elif not grid:
            k += 1


def _grid(path: Path, before: list[str], grid: list[list[float]]) -> list[tuple[float, float, float]]:
    if len({len(row) for row in grid}) > 1:
        raise MeasurementError(f"{path}: a G29 grid has rows of different length; paste it whole")
    sent = words(before, "G29")
    left, right, front, back = (one(sent, letter, "G29", str(path)) for letter in "LRFB")
    x, y = np.linspace(left, right, len(grid[0])), np.linspace(front, back, len(grid))
    radius = 0.5 * max(right - left, back - front) * (1 + 1e-9)
    middle = 0.5 * (left + right), 0.5 * (front + back)
    return [
        (float(x[i]), float(y[j]), z)
        for j, row in enumerate(grid)
        for i, z in enumerate(row)
        if np.isfinite(z) and np.hypot(x[i] - middle[0], y[j] - middle[1]) <= radius
    ]


def _ring(path: Path, before: list[str], heights: Mapping[str, str]) -> list[tuple[float, float, float]]:
    radius = one(words(before, "G33"), "R", "G33", str(path))
    out = [(0.0, 0.0, float(heights["c"]))] if "c" in heights else []
    for name, turn in _AROUND.items():
        if name in heights:
            at = np.deg2rad(turn)
            out.append((radius * float(np.cos(at)), radius * float(np.sin(at)), float(heights[name])))
    return out
