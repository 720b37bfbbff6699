//! Least squares of a tensor product over scattered points by its Legendre moments.
//!
//! A product of two Legendre polynomials is a sum of single ones, so the normal equations of all points need no more
//! than sums of products of polynomials up to twice the order: a few numbers for each point instead of a row. Legendre
//! polynomials are nearly orthogonal on points that fill the box, which keeps the equations well conditioned; where they
//! are not, the weakest pivot says so and the caller takes orthogonal rotations instead ([`super::correction::push`]).
//! Sums of two sets of points are those of both, so that a block is left out by subtraction.
//!
//! Sources: products of Legendre polynomials by their recursion, DLMF 18.9; their Bernstein coefficients, Farouki,
//! "Legendre–Bernstein basis transformations", J. Comput. Appl. Math. 2000, Eq. 20.

use super::correction::{Domain, MAX_ORDER, coefficients_len};
use crate::numbers::math::sqrt;
use crate::{Error, Result};
use nalgebra::Vector3;

const WIDTH: usize = MAX_ORDER + 1;
/// Degrees that products of two polynomials reach.
const DEGREES: usize = 2 * MAX_ORDER + 1;
/// Points whose sums are taken together, so that each sum is touched once for all of them.
const TOGETHER: usize = 4;

/// Numbers that the sums of [`Moments`] take.
#[must_use]
pub const fn moments_len(orders: [usize; 3]) -> usize {
    (2 * orders[0] + 1) * (2 * orders[1] + 1) * (2 * orders[2] + 1) + 3 * coefficients_len(orders)
}

/// Numbers of scratch that [`Moments::solve`] takes.
#[must_use]
pub const fn solve_len(orders: [usize; 3]) -> usize {
    let n = coefficients_len(orders);
    n * n
}

/// Sums over points. `S` is storage of [`moments_len`] numbers, zero at the start.
#[derive(Clone, Debug)]
pub struct Moments<S> {
    orders: [usize; 3],
    domain: Domain,
    points: usize,
    storage: S,
}

impl<S: AsRef<[f64]> + AsMut<[f64]>> Moments<S> {
    /// Empty sums.
    ///
    /// # Errors
    /// [`Error::WrongLength`] for an order above [`MAX_ORDER`] or storage of another length.
    pub fn new(orders: [usize; 3], domain: Domain, mut storage: S) -> Result<Self> {
        if let Some(&found) = orders.iter().find(|o| **o > MAX_ORDER) {
            return Err(Error::WrongLength {
                expected: MAX_ORDER,
                found,
            });
        }
        let (expected, found) = (moments_len(orders), storage.as_ref().len());
        if expected != found {
            return Err(Error::WrongLength { expected, found });
        }
        storage.as_mut().fill(0.0);
        Ok(Self {
            orders,
            domain,
            points: 0,
            storage,
        })
    }

    /// Adds points and what the polynomial is to be there.
    pub fn push(&mut self, positions: &[[f64; 3]], targets: &[[f64; 3]]) {
        let orders = self.orders;
        let degrees = orders.map(|o| 2 * o + 1);
        let (own, right) = self
            .storage
            .as_mut()
            .split_at_mut(degrees[0] * degrees[1] * degrees[2]);
        for (positions, targets) in positions.chunks(TOGETHER).zip(targets.chunks(TOGETHER)) {
            let mut p = [[[0.0; DEGREES]; TOGETHER]; 3];
            for (j, position) in positions.iter().enumerate() {
                let (t, _) = self.domain.normalised(&Vector3::from(*position), orders);
                for k in 0..3 {
                    p[k][j] = legendre(2.0 * t[k] - 1.0);
                }
            }
            // points that are missing in the last chunk weigh nothing
            for (j, place) in p[0].iter_mut().enumerate() {
                if j >= positions.len() {
                    *place = [0.0; DEGREES];
                }
            }
            let [px, py, pz] = &p;
            let mut sums = own.chunks_exact_mut(degrees[2]);
            for x in 0..degrees[0] {
                for y in 0..degrees[1] {
                    let w: [f64; TOGETHER] = core::array::from_fn(|j| px[j][x] * py[j][y]);
                    if let Some(line) = sums.next() {
                        for (z, sum) in line.iter_mut().enumerate() {
                            *sum += (w[0] * pz[0][z] + w[1] * pz[1][z])
                                + (w[2] * pz[2][z] + w[3] * pz[3][z]);
                        }
                    }
                }
            }
            let mut y = [[0.0; 3]; TOGETHER];
            y[..targets.len()].copy_from_slice(targets);
            let mut sums = right.as_chunks_mut::<3>().0.chunks_exact_mut(orders[2] + 1);
            for a in 0..=orders[0] {
                for b in 0..=orders[1] {
                    let w: [f64; TOGETHER] = core::array::from_fn(|j| px[j][a] * py[j][b]);
                    if let Some(line) = sums.next() {
                        for (z, sum) in line.iter_mut().enumerate() {
                            let w: [f64; TOGETHER] = core::array::from_fn(|j| w[j] * pz[j][z]);
                            for (c, s) in sum.iter_mut().enumerate() {
                                *s += (w[0] * y[0][c] + w[1] * y[1][c])
                                    + (w[2] * y[2][c] + w[3] * y[3][c]);
                            }
                        }
                    }
                }
            }
            self.points += positions.len();
        }
    }

    /// Adds the sums of other points with the same orders and box; `sign` -1 takes them away.
    ///
    /// # Errors
    /// [`Error::WrongLength`] where the orders differ.
    pub fn absorb<T: AsRef<[f64]>>(&mut self, other: &Moments<T>, sign: f64) -> Result<()> {
        let (own, new) = (self.storage.as_mut(), other.storage.as_ref());
        if own.len() != new.len() || self.orders != other.orders {
            return Err(Error::WrongLength {
                expected: own.len(),
                found: new.len(),
            });
        }
        for (a, b) in own.iter_mut().zip(new) {
            *a += sign * b;
        }
        self.points = if sign < 0.0 {
            self.points.saturating_sub(other.points)
        } else {
            self.points + other.points
        };
        Ok(())
    }

    /// Writes the Bernstein coefficients and returns how well the points determine them: the weakest pivot over the
    /// strongest, of the polynomials and not of their squares. `scratch` holds [`solve_len`] numbers.
    ///
    /// # Errors
    /// [`Error::WrongLength`] for a wrong buffer; [`Error::Singular`] where nothing determines a coefficient.
    pub fn solve(&self, coefficients: &mut [[f64; 3]], scratch: &mut [f64]) -> Result<f64> {
        let n = coefficients_len(self.orders);
        for (expected, found) in [(n, coefficients.len()), (n * n, scratch.len())] {
            if expected != found {
                return Err(Error::WrongLength { expected, found });
            }
        }
        let degrees = self.orders.map(|o| 2 * o + 1);
        let (own, right) = self
            .storage
            .as_ref()
            .split_at(degrees[0] * degrees[1] * degrees[2]);
        self.normal(own, scratch);
        coefficients.copy_from_slice(right.as_chunks::<3>().0);
        let weakest = cholesky(scratch, coefficients, |k| self.squared_length(k))?;
        for axis in 0..3 {
            self.to_bernstein(axis, coefficients);
        }
        Ok(weakest)
    }

    /// The upper half of the normal equations (n × n).
    fn normal(&self, moments: &[f64], gram: &mut [f64]) {
        let (orders, products) = (self.orders, products());
        let [_, dy, dz] = orders.map(|o| 2 * o + 1);
        let n = coefficients_len(orders);
        let [ny, nz] = [orders[1] + 1, orders[2] + 1];
        let mut by_x = [[0.0; DEGREES]; DEGREES];
        let mut by_xy = [0.0; DEGREES];
        for i in 0..=orders[0] {
            for i2 in i..=orders[0] {
                for (y, line) in by_x[..dy].iter_mut().enumerate() {
                    for (z, value) in line[..dz].iter_mut().enumerate() {
                        *value =
                            sum_of(&products[i][i2], i, i2, |d| moments[(d * dy + y) * dz + z]);
                    }
                }
                for j in 0..ny {
                    for j2 in 0..ny {
                        for (z, value) in by_xy[..dz].iter_mut().enumerate() {
                            *value = sum_of(&products[j][j2], j, j2, |d| by_x[d][z]);
                        }
                        let (row, column) = ((i * ny + j) * nz, (i2 * ny + j2) * nz);
                        for k in 0..nz {
                            let line = &mut gram[(row + k) * n + column..][..nz];
                            for (k2, g) in line.iter_mut().enumerate() {
                                *g = sum_of(&products[k][k2], k, k2, |d| by_xy[d]);
                            }
                        }
                    }
                }
            }
        }
    }

    /// Mean square over the box of the polynomial with this place among the coefficients.
    fn squared_length(&self, place: usize) -> f64 {
        let [_, ny, nz] = self.orders.map(|o| o + 1);
        let degrees = [place / (ny * nz), place / nz % ny, place % nz];
        degrees.iter().map(|d| 1.0 / (2 * d + 1) as f64).product()
    }

    /// Takes coefficients of Legendre polynomials along an axis to those of Bernstein's.
    fn to_bernstein(&self, axis: usize, coefficients: &mut [[f64; 3]]) {
        let order = self.orders[axis];
        let inner: usize = self.orders[axis + 1..].iter().map(|o| o + 1).product();
        let matrix = bernstein_of_legendre(order);
        for block in coefficients.chunks_exact_mut((order + 1) * inner) {
            for at in 0..inner {
                let mut line = [[0.0; 3]; WIDTH];
                for (k, value) in line[..=order].iter_mut().enumerate() {
                    *value = block[k * inner + at];
                }
                for (k, row) in matrix[..=order].iter().enumerate() {
                    let mut sum = [0.0; 3];
                    for (m, value) in row[..=order].iter().zip(&line) {
                        for (s, v) in sum.iter_mut().zip(value) {
                            *s += m * v;
                        }
                    }
                    block[k * inner + at] = sum;
                }
            }
        }
    }
}

/// Legendre polynomials of every degree at `t`, -1 to 1.
fn legendre(t: f64) -> [f64; DEGREES] {
    let mut p = [0.0; DEGREES];
    p[0] = 1.0;
    p[1] = t;
    for n in 2..DEGREES {
        let k = n as f64;
        p[n] = ((2.0 * k - 1.0) * t * p[n - 1] - (k - 1.0) * p[n - 2]) / k;
    }
    p
}

/// `P_i P_j` as a sum of single polynomials.
fn products() -> [[[f64; DEGREES]; WIDTH]; WIDTH] {
    let mut out = [[[0.0; DEGREES]; WIDTH]; WIDTH];
    for j in 0..WIDTH {
        out[0][j][j] = 1.0;
        for i in 1..WIDTH {
            // t P_d = ((d + 1) P_(d+1) + d P_(d-1)) / (2 d + 1)
            let mut by_t = [0.0; DEGREES];
            for (d, value) in out[i - 1][j].iter().enumerate() {
                let k = d as f64;
                if d + 1 < DEGREES {
                    by_t[d + 1] += value * (k + 1.0) / (2.0 * k + 1.0);
                }
                if d > 0 {
                    by_t[d - 1] += value * k / (2.0 * k + 1.0);
                }
            }
            let k = i as f64;
            for d in 0..DEGREES {
                let before = if i > 1 { out[i - 2][j][d] } else { 0.0 };
                out[i][j][d] = ((2.0 * k - 1.0) * by_t[d] - (k - 1.0) * before) / k;
            }
        }
    }
    out
}

/// The sum of what a product of degrees `i` and `j` is made of: every second degree from their difference on.
fn sum_of(parts: &[f64; DEGREES], i: usize, j: usize, of: impl Fn(usize) -> f64) -> f64 {
    (i.abs_diff(j)..=i + j)
        .step_by(2)
        .map(|d| parts[d] * of(d))
        .sum()
}

/// Bernstein coefficients `[k]` of each Legendre polynomial `[j]`.
fn bernstein_of_legendre(order: usize) -> [[f64; WIDTH]; WIDTH] {
    let mut out = [[0.0; WIDTH]; WIDTH];
    for j in 0..=order {
        for k in 0..=order {
            let from = (j + k).saturating_sub(order);
            let sum: f64 = (from..=j.min(k))
                .map(|i| {
                    let sign = if (j - i).is_multiple_of(2) { 1.0 } else { -1.0 };
                    sign * binomial(j, i) * binomial(j, i) * binomial(order - j, k - i)
                })
                .sum();
            out[k][j] = sum / binomial(order, k);
        }
    }
    out
}

fn binomial(n: usize, k: usize) -> f64 {
    (0..k).fold(1.0, |b, i| b * (n - i) as f64 / (i + 1) as f64)
}

/// Solves the upper half of normal equations in place; the weakest pivot over the strongest, each beside what it would
/// be for points that fill the box.
fn cholesky(gram: &mut [f64], right: &mut [[f64; 3]], usual: impl Fn(usize) -> f64) -> Result<f64> {
    let n = right.len();
    let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
    for k in 0..n {
        let (head, tail) = gram.split_at_mut((k + 1) * n);
        let row = &mut head[k * n..];
        let pivot = row[k];
        least = least.min(pivot / usual(k));
        most = most.max(pivot / usual(k));
        if !(pivot > 0.0 && pivot.is_finite()) {
            return Err(Error::Singular);
        }
        let scale = 1.0 / sqrt(pivot);
        for value in &mut row[k..] {
            *value *= scale;
        }
        for (i, other) in tail.chunks_exact_mut(n).enumerate() {
            let i = k + 1 + i;
            let by = row[i];
            for (a, b) in other[i..].iter_mut().zip(&row[i..]) {
                *a -= by * b;
            }
        }
    }
    for k in 0..n {
        let row = &gram[k * n..][..n];
        let value = right[k].map(|v| v / row[k]);
        right[k] = value;
        for (by, other) in row[k + 1..].iter().zip(&mut right[k + 1..]) {
            for (o, v) in other.iter_mut().zip(value) {
                *o -= by * v;
            }
        }
    }
    for k in (0..n).rev() {
        let row = &gram[k * n..][..n];
        let mut sum = right[k];
        for (by, other) in row[k + 1..].iter().zip(&right[k + 1..]) {
            for (s, o) in sum.iter_mut().zip(other) {
                *s -= by * o;
            }
        }
        right[k] = sum.map(|s| s / row[k]);
    }
    Ok(sqrt(least / most))
}
