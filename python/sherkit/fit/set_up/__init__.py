"""Mistakes of the set-up, by their name: found before any physics is blamed."""

from .mistakes import Mistake, set_up_mistakes

__all__ = ["Mistake", "set_up_mistakes"]
