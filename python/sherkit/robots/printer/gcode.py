"""Numbers of G-code commands, as ``M665 R100 L220:221:220``."""

from __future__ import annotations

import re
from collections.abc import Sequence

from ...errors import RobotError

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


def one(
    found: dict[str, tuple[float, ...]], letter: str, command: str, source: str, default: float | None = None
) -> float:
    """A single number. Raises :class:`~sherkit.errors.RobotError` where it is missing."""
    if letter not in found and default is not None:
        return default
    values = found.get(letter, ())
    if len(values) != 1:
        raise RobotError(f"{source}: {command} {letter} is missing; expected a number, as in '{command} {letter}100.0'")
    return values[0]
