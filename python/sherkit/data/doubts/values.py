"""Values that cannot be what the column's name says, and poses that cannot tell what is asked of them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...base import linalg
from ...base.figures import listed
from ...base.types import Bools, Floats, Ints
from .. import columns as c
from ..columns import TEMPERATURE, TIME, unit_in
from ..rows import Measurements
from .doubt import FEWEST, DataWarning, some

# -- Times that no clock showed -------------------------------------------------------------------------------------

#: Few runs are as slow as this for each reading and as long as this on the whole, s.
_SLOW_S = 300.0
_LONG_S = 86_400.0
_FEWEST = 5
#: Joints go where their speeds point in at least this part of a run that was written down whole.
_FOLLOWS = 0.8
#: Steps of time that differ by less than this part of them are all equal.
_EVEN = 1e-6
#: So many steps of a reading are smaller than its noise where a column was sorted by it, and the chance that all of
#: them point one way by themselves is none.
_SMALL_STEPS = 20


def time_in_milliseconds(data: Measurements) -> Iterator[DataWarning]:
    """Times that would make a run of a few minutes last for days."""
    if data.time_s is None or len(data) < _FEWEST:
        return
    gaps = np.diff(np.sort(data.time_s))
    velocities = [v for v in (data.covariates.get(name) for name in data.layout.velocities) if v is not None]
    usual = float(np.median(gaps))
    if velocities and len(velocities) == data.joints.shape[1]:
        # joints tell how fast time runs, where their speeds are known
        order = np.argsort(data.time_s, kind="stable")
        steps, speeds = np.diff(data.joints[order], axis=0), np.column_stack(velocities)[order][1:]
        way, by_speed = np.abs(steps).sum(), (np.abs(speeds) * gaps[:, None]).sum()
        # of rows that others stood between, speeds say nothing on the way from one to the next
        both = (np.linalg.norm(steps, axis=1) * np.linalg.norm(speeds, axis=1)).sum()
        follows = (steps * speeds).sum() > _FOLLOWS * both
        if follows and by_speed > 0 and 500.0 < by_speed / max(float(way), 1e-300) < 2000.0:
            yield DataWarning(
                f"{TIME} looks like milliseconds (ms): at the speeds of the run its joints would have moved "
                f"{by_speed / way:.0f} times as far as they did; divide {TIME} by 1000"
            )
        return
    if usual < _SLOW_S or np.ptp(data.time_s) < _LONG_S:
        return
    hours = float(np.ptp(data.time_s)) / 3600.0
    yield DataWarning(
        f"{TIME} looks like milliseconds (ms): {len(data)} readings would have taken {hours:.0f} hours, "
        f"{usual / 60:.0f} minutes each, instead of {usual / 1000:.1f} s; divide {TIME} by 1000"
    )


def order_lost(data: Measurements) -> Iterator[DataWarning]:
    """Times that rise over rows that were sorted by a reading, down to its noise: when what was read first is lost
    with them, and so are directions."""
    order = _in_order(data)
    if by := "" if order is None else _sorted_reading(data, order):
        yield DataWarning(
            f"{TIME} rises with {by} in every row: the table was sorted, it seems, and times were written anew; what "
            "depends on time, order or direction of motion then looks like anything else; give each row the time at "
            "which it was read, or leave the column out"
        )


def by_number(data: Measurements) -> Iterator[DataWarning]:
    """Times that rise at even steps with the pose's number, all repeats side by side: poses that were read several
    times on the spot, or a table that was sorted, which no row tells."""
    order = _in_order(data)
    if order is None or data.pose is None or data.time_s is None:
        return
    steps, numbers = np.diff(data.time_s[order]), np.diff(data.pose[order])
    usual = float(np.median(steps))
    even = usual > 0 and np.abs(steps - usual).max() <= _EVEN * usual
    if even and (numbers >= 0).all() and (numbers == 0).sum() >= (numbers > 0).sum() > _FEWEST:
        yield DataWarning(
            f"{TIME} rises at even steps with the number of the pose ({c.POSE}): all is well where each pose was read "
            "several times on the spot; where the table was sorted and times were written anew, what depends on time, "
            "order or direction of motion counts as noise: give each row the time at which it was read"
        )


def _in_order(data: Measurements) -> Ints | None:
    """Rows that count, where their times rise; None where they do not, and where nothing moves: there is but the order
    in time."""
    if data.time_s is None or len(data) < max(FEWEST, _SMALL_STEPS) or not (data.joints != data.joints[:1]).any():
        return None
    order = np.flatnonzero(~data.outlier)
    steps = np.diff(data.time_s[order])
    return order if len(steps) and steps.min() >= 0 and np.median(steps) > 0 else None


def _sorted_reading(data: Measurements, order: Ints) -> str:
    """The reading that rises or falls from row to row, down to steps that its own noise would have turned round."""
    repeats = data.repeatability
    for k, name in enumerate(data.layout.coordinates):
        rows = order[data.used[order, k]]
        if len(rows) < _SMALL_STEPS:
            continue
        steps = np.diff(data.readings[rows, k])
        if (steps < 0).any() and (steps > 0).any():
            continue
        noise = 0.0 if repeats is None else repeats.sigma.get(name, 0.0)
        given = data.sigma[rows, k]
        if not noise and np.isfinite(given).all():
            noise = float(np.median(given))
        if int(((np.abs(steps) < noise) & (steps != 0)).sum()) >= _SMALL_STEPS:
            return name
    return ""


# -- Poses that cannot tell what a model asks of them ---------------------------------------------------------------

#: What lies beside a line, as a part of its length.
_BESIDE = 0.01
#: The part of the places that is looked at, the nearest to the middle.
_MOST = 0.8


def on_a_line(data: Measurements) -> Iterator[DataWarning]:
    """Poses along one line, of a machine with several joints."""
    if len(data.layout.joints) < 2 or len(data) < FEWEST or not data.layout.follows:
        return
    few = some(data)
    rows = few.used[:, : few.coordinates].all(axis=1)
    if rows.sum() < FEWEST or few.coordinates < 2:
        return
    along = _line(few.readings[rows][:, : few.coordinates])
    if along is None:
        return
    most = int(np.argmax(np.abs(along)))
    name = data.layout.coordinates[most]
    where = f"along {name}" if abs(along[most]) > 0.99 else f"mostly along {name}"
    yield DataWarning(
        f"all poses stand on one line, {where}: they cannot tell what moves the robot across it, nor most of its "
        "parameters; measure poses in a plane, and at more than one height",
        poses=True,
    )


def _line(places: Floats) -> Floats | None:
    """The direction of the line on which most places (n, k) lie; None where they lie on none, or at one point."""
    places = places - np.median(places, axis=0)
    away = np.abs(places).max(axis=1)
    # wild readings make a line of anything
    _, length, turn = linalg.svd(places[away <= np.quantile(away, _MOST)], full_matrices=False)
    if length[0] == 0 or length[1] > _BESIDE * length[0]:
        return None
    return np.asarray(turn[0])


#: How far readings of a robot that stands still never scatter, by the unit of a reading.
_NEVER_STILL = {"mm": 1.0, "rad": 0.02, "deg": 1.0, "px": 20.0}


def frozen(data: Measurements) -> Iterator[DataWarning]:
    """Joints that are the same in every row while readings scatter from row to row as those of other places."""
    rows = np.flatnonzero(~data.outlier)
    if not data.joints.shape[1] or len(rows) < FEWEST or np.ptp(data.joints[rows], axis=0).any():
        return
    for k, name in enumerate(data.layout.coordinates):
        values = data.readings[rows[data.used[rows, k]], k]
        least = _NEVER_STILL.get(unit_in(name) or "")
        # half of how far neighbours lie apart, so that no slow course counts
        if least is not None and len(values) >= FEWEST and np.median(np.abs(np.diff(values))) > 2.0 * least:
            yield DataWarning(
                f"{listed(list(data.layout.joints))}: the same in all {len(rows)} rows, while {name} scatters by "
                f"{float(np.std(values)):.3g} {unit_in(name)}: the source of the joints froze, it seems; look at what "
                "writes them (a topic that was not renewed, a stopped recorder), and measure again"
            )
            return


# -- What is looked at by a person before a run is used: a diagnosis leaves such rows out by itself -----------------

#: Values lie apart from the others by so many times what the inner half of them ranges over.
_FAR = 20.0


def lost(data: Measurements) -> Iterator[DataWarning]:
    """Single values that no course of the others leads to, as an instrument writes them where it saw nothing; a place
    that is as far in joints as in readings was driven to."""
    read = np.where(data.taken, data.readings, np.nan)
    far = {name: _apart(values) for name, values in zip(data.layout.joints, data.joints.T, strict=True)}
    moved = np.any([*far.values(), np.zeros(len(data), dtype=bool)], axis=0)
    seen = {name: _apart(read[:, k]) for k, name in enumerate(data.layout.readings)}
    both = moved & np.any([*seen.values(), np.zeros(len(data), dtype=bool)], axis=0)
    for name, rows in {**far, **seen}.items():
        wrong = np.flatnonzero(rows & ~both)
        if len(wrong):
            at = data.layout.joints.index(name) if name in far else data.layout.readings.index(name)
            values = np.unique((data.joints if name in far else read)[wrong, at])
            yield DataWarning(
                f"{data.place(wrong)}: {name} is {listed(f'{v:.6g}' for v in values)}, far from all others: a lost "
                "reading, it seems; leave the cell empty"
            )


def _apart(values: Floats) -> Bools:
    """Which of the values (n,) lie far from most."""
    known = values[np.isfinite(values)]
    if len(known) < FEWEST:
        return np.zeros(len(values), dtype=bool)
    low, high = np.quantile(known, [0.25, 0.75])
    return np.asarray((high > low) & (np.abs(values - 0.5 * (low + high)) > _FAR * (high - low)))


def one_value(data: Measurements) -> Iterator[DataWarning]:
    """A reading that never changes while joints move."""
    if len(data) < FEWEST or not np.ptp(data.joints, axis=0).any():
        return
    for k, name in enumerate(data.layout.coordinates):
        values = data.readings[data.taken[:, k], k]
        if len(values) >= FEWEST and not np.ptp(values):
            yield DataWarning(
                f"{name} is {values[0]:g} in all {len(values)} rows, while the joints move: the instrument, or what "
                "writes its value, froze"
            )


# -- Temperatures and angles of another unit -------------------------------------------------------------------------

#: Temperatures of a room or a machine in it, and such as nothing of it ever has, °C.
_COLDEST, _HOTTEST = -60.0, 180.0
_KELVIN = (240.0, 360.0)
#: A room in degrees Fahrenheit, which changes by so little in a run.
_FAHRENHEIT, _ROOM_F = (59.0, 90.0), 20.0
#: Part of the rows in which a thermometer said nothing, at least.
_LOST = 0.005
#: A value is no temperature of this run where it is so many ranges of the others away, and so many °C.
_AWAY, _AWAY_C = 3.0, 8.0
#: Two turns: no joint of an arm goes farther, and no direction is as large, rad.
_TWO_TURNS = 4 * np.pi


def temperature(data: Measurements) -> Iterator[DataWarning]:
    """Temperatures in kelvin or degrees Fahrenheit, and zeros of a thermometer that did not answer."""
    given = data.covariates.get(TEMPERATURE)
    if given is None or len(data) < FEWEST:
        return
    values = given[~data.outlier]
    if not len(values):
        return
    usual, reach = float(np.median(values)), float(np.ptp(values))
    looks = ""
    if _KELVIN[0] < usual < _KELVIN[1] and values.min() > _HOTTEST:
        looks = f"looks like kelvin: it is about {usual:.0f}, which is {usual - 273.15:.0f} °C; subtract 273.15"
    elif _FAHRENHEIT[0] < values.min() and values.max() < _FAHRENHEIT[1] and reach < _ROOM_F:
        looks = (
            f"looks like degrees Fahrenheit: it is about {usual:.0f}, which is {(usual - 32) / 1.8:.0f} °C; subtract "
            "32 and divide by 1.8"
        )
    elif values.min() < _COLDEST or values.max() > _HOTTEST:
        extreme = float(values[np.argmax(np.abs(values - usual))])
        looks = f"holds {extreme:.4g}, which is no temperature in °C; look at its unit, and leave out what was not read"
    elif (lost := _lost(values)) is not None:
        value, count = lost
        looks = (
            f"is {value:.4g} in {count} of {len(values)} rows and about {usual:.3g} in the others: readings of the "
            "thermometer that were lost, it seems; fill them from their neighbours"
        )
    if looks:
        yield DataWarning(f"{TEMPERATURE} {looks} (or give it another name, where it was really so)")


def _lost(values: Floats) -> tuple[float, int] | None:
    """One value, far from all others, that comes again and again."""
    for value in (float(values.min()), float(values.max())):
        here = values == value
        rest = values[~here]
        if not max(3, _LOST * len(values)) <= here.sum() < 0.5 * len(values):
            continue
        gap = float(np.abs(rest - value).min())
        if gap > max(_AWAY * float(np.ptp(rest)), _AWAY_C) and len(np.unique(rest)) > 1:
            return value, int(here.sum())
    return None


def angles(data: Measurements) -> Iterator[DataWarning]:
    """Angles of more than two turns, of joints and of coordinates."""
    layout = data.layout
    columns = [(name, data.joints[~data.outlier, k]) for k, name in enumerate(layout.joints)]
    columns += [(name, data.readings[data.used[:, k], k]) for k, name in enumerate(layout.coordinates)]
    for name, values in columns:
        if unit_in(name) != "rad" or len(values) < FEWEST:
            continue
        most = float(np.quantile(np.abs(values), 0.5))
        if most > _TWO_TURNS:
            yield DataWarning(
                f"{name} is beyond two turns in most rows ({most / (2 * np.pi):.3g} turns is usual): it does not look "
                "like radians (degrees? divide by 57.2958)"
            )
