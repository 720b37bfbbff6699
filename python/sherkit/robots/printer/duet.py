"""RepRapFirmware: M665 and M666 of ``config.g`` as a robot, ``heightmap.csv`` as a run.

As in ``LinearDeltaKinematics.cpp``: X, Y, Z of M665 are degrees that tower A, B, C stands further round, anticlockwise
seen from above; L is one diagonal or three; end stops are H plus M666 X, Y, Z; M666 A and B are the tilt of the bed in
per cent: the towers' frame is at z + x·A/100 + y·B/100 where the bed's is at z. A height map (``Grid.cpp``) holds how
high the bed is at a point, 0 without a decimal where it was not probed, row by row from the lowest y."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ...base.names import brief
from ...errors import MeasurementError, RobotError
from .gcode import one, words
from .klipper import text_of
from .probings import Found, Rows
from .robot import Printer
from .towers import ANGLES, Towers

_TITLE = "RepRapFirmware height map file"


def import_duet(config: str | Path, maps: Sequence[str | Path], plates: Mapping[str, float] | None = None) -> Found:
    """Reads a ``config.g`` (or ``config-override.g``) and height maps; ``plates`` says by how many degrees the plate
    was turned under the map of that file name.

    Raises :class:`~sherkit.errors.RobotError` for a printer that is no linear delta, and
    :class:`~sherkit.errors.MeasurementError` for a file that is no height map.
    """
    path = Path(config)
    robot = _printer(path, text_of(path, "a config.g of RepRapFirmware").splitlines())
    rows = Rows(robot, str(path))
    turned = dict(plates or {})
    names = [Path(one).stem for one in maps]
    if unknown := [name for name in turned if name not in names]:
        raise MeasurementError(f"{path}: no height map '{unknown[0]}' was given")
    for each, name in zip(maps, names, strict=True):
        for x, y, z in _map(Path(each)):
            rows.touch((x, y), z, name, turned.get(name, 0.0), f"{each}:")
    return rows.found("no height map was given; probe the bed (G29) and give its heightmap.csv")


def _printer(path: Path, lines: list[str]) -> Printer:
    found, ends, probe = (words(lines, command) for command in ("M665", "M666", "G31"))
    source = str(path)
    if not found:
        raise RobotError(
            f"{source}: has no M665; only linear deltas can be imported, whose config.g has 'M665 R… L… H…'"
        )
    radius = one(found, "R", "M665", source)
    arms = found.get("L", ())
    if len(arms) == 1:
        arms *= 3
    if len(arms) != 3:
        raise RobotError(f"{source}: M665 L: expected one diagonal or three, as L220.1:220.0:219.9, found {len(arms)}")
    if radius <= 0 or min(arms) <= radius:
        raise RobotError(f"{source}: M665 L{min(arms):g} is not longer than R{radius:g}, above zero")
    height = one(found, "H", "M665", source)
    angle = [a + one(found, letter, "M665", source, 0.0) for a, letter in zip(ANGLES, "XYZ", strict=True)]
    stop = [height + one(ends, letter, "M666", source, 0.0) for letter in "XYZ"]
    x, y, z = (one(probe, letter, "G31", source, 0.0) for letter in "XYZ")
    return Printer.with_towers(
        Towers(radius, (angle[0], angle[1], angle[2]), (arms[0], arms[1], arms[2]), (stop[0], stop[1], stop[2])),
        target_offset_mm=(x, y, -z),
        workspace_radius_mm=one(found, "B", "M665", source, 0.8 * radius),
        tilt=(0.01 * one(ends, "A", "M666", source, 0.0), 0.01 * one(ends, "B", "M666", source, 0.0)),
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
