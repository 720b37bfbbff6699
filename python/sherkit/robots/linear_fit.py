"""What a fit and its correction take of an effect that is not in the model, and what that leaves.

Both are a linear function of the readings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..base import linalg
from ..base.types import Bools, Floats, Ints
from ..fit.error import known_deviations
from ..fit.identify import Fit
from ..model.chain import ChainModel
from ..model.effect import Effect
from .identified_model import BiasBound, IdentifiedModel, at_rest, by_effect, waves, with_effect

#: Singular values below this part of the largest are directions that the poses do not observe; as in planning.
_UNOBSERVED = 1e-7
#: An effect alone explains the readings as well as a correction does, if it leaves at most this times its variance.
_AS_WELL = 1.5
#: Eigenvalues below this part of the largest are rounding.
_ROUNDING = 1e-15
#: Sum of squares over the noise that is none.
_NOTHING = 1e-200

#: What coordinates miss (n, d, k) where readings miss (n, m, k), from joints (n, j) and by_joints (n, m, j).
Carry = Callable[[Floats, Floats, Floats], Floats]


@dataclass(frozen=True, eq=False)
class Counted:
    """What counts in one frame: the ``spread`` (q, d, d) that is known, which of the identified ``values`` (p,) move
    places there by what they took of an effect, and which effects do."""

    spread: Floats
    values: Bools
    moves: Callable[[Effect], bool]


@dataclass(frozen=True, eq=False)
class AccuracyQuery:
    """Where a robot is asked how far off it could be: coordinates (q, d), joints (q, j), time, temperature and
    directions (q, 2 + j), and what is ``counted`` in each of its frames, its own first; ``carry`` turns readings into
    coordinates."""

    coordinates: Floats
    joints: Floats
    now: Floats
    counted: tuple[Counted, ...]
    carry: Carry


@dataclass(frozen=True, eq=False)
class LinearFit:
    """A fit, the part that was made from it, where that is asked, and the rows (r,) of the run that count."""

    fit: Fit
    part: IdentifiedModel
    asked: AccuracyQuery
    rows: Ints

    @cached_property
    def deployed(self) -> ChainModel:
        """The model that is deployed."""
        return self.part.model(self.fit.model.robot)

    # -- derivatives ---------------------------------------------------------------------------------------

    def columns(self, effect: Effect, setting: float | None) -> tuple[Floats, Floats]:
        """Derivatives by an effect's parameters at the rows (r, m, k) and at the asked places (q, m, k)."""
        if effect.is_periodic and setting is not None:
            return self.wave(effect, 1.0 / setting)
        fit, asked = self.fit, self.asked
        model, values, own = with_effect(fit.model, fit.values, effect, setting)
        at_rows = model.derivatives(fit.data, values)[self.rows][:, :, own]
        readings = fit.data.layout.coordinates
        there = by_effect(self.deployed, self.part.values, effect, setting, readings, asked.joints, asked.now)
        return at_rows, there[1]

    def wave(self, effect: Effect, frequency: float) -> tuple[Floats, Floats]:
        """The same of sine and cosine of each joint that has waves, at each end of a distance."""
        k, data = self.joints.shape[1], self.fit.data
        which = effect.waving(data.layout.joints)
        here = waves(self._by_joints[:, :, :k], self.joints, 1.0 / frequency, which)
        if self._by_joints.shape[2] > k:
            there = data.from_other_end.joints[self.rows]
            here = here + waves(self._by_joints[:, :, k:], there, 1.0 / frequency, which)
        return here, waves(self._there[1], self.asked.joints, 1.0 / frequency, which)

    @cached_property
    def joints(self) -> Floats:
        """Joints (r, j) of the rows."""
        return np.ascontiguousarray(self.fit.data.joints[self.rows])

    @cached_property
    def _by_joints(self) -> Floats:
        inputs = self.fit.model.linearised(self.fit.data, self.fit.values).inputs
        assert inputs is not None, "a chain has derivatives by its joints"
        return np.ascontiguousarray(inputs[self.rows])

    @cached_property
    def _there(self) -> tuple[Floats, Floats]:
        """At the asked places: by the deployed values (q, m, p), by the joints (q, m, j)."""
        readings, asked = self.fit.data.layout.coordinates, self.asked
        return at_rest(self.deployed, self.part.values, readings, asked.joints, asked.now)[:2]

    @cached_property
    def _by_values(self) -> Floats:
        return np.asarray(self.fit.model.derivatives(self.fit.data, self.fit.values)[self.rows])

    # -- what the identified values take -------------------------------------------------------------------

    @cached_property
    def _weights(self) -> Floats:
        return np.where(self.fit.data.used, 1.0 / self.fit.noise.sigma, 0.0)[self.rows]

    @cached_property
    def _moved(self) -> tuple[Floats, Floats, Floats]:
        """A basis (N, s) of what the identified values move, and their change (p, s) along it: what they take of
        something is its part along the basis. Orthonormal, but where something is known of the values: then with the
        rows (p, s) of that, which are none of any effect, but see what the values take of it."""
        size, known = self.fit.sizes, known_deviations(self.fit)
        whole = (self._by_values * self._weights[:, :, None] * size).reshape(-1, len(size))
        rows = whole if known is None else np.concatenate([whole, np.diag(size * np.sqrt(known[0] * self._noise))])
        left, singular, right = linalg.svd(rows, full_matrices=False)
        use = singular > _UNOBSERVED * singular[0]
        return left[: len(whole), use], size[:, None] * (right[use].T / singular[use]), left[len(whole) :, use]

    @cached_property
    def _left(self) -> Floats:
        return (np.where(self.fit.data.used, np.nan_to_num(self.fit.residuals), 0.0)[self.rows] * self._weights).ravel()

    @property
    def _noise(self) -> float:
        """Variance of a reading over its weight: where the noise is known, with what the model lacks, as the fit
        weighed its readings against what is known of the values."""
        if self.fit.noise.origin != "unknown":
            return max(self.fit.scale, 1.0) ** 2
        free = max(int(np.count_nonzero(self._weights)) - len(self.fit.values), 1)
        return float(np.square(self._left).sum()) / free

    @cached_property
    def _residual(self) -> Floats:
        """What the fit leaves (N,), over the noise, before any correction."""
        basis = self._moved[0]
        return self._left if known_deviations(self.fit) is not None else self._left - basis @ (basis.T @ self._left)

    @cached_property
    def _off_known(self) -> Floats:
        """What the values (p,) are off what is known of them, as the rows of that have it."""
        known = known_deviations(self.fit)
        if known is None:
            return np.zeros(0)
        return np.asarray(known[1] / np.sqrt(np.where(known[0] > 0, known[0], 1.0)) * np.sqrt(self._noise))

    @cached_property
    def _cells(self) -> Ints:
        """A number (r, m) for each reading, equal for the same reading of repeats of a pose."""
        m = self._weights.shape[1]
        return self.fit.data.groups[self.rows][:, None] * m + np.arange(m)

    # -- what a correction takes ---------------------------------------------------------------------------

    @cached_property
    def _full(self) -> Ints:
        """Rows whose coordinates were all read: those that a correction is fitted to."""
        return np.flatnonzero((self._weights[:, : self.fit.data.coordinates] > 0).all(axis=1))

    @cached_property
    def _functions(self) -> tuple[Floats, Floats, Floats]:
        """A correction's functions at full rows (f, c), an orthonormal basis (f, c) of them, and what gives the
        coefficients from the parts along it (c, c)."""
        d = self.asked.coordinates.shape[1]
        at = self.part.functions(np.ascontiguousarray(self.fit.predicted[self.rows[self._full], :d]))
        if not at.shape[1]:
            return at, at, np.zeros((0, 0))
        basis, upper = linalg.qr(at)
        return at, basis, linalg.pinv(upper)

    @cached_property
    def _functions_there(self) -> Floats:
        return self.part.functions(self.asked.coordinates)

    @cached_property
    def _corrected(self) -> tuple[Floats, float] | None:
        """What a correction leaves (f d,), over the noise, and its variance; None without one."""
        basis, d = self._functions[1], self.asked.coordinates.shape[1]
        if not basis.shape[1]:
            return None
        weights = self._weights[self._full, :d]
        r = self._residual.reshape(self._weights.shape)[self._full, :d] / weights
        r = ((r - basis @ (basis.T @ r)) * weights).ravel()
        free = len(r) - self._moved[0].shape[1] - d * basis.shape[1]
        return (r, float(r @ r) / free) if free > 0 else None

    # -- one effect ----------------------------------------------------------------------------------------

    def assess(self, effect: Effect, setting: float | None, rows: Floats) -> BiasBound:
        """What the poses leave open of an effect with these columns, without advice."""
        k, d = rows.shape[2], self.asked.coordinates.shape[1]
        basis, change, known = self._moved
        whole = (rows * self._weights[:, :, None]).reshape(-1, k)
        take = basis.T @ whole
        absorbed = change @ take
        size = np.array([p.size for p in effect.parameters])
        left = (rows[self._full] - self._by_values[self._full] @ absorbed)[:, : self.fit.data.coordinates]
        corrected = np.zeros((0, d, k))
        kept = np.concatenate([whole - basis @ take, -known @ take])
        residual = np.concatenate([self._residual, self._off_known])
        cells = np.concatenate([self._cells.ravel(), self._cells.max(initial=0) + 1 + np.arange(len(known))])
        moment, noise = self._known(kept, residual, cells, basis.shape[1], size)
        if self._functions[1].shape[1]:
            functions = self._functions[1]
            flat = left.reshape(len(left), -1)
            along = functions.T @ flat
            corrected = (self._functions[2] @ along).reshape(-1, d, k)
            left = (flat - functions @ along).reshape(left.shape)
            if self._corrected is not None and noise > _AS_WELL * self._corrected[1]:
                # it cannot stand for what the correction took: it could only be there besides
                kept = (left * self._weights[self._full, :d, None]).reshape(-1, k)
                cells, used = self._cells[self._full, :d].ravel(), basis.shape[1] + functions.shape[1] * d
                moment, _ = self._known(kept, self._corrected[0], cells, used, size)
        by_joints = self._by_joints[self._full][:, : left.shape[1], : self.joints.shape[1]]
        shown = self.asked.carry(self.joints[self._full], by_joints, left)
        seen = np.tensordot(shown @ moment, shown, ([0, 2], [0, 2])) / max(len(shown), 1)
        return BiasBound(
            effect.name, setting, absorbed[: len(self.part.values)], corrected, moment, seen, np.zeros((0, d)), 1.0
        )

    def missed(self, one: BiasBound, effect: Effect, places: Floats, frame: Counted | None = None) -> Floats:
        """What coordinates miss at the asked places (q, d, k) of an effect whose columns there are ``places`` (q, m,
        k): in a frame, or as readings are."""
        by_values = self._there[0] if frame is None else np.where(frame.values, self._there[0], 0.0)
        moved = places if frame is None or frame.moves(effect) else np.zeros_like(places)
        missed = one.missed(by_values, moved, self._functions_there)
        return self.asked.carry(self.asked.joints, self._there[1], missed)

    def least_seen(self, rows: Floats) -> float:
        """Of columns (r, m, k) in like units, how much the poses show of the combination of which they show least."""
        whole = (rows * self._weights[:, :, None]).reshape(-1, rows.shape[2])
        take = self._moved[0].T @ whole
        return float(np.sqrt(linalg.eigvalsh(whole.T @ whole - take.T @ take)[0].clip(0.0)))

    def taken(self, rows: Floats) -> float:
        """How much columns (r, m, k) take of the squares that the fit leaves."""
        kept = (rows * self._weights[:, :, None]).reshape(-1, rows.shape[2])
        kept = kept - self._moved[0] @ (self._moved[0].T @ kept)
        along = kept.T @ self._residual
        return float(along @ linalg.pinv(kept.T @ kept, hermitian=True) @ along)

    def _known(self, kept: Floats, residual: Floats, cells: Ints, used: int, size: Floats) -> tuple[Floats, float]:
        """Second moment (k, k) of an effect's parameters of plausible ``size`` (k,), and the variance that it leaves.

        ``kept`` (N, k) are its columns without what is taken of them, ``residual`` (N,) likewise, ``used`` directions
        are taken. Errors that all repeats of a pose share count once for the pose.
        """
        prior, scaled = np.diag(size**2), kept * size
        # by eigenvalues, as readings without noise leave next to nothing beside them
        value, vector = linalg.eigh(scaled.T @ scaled)
        along = scaled.T @ residual
        told = value > _ROUNDING * value[-1]
        rest = residual - scaled @ (vector[:, told] @ ((vector[:, told].T @ along) / value[told]))
        squares = float(rest @ rest)
        free = int(np.count_nonzero(residual)) - used - len(size)
        if free <= 0 or squares <= _NOTHING:
            return prior, np.inf
        shared = max(float((np.bincount(cells, rest) ** 2).sum()) / squares, 1.0)
        noise = squares / free
        inverse = (vector / (np.maximum(value, 0.0) + noise * shared)) @ vector.T
        mean = inverse @ along
        return (noise * shared * inverse + np.outer(mean, mean)) * np.outer(size, size), noise


def used_rows(fit: Fit, *, one_each: bool) -> Ints:
    """Rows of which anything is used; of each pose only the first where asked for."""
    rows = np.flatnonzero(fit.data.used.any(axis=1))
    if one_each:
        rows = rows[~fit.data.is_distance[rows]]
    return np.sort(rows[np.unique(fit.data.groups[rows], return_index=True)[1]]) if one_each else rows
