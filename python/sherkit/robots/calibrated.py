"""Calibrations: what is deployed of any robot, from the runs that it is made of to its file.

A kind of robot says what it adds: its compiled chain, how parameters move its tool, and what people ask about it.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import tomli_w
from numpy.typing import ArrayLike

import sherkit._core as _core

from ..base.arguments import validate_arguments
from ..base.figures import listed
from ..base.notebook import Shown
from ..base.types import Bools
from ..data.called import Columns
from ..data.files import write_whole
from ..data.toml import Table, read_toml
from ..errors import CalibrationError, FitError, SherkitError
from ..fit.error import radius_95
from ..fit.identify import Fit
from ..model.batch import vector
from ..model.kinds import Robot, kind_of, known_kinds, robot_from_table
from .accuracy import Accurate
from .calibration_run import CalibrationRun, Corrected
from .deployed import BASE, SENSOR
from .identified_model import IdentifiedModel
from .unobserved_effects import Search

# -- Files --------------------------------------------------------------------------------------------------------

#: 2: what the poses of a run could not show is written beside what they did; before, accuracy left that out. 3: under
#: the key ``unobserved_effects``, which was ``unshown``. 4: how single readings scatter is apart from what the model
#: leaves; where it is not, as in earlier files, it is counted as that. 5: which frame its places are in; before, where
#: the instrument stood was not in it as the pose that it is.
FORMAT = 5


@contextmanager
def reading(path: Path, tables: dict[str, Any]) -> Iterator[Table]:
    """The tables of a file to read from; whatever is wrong with them is a :class:`CalibrationError` that names it."""
    try:
        yield Table(tables, str(path), error=CalibrationError)
    except (TypeError, ValueError, OverflowError, SherkitError) as error:
        said = str(error)
        raise CalibrationError(said if said.startswith(f"{path}: ") else f"{path}: {said}") from None


def tables_of(path: Path, kind: str | None = None) -> dict[str, Any]:
    """The tables of a calibration file, for a robot of this kind or, left out, of any.

    Raises :class:`~sherkit.errors.CalibrationError`.
    """
    tables = read_toml(path, "calibration", CalibrationError)
    settings = tables.get("calibration")
    before = settings.get("format") if isinstance(settings, dict) else None
    if isinstance(before, int) and not isinstance(before, bool) and 1 <= before < FORMAT:
        raise CalibrationError(
            f"{path}: was written by an earlier version ([calibration] format = {before}, expected {FORMAT}) and does "
            "not say in which frame its places are; calibrate again from the run"
        )
    if not isinstance(settings, dict) or settings.get("format") != FORMAT:
        raise CalibrationError(
            f"{path}: is not a calibration of this version (expected [calibration] format = {FORMAT})"
        )
    robot = tables.get("robot")
    found = robot.get("kind") if isinstance(robot, dict) else None
    if kind is not None and isinstance(found, str) and found != kind:
        raise CalibrationError(
            f"{path}: robot.kind: expected '{kind}', found '{found}'; sherkit.load_calibration reads every kind"
        )
    return tables


# -- Calibrations -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Note:
    """Something to know about a calibrated robot: its name (or none), a sentence, and the same for programs."""

    name: str
    text: str
    json: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.name}: {self.text}" if self.name else self.text


#: What the place is called from which moves begin.
MIDDLE = "middle of the run"


@dataclass(frozen=True)
class BesideBase:
    """How accurate a robot is at a place of its base that is called ``name``, as the sensor reads it, and in a move to
    there from the middle of the run, in the sensor's axes; NaN where no joints lead there, and for no move."""

    name: str
    sensor_mm: float
    move_mm: float


@dataclass(frozen=True, eq=False)
class Calibration(Shown, Accurate):
    """A calibrated robot: made from runs, deployed, asked how accurate it is, kept in a file."""

    #: How its parts are read from files, and which there may be; the first one must be.
    part: ClassVar[type[IdentifiedModel]] = IdentifiedModel
    #: The names of columns of its runs by ours, as the robot's file gave them.
    columns: Columns = field(default_factory=dict, kw_only=True)
    parts: ClassVar[tuple[str, ...]] = ("whole",)

    @property
    def parts_made(self) -> tuple[IdentifiedModel, ...]:
        """The parts that there are."""
        return tuple(part for name in self.parts if (part := getattr(self, name)) is not None)

    def notes(self) -> Sequence[Note]:
        """What else there is to know about what is deployed."""
        return ()

    @classmethod
    def require(cls, robot: Robot) -> None:
        """Raises :class:`~sherkit.errors.CalibrationError` where robots of this kind have no calibration."""
        if cls is Calibration:
            raise CalibrationError(
                f"a {robot.kind} robot has no calibration that could be deployed: its kind brings none"
            )

    @classmethod
    @abstractmethod
    def of(cls, whole: CalibrationRun, local: CalibrationRun | None = None) -> Self:
        """From a run over the workspace and, if given, one inside the region of interest."""

    @classmethod
    def from_runs(cls, whole: CalibrationRun, local: CalibrationRun | None = None) -> Self:
        """:meth:`of` these runs, knowing what their poses could not show."""
        made = cls.of(whole, local)
        runs = dict(zip(cls.parts, (whole, local), strict=False))
        parts = {}
        for name, run in runs.items():
            part = getattr(made, name)
            if part is not None and run is not None:
                search = Search(run, part, made.asked(part))
                parts[name] = replace(part, unobserved_effects=search.found(), untried=search.untried)
        return replace(made, **parts)

    @classmethod
    def require_region(cls, robot: Robot) -> None:
        """Raises :class:`~sherkit.errors.FitError` where a robot has no region of interest for a local run."""
        raise FitError(f"a {robot.kind} robot has no region of interest and no local run; join the runs instead")

    @classmethod
    def in_region(cls, fit: Fit) -> Bools | None:
        """Rows of a fit inside the region of interest (n,); None without a region."""
        del fit
        return None

    @classmethod
    def require_correction(cls, robot: Robot) -> None:
        """Raises :class:`~sherkit.errors.FitError` where robots of this kind have no correction that could be named."""
        raise FitError(f"a {robot.kind} robot has no correction of a paper; choose the correction auto or none")

    @classmethod
    def may_correct(cls, fit: Fit) -> bool:
        """Whether this kind of robot has a correction, and a run enough rows for one."""
        del fit
        return False

    @classmethod
    def correct(cls, fit: Fit, way: str = "auto", seed: int = 0) -> Corrected | None:
        """A smooth correction of what a fit leaves: ``auto`` chooses it, ``paper`` takes that of the robot's paper."""
        del fit, way, seed
        return None

    @classmethod
    def about(cls, fit: Fit) -> Sequence[Note]:
        """What a fit says about a robot of this kind beyond its parameters."""
        del fit
        return ()

    # -- moves: what both places are off by alike is no part of them -------------------------------------------------

    def move_accuracy(
        self, start: ArrayLike, end: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None
    ) -> float:
        """Radius, mm, within which the mean of many moves from ``start`` to ``end``, coordinates (k,) of a ``frame``,
        lies of the way commanded, in 95 of 100 cases.

        What turns or shifts all places alike (zeros that the drawing shares with its base, where the target sits) is in
        the accuracy of places, and not in that of a way between them. What the poses show, with what effects of the
        catalogue could do between both places that these did not show, as
        :meth:`~sherkit.robots.accuracy.Accurate.predicted_accuracies` has it. Both places are to be ruled by one part.
        Raises
        :class:`~sherkit.errors.OutOfReach`.
        """
        x = np.stack([self._place(start), self._place(end)])
        joints = self.inverse_batch(x, frame=frame, temperature_c=temperature_c).require("end of the move")
        return self.move_accuracy_with(joints[0], joints[1], frame=frame, temperature_c=temperature_c)

    def move_accuracy_with(
        self, start: ArrayLike, end: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None
    ) -> float:
        """:meth:`move_accuracy` from joints (j,) to joints (j,), which places alone may leave open. Raises
        :class:`~sherkit.errors.OutOfReach`."""
        where = self.frame_of(frame)
        joints = np.stack([vector(one, "joint readings", self._joints) for one in (start, end)])
        x = self.forward_batch(joints, temperature_c=temperature_c).require("end of the move")
        part: Any = self.part_at(x[0])
        now = self.moment_of(part, self._now(temperature_c))
        columns = np.where(self.counted(part, where), self.by_values(part, joints, now), 0.0)
        way = (columns[1] - columns[0])[None]
        left = self.left_at(part, x) * self.grown(part, self.beyond_poses(x, joints))[:, None, None]
        known = way @ part.covariance @ way.transpose(0, 2, 1) + left.sum(axis=0)
        # of the effect that could do most to the way; what was shown at the poses is left at both ends, and counted
        functions = part.functions(x)
        missed = ((one, self.missed(part, one, functions, joints, where, now[:2])) for one in part.unobserved_effects)
        unseen = (one.beyond((ends[1] - ends[0])[None]) for one, ends in missed)
        worst = max(unseen, key=lambda spread: float(np.trace(spread[0])), default=np.zeros_like(known))
        return self.reach_mm * float(radius_95(known + worst)[0])

    def beside_base(self) -> list[BesideBase]:
        """For a robot whose places are those of its base, and whose instrument stood elsewhere, at each of
        :meth:`places`; empty for any other."""
        if self.frame != BASE or SENSOR not in self.frames:
            return []
        places, out = self.places(), []
        middle = self.to_sensor(dict(places).get(MIDDLE, places[0][1])[None])[0]
        for name, place in places:
            there = self.to_sensor(place[None])[0]
            sizes = [float("nan")] * 2
            with suppress(SherkitError):  # what is out of reach is said where accuracy is
                sizes[0] = self.accuracy(there, frame=SENSOR)
                if name != MIDDLE:
                    sizes[1] = self.move_accuracy(middle, there, frame=SENSOR)
            out.append(BesideBase(name, *sizes))
        return out

    # -- files -------------------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Writes TOML that :meth:`load` reads back without loss."""
        parts = {name: getattr(self, name) for name in self.parts}
        made_by = {"format": FORMAT, "made_by": f"sherkit {_core.__version__}", "frame": self.frame}
        tables = {"calibration": made_by | self._settings(), "robot": self.robot.to_tables()}
        tables |= {"columns": dict(self.columns)} if self.columns else {}
        tables |= {name: p.to_table(self.robot, self.coordinates) for name, p in parts.items() if p is not None}
        write_whole(Path(path), tomli_w.dumps(tables))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Reads what :meth:`save` wrote; of any kind of robot, unless asked of the class of one.

        Raises :class:`~sherkit.errors.CalibrationError` naming file and key.
        """
        path = Path(path)
        kinds = known_kinds().items()
        known: dict[str, type[Self]] = {name: k.calibration for name, k in kinds if k.calibration is not None}
        own = next((name for name, made in known.items() if made is cls), None)
        tables = tables_of(path, own)
        if own is not None:
            return cls._from_tables(path, tables)
        robot = tables["robot"] if isinstance(tables.get("robot"), dict) else {}
        found = robot.get("kind")
        if isinstance(found, str) and found in known:
            return known[found]._from_tables(path, tables)
        if "machine" in robot:
            raise CalibrationError(
                f"{path}: is of the machine {found!r}, which is not known here: import the Python file that makes it "
                "first; sherkit verify and sherkit plan --verify take it as --machine FILE.py (no file of data runs "
                "code)"
            )
        raise CalibrationError(f"{path}: [robot] kind: expected one of {listed(known)}, found {found!r}")

    @classmethod
    def _from_tables(cls, path: Path, tables: dict[str, Any]) -> Self:
        with reading(path, tables) as table:
            with table.table("calibration") as c:
                c.pass_over("format", "made_by")
                c.text("frame", (cls.frame,))
                settings = cls._settings_from(c)
            with table.table("robot") as r:
                nominal = robot_from_table(r)
            with table.table("columns", optional=True) as named:
                settings |= {"columns": {name: named.words(name) for name in named.names()}}
            parts: dict[str, Any] = {}
            for name in cls.parts:
                if name == cls.parts[0] or table.has(name):
                    with table.table(name) as one:
                        parts[name] = cls.part.from_table(one, nominal, cls.coordinates)
            table.finish()
            return cls(robot=nominal, **parts, **settings)

    def _settings(self) -> dict[str, Any]:
        """What a kind keeps in [calibration] besides the format."""
        return {}

    @classmethod
    def _settings_from(cls, table: Table) -> dict[str, Any]:
        del table
        return {}

    def __repr__(self) -> str:
        effects = f", {', '.join(self.whole.effects)}" if self.whole.effects else ""
        return f"{type(self).__name__}({self.whole.rows} rows of {self.whole.made_from}{effects})"


def calibration_class(robot: Robot) -> type[Calibration]:
    """The class of a robot's calibrations; the base, which cannot be made, where its kind brings none."""
    made: type[Calibration] = kind_of(robot).calibration or Calibration
    return made


@validate_arguments
def load_calibration(path: str | Path) -> Calibration:
    """Reads a calibration of any robot.

    Raises :class:`~sherkit.errors.CalibrationError` naming file and key.

        calibration = sk.load_calibration("demo/calibrated.toml")
        joints = calibration.inverse([1.0, -2.0, 3.0])
    """
    return Calibration.load(path)
