"""Robot files: TOML in, TOML out."""

from __future__ import annotations

from pathlib import Path

import tomli_w

from .delta import Delta
from .spherical import Spherical
from .table import Table, read_toml

Robot = Delta | Spherical
KINDS: dict[str, type[Delta] | type[Spherical]] = {"delta": Delta, "spherical": Spherical}


def load_robot(path: str | Path) -> Robot:
    """Reads a robot from TOML. Raises :class:`~sherkit.errors.RobotError` naming file, table and key."""
    return robot_from_tables(read_toml(path, "robot"), str(path))


def robot_from_tables(values: dict[str, object], where: str) -> Robot:
    """Reads a robot from parsed TOML tables; ``where`` names the source in errors."""
    table = Table(values, where)
    kind = table.text("kind", tuple(KINDS))
    robot = KINDS[kind].from_table(table)
    table.finish()
    return robot


def save_robot(robot: Robot, path: str | Path) -> None:
    """Writes a robot file that :func:`load_robot` reads."""
    Path(path).write_text(tomli_w.dumps(robot.to_tables()), encoding="utf-8")
