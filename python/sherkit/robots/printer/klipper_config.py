"""Klipper's configuration files: sections and options, included files, the block that SAVE_CONFIG writes.

As in ``klippy/configfile.py``: an option above the SAVE_CONFIG block holds against the same one in it (SAVE_CONFIG
itself turns what it replaces into comments), and a block with other lines behind it is not read."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from ...base.names import brief, listed
from ...base.types import Floats
from ...errors import RobotError

#: What begins each line of the block, and what stands in its first one.
SAVED = "#*#"
_HEADER = re.compile(r"#\*# <-+ SAVE_CONFIG -+>")
_COMMENT = re.compile(r"#.*|(^|\s);.*")
_MOST_FILES = 200


class KlipperConfig:
    """Sections and options of a ``printer.cfg`` and what it includes. Raises :class:`~sherkit.errors.RobotError`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        #: Included files that are not there.
        self.absent: list[str] = []
        self._values: dict[tuple[str, str], str] = {}
        self._files = 0
        lines = text_of(path, "a Klipper printer.cfg").splitlines()
        self._read(path, self._saved(lines))
        self._read(path, [line for line in lines if not line.startswith(SAVED)])

    def _saved(self, lines: list[str]) -> list[str]:
        starts = [k for k, line in enumerate(lines) if _HEADER.match(line)]
        behind = lines[starts[0] :] if starts else []
        other = next((line for line in behind if line.strip() and not line.startswith(SAVED)), None)
        if other is not None:
            raise RobotError(
                f"{self.path}: '{other.strip()[:40]}' stands behind the SAVE_CONFIG block, which Klipper then does not "
                "read; move it above the block"
            )
        return [line[len(SAVED) :].removeprefix(" ") for line in lines if line.startswith(SAVED)]

    def _read(self, path: Path, lines: list[str]) -> None:
        section, key = "", ""
        for line in lines:
            body = _COMMENT.sub("", line).rstrip()
            if not body.strip():
                continue
            if body.startswith("["):
                section, key = body.strip("[] \t"), ""
                if section.startswith("include "):
                    self._include(path.parent, section.removeprefix("include ").strip())
                    section = ""
            elif body[0] in " \t" and key:
                self._values[section, key] += "\n" + body.strip()
            else:
                ends = [i for i in (body.find(":"), body.find("=")) if i >= 0]
                if ends and section:
                    key = body[: min(ends)].strip().lower()
                    self._values[section, key] = body[min(ends) + 1 :].strip()

    def _include(self, folder: Path, pattern: str) -> None:
        # as Klipper does; what is not there may say nothing of the machine's measures, so only a missing option
        # complains
        try:
            found = sorted(folder.glob(pattern)) if not Path(pattern).is_absolute() else [Path(pattern)]
        except (ValueError, NotImplementedError, OSError):
            found = []
        found = [one for one in found if one.is_file()]
        if not found and not set("*?[") & set(pattern):
            self.absent.append(pattern)
        for one in found:
            self._files += 1
            if self._files > _MOST_FILES:
                raise RobotError(f"{self.path}: includes more than {_MOST_FILES} files; does one include itself?")
            self._read(one, text_of(one, "a Klipper configuration").splitlines())

    # -- asking --------------------------------------------------------------------------------------------

    def get(self, section: str, key: str) -> str | None:
        """The text of an option; None where it is not there."""
        return self._values.get((section, key))

    def sections(self, stem: str) -> list[str]:
        """Names of the sections ``[stem NAME]``, as they come."""
        return list(dict.fromkeys(s.removeprefix(f"{stem} ") for s, _ in self._values if s.startswith(f"{stem} ")))

    def numbered(self, section: str, stem: str) -> list[int]:
        """The numbers of the options ``stem0``, ``stem1``, …"""
        found = [k[len(stem) :] for s, k in self._values if s == section and k.startswith(stem)]
        return sorted(int(k) for k in found if k.isdecimal())

    def gear_ratio(self, section: str) -> float:
        """``80:16, 2:1`` as turns of the motor per turn of the belt's pulley; 1 where nothing is said."""
        text = self.get(section, "gear_ratio")
        try:
            pairs = [gear.split(":") for gear in text.split(",")] if text else []
            return math.prod(float(a) / float(b) for a, b in pairs)
        except (ValueError, ZeroDivisionError):
            raise RobotError(
                f"{self.path}: [{section}] gear_ratio: expected pairs like 80:16, found '{brief(text)}'"
            ) from None

    def number(self, section: str, key: str, default: float | None = None) -> float:
        """A number."""
        return float(self.numbers(section, key, 1, None if default is None else (default,))[0])

    def numbers(self, section: str, key: str, count: int, default: tuple[float, ...] | None = None) -> Floats:
        """So many numbers, separated by commas."""
        text = self.get(section, key)
        if text is None:
            if default is None:
                where = f" ({listed(self.absent)}, which it includes, is not there)" if self.absent else ""
                raise RobotError(f"{self.path}: [{section}] {key} is missing; expected {count} number(s){where}")
            return np.array(default)
        try:
            values = np.array([float(v) for v in text.split(",")])
        except ValueError:
            values = np.array([])
        if len(values) != count or not np.isfinite(values).all():
            raise RobotError(f"{self.path}: [{section}] {key}: expected {count} number(s), found '{brief(text)}'")
        return values


def text_of(path: Path, expected: str) -> str:
    """The text of a file, which was ``expected`` to be something. Raises :class:`~sherkit.errors.RobotError`."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise RobotError(f"{path}: is not a text file, expected {expected}") from None
