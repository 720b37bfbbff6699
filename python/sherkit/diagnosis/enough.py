"""Rows of a long run that a diagnosis looks at: all poses, and of each as many visits as tell."""

from __future__ import annotations

import numpy as np

from ..base.types import Ints
from ..data import Measurements

#: Rows beyond which more of them would only show what is smaller than a twentieth of the noise.
ENOUGH = 8192
#: Visits of a pose without which nothing tells its noise.
_REPEATED = 2


def enough_of(data: Measurements, rows: Ints, most: int = ENOUGH) -> Ints:
    """Those of these ``rows`` (k,) that are looked at, in the order of time: at most ``most``.

    Of each pose as many visits as of any other, evenly from first to last: of a run of whole passes these are whole
    passes. Where the poses are too many for that, one by lot stands for its neighbours in time.
    """
    if len(rows) <= most:
        return rows
    rows = rows[np.argsort(data.order[rows], kind="stable")]
    pose = np.unique(data.standing[rows], return_inverse=True)[1].ravel()
    count = np.bincount(pose)
    visit = np.empty(len(rows), dtype=np.int64)
    visit[np.argsort(pose, kind="stable")] = np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)
    each = least = min(_REPEATED, int(count.max()))
    while np.minimum(count, each + 1).sum() <= most:
        each += 1
    taken = np.minimum(count, each)
    keep = (visit * taken[pose]) % count[pose] < taken[pose]
    if taken.sum() > most:
        in_time = pose[np.sort(np.unique(pose, return_index=True)[1])]
        edges = np.linspace(0, len(in_time), most // least + 1).astype(np.int64)
        keep &= np.isin(pose, in_time[np.random.default_rng(0).integers(edges[:-1], edges[1:])])
    return rows[keep]
