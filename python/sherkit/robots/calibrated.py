"""Calibrations: what is deployed of any robot, from the runs that it is made of to its file.

A kind of robot says what it adds: its compiled chain, how parameters move its tool, and what people ask about it.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import tomli_w

import sherkit._core as _core

from ..base.arguments import validate_arguments
from ..base.figures import listed
from ..base.notebook import Shown
from ..base.types import Bools
from ..data.files import write_whole
from ..data.toml import Table, read_toml
from ..errors import CalibrationError, FitError, SherkitError
from ..fit.identify import Fit
from ..model.kinds import Robot, kind_of, known_kinds, robot_from_table
from .calibration_run import CalibrationRun, Corrected
from .identified_model import IdentifiedModel
from .moves import Moving
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


@dataclass(frozen=True, eq=False)
class Calibration(Shown, Moving):
    """A calibrated robot: made from runs, deployed, asked how accurate it is, kept in a file."""

    #: How its parts are read from files, and which there may be; the first one must be.
    part: ClassVar[type[IdentifiedModel]] = IdentifiedModel
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

    # -- files -------------------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Writes TOML that :meth:`load` reads back without loss."""
        parts = {name: getattr(self, name) for name in self.parts}
        made_by = {"format": FORMAT, "made_by": f"sherkit {_core.__version__}", "frame": self.frame}
        tables = {"calibration": made_by | self._settings(), "robot": self.robot.to_tables()}
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
        if own is None:
            robot = tables.get("robot")
            found = robot.get("kind") if isinstance(robot, dict) else None
            if not isinstance(found, str) or found not in known:
                if isinstance(robot, dict) and "machine" in robot:
                    raise CalibrationError(
                        f"{path}: is of the machine {found!r}, which is not known here: import the Python file that "
                        "makes it first; sherkit verify and sherkit plan --verify take it as --machine FILE.py (no "
                        "file of data runs code)"
                    )
                raise CalibrationError(f"{path}: [robot] kind: expected one of {listed(known)}, found {found!r}")
            return known[found]._from_tables(path, tables)
        return cls._from_tables(path, tables)

    @classmethod
    def _from_tables(cls, path: Path, tables: dict[str, Any]) -> Self:
        with reading(path, tables) as table:
            with table.table("calibration") as c:
                c.pass_over("format", "made_by")
                c.text("frame", (cls.frame,))
                settings = cls._settings_from(c)
            with table.table("robot") as r:
                nominal = robot_from_table(r)
            parts = {}
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
