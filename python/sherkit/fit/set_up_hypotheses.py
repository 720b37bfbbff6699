"""What a tired person may have set up otherwise than the robot's file and the columns' names say.

Columns of one unit are exchanged, negated, mirrored within their range, taken for another unit, shifted by rows; the
words and angles of the robot's file are taken for the others that they might be. All follows from the layout of the
rows, from the robot's own tables and from its :class:`~sherkit.model.kinds.Kind`: nothing here knows a robot.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import combinations, islice, pairwise
from typing import Any

import numpy as np

from ..base.types import Floats
from ..data import Measurements
from ..data.columns import unit_in
from ..errors import SherkitError
from ..model.base import ModelWithEffects
from ..model.chain import ChainModel
from ..model.kinds import kind_of, robot_from_tables
from .set_up_rows import of_rows

#: What stands under a name by mistake: the unit it is in, how many of the name's units it has, what to do.
UNITS: dict[str, tuple[tuple[str, float], ...]] = {
    "mm": (("metres", 1e3), ("centimetres", 10.0), ("inches", 25.4), ("micrometres (µm)", 1e-3)),
    "rad": (("degrees", float(np.pi / 180)), ("milliradians", 1e-3), ("turns", float(2 * np.pi))),
    "px": (("pixels of a picture of half size", 2.0), ("pixels of a picture of double size", 0.5)),
}
#: Where angles may be counted from: reading = sign · angle + this, rad.
_QUARTERS = ((-1.0, 0.5), (-1.0, 1.0), (1.0, 0.5), (1.0, -0.5), (1.0, 1.0))
#: By how much a joint moves otherwise with another screw, gear, pulley or setting of its drive.
_GEARS = (2.0, 1.25, 1.5, 1.6, 4.0)
#: Joints leave the ranges that a file gives them by no more than this part of each.
_BEYOND = 0.1
#: All subsets of so few columns are tried; of more, single ones and all together.
_FEW = 3


@dataclass(frozen=True, eq=False)
class SetUpHypothesis:
    """Robot and rows as they may have been meant: what looks wrong, what to change, and both as they would be then.
    ``farther`` is how much less likely this is from the outset than a single slip."""

    looks: str
    advice: str
    model: ModelWithEffects
    data: Measurements
    farther: float = 0.0


def hypotheses(model: ModelWithEffects, data: Measurements) -> Iterator[SetUpHypothesis]:
    """Every mistake that may have been made, the usual ones first."""
    for looks, advice, changed in _of_columns(model, data):
        yield SetUpHypothesis(looks, advice, model, changed)
    for looks, advice, changed in of_rows(model, data):
        yield SetUpHypothesis(looks, advice, model, changed)
    for looks, advice, other in _of_robot(model):
        yield SetUpHypothesis(looks, advice, other, data)


# -- columns -------------------------------------------------------------------------------------------------------


def joints_as(data: Measurements, order: Sequence[int], factor: Floats, offset: Floats) -> Measurements:
    """Each joint from the column that ``order`` names, times its factor, plus its offset."""
    o = list(order)
    ends = data.to_joints if data.layout.from_fixed else data.to_joints[:, o] * factor + offset
    return replace(
        data,
        joints=np.ascontiguousarray(data.joints[:, o] * factor + offset),
        to_joints=np.ascontiguousarray(ends),
        direction=np.ascontiguousarray(data.direction[:, o] * np.sign(factor)),
    )


def _readings_as(data: Measurements, order: Sequence[int], factor: Floats, offset: Floats) -> Measurements:
    """The same of readings."""
    o = list(order)
    taken = np.ascontiguousarray(data.taken[:, o])
    return replace(
        data,
        readings=np.ascontiguousarray(np.where(taken, data.readings[:, o] * factor + offset, 0.0)),
        taken=taken,
        sigma=np.ascontiguousarray(data.sigma[:, o] * np.abs(factor)),
    )


class _Block:
    """Joints, or readings: their names, their units, and how they are changed."""

    def __init__(self, data: Measurements, names: Sequence[str], called: str, change: Any) -> None:
        self.data, self.names, self.called, self._change = data, tuple(names), called, change

    def changed(
        self, columns: Sequence[int], *, sources: Sequence[int] | None = None, factor: float | Floats = 1.0,
        offset: float | Floats = 0.0, data: Measurements | None = None,
    ) -> Measurements:  # fmt: skip
        """The rows with these columns taken from ``sources``, times ``factor`` plus ``offset``."""
        n, c = len(self.names), list(columns)
        order, factors, offsets = np.arange(n), np.ones(n), np.zeros(n)
        order[c] = c if sources is None else list(sources)
        factors[c], offsets[c] = factor, offset
        out: Measurements = self._change(self.data if data is None else data, order, factors, offsets)
        return out

    def of_one_unit(self, columns: Sequence[int]) -> Iterator[tuple[str, list[int]]]:
        """The columns by their units."""
        units = [unit_in(self.names[k]) for k in columns]
        for unit in dict.fromkeys(units):
            yield unit, [k for k, u in zip(columns, units, strict=True) if u == unit]

    def named(self, columns: Sequence[int]) -> str:
        """Their names, in words."""
        return with_and([self.names[k] for k in columns])


def with_and(names: Sequence[str]) -> str:
    """Names as one says them."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _subsets(columns: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """Single columns, then more of them together."""
    few = len(columns) <= _FEW
    for size in range(1, len(columns) + 1):
        if few or size in (1, len(columns)):
            yield from combinations(columns, size)


def _exchanges(columns: Sequence[int]) -> Iterator[tuple[str, list[int], list[int]]]:
    """Two columns that stand for each other; all of them moved round."""
    for pair in combinations(columns, 2):
        yield "swapped", list(pair), list(pair[::-1])
    if len(columns) > 2:
        for by in (1, len(columns) - 1):
            yield "interchanged", list(columns), [columns[(k + by) % len(columns)] for k in range(len(columns))]


def _of_columns(model: ModelWithEffects, data: Measurements) -> Iterator[tuple[str, str, Measurements]]:
    layout = data.layout
    joints = _Block(data, layout.joints, "joint readings", joints_as)
    readings = _Block(data, layout.readings, "readings", _readings_as)
    taken = [k for k in range(len(layout.readings)) if data.used[:, k].any()]
    coordinates = [k for k in taken if k < data.coordinates]
    ranges = model.ranges(data)
    for block, columns in ((joints, range(len(layout.joints))), (readings, coordinates)):
        # of readings in space what leaves them right-handed is a turn of the sensor, where that may stand anywhere
        anywhere = bool(model.stands_anywhere) and block is readings
        for unit, same in block.of_one_unit(list(columns)):
            yield from (one for one in _exchanged(block, same) if not anywhere or one[0].endswith("swapped"))
            yield from islice(_other_way(block, same, ranges), len(same) if anywhere else None)
            if block is readings and len(same) == 2 and not anywhere:
                yield from _quarter_turned(block, same, ranges)
            if unit == "rad":
                yield from _counted_from_elsewhere(block, same)
                if block is joints:
                    yield from _counted_with_the_one_before(data, same)
    yield from _other_units(model.joint_ranges(), data, joints, readings, taken)


def _exchanged(block: _Block, same: Sequence[int]) -> Iterator[tuple[str, str, Measurements]]:
    for how, columns, sources in _exchanges(same):
        advice = "swap these columns"
        if how == "interchanged":
            moves = [f"{block.names[a]} from {block.names[b]}" for a, b in zip(columns, sources, strict=True)]
            advice = f"move these columns round: take {', '.join(moves)}"
        yield f"{block.named(columns)} look {how}", advice, block.changed(columns, sources=sources)


def _other_way(
    block: _Block, same: Sequence[int], ranges: dict[str, tuple[float, float]]
) -> Iterator[tuple[str, str, Measurements]]:
    for columns in _subsets(same):
        names, look = block.named(columns), "looks" if len(columns) == 1 else "look"
        what = "counted the other way" if block.called == "joint readings" else "mirrored (negated)"
        whole = "all joints: " if block.called == "joint readings" and len(columns) == len(same) > 1 else ""
        yield f"{whole}{names} {look} {what}", "change the sign", block.changed(columns, factor=-1.0)
        if all(block.names[k] in ranges for k in columns):
            ends = [sum(ranges[block.names[k]]) for k in columns]
            advice = "; ".join(
                f"{block.names[k]} is {e:.6g} minus what it holds" for k, e in zip(columns, ends, strict=True)
            )
            yield (
                f"{names} {look} mirrored (counted from the opposite side)", advice,
                block.changed(columns, factor=-1.0, offset=np.array(ends)),
            )  # fmt: skip


def _quarter_turned(
    block: _Block, same: Sequence[int], ranges: dict[str, tuple[float, float]]
) -> Iterator[tuple[str, str, Measurements]]:
    """Both columns swapped and one of them mirrored: a picture that is turned by 90°."""
    swapped = block.changed(same, sources=same[::-1])
    for k in same:
        end = sum(ranges.get(block.names[k], (0.0, 0.0)))
        yield (
            f"{block.named(same)} look swapped, and {block.names[k]} mirrored then",
            f"swap these columns, then {block.names[k]} is {end:.6g} minus what it holds",
            block.changed([k], factor=-1.0, offset=end, data=swapped),
        )


def _counted_from_elsewhere(block: _Block, same: Sequence[int]) -> Iterator[tuple[str, str, Measurements]]:
    for k in same:
        for sign, half_turns in _QUARTERS:
            name, degrees = block.names[k], 180 * half_turns
            if sign > 0:
                looks, advice = f"{name} looks off by {-degrees:+.0f}°", f"add {degrees:+.0f}°"
            else:
                looks = f"{name} looks counted from {degrees:.0f}° and the other way round (the complement)"
                advice = f"{name} is {degrees:.0f}° ({np.pi * half_turns:.5f} rad) minus what it holds"
            yield looks, advice, block.changed([k], factor=sign, offset=np.pi * half_turns)


def _counted_with_the_one_before(data: Measurements, same: Sequence[int]) -> Iterator[tuple[str, str, Measurements]]:
    """An angle that is counted from the horizontal, or by a motor that stands in the base."""
    for j, k in pairwise(same):
        for sign, how in ((1.0, "from the sum with"), (-1.0, "from the difference to")):
            joints, ends = data.joints.copy(), data.to_joints.copy()
            joints[:, k] -= sign * joints[:, j]
            if not data.layout.from_fixed:
                ends[:, k] -= sign * ends[:, j]
            one, before = data.layout.joints[k], data.layout.joints[j]
            yield (
                f"{one} looks counted {how} {before}, as from the horizontal",
                f"{'subtract' if sign > 0 else 'add'} {before}; in an arm's file: follows = {-sign:g} of that joint",
                replace(data, joints=joints, to_joints=ends),
            )


def _other_units(
    ranges: dict[str, tuple[float, float]], data: Measurements, joints: _Block, readings: _Block, taken: Sequence[int]
) -> Iterator[tuple[str, str, Measurements]]:
    every = list(range(len(joints.names)))

    def may_be(columns: Sequence[int], factor: float) -> bool:
        """Whether joints may have been written in a unit of so many of theirs: of one that is smaller they are beyond
        their ranges as they stand, of one that is larger within them once they are changed."""
        within = []
        for k in columns:
            values = max(factor, 1.0) * data.joints[~data.outlier, k]
            if joints.names[k] in ranges and np.ptp(values) > 0:
                low, high = ranges[joints.names[k]]
                slack = _BEYOND * (high - low)
                within.append(bool(values.min() >= low - slack and values.max() <= high + slack))
        return not within or (all(within) if factor > 1.0 else not any(within))

    for unit, ways in UNITS.items():
        here = [k for k in every if unit_in(joints.names[k]) == unit]
        there = [k for k in taken if unit_in(readings.names[k]) == unit]
        for called, factor in ways:
            advice = f"multiply by {factor:.6g}" if factor > 1 else f"divide by {1 / factor:.6g}"
            for block, columns in ((joints, here), (readings, there)):
                if columns and (block is readings or may_be(columns, factor)):
                    changed = block.changed(columns, factor=factor)
                    yield f"{block.called} ({block.named(columns)}) look like {called}", advice, changed
                for k in columns if len(columns) > 1 else ():
                    if block is readings or may_be([k], factor):
                        yield f"{block.names[k]} alone looks like {called}", advice, block.changed([k], factor=factor)
            if here and there and may_be(here, factor):
                both = joints.changed(here, factor=factor, data=readings.changed(there, factor=factor))
                names = f"{joints.named(here)}; {readings.named(there)}"
                elsewhere = f"{advice}, or write the robot file in that unit" if unit == "mm" else advice
                yield f"joint readings and readings ({names}) all look like {called}", elsewhere, both
    for k in every:
        for times in (one for ratio in _GEARS for one in (ratio, 1.0 / ratio)):
            if may_be([k], times):
                looks = f"{max(times, 1.0 / times):g} times too {'small' if times > 1 else 'large'}"
                yield (
                    f"{joints.names[k]} looks {looks} (another pitch, gear or pulley?)",
                    f"multiply by {times:g}, or write what is built in", joints.changed([k], factor=times),
                )  # fmt: skip


# -- the robot's file ----------------------------------------------------------------------------------------------


def _of_robot(model: ModelWithEffects) -> Iterator[tuple[str, str, ModelWithEffects]]:
    """The robots that the file may have meant: other words of its choices, two lengths exchanged, angles in radians or
    counted clockwise, what its kind knows to be written in two ways."""
    if not isinstance(model, ChainModel):
        return
    kind, tables = kind_of(model.robot), model.robot.to_tables()
    geometry = tables.get("geometry", {})
    changes: list[tuple[str, str, str, Any]] = []
    for key, words in kind.choices.items():
        now = getattr(model.robot, key)
        for word in words:
            if word != now:
                looks = f'{key} in the robot file looks wrong: "{now}" where the run shows "{word}"'
                changes.append((looks, f'set {key} = "{word}"', "geometry", {key: word}))
    for one, other in combinations([key for key in geometry if unit_in(key)], 2):
        if unit_in(one) == unit_in(other) and np.shape(geometry[one]) == np.shape(geometry[other]):
            looks = f"{one} and {other} in the robot file look exchanged"
            swapped = {one: geometry[other], other: geometry[one]}
            changes.append((looks, "write each where the other stands", "geometry", swapped))
    for name, table in tables.items():
        angles = [key for key in table if unit_in(key) == "deg"] if isinstance(table, dict) else []
        for keys in ([angles] if angles else []) + [[key] for key in angles if len(angles) > 1]:
            looks = f"{with_and(keys)} in the robot file {'look' if len(keys) > 1 else 'looks'} like radians"
            degrees = {key: np.rad2deg(table[key]).tolist() for key in keys}
            changes.append((looks, f"write {'them' if len(keys) > 1 else 'it'} in degrees", name, degrees))
    changes += _other_lengths(tables)
    lists = [key for key in geometry if unit_in(key) == "deg" and np.size(geometry[key]) > 1]
    if lists:
        first = geometry[lists[0]][0]
        for start, how in ((first, "from where limb 1 stands"), (0.0, "from x")):
            turned = {key: [(2 * start - a) % 360.0 for a in geometry[key]] for key in lists}
            looks = f"{with_and(lists)} in the robot file look counted clockwise {how}"
            changes.append((looks, f"count them anticlockwise: {_written(turned)}", "geometry", turned))
    for looks, advice, name, changed in changes:
        meant = deepcopy(tables)
        meant[name] = meant[name] | changed if isinstance(changed, dict) else changed
        try:
            robot = robot_from_tables(meant, "robot file")
        except SherkitError:
            continue
        yield looks, advice, replace(model, robot=robot)
    for looks, advice, robot in kind.misread(model.robot):
        yield looks, advice, replace(model, robot=robot)


def _other_lengths(tables: dict[str, Any]) -> Iterator[tuple[str, str, str, Any]]:
    """Lengths that were written in another unit: all of the geometry, one of its keys, one number; of an arm one
    component of where one joint stands."""
    geometry, joints = tables.get("geometry", {}), tables.get("joint", [])
    lengths = {key: np.asarray(own, dtype=float) for key, own in geometry.items() if unit_in(key) == "mm"}
    for called, factor in UNITS["mm"]:
        if factor < 1.0:
            # nobody writes a robot in micrometres
            continue
        like = f"in the robot file {{}} like {called}"
        longer = {key: factor * own for key, own in lengths.items()}
        ways = [(with_and(list(longer)), longer)] if len(longer) > 1 else []
        for key, own in lengths.items():
            ways.append((key, {key: longer[key]}))
            for at in range(own.size) if own.size > 1 else ():
                if own[at]:
                    made = np.where(np.arange(own.size) == at, longer[key], own)
                    ways.append((f"number {at + 1} of {key}", {key: made}))
        for names, keys in ways:
            meant = {key: own.tolist() for key, own in keys.items()}
            look = "look" if len(keys) > 1 else "looks"
            yield f"{names} {like.format(look)}", f"write {_written(meant)}", "geometry", meant
        for k, joint in enumerate(joints):
            for axis, length in enumerate(joint["origin_mm"]):
                if length:
                    origin = [factor * one if at == axis else one for at, one in enumerate(joint["origin_mm"])]
                    what = f"the {'xyz'[axis]} of origin_mm of {joint['name']}"
                    changed = [*joints[:k], joint | {"origin_mm": origin}, *joints[k + 1 :]]
                    yield f"{what} {like.format('looks')}", f"write {factor * length:.6g}", "joint", changed


def _written(changed: dict[str, Any]) -> str:
    """Keys with their values, as in a file."""
    return "; ".join(
        f"{key} = [{', '.join(f'{v:.5g}' for v in own)}]" if isinstance(own, list) else f"{key} = {own:.5g}"
        for key, own in changed.items()
    )
