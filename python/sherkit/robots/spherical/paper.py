"""Identification from the residual of the inverse kinematics, as the paper of the spherical robot has it (Eq. 6).

Measured joints are compared with those that the inverse kinematics gives for what the camera saw. It is the paper's
way, to stand beside :func:`~sherkit.fit.identify.identify`, which compares readings: there every reading weighs by
its own noise, and errors behind the joints (axes that miss the centre, flexure, the marker) have a place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

import sherkit._core as _core

from ...base.names import listed
from ...base.types import Floats
from ...data import Measurements
from ...data.noise import noise_of
from ...errors import FitError
from ...fit.identify import Fit
from ...model.kinds import model_of
from .model import SphericalModel
from .robot import Spherical

#: Effects that the inverse kinematics of a reading cannot hold.
_BEHIND_THE_JOINTS = ("axis_offset", "gravity_flexure", "marker_offset", "thermal_growth", "drift", "slip")


@dataclass(frozen=True)
class TaskError:
    """Table II: what is left between joints and vision, by angle, rad: mean, root mean square, largest."""

    mean: tuple[float, float]
    rms: tuple[float, float]
    largest: tuple[float, float]
    #: Root of the sum of squares, which the paper prints under the name of RMS.
    root_sum: tuple[float, float]


def identify_joints(robot: Spherical | SphericalModel, data: Measurements, *, free: Sequence[str] = ()) -> Fit:
    """Fits the free parameters so that the inverse kinematics of the readings gives the joints, all rows alike.

    The covariance follows from the residuals of the joints. Raises :class:`~sherkit.errors.FitError` for effects that
    act behind the joints, effects given in NumPy, rows without both readings, and rows that cannot be computed.
    """
    model = cast(SphericalModel, model_of(robot, free))
    refused = [e.name for e in model.effects if e.name in _BEHIND_THE_JOINTS or e.function is not None]
    if refused:
        raise FitError(
            f"{listed(refused)}: acts behind the joints and has no place in the residual of the inverse kinematics; "
            "use sherkit.identify"
        )
    half = ~data.taken.all(axis=1) & ~data.outlier
    if half.any():
        raise FitError(f"{data.place(half)}: the inverse kinematics needs both readings of a row")
    solver = _core.Solver(np.zeros(len(model.parameters)), np.array([p.size for p in model.parameters]))
    weights = np.ascontiguousarray(np.repeat(np.where(data.outlier, 0.0, 1.0)[:, None], 2, axis=1))
    block = model.block(data)
    read = np.where(data.taken, data.readings, np.nan)
    ended, missing = model.core_for(data).solve_inverse(
        solver, np.zeros(len(model.core_parameters)), model.indices, block, read, weights, False
    )
    model.require(data, np.array(missing, dtype=np.int64), np.zeros(len(model.parameters)))
    result = solver.result()
    left = model.joint_residuals(data, solver.trial)[~data.outlier]
    scale = float(np.sqrt((left**2).sum() / max(left.size - result["rank"], 1)))
    return Fit(
        model=model,
        data=data,
        values=solver.trial,
        covariance=result["covariance"] * scale**2,
        unobserved_covariance=result["unobserved_covariance"],
        rank=result["rank"],
        singular_values=result["singular_values"],
        unobserved_basis=result["unobserved"],
        scale=scale,
        noise=noise_of(data),
        loss="linear",
        priors=False,
        converged=ended == "converged",
        evaluations=result["evaluations"],
    )


def task_error(model: SphericalModel, data: Measurements, values: Floats) -> TaskError:
    """φ and γ by the kinematics of the joints, less those that vision gives with the same parameters, rad (Table II).

    Raises :class:`~sherkit.errors.FitError` for rows that cannot be computed.
    """
    seen = model.seen_angles(data, values)
    full = model.full(values)
    told, reached = model.pointing.predict(full, model.block(data))
    bad = ~(reached & np.isfinite(seen).all(axis=1)) & ~data.outlier
    model.require(data, np.flatnonzero(bad), values)
    left = (told - seen)[~data.outlier]
    left[:, 0] = np.angle(np.exp(1j * left[:, 0]))

    def pair(v: Floats) -> tuple[float, float]:
        return float(v[0]), float(v[1])

    squares = (left**2).sum(axis=0)
    return TaskError(
        mean=pair(left.mean(axis=0)),
        rms=pair(np.sqrt(squares / len(left))),
        largest=pair(np.abs(left).max(axis=0)),
        root_sum=pair(np.sqrt(squares)),
    )
