"""Klipper's ``printer.cfg`` of a linear delta: its saved calibration as a robot, all that it measured as a run.

Klipper's ``delta_calibrate`` keeps probed heights and calliper distances as steps since the end stop, which no
calibration changes (``klippy/extras/delta_calibrate.py``); of a bed mesh (``bed_mesh.py``) it keeps how much higher
than expected the nozzle stood at each touch, by the calibration of then, at the coordinates of the probe."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...base.figures import brief, listed
from ...base.types import Bools, Floats
from ...errors import MeasurementError, RobotError
from .robot import ANGLES, ImportedPrinter, Printer, ProbedRows, Towers, triple

# -- Klipper's configuration files ----------------------------------------------------------------------------------

#: What begins each line of the block, and what stands in its first one.
SAVED = "#*#"
_HEADER = re.compile(r"#\*# <-+ SAVE_CONFIG -+>")
_COMMENT = re.compile(r"#.*|(^|\s);.*")
_MOST_FILES = 200


class KlipperConfig:
    """Sections and options of a ``printer.cfg`` and what it includes. Raises :class:`~sherkit.errors.RobotError`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        #: Included files that are not there.
        self.absent: list[str] = []
        self._values: dict[tuple[str, str], str] = {}
        self._files = 0
        lines = text_of(path, "a Klipper printer.cfg").splitlines()
        self._read(path, self._saved(lines))
        self._read(path, [line for line in lines if not line.startswith(SAVED)])

    def _saved(self, lines: list[str]) -> list[str]:
        starts = [k for k, line in enumerate(lines) if _HEADER.match(line)]
        behind = lines[starts[0] :] if starts else []
        other = next((line for line in behind if line.strip() and not line.startswith(SAVED)), None)
        if other is not None:
            raise RobotError(
                f"{self.path}: '{other.strip()[:40]}' stands behind the SAVE_CONFIG block, which Klipper then does not "
                "read; move it above the block"
            )
        return [line[len(SAVED) :].removeprefix(" ") for line in lines if line.startswith(SAVED)]

    def _read(self, path: Path, lines: list[str]) -> None:
        section, key = "", ""
        for line in lines:
            body = _COMMENT.sub("", line).rstrip()
            if not body.strip():
                continue
            if body.startswith("["):
                section, key = body.strip("[] \t"), ""
                if section.startswith("include "):
                    self._include(path.parent, section.removeprefix("include ").strip())
                    section = ""
            elif body[0] in " \t" and key:
                self._values[section, key] += "\n" + body.strip()
            else:
                ends = [i for i in (body.find(":"), body.find("=")) if i >= 0]
                if ends and section:
                    key = body[: min(ends)].strip().lower()
                    self._values[section, key] = body[min(ends) + 1 :].strip()

    def _include(self, folder: Path, pattern: str) -> None:
        # as Klipper does; what is not there may say nothing of the machine's measures, so only a missing option
        # complains
        try:
            found = sorted(folder.glob(pattern)) if not Path(pattern).is_absolute() else [Path(pattern)]
        except (ValueError, NotImplementedError, OSError):
            found = []
        found = [one for one in found if one.is_file()]
        if not found and not set("*?[") & set(pattern):
            self.absent.append(pattern)
        for one in found:
            self._files += 1
            if self._files > _MOST_FILES:
                raise RobotError(f"{self.path}: includes more than {_MOST_FILES} files; does one include itself?")
            self._read(one, text_of(one, "a Klipper configuration").splitlines())

    # -- asking --------------------------------------------------------------------------------------------

    def get(self, section: str, key: str) -> str | None:
        """The text of an option; None where it is not there."""
        return self._values.get((section, key))

    def sections(self, stem: str) -> list[str]:
        """Names of the sections ``[stem NAME]``, as they come."""
        return list(dict.fromkeys(s.removeprefix(f"{stem} ") for s, _ in self._values if s.startswith(f"{stem} ")))

    def numbered(self, section: str, stem: str) -> list[int]:
        """The numbers of the options ``stem0``, ``stem1``, …"""
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
                f"{self.path}: [{section}] gear_ratio: expected pairs like 80:16, found '{brief(text)}'"
            ) from None

    def number(self, section: str, key: str, default: float | None = None) -> float:
        """A number."""
        return float(self.numbers(section, key, 1, None if default is None else (default,))[0])

    def numbers(self, section: str, key: str, count: int, default: tuple[float, ...] | None = None) -> Floats:
        """So many numbers, separated by commas."""
        text = self.get(section, key)
        if text is None:
            if default is None:
                where = f" ({listed(self.absent)}, which it includes, is not there)" if self.absent else ""
                raise RobotError(f"{self.path}: [{section}] {key} is missing; expected {count} number(s){where}")
            return np.array(default)
        try:
            values = np.array([float(v) for v in text.split(",")])
        except ValueError:
            values = np.array([])
        if len(values) != count or not np.isfinite(values).all():
            raise RobotError(f"{self.path}: [{section}] {key}: expected {count} number(s), found '{brief(text)}'")
        return values


def text_of(path: Path, expected: str) -> str:
    """The text of a file, which was ``expected`` to be something. Raises :class:`~sherkit.errors.RobotError`."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise RobotError(f"{path}: is not a text file, expected {expected}") from None


# -- As a robot and a run --------------------------------------------------------------------------------------------

STEPPERS = ("stepper_a", "stepper_b", "stepper_c")
_FULL_STEPS = 200.0
_CALIBRATED = "DELTA_CALIBRATE"
#: Klipper rounds the spacing of a round mesh down to this, mm.
_ROUNDED = 0.01
#: A mesh that reaches so much farther than the radius that is set was probed with another, mm.
_ANOTHER = 1.0


def import_klipper(path: str | Path, plates: Mapping[str, float] | None = None) -> ImportedPrinter:
    """Reads a ``printer.cfg`` and what it includes; ``plates`` says by how many degrees, anticlockwise seen from above,
    the plate was turned under a mesh of that name.

    Raises :class:`~sherkit.errors.RobotError` for a printer that is no calibrated delta, and
    :class:`~sherkit.errors.MeasurementError` where it holds no probing.
    """
    config = KlipperConfig(Path(path))
    source = f"{config.path}:"
    robot = _printer(config)
    rows = ProbedRows(robot, str(config.path))
    per_mm = np.array([_steps_per_mm(config, s) for s in STEPPERS])

    def carriages(key: str) -> Floats:
        return robot.towers.top_mm - config.numbers("delta_calibrate", key, 3) / per_mm

    z_offset = -robot.target_offset_mm[2]
    for stem in ("height", "manual_height"):
        for k in config.numbered("delta_calibrate", stem):
            where = f"{source} [delta_calibrate] {stem}{k}_pos"
            # heights are of the nozzle; the tip of the probe is lower by its offset
            tip = config.number("delta_calibrate", f"{stem}{k}") - z_offset
            rows.touch_at(carriages(f"{stem}{k}_pos"), tip, stem, _CALIBRATED, where)
    for k in config.numbered("delta_calibrate", "distance"):
        ends = [carriages(f"distance{k}_pos{end}") for end in (1, 2)]
        rows.distance(ends[0], ends[1], config.number("delta_calibrate", f"distance{k}"))
    turned = dict(plates or {})
    names = config.sections("bed_mesh")
    if unknown := [name for name in turned if name not in names]:
        raise MeasurementError(f"{source} has no mesh '{unknown[0]}'; it has {listed(names) or 'none'}")
    for name in names:
        for x, y, z in _mesh(config, name):
            rows.touch((x, y), z, name, turned.get(name, 0.0), f"{source} [bed_mesh {name}]")
    return rows.found(
        "holds no probing; expected [delta_calibrate] heights or a [bed_mesh default] in the SAVE_CONFIG block (run "
        "DELTA_CALIBRATE or BED_MESH_CALIBRATE and SAVE_CONFIG)"
    )


def _printer(config: KlipperConfig) -> Printer:
    path = config.path
    kinematics = config.get("printer", "kinematics")
    if kinematics is None:
        raise RobotError(
            f"{path}: has no 'kinematics' in a section [printer]; expected the printer.cfg of a linear delta "
            "(Klipper), a config.g (RepRapFirmware), or what a terminal said to M503 and G29 (Marlin)"
        )
    if kinematics != "delta":
        raise RobotError(
            f"{path}: [printer] kinematics is not 'delta' but '{kinematics}'; only linear deltas can be imported"
        )
    radius = config.number("printer", "delta_radius")
    if radius <= 0:
        raise RobotError(f"{path}: [printer] delta_radius: expected a number above zero, found {radius:g}")
    # as in Klipper, the second and third tower are like the first where nothing else is said
    of_towers = {}
    for option in ("arm_length", "position_endstop"):
        first = config.number(STEPPERS[0], option)
        of_towers[option] = triple([first, *(config.number(s, option, first) for s in STEPPERS[1:])])
    arm = of_towers["arm_length"]
    angle = [config.number(s, "angle", a) for s, a in zip(STEPPERS, ANGLES, strict=True)]
    for stepper, length in zip(STEPPERS, arm, strict=True):
        if length <= radius:
            raise RobotError(f"{path}: [{stepper}] arm_length {length:g} is not longer than delta_radius {radius:g}")
    eddy = (f"probe_eddy_current {name}" for name in config.sections("probe_eddy_current"))
    probes = ("probe", "bltouch", "smart_effector", *eddy)
    probe = next((s for s in probes if config.get(s, "z_offset")), "probe")
    x, y, z = (config.number(probe, f"{axis}_offset", 0.0) for axis in "xyz")
    return Printer.with_towers(
        Towers(radius, triple(angle), arm, of_towers["position_endstop"]),
        target_offset_mm=(x, y, -z),
        workspace_radius_mm=config.number("printer", "print_radius", radius),
        firmware="klipper",
    )


def _steps_per_mm(config: KlipperConfig, stepper: str) -> float:
    if not any(config.numbered("delta_calibrate", stem) for stem in ("height", "manual_height", "distance")):
        return 1.0
    full = config.number(stepper, "full_steps_per_rotation", _FULL_STEPS)
    steps = full * config.number(stepper, "microsteps") * config.gear_ratio(stepper)
    travel = config.number(stepper, "rotation_distance")
    if min(steps, travel) <= 0:
        raise RobotError(f"{config.path}: [{stepper}] {steps:g} steps move {travel:g} mm; expected more than zero")
    return steps / travel


def _mesh(config: KlipperConfig, name: str) -> list[tuple[float, float, float]]:
    """Probed points of a saved mesh, without the copies with which the file of a round one is filled up."""
    section = f"bed_mesh {name}"
    text = config.get(section, "points")
    if text is None:
        return []
    try:
        z = np.array([[float(v) for v in line.split(",")] for line in text.splitlines() if line.strip()])
    except ValueError:
        z = np.zeros(0)
    if z.ndim != 2 or z.size == 0 or not np.isfinite(z).all():
        raise MeasurementError(f"{config.path}: [{section}] points: expected rows of numbers, all of one length")
    low, high = ([config.number(section, f"{end}_{axis}") for axis in "xy"] for end in ("min", "max"))
    if not (low[0] < high[0] and low[1] < high[1]):
        raise MeasurementError(
            f"{config.path}: [{section}] min_x, max_x, min_y, max_y: expected a mesh from the smaller to the larger, "
            f"found {low[0]:g} to {high[0]:g} and {low[1]:g} to {high[1]:g}"
        )
    x, y = np.linspace(low[0], high[0], z.shape[1]), np.linspace(low[1], high[1], z.shape[0])
    # counted from the middle of the mesh
    away = np.hypot(x - 0.5 * (x[0] + x[-1]), (y - 0.5 * (y[0] + y[-1]))[:, None])
    wide, high = 0.5 * (x[-1] - x[0]), 0.5 * (y[-1] - y[0])
    probed = _within(config, away, max(wide, high)) & _probed(z, away, wide, high)
    return [(float(x[i]), float(y[j]), float(z[j, i])) for j, i in np.argwhere(probed)]


def _within(config: KlipperConfig, away: Floats, reach: float) -> Bools:
    """Which points (rows, columns) of a mesh, ``away`` from its middle, lie within the radius that the printer's bed
    has, where it has one: of a mesh that was saved with another grid the corners are copies, or interpolated, and no
    arm may reach them. A mesh that ``reach``-es farther is older than the radius."""
    if config.get("bed_mesh", "mesh_radius") is None:
        return np.ones(away.shape, dtype=bool)
    radius = config.number("bed_mesh", "mesh_radius")
    return (away <= radius + _ROUNDED * max(away.shape)) | (radius < reach - _ANOTHER)


def _probed(z: Floats, away: Floats, wide: float, high: float) -> Bools:
    """Which points (rows, columns) of a mesh, ``away`` from its middle, were probed.

    Of a round mesh Klipper probes those within its radius, which is half its extent but for rounding, and fills each
    row up with copies of its ends. Where what lies outside is no copy, the mesh is not round."""
    everything = np.ones(z.shape, dtype=bool)
    if z.shape[0] != z.shape[1] or z.shape[0] % 2 == 0 or not math.isclose(wide, high, abs_tol=0.1):
        return everything
    # rounded, the one may be larger: each row and column has its middle within
    inside = np.asarray(away <= max(wide, high) + _ROUNDED * (len(z) // 2))
    for row, within in zip(z, inside, strict=True):
        first, last = np.flatnonzero(within)[[0, -1]]
        if (row[:first] != row[first]).any() or (row[last + 1 :] != row[last]).any():
            return everything
    return inside
