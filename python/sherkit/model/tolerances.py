"""How well a drawing is known, as a robot's file states it: ``[tolerances]`` of classes of parameters, ``[known]`` of
single ones that somebody has measured.

    [tolerances]
    rod_length = "0.05 mm"          # of every rod, one standard deviation
    base_angle = "0.1 deg"

    [known]
    rod_length_2 = "120.00 ± 0.01 mm"

Both take the place of the size that the robot's kind takes for plausible. What is ``[known]`` is a measurement besides:
one more row of every fit, as the sensor's pose is where its deviations are stated.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ..base.figures import brief, listed, nearest
from ..base.types import Floats
from ..data.called import factor
from ..data.toml import Table
from ..errors import RobotError
from .effect import Parameter
from .sensor_pose import POSE

# -- Relations ---------------------------------------------------------------------------------------------------------
# What is known of several parameters at once: how far two places are from one another.

#: Names of the parameters that move a place along x, y and z.
Names = tuple[str, str, str]


@dataclass(frozen=True)
class Apart:
    """Two places (2, 3), mm, as drawn, each moved by three parameters, are ``mm`` ± ``sd_mm`` from one another."""

    names: tuple[Names, Names]
    places_mm: Floats
    mm: float
    sd_mm: float

    def row(self, names: list[str], values: Floats) -> tuple[Floats, float]:
        """Derivatives (p,) of the distance by parameters of these names, and how much it is longer than at these
        ``values`` (p,)."""
        moved, index = self.places_mm.copy(), {name: k for k, name in enumerate(names)}
        for k, own in enumerate(self.names):
            moved[k] += [values[index[name]] if name in index else 0.0 for name in own]
        between = moved[1] - moved[0]
        length = float(np.linalg.norm(between))
        along = between / length if length > 0 else np.array([1.0, 0.0, 0.0])
        out = np.zeros(len(names))
        for sign, own in zip((-1.0, 1.0), self.names, strict=True):
            for name, by in zip(own, along, strict=True):
                if name in index:
                    out[index[name]] = sign * by
        return out, self.mm - length


# -- Tolerances --------------------------------------------------------------------------------------------------------

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_STATED = re.compile(rf"^\s*(?:(?P<value>{_NUMBER})\s*)?(?:±|\+/-|\+-)\s*(?P<sd>{_NUMBER})\s*(?P<unit>\S*)\s*$")
_ALONE = re.compile(rf"^\s*(?P<sd>{_NUMBER})\s*(?P<unit>\S*)\s*$")
_EXAMPLE = {"known": '"217 ± 1 mm"', "tolerances": '"0.05 mm"'}
#: Sizes of plausible things; what is smaller is held by leaving it out of ``free``.
_SMALLEST, _LARGEST = 1e-12, 1e12


@dataclass(frozen=True)
class Stated:
    """The texts of one of both tables by the name of a class or a parameter, as they were written."""

    texts: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(cls, texts: Mapping[str, str]) -> Stated:
        """From a mapping: ``sk.Delta(…, known=sk.Stated.of({"rod_length_2": "217 ± 1 mm"}))``."""
        return cls(tuple((str(name), str(text)) for name, text in texts.items()))

    @classmethod
    def from_table(cls, table: Table) -> Stated:
        """Reads the table. Raises :class:`~sherkit.errors.RobotError` for what is no text."""
        return cls.of(table.all_texts('a size with its unit in quotes, such as "0.05 mm" or "217 ± 1 mm"'))

    def to_table(self) -> dict[str, Any]:
        """What :meth:`from_table` reads, without loss."""
        return dict(self.texts)

    def __bool__(self) -> bool:
        return bool(self.texts)


#: Nothing is stated: sizes are those of the robot's kind.
NOT_STATED = Stated()


class Stating:
    """A robot whose file may have both tables; its dataclass has the two fields."""

    tolerances: Stated
    known: Stated

    def drawn_values(self) -> Mapping[str, float]:
        """Values of the drawing by the name of their parameter, in its unit; of others the drawing is zero."""
        return {}


def stated_by(robot: object) -> tuple[Stated, Stated]:
    """The tolerances of a robot, and what is known of it; nothing for one that has no place for it."""
    if not isinstance(robot, Stating):
        return NOT_STATED, NOT_STATED
    return robot.tolerances, robot.known


def stated_sizes(robot: object, base: tuple[Parameter, ...]) -> Mapping[str, tuple[float, bool]]:
    """Of each of these parameters that the robot's file states: its size, in its unit, and whether it is known.

    Raises :class:`~sherkit.errors.RobotError` for a name that is not there, a number without a unit, a unit that
    measures something else, and a value that is not the drawing's.
    """
    tolerances, known = stated_by(robot)
    if not (tolerances or known):
        return {}
    assert isinstance(robot, Stating)
    own = tuple((p.name, p.unit) for p in base if p.name not in POSE)
    return _sizes(tolerances, known, own, tuple(robot.drawn_values().items()))


@lru_cache(maxsize=64)
def _sizes(
    tolerances: Stated, known: Stated, base: tuple[tuple[str, str], ...], drawn: tuple[tuple[str, float], ...]
) -> Mapping[str, tuple[float, bool]]:
    units, out = dict(base), {}
    # the more of a name is said, the later it counts
    for name, text in sorted(tolerances.texts, key=lambda one: one[0].count("_")):
        mine = [one for one in units if _is_of(one, name)]
        if not mine:
            raise _nobody("tolerances", name, {_stem(one) for one in units} | set(units))
        _, sd, unit = _read("tolerances", name, text)
        sizes = {one: _in(units[one], sd, unit, "tolerances", name, text, fails=False) for one in mine}
        if not any(sizes.values()):
            _in(units[mine[0]], sd, unit, "tolerances", name, text)
        out.update({one: (size, False) for one, size in sizes.items() if size})
    for name, text in known.texts:
        if name not in units:
            raise _nobody("known", name, units)
        value, sd, unit = _read("known", name, text)
        out[name] = (_in(units[name], sd, unit, "known", name, text), True)
        if value is not None:
            _require_as_drawn(name, text, value, unit, units[name], dict(drawn).get(name, 0.0))
    return out


def _is_of(name: str, stated: str) -> bool:
    """Whether a parameter is the one that is stated, or one of its class: what its name begins with, but for
    numbers."""
    words = stated.split("_")
    return words in (name.split("_")[: len(words)], _stem(name).split("_")[: len(words)])


def _stem(name: str) -> str:
    return "_".join(word for word in name.split("_") if not word.isdigit())


def _nobody(table: str, name: str, names: Any) -> RobotError:
    if name in POSE or name.startswith("sensor"):
        return RobotError(
            f"[{table}] {brief(name)}: how well it is known where the sensor stands is said under [sensor_pose], "
            "shift_sd_mm and turn_sd_deg"
        )
    there = sorted(names)
    hint = nearest(name, there) or f"; there are {listed(there, 24)}"
    what = "no parameter of this robot" if table == "known" else "no parameter of this robot and no class of them"
    return RobotError(f"[{table}] {brief(name)}: {what}{hint}")


def _read(table: str, name: str, text: str) -> tuple[float | None, float, str]:
    """The value, None where none is given, the deviation and the unit of a text."""
    found = _STATED.match(text) or (_ALONE.match(text) if table == "tolerances" else None)
    where = f"[{table}] {brief(name)}"
    if found is None:
        raise RobotError(f"{where}: expected a size such as {_EXAMPLE[table]}, found {brief(repr(text))}")
    parts = found.groupdict()
    value, sd = parts.get("value"), float(parts["sd"])
    if table == "tolerances" and value is not None:
        raise RobotError(
            f"{where}: expected how well it is known, such as {_EXAMPLE[table]}, found {brief(repr(text))}; a value "
            "that was measured stands under [known]"
        )
    if not parts["unit"]:
        raise RobotError(f"{where}: {brief(repr(text))} has no unit; write {_EXAMPLE[table]}, in mm, um, deg or rad")
    if not _SMALLEST <= sd <= _LARGEST:
        raise RobotError(
            f"{where}: expected a deviation above zero, found {brief(repr(text))}; what is exactly as drawn is left "
            "out of free"
        )
    return None if value is None else float(value), sd, parts["unit"]


def _in(wanted: str, sd: float, unit: str, table: str, name: str, text: str, *, fails: bool = True) -> float:
    """A deviation in the unit of its parameter; where it measures something else 0, or an error."""
    by = factor(unit, wanted)
    if by is None:
        if fails:
            sort = {"mm": "a length (mm, um, m, in)", "rad": "an angle (deg, rad, mrad, arcmin, arcsec)"}
            raise RobotError(
                f"[{table}] {brief(name)}: expected {sort.get(wanted, wanted)}, found {brief(repr(text))}, in "
                f"'{brief(unit)}'"
            )
        return 0.0
    return sd * by


def _require_as_drawn(name: str, text: str, value: float, unit: str, wanted: str, drawn: float) -> None:
    """Refuses a value that is not the drawing's, give or take half of its last digit."""
    by = factor(unit, wanted)
    assert by is not None
    digits = re.match(r"\s*[+-]?\d*\.?(\d*)", text)
    last = 10.0 ** -len(digits[1]) if digits else 1.0
    if abs(value - drawn / by) > 0.5 * last * (1 + 1e-9):
        raise RobotError(
            f"[known] {name}: expected {drawn / by:.10g} {unit}, which it is in this file, found {brief(repr(text))}; "
            "write what was measured into the drawing, and here how well it is known"
        )
