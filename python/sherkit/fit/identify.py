"""Identification: the parameters that fit the readings, and how well each is known.

Source: Eqs. 9 to 11 of Xiao et al., ISMR 2022, solved column-scaled and rank-revealing and iterated to the
nonlinear minimum. The covariance is the usual ``s² (JᵀJ)⁻¹`` (Seber and Wild, *Nonlinear Regression*, 2.1); with a
robust loss, Huber's correction (Huber and Ronchetti, *Robust Statistics*, Eq. 7.81).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from typing import Any

import numpy as np
import polars as pl

from ..base import linalg
from ..base.arguments import NotNegative, validate_arguments
from ..base.figures import number
from ..base.notebook import Shown
from ..base.types import Floats
from ..data import Measurements
from ..data.noise import ReadingNoise, noise_of
from ..data.reader import RunLike
from ..data.repeats import Repeatability
from ..errors import FitError
from ..model.any import Model
from ..model.base import ModelWithEffects, require_columns
from ..model.effect import Effect, Parameter, named_effects
from ..model.kinds import model_of
from ..model.robot_file import RobotLike, read_robot, run_for
from ..model.thermometers import catalogue_for
from .constant_columns import held
from .error import ErrorSize, held_out_error, noise_beside, of_residuals, repeatability_of
from .least_squares import (
    LOSSES,
    NEAR,
    ROUGHLY,
    LeastSquaresProblem,
    beginning,
    noise_ratio,
    over_the_wall,
    reached,
    scale,
    spread,
)
from .regions import Elsewhere, drawn_by, errors_elsewhere, in_plausible_sizes, part_of, scaled_sizes, sizes_told
from .set_up import set_up_mistakes
from .table import Direction, badly_observed, parameter_frame, parameter_table, unobserved

#: A robust fit settles in a few rounds; wild rows from which the first round starts may take some more.
_ROBUST_ROUNDS = 30
#: Evaluations of a fit that begins at the drawing.
_EVALUATIONS = 100
#: A part of the plausible sizes from which on they count as they are.
_AS_PLAUSIBLE = 0.9
#: From so many plausible sizes on a parameter is absurd, and nothing is believed.
ABSURD = 500.0
#: From so many times the noise on, what is left bends parameters by more than it scatters.
_LACKING = 2.0
#: It has settled when no value moves by more than this part of its plausible size; and it may still move by this part
#: of its deviation when the rounds are over.
_SETTLED = 1e-7
_STILL = 1e-3


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Identified:
    """What rows tell of the parameters of a model, without the rows.

    ``values`` (p,) are errors in the units of ``parameters``. ``covariance`` (p, p) is what the readings leave,
    ``unobserved_covariance`` what they do not tell at all, from the plausible sizes. ``scale`` is the ratio of the
    residuals to the assumed noise (to one unit of the readings where the noise is unknown).
    """

    #: A :class:`ModelWithEffects`; of a robot that of its kind, whose own fields its calibration reads.
    model: Any
    values: Floats
    covariance: Floats
    unobserved_covariance: Floats
    rank: int
    singular_values: Floats
    unobserved_basis: Floats
    scale: float
    converged: bool
    evaluations: int

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The identified parameters."""
        parameters: tuple[Parameter, ...] = self.model.parameters
        return parameters

    @cached_property
    def std(self) -> Floats:
        """Standard deviation of each value: readings and plausible sizes together."""
        return np.sqrt(np.diag(self.covariance + self.unobserved_covariance).clip(0.0))

    @cached_property
    def std_from_readings(self) -> Floats:
        """Standard deviation of each value from the readings alone, unobserved directions held."""
        return np.sqrt(np.diag(self.covariance).clip(0.0))

    @cached_property
    def by_name(self) -> dict[str, float]:
        """Values by parameter name."""
        return dict(zip((p.name for p in self.parameters), self.values.tolist(), strict=True))

    @property
    def condition_number(self) -> float:
        """Largest over smallest observed singular value of the column-scaled system."""
        s = self.singular_values
        return float(s[0] / s[self.rank - 1]) if self.rank else float("inf")

    @cached_property
    def unobserved(self) -> tuple[Direction, ...]:
        """Combinations of parameters that change no reading here."""
        return unobserved(self.parameters, self.unobserved_basis, self.model.sensitivities)

    @cached_property
    def badly_observed(self) -> tuple[Direction, ...]:
        """Combinations of parameters that the readings fix worst."""
        return badly_observed(self.parameters, self.covariance, self.model.sensitivities)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self.values)} parameters, rank {self.rank})"


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Fit(Identified, Shown):
    """A model fitted to rows, of any machine.

    ``residuals`` (n, m) is measured minus predicted, NaN where nothing was taken. ``print(fit)`` shows a table of its
    parameters.
    """

    data: Measurements
    noise: ReadingNoise
    loss: str
    #: The part of the plausible sizes within which the drawing counts as known; 0 where it does not.
    priors: float
    #: Whether the drawing counts for the regions alone: with an effect more in the model it may not need to.
    for_regions: bool = False

    @cached_property
    def repeatability(self) -> Repeatability | None:
        """By how much repeats of a pose differ beside what the model explains of them; None where no pose was read
        twice."""
        return repeatability_of(self)

    @cached_property
    def predicted(self) -> Floats:
        """Predicted readings (n, m)."""
        predicted: Floats = self.model.predict(self.data, self.values)
        return predicted

    @cached_property
    def residuals(self) -> Floats:
        """Measured minus predicted (n, m); NaN where nothing was taken."""
        return np.where(self.data.taken, self.data.readings - self.predicted, np.nan)

    @cached_property
    def error(self) -> ErrorSize:
        """How far it is off, on rows held out (:mod:`sherkit.fit.error`)."""
        return self.error_by(0)

    def error_by(self, seed: int) -> ErrorSize:
        """The same by other random splits."""
        return held_out_error(self, seed, refit=self.refitted)

    @cached_property
    def elsewhere(self) -> Elsewhere | None:
        """How far it is off in whole regions of the joints that are held out, and the drawing there
        (:mod:`sherkit.fit.regions`); None where poses are too few for that, or no joint moves."""
        return errors_elsewhere(self)

    def refitted(self, data: Measurements) -> Floats:
        """The parameters (p,) of these rows alone, from the drawing."""
        return identify(self.model, data, loss=self.loss, priors=self.priors).values

    @cached_property
    def nominal_error(self) -> ErrorSize:
        """How far the nominal robot is off."""
        return of_residuals(self.data, self.nominal_residuals, held_out=False)

    @cached_property
    def nominal_residuals(self) -> Floats:
        """Measured minus the nominal robot's prediction (n, m) (delta: Eq. 14), seen from where the sensor must stand
        where that is free."""
        return residuals(self.model, self.data, self.model.start(self.data))

    @cached_property
    def sizes(self) -> Floats:
        """Plausible sizes (p,); where the drawing counts, as closely as it does, and of effects as large as they are
        found."""
        sizes = scaled_sizes(self.model, self.priors or 1.0)
        return sizes_told(self.model, sizes, self.values) if self.priors else sizes

    @cached_property
    def supported(self) -> int:
        """How many combinations of parameters the readings tell better than plausible sizes do.

        Along the others noise moves the values further than they can plausibly be: such a fit is nearer to its own rows
        and further from new ones than one with fewer parameters, or with ``priors``.
        """
        return self.supported_by(self.priors or 1.0)

    def supported_by(self, part: float) -> int:
        """The same where the drawing holds within a part of the plausible sizes."""
        size = scaled_sizes(self.model, part)
        told = linalg.eigvalsh(self.covariance / np.outer(size, size))
        # with priors a combination that both tell alike has half the variance of either
        return self.rank - int(np.count_nonzero(told > (0.5 if self.priors else 1.0)))

    @property
    def overparametrised(self) -> str | None:
        """A sentence on how many parameters the rows support, where that is not all they observe; else None."""
        beyond = self.rank - self.supported
        if not beyond:
            return None
        ways = "" if self.priors else ", or take plausible sizes as knowledge (priors=True, --priors)"
        return (
            f"{len(self.data)} rows support {self.supported} of {len(self.parameters)} parameters: along {beyond} "
            f"combination{'s' if beyond > 1 else ''} noise moves them further than is plausible, which fits better and "
            f"predicts worse. Free fewer, measure more{ways}"
        )

    @property
    def lacking(self) -> str | None:
        """A sentence on deviations that a lack of fit makes too small: it is counted as noise, drawn anew in each row,
        while it bends all parameters together; None where little more than noise is left, or none is known."""
        if self.noise.origin == "unknown" or self.scale < _LACKING:
            return None
        return (
            f"What it leaves is {number(self.scale)} times the noise: the model lacks something, which moves the "
            "parameters further than their deviations say (those count it as noise of each row); diagnose looks for it"
        )

    @cached_property
    def params(self) -> pl.DataFrame:
        """Every parameter, those that are held at zero last, as a polars frame.

        ``name``, ``value``, ``std_from_readings``, ``std`` and ``plausible`` size, all in ``unit``; ``state`` says
        what the readings tell of it: ``observed``, ``in part``, ``unobserved``, of an effect with a simpler form ``not
        by itself``, or ``fixed``.
        """
        return parameter_frame(self)

    def rms(self, which: Floats | None = None) -> dict[str, float]:
        """RMS of residuals per reading, in the unit that people read; of :attr:`residuals` unless others are given.

        Over rows that were taken and are not marked as outliers.
        """
        values = self.residuals if which is None else which
        out = {}
        for k, name in enumerate(self.data.layout.readings):
            rows = self.data.used[:, k]
            if rows.any():
                out[name] = float(self.data.layout.per_unit * np.sqrt(np.mean(values[rows, k] ** 2)))
        return out

    def __repr__(self) -> str:
        named = dict(zip(self.data.layout.readings, self.data.layout.names, strict=True))
        each = ", ".join(f"{named[k]} {v:.1f}" for k, v in self.rms().items())
        unit = self.data.layout.unit
        return f"Fit({len(self.values)} parameters, rank {self.rank}, RMS {each} {unit})"

    def __str__(self) -> str:
        return parameter_table(self)

    def _repr_html_(self) -> str:
        return super()._repr_html_() or f"<pre>{escape(str(self))}</pre>"


def residuals(model: ModelWithEffects, data: Measurements, values: Floats) -> Floats:
    """Measured minus predicted (n, m); NaN where nothing was taken."""
    return np.where(data.taken, data.readings - model.predict(data, values), np.nan)


@validate_arguments
def identify(
    robot: RobotLike | Model | ModelWithEffects,
    data: RunLike,
    *,
    free: Sequence[str] = (),
    effects: Sequence[str | Effect] = (),
    loss: str = "linear",
    priors: bool | NotNegative | None = None,
    linear: bool = False,
    start: Sequence[float] | Floats | None = None,
    noise: ReadingNoise | None = None,
) -> Fit:
    """Fits the free parameters of a robot, or of any other machine's model, to the readings.

    Robot and run may be given by their files, the run as a frame too.
    ``free`` names them (default: those of the kind of robot). ``effects`` are identified besides: names of the
    catalogue, or the user's own. ``loss`` is ``linear``, ``huber``, ``cauchy`` or ``tukey``.
    ``priors`` takes the drawing, with the plausible sizes as deviations, as one more measurement; a number above zero
    takes that part of these sizes, where it is the drawing that they are of. Left out, the drawing counts where the
    readings alone would leave combinations of parameters less sure than the drawing does, reach no minimum, or are
    worse than the drawing in a region that is left out; as closely as the moves of all parameters say that it holds
    (:mod:`.strength`). ``linear`` takes the paper's single step of Eq. 11.
    ``noise`` overrides what
    :func:`~sherkit.data.noise.noise_of` finds.

    Raises :class:`~sherkit.errors.FitError` for rows out of reach, an unknown loss, or too few readings, and
    :class:`~sherkit.errors.EffectError` for an effect that is not known.

        fit = sk.identify("demo/robot.toml", "demo/whole.csv", effects=["rail_lean"])
        print(fit.by_name["rail_lean.radial_1"], fit.rms())
    """
    given = read_robot(robot)
    model = model_of(given, free)
    data = run_for(robot, data)
    model = extended_by(model, effects, data) if effects else model
    data = model.as_declared(data)
    model = model.for_run(data)
    if loss not in LOSSES:
        raise FitError(f"loss: '{loss}' is not known; choose {', '.join(LOSSES)}")
    told = noise is not None
    noise = noise or noise_of(data)
    if not data.used.any():
        raise FitError(f"{data.source}: every row is marked as an outlier; nothing is left to fit")
    fit = _fitted(model, data, noise, start, loss=loss, part=float(priors or 0.0), linear=linear)
    if not told and (beside := noise_beside(fit)) is not None:
        near = fit.values if fit.converged else start
        fit = _fitted(model, data, beside, near, loss=loss, part=float(priors or 0.0), linear=linear)
    return fit if priors is not None or linear else _with_drawing(fit, start)


def _with_drawing(fit: Fit, start: Sequence[float] | Floats | None) -> Fit:
    """What readings do not decide the drawing does, unless they contradict it; those that never change cannot: the
    smaller a robot is, the better it fits them. What begins at another fit was asked there how closely it holds."""
    # along what readings leave open a fit may have run away
    away = fit.rank < len(fit.values) and is_absurd(fit)
    if not fit.converged or fit.supported < fit.rank or away:
        drawn = _drawn(fit, 1.0, start)
        kept = fit.converged and not held(fit.data) and not is_absurd(fit) and _contradict(fit, drawn)
        return fit if kept else _as_it_holds(drawn)
    part = part_of(fit) if start is None and fit.loss == "linear" else 1.0
    if start is not None or _holds_alone(fit, part):
        return fit
    drawn = _drawn(fit, part, fit.values)
    return fit if not held(fit.data) and _contradict(fit, drawn) else replace(drawn, for_regions=True)


def is_absurd(fit: Fit) -> bool:
    """Whether it takes a machine that nobody could have built: what readings hardly tell of it swallows all else."""
    drawn = drawn_by(fit.model)
    sizes = np.array([p.size for p in fit.parameters])
    return bool((np.abs(fit.values[drawn]) > ABSURD * sizes[drawn]).any())


def _holds_alone(fit: Fit, part: float) -> bool:
    """Whether readings are enough without a drawing that holds within a part of the plausible sizes: they leave no
    combination of parameters less sure than that does, and no region that the fit did not see is worse with it."""
    if fit.supported_by(part) < fit.rank:
        return False
    return fit.elsewhere is None or not fit.elsewhere.is_worse


def _drawn(fit: Fit, part: float, start: Sequence[float] | Floats | None) -> Fit:
    """The same with the drawing, known within a part of the plausible sizes."""
    return _fitted(fit.model, fit.data, fit.noise, start, loss=fit.loss, part=part, linear=False)


def _as_it_holds(drawn: Fit) -> Fit:
    """A fit with a drawing that counts within plausible sizes, with it as closely as the readings find that it holds:
    no less, where they alone decide nothing."""
    part = part_of(drawn) if drawn.loss == "linear" else 1.0
    return drawn if part > _AS_PLAUSIBLE else _drawn(drawn, part, drawn.values)


def _contradict(plain: Fit, drawn: Fit) -> bool:
    """Whether the readings of a ``plain`` fit contradict the drawing, with which that ``drawn`` was made: it leaves
    more than numbers without a drawing are worth (Schwarz, "Estimating the dimension of a model", Annals of Statistics
    1978). Fewer are contradicted by chance, but what a model lacks is no chance: a fit bends to it as no robot is
    built, and pays for it away from the poses measured."""
    left = [
        float(np.square(one.residuals[one.data.used] / one.noise.sigma[one.data.used]).sum()) for one in (plain, drawn)
    ]
    return left[1] - left[0] > plain.rank * float(np.log(np.count_nonzero(plain.data.used))) * plain.scale**2


def _fitted(
    model: ModelWithEffects,
    data: Measurements,
    noise: ReadingNoise,
    start: Sequence[float] | Floats | None,
    *,
    loss: str,
    part: float,
    linear: bool,
    sizes: Floats | None = None,
) -> Fit:
    """With the drawing known within a ``part`` of the plausible sizes; 0 where it does not count. ``sizes`` (p,) are
    those of a first such fit, which finds how large effects are."""
    weights, priors, beyond_noise = np.where(data.used, 1.0 / noise.sigma, 0.0), part > 0.0, 1.0
    first = sizes is None
    sizes = scaled_sizes(model, part or 1.0) if sizes is None else sizes
    problem = LeastSquaresProblem(model, data, sizes)
    known = priors or any(p.known for p in model.parameters)
    try:
        values = beginning(model, data, weights) if start is None else model.starting_at(start)
        # what begins at another fit is near its minimum, or has none
        most, roughly = (_EVALUATIONS, _EVALUATIONS) if start is None else (NEAR, ROUGHLY)
        if known:
            ratio, near = noise_ratio(problem, weights, values, loss=loss, priors=priors, linear=linear, most=roughly)
            if noise.origin != "unknown":
                # what the model lacks is no noise, and bends the robot as if it were: the drawing is weighed against it
                ratio = beyond_noise = max(ratio, 1.0)
            weights, values = weights / max(ratio, 1e-12), values if linear else near
        solver, ended = problem.solve(weights, values, priors=priors, linear=linear, max_evaluations=most)
        result = solver.result()
        if not reached(ended, result):
            solver, ended = over_the_wall(problem, weights, solver, ended, priors=priors)
            result = solver.result()
    except FitError as error:
        mistakes = set_up_mistakes(model, data) if start is None else ()
        if not mistakes:
            raise
        raise FitError(f"{error} Most likely: {'; '.join(m.sentence for m in mistakes)}.") from None
    values = solver.trial
    moved = np.zeros(0)
    if loss != "linear":
        # residuals are judged by their own spread, taken anew until it settles
        for _ in range(_ROBUST_ROUNDS):
            robust = weights / spread(problem.residuals(values), weights)
            solver, ended = problem.solve(robust, values, priors=priors, linear=linear, loss=loss)
            moved, values = np.abs(solver.trial - values), solver.trial
            if (moved <= _SETTLED * problem.sizes).all():
                break
        result = solver.result()
    evaluations, at_minimum = result["evaluations"], reached(ended, result)
    judged, plain = weights, loss == "linear" and not known
    if plain and not linear:
        # the solver knows what is left
        beyond_rank = np.count_nonzero(weights) - result["rank"]
        overall = ratio = float(np.sqrt(result["cost"] / beyond_rank)) if beyond_rank > 0 else 1.0
    else:
        left = problem.residuals(values)
        judged = weights if loss == "linear" else weights / spread(left, weights)
        if not plain:
            # what the readings say there, none of them weighed down for being far off
            result = problem.information(judged, values)
        ratio = scale(left, judged, result["rank"], loss)
        # of a robust fit the covariance is that of each column by its own spread; this is all of them over the noise
        overall = ratio if loss == "linear" else scale(left, weights, result["rank"], loss)
    covariance, beyond = result["covariance"] * ratio**2, result["unobserved_covariance"]
    if known:
        both = problem.information(judged / max(ratio, 1e-12), values, priors=priors)
        covariance, beyond = both["covariance"], both["unobserved_covariance"]
    if loss != "linear":
        still = np.maximum(_STILL * np.sqrt(np.diag(covariance).clip(0.0)), _SETTLED * problem.sizes)
        at_minimum = at_minimum and bool((moved <= still).all())
    fit = Fit(
        model=model,
        data=data,
        values=values,
        covariance=covariance,
        unobserved_covariance=beyond,
        rank=result["rank"],
        singular_values=result["singular_values"],
        unobserved_basis=in_plausible_sizes(result["unobserved"], model, sizes),
        scale=overall * beyond_noise,
        noise=noise,
        loss=loss,
        priors=part,
        converged=at_minimum,
        evaluations=evaluations,
    )
    if first and part and not linear and (fit.sizes > sizes).any():
        return _fitted(model, data, noise, values, loss=loss, part=part, linear=linear, sizes=fit.sizes)
    return fit


def extended_by(
    model: ModelWithEffects, effects: Sequence[str | Effect], data: Measurements | None = None
) -> ModelWithEffects:
    """The model with more effects: by name, of the thermometers of a run too, or the user's own. Raises
    :class:`~sherkit.errors.EffectError`."""
    for effect in named_effects(catalogue_for(model, data), effects):
        if data is not None:
            require_columns(effect, data)
        model = model.adopting(effect)
    return model
