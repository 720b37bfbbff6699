"""Klipper's ``printer.cfg`` of a linear delta: its saved calibration as a robot, its probing as a run.

Klipper models each carriage by one radius, a tower angle, an arm length and an end stop
(``klippy/kinematics/delta.py``): the carriage stands at ``position_endstop + sqrt(arm² - radius²)`` when it
touches its end stop and moves down by ``steps / steps_per_mm``. Its ``delta_calibrate`` section keeps probed
heights and calliper distances as steps since the end stop; its bed mesh was probed with the saved calibration.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...data import Measurements
from ...errors import MeasurementError, OutOfReach, RobotError
from ...types import Floats
from .robot import Delta, Triple

_STEPPERS = ("stepper_a", "stepper_b", "stepper_c")
_ANGLES = {"stepper_a": 210.0, "stepper_b": 330.0, "stepper_c": 90.0}
_FULL_STEPS = 200.0
_SAVED = "#*#"
_COMMENT = re.compile(r"#.*|(^|\s);.*")


@dataclass(frozen=True, eq=False)
class KlipperDelta:
    """A printer's own calibration and what it measured."""

    robot: Delta
    measurements: Measurements


def import_klipper(path: str | Path) -> KlipperDelta:
    """Reads a ``printer.cfg`` with a SAVE_CONFIG block.

    Raises :class:`~sherkit.errors.RobotError` for a printer that is no calibrated delta, and
    :class:`~sherkit.errors.MeasurementError` where it holds no probing.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise RobotError(f"{path}: is not a text file, expected a Klipper printer.cfg") from None
    config = _Config(path, text)
    if config.get("printer", "kinematics") != "delta":
        raise RobotError(f"{path}: [printer] kinematics is not 'delta'; only linear deltas can be imported")
    radius = config.number("printer", "delta_radius")
    if radius <= 0:
        raise RobotError(f"{path}: [printer] delta_radius: expected a number above zero, found {radius:g}")
    # as in Klipper, the second and third tower are like the first where nothing else is said
    arm = [config.number("stepper_a", "arm_length")]
    arm += [config.number(s, "arm_length", arm[0]) for s in _STEPPERS[1:]]
    endstop = [config.number("stepper_a", "position_endstop")]
    endstop += [config.number(s, "position_endstop", endstop[0]) for s in _STEPPERS[1:]]
    angle = [config.number(s, "angle", _ANGLES[s]) for s in _STEPPERS]
    for stepper, length in zip(_STEPPERS, arm, strict=True):
        if length <= radius:
            raise RobotError(f"{path}: [{stepper}] arm_length {length:g} is not longer than delta_radius {radius:g}")
    print_radius = config.number("printer", "print_radius", radius)
    robot = Delta(
        base_radius_mm=(radius, radius, radius),
        base_angle_deg=_triple(angle),
        platform_radius_mm=(0.0, 0.0, 0.0),
        platform_angle_deg=_triple(angle),
        rod_length_mm=_triple(arm),
        pole_pitch_mm=0.0,  # steppers without encoders
        workspace_radius_mm=print_radius,
    )
    top = np.array([e + math.sqrt(a * a - radius * radius) for e, a in zip(endstop, arm, strict=True)])
    steps_per_mm = np.array([_steps_per_mm(config, s) for s in _STEPPERS])

    rows: list[tuple[Floats, Floats | None, float, str]] = []
    for stem in ("height", "manual_height"):
        for k in config.numbered("delta_calibrate", stem):
            at = top - config.numbers("delta_calibrate", f"{stem}{k}_pos", 3) / steps_per_mm
            rows.append((at, None, config.number("delta_calibrate", f"{stem}{k}"), stem))
    for k in config.numbered("delta_calibrate", "distance"):
        ends = [top - config.numbers("delta_calibrate", f"distance{k}_pos{end}", 3) / steps_per_mm for end in (1, 2)]
        rows.append((ends[0], ends[1], config.number("delta_calibrate", f"distance{k}"), "distance"))
    for x, y, z in _mesh_points(config):
        # the nozzle touched the bed (height zero) where the printer believed it to be at z
        try:
            rows.append((robot.inverse((x, y, z)), None, 0.0, "mesh"))
        except OutOfReach as error:
            raise RobotError(f"{path}: [bed_mesh default] the point {x:g}, {y:g} mm cannot be: {error}") from None
    if not rows:
        raise MeasurementError(
            f"{path}: holds no probing; expected [delta_calibrate] heights or a [bed_mesh default] in the "
            "SAVE_CONFIG block (run DELTA_CALIBRATE or BED_MESH_CALIBRATE and SAVE_CONFIG)"
        )
    nan = np.full(3, np.nan)
    columns = {
        **{f"q{k + 1}_mm": np.array([r[0][k] for r in rows]) for k in range(3)},
        **{f"to_q{k + 1}_mm": np.array([(nan if r[1] is None else r[1])[k] for r in rows]) for k in range(3)},
        "z_mm": np.array([r[2] if r[1] is None else np.nan for r in rows]),
        "distance_mm": np.array([r[2] if r[1] is not None else np.nan for r in rows]),
        "probe": np.array([r[3] for r in rows]),
    }
    return KlipperDelta(robot, Measurements.from_columns(columns, str(path)))


def _triple(values: list[float]) -> Triple:
    return (values[0], values[1], values[2])


def _steps_per_mm(config: _Config, stepper: str) -> float:
    full = config.number(stepper, "full_steps_per_rotation", _FULL_STEPS)
    steps = full * config.number(stepper, "microsteps") * config.gear_ratio(stepper)
    travel = config.number(stepper, "rotation_distance")
    if min(steps, travel) <= 0:
        raise RobotError(f"{config.path}: [{stepper}] {steps:g} steps move {travel:g} mm; expected more than zero")
    return steps / travel


def _mesh_points(config: _Config) -> list[tuple[float, float, float]]:
    """Probed points of the saved mesh; of a round one the file fills the corners with copies, left out here."""
    section = "bed_mesh default"
    text = config.get(section, "points")
    if text is None:
        return []
    try:
        z = np.array([[float(v) for v in line.split(",")] for line in text.splitlines() if line.strip()])
    except ValueError:
        z = np.zeros(0)
    if z.ndim != 2 or not np.isfinite(z).all():
        raise MeasurementError(f"{config.path}: [{section}] points: expected rows of numbers, all of one length")
    low, high = ([config.number(section, f"{end}_{axis}") for axis in "xy"] for end in ("min", "max"))
    x, y = np.linspace(low[0], high[0], z.shape[1]), np.linspace(low[1], high[1], z.shape[0])
    radius = config.number("bed_mesh", "mesh_radius", math.inf)
    return [
        (float(x[i]), float(y[j]), float(z[j, i]))
        for j in range(z.shape[0])
        for i in range(z.shape[1])
        if math.hypot(x[i] - (low[0] + high[0]) / 2, y[j] - (low[1] + high[1]) / 2) <= radius * (1 + 1e-9)
    ]


class _Config:
    """Sections and options. As in Klipper, what stands above the SAVE_CONFIG block overrides the block."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self._values: dict[tuple[str, str], str] = {}
        lines = text.splitlines()
        self._read([line[len(_SAVED) :].removeprefix(" ") for line in lines if line.startswith(_SAVED)])
        self._read([line for line in lines if not line.startswith(_SAVED)])

    def _read(self, lines: list[str]) -> None:
        section, key = "", ""
        for line in lines:
            body = _COMMENT.sub("", line).rstrip()
            if not body.strip():
                continue
            if body.startswith("["):
                section, key = body.strip("[] \t"), ""
            elif body[0] in " \t" and key:
                self._values[section, key] += "\n" + body.strip()
            else:
                ends = [i for i in (body.find(":"), body.find("=")) if i >= 0]
                if ends and section:
                    key = body[: min(ends)].strip().lower()
                    self._values[section, key] = body[min(ends) + 1 :].strip()

    def get(self, section: str, key: str) -> str | None:
        return self._values.get((section, key))

    def numbered(self, section: str, stem: str) -> list[int]:
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
                f"{self.path}: [{section}] gear_ratio: expected pairs like 80:16, found '{text}'"
            ) from None

    def number(self, section: str, key: str, default: float | None = None) -> float:
        return float(self.numbers(section, key, 1, None if default is None else (default,))[0])

    def numbers(self, section: str, key: str, count: int, default: tuple[float, ...] | None = None) -> Floats:
        text = self.get(section, key)
        if text is None:
            if default is None:
                raise RobotError(f"{self.path}: [{section}] {key} is missing; expected {count} number(s)")
            return np.array(default)
        try:
            values = np.array([float(v) for v in text.split(",")])
        except ValueError:
            values = np.array([])
        if len(values) != count or not np.isfinite(values).all():
            raise RobotError(f"{self.path}: [{section}] {key}: expected {count} number(s), found '{text}'")
        return values
