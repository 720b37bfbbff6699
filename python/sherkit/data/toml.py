"""Reading a TOML table key by key: every key checked, unknown keys refused with the nearest known one.

Robot files are read with it, calibrations, and the files of laboratories and experiments.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..base import linalg
from ..base.names import brief, closest, listed, nearest
from ..base.types import Floats
from ..errors import RobotError, SherkitError

#: Keys of a table look alike (base_radius_mm, platform_radius_mm); a misspelt one looks more alike still.
_MISSPELT = 0.75
#: What a number of a machine can be in size, in whatever unit, and least where it is not zero; what an array holds.
_LARGEST, _SMALLEST, _LARGEST_OF_ARRAY = 1e15, 1e-30, 1e100
#: Characters of a wrong value, and of the path of a file, that a message repeats.
_LONGEST, _LONGEST_PATH = 100, 500


def read_toml(path: str | Path, what: str, error: type[SherkitError] = RobotError) -> dict[str, Any]:
    """The tables of a TOML file; ``what`` it should be, for messages. Raises ``error`` where it cannot be read."""
    path = Path(path)
    if other := _OTHER.get(path.suffix.lower()):
        raise error(f"{path}: expected a {what} TOML file; {other}")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise error(f"{brief(path, _LONGEST_PATH)}: there is no such {what} file") from None
    except IsADirectoryError:
        raise error(f"{path}: is a folder, expected a {what} TOML file") from None
    except OSError as wrong:
        raise error(f"{path}: cannot be read: {wrong.strerror}") from None
    except UnicodeDecodeError:
        raise error(f"{path}: is not a text file, expected a {what} TOML file") from None
    except tomllib.TOMLDecodeError as wrong:
        raise error(f"{path}: is not valid TOML: {wrong}") from None
    except RecursionError:
        raise error(f"{path}: is not valid TOML: lists in lists without end") from None
    except ValueError:
        raise error(f"{str(path)!r} is no name of a {what} file") from None


#: What stands in the place of a TOML file by its ending, and where it belongs.
_OTHER = {
    ".csv": "the robot stands before the run, as in: sherkit diagnose ROBOT RUN",
    ".parquet": "the robot stands before the run, as in: sherkit diagnose ROBOT RUN",
    ".cfg": "that of a printer is for sherkit printer",
    ".urdf": "sherkit import urdf makes one of it",
    ".xacro": "let the xacro write its URDF, then sherkit import urdf",
}
#: A JSON schema, as far as editors need one.
Schema = dict[str, Any]
_NUMBER: Schema = {"type": "number"}
_POSITIVE: Schema = {"type": "number", "exclusiveMinimum": 0}


def _list(items: Schema, count: int | None = None) -> Schema:
    return {"type": "array", "items": items} | ({} if count is None else {"minItems": count, "maxItems": count})


class Table:
    """A TOML table that remembers which of its keys were asked for.

    Raises ``error``, a :class:`~sherkit.errors.RobotError` unless another kind is given, naming file, table and key.
    """

    def __init__(
        self, values: Mapping[str, Any], where: str, path: str = "", error: type[SherkitError] = RobotError
    ) -> None:
        self._values = values
        self._where = where
        self._path = path
        self._error = error
        self._known: set[str] = set()

    def _name(self, key: str) -> str:
        return f"[{self._path}] {brief(key)}" if self._path else brief(key)

    def fail(self, key: str, expected: str) -> SherkitError:
        """The error for a key, in words."""
        found = repr(self._values[key]) if key in self._values else "nothing"
        if _is_beyond(self._values.get(key)):
            expected += f", of a size from {_SMALLEST:g} to {_LARGEST:g}"
        return self._error(f"{self._where}: {self._name(key)}: expected {expected}, found {brief(found, _LONGEST)}")

    def refuse(self, what: str) -> SherkitError:
        """The error for numbers that do not fit together, in words."""
        return self._error(f"{self._where}: [{self._path}] {what}")

    @property
    def values(self) -> Mapping[str, Any]:
        """What is in it, as it was given."""
        return self._values

    def _get(
        self, key: str, expected: str, default: Any, schema: Schema, sample: Any = None, *, optional: bool = False
    ) -> Any:
        """The value of a key as it is given, or ``default``, None being one where the key is ``optional``; ``schema``
        and a ``sample`` of what is expected are for :class:`~sherkit.data.asked.AskedTable`."""
        del schema, sample
        self._known.add(key)
        if key in self._values:
            return self._values[key]
        if default is None and not optional:
            raise self._missing(key, expected)
        return default

    def _inside(self, key: str, values: Mapping[str, Any], name: str) -> Self:
        """The table ``values`` of a key, called by ``name`` in messages."""
        del key
        return type(self)(values, self._where, f"{self._path}.{name}" if self._path else name, self._error)

    def _missing(self, key: str, expected: str) -> SherkitError:
        # a misspelt key is both missing and unknown: say it once, where the user typed it
        typed = closest(key, [k for k in self._values if k not in self._known], cutoff=_MISSPELT)
        hint = f"; is '{typed}' meant to be it?" if typed else ""
        return self._error(f"{self._where}: {self._name(key)} is missing; expected {expected}{hint}")

    @contextmanager
    def table(self, key: str, *, optional: bool = False) -> Iterator[Self]:
        """A sub-table; on leaving it, unknown keys are refused."""
        values = self._get(key, "a table", {} if optional else None, {}, {})
        if not isinstance(values, Mapping):
            raise self.fail(key, f"a table [{key}]")
        inner = self._inside(key, values, key)
        yield inner
        inner.finish()

    def tables(self, key: str, *, optional: bool = True) -> Iterator[Self]:
        """The tables of a list ``[[key]]``, none where it is not given; past each, its unknown keys are refused."""
        values = self._get(key, "a list of tables", [] if optional else None, {"type": "array"})
        if not isinstance(values, list) or not all(isinstance(v, Mapping) for v in values):
            raise self.fail(key, f"tables [[{key}]]")
        for k, one in enumerate(values, 1):
            inner = self._inside(key, one, f"{key} {k}")
            yield inner
            inner.finish()

    def finish(self) -> None:
        """Refuses keys that nobody asked for."""
        for key in self._values:
            if key not in self._known:
                hint = nearest(key, self._known) or f"; known keys: {listed(sorted(self._known), 12)}"
                raise self._error(f"{self._where}: unknown key {self._name(key)}{hint}")

    def free(self, key: str) -> dict[str, Any]:
        """A sub-table whose keys are its owner's own: texts, numbers, truths, lists of them; empty if left out."""
        values = self._get(key, "a table", {}, {"type": "object"})
        if not isinstance(values, Mapping) or not all(_is_plain(v) for v in values.values()):
            raise self.fail(key, "a table of texts, numbers, true or false, and lists of them")
        return dict(values)

    def pass_over(self, *keys: str) -> None:
        """Keys that are for people, and may be there."""
        self._known.update(keys)

    def names(self) -> list[str]:
        """The keys that are given, in the order of the file."""
        return list(self._values)

    def has(self, key: str) -> bool:
        """Whether a key is given, under its very name."""
        return key in self._values

    def text(self, key: str, allowed: tuple[str, ...], default: str | None = None) -> str:
        """One of the allowed words."""
        expected = "one of " + ", ".join(f"'{a}'" for a in allowed)
        value = self._get(key, expected, default, {"enum": list(allowed)}, allowed[0] if allowed else None)
        if value not in allowed:
            raise self.fail(key, expected)
        return str(value)

    def words(self, key: str, default: str | None = None, *, empty: bool = False) -> str:
        """Any text that is not empty unless it may be; where it is left out, ``default``, which may be empty."""
        value = self._get(key, "a text", default, {"type": "string"}, "x")
        if not isinstance(value, str) or (not value and not empty and key in self._values):
            raise self.fail(key, "a text")
        return value

    def texts(self, key: str, default: tuple[str, ...] | None = None) -> tuple[str, ...]:
        """A list of texts."""
        value = self._get(key, "a list of texts", default, _list({"type": "string"}), ["x"])
        if not isinstance(value, list | tuple) or not all(isinstance(v, str) for v in value):
            raise self.fail(key, "a list of texts")
        return tuple(value)

    def wholes(self, key: str) -> tuple[int, ...]:
        """A list of whole numbers."""
        value = self._get(key, "a list of whole numbers", None, _list({"type": "integer"}), [1])
        if not isinstance(value, list) or not all(isinstance(v, int) and not isinstance(v, bool) for v in value):
            raise self.fail(key, "a list of whole numbers")
        return tuple(value)

    def flag(self, key: str, default: bool | None = None) -> bool:
        """true or false."""
        value = self._get(key, "true or false", default, {"type": "boolean"})
        if not isinstance(value, bool):
            raise self.fail(key, "true or false")
        return value

    def whole(self, key: str, default: int | None = None, *, least: int | None = None, most: int | None = None) -> int:
        """A whole number, from ``least`` to ``most``."""
        kind = "a whole number" + (f" of at least {least}" if least is not None else "")
        kind += f", at most {most}" if most is not None else ""
        limits = {"minimum": least, "maximum": most}
        schema = {"type": "integer", **{name: v for name, v in limits.items() if v is not None}}
        value = self._get(key, kind, default, schema, max(least or 0, 3))
        if not isinstance(value, int) or isinstance(value, bool):
            raise self.fail(key, kind)
        if (least is not None and value < least) or (most is not None and value > most):
            raise self.fail(key, kind)
        return value

    def rows(self, key: str, width: int) -> tuple[tuple[float, ...], ...]:
        """A list of lists of ``width`` finite numbers."""
        kind = f"a list of lists of {width} numbers"
        value = self._get(key, kind, None, _list(_list(_NUMBER, width)), [[1.0] * width])
        if not isinstance(value, list) or not all(
            isinstance(row, list) and len(row) == width and all(_is_number(v) for v in row) for row in value
        ):
            raise self.fail(key, kind)
        return tuple(tuple(float(v) for v in row) for row in value)

    def array(self, key: str, *shape: int, finite: bool = True) -> Floats:
        """Numbers of a given shape; none is NaN, and where ``finite`` none has no end."""
        kind = f"{'finite ' if finite else ''}numbers of shape {shape}"
        schema = _NUMBER
        for count in reversed(shape):
            schema = _list(schema, count)
        value = self._get(key, kind, None, schema)
        try:
            made = np.array(value, dtype=float)
        except (TypeError, ValueError, OverflowError):
            raise self.fail(key, kind) from None
        if made.shape != shape or np.isnan(made).any() or (finite and not (np.abs(made) < _LARGEST_OF_ARRAY).all()):
            raise self.fail(key, kind)
        return made

    def covariance(self, key: str, size: int) -> Floats:
        """A covariance (size, size): no variance of it is negative."""
        made = self.array(key, size, size)
        if size and linalg.eigvalsh(0.5 * (made + made.T))[0] < -1e-9 * max(float(np.trace(made)), 1e-300):
            raise self.fail(key, "a covariance (symmetric, no negative variance)")
        return made

    def some_numbers(self, key: str, default: tuple[float, ...] | None = None) -> tuple[float, ...]:
        """A list of finite numbers of any length, at least one."""
        value = self._get(key, "a list of numbers", default, _list(_NUMBER), [1.0])
        if not isinstance(value, list | tuple) or not value or not all(_is_number(v) for v in value):
            raise self.fail(key, "a list of numbers")
        return tuple(float(v) for v in value)

    def number(
        self, key: str, default: float | None = None, *, positive: bool = False, least: float | None = None
    ) -> float:
        """A finite number, at least ``least``."""
        kind = ("a positive number" if positive else "a number") + (
            f", at least {least:g}" if least is not None else ""
        )
        schema = (_POSITIVE if positive else _NUMBER) | ({} if least is None else {"minimum": least})
        value = self._get(key, kind, default, schema, 1.0)
        if not _is_number(value) or (positive and value < _SMALLEST) or (least is not None and value < least):
            raise self.fail(key, kind)
        return float(value)

    def heights(self, key: str) -> tuple[float, float] | None:
        """Two numbers, the lower first, or None where the key is not given."""
        if self._get(key, "two numbers, the lower first", None, _list(_NUMBER, 2), optional=True) is None:
            return None
        low, high = self.numbers(key, 2, (0.0, 0.0))
        if not low < high:
            raise self.fail(key, "two numbers, the lower first")
        return (low, high)

    def positive(self, key: str, *, or_zero: bool = False) -> float | None:
        """A positive number, or None where the key is not given; ``or_zero``: 0 says that there is none."""
        zero = {"type": "number", "minimum": 0}
        expected = "a positive number" + (", or 0 for none" if or_zero else "")
        value = self._get(key, expected, None, zero if or_zero else _POSITIVE, optional=True)
        if value is None:
            return None
        if not or_zero:
            return self.number(key, 1.0, positive=True)
        if not _is_number(value) or value < 0:
            raise self.fail(key, expected)
        return float(value)

    def numbers(
        self, key: str, count: int, default: tuple[float, ...] | None = None, *, positive: bool = False
    ) -> tuple[float, ...]:
        """A list of finite numbers of a given length."""
        kind = f"{count} {'positive ' if positive else ''}numbers"
        schema = _list(_POSITIVE if positive else _NUMBER, count)
        value = self._get(key, kind, default, schema, [1.0 + k for k in range(count)])
        if (
            not isinstance(value, list | tuple)
            or len(value) != count
            or not all(_is_number(v) for v in value)
            or (positive and min(value) < _SMALLEST)
        ):
            each = f", one for each, such as [{', '.join([f'{value:g}'] * count)}]" if _is_number(value) else ""
            raise self.fail(key, kind + each)
        return tuple(float(v) for v in value)


def _is_plain(value: object) -> bool:
    return all(map(_is_plain, value)) if isinstance(value, list) else isinstance(value, str | bool | int | float)


def _is_beyond(value: object) -> bool:
    """Whether a number, or one of a list, is of no size that a machine has."""
    if isinstance(value, list | tuple):
        return any(map(_is_beyond, value))
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return 0 < abs(value) < _SMALLEST or abs(value) > _LARGEST


def _is_number(value: object) -> bool:
    # NaN is not below anything; Python's whole numbers have no end, floats have
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _LARGEST
