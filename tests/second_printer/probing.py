"""Probing a plate as a firmware does: down from above until the tip touches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .firmware import Firmware
from .machine import Machine
from .plate import Plate

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Probe:
    """Where the tip is from the nozzle, as the firmware has it; by how much it really is elsewhere; its scatter, mm."""

    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wrong: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise: float = 0.006


def touched(
    machine: Machine, firmware: Firmware, plate: Plate, probe: Probe, at: Floats, rng: np.random.Generator | None = None
) -> tuple[Floats, Floats]:
    """At which height (n,) above its zero the firmware believes the tip to be when it touches the plate at places (n,
    2) of the tip, and how far down (n, 3) the motors then are."""
    nozzle = at - np.array(probe.offset[:2])
    tip = np.array([probe.offset[0], probe.offset[1], -probe.offset[2]]) + np.array(probe.wrong)
    z = np.full(len(at), probe.offset[2])
    for _ in range(8):
        down = firmware.down(np.column_stack([nozzle, z]))
        where = machine.tip(down, tip)
        z = z - (where[:, 2] - plate.at(where[:, :2]))
    if rng is not None:
        z = z + rng.normal(0.0, probe.noise, len(z))
    return z - probe.offset[2], firmware.down(np.column_stack([nozzle, z]))


def mesh_points(radius: float, count: int) -> tuple[Floats, Floats]:
    """Ticks (count,) of a round mesh, whose spacing Klipper rounds down to hundredths, and which are in it."""
    ticks = np.floor(2 * radius / (count - 1) * 100) / 100 * (np.arange(count) - count // 2)
    return ticks, np.hypot(ticks[:, None], ticks[None, :]) <= radius + 1e-9
