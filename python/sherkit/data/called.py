"""What people call the readings of joints and of instruments: words by which a mapping of columns is proposed."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

#: Of what was driven to, in small letters.
DRIVEN = frozenset((
    "target", "soll", "sollwert", "sollposition", "nominal", "command", "commanded", "cmd", "set", "setpoint", "enc",
    "encoder", "axis", "achse", "joint", "gelenk", "motor", "angle", "winkel", "drive", "geber", "consigne", "axe",
))  # fmt: skip
#: Of what an instrument showed there.
READ = frozenset((
    "measured", "meas", "gemessen", "ist", "istwert", "actual", "reading", "laser", "tracker", "smr", "indicated",
    "observed", "interferometer", "mesure", "messwert", "gauge", "reflector", "reflektor",
))  # fmt: skip
#: Of the difference of the two, which is neither.
_DIFFERENCE = frozenset((
    "error", "fehler", "deviation", "abweichung", "diff", "difference", "differenz", "residual", "err", "erreur",
    "delta",
))  # fmt: skip


def _words(name: str) -> set[str]:
    return set(re.findall(r"[^\W\d_]+", name.lower()))


def in_order(
    names: Sequence[str], wanted: Sequence[str], words: frozenset[str], fits: Callable[[str, str], bool]
) -> Mapping[str, str]:
    """Names of the file by the ``wanted`` ones, in the order of both, where as many have one of these ``words`` and a
    unit that fits; empty where not."""
    others = READ if words is DRIVEN else frozenset[str]()
    found = [
        name for name in names
        if _words(name) & words and not _words(name) & (_DIFFERENCE | others) and any(fits(name, one) for one in wanted)
    ]  # fmt: skip
    if not wanted or len(found) != len(wanted) or not all(map(fits, found, wanted)):
        return {}
    return dict(zip(wanted, found, strict=True))


def is_difference(name: str) -> bool:
    """Whether a column is called the difference of what was read and what was driven to."""
    return bool(_words(name) & _DIFFERENCE)
