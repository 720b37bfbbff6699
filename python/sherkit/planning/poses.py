"""Which poses to measure: few that observe all parameters, chosen from many that the robot can reach.

D-optimal designs (:mod:`~sherkit.evidence.design`). For a given number of poses this is also the best observability
index O1 (Borm and Menq, 1989), the one that is used for robots. Poses are chosen
once each, since a pose that is measured twice shows noise and no other physics, and put into a random order, so that
drift does not look like geometry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base import linalg
from ..base.arguments import Positive, Seed, validate_arguments
from ..base.types import Floats, Ints
from ..data import Measurements
from ..errors import FitError, ShapeError
from ..evidence.design import exchanged, showing
from ..evidence.thresholds import ROUNDING
from ..model.chain import ChainModel
from ..model.effect import Parameter


@dataclass(frozen=True, eq=False)
class PoseDesign:
    """Chosen poses: ``rows`` (k,) of the candidates, in the order to measure them.

    ``std`` (p,) are the standard deviations of the ``parameters`` for one reading of each, unobserved directions held;
    ``o1`` is the observability index: the geometric mean of the observed singular values of the column-scaled
    derivatives over the root of the number of poses. ``rank`` is how many directions of the parameters are observed.
    """

    rows: Ints
    parameters: tuple[Parameter, ...]
    std: Floats
    o1: float
    rank: int


@validate_arguments
@linalg.one_thread()
def choose_poses(
    model: ChainModel,
    candidates: Measurements,
    count: int,
    *,
    sigma: Positive | Floats = 1.0,
    values: Floats | None = None,
    seed: Seed = 0,
) -> PoseDesign:
    """Chooses ``count`` of the ``candidates``, whose joints alone matter.

    ``sigma`` is the standard deviation of a reading (of each coordinate, where they differ); ``values`` are those of
    the parameters about which the model is linear, the drawing if left out. Raises
    :class:`~sherkit.errors.ShapeError` for fewer poses than can observe the parameters, or more than there are.
    """
    whole, size, basis = _observed(model, candidates, sigma, values)
    n, m, rank = whole.shape
    if not -(-rank // m) <= count <= n:
        raise ShapeError(
            f"count: expected {-(-rank // m)} to {n} poses (of {n} candidates, {rank} directions of the parameters can "
            f"be observed), got {count}"
        )
    rng = np.random.default_rng(seed)
    # all poses together are a start that observes everything; it fades as poses are chosen
    begun = showing(whole, 1e-6 * np.einsum("nar,nas->rs", whole, whole), (), count)
    order = rng.permutation(np.array(exchanged(whole, begun), dtype=np.int64))
    std, o1 = _known(whole[order], size, basis)
    return PoseDesign(order, model.parameters, std, o1, rank)


def design_of(
    model: ChainModel, rows: Measurements, *, sigma: float | Floats = 1.0, values: Floats | None = None
) -> PoseDesign:
    """All ``rows`` as a design, to compare with."""
    whole, size, basis = _observed(model, rows, sigma, values)
    std, o1 = _known(whole, size, basis)
    return PoseDesign(np.arange(len(rows)), model.parameters, std, o1, whole.shape[2])


def _observed(
    model: ChainModel, rows: Measurements, sigma: float | Floats, values: Floats | None
) -> tuple[Floats, Floats, Floats]:
    """Derivatives (n, m, rank) by the observed directions, plausible sizes (p,), and those directions (p, rank)."""
    at = np.zeros(len(model.parameters)) if values is None else values
    each = np.reshape(np.asarray(sigma, dtype=float), (-1, 1))
    if len(each) not in (1, rows.coordinates) or not (each > 0).all():
        raise ShapeError(f"sigma: expected a number above 0, or one for each of the {rows.coordinates} coordinates")
    by = model.derivatives(rows, at)[:, : rows.coordinates] / each
    with np.errstate(over="ignore"):
        squares = np.square(by).sum()
    if not np.isfinite(squares):
        raise FitError(f"the model has derivatives that are not finite at these poses, in units of sigma ({sigma})")
    # as identification does it, so that both hold the same directions
    size = np.array([p.size for p in model.parameters])
    _, singular, right = linalg.svd((by * size).reshape(-1, len(size)), full_matrices=False)
    basis = right[singular > ROUNDING * singular[0]].T
    return (by * size) @ basis, size, basis


def _known(rows: Floats, size: Floats, basis: Floats) -> tuple[Floats, float]:
    """Standard deviations of the parameters and O1, from derivatives (k, m, rank)."""
    _, singular, right = linalg.svd(rows.reshape(-1, rows.shape[2]), full_matrices=False)
    root = basis @ (right.T / singular)
    o1 = float(np.exp(np.mean(np.log(singular))) / np.sqrt(len(rows)))
    return np.sqrt((root**2).sum(axis=1)) * size, o1
