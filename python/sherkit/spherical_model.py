"""The spherical robot as a model for identification: geometry, datum, camera and effects, on pixels or on angles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from . import _core
from .chain import ChainModel
from .effects.spherical import SPHERICAL_CATALOGUE
from .errors import SherkitError
from .measurements import Measurements
from .measurements.columns import SPHERICAL_ANGLES, SPHERICAL_PIXELS, TEMPERATURE
from .parameters import Parameter
from .robots.spherical import CameraView, Spherical

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Block = tuple[Floats, Bools | None, Floats | None, Floats | None]

#: The core's parameters are geometry, datum, principal point and effects in the order of its chain.
_CHAIN = (
    "camera_pose", "focal_length", "principal_point", "lens_distortion", "joint_offset", "joint_scale",
    "encoder_eccentricity", "backlash", "unequal_limbs", "axis_offset", "gravity_flexure", "marker_offset",
    "camera_delay",
)  # fmt: skip
#: Poses along φ and γ from which the next ones are chosen.
_GRID = (15, 11)
#: A robot without a camera reads angles; the core wants one all the same.
_ANY_CAMERA = CameraView((2, 2), (1.0, 1.0), (0.0, 0.0), translation_mm=(0.0, 0.0, 1e6))


@dataclass(frozen=True)
class SphericalModel(ChainModel):
    """A nominal spherical robot with named errors and effects to identify.

    ``free`` names geometric errors and datum: by default ``alpha``, ``beta`` and ``radius``, as in the paper; besides
    these ``datum_phi``, ``datum_gamma`` (where angles are read), ``principal_point_u`` and ``principal_point_v`` (where
    pixels are). What else of the camera is free are effects: ``camera_pose``, ``focal_length``, ``lens_distortion``.
    Readings have two columns: u, v in pixels, or φ, γ in rad. The radius shows in pixels alone, and α and β in γ alone.
    """

    robot: Spherical

    catalogue: ClassVar = SPHERICAL_CATALOGUE
    layouts: ClassVar = (SPHERICAL_PIXELS, SPHERICAL_ANGLES)
    core_order: ClassVar = tuple(SPHERICAL_CATALOGUE[name] for name in _CHAIN if name != "principal_point")

    @cached_property
    def base(self) -> tuple[Parameter, ...]:
        """Geometric errors, datum and principal point."""
        lever = self.robot.radius_mm
        return (
            Parameter("alpha", "δα", "rad", 0.02, lever),
            Parameter("beta", "δβ", "rad", 0.02, lever),
            Parameter("radius", "δR", "mm", 20.0),
            Parameter("datum_phi", "d_φ", "rad", 0.02, lever),
            Parameter("datum_gamma", "d_γ", "rad", 0.02, lever),
            Parameter("principal_point_u", "δc_u", "px", 10.0),
            Parameter("principal_point_v", "δc_v", "px", 10.0),
        )

    @property
    def default(self) -> tuple[str, ...]:
        """The paper's three."""
        return ("alpha", "beta", "radius")

    @cached_property
    def core_parameters(self) -> tuple[Parameter, ...]:
        """Every parameter of the compiled chain, in its order."""
        base = {p.name: p for p in self.base}
        out = [p for p in self.base if not p.name.startswith("principal_point")]
        for name in _CHAIN:
            if name == "principal_point":
                out += [base["principal_point_u"], base["principal_point_v"]]
            else:
                out += self.catalogue[name].qualified()
        return tuple(out)

    def settings(self) -> dict[str, float | None]:
        """There are none."""
        return {}

    @cached_property
    def chain(self) -> _core.SphericalModel:
        """The compiled model, whose readings have four columns: u, v, φ, γ."""
        r = self.robot
        pull = np.array(r.gravity) / np.linalg.norm(r.gravity)
        settings = np.array([r.radius_mm, *pull, *np.deg2rad(r.home_deg)])
        camera = (r.camera or _ANY_CAMERA).parameters
        return _core.SphericalModel(r.geometry, camera, settings, r.assembly_mode)

    @cached_property
    def core(self) -> _TwoColumns:
        """The compiled model for runs that hold pixels or angles throughout."""
        return _TwoColumns(self.chain)

    def block(self, data: Measurements, joints: Floats | None = None, push: Floats | None = None) -> Block:
        """The rows as the core takes them. Raises :class:`~sherkit.errors.SherkitError` for pixels without a camera."""
        self.require_own(data)
        angles = data.layout == SPHERICAL_ANGLES
        if not angles:
            _ = self.robot.seen
        covariates = None
        if self.built_in:
            empty = np.full(len(data), np.nan)
            time = empty if data.time_s is None else data.time_s
            known = data.covariates
            columns = [time, known.get(TEMPERATURE, empty), data.direction]
            columns += [known.get(name, empty) for name in data.layout.velocities]
            covariates = np.ascontiguousarray(np.column_stack(columns))
        kind = np.ones(len(data), dtype=bool) if angles else None
        return (data.joints if joints is None else joints, kind, covariates, push)

    def reachable(self, data: Measurements, values: Floats) -> tuple[Floats, Measurements] | None:
        """A grid over the workspace (or where the run was) in φ and γ, with the rows it would give, as coordinates."""
        robot = self.robot
        seen = robot.forward_batch(data.joints)
        where = seen.values[seen.reached]
        if not len(where):
            return None
        limits = []
        for k, given in enumerate((robot.phi_deg, robot.gamma_deg)):
            low, high = (where[:, k].min(), where[:, k].max()) if given is None else np.deg2rad(given)
            limits.append(np.linspace(low, high, _GRID[k]))
        angles = np.stack(np.meshgrid(*limits, indexing="ij"), axis=-1).reshape(-1, 2)
        batch = robot.inverse_batch(angles)
        rows = data.unmeasured(batch.values[batch.reached])
        readings, reached = self.core.predict(self.full(values), self.block(rows))
        if robot.camera is not None and data.layout != SPHERICAL_ANGLES:
            size = np.array(robot.camera.size_px)
            reached = reached & ((readings >= 0) & (readings <= size - 1)).all(axis=1)
        rows = data.unmeasured(rows.joints[reached])
        return (readings[reached], rows) if len(rows) else None

    def reason(self, data: Measurements, row: int, values: Floats) -> str:
        """What of mechanism or camera fails there."""
        full = self.full(values)
        try:
            self.robot.kinematics({"alpha": full[0], "beta": full[1]}).forward(data.joints[row])
        except SherkitError as error:
            return str(error)
        single = data.select(np.array([row]))
        marker, reached = self.chain.markers(full, self.block(single))
        if not reached[0]:
            return "an effect that is at work needs a column that these rows lack, or the links cannot close"
        if self.robot.camera is not None and data.layout != SPHERICAL_ANGLES:
            try:
                self.robot.camera.core.project(marker[0])
            except SherkitError as error:
                return str(error)
        return "the camera does not see the marker there"

    # -- what this robot has beyond others ---------------------------------------------------------------

    def four(self, data: Measurements) -> Floats:
        """Readings (n, 4) as the compiled model has them: u, v, φ, γ; NaN where not taken."""
        return _four(np.where(data.taken, data.readings, np.nan), self.block(data))

    def joint_residuals(self, data: Measurements, values: Floats) -> Floats:
        """Measured joints minus the inverse kinematics of the readings (n, 2), rad (Eq. 6); NaN where it has none."""
        return self.chain.inverse_residuals(self.full(values), self.block(data), self.four(data), [])[0]

    def seen_angles(self, data: Measurements, values: Floats) -> Floats:
        """φ, γ (n, 2), rad, that the readings show: by ray and sphere for pixels, the datum taken out of angles."""
        full = dict(zip((p.name for p in self.core_parameters), self.full(values).tolist(), strict=True))
        if data.layout == SPHERICAL_ANGLES:
            return data.readings - [full["datum_phi"], full["datum_gamma"]]
        camera = self.camera_with(values)
        pixels = np.where(data.taken, data.readings, np.nan)
        return camera.angles_batch(np.ascontiguousarray(pixels), self.robot.radius_mm + full["radius"])[0]

    def camera_with(self, values: Floats) -> _core.Camera:
        """The camera with its identified errors."""
        return self.chain.camera(self.full(values))


class _TwoColumns:
    """The core's four reading columns narrowed to the two that a run holds."""

    def __init__(self, chain: _core.SphericalModel) -> None:
        self._chain = chain

    def predict(self, values: Floats, block: Block) -> tuple[Floats, Bools]:
        """Readings (n, 2) and which rows could be computed."""
        out, reached = self._chain.predict(values, block)
        return np.ascontiguousarray(out[:, _columns(block)]), reached

    def derivatives(self, values: Floats, block: Block, free: list[int]) -> tuple[Floats, Floats, Floats, Bools]:
        """By the parameters (n, 2, free), the joints (n, 2, 2) and the marker's place (n, 2, 3)."""
        *parts, reached = self._chain.derivatives(values, block, free)
        by_values, by_joints, by_body = (np.ascontiguousarray(part[:, _columns(block)]) for part in parts)
        return by_values, by_joints, by_body, reached

    def accumulate(
        self, solver: _core.Solver, values: Floats, free: list[int], block: Block, readings: Floats, weights: Floats
    ) -> list[int]:
        """Adds rows to the solver at its trial; returns those that cannot be computed there."""
        return self._chain.accumulate(solver, values, free, block, _four(readings, block), _four(weights, block))

    def solve(
        self, solver: _core.Solver, values: Floats, free: list[int], block: Block, readings: Floats, weights: Floats,
        priors: bool,
    ) -> tuple[str, list[int]]:  # fmt: skip
        """Iterates to the minimum."""
        return self._chain.solve(solver, values, free, block, _four(readings, block), _four(weights, block), priors)


def _columns(block: Block) -> slice:
    return slice(0, 2) if block[1] is None else slice(2, 4)


def _four(two: Floats, block: Block) -> Floats:
    out = np.zeros((len(two), 4))
    out[:, _columns(block)] = two
    return out
