"""The search for what is missing: explanation sets first, single shapes last.

An effect *explains* where, once it is added, the largest score of the whole family, generic shapes included, is no
longer significant. Among sets that explain, the smallest and then the lowest BIC leads and the others are tied with
it. Only where no effect and no pair explains does the best single candidate enter: an effect, if it does better than
every shape, or the pair that comes nearest, if it is clearly better than that effect with whatever goes best with it;
else the shape, as the description of something that is in no catalogue.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ..base.types import Floats
from ..errors import SherkitError
from ..evidence.fitted_run import FittedRun
from ..model.effect import Effect
from .columns import Block
from .explanation import (
    CLEARLY,
    Explanation,
    as_low,
    as_near,
    bic,
    bic_of,
    lowest,
    plausible,
    refit,
    said_of_the_instrument,
    schwarz,
    schwarz_of,
    simplicity,
)
from .lack_of_fit import FLIPS
from .periods import at_the_row, best_lag, period_of
from .scan import Scan
from .shapes import Shape, wave
from .stage import Candidate, Stage, again, stage_of
from .waves import OVERSAMPLING, Waves

#: A set that explains must take at least this part of what the best candidate takes.
_TAKES = 0.85
#: Deviates beyond which no flip is needed to know that something is left.
_PLAINLY_LEFT = 15.0
#: Sets refitted in full by Schwarz's criterion, and at most as many again by what they leave.
_MOST_REFITS = 4
_MOST_PAIRS = 6
_MOST_STEPS = 4
#: Pairs whose settings are searched for again beside one another.
_MOST_SETTLED = 2
#: Rounds in which settings that hang on one another come to rest.
_ROUNDS = 4
#: A shape that takes this part of what another takes describes as well where neither describes all; how many are told.
_AS_MUCH = 0.95
_MOST_AS_WELL = 6


@dataclass(eq=False)
class SearchResult:
    """What a search found. ``added`` effects in order; ``alternatives`` sets that explain as well as the leading one;
    ``signature`` shapes that describe what no effect explains, ``as_well`` those that do as well as its first;
    ``p_first`` the familywise p before anything."""

    stages: list[Stage]
    p_first: float
    p_left: float
    added: list[Candidate] = field(default_factory=list)
    alternatives: list[Explanation] = field(default_factory=list)
    replaced: tuple[str, ...] = ()
    signature: list[Shape] = field(default_factory=list)
    as_well: list[Shape] = field(default_factory=list)


class Search:
    """Carries what stays the same through a search: data, noise, effects, level."""

    def __init__(
        self,
        base: FittedRun,
        effects: Sequence[Effect],
        rows: NDArray[np.int64],
        sigma: Floats,
        *,
        level: float,
        rho: float | None = None,
        seed: int = 0,
        periods: Sequence[tuple[str, float]] = (),
        step: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.effects = tuple(effects)
        self.rows = rows
        self.sigma = sigma
        self.level = level
        self.seed = seed
        self.periods = tuple(periods)
        self.step = step
        self.rho = rho
        self.waves: Waves | None = None
        self.base = base.on(rows, sigma)
        self._strongest_of: WeakKeyDictionary[Stage, list[Candidate]] = WeakKeyDictionary()

    def stage(self, run: FittedRun, nuisance: Sequence[Shape] = ()) -> Stage:
        """The stage of a run; the correlation of the noise is estimated once, at the first, as waves are made once."""
        rows = np.arange(len(self.rows))
        stage = stage_of(
            run, self.effects, rows, self.sigma,
            rho=self.rho, nuisance=nuisance, waves=self.waves, periods=self.periods,
        )  # fmt: skip
        self.rho, self.waves = stage.filtered.rho, stage.waves or self.waves
        return stage

    def p_value(self, stage: Stage, scan: Scan | None = None) -> float:
        """Familywise p of what is left of a run."""
        if stage.run.is_exact:
            return 1.0
        scan = stage.scan if scan is None else scan
        largest = float(scan.z_scores.max())
        if largest > _PLAINLY_LEFT:
            return 1.0 / FLIPS
        return scan.p_value(largest, level=self.level, seed=self.seed)

    # -- the search --------------------------------------------------------------------------------------

    def find(self, described: Sequence[Shape] = ()) -> SearchResult:
        """Searches until nothing significant is left, or nothing explains what is. Shapes that ``described`` the run
        are in the model from the beginning: an effect is then found in what they leave."""
        stage = self.stage(self.base)
        p = self.p_value(stage)
        found = SearchResult([stage], p_first=p, p_left=p)
        for one in described:
            stage = self._describe(found, stage, one)
            p = self.p_value(stage)
        while p <= self.level and len(found.added) + len(found.signature) < _MOST_STEPS + len(described):
            explanations, singles, nearest = self.explanations(stage)
            shape = self.simpler_shape(stage, explanations)
            if explanations and shape is None:
                lead, *others = said_of_the_instrument(explanations)
                found.added += lead.candidates
                found.alternatives = others
                found.replaced = lead.names
                stage, p = lead.stage, lead.p_left
                found.stages.append(stage)
                break
            best = shape or self.best_single(stage)
            if isinstance(best, Candidate):
                self.step(f"adding {best.name}")
                after = stage.refitted(refit(stage.run, (best,)), (best,))
                added: tuple[Candidate, ...] = (best,)
                if nearest is not None and self.beats(nearest, after, best):
                    after, added = nearest.stage, nearest.candidates
                elif not found.added:
                    # what it leaves, whatever stands in its place leaves too
                    same = [e for e in singles if e.names == (best.name,)]
                    if near := said_of_the_instrument(as_near(same, singles)):
                        after, added, found.alternatives = near[0].stage, near[0].candidates, near[1:]
                    found.replaced = tuple(c.name for c in added)
                found.added += added
                stage = after
                found.stages.append(stage)
            elif best is not None:
                stage = self._describe(found, stage, best)
            else:
                break
            p = self.p_value(stage)
        found.p_left = p
        self._prune(found)
        self._forget(found)
        return found

    def _describe(self, found: SearchResult, stage: Stage, shape: Shape) -> Stage:
        """The stage once a shape describes a part of what is left."""
        shape = again(shape, stage.shapes)
        if not found.signature:
            found.as_well = self.as_well(stage, shape)
        found.signature.append(self.refined(stage, shape))
        stage = self.stage(stage.run, found.signature)
        found.stages.append(stage)
        return stage

    def as_it_stands(self) -> SearchResult:
        """Nothing is looked for."""
        stage = self.stage(self.base)
        p = self.p_value(stage)
        return SearchResult([stage], p_first=p, p_left=p)

    def simpler_shape(self, stage: Stage, explanations: Sequence[Explanation]) -> Shape | None:
        """A single shape that explains alone what only a pair of effects does, and with clearly fewer parameters.

        Two effects that together imitate one simple cause are no explanation of it.
        """
        if not explanations or len(explanations[0].candidates) < 2:
            return None
        shape = self.best_shape(stage)
        if shape is None:
            return None
        given = stage.scan.with_columns(shape.columns)
        of_shape = schwarz(given, len(stage.scan.numbers(shape.columns)))
        image = stage.among(members := list({id(c): c for e in explanations for c in e.candidates}.values()))
        places = [[members.index(c) for c in e.candidates] for e in explanations]
        of_pair = min(
            bic_of(image.rss(*at), image.count, e.candidates) for at, e in zip(places, explanations, strict=True)
        )
        if of_shape < of_pair - CLEARLY and self.p_value(stage, given) > self.level:
            return shape
        return None

    def scores(self, stage: Stage) -> Floats:
        """Change of Schwarz's criterion by each shape, then by each candidate; infinite where nothing is left of it."""
        gain, rank = stage.scan.gains
        n = stage.scan.n * stage.scan.m
        total = stage.scan.sum_of_squares
        score = n * np.log(np.maximum(total - gain, 1e-300) / total) + rank * np.log(n)
        return np.where(rank > 0, score, np.inf)

    def best_shape(self, stage: Stage) -> Shape | None:
        """The shape with the lowest criterion, where one gains."""
        return lowest(stage, self.scores(stage))

    def as_well(self, stage: Stage, shape: Shape) -> list[Shape]:
        """Shapes that do as well as this one in its place, the simplest first, of each kind and variables one."""
        scores = self.scores(stage)
        own = float(scores[stage.shapes.index(shape)])
        # of what describes but a part, another that takes as much but for a little describes as well
        part = self.p_value(stage, stage.scan.with_columns(shape.columns)) <= self.level
        near = as_low(stage, scores, max(CLEARLY, -(1.0 - _AS_MUCH) * own if part else 0.0))
        out: dict[tuple[frozenset[str], str], Shape] = {}
        for other, _ in sorted(near, key=partial(simplicity, stage)):
            out.setdefault((frozenset(other.depends_on), other.shape), other)
        out.pop((frozenset(shape.depends_on), shape.shape), None)
        return list(out.values())[:_MOST_AS_WELL]

    def refined(self, stage: Stage, shape: Shape) -> Shape:
        """A periodic shape at the period that takes most, between its neighbours on the grid."""
        if shape.period is None:
            return shape
        name = shape.depends_on[0]
        values = stage.view.variables[name]
        spacing = 1.0 / (OVERSAMPLING * float(np.ptp(values)))
        pattern = stage.view.patterns[shape.pattern] if shape.pattern else None
        axes = range(stage.scan.m) if shape.axis is None else (shape.axis,)

        def best(at: Floats) -> float:
            """The frequency of these (k,) that leaves least."""
            image = stage.scan.image([partial(filtered, f) for f in at.tolist()])
            return float(at[np.argmin([image.rss(k) for k in range(len(at))])])

        def filtered(frequency: float, rows: slice, block: Block) -> Floats:
            del block
            waves = wave(values, 1.0 / frequency)

            def raw(part: slice) -> Floats:
                if pattern is not None:
                    return np.stack([pattern[part] * w[part, None] for w in waves], axis=2)
                on = np.eye(stage.scan.m)[list(axes)]
                return np.stack([(w[part] - w.mean())[:, None] * a for w in waves for a in on], axis=2)

            return stage.filtered.on(raw, rows)

        grid = 1.0 / shape.period + spacing * np.linspace(-1.0, 1.0, 17)
        grid = grid[grid > 0]
        return replace(shape, period=1.0 / best(best(grid) + spacing * np.linspace(-0.125, 0.125, 9)))

    def explanations(self, stage: Stage) -> tuple[list[Explanation], list[Explanation], Explanation | None]:
        """Sets of effects that explain what is left: singles, or else pairs; the leading one first. All singles that
        were refitted. Where none explains, the pair that comes nearest: by the level of the test, chance refuses the
        right one now and then."""
        candidates = self.strongest_settings(stage)
        singles = self._refitted(stage, [(c,) for c in candidates], _MOST_REFITS)
        if explaining := [e for e in singles if e.p_left > self.level]:
            return as_near(explaining, singles), singles, None
        both = [pair for pair in combinations(candidates, 2) if pair[0].name != pair[1].name]
        pairs = self._refitted(stage, both, _MOST_PAIRS)
        if explaining := [e for e in pairs if e.p_left > self.level]:
            return as_near(explaining, pairs), singles, None
        # a moment or a lag that was found alone need not be that beside another
        settled = [e for pair in pairs[:_MOST_SETTLED] if (e := self._settled(stage, pair)) is not None]
        if settled:
            names = {e.names for e in settled}
            pairs = sorted([*settled, *(e for e in pairs if e.names not in names)], key=self._rank)
            if explaining := [e for e in pairs if e.p_left > self.level]:
                return as_near(explaining, pairs), singles, None
        return [], singles, next((e for e in pairs if plausible(e, self.base)), None)

    def beats(self, pair: Explanation, after: Stage, single: Candidate) -> bool:
        """Whether a pair that leaves something is still clearly better than a single one with whatever, shape or
        effect, goes best with it: else one cause and a shape of no catalogue would be taken for two."""
        best_with_it = bic(after.scan, (single,)) + min(float(self.scores(after).min(initial=0.0)), 0.0)
        return bic(pair.stage.scan, pair.candidates) < best_with_it - CLEARLY

    def _refitted(self, stage: Stage, sets: Sequence[tuple[Candidate, ...]], most: int) -> list[Explanation]:
        """Screens sets by what they take in linear approximation, then refits and tests the best in full."""
        largest = float(stage.scan.gains[0].max())
        single = list({id(c): c for members in sets for c in members}.values())
        place = {id(c): k for k, c in enumerate(single)}
        image = stage.among(single)
        screened = []
        for members in sets:
            left = image.rss(*(place[id(c)] for c in members))
            if stage.scan.sum_of_squares - left >= _TAKES * largest:
                screened.append((bic_of(left, image.count, members), schwarz_of(left, image.count, 0), members))
        screened.sort(key=lambda s: s[0])
        # a cause of many parameters stands behind every smaller one that imitates it, however well it fits: whoever
        # comes as near the data as the first is heard too
        near = [s for s in screened[most:] if s[1] < screened[0][1] + CLEARLY]
        out = []
        for _, _, members in screened[:most] + near[:most]:
            if (made := self._explained(stage, members)) is not None:
                out.append(made)
        out.sort(key=self._rank)
        return out

    def _rank(self, e: Explanation) -> tuple[bool, float]:
        return not plausible(e, self.base), bic(e.stage.scan, e.candidates)

    def _explained(self, stage: Stage, members: tuple[Candidate, ...]) -> Explanation | None:
        """A set refitted in full, and what it leaves; None where it cannot be fitted."""
        self.step("refitting with " + " and ".join(c.name for c in members))
        try:
            run = refit(stage.run, members)
        except SherkitError:
            return None
        if stage.run.fit.converged and not run.fit.converged:
            return None
        after = stage.refitted(run, members)
        return Explanation(members, after, self.p_value(after))

    def _settled(self, stage: Stage, found: Explanation) -> Explanation | None:
        """A set with each of its settings as it takes most beside the others; None where none is searched for."""
        members = list(found.candidates)
        for _ in range(_ROUNDS):
            before = [one.setting for one in members]
            for k, one in enumerate(members):
                if one.effect.search is not None:
                    members[k] = self._beside(stage, one, members[:k] + members[k + 1 :])
            if before == [one.setting for one in members]:
                break
        if [one.setting for one in members] == [one.setting for one in found.candidates]:
            return None
        return self._explained(stage, tuple(members))

    def _beside(self, stage: Stage, one: Candidate, others: Sequence[Candidate]) -> Candidate:
        """An effect at the setting at which it takes most beside ``others``; as it is where they cannot be fitted."""
        try:
            beside = stage.refitted(refit(stage.run, others), others)
        except SherkitError:
            return one
        scored = [(g, c) for g, c in zip(beside.gains.tolist(), beside.candidates, strict=True) if c.name == one.name]
        return self._strongest(beside, scored) if scored else one

    def strongest_settings(self, stage: Stage) -> list[Candidate]:
        """One candidate per effect: where a setting is searched for, the one that takes most, made finer."""
        if (known := self._strongest_of.get(stage)) is not None:
            return known
        tried: dict[str, list[tuple[float, Candidate]]] = {}
        for gain, candidate in zip(stage.gains.tolist(), stage.candidates, strict=True):
            tried.setdefault(candidate.name, []).append((gain, candidate))
        found = self._strongest_of[stage] = [self._strongest(stage, scored) for scored in tried.values()]
        return found

    def _strongest(self, stage: Stage, scored: Sequence[tuple[float, Candidate]]) -> Candidate:
        """Of one effect at several settings, the one that takes most, made finer."""
        _, best = max(scored, key=lambda s: s[0])
        if best.effect.is_periodic:
            period = period_of(stage, [c for _, c in scored])
            return best if period is None else period.candidate
        if best.effect.is_lagging:
            at_once = next((c for c in scored if c[1].setting is None), None)
            return best_lag(stage, best, at_once)
        return at_the_row(stage, best)

    def best_single(self, stage: Stage) -> Candidate | Shape | None:
        """The candidate or shape with the lowest criterion; None where nothing gains."""
        score = self.scores(stage)
        effects = score[stage.n_shapes :]
        # an effect goes before a shape only where it does better: it does not explain, so its name must be earned
        if len(effects) and effects.min() < 0 and effects.min() <= score[: stage.n_shapes].min(initial=np.inf):
            name = stage.candidates[int(np.argmin(effects))].name
            return next(c for c in self.strongest_settings(stage) if c.name == name)
        return self.best_shape(stage)

    def _prune(self, found: SearchResult) -> None:
        """Takes out shapes and effects that later effects have made needless."""
        if found.added and found.signature:
            stage = self.stage(found.stages[-1].run)
            if (p := self.p_value(stage)) > self.level:
                found.signature, found.as_well, found.p_left = [], [], p
                found.stages.append(stage)
        if len(found.added) < 2:
            return
        for candidate in list(found.added[:-1]):
            rest = [c for c in found.added if c is not candidate]
            stage = self.stage(refit(self.base, rest), found.stages[-1].nuisance)
            p = self.p_value(stage)
            if p > self.level:
                found.added = rest
                found.stages.append(stage)
                found.p_left = p

    def _forget(self, found: SearchResult) -> None:
        """Takes out shapes of which nothing is left beside an effect that was found later."""
        scan = found.stages[-1].scan
        image, columns, kept = scan.image([]), scan.fitted, []
        for shape, model in zip(found.signature, scan.model, strict=True):
            before, columns = image.rss_and_rank(columns)[1], columns + len(scan.numbers(model))
            if image.rss_and_rank(columns)[1] > before:
                kept.append(shape)
        if len(kept) < len(found.signature):
            if kept[:1] != found.signature[:1]:
                found.as_well = []
            found.signature = kept
            stage = self.stage(found.stages[-1].run, kept)
            found.stages.append(stage)
            found.p_left = self.p_value(stage)
