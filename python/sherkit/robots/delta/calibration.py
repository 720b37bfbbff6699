"""The calibrated delta: where its measured point is, how to bring it there, and how well.

The whole-workspace model holds everywhere; a local one, where there is one, replaces it inside the region of
interest, blended over a margin so that a commanded position never jumps (the paper switches at the border).
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, ClassVar, Self, cast

import numpy as np

import sherkit._core as _core

from ...base.types import Bools, Floats, Ints
from ...data.declared import Key, key
from ...data.in_time import DRAWN_C
from ...data.toml import Table
from ...errors import CalibrationError, FitError
from ...fit.identify import Fit
from ...model.kinds import Robot
from ..accuracy import Planes
from ..calibrated import Calibration, Note
from ..calibration_run import CalibrationRun, Cells, Corrected
from ..deployed import BASE, SENSOR
from ..identified_model import IdentifiedModel
from .correction import Choice, Correction, choose_correction, enough_rows, leftover
from .paper import PaperProtocol, paper_protocol
from .robot import POSITION, Delta

# -- The correction -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class DeltaCorrected(Corrected):
    """A correction and how it was chosen; ``seed`` rules the split of the paper's protocol."""

    fit: Fit
    choice: Choice
    seed: int

    @cached_property
    def paper(self) -> PaperProtocol | None:
        """The paper's protocol on the same run, to stand beside; None where the run has no plane at the middle."""
        with suppress(FitError):
            return paper_protocol(self.fit, seed=self.seed)
        return None

    @property
    def rows(self) -> Ints:
        """Rows with a full position that are no outliers."""
        return leftover(self.fit).rows

    @property
    def held_out(self) -> Floats:
        """What the chosen orders leave of blocks that they did not see (k, 3), mm."""
        return self.choice.held_out_mm

    @property
    def chosen(self) -> bool:
        """Whether a polynomial helps."""
        return self.choice.correction is not None

    def __str__(self) -> str:
        chosen = self.choice.correction
        text = "none helps on held-out blocks" if chosen is None else f"order {chosen.orders} in (x, y, z)"
        return f"Bernstein correction by blocked cross-validation: {text}"

    def to_json(self) -> dict[str, Any]:
        """Orders of the correction, and those of the paper's protocol with their errors."""
        chosen, paper = self.choice.correction, self.paper
        return {
            "correction": None if chosen is None else {"orders": list(chosen.orders)},
            "paper_protocol": paper and {
                "orders": paper.orders, "test_um": paper.test_um,
                "other_planes_um": {f"{z:g}": v for z, v in paper.other_planes_um.items()},
            },
        }  # fmt: skip

    def cells(self) -> Cells | None:
        """Table III: order, error on the test part and on the other planes, by the paper's protocol."""
        p = self.paper
        if p is None:
            return None
        planes = sorted(p.other_planes_um, reverse=True)
        errors = [(p.test_um, p.test_std_um), *((p.other_planes_um[z], p.other_planes_std_um[z]) for z in planes)]
        lines = ((a, str(p.orders[a]), *(f"{rms[a]:.1f} ± {std[a]:.1f}" for rms, std in errors)) for a in "xyz")
        return Cells(("order", f"test, z = {round(p.plane_mm)}", *(f"z = {round(z)}" for z in planes)), tuple(lines))


# -- The calibration ----------------------------------------------------------------------------------------------

#: Width of the blend around the region of interest, as a part of its half width.
_BLEND = 0.25
#: Poses on the border of the region count as inside, as the paper counts them, though readings miss it a little.
_ON_BORDER = 1.02


@dataclass(frozen=True, eq=False)
class DeltaPart(IdentifiedModel):
    """One identified model of a delta: its residuals, mm², are those about the corrected model.

    ``uncorrected_covariance`` (3, 3) are those about the geometric one, where the correction has faded. The sensors saw
    a point x of the base frame at ``sensor_turn`` x + ``sensor_origin_mm``; the correction is one of the base frame.
    """

    uncorrected_covariance: Floats
    correction: Correction | None
    sensor_turn: Floats
    sensor_origin_mm: Floats

    def at_base(self, positions_mm: Floats) -> Floats:
        """Positions (n, 3) as the sensors see them, mm, in the frame of the base."""
        made: Floats = (positions_mm - self.sensor_origin_mm) @ self.sensor_turn
        return made

    def at_sensor(self, places_mm: Floats) -> Floats:
        """Places (n, 3) of the base frame, mm, as the sensors see them."""
        made: Floats = places_mm @ self.sensor_turn.T + self.sensor_origin_mm
        return made

    @classmethod
    def of(cls, run: CalibrationRun) -> DeltaPart:
        """The part that a run gives: its fit, its correction, its held-out residuals with the correction and without.

        Where no row holds a full position, heights or distances alone say how far off it is: the same on every axis.
        """
        fit = run.fit
        full = fit.data.taken[:, :3].all(axis=1) & ~fit.data.outlier
        if full.any():
            back = run.deployed(np.zeros_like(run.held_out))
            with_it, without = run.corrected + back, run.held_out + back
            corrected = run.correction is not None and run.correction.chosen
            before, scatter = run.left(lambda missed: missed[full, :3], without)
            left = run.left(lambda missed: missed[full, :3], with_it, corrected=True)[0] if corrected else before
        else:
            with_it = without = run.held_out
            before, scatter = run.left_alike(np.isfinite(without) & fit.data.used, without)
            left = before
        # the fit took all misfit for noise; what the correction has removed of it is none
        shrink = min(1.0, float(np.nansum(with_it**2) / max(np.nansum(without**2), 1e-300)))
        where = fit.predicted[~fit.data.is_distance & ~fit.data.outlier, :3]
        found = cast(DeltaCorrected | None, run.correction)
        correction = found.choice.correction if found is not None else None
        turn, origin = fit.model.sensor_frame(fit.values, slipped=True)
        made = cls.identified(
            fit, 3, shrink=shrink, uncorrected_covariance=before, correction=correction, sensor_turn=turn,
            sensor_origin_mm=origin,
        )  # fmt: skip
        return made.leaving(left, scatter, where)

    def functions(self, coordinates: Floats) -> Floats:
        """Those of the polynomial."""
        if self.correction is None:
            return np.zeros((len(coordinates), 0))
        return self.correction.functions(self.at_base(coordinates))

    @classmethod
    def own_keys(cls, unit: str, size: int) -> dict[str, Key]:
        """Where the correction has faded, and how the sensors see the base."""
        return {
            f"uncorrected_covariance_{unit}2": key(Table.covariance, size).of("uncorrected_covariance"),
            "sensor_turn": key(Table.array, 3, 3),
            "sensor_origin_mm": key(Table.array, 3),
        }

    def _own_tables(self) -> dict[str, Any]:
        return {} if self.correction is None else {"correction": self.correction.to_table()}

    @classmethod
    def _own_from(cls, table: Table) -> dict[str, Any]:
        turn = table.array("sensor_turn", 3, 3)
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0:
            raise table.fail("sensor_turn", "a rotation (3 x 3)")
        if not table.has("correction"):
            return {"correction": None}
        with table.table("correction") as c:
            return {"correction": Correction.from_table(c)}


@dataclass(frozen=True, eq=False, repr=False)
class DeltaCalibration(Calibration):
    """A calibrated delta. Positions, mm, are those of the measured point as the sensors read it, where they stood at
    last, unless the frame of the base is asked for, where the robot is without their errors: readings alone leave a
    shift of the base open, a tilt common to all rails and its turn, so that what is promised of a delta is promised
    where it was seen. The region of interest is the base's."""

    frame: ClassVar = SENSOR
    coordinates: ClassVar = POSITION
    called: ClassVar = ("position", "positions")
    part: ClassVar = DeltaPart
    parts: ClassVar = ("whole", "local")

    robot: Delta
    whole: DeltaPart
    local: DeltaPart | None = None
    region_half_width_mm: float | None = None
    blend_mm: float | None = None

    def __post_init__(self) -> None:
        if (self.local is None) != (self.region_half_width_mm is None):
            raise CalibrationError("a local model needs the half width of its region, and the reverse")
        for name in ("region_half_width_mm", "blend_mm"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise CalibrationError(f"{name}: expected a positive number, got {value}")
        super().__post_init__()

    # -- from a run ----------------------------------------------------------------------------------------

    @classmethod
    def of(cls, whole: CalibrationRun, local: CalibrationRun | None = None) -> Self:
        """From a run over the workspace and, if given, one inside the region of interest. A pitch that was found stands
        in the robot."""
        model = whole.fit.model
        robot: Delta = model.robot
        if any(e.is_periodic for e in model.effects) and isinstance(model.period_mm, float):
            robot = replace(robot, pole_pitch_mm=model.period_mm)
        return cls(
            robot=robot,
            whole=DeltaPart.of(whole),
            local=DeltaPart.of(local) if local else None,
            region_half_width_mm=robot.region_half_width_mm if local else None,
        )

    @classmethod
    def require_region(cls, robot: Robot) -> None:
        """A local run needs a region of interest in the robot file."""
        if cast(Delta, robot).region_half_width_mm is None:
            raise FitError("a local run needs [region_of_interest] half_width_mm in the robot file")

    @classmethod
    def in_region(cls, fit: Fit) -> Bools | None:
        """Rows inside the region of interest in x and y (n,), as the paper counts them; None without a region."""
        half = fit.model.robot.region_half_width_mm
        if half is None:
            return None
        turn, origin_mm = fit.model.sensor_frame(fit.values)
        where = ((fit.predicted[:, :3] - origin_mm) @ turn)[:, :2]
        inside: Bools = (np.abs(where) <= half * _ON_BORDER).all(axis=1) & ~fit.data.is_distance
        return inside

    @classmethod
    def require_correction(cls, robot: Robot) -> None:
        """The paper's is a Bernstein polynomial."""

    @classmethod
    def may_correct(cls, fit: Fit) -> bool:
        """Whether enough rows hold a full position."""
        return enough_rows(fit)

    @classmethod
    def correct(cls, fit: Fit, way: str = "auto", seed: int = 0) -> DeltaCorrected:
        """A Bernstein polynomial: ``auto`` by blocked cross-validation, ``paper`` with the order that the paper's
        protocol finds on the middle plane, in x and y alone, fitted to all planes. Raises
        :class:`~sherkit.errors.FitError` where the rows do not determine one."""
        if way == "paper":
            n = max(paper_protocol(fit, seed=seed).orders.values())
            choice = choose_correction(fit, orders=(n,), heights=1, seed=seed, keep_none=False)
        else:
            choice = choose_correction(fit, seed=seed)
        return DeltaCorrected(fit, choice, seed)

    # -- the model ---------------------------------------------------------------------------------------

    def corrects(self, joints: Floats) -> Floats | None:
        """What the correction and the model of the region of interest add, (n, 3) mm."""
        if self.local is None and self.whole.correction is None:
            return None
        plain = replace(self, local=None, region_half_width_mm=None, whole=replace(self.whole, correction=None))
        with_it, without = (one.forward_batch(joints, frame=SENSOR) for one in (self, plain))
        return np.where((with_it.reached & without.reached)[:, None], with_it.values - without.values, 0.0)

    def _core_part(self, part: DeltaPart) -> tuple[_core.DeltaModel, Floats, _core.Bernstein | None]:
        model = part.model(self.robot)
        return model.core, model.full(part.values), part.correction.core if part.correction else None

    def _made_in(self, frame: str) -> _core.Calibrated:
        local = region = None
        if self.local is not None and self.region_half_width_mm is not None:
            local = self._core_part(self.local)
            half = float(self.region_half_width_mm)
            blend = self.blend_mm if self.blend_mm is not None else _BLEND * half
            region = (np.full(3, -half), np.full(3, half), blend)
        return _core.Calibrated(self._core_part(self.whole), local, region, BASE if frame == BASE else SENSOR)

    @property
    def frames(self) -> tuple[str, ...]:
        """That of the instrument, and that of the base."""
        return (SENSOR, BASE)

    @cached_property
    def sensor_frame(self) -> tuple[Floats, Floats]:
        """From the base to the sensors as identified: the turn (3, 3) and the shift (3,), mm."""
        return self.whole.sensor_turn, self.whole.sensor_origin_mm

    # -- accuracy ----------------------------------------------------------------------------------------

    def by_values(self, part: IdentifiedModel, joints: Floats, now: list[float]) -> Floats:
        """Of positions (n, 3, p)."""
        model = part.model(self.robot)
        # a commanded position is reached at rest
        known = np.tile([*now, 0.0, 0.0, 0.0, DRAWN_C], (len(joints), 1))
        block = (np.ascontiguousarray(joints), None, known, None)
        made: Floats = model.core.derivatives(model.full(part.values), block, model.indices)[0][:, :3]
        return made

    def left_at(self, part: IdentifiedModel, coordinates: Floats) -> Floats:
        """Covariance (n, 3, 3), mm²; without the correction as far as it has faded. What the run of the region shows
        to be left does not end at its border: where that is more, it fades over as much as the region reaches."""
        own = cast(DeltaPart, part)
        left = np.array(super().left_at(part, coordinates))
        if own.correction is not None:
            share = np.array([own.correction.share(at) for at in own.at_base(coordinates)])[:, None, None]
            left = share * own.residual_covariance + (1.0 - share) * own.uncorrected_covariance
        if self.local is not None and self.region_half_width_mm is not None and part is not self.local:
            outside = (np.abs(own.at_base(coordinates)) - self.region_half_width_mm).max(axis=1)
            near = (1.0 - outside / self.region_half_width_mm).clip(0.0, 1.0)[:, None, None]
            more = np.trace(self.local.residual_covariance) > np.trace(left, axis1=1, axis2=2)
            left = np.where(more[:, None, None], near * self.local.residual_covariance + (1.0 - near) * left, left)
        return np.asarray(left)

    def part_at(self, coordinates: Floats) -> DeltaPart:
        """The local part inside the region of interest, where there is one, else the whole one."""
        inside = self.region_half_width_mm is not None and bool(
            (np.abs(self.whole.at_base(coordinates)) <= self.region_half_width_mm).all()
        )
        return self.local if inside and self.local is not None else self.whole

    def places(self) -> list[tuple[str, Floats]]:
        """As the sensors see them: the centre, the corner of the region of interest, the rim of the workspace:
        positions (3,), mm."""
        robot = self.robot
        out = [("centre", np.zeros(3))]
        if robot.region_half_width_mm:
            out.append(("corner of the region of interest", np.full(3, float(robot.region_half_width_mm))))
        if robot.workspace_radius_mm and robot.workspace_z_mm:
            rim = np.array([robot.workspace_radius_mm, 0.0, robot.workspace_z_mm[1]])
            out.append(("rim of the workspace", rim))
        return [(name, self.whole.at_sensor(place)) for name, place in out]

    def planes(self, per_side: int) -> Planes:
        """The highest, middle and lowest plane of the workspace, or of what was measured."""
        robot = self.robot
        corners = np.array(list(product(*zip(self.whole.low, self.whole.high, strict=True))))
        low, high = robot.workspace_box(self.whole.at_base(corners))
        made = Planes.horizontal(low, high, per_side, ".3g")
        from_axis = np.hypot(made.grid[:, 0], made.grid[:, 1])
        made = replace(made, grid=np.ascontiguousarray(self.whole.at_sensor(made.grid)))
        if not robot.workspace_radius_mm:
            return made
        return replace(made, inside=from_axis <= robot.workspace_radius_mm - 0.25 * (made.x[1] - made.x[0]))

    def border_jump_mm(self) -> float | None:
        """Largest difference of local and whole model on the border of the region; None without a local model.

        The blend spreads this difference over its width. A large value says that the two runs had different
        references.
        """
        if self.local is None or self.region_half_width_mm is None:
            return None
        ticks = np.linspace(-1.0, 1.0, 5) * self.region_half_width_mm
        cube = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
        border = self.whole.at_sensor(cube[np.isclose(np.abs(cube).max(axis=1), self.region_half_width_mm)])
        whole = DeltaCalibration(self.robot, self.whole)
        local = DeltaCalibration(self.robot, self.local)
        joints = whole.inverse_batch(border)
        there = local.forward_batch(joints.values[joints.reached]).require()
        return float(np.linalg.norm(there - border[joints.reached], axis=1).max())

    def notes(self) -> Sequence[Note]:
        """How far local and whole model are apart on the border of the region."""
        jump = self.border_jump_mm()
        if jump is None:
            return ()
        said = f"local and whole model differ by at most {1e3 * jump:.1f} µm on the region's border; blended there"
        return (Note("", said, {"border_jump_um": 1e3 * jump}),)

    # -- files -------------------------------------------------------------------------------------------

    def _settings(self) -> dict[str, Any]:
        values = {"region_half_width_mm": self.region_half_width_mm, "blend_mm": self.blend_mm}
        return {name: value for name, value in values.items() if value is not None}

    @classmethod
    def _settings_from(cls, table: Table) -> dict[str, Any]:
        return {name: table.positive(name) for name in ("region_half_width_mm", "blend_mm")}

    def __repr__(self) -> str:
        parts = f"whole from {self.whole.rows} rows"
        if self.local is not None:
            parts += f", local from {self.local.rows} rows within ±{self.region_half_width_mm:g} mm"
        return f"DeltaCalibration({parts})"
