"""Streams with different clocks and rates: values at other moments, and the delay between two clocks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ...base.types import Floats
from ...errors import FitError, ShapeError
from .plausible import check_shapes, likeness
from .registration import Registration, register
from .runs import ToolRun
from .smooth_errors import SmoothErrors, smooth_errors
from .tool import FlexibleTool

_LEAST = 8
#: No interrogator is later, s, and a delay less well known is none.
_LONGEST_FIBRES_S = 0.28
_WORST_DELAY_S = 0.02
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


#: A force from which on a shaft leans, mN.
_LEANS_MN = 10.0


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


def align(
    robot_time_s: ArrayLike, robot_mm: ArrayLike, camera_time_s: ArrayLike, camera_mm: ArrayLike, *,
    longest_s: float = 0.5, source: str = "alignment",
) -> Aligned:  # fmt: skip
    """Frame and clock of a camera from a motion of the unbent tool that both saw: least squares over both.

    Robot (n, 3) at its times, camera (m, 3) at its own; delays up to ``longest_s`` either way are tried. Deviations
    are those of :func:`~sherkit.robots.tool.smooth_errors.smooth_errors`. Raises :class:`~sherkit.errors.FitError`
    where fewer than eight pictures fall into the robot's time at every delay tried, where the camera saw another
    motion, one in other units or mirrored, where nothing moves enough to tell the delay, and as
    :func:`~sherkit.robots.tool.registration.register`.
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


@dataclass(frozen=True)
class FibreDelay:
    """How much later the fibres' clock stands than the robot's, s, and its standard deviation."""

    delay_s: float
    std_s: float


def fibre_delay(tool: FlexibleTool, run: ToolRun, *, longest_s: float = _LONGEST_FIBRES_S) -> FibreDelay:
    """The delay of the interrogator from a run in which the shaft leant on the hole.

    Where the shaft leans, its motion makes the force: the right delay is the one with which the force that the motion
    makes is the one that is felt (least mean square of the difference over 0.1 s). Its deviation follows from the
    curvature, one independent value every 0.1 s. Raises :class:`~sherkit.errors.FitError` where the run tells no delay
    between 0 and ``longest_s``: nothing leant, or nothing moved.
    """
    waves = np.ascontiguousarray(run.wavelengths_nm)
    reading = np.ascontiguousarray(np.isfinite(waves).any(axis=1))

    def left(delay: float) -> float:
        stamps = np.ascontiguousarray(run.fibre_times_s - delay)
        told = tool.tracker(float(run.time_s[0]), run.poses[0]).run(run.time_s, run.poses, stamps, waves, reading)
        return float(told["inner"][:, 1].mean())

    grid = np.arange(0.0, longest_s + 1e-9, 0.01)
    squares = np.array([left(d) for d in grid])
    best = int(np.argmin(squares))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    found = scipy.optimize.minimize_scalar(left, bounds=(low, high), method="bounded", options={"xatol": 1e-4})
    delay, least = float(found.x), float(found.fun)
    # over a step on which the forces differ by more than they are known
    step = 2.0 * float(grid[1] - grid[0])
    sides = [left(max(delay + s, 0.0)) for s in (-step, step)]
    curvature = (sides[0] + sides[1] - 2.0 * least) / step**2
    # only where it leans does a window tell anything
    leans = float(
        (np.linalg.norm(tool.sensor.measure_batch(run.fibre_times_s, waves)[0][:, 1:3], axis=1) > _LEANS_MN).mean()
    )
    count = max(2.0 * leans * float(run.time_s[-1] - run.time_s[0]) / 0.1, 1.0)
    std = float(np.sqrt(2.0 * least / (count * curvature))) if curvature > 0 else float("inf")
    if best == len(grid) - 1 or not std < _WORST_DELAY_S:
        raise FitError(
            f"{run.source}: the force does not tell the fibres' delay between 0 and {longest_s:g} s; let the shaft "
            "lean on the hole and move"
        )
    return FibreDelay(delay, std)
