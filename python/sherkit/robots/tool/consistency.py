"""Does a filter know its own errors? Its deviations against a truth: coverage, NEES, and what that means.

Normalised innovations cannot see a bias: gains, references or a clock that are a little off move measurement and
estimate together. Where the truth is known, errors themselves are judged. Errors of neighbouring rows are alike, so the
band of the mean NEES is that of as many independent ones as their correlation leaves (sum of squared autocorrelations,
about zero, not about their mean: a bias that lasts is one error). Sources: Bar-Shalom, Li, Kirubarajan 2001, 5.4
(NEES); Bartlett 1946 (correlated errors).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy

from ...base import linalg
from ...base.types import Floats, Ints
from .alignment import at_times
from .filters import DEPTH_PART, NIS_LEVEL, TIP_PART, Estimate, Track
from .runs import check_camera

#: What intervals are stated to cover.
STATED = 0.95
#: A coverage of less is not called consistent, however few the independent errors are.
_LEAST_COVERAGE = 0.90
_LEAST_ROWS = 20
#: A deviation of less is no claim that anybody checks, mm.
_FINEST_MM = 1e-3


@dataclass(frozen=True)
class NeesConsistency:
    """How true the stated deviations of one estimate are, on ``rows`` of a run under a condition.

    ``coverage`` of what is stated to be 95 %; ``nees`` per degree of freedom, 1 where honest, with the 99 % band of as
    many independent errors as there are; ``largest`` error of a coordinate in its deviations. ``of_truth`` is the share
    of the variance that is the truth's own (the camera's noise).
    """

    quantity: str
    signal: str
    truth: str
    condition: str
    rows: int
    coverage: float
    nees: float
    low: float
    high: float
    largest: float
    of_truth: float
    least_coverage: float

    @property
    def verdict(self) -> str:
        """``consistent``, ``overconfident``, ``too careful``; ``unknown`` where the run is too short to say.

        Never *too careful* where fewer than 95 % of the truths lie inside.
        """
        if self.rows < _LEAST_ROWS:
            return "unknown"
        if self.nees > self.high or self.coverage < self.least_coverage:
            return "overconfident"
        if self.coverage < _LEAST_COVERAGE:
            return "unknown"
        return "too careful" if self.nees < self.low and self.coverage >= STATED else "consistent"


@dataclass(frozen=True, eq=False)
class _Truth:
    """Where a run tells the ``quantity``, by its own column or the camera (``name``): at m moments, each behind one of
    ``rows`` (m,). ``part`` are its columns of depth and tip, ``own`` is the truth's variance, ``lasting`` (m,) of the
    estimate's what one run draws but once, by the bench, ``off`` takes a signal
    (n, k) to its errors (m, k); ``raw`` are the signals without a filter, the paper's first."""

    quantity: str
    name: str
    part: slice
    rows: Ints
    own: float
    lasting: Floats
    off: Callable[[Floats], Floats]
    raw: Mapping[str, Floats]


def _truths(e: Estimate) -> list[_Truth]:
    run, out = e.run, []
    if (known_mm := run.depth_mm) is not None:
        there = np.flatnonzero(np.isfinite(known_mm))
        raw = {"gratings": e.held_depth_mm[:, None], "kinematics": e.kinematic_depth_mm[:, None]}
        tens = e.depth.value[there] / 10.0
        by = np.concatenate([np.ones_like(tens), tens, tens**2], axis=1)
        lasting = np.einsum("ni,ij,nj->n", by, np.array(e.tool.doubt.depth), by) + e.tool.doubt.deeper_mm**2
        out.append(
            _Truth(
                "depth", "depth_mm", DEPTH_PART, there, 0.0, lasting, lambda v: v[there] - known_mm[there, None], raw
            )
        )
    moments, seen = e.pictures
    if len(moments):
        before = np.searchsorted(run.time_s, moments, side="right") - 1
        own, raw = e.tool.camera_std_mm**2 / 3.0, {"kinematics": e.kinematic_tip_mm}
        out.append(
            _Truth(
                "tip",
                "camera",
                TIP_PART,
                before,
                own,
                np.zeros(len(before)),
                lambda v: at_times(run.time_s, v, moments) - seen,
                raw,
            )
        )
    return out


@linalg.one_thread()
def known(e: Estimate) -> list[NeesConsistency]:
    """Depth where the run has ``depth_mm``, tip where a camera saw it; over the run, with and without a force.

    The filter of both stands beside the others where these are not its parts, here and among the errors.
    """
    told = np.isfinite(e.fibre_depth_mm)
    out: list[NeesConsistency] = []
    for truth in _truths(e):
        signals = _filters(e, truth)
        with_force = told[truth.rows]
        conditions = {"whole run": np.ones_like(with_force), "with a force": with_force, "without a force": ~with_force}
        for signal, track in signals.items():
            off, covariance = truth.off(track.value), track.covariance[truth.rows]
            out += [
                knowledge(off[rows], covariance[rows], truth.own, truth.lasting[rows], quantity=truth.quantity,
                          signal=signal, truth=truth.name, condition=name)
                for name, rows in conditions.items()
                if rows.sum() >= _LEAST_ROWS
            ]  # fmt: skip
    return out


def _filters(e: Estimate, truth: _Truth) -> dict[str, Track]:
    signals = {"filter": e.depth if truth.quantity == "depth" else e.tip}
    return signals if e.tool.noise == "propagated" else signals | {"filter of both": e.together.part(truth.part)}


def known_of(truths: Sequence[NeesConsistency], quantity: str) -> NeesConsistency | None:
    """What is known of the filter's depth or tip over the whole run."""
    return next((k for k in truths if (k.quantity, k.signal, k.condition) == (quantity, "filter", "whole run")), None)


def knowledge(
    off: Floats, covariance: Floats, of_truth: float = 0.0, lasting: Floats | float = 0.0, *,
    quantity: str = "depth", signal: str = "filter",
    truth: str = "truth", condition: str = "whole run",
) -> NeesConsistency:  # fmt: skip
    """From errors (n, k), mm, with stated covariances (n, k, k), mm², against a truth with its own variance, mm².
    ``lasting`` (n,), mm², of what is stated is one draw for all rows, which may be small by itself.

    Rows whose estimate or covariance is no number cover nothing, and are left out of the NEES.
    """
    rows, k = off.shape
    of = partial(NeesConsistency, quantity, signal, truth, condition, rows)
    usable = np.isfinite(off).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    if not usable.any():
        return of(coverage=0.0, nees=np.inf, low=0.0, high=0.0, largest=np.inf, of_truth=0.0, least_coverage=STATED)
    off, spread = off[usable], covariance[usable] + (of_truth + _FINEST_MM**2) * np.eye(k)
    whitened = linalg.solve(linalg.cholesky(spread), off[..., None])[..., 0]
    squared = (whitened**2).sum(axis=1)
    nees = float(squared.mean() / k)
    independent = _independent(whitened)
    some = max(int(independent), 1)
    low, high = scipy.stats.chi2.ppf([(1 - NIS_LEVEL) / 2, (1 + NIS_LEVEL) / 2], independent * k) / (independent * k)
    total = np.einsum("nii->n", spread)
    own = of_truth * k / total
    low *= float(np.clip(1.0 - np.broadcast_to(lasting, rows)[usable] * k / total, 0.0, 1.0).mean())
    inside = int((squared <= scipy.stats.chi2.ppf(STATED, k)).sum())
    return of(
        coverage=inside / rows, nees=nees, low=float(low), high=float(high),
        largest=float((np.abs(off) / np.sqrt(np.einsum("nii->ni", spread))).max()), of_truth=float(np.median(own)),
        least_coverage=float(scipy.stats.binom.ppf((1 - NIS_LEVEL) / 2, some, STATED) / some),
    )  # fmt: skip


def _independent(whitened: Floats) -> float:
    """How many independent errors (n, k) are worth, for the mean of their squares: n / (1 + 2 Σ ρ²)."""
    n = len(whitened)
    power = float((whitened**2).sum())
    if power == 0.0:
        return float(n)
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(whitened, size, axis=0)) ** 2
    correlation = np.fft.irfft(spectrum.sum(axis=1), size)[:n] / power
    # beyond the first crossing of zero there is nothing but noise
    end = int(np.argmax(correlation <= 0)) or n
    return float(max(n / (1.0 + 2.0 * (correlation[1:end] ** 2).sum()), 1.0))


# -- How far estimates are off, over T0 and T1 ----------------------------------------------------------------------

#: The paper's threshold between T0 and T1.
MISMATCH_MM = 0.1


@dataclass(frozen=True)
class SignalErrors:
    """Mean error in mm of one signal over all rows, over T0 and over T1 (NaN where there is none), and the largest."""

    signal: str
    total: float
    t0: float
    t1: float
    largest: float


@dataclass(frozen=True)
class ErrorStatistics:
    """Errors of every signal for one quantity, ``"depth"`` or ``"tip"``; ``share_t0`` of the rows are T0."""

    quantity: str
    truth: str
    share_t0: float
    errors: tuple[SignalErrors, ...]

    def of(self, signal: str) -> SignalErrors:
        """The errors of a signal by name."""
        return next(e for e in self.errors if e.signal == signal)


@linalg.one_thread()
def judge(e: Estimate) -> list[ErrorStatistics]:
    """Depth where the run has it, tip where a camera saw it. T0 and T1 by the filters of Eqs. 8 and 14.

    Raises :class:`~sherkit.errors.MeasurementError` for a camera whose places are in another unit.
    """
    moments, seen = e.pictures
    if len(moments):
        check_camera(at_times(e.run.time_s, e.kinematic_tip_mm, moments), seen, e.run.source)
    out = []
    for truth in _truths(e):
        signals = {
            **truth.raw,
            **{name: track.value for name, track in _filters(e, truth).items()},
            "paper's filter": e.paper.value[:, truth.part],
        }
        off = {name: truth.off(value) for name, value in signals.items()}
        t0 = np.linalg.norm(off["filter"] - off[next(iter(off))], axis=1) > MISMATCH_MM
        made = []
        for name, one in off.items():
            size = np.linalg.norm(one, axis=1)
            total, first, second = (float(v.mean()) if len(v) else float("nan") for v in (size, size[t0], size[~t0]))
            made.append(SignalErrors(name, total, first, second, float(size.max())))
        out.append(ErrorStatistics(truth.quantity, truth.name, float(t0.mean()), tuple(made)))
    return out


def mean_errors(judged: Sequence[ErrorStatistics]) -> dict[str, dict[str, float]]:
    """Mean errors over the whole run, mm, by quantity and signal."""
    return {j.quantity: {x.signal: x.total for x in j.errors} for j in judged}
