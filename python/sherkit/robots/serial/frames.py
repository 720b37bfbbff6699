"""Rigid transforms as 4 x 4 matrices, mm, and as files have them: a shift and URDF's roll, pitch and yaw; and
turns as programs and controllers write them."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np
import scipy

from ...base import linalg
from ...base.types import Floats, Ints
from ...data.called import header_unit
from ...errors import MeasurementError, SherkitWarning

# -- Frames ------------------------------------------------------------------------------------------------------------

Triple = tuple[float, float, float]


def triple(numbers: Sequence[float] | Floats) -> Triple:
    """Three numbers of Python's own, no zero that is negative."""
    x, y, z = (float(one) + 0.0 for one in numbers)
    return x, y, z


#: An axis that leans by less is z itself.
_ALONG = 1e-12


def about(axis: int, angle: float) -> Floats:
    """A turn (3, 3) about x, y or z, rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    out = np.eye(3)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    out[j, j] = out[k, k] = cos
    out[j, k], out[k, j] = -sin, sin
    return out


def frame(shift_mm: Sequence[float], turn: Floats) -> Floats:
    """The transform (4, 4) of a turn (3, 3) and a shift."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = turn, shift_mm
    return out


def of_rpy(rpy_rad: Sequence[float] | Floats) -> Floats:
    """The turn (3, 3) of URDF's roll, pitch and yaw: about the fixed x, then y, then z."""
    roll, pitch, yaw = rpy_rad
    return about(2, yaw) @ about(1, pitch) @ about(0, roll)


def placed(shift_mm: Sequence[float], rpy_deg: Sequence[float]) -> Floats:
    """The transform (4, 4) that a file says: a shift, mm, and roll, pitch, yaw, degrees."""
    return frame(shift_mm, of_rpy(np.deg2rad(rpy_deg)))


def rpy_of(turn: Floats) -> Floats:
    """Roll, pitch and yaw (3,), rad, of a turn (3, 3); exact where yaw and roll turn about one axis, too."""
    yaw = np.arctan2(turn[1, 0], turn[0, 0])
    cos, sin = np.cos(yaw), np.sin(yaw)
    roll = np.arctan2(sin * turn[0, 2] - cos * turn[1, 2], cos * turn[1, 1] - sin * turn[0, 1])
    return np.array([roll, np.arctan2(-turn[2, 0], cos * turn[0, 0] + sin * turn[1, 0]), yaw])


def onto(axis: Sequence[float]) -> Floats:
    """The smallest turn (3, 3) that brings z onto an axis; half a turn about x where that is -z."""
    x, y, z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    across = np.hypot(x, y)
    if across < _ALONG:
        return np.eye(3) if z > 0 else about(0, np.pi)
    c, s = x / across, y / across
    h = (1.0 - z) * s * c
    return np.array([[z + (1.0 - z) * s * s, -h, x], [-h, z + (1.0 - z) * c * c, y], [-x, -y, z]])


def rpy_of_transform(made: Floats) -> tuple[Triple, Triple]:
    """Shift, mm, and roll, pitch, yaw, degrees, of a transform (4, 4), as a file has them."""
    return triple(made[:3, 3]), triple(np.rad2deg(rpy_of(made[:3, :3])))


# -- Turns -------------------------------------------------------------------------------------------------------------
# Turns of a tool as programs and controllers write them: which convention, by the names of columns and by the arm.
#
# Where names leave it open, as ``rx, ry, rz`` do, the convention is the one in which the turns between poses are as
# large as the arm's joints say: that asks neither where the instrument stands nor how the tool is held.

#: Columns that tell a turn: of angles with their unit at the end, of a quaternion, of a matrix row by row.
VECTOR: tuple[str, ...] = ("rx", "ry", "rz")
QUATERNION: tuple[str, ...] = ("qx", "qy", "qz", "qw")
_NAMED: dict[tuple[str, ...], str] = {
    ("roll", "pitch", "yaw"): "xyz",
    # KUKA: A about z, then B about y, then C about x; FANUC: W, P, R about the fixed x, y, z
    ("a", "b", "c"): "ZYX",
    ("w", "p", "r"): "xyz",
}  # fmt: skip
#: ABB: the real part first.
_REAL_FIRST: tuple[tuple[str, ...], ...] = (("q1", "q2", "q3", "q4"), ("qw", "qx", "qy", "qz"))
_MATRIX = re.compile(r"(?:t|r|m|rot|h|a)_?(\d)_?(\d)")
_SCALES = {"rad": 1.0, "deg": np.pi / 180.0, "": np.pi / 180.0}
#: A quaternion is of length one, and a matrix turns, but for its digits.
_LENGTH = 1e-3
#: Sets of poses that are compared; an arm whose zeros are off turns by other angles, but not by so many rad; by so
#: much better must a convention fit than what the names say, where that is off by more than this.
_PAIRS, _FITS, _BETTER, _OFF, _ALIKE = 2000, 0.06, 4.0, 0.004, 1.001
#: By so much better must turns go with the places, where they go with the joints as well in another convention.
_TURNS_WITH = 2.0


def _rotation() -> Any:
    return scipy.spatial.transform.Rotation  # loaded when it is first asked for


@dataclass(frozen=True)
class Turns:
    """Turns (n, 3, 3) from the tool's axes to those of the instrument, and the ``columns`` that told them."""

    matrices: Floats
    columns: tuple[str, ...]


def turns_of(
    numbers: Callable[[Sequence[str]], Floats], names: Sequence[str], drawn: Floats | None, source: str,
    stand: Floats | None = None,
) -> Turns | None:  # fmt: skip
    """The turns that columns of a table tell, ``numbers`` giving those of some (n, ·), for an arm whose tool as drawn
    is turned by ``drawn`` (n, 3, 3), None where no joints tell that, before an instrument of which places tell how it
    ``stand``s, the turn (3, 3) of the base's axes in its own; None where no columns do. What names leave open,
    and what they say and does not fit the arm, is said in a :class:`~sherkit.errors.SherkitWarning`.

    Raises :class:`~sherkit.errors.MeasurementError` for a quaternion that is not of length one and a matrix that does
    not turn.
    """
    told = {header_unit(name)[0].lower(): name for name in names}
    for wanted in (QUATERNION, *_REAL_FIRST):
        if set(wanted) <= set(told) and not (wanted[0] == "q1" and "q5" in told):
            columns = tuple(told[one] for one in wanted)
            q = numbers(columns)
            if (off := np.abs(np.linalg.norm(q, axis=1) - 1.0) > _LENGTH).any():
                raise MeasurementError(
                    f"{source}: {', '.join(columns)}: expected a quaternion of length one, found "
                    f"{float(np.linalg.norm(q[off][0])):.4g} in row {int(np.argmax(off))}"
                )
            first, last = "a quaternion, its real part first", "a quaternion, its real part last"
            orders = [(last, q), (first, np.roll(q, -1, axis=1))][:: 1 if wanted == QUATERNION else -1]
            read = {name: np.asarray(_rotation().from_quat(one).as_matrix()) for name, one in orders}
            return Turns(_checked(read, (drawn, stand), source, columns), columns)
    if columns := _of_matrix(names)[0]:
        m = numbers(columns).reshape(-1, 3, 3)
        apart = np.abs(m @ m.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        if (off := (apart > 10 * _LENGTH) | (np.linalg.det(m) < 0)).any():
            raise MeasurementError(
                f"{source}: {', '.join(columns)}: expected the matrix of a turn; that of row {int(np.argmax(off))} is "
                "none"
            )
        return Turns(
            _checked({"a matrix": _rotation().from_matrix(m).as_matrix()}, (drawn, stand), source, columns), columns
        )
    for wanted in (VECTOR, *_NAMED):
        if not set(wanted) <= set(told):
            continue
        columns = tuple(told[one] for one in wanted)
        units = {header_unit(name)[1] for name in columns}
        if len(units) > 1 or not units <= {*_SCALES}:
            raise MeasurementError(f"{source}: {', '.join(columns)}: expected angles, all in rad or all in deg")
        unit, axes = units.pop() or "deg", _NAMED.get(wanted, "")
        ways = {_called(axes): (axes, [0, 1, 2])} | _ways()
        every: dict[str, Floats] = {}
        for one in (unit, "deg" if unit == "rad" else "rad"):
            angles, added = _SCALES[one] * numbers(columns), "" if one == unit else f", in {one}"
            every |= {f"{name}{added}": _matrices(axes, angles[:, order]) for name, (axes, order) in ways.items()}
        return Turns(_checked(every, (drawn, stand), source, columns), columns)
    return None


def place_in_matrix(names: Sequence[str]) -> tuple[str, ...]:
    """The columns of a 4 × 4 matrix that hold the place; empty where there is none."""
    return _of_matrix(names)[1]


def _of_matrix(names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Columns of the turn of a matrix, row by row, and of its place."""
    found: dict[tuple[int, int], str] = {}
    for name in names:
        if at := _MATRIX.fullmatch(header_unit(name)[0].lower()):
            found.setdefault((int(at[1]), int(at[2])), name)
    for first in (1, 0):
        own = [(first + i, first + j) for i in range(3) for j in range(3)]
        if all(one in found for one in own) and (first == 0 or (0, 0) not in found):
            place = [(first + i, first + 3) for i in range(3)]
            return tuple(found[one] for one in own), tuple(found[one] for one in place if one in found)
    return (), ()


def _matrices(axes: str, numbers: Floats) -> Floats:
    """Turns (n, 3, 3) of numbers (n, 3), rad: about these axes, or rotation vectors without any."""
    made = _rotation().from_euler(axes, numbers) if axes else _rotation().from_rotvec(numbers)
    return np.asarray(made.as_matrix())


def _called(axes: str) -> str:
    """A sequence of turns in words: small letters about fixed axes, capitals about those that turn along."""
    if not axes:
        return "a rotation vector"
    sort = "the fixed axes" if axes.islower() else "the tool's own axes"
    return f"angles about {sort} {', '.join(axes.lower())}, one after the other"


def _ways() -> dict[str, tuple[str, list[int]]]:
    """Everything that three numbers may be, axes and order of columns: a rotation vector, and angles about three axes,
    each about its own axis where the names say which that is."""
    out = {_called(""): ("", [0, 1, 2])}
    for order in permutations(range(3)):
        axes = "".join("xyz"[k] for k in order)
        out[_called(axes)] = axes, list(order)
    for axes in ("ZYX", "XYZ", "ZYZ", "ZXZ", "YXY", "YZY", "XYX", "XZX"):
        out[f"{_called(axes)} by column"] = axes, [0, 1, 2]
    return out


def _checked(
    ways: Mapping[str, Floats], known: tuple[Floats | None, Floats | None], source: str, columns: Sequence[str]
) -> Floats:
    """The turns of the way that fits the arm: the first unless another fits far better, the other way round too.
    ``known`` are the drawing's, and how the instrument stands."""
    drawn, stand = known
    if drawn is None:
        return next(iter(ways.values()))
    every = dict(ways) | {
        f"{name}, from the instrument's axes to the tool's": m.transpose(0, 2, 1) for name, m in ways.items()
    }
    usual = next(iter(every))
    few = np.random.default_rng(0).integers(len(drawn), size=(_PAIRS, 4))
    wanted = _angles(drawn, few)
    off = {name: float(np.median(np.abs(_angles(m, few) - wanted))) for name, m in every.items()}
    # of two that differ by how axes are called alone, the first; of others that which turns with the places
    alike = [name for name in every if off[name] <= _ALIKE * min(off.values())]
    apart = {name: _apart(every[name], drawn, stand) for name in alike}
    best = next(name for name in alike if apart[name] <= _TURNS_WITH * min(apart.values()) + _OFF)
    if off[usual] > _OFF and _BETTER * off[best] < off[usual] and off[best] < _FITS:
        chosen, further = best, f"; they are read as {best}, which fits ({np.rad2deg(off[best]):.2g}°)"
    elif off[usual] > _FITS:
        further = (
            ", and so it does in every other convention: are the joints those of this arm, in the order and the unit "
            "of its file?"
        )
        chosen = usual
    else:
        return every[usual]
    warnings.warn(
        f"{source}: {', '.join(columns)}: read as {usual} the tool turns otherwise than the joints of this arm do (by "
        f"{np.rad2deg(off[usual]):.2g}° in the middle){further}",
        SherkitWarning,
        stacklevel=2,
    )
    return every[chosen]


def _apart(m: Floats, drawn: Floats, stand: Floats | None) -> float:
    """How far turns (n, 3, 3) are from those of the drawing, rad in the middle, but for how the tool is held; zero
    where nobody knows how the instrument stands."""
    if stand is None:
        return 0.0
    held = np.einsum("nab,nbc->nac", (stand @ drawn).transpose(0, 2, 1), m)
    u, _, v = linalg.svd(held.sum(axis=0))
    cosine = 0.5 * (np.einsum("ab,nab->n", u @ v, held) - 1.0)
    return float(np.median(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _angles(m: Floats, few: Ints) -> Floats:
    """By how much one turns from the first to the second and on by as much as from the third to the fourth of ``few``
    (k, 4) rows, rad: of two rows alone the turn back would be as large."""
    turns = [m[rows] for rows in few.T]
    cosine = 0.5 * (np.einsum("nab,nac,ndc,ndb->n", *turns, optimize=True) - 1.0)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))
