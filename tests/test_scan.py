"""The statistics under diagnosis, one by one, against brute force."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray
from scipy import stats

from sherkit.diagnosis import play_operator
from sherkit.diagnosis.axis_waves import AxisWaves
from sherkit.diagnosis.columns import Block, Columns
from sherkit.diagnosis.lack_of_fit import codes_of, z_score
from sherkit.diagnosis.scan import Scan
from sherkit.diagnosis.shapes import build, wave
from sherkit.diagnosis.stage import _largest_step
from sherkit.diagnosis.waves import Gridded, Waves, waves_of
from sherkit.evidence.linearised import Linearised
from sherkit.evidence.run import one_after_another
from sherkit.evidence.whitening import Whitening, correlation_in_time, orthonormal, whiten
from sherkit.model.effect import Effect

Floats = NDArray[np.float64]

N, M, P, F, D = 60, 3, 5, 4, 3
CANDIDATES = (
    Columns(functions=(0,), axis=1), Columns(functions=(0, 1, 2), axis=0), Columns(functions=(1, 3)),
    Columns(dense=(0,)), Columns(dense=(0, 1, 2), exact=True), Columns(functions=(2,)),
)  # fmt: skip


@dataclass(frozen=True)
class Written:
    """Rows of a scan whose columns are all at hand, looked at in two stretches."""

    residual: Floats
    fitted: Floats
    functions: Floats
    dense: Floats
    filtered: Whitening = field(default_factory=lambda: Whitening(0.0, np.ones(N, dtype=np.int64)))

    @property
    def blocks(self) -> list[slice]:
        return [slice(0, 23), slice(23, N)]

    def block(self, rows: slice) -> Block:
        parts = (self.residual, self.fitted, self.functions, self.dense)
        return Block(*(self.filtered.on(lambda some, one=one: one[some], rows) for one in parts))


@dataclass(frozen=True)
class Given:
    """Derivatives that are all at hand, none by what is fitted or by effects."""

    inputs: Floats

    def fitted(self, rows: slice) -> tuple[Floats, Floats | None]:
        return self.effects(rows), self.inputs[rows]

    def effects(self, rows: slice) -> Floats:
        return np.zeros((*self.inputs[rows].shape[:2], 0))


def problem(seed: int = 0) -> tuple[Scan, dict[str, Floats]]:
    """A scan of random columns, poses of three rows each scattered over the run, and what it was made of."""
    rng = np.random.default_rng(seed)
    parts = {
        "residual": rng.normal(size=(N, M)) * [1.0, 2.0, 0.5],
        "fitted": rng.normal(size=(N, M, P)),
        "functions": rng.normal(size=(N, F)),
        "dense": rng.normal(size=(N, M, D)),
        "group": rng.permutation(np.repeat(np.arange(N // 3), 3)) * 7 + 2,
    }
    # a fitted parameter that repeats another must not break anything
    parts["fitted"][:, :, 4] = parts["fitted"][:, :, 0] - 2 * parts["fitted"][:, :, 1]
    rows = Written(parts["residual"], parts["fitted"], parts["functions"], parts["dense"])
    return Scan(rows, CANDIDATES, parts["group"]), parts


def columns_of(candidate: Columns, parts: dict[str, Floats]) -> Floats:
    """A candidate's columns (N·M, k), written out."""
    out = []
    for axis in range(M) if candidate.axis is None else (candidate.axis,):
        for k in candidate.functions:
            column = np.zeros((N, M))
            column[:, axis] = parts["functions"][:, k]
            out.append(column.ravel())
    out += [parts["dense"][:, :, k].ravel() for k in candidate.dense]
    return np.stack(out, axis=1)


def left(target: Floats, columns: Floats) -> Floats:
    """What a least-squares fit leaves."""
    return target - columns @ np.linalg.lstsq(columns, target, rcond=1e-10)[0]


@pytest.mark.parametrize("seed", range(20))
def test_what_few_patterns_of_signs_decide_all_would(seed: int) -> None:
    """Catches a score that is called beyond chance for what the first 256 patterns say where all 2,048 would not, or is
    far beyond all of them and has them drawn: heavy tails, and scores about and beyond the largest of the first."""
    rng = np.random.default_rng(seed)
    parts = problem(seed)[1]
    residual = rng.standard_t(4, size=(N, M))
    rows = Written(residual, parts["fitted"], parts["functions"], parts["dense"])
    scan = Scan(rows, CANDIDATES, np.arange(N))
    null = scan.null(0)[1:]
    first = Scan(rows, CANDIDATES, np.arange(N))
    for score in (first.null(0, 256)[1:].max() + np.array([0.0, 0.3, 0.6, 1.0, 2.0, 5.0])).tolist():
        exact = (1 + int((null >= score).sum())) / (len(null) + 1)
        assert abs(first.p_value(score, level=0.01) - exact) <= 3 / (len(null) + 1)
    assert (0, 2048) in first._nulls
    far = Scan(rows, CANDIDATES, np.arange(N))
    assert far.p_value(30.0, level=0.01) == 1 / 2048
    assert (0, 2048) not in far._nulls


def test_another_fit_beside_the_same_columns_is_a_family_of_its_own() -> None:
    """Catches products, Gram matrices or scores of one fit that are kept for another, or of another choice of
    candidates: what is fitted and its residual change, beside a column that is in the model, and four are asked."""
    first, parts = problem()
    other = problem(1)[1]
    asked = [CANDIDATES[i] for i in (4, 0, 3, 1)]
    rows = Written(other["residual"], other["fitted"][:, :, 1:], parts["functions"], parts["dense"])
    anew = Scan(rows, asked, parts["group"]).with_columns(CANDIDATES[5])
    first = Scan(first.rows, CANDIDATES, parts["group"], model=[CANDIDATES[5]])
    chosen = first.asking(asked)
    np.testing.assert_array_equal(chosen.z_scores, first.z_scores[[4, 0, 3, 1]])
    seen = chosen.beside(rows)
    np.testing.assert_allclose(seen.z_scores, anew.z_scores, rtol=1e-9)
    np.testing.assert_allclose(seen.null(0), anew.null(0), rtol=1e-9)
    assert seen.free == anew.free


def brute_f(residual: Floats, model: Floats, extra: Floats) -> tuple[float, int, int]:
    """F statistic of extra columns beside a model, with its degrees of freedom."""
    both = np.concatenate([model, extra], axis=1)
    before, after = (float((left(residual, c) ** 2).sum()) for c in (model, both))
    rank_before, rank_after = (int(np.linalg.matrix_rank(c)) for c in (model, both))
    k, free = rank_after - rank_before, len(residual) - rank_after
    return (before - after) / k / (after / free), k, free


@pytest.mark.parametrize("added", [(), (2,), (3, 1)])
def test_deviates_are_those_of_least_squares(added: tuple[int, ...]) -> None:
    """Catches a wrong projection, Gram matrix, rank, order of rows or degrees of freedom, with and without columns
    taken into the model: conditioning must equal a refit with the columns added."""
    scan, parts = problem()
    extra = [columns_of(CANDIDATES[i], parts) for i in added]
    model = np.concatenate([parts["fitted"].reshape(N * M, P), *extra], axis=1)
    given = scan.with_columns(*(CANDIDATES[i] for i in added))
    residual = parts["residual"].ravel()
    few = scan.among([CANDIDATES[i] for i in added])
    assert few.rss(*range(len(added))) == pytest.approx(given.sum_of_squares, rel=1e-10)
    assert given.sum_of_squares == pytest.approx(float((left(residual, model) ** 2).sum()), rel=1e-10)
    assert given.free == N * M - np.linalg.matrix_rank(model)
    z_scores = given.z_scores
    gains, ranks = given.gains
    for i, candidate in enumerate(CANDIDATES):
        columns = columns_of(candidate, parts)
        if np.linalg.matrix_rank(np.concatenate([model, columns], axis=1)) == np.linalg.matrix_rank(model):
            assert z_scores[i] == -np.inf
            assert ranks[i] == 0
            continue
        f, k, free = brute_f(residual, model, columns)
        assert ranks[i] == k
        expected = wilson_hilferty(f, k, free)
        assert z_scores[i] == pytest.approx(expected, rel=1e-8, abs=1e-8)
        assert gains[i] > 0


def wilson_hilferty(f: float, k: int, free: int) -> float:
    """The textbook's transformation of an F ratio to a normal deviate."""
    a, b = 2 / (9 * k), 2 / (9 * free)
    return float(((1 - b) * f ** (1 / 3) - (1 - a)) / np.sqrt(b * f ** (2 / 3) + a))


@pytest.mark.parametrize(("k", "free"), [(1, 200), (3, 500), (9, 1000), (27, 300)])
def test_a_deviate_has_the_tail_of_its_f(k: int, free: int) -> None:
    """Catches candidates of different size that are not comparable: within 0.3 of the exact deviate (0.2 beyond one
    column) from the 1 % point to the 1e-6 point; the approximation is known to be worst for one column."""
    for p in (1e-2, 1e-4, 1e-6):
        f = stats.f.isf(p, k, free)
        gain = k * f / (free + k * f) * 7.0  # of a total of 7
        z = float(z_score(np.array([gain]), np.array([k]), 7.0, free + k)[0])
        assert z == pytest.approx(stats.norm.isf(p), abs=0.2 if k > 1 else 0.3)


def test_flips_are_flips_of_whole_poses_fitted_again() -> None:
    """Catches a null distribution without the fit after each flip, with repeats of a pose flipped apart, or of
    residuals that are small since their poses have pulled the fit to themselves.

    The same signs, each flipped residual projected anew and scored by brute force, 8 flips, the first of them none.
    """
    scan, parts = problem(3)
    extra = columns_of(CANDIDATES[0], parts)
    given = scan.with_columns(CANDIDATES[0])
    model = np.concatenate([parts["fitted"].reshape(N * M, P), extra], axis=1)
    residual = left(parts["residual"].ravel(), model).reshape(N, M)
    poses = np.unique(parts["group"])
    remains = np.eye(N * M) - model @ np.linalg.pinv(model, rcond=1e-9)
    for pose in poses:
        rows = parts["group"] == pose
        own = remains.reshape(N, M, N, M)[rows][:, :, rows].reshape(3 * M, 3 * M)
        larger = np.linalg.inv(scipy.linalg.sqrtm(0.5 * (own + own.T)).real)
        residual[rows] = (larger @ residual[rows].ravel()).reshape(3, M)
        # as independent noise would have been before it was fitted
        np.testing.assert_allclose(larger @ own @ larger.T, np.eye(3 * M), atol=1e-9)
    codes = codes_of(len(poses), 11)
    assert len(set(codes.tolist())) == len(poses)
    which = [0, 1, 2, 3, 500, 1023, 1024, 2047]
    expected = []
    for flip in which:
        shared = [bin(int(code) & flip).count("1") for code in codes]
        sign = np.where(np.array(shared) % 2, -1.0, 1.0)[np.searchsorted(poses, parts["group"])]
        flipped = (residual * sign[:, None]).ravel()
        scores = []
        for candidate in CANDIDATES[1:]:
            f, k, free = brute_f(flipped, model, columns_of(candidate, parts))
            scores.append(wilson_hilferty(f, k, free))
        expected.append(max(scores))
    np.testing.assert_allclose(given.null(11)[which], expected, rtol=1e-7, atol=1e-8)


def test_nothing_left_scores_minus_infinity() -> None:
    """Catches rounding noise of a column that the fit already holds, scored as if it were a cause."""
    rng = np.random.default_rng(1)
    fitted = rng.normal(size=(N, M, 4))
    functions = rng.normal(size=(N, 1))
    dense = np.stack([fitted[:, :, 0], fitted[:, :, 1] + 3 * fitted[:, :, 2], rng.normal(size=(N, M))], axis=2)
    near = fitted[:, :, 3] + 1e-3 * rng.normal(size=(N, M))
    dense = np.concatenate([dense, near[:, :, None], np.zeros((N, M, 1))], axis=2)
    candidates = [Columns(dense=(0,), exact=True), Columns(dense=(0, 1)), Columns(dense=(2,)), Columns(dense=(3,)),
                  Columns(dense=(3,), exact=True), Columns(dense=(4,)), Columns(functions=(0,))]  # fmt: skip
    scan = Scan(Written(rng.normal(size=(N, M)), fitted, functions, dense), candidates, np.arange(N))
    z_scores = scan.z_scores
    # a part of 1e-3 left is too little for a shape and enough for an effect, whose derivative is exact
    assert (z_scores == -np.inf).tolist() == [True, True, False, True, False, True, False]
    gone = scan.with_columns(candidates[2]).z_scores
    assert gone[2] == -np.inf


def test_p_values_of_noise_are_uniform() -> None:
    """Catches a test that is wrong on noise of unequal size, repeats sharing an error among them.

    300 runs, seeds 0 to 299, level 5 %: 4 to 29 below 0.05 (a correct program fails with less than 1 in 1,000).
    """
    below = 0
    for seed in range(300):
        rng = np.random.default_rng(seed)
        group = np.repeat(np.arange(N // 3), 3)
        common = rng.standard_t(3, size=(N // 3, M))[group]
        noise = (rng.normal(size=(N, M)) + common) * [1.0, 5.0, 0.3] * rng.choice([0.5, 3.0], N // 3)[group, None]
        rows = Written(noise, rng.normal(size=(N, M, P)), rng.normal(size=(N, F)), rng.normal(size=(N, M, D)))
        scan = Scan(rows, CANDIDATES, group)
        below += scan.p_value(float(scan.z_scores.max()), level=0.05, seed=seed) <= 0.05
    assert stats.binom.ppf(5e-4, 300, 0.05) <= below <= stats.binom.isf(5e-4, 300, 0.05)


def test_an_orthonormal_basis_spans_its_columns() -> None:
    """Catches a rank taken wrong where columns repeat, differ in scale by powers of ten, or are zero."""
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(80, 6)) * 10.0 ** np.arange(-6, 6, 2)
    columns[:, 3] = columns[:, 0] * 1e5 + columns[:, 5]
    columns[:, 2] = 0.0
    q = orthonormal(columns)
    assert q.shape == (80, 4)
    np.testing.assert_allclose(q.T @ q, np.eye(4), atol=1e-12)
    rest = columns - q @ (q.T @ columns)
    assert (np.linalg.norm(rest, axis=0) <= 1e-7 * np.linalg.norm(columns, axis=0).clip(1e-300)).all()


@pytest.mark.parametrize("rho", [0.0, -0.4, 0.3, 0.7, 0.9])
def test_the_correlation_in_time_is_recovered(rho: float) -> None:
    """Catches an estimate that the fit's own projection biases, or a correlation found in white noise.

    20 seeds each, 800 rows of 3 readings with 60 columns projected out: the mean within 4 standard errors and 0.01;
    zero for white noise in 18 of 20 (the threshold is three standard errors).
    """
    n, found = 800, []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        e = rng.normal(size=(n, 3))
        for k in range(1, n):
            e[k] = rho * e[k - 1] + np.sqrt(1 - rho * rho) * e[k]
        t = np.linspace(-1, 1, n)
        smooth = np.polynomial.legendre.legvander(t, 7)[:, 1:]
        columns = np.concatenate([rng.normal(size=(n, 3, 39)), np.zeros((n, 3, 21))], axis=2)
        for axis in range(3):
            columns[:, axis, 39 + 7 * axis : 46 + 7 * axis] = smooth
        q = orthonormal(columns)
        flat = e.ravel()
        found.append(correlation_in_time((flat - q @ (q.T @ flat)).reshape(n, 3), q))
    if rho == 0.0:
        assert sum(f == 0.0 for f in found) >= 18
    else:
        error = np.sqrt((1 - rho * rho) / (3 * n))
        assert abs(np.mean(found) - rho) < 4 * error / np.sqrt(20) + 0.01
        assert np.abs(np.array(found) - rho).max() < 6 * error


def test_the_filter_in_time_whitens() -> None:
    """Catches a filter that leaves a correlation or changes the variance, at the first row too."""
    rng = np.random.default_rng(4)
    rho = 0.7
    e = rng.normal(size=(3, 40_000))
    for k in range(1, 3):
        e[k] = rho * e[k - 1] + np.sqrt(1 - rho * rho) * e[k]
    covariance = np.cov(whiten(e, rho))
    np.testing.assert_allclose(covariance, np.eye(3), atol=0.03)
    assert whiten(e, 0.0) is e


def test_targets_that_are_read_in_turn_follow_their_own_in_time() -> None:
    """Catches a filter that takes a target for what follows another one of the same visit, in one block or in several,
    and a correlation within visits that is taken for one in time."""
    rng = np.random.default_rng(12)
    visits, rho = 400, 0.6
    e = rng.normal(size=(visits, 2))
    for k in range(1, visits):
        e[k] = rho * e[k - 1] + np.sqrt(1 - rho * rho) * e[k]
    e = np.stack([e, 2.0 * e + rng.normal(size=e.shape), rng.normal(size=e.shape)], axis=1)
    # the second target is not seen in the third visit
    seen = np.delete(np.arange(3 * visits), 7)
    rows, which = e.reshape(-1, 2)[seen], seen % 3
    lag, back = one_after_another(np.arange(3 * visits), np.arange(3 * visits) % 3, seen)
    assert back is not None
    filtered = Whitening(rho, lag, back)
    for target in range(3):
        own = which == target
        alone = Whitening(rho, lag[own])(rows[own])
        np.testing.assert_allclose(filtered(rows)[own], alone, atol=1e-14)
    blocks = [filtered.on(lambda part: rows[part], part) for part in (slice(0, 8), slice(8, 9), slice(9, len(rows)))]
    np.testing.assert_array_equal(np.concatenate(blocks), filtered(rows))
    shared = np.repeat(rng.normal(size=(visits, 2)), 3, axis=0) + 0.2 * rng.normal(size=(3 * visits, 2))
    _, back = one_after_another(np.arange(3 * visits), np.arange(3 * visits) % 3, np.arange(3 * visits))
    nothing = np.zeros((6 * visits, 0))
    assert correlation_in_time(shared, nothing) > 0.3
    assert correlation_in_time(shared, nothing, back) == 0.0


def test_a_step_is_one_where_chance_has_it_once_in_a_million() -> None:
    """Catches a level that is another one: a step in noise is taken or not on either side of the chance that its square
    has by the χ² distribution, times the places where it could be."""
    n, m, at = 400, 2, 150
    noise = np.random.default_rng(5).normal(size=(n, m))
    noise -= noise.mean(axis=0)
    mean = np.eye(m)[np.tile(np.arange(m), n)] / np.sqrt(n)  # a constant for each axis is fitted
    taken = {}
    for height in np.linspace(0.3, 1.0, 701):
        residual = noise + height * (np.arange(n) >= at)[:, None] * [1.0, 0.0]
        left = residual - residual.mean(axis=0)
        before = np.cumsum(left, axis=0)[1 : n - 3]  # sums of the rows before each of the places
        rows = np.arange(2, n - 2)[:, None]
        gain = (before**2 * (1.0 / rows + 1.0 / (n - rows))).sum(axis=1).max()
        chance = (n - 4) * stats.chi2.sf(gain / ((left**2).sum() - gain) * (n * m - 2 * m), m)
        taken[chance] = _largest_step(residual, mean).shape[1] > 0
    assert max(p for p, found in taken.items() if found) == pytest.approx(1e-6, rel=0.1)
    assert min(p for p, found in taken.items() if not found) == pytest.approx(1e-6, rel=0.1)


def test_play_follows_with_its_dead_zone() -> None:
    """Catches a play operator that forgets where it was, moves inside its zone, or lags by another width."""
    assert play_operator(np.array([0.0, 0.4, 1.0, 0.9, 0.3, -1.0, -0.8]), 1.0).tolist() == pytest.approx(
        [0.0, 0.0, 0.5, 0.5, 0.5, -0.5, -0.5]
    )
    q = np.cumsum(np.random.default_rng(0).normal(size=500))
    for width in (0.1, 2.0):
        out = play_operator(q, width)
        assert np.abs(out - q).max() <= 0.5 * width + 1e-12
        moved = np.diff(out) != 0
        assert (np.diff(out)[moved] * np.diff(q)[moved] > 0).all()
        np.testing.assert_allclose(np.abs(out - q)[1:][moved], 0.5 * width, atol=1e-12)
    np.testing.assert_array_equal(play_operator(q, 0.0), q)


def test_shapes_follow_from_the_variables_alone() -> None:
    """Catches shapes of a variable that never changes, a missing family, and columns that are not of unit length."""
    rng = np.random.default_rng(2)
    n = 200
    time = np.sort(rng.uniform(0, 100, n))
    q = {f"q{k}_mm": rng.uniform(0, 40, n) for k in (1, 2, 3)}
    view = Linearised(
        residual=rng.normal(size=(n, 3)),
        variables={**q, "x_mm": rng.uniform(-20, 20, n), "time_s": time, "lamp": np.full(n, 3.0)}, group=np.arange(n),
        repeated=np.arange(n), derivatives=Given(rng.normal(size=(n, 3, 3))), pattern_of={name: name for name in q},
        inputs=q, time=time,
    )  # fmt: skip
    family = build(view, Waves(view))
    kinds = {s.shape for s in family.shapes}
    assert kinds == {"smooth", "periodic", "interaction", "hysteretic", "step"}
    assert not any("lamp" in s.depends_on for s in family.shapes)
    functions, dense = family.functions_in(view.whole), family.dense_in(view.whole)
    np.testing.assert_allclose(np.linalg.norm(functions, axis=0), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(dense.reshape(3 * n, -1), axis=0), 1.0, atol=1e-12)
    np.testing.assert_allclose(functions.mean(axis=0), 0.0, atol=1e-12)
    some = slice(60, 110)
    np.testing.assert_array_equal(family.functions_in(some), functions[some])
    np.testing.assert_array_equal(family.dense_in(some), dense[some])
    assert {s.depends_on for s in family.shapes if s.shape == "step"} == {("time_s",)}
    assert {s.pattern for s in family.shapes if s.shape == "hysteretic" and s.pattern} == set(q)


@pytest.mark.parametrize(("rho", "in_turn"), [(0.0, False), (0.6, False), (-0.4, False), (0.6, True)])
@pytest.mark.parametrize("ring", [False, True])
def test_waves_that_are_never_written_out_are_those_that_are(rho: float, in_turn: bool, ring: bool) -> None:
    """Catches products, Gram matrices, sums over poses and flips of waves that differ from those of full columns,
    also under the filter in time, across gaps, of targets read in turn, with poses scattered over the run, and with
    a sign or a number mistaken; of waves along the inputs and of those on single axes."""
    rng = np.random.default_rng(5)
    q = {f"q{k}": rng.uniform(0, 2.5, N) for k in (1, 2)}
    turning = Effect("ring", "joints", (), search="period_rad")
    view = Linearised(
        residual=rng.normal(size=(N, M)),
        variables=q | {"x_mm": rng.uniform(-20, 20, N)},
        group=rng.permutation(np.repeat(np.arange(N // 3), 3)),
        repeated=rng.permutation(np.repeat(np.arange(N // 3), 3)),
        derivatives=Given(rng.normal(size=(N, M, 2))),
        pattern_of={name: name for name in q},
        place=("x_mm",),
        inputs=q,
        periodic=((turning, None),) if ring else (),
    )
    fitted = rng.normal(size=(N, M, P))
    back = None
    if in_turn:
        _, back = one_after_another(np.arange(N), rng.integers(0, 3, N), np.arange(N))
    filtered = Whitening(rho, rng.integers(1, 4, N), back)
    waves = Waves(view)
    dense = np.concatenate([waves_of(view, f) for f in waves.at], axis=2)
    # at each frequency the sine and the cosine of the first input, then of the second
    every = [tuple(range(4 * f, 4 * f + 4)) for f in range(len(waves.at))]
    sets = [of for f in every for of in (f, f[:2], f[2:])]
    known = [numbers for numbers, _ in waves.on_all_inputs]
    alike = [of for f in known for of in (f, f[:2], f[2:])]
    # along a coordinate, on each axis and on all of them
    family = build(view, waves)
    shapes = [one for one in family.shapes if one.along]
    x = view.variables["x_mm"]
    functions = np.stack([w - w.mean() for one in shapes[:: M + 1] for w in wave(x, one.period)], axis=1)
    pairs = [(2 * k, 2 * k + 1) for k in range(len(shapes) // (M + 1))]
    on_axes = [Columns(functions=pair, axis=axis) for pair in pairs for axis in (*range(M), None)]
    written = Scan(
        Written(view.residual, fitted, functions, dense, filtered),
        [Columns(dense=s, exact=True) for s in sets] + on_axes,
        view.group,
    )
    never = Scan(
        Written(view.residual, fitted, np.zeros((N, 0)), np.zeros((N, M, 0)), filtered),
        [Columns(waves=s, exact=True) for s in alike] + [one.columns for one in shapes],
        view.group,
        waves.filtered(filtered),
        AxisWaves(family.along, M, filtered),
    )
    np.testing.assert_allclose(never.z_scores, written.z_scores, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(never.null(3), written.null(3), rtol=1e-7, atol=1e-7)
    for k in (4, len(sets) + 1):
        one, other = (scan.with_columns(scan.candidates[k]) for scan in (written, never))
        np.testing.assert_allclose(other.z_scores, one.z_scores, rtol=1e-7, atol=1e-7)
    gram, along, _ = never.along_waves(waves.at[3])
    taken = float(along @ np.linalg.lstsq(gram, along, rcond=1e-8)[0])
    assert taken == pytest.approx(written.gains[0][9], rel=1e-8)


def test_sums_over_a_grid_are_those_over_the_rows() -> None:
    """Catches a kernel or its transform that is off, cells counted from elsewhere, and a phase of the wrong sign, to
    twelve digits of the sum of all weights."""
    rng = np.random.default_rng(6)
    at, weights = rng.uniform(3.0, 47.0, 500), rng.normal(size=(500, 3))
    sums = Gridded(3.0, 47.0, 1 / 88.0, 300, 3, 3.5)
    sums.add(at[:200], weights[:200])
    sums.add(at[200:], weights[200:])
    for turns in (1, 37, 300):
        expected = np.exp(2j * np.pi * turns / 88.0 * (at - 3.5)) @ weights
        np.testing.assert_allclose(sums.multiples(np.array([turns]))[0], expected, atol=1e-12 * np.abs(weights).sum())
        np.testing.assert_allclose(sums.at(turns / 88.0), expected, atol=1e-12 * np.abs(weights).sum())
