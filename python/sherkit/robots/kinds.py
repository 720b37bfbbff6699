"""THE list of built-in kinds of robot. A new one is a folder beside those here, and a line."""

from __future__ import annotations

from importlib import import_module

from ..model.kinds import register

# one after the other: where columns fit none, messages speak of the first
for name in ("delta", "spherical", "serial", "printer"):
    register(import_module(f".{name}", __package__).KIND)
