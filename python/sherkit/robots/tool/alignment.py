"""Streams with different clocks and rates: values at other moments, the delay between two clocks, the turn between two
clouds of points, and how well these are known.
"""

from __future__ import annotations

import warnings
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy
from numpy.typing import ArrayLike
from scipy.linalg import cho_solve

import sherkit._core as _core

from ...base import linalg
from ...base.figures import listed
from ...base.types import Floats
from ...errors import FitError, ShapeError, SherkitWarning
from .runs import ToolRun, check_shapes, likeness
from .tool import POSITION, FlexibleTool, nested

# -- The rigid transform between two clouds of points ----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Registration:
    """x_target = ``rotation`` x_source + ``translation_mm``.

    ``residuals_mm`` (n, 3) are target less transformed source. ``covariance`` (6, 6) is that of a small rotation (rad,
    about the target's axes) and of the translation (mm), for residuals of the size found.
    """

    rotation: Floats
    translation_mm: Floats
    residuals_mm: Floats
    covariance: Floats

    @property
    def rotation_rad(self) -> Floats:
        """The rotation as a vector (3,)."""
        return np.asarray(scipy.spatial.transform.Rotation.from_matrix(self.rotation).as_rotvec())

    @property
    def mean_error_mm(self) -> float:
        """Mean length of the residuals, as the paper prints it (Eq. 20)."""
        known = np.isfinite(self.residuals_mm).all(axis=1)
        return float(np.linalg.norm(self.residuals_mm[known], axis=1).mean())

    def apply(self, points_mm: ArrayLike) -> Floats:
        """Points (n, 3) of the source's frame in the target's."""
        return np.atleast_2d(np.asarray(points_mm, dtype=float)) @ self.rotation.T + self.translation_mm


def register(source_mm: ArrayLike, target_mm: ArrayLike, method: str = "quaternion") -> Registration:
    """The transform that takes points (n, 3) to points (n, 3), by ``"quaternion"`` or ``"svd"``; both agree.

    Raises :class:`~sherkit.errors.ShapeError` for clouds of unlike size, and :class:`~sherkit.errors.FitError` that
    says whether the points are too few or stand on a line.
    """
    a, b = (np.ascontiguousarray(np.atleast_2d(np.asarray(p, dtype=float))) for p in (source_mm, target_mm))
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 3:
        raise ShapeError(f"registration: expected two clouds (n, 3), got {a.shape} and {b.shape}")
    found = _core.register_points(a, b, method)
    return Registration(
        rotation=found["rotation"],
        translation_mm=found["translation_mm"],
        residuals_mm=found["residuals_mm"],
        covariance=found["unit_covariance"] * found["residual_variance"],
    )


# -- How well a fit to pictures is known whose errors are alike at neighbouring places and times --------------------

#: Pictures, evenly over the run, from which size and reaches are taken: what they cost grows with the cube.
_MOST = 240
#: What is tried: reaches over place and time in parts of what the run spans, and the variance of the smooth errors over
#: that of the noise.
_REACHES_MM, _REACHES_S = np.geomspace(0.05, 0.8, 5), np.array([0.03, 0.2, 10.0])
_RATIOS = np.concatenate([[0.0], np.geomspace(0.01, 100.0, 9)])


@dataclass(frozen=True, eq=False)
class SmoothErrors:
    """Errors of one axis: white ``noise_mm``, and smooth ones of ``size_mm`` that are alike within ``reach_mm``.
    ``covariance`` (p, p) is that of the parameters fitted by least squares."""

    noise_mm: float
    size_mm: float
    reach_mm: float
    covariance: Floats


def smooth_errors(jacobian: Floats, residuals_mm: Floats, places_mm: Floats, time_s: Floats) -> SmoothErrors:
    """Of a least-squares fit with derivatives (n, m, p) that leaves residuals (n, m), at places (n, 3), mm, and times
    (n,). Raises :class:`~sherkit.errors.Singular` for derivatives that are no fit's."""
    n, m, p = jacobian.shape
    flat = jacobian.reshape(n * m, p)
    # the same size for angles, lengths and delays
    unit = np.linalg.norm(flat, axis=0)
    inverse = linalg.inv((flat / unit).T @ (flat / unit))
    some = np.unique(np.linspace(0, n - 1, min(n, _MOST)).round().astype(np.int64))
    j, e = jacobian[some] / unit, residuals_mm[some]
    apart = ((places_mm[some, None] - places_mm[None, some]) ** 2).sum(axis=2)
    later = (time_s[some, None] - time_s[None, some]) ** 2
    spans = np.sqrt([max(apart.max(), 1e-12), max(later.max(), 1e-12)])

    covariances, criteria, told = [], [], []
    for wide, long in product(_REACHES_MM * spans[0], _REACHES_S * spans[1]):
        alike = np.exp(-0.5 * (apart / wide**2 + later / long**2))
        within = np.einsum("nmi,nk,kmj->ij", j, alike, j, optimize=True) * (n / len(some)) ** 2
        for ratio in _RATIOS:
            criterion, variance = _restricted(j, e, ratio * alike)
            criteria.append(criterion)
            covariances.append(variance * (inverse + ratio * inverse @ within @ inverse))
            told.append((variance, ratio * variance, wide))
    share = np.exp(-0.5 * (np.array(criteria) - min(criteria)))
    share /= share.sum()
    noise, size, wide = told[int(np.argmax(share))]
    covariance = np.einsum("k,kij->ij", share, covariances) / np.outer(unit, unit)
    return SmoothErrors(float(np.sqrt(noise)), float(np.sqrt(size)), float(wide), covariance)


def _restricted(j: Floats, e: Floats, smooth: Floats) -> tuple[float, float]:
    """Minus twice the restricted log-likelihood of residuals (n, m) whose smooth part has a covariance (n, n) in units
    of the noise's, and the variance of the noise that goes with it."""
    n, m, p = j.shape
    factor = (linalg.cholesky(np.eye(n) + smooth), True)
    solved = cho_solve(factor, np.concatenate([j.reshape(n, -1), e], axis=1))
    weighted, left = solved[:, : m * p].reshape(j.shape), solved[:, m * p :]
    gram, right = np.einsum("nmi,nmk->ik", j, weighted), np.einsum("nmi,nm->i", j, left)
    free = e.size - p
    variance = max(float((e * left).sum() - right @ linalg.solve(gram, right)), 1e-300) / free
    determinant = 2.0 * m * np.log(np.diag(factor[0])).sum() + np.linalg.slogdet(gram)[1]
    return float(free * np.log(variance) + determinant), variance


# -- Streams in time -------------------------------------------------------------------------------------------------

_LEAST = 8
#: Velocities are taken over twice this, s.
_STEP_S = 0.01


def at_times(time_s: ArrayLike, values: ArrayLike, moments_s: ArrayLike) -> Floats:
    """``values`` (n, k), taken at growing times (n,), at other moments (m,) by straight lines between neighbours.

    Raises :class:`~sherkit.errors.ShapeError` for times that do not grow, moments outside them, or unlike sizes.
    """
    t, v, at = (np.asarray(a, dtype=float) for a in (time_s, values, moments_s))
    if t.ndim != 1 or len(t) != len(v) or len(t) < 2:
        raise ShapeError(f"times: expected a time for each of {len(v)} rows, two or more; got shape {t.shape}")
    if not (np.diff(t) > 0).all():
        raise ShapeError(f"times: row {int(np.argmin(np.diff(t) > 0)) + 1} is not later than the one before")
    if len(at) and not ((at >= t[0]) & (at <= t[-1])).all():
        row = int(np.argmax(~((at >= t[0]) & (at <= t[-1]))))
        raise ShapeError(f"moments: row {row} at {at[row]:g} s lies outside {t[0]:g} to {t[-1]:g} s")
    after = np.clip(np.searchsorted(t, at, side="right"), 1, len(t) - 1)
    share = ((at - t[after - 1]) / (t[after] - t[after - 1])).reshape(-1, *[1] * (v.ndim - 1))
    return np.asarray(v[after - 1] + share * (v[after] - v[after - 1]))


@dataclass(frozen=True, eq=False)
class Aligned:
    """A camera brought into the robot's frame and clock.

    ``registration`` takes camera to base, ``delay_s`` ± ``delay_std_s`` is how much later the camera's clock stands,
    ``rms_mm`` what is left. Both deviations are those under ``errors``: the camera's noise, and what its pictures have
    in common where they are near each other.
    """

    registration: Registration
    delay_s: float
    delay_std_s: float
    rms_mm: float
    errors: SmoothErrors

    def in_tool(self, tool: FlexibleTool) -> FlexibleTool:
        """The tool whose file says where the camera is, how late its clock, and how far off what it sees (in space)."""
        found = self.registration
        off = np.sqrt(np.square(found.residuals_mm).sum(axis=1).mean())
        return replace(
            tool, camera_rotation_rad=nested(found.rotation_rad), camera_translation_mm=nested(found.translation_mm),
            camera_delay_s=self.delay_s, camera_std_mm=float(off) or tool.camera_std_mm,
        )  # fmt: skip


@linalg.one_thread()
def align(
    robot_time_s: ArrayLike, robot_mm: ArrayLike, camera_time_s: ArrayLike, camera_mm: ArrayLike, *,
    longest_s: float = 0.5, source: str = "alignment",
) -> Aligned:  # fmt: skip
    """Frame and clock of a camera from a motion of the unbent tool that both saw: least squares over both.

    Robot (n, 3) at its times, camera (m, 3) at its own; delays up to ``longest_s`` either way are tried. Deviations
    are those of :func:`~sherkit.robots.tool.alignment.smooth_errors`. Raises :class:`~sherkit.errors.FitError`
    where fewer than eight pictures fall into the robot's time at every delay tried, where the camera saw another
    motion, one in other units or mirrored, where nothing moves enough to tell the delay, and as
    :func:`~sherkit.robots.tool.alignment.register`.
    """
    t, x = np.asarray(robot_time_s, dtype=float), np.asarray(robot_mm, dtype=float)
    at, seen = np.asarray(camera_time_s, dtype=float), np.asarray(camera_mm, dtype=float)
    inside = (at - longest_s >= t[0]) & (at + longest_s <= t[-1])
    if int(inside.sum()) < _LEAST:
        raise FitError(
            f"{source}: {int(inside.sum())} pictures lie inside the robot's time by {longest_s:g} s on both sides; "
            f"expected {_LEAST} or more"
        )
    at, seen = at[inside], seen[inside]

    def left(delay: float) -> float:
        try:
            return float((register(seen, at_times(t, x, at - delay)).residuals_mm ** 2).sum())
        except FitError:  # so far off that nothing is left of the cloud's shape
            return float("inf")

    grid = np.linspace(-longest_s, longest_s, 81)
    squares = np.array([left(d) for d in grid])
    nearest = max(grid[::4], key=lambda d: likeness(at_times(t, x, at - d), seen).best)
    check_shapes(at_times(t, x, at - nearest), seen, source)
    if not np.isfinite(squares).any():
        raise FitError(
            f"{source}: this motion tells no turn of the camera; lead the free tool to places some centimetres apart, "
            "in all three directions"
        )
    best = int(np.argmin(squares))
    if best in (0, len(grid) - 1):
        raise FitError(f"{source}: the delay lies at the end of what was tried, {grid[best]:+g} s; allow a longer one")
    found = scipy.optimize.minimize_scalar(left, bounds=(grid[best - 1], grid[best + 1]), method="bounded",
                                     options={"xatol": 1e-7})  # fmt: skip
    delay = float(found.x)
    registration = register(seen, at_times(t, x, at - delay))
    before, after = (np.clip(at - delay + s, t[0], t[-1]) for s in (-_STEP_S, _STEP_S))
    velocity = (at_times(t, x, after) - at_times(t, x, before)) / (after - before)[:, None]
    if not np.abs(velocity).max() > 0:
        raise FitError(f"{source}: nothing moves enough to tell the delay between the clocks")
    turned = seen @ registration.rotation.T
    cross = np.cross(np.eye(3), turned[:, None, :]).transpose(0, 2, 1)
    moved = np.concatenate([cross, np.broadcast_to(np.eye(3), (len(at), 3, 3)), velocity[:, :, None]], axis=2)
    errors = smooth_errors(moved, registration.residuals_mm, seen, at)
    return Aligned(
        replace(registration, covariance=errors.covariance[:6, :6]), delay,
        float(np.sqrt(errors.covariance[6, 6])), float(np.sqrt(left(delay) / (3 * len(at)))), errors,
    )  # fmt: skip


#: Smooth errors of so many times the noise are none of a camera; where the robot's places are told otherwise, less than
#: this part of what was left is left.
_NO_CAMERA, _NEARER = 4.0, 0.3


def align_run(free: ToolRun, longest_s: float, length_mm: float) -> Aligned:
    """The same from a run in which the unbent tool, of this free length, was led around freely. Raises
    :class:`~sherkit.errors.FitError` as well for places of the flange, and warns of other places than the camera's."""
    refused, found, on = None, None, None
    try:
        found = _aligned(free, longest_s)
    except FitError as error:
        refused = error
    if found is not None and found.errors.size_mm < _NO_CAMERA * found.errors.noise_mm:
        return found
    with suppress(FitError):
        on = _aligned(free.further_on(length_mm), longest_s)
    if on is not None and (found is None or on.rms_mm < _NEARER * found.rms_mm):
        now = "no frame of the camera fits" if found is None else f"it is {found.registration.mean_error_mm:.2f} mm"
        raise FitError(
            f"{free.source}: {listed(POSITION)} are those of the flange, and not of the unbent tip {length_mm:.3g} mm "
            f"further on: with that undone the mean error is {on.registration.mean_error_mm:.2f} mm, now {now}"
        )
    if found is None:
        raise refused or FitError(free.source)
    off = found.registration.mean_error_mm
    warnings.warn(
        f"{free.source}: the camera sees the tip {off:.2f} mm from where the robot has it, and its pictures "
        f"scatter by {found.errors.noise_mm:.2f} mm an axis: did something touch the tool, or are "
        f"{listed(POSITION)} of another place than the unbent tip? A frame from them is off by as much",
        SherkitWarning, stacklevel=2,
    )  # fmt: skip
    return found


def _aligned(free: ToolRun, longest_s: float) -> Aligned:
    return align(
        free.time_s, free.position_mm, free.camera_time_s, free.camera_mm, longest_s=longest_s, source=free.source
    )
