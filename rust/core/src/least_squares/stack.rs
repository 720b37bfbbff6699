//! The stacked system of all rows, kept as one triangle.
//!
//! Rows `(j, r)` collect in a block of [`BLOCK_ROWS`]; a full block is folded into the upper triangle of
//! `[J | r]` by Householder reflections that touch one row of the triangle at a time (LAPACK's `tpqrt` with a
//! full block; Golub and Van Loan, *Matrix Computations*, 5.1). The result equals the QR factorisation of
//! all rows at once, in memory that does not grow with their number. Several right-hand sides (targets) may
//! share the columns.
//!
//! A NaN in a row makes the triangle NaN: callers push finite rows only, and the solve checks once.

use crate::math::sqrt;
use crate::{Error, Result};

/// Rows folded at a time.
pub const BLOCK_ROWS: usize = 64;

/// Numbers that a [`Stack`] of `columns` parameters and `targets` right-hand sides needs.
#[must_use]
pub const fn stack_len(columns: usize, targets: usize) -> usize {
    let width = columns + targets;
    width * (width + BLOCK_ROWS)
}

/// A triangle that rows fold into. `S` is the caller's storage of [`stack_len`] numbers.
#[derive(Clone, Debug)]
pub struct Stack<S> {
    columns: usize,
    targets: usize,
    pending: usize,
    rows: usize,
    /// Upper triangle of `[R | Qᵀr]`, row by row, then the block, column by column.
    storage: S,
}

impl<S: AsRef<[f64]> + AsMut<[f64]>> Stack<S> {
    /// An empty stack.
    ///
    /// # Errors
    /// [`Error::WrongLength`] where the storage is not [`stack_len`] numbers long.
    pub fn new(columns: usize, targets: usize, storage: S) -> Result<Self> {
        let (expected, found) = (stack_len(columns, targets), storage.as_ref().len());
        if expected != found {
            return Err(Error::WrongLength { expected, found });
        }
        let mut stack = Self {
            columns,
            targets,
            pending: 0,
            rows: 0,
            storage,
        };
        stack.clear();
        Ok(stack)
    }

    /// Forgets all rows.
    pub fn clear(&mut self) {
        self.storage.as_mut().fill(0.0);
        self.pending = 0;
        self.rows = 0;
    }

    /// Number of parameters.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Rows pushed since the last [`Self::clear`].
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    fn width(&self) -> usize {
        self.columns + self.targets
    }

    /// Adds one row: derivatives by the parameters, then the targets, all already weighted. What the
    /// iterator leaves out is zero.
    #[inline]
    pub fn push(&mut self, row: impl IntoIterator<Item = f64>) {
        let n = self.width();
        let at = self.pending;
        let block = &mut self.storage.as_mut()[n * n..];
        for (column, x) in block.chunks_exact_mut(BLOCK_ROWS).zip(row) {
            column[at] = x;
        }
        self.pending += 1;
        self.rows += 1;
        if self.pending == BLOCK_ROWS {
            self.fold();
        }
    }

    /// Folds what is pending and returns the triangle of `[R | Qᵀr]`, `columns + targets` squared, row by row.
    /// Its last `targets` rows hold what no parameter can explain: with one target, the norm of the residual.
    pub fn triangle(&mut self) -> &[f64] {
        if self.pending > 0 {
            self.fold();
        }
        let n = self.width();
        &self.storage.as_ref()[..n * n]
    }

    fn fold(&mut self) {
        let n = self.width();
        let (triangle, block) = self.storage.as_mut().split_at_mut(n * n);
        let used = self.pending.next_multiple_of(LANES);
        for (k, row) in triangle.chunks_exact_mut(n).enumerate() {
            let Some((v, rest)) = block[k * BLOCK_ROWS..].split_at_mut_checked(BLOCK_ROWS) else {
                break;
            };
            let v = &mut v[..used];
            let below = dot(v, v);
            if below == 0.0 {
                continue;
            }
            let alpha = row[k];
            let norm = sqrt(alpha * alpha + below);
            let beta = if alpha >= 0.0 { -norm } else { norm };
            let scale = 1.0 / (alpha - beta);
            let tau = (beta - alpha) / beta;
            for x in v.iter_mut() {
                *x *= scale;
            }
            row[k] = beta;
            for (r, column) in row[k + 1..]
                .iter_mut()
                .zip(rest.chunks_exact_mut(BLOCK_ROWS))
            {
                let column = &mut column[..used];
                let w = tau * (*r + dot(v, column));
                *r -= w;
                for (c, x) in column.iter_mut().zip(v.iter()) {
                    *c -= w * x;
                }
            }
        }
        block.fill(0.0);
        self.pending = 0;
    }
}

const LANES: usize = 8;

/// Dot product in lanes of a fixed order, so that it vectorises and always rounds alike.
#[inline(always)]
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; LANES];
    let (a, b) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let tail: f64 = a
        .remainder()
        .iter()
        .zip(b.remainder())
        .map(|(x, y)| x * y)
        .sum();
    for (x, y) in a.zip(b) {
        for lane in 0..LANES {
            lanes[lane] += x[lane] * y[lane];
        }
    }
    lanes.iter().sum::<f64>() + tail
}
