"""From measurements to a calibration: identify, hold out, correct, and account for the errors."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .calibration import Calibration, Part
from .calibrations import AnyCalibration
from .chain import lacks
from .correction import Choice, PaperProtocol, choose_correction, leftover, paper_protocol
from .diagnosis.search import slip_time
from .effects import Effect
from .errors import EffectError, FitError, SherkitWarning
from .identification import Fit, identify
from .measurements import Measurements
from .models import model_of
from .names import listed
from .remote_centre import remote_centre
from .robots import Delta, Robot, Spherical
from .spherical_calibration import SphericalCalibration
from .spherical_model import SphericalModel
from .validation import hold_out

Floats = NDArray[np.float64]
Step = Callable[[str], None]

CORRECTIONS = ("auto", "none", "paper")


def _silent(_: str) -> None:
    """No progress."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """One run taken through identification, holding out and correction.

    ``held_out`` (n, m) are residuals of fits that did not see the row's block.
    """

    fit: Fit
    held_out: Floats
    choice: Choice | None
    paper: PaperProtocol | None

    @cached_property
    def corrected(self) -> Floats:
        """Held-out residuals after the correction, chosen and fitted without the row's block, (n, m); those before
        where there is no correction."""
        out = self.held_out.copy()
        if self.choice is not None and self.choice.correction is not None:
            rows = leftover(self.fit).rows
            out[rows, :3] = self.choice.held_out_mm
        return out

    def rms(self, values: Floats, rows: NDArray[np.bool_] | None = None) -> dict[str, tuple[float, float]]:
        """RMS and standard deviation per reading, in the unit that people read, over rows not marked as outliers."""
        out = {}
        layout = self.fit.data.layout
        for k, name in enumerate(layout.readings):
            use = self.fit.data.taken[:, k] & ~self.fit.data.outlier & np.isfinite(values[:, k])
            if rows is not None:
                use = use & rows
            if use.any():
                v = values[use, k] * layout.per_unit
                out[name] = (float(np.sqrt(np.mean(v**2))), float(v.std()))
        return out

    def lines(self) -> list[tuple[str, str, dict[str, tuple[float, float]]]]:
        """Table I: name of a line, that of the paper's ('' where it prints none), RMS and deviation by reading."""
        region = self.in_region
        wanted: list[tuple[str, str, Floats, NDArray[np.bool_] | None]] = [
            ("before calibration", "before", self.fit.nominal_residuals, None),
            ("after geometry", "after", self.fit.residuals, None),
            ("  on poses held out", "", self.held_out, None),
        ]
        if self.choice is not None:
            wanted.append(("  held out, corrected", "", self.corrected, None))
        if region is not None and region.any() and not region.all():
            wanted += [
                ("before, region of interest", "before, region", self.fit.nominal_residuals, region),
                ("after, region of interest", "after, region", self.fit.residuals, region),
            ]
            if self.choice is not None:
                wanted.append(("  held out, corrected", "", self.corrected, region))
        return [(name, key, self.rms(values, rows)) for name, key, values, rows in wanted]

    @cached_property
    def in_region(self) -> NDArray[np.bool_] | None:
        """Rows inside the region of interest in x and y, as the paper counts them; None without a region."""
        half = getattr(self.fit.model.robot, "region_half_width_mm", None)
        if half is None:
            return None
        where = self.fit.predicted[:, :2]
        return (np.abs(where) <= half * 1.02).all(axis=1) & ~self.fit.data.is_distance

    def _left_out(self) -> Floats:
        """What the user's effects add to the prediction (n, m)."""
        fit = self.fit
        deployed = fit.model
        for effect in fit.model.own:
            deployed = deployed.without_effect(effect.name)
        core = deployed.predict(fit.data, fit.values[: len(deployed.parameters)])
        return np.where(fit.data.taken, fit.predicted - core, 0.0)

    def deployed(self, residuals: Floats) -> Floats:
        """Residuals (n, m) as they are where a user's effects do not run: what those explain comes back."""
        own = self.fit.model.own
        if not own:
            return residuals
        without, layout = self._left_out(), self.fit.data.layout
        worst = layout.per_unit * float(np.sqrt(np.mean(without[:, : self.fit.data.coordinates] ** 2)))
        warnings.warn(
            f"{listed(e.name for e in own)}: effects given in NumPy do not run in a control loop and are left out of "
            f"the calibration; that leaves {worst:.1f} {layout.unit} RMS, which the predicted accuracy includes",
            SherkitWarning,
            stacklevel=3,
        )
        return residuals + without

    def part(self) -> Part:
        """The piece of a delta's calibration that this run gives."""
        full = self.fit.data.taken[:, :3].all(axis=1) & ~self.fit.data.outlier
        corrected, uncorrected = self.corrected[full, :3], self.held_out[full, :3]
        if full.any():
            back = self.deployed(np.zeros_like(self.held_out))[full, :3]
            corrected, uncorrected = corrected + back, uncorrected + back
        else:
            # heights or distances only: the same spread on every axis
            spread = float(np.nanmean(self.held_out**2))
            corrected = uncorrected = np.sqrt(3.0 * spread) * np.eye(3)
        correction = self.choice.correction if self.choice else None
        return Part.of(self.fit, correction, corrected, uncorrected)


@dataclass(frozen=True, eq=False)
class Result:
    """Everything a calibration run found; ``calibration`` is what to deploy."""

    whole: Experiment
    local: Experiment | None
    calibration: AnyCalibration

    @property
    def converged(self) -> bool:
        """Whether every identification reached its minimum."""
        return self.whole.fit.converged and (self.local is None or self.local.fit.converged)


def calibrate(
    robot: Robot,
    whole: Measurements,
    local: Measurements | None = None,
    *,
    free: Sequence[str] = (),
    effects: Sequence[Effect] = (),
    loss: str = "linear",
    priors: bool = False,
    linear: bool = False,
    correction: str = "auto",
    seed: int = 0,
    step: Step = _silent,
) -> Result:
    """Calibrates a robot from a run over its workspace and, if given, one inside its region of interest.

    ``effects`` are identified together with the geometry. ``correction``: ``auto`` chooses a Bernstein polynomial by
    blocked cross-validation (or none, where none helps); ``paper`` takes the order that the paper's protocol finds on
    the middle plane, in x and y alone, and fits it to all planes; ``none`` leaves the geometry alone.
    ``step`` is told what is being done. Raises :class:`~sherkit.errors.FitError`.
    """
    if correction not in CORRECTIONS:
        raise FitError(f"correction: '{correction}' is not known; choose {', '.join(CORRECTIONS)}")
    if local is not None and not isinstance(robot, Delta):
        raise FitError(f"a {robot.kind} robot has no region of interest and no local run; join the runs instead")
    if local is not None and isinstance(robot, Delta) and robot.region_half_width_mm is None:
        raise FitError("a local run needs [region_of_interest] half_width_mm in the robot file")

    def experiment(data: Measurements, name: str) -> Experiment:
        step(f"identifying the {name} run")
        model = model_of(robot, free)
        for effect in effects:
            missing = lacks(effect, data)
            if missing:
                raise EffectError(f"{data.source}: '{effect.name}' needs the column {listed(missing)}")
            setting = {"slip_time_s": slip_time(identify(model, data))} if effect.search == "time_s" else {}
            model = model.with_effect(effect, **setting)
        fit = identify(model, data, loss=loss, priors=priors, linear=linear)
        step(f"holding out blocks of the {name} run")
        held = hold_out(fit.model, data, seed=seed, loss=loss).residuals
        choice = paper = None
        wanted = correction != "none" and isinstance(robot, Delta)
        if wanted and data.taken[:, :3].all(axis=1).sum() >= _FEWEST:
            step(f"correcting what the {name} run leaves")
            if correction == "auto":
                choice = choose_correction(fit, seed=seed)
                with suppress(FitError):  # a run without a plane at the middle has no Table III
                    paper = paper_protocol(fit, seed=seed)
            else:
                paper = paper_protocol(fit, seed=seed)
                n = max(paper.orders.values())
                choice = choose_correction(fit, orders=(n,), heights=1, seed=seed, keep_none=False)
        return Experiment(fit, held, choice, paper)

    first = experiment(whole, "whole")
    second = experiment(local, "local") if local is not None else None
    return Result(first, second, calibration_of(first, second))


def calibration_of(whole: Experiment, local: Experiment | None = None) -> AnyCalibration:
    """The model to deploy from what a run, and for a delta perhaps one in its region of interest, has given."""
    robot = whole.fit.model.robot
    if isinstance(robot, Spherical):
        return SphericalCalibration.of(whole.fit, whole.deployed(whole.held_out))
    return Calibration(
        robot=robot,
        whole=whole.part(),
        local=local.part() if local else None,
        region_half_width_mm=robot.region_half_width_mm if local else None,
    )


#: Fewer full positions than this carry no polynomial worth having.
_FEWEST = 20


def to_json(result: Result) -> dict[str, Any]:
    """What a program wants to know; see README."""
    return {
        "converged": result.converged,
        "whole": _experiment_json(result.whole),
        "local": _experiment_json(result.local) if result.local else None,
        "border_jump_um": _border_jump_um(result.calibration),
    }


def _border_jump_um(calibration: AnyCalibration) -> float | None:
    jump = calibration.border_jump_mm() if isinstance(calibration, Calibration) else None
    return None if jump is None else 1e3 * jump


def _experiment_json(e: Experiment) -> dict[str, Any]:
    fit = e.fit
    repeats = fit.data.repeatability

    layout = fit.data.layout
    # programs find the unit in the key
    unit = {"µm": "um"}.get(layout.unit, layout.unit)

    def rms(values: Floats) -> dict[str, float]:
        return {name.rsplit("_", 1)[0]: value[0] for name, value in e.rms(values).items()}

    def directions(found: Sequence[Any]) -> list[dict[str, Any]]:
        return [{"text": str(d), "change": d.change, "std_mm": None if np.isinf(d.std_mm) else d.std_mm} for d in found]

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
            f"repeatability_{unit}": {k.rsplit("_", 1)[0]: layout.per_unit * v for k, v in repeats.sigma_mm.items()}
            if repeats
            else None,
        },
        f"rms_{unit}": {
            "before": rms(fit.nominal_residuals),
            "after": rms(fit.residuals),
            "held_out": rms(e.held_out),
            "held_out_corrected": rms(e.corrected),
        },
        **({"remote_centre_mm": _remote_centre_json(fit)} if isinstance(fit.model, SphericalModel) else {}),
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
        "outliers": fit.data.line[fit.outliers].tolist(),
        "correction": None
        if e.choice is None or e.choice.correction is None
        else {"orders": list(e.choice.correction.orders)},
        "paper_protocol": None
        if e.paper is None
        else {"orders": e.paper.orders, "test_um": e.paper.test_um,
              "other_planes_um": {f"{z:g}": v for z, v in e.paper.other_planes_um.items()}},
    }  # fmt: skip


def _remote_centre_json(fit: Fit) -> dict[str, Any]:
    found = remote_centre(fit)
    size, std = found.largest
    return {"rms": found.rms_mm, "largest": size, "std": std, "within_95": found.within_mm, "in_model": found.explained}
