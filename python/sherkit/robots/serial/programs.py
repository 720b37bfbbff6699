"""Programs for the controller that an arm has: it knows the drawing, and is given other targets for it.

To bring a tool to a pose, the joints are found at which the calibrated arm holds it there; the pose that the drawing
has for these joints is what the controller must be given, since it goes back to just these joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import polars as pl
import scipy

from ...base import linalg
from ...base.figures import listed
from ...base.types import Bools, Floats, Ints
from ...data.called import factor, header_unit
from ...errors import MeasurementError, OutOfReach
from ..predicted_accuracy import PredictedAccuracies
from .calibration import SerialCalibration
from .frames import of_rpy, turns_of
from .full_poses import cells_of, meant
from .identified import as_identified
from .robot import POSITION, Serial

# -- How controllers write a pose ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Dialect:
    """How a controller writes poses: columns of the place, its unit in mm, columns of the turn, and what these are:
    ``vector``, rad, ``quaternion``, or the axes of angles, degrees."""

    place: tuple[str, str, str]
    unit_mm: float
    turn: tuple[str, ...]
    way: str

    @property
    def in_degrees(self) -> bool:
        """Whether its joints are in degrees, too."""
        return self.way != "vector"

    def numbers(self, turns: Floats) -> Floats:
        """The columns of turns (n, 3, 3), as (n, ·)."""
        rotation = scipy.spatial.transform.Rotation.from_matrix(turns)
        if self.way == "quaternion":
            return np.roll(rotation.as_quat(canonical=True), 1, axis=1)
        return np.asarray(rotation.as_rotvec() if self.way == "vector" else rotation.as_euler(self.way, degrees=True))


_XYZ_MM = ("X_mm", "Y_mm", "Z_mm")
#: By name. KUKA: A about z, then B about the y that this leaves, then C about x; FANUC: W, P, R about the fixed x, y,
#: z; ABB: a quaternion, the real part first; UR: m and a rotation vector. Their columns are read back as they are.
DIALECTS: Mapping[str, Dialect] = {
    "plain": Dialect(POSITION, 1.0, ("rx_rad", "ry_rad", "rz_rad"), "vector"),
    "kuka": Dialect(_XYZ_MM, 1.0, ("A_deg", "B_deg", "C_deg"), "ZYX"),
    "abb": Dialect(POSITION, 1.0, ("q1", "q2", "q3", "q4"), "quaternion"),
    "fanuc": Dialect(_XYZ_MM, 1.0, ("W_deg", "P_deg", "R_deg"), "xyz"),
    "ur": Dialect(("x_m", "y_m", "z_m"), 1000.0, ("rx_rad", "ry_rad", "rz_rad"), "vector"),
}

#: Places that are so far from those of their joints, in parts of the reach, are in another frame.
_ELSEWHERE = 0.05

# -- Targets that are given -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Targets:
    """Where a tool is to be, row by row: places (n, 3), mm, base frame, turns (n, 3, 3), joints (n, k), each None where
    the table has none; ``others`` are its other columns."""

    source: str
    places: Floats | None
    turns: Floats | None
    joints: Floats | None
    others: pl.DataFrame

    def __len__(self) -> int:
        return self.others.height

    def wanted(self, arm: Serial, row: int) -> tuple[Floats, Floats | None]:
        """Place (3,) and turn (3, 3) of a row, the turn None where it is open; of joints alone those as drawn."""
        if self.places is not None:
            return self.places[row], None if self.turns is None else self.turns[row]
        posed = arm.tool_frame(np.zeros(0) if self.joints is None else self.joints[row])
        return posed[:3, 3], posed[:3, :3]


def read_targets(arm: Serial, path: str | Path) -> Targets:
    """The targets of a table: ``x_mm, y_mm, z_mm`` with a turn in columns of :func:`~.full_poses.points_of_poses`, or
    joints, or both, of which the joints then say how the arm is to stand.

    Raises :class:`~sherkit.errors.MeasurementError` with line and column.
    """
    source, frame, line = cells_of(path)
    if not frame.height:
        raise MeasurementError(f"{path}: holds no row, only column names; expected targets")
    # metres are no unit that a name of ours ends in
    frame = frame.rename({f"{axis}_m": f"{axis} [m]" for axis in "xyz" if f"{axis}_m" in frame.columns})
    table = _TargetColumns(source, frame, line)
    found = meant(arm, frame.columns)
    by_stem = {header_unit(name)[0].lower(): name for name in frame.columns}
    wanted = dict(zip(arm.layout.joints, (one.name for one in arm.joints), strict=True))
    named = {ours: ours if ours in frame.columns else by_stem.get(own.lower()) for ours, own in wanted.items()}
    named |= {ours: ours for ours in POSITION if ours in frame.columns}
    named |= {ours: theirs for ours, (theirs, _) in found.items() if not named.get(ours)}
    units = (*(("mm",) * len(POSITION)), *("mm" if joint.slides else "deg" for joint in arm.joints))
    usual = dict(zip((*POSITION, *wanted), units, strict=True))

    def numbers(ours: Sequence[str], what: str) -> Floats | None:
        there = [name for name in ours if named.get(name)]
        if not there:
            return None
        if lacking := [name for name in ours if name not in there]:
            raise MeasurementError(f"{path}: {listed(there)} is there, and {listed(lacking)} is missing: {what}")
        return np.column_stack([table.in_unit(named[name] or "", name, usual[name]) for name in ours])

    joints, places = numbers(tuple(wanted), "all joints"), numbers(POSITION, "a place")
    if joints is None and places is None:
        raise MeasurementError(
            f"{path}: no columns tell targets; expected {', '.join(POSITION)} with a turn (rx_deg, ry_deg, rz_deg, a "
            f"quaternion, A, B, C …), or the joints {', '.join(wanted)}; the file has {listed(frame.columns, 20)}"
        )
    if joints is not None and places is not None:
        off = float(np.median(np.linalg.norm(places - [arm.forward(one) for one in joints], axis=1)))
        if off > _ELSEWHERE * float(arm.reach_mm[0]):
            raise MeasurementError(
                f"{path}: its places are {off:.0f} mm (median) from where its joints bring the arm: are they those of "
                "the tracker, as in a run? Targets are in the base; leave out joints or places"
            )
    taken = [name for name in named.values() if name]
    turned = turns_of(table.numbers, frame.columns, None, str(path)) if places is not None else None
    taken += turned.columns if turned else ()
    return Targets(str(path), places, turned.matrices if turned else None, joints, frame.drop(*taken, strict=False))


@dataclass(frozen=True, eq=False)
class _TargetColumns:
    """The cells of a table as numbers."""

    source: str
    frame: pl.DataFrame
    line: Ints | None

    def numbers(self, names: Sequence[str]) -> Floats:
        """Columns (n, ·)."""
        return np.column_stack([self._of(name) for name in names])

    def in_unit(self, name: str, ours: str, usual: str) -> Floats:
        """A column in the unit at the end of our name, from that of its own, or the ``usual`` one."""
        said, wanted = header_unit(name)[1] or usual, header_unit(ours)[1]
        by = factor(said, wanted)
        if by is None:
            raise MeasurementError(f"{self.source}: column '{name}' is in {said}, expected {wanted}")
        return by * self._of(name)

    def _of(self, name: str) -> Floats:
        column = self.frame[name]
        text = column.cast(pl.String).str.strip_chars()
        values = text.cast(pl.Float64, strict=False).to_numpy().astype(float)
        if (bad := ~np.isfinite(values)).any():
            row = int(np.argmax(bad))
            at = f"row {row + 1}" if self.line is None else f"line {int(self.line[row])}"
            raise MeasurementError(f"{self.source}: {at}: {name}: expected a number, found '{text[row] or ''}'")
        return values


# -- What the controller is given ---------------------------------------------------------------------------------

#: A turn weighs as much as what it moves so far from the target, mm.
_LEVER = 100.0
#: So much a cell of its matrix: by a small turn all nine change by its angle times the square root of 2.
_CELLS = _LEVER / np.sqrt(2.0)
#: A pose counts as held within this, mm, and at this lever.
_HELD = 1e-6
#: Step by which slopes of a turn are found, rad or mm; steps of the search, and behind it; margin at a joint's ends.
_STEP, _MOST, _LAST, _MARGIN = 1e-6, 40, 6, 1e-9
#: A turn that an arm of few joints cannot make is told from so many rad on.
_TURN = 1e-5
#: An arm that stands otherwise by more than this, rad, has another posture.
_ANOTHER = 0.5
_REACHED = "reached, "


@dataclass(frozen=True, eq=False)
class Program:
    """Targets for the controller: ``joints`` (n, k), places (n, 3) and turns (n, 3, 3) of the drawing with them, NaN
    where not ``reached`` (n,); ``moved_mm`` (n,) is how far they are from the targets; ``notes`` say what is to know of
    a row, empty where nothing is."""

    arm: Serial
    targets: Targets
    joints: Floats
    places: Floats
    turns: Floats
    reached: Bools
    moved_mm: Floats
    notes: tuple[str, ...]
    accuracy: PredictedAccuracies

    @cached_property
    def accuracy_mm(self) -> Floats:
        """The radius (n,) in which the mean of many visits is predicted to lie, 95 of 100 cases."""
        out = np.full(len(self.reached), np.nan)
        out[self.reached] = self.accuracy.total_mm
        return out

    def to_frame(self, dialect: str = "plain") -> pl.DataFrame:
        """A row for each target: the pose as the controller of :data:`DIALECTS` writes it, the joints, ``moved_mm``,
        ``accuracy_mm``, ``reach``; null where it is out of reach."""
        way, ok = DIALECTS[dialect], self.reached
        turn = np.full((len(ok), len(way.turn)), np.nan)
        if ok.any():
            turn[ok] = way.numbers(self.turns[ok])
        columns = dict(zip((*way.place, *way.turn), (*(self.places.T / way.unit_mm), *turn.T), strict=True))
        for joint, own in zip(self.arm.joints, self.joints.T, strict=True):
            turns = way.in_degrees and not joint.slides
            columns[f"{joint.name}_{'deg' if turns else joint.unit}"] = np.rad2deg(own) if turns else own
        columns |= {"moved_mm": self.moved_mm, "accuracy_mm": self.accuracy_mm}
        made = pl.DataFrame(columns).with_columns(pl.all().fill_nan(None))
        made = made.with_columns(reach=pl.Series([note or "reached" for note in self.notes]))
        others = self.targets.others
        return pl.concat([others.select(c for c in others.columns if c not in made.columns), made], how="horizontal")


def program_of(
    made: SerialCalibration, targets: Targets, *, tool: Serial | None = None, payload_kg: float = 0.0,
    temperature_c: float | None = None,
) -> Program:  # fmt: skip
    """What the controller, which knows the drawing, must be given for ``targets``: places with turns, or alone, where
    the tool turns as it may; joints alone are the poses that the drawing has for them.

    They are those of the measured target, or of the ``tool`` that works: the drawing with another ``target_mm`` and
    ``tool_rpy_deg``. Raises :class:`~sherkit.errors.MeasurementError` for such a tool and places without turns.
    """
    arm, count = tool or made.robot, len(targets)
    hold = _Holding(made, [*made._now(temperature_c)[:-1], float(payload_kg)], arm)
    if hold.beyond.any() and targets.turns is None and targets.joints is None:
        raise MeasurementError(f"{targets.source}: a tool of its own needs turns, or joints, beside its places")
    joints, places = np.full((count, len(arm.joints)), np.nan), np.full((count, 3), np.nan)
    turns, slides = np.zeros((count, 3, 3)), np.array([joint.slides for joint in arm.joints])
    moved, notes, before = np.full(count, np.nan), [""] * count, None
    for row in range(count):
        given = None if targets.joints is None else targets.joints[row]
        place, turn = targets.wanted(arm, row)
        if turn is None and given is not None and hold.beyond.any():
            turn = arm.tool_frame(given)[:3, :3]
        try:
            joints[row], notes[row] = hold.joints_for(place, turn, before if given is None else given)
        except OutOfReach as error:
            notes[row] = f"not reached: {str(error).removeprefix('out of reach: ')}"
            continue
        before = joints[row]
        sent = arm.tool_frame(before)
        places[row], turns[row] = sent[:3, 3], sent[:3, :3]
        moved[row] = np.linalg.norm(sent[:3, 3] - place)
        said = [notes[row].removeprefix(_REACHED)] if notes[row] else []
        if given is not None and np.abs(before - given)[~slides].max(initial=0.0) > _ANOTHER:
            said.append("in another posture than given")
        if not made.measured(made.forward(before)):
            said.append("beyond what was measured")
        notes[row] = _REACHED + ", ".join(said) if said else ""
    reached = np.isfinite(moved)
    accuracy = made.predicted_accuracies_with(joints[reached], temperature_c=temperature_c)
    return Program(arm, targets, joints, places, turns, reached, moved, tuple(notes), accuracy)


@dataclass(frozen=True, eq=False)
class _Holding:
    """The calibrated arm with its tool, at covariates that stay."""

    made: SerialCalibration
    now: list[float]
    arm: Serial

    @cached_property
    def beyond(self) -> Floats:
        """From the target as identified to the point of the tool that works (3,), mm, in the axes of the flange."""
        if self.arm is self.made.robot:
            return np.zeros(3)
        return np.array(self.arm.target_mm) - np.array(as_identified(self.made).target_mm)

    @cached_property
    def _tool(self) -> Floats:
        return of_rpy(np.deg2rad(self.arm.tool_rpy_deg))

    def _place(self, place: Floats, begin: Floats | None) -> Floats:
        """Joints for a place alone."""
        return self.made.robot.found_from(lambda x, q: self.made.core.inverse(x, self.now, q), place, begin)

    def joints_for(self, place: Floats, turn: Floats | None, start: Floats | None) -> tuple[Floats, str]:
        """Joints that bring the target to a place, and the tool to a turn if there is one, and what is to know of them.

        Raises :class:`~sherkit.errors.OutOfReach`.
        """
        arm, core = self.made.robot, self.made.core
        if turn is None:
            if start is None:
                # the posture that a controller would take, where the drawing reaches the place
                with suppress(OutOfReach):
                    start = arm.inverse(place)
            return self._place(place, start), ""
        nearest, least = None, np.inf
        for k, begin in enumerate(arm.starts if start is None else (start, *arm.starts)):
            found = self._held(place, turn, begin)
            off = float(np.linalg.norm(self._missed(found, place, turn)))
            if off < least:
                nearest, least = found, off
            if least < _HELD:
                break
            if k == 0 and not self.beyond.any():
                # what is too far for the place alone is told at once
                self._place(place, None)
        if nearest is None or (least >= _HELD and len(arm.joints) >= 6):
            raise OutOfReach(f"the nearest pose is {least:.3g} mm away (its turn counted at {_LEVER:g} mm)", 0, least)
        if least < _HELD:
            return nearest, ""
        # few joints: the place to the end, the turn as near as it goes
        exact = nearest
        for _ in range(_LAST if self.beyond.any() else 1):
            exact = core.inverse(place - self._flange(exact) @ self.beyond, self.now, exact)
        angle = float(np.linalg.norm(self._missed(exact, place, turn)[3:])) / _LEVER
        return exact, f"{_REACHED}its turn off by {np.rad2deg(angle):.3g}°" if angle > _TURN else ""

    def _missed(self, joints: Floats, place: Floats, turn: Floats) -> Floats:
        """By how much a pose is missed (12,), mm: its place, and the cells of its turn, as smooth far away as near."""
        there, _ = self.made.core.forward(joints, self.now)
        flange = self._flange(joints)
        return np.concatenate([there + flange @ self.beyond - place, _CELLS * (flange @ self._tool - turn).ravel()])

    def _flange(self, joints: Floats) -> Floats:
        """The axes of the flange as the drawing has them (3, 3)."""
        return np.asarray(self.made.core.flange(joints, self.now) @ self.made.robot.joints[-1].turn.T)

    def _slopes(self, joints: Floats) -> Floats:
        """Of what is missed (12, k)."""
        _, by_joints = self.made.core.forward(joints, self.now)
        here = self._flange(joints)
        turned = np.array([self._flange(joints + one) - here for one in _STEP * np.eye(len(joints))]) / _STEP
        by_turn = (turned @ self._tool).reshape(len(joints), -1).T
        return np.vstack([by_joints + (turned @ self.beyond).T, _CELLS * by_turn])

    def _held(self, place: Floats, turn: Floats, start: Floats) -> Floats:
        """Joints within their limits that miss a pose least, from a start."""
        low, high = self.made.robot.ranges
        slides = np.array([joint.slides for joint in self.made.robot.joints])
        found = scipy.optimize.least_squares(
            lambda q: self._missed(q, place, turn),
            np.clip(start, low + _MARGIN, high - _MARGIN),
            self._slopes,
            bounds=(low, high),
            x_scale=np.where(slides, 5.0 * _LEVER, 1.0),
            xtol=1e-7, ftol=1e-7, gtol=1e-7, max_nfev=_MOST,
        ).x  # fmt: skip
        missed = self._missed(found, place, turn)
        for _ in range(_LAST):
            step = linalg.lstsq(self._slopes(found), missed, rcond=1e-9)[0]
            better = np.clip(found - step, low, high)
            left = self._missed(better, place, turn)
            if np.linalg.norm(left) >= np.linalg.norm(missed):
                break
            found, missed = better, left
        return np.asarray(found)
