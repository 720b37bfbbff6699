"""Which runs may say that nothing has changed: what each would have shown where the robot works.

A change is measured where the robot is used, not where it happened to be read: three places in a corner see nothing of
what goes on elsewhere. The sensor's stand is free there as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import scipy

from ..adaptive.gate import TIMES, Power, Sight, Silent, power_of, still
from ..base import linalg
from ..base.figures import listed, number
from ..base.types import Floats
from ..data import Measurements
from ..errors import SherkitError
from ..evidence.base import Base
from ..evidence.linearised import step_gains, within
from ..evidence.run import Run, unit
from ..evidence.thresholds import NEARLY_ALWAYS
from ..evidence.whitening import orthonormal
from ..fit.folds import blocks
from ..fit.set_up import set_up_mistakes
from .change_model import SEEN, ChangeRows, estimated
from .pooled_fit import Joined
from .runs import RunData, stand_of

# -- Whether a promise is broken ---------------------------------------------------------------------------------------
# Whether a promise is broken: a test of the changes that would break it.
#
# Every candidate, and every smooth error that none of them makes, is taken in sizes that leave an error of so many
# times what was promised, both ways, and the likelihood ratios of these against "nothing has changed" are averaged: of
# all tests of a level the one that finds most of them (Neyman and Pearson, 1933). Noise is unknown (Jeffreys' prior);
# what the calibration does not know is free, as large as it is unknown. The level is counted on draws of noise at the
# very poses of the run, so that no candidates and no correlations between them are approximated.

#: Sizes of the error, in promises, that are looked for.
_SIZES = (1.2, 1.5, 2.0, 3.0, 6.0)
#: Combinations of an effect's parameters, drawn at random, and draws of noise.
_WAYS, _DRAWS = 24, 800
#: The weight of all smooth fields beside that of all candidates.
_FIELDS = 0.5
#: Errors, in promises, of which it is told whether they would have been found.
_TOLD = (1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0, 16.0, 25.0, 40.0, 100.0, 300.0)


def broken(base: Base, stand: Floats, promised: float, level: float, fields: Sequence[Floats]) -> tuple[float, float]:
    """The chance that noise alone looks as much like a broken promise as these readings, and the least error, in
    promises, that would have been found at a ``level`` (infinite where none would).

    The promise is one of a reading (root mean square, in noises). It is tested with the blocks of ``base``, whose first
    rows are the readings, and with ``fields`` (n, m, k) of their rows; ``stand`` (n·m, s) are the columns of where the
    sensor stands.
    """
    columns, ways, share = _ways(base, stand, promised, fields)
    residual, free = base.residual, base.free
    if not len(share) or free < 2 or not residual.any():
        return 1.0, np.inf
    gram = ways.T @ (columns.T @ columns) @ ways
    answers, held, left = (np.zeros((k, _DRAWS)) for k in (columns.shape[1], base.basis.shape[1], 1))
    rng = np.random.default_rng(0)
    for some in blocks(len(residual)):
        # as many numbers as there are readings: what the base holds of them depends on no choice of its columns
        drawn = rng.normal(size=(some.stop - some.start, _DRAWS))
        answers += columns[some].T @ drawn
        held += base.basis[some].T @ drawn
        left += np.square(drawn).sum(axis=0)
    answers, left = ways.T @ answers, (left - np.square(held).sum(axis=0))[0]
    squares = np.diag(gram)[:, None]
    whole = float(residual @ residual)
    seen = ways.T @ (columns.T @ residual)
    scale = np.sqrt(whole / free)
    still = _ratio(squares, share, scale * answers, scale**2 * left, free)
    # the draw that is seen counts too
    told_by = _ratio(squares, share, seen[:, None], np.array([whole]), free)[0]
    chance = float((still >= told_by).sum() + 1) / (_DRAWS + 1)
    # what would have been found is asked of the noise alone, as large as these rows allow it to be: of checks whose
    # noise happens to look small, too many would claim to have found it
    told = float((np.square(seen) / squares[:, 0]).max())
    scale = np.sqrt(max(whole - told, 1e-12 * whole) / scipy.special.chdtri(free - 1, NEARLY_ALWAYS))
    answers, left = scale * answers, scale**2 * left
    limit = float(np.quantile(_ratio(squares, share, answers, left, free), 1.0 - level))
    which = rng.choice(len(share), _DRAWS, p=share / share.sum())
    signs = rng.choice([-1.0, 1.0], _DRAWS)
    own = answers[which, np.arange(_DRAWS)]
    before, less = _TOLD[0], 0.0
    for size in _TOLD:
        moved = left + 2.0 * size * signs * own + size**2 * squares[which, 0]
        found = _ratio(squares, share, answers + size * signs * gram[:, which], moved, free)
        share_found = float(np.mean(found > limit))
        if share_found >= NEARLY_ALWAYS:
            return chance, before + (size - before) * (NEARLY_ALWAYS - less) / (share_found - less)
        before, less = size, share_found
    return chance, np.inf


def smooth_fields(model: Any, rows: Measurements, values: Floats, axes: Sequence[int]) -> list[Floats]:
    """Columns (n, m, m) of errors along each axis of the robot that go with the places of rows or with a product of two
    of them: what a change does that is in no catalogue, wherever the sensor stands."""
    places = model.place(rows, np.asarray(model.predict(rows, values)), values).values()
    turn, m = model.axes_of_readings(rows, values), len(axes)
    along = np.eye(m) if turn is None or len(turn) != m else np.asarray(turn, dtype=float)
    u = [unit(one) for one in places if np.ptp(one) > 0]
    functions = [*u, *(a * b for k, a in enumerate(u) for b in u[k:])]
    return [one[:, None, None] * along for one in functions]


def _ways(base: Base, stand: Floats, promised: float, fields: Sequence[Floats]) -> tuple[Floats, Floats, Floats]:
    """All columns (N, k) beside the base, coefficients (k, v) of them, each way an error of one promise, and the share
    of each."""
    rng = np.random.default_rng(0)
    basis, count, family = orthonormal(stand), len(stand), base.family
    # ways of all of an effect are those of its parts, too
    whole = [block for block in family.blocks if block.pattern is None]
    raws = [family.run.flat(family.columns.raw(block.at[: len(block.at) - block.zeros])) for block in whole]
    weight = [1.0 / max(len(raws), 1)] * len(raws) + [_FIELDS / max(len(fields), 1)] * len(fields)
    # of what is known of parameters, whose rows stand behind those that were read, they say nothing
    raws += [family.run.flat(np.pad(one, ((0, len(family.run) - len(one)), (0, 0), (0, 0)))) for one in fields]
    every = np.concatenate([np.zeros((len(base.residual), 0)), *raws], axis=1)
    wide = [raw.shape[1] for raw in raws]
    del raws
    left = every - base.basis @ (base.basis.T @ every)
    ways, share, start = [np.zeros((every.shape[1], 0))], [], 0
    for count_of, part in zip(wide, weight, strict=True):
        at = slice(start, start := start + count_of)
        raw = every[:, at]
        mine = np.ones((1, 1)) if raw.shape[1] == 1 else rng.normal(size=(raw.shape[1], _WAYS))
        size, whole = shows(raw[:count] @ mine, basis), np.sqrt(np.square(raw @ mine).mean(axis=0))
        # what this stand or the calibration's own doubts take up is no error that could be seen
        known = (size > SEEN * whole) & (np.square(left[:, at] @ mine).sum(axis=0) > SEEN**2 * whole**2)
        some = np.zeros((every.shape[1], int(known.sum())))
        some[at] = mine[:, known] * (promised / size[known])
        ways.append(some)
        share += [part / max(known.sum(), 1)] * int(known.sum())
    # each of unit length: what an instrument does metres away is a million times what a joint does
    length = np.maximum(np.linalg.norm(left, axis=0), 1e-300)
    return left / length, np.concatenate(ways, axis=1) * length[:, None], np.array(share)


def shows(columns: Floats, basis: Floats) -> Floats:
    """The root mean square (v,) that the stand of the sensor leaves of columns (n, v) of readings."""
    return np.asarray(np.sqrt(np.square(columns - basis @ (basis.T @ columns)).mean(axis=0)))


def error_of_lead(base: Base, stand: Floats) -> float:
    """The error that the likeliest change makes at these places (root mean square of a reading, in noises)."""
    family = base.family
    if not len(family):
        return 0.0
    columns = family.run.flat(family.columns.raw(family.blocks[int(np.argmax(base.each))].at))
    value, _, _ = estimated(columns, base.basis, base.residual)
    return float(shows((columns @ value)[: len(stand), None], orthonormal(stand))[0])


def _ratio(squares: Floats, share: Floats, answers: Floats, left: Floats, free: int) -> Floats:
    """Logarithms (d,) of the mean likelihood ratio for each of d residuals, but for a constant: by the ``squares``
    (v, 1) of the ways, the ``answers`` (v, d) of the residuals to them, and their own square ``left`` (d,)."""
    out = np.full(answers.shape[1], -np.inf)
    for size in _SIZES:
        for sign in (-1.0, 1.0):
            moved = np.log1p((size**2 * squares - 2.0 * sign * size * answers) / left)
            each = np.log(share)[:, None] - 0.5 * free * moved
            top = each.max(axis=0)
            out = np.logaddexp(out, top + np.log(np.exp(each - top).sum(axis=0)))
    return out


# -- Which runs may vouch ----------------------------------------------------------------------------------------------

#: Places that stand for the workspace.
_PLACES = 120
#: A run is asked for mistakes of its set-up where it is off by this part of how far its readings move.
_MISTAKEN = 0.01
#: Repeats beside one of each pose that tell a step in time; the part of their scatter that one takes.
_FEWEST_AGAIN, _ALL_OF_IT = 8, 0.8


def errors_at_work(rows: ChangeRows, data: Measurements) -> dict[str, Floats]:
    """By candidate the mean square of a row's error (k, k), in the unit of the readings, where the robot works: in the
    workspace, where the robot's file says how far it may go, else where the run was."""
    try:
        reachable = rows.model.reachable(data, rows.values)
        if reachable is not None and len(reachable.rows) > 1:
            return _errors(rows, reachable.rows)
    except SherkitError:
        # such as a grid that a camera does not see: the run's own places are known to be read
        pass
    return _errors(rows, data)


def _errors(rows: ChangeRows, every: Measurements) -> dict[str, Floats]:
    """The same over rows, without what the stand of the sensor takes up."""
    there = every.select(np.random.default_rng(0).permutation(len(every))[:_PLACES])
    basis, out = orthonormal(stand_columns(rows.model, there, rows.values, rows.axes)), {}
    for name, each in rows.columns_at(there).items():
        flat = each.reshape(-1, each.shape[2])
        left = flat - basis @ (basis.T @ flat)
        if np.square(left).sum() > SEEN**2 * np.square(flat).sum() > 0:
            out[name] = left.T @ left / len(there) * there.layout.per_unit**2
    return out


def stand_columns(model: Any, rows: Measurements, values: Floats, axes: tuple[int, ...]) -> Floats:
    """Columns (n, m, s) of where the sensor stands, of rows that read what a model says."""
    exact = rows.with_readings(np.zeros(rows.readings.shape) + model.predict(rows, values))
    return stand_of(model, exact, values, axes, np.ones((len(rows), len(axes)), dtype=bool)).columns


def sights_of(
    rows: ChangeRows, run: Run, factors: Floats, there: Mapping[str, Floats], noise: float, settings: int = 1
) -> dict[str, Sight]:
    """What a ``run`` of rows sees of candidates at these factors, beside what is free in it, over the ``noise``."""
    out = {}
    for effect in rows.candidates:
        if effect.name in there:
            whole = run.flat(rows.columns_of(effect, factors))
            left = (whole - run.basis @ (run.basis.T @ whole)) / max(noise, 1e-300)
            # causes have half of the weight, as in the evidence
            weight = 0.5 / len(rows.candidates) / settings
            acts = int((np.abs(whole).max(axis=1) > 0).sum())
            out[effect.name] = Sight(left, acts, weight, there[effect.name])
    return out


class Gate:
    """What joined runs could see: the power of each later one, and what the model of the first leaves unknown there."""

    def __init__(self, joined: Joined, required: float, alarm: float) -> None:
        self.joined, self.required, self.alarm = joined, required, alarm
        self._unit = joined.runs[0].data.layout
        self._there = errors_at_work(joined, joined.runs[0].data)
        self._run = run = joined.run()
        self._free = len(run.residual) - run.basis.shape[1]
        left = run.residual - run.basis @ (run.basis.T @ run.residual)
        self._noise = max(1.0, float(np.sqrt(left @ left / max(self._free, 1))))

    def power(self, at: int) -> Power:
        """Of one run: a change in it alone."""
        runs = len(self.joined.runs)
        sights = sights_of(self.joined, self._run, np.eye(runs)[at], self._there, self._noise, runs - 1)
        return power_of(sights, self.required, self._free, self.alarm)

    def first(self) -> Silent | None:
        """Why the first run cannot be what others are held against: what it leaves unknown of the model is, where the
        others were read, more than a change that must be seen."""
        joined = self.joined
        first = joined.runs[0]
        own = first.own[first.used] / (first.sigma or joined.noise)
        sizes = np.array([p.size for p in joined.model.parameters])
        covariance = linalg.inv((own * sizes).T @ (own * sizes) + np.eye(len(sizes)))
        unknown = max(_unknown(run, sizes, covariance) for run in joined.runs[1:]) * self._unit.per_unit
        if unknown <= TIMES * self.required:
            return None
        return Silent(
            f"its {len(first.data)} rows leave the model unknown by {number(unknown)} {self._unit.unit} where the "
            f"later runs were read", "measure it at more places, over all of the workspace, before anything changes",
        )  # fmt: skip

    def mute(self) -> dict[int, Silent]:
        """Runs, by their numbers, that say nothing since something is wrong with them: later ones in which a usual
        mistake of the set-up is seen, or those in which a joint is stuck."""
        joined = self.joined
        found = {
            k: mistaken(joined.model, run.data, joined.axes, error_in_another(run))
            for k, run in enumerate(joined.runs[1:], 1)
        }
        return {k: one for k, one in found.items() if one is not None} or self._stuck()

    def _stuck(self) -> dict[int, Silent]:
        """Runs, by their numbers, that are far off where a joint stands still that moves in others."""
        runs, before = self.joined.runs, float(self.joined.fit.error.rms)
        far, out = TIMES * self.required, {}
        for k, run in enumerate(runs):
            off = error_in_another(run) if k else before
            others = [other.data for j, other in enumerate(runs) if j != k]
            if off > (max(far, TIMES * before) if k else far) and (held := held_in(run.data, others)):
                out[k] = stuck(held, f"and it is off by {number(off)} {self._unit.unit}")
        return out

    def later(self, at: int, power: Power, before: float) -> Silent | None:
        """Why a later run cannot say that nothing has changed."""
        run, unit = self.joined.runs[at], self._unit.unit
        if not power.speaks and self.joined.is_apart(at):
            return Silent(
                "it stands at other places than the first run: what the model lacks differs there too",
                "measure once more where the first run was read",
            )
        if not power.speaks:
            noise = (run.sigma or self.joined.noise) * float(np.sqrt(len(self.joined.axes))) * self._unit.per_unit
            return unable(power, noise, unit, run.data, self.joined.axes)
        # what follows the temperature is no change, and none need explain it
        off = error_in_another(run, [run.columns[effect.name] for effect in self.joined.growth])
        if off <= TIMES * max(self.required, before):
            return None
        return Silent(
            f"it is off by {number(off)} {unit}, where {number(self.required)} are required, and no change explains it",
            "look whether it is a run of this robot, and measure it again",
        )  # fmt: skip


def mistaken(model: Any, data: Measurements, axes: Sequence[int], off: float) -> Silent | None:
    """Why a run says nothing that is ``off`` by a good part of how far its readings move, and in which a usual mistake
    of the set-up is seen: what it does to a run no change of the robot should explain."""
    moves = np.square(data.readings - np.nanmean(data.readings, axis=0))[:, list(axes)]
    spread = float(np.sqrt(np.nansum(moves) / len(moves))) * data.layout.per_unit
    if off <= _MISTAKEN * spread:
        return None
    found = set_up_mistakes(model, data)
    return Silent(found[0].sentence, "put that right, and compare again") if found else None


def held_in(data: Measurements, others: Sequence[Measurements]) -> list[str]:
    """Joints that stand still in a run and move in another one."""
    moves = np.any([~still(other.joints) for other in others], axis=0)
    return [name for name, one in zip(data.layout.joints, still(data.joints) & moves, strict=True) if one]


def stuck(held: Sequence[str], so: str) -> Silent:
    """That joints do not move in a run, and what is wrong with it."""
    verb = "does" if len(held) == 1 else "do"
    return Silent(f"its {listed(held)} {verb} not move, {so}", "look at that encoder, and measure again")


def unable(power: Power, noise: float, unit: str, data: Measurements, axes: Sequence[int]) -> Silent:
    """Why rows of this power cannot say that nothing has changed; ``noise`` is that of a row, as people read it."""
    if (stepped := _stepped(data, axes)) is not None:
        return stepped
    most = TIMES * power.required
    sees = f"a change from {number(power.smallest)} {unit} on" if np.isfinite(power.smallest) else "no change"
    why = f"it would show {sees}, and must show one of {number(most)} {unit}"
    if noise <= power.required:
        return Silent(why, "measure at a dozen places or more, over the whole workspace")
    times = float(np.ceil((power.smallest / most) ** 2))
    more = f"about {number(times)} times as many readings" if np.isfinite(times) else "more readings"
    return Silent(f"its noise is {number(noise)} {unit}: {why}", f"take {more}, or measure with less noise")


def _stepped(data: Measurements, axes: Sequence[int]) -> Silent | None:
    """That readings of the same poses differ by one step in time, and so are no noise."""
    rows = np.flatnonzero(data.used[:, list(axes)].all(axis=1))
    rows = rows[np.argsort(data.order[rows], kind="stable")]
    group = np.unique(data.groups[rows], return_inverse=True)[1].ravel()
    count = np.bincount(group).astype(float)
    if len(rows) - len(count) < _FEWEST_AGAIN:
        return None
    read = data.readings[rows][:, list(axes)]
    off = read - np.stack([np.bincount(group, one) / count for one in read.T], axis=1)[group]
    poses = ((group == k)[:, None] / np.sqrt(count[k]) for k in range(len(count)))
    cuts = np.arange(1, len(rows))
    taken = step_gains(off, within(poses, cuts), cuts, 1.0 / len(rows))
    first = int(cuts[np.argmax(taken)])
    if taken.max() < _ALL_OF_IT * np.square(off).sum():
        return None
    where = data.place(rows[first : first + 1]).removeprefix(f"{data.source}: ")
    return Silent(
        f"its readings of the same poses differ by one step, from {where} on: the instrument or the target was "
        "knocked, it seems",
        "measure again, or give the rows before and after as two set-ups",
    )


def _unknown(run: RunData, sizes: Floats, covariance: Floats) -> float:
    """The root mean square of a row's reading that is unknown (in its unit), beside the stand of the sensor."""
    basis = orthonormal(np.where(run.used[:, :, None], run.stand.columns, 0.0))
    own = (np.where(run.used[:, :, None], run.own, 0.0) * sizes).reshape(-1, len(sizes))
    own = own - basis @ (basis.T @ own)
    total = float(np.einsum("ij,jk,ik->", own, covariance, own))
    return float(np.sqrt(max(total, 0.0) / max(int(run.used.any(axis=1).sum()), 1)))


def errors_of(joined: Joined) -> list[float]:
    """How far the model of the first run is off in each: in its own, on poses held out, as wherever it is said."""
    return [float(joined.fit.error.rms), *map(error_in_another, joined.runs[1:])]


def error_in_another(run: RunData, beside: Sequence[Floats] = ()) -> float:
    """How far the model of the first run is off in another (root mean square of a row), as people read it; ``beside``
    columns (n, m, k) each that are fitted to it."""
    left = np.where(run.used, run.stand.residual, 0.0)
    if beside:
        every = np.where(run.used[:, :, None], np.concatenate([run.stand.columns, *beside], axis=2), 0.0)
        basis = orthonormal(every.reshape(left.size, -1))
        left = left - (basis @ (basis.T @ left.ravel())).reshape(left.shape)
    rows = max(int(run.used.any(axis=1).sum()), 1)
    return float(np.sqrt(np.square(left).sum() / rows)) * run.data.layout.per_unit
