"""Sentences on the effects of the planar arm: those that every robot has, and its own."""

from __future__ import annotations

from sherkit.model.effect import Effect, Sentences
from sherkit.model.sentences import catalogue_of

from .core import CATALOGUE

_OWN = {
    "droop": Sentences(
        physics="The arm's own weight tilts the shoulder, so the tip falls; the value is the fall at full reach.",
        residuals="Downwards, with the square of the distance from the shoulder.",
        remedy="Preload the bearing of the shoulder, or balance the arm.",
    ),
}

#: The effects by name, in the order of the chain.
PLANAR_CATALOGUE: dict[str, Effect] = catalogue_of(CATALOGUE, _OWN)
