"""What a binding of ``rust/core/src/chain/planar.rs`` would be: the table and the chain, in NumPy, for as many rows as
there are. Its derivatives are complex steps. Where the sensor stands is the link that every NumPy chain can have
(``sherkit.model.sensor_pose``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sherkit.base.types import Floats
from sherkit.fit.numpy_chain import ComplexChain
from sherkit.model.sensor_pose import SensorPose, pose_row, seen_from, slip_row

_REFERENCE_C = 20.0


def _row(
    name: str, link: str, unit: str, size: float, lever: float | None, *parameters: str, base: bool = False, **more: Any
) -> dict[str, Any]:
    own = [{"name": p, "symbol": p, "unit": unit, "size": size, "lever_mm": lever} for p in parameters]
    return {"name": name, "link": link, "base": base, "parameters": own, "needs": [], "search": None, **more}


#: The table of `chain/planar.rs`, row by row.
CATALOGUE: Sequence[dict[str, Any]] = (
    _row("links", "structure", "mm", 1.0, 1.0, "length_1", "length_2", base=True),
    _row("joint_offset", "joints", "rad", 0.02, None, "offset_1", "offset_2", base=True),
    pose_row(),
    slip_row(200.0),
    _row("joint_scale", "joints", "rad/rad", 2e-3, 200.0, "scale_1", "scale_2"),
    _row("encoder_eccentricity", "joints", "rad", 2e-3, 200.0, "sine_1", "cosine_1", "sine_2", "cosine_2"),
    _row(
        "encoder_cyclic", "joints", "rad", 1e-3, 200.0, "sine_1", "cosine_1", "sine_2", "cosine_2", search="period_rad"
    ),
    _row("backlash", "joints", "rad", 1e-3, 200.0, "width_1", "width_2", needs=["direction"]),
    _row("joint_slip", "joints", "rad", 2e-3, 200.0, "step_1", "step_2", needs=["time_s"], search="time_s"),
    _row("droop", "structure", "mm", 0.2, 1.0, "fall"),
    _row("thermal_growth", "body", "1/°C", 2e-5, 200.0, "coefficient", needs=["temperature_c"]),
    _row("drift", "body", "mm/h", 0.1, 1.0, "rate_x", "rate_y", "rate_z", needs=["time_s"]),
    _row("slip", "body", "mm", 0.1, 1.0, "step_x", "step_y", "step_z", needs=["time_s"], search="time_s"),
    _row(
        "thermal_shift", "sensor", "mm/°C", 0.01, 1.0, "shift_x", "shift_y", "shift_z", needs=["temperature_c"],
        search="lag_s",
    ),
    _row("sensor_linearity", "sensor", "mm", 0.005, 1.0, "cubic_x", "cubic_y", "cubic_z"),
)  # fmt: skip
_ENDS = np.cumsum([len(row["parameters"]) for row in CATALOGUE])
_OWN = {row["name"]: slice(end - len(row["parameters"]), end) for row, end in zip(CATALOGUE, _ENDS, strict=True)}


class PlanarCore(ComplexChain):
    """The chain of one arm: ``lengths`` (2,) and ``height``, mm; ``home`` (2,), rad; moments, s; the period of
    the encoders, rad; where the sensor stands that reads it."""

    joints, read = 2, 3

    def __init__(
        self,
        lengths: Floats,
        height: float,
        home: Floats,
        time_origin_s: float,
        slip_time_s: float,
        joint_slip_time_s: float,
        sensor_slip_time_s: float,
        period_rad: float,
        pose: SensorPose,
    ) -> None:
        self.lengths, self.height, self.home, self.wave = lengths, height, home, 2.0 * np.pi / period_rad
        self.time_origin_s, self.slip_time_s, self.joint_slip_time_s = time_origin_s, slip_time_s, joint_slip_time_s
        self.sensor_slip_time_s, self.pose = sensor_slip_time_s, pose

    def _readings(self, values: NDArray[Any], joints: NDArray[Any], known: Floats, push: NDArray[Any]) -> NDArray[Any]:
        """Readings (n, 3) for readings of the joints (n, 2), covariates (n, 7) and displacements (n, 3)."""
        p = {name: values[own] for name, own in _OWN.items()}
        time, warmer, direction = known[:, :1], known[:, 1:2] - _REFERENCE_C, known[:, 2:4]

        def late(moment_s: float) -> Floats:
            return np.where(np.isnan(time), np.nan, (time >= moment_s).astype(float))

        def acting(name: str, gain: NDArray[Any]) -> Any:
            # an effect at zero does not ask for its covariate
            return p[name] * gain if p[name].any() else 0.0

        theta = joints + p["joint_offset"] + p["joint_scale"] * (joints - self.home)
        for name, angle in (("encoder_cyclic", self.wave * joints), ("encoder_eccentricity", joints)):
            if (wave := p[name]).any():
                theta = theta + wave[::2] * np.sin(angle) + wave[1::2] * np.cos(angle)
        theta = theta + acting("backlash", 0.5 * direction)
        theta = theta + acting("joint_slip", late(self.joint_slip_time_s))
        lengths = self.lengths + p["links"]
        angles = np.cumsum(theta, axis=1)
        x, y = (np.sum(lengths * turn(angles), axis=1) for turn in (np.cos, np.sin))
        z = self.height - p["droop"] * (x * x + y * y) / self.lengths.sum() ** 2
        point = np.column_stack([x, y, z])
        body = point * (1.0 + acting("thermal_growth", warmer)) + acting("slip", late(self.slip_time_s)) + push
        body = body + acting("drift", (time - self.time_origin_s) / 3600.0)
        body = body + acting("thermal_shift", known[:, -1:] - _REFERENCE_C)
        seen = seen_from(self.pose, p["sensor_pose"] + acting("sensor_slip", late(self.sensor_slip_time_s)), body)
        return np.asarray(seen + p["sensor_linearity"] * (seen / 20.0) ** 3)
