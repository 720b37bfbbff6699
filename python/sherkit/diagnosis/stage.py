"""One stage of the search: a fit, what it leaves, and every candidate's score."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..errors import FitError
from ..model.effect import Effect
from ..types import Floats
from .fitted_run import FittedRun
from .linearised import Linearised, Whitening, correlation_in_time, orthonormal
from .scan import Columns, ConditionalScan, Scan
from .shapes import Family, Shape, build
from .waves import Waves, waves_of


@dataclass(frozen=True, eq=False)
class Candidate:
    """A physical effect to try, with the setting it is tried at (period or time): None for the one the model has."""

    effect: Effect
    columns: Columns
    setting: float | None = None

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name

    @property
    def addition(self) -> tuple[Effect, float | None]:
        """What a refit adds: the effect at the setting that was found."""
        return self.effect, self.setting


@dataclass(frozen=True, eq=False)
class Stage:
    """A fit on some rows, seen by diagnosis.

    ``rows`` are indices of the rows used, in the order of time; ``sigma`` (m,) the noise of each axis;
    ``filtered`` the filter that takes the correlation of the noise from row to row out;
    ``candidates`` the effects that can be tried; ``untestable`` effect to the reason why it cannot.
    """

    run: FittedRun
    rows: NDArray[np.int64]
    axes: tuple[int, ...]
    sigma: Floats
    filtered: Whitening
    view: Linearised
    family: Family
    scan: Scan
    candidates: tuple[Candidate, ...]
    untestable: dict[str, str]
    nuisance: tuple[Shape, ...]
    #: Waves of the inputs where it is a thorough one.
    waves: Waves | None
    #: Columns of effects and shapes (n, m, k), not filtered in time.
    columns: Floats = field(repr=False)

    @cached_property
    def plain(self) -> ConditionalScan:
        """Nothing added, besides the nuisance shapes."""
        return self.scan.condition(self.nuisance_columns)

    @cached_property
    def nuisance_columns(self) -> Floats:
        """Columns of shapes that were accepted as a description of what no effect explains."""
        parts = [self.scan.take(columns_of(s)) for s in self.nuisance]
        return np.concatenate(parts, axis=1) if parts else np.zeros((self.scan.n * self.scan.m, 0))

    def with_effects(self, *added: Candidate) -> ConditionalScan:
        """The family once these effects are added, in linear approximation."""
        parts = [self.nuisance_columns] + [self.scan.take(c.columns) for c in added]
        return self.scan.condition(np.concatenate(parts, axis=1))

    @cached_property
    def deviates(self) -> Floats:
        """Scores of shapes, then of candidates."""
        return self.plain.deviates()

    @property
    def n_shapes(self) -> int:
        """How many of the scores belong to shapes."""
        return len(self.family.shapes)


def columns_of(shape: Shape) -> Columns:
    """A shape's columns for the scan."""
    return Columns(shape.functions, shape.axis, shape.dense, shape.waves)


def stage_of(
    run: FittedRun,
    effects: Sequence[Effect],
    rows: NDArray[np.int64],
    sigma: Floats,
    *,
    rho: float | None = None,
    nuisance: Sequence[Shape] = (),
    thorough: bool = True,
    at: Mapping[str, float] | None = None,
    waves: Waves | None = None,
) -> Stage:
    """Builds the stage for a run on the given ones of its rows. ``sigma`` (columns,) is the noise per reading.

    Only a ``thorough`` one has the shapes that cost time, periods and hysteresis, and tries periodic effects at every
    frequency; else they are tried at the period that the model has and at that of ``at``, by name. ``waves`` are those
    of an earlier stage of the same rows, which need not be made again.

    Raises :class:`FitError` where no row has all readings.
    """
    rows = testable(run, rows)
    sigma = sigma[list(run.axes)]
    view = run.linearised(rows, effects, sigma)
    candidates: list[Candidate] = []
    offset = 0
    for effect, of_effect in view.effects:
        first, offset = offset, offset + of_effect.shape[2]
        candidates.append(Candidate(effect, Columns(dense=tuple(range(first, offset)), exact=True)))
    physical = _stacked(view)
    periods = [(n.depends_on[0], n.period) for n in nuisance if n.period is not None]
    waves = (waves or Waves(view)) if thorough else None
    family = build(view, waves, periods=periods, number=offset)
    offset += family.dense.shape[2]
    stepped: list[Floats] = []
    for effect, moved in view.in_time:
        for shape in family.shapes:
            if shape.shape != "step" or shape.axis is not None:
                continue
            about = Columns(functions=shape.functions, exact=True)
            if moved is not None and view.time is not None and shape.setting is not None:
                after = (view.time >= shape.setting)[:, None, None]
                stepped.append(np.where(after, moved, 0.0))
                first, offset = offset, offset + moved.shape[2]
                about = Columns(dense=tuple(range(first, offset)), exact=True)
            candidates.append(Candidate(effect, about, shape.setting))
    for effect, _ in view.periodic:
        if effect.name in (at or {}):
            period = (at or {})[effect.name]
            stepped.append(waves_of(view, 1.0 / period))
            first, offset = offset, offset + stepped[-1].shape[2]
            candidates.append(Candidate(effect, Columns(dense=tuple(range(first, offset)), exact=True), period))

    if rho is None:
        rho = correlation_in_time(view.residual, _rich_basis(view.fitted, physical, family))
    columns = np.concatenate([physical, family.dense, *stepped], axis=2)
    filtered = Whitening(rho, _lags(run.data.order[rows]))
    if waves is not None:
        candidates += [
            Candidate(effect, Columns(waves=numbers, exact=True), period)
            for effect, _ in view.periodic
            for numbers, period in waves.on_all_inputs()
        ]
    scan = Scan(
        filtered(view.residual),
        filtered(view.fitted),
        filtered(family.functions),
        filtered(columns),
        [columns_of(s) for s in family.shapes] + [c.columns for c in candidates],
        view.group,
        waves.filtered(filtered) if waves is not None else None,
    )
    return Stage(
        run=run,
        rows=rows,
        axes=run.axes,
        sigma=sigma,
        filtered=filtered,
        view=view,
        family=family,
        scan=scan,
        candidates=tuple(candidates),
        untestable=dict(view.untestable),
        nuisance=tuple(_again(n, family.shapes) for n in nuisance),
        waves=waves,
        columns=columns,
    )


def testable(run: FittedRun, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those of these rows that have all readings, in the order of time. Raises :class:`FitError` for too few."""
    rows = rows[run.whole[rows]]
    if run.data.time_s is not None:
        rows = rows[np.argsort(run.data.time_s[rows], kind="stable")]
    if len(rows) < 10:
        raise FitError(
            f"{run.data.source}: {len(rows)} rows with all readings are too few to diagnose; expected 10 or more"
        )
    return rows


def _stacked(view: Linearised) -> Floats:
    """Columns (n, m, k) of every effect."""
    columns = [columns for _, columns in view.effects]
    return np.concatenate(columns, axis=2) if columns else np.zeros((len(view), view.axes, 0))


def _lags(place: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many rows of the run it is from one of these rows to the next."""
    return np.concatenate([[1], np.maximum(np.diff(place), 1)])


def _rich_basis(fitted: Floats, physical: Floats, family: Family) -> Floats:
    """Orthonormal columns of what is fitted, of every effect, and of the smooth shapes: all that noise is not.

    Functions on single axes are orthonormal on all axes once they are on one, so only the rest costs time.
    """
    n, m = fitted.shape[:2]
    smooth = sorted({k for s in family.shapes if s.shape in ("smooth", "interaction") for k in s.functions})
    # never so many that little is left to see the noise in
    f = orthonormal(family.functions[:, smooth[: n // 4]], 1e-6)
    columns = np.concatenate([fitted, physical], axis=2)
    rest = columns - np.einsum("nf,fmk->nmk", f, np.einsum("nf,nmk->fmk", f, columns, optimize=True), optimize=True)
    q = orthonormal(rest, 1e-6)[:, : max((n * m) // 8, 1)]
    out = np.zeros((n, m, m * f.shape[1] + q.shape[1]))
    for a in range(m):
        out[:, a, a * f.shape[1] : (a + 1) * f.shape[1]] = f
    out[:, :, m * f.shape[1] :] = q.reshape(n, m, -1)
    return out.reshape(n * m, -1)


def _again(old: Shape, shapes: Sequence[Shape]) -> Shape:
    """The shape of this stage that is the same as one of an earlier stage."""

    def same(s: Shape) -> bool:
        return (s.depends_on, s.shape, s.order, s.axis, s.pattern, s.setting) == (
            old.depends_on, old.shape, old.order, old.axis, old.pattern, old.setting,
        )  # fmt: skip

    alike = [s for s in shapes if same(s)]
    if old.period is not None:
        return min(alike, key=lambda s: abs((s.period or 0.0) - (old.period or 0.0)), default=old)
    return alike[0] if alike else old
