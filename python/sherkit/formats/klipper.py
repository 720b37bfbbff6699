"""Klipper's ``printer.cfg`` of a linear delta: its saved calibration as a robot, its probing as a run.

Klipper models each carriage by one radius, a tower angle, an arm length and an end stop
(``klippy/kinematics/delta.py``): the carriage stands at ``position_endstop + sqrt(arm² - radius²)`` when it
touches its end stop and moves down by ``steps / steps_per_mm``. Its ``delta_calibrate`` section keeps probed
heights and calliper distances as steps since the end stop; its bed mesh was probed with the saved calibration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import MeasurementError, RobotError
from ..measurements import Measurements
from ..robots import Delta
from ..robots.delta import Triple

Floats = NDArray[np.float64]

_STEPPERS = ("stepper_a", "stepper_b", "stepper_c")
_ANGLES = {"stepper_a": 210.0, "stepper_b": 330.0, "stepper_c": 90.0}
_FULL_STEPS = 200.0
_SAVED = "#*#"


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
    arm = [config.number(s, "arm_length") for s in _STEPPERS]
    angle = [config.number(s, "angle", _ANGLES[s]) for s in _STEPPERS]
    endstop = [config.number(s, "position_endstop") for s in _STEPPERS]
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
        workspace_radius_mm=print_radius,
    )
    top = np.array([e + math.sqrt(a * a - radius * radius) for e, a in zip(endstop, arm, strict=True)])
    steps_per_mm = np.array([_steps_per_mm(config, s) for s in _STEPPERS])

    rows: list[tuple[Floats, Floats | None, float, str]] = []
    for k in config.numbered("delta_calibrate", "height"):
        at = top - config.numbers("delta_calibrate", f"height{k}_pos", 3) / steps_per_mm
        rows.append((at, None, config.number("delta_calibrate", f"height{k}"), "height"))
    for k in config.numbered("delta_calibrate", "distance"):
        ends = [top - config.numbers("delta_calibrate", f"distance{k}_pos{end}", 3) / steps_per_mm for end in (1, 2)]
        rows.append((ends[0], ends[1], config.number("delta_calibrate", f"distance{k}"), "distance"))
    for x, y, z in _mesh_points(config):
        # the nozzle touched the bed (height zero) where the printer believed it to be at z
        rows.append((robot.inverse((x, y, z)), None, 0.0, "mesh"))
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
    ratio = 1.0
    for gear in (config.get(stepper, "gear_ratio") or "1:1").split(","):
        a, _, b = gear.partition(":")
        ratio *= float(a) / float(b)
    full = config.number(stepper, "full_steps_per_rotation", _FULL_STEPS)
    microsteps = config.number(stepper, "microsteps")
    return full * microsteps * ratio / config.number(stepper, "rotation_distance")


def _mesh_points(config: _Config) -> list[tuple[float, float, float]]:
    """Probed points of a round mesh; the file fills the corners of the square with copies, left out here."""
    section = "bed_mesh default"
    if config.get(section, "points") is None:
        return []
    rows = [line for line in (config.get(section, "points") or "").splitlines() if line.strip()]
    z = np.array([[float(v) for v in line.split(",")] for line in rows])
    radius = config.number("bed_mesh", "mesh_radius", 0.0)
    if radius > 0:
        origin = config.numbers("bed_mesh", "mesh_origin", 2, (0.0, 0.0))
        x = origin[0] + np.linspace(-radius, radius, z.shape[1])
        y = origin[1] + np.linspace(-radius, radius, z.shape[0])
    else:
        low = config.numbers("bed_mesh", "mesh_min", 2)
        high = config.numbers("bed_mesh", "mesh_max", 2)
        x, y = np.linspace(low[0], high[0], z.shape[1]), np.linspace(low[1], high[1], z.shape[0])
        origin = np.zeros(2)
    return [
        (float(x[i]), float(y[j]), float(z[j, i]))
        for j in range(z.shape[0])
        for i in range(z.shape[1])
        if radius <= 0 or math.hypot(x[i] - origin[0], y[j] - origin[1]) <= radius * (1 + 1e-9)
    ]


class _Config:
    """Sections and options; what SAVE_CONFIG wrote overrides what stands above it."""

    def __init__(self, path: Path, text: str) -> None:
        self._path = path
        self._values: dict[tuple[str, str], str] = {}
        lines = text.splitlines()
        self._read([line for line in lines if not line.startswith(_SAVED)])
        self._read([line[len(_SAVED) :].removeprefix(" ") for line in lines if line.startswith(_SAVED)])

    def _read(self, lines: list[str]) -> None:
        section, key = "", ""
        for line in lines:
            body = line.split("#", 1)[0].rstrip()
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
        return sorted(int(k) for k in found if k.isdigit())

    def number(self, section: str, key: str, default: float | None = None) -> float:
        return float(self.numbers(section, key, 1, None if default is None else (default,))[0])

    def numbers(self, section: str, key: str, count: int, default: tuple[float, ...] | None = None) -> Floats:
        text = self.get(section, key)
        if text is None:
            if default is None:
                raise RobotError(f"{self._path}: [{section}] {key} is missing; expected {count} number(s)")
            return np.array(default)
        try:
            values = np.array([float(v) for v in text.split(",")])
        except ValueError:
            values = np.array([])
        if len(values) != count or not np.isfinite(values).all():
            raise RobotError(f"{self._path}: [{section}] {key}: expected {count} number(s), found '{text}'")
        return values
