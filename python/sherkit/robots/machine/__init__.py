"""Any machine that its owner describes by one function; it stands beside the built-in robots, not among them."""

from .machine import Machine

__all__ = ["Machine"]
