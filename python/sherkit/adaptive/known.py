"""What is fixed before a loop reads: the model, where and over what time it is judged, and all that may be missing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Bools, Floats
from ..data import Measurements
from ..data.columns import TEMPERATURE, TIME, unit_in
from ..evidence.base import reference_of
from ..evidence.blocks import ReferenceRows
from ..evidence.fitted_run import FittedRun
from ..evidence.run import Run
from ..evidence.thresholds import NEARLY_ALWAYS, ROUNDING
from ..evidence.whitening import Whitening
from ..fit.identify import Fit, identify
from ..model.base import ModelWithEffects
from ..model.effect import Effect
from ..planning.region import PosesToDrive, Region, planned

#: Rows of the reference, and those from which on something may let go: what one or two rows before it say may be their
#: own.
_ROWS, _CUTS = 160, np.unique(np.geomspace(4.0, 150.0, 36).astype(np.int64))
#: Places at which the accuracy is asked.
PLACES = 60
#: By how much a covariate swings, unless its name is known: this part of its value, or of what the first rows show.
_SWINGS, _TIMES, _WIDTHS = 0.1, 4.0, {TEMPERATURE: 1.0}


@dataclass(frozen=True, eq=False)
class FixedBefore:
    """The ``model`` without what may be missing, the ``region``, the readings ``axes`` that are looked at, and the
    ``reference`` of the evidence; ``effects`` by name, ``untestable`` those that are none here, with the reason."""

    model: ModelWithEffects
    region: Region
    axes: tuple[int, ...]
    reference: ReferenceRows
    effects: Mapping[str, Effect]
    untestable: Mapping[str, str]
    #: What a later moment shows more of.
    in_time: frozenset[str]

    @classmethod
    def of(
        cls, model: ModelWithEffects, region: Region, data: Measurements, axes: tuple[int, ...], span_s: float
    ) -> FixedBefore:
        """What can be missing where rows have the columns of ``data``; ``span_s`` is over what time it is judged."""
        rows = _reference(region, data, span_s)
        rows = replace(rows, taken=_taken(rows, axes))
        exact = model.predict(rows, np.zeros(len(model.parameters)))
        rows = replace(rows, readings=np.where(rows.taken, exact, np.nan))
        run = run_at(identify(model, rows), np.ones(len(data.layout.names)))
        reference, view = reference_of(run, _CUTS), run.view
        tried = {e.name: e for e, _ in (*view.effects, *view.in_time, *view.periodic)}
        effects = {name: e for name, e in tried.items() if name in reference.names}
        taken = {name: "what the model fits anyway takes all of it" for name in tried if name not in effects}
        beside = {TIME} | {name for name in data.covariates if name not in (*data.layout.apart, *data.layout.loads)}
        in_time = {name for name, e in effects.items() if beside.intersection(e.needs) or e.search == TIME}
        return cls(
            model, region, axes, reference, effects, {**view.untestable, **taken}, frozenset(in_time | beside)
        )  # fmt: skip

    def later(self, data: Measurements, places: PosesToDrive, after_s: float, rng: np.random.Generator) -> Measurements:
        """These rows, and behind them rows at places a little later, approached from where the robot stands."""
        n = len(places)
        joints = np.concatenate([data.joints, places.joints])
        columns: dict[str, Floats] = {}
        if data.time_s is not None:
            columns[TIME] = np.append(data.time_s, np.full(n, float(data.time_s.max()) + after_s))
        for name, values in data.covariates.items():
            columns[name] = np.append(
                values, rng.choice(values, n) if name in data.layout.apart else np.full(n, float(values[-1]))
            )
        way = np.sign(places.joints - data.joints[-1])
        direction = np.concatenate([data.direction, np.where(way != 0, way, 1.0)])
        columns |= {f"direction_{k + 1}": one for k, one in enumerate(direction.T)}
        rows = planned(joints, data.layout, columns)
        # times go on from the begin of the run
        return replace(rows, taken=_taken(rows, self.axes), begins_s=data.begins_s, room=data.room)

    @linalg.one_thread()
    def accuracy_um(self, data: Measurements, fit: Fit, seed: int) -> float | None:
        """How far off the fitted model may be anywhere in the region, in 95 of 100 cases, µm: the largest over places,
        to first order; None where readings are no lengths."""
        axes = list(self.axes)
        if not all(unit_in(data.layout.readings[a]) == "mm" for a in axes):
            return None
        places = self.region.spread(PLACES, seed + 1)
        rows = self.later(data, places, 0.0, np.random.default_rng(seed))
        by = fit.model.derivatives(rows, fit.values)[-len(places) :, axes]
        each = np.einsum("nmp,pq,nkq->nmk", by, fit.covariance + fit.unobserved_covariance, by)
        largest = float(linalg.eigvalsh(each)[:, -1].max())
        return float(1e3 * np.sqrt(scipy.special.chdtri(len(axes), 1.0 - NEARLY_ALWAYS) * max(largest, 0.0)))


def run_at(fit: Fit, sigma: Floats) -> Run:
    """All rows of a fit over the noise ``sigma`` (columns,), in their order."""
    of, rows = FittedRun(fit), np.arange(len(fit.data))
    view = of.linearised(rows, of.catalogue, sigma[list(of.axes)])
    return Run(of, rows, sigma, view, Whitening.none(len(rows)))


def _taken(rows: Measurements, axes: tuple[int, ...]) -> Bools:
    return np.isin(np.arange(rows.taken.shape[1]), axes) & np.ones((len(rows), 1), dtype=bool)


def _reference(region: Region, data: Measurements, span_s: float) -> Measurements:
    """Rows over all of the region and the span, in a room that swings by a degree, that came from either side."""
    rng = np.random.default_rng(0)
    places = region.spread(_ROWS, 0)
    part = np.arange(_ROWS) / _ROWS
    columns: dict[str, Floats] = {}
    if data.time_s is not None:
        columns[TIME] = part * span_s
    for number, (name, values) in enumerate(data.covariates.items()):
        if name in data.layout.apart or name in data.layout.loads:
            columns[name] = rng.choice(values, _ROWS)
        else:
            # first rows last a minute: a room that swings by a tenth of its humidity in an hour has hardly begun to
            begins, spread = float(values[0]), float(np.ptp(values))
            swing = _WIDTHS.get(name, max(_SWINGS * abs(begins), _TIMES * spread, ROUNDING))
            # each in a course of its own: what swings alike could not be told apart
            columns[name] = begins + swing * np.sin(2.0 * np.pi * (1.0 + 0.37 * number) * part + number)
    for k in range(places.joints.shape[1]):
        columns[f"direction_{k + 1}"] = rng.choice([-1.0, 1.0], _ROWS)
    return planned(places.joints, data.layout, columns)
