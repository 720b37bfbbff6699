"""Mistakes of the set-up, by their name: found before any physics is blamed."""

from .columns_alone import held, unread
from .mistakes import Mistake, set_up_mistakes

__all__ = ["Mistake", "held", "set_up_mistakes", "unread"]
