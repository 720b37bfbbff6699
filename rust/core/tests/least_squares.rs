//! The triangle, its decomposition, the nonlinear iteration and the losses, against nalgebra's dense algebra
//! and against problems whose minima are known.

mod common;
mod nist;

use common::{Random, config};
use nalgebra::{SMatrix, SVector};
use nist::Problem;
use proptest::prelude::*;
use sherkit_core::Error;
use sherkit_core::fit::{
    BLOCK_ROWS, Decomposition, Descended, Descent, Fold, Levenberg, Loss, Progress, Settings,
    Stack, decomposition_len, descent_len, levenberg_len, stack_len,
};

// ---------------------------------------------------------------------------------------------------- stack

fn stack(columns: usize, targets: usize) -> Stack<Vec<f64>> {
    Stack::new(columns, targets, vec![0.0; stack_len(columns, targets)]).expect("right length")
}

fn gram_of_rows(rows: &[Vec<f64>], width: usize) -> Vec<f64> {
    let mut gram = vec![0.0; width * width];
    for row in rows {
        for (i, a) in row.iter().enumerate() {
            for (j, b) in row.iter().enumerate() {
                gram[i * width + j] += a * b;
            }
        }
    }
    gram
}

fn gram_of_triangle(triangle: &[f64], width: usize) -> Vec<f64> {
    let rows: Vec<Vec<f64>> = triangle.chunks_exact(width).map(<[f64]>::to_vec).collect();
    gram_of_rows(&rows, width)
}

/// Largest difference of two Gram matrices, each element in units of its own two columns.
fn gram_difference(a: &[f64], b: &[f64], width: usize) -> f64 {
    let mut worst: f64 = 0.0;
    for i in 0..width {
        for j in 0..width {
            let size = (b[i * width + i] * b[j * width + j]).sqrt();
            let difference = (a[i * width + j] - b[i * width + j]).abs();
            if difference > 0.0 {
                worst = worst.max(difference / size);
            }
        }
    }
    worst
}

/// Rows whose columns differ in scale by `10^±decades`, with the odd column and row of zeros.
fn random_rows(random: &mut Random, rows: usize, width: usize, decades: f64) -> Vec<Vec<f64>> {
    let scales: Vec<f64> = (0..width)
        .map(|_| {
            if random.next().is_multiple_of(10) {
                0.0
            } else {
                random.magnitude(decades)
            }
        })
        .collect();
    (0..rows)
        .map(|_| {
            let of_zeros = random.next().is_multiple_of(10);
            scales
                .iter()
                .map(|s| if of_zeros { 0.0 } else { s * random.unit() })
                .collect()
        })
        .collect()
}

/// Absolute values of R by nalgebra's QR, against those of the stack.
macro_rules! equals_qr {
    ($random:expr, $($rows:literal),*) => {$({
        let a = SMatrix::<f64, $rows, 6>::from_fn(|_, _| $random.unit());
        let r = a.qr().r();
        let mut s = stack(5, 1);
        for row in a.row_iter() {
            s.push(row.iter().copied());
        }
        let triangle = s.triangle();
        for i in 0..6 {
            for j in i..6 {
                let (ours, theirs) = (triangle[i * 6 + j], r[(i, j)]);
                let sign = (triangle[i * 7] * r[(i, i)]).signum();
                prop_assert!((ours - sign * theirs).abs() < 1e-10 * r.column(j).norm(), "{} ({i}, {j})", $rows);
            }
        }
    })*};
}

proptest! {
    #![proptest_config(config())]

    /// A row lost or counted twice at the border of a block, a reflection that leaves out the targets or the
    /// last column, a triangle with something below its diagonal.
    #[test]
    fn triangle_has_the_gram_matrix_of_the_rows(
        seed in any::<u64>(),
        rows in prop_oneof![
            Just(0_usize), Just(1), Just(7), Just(63), Just(64), Just(65), Just(127), Just(128), Just(129),
            Just(255), Just(256), Just(257), Just(1000), 0..300_usize,
        ],
        columns in 1..12_usize,
        targets in 1..5_usize,
    ) {
        let width = columns + targets;
        let rows = random_rows(&mut Random(seed), rows, width, 6.0);
        let mut s = stack(columns, targets);
        for row in &rows {
            s.push(row.iter().copied());
        }
        prop_assert_eq!(s.rows(), rows.len());
        prop_assert_eq!(s.columns(), columns);
        let triangle = s.triangle();
        prop_assert_eq!(triangle.len(), width * width);
        for i in 0..width {
            prop_assert!(triangle[i * width..i * width + i].iter().all(|x| *x == 0.0));
        }
        let difference = gram_difference(&gram_of_triangle(triangle, width), &gram_of_rows(&rows, width), width);
        prop_assert!(difference < 1e-13, "{difference}");
    }

    /// A triangle that equals the Gram matrix but is no QR factor, such as one with rows out of order: against
    /// nalgebra's QR, and for many rows against its Cholesky factor of the normal equations.
    #[test]
    fn triangle_is_the_factor_of_a_qr_factorisation(seed in any::<u64>()) {
        let mut random = Random(seed);
        equals_qr!(random, 20, 63, 64, 65, 127);
        for rows in [128, 200, 1000] {
            let mut s = stack(5, 1);
            let mut gram = SMatrix::<f64, 6, 6>::zeros();
            for _ in 0..rows {
                let row = SVector::<f64, 6>::from_fn(|_, _| random.unit());
                gram += row * row.transpose();
                s.push(row.iter().copied());
            }
            let factor = gram.cholesky().unwrap().l();
            let triangle = s.triangle();
            for i in 0..6 {
                for j in i..6 {
                    let ours = triangle[i * 6 + j] * triangle[i * 7].signum();
                    prop_assert!((ours - factor[(j, i)]).abs() < 1e-12 * gram[(j, j)], "{rows} ({i}, {j})");
                }
            }
        }
    }

    /// Rows that go missing when the triangle is read in between; old rows that survive a clear; a row left
    /// unfinished that inherits numbers of an earlier block.
    #[test]
    fn reading_in_between_and_clearing_lose_nothing(
        seed in any::<u64>(),
        reads in prop::collection::vec(0..150_usize, 0..6),
        columns in 1..6_usize,
    ) {
        let width = columns + 2;
        let mut random = Random(seed);
        let mut s = stack(columns, 2);
        for row in random_rows(&mut random, 100, width, 2.0) {
            s.push(row);
        }
        s.clear();
        prop_assert_eq!(s.rows(), 0);
        prop_assert!(s.triangle().iter().all(|x| *x == 0.0));
        let mut all = Vec::new();
        for read in reads {
            for mut row in random_rows(&mut random, read, width, 2.0) {
                let given = usize::try_from(random.next() % 20).unwrap().min(width);
                row[given..].fill(0.0);
                s.push(row[..given].iter().copied());
                all.push(row);
            }
            let triangle = s.triangle().to_vec();
            prop_assert_eq!(&triangle, s.triangle());
            let difference = gram_difference(&gram_of_triangle(&triangle, width), &gram_of_rows(&all, width), width);
            prop_assert!(difference < 1e-13, "{difference}");
        }
        prop_assert_eq!(s.rows(), all.len());
    }

    /// Products of columns that were taken for others, or of rows that were added twice or side by side in another place.
    #[test]
    fn products_are_those_of_the_rows(seed in any::<u64>(), count in 0..300_usize, columns in 1..9_usize) {
        let (mut random, width) = (Random(seed), columns + 1);
        let rows = random_rows(&mut random, count, width, 3.0);
        let (mut single, mut wide) = (stack(columns, 1), stack(columns, 1));
        single.clear_for(Fold::Products);
        for row in &rows {
            single.push(row.iter().copied());
        }
        // some in eights, some alone, in turns
        let mut left = &rows[..];
        while let Some((eight, rest)) = left.split_first_chunk::<8>() {
            for (k, place) in wide.next_wide(8).enumerate() {
                *place = eight.each_ref().map(|row| row[k]);
            }
            wide.commit_wide();
            let alone = rest.len().min(usize::try_from(random.next() % 3).unwrap());
            for row in &rest[..alone] {
                wide.push(row.iter().copied());
            }
            left = &rest[alone..];
        }
        for row in left {
            wide.push(row.iter().copied());
        }
        prop_assert_eq!((single.rows(), wide.rows()), (count, count));
        let expected = gram_of_rows(&rows, width);
        let products = single.triangle();
        let whole: Vec<f64> = (0..width * width)
            .map(|at| products[(at / width).min(at % width) * width + (at / width).max(at % width)])
            .collect();
        prop_assert!(gram_difference(&whole, &expected, width) < 1e-13);
        let triangle = gram_of_triangle(wide.triangle(), width);
        prop_assert!(gram_difference(&triangle, &expected, width) < 1e-13);
    }

    /// Parts stacked apart and joined: rows of either part lost, counted twice, or not counted.
    #[test]
    fn stacks_of_parts_join_to_the_whole(seed in any::<u64>(), first in 0..300_usize, second in 0..300_usize) {
        let mut random = Random(seed);
        let rows = random_rows(&mut random, first + second, 7, 3.0);
        let (mut a, mut b) = (stack(5, 2), stack(5, 2));
        for (k, row) in rows.iter().enumerate() {
            let part = if k < first { &mut a } else { &mut b };
            part.push(row.iter().copied());
        }
        let count = b.rows();
        a.absorb(b.triangle(), count);
        prop_assert_eq!(a.rows(), rows.len());
        let difference = gram_difference(&gram_of_triangle(a.triangle(), 7), &gram_of_rows(&rows, 7), 7);
        prop_assert!(difference < 1e-13, "{difference}");
    }

    /// The last diagonal element is not the norm of the residual.
    #[test]
    fn last_diagonal_is_the_norm_of_the_residual(seed in any::<u64>()) {
        let mut random = Random(seed);
        let a = SMatrix::<f64, 80, 4>::from_fn(|_, _| random.unit());
        let b = SVector::<f64, 80>::from_fn(|_, _| random.unit());
        let qr = a.qr();
        let x = qr.r().solve_upper_triangular(&qr.q().tr_mul(&b)).unwrap();
        let mut s = stack(4, 1);
        for (row, target) in a.row_iter().zip(b.iter()) {
            s.push(row.iter().copied().chain([*target]));
        }
        prop_assert!((s.triangle()[24].abs() - (b - a * x).norm()).abs() < 1e-12);
    }
}

/// Storage of the wrong length that is taken, to panic later.
#[test]
fn wrong_lengths_are_refused() {
    for (columns, targets) in [(1, 1), (5, 1), (4, 3)] {
        let expected = stack_len(columns, targets);
        assert_eq!(
            expected,
            (columns + targets) * (columns + targets + BLOCK_ROWS)
        );
        for found in [0, expected - 1, expected + 1] {
            let refused = Stack::new(columns, targets, vec![0.0; found]).err();
            assert_eq!(refused, Some(Error::WrongLength { expected, found }));
        }
    }
    let (expected, found) = (decomposition_len(3), decomposition_len(3) + 1);
    assert_eq!(
        Decomposition::new(3, vec![0.0; found]).err(),
        Some(Error::WrongLength { expected, found })
    );
    let mut d = Decomposition::new(3, vec![0.0; expected]).unwrap();
    assert_eq!(
        d.decompose(&[0.0; 9], &[1.0; 3], 1e-9),
        Err(Error::WrongLength {
            expected: 16,
            found: 9
        })
    );
    assert_eq!(
        d.decompose(&[0.0; 16], &[1.0; 2], 1e-9),
        Err(Error::WrongLength {
            expected: 3,
            found: 2
        })
    );
    let expected = levenberg_len(2);
    let new = |sizes: &[f64], found| {
        Levenberg::new(&[0.0; 2], sizes, Settings::default(), vec![0.0; found]).err()
    };
    assert_eq!(
        new(&[1.0; 2], expected - 1),
        Some(Error::WrongLength {
            expected,
            found: expected - 1
        })
    );
    assert_eq!(
        new(&[1.0; 3], expected),
        Some(Error::WrongLength {
            expected: 2,
            found: 3
        })
    );
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(
            new(&[1.0, bad], expected),
            Some(Error::NotFinite { index: 1 })
        );
    }
}

// -------------------------------------------------------------------------------------------- decomposition

const ROWS: usize = 40;
const N: usize = 6;
type Design = SMatrix<f64, ROWS, N>;
type Targets = SVector<f64, ROWS>;
type Square = SMatrix<f64, N, N>;
type Vector = SVector<f64, N>;

const TOLERANCE: f64 = 1e-9;

fn decompose(a: &Design, b: &Targets, sizes: &Vector) -> Decomposition<Vec<f64>> {
    let mut s = stack(N, 1);
    for (row, target) in a.row_iter().zip(b.iter()) {
        s.push(row.iter().copied().chain([*target]));
    }
    let mut d = Decomposition::new(N, vec![f64::NAN; decomposition_len(N)]).expect("right length");
    d.decompose(s.triangle(), sizes.as_slice(), TOLERANCE)
        .expect("finite rows");
    d
}

/// Step without damping and at the smallest change in plausible sizes.
fn solution(d: &Decomposition<Vec<f64>>) -> Vector {
    let mut x = Vector::repeat(f64::NAN);
    d.step(0.0, x.as_mut_slice());
    d.remove_unobserved(x.as_mut_slice());
    x
}

fn covariance(d: &Decomposition<Vec<f64>>) -> (Square, Square) {
    let (mut data, mut unobserved) = (Square::repeat(f64::NAN), Square::repeat(f64::NAN));
    let mut scratch = [f64::NAN; N];
    d.covariance(data.as_mut_slice(), unobserved.as_mut_slice(), &mut scratch);
    (data, unobserved)
}

fn unobserved(d: &Decomposition<Vec<f64>>) -> Vec<Vector> {
    d.unobserved().map(Vector::from_column_slice).collect()
}

/// Columns that are fresh, zero, copies or combinations of earlier ones; `used` rows of numbers, zeros below.
fn random_design(random: &mut Random, used: usize, kinds: [u8; N], decades: f64) -> Design {
    let mut a = Design::zeros();
    for k in 0..N {
        let column = match kinds[k] {
            0 => Targets::zeros(),
            1 if k > 0 => a.column(k / 2).into_owned(),
            2 if k > 1 => a.column(0) * random.unit() + a.column(k - 1) * random.unit(),
            _ => Targets::from_fn(|i, _| if i < used { random.unit() } else { 0.0 }),
        };
        a.set_column(k, &column);
    }
    for mut column in a.column_iter_mut() {
        column *= random.magnitude(decades);
    }
    a
}

fn norms_of(a: &Design) -> Vector {
    Vector::from_fn(|k, _| match a.column(k).norm() {
        0.0 => 1.0,
        norm => norm,
    })
}

fn scaled(a: &Design) -> Design {
    a * Square::from_diagonal(&norms_of(a).map(f64::recip))
}

/// A linear system by its recipe, so that a failing case prints in one line.
#[derive(Clone, Copy, Debug)]
struct System {
    seed: u64,
    kinds: [u8; N],
    used: usize,
    decades: f64,
}

impl System {
    fn build(&self) -> (Design, Targets, Vector) {
        let mut random = Random(self.seed);
        let a = random_design(&mut random, self.used, self.kinds, self.decades);
        let b = Targets::from_fn(|_, _| random.unit());
        let sizes = Vector::from_fn(|_, _| random.magnitude(self.decades));
        (a, b, sizes)
    }
}

/// A column that moves the readings by less than this part of what moves them most is taken for rounding.
const ROUNDING: f64 = 1e-13;

/// How far the readings move for a change of plausible size of each parameter, and the most of these or of what is
/// to be explained.
fn effects(a: &Design, b: &Targets, sizes: &Vector) -> (Vector, f64) {
    let each = Vector::from_fn(|k, _| a.column(k).norm() * sizes[k]);
    (each, each.amax().max(b.norm()))
}

/// The matrix without the columns that count as rounding; none where a column is so close to the limit that
/// rounding decides.
fn known(a: &Design, b: &Targets, sizes: &Vector) -> Option<Design> {
    let (each, most) = effects(a, b, sizes);
    let mut known = *a;
    for (k, effect) in each.iter().enumerate() {
        let share = effect / (ROUNDING * most);
        if (share - 1.0).abs() < 1e-9 {
            return None;
        }
        if share < 1.0 {
            known.column_mut(k).fill(0.0);
        }
    }
    Some(known)
}

fn systems() -> impl Strategy<Value = System> {
    let kinds = prop::array::uniform6(prop_oneof![
        Just(3_u8),
        Just(3),
        Just(3),
        Just(2),
        Just(1),
        Just(0)
    ]);
    (any::<u64>(), kinds, 0..=ROWS, 0.0..4.0_f64).prop_map(|(seed, kinds, used, decades)| System {
        seed,
        kinds,
        used,
        decades,
    })
}

/// Singular values of the column-scaled matrix by nalgebra, largest first, and their number above the
/// tolerance; none where it is not clear which are zero. A little noise is added first: nalgebra's decomposition
/// is wrong in the third digit for some matrices that have columns of zeros beside equal ones.
fn spectrum(a: &Design) -> Option<(Vec<f64>, usize)> {
    let mut random = Random(1);
    let noisy = scaled(a) + Design::from_fn(|_, _| NOISE * random.unit());
    let mut s: Vec<f64> = noisy.singular_values().iter().copied().collect();
    s.sort_by(|x, y| y.total_cmp(x));
    let zero = 100.0 * NOISE;
    let clear = s.iter().all(|x| *x > 1e-4 || *x < zero);
    let rank = s.iter().filter(|x| **x > zero).count();
    clear.then_some((s, rank))
}

const NOISE: f64 = 1e-11;

/// How far the readings may move along each unobserved direction.
///
/// What counts as zero need not be: a change `y`, in units that make every column of unit length, moves them by up to
/// the first singular value below the tolerance times `|y|`. The rest is rounding. The directions are orthonormal in
/// `y` first, then by Gram and Schmidt in plausible sizes, where they may be almost parallel: what is left of one
/// after the others are taken out, the share ℓ of its length, is made as long as it was, and so is the rounding of
/// what was taken out, which is relative to the longest of them in `y`. With the directions as columns of `Y`, the
/// shares are those of the columns of `R⁻¹` for `Y = QR`.
fn blind_to(d: &Decomposition<Vec<f64>>, a: &Design, sizes: &Vector) -> Vec<f64> {
    let scale = norms_of(a).component_mul(sizes);
    let count = N - d.rank();
    let mut directions = Square::zeros();
    for (j, u) in unobserved(d).iter().enumerate() {
        directions.set_column(j, &u.component_mul(&scale));
    }
    let longest = directions.amax();
    let mut r = directions.qr().r();
    for j in count..N {
        r[(j, j)] = 1.0;
    }
    let unseen = d.singular_values().get(d.rank()).copied().unwrap_or(0.0);
    (0..count)
        .map(|j| {
            let inverse = r.solve_upper_triangular(&Vector::ith(j, 1.0)).unwrap();
            let share = inverse[j].abs() / inverse.norm();
            unseen * directions.column(j).norm() + 1e-13 * longest / share
        })
        .collect()
}

fn check_rank_and_directions(system: &System) -> Result<(), TestCaseError> {
    let (all, b, sizes) = system.build();
    let Some(a) = known(&all, &b, &sizes) else {
        return Ok(());
    };
    let Some((singular, rank)) = spectrum(&a) else {
        return Ok(());
    };
    let d = decompose(&all, &b, &sizes);
    prop_assert_eq!(d.rank(), rank);
    let ours = d.singular_values();
    for (ours, theirs) in ours.iter().zip(&singular) {
        prop_assert!((ours - theirs).abs() < 100.0 * NOISE, "{ours} {theirs}");
    }
    prop_assert!(ours.is_sorted_by(|x, y| x >= y) && ours.iter().all(|s| *s >= 0.0));
    // sharper: the traces of the powers of the Gram matrix, which together fix the spectrum
    let gram = scaled(&a).tr_mul(&scaled(&a));
    let mut power = Square::identity();
    for k in 1..=6 {
        power *= gram;
        let (trace, sum) = (
            power.trace(),
            ours.iter().map(|s| s.powi(2 * k)).sum::<f64>(),
        );
        prop_assert!(
            (sum - trace).abs() <= 1e-13 * trace,
            "{k}: {}",
            sum / trace - 1.0
        );
    }
    let directions = unobserved(&d);
    prop_assert_eq!(directions.len(), N - rank);
    let bounds = blind_to(&d, &a, &sizes);
    for (i, u) in directions.iter().enumerate() {
        for (j, w) in directions.iter().enumerate() {
            let expected = if i == j { 1.0 } else { 0.0 };
            prop_assert!((u.dot(w) - expected).abs() < 1e-12);
        }
        let moved = (a * sizes.component_mul(u)).norm();
        prop_assert!(moved <= bounds[i], "{moved} of {}", bounds[i]);
    }
    Ok(())
}

fn check_solution(system: &System) -> Result<(), TestCaseError> {
    let (all, b, sizes) = system.build();
    let Some(a) = known(&all, &b, &sizes) else {
        return Ok(());
    };
    let Some((_, rank)) = spectrum(&a) else {
        return Ok(());
    };
    let d = decompose(&all, &b, &sizes);
    let x = solution(&d);
    prop_assert!(x.iter().all(|v| v.is_finite()));
    let mut raw = Vector::zeros();
    d.step(0.0, raw.as_mut_slice());
    let gradient = scaled(&a).tr_mul(&(b - a * x)).amax();
    // rounding of both solutions, and what the readings see of the part that was taken out between them
    let norms = norms_of(&a);
    let largest = [x, raw]
        .map(|v| v.component_mul(&norms).amax())
        .into_iter()
        .fold(b.norm(), f64::max);
    let [y, raw] = [x, raw].map(|v| v.component_div(&sizes));
    let directions = unobserved(&d);
    let taken: f64 = directions
        .iter()
        .zip(blind_to(&d, &a, &sizes))
        .map(|(u, bound)| u.dot(&raw).abs() * bound)
        .sum();
    prop_assert!(
        gradient <= 1e-12 * largest + taken,
        "{gradient} of {largest} {taken}"
    );
    // the directions themselves are checked above
    prop_assert_eq!(d.rank(), rank);
    for u in directions {
        let along = u.dot(&y).abs();
        prop_assert!(
            along <= 1e-12 * raw.norm().max(y.norm()),
            "{along} of {}",
            raw.norm()
        );
    }
    Ok(())
}

/// Systems that once failed. In the first two a column is below what counts as rounding beside another in units of
/// plausible size; in the others two unobserved directions are almost parallel in plausible sizes, of very different
/// reach, or columns that are parallel but for the rounding of a difference count as such.
#[test]
fn systems_at_the_limits_of_rounding() {
    for (seed, kinds, used, decades) in [
        (
            8_030_994_168_690_323_727,
            [0, 3, 3, 3, 3, 2],
            11,
            3.833_888_188_763_758_4,
        ),
        (
            6_238_593_736_354_295_370,
            [3, 1, 3, 3, 2, 1],
            26,
            3.817_453_105_467_827,
        ),
        (
            11_655_334_193_143_676_044,
            [3, 1, 1, 2, 3, 1],
            25,
            3.354_676_204_839_938_3,
        ),
        (
            12_812_356_480_334_570_577,
            [2, 3, 3, 3, 3, 1],
            3,
            3.888_484_455_221_712_4,
        ),
        (
            12_609_443_720_497_365_962,
            [3, 1, 2, 0, 3, 3],
            26,
            1.629_184_031_747_824_8,
        ),
    ] {
        let system = System {
            seed,
            kinds,
            used,
            decades,
        };
        check_rank_and_directions(&system).unwrap();
        check_solution(&system).unwrap();
    }
}

proptest! {
    #![proptest_config(config())]

    /// Wrong singular values, a rank that depends on units, unobserved directions that rows do observe, that
    /// are too few, or that are not orthonormal in plausible sizes.
    #[test]
    fn rank_and_directions_are_those_of_the_matrix(system in systems()) {
        check_rank_and_directions(&system)?;
    }

    /// A step that is no minimum, or one that is not the smallest in plausible sizes. Both together are the
    /// Karush-Kuhn-Tucker conditions of the smallest minimiser, so nothing else passes.
    #[test]
    fn the_solution_is_the_smallest_minimiser(system in systems()) {
        check_solution(&system)?;
    }

    /// The smallest minimiser by an explicit Karush-Kuhn-Tucker system, for rows that are known to see just
    /// three combinations.
    #[test]
    fn the_solution_equals_an_explicit_saddle_point_system(seed in any::<u64>()) {
        let mut random = Random(seed);
        let left = SMatrix::<f64, ROWS, 3>::from_fn(|_, _| random.unit());
        let right = SMatrix::<f64, 3, N>::from_fn(|_, _| random.unit());
        let b = Targets::from_fn(|_, _| random.unit());
        let sizes = Vector::from_fn(|_, _| random.magnitude(1.0));
        let combinations = (left.transpose() * left).try_inverse().unwrap() * left.tr_mul(&b);
        let mut system = SMatrix::<f64, 9, 9>::zeros();
        system.fixed_view_mut::<N, N>(0, 0).set_diagonal(&sizes.map(|s| 1.0 / (s * s)));
        system.fixed_view_mut::<N, 3>(0, N).copy_from(&right.transpose());
        system.fixed_view_mut::<3, N>(N, 0).copy_from(&right);
        let mut known = SVector::<f64, 9>::zeros();
        known.fixed_rows_mut::<3>(N).copy_from(&combinations);
        let expected = system.lu().solve(&known).unwrap().fixed_rows::<N>(0).into_owned();
        let a = left * right;
        let Some((s, 3)) = spectrum(&a) else { return Ok(()) };
        prop_assume!(s[2] > 1e-2 * s[0] && right.singular_values().min() > 1e-2);
        let x = solution(&decompose(&a, &b, &sizes));
        prop_assert!((x - expected).norm() < 1e-10 * expected.norm().max(1.0), "{}", (x - expected).norm());
    }

    /// A covariance in wrong units, one that misses the projection onto the smallest change, or one that
    /// counts an unobserved direction as observed.
    #[test]
    fn covariance_is_that_of_the_pseudo_inverse(seed in any::<u64>(), kinds in prop::array::uniform6(0..6_u8), used in 0..=ROWS) {
        let mut random = Random(seed);
        let a = random_design(&mut random, used, kinds, 0.5);
        let sizes = Vector::from_fn(|_, _| random.magnitude(0.5));
        let Some((s, rank)) = spectrum(&a) else { return Ok(()) };
        prop_assume!(rank == 0 || s[rank - 1] > 1e-2 * s[0]);
        let in_sizes = a * Square::from_diagonal(&sizes);
        let (data, unobserved) = covariance(&decompose(&a, &Targets::zeros(), &sizes));
        prop_assert_eq!(data, data.transpose());
        // in units of plausible size the covariance is the pseudo-inverse of the normal matrix, by the four
        // conditions of Moore and Penrose, and what is unobserved is the projector that is left
        let gram = in_sizes.tr_mul(&in_sizes);
        let back = Square::from_diagonal(&sizes.map(f64::recip));
        let (x, u) = (back * data * back, back * unobserved * back);
        let close = |a: Square, b: Square, size: f64| (a - b).norm() <= 1e-10 * size;
        prop_assert!(close(gram * x * gram, gram, gram.norm()));
        prop_assert!(close(x * gram * x, x, x.norm()));
        prop_assert!(close(gram * x, (gram * x).transpose(), 1.0));
        prop_assert!(close(x * gram, (x * gram).transpose(), 1.0));
        prop_assert!(close(u, Square::identity() - x * gram, 1.0));
        if rank == N {
            let normal = (a.transpose() * a).try_inverse().unwrap();
            prop_assert!((data - normal).norm() < 1e-9 * normal.norm());
            prop_assert_eq!(unobserved, Square::zeros());
        }
    }

    /// Damping in other units than those of the scaled columns, or one that is not damping.
    #[test]
    fn a_damped_step_solves_the_damped_normal_equations(seed in any::<u64>(), damping in -6.0..4.0_f64) {
        let mut random = Random(seed);
        let damping = 10.0_f64.powf(damping);
        let a = random_design(&mut random, ROWS, [3; N], 3.0);
        let b = Targets::from_fn(|_, _| random.unit());
        let unit = scaled(&a);
        let expected = ((unit.transpose() * unit + Square::identity() * damping).try_inverse().unwrap() * unit.tr_mul(&b))
            .component_div(&norms_of(&a));
        let mut step = Vector::repeat(f64::NAN);
        decompose(&a, &b, &Vector::repeat(1.0)).step(damping, step.as_mut_slice());
        let difference = (step - expected).component_mul(&norms_of(&a)).norm();
        prop_assert!(difference < 1e-12 * b.norm(), "{difference}");
    }

    /// A decomposition that depends on what its storage held before.
    #[test]
    fn storage_is_reused_without_traces(system in systems(), other in systems()) {
        let ((a, b, sizes), (c, e, other_sizes)) = (system.build(), other.build());
        let fresh = decompose(&a, &b, &sizes);
        let mut used = decompose(&c, &e, &other_sizes);
        let mut s = stack(N, 1);
        for (row, target) in a.row_iter().zip(b.iter()) {
            s.push(row.iter().copied().chain([*target]));
        }
        used.decompose(s.triangle(), sizes.as_slice(), TOLERANCE).unwrap();
        prop_assert_eq!(solution(&used), solution(&fresh));
        prop_assert_eq!(covariance(&used), covariance(&fresh));
        prop_assert_eq!(used.singular_values(), fresh.singular_values());
    }
}

/// A triangle that is not finite and yields numbers, or the wrong column blamed.
#[test]
fn a_column_that_is_no_number_is_named() {
    let mut d = Decomposition::new(3, vec![0.0; decomposition_len(3)]).unwrap();
    for (at, index) in [(0, 0), (1, 1), (2, 2), (5, 1), (6, 2), (10, 2)] {
        for bad in [f64::NAN, f64::INFINITY] {
            let mut triangle = [
                1.0, 0.5, 0.5, 1.0, 0.0, 1.0, 0.5, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0,
            ];
            triangle[at] = bad;
            assert_eq!(
                d.decompose(&triangle, &[1.0; 3], 1e-9),
                Err(Error::NotFinite { index })
            );
        }
    }
}

/// Two columns that differ by next to nothing: rotations that never settle, a rank of two, a step of NaN.
#[test]
fn nearly_equal_columns_settle() {
    for exponent in 1..=320 {
        let little = 10.0_f64.powi(-exponent);
        let mut d = Decomposition::new(2, vec![0.0; decomposition_len(2)]).unwrap();
        let triangle = [1.0, 1.0, 1.0, 0.0, little, 0.0, 0.0, 0.0, 0.0];
        d.decompose(&triangle, &[1.0; 2], 1e-9)
            .unwrap_or_else(|e| panic!("1e-{exponent}: {e}"));
        assert_eq!(d.rank(), if exponent < 9 { 2 } else { 1 });
        let mut step = [f64::NAN; 2];
        d.step(0.0, &mut step);
        d.remove_unobserved(&mut step);
        assert!(step.iter().all(|s| s.is_finite()));
        if exponent >= 9 {
            assert!((step[0] - 0.5).abs() < 1e-8 && (step[1] - 0.5).abs() < 1e-8);
        }
    }
}

/// No parameter, or one: loops and slices at their shortest.
#[test]
fn the_smallest_systems_work() {
    let mut none = Decomposition::new(0, []).unwrap();
    none.decompose(&[3.0], &[], 1e-9).unwrap();
    assert_eq!((none.rank(), none.unobserved().count()), (0, 0));
    none.covariance(&mut [], &mut [], &mut []);
    let mut one = Decomposition::new(1, [0.0; decomposition_len(1)]).unwrap();
    one.decompose(&[-4.0, 2.0, 0.0, 1.0], &[10.0], 1e-9)
        .unwrap();
    let (mut step, mut data, mut unobserved) = ([0.0], [0.0], [0.0]);
    one.step(0.0, &mut step);
    one.covariance(&mut data, &mut unobserved, &mut [0.0]);
    assert_eq!(
        (one.rank(), step, data, unobserved),
        (1, [-0.5], [0.0625], [0.0])
    );
    one.decompose(&[0.0, 2.0, 0.0, 1.0], &[10.0], 1e-9).unwrap();
    one.step(0.0, &mut step);
    one.covariance(&mut data, &mut unobserved, &mut [0.0]);
    assert_eq!(
        (one.rank(), step, data, unobserved),
        (0, [0.0], [0.0], [100.0])
    );
}

// ------------------------------------------------------------------------------------------------ levenberg

struct Fit<const N: usize> {
    progress: Progress,
    estimate: SVector<f64, N>,
    cost: f64,
    evaluations: usize,
    rank: usize,
    unobserved: Vec<SVector<f64, N>>,
}

/// Rows of a model: each is handed over with its derivatives and what is left of the measurement. `None`
/// where the model does not exist.
type Rows<const N: usize> = Vec<([f64; N], f64)>;

fn fit<const N: usize>(
    start: [f64; N],
    sizes: [f64; N],
    settings: Settings,
    rows: impl FnMut(&[f64; N]) -> Option<Rows<N>>,
) -> Fit<N> {
    let iteration = Levenberg::new(&start, &sizes, settings, vec![f64::NAN; levenberg_len(N)]);
    iterate(start, sizes, iteration.unwrap(), rows)
}

/// Products of the rows and their cost, infinite where there are none.
fn products<const N: usize>(rows: Option<Rows<N>>) -> (Vec<f64>, f64) {
    let mut s = stack(N, 1);
    s.clear_for(Fold::Products);
    let mut cost = f64::INFINITY;
    if let Some(rows) = rows {
        cost = rows.iter().map(|(_, r)| r * r).sum();
        for (j, r) in rows {
            s.push(j.into_iter().chain([r]));
        }
    }
    (s.triangle().to_vec(), cost)
}

/// The same with a descent before: begun where it ends, or at the start where it gets lost.
fn fit_after_descent<const N: usize>(
    start: [f64; N],
    sizes: [f64; N],
    settings: Settings,
    mut rows: impl FnMut(&[f64; N]) -> Option<Rows<N>>,
) -> Fit<N> {
    let mut descent = Descent::new(&start, &sizes, 1e-3, vec![f64::NAN; descent_len(N)]).unwrap();
    let near = loop {
        let trial: [f64; N] = descent.trial().try_into().unwrap();
        let (products, cost) = products(rows(&trial));
        match descent.advance(&products, cost) {
            Descended::Evaluate => {}
            end => break end == Descended::Near,
        }
    };
    let mut iteration =
        Levenberg::new(&start, &sizes, settings, vec![f64::NAN; levenberg_len(N)]).unwrap();
    let place = if near { descent.trial() } else { &start };
    iteration.begin_at(place, descent.evaluations());
    iterate(start, sizes, iteration, rows)
}

fn iterate<const N: usize>(
    start: [f64; N],
    sizes: [f64; N],
    mut iteration: Levenberg<Vec<f64>>,
    mut rows: impl FnMut(&[f64; N]) -> Option<Rows<N>>,
) -> Fit<N> {
    assert_eq!(
        (iteration.start(), iteration.sizes()),
        (&start[..], &sizes[..])
    );
    let mut s = stack(N, 1);
    let progress = loop {
        let trial: [f64; N] = iteration.trial().try_into().unwrap();
        assert!(trial.iter().all(|t| t.is_finite()), "{trial:?}");
        s.clear();
        let mut cost = f64::INFINITY;
        if let Some(rows) = rows(&trial) {
            cost = rows.iter().map(|(_, r)| r * r).sum();
            for (j, r) in rows {
                s.push(j.into_iter().chain([r]));
            }
        }
        match iteration.advance(s.triangle(), cost).unwrap() {
            Progress::Evaluate => {}
            end => break end,
        }
    };
    let (rank, unobserved) = iteration
        .with_decomposition(|d| {
            (
                d.rank(),
                d.unobserved().map(SVector::from_column_slice).collect(),
            )
        })
        .unwrap();
    Fit {
        progress,
        estimate: SVector::from_column_slice(iteration.trial()),
        cost: iteration.cost(),
        evaluations: iteration.evaluations(),
        rank,
        unobserved,
    }
}

/// To the last digit: every rank that rounding can show, and steps down to rounding.
fn thorough() -> Settings {
    Settings {
        max_evaluations: 3000,
        step_tolerance: 1e-12,
        rank_tolerance: 1e-14,
        single_step: false,
    }
}

fn rosenbrock(p: &[f64; 2]) -> Rows<2> {
    let [x, y] = *p;
    vec![
        ([-20.0 * x, 10.0], -10.0 * (y - x * x)),
        ([-1.0, 0.0], x - 1.0),
    ]
}

/// Fits from both starts, with a descent before and without. Where `may_give_up` says so, running out of evaluations is no failure.
fn check_nist<const N: usize>(name: &str, problem: &Problem<N>, may_give_up: [bool; 2]) {
    for (k, after_descent) in [(0, false), (1, false), (0, true), (1, true)] {
        let start = problem.starts[k];
        let sizes = start.map(f64::abs);
        let rows_at = |b: &[f64; N]| {
            let rows: Rows<N> = problem
                .rows
                .iter()
                .map(|(y, x)| {
                    let (value, derivative) = (problem.model)(b, *x);
                    (derivative, y - value)
                })
                .collect();
            rows.iter()
                .all(|(j, r)| r.is_finite() && j.iter().all(|d| d.is_finite()))
                .then_some(rows)
        };
        let fit = if after_descent {
            fit_after_descent(start, sizes, thorough(), rows_at)
        } else {
            fit(start, sizes, thorough(), rows_at)
        };
        let at = format!(
            "{name} from start {}, after a descent: {after_descent}",
            k + 1
        );
        if may_give_up[k] && fit.progress == Progress::Exhausted {
            continue;
        }
        assert_eq!(fit.progress, Progress::Converged, "{at}");
        assert_eq!(fit.rank, N, "{at}");
        for (found, certified) in fit.estimate.iter().zip(problem.certified) {
            assert!(
                (found / certified - 1.0).abs() < 1e-7,
                "{at}: {found} for {certified}"
            );
        }
        assert!(
            (fit.cost / problem.sum_of_squares - 1.0).abs() < 1e-9,
            "{at}: cost {}",
            fit.cost
        );
    }
}

/// A NIST model whose hand-made derivatives are wrong would test nothing.
#[test]
fn nist_derivatives_are_right() {
    fn check<const N: usize>(problem: &Problem<N>) {
        for &(_, x) in problem.rows {
            let (_, derivative) = (problem.model)(&problem.certified, x);
            for k in 0..N {
                let differences = common::derivative(
                    |h| {
                        let mut b = problem.certified;
                        b[k] *= 1.0 + h;
                        SVector::<f64, 1>::new((problem.model)(&b, x).0)
                    },
                    3e-5,
                )[0] / problem.certified[k];
                let size = (problem.model)(&problem.certified, x).0 / problem.certified[k];
                assert!(
                    (derivative[k] - differences).abs()
                        < 1e-7 * size.abs().max(derivative[k].abs())
                );
            }
        }
    }
    check(&nist::MISRA1A);
    check(&nist::THURBER);
    check(&nist::MGH09);
    check(&nist::ECKERLE4);
    check(&nist::BENNETT5);
}

/// An iteration that stops early, at a saddle, or with a parameter called unobserved: Misra1a.
#[test]
fn nist_misra1a() {
    check_nist("Misra1a", &nist::MISRA1A, [false; 2]);
}

/// As above, with seven parameters: Thurber.
#[test]
fn nist_thurber() {
    check_nist("Thurber", &nist::THURBER, [false; 2]);
}

/// As above, with a residual that flattens out: MGH09.
#[test]
fn nist_mgh09() {
    check_nist("MGH09", &nist::MGH09, [false; 2]);
}

/// As above, with a narrow peak: Eckerle4. From the far start, where no row sees the peak, the iteration may run
/// out of evaluations, but must not claim a minimum elsewhere.
#[test]
fn nist_eckerle4() {
    check_nist("Eckerle4", &nist::ECKERLE4, [true, false]);
}

/// As above, almost rank-deficient: Bennett5. Its valley is so narrow that damping which begins too strong crawls
/// through it for thousands of evaluations.
#[test]
fn nist_bennett5() {
    let near = nist::BENNETT5.certified.map(|b| b * (1.0 + 1e-5));
    let near = Problem {
        starts: [near, near],
        ..nist::BENNETT5
    };
    check_nist("Bennett5 from nearby", &near, [false; 2]);
    check_nist("Bennett5", &nist::BENNETT5, [false; 2]);
}

proptest! {
    #![proptest_config(config())]

    /// Damping that never comes down again, or a step accepted that made things worse: the curved valley.
    #[test]
    fn rosenbrock_is_minimised_from_anywhere(start in prop::array::uniform2(-3.0..3.0_f64)) {
        let settings = Settings { step_tolerance: 1e-10, max_evaluations: 500, ..Settings::default() };
        let found = fit(start, [1.0; 2], settings, |p| Some(rosenbrock(p)));
        prop_assert_eq!(found.progress, Progress::Converged);
        prop_assert!((found.estimate - SVector::from([1.0, 1.0])).amax() < 1e-9, "{}", found.estimate);
        prop_assert_eq!(found.rank, 2);
    }

    /// The estimate of a linear problem: two evaluations and the dense solution, whatever the start.
    #[test]
    fn a_linear_problem_takes_one_step(system in systems(), start in prop::array::uniform6(-1.0..1.0_f64)) {
        // in units that differ by more, rounding alone moves a parameter by a fraction of its plausible size
        let (a, b, sizes) = System { decades: 0.5 * system.decades, ..system }.build();
        let Some((s, rank)) = spectrum(&a) else { return Ok(()) };
        prop_assume!(s[0] > 0.0);
        let start = Vector::from(start).component_mul(&sizes);
        let rows = |p: &[f64; N]| {
            let left = b - a * Vector::from(*p);
            Some(a.row_iter().zip(left.iter()).map(|(j, r)| (std::array::from_fn(|k| j[k]), *r)).collect())
        };
        let found = fit(start.into(), sizes.into(), Settings::default(), rows);
        prop_assert_eq!(found.progress, Progress::Converged);
        prop_assert_eq!(found.rank, rank);
        prop_assert!(found.evaluations <= 3, "{}", found.evaluations);
        let expected = start + solution(&decompose(&a, &(b - a * start), &sizes));
        let norms = norms_of(&a);
        let size = expected.component_mul(&norms).amax().max(start.component_mul(&norms).amax()).max(b.norm());
        let difference = (found.estimate - expected).component_mul(&norms).norm();
        prop_assert!(difference < 1e-10 * size, "{difference}");
    }

    /// Rotations that chase a vector of rounding down to where products underflow: two equal columns beside a
    /// third, in one of a few hundred draws.
    #[test]
    fn equal_columns_settle(seed in any::<u64>()) {
        let mut random = Random(seed);
        for _ in 0..20 {
            let (rate, scale) = (1.5 * random.unit(), 1.0 + 0.3 * random.unit());
            let mut s = stack(3, 1);
            for i in 0..30 {
                let x = f64::from(i) / 10.0;
                let y = scale * (rate * x).exp();
                s.push([x * y, x * y, y / scale, random.unit()]);
            }
            let mut d = Decomposition::new(3, vec![0.0; decomposition_len(3)]).unwrap();
            prop_assert_eq!(d.decompose(s.triangle(), &[1.0; 3], 1e-9), Ok(()));
            prop_assert_eq!(d.rank(), 2);
        }
    }

    /// Parameters of which only a sum is seen: an estimate that wanders along the difference instead of
    /// sharing the change by plausible size.
    #[test]
    fn an_unseen_difference_is_shared_by_plausible_size(
        start in prop::array::uniform3(-1.0..1.0_f64),
        sizes in prop::array::uniform3(-2.0..2.0_f64),
        truth in (-0.7..0.7_f64, 0.5..2.0_f64),
    ) {
        let sizes = sizes.map(|s: f64| 10.0_f64.powf(s));
        let start = [start[0], start[1], 1.0 + 0.3 * start[2]];
        let (sum, scale) = truth;
        let rows = |p: &[f64; 3]| {
            Some((0..30).map(|i| {
                let x = f64::from(i) / 10.0;
                let y = p[2] * ((p[0] + p[1]) * x).exp();
                ([x * y, x * y, y / p[2]], scale * (sum * x).exp() - y)
            }).collect())
        };
        let settings = Settings { step_tolerance: 1e-10, max_evaluations: 1000, ..Settings::default() };
        let found = fit(start, sizes, settings, rows);
        prop_assert_eq!(found.progress, Progress::Converged);
        prop_assert_eq!(found.rank, 2);
        let p = found.estimate;
        prop_assert!((p[0] + p[1] - sum).abs() < 1e-7 && (p[2] - scale).abs() < 1e-7, "{p}");
        let share = |k: usize| sizes[k].powi(2) / (sizes[0].powi(2) + sizes[1].powi(2));
        let change = sum - start[0] - start[1];
        for k in 0..2 {
            prop_assert!((p[k] - start[k] - change * share(k)).abs() < 1e-7 * change.abs().max(1.0), "{p}");
        }
    }

    /// As above where the unseen direction turns on the way: a false claim of convergence, from anywhere. That it
    /// does converge is checked from a few starts below.
    #[test]
    fn an_unseen_curve_is_never_left_elsewhere(
        start in prop::array::uniform2(0.5..3.0_f64),
        sizes in prop::array::uniform2(-0.5..0.5_f64),
        growth in 0.5..2.0_f64,
    ) {
        let sizes = sizes.map(|s: f64| 10.0_f64.powf(s));
        let (found, along) = fit_product(start, sizes, growth * start[0] * start[1]);
        if found.progress == Progress::Converged {
            prop_assert!(along.abs() < 1e-7, "{along} at {}", found.estimate);
        }
    }

    /// A trial that cannot be evaluated and ends the iteration, or whose rows get into the estimate: the first
    /// step of a logarithm leads far outside of where it exists.
    #[test]
    fn failed_trials_are_recovered_from(
        truth in prop::array::uniform2(0.05..2.0_f64),
        start in prop::array::uniform2(6.0..40.0_f64),
        nan in any::<bool>(),
    ) {
        let mut failures = 0;
        let mut iteration = Levenberg::new(
            &start, &[1.0; 2], Settings { step_tolerance: 1e-10, max_evaluations: 500, ..Settings::default() },
            vec![0.0; levenberg_len(2)],
        ).unwrap();
        let mut s = stack(2, 1);
        let end = loop {
            let p = [iteration.trial()[0], iteration.trial()[1]];
            s.clear();
            let mut cost = 0.0;
            if p.iter().all(|p| *p > 0.0) {
                for k in 0..2 {
                    let left = truth[k].ln() - p[k].ln();
                    let mut j = [0.0; 2];
                    j[k] = 1.0 / p[k];
                    s.push(j.into_iter().chain([left]));
                    cost += left * left;
                }
            } else {
                failures += 1;
                // rows of nonsense that must not be looked at
                s.push([f64::NAN; 3]);
                cost = if nan { f64::NAN } else { f64::INFINITY };
            }
            match iteration.advance(s.triangle(), cost).unwrap() {
                Progress::Evaluate => {}
                end => break end,
            }
        };
        prop_assert_eq!(end, Progress::Converged);
        prop_assert!(failures > 0);
        for k in 0..2 {
            prop_assert!((iteration.trial()[k] - truth[k]).abs() < 1e-9);
        }
        prop_assert!(iteration.cost() < 1e-14);
    }

    /// A cost that rises from one estimate to the next, or an estimate that is not the best trial seen.
    #[test]
    fn the_best_trial_is_kept(start in prop::array::uniform2(-3.0..3.0_f64), allowed in 1..12_usize) {
        let mut best = f64::INFINITY;
        let settings = Settings { max_evaluations: allowed, step_tolerance: 0.0, ..Settings::default() };
        let found = fit(start, [1.0; 2], settings, |p| {
            let rows = rosenbrock(p);
            best = best.min(rows.iter().map(|(_, r)| r * r).sum());
            Some(rows)
        });
        prop_assert!(found.evaluations <= allowed);
        prop_assert!(found.cost <= best * (1.0 + 1e-11) && found.cost >= best * (1.0 - 1e-11));
        let estimate: [f64; 2] = found.estimate.into();
        let cost: f64 = rosenbrock(&estimate).iter().map(|(_, r)| r * r).sum();
        // where the minimum is reached exactly, both are rounding
        prop_assert!((cost - best).abs() <= 1e-9 * best + 1e-25, "{cost} {best}");
    }

    /// A single step that is damped, repeated, or not the linear solution at the start.
    #[test]
    fn a_single_step_is_the_linear_solution(start in prop::array::uniform2(0.9..1.1_f64)) {
        let settings = Settings { single_step: true, ..Settings::default() };
        // from a start of no curvature in the first row's residual the step lowers the cost
        let start = [start[0], start[0] * start[0] + 0.01 * (start[1] - 1.0)];
        let found = fit(start, [1.0; 2], settings, |p| {
            let [x, y] = *p;
            Some(vec![([-2.0 * x, 1.0], x * x - y), ([1.0, 0.0], 1.0 - x)])
        });
        prop_assert!(found.progress == Progress::Converged && found.evaluations <= 2);
        let [x, y] = start;
        // the step to x = 1 that keeps the linearised first residual at zero
        let expected = SVector::from([1.0, y + (x * x - y) + 2.0 * x * (1.0 - x)]);
        prop_assert!((found.estimate - expected).amax() < 1e-12, "{} {expected}", found.estimate);
    }
}

/// Only the product of two parameters is seen. The smallest deviation on the hyperbola is where the deviation
/// is at right angles to it, in plausible sizes: the second result vanishes there.
fn fit_product(start: [f64; 2], sizes: [f64; 2], product: f64) -> (Fit<2>, f64) {
    let settings = Settings {
        step_tolerance: 1e-9,
        max_evaluations: 2000,
        ..Settings::default()
    };
    let found = fit(start, sizes, settings, |p| {
        // rows in pairs of opposite noise, so that the cost has a floor above rounding
        let row = |i: u8| {
            let x = f64::from(i / 2);
            let noise = if i.is_multiple_of(2) { 0.1 } else { -0.1 };
            ([x * p[1], x * p[0]], x * (product - p[0] * p[1]) + noise)
        };
        Some((2..20).map(row).collect())
    });
    let part =
        |k: usize| found.estimate[k] * (found.estimate[k] - start[k]) / (sizes[k] * sizes[k]);
    let along = part(0) - part(1);
    (found, along)
}

/// An estimate that keeps to the first linearisation's unseen direction while the direction turns.
#[test]
fn an_unseen_curve_is_left_at_the_smallest_deviation() {
    for (start, sizes, product) in [
        ([1.0, 1.0], [1.0, 1.0], 1.5),
        ([1.0, 1.0], [1.0, 3.0], 0.8),
        ([2.0, 0.5], [0.5, 1.0], 1.3),
        ([0.7, 2.5], [1.0, 2.0], 2.0),
    ] {
        let (found, along) = fit_product(start, sizes, product);
        assert_eq!(
            (found.progress, found.rank, found.unobserved.len()),
            (Progress::Converged, 1, 1)
        );
        let p = found.estimate;
        assert!((p[0] * p[1] - product).abs() < 1e-8, "{p}");
        assert!(along.abs() < 1e-7, "{along} at {p}");
    }
}

/// A wall around the start that is called a minimum: every other place fails, so the iteration has to give up.
#[test]
fn a_wall_is_no_minimum() {
    let found = fit([2.0], [1.0], Settings::default(), |p| {
        (p[0] == 2.0).then(|| vec![([1.0], 3.0)])
    });
    assert_eq!(found.progress, Progress::Exhausted);
    assert_eq!(found.estimate[0], 2.0);
}

/// The linear solution withheld because the model's curvature raises the cost there.
#[test]
fn a_single_step_is_taken_even_where_it_raises_the_cost() {
    let settings = Settings {
        single_step: true,
        ..Settings::default()
    };
    let found = fit([-1.2, 1.0], [1.0; 2], settings, |p| Some(rosenbrock(p)));
    assert!((found.estimate - SVector::from([1.0, -3.84])).amax() < 1e-12);
}

/// A start that cannot be evaluated and is iterated from.
#[test]
fn a_start_that_fails_is_refused() {
    for cost in [f64::INFINITY, f64::NAN, f64::NEG_INFINITY] {
        let mut iteration = Levenberg::new(
            &[1.0],
            &[1.0],
            Settings::default(),
            vec![0.0; levenberg_len(1)],
        )
        .unwrap();
        assert_eq!(
            iteration.advance(&[1.0, 0.0, 0.0, 1.0], cost),
            Err(Error::NotFinite { index: 0 })
        );
    }
}

// ------------------------------------------------------------------------------------------------- losses

const LOSSES: [(Loss, &str, f64); 4] = [
    (Loss::Linear, "linear", f64::INFINITY),
    (Loss::Huber, "huber", 1.345),
    (Loss::Cauchy, "cauchy", 2.385),
    (Loss::Tukey, "tukey", 4.685),
];

proptest! {
    #![proptest_config(config())]

    /// A weight that is not the derivative of its cost, so that the iteration minimises something else than
    /// it reports: `d(2ρ)/du = 2 w u`.
    #[test]
    fn weight_is_the_slope_of_the_cost(u in -12.0..12.0_f64) {
        for (loss, name, knee) in LOSSES {
            let h = 1e-3;
            if (u.abs() - knee).abs() < 2.0 * h {
                continue;
            }
            let slope = common::derivative(|h| SVector::<f64, 1>::new(loss.root_weight_and_cost(u + h).1), h)[0];
            let (root, cost) = loss.root_weight_and_cost(u);
            prop_assert!((slope - 2.0 * root * root * u).abs() < 1e-9, "{name} at {u}");
            prop_assert_eq!(loss.root_weight_and_cost(-u), (root, cost));
            prop_assert!((0.0..=1.0).contains(&root) && cost >= 0.0 && cost <= u * u + 1e-12);
        }
    }
}

/// A step in cost or weight where a loss changes its formula; a cost that is not `u²` for small residuals.
#[test]
fn losses_are_continuous_at_the_knee_and_square_near_zero() {
    for (loss, name, knee) in LOSSES {
        assert_eq!(Loss::from_name(name), Some(loss));
        assert_eq!(loss.root_weight_and_cost(0.0), (1.0, 0.0), "{name}");
        let u = 1e-4;
        assert!((loss.root_weight_and_cost(u).1 / (u * u) - 1.0).abs() < 1e-7);
        if knee.is_finite() {
            let (below, above) = (knee * (1.0 - 1e-9), knee * (1.0 + 1e-9));
            let (a, b) = (
                loss.root_weight_and_cost(below),
                loss.root_weight_and_cost(above),
            );
            assert!(
                (a.0 - b.0).abs() < 1e-7 && (a.1 - b.1).abs() < 1e-7,
                "{name}"
            );
        }
    }
    assert_eq!(Loss::from_name("Huber"), None);
}

/// A tuning constant that does not give the efficiency of 95 % on Gaussian noise that it is chosen for:
/// `(E ψ')² / E ψ²` with `ψ(u) = w u`, and `E ψ' = E u ψ` for a standard normal.
#[test]
fn losses_are_95_percent_efficient() {
    for (loss, name, knee) in LOSSES {
        let (mut slope, mut square) = (0.0, 0.0);
        let h = 1e-3;
        for i in -12_000..12_000 {
            let u = (f64::from(i) + 0.5) * h;
            let density = (-0.5 * u * u).exp() / std::f64::consts::TAU.sqrt() * h;
            let psi = loss.root_weight_and_cost(u).0.powi(2) * u;
            slope += u * psi * density;
            square += psi * psi * density;
        }
        let expected = if knee.is_finite() { 0.95 } else { 1.0 };
        let efficiency = slope * slope / square;
        assert!((efficiency - expected).abs() < 1e-3, "{name}: {efficiency}");
    }
}

/// An outlier that still decides the fit, under iteratively reweighted rows as the solver makes them.
#[test]
fn robust_losses_resist_an_outlier() {
    let data: Vec<(f64, f64)> = (0..40)
        .map(|i| {
            let x = f64::from(i) / 10.0;
            let noise = 0.3 * (f64::from(i) * 1.7).sin();
            (x, 1.0 + 2.0 * x + noise + if i == 37 { 50.0 } else { 0.0 })
        })
        .collect();
    let fitted = |loss: Loss| {
        // from near the truth, as Tukey's loss demands
        let mut iteration = Levenberg::new(
            &[1.2, 1.9],
            &[1.0; 2],
            Settings::default(),
            vec![0.0; levenberg_len(2)],
        )
        .unwrap();
        let mut s = stack(2, 1);
        loop {
            let [a, b] = [iteration.trial()[0], iteration.trial()[1]];
            s.clear();
            let mut total = 0.0;
            for (x, y) in &data {
                let u = (y - a - b * x) / 0.3;
                let (root, cost) = loss.root_weight_and_cost(u);
                total += cost;
                s.push([root / 0.3, root * x / 0.3, root * u]);
            }
            if iteration.advance(s.triangle(), total).unwrap() != Progress::Evaluate {
                return (iteration.trial()[0] - 1.0)
                    .abs()
                    .max((iteration.trial()[1] - 2.0).abs());
            }
        }
    };
    assert!(fitted(Loss::Linear) > 1.0);
    for loss in [Loss::Huber, Loss::Cauchy, Loss::Tukey] {
        assert!(fitted(loss) < 0.2, "{loss:?}: {}", fitted(loss));
    }
}
