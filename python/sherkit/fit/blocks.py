"""Blocks of neighbouring poses, held out together."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..base.types import Floats, Ints
from ..data import Measurements

_TILES = 4


def blocks_of(data: Measurements, place: Mapping[str, Floats], folds: int = 5, seed: int = 0) -> Ints:
    """A fold (0 … folds - 1) for every row: as the rows say, else tiles of the ``place`` (n,) by name."""
    if data.block is None:
        return deal_tiles(np.nan_to_num(np.stack(list(place.values()), axis=1)), data.standing, folds, seed)
    names, block = np.unique(data.block, return_inverse=True)
    return _dealt(len(names), folds, seed)[block.ravel()]


def spatial_blocks(data: Measurements, positions_mm: Floats, folds: int = 5, seed: int = 0) -> Ints:
    """A fold (0 … folds - 1) for every row; repeats of a pose and neighbours in space stay together."""
    return deal_tiles(positions_mm, data.standing, folds, seed)


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
    return _dealt(len(names), folds, seed)[tile.ravel()][groups]


def _dealt(count: int, folds: int, seed: int) -> Ints:
    deal = np.arange(count, dtype=np.int64) % folds
    np.random.default_rng(seed).shuffle(deal)
    return deal


def _group_means(values: Floats, groups: Ints) -> Floats:
    count = np.bincount(groups)
    return np.stack([np.bincount(groups, v) / count for v in values.T], axis=1)
