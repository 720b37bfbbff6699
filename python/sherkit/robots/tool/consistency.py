"""Does a filter know its own errors? Its deviations against a truth: coverage, NEES, and what that means.

Normalised innovations cannot see a bias: gains, references or a clock that are a little off move measurement and
estimate together. Where the truth is known, errors themselves are judged. Errors of neighbouring rows are alike, so the
band of the mean NEES is that of as many independent ones as their correlation leaves (sum of squared autocorrelations,
about zero, not about their mean: a bias that lasts is one error). Sources: Bar-Shalom, Li, Kirubarajan 2001, 5.4
(NEES); Bartlett 1946 (correlated errors).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ...base import linalg
from ...base.types import Bools, Floats
from .alignment import at_times
from .filters import NIS_LEVEL, Estimate
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


@linalg.one_thread()
def known(e: Estimate) -> list[NeesConsistency]:
    """Depth where the run has ``depth_mm``, tip where a camera saw it; over the run, with and without a force.

    The filter of both stands beside the others where these are not its parts.
    """
    run, tool = e.run, e.tool
    apart = tool.noise != "propagated"
    told = np.isfinite(e.fibre_depth_mm)
    out: list[NeesConsistency] = []
    if run.depth_mm is not None:
        there = np.isfinite(run.depth_mm)
        depths = {
            "filter": (e.depth.value, e.depth.covariance),
            **({"filter of both": (e.together.value[:, :1], e.together.covariance[:, :1, :1])} if apart else {}),
        }
        for signal, (value, covariance) in depths.items():
            off = (value[:, 0] - run.depth_mm)[there, None]
            out += _by_condition("depth", signal, "depth_mm", off, covariance[there], 0.0, told[there])
    moment = run.camera_time_s - tool.camera_delay_s
    seen = (moment >= run.time_s[0]) & (moment <= run.time_s[-1])
    if seen.any():
        moment, truth = moment[seen], tool.in_base(run.camera_mm[seen])
        row = np.searchsorted(run.time_s, moment, side="right") - 1
        tips = {
            "filter": (e.tip.value, e.tip.covariance),
            **({"filter of both": (e.together.value[:, 1:], e.together.covariance[:, 1:, 1:])} if apart else {}),
        }
        for signal, (value, covariance) in tips.items():
            off = at_times(run.time_s, value, moment) - truth
            own = tool.camera_std_mm**2 / 3.0
            out += _by_condition("tip", signal, "camera", off, covariance[row], own, told[row])
    return out


def _by_condition(
    quantity: str, signal: str, truth: str, off: Floats, covariance: Floats, of_truth: float, told: Bools
) -> list[NeesConsistency]:
    conditions = {"whole run": np.ones(len(off), dtype=bool), "with a force": told, "without a force": ~told}
    return [
        knowledge(off[rows], covariance[rows], of_truth, quantity=quantity, signal=signal, truth=truth, condition=name)
        for name, rows in conditions.items()
        if rows.sum() >= _LEAST_ROWS
    ]


def knowledge(
    off: Floats, covariance: Floats, of_truth: float = 0.0, *, quantity: str = "depth", signal: str = "filter",
    truth: str = "truth", condition: str = "whole run",
) -> NeesConsistency:  # fmt: skip
    """From errors (n, k), mm, with stated covariances (n, k, k), mm², against a truth with its own variance, mm².

    Rows whose estimate or covariance is no number cover nothing, and are left out of the NEES.
    """
    rows, k = off.shape
    usable = np.isfinite(off).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    if not usable.any():
        return NeesConsistency(quantity, signal, truth, condition, rows, coverage=0.0, nees=np.inf, low=0.0, high=0.0,
                            largest=np.inf, of_truth=0.0, least_coverage=STATED)  # fmt: skip
    off, spread = off[usable], covariance[usable] + (of_truth + _FINEST_MM**2) * np.eye(k)
    whitened = linalg.solve(linalg.cholesky(spread), off[..., None])[..., 0]
    squared = (whitened**2).sum(axis=1)
    nees = float(squared.mean() / k)
    independent = _independent(whitened)
    some = max(int(independent), 1)
    low, high = scipy.stats.chi2.ppf([(1 - NIS_LEVEL) / 2, (1 + NIS_LEVEL) / 2], independent * k) / (independent * k)
    own = of_truth * k / np.einsum("nii->n", spread)
    inside = int((squared <= scipy.stats.chi2.ppf(STATED, k)).sum())
    return NeesConsistency(
        quantity=quantity, signal=signal, truth=truth, condition=condition, rows=rows, coverage=inside / rows,
        nees=nees, low=float(low), high=float(high),
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

    def improvement(self, signal: str, over: str) -> float:
        """Part of the error over T0 of signal ``over`` that ``signal`` takes away."""
        return 1.0 - self.of(signal).t0 / self.of(over).t0


@linalg.one_thread()
def judge(e: Estimate) -> list[ErrorStatistics]:
    """Depth where the run has it, tip where a camera saw it. T0 and T1 by the filters of Eqs. 8 and 14.

    Raises :class:`~sherkit.errors.MeasurementError` for a camera whose places are in another unit.
    """
    out = []
    run = e.run
    if run.depth_mm is not None:
        truth = run.depth_mm
        rows = np.isfinite(truth)
        sensor = e.held_depth_mm
        t0 = np.abs(e.depth.value[:, 0] - sensor) > MISMATCH_MM
        signals = {
            "gratings": sensor,
            "kinematics": e.kinematic_depth_mm,
            "filter": e.depth.value[:, 0],
            "filter of both": e.together.value[:, 0],
            "paper's filter": e.paper.value[:, 0],
        }
        errors = {name: np.abs(value - truth)[rows] for name, value in signals.items()}
        out.append(_judged("depth", "depth_mm", errors, t0[rows]))
    if len(run.camera_time_s):
        tool = e.tool
        moment = run.camera_time_s - tool.camera_delay_s
        rows = (moment >= run.time_s[0]) & (moment <= run.time_s[-1])
        if rows.any():
            truth = tool.in_base(run.camera_mm[rows])
            moment = moment[rows]
            places = {
                "kinematics": at_times(run.time_s, e.kinematic_tip_mm, moment),
                "filter": at_times(run.time_s, e.tip.value, moment),
                "filter of both": at_times(run.time_s, e.together.value[:, 1:], moment),
                "paper's filter": at_times(run.time_s, e.paper.value[:, 1:], moment),
            }
            check_camera(places["kinematics"], truth, run.source)
            t0 = np.linalg.norm(places["filter"] - places["kinematics"], axis=1) > MISMATCH_MM
            errors = {name: np.linalg.norm(value - truth, axis=1) for name, value in places.items()}
            out.append(_judged("tip", "camera", errors, t0))
    return out


def _judged(quantity: str, truth: str, errors: dict[str, Floats], t0: Bools) -> ErrorStatistics:
    def mean(values: Floats) -> float:
        return float(values.mean()) if len(values) else float("nan")

    made = tuple(
        SignalErrors(name, mean(one), mean(one[t0]), mean(one[~t0]), float(one.max())) for name, one in errors.items()
    )
    return ErrorStatistics(quantity, truth, float(t0.mean()), made)
