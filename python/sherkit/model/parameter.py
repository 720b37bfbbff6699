"""Parameters of a model: what is identified, in the field's names, with units and plausible sizes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Parameter:
    """One identifiable quantity. Its value is a deviation from the drawing, zero where the drawing is right.

    ``size`` is a plausible size in ``unit``: it weighs directions that no measurement observes and, where
    priors are asked for, is the standard deviation of the prior. ``lever_mm`` turns the unit into the millimetres
    it moves in this robot, so that directions of mixed units can be compared.
    """

    name: str
    symbol: str
    unit: str
    size: float
    lever_mm: float = 1.0
