"""How far off something is in 95 of 100 cases, from a covariance."""

from __future__ import annotations

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Floats


def radius_95(covariances: Floats) -> Floats:
    """Radius (n,) that holds 95 of 100 draws of Gaussians with covariances (n, k, k), in their unit.

    By matching two moments of the squared length (Satterthwaite).
    """
    axes = linalg.eigvalsh(covariances).clip(0.0)
    total, squares = axes.sum(axis=1), (axes**2).sum(axis=1)
    freedom = np.where(squares > 0, total**2 / np.where(squares > 0, squares, 1.0), 1.0)
    return np.asarray(np.sqrt(total / freedom * scipy.special.chdtri(freedom, 0.05)))
