//! Rank, solution, covariance and blind directions against nalgebra's decompositions.

use crate::common::{Random, config};
use crate::systems::*;
use nalgebra::{SMatrix, SVector};
use proptest::prelude::*;
use sherkit_core::Error;
use sherkit_core::fit::{Decomposition, decomposition_len};

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
