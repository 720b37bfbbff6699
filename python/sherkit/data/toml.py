"""Reading a TOML table key by key: every key checked, unknown keys refused with the nearest known one.

Robot files are read with it, calibrations, and the files of laboratories and experiments.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..base import linalg
from ..base.figures import brief, closest, listed, nearest
from ..base.types import Floats
from ..errors import RobotError, SherkitError
from .files import of_demo, refuse_device

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
    refuse_device(path, error)
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise error(f"{brief(path, _LONGEST_PATH)}: there is no such {what} file{of_demo(path)}") from None
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
_TEXT: Schema = {"type": "string"}
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

    def saying(self, what: str) -> SherkitError:
        """The error for what is wrong with the file as a whole, in words."""
        return self._error(f"{self._where}: {what}")

    @property
    def values(self) -> Mapping[str, Any]:
        """What is in it, as it was given."""
        return self._values

    def _get(
        self, key: str, expected: str, schema: Schema, holds: Callable[[Any], bool], default: Any = None, *,
        sample: Any = None, optional: bool = False,
    ) -> Any:  # fmt: skip
        """The value of a key where it ``holds``; ``default`` where it is not given, None being one where the key is
        ``optional``. ``schema`` and a ``sample`` of what is expected are for
        :class:`~sherkit.data.declared.AskedTable`.
        """
        del schema, sample
        self._known.add(key)
        if key in self._values:
            value = self._values[key]
            if not holds(value):
                raise self.fail(key, expected)
            return value
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
        values = self._get(key, f"a table [{key}]", {}, _is_table, {} if optional else None, sample={})
        inner = self._inside(key, values, key)
        yield inner
        inner.finish()

    def tables(self, key: str, *, optional: bool = True) -> Iterator[Self]:
        """The tables of a list ``[[key]]``, none where it is not given; past each, its unknown keys are refused."""
        default = () if optional else None
        for k, one in enumerate(self._get(key, f"tables [[{key}]]", _list({}), _list_of(_is_table), default), 1):
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
        expected = "a table of texts, numbers, true or false, and lists of them"
        plain = self._get(
            key, expected, {"type": "object"}, lambda v: _is_table(v) and all(map(_is_plain, v.values())), {}
        )
        return dict(plain)

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
        expected, sample = "one of " + ", ".join(f"'{a}'" for a in allowed), next(iter(allowed), None)
        return str(self._get(key, expected, {"enum": list(allowed)}, lambda v: v in allowed, default, sample=sample))

    def words(self, key: str, default: str | None = None, *, empty: bool = False) -> str:
        """Any text that is not empty unless it may be; where it is left out, ``default``, which may be empty."""
        return str(self._get(key, "a text", _TEXT, lambda v: _is_text(v) and bool(v or empty), default, sample="x"))

    def all_texts(self, expected: str) -> dict[str, str]:
        """Every key of a table whose keys are its owner's own, each a text; ``expected`` is what it says, in words."""
        out = {}
        for key in self._values:
            if not _is_text(self._values[key]):
                self._known.add(key)
                raise self.fail(key, expected)
            out[key] = self.words(key)
        return out

    def texts(self, key: str, default: tuple[str, ...] | None = None) -> tuple[str, ...]:
        """A list of texts."""
        return tuple(self._get(key, "a list of texts", _list(_TEXT), _list_of(_is_text), default, sample=["x"]))

    def wholes(self, key: str) -> tuple[int, ...]:
        """A list of whole numbers."""
        schema = _list({"type": "integer"})
        return tuple(self._get(key, "a list of whole numbers", schema, _list_of(_is_whole), sample=[1]))

    def flag(self, key: str, default: bool | None = None) -> bool:
        """true or false."""
        return bool(self._get(key, "true or false", {"type": "boolean"}, lambda v: isinstance(v, bool), default))

    def whole(self, key: str, default: int | None = None, *, least: int | None = None, most: int | None = None) -> int:
        """A whole number, from ``least`` to ``most``."""
        expected = "a whole number" + (f" of at least {least}" if least is not None else "")
        expected += f", at most {most}" if most is not None else ""
        limits = {"minimum": least, "maximum": most}
        schema = {"type": "integer", **{name: v for name, v in limits.items() if v is not None}}

        def holds(v: Any) -> bool:
            return _is_whole(v) and (least is None or v >= least) and (most is None or v <= most)

        return int(self._get(key, expected, schema, holds, default, sample=max(least or 0, 3)))

    def rows(self, key: str, width: int) -> tuple[tuple[float, ...], ...]:
        """A list of lists of ``width`` finite numbers."""
        expected, schema = f"a list of lists of {width} numbers", _list(_list(_NUMBER, width))
        value = self._get(key, expected, schema, _list_of(_list_of(_is_number, width)), sample=[[1.0] * width])
        return tuple(tuple(float(v) for v in row) for row in value)

    def array(self, key: str, *shape: int, finite: bool = True) -> Floats:
        """Numbers of a given shape; none is NaN, and where ``finite`` none has no end."""
        expected, schema = f"{'finite ' if finite else ''}numbers of shape {shape}", _NUMBER
        for count in reversed(shape):
            schema = _list(schema, count)

        def holds(v: Any) -> bool:
            try:
                made = np.array(v, dtype=float)
            except (TypeError, ValueError, OverflowError):
                return False
            fits = made.shape == shape and not np.isnan(made).any()
            return fits and bool(not finite or (np.abs(made) < _LARGEST_OF_ARRAY).all())

        return np.array(self._get(key, expected, schema, holds), dtype=float)

    def covariance(self, key: str, size: int) -> Floats:
        """A covariance (size, size): no variance of it is negative."""
        made = self.array(key, size, size)
        if size and linalg.eigvalsh(0.5 * (made + made.T))[0] < -1e-9 * max(float(np.trace(made)), 1e-300):
            raise self.fail(key, "a covariance (symmetric, no negative variance)")
        return made

    def some_numbers(self, key: str, default: tuple[float, ...] | None = None) -> tuple[float, ...]:
        """A list of finite numbers of any length, at least one."""
        holds = _list_of(_is_number)
        value = self._get(
            key, "a list of numbers", _list(_NUMBER), lambda v: holds(v) and len(v) > 0, default, sample=[1.0]
        )
        return tuple(float(v) for v in value)

    def number(
        self, key: str, default: float | None = None, *, positive: bool = False, least: float | None = None
    ) -> float:
        """A finite number, at least ``least``."""
        expected = "a positive number" if positive else "a number"
        expected += f", at least {least:g}" if least is not None else ""
        schema = (_POSITIVE if positive else _NUMBER) | ({} if least is None else {"minimum": least})
        lowest = max(_SMALLEST if positive else -_LARGEST, -_LARGEST if least is None else least)
        return float(self._get(key, expected, schema, lambda v: _is_number(v) and v >= lowest, default, sample=1.0))

    def one_or_more(self, key: str, default: float | None = None) -> float | tuple[float, ...]:
        """A finite number, or a list of them."""
        schema: Schema = {"anyOf": [_NUMBER, _list(_NUMBER)]}
        several = _list_of(_is_number)
        found = self._get(
            key, "a number, or a list of them", schema, lambda v: _is_number(v) or (several(v) and len(v) > 0), default,
            sample=1.0,
        )  # fmt: skip
        return tuple(float(v) for v in found) if isinstance(found, list | tuple) else float(found)

    def choice(self, key: str) -> bool | None:
        """true or false, or None where the key is not given."""
        found = self._get(key, "true or false", {"type": "boolean"}, lambda v: isinstance(v, bool), optional=True)
        return None if found is None else bool(found)

    def deviations(self, key: str, count: int) -> tuple[float, ...] | None:
        """Standard deviations, one number for all or ``count`` of them: 0 where a thing is held, inf where it is free;
        None where the key is not given."""
        expected = f"a number for all axes, or {count} of them, none below zero; 0 holds an axis, inf frees it"
        one: Schema = {"type": "number", "minimum": 0}
        several = _list_of(_is_deviation, count)
        found = self._get(
            key, expected, {"anyOf": [one, _list(one, count)]}, lambda v: _is_deviation(v) or several(v), optional=True
        )
        if found is None:
            return None
        return tuple(float(v) for v in (found if isinstance(found, list | tuple) else [found] * count))

    def heights(self, key: str) -> tuple[float, float] | None:
        """Two numbers, the lower first, or None where the key is not given."""
        holds, expected = _list_of(_is_number, 2), "two numbers, the lower first"
        value = self._get(key, expected, _list(_NUMBER, 2), lambda v: holds(v) and v[0] < v[1], optional=True)
        return None if value is None else (float(value[0]), float(value[1]))

    def positive(self, key: str, *, or_zero: bool = False) -> float | None:
        """A positive number, or None where the key is not given; ``or_zero``: 0 says that there is none."""
        expected, lowest, schema = "a positive number", _SMALLEST, _POSITIVE
        if or_zero:
            expected, lowest, schema = f"{expected}, or 0 for none", 0.0, {"type": "number", "minimum": 0}
        value = self._get(key, expected, schema, lambda v: _is_number(v) and v >= lowest, optional=True)
        return None if value is None else float(value)

    def numbers(
        self, key: str, count: int, default: tuple[float, ...] | None = None, *, positive: bool = False
    ) -> tuple[float, ...]:
        """A list of finite numbers of a given length."""
        expected = f"{count} {'positive ' if positive else ''}numbers"
        if _is_number(one := self._values.get(key)):
            expected += f", one for each, such as [{', '.join([f'{one:g}'] * count)}]"
        schema, sample = _list(_POSITIVE if positive else _NUMBER, count), [1.0 + k for k in range(count)]
        holds = _list_of(lambda v: _is_number(v) and (not positive or v >= _SMALLEST), count)
        return tuple(float(v) for v in self._get(key, expected, schema, holds, default, sample=sample))


def _list_of(holds: Callable[[Any], bool], count: int | None = None) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, list | tuple) and count in (None, len(value)) and all(map(holds, value))


def _is_table(value: object) -> bool:
    return isinstance(value, Mapping)


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_plain(value: object) -> bool:
    return all(map(_is_plain, value)) if isinstance(value, list) else isinstance(value, str | bool | int | float)


def _is_beyond(value: object) -> bool:
    """Whether a number, or one of a list, is of no size that a machine has."""
    if isinstance(value, list | tuple):
        return any(map(_is_beyond, value))
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return 0 < abs(value) < _SMALLEST or abs(value) > _LARGEST


def _is_deviation(value: object) -> bool:
    return value == float("inf") or (_is_number(value) and (value == 0 or value >= _SMALLEST))  # type: ignore[operator]


def _is_number(value: object) -> bool:
    # NaN is not below anything; Python's whole numbers have no end, floats have
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _LARGEST
