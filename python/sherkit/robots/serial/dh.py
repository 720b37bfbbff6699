"""An arm from a table of Denavit-Hartenberg or Hayati parameters.

Standard: ``Rz(θ) Tz(d) Tx(a) Rx(α)`` behind each joint (Denavit and Hartenberg, 1955; Paul, 1981); modified:
``Rx(α) Tx(a) Rz(θ) Tz(d)`` before it (Craig, 1986); Hayati, for an axis that is nearly parallel to the one before:
``Rz(θ) Tx(a) Rx(α) Ry(β)`` (Hayati and Mirmirani, 1985), here a standard row with a β, whose d is zero.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...base.names import brief, listed, nearest
from ...base.types import Floats
from ...errors import RobotError
from .frames import Triple, about, as_written, frame, of_rpy
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


def read_in_the_other_convention(arm: Serial) -> Iterator[tuple[str, str, Serial]]:
    """The arms that a table gives which was read in the other convention, where the arm may come from a table: with the
    part of each row that moves with the joint on the wrong side of it."""
    rows = [_row_of(frame(joint.origin_mm, of_rpy(_rad(joint.rpy_deg)))) for joint in arm.joints]
    if any(row is None for row in rows):
        return
    links, own = zip(*(row for row in rows if row is not None), strict=True)
    end, nothing = frame(arm.target_mm, of_rpy(_rad(arm.tool_rpy_deg))), np.eye(4)
    # read as standard, a link stands behind its joint, as modified before it; a target of one's own hides the last
    last = end if _is_link(end) else frame((0.0, 0.0, 0.0), end[:3, :3])
    if _is_link(last):
        rest = nothing if _is_link(end) else frame(arm.target_mm, nothing[:3, :3])
        yield _read_as("standard", "modified", arm, (*links[1:], last), own, rest)
    yield _read_as("modified", "standard", arm, (nothing, *links[:-1]), own, links[-1] @ end)


def _read_as(
    read: str, meant: str, arm: Serial, links: Sequence[Floats], own: Sequence[Floats], end: Floats
) -> tuple[str, str, Serial]:
    made = [as_written(link @ moved) for link, moved in zip(links, own, strict=True)]
    joints = [replace(one, origin_mm=shift, rpy_deg=turn) for one, (shift, turn) in zip(arm.joints, made, strict=True)]
    target, tool = as_written(end)
    looks = f"the table of Denavit and Hartenberg behind the robot file looks {meant}, and was read as {read}"
    other = replace(arm, joints=tuple(joints), target_mm=target, tool_rpy_deg=tool)
    return looks, f"import it with the convention {meant}", other


def _rad(degrees: Triple) -> list[float]:
    return [math.radians(value) for value in degrees]


def _is_link(made: Floats) -> bool:
    """Whether a transform is ``Tx(a) Rx(α)``."""
    row = _row_of(made)
    return row is not None and np.allclose(row[1], np.eye(4), atol=1e-6)


def _row_of(made: Floats) -> tuple[Floats, Floats] | None:
    """The two parts of ``Tx(a) Rx(α) Tz(d) Rz(θ)``; None for a transform that is no such product."""
    alpha, theta = np.arctan2(-made[1, 2], made[2, 2]), np.arctan2(-made[0, 1], made[0, 0])
    link = frame((made[0, 3], 0.0, 0.0), about(0, alpha))
    along = float(np.cos(alpha) * made[2, 3] - np.sin(alpha) * made[1, 3])
    own = frame((0.0, 0.0, along), about(2, theta))
    return (link, own) if np.allclose(link @ own, made, atol=1e-6) else None


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
            raise RobotError(f"{self.where}: {column}: expected a number, found '{brief(text)}'")
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
