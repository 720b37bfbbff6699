"""Where the model fails: error against everything, each with its own test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from .stage import Stage

_BINS = 6


@dataclass(frozen=True)
class Dependence:
    """Error against one variable: bin edges, RMS per bin (in the unit of the diagnosis, axes together), and the p that
    it is all the same mean, corrected for the shapes tried on this variable."""

    variable: str
    edges: tuple[float, ...]
    rms: tuple[float, ...]
    p_value: float


def where(stage: Stage) -> tuple[Dependence, ...]:
    """One line for each variable (joints, coordinates, time, directions, covariates), the clearest first."""
    out = []
    z = stage.scan.z_scores[: stage.n_shapes]
    error = stage.view.residual * stage.sigma * stage.run.per_row
    for name, values in stage.view.variables.items():
        scores = [s for s, shape in zip(z.tolist(), stage.shapes, strict=True) if shape.depends_on == (name,)]
        if not scores:
            continue
        p = min(1.0, len(scores) * float(scipy.special.ndtr(-max(scores))))
        edges = np.unique(np.quantile(values, np.linspace(0, 1, _BINS + 1)))
        if len(edges) < 2:
            continue
        which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
        rms = [float(np.sqrt(np.mean(error[which == k] ** 2))) for k in range(len(edges) - 1) if (which == k).any()]
        out.append(Dependence(name, tuple(edges.tolist()), tuple(rms), p))
    return tuple(sorted(out, key=lambda d: d.p_value))


def neighbour_correlation(stage: Stage) -> float:
    """Correlation of what is left at a pose with what is left at its nearest neighbour in the workspace."""
    names = stage.view.place
    if not names:
        return 0.0
    group = np.unique(stage.view.group, return_inverse=True)[1]
    count = np.bincount(group)
    if len(count) < 10:
        return 0.0
    place = np.stack([np.bincount(group, stage.view.variables[n]) / count for n in names], axis=1)
    mean = np.stack([np.bincount(group, e) / count for e in stage.view.residual.T], axis=1)
    mean -= mean.mean(axis=0)
    near = scipy.spatial.cKDTree(place).query(place, 2)[1]
    # where several poses are at the same place one may be found before itself
    other = mean[np.where(near[:, 0] == np.arange(len(place)), near[:, 1], near[:, 0])]
    return float((mean * other).sum() / max(float(np.sqrt((mean**2).sum() * (other**2).sum())), 1e-300))
