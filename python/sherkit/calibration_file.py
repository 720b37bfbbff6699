"""Calibration files: TOML in which every value is checked, and every error names file and key."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .chain import ChainModel
from .errors import CalibrationError
from .names import listed

Floats = NDArray[np.float64]

FORMAT = 1


def tables_of(path: Path, kind: str | None = None) -> tuple[dict[str, Any], dict[str, Any]]:
    """All tables of a calibration file, and the table [calibration], for a robot of this kind.

    Raises :class:`~sherkit.errors.CalibrationError`.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise CalibrationError(f"{path}: is not valid TOML: {error}") from None
    settings = tables.get("calibration")
    if not isinstance(settings, dict) or settings.get("format") != FORMAT:
        raise CalibrationError(
            f"{path}: is not a calibration of this version (expected [calibration] format = {FORMAT})"
        )
    robot = tables.get("robot")
    found = robot.get("kind") if isinstance(robot, dict) else None
    if kind is not None and isinstance(found, str) and found != kind:
        raise CalibrationError(
            f"{path}: robot.kind: expected '{kind}', found '{found}'; sherkit.load_calibration reads every kind"
        )
    return tables, settings


class Keys:
    """A table of a calibration file: every value checked, every error with its key. Raises ``ValueError``."""

    def __init__(self, values: Any, path: str) -> None:
        if not isinstance(values, Mapping):
            raise ValueError(f"[{path}]: expected a table, found {values!r}")
        self.values: dict[str, Any] = dict(values)
        self.path = path

    def _fail(self, key: str, expected: str) -> ValueError:
        if key not in self.values:
            return ValueError(f"[{self.path}] '{key}' is missing; expected {expected}")
        found = self.values[key]
        return ValueError(f"[{self.path}] {key}: expected {expected}, found {str(found)[:80]}")

    def get(self, key: str, kind: type | tuple[type, ...], expected: str) -> Any:
        value = self.values.get(key)
        if not isinstance(value, kind) or isinstance(value, bool):
            raise self._fail(key, expected)
        return value

    def table(self, key: str) -> Keys:
        path = f"{self.path}.{key}" if self.path else key
        if key not in self.values:
            raise ValueError(f"[{path}] is missing")
        return Keys(self.values[key], path)

    def number(self, key: str) -> float:
        value = float(self.get(key, (int, float), "a number"))
        if not np.isfinite(value):
            raise self._fail(key, "a finite number")
        return value

    def optional_number(self, key: str) -> float | None:
        return self.number(key) if key in self.values else None

    def names(self, key: str) -> tuple[str, ...]:
        value = self.get(key, list, "a list of names")
        if not all(isinstance(v, str) for v in value):
            raise self._fail(key, "a list of names")
        return tuple(value)

    def array(self, key: str, *shape: int, finite: bool = True) -> Floats:
        expected = f"{'finite ' if finite else ''}numbers of shape {shape}"
        try:
            array = np.array(self.get(key, list, expected), dtype=float)
        except (TypeError, ValueError):
            raise self._fail(key, expected) from None
        if array.shape != shape or np.isnan(array).any() or (finite and not np.isfinite(array).all()):
            raise self._fail(key, expected)
        return array

    def covariance(self, key: str, size: int) -> Floats:
        matrix = self.array(key, size, size)
        if size and np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0] < -1e-9 * max(float(np.trace(matrix)), 1e-300):
            raise self._fail(key, "a covariance (symmetric, no negative variance)")
        return matrix


def check_names(model: ChainModel, keys: Keys) -> None:
    """Refuses a file whose parameters are not those of its effects, in their order."""
    found = [p["name"] for p in keys.values["parameters"]]
    expected = [p.name for p in model.parameters]
    if found != expected:
        wrong = next((f for f, e in zip(found, expected, strict=False) if f != e), "a missing one")
        raise ValueError(f"[{keys.path}] parameters: expected {listed(expected, 30)}; '{wrong}' does not belong there")
