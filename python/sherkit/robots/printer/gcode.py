"""Firmwares that are set by G-code commands, as ``M665 R100 L220:221:220``: RepRapFirmware and Marlin.

Of RepRapFirmware M665 and M666 of ``config.g`` as a robot, ``heightmap.csv`` as a run, as in
``LinearDeltaKinematics.cpp``: X, Y, Z of M665 are degrees that tower A, B, C stands further round, anticlockwise seen
from above; L is one diagonal or three; end stops are H plus M666 X, Y, Z; M666 A and B are the tilt of the bed in per
cent: the towers' frame is at z + x·A/100 + y·B/100 where the bed's is at z. A height map (``Grid.cpp``) holds how high
the bed is at a point, 0 without a decimal where it was not probed, row by row from the lowest y.

Of Marlin what its terminal says to M503, G29 and G33, pasted into a text file, as in ``delta.cpp``: X, Y, Z of M665 are
degrees that a tower stands further round, anticlockwise seen from above; A, B, C what its diagonal is longer than L; an
end stop stands at H minus its number of M666, none of which is above zero. M851 is where the probe is from the nozzle.
G29 prints how high the bed is on a grid, row by row from the front; it does not print where, so the command stands
above with its limits, as typed: ``G29 L-100 R100 F-100 B100``. On a delta what lies outside the circle is extrapolated,
not probed. G33 prints heights at the middle, before the towers (x, y, z) and between them, at the radius of the
command: ``G33 R100``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from ...base.figures import brief
from ...errors import MeasurementError, RobotError
from .klipper import text_of
from .robot import ANGLES, ImportedPrinter, Printer, ProbedRows, Towers, triple

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
_WORD = re.compile(rf"([A-Z])\s*({_NUMBER}(?:\s*:\s*{_NUMBER})*)", re.IGNORECASE)


def words(lines: Sequence[str], command: str) -> dict[str, tuple[float, ...]]:
    """Every word that a command was given, the last time each was; comments and what a terminal puts before are left
    out."""
    out: dict[str, tuple[float, ...]] = {}
    begins = re.compile(rf"(?:^|[\s>:])({command})(?=\s|$)", re.IGNORECASE)
    for line in lines:
        body = line.split(";", 1)[0]
        found = begins.search(body)
        if found:
            for letter, text in _WORD.findall(body[found.end(1) :]):
                out[letter.upper()] = tuple(float(v) for v in text.split(":"))
    return out


class _Command:
    """What a command was given in the lines of a file."""

    def __init__(self, path: Path, lines: Sequence[str], name: str) -> None:
        self.path, self.name, self.words = path, name, words(lines, name)

    def one(self, letter: str, default: float | None = None) -> float:
        """A single number. Raises :class:`~sherkit.errors.RobotError` where it is missing."""
        if letter not in self.words and default is not None:
            return default
        values = self.words.get(letter, ())
        if len(values) != 1:
            raise RobotError(
                f"{self.path}: {self.name} {letter} is missing; expected a number, as in '{self.name} {letter}100.0'"
            )
        return values[0]

    def each(self, letters: str, default: float | None = 0.0) -> list[float]:
        """The numbers of several letters, zero where nothing is said."""
        return [self.one(letter, default) for letter in letters]


def _towers(geometry: _Command, ends: _Command, radius: float, arms: Sequence[float], sign: float) -> Towers:
    """The towers with these diagonals; an end stop stands at H and ``sign`` times its number of M666."""
    if radius <= 0 or min(arms) <= radius:
        raise RobotError(f"{geometry.path}: M665 L{min(arms):g} is not longer than R{radius:g}, above zero")
    stop = geometry.one("H") + sign * np.array(ends.each("XYZ"))
    return Towers(radius, triple(np.array(ANGLES) + geometry.each("XYZ")), triple(arms), triple(stop))


# -- RepRapFirmware -----------------------------------------------------------------------------------------------

_TITLE = "RepRapFirmware height map file"


def import_duet(
    config: str | Path, maps: Sequence[str | Path], plates: Mapping[str, float] | None = None
) -> ImportedPrinter:
    """Reads a ``config.g`` (or ``config-override.g``) and height maps; ``plates`` says by how many degrees the plate
    was turned under the map of that file name.

    Raises :class:`~sherkit.errors.RobotError` for a printer that is no linear delta, and
    :class:`~sherkit.errors.MeasurementError` for a file that is no height map.
    """
    path = Path(config)
    robot = _duet(path, text_of(path, "a config.g of RepRapFirmware").splitlines())
    rows = ProbedRows(robot, str(path))
    turned = dict(plates or {})
    names = [Path(one).stem for one in maps]
    if unknown := [name for name in turned if name not in names]:
        raise MeasurementError(f"{path}: no height map '{unknown[0]}' was given")
    for each, name in zip(maps, names, strict=True):
        for x, y, z in _map(Path(each)):
            rows.touch((x, y), z, name, turned.get(name, 0.0), f"{each}:")
    return rows.found("no height map was given; probe the bed (G29) and give its heightmap.csv")


def _duet(path: Path, lines: list[str]) -> Printer:
    found, ends, probe = (_Command(path, lines, name) for name in ("M665", "M666", "G31"))
    if not found.words:
        raise RobotError(f"{path}: has no M665; only linear deltas can be imported, whose config.g has 'M665 R… L… H…'")
    radius, arms = found.one("R"), found.words.get("L", ())
    arms *= 3 if len(arms) == 1 else 1
    if len(arms) != 3:
        raise RobotError(f"{path}: M665 L: expected one diagonal or three, as L220.1:220.0:219.9, found {len(arms)}")
    towers = _towers(found, ends, radius, arms, 1.0)
    x, y, z = probe.each("XYZ")
    return Printer.with_towers(
        towers,
        target_offset_mm=(x, y, -z),
        workspace_radius_mm=found.one("B", 0.8 * radius),
        tilt=(0.01 * ends.one("A", 0.0), 0.01 * ends.one("B", 0.0)),
        firmware="reprapfirmware",
    )


def _map(path: Path) -> list[tuple[float, float, float]]:
    lines = [line for line in text_of(path, "a heightmap.csv").splitlines() if line.strip()]
    if len(lines) < 4 or _TITLE not in lines[0]:
        raise MeasurementError(f"{path}: is no height map; expected '{_TITLE} …' in its first line")
    labels, values = ([part.strip() for part in line.split(",")] for line in lines[1:3])
    named = dict(zip(labels, values, strict=False))

    def of(*names: str) -> float:
        text = next((named[name] for name in names if name in named), "")
        found = _number(text)
        if found is None:
            raise MeasurementError(f"{path}: line 3: expected a number for {names[0]}, found '{text[:40]}'")
        return found

    low = of("min0", "xmin"), of("min1", "ymin")
    step = of("spacing0", "xspacing", "spacing"), of("spacing1", "yspacing", "spacing")
    counts = int(of("num0", "xnum", "num_x")), int(of("num1", "ynum", "num_y"))
    out = []
    for j, line in enumerate(lines[3:]):
        cells = [cell.strip() for cell in line.split(",") if cell.strip()]
        if len(cells) != counts[0] or j >= counts[1]:
            raise MeasurementError(f"{path}: line {j + 4}: expected {counts[1]} rows of {counts[0]} heights")
        for i, cell in enumerate(cells):
            if cell in ("0", "*"):
                continue
            height = _number(cell)
            if height is None:
                raise MeasurementError(f"{path}: line {j + 4}: expected a height, found '{brief(cell)}'")
            out.append((low[0] + i * step[0], low[1] + j * step[1], height))
    return out


def _number(cell: str) -> float | None:
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


# -- Marlin -------------------------------------------------------------------------------------------------------

_ROW = re.compile(r"^\s*(?:[A-Za-z]+:\s*)?(\d+)((?:\s+(?:[-+]\d+\.\d+|=+|nan))+)\s*$", re.IGNORECASE)
_POINT = re.compile(r"(?<![A-Za-z])(c|xy|yz|zx|x|y|z):\s*([-+]\d+\.\d+)")
#: Directions of the points of G33, degrees.
_AROUND = {"x": 210.0, "y": 330.0, "z": 90.0, "yz": 30.0, "zx": 150.0, "xy": 270.0}


def import_marlin(path: str | Path, plates: Mapping[str, float] | None = None) -> ImportedPrinter:
    """Reads a pasted text; the grids in it are the probings ``G29_1``, ``G29_2`` …, under which the plate was turned by
    the degrees of ``plates``.

    Raises :class:`~sherkit.errors.RobotError` for a printer that is no linear delta, and
    :class:`~sherkit.errors.MeasurementError` where no report is in it.
    """
    path = Path(path)
    lines = text_of(path, "what Marlin's terminal said, as text").splitlines()
    rows = ProbedRows(_marlin(path, lines), str(path))
    turned = dict(plates or {})
    for name, points in _reports(path, lines):
        for x, y, z in points:
            rows.touch((x, y), z, name, turned.get(name, 0.0), f"{path}: {name}:")
    found = rows.found("holds no report of G29 or G33; paste what the terminal says to 'G29 L-100 R100 F-100 B100'")
    if unknown := [name for name in turned if name not in found.robot.probings]:
        raise MeasurementError(f"{path}: has no probing '{unknown[0]}'; it has {', '.join(found.robot.probings)}")
    return found


def _marlin(path: Path, lines: list[str]) -> Printer:
    found, ends, probe = (_Command(path, lines, name) for name in ("M665", "M666", "M851"))
    if not found.words:
        raise RobotError(f"{path}: has no M665; paste what the terminal says to M503, of a delta")
    radius, arm = found.one("R"), found.one("L")
    towers = _towers(found, ends, radius, [arm + more for more in found.each("ABC")], -1.0)
    return Printer.with_towers(
        towers, target_offset_mm=triple(probe.each("XYZ")), workspace_radius_mm=0.8 * radius, firmware="marlin"
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
    left, right, front, back = _Command(path, before, "G29").each("LRFB", None)
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
    sent = _Command(path, before, "G33")
    if "R" not in sent.words:
        raise RobotError(
            f"{path}: the report of G33 does not say how far from the middle it probed, which is what Marlin was built "
            "with (DELTA_PRINTABLE_RADIUS); write that behind the command in this file, as in 'G33 R100 V2', or probe "
            "again with such a command"
        )
    radius = sent.one("R")
    out = [(0.0, 0.0, float(heights["c"]))] if "c" in heights else []
    for name, turn in _AROUND.items():
        if name in heights:
            at = np.deg2rad(turn)
            out.append((radius * float(np.cos(at)), radius * float(np.sin(at)), float(heights[name])))
    return out
