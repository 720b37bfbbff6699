"""A bench of known loads, with a convention of its own for what it calls depth and force."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .wide_fibres import Fibres
from .wide_rod import RoughRod, Touch
from .world import fibre_columns

Array = NDArray[np.float64]

#: Of the depth: height of the load above the unbent tip along the unbent axis, as it stands while it pushes; or length
#: of the shaft beyond the load. Of the force: its component across the clamp's axis; or across the shaft at the load.
DEPTHS, FORCES = ("axis", "arc"), ("across", "normal")

#: No operator bends a shaft further at the load, mm at size 1.
_FARTHEST_MM = 12.0
_CELL_MN, _CELL_RAD, _ZERO_MM, _DEFLECTION_MM, _ROUGHNESS = 0.3, np.deg2rad(0.5), 0.2, 0.01, 0.1


def applied(rng: np.random.Generator, rod: RoughRod, size: float, loads: int) -> tuple[Touch, Array]:
    """Loads as they truly are, and the way (n, 2) each pushes: 20 to 300 mN at 0.5 to 25 mm along the unbent axis."""
    depth = rng.uniform(0.5, 25.0, loads)
    reach = rod.length_mm - depth
    most = np.minimum(300.0, 3.0 * rod.stiffness_mn_mm2 * _FARTHEST_MM / reach**3) * size
    normal = 20.0 * size + (most - 20.0 * size) * rng.random(loads)
    angle = rng.uniform(0.0, 2 * np.pi, loads)
    touch = rod.at_axis(normal, depth, rng.uniform(-_ROUGHNESS, _ROUGHNESS, loads))
    if (touch.arc_mm <= 0.0).any():  # a load that would slip off the tip stands further up
        up = np.where(touch.arc_mm <= 0.0, 3.0, 0.0)
        touch = rod.at_axis(normal, depth + up, touch.friction)
    return touch, np.column_stack([np.cos(angle), np.sin(angle)])


def rows(
    rng: np.random.Generator, rod: RoughRod, glass: Fibres, *, depth: str, force: str, size: float, loads: int,
    unloaded: int,
) -> dict[str, Array]:  # fmt: skip
    """The table: loads, and between them rows of the untouched shaft whose force is exactly nothing."""
    touch, way = applied(rng, rod, size, loads)
    zero = np.clip(_ZERO_MM * rng.standard_normal(), -0.45, 0.45)
    turned = _CELL_RAD * rng.choice([-1.0, 1.0])
    cell = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
    read_depth = {"axis": rod.length_mm - touch.along_mm, "arc": touch.arc_mm}[depth]
    read_force = {"across": touch.pushed_mn, "normal": touch.normal_mn}[force][:, None] * (way @ cell.T)
    read_force = read_force + _CELL_MN * rng.standard_normal((loads, 2))

    n = loads + unloaded
    bent = np.zeros((n, 9))
    bent[:loads] = glass.bending(touch, way)
    warmth = glass.warmed(0.3 * np.sin(2 * np.pi * (np.arange(n) / n * rng.uniform(0.3, 1.0) + rng.random())))
    waves = glass.read(bent + warmth, rng.standard_normal((n, 9)))
    deflection = np.concatenate([touch.across_mm, np.zeros(unloaded)]) + _DEFLECTION_MM * rng.standard_normal(n)
    table = {
        "force_x_mn": np.concatenate([read_force[:, 0], np.zeros(unloaded)]),
        "force_y_mn": np.concatenate([read_force[:, 1], np.zeros(unloaded)]),
        "depth_mm": np.concatenate([read_depth, rng.uniform(0.5, 25.0, unloaded)]) + zero,
        "deflection_mm": deflection,
    }
    order = np.argsort(np.concatenate([np.arange(loads), np.linspace(0.0, loads, unloaded)]), kind="stable")
    return {k: v[order] for k, v in (table | fibre_columns(waves)).items()}
