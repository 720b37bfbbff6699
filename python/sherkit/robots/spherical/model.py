"""The spherical robot as a model for identification: geometry, datum, camera and effects, on pixels or on angles.

The table of the effects is `rust/core/src/spherical/effects.rs`; here are the sentences on them.

Beside it stands the paper's identification, from the residual of the inverse kinematics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import ClassVar, cast

import numpy as np

import sherkit._core as _core

from ...base.figures import listed
from ...base.types import Bools, Floats
from ...data import Measurements
from ...data.noise import noise_of
from ...errors import FitError, SherkitError
from ...fit.identify import Fit
from ...model.chain import SLACK, ChainModel
from ...model.effect import Effect, Parameter, Sentences, Setting
from ...model.kinds import model_of
from ...model.sensor_pose import POSE
from ...model.sentences import catalogue_of
from .robot import SPHERICAL_ANGLES, SPHERICAL_PIXELS, CameraView, Spherical

# -- Effects ------------------------------------------------------------------------------------------------------

_OWN = {
    "joint_offset": Sentences(
        physics="The zero of an encoder is not where the drawing has it: every reading of the joint is off by one "
        "angle.",
        residuals="The common part turns the whole picture about the actuated axis; the difference lifts the tool.",
        remedy="Drive each joint to its mechanical zero and set the encoder there.",
        sizes={"offset": "the zero of joint {k} is off by {size}"},
    ),
    "joint_scale": Sentences(
        physics="The ratio of gear or belt is not quite what the drawing says, so an encoder counts too many or too "
        "few radians.",
        residuals="Grows in proportion to the travel of one joint; zero at the home position.",
        remedy="Compare a full turn of each joint with its index mark; correct counts per turn.",
        sizes={"scale": "joint {k} counts {size} too much/little"},
    ),
    "unequal_limbs": Sentences(
        physics="The two limbs are not alike: the arcs of limb 1 are longer than the common ones by the value, those "
        "of limb 2 shorter by as much, so the limbs differ by twice the value.",
        residuals="The tool leans to one side, more where it points away from the actuated axis.",
        remedy="Measure the arcs of both limbs on one fixture and match them.",
    ),
    "axis_offset": Sentences(
        physics="The axis between the links of a limb misses the centre, so the remote centre of motion wanders as the "
        "robot moves.",
        residuals="Millimetres that turn with the joints, whatever the radius.",
        remedy="Shim the bearings of the elbows until their axes meet; this is what makes the robot safe.",
        sizes={
            "across": "the elbow of limb {k} misses the centre by {size} across its axis",
            "along": "the elbow of limb {k} misses the centre by {size} along its axis",
        },
    ),
    "gravity_flexure": Sentences(
        physics="The distal links bend under the weight of the tool; the value is the bend under all of its moment.",
        residuals="Droop that grows with the horizontal lever arm of the tool.",
        remedy="Stiffen the distal links, or balance the tool.",
        sizes={"bend": "limb {k} bends by {size}"},
    ),
    "marker_offset": Sentences(
        physics="The marker is not on the tool axis: it sits beside it, and turns with the distal link.",
        residuals="A shift that turns with the tool.",
        remedy="Move the marker onto the axis, or measure where it is.",
    ),
    "thermal_growth": Sentences(
        physics="Everything expands with temperature, so the marker moves away from the remote centre.",
        residuals="A growth of the radius in proportion to the deviation of temperature from 20 °C; none in angles.",
        remedy="Warm up before measuring; hold the temperature; use Invar.",
    ),
}

#: The effects by name, in the order of the chain.
SPHERICAL_CATALOGUE: dict[str, Effect] = catalogue_of(_core.SphericalModel.CATALOGUE, _OWN)


# -- The model ----------------------------------------------------------------------------------------------------

_DATUM = ("datum_phi", "datum_gamma")
#: A calibration of a lens leaves its centre open by about a pixel.
_CENTRE = Effect(
    name="principal_point", link="sensor", frees=True,
    parameters=tuple(Parameter(f"principal_point_{axis}", f"δc_{axis}", "px", 1.0) for axis in "uv"),
    physics="The centre of the lens lies elsewhere in the picture than centre_px says.",
    remedy="Calibrate the lens with the board in all corners of the picture, or free principal_point_u and _v.",
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
    pixels are). Where pixels are read, so is the pose of the camera (``sensor_turn_x`` …, ``sensor_shift_x`` …), which
    is known to a millimetre and a tenth of a degree unless the robot's file says otherwise under ``[sensor_pose]``.
    ``period_rad`` is that of the encoders' cyclic error, for which a file has no place. What else of the camera is free
    are effects: ``focal_length``, ``lens_distortion``. Readings have two columns: u, v
    in pixels, or φ, γ in rad. The radius shows in pixels alone, and α and β in γ alone.
    """

    robot: Spherical
    slip_time_s: float = 0.0
    joint_slip_time_s: float = 0.0
    thermal_shift_lag_s: float = 0.0
    sensor_slip_time_s: float = 0.0
    time_origin_s: float = 0.0
    period_rad: Setting | None = None

    catalogue: ClassVar = SPHERICAL_CATALOGUE
    layouts: ClassVar = (SPHERICAL_PIXELS, SPHERICAL_ANGLES)
    table: ClassVar = _core.SphericalModel.CATALOGUE
    targets: ClassVar = SPHERICAL_ANGLES.coordinates
    usual_pose_sd: ClassVar = ((1.0, 1.0, 1.0), (0.1, 0.1, 0.1))
    pose_sigma_in_file: ClassVar = "marker_sigma_px under [camera]"

    def lever_mm(self, name: str) -> float:
        """Angles move what stands on the sphere."""
        del name
        return self.robot.radius_mm

    @property
    def may_be_off(self) -> Mapping[str, Effect]:
        """The catalogue, and the centre of the lens where that is held."""
        held = self.robot.camera is not None and not any(p.name in self.free for p in _CENTRE.parameters)
        return {**self.known_effects, _CENTRE.name: _CENTRE} if held else self.known_effects

    @property
    def default(self) -> tuple[str, ...]:
        """The paper's three, and what is open of the camera's pose."""
        pose = (name for name in POSE if self.robot.camera is not None and not self.held_of_pose(name))
        return ("alpha", "beta", "radius", *pose)

    def for_run(self, data: Measurements) -> SphericalModel:
        """Angles tell nothing of where a camera stands."""
        made = super().for_run(data)
        if data.layout != SPHERICAL_ANGLES:
            return made
        return replace(made, free=tuple(name for name in made.free if name not in POSE))

    def settings(self) -> dict[str, Setting | None]:
        """Moments of the slips of marker, joints, camera, lag of the stands, origin of time, period of the encoders."""
        return {one.name: getattr(self, one.name) for one in fields(self)[len(fields(ChainModel)) :]}

    @cached_property
    def core(self) -> _core.SphericalModel:
        """The compiled model for runs that hold pixels."""
        r = self.robot
        pull = np.array(r.gravity) / np.linalg.norm(r.gravity)
        # without a cyclic error the period does not matter
        times = (self.time_origin_s, self.slip_time_s, self.joint_slip_time_s, self.sensor_slip_time_s)
        periods = self.periods(self.layouts[0].joints, np.pi)
        settings = np.array([r.radius_mm, *pull, *np.deg2rad(r.home_deg), *times, np.pi])
        camera = (r.camera or _ANY_CAMERA).parameters
        return _core.SphericalModel(r.geometry, camera, settings, r.assembly_mode, readings="pixels", periods=periods)

    @cached_property
    def pointing(self) -> _core.SphericalModel:
        """The compiled model for runs that hold angles."""
        return self.core.reading("angles")

    def core_for(self, data: Measurements) -> _core.SphericalModel:
        """The compiled model for pixels or angles. Raises :class:`~sherkit.errors.SherkitError` for pixels unseen."""
        if data.layout == SPHERICAL_ANGLES:
            return self.pointing
        _ = self.robot.seen
        return self.core

    def as_declared(self, data: Measurements) -> Measurements:
        """With the error of a marker's place in the picture that repeats share, where the robot file has it."""
        data = super().as_declared(data)
        sigma = None if self.robot.camera is None else self.robot.camera.marker_sigma_px
        if sigma is None or data.layout != SPHERICAL_PIXELS:
            return data
        missing = data.taken & ~(data.pose_sigma > 0)
        return replace(data, pose_sigma=np.where(missing, sigma, data.pose_sigma)) if missing.any() else data

    def ranges(self, data: Measurements) -> dict[str, tuple[float, float]]:
        """The first and the last pixel of the picture."""
        camera = self.robot.camera
        if camera is None or data.layout != SPHERICAL_PIXELS:
            return {}
        return {name: (0.0, size - 1.0) for name, size in zip(data.layout.coordinates, camera.size_px, strict=True)}

    def grid(self, data: Measurements) -> Floats | None:
        """φ and γ (k, 2), rad, over the workspace, or over where the run was."""
        robot = self.robot
        seen = robot.forward_batch(data.joints)
        where = seen.values[seen.reached]
        if not len(where):
            return None
        limits = []
        for k, given in enumerate((robot.phi_deg, robot.gamma_deg)):
            low, high = (where[:, k].min(), where[:, k].max()) if given is None else np.deg2rad(given)
            limits.append(np.linspace(low, high, _GRID[k]))
        return np.stack(np.meshgrid(*limits, indexing="ij"), axis=-1).reshape(-1, 2)

    def stands(self, rows: Measurements, values: Floats) -> tuple[Floats, Bools]:
        """φ and γ (k, 2), rad, of the tool, and whether the marker is in the picture where one is taken."""
        full = self.full(values)
        tool = np.where([p.name in _DATUM for p in self.core_parameters], 0.0, full)
        found, reached = self.pointing.predict(tool, self.block(rows))
        if rows.layout != SPHERICAL_ANGLES:
            pixels, shown = self.core_for(rows).predict(full, self.block(rows))
            size = np.array(self.robot.seen.size_px)
            reached = reached & shown & ((pixels >= 0) & (pixels <= size - 1)).all(axis=1)
        return found, reached

    def allowed(self, coordinates: Floats, slack: float = SLACK) -> Bools:
        """Which φ and γ (k, 2) lie in the workspace of the robot file."""
        inside = np.ones(len(coordinates), dtype=bool)
        for k, given in enumerate((self.robot.phi_deg, self.robot.gamma_deg)):
            if given is not None:
                low, high = np.deg2rad(given)
                more = slack * (high - low)
                inside &= (coordinates[:, k] >= low - more) & (coordinates[:, k] <= high + more)
        return inside

    def reason(self, data: Measurements, row: int, values: Floats) -> str:
        """What of mechanism or camera fails there."""
        full = self.full(values)
        try:
            self.robot.kinematics({"alpha": full[0], "beta": full[1]}).forward(data.joints[row])
        except SherkitError as error:
            return str(error)
        single = data.select(np.array([row]))
        marker, reached = self.core.markers(full, self.block(single))
        if not reached[0]:
            return "an effect that is at work needs a column that these rows lack, or the links cannot close"
        if self.robot.camera is not None and data.layout != SPHERICAL_ANGLES:
            try:
                self.robot.camera.core.project(marker[0])
            except SherkitError as error:
                return str(error)
        return "the camera does not see the marker there"

    # -- what this robot has beyond others ---------------------------------------------------------------

    def joint_residuals(self, data: Measurements, values: Floats) -> Floats:
        """Measured joints minus the inverse kinematics of the readings (n, 2), rad (Eq. 6); NaN where it has none."""
        read = np.where(data.taken, data.readings, np.nan)
        return self.core_for(data).inverse_residuals(self.full(values), self.block(data), read, [])[0]

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
        return self.core.camera(self.full(values))


# -- As the paper has it (Eq. 6) ----------------------------------------------------------------------------------

#: Effects that the inverse kinematics of a reading cannot hold.
_BEHIND_THE_JOINTS = ("axis_offset", "gravity_flexure", "marker_offset", "thermal_growth", "drift", "slip")


@dataclass(frozen=True)
class TaskError:
    """Table II: what is left between joints and vision, by angle, rad: mean, root mean square, largest."""

    mean: tuple[float, float]
    rms: tuple[float, float]
    largest: tuple[float, float]
    #: Root of the sum of squares, which the paper prints under the name of RMS.
    root_sum: tuple[float, float]


def identify_joints(robot: Spherical | SphericalModel, data: Measurements, *, free: Sequence[str] = ()) -> Fit:
    """Fits the free parameters so that the inverse kinematics of the readings gives the joints, all rows alike (Eq. 6).

    It is the paper's way, to stand beside :func:`~sherkit.fit.identify.identify`, which compares readings: there every
    reading weighs by its own noise, and errors behind the joints (axes that miss the centre, flexure, the marker) have
    a place.

    The covariance follows from the residuals of the joints. Raises :class:`~sherkit.errors.FitError` for effects that
    act behind the joints, effects given in NumPy, rows without both readings, and rows that cannot be computed.
    """
    model = cast(SphericalModel, model_of(robot, free))
    refused = [e.name for e in model.effects if e.name in _BEHIND_THE_JOINTS or e.function is not None]
    if refused:
        raise FitError(
            f"{listed(refused)}: acts behind the joints and has no place in the residual of the inverse kinematics; "
            "use sherkit.identify"
        )
    half = ~data.taken.all(axis=1) & ~data.outlier
    if half.any():
        raise FitError(f"{data.place(half)}: the inverse kinematics needs both readings of a row")
    solver = _core.Solver(np.zeros(len(model.parameters)), np.array([p.size for p in model.parameters]))
    weights = np.ascontiguousarray(np.repeat(np.where(data.outlier, 0.0, 1.0)[:, None], 2, axis=1))
    block = model.block(data)
    read = np.where(data.taken, data.readings, np.nan)
    ended, missing = model.core_for(data).solve_inverse(
        solver, np.zeros(len(model.core_parameters)), model.indices, block, read, weights
    )
    model.require(data, np.array(missing, dtype=np.int64), np.zeros(len(model.parameters)))
    result = solver.result()
    left = model.joint_residuals(data, solver.trial)[~data.outlier]
    scale = float(np.sqrt((left**2).sum() / max(left.size - result["rank"], 1)))
    return Fit(
        model=model,
        data=data,
        values=solver.trial,
        covariance=result["covariance"] * scale**2,
        unobserved_covariance=result["unobserved_covariance"],
        rank=result["rank"],
        singular_values=result["singular_values"],
        unobserved_basis=result["unobserved"],
        scale=scale,
        noise=noise_of(data),
        loss="linear",
        priors=False,
        converged=ended == "converged",
        evaluations=result["evaluations"],
    )


def task_error(model: SphericalModel, data: Measurements, values: Floats) -> TaskError:
    """φ and γ by the kinematics of the joints, less those that vision gives with the same parameters, rad (Table II).

    Raises :class:`~sherkit.errors.FitError` for rows that cannot be computed.
    """
    seen = model.seen_angles(data, values)
    full = model.full(values)
    told, reached = model.pointing.predict(full, model.block(data))
    bad = ~(reached & np.isfinite(seen).all(axis=1)) & ~data.outlier
    model.require(data, np.flatnonzero(bad), values)
    left = (told - seen)[~data.outlier]
    left[:, 0] = np.angle(np.exp(1j * left[:, 0]))

    def pair(v: Floats) -> tuple[float, float]:
        return float(v[0]), float(v[1])

    squares = (left**2).sum(axis=0)
    return TaskError(
        mean=pair(left.mean(axis=0)),
        rms=pair(np.sqrt(squares / len(left))),
        largest=pair(np.abs(left).max(axis=0)),
        root_sum=pair(np.sqrt(squares)),
    )
