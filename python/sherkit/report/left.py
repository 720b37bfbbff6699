"""What a fit leaves of a run, ready to be drawn: any machine, in the unit that people read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..diagnosis.questions import case_of
from ..identification import Fit
from ..readings import ModelFit

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Left:
    """Measured minus predicted, ``values`` (n, m) in ``unit``, NaN where nothing was taken.

    ``names`` are those of the m readings; ``noise`` (m,) their noise in ``unit`` and ``noise_origin`` how it is known;
    ``place`` up to three coordinates (n,) of where the machine was; ``variables`` (n,) everything the error may depend
    on; ``group`` (n,) is equal for repeats of a pose; ``row`` (n,) is the row of the run, ``line`` (n,) its number in
    the file, counted in ``counted``; ``outlier`` (n,) marks rows that were not fitted.
    """

    names: tuple[str, ...]
    unit: str
    values: Floats
    noise: Floats
    noise_origin: str
    place: Mapping[str, Floats]
    variables: Mapping[str, Floats]
    group: Ints
    row: Ints
    line: Ints
    counted: str
    outlier: Bools

    def __len__(self) -> int:
        return len(self.values)

    @cached_property
    def rms(self) -> Floats:
        """Root mean square of each reading (m,) over rows that are not marked as outliers."""
        used = np.where(self.outlier[:, None], np.nan, self.values)
        count = np.isfinite(used).sum(axis=0)
        return np.sqrt(np.nansum(used**2, axis=0) / np.maximum(count, 1))

    @property
    def rms_of_all(self) -> float:
        """Root mean square of single readings, all axes together."""
        return float(np.sqrt(np.mean(self.rms**2)))


def left_of(fit: Fit | ModelFit) -> Left:
    """What a fit leaves, on every row of its run that has a reading."""
    case = case_of(fit)
    axes = list(case.axes)
    rows = np.flatnonzero(np.isfinite(case.residuals[:, axes]).any(axis=1)).astype(np.int64)
    view = case.see(rows, (), np.ones(len(axes))).view
    sigma, origin = case.noise()
    data = fit.data
    return Left(
        names=tuple(case.names[a] for a in axes),
        unit=case.unit,
        values=case.per_unit * view.residual,
        noise=case.per_unit * sigma[axes],
        noise_origin=origin,
        place={name: view.variables[name] for name in view.place},
        variables=dict(view.variables) | _directions(data, rows),
        group=view.group,
        row=rows,
        line=data.line[rows],
        counted=getattr(data, "counted", "row"),
        outlier=data.outlier[rows],
    )


def _directions(data: Any, rows: Ints) -> dict[str, Floats]:
    """Sign of the last motion of each joint, where it is known and both signs occur."""
    direction = getattr(data, "direction", None)
    if direction is None:
        return {}
    columns = {f"direction_{k + 1}": column[rows] for k, column in enumerate(direction.T)}
    return {name: v for name, v in columns.items() if np.isfinite(v).all() and np.ptp(v) > 0}
