"""What a firmware believes of a delta, and the files in which it keeps that and what it probed.

Conventions are those of ``klippy/kinematics/delta.py`` (Klipper), ``LinearDeltaKinematics.cpp`` (RepRapFirmware) and
``delta.cpp`` (Marlin), written down here again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Firmware:
    """Radius; angle, arm and end stop of each tower; the tilt (x, y) that RepRapFirmware gives the bed."""

    radius: float
    angle: tuple[float, float, float]
    arm: tuple[float, float, float]
    endstop: tuple[float, float, float]
    tilt: tuple[float, float] = (0.0, 0.0)

    @property
    def towers(self) -> Floats:
        """Feet of the towers (3, 2), mm."""
        return self.radius * np.stack([np.cos(np.deg2rad(self.angle)), np.sin(np.deg2rad(self.angle))], axis=1)

    @property
    def top(self) -> Floats:
        """Heights of the carriages (3,) at their end stops, mm."""
        return np.array(self.endstop) + np.sqrt(np.square(self.arm) - self.radius**2)

    def down(self, at: Floats) -> Floats:
        """How far (n, 3) the motors go down from the end stops for the nozzle at places (n, 3), mm."""
        flat = ((at[:, None, :2] - self.towers[None]) ** 2).sum(axis=2)
        z = at[:, 2] + at[:, :2] @ np.array(self.tilt)
        return self.top - z[:, None] - np.sqrt(np.square(self.arm) - flat)


def klipper_file(
    firmware: Firmware,
    meshes: Mapping[str, tuple[Floats, Floats, Floats]],
    *,
    offset: Sequence[float] = (0.0, 0.0, 0.0),
    heights: Sequence[tuple[float, Floats]] = (),
    distances: Sequence[tuple[float, Floats, Floats]] = (),
    print_radius: float = 130.0,
) -> str:
    """A ``printer.cfg``. ``meshes`` are x ticks, y ticks and heights (rows, columns), NaN where a round one was not
    probed; ``heights`` and ``distances`` give motor travels (3,), mm, at 80 steps per mm."""
    lines = ["[printer]", "kinematics: delta", f"print_radius: {print_radius}", ""]
    for name in "abc":
        lines += [f"[stepper_{name}]", "microsteps: 16", "rotation_distance: 40", ""]
    lines += ["[probe]", *(f"{axis}_offset: {v}" for axis, v in zip("xyz", offset, strict=True)), ""]
    block = ["[printer]", f"delta_radius = {firmware.radius:.6f}", ""]
    for k, name in enumerate("abc"):
        block += [f"[stepper_{name}]", f"angle = {firmware.angle[k]:.6f}", f"arm_length = {firmware.arm[k]:.6f}"]
        block += [f"position_endstop = {firmware.endstop[k]:.6f}", ""]
    for name, (x, y, z) in meshes.items():
        block += [f"[bed_mesh {name}]", "version = 1", "points ="]
        block += ["\t  " + ", ".join(f"{v:.6f}" for v in _filled(row)) for row in z]
        block += [f"x_count = {len(x)}", f"y_count = {len(y)}", f"min_x = {x[0]:.2f}", f"max_x = {x[-1]:.2f}"]
        block += [f"min_y = {y[0]:.2f}", f"max_y = {y[-1]:.2f}", ""]
    if heights or distances:
        block.append("[delta_calibrate]")
    for k, (height, down) in enumerate(heights):
        block += [f"height{k} = {height}", f"height{k}_pos = {_steps(down)}"]
    for k, (length, start, end) in enumerate(distances):
        block += [
            f"distance{k} = {length:.2f}",
            f"distance{k}_pos1 = {_steps(start)}",
            f"distance{k}_pos2 = {_steps(end)}",
        ]
    saved = ["<---------------------- SAVE_CONFIG ---------------------->", "DO NOT EDIT THIS BLOCK", "", *block]
    return "\n".join(lines) + "\n" + "".join(f"#*# {line}".rstrip() + "\n" for line in saved)


def _steps(down: Floats) -> str:
    return ",".join(f"{80.0 * v:.3f}" for v in down)


def _filled(row: Floats) -> Floats:
    """Klipper fills a row of a round mesh up with copies of its ends."""
    known = np.flatnonzero(np.isfinite(row))
    return row[np.clip(np.arange(len(row)), known[0], known[-1])]


def duet_files(
    firmware: Firmware, mesh: tuple[Floats, Floats, Floats], *, offset: Sequence[float] = (0.0, 0.0, 0.0)
) -> tuple[str, str]:
    """A ``config.g`` and a ``heightmap.csv`` of RepRapFirmware: H is the mean end stop, M666 what each has above it."""
    mean = float(np.mean(firmware.endstop))
    trims = [a - n for a, n in zip(firmware.angle, (210.0, 330.0, 90.0), strict=True)]
    config = [
        "; a delta",
        "M665 R{:.6f} L{} B130.0 H{:.6f} X{:.6f} Y{:.6f} Z{:.6f}".format(
            firmware.radius, ":".join(f"{a:.6f}" for a in firmware.arm), mean, *trims
        ),
        "M666 X{:.6f} Y{:.6f} Z{:.6f} A{:.6f} B{:.6f} ; end stops, tilt in percent".format(
            *(e - mean for e in firmware.endstop), 100 * firmware.tilt[0], 100 * firmware.tilt[1]
        ),
        f"G31 P500 X{offset[0]} Y{offset[1]} Z{offset[2]}",
    ]
    at_x, at_y, heights = mesh
    lines = [
        "RepRapFirmware height map file v2 generated at 2026-01-01 12:00, min error -0.1, max error 0.2",
        "axis0,axis1,min0,max0,min1,max1,radius,spacing0,spacing1,num0,num1",
        f"X,Y,{at_x[0]:.2f},{at_x[-1]:.2f},{at_y[0]:.2f},{at_y[-1]:.2f},{at_x[-1]:.2f},"
        f"{at_x[1] - at_x[0]:.2f},{at_y[1] - at_y[0]:.2f},{len(at_x)},{len(at_y)}",
    ]
    lines += [",".join(f"{v:7.3f}" if np.isfinite(v) else "      0" for v in row) for row in heights]
    return "\n".join(config) + "\n", "\n".join(lines) + "\n"


def marlin_file(firmware: Firmware, mesh: tuple[Floats, Floats, Floats], *, offset: Sequence[float] = (0, 0, 0)) -> str:
    """What Marlin prints for M503 and G29: end stops are M665 H minus M666, none of which is above zero."""
    height = min(firmware.endstop)
    arm = float(np.mean(firmware.arm))
    out = [
        "echo:; Endstop adjustment:",
        "echo:  M666 X{:.4f} Y{:.4f} Z{:.4f}".format(*(height - e for e in firmware.endstop)),
        "echo:; Delta settings: L<diagonal rod> R<radius> H<height>",
        "echo:  M665 L{:.4f} R{:.4f} H{:.4f} S100.00 X{:.4f} Y{:.4f} Z{:.4f} A{:.4f} B{:.4f} C{:.4f}".format(
            arm, firmware.radius, height, *(a - n for a, n in zip(firmware.angle, (210.0, 330.0, 90.0), strict=True)),
            *(a - arm for a in firmware.arm),
        ),
        f"echo:  M851 X{offset[0]:.2f} Y{offset[1]:.2f} Z{-offset[2]:.2f} ; (mm)",
    ]  # fmt: skip
    x, y, z = mesh
    out += [f">>> G29 L{x[0]:.2f} R{x[-1]:.2f} F{y[0]:.2f} B{y[-1]:.2f}", "Bilinear Leveling Grid:"]
    out.append("      " + " ".join(f"{k:>6}" for k in range(len(x))))
    for k, row in enumerate(z):
        out.append(f"{k:>2} " + " ".join(f"{v:+.3f}" if np.isfinite(v) else "======" for v in row))
    return "\n".join(out) + "\nok\n"
