//! The way to the minimum by products of the rows, as a state machine: Gauss–Newton steps by Cholesky's decomposition.
//!
//! Products have half the digits of the rows, enough for steps that the next one corrects. What is found is where
//! [`super::Levenberg`] starts to look carefully, by orthogonal reflections; from a start that is already the minimum it
//! needs one evaluation. Where steps do not lower the cost, or the products say too little, the descent is given up and
//! the careful iteration goes all the way.
//!
//! A prior that weighs next to nothing keeps what no row observes at the start (Golub and Van Loan, 4.2 and 5.3).

use crate::numbers::math::sqrt;
use crate::{Error, Result};

/// Weight of the prior beside the strongest parameter, in plausible sizes: above the rounding of the products.
const PRIOR: f64 = 1e-12;
/// Gauss–Newton that has not come near by then does not.
const MOST_EVALUATIONS: usize = 12;

/// Numbers that a [`Descent`] of `n` parameters needs.
#[must_use]
pub const fn descent_len(n: usize) -> usize {
    n * n + 4 * n
}

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Descended {
    /// Evaluate the products at the new trial.
    Evaluate,
    /// The trial is so near the minimum that one careful step leads there.
    Near,
    /// The way cannot be found so.
    Lost,
}

/// The descent. `S` is storage of [`descent_len`] numbers.
#[derive(Clone, Debug)]
pub struct Descent<S> {
    n: usize,
    near: f64,
    evaluations: usize,
    cost: f64,
    /// start | sizes | trial | step | matrix
    storage: S,
}

impl<S: AsRef<[f64]> + AsMut<[f64]>> Descent<S> {
    /// Starts at `start`; `sizes` are the plausible sizes of the parameters. The last step is less than `near` of them: each
    /// step leaves about the square of the one before.
    ///
    /// # Errors
    /// [`Error::WrongLength`].
    pub fn new(start: &[f64], sizes: &[f64], near: f64, mut storage: S) -> Result<Self> {
        let n = start.len();
        for (expected, found) in [(descent_len(n), storage.as_ref().len()), (n, sizes.len())] {
            if expected != found {
                return Err(Error::WrongLength { expected, found });
            }
        }
        for (slot, values) in storage
            .as_mut()
            .chunks_exact_mut(n.max(1))
            .zip([start, sizes, start])
        {
            slot.copy_from_slice(values);
        }
        Ok(Self {
            n,
            near,
            evaluations: 0,
            cost: f64::INFINITY,
            storage,
        })
    }

    /// Parameters at which to evaluate the products.
    #[must_use]
    pub fn trial(&self) -> &[f64] {
        &self.storage.as_ref()[2 * self.n..3 * self.n]
    }

    /// Evaluations so far.
    #[must_use]
    pub fn evaluations(&self) -> usize {
        self.evaluations
    }

    /// Takes the products of [`super::Stack::triangle`] and the cost at the trial, and says what to do next.
    pub fn advance(&mut self, products: &[f64], cost: f64) -> Descended {
        let n = self.n;
        self.evaluations += 1;
        let lower = cost <= self.cost * (1.0 + 1e-12);
        if !lower || !cost.is_finite() || self.evaluations > MOST_EVALUATIONS {
            return Descended::Lost;
        }
        self.cost = cost;
        let (slots, matrix) = self.storage.as_mut().split_at_mut(4 * n);
        let (fixed, moving) = slots.split_at_mut(2 * n);
        let (start, sizes) = fixed.split_at(n);
        let (trial, step) = moving.split_at_mut(n);
        let mut most = 0.0_f64;
        let lines = products
            .chunks_exact(n + 1)
            .zip(matrix.chunks_exact_mut(n.max(1)));
        for (i, (products, line)) in lines.enumerate() {
            for j in i..n {
                line[j] = products[j] * sizes[i] * sizes[j];
            }
            most = most.max(line[i]);
            step[i] = products[n] * sizes[i];
        }
        for i in 0..n {
            matrix[i * n + i] += PRIOR * most;
            step[i] -= PRIOR * most * (trial[i] - start[i]) / sizes[i];
        }
        if !solve(matrix, step) {
            return Descended::Lost;
        }
        let mut farthest = 0.0_f64;
        for ((t, s), size) in trial.iter_mut().zip(&*step).zip(sizes) {
            farthest = farthest.max(s.abs());
            *t += s * size;
        }
        if farthest <= self.near {
            Descended::Near
        } else {
            Descended::Evaluate
        }
    }
}

/// Solves a positive definite system, of whose matrix the upper half is given; false where it is none.
fn solve(matrix: &mut [f64], right: &mut [f64]) -> bool {
    let n = right.len();
    for k in 0..n {
        let (head, tail) = matrix.split_at_mut((k + 1) * n);
        let row = &mut head[k * n..];
        let pivot = sqrt(row[k]);
        // a NaN is not above zero
        if !(pivot > 0.0 && pivot.is_finite()) {
            return false;
        }
        for value in &mut row[k..] {
            *value /= pivot;
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
        let (done, rest) = right.split_at_mut(k + 1);
        let row = &matrix[k * n..][..n];
        done[k] /= row[k];
        for (r, by) in rest.iter_mut().zip(&row[k + 1..]) {
            *r -= by * done[k];
        }
    }
    for k in (0..n).rev() {
        let row = &matrix[k * n..][..n];
        let known: f64 = row[k + 1..]
            .iter()
            .zip(&right[k + 1..])
            .map(|(a, b)| a * b)
            .sum();
        right[k] = (right[k] - known) / row[k];
    }
    true
}
