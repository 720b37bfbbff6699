//! Linear systems by recipes, and what is asked of them.

use crate::common::Random;
use nalgebra::{SMatrix, SVector};
use proptest::prelude::*;
use sherkit_core::fit::{Decomposition, Stack, decomposition_len, stack_len};

pub fn stack(columns: usize, targets: usize) -> Stack<Vec<f64>> {
    Stack::new(columns, targets, vec![0.0; stack_len(columns, targets)]).expect("right length")
}

pub fn gram_of_rows(rows: &[Vec<f64>], width: usize) -> Vec<f64> {
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

pub fn gram_of_triangle(triangle: &[f64], width: usize) -> Vec<f64> {
    let rows: Vec<Vec<f64>> = triangle.chunks_exact(width).map(<[f64]>::to_vec).collect();
    gram_of_rows(&rows, width)
}

/// Largest difference of two Gram matrices, each element in units of its own two columns.
pub fn gram_difference(a: &[f64], b: &[f64], width: usize) -> f64 {
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

pub const ROWS: usize = 40;
pub const N: usize = 6;
pub type Design = SMatrix<f64, ROWS, N>;
pub type Targets = SVector<f64, ROWS>;
pub type Square = SMatrix<f64, N, N>;
pub type Vector = SVector<f64, N>;

pub const TOLERANCE: f64 = 1e-9;

pub fn decompose(a: &Design, b: &Targets, sizes: &Vector) -> Decomposition<Vec<f64>> {
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
pub fn solution(d: &Decomposition<Vec<f64>>) -> Vector {
    let mut x = Vector::repeat(f64::NAN);
    d.step(0.0, x.as_mut_slice());
    d.remove_unobserved(x.as_mut_slice());
    x
}

pub fn covariance(d: &Decomposition<Vec<f64>>) -> (Square, Square) {
    let (mut data, mut unobserved) = (Square::repeat(f64::NAN), Square::repeat(f64::NAN));
    let mut scratch = [f64::NAN; N];
    d.covariance(data.as_mut_slice(), unobserved.as_mut_slice(), &mut scratch);
    (data, unobserved)
}

pub fn unobserved(d: &Decomposition<Vec<f64>>) -> Vec<Vector> {
    d.unobserved().map(Vector::from_column_slice).collect()
}

/// Columns that are fresh, zero, copies or combinations of earlier ones; `used` rows of numbers, zeros below.
pub fn random_design(random: &mut Random, used: usize, kinds: [u8; N], decades: f64) -> Design {
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

pub fn norms_of(a: &Design) -> Vector {
    Vector::from_fn(|k, _| match a.column(k).norm() {
        0.0 => 1.0,
        norm => norm,
    })
}

pub fn scaled(a: &Design) -> Design {
    a * Square::from_diagonal(&norms_of(a).map(f64::recip))
}

/// A linear system by its recipe, so that a failing case prints in one line.
#[derive(Clone, Copy, Debug)]
pub struct System {
    pub seed: u64,
    pub kinds: [u8; N],
    pub used: usize,
    pub decades: f64,
}

impl System {
    pub fn build(&self) -> (Design, Targets, Vector) {
        let mut random = Random(self.seed);
        let a = random_design(&mut random, self.used, self.kinds, self.decades);
        let b = Targets::from_fn(|_, _| random.unit());
        let sizes = Vector::from_fn(|_, _| random.magnitude(self.decades));
        (a, b, sizes)
    }
}

/// A column that moves the readings by less than this part of what moves them most is taken for rounding.
pub const ROUNDING: f64 = 1e-13;

/// How far the readings move for a change of plausible size of each parameter, and the most of these or of what is
/// to be explained.
pub fn effects(a: &Design, b: &Targets, sizes: &Vector) -> (Vector, f64) {
    let each = Vector::from_fn(|k, _| a.column(k).norm() * sizes[k]);
    (each, each.amax().max(b.norm()))
}

/// A column that moves the readings by less than this part of what nothing explains tells nothing.
const ABSURD: f64 = 1e-4;

/// The matrix without the columns that count as rounding, or that would explain nothing at any size; none where a column
/// is so close to the limit that rounding decides.
pub fn known(a: &Design, b: &Targets, sizes: &Vector) -> Option<Design> {
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
    let svd = scaled(&known).svd(true, false);
    let u = svd.u?;
    let mut left = *b;
    for (k, s) in svd.singular_values.iter().enumerate() {
        if *s > TOLERANCE * svd.singular_values.max() {
            left -= u.column(k) * u.column(k).dot(b);
        }
    }
    for (k, effect) in each.iter().enumerate() {
        let share = effect / (ABSURD * left.norm());
        if (share - 1.0).abs() < 1e-6 {
            return None;
        }
        if share < 1.0 {
            known.column_mut(k).fill(0.0);
        }
    }
    Some(known)
}

pub fn systems() -> impl Strategy<Value = System> {
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
pub fn spectrum(a: &Design) -> Option<(Vec<f64>, usize)> {
    let mut random = Random(1);
    let noisy = scaled(a) + Design::from_fn(|_, _| NOISE * random.unit());
    let mut s: Vec<f64> = noisy.singular_values().iter().copied().collect();
    s.sort_by(|x, y| y.total_cmp(x));
    let zero = 100.0 * NOISE;
    let clear = s.iter().all(|x| *x > 1e-4 || *x < zero);
    let rank = s.iter().filter(|x| **x > zero).count();
    clear.then_some((s, rank))
}

pub const NOISE: f64 = 1e-11;
