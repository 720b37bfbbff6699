"""The bed that is probed: its own shape, which turns with the plate, and the zero of each probing."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from ...base.types import Bools, Floats
from ...model.effect import Effect, Parameter, effect
from .robot import PLATE, PROBING

#: Shapes are named by their height this far from the middle, mm.
SPAN_MM = 100.0
#: Smooth shapes of a plate: order in the distance from the middle, and how many lobes they have around it. A constant
#: is the zero of the probing.
_SHAPES = ((1, 1), (2, 0), (2, 2), (3, 1), (3, 3), (4, 0), (4, 2), (4, 4))
_NAMES = tuple(
    f"{kind}_{order}_{lobes}" if lobes else f"ring_{order}"
    for order, lobes in _SHAPES
    for kind in (("cosine", "sine") if lobes else ("",))
)


def shapes_at(xy: Floats, plate_deg: Floats | float) -> Floats:
    """The shapes (n, 14), 1 at their highest on a ring of :data:`SPAN_MM`, at places (n, 2), mm, of the machine under
    which the plate lies turned by ``plate_deg`` (n,)."""
    turn = np.exp(-1j * np.deg2rad(plate_deg))
    at = (xy[:, 0] + 1j * xy[:, 1]) * turn / SPAN_MM
    out = []
    for order, lobes in _SHAPES:
        wave = at**lobes * np.abs(at) ** (order - lobes)
        out += [wave.real, wave.imag] if lobes else [wave.real]
    return np.stack(out, axis=1)


def _columns(rows: Any, p: SimpleNamespace) -> Floats:
    """What the reading loses where the bed is higher (n, 1, 14); distances are none of the bed's."""
    del p
    return -np.where(rows.is_distance[:, None], 0.0, shapes_at(rows.position[:, :2], rows[PLATE]))[:, None, :]


@effect(
    at="sensor",
    parameters=dict.fromkeys(_NAMES, ("mm", 0.1)),
    needs=(PLATE,),
    physics="The plate that is probed is not flat: bent, bowed or twisted, smoothly; it turns with the plate.",
    remedy="Lay a straightedge and a feeler gauge across the plate, or turn it and probe again: what turns with it "
    "is its own. A mesh in the firmware covers it for printing.",
    derivative=_columns,
)
def bed_shape(rows: Any, p: SimpleNamespace) -> Floats:
    """Heights above a plate that is not flat."""
    return _columns(rows, p)[:, 0] @ np.array([getattr(p, name) for name in _NAMES])[:, None]


def _zeros(rows: Any, count: int) -> Floats:
    """Which of the probings behind the first each row (n, 1, count) is from; distances have no zero."""
    of: Bools = rows[PROBING][:, None] == np.arange(1, count + 1)
    return np.where(rows.is_distance[:, None], 0.0, of)[:, None, :]


def _by_zeros(rows: Any, p: SimpleNamespace) -> Floats:
    return _zeros(rows, len(vars(p)))


@effect(
    at="sensor",
    parameters={"zero_1": ("mm", 1.0)},
    needs=(PROBING,),
    physics="The zero of a probe is set anew, or moves with the temperature, between one probing and the next.",
    remedy="None needed.",
    derivative=_by_zeros,
)
def probing_zero(rows: Any, p: SimpleNamespace) -> Floats:
    """The zero of each probing behind the first."""
    return _by_zeros(rows, p)[:, 0] @ np.array(list(vars(p).values()))[:, None]


def zeros_of(probings: int) -> Effect:
    """The zeros of so many probings: that of the first is in the end stops."""
    one = probing_zero.parameters[0]
    made = tuple(Parameter(f"zero_{k}", f"zero_{k}", one.unit, one.size) for k in range(1, probings))
    return replace(probing_zero, parameters=made)
