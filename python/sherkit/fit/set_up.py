"""The mistakes of a set-up that a run shows: every hypothesis is fitted, the ones that are much better are said."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from ..base.types import Bools, Floats
from ..data import Measurements
from ..data.doubts import angles, doubts
from ..data.noise import noise_of
from ..model.base import ModelWithEffects
from .constant_columns import constant, constant_by_mistake, frozen
from .plausible import (
    COUNTED,
    NOT_COMPUTED,
    Plausible,
    as_fitted,
    may_be_anything,
    plausible_fit,
    thinned,
)
from .set_up_frames import set_up_anew, turned_frame
from .set_up_hypotheses import SetUpHypothesis, hypotheses
from .set_up_rows import moved_from_a_row_on
from .set_up_zeros import several_joints

# -- The mistakes ----------------------------------------------------------------------------------------------------

#: A set-up is mistaken where another explains the run better by a factor of five with parameters as plausible.
_MUCH = COUNTED * float(np.log(5.0))
#: As good as the best: by a factor of 1.5.
_AS_GOOD = COUNTED * float(np.log(1.5))
#: What is left is small: this part of the readings' spread, where mistakes leave twenty times that; or this many times
#: the noise, and this part of the spread.
_SMALL = 0.01
_NOISES = 3.0
_NOT_LARGE = 0.05
#: A reading that hardly moves counts as moving by this part of the one that moves most.
_LEAST_SPREAD = 0.02
#: Parameters are plausible as long as they cost no more than this.
_MOVED = 8.0
#: So much more they cost where a robot is far from its drawing: one of them is off by six of its sizes.
_FAR_FROM_DRAWN = 5.0
#: More mistakes than this at once are not looked for.
_MOST_MISTAKES = 3
#: Of how far readings lie from their middle, the part by which two frames may differ and be said as one: 3°.
_NEARLY = 0.05
#: A sensor whose axes are turned by less against the base, rad, stands as the robot does.
_SQUARE = 0.1
#: How often a turned frame is registered anew to what the model predicts.
_TURNS = 4
#: Rows by which set-ups are looked at first; so many that look best are fitted to their end.
_AT_FIRST = 100
_LOOKED_AT = 8
#: A row is read from elsewhere that is off by so many times what most rows are, and such a part of those on its side.
_WILD, _WHOLE = 20.0, 0.9
#: Readings for each parameter, fewer of which fit anything.
_READINGS = 3
#: A set-up that leaves more than this part of the spread is not right, whatever the others leave.
_NOT_RIGHT = 0.1
#: One that leaves more than this is no set-up at all.
_ABSURD = 0.3
#: A coordinate is fitted better where less than this part is left of what was.
_BETTER = 0.8
#: A robot that is driven by less than this part of what is left is hardly driven at all.
_HARDLY = 0.3
#: An effect that leaves less than this part takes most.
_MOST = 0.5


@dataclass(frozen=True)
class Mistake:
    """Something in the set-up that looks wrong: a sentence with what to change.

    ``before`` and ``after`` are the RMS that robust fits with plausible parameters leave as it stands and once it is
    changed, in the unit that people read; NaN where nothing can be computed, or where no fit shows it.
    """

    sentence: str
    before: float = float("nan")
    after: float = float("nan")

    def __str__(self) -> str:
        return self.sentence


def set_up_mistakes(model: ModelWithEffects, data: Measurements, values: Floats | None = None) -> tuple[Mistake, ...]:
    """The mistakes of the set-up that rows show beside a model; none where its fit leaves little and is plausible.

    ``values`` (p,) are those of a fit, None where there is none, as where rows cannot be reached.
    """
    table = [doubt for doubt in doubts(data) if not doubt.poses]
    out = [Mistake(doubt.sentence) for doubt in table]
    if not data.layout.follows or any(doubt.columns for doubt in table):
        # what is wrong beside is told by how far readings move
        return tuple(out)
    if values is not None:
        still = dict(constant_by_mistake(model, data))
        if still:
            out += [Mistake(sentence) for sentence in still.values()]
            taken = data.taken.copy()
            taken[:, list(still)] = False
            data, values = replace(data, taken=taken).select(np.flatnonzero(taken.any(axis=1))), None
            if not len(data):
                return tuple(out)
    if set(np.flatnonzero(data.used.any(axis=0))) <= set(constant(data)):
        # whatever makes the robot stand still would fit a reading that is held
        return tuple(out)
    free = None if values is None else as_fitted(model, data, values)
    wrong = [] if free is not None and _is_small(free, data) else _wrong(model, data, free)
    if not wrong:
        # each has another name where a fit shows one
        small = free is not None and _is_small(free, data)
        wrong = [] if small else [Mistake(doubt.sentence) for doubt in angles(data)]
    return (*out, *wrong)


def _usual_noise(data: Measurements) -> Floats:
    """Noise (m,) of each column, NaN where nothing was taken or nothing tells it."""
    noise = noise_of(data)
    if noise.origin == "unknown":
        return np.full(data.used.shape[1], np.nan)
    pairs = zip(noise.sigma.T, data.used.T, strict=True)
    return np.array([np.median(sigma[used]) if used.any() else np.nan for sigma, used in pairs])


def _is_noise(now: Plausible, data: Measurements) -> bool:
    """Whether a fit leaves no more than readings of one pose differ among themselves."""
    taken = np.isfinite(now.rms)
    return bool((now.rms <= _NOISES * _usual_noise(data))[taken].all())


def _is_small(now: Plausible, data: Measurements) -> bool:
    """Whether a fit leaves so little, with parameters so plausible, that nothing can be wrong that it would show."""
    # one that hardly moves beside the others, as the height in a plane, may be all noise
    spread = np.maximum(now.spread, _LEAST_SPREAD * np.nanmax(now.spread))
    small = (now.rms <= _SMALL * spread) | (
        (now.rms <= _NOISES * _usual_noise(data)) & (now.rms <= _NOT_LARGE * spread)
    )
    return bool(small[np.isfinite(now.rms)].all()) and now.moved <= _MOVED and now.elsewhere < 0.5


def _wrong(
    model: ModelWithEffects, data: Measurements, free: Plausible | None, most: int = _MOST_MISTAKES
) -> list[Mistake]:
    """What looks wrong as it stands, by every hypothesis, and what looks wrong once that is changed; ``free`` is the
    free fit."""
    datum = _datum(model, data)
    if datum is None or data.used.sum() < _READINGS * len(model.parameters):
        return []
    now = plausible_fit(model, data, datum)
    # a fit that wild rows do not move may leave little of most, and the others were read from elsewhere
    asked = now is not None and model.stands_anywhere and most == _MOST_MISTAKES
    anew = _anew(model, data, datum) if asked else None
    if now is not None and most == _MOST_MISTAKES:
        moved = (
            SetUpHypothesis(looks, advice, model, there) for looks, advice, there in moved_from_a_row_on(model, data)
        )
        later = ((one, plausible_fit(model, one.data, datum)) for one in moved)
        for one, found in chain(later, () if anew is None else [anew]):
            if since := _since(model, data, now, one, found):
                return since
    if now is not None and _is_small(now, data):
        return []
    stands = min((p for p in (now, free) if p is not None), key=lambda p: p.misfit, default=None)
    better = _much_better(model, data, datum, stands, now, anew)
    if not better and (several := several_joints(model, data)) is not None:
        found = plausible_fit(model, several.data, datum)
        if found is not None and found.relative < _NOT_RIGHT and _is_much_better(several, found, stands):
            better = [(several, found)]
    unit, per_unit = data.layout.unit, data.layout.per_unit
    before = float("nan") if now is None else per_unit * now.error
    if not better:
        if now is None or free is None or min(now.relative, free.relative) < _ABSURD or not _moves(model, data, now):
            return []
        if _is_physics(model, data, datum, now):
            return []
        return [_all_noise(now, before, unit) if _is_noise(now, data) else _nothing_usual(now, before, unit, data)]
    first, found = better[0]
    after = per_unit * found.error
    looks, advice = (
        dict.fromkeys(words) for words in zip(*((one.looks, one.advice) for one, _ in better), strict=True)
    )
    stood = "where nothing can be computed as it stands" if np.isnan(before) else f"instead of {_plain(before)}"
    same = ", which here is the same" if len(better) > 1 else ""
    then = "" if most == _MOST_MISTAKES else "then "
    sentence = f"{then}{', or '.join(looks)}{same}: {_plain(after)} {unit} RMS {stood}; {', or '.join(advice)}"
    out = [Mistake(sentence, before, after)]
    return out if most == 1 else out + _wrong(first.model, first.data, None, most - 1)


def _much_better(
    model: ModelWithEffects, data: Measurements, datum: Bools, stands: Plausible | None, now: Plausible | None,
    anew: tuple[SetUpHypothesis, Plausible | None] | None,
) -> list[tuple[SetUpHypothesis, Plausible]]:  # fmt: skip
    """The set-up that explains the run much better than it ``stands`` or fits ``now``, first, and those that are as
    good: every coordinate that it touches gets better, and none worse."""
    every = list(hypotheses(model, data))
    first = [plausible_fit(one.model, thinned(one.data, _AT_FIRST), datum, rounds=1) for one in every]
    likely = sorted((found.misfit, k) for k, found in enumerate(first) if found is not None)
    # those that are the same to a run are all among them
    near = likely[0][0] + _AS_GOOD if likely else np.inf
    likely = [pair for place, pair in enumerate(likely) if place < _LOOKED_AT or pair[0] < near]
    fitted = [(every[k], plausible_fit(every[k].model, every[k].data, datum)) for _, k in likely]
    if model.stands_anywhere:
        fitted += [_anew(model, data, datum) if anew is None else anew]
    else:
        fitted += [_turned(model, data, datum, mirrored=mirrored) for mirrored in (False, True)]
    better = []
    for one, found in fitted:
        if found is None or found.relative >= _NOT_RIGHT or not _is_much_better(one, found, stands):
            continue
        if now is None or _nowhere_worse(one, found, now, data):
            better.append((one, found))
    if any(one.farther for one, _ in better):
        # an instrument that stands a little otherwise is physics, where that explains as much
        physics = min((found.misfit for found in _with_an_effect(model, data, datum)), default=np.inf)
        better = [(one, found) for one, found in better if not one.farther or found.misfit + one.farther < physics]
    best = min((found.misfit + one.farther for one, found in better), default=np.inf)
    as_good = [(one, found) for one, found in better if found.misfit < best + _AS_GOOD]
    columns = [pair for pair in better if _is_columns(pair[0], model, data)]
    # a frame may turn a little beside, to take what is left of something else: rails that lean, beams that are askew
    as_good += [
        pair
        for pair in columns
        if pair not in as_good and any(_is_nearly(pair[0], one) for one, _ in as_good if one.farther)
    ]
    if any(pair in as_good for pair in columns):
        # a turn by which axes come to lie on axes is said by their columns
        as_good = [(one, found) for one, found in as_good if not one.farther]
    if model.stands_anywhere:
        as_good = _handed(as_good, model, data)
    return sorted(as_good, key=lambda pair: pair[1].misfit + pair[0].farther)


def _is_much_better(one: SetUpHypothesis, found: Plausible, stands: Plausible | None) -> bool:
    """Whether a set-up explains the run much better than it ``stands``; or as well, with a robot as it is drawn, where
    it takes one that is not."""
    if stands is None or found.misfit + one.farther < stands.misfit - _MUCH:
        return True
    as_drawn = found.moved + one.farther < stands.moved - _FAR_FROM_DRAWN
    return as_drawn and found.relative < stands.relative / _BETTER


def _handed(
    as_good: list[tuple[SetUpHypothesis, Plausible]], model: ModelWithEffects, data: Measurements
) -> list[tuple[SetUpHypothesis, Plausible]]:
    """Two columns exchanged, or one of the wrong sign, are one thing to a sensor that may stand anywhere: those are
    said with which it stands as the robot does, or else that the readings are left-handed."""
    mirrors = [pair for pair in as_good if _is_columns(pair[0], model, data)]
    if len(mirrors) < 2:
        return as_good
    names = [p.name for p in model.parameters]
    turns = [names.index(name) for name in model.stands_anywhere if "turn" in name]
    square = [pair for pair in mirrors if np.linalg.norm(pair[1].values[turns]) < _SQUARE]
    others = [pair for pair in as_good if pair not in mirrors]
    if square:
        return [*others, *square]
    one, found = min(mirrors, key=lambda pair: pair[1].misfit)
    looks = f"{', '.join(data.layout.coordinates)} look left-handed: two of them exchanged, or one with the wrong sign"
    return [*others, (replace(one, looks=looks, advice="swap two of these columns, or change the sign of one"), found)]


def _nowhere_worse(one: SetUpHypothesis, found: Plausible, now: Plausible, data: Measurements) -> bool:
    """Whether each coordinate that a set-up changes is fitted better with it, and none worse.

    All are touched by another robot, other joints and other rows, but not all at once may be wrong: what is absurd
    before and after waits for the next mistake.
    """
    left, was = found.rms / found.spread, now.rms / now.spread
    with np.errstate(invalid="ignore"):
        better = (left < _BETTER * was) | (left < _SMALL)
        worse = (left > was / _BETTER) & (left > _SMALL) & (was < _ABSURD)
    if len(one.data) == len(data) and not one.farther:
        moves = now.spread > _LEAST_SPREAD * np.nanmax(now.spread)
        touched = (one.data.readings != data.readings).any(axis=0) & data.used.any(axis=0) & moves
        if touched.any() and not better[touched].all():
            return False
    return not worse[np.isfinite(was)].any()


def _is_columns(one: SetUpHypothesis, model: ModelWithEffects, data: Measurements) -> bool:
    """Whether a set-up changes columns of readings alone."""
    return one.model is model and one.data.joints is data.joints and not one.farther


def _is_nearly(one: SetUpHypothesis, frame: SetUpHypothesis) -> bool:
    """Whether a set-up puts the readings where a turned frame has them, but for a shift and a small angle."""
    use = one.data.used.all(axis=1) if one.data.layout.distance is None else one.data.used[:, :-1].all(axis=1)
    a, b = (each.data.readings[use, : each.data.coordinates] for each in (one, frame))
    a, b = a - np.median(a, axis=0), b - np.median(b, axis=0)
    return bool(len(a) and np.median(np.linalg.norm(a - b, axis=1)) < _NEARLY * np.median(np.linalg.norm(b, axis=1)))


def _turned(
    model: ModelWithEffects, data: Measurements, datum: Bools, *, mirrored: bool
) -> tuple[SetUpHypothesis, Plausible | None]:
    """The frame turned onto the drawing, then onto what the model predicts with the parameters that this gives."""
    one: SetUpHypothesis | None = None
    found: Plausible | None = None
    values = np.zeros(len(datum))
    try:
        for _ in range(_TURNS):
            one = turned_frame(model, data, values, mirrored=mirrored)
            found = None if one is None else plausible_fit(model, one.data, datum)
            if found is None:
                break
            values = found.values
    except NOT_COMPUTED:
        found = None
    return one or SetUpHypothesis("", "", model, data), found


def _since(
    model: ModelWithEffects, data: Measurements, now: Plausible, one: SetUpHypothesis, found: Plausible | None
) -> list[Mistake]:
    """That the instrument was set up anew, or readings have moved by a row, where a fit that wild rows do not move
    leaves much of all rows on one side of a moment, and of next to none beyond it, and that is all that is wrong with
    them."""
    if found is None:
        return []
    moved: Bools = np.asarray((one.data.readings != data.readings).any(axis=1))

    def off(rows: Measurements, values: Floats) -> Floats:
        return np.where(data.used, rows.readings - model.predict(rows, values), 0.0)

    was, now_is = off(data, now.values), off(one.data, found.values)
    wild = np.abs(was) > _WILD * np.where(np.isfinite(now.rms), now.rms, np.inf)
    far, used = np.asarray(wild.any(axis=1)), np.asarray((data.used & one.data.used).any(axis=1))
    side = moved if far[moved & used].mean() > far[~moved & used].mean() else ~moved
    rms = [float(np.sqrt(np.mean(each[side & used] ** 2))) for each in (was, now_is)]
    right = min(_BETTER * rms[0], _NOT_RIGHT * float(np.nanmax(found.spread)))
    if far[side & used].mean() < _WHOLE or far[~side & used].mean() > 1.0 - _WHOLE or rms[1] > right:
        return []
    unit, per_unit = data.layout.unit, data.layout.per_unit
    left = f"{_plain(per_unit * rms[1])} {unit} RMS instead of {_plain(per_unit * rms[0])} there"
    return [Mistake(f"{one.looks}: {left}; {one.advice}", per_unit * rms[0], per_unit * rms[1])]


def _anew(model: ModelWithEffects, data: Measurements, datum: Bools) -> tuple[SetUpHypothesis, Plausible | None]:
    """The rows before an instrument was set up anew, as they would have been seen since."""
    one, found = SetUpHypothesis("", "", model, data), None
    for _ in range(_MOST_MISTAKES):
        try:
            again = set_up_anew(model, one.data)
        except NOT_COMPUTED:
            again = None
        better = None if again is None else plausible_fit(model, again.data, datum)
        # once more where that is worth it
        if (
            again is None
            or better is None
            or (found is not None and better.misfit + again.farther > found.misfit - _MUCH)
        ):
            break
        one = again if found is None else replace(again, looks=f"{one.looks}, and {again.looks.partition('looks ')[2]}")
        found = better
    return one, found


def _datum(model: ModelWithEffects, data: Measurements) -> Bools | None:
    """Parameters that only shift readings; by the first set-up that can be computed."""
    for one in chain([SetUpHypothesis("", "", model, data)], hypotheses(model, data)):
        try:
            return may_be_anything(one.model, one.data)
        except NOT_COMPUTED:
            continue
    return None


def _plain(value: float) -> str:
    """Three digits, never as a power of ten."""
    return f"{float(f'{value:.3g}'):,.12g}"


def _moves(model: ModelWithEffects, data: Measurements, now: Plausible) -> bool:
    """Whether the robot was driven anywhere, beside what is left, or beside what is left at one place, where repeats
    tell that: at one place readings are all noise. Where its drawing moves no reading, as that of a ball bar on a
    circle, all that moves is what the robot does wrong."""
    some = thinned(data)
    drawn = model.predict(some, model.start(data))
    driven = min(float(np.ptp(one, axis=0).max()) for one in (model.predict(some, now.values), drawn))
    left = now.rms_of_all
    return driven > left or (driven > _HARDLY * left and bool(np.isfinite(_usual_noise(data)).any()))


def _is_physics(model: ModelWithEffects, data: Measurements, datum: Bools, now: Plausible) -> bool:
    """Whether a known effect of plausible size takes most of what is left: where readings move little, a large part of
    that may be physics."""
    return any(found.relative < min(_ABSURD, _MOST * now.relative) for found in _with_an_effect(model, data, datum))


def _with_an_effect(model: ModelWithEffects, data: Measurements, datum: Bools) -> Iterator[Plausible]:
    """Fits with plausible parameters, each with one known effect."""
    for effect in model.is_testable(tuple(model.known_effects.values()), data)[0]:
        if effect.search is None:
            more = model.with_effect(effect)
            found = plausible_fit(more, data, np.append(datum, np.zeros(len(effect.parameters), dtype=bool)))
            if found is not None:
                yield found


def _all_noise(now: Plausible, before: float, unit: str) -> Mistake:
    """That readings differ at one pose about as much as between poses."""
    sentence = (
        f"readings of one pose differ by {_plain(before)} {unit} RMS, {100 * now.relative:.0f} % of how far "
        "all readings move: the poses are too close together, or poses and readings do not belong together"
    )
    return Mistake(sentence, before)


def _nothing_usual(now: Plausible, before: float, unit: str, data: Measurements) -> Mistake:
    """That the fit is absurd and nothing that is usually mistaken explains it."""
    sentence = (
        f"nothing that is usually mistaken explains the run: {_plain(before)} {unit} RMS are left with parameters of "
        f"plausible size, {100 * now.relative:.0f} % of how far the readings move; compare a pose or two with the "
        "robot's file by hand"
    )
    return Mistake(sentence + frozen(data), before)
