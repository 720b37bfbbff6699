"""Errors on measurements that were not fitted: blocks of poses held out in turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .chain import ChainModel
from .identification import identify, residuals
from .measurements import Measurements

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_TILES = 4


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Residuals (n, m), each from a fit that did not see its block, and the block of each row."""

    residuals: Floats
    block: Ints

    @property
    def residuals_mm(self) -> Floats:
        """The same (n, 4), for a delta, whose readings are in mm."""
        return self.residuals


def spatial_blocks(data: Measurements, positions_mm: Floats, folds: int = 5, seed: int = 0) -> Ints:
    """A fold (0 … folds - 1) for every row; repeats of a pose and neighbours in space stay together."""
    return deal_tiles(positions_mm, data.groups, folds, seed)


def deal_tiles(places: Floats, groups: Ints, folds: int = 5, seed: int = 0) -> Ints:
    """A fold (0 … folds - 1) for every row of ``places`` (n, d); equal ``groups`` (n,) and neighbours stay together.

    The first two coordinates are cut into 4 × 4 tiles, a third one into 3 layers, and whole tiles are dealt to folds,
    so that a fold is predicted from its surroundings and never from its own repeats (Roberts et al., "Cross-validation
    strategies for data with temporal, spatial … structure", Ecography 2017).
    """
    centre = _group_means(places, groups)
    tile = np.zeros(len(centre), dtype=np.int64)
    for axis in range(min(centre.shape[1], 3)):
        rank = np.argsort(np.argsort(centre[:, axis], kind="stable"), kind="stable")
        parts = _TILES if axis < 2 else 3
        tile = tile * parts + rank * parts // len(centre)
    names, tile = np.unique(tile, return_inverse=True)
    deal = np.arange(len(names)) % folds
    np.random.default_rng(seed).shuffle(deal)
    return deal[tile.ravel()][groups]


def hold_out(model: ChainModel, data: Measurements, *, folds: int = 5, seed: int = 0, loss: str = "linear") -> HeldOut:
    """Refits without each block in turn and predicts it. Raises as :func:`~sherkit.identification.identify`."""
    nominal = model.predict(data, np.zeros(len(model.parameters)))[:, : data.coordinates]
    block = spatial_blocks(data, np.nan_to_num(nominal), folds, seed)
    out = np.full(data.readings.shape, np.nan)
    for fold in np.unique(block):
        inside = block == fold
        if inside.all():
            # one pose alone cannot be held out: what is left is the fit's own residual
            out[inside] = residuals(model, data, identify(model, data, loss=loss).values)
            break
        fit = identify(model, data.select(~inside), loss=loss)
        out[inside] = residuals(model, data.select(inside), fit.values)
    return HeldOut(out, block)


def _group_means(values: Floats, groups: Ints) -> Floats:
    count = np.bincount(groups)
    return np.stack([np.bincount(groups, v) / count for v in values.T], axis=1)
