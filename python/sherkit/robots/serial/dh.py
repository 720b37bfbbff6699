"""An arm from a table of Denavit-Hartenberg or Hayati parameters.

Standard: ``Rz(θ) Tz(d) Tx(a) Rx(α)`` behind each joint (Denavit and Hartenberg, 1955; Paul, 1981); modified:
``Rx(α) Tx(a) Rz(θ) Tz(d)`` before it (Craig, 1986); Hayati, for an axis that is nearly parallel to the one before:
``Rz(θ) Tx(a) Rx(α) Ry(β)`` (Hayati and Mirmirani, 1985), here a standard row with a β, whose d is zero.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from ...errors import RobotError
from ...names import listed, nearest
from .frames import about, as_written, frame
from .robot import MOST_JOINTS, TYPES, Joint, Serial

CONVENTIONS = ("standard", "modified")
_NEEDED = ("d_mm", "a_mm", "alpha_deg")
_KNOWN = ("name", "type", "theta_deg", *_NEEDED, "beta_deg", "low", "high")


def import_dh(path: str | Path, convention: str = "standard") -> Serial:
    """The arm of a CSV table, a row for each joint: ``d_mm``, ``a_mm``, ``alpha_deg``, and where they are not the same
    for all ``name``, ``type`` (revolute, prismatic), ``theta_deg`` (what is added to the reading), ``beta_deg``
    (Hayati), and the limits ``low`` and ``high`` (degrees, or mm of what slides).

    The target is the origin of the last frame. Raises :class:`~sherkit.errors.RobotError` with row and column.
    """
    if convention not in CONVENTIONS:
        raise RobotError(f"convention: '{convention}' is not known; choose {' or '.join(CONVENTIONS)}")
    rows = _rows(Path(path))
    folded, joints = np.eye(4), []
    for k, row in enumerate(rows, 1):
        moved = _Row(f"{path}: row {k}", row)
        own = frame((0.0, 0.0, moved.number("d_mm")), about(2, moved.angle("theta_deg")))
        link = frame(
            (moved.number("a_mm"), 0.0, 0.0), about(0, moved.angle("alpha_deg")) @ about(1, moved.angle("beta_deg"))
        )
        if convention == "modified":
            folded = folded @ link @ own
        else:
            if moved.angle("beta_deg") and moved.number("d_mm"):
                raise RobotError(f"{path}: row {k}: a row of Hayati (beta_deg) has no d_mm; put it to zero")
            folded = folded @ own
        shift, turn = as_written(folded)
        joints.append(Joint(moved.name(f"joint_{k}"), moved.type(), shift, turn, limits=moved.limits()))
        folded = np.eye(4) if convention == "modified" else link
    shift, turn = as_written(folded)
    return Serial(tuple(joints), shift, turn)


class _Row:
    """A row of the table, every cell checked when it is asked for."""

    def __init__(self, where: str, cells: dict[str, str]) -> None:
        self.where, self.cells = where, cells

    def number(self, column: str) -> float:
        """Zero where the table has no such column, or no such cell."""
        text = self.cells.get(column, "").strip()
        try:
            value = float(text) if text else 0.0
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise RobotError(f"{self.where}: {column}: expected a number, found '{text}'")
        return value

    def angle(self, column: str) -> float:
        """In rad."""
        return math.radians(self.number(column))

    def name(self, otherwise: str) -> str:
        """The name of its joint."""
        return self.cells.get("name", "").strip() or otherwise

    def type(self) -> str:
        """Revolute unless it says otherwise."""
        found = self.cells.get("type", "").strip() or TYPES[0]
        if found not in TYPES:
            raise RobotError(f"{self.where}: type: expected {' or '.join(TYPES)}, found '{found}'")
        return found

    def limits(self) -> tuple[float, float] | None:
        """None where the row names none."""
        if not (self.cells.get("low", "").strip() and self.cells.get("high", "").strip()):
            return None
        low, high = self.number("low"), self.number("high")
        if not low < high:
            raise RobotError(f"{self.where}: low: expected less than high, found {low:g} and {high:g}")
        return low, high


def _rows(path: Path) -> list[dict[str, str]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, restval="", skipinitialspace=True)
            names = [name.strip() for name in reader.fieldnames or ()]
            rows = []
            for k, row in enumerate(reader, 1):
                if None in row:
                    raise RobotError(f"{path}: row {k} has more cells than there are columns; a comma for a point?")
                rows.append({name: row[own] or "" for name, own in zip(names, reader.fieldnames or (), strict=True)})
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise RobotError(f"{path}: is no CSV table: {error}") from None
    for name in names:
        if name not in _KNOWN:
            raise RobotError(
                f"{path}: column '{name}' is not known{nearest(name, _KNOWN)}; there are {listed(_KNOWN, 12)}"
            )
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise RobotError(f"{path}: column '{twice[0]}' is there twice")
    if lacking := [name for name in _NEEDED if name not in names]:
        raise RobotError(f"{path}: column {listed(lacking)} is missing")
    if not 1 <= len(rows) <= MOST_JOINTS:
        raise RobotError(f"{path}: expected one to {MOST_JOINTS} rows, one for each joint, found {len(rows)}")
    return rows
