"""Model of a robot for identification: which errors are free, predicted readings, their derivatives."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from . import _core
from .errors import FitError, ShapeError
from .measurements import Measurements
from .names import listed, nearest
from .parameters import Parameter
from .robots.delta import LIMB_PARAMETERS, Delta

Floats = NDArray[np.float64]

#: Plausible sizes of errors of a machined and assembled delta, mm and rad: the order of the paper's Table II.
_SIZES = {
    "base_radius": 3.0,
    "base_angle": float(np.deg2rad(1.0)),
    "joint_offset": 2.0,
    "rod_length": 2.0,
    "platform_radius": 1.0,
    "platform_angle": float(np.deg2rad(1.0)),
}
_DATUM_SIZE_MM = 10.0
_SUBSCRIPTS = "₁₂₃"


@dataclass(frozen=True)
class DeltaModel:
    """A nominal delta with named errors to identify.

    ``free`` names the parameters to identify: by default the paper's twelve (Eq. 9) and the datum of the
    sensors. The platform's radii and angles can be freed as well; they are exactly dependent on the base's.
    Readings have four columns: x, y, z, distance.
    """

    robot: Delta
    free: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        known = [p.name for p in self.all_parameters]
        if not self.free:
            object.__setattr__(self, "free", tuple(n for n in known if not n.startswith("platform")))
        for name in self.free:
            if name not in known:
                raise FitError(f"'{name}' is not a parameter of this robot{nearest(name, known)}")
        if len(set(self.free)) < len(self.free):
            raise FitError(f"a parameter is freed twice: {listed(self.free, 24)}")

    @cached_property
    def all_parameters(self) -> tuple[Parameter, ...]:
        """Every parameter of the chain, in the order of the core: 18 geometric errors, then the datum."""
        r = self.robot
        levers = {"base_angle": r.base_radius_mm, "platform_angle": r.platform_radius_mm}
        out = []
        for limb in range(3):
            for name, symbol in LIMB_PARAMETERS:
                angle = name.endswith("angle")
                lever = levers[name][limb] if angle else 1.0
                unit = "rad" if angle else "mm"
                symbol_i = f"{symbol}{_SUBSCRIPTS[limb]}"
                out.append(Parameter(f"{name}_{limb + 1}", symbol_i, unit, _SIZES[name], lever_mm=lever))
        out += [Parameter(f"datum_{axis}", f"d_{axis}", "mm", _DATUM_SIZE_MM) for axis in "xyz"]
        return tuple(out)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters, in the order of ``free``."""
        by_name = {p.name: p for p in self.all_parameters}
        return tuple(by_name[name] for name in self.free)

    @cached_property
    def indices(self) -> list[int]:
        """Places of the free parameters among all."""
        names = [p.name for p in self.all_parameters]
        return [names.index(name) for name in self.free]

    @cached_property
    def core(self) -> _core.DeltaModel:
        """The compiled model."""
        r = self.robot
        return _core.DeltaModel(r.geometry, np.array(r.target_offset_mm), r.assembly_mode)

    def full(self, values: Floats) -> Floats:
        """Values of the free parameters among zeros for the fixed ones, (21,)."""
        values = np.asarray(values, dtype=float)
        if values.shape != (len(self.free),):
            raise ShapeError(f"values: expected {len(self.free)} numbers, got an array of shape {values.shape}")
        out = np.zeros(len(self.all_parameters))
        out[self.indices] = values
        return out

    def predict(self, data: Measurements, values: Floats) -> Floats:
        """Predicted readings (n, 4), mm. Raises :class:`FitError` naming rows out of reach."""
        out, reached = self.core.predict(self.full(values), data.joints_mm, data.distances_or_none)
        self.require(data, np.flatnonzero(~reached & ~data.outlier), values)
        return out

    def derivatives(self, data: Measurements, values: Floats) -> Floats:
        """Derivatives (n, 4, free) of the readings by the free parameters. Raises as :meth:`predict`."""
        full = self.full(values)
        out, reached = self.core.derivatives(full, data.joints_mm, data.distances_or_none, self.indices)
        self.require(data, np.flatnonzero(~reached & ~data.outlier), values)
        return out

    def require(self, data: Measurements, missing: NDArray[np.int64], values: Floats) -> None:
        """Raises :class:`FitError` for rows that the model cannot reach, with the reason for the first."""
        if len(missing) == 0:
            return
        ends = [data.joints_mm[missing[0]], data.to_joints_mm[missing[0]]]
        names = self.robot.parameter_names
        errors = dict(zip(names, self.full(values)[: len(names)], strict=True))
        reason = "the geometry leaves no robot"
        try:
            kinematics = self.robot.kinematics(errors)
            for joints in ends:
                if np.isfinite(joints).all():
                    kinematics.forward(joints)
        except Exception as error:
            reason = str(error)
        raise FitError(
            f"{data.place(missing)}: the model cannot reach these joint readings ({reason}). "
            "Check units and joint order, correct the geometry, or mark the rows as outliers "
            "(column 'outlier' = 1)."
        )

    def starting_at(self, values: Iterable[float] | None) -> Floats:
        """Start values for the free parameters; zero, the drawing, by default."""
        if values is None:
            return np.zeros(len(self.free))
        start = np.fromiter(values, dtype=float)
        if start.shape != (len(self.free),) or not np.isfinite(start).all():
            raise ShapeError(f"start: expected {len(self.free)} finite numbers")
        return start
