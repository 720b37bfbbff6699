"""A recorded run against the stereo camera, as a model to diagnose: where the tip should be seen, and what is missing.

The tip is the robot's, bent by the force of the gratings at the smoothed depth (Eqs. 1, 2, 8 and 9). An effect is a
change of the tool or of its wavelengths, and is carried through all of that by the compiled code; what it adds is the
difference.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..effects import Effect
from ..effects.tool import TOOL_CATALOGUE
from ..errors import FitError, MeasurementError, RobotError
from ..parameters import Parameter
from ..readings import Readings
from ..robots.flexible_tool import FlexibleTool, rotation_of
from .alignment import at_times
from .runs import ToolRun

Floats = NDArray[np.float64]

#: Column of the rows that says which picture a row is.
_PICTURE = "picture"
_LEAST = 20
#: Two patterns of three fibres without a common part.
_PATTERNS = np.array([[1.0, -1.0, 0.0], [0.5, 0.5, -1.0]])
#: The direction in which a force changes is taken over this time, s.
_SMOOTHING_S = 0.1
_AXES = ("x", "y", "z")
#: Plausible sizes that a fit may go: beyond, effects that take each other's part would run away together.
_FARTHEST = 15.0


@dataclass(frozen=True, eq=False)
class ToolModel:
    """Places of the tip as the camera should see them, in the robot's base (k, 3), mm, at its pictures.

    Fitted without any effect is the camera's offset alone. ``candidates`` are the effects of the tool on this run.
    Raises :class:`~sherkit.errors.MeasurementError` for a run with too few pictures inside the robot's time.
    """

    tool: FlexibleTool
    run: ToolRun

    def __post_init__(self) -> None:
        if int(self.pictures.sum()) < _LEAST:
            raise MeasurementError(
                f"{self.run.source}: {int(self.pictures.sum())} pictures lie within the robot's time; expected "
                f"{_LEAST} or more to diagnose"
            )
        if not self.run.present.any():
            raise MeasurementError(f"{self.run.source}: no row has wavelengths")

    @cached_property
    def pictures(self) -> NDArray[np.bool_]:
        """Pictures (m,) inside the robot's time, with room for an effect of the delay."""
        moment = self.run.camera_time_s - self.tool.camera_delay_s
        room = 5.0 * TOOL_CATALOGUE["camera_delay"].parameters[0].size
        return (moment >= self.run.time_s[0] + room) & (moment <= self.run.time_s[-1] - room)

    @cached_property
    def moments_s(self) -> Floats:
        """Times (k,) of the pictures by the robot's clock, as the tool file has the delay."""
        return self.run.camera_time_s[self.pictures] - self.tool.camera_delay_s

    @cached_property
    def seen_mm(self) -> Floats:
        """What the camera saw (k, 3), robot's base."""
        return self.tool.in_base(self.run.camera_mm[self.pictures])

    @cached_property
    def readings(self) -> Readings:
        """The rows to fit and diagnose: one a picture, with force and depth at its moment."""
        state = self._felt
        force, depth = (
            at_times(self.run.time_s, state.force, self.moments_s),
            at_times(self.run.time_s, state.depth, self.moments_s),
        )
        robot = at_times(self.run.time_s, self.run.position_mm, self.moments_s)
        count = len(self.moments_s)
        return Readings(
            place=dict(zip(("robot_x_mm", "robot_y_mm", "robot_z_mm"), robot.T, strict=True)),
            readings=self.seen_mm,
            names=_AXES,
            unit="mm",
            covariates={
                "force_x_mn": force[:, 0],
                "force_y_mn": force[:, 1],
                "depth_mm": depth,
                _PICTURE: np.arange(count, dtype=float),
            },
            time_s=self.moments_s,
            block=(np.arange(count) * 24 // count).astype(np.int64),
            sigma=np.full((count, 3), self.tool.camera_std_mm / np.sqrt(3.0)),
            source=self.run.source,
        )

    # -- the three methods -------------------------------------------------------------------------------

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The offset of the camera."""
        return tuple(Parameter(f"camera_{axis}", f"c_{axis}", "mm", 1.0) for axis in _AXES)

    def predict(self, data: Readings, values: Floats) -> Floats:
        """Places of the tip (n, 3)."""
        return self._plain[self._rows(data)] + values

    def derivatives(self, data: Readings, values: Floats) -> Floats:
        """Those of the offset (n, 3, 3)."""
        del values
        return np.broadcast_to(np.eye(3), (len(data), 3, 3)).copy()

    def covariates(self, data: Readings) -> dict[str, Floats]:
        """Force, depth and time."""
        out = {name: data.covariates[name] for name in ("force_x_mn", "force_y_mn", "depth_mm")}
        if data.time_s is not None:
            out["time_s"] = data.time_s
        return out

    @cached_property
    def candidates(self) -> tuple[Effect, ...]:
        """The catalogue on this run."""
        return tuple(replace(e, function=self._adding(e)) for e in TOOL_CATALOGUE.values())

    # -- what effects do ---------------------------------------------------------------------------------

    @cached_property
    def _felt(self) -> SimpleNamespace:
        return _state(self.tool, self.run)

    @cached_property
    def _plain(self) -> Floats:
        return _tips(self.tool, self.run, self.moments_s, self._felt)

    @cached_property
    def _changing(self) -> Floats:
        return _direction(self.run.time_s, self._felt.force)

    @staticmethod
    def _rows(data: Readings) -> NDArray[np.int64]:
        return np.asarray(data.covariates[_PICTURE], dtype=np.int64)

    def _adding(self, effect: Effect) -> Callable[[Readings, SimpleNamespace], Floats]:
        """What the effect adds on rows of this run, remembered for the values asked last."""
        names = [p.name for p in effect.parameters]
        farthest = _FARTHEST * np.array([p.size for p in effect.parameters])
        last: dict[tuple[float, ...], Floats] = {}

        def adds(rows: Readings, p: SimpleNamespace) -> Floats:
            values = tuple(float(getattr(p, name)) for name in names)
            if (np.abs(values) > farthest).any():
                raise FitError(f"{effect.name}: a step of {_FARTHEST:g} plausible sizes and more")
            if values not in last:
                if len(last) > 4 * len(names) + 8:
                    last.clear()
                try:
                    last[values] = self.with_effect(effect.name, np.array(values)) - self._plain
                except RobotError as error:  # a step so long that it leaves what is a tool
                    raise FitError(f"{effect.name}: {error}") from None
            return last[values][self._rows(rows)]

        return adds

    def with_effect(self, name: str, values: Floats) -> Floats:
        """Places of the tip (k, 3) at the pictures, with an effect of these values at work."""
        tool, run, at = self.tool, self.run, self.moments_s
        if name == "tool_stiffness":
            stiffness = tool.stiffness_mn_mm2 * (1.0 + values[0])
            return _tips(replace(tool, stiffness_mn_mm2=stiffness), run, at, self._felt)
        if name == "tool_length":
            return _tips(replace(tool, length_mm=tool.length_mm + values[0]), run, at, self._felt)
        if name == "fbg_gain":
            # a section that answers more strongly needs a smaller gain
            gains = np.array(tool.gains) / (1.0 + values)[:, None, None]
            stronger = replace(tool, gains=gains.tolist())
            return _tips(stronger, run, at, _state(stronger, run))
        if name in ("fbg_bias", "fbg_temperature"):
            shift = (values.reshape(2, 2) @ _PATTERNS).reshape(1, 6)
            waves = run.wavelengths_nm.copy()
            if name == "fbg_temperature":
                common = (waves - np.array(tool.reference_nm)).reshape(-1, 3, 3).mean(axis=2)
                shift = np.repeat(common[:, :2], 3, axis=1) * shift
            waves[:, :6] -= shift
            return _tips(tool, run, at, _state(tool, run, waves))
        if name == "force_hysteresis":
            lag = float(values[0]) * self._changing
            return _tips(tool, run, at, SimpleNamespace(force=self._felt.force + lag, depth=self._felt.depth))
        if name == "camera_delay":
            return _tips(tool, run, at - values[0], self._felt)
        place = self._plain
        if name == "shaft_bend":
            turned = rotation_of(at_times(run.time_s, run.turn_rad, at))
            return place + np.einsum("nij,j->ni", turned[:, :, :2], values)
        # registration: seen places are turned about the middle of the run
        middle = place.mean(axis=0)
        return middle + (place - middle) @ rotation_of(values)[0].T


def _state(tool: FlexibleTool, run: ToolRun, wavelengths_nm: Floats | None = None) -> SimpleNamespace:
    """Force (n, 2) and smoothed depth (n,) at the rows of the robot; lost wavelengths are bridged."""
    waves = run.wavelengths_nm if wavelengths_nm is None else wavelengths_nm
    measured = tool.sensor.measure_batch(run.time_s, np.ascontiguousarray(waves))[0]
    start = _core.DepthFilter(tool.start_depth_mm, tool.start_std_mm**2, float(run.time_s[0]), tool.filter_noise)
    depth, _ = start.smooth(run.time_s, np.ascontiguousarray(run.insertion_mm_s), measured, run.present)
    force = measured[:, 1:3]
    if not run.present.all():
        here = np.flatnonzero(run.present)
        force = np.column_stack([np.interp(run.time_s, run.time_s[here], force[here, k]) for k in range(2)])
    return SimpleNamespace(force=force, depth=depth[:, 0])


def _tips(tool: FlexibleTool, run: ToolRun, moments_s: Floats, state: SimpleNamespace) -> Floats:
    """Places of the tip (k, 3) at these moments, robot's base."""
    at = [at_times(run.time_s, v, moments_s) for v in (state.force, state.depth, run.turn_rad, run.position_mm)]
    poses = np.hstack([rotation_of(at[2]).reshape(-1, 9), at[3]])
    return tool.beam.tip_batch(np.ascontiguousarray(at[0]), np.ascontiguousarray(at[1]), np.ascontiguousarray(poses))


def _direction(time_s: Floats, force_mn: Floats) -> Floats:
    """The way (n, 2) in which the force changes, of length one in motion and less where it rests."""
    step = float(np.median(np.diff(time_s)))
    half = max(1, round(_SMOOTHING_S / step / 2))
    total = np.cumsum(np.vstack([np.zeros((1, 2)), force_mn]), axis=0)
    n = len(force_mn)
    ahead, behind = (np.clip(np.arange(n) + k, 0, n) for k in (2 * half + 1, -2 * half))
    here = np.arange(n)
    later = (total[ahead] - total[here]) / np.maximum(ahead - here, 1)[:, None]
    before = (total[here] - total[behind]) / np.maximum(here - behind, 1)[:, None]
    before[behind == here] = force_mn[behind == here]
    moved = later - before
    noise = np.median(np.linalg.norm(np.diff(force_mn, axis=0), axis=1)) / np.sqrt(2 * half)
    size = np.linalg.norm(moved, axis=1)
    return np.asarray(moved / np.sqrt(size**2 + (3.0 * noise) ** 2 + 1e-12)[:, None])
