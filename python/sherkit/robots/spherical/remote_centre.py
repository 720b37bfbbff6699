"""The remote centre of motion: how far it wanders, and how well that is known. It is what makes such a robot safe."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from ...base import linalg
from ...base.types import Floats
from ...errors import FitError
from ...fit.identify import Fit, identify
from .model import SphericalModel

EFFECT = "axis_offset"
#: One-sided 95 % quantile of a Gaussian.
_ONE_SIDED = 1.6448536269514722


@dataclass(frozen=True, eq=False)
class RemoteCentre:
    """Displacement of the remote centre over the poses of a run, mm.

    ``displacement_mm`` (n, 3) and ``covariance_mm2`` (n, 3, 3), row by row; ``explained`` tells whether the axes that
    miss the centre are in the model that was fitted, or were added only to ask.
    """

    displacement_mm: Floats
    covariance_mm2: Floats
    explained: bool

    @property
    def distance_mm(self) -> Floats:
        """How far the centre is off at every row (n,)."""
        return np.linalg.norm(self.displacement_mm, axis=1)

    @property
    def rms_mm(self) -> float:
        """Root mean square of the distance."""
        return float(np.sqrt(np.mean(self.distance_mm**2)))

    @property
    def largest(self) -> tuple[float, float]:
        """Largest distance over the run and its standard deviation, mm."""
        row = int(np.argmax(self.distance_mm))
        return float(self.distance_mm[row]), float(self._std_along()[row])

    @property
    def within_mm(self) -> float:
        """The centre stays within this distance, mm, at every pose of the run, in 95 of 100 cases."""
        return float((self.distance_mm + _ONE_SIDED * self._std_along()).max())

    def _std_along(self) -> Floats:
        """Standard deviation of each distance: along the displacement, or the worst way where there is none."""
        distance = self.distance_mm[:, None]
        along = np.divide(self.displacement_mm, distance, out=np.zeros_like(self.displacement_mm), where=distance > 0)
        variance = np.einsum("ni,nij,nj->n", along, self.covariance_mm2, along)
        worst = linalg.eigvalsh(self.covariance_mm2)[:, -1]
        return np.sqrt(np.where(distance[:, 0] > 0, variance, worst).clip(0.0))

    def __repr__(self) -> str:
        size, std = self.largest
        return f"RemoteCentre(off by at most {size:.3f} ± {std:.3f} mm, within {self.within_mm:.3f} mm at 95 %)"


def remote_centre(fit: Fit) -> RemoteCentre:
    """How far the remote centre wanders over the poses of a fitted run.

    Where ``axis_offset`` is not in the model it is fitted besides, to ask. Raises
    :class:`~sherkit.errors.FitError` for a robot without a remote centre.
    """
    if EFFECT not in fit.model.known_effects:
        raise FitError("only a spherical robot has a remote centre of motion")
    model = cast(SphericalModel, fit.model)
    explained = EFFECT in {e.name for e in model.effects}
    if not explained:
        model = model.with_effect(model.known_effects[EFFECT])
        fit = identify(model, fit.data, noise=fit.noise, loss=fit.loss)
    full = model.full(fit.values)
    here, by_values, _, reached = model.core.centres(full, model.block(fit.data), model.indices)
    count = len(model.indices)
    covariance = (fit.covariance + fit.unobserved_covariance)[:count, :count]
    rows = reached & ~fit.data.outlier
    spread = by_values[rows] @ covariance @ by_values[rows].transpose(0, 2, 1)
    return RemoteCentre(here[rows], spread, explained)


def centre_in_words(found: RemoteCentre) -> str:
    """One sentence for people."""
    size, std = found.largest
    model = "" if found.explained else " (axis_offset was fitted besides, to ask)"
    return f"off by at most {size:.3f} ± {std:.3f} mm over the run, within {found.within_mm:.3f} mm at 95 %{model}"
