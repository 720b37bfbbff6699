"""The calibrated spherical robot: where its tool points, how to point it, how well, and where its centre is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
import tomli_w
from numpy.typing import ArrayLike, NDArray

from . import _core
from .calibration_file import FORMAT, Keys, check_names, tables_of
from .chain import effects_by_name
from .coverage import radius_95
from .errors import CalibrationError, SherkitError
from .identification import Fit
from .measurements.columns import SPHERICAL_ANGLES, TEMPERATURE
from .notebook import Shown
from .robots.batch import Batch, matrix, vector
from .robots.file import robot_from_tables
from .robots.spherical import Spherical
from .spherical_model import SphericalModel

Floats = NDArray[np.float64]

_NOW = ("time_s", "temperature_c", "direction_1", "direction_2")


@dataclass(frozen=True, eq=False)
class SphericalCalibration(Shown):
    """A calibrated spherical robot. Angles φ and γ, rad, are those of the end of the tool axis seen from the centre.

    What was identified of the measurement alone (camera, its delay, the marker's place on the tool) does not move the
    tool and is left out of :meth:`forward`. ``free``, ``effects``, ``values`` and ``covariance`` (p, p) are what was
    identified; effects given in NumPy do not run in a control loop and are listed in ``left_out``. ``now`` holds time,
    temperature and directions that stand in where the loop gives none. ``residual_covariance_rad2`` (2, 2) are held-out
    readings about the model, as angles across the tool: the camera's noise included. ``low_rad`` and ``high_rad`` (2,)
    are the corners of the box in φ and γ in which the run measured.
    """

    #: What :meth:`forward` gives, with units.
    coordinates: ClassVar[tuple[str, ...]] = SPHERICAL_ANGLES.coordinates

    robot: Spherical
    free: tuple[str, ...]
    effects: tuple[str, ...]
    left_out: tuple[str, ...]
    now: tuple[float, float, float, float]
    values: Floats
    covariance: Floats
    residual_covariance_rad2: Floats
    low_rad: Floats
    high_rad: Floats
    made_from: str
    rows: int

    def __post_init__(self) -> None:
        _ = self.core  # refuses numbers that do not fit together

    @classmethod
    def of(cls, fit: Fit, held_out: Floats) -> SphericalCalibration:
        """From a fit and held-out residuals of its readings (n, 2). Raises as :class:`SphericalModel`."""
        model = fit.model
        assert isinstance(model, SphericalModel)
        data, count = fit.data, len(model.indices)
        time, temperature = data.time_s, data.covariates.get(TEMPERATURE)
        made = cls(
            robot=model.robot,
            free=model.free,
            effects=tuple(e.name for e in model.built_in),
            left_out=tuple(e.name for e in model.own),
            now=(
                float(time.max()) if time is not None else 0.0,
                float(temperature.mean()) if temperature is not None else 20.0,
                0.0,
                0.0,
            ),
            values=fit.values[:count],
            covariance=(fit.covariance + fit.unobserved_covariance)[:count, :count],
            residual_covariance_rad2=np.zeros((2, 2)),
            low_rad=np.zeros(2),
            high_rad=np.zeros(2),
            made_from=data.source,
            rows=len(data),
        )
        full = data.taken.all(axis=1) & ~data.outlier & np.isfinite(held_out).all(axis=1)
        angles, across = made._as_angles(fit, held_out, full)
        return replace(
            made,
            residual_covariance_rad2=across.T @ across / max(len(across), 1),
            low_rad=angles.min(axis=0) if len(angles) else np.zeros(2),
            high_rad=angles.max(axis=0) if len(angles) else np.zeros(2),
        )

    def _as_angles(self, fit: Fit, held_out: Floats, rows: NDArray[np.bool_]) -> tuple[Floats, Floats]:
        """Angles (k, 2) of the rows, and their residuals carried through the joints to angles across it (k, 2)."""
        model, data = fit.model, fit.data.select(rows)
        _, by_joints, _, seen = model.core.derivatives(model.full(fit.values), model.block(data), [])
        angles, by_angles, _, reached = self.core.forward_batch(np.ascontiguousarray(data.joints), list(self.now), [])
        use = seen & reached & (np.abs(np.linalg.det(by_joints)) > 0)
        turned = by_angles[use] @ np.linalg.solve(by_joints[use], held_out[rows][use][:, :, None])
        return angles[use], _across(turned[:, :, 0], angles[use])

    # -- the model ---------------------------------------------------------------------------------------

    @cached_property
    def model(self) -> SphericalModel:
        """The model that was identified."""
        return SphericalModel(self.robot, self.free, effects_by_name(SphericalModel.catalogue, self.effects))

    @cached_property
    def core(self) -> _core.SphericalCalibrated:
        """The compiled model: the same code that a control loop runs."""
        return _core.SphericalCalibrated(self.model.chain, self.model.full(self.values), self.robot.working_mode)

    @property
    def radius_mm(self) -> float:
        """Distance of the end of the tool from the centre, as identified."""
        names = [p.name for p in self.model.parameters]
        return self.robot.radius_mm + (float(self.values[names.index("radius")]) if "radius" in names else 0.0)

    def _now(self, temperature_c: float | None, direction: ArrayLike | None) -> list[float]:
        now = list(self.now)
        if temperature_c is not None:
            now[1] = float(temperature_c)
        if direction is not None:
            now[2:] = [float(d) for d in vector(direction, "direction", 2)]
        return now

    def forward(
        self, joints_rad: ArrayLike, *, temperature_c: float | None = None, direction: ArrayLike | None = None
    ) -> Floats:
        """φ and γ (2,), rad, for joint readings (2,), rad.

        ``direction`` (sign of the last motion of each joint) matters only where backlash was identified. Raises
        :class:`~sherkit.errors.OutOfReach` or ``Singular`` with what is wrong.
        """
        return self.core.forward(vector(joints_rad, "joint readings", 2), self._now(temperature_c, direction))[0]

    def jacobian(
        self, joints_rad: ArrayLike, *, temperature_c: float | None = None, direction: ArrayLike | None = None
    ) -> Floats:
        """d(φ, γ) / d joints (2, 2). Arguments and errors as :meth:`forward`."""
        return self.core.forward(vector(joints_rad, "joint readings", 2), self._now(temperature_c, direction))[1]

    def inverse(
        self, angles_rad: ArrayLike, *, temperature_c: float | None = None, direction: ArrayLike | None = None
    ) -> Floats:
        """Joint readings (2,), rad, that point the tool to φ and γ (2,) to 1e-12 rad. Raises as :meth:`forward`."""
        return self.core.inverse(vector(angles_rad, "phi and gamma", 2), self._now(temperature_c, direction))

    def forward_batch(self, joints_rad: ArrayLike) -> Batch:
        """φ, γ (n, 2) for joint readings (n, 2); rows out of reach are marked."""
        values, _, _, reached = self.core.forward_batch(matrix(joints_rad, "joint readings", 2), list(self.now), [])
        return Batch(values, reached)

    def inverse_batch(self, angles_rad: ArrayLike) -> Batch:
        """Joint readings (n, 2) for φ, γ (n, 2); rows out of reach are marked."""
        values, reached = self.core.inverse_batch(matrix(angles_rad, "phi and gamma", 2), list(self.now))
        return Batch(values, reached)

    # -- accuracy ----------------------------------------------------------------------------------------

    def accuracy(self, angles_rad: ArrayLike) -> float:
        """Radius, mm, within which the end of the tool is predicted to be of φ, γ (2,) in 95 of 100 cases.

        Parameter covariance carried to the tool, plus that of held-out residuals, at the identified radius; where no
        pose was measured (:meth:`measured`) it holds only as far as the model does. By matching two moments
        (Satterthwaite). Raises as :meth:`inverse`.
        """
        x = vector(angles_rad, "phi and gamma", 2)
        self.inverse(x)  # says why where it cannot be reached
        return float(self.accuracy_batch(x[None, :]).require("pose")[0])

    def accuracy_batch(self, angles_rad: ArrayLike) -> Batch:
        """:meth:`accuracy` at each of φ, γ (n, 2): values (n,), mm; those out of reach are marked."""
        x = matrix(angles_rad, "phi and gamma", 2)
        joints = self.inverse_batch(x)
        out = np.full(len(x), np.nan)
        rows = np.flatnonzero(joints.reached)
        at = np.ascontiguousarray(joints.values[rows])
        angles, _, by_values, _ = self.core.forward_batch(at, list(self.now), self.model.indices)
        across = np.stack([_across(by_values[:, :, k], angles) for k in range(by_values.shape[2])], axis=2)
        spread = across @ self.covariance @ across.transpose(0, 2, 1) + self.residual_covariance_rad2
        out[rows] = self.radius_mm * radius_95(spread)
        return Batch(out, joints.reached)

    def measured(self, angles_rad: ArrayLike) -> bool:
        """Whether φ, γ (2,) lie in the box in which poses were measured, give or take a tenth."""
        x = vector(angles_rad, "phi and gamma", 2)
        margin = 0.1 * (self.high_rad - self.low_rad)
        return bool(((x >= self.low_rad - margin) & (x <= self.high_rad + margin)).all())

    def places(self) -> list[tuple[str, Floats]]:
        """Directions φ, γ (2,), rad, for which a person would ask how accurate the robot is, with their names."""
        low, high = self.low_rad, self.high_rad
        out = [("middle of the run", 0.5 * (low + high)), ("corner near the axis", low), ("corner far from it", high)]
        return [(name, np.array(place)) for name, place in out]

    # -- files -------------------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Writes TOML that :meth:`load` reads back without loss."""
        std = np.sqrt(np.diag(self.covariance).clip(0.0))
        whole = {
            "made_from": self.made_from,
            "rows": self.rows,
            "effects": list(self.effects),
            "left_out": list(self.left_out),
            "now": dict(zip(_NOW, self.now, strict=True)),
            "parameters": [
                {"name": p.name, "value": float(v), "std": float(s), "unit": p.unit}
                for p, v, s in zip(self.model.parameters, self.values, std, strict=True)
            ],
            "covariance": self.covariance.tolist(),
            "residual_covariance_rad2": self.residual_covariance_rad2.tolist(),
            "low_rad": self.low_rad.tolist(),
            "high_rad": self.high_rad.tolist(),
        }
        settings = {"format": FORMAT, "made_by": f"sherkit {_core.__version__}"}
        tables = {"calibration": settings, "robot": self.robot.to_tables(), "whole": whole}
        Path(path).write_text(tomli_w.dumps(tables), encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> SphericalCalibration:
        """Reads what :meth:`save` wrote. Raises :class:`~sherkit.errors.CalibrationError` naming file and key."""
        path = Path(path)
        tables, _ = tables_of(path, "spherical")
        try:
            keys = Keys(tables, "").table("whole")
            robot = robot_from_tables(Keys(tables, "").table("robot").values, f"{path} [robot]")
            assert isinstance(robot, Spherical)
            parameters = [Keys(p, "whole.parameters") for p in keys.get("parameters", list, "a list of tables")]
            now = keys.table("now")
            time, temperature, first, second = (now.number(name) for name in _NOW)
            rows = keys.get("rows", int, "a whole number")
            made = cls(
                robot=robot,
                free=tuple(n for n in (p.get("name", str, "a name") for p in parameters) if "." not in n),
                effects=keys.names("effects"),
                left_out=keys.names("left_out"),
                now=(time, temperature, first, second),
                values=np.array([p.number("value") for p in parameters], dtype=float),
                covariance=keys.covariance("covariance", len(parameters)),
                residual_covariance_rad2=keys.covariance("residual_covariance_rad2", 2),
                low_rad=keys.array("low_rad", 2),
                high_rad=keys.array("high_rad", 2),
                made_from=keys.get("made_from", str, "a file name"),
                rows=rows,
            )
            check_names(made.model, keys)
        except (TypeError, ValueError, OverflowError, SherkitError) as error:
            raise CalibrationError(f"{path}: {error}") from None
        return made

    def __repr__(self) -> str:
        effects = f", {', '.join(self.effects)}" if self.effects else ""
        return f"SphericalCalibration({self.rows} rows of {self.made_from}{effects})"


def _across(change: Floats, angles: Floats) -> Floats:
    """Changes of φ and γ (n, 2) as angles across the tool: φ counts the less the nearer the tool is to the axis."""
    return np.column_stack([change[:, 0] * np.sin(angles[:, 1]), change[:, 1]])
