"""A model whose robot is read by a sensor that stands somewhere: how well that is known, where a fit begins, and how
what is read is seen from the base."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
import scipy

import sherkit._core as _core

from ..base.types import Bools, Floats
from ..data import Measurements
from ..data.columns import Layout
from .base import ModelWithEffects
from .effect import Effect, Parameter
from .sensor_pose import (
    FREE,
    IN_PLANE,
    OWN_AXES,
    POSE,
    SPACE,
    Registered,
    SensorPose,
    Triple,
    as_places,
    registered,
    slip_of,
)
from .set_ups import effect_of, seen_from_the_last
from .tolerances import stated_sizes

#: A turn by so little, rad, moves no arrow of a picture.
_TO_THE_EYE = 0.02


@dataclass(frozen=True)
class SeenModel(ModelWithEffects):
    """What every model of a measurement chain knows of its sensor; see :class:`~sherkit.model.chain.ChainModel`."""

    #: How well the sensor's pose is known where the robot's file leaves it open: along its axes, mm, and about them,
    #: degrees.
    usual_pose_sd: ClassVar[tuple[Triple, Triple]] = (FREE, FREE)
    layouts: ClassVar[tuple[Layout, ...]]
    #: The numbers of the set-ups before the last, see :mod:`~sherkit.model.set_ups`: no effects that could be missing.
    set_ups: tuple[Effect, ...] = field(default=(), kw_only=True)

    # -- what the chain says -------------------------------------------------------------------------------

    @property
    @abstractmethod
    def core_parameters(self) -> Sequence[Parameter]:
        """Every parameter of the chain, in its order."""

    @abstractmethod
    def full(self, values: Floats) -> Floats:
        """Values of the chain's parameters, the identified ones among zeros."""

    @abstractmethod
    def drawn(self, data: Measurements) -> tuple[Floats, Bools]:
        """What the chain reads as drawn (n, m), and which rows could be computed."""

    @abstractmethod
    def require_own(self, data: Measurements) -> None:
        """Raises :class:`~sherkit.errors.FitError` for a run of another kind of robot."""

    # -- how well its pose is known ------------------------------------------------------------------------

    @property
    def sensor_pose(self) -> SensorPose:
        """Where the sensor stands by the robot's file; a robot that says nothing of it is read in its own axes."""
        robot: Any = self.robot
        pose: SensorPose = getattr(robot, "sensor_pose", OWN_AXES)
        return pose

    @cached_property
    def pose_sd(self) -> Floats:
        """How well each number of the sensor's pose is known (6,), rad and mm: infinite where it is free, 0 where it is
        held."""
        return self.sensor_pose.sd(*self.usual_pose_sd)

    @cached_property
    def free_of_pose(self) -> tuple[str, ...]:
        """As of any model."""
        return tuple(name for name, sd in zip(POSE, self.pose_sd, strict=True) if np.isinf(sd))

    @cached_property
    def stands_anywhere(self) -> tuple[str, ...]:
        """As of any model; of readings in a plane three numbers are all."""
        in_plane = all(one.coordinates == SPACE[:2] for one in self.layouts)
        whole = IN_PLANE if in_plane else POSE
        return whole if set(whole) <= {*self.free_of_pose} & {p.name for p in self.parameters} else ()

    def as_known(self, parameter: Parameter) -> Parameter:
        """A parameter of the table, as well as it is known by the robot's file; of the sensor's pose as that is."""
        if parameter.name not in POSE:
            size, known = self.stated_sizes.get(parameter.name, (parameter.size, parameter.known))
            return replace(parameter, size=size, known=known)
        sd = float(self.pose_sd[POSE.index(parameter.name)])
        return replace(parameter, size=sd, known=True) if 0 < sd < np.inf else parameter

    @cached_property
    def stated_sizes(self) -> Mapping[str, tuple[float, bool]]:
        """Sizes that the robot's file states, see :mod:`~sherkit.model.tolerances`."""
        return stated_sizes(self.robot, tuple(self.unstated_base()))

    @abstractmethod
    def unstated_base(self) -> Iterable[Parameter]:
        """Parameters of the table as the robot's kind has them, whatever its file states."""

    def held_of_pose(self, name: str) -> bool:
        """Whether a parameter is a number of the sensor's pose that the robot's file holds."""
        return name in POSE and self.pose_sd[POSE.index(name)] == 0

    # -- where a fit begins --------------------------------------------------------------------------------

    def reads_places(self, data: Measurements) -> bool:
        """Whether readings such as these are places, in space or in a plane, mm."""
        return data.layout.coordinates in (SPACE, SPACE[:2])

    def start(self, data: Measurements) -> Floats:
        """The drawing, seen from where the sensor must stand for most of these rows to be as they are: it may stand
        anywhere where all of its pose is free, and a turn of half a circle is too far for steps from none."""
        out = super().start(data)
        found = self.registration(data) if self.stands_anywhere and self.reads_places(data) else None
        if found is not None:
            at, of = self._places_of_pose
            out[at] = found[of]
        return out

    @cached_property
    def _places_of_pose(self) -> tuple[list[int], list[int]]:
        """Where the numbers of the sensor's pose that are free stand among the parameters, and among all six."""
        names = [p.name for p in self.parameters]
        return [names.index(name) for name in self.stands_anywhere], [POSE.index(n) for n in self.stands_anywhere]

    def registration(self, data: Measurements) -> Floats | None:
        """By how much the sensor's pose (6,) is off that of the robot's file, rad and mm, where most of these rows are
        as the drawing has them; None where too few tell it."""
        pose, size = self.sensor_pose, data.coordinates
        if not data.taken[:, size - 1].any():
            size -= 1  # heights that were not read leave a plane
        whole = data.used[:, :size]
        found = self.registered(data if whole.all() else data.select(np.flatnonzero(whole.all(axis=1))), size)
        if found is None:
            return None
        off = _core.rotation_vector(np.ascontiguousarray(found.turn @ pose.turn.T))
        return np.concatenate([off, found.shift_mm - pose.origin_mm])

    def registered(self, seen: Measurements, size: int, *, mirrored: bool = False) -> Registered | None:
        """The transform from the base to where most of these rows were read, by the drawing and the first ``size``
        coordinates, of which all were taken; None where too few tell it."""
        self.require_own(seen)
        pose = self.sensor_pose
        shown, _ = self.drawn(seen)  # NaN where it cannot be computed
        found = registered(as_places(shown[:, :size]), as_places(seen.readings[:, :size]), mirrored=mirrored)
        if found is None:
            return None
        # what is shown is turned and shifted already as the file says
        shift = found.turn @ pose.origin_mm + found.shift_mm
        return Registered(found.turn @ pose.turn, shift, found.missed_mm)

    # -- where it was moved in between ---------------------------------------------------------------------

    @cached_property
    def own(self) -> tuple[Effect, ...]:
        """As of any model, behind what the set-ups before the last have of their own."""
        return (*self.set_ups, *(e for e in self.effects if e.function is not None))

    def as_declared(self, data: Measurements) -> Measurements:
        """As of any model, and as the last set-up of the instrument would have shown them."""
        return seen_from_the_last(self, super().as_declared(data))

    def for_run(self, data: Measurements) -> Self:
        """As of any model, with the poses of the set-ups before the last."""
        made = super().for_run(data)
        known = {one.name for one in made.set_ups}
        new = [one for one in (effect_of(made, each) for each in data.set_ups) if one.name not in known]
        return replace(made, set_ups=(*made.set_ups, *new)) if new else made

    # -- as it was identified ------------------------------------------------------------------------------

    def sensor_frame(self, values: Floats, *, slipped: bool = False) -> tuple[Floats, Floats]:
        """From the base to the sensor as identified: the turn (3, 3) and the shift (3,), mm; once it has ``slipped``
        those from then on."""
        known = dict(zip((p.name for p in self.core_parameters), self.full(values).tolist(), strict=True))
        off = np.array([known.get(name, 0.0) + slipped * known.get(slip_of(name), 0.0) for name in POSE])
        by = scipy.spatial.transform.Rotation.from_rotvec(off[:3]).as_matrix()
        return by @ self.sensor_pose.turn, np.array(self.sensor_pose.origin_mm) + off[3:]

    def at_base(self, places_mm: Floats, values: Floats) -> Floats:
        """What the sensor shows (n, c) as coordinates of the base, by where it was identified to stand; what is read in
        the robot's own axes stays as it is."""
        turn, shift = self.sensor_frame(values)
        if (turn == np.eye(3)).all() and not shift.any():
            return places_mm
        return ((as_places(places_mm) - shift) @ turn)[:, : places_mm.shape[1]]

    def axes_of_readings(self, data: Measurements, values: Floats) -> Floats | None:
        """The turn (c, c) from the base's axes to those in which readings of places are shown; None where they are
        the same to the eye, or the readings are no places."""
        turn = self.sensor_frame(values)[0][: data.coordinates, : data.coordinates]
        return (
            turn
            if self.reads_places(data) and not np.allclose(turn, np.eye(len(turn)), rtol=0, atol=_TO_THE_EYE)
            else None
        )
