"""What a file is, by looking at it and by the ending of its name: what a verb may replace, and what it may not."""

from __future__ import annotations

import csv
import json
import os
import re
import tomllib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

#: So much of a file tells what it is; what has to be read as a whole is not longer than the other.
_HEAD, _WHOLE = 1 << 16, 1 << 24
_SQLITE = b"SQLite format 3\x00"
#: So many rows tell whether a text is a table.
_ROWS = 20
#: The first line of the planted errors of ``sherkit simulate --truth``, whose tables are each kind's own.
PLANTED_BY = "# The errors that sherkit simulate planted\n"


class FileContent:
    """What stands in a file, as far as it is asked for. One that cannot be read is of no kind."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def _first(self, most: int) -> bytes:
        with suppress(OSError, ValueError), self.path.open("rb") as file:
            return file.read(most)
        return b""

    @cached_property
    def head(self) -> bytes:
        """Its first bytes."""
        return self._first(_HEAD)

    @cached_property
    def begin(self) -> str:
        """Its first letters; what is no text is not shown."""
        return self.head.decode("utf-8-sig", "replace")

    @cached_property
    def text(self) -> str:
        """All of it as text; empty where it is none."""
        with suppress(UnicodeDecodeError):
            return self._first(_WHOLE).decode("utf-8-sig")
        return ""

    @cached_property
    def toml(self) -> dict[str, Any]:
        """Its tables; empty where it is no TOML."""
        with suppress(ValueError, RecursionError):
            return tomllib.loads(self.text)
        return {}

    @cached_property
    def json(self) -> Any:
        """What it holds as JSON; None where it is none."""
        with suppress(ValueError, RecursionError):
            return json.loads(self.text)
        return None


@dataclass(frozen=True)
class FileKind:
    """A sort of file that verbs write: what it is called, the endings of its names, and what one looks like."""

    called: str
    endings: tuple[str, ...]
    holds: Callable[[FileContent], bool]
    #: Whether a file of this kind is written under these endings alone, also where nothing stands there.
    only: bool = False

    def replaces(self, look: FileContent) -> bool:
        """Whether a file that is there may be replaced by one of this kind: it holds nothing, or is one by its name and
        by what is in it."""
        ending = look.path.suffix.lower()
        of_others = ending in _ENDINGS and ending not in self.endings
        return not look.head or (not of_others and self.holds(look))


# -- What they look like ---------------------------------------------------------------------------------------------


def _is_table(look: FileContent) -> bool:
    """Parquet, or rows that all have as many cells as the first."""
    if look.head[:4] == b"PAR1":
        return True
    whole = look.begin if len(look.head) < _HEAD else look.begin.rpartition("\n")[0]
    lines = [line for line in whole.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines or "\0" in whole or lines[0].lstrip()[:1] in "<{[":
        return False
    separator = max(",;\t", key=lines[0].count)
    try:
        cells = [len(row) for row in islice(csv.reader(lines, delimiter=separator), _ROWS)]
    except csv.Error:
        return False
    return cells[0] > 1 and {*cells} == {cells[0]} and (len(cells) > 1 or look.path.suffix.lower() in TABLE.endings)


def _is_page(look: FileContent) -> bool:
    return look.begin.lstrip().lower().startswith(("<!doctype html", "<html"))


def _is_svg(look: FileContent) -> bool:
    begin = look.begin.lstrip()
    return begin.startswith("<svg") or (begin.startswith("<?xml") and "<svg" in begin)


def _is_picture(look: FileContent) -> bool:
    return _is_page(look) or _is_svg(look) or _is_png(look)


def _is_png(look: FileContent) -> bool:
    return look.head.startswith(b"\x89PNG")


def _is_robot(look: FileContent) -> bool:
    return isinstance(look.toml.get("kind"), str) and not CALIBRATION.holds(look) and not TOOL.holds(look)


def _is_ports(look: FileContent) -> bool:
    ports = look.json
    return isinstance(ports, dict) and all(isinstance(one, dict) and "address" in one for one in ports.values())


def _is_results(look: FileContent) -> bool:
    """The lines of a study of simulated robots: what it is about stands in the first."""
    with suppress(ValueError, RecursionError):
        first = json.loads(look.text.partition("\n")[0])
        return isinstance(first, dict) and isinstance(first.get("study"), str)
    return False


def _is_study(look: FileContent) -> bool:
    return isinstance(look.json, dict) and isinstance(look.json.get("format"), int)


def _is_begun_from(look: FileContent) -> bool:
    return isinstance(look.json, dict) and {"robot", "run", "run_bytes"} <= {*look.json}


def _is_klipper(look: FileContent) -> bool:
    return bool(re.search(r"^\[printer\]", look.text, re.M) and re.search(r"^\[stepper_a\]", look.text, re.M))


def _is_commands(look: FileContent) -> bool:
    lines = [line for line in look.text.splitlines() if line.strip()]
    return bool(lines) and all(re.match(r"M(665|666|500)\b", line) for line in lines)


def _is_urdf(look: FileContent) -> bool:
    """One robot in XML, a xacro too."""
    return bool(re.match(r"\s*(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*<robot\b", look.begin, re.S))


def _is_kinematics(look: FileContent) -> bool:
    return bool(re.search(r"^kinematics:\s*$", look.begin, re.M))


def _is_compensation(look: FileContent) -> bool:
    """Lines of three numbers each, and nothing else."""
    try:
        return bool(look.text.strip()) and all(len([*map(float, one.split())]) == 3 for one in look.text.splitlines())
    except ValueError:
        return False


def _is_run(look: FileContent) -> bool:
    return look.head.startswith(_SQLITE)


# -- The kinds -------------------------------------------------------------------------------------------------------

TABLE = FileKind("a table", (".csv", ".tsv", ".parquet", ".pq", ".txt", ".dat"), _is_table)
CALIBRATION = FileKind("a calibration", (".toml",), lambda look: isinstance(look.toml.get("calibration"), dict))
TOOL = FileKind("a tool file", (".toml",), lambda look: look.toml.get("kind") == "flexible_tool")
ROBOT = FileKind("a robot file", (".toml",), _is_robot)
#: What people write: no verb does but the two demos, into a folder of their own.
PLANNED = FileKind(
    "the file of an experiment or a laboratory", (".toml",), lambda look: isinstance(look.toml.get("robot"), str)
)
CAMERA = FileKind("the table of a camera", (".toml",), lambda look: {*look.toml} == {"camera"})
PLANTED = FileKind("planted errors", (".toml",), lambda look: look.begin.startswith(PLANTED_BY))
PAGE = FileKind("a page", (".html",), _is_page, only=True)
PICTURE = FileKind("a picture", (".html", ".png", ".svg"), _is_picture, only=True)
DRAWN = FileKind("a picture", (".html", ".svg"), _is_picture, only=True)
PRINTED = FileKind("a marker", (".pdf", ".png"), lambda look: look.head.startswith(b"%PDF") or _is_png(look), only=True)
TEMPLATE = FileKind("an effect", (".py",), lambda look: "Written by `sherkit diagnose`" in look.begin)
HEADER = FileKind("a C header", (".h", ".hh", ".hpp"), lambda look: "written by `sherkit export c`" in look.begin)
KLIPPER = FileKind("a configuration of Klipper", (".cfg", ".conf"), _is_klipper)
COMMANDS = FileKind("commands for a firmware", (".g", ".gcode", ".txt"), _is_commands)
URDF = FileKind("a URDF", (".urdf", ".xacro", ".xml"), _is_urdf)
KINEMATICS = FileKind("kinematics of an arm", (".yaml", ".yml"), _is_kinematics)
COMPENSATION = FileKind("compensation of an axis", (".comp",), _is_compensation)
PORTS = FileKind("addresses of instruments", (".json",), _is_ports)
RESULTS = FileKind("results of simulated robots", (".jsonl", ".json"), _is_results)
RUN = FileKind("a run file", (".sqlite", ".sqlite3", ".db"), _is_run)
STUDY = FileKind("a study", (".json",), _is_study)
BEGUN_FROM = FileKind("the sources of a study", (".json",), _is_begun_from)
#: Lines of a person's own: where there is a study they are those that were typed into its page.
TYPED = FileKind("lines of Python", (".py",), lambda look: look.path.with_name("study.json").exists())

KINDS = (
    RUN, TABLE, CALIBRATION, TOOL, ROBOT, PLANNED, CAMERA, PLANTED, PAGE, PICTURE, PRINTED, TEMPLATE, HEADER,
    KLIPPER, COMMANDS, URDF, KINEMATICS, COMPENSATION, PORTS, RESULTS, BEGUN_FROM, STUDY,
)  # fmt: skip
_ENDINGS = {ending for kind in KINDS for ending in kind.endings}


def called(look: FileContent) -> str:
    """What a file is, in words."""
    return next((kind.called for kind in KINDS if kind.holds(look)), "a file of another kind")


def run_file_of(path: Path) -> Path | None:
    """The run file that a path is, or beside which SQLite and its runner keep it; None where it is none.

    Its newest rows may stand beside it and nowhere else: a run whose program was killed is not whole without them.
    """
    real = Path(os.path.realpath(path))
    for end in ("-wal", "-shm", "-journal", ".lock"):
        of = real.with_name(real.name.removesuffix(end) or real.name)
        if of != real and (_is_run(FileContent(of)) or (end != ".lock" and os.path.isfile(of))):
            return of
    newest = any(os.path.exists(f"{real}{end}") for end in ("-wal", "-journal"))
    return real if _is_run(FileContent(real)) or (newest and os.path.isfile(real)) else None
