"""What the drawing of the stage may get wrong, link by link, and the effects that can be missing beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sherkit.base.types import Floats
from sherkit.data import Measurements
from sherkit.data.columns import Layout
from sherkit.fit.numpy_chain import ComplexChain
from sherkit.model.chain import ChainModel
from sherkit.model.effect import Effect, Sentences
from sherkit.model.sensor_pose import IN_PLANE, SensorPose, pose_row, seen_in_plane, slip_row
from sherkit.model.sentences import catalogue_of

from .stage import XYStage

#: The columns of a run: what the scales say, and what an interferometer reads of the table.
XY = Layout(("axis_1_mm", "axis_2_mm"), ("x_mm", "y_mm"), "µm", 1e3)
_REFERENCE_C = 20.0


def _row(name: str, link: str, unit: str, size: float, lever: float, *parameters: str, **more: Any) -> dict[str, Any]:
    own = [{"name": p, "symbol": p, "unit": unit, "size": size, "lever_mm": lever} for p in parameters]
    return {"name": name, "link": link, "base": False, "parameters": own, "needs": [], "search": None, **more}


#: THE table: what is free as drawn (``base``), then the effects in the order of the chain.
TABLE: Sequence[dict[str, Any]] = (
    _row("squareness", "structure", "rad", 1e-3, 60.0, "lean", base=True),
    pose_row(IN_PLANE),
    slip_row(60.0, IN_PLANE),
    _row("joint_scale", "joints", "mm/mm", 1e-4, 60.0, "scale_1", "scale_2"),
    _row("backlash", "joints", "mm", 0.005, 1.0, "width_1", "width_2", needs=["direction"]),
    _row("bow", "structure", "mm", 0.01, 1.0, "of_1", "of_2"),
    _row("thermal_growth", "body", "1/°C", 2e-5, 60.0, "coefficient", needs=["temperature_c"]),
    _row("drift", "body", "mm/h", 0.05, 1.0, "rate_x", "rate_y", needs=["time_s"]),
)
CATALOGUE: dict[str, Effect] = catalogue_of(
    TABLE,
    {
        "bow": Sentences(
            physics="A guide is not straight: the table is led off sideways, most in the middle of the travel.",
            residuals="Across an axis, with the square of where it stands.",
            remedy="Scrape or shim the guide, or correct it by a table.",
        ),
    },
)


class XYChain(ComplexChain):
    """The chain of one stage. Its derivatives are complex steps."""

    joints, read = 2, 2

    def __init__(
        self, travel_mm: tuple[float, float], pose: SensorPose, time_origin_s: float, sensor_slip_time_s: float
    ) -> None:
        self.half = 0.5 * np.array(travel_mm)
        self.pose = pose
        self.time_origin_s, self.sensor_slip_time_s = time_origin_s, sensor_slip_time_s

    def _readings(self, values: NDArray[Any], joints: NDArray[Any], known: Floats, push: NDArray[Any]) -> NDArray[Any]:
        named = [(row["name"], p["name"]) for row in TABLE for p in row["parameters"]]
        p = {name: value for (_, name), value in zip(named, values, strict=True)}
        off, slip = (values[[row == one for row, _ in named]] for one in ("sensor_pose", "sensor_slip"))
        time_s, temperature_c, direction = known[:, 0], known[:, 1], known[:, 2:4]

        def acting(names: Sequence[str], gain: NDArray[Any]) -> Any:
            # an effect at zero does not ask for its column
            sizes = np.array([p[name] for name in names])
            return sizes * gain if sizes.any() else 0.0

        scales = joints * (1.0 + np.array([p["scale_1"], p["scale_2"]]))
        scales = scales + acting(("width_1", "width_2"), 0.5 * direction)
        straight = 1.0 - (scales / self.half) ** 2
        across = np.stack([p["of_2"] * straight[:, 1], p["of_1"] * straight[:, 0]], axis=1)
        table = np.stack([scales[:, 0] - p["lean"] * scales[:, 1], scales[:, 1]], axis=1) + across + push[:, :2]
        table = table + acting(("coefficient",), (temperature_c - _REFERENCE_C)[:, None]) * table
        table = table + acting(("rate_x", "rate_y"), (time_s - self.time_origin_s)[:, None] / 3600.0)
        if slip.any():
            late = np.where(np.isnan(time_s), np.nan, (time_s >= self.sensor_slip_time_s).astype(float))
            off = off + late[:, None] * slip
        return seen_in_plane(self.pose, off, table)


@dataclass(frozen=True)
class XYModel(ChainModel):
    """A nominal stage with named errors and effects to identify. Readings are x and y of the table, mm."""

    robot: XYStage
    time_origin_s: float = 0.0
    sensor_slip_time_s: float = 0.0

    catalogue: ClassVar[Mapping[str, Effect]] = CATALOGUE
    layouts: ClassVar = (XY,)
    table: ClassVar = TABLE
    targets: ClassVar = XY.coordinates

    def lever_mm(self, name: str) -> float:
        """A turn of the interferometer moves all that it sees; other levers stand in the table."""
        del name
        return 0.5 * max(self.robot.travel_mm)

    @property
    def default(self) -> tuple[str, ...]:
        """How square the axes are, and what the file leaves open of where the interferometer stands."""
        return tuple(p.name for p in self.base if not self.held_of_pose(p.name))

    def settings(self) -> dict[str, float | None]:
        """The origin of time, the moment at which the interferometer was knocked."""
        return {"time_origin_s": self.time_origin_s, "sensor_slip_time_s": self.sensor_slip_time_s}

    @cached_property
    def core(self) -> XYChain:
        """The chain."""
        return XYChain(self.robot.travel_mm, self.robot.sensor_pose, self.time_origin_s, self.sensor_slip_time_s)

    def grid(self, data: Measurements) -> Floats:
        """Places from which the next poses are chosen."""
        from .stage import grid

        del data
        return grid(self.robot)

    def reason(self, data: Measurements, row: int, values: Floats) -> str:
        """A stage reaches everywhere: it is a column."""
        del data, row, values
        return "an effect that is at work needs a column that these rows lack"
