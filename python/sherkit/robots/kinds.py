"""Makes the kinds of robot known that are installed: sherkit's own, a folder each beside this file, and those of other
packages.

Each is declared in the package's ``pyproject.toml``, under ``[project.entry-points."sherkit.robots"]``.
"""

from __future__ import annotations

from ..base.extensions import ROBOTS, brought_beside
from ..model.kinds import Kind, register

#: Where columns fit no robot, messages speak of the first.
_FIRST = ("delta", "spherical", "serial", "printer")

found = brought_beside((), ROBOTS, Kind)
for name in sorted(found, key=lambda one: _FIRST.index(one) if one in _FIRST else len(_FIRST)):
    register(found[name])
