"""The measurement chain of a machine given by a function: joints, the function, readings, with the effects of each.

What a robot has compiled stands here in NumPy; a fit, a diagnosis and a calibration ask it the same questions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base import linalg
from ...base.types import Bools, Floats
from ...fit.numpy_chain import NumpyChain
from ...model.chain import Block
from .effects import Generic, Known
from .function import UserFunction

_TINY = 1e-30
#: Part of an effect's columns that must be left where those of the function are taken out, for it to be another one.
_SAME = 1e-3


@dataclass(frozen=True, eq=False)
class MachineCore(NumpyChain):
    """The chain of one machine at the settings of its effects: ``wave``, one turn over the period of its encoders, and
    three moments, s."""

    function: UserFunction
    effects: tuple[Generic, ...]
    wave: float
    time_origin_s: float
    slip_time_s: float
    joint_slip_time_s: float

    @cached_property
    def _places(self) -> list[slice]:
        ends = np.cumsum([len(self.function.parameters), *(len(one.parameters) for one in self.effects)])
        return [slice(a, b) for a, b in pairwise(ends.tolist())]

    def _known(self, block: Block) -> tuple[Floats, Known, Floats]:
        joints, _, columns, push = block
        k = joints.shape[1]
        columns = np.full((len(joints), 3 + 2 * k), np.nan) if columns is None else columns
        moments = (self.wave, self.time_origin_s, self.slip_time_s, self.joint_slip_time_s)
        moved = columns[:, 2 : 2 + k], columns[:, 2 + k : 2 + 2 * k]
        known = Known(columns[:, 0], columns[:, 1], columns[:, -1], *moved, *moments)
        return joints, known, np.zeros((len(joints), 3)) if push is None else push

    def _link(self, link: str, x: NDArray[Any], values: Floats, known: Known) -> NDArray[Any]:
        """A link: what comes in (n, axes), and what its effects add."""
        out = x
        for one, place in zip(self.effects, self._places, strict=True):
            # an effect at zero does not ask for its covariate
            if one.link == link and values[place].any():
                out = out + one.formula(x, known) @ values[place]
        return out

    def _by_input(self, link: str, x: Floats, values: Floats, known: Known) -> Floats:
        """How a link carries on a change of what comes in (n, axes, axes): its formulas are ours, and complex."""
        n, axes = x.shape
        own = [o for o, p in zip(self.effects, self._places, strict=True) if o.link == link and values[p].any()]
        if not own:
            return np.broadcast_to(np.eye(axes), (n, axes, axes))
        columns = []
        for k in range(axes):
            moved = x.astype(complex)
            moved[:, k] += 1j * _TINY
            columns.append(self._link(link, moved, values, known).imag / _TINY)
        return np.stack(columns, axis=2)

    def predict(self, values: Floats, block: Block) -> tuple[Floats, Bools]:
        """Readings (n, m), and which rows could be computed."""
        joints, known, push = self._known(block)
        own = values[: len(self.function.parameters)]
        point = self.function(self._link("joints", joints, values, known), own)
        out = self._link("sensor", self._pushed(self._link("body", point, values, known), push), values, known)
        return out, np.isfinite(out).all(axis=1)

    def _pushed(self, point: Floats, push: Floats) -> Floats:
        return point + push if point.shape[1] == push.shape[1] else point

    def derivatives(self, values: Floats, block: Block, free: Sequence[int]) -> tuple[Floats, Floats, Floats, Bools]:
        """By the parameters ``free``, the joints and a displacement of the point (n, m, ·), and which rows could be
        computed."""
        joints, known, push = self._known(block)
        count = len(self.function.parameters)
        own = values[:count]
        stood = self._link("joints", joints, values, known)
        point = self.function(stood, own)
        shown = self._pushed(self._link("body", point, values, known), push)
        by_shown = self._by_input("sensor", shown, values, known)
        by_point = by_shown @ self._by_input("body", point, values, known)
        wanted = [k for k in free if k < count]
        by_stood, by_own = self.function.derivatives(stood, own, wanted)
        by_stood, by_own = by_point @ by_stood, by_point @ by_own
        columns = dict(zip(wanted, np.moveaxis(by_own, 2, 0), strict=True))
        for one, place in zip(self.effects, self._places, strict=True):
            asked = [k for k in free if place.start <= k < place.stop]
            if not asked:
                continue
            at, carry = {
                "joints": (joints, by_stood), "body": (point, by_shown), "sensor": (shown, np.eye(shown.shape[1])),
            }[one.link]  # fmt: skip
            carried = carry @ one.formula(at, known)
            columns |= {k: carried[:, :, k - place.start] for k in asked}
        out = np.stack([columns[k] for k in free], axis=2) if len(free) else np.zeros((*point.shape, 0))
        by_joints = by_stood @ self._by_input("joints", joints, values, known)
        by_push = by_shown if shown.shape[1] == 3 else np.zeros((*shown.shape, 3))
        reached = np.isfinite(self._link("sensor", shown, values, known)).all(axis=1)
        return out, by_joints, by_push, reached


def not_in(function: UserFunction, effects: Sequence[Generic]) -> tuple[Generic, ...]:
    """The effects without those parameters that do what the function's own parameters do already.

    Two names for one thing would be a valley in which no fit settles. Found at places over the joints' ranges.
    """
    joints = function.somewhere
    k, count = joints.shape[1], len(function.parameters)
    n, rng = len(joints), np.random.default_rng(1)
    known = np.column_stack([60.0 * np.arange(n), 20.0 + rng.normal(size=n), rng.choice([-1.0, 1.0], (n, k)),
                             rng.normal(size=(n, k)), 20.0 + rng.normal(size=n)])  # fmt: skip
    core = MachineCore(function, tuple(effects), 1.0, 0.0, 30.0 * n, 30.0 * n)
    total = count + sum(len(one.parameters) for one in effects)
    columns = core.derivatives(np.zeros(total), (joints, None, known, None), range(total))[0]
    whole = np.asarray(np.isfinite(columns).all(axis=(1, 2)))
    columns = columns[whole].reshape(-1, total)
    length = np.sqrt((columns**2).sum(axis=0))
    columns = columns / np.where(length > 0, length, 1.0)
    basis, size, _ = linalg.svd(columns[:, :count], full_matrices=False)
    basis = basis[:, size > _SAME * size.max(initial=0.0)]
    left = np.sqrt(((columns - basis @ (basis.T @ columns)) ** 2).sum(axis=0))
    new = np.flatnonzero(left > _SAME)
    out = []
    for one, place in zip(effects, core._places, strict=True):
        kept = [k for k in range(len(one.parameters)) if one.search or place.start + k in new]
        if kept:
            out.append(one.only(kept) if len(kept) < len(one.parameters) else one)
    return tuple(out)
