"""The effects that any machine given by a function may have: of its joints, of the measured point, of its readings."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.types import Floats
from ...data.called import factor
from ...data.columns import TEMPERATURE, TIME, bare, unit_in
from ...data.in_time import DRAWN_C
from ...model.effect import Effect, Sentences, catalogue_of_core
from ...model.sensor_pose import POSE, drift_row, pose_row, slip_row
from ...model.sentences import COMMON

#: A plausible small error of a reading or joint by its unit; of any other, this part of its range. A joint that
#: goes far is made less well: no less than such a part of its travel, where that is a length.
_SMALL = {"mm": 0.1, "um": 100.0, "m": 1e-4, "rad": 2e-3, "mrad": 2.0, "deg": 0.1, "px": 5.0, "arcsec": 300.0}
_OF_TRAVEL = 5e-4
_SCALE, _GROWTH = 1e-3, 1e-4
_METRE = 1000.0
#: Machines with more joints than this have couplings of neighbours alone.
_FEW_JOINTS = 3


@dataclass(frozen=True, eq=False)
class RowCovariates:
    """What effects look at besides joints and point: ``time_s`` (n,), ``temperature_c`` (n,) and that of the stands
    ``stand_c`` (n,), ``direction`` (n, k) and ``velocity`` (n, k), NaN where they are not known; and the ``chain``, for
    its settings."""

    time_s: Floats
    temperature_c: Floats
    stand_c: Floats
    direction: Floats
    velocity: Floats
    chain: Any


#: What an effect adds (n, axes, p) for each of its parameters at one: where it acts (n, axes), joints or readings.
Formula = Callable[[NDArray[Any], RowCovariates], NDArray[Any]]
#: Names with unit and plausible size.
Parameters = tuple[tuple[str, str, float], ...]


@dataclass(frozen=True)
class Generic:
    """One effect that every machine can have: its link, its parameters with unit and plausible size, and its formula.

    It is linear in its parameters, and says what it adds at its link: to the readings of the joints, to those of the
    instruments; ``by_pose`` to the six numbers of the sensor's pose.
    """

    name: str
    link: str
    parameters: Parameters
    formula: Formula = field(repr=False)
    needs: tuple[str, ...] = ()
    search: str | None = None
    by_pose: bool = False

    def only(self, which: Sequence[int]) -> Generic:
        """With these of its parameters."""
        formula, columns = self.formula, list(which)
        return replace(
            self,
            parameters=tuple(self.parameters[k] for k in columns),
            formula=lambda x, at: formula(x, at)[:, :, columns],
        )

    @property
    def at(self) -> str:
        """What it adds to."""
        return "pose" if self.by_pose else self.link

    @property
    def is_base(self) -> bool:
        """Whether it is no effect but of every model: where the sensor stands."""
        return self.by_pose and not self.needs

    @property
    def row(self) -> dict[str, Any]:
        """As a row of the table of a chain."""
        lever = None if self.is_base else 1.0
        own = [{"name": n, "symbol": n, "unit": u, "size": s, "lever_mm": lever} for n, u, s in self.parameters]
        return {
            "name": self.name, "link": self.link, "base": self.is_base, "parameters": own, "needs": list(self.needs),
            "search": self.search,
        }  # fmt: skip


def generic_effects(
    joints: Sequence[str], readings: Sequence[str], spans: Sequence[float], shown: Sequence[float], is_place: bool
) -> tuple[Generic, ...]:
    """Those of a machine with these joints, which range over ``spans``, and readings, which then range over ``shown``,
    in the order of the chain; whether the readings are a place in space."""
    units, read = [unit_in(name) for name in joints], [unit_in(name) for name in readings]
    lengths = [_OF_TRAVEL * span if factor(unit, "mm") else 0.0 for unit, span in zip(units, spans, strict=True)]
    small = [max(_SMALL.get(unit, 1e-3 * span), least) for unit, span, least in zip(units, spans, lengths, strict=True)]
    seen = [_SMALL.get(unit, _SCALE * span or 1.0) for unit, span in zip(read, shown, strict=True)]

    def by_joint(word: str, sizes: Sequence[float], own: Sequence[str] = units) -> Parameters:
        return tuple((f"{word}_{bare(n)}", u, float(s)) for n, u, s in zip(joints, own, sizes, strict=True))

    def by_reading(word: str, sizes: Sequence[float], own: Sequence[str] = read) -> Parameters:
        return tuple((f"{word}_{bare(n)}", u, float(s)) for n, u, s in zip(readings, own, sizes, strict=True))

    few = len(joints) <= _FEW_JOINTS
    pairs = [(i, j) for i, j in permutations(range(len(joints)), 2) if few or abs(i - j) == 1]
    coupled = tuple((f"{bare(joints[i])}_by_{bare(joints[j])}", _ratio(units[i], units[j]),
                     _SCALE * spans[i] / spans[j]) for i, j in pairs)  # fmt: skip
    turning = {i: by for i, unit in enumerate(units) if (by := factor(unit, "rad")) is not None}

    def per_turn(name: str, times: float) -> Generic:
        waves = (one for i, by in turning.items() for one in _waves([joints[i]], units[i], 2e-3 / times / by))
        return Generic(name, "joints", tuple(waves), _wave_of({i: times * by for i, by in turning.items()}))

    # joints of one unit have waves of one period: first those of most of them
    cyclic: list[Generic] = []
    for unit in sorted(dict.fromkeys(units), key=units.count, reverse=True):
        by = factor(unit, "rad")
        if unit == "mm" or by is not None:
            which = [i for i, one in enumerate(units) if one == unit]
            lines = _waves([joints[i] for i in which], unit, 0.005 if by is None else 1e-3 / by)
            other = f"_{unit}" if cyclic else ""
            cyclic.append(Generic(f"encoder_cyclic{other}", "joints", lines, _cyclic(which), search=f"period_{unit}"))
            if not other:
                half = tuple((name, unit, 0.4 * size) for name, unit, size in lines)
                second = Generic("encoder_second", "joints", half, _cyclic(which, 2.0))
    out = [
        Generic("joint_offset", "joints", by_joint("offset", small), _each(lambda q, _: 1.0)),
        Generic("joint_scale", "joints", by_joint("scale", [_SCALE] * len(joints), [""] * len(joints)),
                _each(lambda q, at: q - at.chain.home)),
        Generic("joint_coupling", "joints", coupled, _coupling(pairs)),
        per_turn("encoder_eccentricity", 1.0),
        per_turn("encoder_two_per_turn", 2.0),
        *([cyclic[0], second, *cyclic[1:]] if cyclic else []),
        Generic("joint_growth", "joints", by_joint("growth", [_GROWTH] * len(joints), ["1/°C"] * len(joints)),
                _each(_growing), (TEMPERATURE,)).only([i for i, one in enumerate(units) if factor(one, "mm")]),
        # who reads a joint a moment after the point sees it where it was then
        Generic("reading_delay", "joints", (("delay", "s", 0.02),), lambda _, at: -at.velocity[:, :, None],
                tuple(f"{name}_per_s" for name in joints)),
        Generic("backlash", "joints", by_joint("width", [0.2 * s for s in small]),
                _each(lambda _, at: 0.5 * at.direction), ("direction",)),
        Generic("joint_slip", "joints", by_joint("step", small), _each(_late("joint_slip_time_s")), (TIME,), TIME),
    ]  # fmt: skip
    if is_place:
        out += [
            Generic("thermal_growth", "body", (("coefficient", "1/°C", 1e-4),),
                    lambda x, at: (at.temperature_c - DRAWN_C)[:, None, None] * x[:, :, None], (TEMPERATURE,)),
            Generic("droop", "body", (("fall_at_1_m", "mm", 1.0),), _droop),
            Generic("instrument_turned", "sensor", tuple((f"turn_{axis}", "rad", 2e-3) for axis in "xyz"), _turned),
        ]  # fmt: skip
    else:
        out.append(Generic("sensor_growth", "sensor", by_reading("growth", [_GROWTH] * len(read), ["1/°C"] * len(read)),
                           _each(_growing), (TEMPERATURE,)))  # fmt: skip
    out += [
        Generic("drift", "body", by_reading("rate", seen, [f"{u}/h" for u in read]), _each(_hours), (TIME,)),
        Generic("slip", "body", by_reading("step", seen), _each(_late("slip_time_s")), (TIME,), TIME),
        Generic("thermal_shift", "sensor", by_reading("shift", [0.2 * s for s in seen], [f"{u}/°C" for u in read]),
                _each(lambda _, at: (at.stand_c - DRAWN_C)[:, None]), (TEMPERATURE,), "lag_s"),
        Generic("sensor_offset", "sensor", by_reading("offset", [5 * s for s in seen]), _each(lambda x, _: 1.0)),
        Generic("sensor_scale", "sensor", by_reading("scale", [_SCALE] * len(read), [""] * len(read)),
                _each(lambda x, _: x)),
    ]  # fmt: skip
    if is_place:
        out += [_of_pose(slip_row(1.0), _each(_late("sensor_slip_time_s"))), _of_pose(drift_row(1.0), _each(_hours))]
    return tuple(one for one in out if one.parameters)


def home_of(box: Floats) -> tuple[float, ...]:
    """From where scales and couplings of joints count that range over a box (k, 2): from zero, as encoders do, and
    where that is none of their readings from the middle. From far outside the geometry would make up for the mean."""
    low, high = box.reshape(-1, 2).T
    return tuple(np.where((low <= 0.0) & (high >= 0.0), 0.0, 0.5 * (low + high)).tolist())


def sensor_pose(names: Collection[str]) -> Generic:
    """These numbers of the sensor's pose, as what every machine has whose readings are places in space."""
    which = [POSE.index(name) for name in POSE if name in names]
    return _of_pose(pose_row(names), lambda x, _: _diagonal(np.ones_like(x))[:, :, which])


def _of_pose(row: Mapping[str, Any], formula: Formula) -> Generic:
    own = tuple((p["name"], p["unit"], p["size"]) for p in row["parameters"])
    return Generic(row["name"], row["link"], own, formula, tuple(row["needs"]), row["search"], by_pose=True)


def is_point_in_space(readings: Sequence[str]) -> bool:
    """Whether readings are x, y and z of one point, mm: by their names, which differ in that alone."""
    words = [bare(name).lower().split("_") for name in readings]
    if len(readings) != 3 or {unit_in(name) for name in readings} != {"mm"} or len({len(one) for one in words}) > 1:
        return False
    apart = [column for column in zip(*words, strict=True) if len(set(column)) > 1]
    return apart == [("x", "y", "z")]


def machine_catalogue(effects: Sequence[Generic]) -> dict[str, Effect]:
    """As effects with their sentences."""
    sentences: Mapping[str, Sentences] = COMMON | _OWN
    # waves of joints in another unit are said as those of most
    cyclic = "encoder_cyclic"
    told = {one.name: sentences[cyclic if one.name.startswith(cyclic) else one.name] for one in effects}
    return catalogue_of_core([one.row for one in effects], told)


# -- parameters ------------------------------------------------------------------------------------------


def _waves(names: Sequence[str], unit: str, size: float) -> Parameters:
    return tuple((f"{part}_{bare(n)}", unit, size) for n in names for part in ("sine", "cosine"))


def _ratio(of: str, by: str) -> str:
    return "" if of == by else f"{of}/{by}"


# -- formulas --------------------------------------------------------------------------------------------


def _growing(x: NDArray[Any], at: RowCovariates) -> NDArray[Any]:
    """In proportion to itself and to the temperature."""
    return x * (at.temperature_c - DRAWN_C)[:, None]


def _diagonal(each: NDArray[Any]) -> NDArray[Any]:
    """(n, k, k): each parameter acts at its own place."""
    return each[:, :, None] * np.eye(each.shape[1])


def _each(of: Callable[[NDArray[Any], RowCovariates], ArrayLike]) -> Formula:
    """Of what is added at one to each axis, (n, axes) or alike for all."""
    return lambda x, at: _diagonal(np.broadcast_to(of(x, at), x.shape))


def _coupling(pairs: Sequence[tuple[int, int]]) -> Formula:
    def formula(q: NDArray[Any], at: RowCovariates) -> NDArray[Any]:
        out, travel = np.zeros((*q.shape, len(pairs)), dtype=q.dtype), q - at.chain.home
        for p, (i, j) in enumerate(pairs):
            out[:, i, p] = travel[:, j]
        return out

    return formula


def _wave(q: NDArray[Any], turns: Mapping[int, float]) -> NDArray[Any]:
    """(n, k, 2 len(turns)): sine and cosine of each of these joints, at its own place; so many rad for each unit."""
    out = np.zeros((*q.shape, 2 * len(turns)), dtype=q.dtype)
    for p, (i, by) in enumerate(turns.items()):
        out[:, i, 2 * p] = np.sin(by * q[:, i])
        out[:, i, 2 * p + 1] = np.cos(by * q[:, i])
    return out


def _wave_of(turns: Mapping[int, float]) -> Formula:
    return lambda q, _: _wave(q, turns)


def _cyclic(which: Sequence[int], times: float = 1.0) -> Formula:
    return lambda q, at: _wave(q, {k: times * at.chain.wave[k] for k in which})


def _hours(_: NDArray[Any], at: RowCovariates) -> Floats:
    """Since the beginning of the run, (n, 1)."""
    return ((at.time_s - at.chain.time_origin_s) / 3600.0)[:, None]


def _late(setting: str) -> Callable[[NDArray[Any], RowCovariates], Floats]:
    """One from the moment on that a setting names, (n, 1)."""

    def late(_: NDArray[Any], at: RowCovariates) -> Floats:
        return np.where(np.isnan(at.time_s), np.nan, (at.time_s >= getattr(at.chain, setting)).astype(float))[:, None]

    return late


def _droop(x: NDArray[Any], _: RowCovariates) -> NDArray[Any]:
    out = np.zeros((len(x), 3, 1), dtype=x.dtype)
    out[:, 2, 0] = -(x[:, 0] ** 2 + x[:, 1] ** 2) / _METRE**2
    return out


def _turned(x: NDArray[Any], _: RowCovariates) -> NDArray[Any]:
    """Small rotations of the instrument about its axes, to first order."""
    out = np.zeros((len(x), 3, 3), dtype=x.dtype)
    for p, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        out[:, i, p], out[:, j, p] = -x[:, j], x[:, i]
    return out


_OWN = {
    "joint_offset": Sentences(
        physics="The zero of an encoder is not where the model has it.",
        residuals="As if one joint stood elsewhere by the same amount at every pose.",
        remedy="Home the joint again, or correct the offset in the controller.",
        sizes={"offset": "the zero of {k} is off by {size}"},
    ),
    "joint_coupling": Sentences(
        physics="One joint moves along with another: axes that are not square, a belt or gear that couples them.",
        residuals="In proportion to the travel of one joint, along the motion of another.",
        remedy="Measure the squareness with a granite square; shim the rail, or correct it in the controller.",
    ),
    "joint_growth": Sentences(
        physics="The scale, rack or screw that a joint is measured by expands with the temperature.",
        residuals="In proportion to the travel of one joint, times the deviation of temperature from 20 °C.",
        remedy="Warm up; measure the scale's own temperature and correct by it; use a scale of glass ceramic.",
        sizes={"growth": "the scale of {k} grows/shrinks by {size}"},
    ),
    "encoder_two_per_turn": Sentences(
        physics="An encoder's ring is oval, or read by two heads: its error repeats twice per turn.",
        residuals="A wave along one joint with two periods in a whole turn.",
        remedy="Mount the ring without stress; use the encoder's own compensation.",
    ),
    "droop": Sentences(
        physics="The machine gives way under its own weight the further it reaches from its axis; the value is the "
        "fall at a metre from it.",
        residuals="Downwards, with the square of the distance from the z axis.",
        remedy="Balance or stiffen the overhanging part; preload its bearing.",
        sizes={"fall": "a metre out it hangs {size} too low"},
    ),
    "instrument_turned": Sentences(
        physics="The measuring instrument's axes are not parallel to those of the model.",
        residuals="The whole cloud of points turned.",
        remedy="Register the instrument on the machine's base; or identify the turn with the model.",
    ),
    "sensor_offset": Sentences(
        physics="The zero of an instrument is not where the model has it.",
        residuals="Constant.",
        remedy="Set the instrument to zero at the reference; or identify the offset with the model.",
    ),
    "sensor_growth": Sentences(
        physics="An instrument shows more or less in proportion to the temperature: an interferometer whose wavelength "
        "is not corrected for the air, a wire or a scale that expands.",
        residuals="In proportion to one reading, times the deviation of temperature from 20 °C.",
        remedy="Have the instrument correct for air and material; measure the temperature where it is.",
    ),
    "sensor_scale": Sentences(
        physics="An instrument shows a little too much or too little.",
        residuals="In proportion to one reading.",
        remedy="Check the instrument with a gauge block; correct its scale.",
    ),
}  # fmt: skip
