"""Reading a TOML table key by key: every key checked, unknown keys refused with the nearest known one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from ..errors import RobotError
from ..names import closest, listed, nearest

#: Keys of a table look alike (base_radius_mm, platform_radius_mm); a misspelt one looks more alike still.
_MISSPELT = 0.75
_LARGEST = 1e100
#: Characters of a wrong value that a message repeats.
_LONGEST = 100


class Table:
    """A TOML table that remembers which of its keys were asked for.

    Raises :class:`~sherkit.errors.RobotError` naming file, table and key.
    """

    def __init__(self, values: Mapping[str, Any], where: str, path: str = "") -> None:
        self._values = values
        self._where = where
        self._path = path
        self._known: set[str] = set()

    def _name(self, key: str) -> str:
        return f"[{self._path}] {key}" if self._path else key

    def fail(self, key: str, expected: str) -> RobotError:
        """The error for a key, in words."""
        found = repr(self._values[key]) if key in self._values else "nothing"
        found = found if len(found) <= _LONGEST else f"{found[:_LONGEST]} …"
        return RobotError(f"{self._where}: {self._name(key)}: expected {expected}, found {found}")

    def _get(self, key: str, expected: str, default: Any) -> Any:
        self._known.add(key)
        if key not in self._values:
            if default is None:
                raise self._missing(key, expected)
            return default
        return self._values[key]

    def _missing(self, key: str, expected: str) -> RobotError:
        # a misspelt key is both missing and unknown: say it once, where the user typed it
        typed = closest(key, [k for k in self._values if k not in self._known], cutoff=_MISSPELT)
        hint = f"; is '{typed}' meant to be it?" if typed else ""
        return RobotError(f"{self._where}: {self._name(key)} is missing; expected {expected}{hint}")

    @contextmanager
    def table(self, key: str, *, optional: bool = False) -> Iterator[Table]:
        """A sub-table; on leaving it, unknown keys are refused."""
        values = self._get(key, "a table", {} if optional else None)
        if not isinstance(values, Mapping):
            raise self.fail(key, f"a table [{key}]")
        inner = Table(values, self._where, f"{self._path}.{key}" if self._path else key)
        yield inner
        inner.finish()

    def finish(self) -> None:
        """Refuses keys that nobody asked for."""
        for key in self._values:
            if key not in self._known:
                hint = nearest(key, self._known) or f"; known keys: {listed(sorted(self._known), 12)}"
                raise RobotError(f"{self._where}: unknown key {self._name(key)}{hint}")

    def has(self, key: str) -> bool:
        """Whether a key is given, under its very name."""
        return key in self._values

    def text(self, key: str, allowed: tuple[str, ...], default: str | None = None) -> str:
        """One of the allowed words."""
        expected = "one of " + ", ".join(f"'{a}'" for a in allowed)
        value = self._get(key, expected, default)
        if value not in allowed:
            raise self.fail(key, expected)
        return str(value)

    def number(self, key: str, default: float | None = None, *, positive: bool = False) -> float:
        """A finite number."""
        kind = "a positive number" if positive else "a number"
        value = self._get(key, kind, default)
        if not _is_number(value) or (positive and value <= 0):
            raise self.fail(key, kind)
        return float(value)

    def heights(self, key: str) -> tuple[float, float] | None:
        """Two numbers, the lower first, or None where the key is not given."""
        self._known.add(key)
        if key not in self._values:
            return None
        low, high = self.numbers(key, 2)
        if not low < high:
            raise self.fail(key, "two numbers, the lower first")
        return (low, high)

    def positive(self, key: str) -> float | None:
        """A positive number, or None where the key is not given."""
        self._known.add(key)
        return self.number(key, positive=True) if key in self._values else None

    def numbers(
        self, key: str, count: int, default: tuple[float, ...] | None = None, *, positive: bool = False
    ) -> tuple[float, ...]:
        """A list of finite numbers of a given length."""
        kind = f"{count} {'positive ' if positive else ''}numbers"
        value = self._get(key, kind, default)
        if (
            not isinstance(value, list | tuple)
            or len(value) != count
            or not all(_is_number(v) for v in value)
            or (positive and min(value) <= 0)
        ):
            raise self.fail(key, kind)
        return tuple(float(v) for v in value)


def _is_number(value: object) -> bool:
    # NaN is not below anything; Python's whole numbers have no end, floats have
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _LARGEST
