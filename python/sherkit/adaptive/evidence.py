"""Evidence that may be looked at as often as one likes: Bayes factors whose weighted mean is an e-process.

Each hypothesis adds columns to what the model fits. Its Bayes factor against the model alone has a flat prior on what
the model fits, Jeffreys' on the noise, and coefficients that are normal with a standard deviation of
:data:`SIZES` times the noise on the reference. Under "nothing is missing" such a factor is the ratio of two densities
of the same maximal invariant, so that its mean over looks never rises; by Ville's inequality a weighted mean of them
exceeds 1/α at any look with a chance of α at most (Grünwald, de Heide and Koolen, "Safe testing", J. R. Stat. Soc. B
2024; Pérez-Ortiz, Lardy, de Heide and Grünwald, "E-statistics, group invariance and anytime-valid testing", Ann. Stat.
2024). No number of looks and no budget is in it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..base import linalg
from ..base.types import Floats, Ints
from ..evidence.whitening import orthonormal
from .hypotheses import Hypotheses, Key

#: What has no shape that these poses could tell: another error at each of them, the same when it is read once more.
ROUGH = "something finer than these poses"
#: Sizes of coefficients that are expected, in noises on the reference, each as likely.
SIZES = (0.7, 2.0, 6.0, 20.0, 60.0)
#: Pairs looked at: of the first so many effects, and shapes, with every other.
_FIRST, _FIRST_SHAPES = 6, 3


@dataclass(frozen=True, eq=False)
class Weighed:
    """Logarithms of the Bayes factors of all hypotheses beside a base, and the settings that are likeliest."""

    log_bf: dict[str, float]
    setting: dict[str, float | None]
    log_mean: float


class Evidence:
    """What a residual (N,) says of columns beside those of the model, all over the noise of each reading.

    ``own`` (N, p) is what the model fits, ``tried`` maps hypotheses to their columns (N, s, k) at each setting;
    ``rounding`` is the size of a reading's last digit, ``pose`` (N,) numbers readings that must agree but for noise.
    """

    def __init__(
        self, family: Hypotheses, residual: Floats, own: Floats, tried: Mapping[str, Floats], rounding: float = 0.0,
        pose: Ints | None = None,
    ) -> None:  # fmt: skip
        self.family, self.pose = family, pose
        self.own, self.raw_residual, self.tried = own, residual, tried
        self.basis = orthonormal(own)
        ends = np.cumsum([0, *(columns[0].size for columns in tried.values())])
        self.place = {name: slice(a, b) for name, a, b in zip(tried, ends[:-1], ends[1:], strict=True)}
        columns = np.concatenate(
            [c.reshape(len(residual), -1) for c in (*tried.values(), np.zeros((len(residual), 0)))], 1
        )
        self.columns = columns - self.basis @ (self.basis.T @ columns)
        self.residual = residual - self.basis @ (self.basis.T @ residual)
        self.free = len(residual) - self.basis.shape[1]
        # what is no more than the digits of a reading tells nothing: readings that were computed, not taken
        self._least = len(residual) * rounding**2

    def raw(self, key: Key) -> Floats:
        """Columns (N, k) of a hypothesis at a setting."""
        return np.asarray(self.tried[key[0]][:, self._number(key)])

    def left(self, key: Key) -> Floats:
        """What the model leaves of them."""
        width = self.tried[key[0]].shape[2]
        begin = self.place[key[0]].start + self._number(key) * width
        return self.columns[:, begin : begin + width]

    def _number(self, key: Key) -> int:
        return self.family.by_name[key[0]].settings.index(key[1])

    @cached_property
    def alone(self) -> Weighed:
        """Beside the model alone."""
        return self._weighed(self.columns, self.residual, self.free)

    def beside(self, keys: Iterable[Key]) -> Weighed:
        """Beside the model with these hypotheses in it."""
        keys = tuple(keys)
        basis = orthonormal(np.concatenate([self.left(key) for key in keys], axis=1))
        rest = self.columns - basis @ (basis.T @ self.columns)
        left = self.residual - basis @ (basis.T @ self.residual)
        return self._weighed(rest, left, self.free - basis.shape[1], without={name for name, _ in keys})

    def left_of(self, keys: Iterable[Key]) -> float:
        """The square of what the model with these hypotheses in it leaves."""
        taken = [self.left(key) for key in keys]
        basis = orthonormal(np.concatenate([np.zeros((len(self.residual), 0)), *taken], axis=1))
        return float(self.residual @ self.residual) - float(np.square(basis.T @ self.residual).sum())

    @cached_property
    def _alike(self) -> list[tuple[Ints, Ints]]:
        """All settings of all hypotheses by how many columns they have: their numbers (v,), one hypothesis after the
        other, and where their columns (v, k) stand."""
        counts = [len(self.family.by_name[name].settings) for name in self.place]
        widths = [(at.stop - at.start) // count for at, count in zip(self.place.values(), counts, strict=True)]
        width = np.repeat(np.array(widths, dtype=np.int64), counts)
        begins = np.cumsum(width) - width
        each = ((k, np.flatnonzero(width == k)) for k in np.unique(width).tolist())
        return [(some, begins[some, None] + np.arange(k)) for k, some in each]

    def _weighed(self, columns: Floats, residual: Floats, free: int, without: Iterable[str] = ()) -> Weighed:
        squares = float(residual @ residual)
        told = free > 0 and squares > self._least
        answers = columns.T @ residual
        found = np.zeros(sum(len(settings) for settings, _ in self._alike))
        for settings, at in self._alike if told else ():
            some = columns[:, at.ravel()].reshape(len(residual), *at.shape).transpose(1, 2, 0)
            found[settings] = log_bayes(some @ some.transpose(0, 2, 1), answers[at], squares, free)
        log_bf: dict[str, float] = {}
        setting: dict[str, float | None] = {}
        last = 0
        for name in self.place:
            h = self.family.by_name[name]
            first, last = last, last + len(h.settings)
            if name not in without:
                each = found[first:last]
                log_bf[name], setting[name] = (
                    _log_sum(each) - float(np.log(len(each))),
                    h.settings[int(np.argmax(each))],
                )
        if self.pose is not None and ROUGH not in without:
            log_bf[ROUGH] = Agreement.of(residual, self.pose, free).log_bf if told else 0.0
            setting[ROUGH] = None
        shares = np.array([self.family.by_name[name].weight for name in log_bf])
        mean = _log_sum(np.array(list(log_bf.values())) + np.log(shares / shares.sum())) if log_bf else 0.0
        return Weighed(log_bf, setting, mean)

    def sets(self) -> dict[tuple[Key, ...], float]:
        """Logarithms of weight times Bayes factor of every hypothesis alone and of pairs.

        A second one is looked for beside the first :data:`_FIRST` effects and as many shapes: pairs of which one shows
        alone. Shapes are among them, since two effects must not be named for what one effect and an unknown, or two
        unknowns, would do as well.
        """
        alone, by_name = self.alone, self.family.by_name
        out: dict[tuple[Key, ...], float] = {
            ((name, alone.setting[name]),): float(np.log(by_name[name].weight)) + value
            for name, value in alone.log_bf.items()
        }
        ordered = sorted(alone.log_bf, key=lambda name: -alone.log_bf[name])
        first = [name for name in ordered if not by_name[name].is_shape][:_FIRST]
        # of a second cause beside what has no shape nothing can be told
        first += [name for name in ordered if by_name[name].is_shape and name != ROUGH][:_FIRST_SHAPES]
        pairs: dict[frozenset[str], tuple[float, tuple[Key, ...]]] = {}
        for name in first:
            key = (name, alone.setting[name])
            given = self.beside([key])
            for other, value in given.log_bf.items():
                both = frozenset((name, other))
                total = float(np.log(self.family.weight((name, other)))) + alone.log_bf[name] + value
                if both not in pairs or total > pairs[both][0]:
                    first_key, second = sorted([key, (other, given.setting[other])], key=lambda one: one[0])
                    pairs[both] = (total, (first_key, second))
        return out | {pair: value for value, pair in pairs.values()}


def log_bayes(squares: Floats, answers: Floats, left: float, free: int) -> Floats:
    """Logarithms (v,) of Bayes factors of columns beside a base: their ``squares`` (v, k, k), their products with the
    residual ``answers`` (v, k), the residual's own square ``left`` and its degrees of freedom."""
    value, vector = linalg.eigh(squares)
    value = value.clip(0.0)
    along = np.einsum("vjk,vj->vk", vector, answers) ** 2
    sizes = []
    for size in SIZES:
        taken = (along * size**2 / (1.0 + size**2 * value)).sum(axis=1) / left
        sizes.append(
            -0.5 * np.log1p(size**2 * value).sum(axis=1) - 0.5 * free * np.log1p(-taken.clip(0.0, 1.0 - 1e-12))
        )
    top = np.max(sizes, axis=0)
    return np.asarray(top + np.log(np.mean(np.exp(sizes - top), axis=0)))


@dataclass(frozen=True)
class Agreement:
    """How a residual divides: what it leaves ``between`` poses and ``within`` them, from reading to reading, with
    degrees of freedom; a pose has ``times`` readings on average."""

    between: float
    within: float
    between_free: int
    within_free: int
    times: float

    @classmethod
    def of(cls, residual: Floats, pose: Ints, free: int) -> Agreement:
        """Of a residual (N,) of ``free`` degrees of freedom, by the numbers (N,) of poses."""
        count = np.bincount(pose)
        poses = int(np.count_nonzero(count))
        within = residual - (np.bincount(pose, residual) / np.maximum(count, 1))[pose]
        squares = float(within @ within)
        within_free = len(pose) - poses
        left = max(float(residual @ residual) - squares, 0.0)
        return cls(left, squares, free - within_free, within_free, len(pose) / max(poses, 1))

    @property
    def log_bf(self) -> float:
        """The logarithm of the Bayes factor of an error of its own at each pose, against noise alone.

        Where errors of poses have a variance of τ² noises, what is left between poses is χ² of 1 + τ² ``times`` the
        noise, and what is left within them of the noise alone: the lack-of-fit test of the field (Draper and Smith,
        *Applied Regression Analysis*, 1998, 2.1), with a prior on τ so that it may be looked at as often as one likes.
        """
        if self.within_free <= 0 or self.between_free <= 0 or not (self.between > 0 and self.within > 0):
            return 0.0
        grown = 1.0 + np.square(SIZES) * self.times
        ratios = (self.between + self.within) / (self.between / grown + self.within)
        free = self.between_free + self.within_free
        each = -0.5 * self.between_free * np.log(grown) + 0.5 * free * np.log(ratios)
        return _log_sum(each) - float(np.log(len(SIZES)))


def log_bayes_at(squares: Floats, answers: Floats, told: float, base: float, free: int) -> float:
    """The same of one hypothesis that was fitted in full, to first order about that fit: the ``squares`` (k, k) of its
    columns, their products ``answers`` (k,) with what it has to tell, the square ``told`` of that, and the square of
    the residual that the ``base`` leaves."""
    value, vector = linalg.eigh(squares)
    value, along = value.clip(0.0), (vector.T @ answers) ** 2
    sizes = []
    for size in SIZES:
        left = told - float((along * size**2 / (1.0 + size**2 * value)).sum())
        sizes.append(-0.5 * float(np.log1p(size**2 * value).sum()) - 0.5 * free * np.log(max(left / base, 1e-12)))
    return _log_sum(np.array(sizes)) - float(np.log(len(SIZES)))


def _log_sum(values: Floats) -> float:
    """The logarithm of a sum of exponentials."""
    top = float(values.max())
    return top + float(np.log(np.exp(values - top).sum()))
