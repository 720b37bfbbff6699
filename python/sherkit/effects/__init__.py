"""The catalogue of physical effects, by link of the measurement chain, and users' own."""

from .catalogue import CATALOGUE
from .effect import Effect, check_user_effect, effect

__all__ = ["CATALOGUE", "Effect", "check_user_effect", "effect"]
