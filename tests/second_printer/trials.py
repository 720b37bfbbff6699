"""Printers with one fault each, and what they write: what a count of verdicts is made of."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .firmware import Firmware, duet_files, klipper_file, marlin_file
from .machine import Machine
from .plate import Plate
from .probing import Probe, mesh_points, touched

Floats = NDArray[np.float64]

#: Faults, and what is to be named for each; nothing where better numbers are the cure, or where probing shows nothing.
FAULTS = {
    "none": "", "one tower leans": "rail_lean", "frame twisted": "rail_lean", "arm lengths": "", "wrong radius": "",
    "bent plate": "bed_shape", "slack belt": "", "tilted probe": "", "tilting effector": "rod_mismatch",
}  # fmt: skip


@dataclass(frozen=True)
class Trial:
    """A printer with a fault, its plate and probe, and the radius and points across of its mesh."""

    fault: str
    firmware: Firmware
    machine: Machine
    plate: Plate
    probe: Probe
    radius: float
    count: int

    @classmethod
    def of(cls, fault: str, seed: int, number: int) -> Trial:
        """A printer of usual errors in its numbers, and one fault."""
        rng = np.random.default_rng([seed, number])
        size = rng.uniform(100, 165)
        arm = size * rng.uniform(2.05, 2.35)
        firmware = Firmware(size, (210.0, 330.0, 90.0), (arm,) * 3, (400.0,) * 3)
        machine = Machine.of(
            size + rng.normal(0, 0.2, 3),
            np.array(firmware.angle) + rng.normal(0, 0.1, 3),
            arm + rng.normal(0, 0.1, 3),
            firmware.top + rng.normal(0, 0.2, 3),
        )
        machine = replace(machine, effector=rng.uniform(25, 40), spacing=rng.uniform(40, 65))
        beside = (float(rng.uniform(-25, 25)), float(rng.uniform(15, 30)), 1.5)
        probe = Probe(beside if rng.random() < 0.5 else (0.0, 0.0, 16.0), noise=rng.uniform(0.004, 0.010))
        plate, side = Plate.flat(), rng.choice([-1.0, 1.0])
        lean = np.zeros((3, 2))
        if fault == "one tower leans":
            turn = rng.uniform(0, 2 * np.pi)
            lean[rng.integers(3)] = np.deg2rad(rng.uniform(0.3, 0.8)) * np.array([np.cos(turn), np.sin(turn)])
        elif fault == "frame twisted":
            lean[:, 1] = side * np.deg2rad(rng.uniform(0.3, 0.8))
        elif fault == "arm lengths":
            machine = replace(machine, arm=machine.arm + rng.uniform(-1, 1, (3, 1)))
        elif fault == "wrong radius":
            machine = replace(machine, foot=machine.foot * (1 + side * rng.uniform(0.003, 0.01)))
        elif fault == "bent plate":
            plate = Plate.bent(int(rng.integers(1 << 30)), 0.85 * size, rng.uniform(0.06, 0.2))
        elif fault == "slack belt":
            # whoever probes comes from above: the slack is the same in each touch
            machine = replace(machine, slack=rng.uniform(0.05, 0.3, 3))
        elif fault == "tilted probe":
            probe = replace(probe, wrong=(rng.normal(0, 1), rng.normal(0, 1), rng.normal(0, 0.1)))
        elif fault == "tilting effector":
            apart = rng.uniform(0.2, 0.6, (3, 1)) * rng.choice([-1.0, 1.0], (3, 1))
            machine = replace(machine, arm=machine.arm + apart * np.array([0.5, -0.5]))
            probe = replace(probe, offset=beside)
        machine = replace(machine, lean=lean)
        # no further out than the arms of all towers reach with the probe
        reached = 0.97 * machine.arm.min() - machine.foot.max() - np.hypot(*probe.offset[:2])
        return cls(fault, firmware, machine, plate, probe, min(0.85 * size, reached), int(rng.choice([7, 9])))

    def mesh(self, turned_deg: float, rng: np.random.Generator | None) -> tuple[Floats, Floats, Floats]:
        """Ticks and heights of a round mesh, NaN where it was not probed; without noise where ``rng`` is None."""
        ticks, inside = mesh_points(self.radius, self.count)
        x, y = np.meshgrid(ticks, ticks)
        z = np.full(inside.shape, np.nan)
        at = np.column_stack([x[inside], y[inside]])
        z[inside] = touched(self.machine, self.firmware, self.plate.turned(turned_deg), self.probe, at, rng)[0]
        return ticks, ticks, z

    def write(self, folder: Path, firmware: str, turned: tuple[float, ...], seed: int | None) -> list[Path]:
        """The files of a firmware after a mesh with the plate turned by each of these; the configuration first."""
        rng = None if seed is None else np.random.default_rng(seed)
        meshes = {f"at{turn:g}": self.mesh(turn, rng) for turn in turned}
        if firmware == "klipper":
            path = folder / "printer.cfg"
            path.write_text(klipper_file(self.firmware, meshes, offset=self.probe.offset))
            return [path]
        if firmware == "marlin":
            path = folder / "marlin.txt"
            texts = [marlin_file(self.firmware, mesh, offset=self.probe.offset) for mesh in meshes.values()]
            path.write_text("\n".join(texts))
            return [path]
        out = []
        for name, mesh in meshes.items():
            config, heights = duet_files(self.firmware, mesh, offset=self.probe.offset)
            (folder / "config.g").write_text(config)
            out.append(folder / f"{name}.csv")
            out[-1].write_text(heights)
        return [folder / "config.g", *out]
