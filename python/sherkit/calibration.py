"""From measurements to a calibration: identify, hold out, correct, and account for the errors."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .base import linalg
from .base.arguments import NotNegative, Seed, validate_arguments
from .base.figures import listed
from .base.types import Floats
from .data import Measurements
from .data.doubts import doubts
from .data.reader import RunLike
from .diagnosis.outliers import gross_errors, warn_of_outliers
from .diagnosis.selection import adopting
from .errors import FitError, SherkitWarning
from .evidence.plausible import refuse_absurd
from .evidence.thresholds import SURE
from .fit.constant_columns import outside_limits, unread
from .fit.hold_out import hold_out
from .fit.identify import identify
from .fit.known_stand import known_stand
from .fit.set_up import set_up_mistakes
from .model.effect import Effect, named_effects
from .model.kinds import model_of
from .model.robot_file import RobotLike, columns_of, robot_of, run_for
from .model.thermometers import catalogue_for, further, grows, nearer_by, with_temperature_of
from .robots.calibrated import Calibration, calibration_class
from .robots.calibration_run import CalibrationRun

Progress = Callable[[str], None]

CORRECTIONS = ("auto", "none", "paper")
#: What is said of a sensor that a fit has elsewhere than where it is known to stand.
_OFF_STAND = (
    ": it stands elsewhere (measure again where, or say [sensor_pose] free = true), or takes up what the model lacks "
    "(diagnose); the accuracy in the frame of the base counts both"
)


def _silent(_: str) -> None:
    """No progress."""


@dataclass(frozen=True, eq=False)
class Result:
    """Everything a calibration run found; ``calibration`` is what to deploy."""

    whole: CalibrationRun
    local: CalibrationRun | None
    calibration: Calibration

    @property
    def converged(self) -> bool:
        """Whether every identification reached its minimum."""
        return self.whole.fit.converged and (self.local is None or self.local.fit.converged)


@validate_arguments
@linalg.one_thread()
def calibrate(
    robot: RobotLike,
    whole: RunLike,
    local: RunLike | None = None,
    *,
    free: Sequence[str] = (),
    effects: Sequence[str | Effect] = (),
    loss: str = "linear",
    priors: bool | NotNegative | None = None,
    linear: bool = False,
    correction: str = "auto",
    with_outliers: bool = False,
    seed: Seed = 0,
    step: Progress = _silent,
) -> Result:
    """Calibrates a robot from a run over its workspace and, if given, one inside its region of interest.

    Robot and runs may be given by their files, runs as frames too. ``effects``, names of the catalogue or the user's
    own, are identified together with the geometry. ``correction``, for robots that have one: ``auto`` chooses it
    by blocked cross-validation (or none, where none helps); ``none`` leaves the geometry alone; ``paper`` takes the one
    of the paper's protocol, and is refused for robots without one. Rows that a diagnosis lists as gross errors are left
    out, unless ``with_outliers``: then they are used, with a warning where they decide the fit.
    ``step`` is told what is being done. Raises :class:`~sherkit.errors.FitError`, and
    :class:`~sherkit.errors.CalibrationError` for a robot whose kind has no calibration.

        result = sk.calibrate("demo/robot.toml", "demo/whole.csv", effects=["rail_lean"])
        result.calibration.save("calibrated.toml")
    """
    if correction not in CORRECTIONS:
        raise FitError(f"correction: '{correction}' is not known; choose {', '.join(CORRECTIONS)}")
    whole, local = run_for(robot, whole), None if local is None else run_for(robot, local)
    given, robot = robot, robot_of(robot)
    # what these parameters leave held can be freed by the name that a diagnosis gives it
    added = named_effects(catalogue_for(model_of(robot, free), whole), effects)
    own = [effect for effect in added if effect.function is not None]
    made = calibration_class(robot)
    made.require(robot)
    if local is not None:
        made.require_region(robot)
    if correction == "paper":
        made.require_correction(robot)

    def run(data: Measurements, name: str) -> CalibrationRun:
        model = model_of(robot, free)
        data = model.as_declared(data)
        for said in (
            *unread(data),
            *outside_limits(model, data),
            *(doubt for doubt in doubts(data) if not doubt.poses),
        ):
            warnings.warn(f"{data.source}: {said}", SherkitWarning, stacklevel=2)
        if data.set_ups:
            warnings.warn(
                f"{data.source}: the instrument was moved ({listed(one.name for one in data.set_ups)}, then "
                f"{data.last_set_up}): what is deployed is as seen from where it stood last, in setup "
                f"'{data.last_set_up}'",
                SherkitWarning,
                stacklevel=2,
            )
        outliers = np.zeros(0, dtype=np.int64)
        if not with_outliers:
            step(f"looking for gross errors in the {name} run")
            # what needs a setting that is searched for is among the effects that are tried, not in this fit
            inside = [e for e in added if e.search is None and not e.goes_with]
            outliers = gross_errors(identify(model, data, effects=inside), own)
            data = data.mark_outliers(outliers)
        step(f"identifying the {name} run")
        model = adopting(model, added, data)
        fit = identify(model, data, loss=loss, priors=priors, linear=linear)
        for mistake in set_up_mistakes(fit.model, data, fit.values):
            if np.isfinite(mistake.after):
                warnings.warn(f"{data.source}: {mistake}", SherkitWarning, stacklevel=2)
        refuse_absurd(fit, [effect.name for effect in added])
        if (stand := known_stand(fit)) is not None and not stand.holds:
            said = f"{data.source}: the {stand.called} stands {stand}{_OFF_STAND}"
            warnings.warn(said, SherkitWarning, stacklevel=2)
        used = {name for effect in model.effects for name in effect.needs}
        for column in (one for one in further(data) if any(map(grows, added)) and one not in used):
            other = identify(model, with_temperature_of(data, column), loss=loss, priors=priors, linear=linear)
            if len(data) * np.log(fit.error.rms / other.error.rms) > SURE:
                warnings.warn(f"{data.source}: {nearer_by(column, data)}", SherkitWarning, stacklevel=2)
        if with_outliers:
            outliers = (warn_of_outliers if loss == "linear" else gross_errors)(fit, own)
        step(f"holding out blocks of the {name} run")
        held = hold_out(fit.model, data, seed=seed, loss=loss, priors=fit.priors or priors)
        corrected = None
        if correction != "none" and made.may_correct(fit):
            step(f"correcting what the {name} run leaves")
            corrected = made.correct(fit, correction, seed)
        return CalibrationRun(fit, held.residuals, corrected, made.in_region(fit), outliers, held.block)

    first = run(whole, "whole")
    second = run(local, "local") if local is not None else None
    return Result(first, second, replace(made.from_runs(first, second), columns=columns_of(given)))


def to_json(result: Result) -> dict[str, Any]:
    """What a program wants to know; see README."""
    return {
        "converged": result.converged,
        "whole": _run_json(result.whole),
        "local": _run_json(result.local) if result.local else None,
        # known where there is a local model
        "border_jump_um": None,
        **{key: value for note in result.calibration.notes() for key, value in note.json.items()},
    }


def _run_json(run: CalibrationRun) -> dict[str, Any]:
    fit = run.fit
    repeats = fit.repeatability

    layout = fit.data.layout
    # programs find the unit in the key
    unit = {"µm": "um"}.get(layout.unit, layout.unit)

    def rms(values: Floats) -> dict[str, float]:
        return {name.rsplit("_", 1)[0]: value[0] for name, value in run.rms(values).items()}

    def directions(found: Sequence[Any]) -> list[dict[str, Any]]:
        return [{"text": str(d), "change": d.change, "std_mm": None if np.isinf(d.std) else d.std} for d in found]

    return {
        "source": fit.data.source,
        "rows": len(fit.data),
        "converged": fit.converged,
        "evaluations": fit.evaluations,
        "rank": fit.rank,
        "parameters_free": len(fit.parameters),
        "condition_number": fit.condition_number if np.isfinite(fit.condition_number) else None,
        "noise": {
            "origin": fit.noise.origin,
            f"repeatability_{unit}": {k.rsplit("_", 1)[0]: layout.per_unit * v for k, v in repeats.sigma.items()}
            if repeats
            else None,
        },
        "nominal_error": fit.nominal_error.to_json(),
        "error": fit.error.to_json(),
        "elsewhere": None if fit.elsewhere is None else fit.elsewhere.to_json(),
        f"rms_{unit}": {
            "before": rms(fit.nominal_residuals),
            "after": rms(fit.residuals),
            "held_out": rms(run.held_out),
            "held_out_corrected": rms(run.corrected),
        },
        **{k: v for note in calibration_class(fit.model.robot).about(fit) for k, v in note.json.items()},
        "parameters": [
            {
                "name": p.name, "value": v, "std": s, "std_from_readings": r, "unit": p.unit,
            }
            for p, v, s, r in zip(
                fit.parameters, fit.values.tolist(), fit.std.tolist(), fit.std_from_readings.tolist(), strict=True
            )
        ],
        "covariance": (fit.covariance + fit.unobserved_covariance).tolist(),
        "badly_observed": directions(fit.badly_observed),
        "unobserved": directions(fit.unobserved),
        "outliers": fit.data.line[run.outliers].tolist(),
        "correction": None,
        "paper_protocol": None,
        **(run.correction.to_json() if run.correction is not None else {}),
    }  # fmt: skip
