"""The rows of a long run that are drawn: pictures cost what they show, not what was measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..base.types import Ints
from ..data import Measurements
from ..data.noise import Noise
from ..fit.identify import Fit

#: So many rows are drawn of a run, and its extremes.
MOST_ROWS = 6000


def drawn_rows(data: Measurements, most: int) -> Ints:
    """Which rows to draw: whole poses chosen at random (the same ones each time), so that repeats stay together, and
    with them the lowest and the highest of every column, and rows marked as outliers."""
    columns = [*data.joints.T, *data.readings.T, *data.covariates.values()]
    columns += [] if data.time_s is None else [data.time_s]
    extremes = [at for v in columns if np.isfinite(v).any() for at in (np.nanargmin(v), np.nanargmax(v))]
    marked = np.flatnonzero(data.outlier)
    keep = [*extremes, *marked[np.linspace(0, len(marked) - 1, min(len(marked), most // 4)).astype(int)]]
    _, pose, size = np.unique(data.groups, return_inverse=True, return_counts=True)
    random = np.random.default_rng(0)
    if size.max() > most // 4:  # few poses, read over and over: single readings of them
        chosen = random.permutation(len(data))[:most]
    else:
        order = random.permutation(len(size))
        enough = int(np.searchsorted(np.cumsum(size[order]), most))
        chosen = np.flatnonzero(np.isin(pose, order[:enough]))
    return np.union1d(chosen, np.array(keep, dtype=np.int64))


def drawn(fit: Fit, most: int = MOST_ROWS) -> Fit:
    """A fit with the same values on the rows of its run that are drawn; itself where these are all.

    The same rows for every fit of a run, since all are chosen by what was read.
    """
    if len(fit.data) <= most:
        return fit
    rows = drawn_rows(fit.data, most)
    return replace(fit, data=fit.data.select(rows), noise=Noise(fit.noise.sigma[rows], fit.noise.origin))


def said(count: int, of: int) -> str:
    """What the note under a picture says of it; nothing where every row is drawn."""
    if count == of:
        return ""
    return (
        f" Drawn are {count} of the {of} rows: whole poses chosen at random, the lowest and highest values, "
        "and marked outliers."
    )
