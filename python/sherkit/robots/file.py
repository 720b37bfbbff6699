"""Robot files: TOML in, TOML out."""

from __future__ import annotations

import tomllib
from pathlib import Path

import tomli_w

from ..errors import RobotError
from .delta import Delta
from .spherical import Spherical
from .table import Table

Robot = Delta | Spherical
KINDS: dict[str, type[Delta] | type[Spherical]] = {"delta": Delta, "spherical": Spherical}


def load_robot(path: str | Path) -> Robot:
    """Reads a robot from TOML. Raises :class:`~sherkit.errors.RobotError` naming file, table and key."""
    path = Path(path)
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise RobotError(f"{path}: there is no such robot file") from None
    except IsADirectoryError:
        raise RobotError(f"{path}: is a folder, expected a robot TOML file") from None
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise RobotError(f"{path}: is not a text file, expected a robot TOML file") from None
    except tomllib.TOMLDecodeError as error:
        raise RobotError(f"{path}: is not valid TOML: {error}") from None
    return robot_from_tables(values, str(path))


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
