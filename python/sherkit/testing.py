"""For who writes a robot: everything that sherkit asks of a kind, asked of yours.

    import sherkit.testing
    from my_package import KIND


    def test_my_robot():
        sherkit.testing.check_robot(KIND)

It needs no pytest, and makes all of its runs with the kind's own virtual robot.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from .base.arguments import validate_arguments
from .base.types import Floats
from .calibration import calibrate
from .data import Measurements
from .data.toml import Table, read_toml
from .diagnosis import diagnose
from .errors import SherkitError
from .fit import identify
from .model.base import missing_columns
from .model.chain import ChainModel
from .model.effect import WITHIN
from .model.kinds import Kind, Robot, kind_of, known_as, model_of
from .model.robot_file import save_robot
from .robots.calibrated import load_calibration
from .study import Study

#: Rows at which derivatives are compared with differences, and the part of a parameter's plausible size that is a step.
_ROWS, _STEP = 8, 1e-3
#: Differences, places and covariances agree to this part.
_CLOSE = 1e-5
_SEEDS = (1, 2, 3, 4, 5)
#: Runs without an effect of which as many may raise an alarm: at a level of 1 % two in five are a defect.
_ALARMS = 1


@dataclass(frozen=True)
class _CheckedKind:
    """A kind and one robot of it, with what several checks need."""

    kind: Kind
    robot: Any

    @cached_property
    def poses(self) -> Floats:
        """Coordinates over its workspace."""
        _require(bool(self.kind.areas), "areas: expected the poses of 'sherkit simulate', at least one set")
        area = self.kind.areas.get("whole") or next(iter(self.kind.areas.values()))
        return np.asarray(area(self.robot), dtype=float)

    @property
    def places(self) -> Floats:
        """Where these poses are; poses of an arm that reaches a place in many ways are its joints."""
        if not self.kind.areas:
            return np.array([self.robot.middle])
        if self.poses.shape[1] == len(self.kind.coordinates):
            return self.poses
        return np.array([self.robot.forward(joints) for joints in self.poses])

    def run(self, errors: float = 1.0, seed: int = 1, repeats: int = 2, quiet: bool = False) -> Measurements:
        """A run of its virtual robot: geometric errors, noise, no effect."""
        virtual = self.kind.require_virtual()
        sizes = {name: 0.0 if quiet or not name.startswith("noise") else one.default
                 for name, one in virtual.OPTIONS.items()}  # fmt: skip
        made = virtual.simulated(self.robot, seed, errors, sizes)
        return made.measure(self.poses, repeats=repeats, order="shuffled", seed=seed + 1)

    @cached_property
    def usual(self) -> Measurements:
        """The run that most checks look at."""
        return self.run()

    @cached_property
    def model(self) -> ChainModel:
        """Its model, as it is drawn."""
        return model_of(self.robot)


class _NotAskedError(Exception):
    """The kind brings nothing that could be asked."""


def _require(holds: bool, what: str) -> None:
    if not holds:
        raise AssertionError(what)


def _names(a: _CheckedKind) -> None:
    """The kind has a name, columns of runs with units, and coordinates that are columns."""
    _require(a.kind.name == a.robot.kind, f"kind: robots say '{a.robot.kind}', the Kind is '{a.kind.name}'")
    own = kind_of(a.robot)
    same = own.model is a.kind.model and own.robot is a.kind.robot and own.calibration is a.kind.calibration
    _require(same, "brings: the robot brings a Kind of its own, which is used for it; give that one")
    _require(bool(a.kind.layouts), "layouts: expected the columns of a run, at least one set")
    for layout in a.kind.layouts:
        names = (*layout.joints, *layout.coordinates)
        _require(len(set(names)) == len(names), f"layouts: two columns have one name: {', '.join(names)}")
    _require(bool(a.kind.coordinates), "coordinates: expected what forward gives, as columns")


def _file(a: _CheckedKind) -> None:
    """A robot is the same once it was written and read, and an unknown key of its file is refused."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.toml"
        tables = a.robot.to_tables()
        save_robot(a.robot, path)
        table = Table(read_toml(path, "robot"), str(path))
        table.text("kind", (a.kind.name,))
        again = a.kind.robot.from_table(table)
        table.finish()
        _require(again == a.robot, "from_table(to_tables()): is another robot")
        wrong = Table(tables | {"no_such_key": 1}, str(path))
        wrong.text("kind", (a.kind.name,))
        try:
            a.kind.robot.from_table(wrong)
            wrong.finish()
        except SherkitError:
            return
    raise AssertionError("from_table: takes a key that nobody knows; read tables with Table and its methods")


def _there_and_back(a: _CheckedKind) -> None:
    """The joints that inverse gives lead where they should, one pose at a time and many."""
    places = a.places
    found = a.robot.inverse_batch(places)
    _require(bool(found.reached.all()), f"areas: {(~found.reached).sum()} poses of {len(places)} cannot be reached")
    size = max(float(np.abs(places).max()), 1.0)
    for place, joints in zip(places, found.values, strict=True):
        one = np.asarray(a.robot.inverse(place))
        _require(np.allclose(one, joints, rtol=1e-9, atol=1e-9), "inverse and inverse_batch: do not agree")
        back = np.asarray(a.robot.forward(joints))
        told = f"forward(inverse({place.tolist()})): is {back.tolist()}"
        _require(np.allclose(back, place, atol=_CLOSE * size), told)


def _every_effect(a: _CheckedKind) -> Iterator[tuple[ChainModel, str]]:
    """The model with each effect of the catalogue that the run allows."""
    for name, effect in a.model.known_effects.items():
        if name in (*WITHIN, *(e.name for e in a.model.effects)) or missing_columns(effect, a.usual):
            continue
        at = 0.4 * float(np.ptp(a.usual.joints)) if effect.is_periodic or effect.goes_with else None
        yield a.model.with_effect(effect, at=at), name


def _zero_is_none(a: _CheckedKind) -> None:
    """An effect whose parameters are zero changes nothing, also on rows without its column."""
    rows = a.usual.select(np.arange(_ROWS))
    plain = a.model.predict(rows, np.zeros(len(a.model.parameters)))
    for model, name in _every_effect(a):
        same = model.predict(rows, np.zeros(len(model.parameters)))
        _require(np.allclose(same, plain, rtol=0, atol=1e-12, equal_nan=True), f"{name}: is not zero at zero")


def _derivatives(a: _CheckedKind) -> None:
    """Derivatives are those of the readings, for geometry and every effect."""
    rows = a.usual.select(np.arange(_ROWS))
    for model, name in ((a.model, "geometry"), *_every_effect(a)):
        sizes = np.array([p.size for p in model.parameters])
        values = 0.3 * sizes
        columns = model.derivatives(rows, values)
        for k, parameter in enumerate(model.parameters):
            step = np.where(np.arange(len(sizes)) == k, _STEP * sizes[k], 0.0)
            change = model.predict(rows, values + step) - model.predict(rows, values - step)
            found = 2.0 * _STEP * sizes[k] * columns[:, :, k]
            scale = max(float(np.nanmax(np.abs(change))), 1e-9)
            _require(
                np.allclose(found, change, rtol=0, atol=1e-3 * scale, equal_nan=True),
                f"{name}: the derivative by {parameter.name} is not that of the readings",
            )


def _sentences(a: _CheckedKind) -> None:
    """Every effect says its physics, how it shows and what to do, and has parameters with a unit and a size."""
    for name, effect in a.model.known_effects.items():
        said = {"physics": effect.physics, "residuals": effect.residuals, "remedy": effect.remedy}
        for what, text in said.items():
            _require(bool(text.strip()), f"{name}: has no {what}")
        _require(all(p.size > 0 for p in effect.parameters), f"{name}: a parameter has no plausible size")


def _geometry(a: _CheckedKind) -> None:
    """Without noise the geometric errors of the virtual robot are fitted to nothing."""
    fit = identify(a.robot, a.run(quiet=True))
    left = fit.error_by(0).rms
    _require(left < 1e-3 * fit.nominal_error.rms, f"a run without noise leaves {left:.3g} of {fit.nominal_error}")


def _quiet(a: _CheckedKind) -> None:
    """Where nothing is hidden nothing is found."""
    told = []
    for seed in _SEEDS:
        found = diagnose(a.robot, a.run(seed=seed))
        if found.effects or found.verdict not in ("adequate", "undecided"):
            told.append(f"seed {seed}: {found.headline}")
    _require(len(told) <= _ALARMS, f"alarms where nothing is hidden: {'; '.join(told)}")


def _deployed(a: _CheckedKind) -> None:
    """A calibration is the same once it was written and read, leads where it should, and says how well."""
    if a.kind.calibration is None:
        raise _NotAskedError
    made = calibrate(a.robot, a.usual, correction="none").calibration
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "calibrated.toml"
        made.save(path)
        again = load_calibration(path)
    place = np.asarray(made.forward(a.robot.inverse(a.robot.middle)))
    joints = made.inverse(place)
    _require(np.allclose(again.inverse(place), joints, rtol=0, atol=1e-9), "a calibration read again is another one")
    size = max(float(np.abs(place).max()), 1.0)
    _require(np.allclose(made.forward(joints), place, atol=_CLOSE * size), "forward(inverse(place)): is elsewhere")
    _require(0.0 < made.accuracy(place) < size, "accuracy: expected a size in the unit of the coordinates")


def _studied(a: _CheckedKind) -> None:
    """A study goes a step and back, and is the same once it was written and read."""
    study = Study(a.robot, a.usual)
    before = study.fit.values.copy()
    plain = [model.effects[-1] for model, _ in _every_effect(a) if not model.effects[-1].search]
    if not plain:
        raise _NotAskedError
    study.add(plain[0].name)
    study.undo()
    _require(bool(np.allclose(study.fit.values, before)), "undo: is not what was before")
    with tempfile.TemporaryDirectory() as folder:
        study.save(folder)
        _require(bool(np.allclose(Study.load(folder).fit.values, before)), "load: is not what was saved")


#: What is asked, in order; those of the second list need a virtual robot.
_OF_ROBOTS: tuple[Callable[[_CheckedKind], None], ...] = (_names, _file, _there_and_back, _sentences)
_OF_RUNS: tuple[Callable[[_CheckedKind], None], ...] = (
    _zero_is_none,
    _derivatives,
    _geometry,
    _quiet,
    _deployed,
    _studied,
)


@validate_arguments
def check_robot(kind: Kind, robot: Robot | None = None) -> tuple[str, ...]:
    """Asks a kind of robot everything that sherkit relies on; ``robot`` is one of the kind, by default its ``example``.

    Returns the statements that hold, in words. Those about runs are asked of kinds that bring a virtual robot; it must
    not share its formulas with the model, or nothing is shown by them. Raises :class:`AssertionError` with all
    statements that do not hold, and why. The kind that is given is asked, also where another is known by its name.
    """
    one = kind.example if robot is None else robot
    if one is None:
        raise AssertionError(f"{kind.name}: has no example; give a robot: check_robot(KIND, robot)")
    asked = _CheckedKind(kind if kind.own_layouts is None else replace(kind, layouts=kind.own_layouts(one)), one)
    held, failed = [], []
    with known_as(kind):
        for check in _OF_ROBOTS if kind.virtual is None else (*_OF_ROBOTS, *_OF_RUNS):
            said = " ".join((check.__doc__ or "").split())
            try:
                check(asked)
                held.append(said)
            except _NotAskedError:
                continue
            except (Exception, SystemExit) as error:
                is_told = isinstance(error, AssertionError | SherkitError)
                failed.append(f"{said}\n    {error if is_told else f'{type(error).__name__}: {error}'}")
    if failed:
        raise AssertionError(f"{kind.called or kind.name}: {len(failed)} of {len(held) + len(failed)} do not hold\n- "
                             + "\n- ".join(failed))  # fmt: skip
    return tuple(held)
