//! The triangle of a stack of rows against products of the rows.

use crate::common::{Random, config};
use crate::systems::{gram_difference, gram_of_rows, gram_of_triangle, stack};
use nalgebra::{SMatrix, SVector};
use proptest::prelude::*;
use sherkit_core::Error;
use sherkit_core::fit::{
    BLOCK_ROWS, Decomposition, Fold, Levenberg, Settings, Stack, decomposition_len, levenberg_len,
    stack_len,
};

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
