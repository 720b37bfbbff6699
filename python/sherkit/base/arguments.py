"""Arguments of what a person calls, held against their annotations: the wrong one is named before anything is done."""

from __future__ import annotations

import inspect
import math
import os
import types
import typing
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cache, wraps
from numbers import Integral, Real
from typing import Annotated, Any, ParamSpec, TypeVar

import numpy as np

from ..errors import ArgumentError

_P = ParamSpec("_P")
_R = TypeVar("_R")
#: Characters of a value that a sentence repeats.
_SHOWN = 60
_PLAIN = {int: "a whole number", float: "a finite number", bool: "True or False", str: "text", type(None): "None"}


@dataclass(frozen=True)
class Above:
    """More than ``least`` and, where it is given, less than ``most``."""

    least: float
    most: float = math.inf

    def holds(self, value: Any) -> bool:
        """Whether a number is as it must be."""
        return bool(self.least < value < self.most)

    def __str__(self) -> str:
        return f"above {self.least:g}" + (f" and below {self.most:g}" if self.most < math.inf else "")


@dataclass(frozen=True)
class AtLeast:
    """``least`` or more."""

    least: float

    def holds(self, value: Any) -> bool:
        """Whether a number is as it must be."""
        return bool(value >= self.least)

    def __str__(self) -> str:
        return f"of at least {self.least:g}"


#: Where randomness starts.
Seed = Annotated[int, AtLeast(0)]
#: How many of something.
Count = Annotated[int, Above(0, 1e9)]
#: How often a true statement may be refused.
Level = Annotated[float, Above(0.0, 1.0)]
#: A time, or a part, that may be none.
NotNegative = Annotated[float, AtLeast(0)]
#: A length, a time, a deviation.
Positive = Annotated[float, Above(0.0)]


def validate_arguments(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """A function whose arguments are held against its annotations at each call.

    A number is finite, one text is no list of names, and a path has no zero byte. What cannot be told before it is used
    (a protocol, the shape of an array) is left to the function. Raises :class:`~sherkit.errors.ArgumentError`.
    """
    parameters = inspect.signature(function).parameters
    by_position = [p.name for p in parameters.values() if p.kind is p.POSITIONAL_OR_KEYWORD]
    hints: dict[str, Any] = {}

    @wraps(function)
    def call(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        # what is left out, twice there, or has no such name Python itself tells best
        given = dict(zip(by_position, args, strict=False)) | kwargs
        if not hints:  # only now: what an annotation names may be defined below the function
            hints.update(typing.get_type_hints(function, include_extras=True))
        for name, value in given.items():
            if name in hints and not _fits(hints[name], value):
                who = function.__qualname__.removesuffix(".__init__")
                raise ArgumentError(f"{who}: {name}: {_told(hints[name], value)}")
        return function(*args, **kwargs)

    return call


def _told(hint: Any, value: Any) -> str:
    hinted = f"; did you mean [{value!r}]?" if isinstance(value, str) and _fits(hint, [value]) else ""
    text = " ".join(f"{value!r}".split())
    return f"expected {_words(hint)}, found {text if len(text) <= _SHOWN else text[:_SHOWN] + '…'}{hinted}"


@cache
def _of(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    return typing.get_origin(hint) or hint, typing.get_args(hint)


def _is_path(hint: Any) -> bool:
    kind, inner = _of(hint)
    return any(map(_is_path, inner)) if _is_choice(kind) else _is_class(kind) and issubclass(kind, os.PathLike)


def _is_class(kind: Any) -> bool:
    """Whether a value can be told to be of it: not of a protocol, which other people's classes satisfy."""
    return isinstance(kind, type) and kind is not Any and not getattr(kind, "_is_protocol", False)


def _is_choice(kind: Any) -> bool:
    return kind in (typing.Union, types.UnionType)


def _fits(hint: Any, value: Any) -> bool:
    """Whether a value is what an annotation says, as far as that can be told."""
    kind, inner = _of(hint)
    if kind is Annotated:
        return _fits(inner[0], value) and all(rule.holds(value) for rule in inner[1:])
    if _is_choice(kind):
        if isinstance(value, str) and _is_path(hint):
            return "\0" not in value
        return any(_fits(one, value) for one in inner)
    if kind in (int, float):
        number = isinstance(value, Integral if kind is int else Real) and not isinstance(value, bool)
        return number and (kind is int or math.isfinite(value))
    if kind is bool:
        return isinstance(value, bool | np.bool_)
    if kind is Callable:
        return callable(value)
    if not _is_class(kind):
        return True
    if issubclass(kind, Mapping):
        names, values = inner or (Any, Any)
        return isinstance(value, Mapping) and all(_fits(names, k) and _fits(values, v) for k, v in value.items())
    if kind is np.ndarray and inner:
        wanted = typing.get_args(inner[1])[0]
        return isinstance(value, kind) and (wanted is Any or np.can_cast(value.dtype, wanted, "same_kind"))
    if not inner or not issubclass(kind, Collection):
        return isinstance(value, kind)
    if (
        not isinstance(value, Collection)
        or isinstance(value, str | bytes | Mapping)
        or getattr(value, "shape", None) == ()
    ):
        return False
    if kind is tuple and inner[-1] is not ...:
        return len(value) == len(inner) and all(map(_fits, inner, value))
    return all(_fits(inner[0], one) for one in value)


def _words(hint: Any) -> str:
    """An annotation as a person would say it."""
    kind, inner = _of(hint)
    if kind is Annotated:
        return " ".join([_words(inner[0]), *map(str, inner[1:])])
    if _is_choice(kind):
        paths = _is_path(hint)
        told = [_words(one) for one in inner if not (paths and one is str)]
        return " or ".join(dict.fromkeys(told))
    if kind is Callable:
        return "a function"
    if not _is_class(kind):
        return getattr(kind, "__name__", "anything")
    if kind in _PLAIN or issubclass(kind, os.PathLike):
        return _PLAIN.get(kind, "a path")
    if issubclass(kind, Mapping):
        return f"a mapping of {' to '.join(map(_words, inner))}" if inner else "a mapping"
    if kind is np.ndarray:
        return "an array"
    if not inner or not issubclass(kind, Collection):
        return f"{'an' if kind.__name__[0] in 'AEIO' else 'a'} {kind.__name__}"
    if kind is tuple and inner[-1] is not ...:
        return f"({', '.join(map(_words, inner))})"
    return "a list" if inner[0] is Any else f"a list, each {_words(inner[0])}"
