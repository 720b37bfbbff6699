"""A user's function of joints and parameters, asked with care: its shapes, its derivatives, what is wrong with it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from ...base import linalg
from ...base.figures import listed
from ...base.types import Bools, Floats
from ...errors import FitError, SherkitError
from ...model.effect import Parameter

# -- Derivatives of a user's function -------------------------------------------------------------------------------

#: Readings (n, m) for inputs (n, i): joints and parameters beside each other, each row with its own.
Function = Callable[[NDArray[np.inexact]], NDArray[np.inexact]]

_TINY = 1e-30
#: Steps of differences, in parts of the size of an input.
_STEPS = 10.0 ** np.arange(0.0, -4.0, -0.5)
#: Part of the largest change by which two ways to a derivative may differ.
AGREE = 1e-5
#: The same where a function is called not smooth.
_SMOOTH = 1e-2
#: Digits of readings that a difference over a size can see.
_ROUNDING = 1e-11


@dataclass(frozen=True, eq=False)
class InputSteps:
    """How each input (i,) is stepped: zero by a complex step, else the step of its difference."""

    real: Floats

    def columns(self, function: Function, at: Floats, which: Sequence[int]) -> Floats:
        """Derivatives (n, m, len(which)) by these inputs at the rows ``at`` (n, i)."""
        if not len(which):
            return np.zeros((*np.shape(function(at)), 0))
        return np.stack([self._column(function, at, k) for k in which], axis=2)

    def _column(self, function: Function, at: Floats, k: int) -> Floats:
        if self.real[k] > 0:
            return difference(function, at, k, float(self.real[k]))
        return complex_step(function, at, k)


def complex_step(function: Function, at: Floats, k: int) -> Floats:
    """Derivative (n, m) by input ``k`` at the rows ``at`` (n, i)."""
    moved = at.astype(complex)
    moved[:, k] += 1j * _TINY
    return np.asarray(np.imag(function(moved)) / _TINY, dtype=float)


def difference(function: Function, at: Floats, k: int, step: float) -> Floats:
    """The same by a central difference of fourth order."""
    values = []
    for by in (-2, -1, 1, 2):
        moved = at.copy()
        moved[:, k] += by * step
        values.append(np.asarray(function(moved), dtype=float))
    return (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * step)


def steps_for(function: Function, at: Floats, sizes: Floats, names: Sequence[str]) -> InputSteps:
    """The way to step each input, tried at the rows ``at`` (n, i); ``sizes`` (i,) are what each may move by.

    Raises :class:`~sherkit.errors.FitError` where no two steps agree: the function is not smooth.
    """
    real = np.zeros(len(sizes))
    with np.errstate(all="ignore"):
        rounding = _ROUNDING * float(np.nanmax(np.abs(np.asarray(function(at), dtype=float)), initial=0.0))
        for k, size in enumerate(sizes):
            tried = [difference(function, at, k, float(step * size)) for step in _STEPS]
            # rows that one side of a step takes out of reach tell nothing
            known = np.asarray(np.isfinite(tried).all(axis=0))
            if not known.any():
                continue
            # a slope that is lost in the rounding of the readings is none
            scale = max(float(np.abs(tried[0])[known].max()), rounding / size, np.finfo(float).tiny)
            apart = [np.abs(a - b)[known].max() / scale for a, b in pairwise(tried)]
            best = int(np.argmin(apart))
            if apart[best] > _SMOOTH:
                row = int(np.argmax(np.where(known, np.abs(tried[best] - tried[best + 1]), 0.0).max(axis=1)))
                raise FitError(
                    f"the model's function is not smooth in '{names[k]}': at row {row} its slope depends on the step "
                    "(does it round, branch, or stop an iteration early?)"
                )
            if not _allows_complex(function, at, k, tried[best + 1], known, max(AGREE * scale, apart[best] * scale)):
                real[k] = _STEPS[best + 1] * size
    return InputSteps(real)


def _allows_complex(
    function: Function, at: Floats, k: int, slope: Floats, known: NDArray[np.bool_], off: float
) -> bool:
    """Whether complex steps come through a function."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # NumPy warns where it casts the imaginary part away
            found = complex_step(function, at, k)
    except Exception:
        return False
    return bool(np.isfinite(found[known]).all() and np.abs(found - slope)[known].max() <= 10 * off)


# -- The function ----------------------------------------------------------------------------------------------------

#: (joints (n, k), parameters by name) → readings (n, m).
Forward = Callable[[Any, SimpleNamespace], Any]
#: The same → derivatives (n, m, p) by the parameters.
Derivative = Callable[[Any, SimpleNamespace], Any]

#: Rows on which derivatives are tried, and the seed by which they are drawn.
_ROWS, _SEED = 32, 7


@dataclass(frozen=True, eq=False)
class UserFunction:
    """Readings (n, m) of a machine for its joints (n, k) and values (p,) of its ``parameters``.

    ``box`` (k, 2) is where the joints may stand, and ``joints_at`` gives those at parts (n, k) of their ranges:
    derivatives are tried there, once.
    """

    name: str
    forward: Forward
    derivative: Derivative | None
    joints: tuple[str, ...]
    readings: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    box: Floats = field(repr=False)
    joints_at: Callable[[Floats], Floats] = field(repr=False, compare=False)

    def __call__(self, joints: NDArray[Any], values: NDArray[Any]) -> Floats:
        """Readings (n, m), NaN where the function has none. Raises :class:`~sherkit.errors.FitError`."""
        return np.asarray(self._asked(joints, values), dtype=float)

    def derivatives(self, joints: Floats, values: Floats, wanted: Sequence[int]) -> tuple[Floats, Floats]:
        """Derivatives (n, m, k) by the joints and (n, m, len(wanted)) by these parameters. Raises as a call."""
        k = len(self.joints)
        at = np.column_stack([joints, np.tile(values, (len(joints), 1))])
        by_joints = self._steps.columns(self._beside, at, range(k))
        if not wanted:
            return by_joints, np.zeros((len(joints), len(self.readings), 0))
        if self.derivative is None:
            return by_joints, self._steps.columns(self._beside, at, [k + one for one in wanted])
        return by_joints, self._given(joints, values)[:, :, list(wanted)]

    # -- how it is asked ---------------------------------------------------------------------------------

    def _asked(self, joints: NDArray[Any], values: NDArray[Any]) -> NDArray[Any]:
        """The function for rows (n, k) with values (p,), or (n, p) where each row has its own."""
        columns = values.T if values.ndim == 2 else values
        p = SimpleNamespace(**{one.name: column for one, column in zip(self.parameters, columns, strict=True)})
        try:
            with np.errstate(all="ignore"):
                # a copy: what the function does to it must not reach the run
                out = np.asarray(self.forward(joints.copy(), p))
        except SherkitError:
            raise
        except (Exception, SystemExit) as error:
            if np.iscomplexobj(joints):
                raise
            raise FitError(
                f"the model's function '{self.name}' failed{self._where(joints, values)}: {type(error).__name__}: "
                f"{error}{self._hint(error)}"
            ) from error
        expected = (len(joints), len(self.readings))
        if out.shape != expected:
            raise FitError(
                f"the model's function '{self.name}' gives an array of shape {out.shape} for {len(joints)} rows; "
                f"expected {expected}: a column for each of {', '.join(self.readings)}"
            )
        if out.dtype.kind not in "fciu":
            raise FitError(f"the model's function '{self.name}' gives {out.dtype} and no numbers")
        return out

    def _where(self, joints: NDArray[Any], values: NDArray[Any]) -> str:
        """The joints at which the function fails, of the first such row; nothing where it fails at every one of several
        rows, or only with rows together."""
        failing = [row for row in range(len(joints)) if self._fails(joints[row : row + 1], values, row)]
        if not 0 < len(failing) < max(len(joints), 2):
            return ""
        at = ", ".join(f"{name} = {x:g}" for name, x in zip(self.joints, joints[failing[0]].tolist(), strict=True))
        return f" at {at} (row {failing[0]} of the {len(joints)} that it was asked for; {len(failing)} fail)"

    def _fails(self, joints: NDArray[Any], values: NDArray[Any], row: int) -> bool:
        columns = values[row] if values.ndim == 2 else values
        p = SimpleNamespace(**{one.name: column for one, column in zip(self.parameters, columns, strict=True)})
        try:
            with np.errstate(all="ignore"):
                self.forward(joints.copy(), p)
        except (Exception, SystemExit):
            return True
        return False

    def _hint(self, error: Exception | SystemExit) -> str:
        """What was meant, where a parameter is asked for that is none, or in another way."""
        if "SimpleNamespace" not in str(error):
            return ""
        names = listed([one.name for one in self.parameters]) or "none"
        return f"; parameters are asked for as p.name, and this machine's are {names}"

    def _beside(self, at: NDArray[Any]) -> NDArray[Any]:
        """The function of joints and parameters side by side (n, k + p)."""
        k = len(self.joints)
        # most functions want one number for a parameter: they get it, since rows differ in none but by a joint
        return self._asked(at[:, :k], at[0, k:] if len(at) else np.zeros(len(self.parameters)))

    @cached_property
    def somewhere(self) -> Floats:
        """Joints (n, k) at random within their box."""
        return self.joints_at(np.random.default_rng(_SEED).uniform(size=(_ROWS, len(self.box))))

    @cached_property
    def _steps(self) -> InputSteps:
        """How each input is stepped, tried at joints within their box and the drawing's parameters."""
        low, high = self.box.T
        joints = self.somewhere
        at = np.column_stack([joints, np.zeros((_ROWS, len(self.parameters)))])
        sizes = np.concatenate([1e-2 * (high - low), [one.size for one in self.parameters]])
        names = [*self.joints, *(one.name for one in self.parameters)]
        steps = steps_for(self._beside, at, sizes, names)
        if self.derivative is not None and self.parameters:
            self._check_given(joints, at, steps)
        return steps

    # -- a derivative that the user gives ------------------------------------------------------------------

    def _given(self, joints: Floats, values: Floats) -> Floats:
        assert self.derivative is not None
        p = SimpleNamespace(**dict(zip((one.name for one in self.parameters), values.tolist(), strict=True)))
        try:
            out = np.asarray(self.derivative(joints, p), dtype=float)
        except (Exception, SystemExit) as error:
            raise FitError(f"the derivative of '{self.name}' failed: {type(error).__name__}: {error}") from error
        expected = (len(joints), len(self.readings), len(self.parameters))
        if out.shape != expected:
            raise FitError(f"the derivative of '{self.name}': expected an array of shape {expected}, got {out.shape}")
        return out

    def _check_given(self, joints: Floats, at: Floats, steps: InputSteps) -> None:
        """Refuses a derivative that is not that of the function."""
        k = len(self.joints)
        numeric = steps.columns(self._beside, at, range(k, at.shape[1]))
        given = self._given(joints, at[0, k:])
        known = np.isfinite(numeric).all(axis=(1, 2))
        for j, one in enumerate(self.parameters):
            scale = max(float(np.abs(numeric[known, :, j]).max(initial=0.0)), np.finfo(float).tiny)
            off = np.where(known, np.abs(given[:, :, j] - numeric[:, :, j]).max(axis=1), 0.0)
            row = int(np.argmax(off))
            if not off[row] <= 1e3 * AGREE * scale:
                where = ", ".join(f"{n} = {v:.6g}" for n, v in zip(self.joints, joints[row], strict=True))
                raise FitError(
                    f"the derivative of '{self.name}' by {one.name} is not that of the function: at {where} it gives "
                    f"{_told(given[row, :, j])}, differences {_told(numeric[row, :, j])}"
                )


def _told(values: Floats) -> str:
    return f"({', '.join(f'{v:.6g}' for v in values)})"


# -- Which joints show given readings -----------------------------------------------------------------------------

#: Places over the ranges of the joints from which one begins.
_PLACES = 1024
_ROUNDS = 30
#: Part of a range by which a step counts as none, and by which a place is as good as the nearest.
_STILL, _NEAR = 1e-12, 1e-6
#: Part of a range by which a solution may leave it: a machine is not quite as drawn.
_SLACK = 0.02
#: How far beside the surface that fewer joints than readings make a place may be asked for, in parts of its size.
_BESIDE_SURFACE = 1e-3


def starts(forward: Callable[[Floats], Floats], readings: Floats, box: Floats) -> Floats:
    """For each of the readings (n, m) the nearest place (n, k) of the joints, of many over their ``box`` (k, 2)."""
    if not len(box):  # nothing moves
        return np.zeros((len(readings), 0))
    low, high = box.T
    joints = low + (high - low) * scipy.stats.qmc.Halton(len(low), scramble=False).random(_PLACES + 1)[1:]
    shown = forward(joints)
    known = np.isfinite(shown).all(axis=1)
    joints, shown = joints[known], shown[known]
    if not len(joints):
        return np.full((len(readings), len(low)), np.nan)
    # where nothing is asked for, any place is as good
    nearest = scipy.spatial.KDTree(shown).query(np.nan_to_num(readings))[1]
    return np.asarray(joints[nearest])


def settled(
    forward: Callable[[Floats], tuple[Floats, Floats]], readings: Floats, start: Floats, box: Floats
) -> tuple[Floats, Bools]:
    """Joints (n, k) that show these readings (n, m), and which rows settled; others are NaN. Gauss and Newton from
    ``start`` (n, k), within the ``box`` (k, 2).

    ``forward`` gives readings and their derivatives by the joints. Machines with more joints than readings take the
    nearest solution to where they begin; with fewer, the place nearest to what is asked, which is as good as reached
    where it is hardly beside that: no reading lies on their surface to the last digit.
    """
    if not start.shape[1]:
        return start, np.ones(len(start), dtype=bool)
    low, high = box.T
    span = high - low
    joints = start.copy()
    still = np.zeros(len(joints), dtype=bool)
    best = np.full(len(joints), np.inf)
    step = np.zeros_like(joints)
    shorter = np.ones(len(joints))
    for _ in range(_ROUNDS):
        shown, by_joints = forward(joints + shorter[:, None] * step)
        off = np.where(np.isfinite(shown).all(axis=1), np.linalg.norm(readings - shown, axis=1), np.inf)
        # a step that makes it worse is taken half as far
        good = off <= np.maximum(best * (1 + 1e-9), 1e-12 * np.linalg.norm(readings, axis=1))
        joints = np.where(good[:, None], joints + shorter[:, None] * step, joints)
        best = np.where(good, off, best)
        fresh = good & np.isfinite(by_joints).all(axis=(1, 2))
        if fresh.any():
            by = by_joints[fresh] * span  # joints in parts of their ranges
            now = linalg.pinv(by, rcond=1e-12) @ (readings[fresh] - shown[fresh])[:, :, None]
            step[fresh] = now[:, :, 0] * span
        # what is already at its place stays
        shorter = np.where(
            good, np.minimum(1.0, 0.5 / np.maximum(np.abs(step / span).max(axis=1), 1e-300)), 0.5 * shorter
        )
        still = (np.abs(step / span).max(axis=1) < _STILL) | (shorter < 1e-6)
        if still.all():
            break
    scale = np.abs(readings).max(axis=1) + 1.0
    within = ((joints >= low - _SLACK * span) & (joints <= high + _SLACK * span)).all(axis=1)
    few = readings.shape[1] > joints.shape[1]
    # beside it steps get shorter by a part each
    nearest = still | (np.abs(step / span).max(axis=1) < _NEAR)
    most = np.where(nearest, _BESIDE_SURFACE, 1e-9) if few else 1e-9
    reached = (best <= most * scale) & within & np.isfinite(joints).all(axis=1)
    return np.where(reached[:, None], joints, np.nan), reached
