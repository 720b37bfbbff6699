"""THE list of built-in kinds of robot. A new one is a folder beside those here, and a line."""

from __future__ import annotations

from ..model.kinds import register
from . import delta, serial, spherical

for kind in (delta.KIND, spherical.KIND, serial.KIND):
    register(kind)
