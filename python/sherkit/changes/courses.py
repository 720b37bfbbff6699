"""Evidence that something has changed: every block of columns twice, as all runs have it and in a course over the runs.

What all runs lack is a nuisance that they share: a change is what its own columns say beside the common ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .._core import blocks_taken as taken
from ..base import linalg
from ..base.types import Floats, Ints
from ..errors import SherkitError
from ..evidence.base import Base, log_bayes, log_bayes_of_fit, total
from ..evidence.blocks import Block, ColumnPart, Columns
from ..evidence.family import Family, everything
from ..evidence.names import Names, Told, judged_names
from ..evidence.plausible import is_plausible
from ..evidence.sets import ONE_MORE, EffectSet, Sets, ShapeDescription
from ..evidence.thresholds import ALARM, LEFT, MOST, TIED
from .change_model import About, ChangeRows
from .pooled_fit import Joined

#: Changes beside which it is looked for what all runs lack alike.
_MOST_BESIDE = 3
#: A change of one unit of the noise must be seen with readings of so many beyond what is free.
_FEWEST = 12
#: Steps of a fit in full.
_REFITS = 3
#: Part of what is seen that one change leaves at most that says nearly all of it; any other alone leaves so many times
#: as much. Of robots that bent where no catalogue has it the nearest left 0.35 and more, none of true ones above 0.03.
_LEAVES, _OTHERS_LEAVE = 0.05, 3.0
#: Times as much as a change that where it has its zero may move readings by: rails lean about a foot far below.
_ZEROS = 12.0


@dataclass(frozen=True, eq=False)
class Courses:
    """What may change in these ``courses`` (S, R), the factors of each run: a ``family`` of which each block has the
    columns of the change, then as many that all runs have in common."""

    joined: Joined
    courses: Floats
    family: Family

    @classmethod
    def of(cls, joined: Joined, courses: Sequence[Floats], *, waves: bool = True) -> Courses:
        """Every candidate and every shape, without ``waves`` those alone that have no period."""
        run = joined.run()
        made, blocks = everything(run)
        kept = [block for block in in_parts(blocks) if waves or block.period is None]
        factors = [joined.by_row(list(course), 0.0) for course in (*courses, np.ones(len(joined.runs)))]
        # a function of a reading itself, of one unit in all runs, over the noise of each
        over = joined.by_row([joined.noise / joined.sigma(one) for one in joined.runs], 0.0)
        columns, twice = _times(made, kept, zeros_at(joined, kept), np.array(factors, dtype=float), over)
        return cls(joined, np.array(courses, dtype=float), Family(run, made=(columns, twice)))

    @cached_property
    def base(self) -> Changed:
        """What is free of all runs."""
        return Changed.of(self.family, self.family.run)

    @property
    def evidence(self) -> float:
        """By how much the readings favour that something has changed: at other places a shape says no more than what
        the model lacks there."""
        apart = any(self.joined.is_apart(k) for k in range(len(self.joined.runs)))
        return total(self.base.each[self.family.is_effect]) if apart else self.base.evidence

    @property
    def quiet(self) -> str:
        """``unchanged`` or ``undecided`` where nothing is seen to have changed, else empty."""
        if self.evidence >= ALARM:
            return ""
        readings = sum(run.used.sum() - run.stand.columns.shape[2] for run in self.joined.runs[1:])
        enough = min(readings, self.base.free) >= _FEWEST
        return "unchanged" if self.evidence < LEFT and enough else "undecided"


#: What to do where it is ``undecided``.
MEASURE_MORE = "measure more poses: these are too few to say whether anything has changed"


def change_verdict(named: Sequence[object], *, explains: bool) -> str:
    """What is said of changes of which there is evidence, by what may be ``named`` and whether it explains all."""
    return "unexplained" if not named else "changed" if explains else "partly explained"


def in_parts(blocks: Sequence[Block]) -> list[Block]:
    """Blocks, and those of effects once more of each of their parts alone: what has changed of one limb pays for no
    other."""
    return [*blocks, *(
        replace(block, effect=effect.of(numbers), at=block.at[numbers], pattern=part)
        for block in blocks if (effect := block.effect) is not None and len(block.at) == len(effect.parameters)
        for part, numbers in effect.parts.items()
    )]  # fmt: skip


def zeros_at(rows: ChangeRows, blocks: Sequence[Block]) -> list[Ints]:
    """Of each block the columns of the parameters that take up where it has its zeros."""
    at = {block.name: block.at for block in blocks if block.pattern is None}
    none = np.zeros(0, dtype=np.int64)
    every = ([] if block.effect is None else rows.zeros(block.effect) for block in blocks)
    return [np.concatenate([none, *(at[one.name] for one in zeros)]) for zeros in every]


def _times(
    columns: Columns, blocks: Sequence[Block], zeros: Sequence[Ints], factors: Floats, over: Floats
) -> tuple[Columns, list[Block]]:  # fmt: skip
    """Every block, with its ``zeros``, in each course but the last of ``factors`` (S + 1, n), beside itself in the
    last; what acts on one axis alone times ``over`` (n,)."""
    parts, number = [], np.full(len(columns), -1, dtype=np.int64)
    stride = np.zeros(len(columns), dtype=np.int64)
    asked = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *(block.at for block in blocks)]))
    starts = [*columns.starts.tolist(), len(columns) + 1]
    first = 0
    for part, begin, end in zip(columns.parts, starts[:-1], starts[1:], strict=False):
        mine = asked[(asked >= begin) & (asked < end)]
        function, _, _ = part.split(mine - begin)
        used = np.unique(function)
        wide = len(part) // max(part.functions.shape[1], 1)
        number[mine] = first + np.searchsorted(used, function) * wide + (mine - begin) % max(wide, 1)
        stride[mine] = len(used) * wide
        mine_by = factors * over if part.alone else factors
        at = columns.visits.first if part.posed else slice(None)
        every = np.concatenate([part.functions[:, used] * one[at, None] for one in mine_by], axis=1)
        parts.append(ColumnPart(every, part.carriers, part.axes, part.posed))
        first += len(parts[-1])
    made = Columns(columns.run, columns.visits, parts)
    out, last = [], len(factors) - 1
    for since in range(last):
        for block, zero in zip(blocks, zeros, strict=True):
            change, common = (number[block.at] + k * stride[block.at] for k in (since, last))
            there = (made.length[change] > 0) & (made.length[common] > 0)
            # the geometry that all runs share is free in all of them
            more = number[zero] + since * stride[zero] if there.any() else zero[:0]
            again = np.repeat(common[there][:1], len(more))
            both = np.concatenate([change[there], more, common[there], again])
            out.append(replace(block, at=both, since=since))
    return made, out


class Changed(Base):
    """What a change says beside what all runs have of it: of each block the first half of its columns beside the last
    half."""

    @cached_property
    def _found(self) -> Floats:
        """Gain and rank of each block (3, 2, B): of what is common, of the change by itself, of it beside the first."""
        out = np.zeros((3, 2, len(self.family)))
        for (which, at, _), gram in zip(self.family.groups, self.left, strict=True):
            k, least, right = at.shape[1] // 2, self.family.least[which], self.right[at]
            there = np.einsum("bkk->bk", gram)[:, k:] > least[:, None]
            common = np.where(there[:, :, None] & there[:, None, :], gram[:, k:, k:], 0.0)
            across = np.where(there[:, None, :], gram[:, :k, k:], 0.0)
            ridge = least[:, None, None] * np.eye(k)
            part = linalg.solve(common + ridge, across.transpose(0, 2, 1)).transpose(0, 2, 1)
            mine = right[:, :k] - np.einsum("bij,bj->bi", part, np.where(there, right[:, k:], 0.0))
            out[0][:, which] = taken(gram[:, k:, k:], right[:, k:], least)
            out[1][:, which] = taken(gram[:, :k, :k], right[:, :k], least)
            out[2][:, which] = taken(gram[:, :k, :k] - part @ across.transpose(0, 2, 1), mine, least)
        return out

    def in_common(self, block: Block) -> int:
        """What all runs have of it."""
        return len(block.at) // 2

    @cached_property
    def gains(self) -> tuple[Floats, Floats]:
        """Of each change beside what is common."""
        return self._found[2][0], self._found[2][1]

    @cached_property
    def log_bf(self) -> Floats:
        """Logarithm of the Bayes factor of each change (B,) beside what is common."""
        return self._log_bf(2, *self._found[0])

    def _log_bf(self, number: int, less: Floats | float = 0.0, used: Floats | float = 0.0) -> Floats:
        gain, rank = self._found[number]
        left = np.maximum(self.rss - less, 1e-12 * self.rss + 1e-300)
        return log_bayes(gain / left, rank, np.asarray(self.free - used), len(self.residual))

    @cached_property
    def common(self) -> Floats:
        """What of each block (B,) all runs have in common says, with its prior weight."""
        return self.family.log_weight + self._log_bf(0)

    def lasting(self) -> Block | None:
        """What all runs lack, where that is likelier than any change, or nearly; None where nothing is."""
        i, change = int(np.argmax(self.common)), self.family.log_weight + self._log_bf(1)
        return self.family.blocks[i] if self.common[i] > max(ALARM, float(change.max()) - TIED) else None


def lacking(joined: Joined) -> Joined:
    """The same runs, and free in all of them alike what the model lacks from the first on: as long as something that
    lasts is nearly as likely as all that may have begun with a later run, beside the changes that are far likelier."""
    made = Courses.of(joined, joined.steps)
    base, columns = made.base, made.family.columns
    lasting: list[Ints] = []
    beside = 0
    while len(lasting) < MOST:
        block = base.lasting()
        if block is not None:
            lasting.append(block.at[len(block.at) // 2 :])
            base = base.with_columns(columns.of(lasting[-1]))
            continue
        i, beside = int(np.argmax(base.effects)), beside + 1
        if base.effects[i] < ALARM or beside > _MOST_BESIDE:
            break
        at = base.family.blocks[i].at
        base = base.with_columns(columns.of(at[: len(at) // 2]))
    return joined.lacking(columns.raw(np.concatenate(lasting))) if lasting else joined


class ChangeSets(Sets):
    """Sets of changes in ``courses`` (S, R), each fitted in full to the ``rows``."""

    # to first order two limbs that bend against each other do what one that leans does
    refits = 16

    def __init__(self, rows: ChangeRows, courses: Floats, base: Base) -> None:
        super().__init__(base.family, base)
        self.rows, self.courses = rows, courses

    @property
    def every(self) -> list[EffectSet]:
        """All that were fitted, of each name the likeliest, that first."""
        fitted = sorted((one for one in self._fitted.values() if one is not None), key=lambda one: one.value)
        return sorted({one.names: one for one in fitted}.values(), key=lambda one: -one.value)

    @property
    def by_far(self) -> EffectSet | None:
        """The change that alone leaves next to nothing, and much less than any other alone; None where there is none.
        Of several that take much of what has changed together each is as likely a helper of what is in no catalogue."""
        singles = sorted((one for one in self.every if len(one.blocks) == 1), key=lambda one: one.base.rss)
        left = [one.base.rss - one.base.free for one in singles]
        if not singles or left[0] > _LEAVES * (self.base.rss - self.base.free):
            return None
        return singles[0] if len(left) == 1 or left[0] < left[1] / _OTHERS_LEAVE else None

    @property
    def _of_effects(self) -> Base:
        return self.base

    def counted(self, one: EffectSet) -> int:
        """So many numbers: two of a robot that changed are less than an effect of nine that imitates them, as of an
        instrument that is bent to any shape."""
        return sum(len(block.effect.parameters) for block in one.blocks if block.effect)

    def described(self, base: Base, most: int, starts: int) -> ShapeDescription:
        """As of any sets; as effects are, shapes in the place of all of them are held against what says most without a
        change, and not against what all runs have of themselves."""
        found = super().described(base, most, starts)
        if base is not self.base or not found.shapes or not isinstance(self.base, Changed):
            return found
        own = max(float(self.base.common[self.family.blocks.index(found.shapes[0])]), 0.0)
        return replace(found, evidence=found.evidence + own - self._still)

    def _is_zero_alone(self, about: About, number: int) -> bool:
        """Whether it is where a change, by its number, has its zero that says all, and not itself: a zero as far away
        as any is moves readings no more than so many times what the change does among them."""
        effect, course = about.changes[number]
        names = {one.name for one in self.rows.zeros(effect)}
        zeros = [
            k for k, (one, factors) in enumerate(about.changes)
            if one.name in names and np.array_equal(factors, course)
        ]  # fmt: skip
        return not about.told[number] or about.moved_by(zeros) > _ZEROS * about.moved_by([number])

    @cached_property
    def _still(self) -> float:
        return float(self.base.common.max(initial=0.0)) if isinstance(self.base, Changed) else 0.0

    def _fit(self, blocks: tuple[Block, ...]) -> EffectSet | None:
        rows = self.rows
        changes = [(block.effect, self.courses[block.since]) for block in blocks if block.effect is not None]
        best: tuple[float, EffectSet] | None = None
        weight = sum(float(self.family.log_weight[self.family.where(block)]) for block in blocks)
        # as large as they are to first order, then about that
        for k in range(_REFITS + 1):
            try:
                about, run = rows.about(changes)
                base = type(self.base).of(self.family, run)
            except (SherkitError, np.linalg.LinAlgError):
                # as far as that the robot does not reach its own poses
                break
            if any(self._is_zero_alone(about, k) for k, (effect, _) in enumerate(changes) if rows.zeros(effect)):
                # where it has its zero says all: that is no change of it
                return None
            if best is None or base.rss < best[0]:
                rank = max(base.basis.shape[1] - self.base.basis.shape[1], 1)
                part = np.array([1.0 - base.rss / self.base.rss])
                # all against what says most without a change
                bf = log_bayes_of_fit(part, rank, self.base.free, len(base.residual)) - self._still
                # zeros that moved are one change more
                value = bf + weight + ONE_MORE * (len(blocks) - 1 + any(about.told[len(changes) :]))
                plausible = all(is_plausible(about, effect) for effect, _ in changes)  # type: ignore[arg-type]
                best = base.rss, EffectSet(blocks, run, base, bf, value, plausible)
            if k < _REFITS:
                try:
                    rows = rows.at(about)
                except SherkitError:
                    break
        return None if best is None else best[1]


def named_changes(sets: ChangeSets) -> Names:
    """What has changed, as :func:`~sherkit.evidence.names.judged_names` names what is missing; of what no changes
    explain the one is named that says nearly all of it."""
    names = judged_names(sets)
    if names.lead is None or names.explains:
        return names
    one = sets.by_far
    if one is None:
        return replace(names, refused=dict.fromkeys((each.name for each in names.told), "others explain as much"))
    told = Told(one.blocks[0].name, one.value, one.value, 0.0)
    return replace(names, lead=one, told=(told,), refused={}, ties=(), beside=sets.described(one.base, MOST, 1))
