"""Identification of runs too large for memory: passed over in blocks, once per iteration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import sherkit._core as _core

from ..base.types import Floats
from ..data import MeasurementStream
from ..errors import FitError
from ..model.any import Model
from ..model.base import ModelWithEffects
from ..model.chain import ChainModel
from ..model.effect import Effect
from ..model.kinds import Robot, model_of
from .identify import Identified, extended_by
from .least_squares import iterate, push, reached


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class StreamFit(Identified):
    """A model fitted to a stream of so many ``rows``: nothing that would need them all."""

    rows: int


def identify_stream(
    robot: Robot | Model | ModelWithEffects,
    stream: MeasurementStream,
    *,
    free: Sequence[str] = (),
    effects: Sequence[str | Effect] = (),
) -> StreamFit:
    """Fits a run of any length in constant memory, passing over it once per iteration.

    Readings weigh by their declared sigma, or all the same. Raises as :func:`~sherkit.fit.identify.identify`.
    """
    model = extended_by(model_of(robot, free), effects)
    first = next(iter(stream.blocks()), None)
    if first is None:
        raise FitError(f"{stream.source}: the stream holds no row")
    if first.set_up is not None:
        raise FitError(
            f"{stream.source}: column 'setup': a stream is read from one place of the instrument; read the run whole "
            "(read_measurements, identify), or leave the column out where it was not moved"
        )
    solver = _core.Solver(
        model.start(first), np.array([p.size for p in model.parameters]), known=model.known(drawn=False)
    )
    rows = 0

    def feed(values: Floats) -> None:
        nonlocal rows
        rows = 0
        for block in stream.blocks():
            noise = np.where(np.isfinite(block.sigma), block.sigma, 1.0)
            weights = np.where(block.used, 1.0 / noise, 0.0)
            rows += len(block)
            if isinstance(model, ChainModel) and not model.own:
                model.accumulate(solver, block, weights)
            else:
                push(solver, model, block, weights, values)
        solver.push_priors()
        if rows == 0:
            raise FitError(f"{stream.source}: the stream holds no row")

    ended = iterate(solver, feed)
    result = solver.result()
    scale = float(np.sqrt(result["cost"] / max(result["rows"] - result["rank"], 1)))
    return StreamFit(
        model=model,
        values=result["values"],
        covariance=result["covariance"] * scale**2,
        unobserved_covariance=result["unobserved_covariance"],
        rank=result["rank"],
        singular_values=result["singular_values"],
        unobserved_basis=result["unobserved"],
        scale=scale,
        rows=rows,
        converged=reached(ended, result),
        evaluations=result["evaluations"],
    )
