"""A recorded run against the stereo camera, as a model to diagnose: where the tip should be seen, and what is missing.

Without an effect the tip is where the tool file has it (`places.py`); what an effect adds is the difference to where
the tip would be with it (`effects.py`).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import scipy
from numpy.typing import NDArray

from ...base import linalg
from ...base.figures import listed
from ...base.notebook import Saved
from ...base.types import Floats
from ...data import Measurements, from_arrays
from ...diagnosis import Diagnosis
from ...errors import FitError, MeasurementError, RobotError, SherkitWarning
from ...fit.identify import Fit, identify
from ...model.drawing import Drawing, DrawnPart, line, with_target
from ...model.effect import Effect, Parameter
from ...model.rows import EffectRows
from .alignment import at_times
from .effects import TOOL_CATALOGUE, ToolEffect
from .places import TipPlaces
from .runs import OUT_OF_REACH_NM, ToolRun, check_camera, check_wavelengths, require_camera, warn_frozen
from .tool import FIBRES, FlexibleTool, nested, rotation_of

# -- As it is drawn -----------------------------------------------------------------------------------------------

_STEPS = 25
#: Radius of the hole as it is drawn, and how much of the way to the camera, by the length of the shaft.
_HOLE, _SIGHT = 0.12, 0.8


def drawing(
    tool: Any, turn: Floats, unbent_mm: Floats, depth_mm: Floats, tip_mm: Floats, shown_mm: Floats
) -> Drawing:  # fmt: skip
    """A tool at n moments.

    ``turn`` (n, 3, 3) takes its frame to the base, ``unbent_mm`` (n, 3) is where the tip would be without force,
    ``depth_mm`` (n,) how far from the tip the contact is, ``tip_mm`` (n, 3) where the tip is, ``shown_mm`` (n, 3) where
    it is seen.

    The shaft has the shape of a cantilever under a load at the contact, w(s) ~ s² (3 a - s) and straight beyond it, of
    the size that brings its end to the tip.
    """
    length, way = tool.length_mm, turn[:, :, 2]
    clamp = unbent_mm - length * way
    contact = np.clip(length - depth_mm, 0.05 * length, length)

    def along(s: Floats) -> Floats:
        """Points (n, k, 3) at ways (n, k) from the clamp."""
        a = contact[:, None]
        bent = np.where(s < a, s**2 * (3.0 * a - s), a**2 * (3.0 * s - a))
        share = bent / (contact**2 * (3.0 * length - contact))[:, None]
        straight = clamp[:, None] + s[:, :, None] * way[:, None]
        return np.asarray(straight + share[:, :, None] * (tip_mm - unbent_mm)[:, None])

    n = len(tip_mm)
    whole = np.broadcast_to(np.linspace(0.0, length, _STEPS), (n, _STEPS))
    hole = along(contact[:, None])[:, 0]
    angle = np.linspace(0.0, 2.0 * np.pi, 33)[None, :, None]
    circle = _HOLE * length * (np.cos(angle) * turn[:, None, :, 0] + np.sin(angle) * turn[:, None, :, 1])
    to_camera = np.array(tool.camera_translation_mm) - shown_mm
    far = np.linalg.norm(to_camera, axis=1, keepdims=True)
    sight = shown_mm + _SIGHT * length * np.divide(to_camera, far, out=np.zeros_like(to_camera), where=far > 0)
    parts = [
        DrawnPart("shaft without force", "guide", line(clamp, unbent_mm)),
        DrawnPart("hole in the sclera", "sensor", hole[:, None] + circle),
        DrawnPart("shaft", "link", along(whole)),
        DrawnPart("clamp", "joint", line(clamp)),
        *(
            DrawnPart(f"gratings of section {name}", "joint", along(np.full((n, 1), length - distance)))
            for name, distance in zip(("I", "II"), tool.distances_mm, strict=True)
        ),
        DrawnPart("towards the camera", "guide", line(shown_mm, sight)),
    ]
    return with_target(parts, tip_mm, shown_mm)


# -- The model ----------------------------------------------------------------------------------------------------

#: Part of a run in which a grating shows nothing that is dead; readings of one number after which one is.
_OUT, _LONG = 0.1, 20
#: Column of the rows that says which picture a row is.
_PICTURE = "picture"
_LEAST = 20
_AXES = ("x", "y", "z")
#: Plausible sizes that a fit may go: beyond, effects that take each other's part would run away together.
_FARTHEST = 15.0


@dataclass(frozen=True, eq=False)
class ToolModel(Saved):
    """Places of the tip as the camera should see them, in the robot's base (k, 3), mm, at its pictures.

    Fitted without any effect is the camera's offset alone. ``candidates`` are the effects of the tool on this run.
    Raises :class:`~sherkit.errors.MeasurementError` for a run with too few pictures inside the robot's time, or with
    numbers that cannot be those of this tool.
    """

    tool: FlexibleTool
    run: ToolRun

    #: The command that writes what was named into a file.
    writes: ClassVar[str] = "diagnose ROBOT RUN -o with_it.toml"

    def __post_init__(self) -> None:
        require_camera(self.run)
        warn_frozen(self.run)
        if self.dead.any():
            out = [f"{n} in {s:.0%}" for n, s in zip(FIBRES, self._silent.mean(axis=0), strict=True) if s > _OUT]
            warnings.warn(
                f"{self.run.source}: shows nothing, or always the same: {listed(out)} of the rows; pictures of that "
                "time are not looked at",
                SherkitWarning,
                stacklevel=2,
            )
        if int(self.pictures.sum()) < _LEAST:
            raise MeasurementError(
                f"{self.run.source}: {int(self.pictures.sum())} pictures lie within the robot's time; expected "
                f"{_LEAST} or more to diagnose"
            )
        if not self.run.present.any():
            raise MeasurementError(f"{self.run.source}: no row has wavelengths")
        check_wavelengths(self.run.wavelengths_nm, self.tool.reference_nm, self.run.source)
        check_camera(at_times(self.run.time_s, self.run.position_mm, self.moments_s), self.seen_mm, self.run.source)

    @cached_property
    def _silent(self) -> NDArray[np.bool_]:
        """Gratings (n, 9) that show nothing in a row in which others do: no number, none of this tool, or a number for
        long."""
        waves, out = self.run.wavelengths_nm, np.zeros(self.run.wavelengths_nm.shape, dtype=bool)
        rows = np.flatnonzero(np.isfinite(waves).any(axis=1))
        shown = waves[rows]
        off = np.abs(shown - self.tool.reference_nm)
        out[rows] = ~(off < OUT_OF_REACH_NM)
        for k, stretch in enumerate(np.cumsum(np.diff(shown, axis=0, prepend=np.nan) != 0, axis=0).T):
            out[rows, k] |= np.bincount(stretch)[stretch] > _LONG
        # where all do it is the world, or another tool
        return out & ~out.all(axis=1, keepdims=True)

    @cached_property
    def dead(self) -> NDArray[np.bool_]:
        """Rows (n,) of the robot in which a grating shows nothing that does so for a good part of the run."""
        return np.asarray(self._silent[:, self._silent.mean(axis=0) > _OUT].any(axis=1))

    @cached_property
    def pictures(self) -> NDArray[np.bool_]:
        """Pictures (m,) inside the robot's time, with room for an effect of the delay, and not of seconds in which the
        robot's pose or the wavelengths froze."""
        moment = self.run.camera_time_s - self.tool.camera_delay_s
        room = 5.0 * TOOL_CATALOGUE["camera_delay"].parameters[0].size
        inside = (moment >= self.run.time_s[0] + room) & (moment <= self.run.time_s[-1] - room)
        for one in (*self.run.frozen_fibres, *self.run.frozen_pose):
            inside &= (moment < one.since_s - room) | (moment > one.until_s + room)
        after = np.searchsorted(self.run.time_s, moment).clip(0, len(self.run) - 1)
        return inside & ~self.dead[after] & ~self.dead[(after - 1).clip(0)]

    @cached_property
    def moments_s(self) -> Floats:
        """Times (k,) of the pictures by the robot's clock, as the tool file has the delay."""
        return self.run.camera_time_s[self.pictures] - self.tool.camera_delay_s

    @cached_property
    def seen_mm(self) -> Floats:
        """What the camera saw (k, 3), robot's base."""
        return self.tool.in_base(self.run.camera_mm[self.pictures])

    @cached_property
    def readings(self) -> Measurements:
        """The rows to fit and diagnose: one a picture, with force and depth at its moment."""
        felt, run = self._places.felt, self.run
        force, depth, robot = (
            at_times(run.time_s, v, self.moments_s) for v in (felt.force_mn, felt.depth_mm, run.position_mm)
        )
        count = len(self.moments_s)
        return from_arrays(
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

    def predict(self, data: Measurements, values: Floats) -> Floats:
        """Places of the tip (n, 3)."""
        return self._places.tip_mm[self._rows(data)] + values

    def derivatives(self, data: Measurements, values: Floats) -> Floats:
        """Those of the offset (n, 3, 3)."""
        del values
        return np.broadcast_to(np.eye(3), (len(data), 3, 3)).copy()

    def covariates(self, data: Measurements) -> dict[str, Floats]:
        """Force, depth and time."""
        out = {name: data.covariates[name] for name in ("force_x_mn", "force_y_mn", "depth_mm")}
        if data.time_s is not None:
            out["time_s"] = data.time_s
        return out

    def drawing(self, model: Any, data: Measurements, values: Floats, readings: Floats | None = None) -> Drawing:
        """The tool at the pictures of these rows, with the effects of ``model`` and their ``values``; where it is seen
        is what ``model`` predicts, or ``readings``. Effects of the camera leave the tool where it is."""
        places, rows, moments = self._places, self._rows(data), self.moments_s
        shown = model.predict(data, values)
        machine = tuple(e for e in model.effects if e.link != "sensor")
        without = replace(model, effects=machine)
        names = [p.name for p in model.parameters]
        own = [names.index(p.name) for p in without.parameters]
        kept = np.where([p.name.startswith("camera_") for p in without.parameters], 0.0, values[own])
        tip = without.predict(data, kept)
        origin = at_times(self.run.time_s, self.run.position_mm, moments)[rows]
        depth = at_times(self.run.time_s, places.felt.depth_mm, moments)[rows]
        return drawing(
            self.tool, places.turn[rows], origin, depth, tip, shown[:, :3] if readings is None else readings[:, :3]
        )

    @cached_property
    def candidates(self) -> tuple[Effect, ...]:
        """The catalogue on this run."""
        return tuple(replace(e, function=self._adding(e)) for e in TOOL_CATALOGUE.values())

    # -- what effects do ---------------------------------------------------------------------------------

    @cached_property
    def _places(self) -> TipPlaces:
        lost = self.dead[:, None] | self.run.leaps.single
        run = (
            replace(self.run, wavelengths_nm=np.where(lost, np.nan, self.run.wavelengths_nm))
            if lost.any()
            else self.run
        )
        return TipPlaces(self.tool, run, self.moments_s)

    @staticmethod
    def _rows(data: Measurements) -> NDArray[np.int64]:
        return data[_PICTURE].astype(np.int64)

    def _adding(self, effect: ToolEffect) -> Callable[[EffectRows, SimpleNamespace], Floats]:
        """What the effect adds on rows of this run, remembered for the values asked last."""
        places, known = self._places, effect.parameters

        @lru_cache(4 * len(known) + 8)
        def moved(*values: float) -> Floats:
            if any(abs(value) > _FARTHEST * p.size for value, p in zip(values, known, strict=True)):
                raise FitError(f"{effect.name}: a step of {_FARTHEST:g} plausible sizes and more")
            try:
                return effect.places(places, np.array(values)) - places.tip_mm
            except RobotError as error:  # a step so long that it leaves what is a tool
                raise FitError(f"{effect.name}: {error}") from None

        return lambda rows, p: moved(*(float(getattr(p, one.name)) for one in known))[rows[_PICTURE].astype(np.int64)]


# -- Into the tool file -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Applied:
    """``tool`` says the effects that are ``written``; ``kept_out`` are those that a tool file cannot say, ``why`` a
    sentence on each."""

    tool: FlexibleTool
    written: tuple[str, ...]
    kept_out: tuple[str, ...]
    why: tuple[str, ...]


#: An effect is written where it leaves no more than this part of the error on poses that the fit had not seen: a long
#: run makes less certain, and still moves gains, and so the depth, by more than it mends.
_GAINS = 0.95


def mended(model: ToolModel, found: Diagnosis) -> Applied:
    """What a diagnosis named as :func:`applied`, without effects that gain next to nothing on rows held out."""
    idle = {}
    for before, after in pairwise(found.steps):
        if after.effect is not None and not after.error.rms < _GAINS * before.error.rms:
            unit = after.error.unit
            idle[after.effect] = (
                f"{after.effect} is not written: with it the error on poses that the fit had not seen falls only from "
                f"{before.error.rms:.3g} to {after.error.rms:.3g} {unit}"
            )
    fit = found.fit
    if idle:
        fit = identify(model, fit.data, effects=[e for e in fit.model.effects if e.name not in idle])
    told = applied(model, fit)
    why = (*told.why, *idle.values(), *_references(model.tool, told.tool))
    return replace(told, tool=_left_open(model, found, told), kept_out=(*told.kept_out, *idle), why=why)


def _references(before: FlexibleTool, after: FlexibleTool) -> list[str]:
    """A sentence on the fibres whose references were written anew."""
    moved = 1e3 * (np.array(after.reference_nm) - np.array(before.reference_nm))
    named = [f"{name} {by:+.0f} pm" for name, by in zip(FIBRES, moved, strict=True) if abs(by) > 0.5]
    return [f"reference_nm moved, but for what a section has in common: {listed(named, 9)}"] if named else []


def _left_open(model: ToolModel, found: Diagnosis, told: Applied) -> FlexibleTool:
    """The tool that was written, with what it leaves open in its ``doubt``: where the tip tells stiffness from length
    as little as a clamp that stands elsewhere from a tip that does, the beam is either, and the depth may be, which
    counts from the tip."""
    named = {*told.written}
    for tie in found.indistinguishable:
        named |= {*tie} if named & {*tie} else set()
    if "tool_length" not in named:
        return told.tool
    at, tool = model._places, told.tool
    beam = np.array(tool.doubt.beam)
    for one in found.candidates:
        if one.effect in ("tool_length", "tool_stiffness") and one.effect in named - {*told.written}:
            of = TOOL_CATALOGUE[one.effect].tool
            assert of is not None
            other = of(model.tool, np.array([p["value"] for p in one.parameters]))
            off = np.array([other.length_mm - tool.length_mm, other.stiffness_mn_mm2 - tool.stiffness_mn_mm2])
            beam += np.outer(off, off)
    longer = replace(model.tool, length_mm=model.tool.length_mm + 1.0,
                     distances_mm=nested(np.array(model.tool.distances_mm) + 1.0))  # fmt: skip
    moved, by_mm = (at.tip(one, at.feel(one)) - at.tip_mm for one in (tool, longer))
    deeper = float((moved * by_mm).sum() / (by_mm**2).sum())
    doubt = replace(tool.doubt, beam=nested(beam), deeper_mm=float(np.hypot(tool.doubt.deeper_mm, deeper)))
    return replace(tool, doubt=doubt)


@linalg.one_thread()
def applied(model: ToolModel, fit: Fit) -> Applied:
    """The tool of a model with the camera's offset and the effects of a fit to its rows written into it.

    The camera saw the tip at m + R (tip - m) + c, with the middle m of the run's places, the turn R of ``registration``
    and the offset c; its frame is turned and moved back by that.
    """
    tool, turn, why = model.tool, np.eye(3), {}
    for effect in fit.model.effects:
        values = fit.values[fit.model.owns(effect)]
        known = TOOL_CATALOGUE.get(effect.name)
        if effect.name == "registration":
            turn = rotation_of(values)[0]
        elif known is None or known.tool is None:
            why[effect.name] = f"{effect.name} has no key in a tool file. {known.remedy if known else ''}".strip()
        else:
            try:
                tool = known.tool(tool, values)
            except RobotError as error:
                why[effect.name] = f"{effect.name} cannot be written: {error}"
    offset = fit.values[: len(model.parameters)]
    middle = model.predict(model.readings, np.zeros(len(model.parameters))).mean(axis=0)
    shift = turn.T @ (np.array(tool.camera_translation_mm) - offset - middle) + middle
    rotation = scipy.spatial.transform.Rotation.from_matrix(turn.T @ tool.camera_rotation).as_rotvec()
    tool = replace(tool, camera_rotation_rad=nested(rotation), camera_translation_mm=nested(shift))
    written = tuple(e.name for e in fit.model.effects if e.name not in why)
    return Applied(tool, written, tuple(why), tuple(why.values()))
