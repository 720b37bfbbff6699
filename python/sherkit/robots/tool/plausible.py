"""What a run's numbers cannot be: other units, another clock, another tool, a camera that saw something else."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from ...base import linalg
from ...base.types import Floats
from ...errors import FitError, MeasurementError, SherkitWarning
from .tool import CAMERA, DEPTH, FIBRE_TIME, FIBRES, POSITION, TURN

_UNITS = {"pm": 1e3, "um": 1e-3, "m": 1e-9}
#: No load moves a grating further than this, nm.
OUT_OF_REACH_NM = 8.0
#: Rows of a robot are no further apart, and readings no further from their rows, s.
_SLOWEST_S, _STRANGE_CLOCK_S = 0.5, 1.0
_LONGEST_TURN_RAD = 2.0 * np.pi + 0.1
#: A depth that never exceeds this is none, or in another unit, mm.
_LEAST_DEPTH_MM = 0.1
#: From here on two clouds have one shape, or nothing in common; and how unlike in size they may be.
_SAME, _UNLIKE, _SCALE = 0.8, 0.9, 30.0
#: A reflection takes this much of what a turn leaves, where the motion has three directions.
_MIRRORED = 0.02
#: A camera further off than a tool is long was never registered, mm.
_ELSEWHERE_MM = 60.0


def check_unit(wavelengths_nm: Floats, reference_nm: Floats, source: str) -> None:
    """Raises :class:`~sherkit.errors.MeasurementError` for wavelengths (n, 9) that are not in nm, or are shifts."""
    known = wavelengths_nm[np.isfinite(wavelengths_nm)]
    if not len(known):
        return
    ratio, there = float(np.median(known)) / float(np.mean(reference_nm)), float(np.mean(reference_nm))
    for unit, factor in _UNITS.items():
        if 0.5 < ratio / factor < 2.0:
            raise MeasurementError(
                f"{source}: the wavelengths of {FIBRES[0]} and the others seem to be in {unit}; expected nm, near "
                f"{there:.0f}"
            )
    if not 0.3 < ratio < 3.0:
        raise MeasurementError(
            f"{source}: {FIBRES[0]} and the others hold numbers around {np.median(known):.3g}; expected wavelengths in "
            f"nm, near {there:.0f}, and not their shifts"
        )


def check_wavelengths(wavelengths_nm: Floats, reference_nm: Floats, source: str) -> None:
    """As :func:`check_unit`, and for wavelengths of another tool than the one with these references (9,)."""
    check_unit(wavelengths_nm, reference_nm, source)
    shift = np.abs(wavelengths_nm - reference_nm)
    off = float(np.median(shift[np.isfinite(shift)])) if np.isfinite(shift).any() else 0.0
    if off > OUT_OF_REACH_NM:
        raise MeasurementError(
            f"{source}: the wavelengths lie {off:.3g} nm from reference_nm of the tool file, which no force does: is "
            "it the file of this tool?"
        )


def check_clocks(time_s: Floats, stamps_s: Floats | None, source: str) -> None:
    """Raises :class:`~sherkit.errors.MeasurementError` for rows (n,) of a robot that are too far apart, and for stamps
    (n,; NaN without a reading) by another clock."""
    step = float(np.median(np.diff(time_s)))
    if step > _SLOWEST_S:
        raise MeasurementError(
            f"{source}: rows of the robot are {step:g} s apart; expected {_SLOWEST_S:g} s or less: is time_s in "
            "another unit?"
        )
    if stamps_s is None:
        return
    apart = np.abs(stamps_s - time_s)
    apart = apart[np.isfinite(apart)]
    if len(apart) and float(np.median(apart)) > _STRANGE_CLOCK_S:
        raise MeasurementError(
            f"{source}: {FIBRE_TIME} lies {np.median(apart):.3g} s from time_s; expected seconds by the robot's clock"
        )


def check_turn(turn_rad: Floats, source: str) -> None:
    """Raises :class:`~sherkit.errors.MeasurementError` for rotation vectors (n, 3) of more than a turn."""
    most = float(np.linalg.norm(turn_rad, axis=1).max())
    if most > _LONGEST_TURN_RAD:
        raise MeasurementError(
            f"{source}: {TURN[0]} and the others make a turn of {most:.3g} rad; expected a rotation vector in rad: are "
            "they degrees?"
        )


def check_depth(depth_mm: Floats, source: str) -> None:
    """Warns of known depths (n,) that are in another unit."""
    most = float(np.nanmax(np.abs(depth_mm)))
    if 0.0 < most < _LEAST_DEPTH_MM:
        warnings.warn(f"{source}: {DEPTH} never exceeds {most:.2g} mm: is it in m?", SherkitWarning, stacklevel=3)


@dataclass(frozen=True)
class Likeness:
    """How alike two clouds are in shape: ``rigid`` is 1 for a turn and a scale, ``mirrored`` for one with a reflection;
    ``scale`` is the second's size over the first's."""

    scale: float
    rigid: float
    mirrored: float

    @property
    def best(self) -> float:
        """With or without a reflection."""
        return max(self.rigid, self.mirrored)


def likeness(first_mm: Floats, second_mm: Floats) -> Likeness:
    """Of points (n, 3) to points (n, 3) (Umeyama, IEEE PAMI 1991)."""
    a, b = (p - p.mean(axis=0) for p in (first_mm, second_mm))
    u, s, v = linalg.svd(a.T @ b)
    size_a, size_b = float((a**2).sum()), float((b**2).sum())
    if size_a == 0.0 or size_b == 0.0:
        return Likeness(1.0, 0.0, 0.0)
    last = s[2] * np.sign(np.linalg.det(u) * np.linalg.det(v))
    both = np.sqrt(size_a * size_b)
    one, other = float(s[0] + s[1] + last) / both, float(s[0] + s[1] - last) / both
    return Likeness(float(np.sqrt(size_b / size_a)), one, other)


def check_shapes(robot_mm: Floats, camera_mm: Floats, source: str) -> None:
    """Raises :class:`~sherkit.errors.FitError` for a free motion (n, 3) that a camera saw (n, 3) otherwise than moved
    and turned: in another unit, mirrored, or not at all."""
    alike = likeness(robot_mm, camera_mm)
    if alike.best < _UNLIKE:
        raise FitError(
            f"{source}: the camera's places do not follow the robot's (likeness {alike.best:.2f}, where 1 is the same "
            "motion): did the camera see the tip of the free tool, in the same seconds?"
        )
    if not 1.0 / _SCALE < alike.scale < _SCALE:
        raise FitError(
            f"{source}: the camera's places span {alike.scale:.3g} times those of the robot; expected both in mm "
            f"({CAMERA[0]}, {POSITION[0]})"
        )
    if alike.mirrored > _SAME and alike.mirrored - alike.rigid > _MIRRORED:
        raise FitError(
            f"{source}: the camera sees the motion mirrored: one of {', '.join(CAMERA)} is turned round, or two of "
            "them are swapped"
        )


def check_camera(robot_mm: Floats, seen_mm: Floats, source: str) -> None:
    """Of a run: places (n, 3) of the unbent tip, and of the tip as a registered camera saw it in the base. Raises
    :class:`~sherkit.errors.MeasurementError` for other units, and warns of a camera that stands elsewhere."""
    alike = likeness(robot_mm, seen_mm)
    if alike.rigid > _SAME and not 1.0 / _SCALE < alike.scale < _SCALE:
        raise MeasurementError(
            f"{source}: the camera's places span {alike.scale:.3g} times those of the robot; expected both in mm "
            f"({CAMERA[0]}, {POSITION[0]})"
        )
    off = float(np.median(np.linalg.norm(seen_mm - robot_mm, axis=1)))
    if off > _ELSEWHERE_MM:
        warnings.warn(
            f"{source}: the camera sees the tip {off:.0f} mm from where the robot has it: is [camera] of the tool file "
            "that of this camera? sherkit register finds it from a free motion",
            SherkitWarning, stacklevel=3,
        )  # fmt: skip
