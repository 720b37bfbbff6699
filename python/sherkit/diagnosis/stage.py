"""One stage of the search: a fit, what it leaves, and every candidate's score."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from ..base.types import Floats, Ints
from ..evidence.fitted_run import FittedRun
from ..evidence.linearised import FittedAnew, Linearised, last_asked, step_gains, within
from ..evidence.run import in_time, one_after_another
from ..evidence.whitening import Whitening, correlation_in_time, orthonormal
from ..model.effect import Effect
from .axis_waves import AxisWaves
from .columns import Block, Columns, Image
from .lack_of_fit import chi2_log_tail
from .scan import Scan
from .shapes import Family, Shape, build
from .waves import Waves, waves_of

#: Time constants that are tried, and the fewest readings in one of them.
_LAGS, _READINGS_BEHIND = 8, 4.0
#: Rows that tell how noise is correlated in time: more would tell it better than any test here could see.
_CORRELATED = 8192
#: Chance that pure noise has a step.
_STEPS = 1e-6
#: Part of a step's square below which nothing of it is left beside the other columns.
_NOTHING_LEFT = 1e-4


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
class Written:
    """All columns that are written out, a stretch of rows at a time.

    ``more`` gives columns (b, m, k) beside those of effects and shapes.
    """

    view: Linearised
    family: Family
    more: tuple[Callable[[slice], Floats], ...]
    filtered: Whitening

    @property
    def blocks(self) -> Sequence[slice]:
        """The stretches."""
        return self.view.blocks

    @last_asked
    def block(self, rows: slice) -> Block:
        """A stretch under the filter in time."""
        on = self.filtered.on
        return Block(
            residual=on(lambda part: self.view.residual[part], rows),
            fitted=on(lambda part: self.view.fitted(part), rows),
            functions=on(self.family.functions_in, rows),
            dense=on(self.dense, rows),
        )

    @last_asked
    def dense(self, rows: slice) -> Floats:
        """Full columns (b, m, k) of a stretch, not filtered: of effects, of shapes, and the others."""
        last = self.view.effects[-1][1].stop if self.view.effects else 0
        effects = self.view.effects_in(rows)[:, :, :last]
        return np.concatenate([effects, self.family.dense_in(rows), *(one(rows) for one in self.more)], axis=2)


@dataclass(frozen=True, eq=False)
class Refitted:
    """The same columns beside another fit of the same rows, whose ``view`` has what is fitted and what it leaves."""

    written: Written
    view: Linearised

    @property
    def blocks(self) -> Sequence[slice]:
        """The stretches."""
        return self.written.blocks

    @last_asked
    def block(self, rows: slice) -> Block:
        """One of them."""
        on, view = self.written.filtered.on, self.view
        residual, fitted = on(lambda part: view.residual[part], rows), on(view.fitted, rows)
        return replace(self.written.block(rows), residual=residual, fitted=fitted)


@dataclass(frozen=True, eq=False)
class Stage:
    """A fit on some rows, seen by diagnosis.

    ``rows`` are indices of the rows used, in the order of time; ``sigma`` (m,) the noise of each axis;
    ``filtered`` the filter that takes the correlation of the noise from row to row out;
    ``candidates`` the effects that can be tried; ``untestable`` effect to the reason why it cannot; ``nuisance`` shapes
    that were accepted as a description of what no effect explains: ``scan`` has them in its model.
    """

    run: FittedRun
    rows: NDArray[np.int64]
    axes: tuple[int, ...]
    sigma: Floats
    view: Linearised
    written: Written
    scan: Scan
    candidates: tuple[Candidate, ...]
    untestable: dict[str, str]
    nuisance: tuple[Shape, ...]
    #: Waves of the inputs, where periods are asked for.
    waves: Waves | None

    @property
    def filtered(self) -> Whitening:
        """The filter in time."""
        return self.written.filtered

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Shapes of the family."""
        return self.written.family.shapes

    @property
    def n_shapes(self) -> int:
        """How many of the scores belong to shapes."""
        return len(self.shapes)

    @cached_property
    def gains(self) -> Floats:
        """What each candidate takes."""
        return self.scan.gains[0][self.n_shapes :]

    def raw(self, columns: Columns, rows: slice) -> Floats:
        """A candidate's columns (b, m, k) in a stretch of rows before the filter in time."""
        if not columns.functions:
            return self.written.dense(rows)[:, :, list(columns.dense)]
        functions = self.written.family.functions_in(rows)[:, list(columns.functions)]
        return np.einsum("nk,ab->nakb", functions, np.eye(self.view.axes)).reshape(len(functions), self.view.axes, -1)

    def columns_of(self, candidate: Candidate, rows: slice) -> Floats:
        """The same of an effect, a wave at the very period of its setting."""
        if candidate.columns.waves and candidate.setting is not None:
            return waves_of(self.view, 1.0 / candidate.setting, rows)
        return self.raw(candidate.columns, rows)

    def among(self, candidates: Sequence[Candidate]) -> Image:
        """These effects in full."""
        return self.scan.among([c.columns for c in candidates])

    def asking(self, candidates: Sequence[Candidate]) -> Stage:
        """The same with these candidates alone."""
        columns = [*(s.columns for s in self.shapes), *(c.columns for c in candidates)]
        return replace(self, candidates=tuple(candidates), scan=self.scan.asking(columns))

    def refitted(self, run: FittedRun, added: Sequence[Candidate]) -> Stage:
        """The stage of the full fit ``run`` with these effects: what they are has the derivatives of that fit; shapes
        and all other effects, which change by as little as the machine does, keep those of this one."""
        own = run.linearised(self.rows, (), self.sigma)
        view = replace(self.view, residual=own.residual, derivatives=FittedAnew(own.derivatives, self.view))
        names = {one.name for one in added}
        asked = self.asking([c for c in self.candidates if c.name not in names])
        return replace(asked, run=run, view=view, scan=asked.scan.beside(Refitted(self.written, view)))


def stage_of(
    run: FittedRun,
    effects: Sequence[Effect],
    rows: NDArray[np.int64],
    sigma: Floats,
    *,
    rho: float | None = None,
    nuisance: Sequence[Shape] = (),
    thorough: bool = True,
    waves: Waves | None = None,
    periods: Sequence[tuple[str, float]] = (),
) -> Stage:
    """Builds the stage for a run on the given ones of its rows. ``sigma`` (columns,) is the noise per reading.

    Only a ``thorough`` one has the shapes that cost time, periods and hysteresis, and tries periodic effects at every
    frequency; else they are tried at the period that the model has. ``waves`` are those of an earlier stage of the same
    rows, which need not be made again; ``periods`` (variable, period) are tried as shapes besides.

    Raises :class:`FitError` where no row has all readings.
    """
    rows = in_time(run, rows)
    sigma = sigma[list(run.axes)]
    view = run.linearised(rows, effects, sigma)
    candidates = [
        Candidate(effect, Columns(dense=tuple(range(at.start, at.stop)), exact=True)) for effect, at in view.effects
    ]
    offset = view.effects[-1][1].stop if view.effects else 0
    periods = [*periods, *((n.depends_on[0], n.period) for n in nuisance if n.period is not None)]
    waves = (waves or Waves(view)) if thorough else None
    family = build(view, waves, periods=periods, number=offset)
    offset += len(family.dense)
    more: list[Callable[[slice], Floats]] = []

    def full(columns: Callable[[slice], Floats], count: int) -> Columns:
        nonlocal offset
        more.append(columns)
        first, offset = offset, offset + count
        return Columns(dense=tuple(range(first, offset)), exact=True)

    for effect, place in view.in_time:
        for shape in family.shapes:
            if shape.shape != "step" or shape.axis is not None:
                continue
            about = Columns(functions=shape.functions, exact=True)
            if place is not None and view.time is not None and shape.setting is not None:
                about = full(_stepped(view, place, shape.setting), place.stop - place.start)
            candidates.append(Candidate(effect, about, shape.setting))
    for effect, behind in view.lagging:
        width = len(effect.parameters)
        candidates += [Candidate(effect, full(behind(lag), width), lag) for lag in lags_of(view)]

    lag, back = one_after_another(run.data.order, run.data.series, rows)
    if rho is None:
        rho = _correlation(view, family, back)
    filtered = Whitening(rho, lag, back)
    if waves is not None:
        candidates += [
            Candidate(effect, Columns(waves=numbers, exact=True), period)
            for effect, _ in view.periodic
            for numbers, period in waves.on_all_inputs
        ]
    accepted = tuple(again(n, family.shapes) for n in nuisance)
    written = Written(view, family, tuple(more), filtered)
    scan = Scan(
        written,
        [s.columns for s in family.shapes] + [c.columns for c in candidates],
        view.group,
        waves.filtered(filtered) if waves is not None and len(waves) else None,
        AxisWaves(family.along, view.axes, filtered) if family.along else None,
        [s.columns for s in accepted],
    )
    return Stage(
        run=run,
        rows=rows,
        axes=run.axes,
        sigma=sigma,
        view=view,
        written=written,
        scan=scan,
        candidates=tuple(candidates),
        untestable=dict(view.untestable),
        nuisance=accepted,
        waves=waves,
    )


def _stepped(view: Linearised, place: slice, moment: float) -> Callable[[slice], Floats]:
    """Columns of an effect from a moment on."""
    return partial(_rows_from, view, place, moment)


def _rows_from(view: Linearised, place: slice, moment: float, rows: slice) -> Floats:
    assert view.time is not None, "a step has a moment"
    first = int(np.searchsorted(view.time[rows], moment))
    out = view.effects_in(rows)[:, :, place].copy()
    out[:first] = 0.0
    return out


def lags_of(view: Linearised) -> list[float]:
    """Time constants, s, that are tried: each half of the one before, from the length of the run to a few readings.
    What is slower goes by what the temperature has summed up to; what is quicker has followed."""
    if view.time is None:
        return []
    length = float(np.ptp(view.time))
    least = max(_READINGS_BEHIND * length / len(view), length / 2.0**_LAGS)
    return [float(lag) for lag in length / 2.0 ** np.arange(_LAGS) if lag >= least]


def _correlation(view: Linearised, family: Family, back: Ints | None) -> float:
    """Correlation of the noise in time, from the beginning of a run."""
    rows = slice(0, min(len(view), _CORRELATED))
    last = view.effects[-1][1].stop if view.effects else 0
    basis = _rich_basis(view.fitted(rows), view.effects_in(rows)[:, :, :last], family, rows)
    basis = np.concatenate([basis, _largest_step(view.residual[rows], basis)], axis=1)
    return correlation_in_time(view.residual[rows], basis, None if back is None else back[rows])


def _rich_basis(fitted: Floats, physical: Floats, family: Family, rows: slice) -> Floats:
    """Orthonormal columns of what is fitted, of every effect, and of the smooth shapes: all that noise is not.

    Functions on single axes are orthonormal on all axes once they are on one, so only the rest costs time.
    """
    n, m = fitted.shape[:2]
    # a period on single axes is one that was found
    known = ("smooth", "interaction", "periodic")
    smooth = sorted({k for s in family.shapes if s.shape in known for k in s.functions})
    # never so many that little is left to see the noise in
    f = orthonormal(family.functions_in(rows)[:, smooth[: n // 4]], 1e-6)
    columns = np.concatenate([fitted, physical], axis=2)
    rest = columns.copy()
    for a in range(m):
        rest[:, a] -= f @ (f.T @ columns[:, a])
    q = orthonormal(rest, 1e-6)[:, : max((n * m) // 8, 1)]
    out = np.zeros((n, m, m * f.shape[1] + q.shape[1]))
    for a in range(m):
        out[:, a, a * f.shape[1] : (a + 1) * f.shape[1]] = f
    out[:, :, m * f.shape[1] :] = q.reshape(n, m, -1)
    return out.reshape(n * m, -1)


def _largest_step(residual: Floats, basis: Floats) -> Floats:
    """What an orthonormal basis (n·m, k) leaves of the step on all axes that takes most beside it, orthonormal
    (n·m, r): neighbours on one side of it are alike whatever the noise is. Nothing where chance may have taken it."""
    n, m = residual.shape
    cuts = np.arange(2, n - 2)
    nothing, free_numbers = np.zeros((n * m, 0)), n * m - basis.shape[1]
    if not len(cuts) or free_numbers <= m:
        return nothing
    flat = residual.reshape(-1)
    left = (flat - basis @ (basis.T @ flat)).reshape(n, m)
    inside = within((column.reshape(n, m) for column in np.ascontiguousarray(basis.T)), cuts)
    gain = step_gains(left, inside, cuts, _NOTHING_LEFT)
    variance = max(float((left**2).sum() - gain.max()) / (free_numbers - m), 1e-300)
    if chi2_log_tail(float(gain.max()) / variance, m) + np.log(len(cuts)) > np.log(_STEPS):
        return nothing
    step = np.zeros((n, m, m))
    step[cuts[np.argmax(gain)] :] = np.eye(m)
    columns = step.reshape(n * m, m)
    columns = columns - basis @ (basis.T @ columns)
    return orthonormal(columns[:, (columns**2).sum(axis=0) > _NOTHING_LEFT * n], 1e-6)


def again(old: Shape, shapes: Sequence[Shape]) -> Shape:
    """The shape of this stage that is the same as one of an earlier stage."""

    def same(s: Shape) -> bool:
        return (s.depends_on, s.shape, s.order, s.axis, s.pattern, s.setting) == (
            old.depends_on, old.shape, old.order, old.axis, old.pattern, old.setting,
        )  # fmt: skip

    alike = [s for s in shapes if same(s)]
    if old.period is not None:
        return min(alike, key=lambda s: abs((s.period or 0.0) - (old.period or 0.0)), default=old)
    return alike[0] if alike else old
