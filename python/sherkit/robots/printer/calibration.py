"""The calibrated printer: where its nozzle is, and what of that its firmware can hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import ClassVar, cast

import numpy as np
import scipy

from ...base import linalg
from ...base.types import Floats
from ...data import Measurements
from ...errors import RobotError
from ...fit.identify import Fit, identify
from ...model.chain import ChainModel
from ...model.kinds import Robot
from ..calibrated import Note
from ..calibration_run import CalibrationRun
from ..delta.calibration import DeltaCalibration, DeltaPart
from .klipper import SAVED, STEPPERS, KlipperConfig, text_of
from .model import PrinterModel
from .robot import ANGLES, FIRMWARES, PLATE, PROBED, PROBING, Printer, Towers


@dataclass(frozen=True, eq=False)
class PrinterPart(DeltaPart):
    """One identified model of a printer."""

    @classmethod
    def of(cls, run: CalibrationRun) -> PrinterPart:
        """The part that a run gives: heights say how far off it is, the same on every axis."""
        fit = run.fit
        left, scatter = run.left_alike(np.isfinite(run.held_out), run.held_out)
        tips = fit.model.tips(fit.data)[~fit.data.between_places & ~fit.data.outlier]
        # the printer carries its probe: what it reads is of the base's own axes
        made = cls.identified(fit, 3, uncorrected_covariance=left, correction=None, sensor_turn=np.eye(3),
                              sensor_origin_mm=np.zeros(3))  # fmt: skip
        return made.leaving(left, scatter, tips)

    def model(self, robot: Robot) -> ChainModel:
        """The model that was identified, without the zeros of its probings."""
        return super().model(replace(cast(Printer, robot), probings=()))


@dataclass(frozen=True, eq=False, repr=False)
class PrinterCalibration(DeltaCalibration):
    """A calibrated printer, as :class:`~sherkit.robots.delta.DeltaCalibration`. Positions are those that its firmware
    counts, from the bed; the plate is none of it."""

    part: ClassVar = PrinterPart
    frame: ClassVar = "bed"
    no_other: ClassVar = "a probe that the printer carries has no other; leave the frame out"

    robot: Printer

    @classmethod
    def of(cls, whole: CalibrationRun, local: CalibrationRun | None = None) -> PrinterCalibration:
        """From a run of heights and distances."""
        del local
        return cls(robot=whole.fit.model.robot, whole=PrinterPart.of(whole))

    @classmethod
    def from_runs(cls, whole: CalibrationRun, local: CalibrationRun | None = None) -> PrinterCalibration:
        """:meth:`of` these runs: what a probe does not show of an effect a printer's owner cannot ask."""
        return cls.of(whole, local)

    @property
    def frames(self) -> tuple[str, ...]:
        """That of the bed."""
        return (self.frame,)

    def spread(
        self, coordinates: Floats, joints: Floats, *, frame: str | None = None, temperature_c: float | None = None,
        **load: float,
    ) -> Floats:  # fmt: skip
        """Covariance (n, 3, 3), mm², of the height alone: along the plate a probe sees nothing, and where on it a print
        stands is no error."""
        out = super().spread(coordinates, joints, frame=frame, temperature_c=temperature_c, **load)
        out[:, :2] = out[:, :, :2] = 0.0
        return out

    def notes(self) -> Sequence[Note]:
        """Of what it is known how far it is off."""
        said = "of the height over the plate; how true the sizes of prints are callipers tell"
        return (Note("predicted accuracy", said, {}),)

    @classmethod
    def may_correct(cls, fit: Fit) -> bool:
        """A firmware has a mesh for that."""
        del fit
        return False


# -- Back to the printer ------------------------------------------------------------------------------------------

#: Rings and places on each from which a firmware's numbers are chosen, over the printed area.
_RINGS, _AROUND = 6, 18
#: A combination of numbers is told where chance leaves it within its deviations so often: three of them.
_SURE = 0.99865
#: Numbers of a firmware that differ by less are the same: its file has six decimals.
_SAME = 2e-6
_BEGINS = "<---------------------- SAVE_CONFIG ---------------------->"
_WARNING = "DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated."


@dataclass(frozen=True)
class FirmwareFit:
    """What a firmware can hold of a machine, and the height errors over the bed that are left of what it cannot, mm."""

    towers: Towers
    rms_mm: float
    largest_mm: float
    #: The towers as errors of the geometry by name, of the printer as its firmware has it now.
    errors: Mapping[str, float]


def held(robot: Printer, errors: Mapping[str, float]) -> FirmwareFit:
    """The firmware's numbers for a printer with these errors by name: geometry as it is; of effects that no firmware
    holds, leans, belts and unequal rods, as much as its geometry can take over the bed."""
    plain = PrinterModel(replace(robot, probings=()))
    beyond = {name.partition(".")[0] for name, value in errors.items() if "." in name and value}
    known = [e for e in plain.catalogue.values() if e.name in beyond and e.function is None]
    full = reduce(lambda model, effect: model.with_effect(effect), known, plain)
    values, start = (np.array([errors.get(p.name, 0.0) for p in one.parameters]) for one in (full, plain))
    if not known:
        return FirmwareFit(towers_of(robot, errors), 0.0, 0.0, errors)
    # what the machine does where it is sent over the bed, heights alone: that is what a probe would see
    radius = robot.workspace_radius_mm or 0.8 * robot.towers.radius_mm
    rings = np.linspace(0.0, radius, _RINGS)[1:]
    turn = np.linspace(0.0, 2 * np.pi, _AROUND, endpoint=False)
    xy = np.array([(0.0, 0.0), *((r * np.cos(t), r * np.sin(t)) for r in rings for t in turn)])
    sent = robot.inverse_batch(np.column_stack([xy, robot.plane_mm(xy)]))
    nothing = np.zeros(sent.reached.sum())
    plan = Measurements.planned(sent.values[sent.reached], PROBED, "bed", **dict.fromkeys((PLATE, PROBING), nothing))
    plan = plan.with_readings(full.predict(plan, values))
    fit = identify(plain, plan, start=start)
    left = fit.residuals
    return FirmwareFit(
        towers_of(robot, fit.by_name), float(np.sqrt(np.mean(left**2))), float(np.abs(left).max()), fit.by_name
    )


def told(fit: Fit) -> dict[str, float]:
    """Values by name, those of the geometry zero along each combination that the readings do not tell from none: a
    dozen rough distances beside a plate that may be bent leave millimetres of an arm open, and numbers that are no
    better than those there are stay as they are.

    Combinations are those that the readings tell independently of each other, in plausible sizes.
    """
    own = [k for k, p in enumerate(fit.parameters) if "." not in p.name]
    size = np.array([fit.parameters[k].size for k in own])
    squares, axes = linalg.eigh(fit.covariance[np.ix_(own, own)] / np.outer(size, size))
    along = axes.T @ (fit.values[own] / size)
    free = max(int(fit.data.used.sum()) - fit.rank, 1)
    sure = np.abs(along) > scipy.special.stdtrit(free, _SURE) * np.sqrt(squares.clip(0.0))
    values = fit.values.copy()
    values[own] = size * (axes @ np.where(sure, along, 0.0))
    return dict(zip(fit.by_name, values.tolist(), strict=True))


def towers_of(robot: Printer, errors: Mapping[str, float]) -> Towers:
    """The firmware's numbers for errors of the geometry, exactly: any three upright towers have a circle through
    them."""

    off = np.array([errors.get(name, 0.0) for name in robot.parameter_names])
    radius, angle, tops, arms, joint, at = (robot.geometry + off).reshape(3, -1).T
    foot = radius * np.exp(1j * angle) - joint * np.exp(1j * at)
    feet = np.stack([foot.real, foot.imag], axis=1)
    return Towers.through(feet, arms, robot.towers.top_mm + tops, robot.base_angle_deg[2])


# -- files ---------------------------------------------------------------------------------------------------


def klipper_block(towers: Towers) -> dict[tuple[str, str], str]:
    """The options of Klipper by section and name, with the digits that its own ``save_state`` writes."""
    out = {("printer", "delta_radius"): f"{towers.radius_mm:.6f}"}
    for k, stepper in enumerate(STEPPERS):
        out[stepper, "angle"] = f"{towers.angle_deg[k]:.6f}"
        out[stepper, "arm_length"] = f"{towers.arm_mm[k]:.6f}"
        out[stepper, "position_endstop"] = f"{towers.endstop_mm[k]:.6f}"
    return out


def klipper_config(path: Path, towers: Towers) -> str:
    """The text of a ``printer.cfg`` with these numbers in its SAVE_CONFIG block. As SAVE_CONFIG does, the same options
    above the block become comments. Where the numbers change, saved meshes go, as ``BED_MESH_PROFILE REMOVE`` takes
    them out: they hold what was wrong with the old ones, and would bring it back with the other sign.

    Raises :class:`~sherkit.errors.RobotError` where one of them stands in an included file, which SAVE_CONFIG refuses.
    """
    config = KlipperConfig(path)
    lines = text_of(path, "a Klipper printer.cfg").splitlines()
    options = klipper_block(towers)
    if any(_differs(config.get(*where), new) for where, new in options.items()):
        lines = _without_meshes(lines)
    above = [line for line in lines if not line.startswith(SAVED)]
    saved = [line[len(SAVED) :].removeprefix(" ") for line in lines if line.startswith(SAVED)]
    above, _ = _set(above, options, comment=True)
    while above and not above[-1].strip():
        above.pop()
    body, missing = _set(saved or [_BEGINS, _WARNING, ""], options, comment=False)
    for section in dict.fromkeys(section for section, _ in missing):
        own = [f"{key} = {options[section, key]}" for s, key in missing if s == section]
        heads = [k for k, line in enumerate(body) if line.strip() == f"[{section}]"]
        if heads:
            body[heads[-1] + 1 : heads[-1] + 1] = own
        else:
            body += ["", f"[{section}]", *own]
    return "\n".join([*above, "", *(f"{SAVED} {line}".rstrip() for line in body)]) + "\n"


def _differs(old: str | None, new: str) -> bool:
    try:
        return old is None or abs(float(old) - float(new)) > _SAME
    except ValueError:
        return True


def _without_meshes(lines: list[str]) -> list[str]:
    """Lines without the sections of saved meshes."""
    out, inside = [], False
    for line in lines:
        body = line.removeprefix(SAVED).strip()
        if body.startswith("[") or not line.startswith(SAVED):
            inside = line.startswith(SAVED) and body.startswith("[bed_mesh ")
        if not inside:
            out.append(line)
    return out


def _set(
    lines: list[str], options: Mapping[tuple[str, str], str], *, comment: bool
) -> tuple[list[str], list[tuple[str, str]]]:
    """Lines with these options set, or turned into comments; and the options that none of them holds."""
    out, section, left = [], "", dict(options)
    for line in lines:
        body = line.strip()
        if body.startswith("["):
            section = body.split("]")[0].strip("[ \t")
        ends = [i for i in (line.find(":"), line.find("=")) if i >= 0]
        key = line[: min(ends)].strip().lower() if ends and line[:1] not in " \t#;" else ""
        if (section, key) not in options:
            out.append(line)
        elif comment:
            out.append(f"#{line}")
        elif (section, key) in left:
            out.append(f"{key} = {left.pop((section, key))}")
    return out, list(left)


def commands(robot: Printer, towers: Towers) -> list[str]:
    """M665 and M666 of RepRapFirmware or Marlin with these numbers.

    RepRapFirmware's end stops are H plus M666, whose mean is zero; Marlin's are H minus M666, none of which is above
    zero. The tilt of a RepRapFirmware bed stays as it is. Raises :class:`~sherkit.errors.RobotError` for Klipper, which
    has no such commands.
    """
    x, y, z = (a - nominal for a, nominal in zip(towers.angle_deg, ANGLES, strict=True))
    ends, arms = np.array(towers.endstop_mm), towers.arm_mm
    if robot.firmware == "reprapfirmware":
        height = float(ends.mean())
        more = f" B{robot.workspace_radius_mm:.1f}" if robot.workspace_radius_mm else ""
        tilt = f" A{100 * robot.tilt[0]:.4f} B{100 * robot.tilt[1]:.4f}" if any(robot.tilt) else ""
        rods = ":".join(f"{a:.4f}" for a in arms)
        return [
            f"M665 L{rods} R{towers.radius_mm:.4f} H{height:.4f}{more} X{x:.4f} Y{y:.4f} Z{z:.4f}",
            "M666 X{:.4f} Y{:.4f} Z{:.4f}".format(*(ends - height)) + tilt,
        ]
    if robot.firmware == "marlin":
        height, arm = float(ends.min()), float(np.mean(arms))
        trims = " ".join(f"{n}{a - arm:.4f}" for n, a in zip("ABC", arms, strict=True))
        return [
            f"M665 L{arm:.4f} R{towers.radius_mm:.4f} H{height:.4f} X{x:.4f} Y{y:.4f} Z{z:.4f} {trims}",
            "M666 X{:.4f} Y{:.4f} Z{:.4f}".format(*(height - ends)),
            "M500",
        ]
    raise RobotError(f"a printer with {robot.firmware} has no M665; its numbers stand in printer.cfg ({FIRMWARES[0]})")
