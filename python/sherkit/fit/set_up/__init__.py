"""Mistakes of the set-up, by their name: found before any physics is blamed."""

from .mistakes import Mistake, held, set_up_mistakes, unread

__all__ = ["Mistake", "held", "set_up_mistakes", "unread"]
