"""The calibrated spherical robot: where its tool points, how to point it, how well, and where its centre is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Self, cast

import numpy as np

import sherkit._core as _core

from ...base import linalg
from ...base.types import Bools, Floats
from ...errors import FitError
from ...fit.identify import Fit, identify
from ...model.effect import Effect
from ..accuracy import Planes
from ..calibrated import Calibration, Note
from ..calibration_run import CalibrationRun
from ..deployed import BASE, SENSOR
from ..identified_model import IdentifiedModel
from .model import SphericalModel
from .robot import SPHERICAL_ANGLES, Spherical

# -- The remote centre of motion: how far it wanders is what makes such a robot safe ------------------------------

EFFECT = "axis_offset"
#: One-sided 95 % quantile of a Gaussian.
_ONE_SIDED = 1.6448536269514722


@dataclass(frozen=True, eq=False)
class RemoteCentre:
    """Displacement of the remote centre over the poses of a run, mm.

    ``displacement_mm`` (n, 3) and ``covariance_mm2`` (n, 3, 3), row by row; ``explained`` tells whether the axes that
    miss the centre are in the model that was fitted, or were added only to ask.
    """

    displacement_mm: Floats
    covariance_mm2: Floats
    explained: bool

    @property
    def distance_mm(self) -> Floats:
        """How far the centre is off at every row (n,)."""
        return np.linalg.norm(self.displacement_mm, axis=1)

    @property
    def rms_mm(self) -> float:
        """Root mean square of the distance."""
        return float(np.sqrt(np.mean(self.distance_mm**2)))

    @property
    def largest(self) -> tuple[float, float]:
        """Largest distance over the run and its standard deviation, mm."""
        row = int(np.argmax(self.distance_mm))
        return float(self.distance_mm[row]), float(self._std_along()[row])

    @property
    def within_mm(self) -> float:
        """The centre stays within this distance, mm, at every pose of the run, in 95 of 100 cases."""
        return float((self.distance_mm + _ONE_SIDED * self._std_along()).max())

    def _std_along(self) -> Floats:
        """Standard deviation of each distance: along the displacement, or the worst way where there is none."""
        distance = self.distance_mm[:, None]
        along = np.divide(self.displacement_mm, distance, out=np.zeros_like(self.displacement_mm), where=distance > 0)
        variance = np.einsum("ni,nij,nj->n", along, self.covariance_mm2, along)
        worst = linalg.eigvalsh(self.covariance_mm2)[:, -1]
        return np.sqrt(np.where(distance[:, 0] > 0, variance, worst).clip(0.0))

    def __repr__(self) -> str:
        size, std = self.largest
        return f"RemoteCentre(off by at most {size:.3f} ± {std:.3f} mm, within {self.within_mm:.3f} mm at 95 %)"


def remote_centre(fit: Fit) -> RemoteCentre:
    """How far the remote centre wanders over the poses of a fitted run.

    Where ``axis_offset`` is not in the model it is fitted besides, to ask. Raises
    :class:`~sherkit.errors.FitError` for a robot without a remote centre.
    """
    if EFFECT not in fit.model.known_effects:
        raise FitError("only a spherical robot has a remote centre of motion")
    model = cast(SphericalModel, fit.model)
    explained = EFFECT in {e.name for e in model.effects}
    if not explained:
        model = model.with_effect(model.known_effects[EFFECT])
        fit = identify(model, fit.data, noise=fit.noise, loss=fit.loss)
    full = model.full(fit.values)
    here, by_values, _, reached = model.core.centres(full, model.block(fit.data), model.indices)
    count = len(model.indices)
    covariance = (fit.covariance + fit.unobserved_covariance)[:count, :count]
    rows = reached & ~fit.data.outlier
    spread = by_values[rows] @ covariance @ by_values[rows].transpose(0, 2, 1)
    return RemoteCentre(here[rows], spread, explained)


# -- The calibration ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class SphericalCalibration(Calibration):
    """A calibrated spherical robot. Angles φ and γ, rad, are those of the end of the tool axis seen from the centre.

    What was identified of the measurement alone (camera, its delay, the marker's place on the tool) does not move the
    tool and is left out of :meth:`forward`. Residuals (2, 2), rad², are angles across the tool.
    """

    coordinates: ClassVar = SPHERICAL_ANGLES.coordinates
    called: ClassVar = ("phi and gamma", "phi and gamma")
    frame: ClassVar = BASE
    no_other: ClassVar = "they are angles about its own centre, wherever a camera stands; leave the frame out"

    robot: Spherical
    whole: IdentifiedModel

    @classmethod
    def of(cls, whole: CalibrationRun, local: CalibrationRun | None = None) -> Self:
        """From a run; there is no local one. Raises as :class:`~sherkit.robots.spherical.SphericalModel`."""
        del local
        fit, held_out = whole.fit, whole.deployed(whole.held_out)
        made = cls(fit.model.robot, IdentifiedModel.identified(fit, 2))
        full = fit.data.taken.all(axis=1) & ~fit.data.outlier & np.isfinite(held_out).all(axis=1)
        angles = made._as_angles(fit, held_out, full)[0]
        left, scatter = whole.left(lambda missed: made._as_angles(fit, missed, full)[1], held_out)
        return replace(made, whole=made.whole.leaving(left, scatter, angles))

    def _as_angles(self, fit: Fit, held_out: Floats, rows: Bools) -> tuple[Floats, Floats]:
        """Angles (k, 2) of the rows, and their residuals carried through the joints to angles across it (k, 2)."""
        model, data = fit.model, fit.data.select(rows)
        _, by_joints, _, seen = model.core_for(data).derivatives(model.full(fit.values), model.block(data), [])
        angles, by_angles, reached = self._rows(data.joints)
        use = seen & reached & (np.abs(np.linalg.det(by_joints)) > 0)
        turned = by_angles[use] @ linalg.solve(by_joints[use], held_out[rows][use][:, :, None])
        return angles[use], _across(turned, angles[use])[:, :, 0]

    @classmethod
    def about(cls, fit: Fit) -> Sequence[Note]:
        """How far the remote centre of motion wanders."""
        found = remote_centre(fit)
        size, std = found.largest
        values = {
            "rms": found.rms_mm, "largest": size, "std": std, "within_95": found.within_mm, "in_model": found.explained,
        }  # fmt: skip
        asked = "" if found.explained else " (axis_offset was fitted besides, to ask)"
        said = f"off by at most {size:.3f} ± {std:.3f} mm over the run, within {found.within_mm:.3f} mm at 95 %{asked}"
        return (Note("remote centre of motion", said, {"remote_centre_mm": values}),)

    # -- the model ---------------------------------------------------------------------------------------

    @cached_property
    def core(self) -> _core.SphericalCalibrated:
        """The compiled model: the same code that a control loop runs."""
        return _core.SphericalCalibrated(self.model.core, self.model.full(self.whole.values), self.robot.working_mode)

    @property
    def radius_mm(self) -> float:
        """Distance of the end of the tool from the centre, as identified."""
        return self.robot.radius_mm + self.by_name.get("radius", 0.0)

    # -- accuracy ----------------------------------------------------------------------------------------

    def by_values(self, part: IdentifiedModel, joints: Floats, now: list[float]) -> Floats:
        """Of angles across the tool (n, 2, p), rad."""
        del part
        angles, by_values, _ = self.core.by_parameters_batch(joints, now, self.model.indices)
        return _across(by_values, angles)

    def counted(self, part: IdentifiedModel, frame: str) -> Bools:
        """What is the measurement's alone turns no tool."""
        names = [p.name for p in self.model.parameters[: len(part.values)]]
        others = {*self.model.of_sensor, "radius"}
        return np.array([n not in others and n.partition(".")[0] not in _OF_MARKER for n in names], dtype=bool)

    def moves(self, effect: Effect, frame: str) -> bool:
        """Nor does an effect of it; what geometry took of that does."""
        return effect.link != SENSOR and effect.name not in _OF_MARKER

    def carried(self, joints: Floats, by_joints: Floats, missed: Floats) -> Floats:
        """Through the joints to angles across the tool."""
        angles, by_angles, _ = self._rows(joints)
        return _across(by_angles @ linalg.solve(by_joints, missed), angles)

    @property
    def accuracy_unit(self) -> str:
        """How far the end of the tool is off."""
        return "mm"

    @property
    def reach_mm(self) -> float:
        """The identified radius: an angle across the tool moves its end by as much."""
        return self.radius_mm

    def places(self) -> list[tuple[str, Floats]]:
        """The middle and two corners of the run: directions φ, γ (2,), rad."""
        low, high = self.whole.low, self.whole.high
        out = [("middle of the run", 0.5 * (low + high)), ("corner near the axis", low), ("corner far from it", high)]
        return [(name, np.array(place)) for name, place in out]

    def planes(self, per_side: int) -> Planes:
        """The sphere, as a plane in φ and γ, degrees."""
        limits = []
        for k, given in enumerate((self.robot.phi_deg, self.robot.gamma_deg)):
            low, high = np.rad2deg([self.whole.low[k], self.whole.high[k]]) if given is None else given
            limits.append(np.linspace(low, high, per_side))
        phi, gamma = limits
        grid = np.stack(np.meshgrid(gamma, phi, indexing="ij"), axis=-1).reshape(-1, 2)[:, ::-1]
        inside = np.ones(len(grid), dtype=bool)
        return Planes(phi, gamma, ("φ, °", "γ, °"), ("end of the tool",), np.deg2rad(grid), inside)


#: What moves the marker and no tool: with the camera's errors it is left out of where the tool points.
_OF_MARKER = ("marker_offset", "thermal_growth", "drift", "slip")


def _across(change: Floats, angles: Floats) -> Floats:
    """Changes of φ and γ (n, 2, k) as angles across the tool: φ counts the less the nearer the tool is to the axis."""
    return np.stack([change[:, 0] * np.sin(angles[:, 1:]), change[:, 1]], axis=1)
