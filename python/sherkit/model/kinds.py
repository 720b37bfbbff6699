"""The kinds of robot that are known: what each brings, asked for by the robot's own ``kind``.

A robot's folder says what it brings as a :class:`Kind`; ``robots/__init__.py`` makes it known. Nothing else asks which
robot it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Protocol, Self, overload, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from ..base import built_in
from ..base.figures import brief, listed
from ..base.types import Floats, Ints
from ..data import Measurements
from ..data.columns import LAYOUTS, Layout, know
from ..data.toml import Table
from ..errors import FitError, RobotError, ShapeError
from .any import Extended, Model
from .base import ModelWithEffects
from .batch import Batch
from .chain import ChainModel
from .drawing import Draw, drawing_of_readings
from .effect import Effect
from .tolerances import stated_by

#: What a plan may ask of a set of poses: more nobody measures, and no memory holds.
MOST_PER_SIDE, MOST_IN_LINE = 300, 100_000
_ORDERS = ("planes", "shuffled")


@runtime_checkable
class Robot(Protocol):
    """A nominal robot, as on its drawing: immutable, read from TOML and written to it.

    Joint readings are in ``joint_unit``, ``mm`` or ``rad``; what :meth:`forward` gives are the coordinates of its
    kinematics, in mm or rad.
    """

    @property
    def kind(self) -> str:
        """The name under which its :class:`Kind` is known."""
        ...

    @property
    def joint_unit(self) -> str:
        """Unit of the joint readings."""
        ...

    @property
    def joint_limits(self) -> tuple[float, float] | None:
        """Lowest and highest reading to which a motor may go, in ``joint_unit``; None where the file names none."""
        ...

    @property
    def middle(self) -> tuple[float, ...]:
        """Coordinates of the middle of its workspace: where an experiment begins and ends."""
        ...

    def forward(self, joints: ArrayLike, /) -> Floats:
        """Coordinates for joint readings."""
        ...

    def inverse(self, coordinates: ArrayLike, /) -> Floats:
        """Joint readings for coordinates. Raises :class:`~sherkit.errors.OutOfReach`."""
        ...

    def inverse_batch(self, coordinates: ArrayLike, /) -> Batch:
        """Joint readings for rows of coordinates; those out of reach are marked."""
        ...

    def to_tables(self) -> dict[str, Any]:
        """The tables of its file, without loss."""
        ...


def required_um(robot: object) -> float | None:
    """The accuracy that a robot is for, µm, where its file says so (``required_um`` in ``[workspace]``)."""
    stated: float | None = getattr(robot, "required_um", None)
    return stated


@dataclass(frozen=True)
class Option:
    """The size of an error that a user chooses for a virtual robot: its ``default``, and what it is, in words."""

    default: float
    what: str
    signed: bool = False


class Virtual(Protocol):
    """A robot with hidden errors, to try things on."""

    #: What a user can choose besides the size of the geometric errors, by name with its unit.
    OPTIONS: ClassVar[Mapping[str, Option]]

    @property
    def robot(self) -> Any:
        """The robot as drawn."""
        ...

    @classmethod
    def simulated(cls, robot: Any, seed: int, errors: float, sizes: Mapping[str, float], /) -> Self:
        """One with geometric errors of ``errors`` times the plausible size, and ``sizes`` of each of the options."""
        ...

    @classmethod
    def hidden(cls, robot: Any, seed: int, table: Table, /) -> Self:
        """One without noise, as the table ``[hidden]`` of a laboratory describes it."""
        ...

    def truth(self) -> dict[str, Any]:
        """The hidden errors, for TOML."""
        ...

    def noise_free(self, joints: ArrayLike, /) -> Floats:
        """What a run without noise would hold (n, k), for joint readings (n, j) or those of one pose (j,).

        Raises :class:`~sherkit.errors.OutOfReach`.
        """
        ...

    def measure(self, coordinates: ArrayLike, /, *, repeats: int, order: str, seed: int) -> Measurements:
        """A run over these coordinates, reached as the drawing has it."""
        ...


def walked(poses: int, repeats: int, order: str, rng: np.random.Generator) -> tuple[Ints, dict[str, Ints]]:
    """Which pose each row (n,) of a virtual robot's run is at, and the columns of a run that say so, counted from 1.

    ``planes``: as listed, pass after pass; ``shuffled``: anew for each pass. Raises
    :class:`~sherkit.errors.ShapeError`.
    """
    if order not in _ORDERS:
        raise ShapeError(f"order: '{order}' is not known; choose {' or '.join(_ORDERS)}")
    if repeats < 1:
        raise ShapeError(f"repeats: expected at least 1, got {repeats}")
    listed = np.arange(poses)
    pose = np.concatenate([rng.permutation(listed) if order == "shuffled" else listed for _ in range(repeats)])
    return pose, {"pose": pose + 1, "repeat": np.repeat(np.arange(repeats) + 1, poses)}


@runtime_checkable
class SeenInPictures(Protocol):
    """A virtual robot at which a camera looks."""

    @property
    def eye(self) -> Any:
        """The camera."""
        ...

    def plan(self, coordinates: ArrayLike, /, *, repeats: int, order: str, seed: int) -> dict[str, Floats]:
        """The columns of a run, but for what is seen."""
        ...

    def markers(self, joints: Floats, /) -> Floats:
        """Where the marker is (n, 3), mm in the base frame."""
        ...

    def axes(self, joints: Floats, /) -> Floats:
        """Where it faces (n, 3), unit vectors in the base frame."""
        ...


@dataclass(frozen=True)
class RequiredSetting:
    """A setting of a robot file that may be left out, but not in silence: ``key`` of ``table``.

    ``without`` says what cannot be tried or is assumed without it, ``instead`` what to write, also by whoever has none.
    """

    table: str
    key: str
    without: str
    instead: str

    def __str__(self) -> str:
        return f"[{self.table}] {self.key} is left out: {self.without}; {self.instead}"


def _read_as_meant(_: Any) -> Iterator[tuple[str, str, Any]]:
    yield from ()


@dataclass(frozen=True)
class Kind:
    """What a kind of robot brings.

    ``robot`` reads itself from a file (``from_table``); ``model`` is made for it; ``layouts`` are the columns of its
    runs, those of an experiment first; ``calibration`` is the class of what is deployed, a
    :class:`~sherkit.robots.calibrated.Calibration`, or None where nothing is; ``virtual`` is a robot with hidden
    errors, to try things on.

    ``coordinates`` are what its ``forward`` gives, as columns. ``poses`` are the sets of poses that a plan can name:
    coordinates (n, k) for a robot and the keys of the plan. The one called ``grid`` covers a region, from which the
    best poses can be chosen. ``areas`` are the poses of ``sherkit simulate`` for a robot, over all of its workspace and
    a part of it. ``signature`` gives the places (n, 3) that an effect is drawn at and what is left of it there (n, 3),
    mm; None where it is not drawn. ``called`` is what people call it, such as "the linear delta". ``choices`` are the
    words from which keys of its table ``[geometry]`` choose; its attributes have the same names.
    ``asks`` are the settings of its file that are asked for where they are left out. ``example`` is a robot of this
    kind, whole, to show what its files hold; ``spelt`` are other ways to write tables of its file. ``own_layouts`` are
    those of one robot, where its columns are not those of every other of its kind, as the joints of an arm are not.
    ``misread`` gives the robots that a file may have meant which was written otherwise than it is read, each with what
    looks wrong and what to do. ``drawing`` gives its mechanism for each row of a run, by its model and the values of
    its parameters.
    """

    name: str
    robot: type[Any]
    model: type[ChainModel]
    layouts: tuple[Layout, ...]
    calibration: type[Any] | None
    virtual: type[Virtual] | None = None
    coordinates: tuple[str, ...] = ()
    poses: Mapping[str, Callable[[Any, Table], Floats]] = field(default_factory=dict)
    grid: str = ""
    areas: Mapping[str, Callable[[Any], Floats]] = field(default_factory=dict)
    signature: Callable[[Effect, Any], tuple[Floats, Floats]] | None = None
    called: str = ""
    choices: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    asks: tuple[RequiredSetting, ...] = ()
    example: Any = None
    spelt: tuple[Mapping[str, Mapping[str, Any]], ...] = ()
    own_layouts: Callable[[Any], tuple[Layout, ...]] | None = None
    misread: Callable[[Any], Iterator[tuple[str, str, Any]]] = _read_as_meant
    drawing: Draw = drawing_of_readings

    @property
    def title(self) -> str:
        """What people call it; by its name where nothing else is said."""
        return self.called or f"the {self.name} robot"

    @property
    def layout(self) -> Layout:
        """The columns of the run that an experiment gives."""
        return self.layouts[0]

    @property
    def place_unit(self) -> str:
        """The unit in which the columns of an experiment show where the robot is."""
        return self.layout.coordinates[0].rpartition("_")[2]

    @property
    def shows_coordinates(self) -> bool:
        """Whether what instruments show of it is what its kinematics gives."""
        return self.layout.coordinates == self.coordinates

    def require_virtual(self) -> type[Virtual]:
        """The virtual robot. Raises :class:`~sherkit.errors.RobotError` for a kind without one."""
        if self.virtual is None:
            raise RobotError(f"{self.name} robots have no virtual one: there is nothing to simulate them with")
        return self.virtual


#: The kinds that were made known so far; :func:`known_kinds` are all.
KINDS: dict[str, Kind] = {}


def known_kinds() -> dict[str, Kind]:
    """Every kind of robot by name, the built-in ones first."""
    built_in.load()
    return KINDS


def register(kind: Kind) -> None:
    """Makes a kind known, its runs and its files.

    Raises :class:`~sherkit.errors.RobotError` for one that lacks what every verb asks of it.
    """
    known = known_kinds()
    if not (isinstance(kind.model, type) and issubclass(kind.model, ChainModel)):
        raise RobotError(f"the Kind '{kind.name}': model: expected a class below ChainModel, got {brief(kind.model)}")
    if not (isinstance(kind.layouts, tuple) and all(isinstance(one, Layout) for one in kind.layouts)):
        raise RobotError(f"the Kind '{kind.name}': layouts: expected a tuple of Layout, got {brief(kind.layouts)}")
    if not hasattr(kind.robot, "forward"):
        raise RobotError(f"the Kind '{kind.name}': robot: expected the class of a robot, got {brief(kind.robot)}")
    know(*kind.layouts)
    known[kind.name] = kind


@contextmanager
def known_as(kind: Kind) -> Iterator[None]:
    """Within it this kind has its name, its files and its runs, whoever had them before and has them again after it."""
    known, held = known_kinds(), known_kinds().get(kind.name)
    layouts = list(LAYOUTS)
    LAYOUTS[:] = [one for one in layouts if held is None or one not in held.layouts]
    try:
        register(kind)
        yield
    finally:
        LAYOUTS[:] = layouts
        if held is None:
            known.pop(kind.name, None)
        else:
            known[kind.name] = held


def robot_from_tables(values: dict[str, object], where: str) -> Robot:
    """Reads a robot from parsed TOML tables; ``where`` names the source in errors."""
    table = Table(values, where)
    robot = robot_from_table(table)
    table.finish()
    return robot


def kind_of(robot: Robot) -> Kind:
    """What the robot's kind brings, or a machine of the user's by itself (``brings``).

    Raises :class:`~sherkit.errors.RobotError` for a kind that nobody made known.
    """
    own = getattr(robot, "brings", None)
    if isinstance(own, Kind):
        return own
    known = known_kinds()
    if robot.kind not in known:
        raise RobotError(f"{robot.kind} robots are not known; there are {listed(known)}")
    kind = known[robot.kind]
    return kind if kind.own_layouts is None else replace(kind, layouts=kind.own_layouts(robot))


def robot_from_table(table: Table) -> Robot:
    """Reads a robot from a table that may stand in another file.

    A machine of the user's is never made from a file, which would run code: it must be there.
    """
    known = known_kinds()
    if table.has("machine") and table.words("kind") not in known:
        raise table.refuse(
            f"is of the machine '{table.words('kind')}', which is not known here: import the Python file that makes it "
            "first (no file of data runs code)"
        )
    robot: Robot = known[table.text("kind", tuple(known))].robot.from_table(table)
    if any(stated_by(robot)):
        try:
            _ = kind_of(robot).model(robot).stated_sizes
        except RobotError as error:
            raise table.saying(str(error)) from None
    return robot


@overload
def model_of(model: Robot | ChainModel, free: Sequence[str] = ()) -> ChainModel: ...
@overload
def model_of(model: Robot | Model | ModelWithEffects, free: Sequence[str] = ()) -> ModelWithEffects: ...
def model_of(model: Robot | Model | ModelWithEffects, free: Sequence[str] = ()) -> ModelWithEffects:
    """The model of a robot, with these parameters ``free`` (by default those of its kind); that of any other machine,
    so that effects can be added to it; a model with effects as it is.

    Raises :class:`~sherkit.errors.FitError` for what is none of them, or a choice of parameters that a model lacks.
    """
    if isinstance(model, ModelWithEffects):
        if not free:
            return model
        if not isinstance(model, ChainModel):
            raise FitError("free: this model says itself which of its parameters are free")
        return replace(model, free=tuple(free))
    kind = getattr(model, "kind", None)
    if isinstance(kind, str) and kind in known_kinds():
        return kind_of(model).model(model, tuple(free))  # type: ignore[arg-type]
    if isinstance(model, Model):
        return model_of(Extended(model), free)
    raise FitError(
        f"expected a robot, or a model with parameters, predict, derivatives and covariates; got {type(model).__name__}"
    )


def draw_of(model: ModelWithEffects) -> Draw:
    """How the machine of a model is drawn: as its kind says, as a model with a ``drawing`` of its own says, or by its
    readings."""
    if model.robot is not None:
        return kind_of(model.robot).drawing
    own: Draw | None = getattr(getattr(model, "plain", None), "drawing", None)
    return own or drawing_of_readings


def catalogue_of(robot: Robot) -> Mapping[str, Effect]:
    """The built-in effects of a robot by name, in the order of the chain."""
    return model_of(robot).known_effects
