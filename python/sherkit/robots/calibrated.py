"""Calibrations: the model to deploy, of any robot. Where its tool is, how to bring it there, and how well.

A kind of robot says what it adds: its compiled chain, how parameters move its tool, and what people ask about it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import tomli_w
from numpy.typing import ArrayLike

import sherkit._core as _core

from ..data.columns import TEMPERATURE
from ..data.toml import Table
from ..errors import CalibrationError, FitError, SherkitError
from ..fit.coverage import radius_95
from ..fit.identify import Fit
from ..model.batch import Batch, matrix, vector
from ..model.chain import ChainModel
from ..model.effect import effects_by_name
from ..model.kinds import KINDS, Robot, catalogue_of, kind_of, model_of, robot_from_table
from ..names import listed
from ..notebook import Shown
from ..types import Bools, Floats
from .calibration_file import FORMAT, tables_of
from .calibration_run import CalibrationRun, Corrected

#: Accuracy that subretinal injection needs, µm (Xiao et al., ISMR 2022).
REQUIREMENT_UM = 20.0


@dataclass(frozen=True)
class Note:
    """Something to know about a calibrated robot: its name (or none), a sentence, and the same for programs."""

    name: str
    text: str
    json: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.name}: {self.text}" if self.name else self.text


@dataclass(frozen=True, eq=False)
class Planes:
    """Planes of the workspace to draw a quantity on: ``x`` (nx,) and ``y`` (ny,) in the units of ``labels``.

    ``grid`` (planes · ny · nx, k) are their points in coordinates, plane by plane and row by row, of which ``inside``
    (planes · ny · nx,) belong to the workspace; ``titles`` are those of the planes.
    """

    x: Floats
    y: Floats
    labels: tuple[str, str]
    titles: tuple[str, ...]
    grid: Floats
    inside: Bools


@dataclass(frozen=True, eq=False)
class Part:
    """One identified model: errors by name, their covariance, and what it leaves.

    ``free`` and ``effects`` say what was identified, ``settings`` the settings of the effects; effects given in NumPy
    do not run in a control loop and are listed in ``left_out``. ``now`` holds time, temperature and a direction for
    each joint that stand for the covariates where the loop does not give its own: the end of the run, its mean
    temperature, the middle of the backlash. ``covariance`` (p, p) in the order of ``values``; ``residual_covariance``
    (k, k) of held-out readings about the model, noise included, in the unit of the coordinates. ``low`` and ``high``
    (k,) are the corners of the box in which the run measured, as coordinates.
    """

    free: tuple[str, ...]
    effects: tuple[str, ...]
    settings: dict[str, float]
    left_out: tuple[str, ...]
    now: tuple[float, ...]
    values: Floats
    covariance: Floats
    residual_covariance: Floats
    low: Floats
    high: Floats
    made_from: str
    rows: int

    @staticmethod
    def identified(fit: Fit) -> dict[str, Any]:
        """What a part has from its fit alone."""
        model, data = fit.model, fit.data
        time, temperature = data.time_s, data.covariates.get(TEMPERATURE)
        return {
            "free": model.free,
            "effects": tuple(e.name for e in model.built_in),
            "settings": {name: value or 0.0 for name, value in model.settings().items()},
            "left_out": tuple(e.name for e in model.own),
            "now": (
                float(time.max()) if time is not None else 0.0,
                float(temperature.mean()) if temperature is not None else 20.0,
                *(0.0 for _ in data.layout.joints),
            ),
            "values": fit.values[: len(model.indices)],
            "made_from": data.source,
            "rows": len(data),
        }

    def model(self, robot: Robot) -> ChainModel:
        """The model that was identified."""
        chosen = effects_by_name(catalogue_of(robot), self.effects)
        return kind_of(robot).model(robot, self.free, chosen, **self.settings)

    def to_table(self, of: Calibration) -> dict[str, Any]:
        """For TOML, without loss."""
        unit, now = of.unit, _now_names(of.robot)
        std = np.sqrt(np.diag(self.covariance).clip(0.0))
        return {
            "made_from": self.made_from,
            "rows": self.rows,
            "effects": list(self.effects),
            "left_out": list(self.left_out),
            **({"settings": dict(self.settings)} if self.settings else {}),
            "now": dict(zip(now, self.now, strict=True)),
            "parameters": [
                {"name": p.name, "value": float(v), "std": float(s), "unit": p.unit}
                for p, v, s in zip(self.model(of.robot).parameters, self.values, std, strict=True)
            ],
            "covariance": self.covariance.tolist(),
            f"residual_covariance_{unit}2": self.residual_covariance.tolist(),
            **self._own_table(unit),
            f"low_{unit}": self.low.tolist(),
            f"high_{unit}": self.high.tolist(),
        }

    def _own_table(self, unit: str) -> dict[str, Any]:
        del unit
        return {}

    @classmethod
    def from_table(cls, table: Table, of: type[Calibration], robot: Robot) -> Self:
        """Back from :meth:`to_table`. Raises :class:`~sherkit.errors.CalibrationError` with the key."""
        size, unit = len(of.coordinates), of.unit
        names, values = [], []
        for p in table.tables("parameters", optional=False):
            names.append(p.words("name"))
            values.append(p.number("value"))
            p.pass_over("std", "unit")  # they follow from covariance and model
        settings = {}
        known = model_of(robot).settings()
        if known:
            with table.table("settings") as s:
                settings = {name: s.number(name) for name in known}
        with table.table("now") as n:
            now = tuple(n.number(name) for name in _now_names(robot))
        low, high = table.array(f"low_{unit}", size), table.array(f"high_{unit}", size)
        if (low > high).any():
            raise table.fail(f"low_{unit}", f"nothing above high_{unit}")
        made = cls(
            free=tuple(name for name in names if "." not in name),
            effects=table.texts("effects"),
            settings=settings,
            left_out=table.texts("left_out"),
            now=now,
            values=np.array(values, dtype=float),
            covariance=table.covariance("covariance", len(values)),
            residual_covariance=table.covariance(f"residual_covariance_{unit}2", size),
            low=low,
            high=high,
            made_from=table.words("made_from", empty=True),
            rows=table.whole("rows", least=0),
            **cls._own_fields(table, unit, size),
        )
        expected = [p.name for p in made.model(robot).parameters]
        if names != expected:
            wrong = next((f for f, e in zip(names, expected, strict=False) if f != e), "a missing one")
            raise table.refuse(f"parameters: expected {listed(expected, 30)}; '{wrong}' does not belong there")
        return made

    @classmethod
    def _own_fields(cls, table: Table, unit: str, size: int) -> dict[str, Any]:
        del table, unit, size
        return {}


@dataclass(frozen=True, eq=False)
class Calibration(Shown, ABC):
    """A calibrated robot: ``whole`` is what was identified over its workspace.

    Coordinates are those of :attr:`coordinates`, joint readings those of the robot. Covariates of the control loop
    (``temperature_c``, and ``direction``: the sign of the last motion of each joint) matter only where the model holds
    an effect that needs them; left out, :attr:`Part.now` stands for them.
    """

    #: What :meth:`forward` gives, with units.
    coordinates: ClassVar[tuple[str, ...]]
    #: What one and many of them are called in messages.
    called: ClassVar[tuple[str, str]]
    #: How its parts are read from files, and which there may be; the first one must be.
    part: ClassVar[type[Part]] = Part
    parts: ClassVar[tuple[str, ...]] = ("whole",)
    unit: ClassVar[str]

    robot: Robot
    whole: Part

    def __init_subclass__(cls, **others: Any) -> None:
        super().__init_subclass__(**others)
        cls.unit = cls.coordinates[0].rpartition("_")[2]

    def __post_init__(self) -> None:
        _ = self.core  # refuses numbers that do not fit together

    # -- what a kind of robot says -------------------------------------------------------------------------

    @property
    @abstractmethod
    def core(self) -> Any:
        """The compiled model: the same code that a control loop runs."""

    @abstractmethod
    def spread(self, coordinates: Floats, joints: Floats) -> Floats:
        """Covariance (n, d, d) of where the robot really is when sent to ``coordinates`` (n, k) by ``joints`` (n, j).

        Parameter covariance carried there, plus that of held-out residuals. In units of which one makes
        :attr:`reach_mm` at the tool.
        """

    @abstractmethod
    def places(self) -> list[tuple[str, Floats]]:
        """Coordinates (k,) for which a person would ask how accurate the robot is, with their names."""

    @abstractmethod
    def planes(self, per_side: int) -> Planes:
        """Planes of the workspace, or of what was measured, with ``per_side`` points along each side."""

    @property
    def reach_mm(self) -> float:
        """How far one unit of the coordinates moves the tool, mm."""
        return 1.0

    def notes(self) -> Sequence[Note]:
        """What else there is to know about what is deployed."""
        return ()

    @classmethod
    def require(cls, robot: Robot) -> None:
        """Raises :class:`~sherkit.errors.CalibrationError` where robots of this kind have no calibration."""
        if cls is Calibration:
            raise CalibrationError(
                f"a {robot.kind} robot has no calibration that could be deployed: its kind brings none"
            )

    @classmethod
    def of(cls, whole: CalibrationRun, local: CalibrationRun | None = None) -> Self:
        """From a run over the workspace and, if given, one inside the region of interest."""
        raise NotImplementedError(f"{cls.__name__} is made from no run")

    @classmethod
    def require_region(cls, robot: Robot) -> None:
        """Raises :class:`~sherkit.errors.FitError` where a robot has no region of interest for a local run."""
        raise FitError(f"a {robot.kind} robot has no region of interest and no local run; join the runs instead")

    @classmethod
    def in_region(cls, fit: Fit) -> Bools | None:
        """Rows of a fit inside the region of interest (n,); None without a region."""
        del fit
        return None

    @classmethod
    def require_correction(cls, robot: Robot) -> None:
        """Raises :class:`~sherkit.errors.FitError` where robots of this kind have no correction that could be named."""
        raise FitError(f"a {robot.kind} robot has no correction of a paper; choose the correction auto or none")

    @classmethod
    def may_correct(cls, fit: Fit) -> bool:
        """Whether this kind of robot has a correction, and a run enough rows for one."""
        del fit
        return False

    @classmethod
    def correct(cls, fit: Fit, way: str = "auto", seed: int = 0) -> Corrected | None:
        """A smooth correction of what a fit leaves: ``auto`` chooses it, ``paper`` takes that of the robot's paper."""
        del fit, way, seed
        return None

    @classmethod
    def about(cls, fit: Fit) -> Sequence[Note]:
        """What a fit says about a robot of this kind beyond its parameters."""
        del fit
        return ()

    # -- where it is and how to bring it there -------------------------------------------------------------

    def forward(
        self, joints: ArrayLike, *, temperature_c: float | None = None, direction: ArrayLike | None = None
    ) -> Floats:
        """Coordinates (k,) for joint readings (j,). Raises :class:`~sherkit.errors.OutOfReach` with what is wrong."""
        return self._one(joints, temperature_c, direction)[0]

    def jacobian(
        self, joints: ArrayLike, *, temperature_c: float | None = None, direction: ArrayLike | None = None
    ) -> Floats:
        """d coordinates / d joints (k, j) of the whole corrected model. Arguments and errors as :meth:`forward`."""
        return self._one(joints, temperature_c, direction)[1]

    def inverse(
        self, coordinates: ArrayLike, *, temperature_c: float | None = None, direction: ArrayLike | None = None
    ) -> Floats:
        """Joint readings (j,) at which the corrected model gives ``coordinates`` (k,), to 1e-6 mm or 1e-12 rad.

        Arguments as :meth:`forward`. Raises :class:`~sherkit.errors.OutOfReach`, or ``NotConverged`` where a
        correction folds over.
        """
        made: Floats = self.core.inverse(self._place(coordinates), self._now(temperature_c, direction))
        return made

    def forward_batch(self, joints: ArrayLike) -> Batch:
        """Coordinates (n, k) for joint readings (n, j); rows out of reach are marked."""
        values, _, reached = self._rows(joints)
        return Batch(values, reached)

    def jacobian_batch(self, joints: ArrayLike) -> Batch:
        """Jacobians (n, k, j) for joint readings (n, j); rows out of reach are marked."""
        _, values, reached = self._rows(joints)
        return Batch(values, reached)

    def inverse_batch(self, coordinates: ArrayLike) -> Batch:
        """Joint readings (n, j) for coordinates (n, k); rows out of reach are marked."""
        values, reached = self.core.inverse_batch(self._places(coordinates), self._now())
        return Batch(values, reached)

    def _one(
        self, joints: ArrayLike, temperature_c: float | None, direction: ArrayLike | None
    ) -> tuple[Floats, Floats]:
        q = vector(joints, "joint readings", self._joints)
        made: tuple[Floats, Floats] = self.core.forward(q, self._now(temperature_c, direction))
        return made

    def _rows(self, joints: ArrayLike) -> tuple[Floats, Floats, Bools]:
        """Coordinates, Jacobians, and which rows are within reach."""
        q = matrix(joints, "joint readings", self._joints)
        made: tuple[Floats, Floats, Bools] = self.core.forward_batch(q, self._now())
        return made

    def _now(self, temperature_c: float | None = None, direction: ArrayLike | None = None) -> list[float]:
        """Covariates for the core: those given, else those that stand in for them."""
        now = list(self.whole.now)
        if temperature_c is not None:
            now[1] = float(temperature_c)
        if direction is not None:
            now[2:] = [float(d) for d in vector(direction, "direction", self._joints)]
        return now

    @property
    def _joints(self) -> int:
        return len(self.whole.now) - 2

    def _place(self, coordinates: ArrayLike) -> Floats:
        return vector(coordinates, self.called[0], len(self.coordinates))

    def _places(self, coordinates: ArrayLike) -> Floats:
        return matrix(coordinates, self.called[1], len(self.coordinates))

    # -- accuracy ----------------------------------------------------------------------------------------

    def accuracy(self, coordinates: ArrayLike) -> float:
        """Radius, mm, within which the robot is predicted to be of ``coordinates`` (k,) in 95 of 100 cases.

        Parameter covariance carried to the place, plus the covariance of held-out residuals (noise and what the model
        leaves). Where no pose was measured (:meth:`measured`) this is extrapolation and holds only as far as the model
        does. The radius of a Gaussian by matching two moments of its squared length (Satterthwaite). Raises as
        :meth:`inverse`.
        """
        x = self._place(coordinates)
        self.inverse(x)  # says why where it cannot be reached
        return float(self.accuracy_batch(x[None, :]).require(self.called[0])[0])

    def accuracy_batch(self, coordinates: ArrayLike) -> Batch:
        """:meth:`accuracy` at every one of ``coordinates`` (n, k): values (n,), mm; those out of reach are marked."""
        x = self._places(coordinates)
        joints = self.inverse_batch(x)
        out = np.full(len(x), np.nan)
        rows = np.flatnonzero(joints.reached)
        out[rows] = self.reach_mm * radius_95(self.spread(x[rows], np.ascontiguousarray(joints.values[rows])))
        return Batch(out, joints.reached, joints.why)

    def measured(self, coordinates: ArrayLike) -> bool:
        """Whether ``coordinates`` (k,) lie in the box in which poses were measured, give or take a tenth."""
        x = self._place(coordinates)
        part = self.part_at(x)
        margin = 0.1 * (part.high - part.low)
        return bool(((x >= part.low - margin) & (x <= part.high + margin)).all())

    def part_at(self, coordinates: Floats) -> Part:
        """The part that rules at ``coordinates`` (k,)."""
        del coordinates
        return self.whole

    # -- files -------------------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Writes TOML that :meth:`load` reads back without loss."""
        parts = {name: getattr(self, name) for name in self.parts}
        tables = {
            "calibration": {"format": FORMAT, "made_by": f"sherkit {_core.__version__}", **self._settings()},
            "robot": self.robot.to_tables(),
            **{name: part.to_table(self) for name, part in parts.items() if part is not None},
        }
        Path(path).write_text(tomli_w.dumps(tables), encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Reads what :meth:`save` wrote; of any kind of robot, unless asked of the class of one.

        Raises :class:`~sherkit.errors.CalibrationError` naming file and key.
        """
        path = Path(path)
        known: dict[str, type[Self]] = {name: k.calibration for name, k in KINDS.items() if k.calibration is not None}
        own = next((name for name, made in known.items() if made is cls), None)
        tables = tables_of(path, own)
        if own is None:
            robot = tables.get("robot")
            found = robot.get("kind") if isinstance(robot, dict) else None
            if found not in known:
                raise CalibrationError(f"{path}: [robot] kind: expected one of {listed(known)}, found {found!r}")
            return known[found].load(path)
        table = Table(tables, str(path), error=CalibrationError)
        try:
            with table.table("calibration") as c:
                c.pass_over("format", "made_by")
                settings = cls._settings_from(c)
            with table.table("robot") as r:
                nominal = robot_from_table(r)
            parts = {}
            for name in cls.parts:
                if name == cls.parts[0] or table.has(name):
                    with table.table(name) as one:
                        parts[name] = cls.part.from_table(one, cls, nominal)
            table.finish()
            return cls(robot=nominal, **parts, **settings)
        except (TypeError, ValueError, OverflowError, SherkitError) as error:
            said = str(error)
            raise CalibrationError(said if said.startswith(f"{path}: ") else f"{path}: {said}") from None

    def _settings(self) -> dict[str, Any]:
        """What a kind keeps in [calibration] besides the format."""
        return {}

    @classmethod
    def _settings_from(cls, table: Table) -> dict[str, Any]:
        del table
        return {}

    def __repr__(self) -> str:
        effects = f", {', '.join(self.whole.effects)}" if self.whole.effects else ""
        return f"{type(self).__name__}({self.whole.rows} rows of {self.whole.made_from}{effects})"


def calibration_class(robot: Robot) -> type[Calibration]:
    """The class of a robot's calibrations; the base, which cannot be made, where its kind brings none."""
    made: type[Calibration] = kind_of(robot).calibration or Calibration
    return made


def _now_names(robot: Robot) -> tuple[str, ...]:
    return ("time_s", "temperature_c", *kind_of(robot).layout.directions)
