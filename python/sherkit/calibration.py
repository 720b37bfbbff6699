"""Calibration: the model to deploy. Forward, inverse and Jacobian of the corrected robot, and its accuracy.

The whole-workspace model holds everywhere; a local one, where there is one, replaces it inside the region of
interest, blended over a margin so that a commanded position never jumps (the paper switches at the border).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import tomli_w
from numpy.typing import ArrayLike, NDArray

from . import _core
from .calibration_file import FORMAT, Keys, check_names, tables_of
from .correction import MAX_ORDER, Correction
from .coverage import radius_95
from .errors import CalibrationError, SherkitError
from .identification import Fit
from .measurements.columns import POSITION, TEMPERATURE
from .model import DeltaModel, effects_by_name
from .notebook import Shown
from .parameters import Parameter
from .robots import Delta
from .robots.batch import Batch, matrix, vector
from .robots.file import robot_from_tables

Floats = NDArray[np.float64]

#: Width of the blend around the region of interest, as a part of its half width.
_BLEND = 0.25


@dataclass(frozen=True, eq=False)
class Part:
    """One identified model: errors by name, their covariance, a correction, and what it leaves.

    ``free`` and ``effects`` say what was identified, ``settings`` the settings of the effects; effects given in NumPy
    do not run in a control loop and are listed in ``left_out``. ``now`` holds time, temperature and directions that
    stand for the covariates where the loop does not give its own: the end of the run, its mean temperature, the
    middle of the backlash. ``covariance`` (p, p) in the order of ``values``; ``residual_covariance_mm2`` (3, 3) of
    held-out readings about
    the corrected model and ``uncorrected_covariance_mm2`` about the geometric one, repeatability included.
    ``low_mm`` and ``high_mm`` (3,) are the corners of the box in which the run measured.
    """

    free: tuple[str, ...]
    effects: tuple[str, ...]
    settings: dict[str, float]
    left_out: tuple[str, ...]
    now: tuple[float, float, float, float, float]
    values: Floats
    covariance: Floats
    residual_covariance_mm2: Floats
    uncorrected_covariance_mm2: Floats
    low_mm: Floats
    high_mm: Floats
    correction: Correction | None
    made_from: str
    rows: int

    @classmethod
    def of(cls, fit: Fit, correction: Correction | None, corrected_mm: Floats, uncorrected_mm: Floats) -> Part:
        """From a fit, its correction, and held-out residuals (n, 3), mm, with the correction and without."""
        where = fit.predicted_mm[~fit.data.is_distance & ~fit.data.outlier, :3]
        if len(where) == 0:
            where = np.zeros((1, 3))
        model = fit.model
        settings = model.settings()
        core = len(model.indices)
        # the fit took all misfit for noise; what the correction has removed of it is none
        left, before = _second_moment(corrected_mm), _second_moment(uncorrected_mm)
        shrink = min(1.0, float(np.trace(left) / max(np.trace(before), 1e-300)))
        time, temperature = fit.data.time_s, fit.data.covariates.get(TEMPERATURE)
        return cls(
            free=model.free,
            effects=tuple(e.name for e in model.built_in),
            settings={
                "period_mm": settings["period_mm"] or 0.0,
                "slip_time_s": settings["slip_time_s"] or 0.0,
                "time_origin_s": settings["time_origin_s"] or 0.0,
            },
            left_out=tuple(e.name for e in model.own),
            now=(
                float(time.max()) if time is not None else 0.0,
                float(temperature.mean()) if temperature is not None else 20.0,
                0.0,
                0.0,
                0.0,
            ),
            values=fit.values[:core],
            covariance=fit.covariance[:core, :core] * shrink,
            residual_covariance_mm2=left,
            uncorrected_covariance_mm2=before,
            low_mm=where.min(axis=0),
            high_mm=where.max(axis=0),
            correction=correction,
            made_from=fit.data.source,
            rows=len(fit.data),
        )


@dataclass(frozen=True, eq=False)
class Calibration(Shown):
    """A calibrated delta. Positions are readings of the measured point: the datum of the run is included."""

    #: What :meth:`forward` gives, with units.
    coordinates: ClassVar[tuple[str, ...]] = POSITION

    robot: Delta
    whole: Part
    local: Part | None = None
    region_half_width_mm: float | None = None
    blend_mm: float | None = None

    def __post_init__(self) -> None:
        if (self.local is None) != (self.region_half_width_mm is None):
            raise CalibrationError("a local model needs the half width of its region, and the reverse")
        for name in ("region_half_width_mm", "blend_mm"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise CalibrationError(f"{name}: expected a positive number, got {value}")
        _ = self.core  # refuses numbers that do not fit together

    # -- the model ---------------------------------------------------------------------------------------

    def _model(self, part: Part) -> DeltaModel:
        s = part.settings
        return DeltaModel(
            self.robot,
            part.free,
            effects_by_name(part.effects),
            period_mm=s["period_mm"] or None,
            slip_time_s=s["slip_time_s"],
            time_origin_s=s["time_origin_s"],
        )

    def _core_part(self, part: Part) -> tuple[_core.DeltaModel, Floats, _core.Bernstein | None]:
        model = self._model(part)
        return model.core, model.full(part.values), part.correction.core if part.correction else None

    def _now(self, temperature_c: float | None, direction: ArrayLike | None) -> list[float]:
        """Covariates for the core: those given, else those that stand in for them."""
        now = list(self.whole.now)
        if temperature_c is not None:
            now[1] = float(temperature_c)
        if direction is not None:
            now[2:] = [float(d) for d in vector(direction, "direction")]
        return now

    @cached_property
    def core(self) -> _core.Calibrated:
        """The compiled model: the same code that a control loop runs."""
        local = region = None
        if self.local is not None and self.region_half_width_mm is not None:
            local = self._core_part(self.local)
            half = float(self.region_half_width_mm)
            blend = self.blend_mm if self.blend_mm is not None else _BLEND * half
            region = (np.full(3, -half), np.full(3, half), blend)
        return _core.Calibrated(self._core_part(self.whole), local, region)

    def forward(
        self, joints_mm: ArrayLike, *, temperature_c: float | None = None, direction: ArrayLike | None = None
    ) -> Floats:
        """Position (3,) for joint readings (3,), mm.

        ``temperature_c`` and ``direction`` (sign of the last motion of each joint) matter only where the model holds
        an effect that needs them; left out, :attr:`Part.now` stands for them. Raises
        :class:`~sherkit.errors.OutOfReach`.
        """
        return self.core.forward(vector(joints_mm, "joint readings"), self._now(temperature_c, direction))[0]

    def jacobian(
        self, joints_mm: ArrayLike, *, temperature_c: float | None = None, direction: ArrayLike | None = None
    ) -> Floats:
        """d position / d joints (3, 3) of the whole corrected model. Arguments and errors as :meth:`forward`."""
        return self.core.forward(vector(joints_mm, "joint readings"), self._now(temperature_c, direction))[1]

    def inverse(
        self, position_mm: ArrayLike, *, temperature_c: float | None = None, direction: ArrayLike | None = None
    ) -> Floats:
        """Joint readings (3,) at which the corrected model gives ``position_mm`` to within 1 nm.

        Arguments as :meth:`forward`. Raises :class:`~sherkit.errors.OutOfReach`, or ``NotConverged`` where
        the correction folds over.
        """
        return self.core.inverse(vector(position_mm, "position"), self._now(temperature_c, direction))

    def forward_batch(self, joints_mm: ArrayLike) -> Batch:
        """Positions (n, 3) for joint readings (n, 3); rows out of reach are marked."""
        values, _, reached = self.core.forward_batch(matrix(joints_mm, "joint readings"), self._now(None, None))
        return Batch(values, reached)

    def jacobian_batch(self, joints_mm: ArrayLike) -> Batch:
        """Jacobians (n, 3, 3) for joint readings (n, 3); rows out of reach are marked."""
        _, values, reached = self.core.forward_batch(matrix(joints_mm, "joint readings"), self._now(None, None))
        return Batch(values, reached)

    def inverse_batch(self, positions_mm: ArrayLike) -> Batch:
        """Joint readings (n, 3) for positions (n, 3); rows out of reach are marked."""
        values, reached = self.core.inverse_batch(matrix(positions_mm, "positions"), self._now(None, None))
        return Batch(values, reached)

    # -- accuracy ----------------------------------------------------------------------------------------

    def accuracy(self, position_mm: ArrayLike) -> float:
        """Radius, mm, within which the robot is predicted to be of ``position_mm`` (3,) in 95 of 100 cases.

        Parameter covariance carried to the position, plus the covariance of held-out residuals (repeatability
        and what the model leaves; without the correction as far as it has faded). Where no pose was measured
        (:meth:`measured`) this is extrapolation and holds only as far as the model does.
        The radius of a three-dimensional Gaussian by matching two moments of its squared length (Satterthwaite).
        Raises as :meth:`inverse`.
        """
        x = vector(position_mm, "position")
        self.inverse(x)  # says why where it cannot be reached
        return float(self.accuracy_batch(x[None, :]).require("position")[0])

    def accuracy_batch(self, positions_mm: ArrayLike) -> Batch:
        """:meth:`accuracy` at every one of ``positions_mm`` (n, 3): values (n,), mm; those out of reach are marked."""
        x = matrix(positions_mm, "positions")
        joints = self.inverse_batch(x)
        out = np.full(len(x), np.nan)
        inside = np.array([self._part_at(one) is self.local for one in x]) & (self.local is not None)
        for part, here in ((self.whole, ~inside), (self.local, inside)):
            rows = np.flatnonzero(here & joints.reached)
            if part is None or not len(rows):
                continue
            model = self._model(part)
            now = np.tile(self._now(None, None), (len(rows), 1))
            block = (np.ascontiguousarray(joints.values[rows]), None, now, None)
            derivative = model.core.derivatives(model.full(part.values), block, model.indices)[0][:, :3]
            share = np.array([part.correction.share(x[row]) if part.correction else 1.0 for row in rows])[:, None, None]
            left = share * part.residual_covariance_mm2 + (1.0 - share) * part.uncorrected_covariance_mm2
            out[rows] = radius_95(derivative @ part.covariance @ derivative.transpose(0, 2, 1) + left)
        return Batch(out, joints.reached, joints.why)

    def measured(self, position_mm: ArrayLike) -> bool:
        """Whether ``position_mm`` (3,) lies in the box in which poses were measured, give or take a tenth."""
        x = vector(position_mm, "position")
        part = self._part_at(x)
        margin = 0.1 * (part.high_mm - part.low_mm)
        return bool(((x >= part.low_mm - margin) & (x <= part.high_mm + margin)).all())

    def _part_at(self, position_mm: Floats) -> Part:
        inside = self.region_half_width_mm is not None and bool(
            (np.abs(position_mm) <= self.region_half_width_mm).all()
        )
        return self.local if inside and self.local is not None else self.whole

    def places(self) -> list[tuple[str, Floats]]:
        """Positions (3,), mm, for which a person would ask how accurate the robot is, with their names."""
        robot = self.robot
        out = [("centre", np.zeros(3))]
        if robot.region_half_width_mm:
            out.append(("corner of the region of interest", np.full(3, float(robot.region_half_width_mm))))
        if robot.workspace_radius_mm and robot.workspace_z_mm:
            rim = np.array([robot.workspace_radius_mm, 0.0, robot.workspace_z_mm[1]])
            out.append(("rim of the workspace", rim))
        return out

    def border_jump_mm(self) -> float | None:
        """Largest difference of local and whole model on the border of the region; None without a local model.

        The blend spreads this difference over its width. A large value says that the two runs had different
        references.
        """
        if self.local is None or self.region_half_width_mm is None:
            return None
        ticks = np.linspace(-1.0, 1.0, 5) * self.region_half_width_mm
        cube = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
        border = cube[np.isclose(np.abs(cube).max(axis=1), self.region_half_width_mm)]
        whole = Calibration(self.robot, self.whole)
        local = Calibration(self.robot, self.local)
        joints = whole.inverse_batch(border)
        there = local.forward_batch(joints.values[joints.reached]).require()
        return float(np.linalg.norm(there - border[joints.reached], axis=1).max())

    # -- files -------------------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Writes TOML that :meth:`load` reads back without loss."""
        parts = {"whole": _part_table(self.whole, self._model(self.whole).parameters)}
        settings: dict[str, Any] = {"format": FORMAT, "made_by": f"sherkit {_core.__version__}"}
        if self.local is not None:
            parts["local"] = _part_table(self.local, self._model(self.local).parameters)
            settings["region_half_width_mm"] = self.region_half_width_mm
        if self.blend_mm is not None:
            settings["blend_mm"] = self.blend_mm
        tables = {"calibration": settings, "robot": self.robot.to_tables(), **parts}
        Path(path).write_text(tomli_w.dumps(tables), encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> Calibration:
        """Reads what :meth:`save` wrote. Raises :class:`~sherkit.errors.CalibrationError` naming file and key."""
        path = Path(path)
        tables, settings = tables_of(path, "delta")
        try:
            robot = robot_from_tables(Keys(tables, "").table("robot").values, f"{path} [robot]")
            assert isinstance(robot, Delta)
            keys = Keys(tables, "")
            made = cls(
                robot=robot,
                whole=_part_from(keys.table("whole")),
                local=_part_from(keys.table("local")) if "local" in tables else None,
                region_half_width_mm=Keys(settings, "calibration").optional_number("region_half_width_mm"),
                blend_mm=Keys(settings, "calibration").optional_number("blend_mm"),
            )
            for name, part in (("whole", made.whole), ("local", made.local)):
                if part is not None:
                    check_names(made._model(part), keys.table(name))
        except (TypeError, ValueError, OverflowError, SherkitError) as error:
            raise CalibrationError(f"{path}: {error}") from None
        return made

    def __repr__(self) -> str:
        parts = f"whole from {self.whole.rows} rows"
        if self.local is not None:
            parts += f", local from {self.local.rows} rows within ±{self.region_half_width_mm:g} mm"
        return f"Calibration({parts})"


_NOW = ("time_s", "temperature_c", "direction_1", "direction_2", "direction_3")


def _part_table(part: Part, parameters: Sequence[Parameter]) -> dict[str, Any]:
    std = np.sqrt(np.diag(part.covariance).clip(0.0))
    table: dict[str, Any] = {
        "made_from": part.made_from,
        "rows": part.rows,
        "effects": list(part.effects),
        "left_out": list(part.left_out),
        "settings": dict(part.settings),
        "now": dict(zip(_NOW, part.now, strict=True)),
        "parameters": [
            {"name": p.name, "value": float(v), "std": float(s), "unit": p.unit}
            for p, v, s in zip(parameters, part.values, std, strict=True)
        ],
        "covariance": part.covariance.tolist(),
        "residual_covariance_mm2": part.residual_covariance_mm2.tolist(),
        "uncorrected_covariance_mm2": part.uncorrected_covariance_mm2.tolist(),
        "low_mm": part.low_mm.tolist(),
        "high_mm": part.high_mm.tolist(),
    }
    if part.correction is not None:
        table["correction"] = part.correction.to_table()
    return table


def _part_from(keys: Keys) -> Part:
    parameters = [Keys(p, f"{keys.path}.parameters") for p in keys.get("parameters", list, "a list of tables")]
    count = len(parameters)
    names = [p.get("name", str, "a name") for p in parameters]
    settings, now = keys.table("settings"), keys.table("now")
    time, temperature, *directions = (now.number(name) for name in _NOW)
    low, high = keys.array("low_mm", 3), keys.array("high_mm", 3)
    if (low > high).any():
        raise ValueError(f"[{keys.path}] low_mm: expected nothing above high_mm, found {low.tolist()}")
    rows = keys.get("rows", int, "a whole number")
    if rows < 0:
        raise ValueError(f"[{keys.path}] rows: expected a whole number, found {rows}")
    return Part(
        free=tuple(name for name in names if "." not in name),
        effects=keys.names("effects"),
        settings={k: settings.number(k) for k in ("period_mm", "slip_time_s", "time_origin_s")},
        left_out=keys.names("left_out"),
        now=(time, temperature, directions[0], directions[1], directions[2]),
        values=np.array([p.number("value") for p in parameters], dtype=float),
        covariance=keys.covariance("covariance", count),
        residual_covariance_mm2=keys.covariance("residual_covariance_mm2", 3),
        uncorrected_covariance_mm2=keys.covariance("uncorrected_covariance_mm2", 3),
        low_mm=low,
        high_mm=high,
        correction=_correction_from(keys.table("correction")) if "correction" in keys.values else None,
        made_from=keys.get("made_from", str, "a file name"),
        rows=rows,
    )


def _correction_from(keys: Keys) -> Correction:
    orders = keys.get("orders", list, f"three orders from 0 to {MAX_ORDER}")
    if len(orders) != 3 or not all(type(o) is int and 0 <= o <= MAX_ORDER for o in orders):
        raise ValueError(f"[{keys.path}] orders: expected three orders from 0 to {MAX_ORDER}, found {orders}")
    count = int(np.prod([o + 1 for o in orders]))
    try:
        return Correction(
            orders=(orders[0], orders[1], orders[2]),
            low_mm=keys.array("low_mm", 3, finite=False),
            high_mm=keys.array("high_mm", 3, finite=False),
            fade_mm=keys.number("fade_mm"),
            coefficients_mm=keys.array("coefficients_mm", count, 3),
        )
    except SherkitError as error:
        raise ValueError(f"[{keys.path}] {error}") from None


def _second_moment(residuals_mm: Floats) -> Floats:
    return residuals_mm.T @ residuals_mm / max(len(residuals_mm), 1)
