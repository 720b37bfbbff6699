//! The stacked system of all rows, kept as one triangle.
//!
//! Rows `(j, r)` collect in a block of [`BLOCK_ROWS`]; a full block is folded into the upper triangle of
//! `[J | r]` by Householder reflections that touch one row of the triangle at a time (LAPACK's `tpqrt` with a
//! full block; Golub and Van Loan, *Matrix Computations*, 5.1). The result equals the QR factorisation of
//! all rows at once, in memory that does not grow with their number. Several right-hand sides (targets) may
//! share the columns.
//!
//! Where only the way to the minimum is asked for, rows fold into their products instead ([`Fold::Products`]): a tenth of the
//! work, with half the digits.
//!
//! A NaN in a row makes the triangle NaN: callers push finite rows only, and the solve checks once.

use crate::numbers::math::sqrt;
use crate::numbers::wide::{Kernel, LANES, Wide, widest};
use crate::{Error, Result};

/// Rows folded at a time.
pub const BLOCK_ROWS: usize = 128;

/// Numbers that a [`Stack`] of `columns` parameters and `targets` right-hand sides needs.
#[must_use]
pub const fn stack_len(columns: usize, targets: usize) -> usize {
    let width = columns + targets;
    width * (width + BLOCK_ROWS)
}

/// What rows fold into.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fold {
    /// The triangle `R` of `[J | r] = Q R`.
    Triangle,
    /// The upper half of `[J | r]ᵀ [J | r]`.
    Products,
}

/// A triangle that rows fold into. `S` is the caller's storage of [`stack_len`] numbers.
#[derive(Clone, Debug)]
pub struct Stack<S> {
    columns: usize,
    targets: usize,
    pending: usize,
    rows: usize,
    into: Fold,
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
            into: Fold::Triangle,
            storage,
        };
        stack.clear();
        Ok(stack)
    }

    /// Forgets all rows; the next ones fold into the triangle.
    pub fn clear(&mut self) {
        self.clear_for(Fold::Triangle);
    }

    /// Forgets all rows, and says what the next ones fold into.
    pub fn clear_for(&mut self, into: Fold) {
        self.into = into;
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
        for (place, x) in self.next_row().zip(row) {
            *place = x;
        }
        self.commit_row();
    }

    /// The places of the next row, zero until they are written; [`Self::commit_row`] adds it.
    #[inline]
    pub fn next_row(&mut self) -> impl Iterator<Item = &mut f64> {
        let n = self.width();
        let at = self.pending;
        self.storage.as_mut()[n * n..]
            .iter_mut()
            .skip(at)
            .step_by(BLOCK_ROWS)
    }

    /// Adds the row that was written into [`Self::next_row`].
    #[inline]
    pub fn commit_row(&mut self) {
        self.pending += 1;
        self.rows += 1;
        if self.pending == BLOCK_ROWS {
            self.fold();
        }
    }

    /// The places of as many rows as there are lanes, column by column; `counting` of them are not all zero.
    /// [`Self::commit_wide`] adds them.
    #[inline(always)]
    pub fn next_wide(&mut self, counting: usize) -> impl Iterator<Item = &mut [f64; LANES]> {
        // rows that were pushed one by one may end between lanes: the rest of these stay zero
        self.pending = self.pending.next_multiple_of(LANES);
        if self.pending == BLOCK_ROWS {
            self.fold();
        }
        self.rows += counting;
        let (n, at) = (self.width(), self.pending / LANES);
        let lanes = self.storage.as_mut()[n * n..].as_chunks_mut().0;
        lanes.iter_mut().skip(at).step_by(BLOCK_ROWS / LANES)
    }

    /// Adds the rows that were written into [`Self::next_wide`].
    #[inline(always)]
    pub fn commit_wide(&mut self) {
        self.pending += LANES;
        if self.pending == BLOCK_ROWS {
            self.fold();
        }
    }

    /// Adds all rows of another stack of the same shape, given its triangle and how many they were.
    pub fn absorb(&mut self, triangle: &[f64], rows: usize) {
        let n = self.width();
        let before = self.rows;
        for row in triangle.chunks_exact(n) {
            self.push(row.iter().copied());
        }
        self.rows = before + rows;
    }

    /// Folds what is pending and returns the triangle of `[R | Qᵀr]`, `columns + targets` squared, row by row.
    /// Its last `targets` rows hold what no parameter can explain: with one target, the norm of the residual. Of a stack
    /// that was cleared for them, the products instead.
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
        match self.into {
            Fold::Triangle => fold_widest(triangle, block, n, used),
            Fold::Products => widest(Products {
                sums: triangle,
                block,
                n,
                used,
            }),
        }
        block.fill(0.0);
        self.pending = 0;
    }
}

/// [`fold_block`] with the widest vectors of this processor. Each sum runs in the same lanes whatever their
/// width, and nothing is fused, so every choice gives the same bits.
fn fold_widest(triangle: &mut [f64], block: &mut [f64], n: usize, used: usize) {
    #[cfg(all(feature = "std", target_arch = "x86_64"))]
    {
        extern crate std;
        #[target_feature(enable = "avx512f")]
        fn fold_avx512(triangle: &mut [f64], block: &mut [f64], n: usize, used: usize) {
            fold_block(triangle, block, n, used);
        }
        #[target_feature(enable = "avx2")]
        fn fold_avx2(triangle: &mut [f64], block: &mut [f64], n: usize, used: usize) {
            fold_block(triangle, block, n, used);
        }
        if std::arch::is_x86_feature_detected!("avx512f") {
            // SAFETY: the processor was just asked for the feature.
            return unsafe { fold_avx512(triangle, block, n, used) };
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor was just asked for the feature.
            return unsafe { fold_avx2(triangle, block, n, used) };
        }
    }
    fold_block(triangle, block, n, used);
}

/// Adds the products of the columns of a block, of which `used` rows hold data.
struct Products<'a> {
    sums: &'a mut [f64],
    block: &'a [f64],
    n: usize,
    used: usize,
}

/// Columns whose products with another are taken at once.
const TILE: usize = 4;

impl Kernel for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Wide>(self) {
        let column = |k: usize| {
            let numbers = &self.block[k * BLOCK_ROWS..][..self.used];
            numbers.as_chunks::<LANES>().0
        };
        for (i, sums) in self.sums.chunks_exact_mut(self.n).enumerate() {
            for (tile, sums) in sums[i..].chunks_mut(TILE).enumerate() {
                // beyond the last column that one again
                let others: [_; TILE] =
                    [0, 1, 2, 3].map(|k| column((i + tile * TILE + k).min(self.n - 1)));
                let mut products = [V::splat(0.0); TILE];
                for (chunk, own) in column(i).iter().enumerate() {
                    let own = V::of(*own);
                    for (product, other) in products.iter_mut().zip(others) {
                        *product = *product + own * V::of(other[chunk]);
                    }
                }
                for (sum, product) in sums.iter_mut().zip(products) {
                    *sum += product.sum();
                }
            }
        }
    }
}

/// Reflects the block into the triangle, two columns at a time. `used` rows of each block column hold data,
/// the rest of its lanes is zero.
///
/// Two reflectors are applied to a column in one pass over it: with `g = v_2·v_1`, the second one's weight is
/// `τ_2 (r_2 + v_2·c - w_1 g)` (the compact WY form for two; Golub and Van Loan, 5.1.7).
#[inline(always)]
fn fold_block(triangle: &mut [f64], block: &mut [f64], n: usize, used: usize) {
    let mut k = 0;
    while k + 1 < n {
        let (done, rest) = block.split_at_mut((k + 2) * BLOCK_ROWS);
        let (_, two) = done.split_at_mut(k * BLOCK_ROWS);
        let (v1, v2) = two.split_at_mut(BLOCK_ROWS);
        let (v1, v2) = (&mut v1[..used], &mut v2[..used]);
        let (above, below) = triangle.split_at_mut((k + 1) * n);
        let (r1, r2) = (&mut above[k * n..], &mut below[..n]);

        let tau1 = reflector(&mut r1[k], v1);
        let w = tau1 * (r1[k + 1] + dot(v1, v2));
        r1[k + 1] -= w;
        for (b, a) in v2.iter_mut().zip(v1.iter()) {
            *b -= w * a;
        }
        let tau2 = reflector(&mut r2[k + 1], v2);
        let g = dot(v1, v2);

        let heads = r1[k + 2..].iter_mut().zip(&mut r2[k + 2..]);
        for ((r1, r2), column) in heads.zip(rest.chunks_exact_mut(BLOCK_ROWS)) {
            let column = &mut column[..used];
            let (d1, d2) = dot_two(column, v1, v2);
            let w1 = tau1 * (*r1 + d1);
            let w2 = tau2 * (*r2 + d2 - w1 * g);
            *r1 -= w1;
            *r2 -= w2;
            for ((c, a), b) in column.iter_mut().zip(v1.iter()).zip(v2.iter()) {
                *c -= w1 * a + w2 * b;
            }
        }
        k += 2;
    }
    if k < n {
        reflector(
            &mut triangle[k * n + k],
            &mut block[k * BLOCK_ROWS..][..used],
        );
    }
}

/// Turns a column below `alpha` into a reflector (first component one, the rest in `v`); returns its τ.
#[inline(always)]
fn reflector(alpha: &mut f64, v: &mut [f64]) -> f64 {
    let below = dot(v, v);
    if below == 0.0 {
        return 0.0;
    }
    let norm = sqrt(*alpha * *alpha + below);
    let beta = if *alpha >= 0.0 { -norm } else { norm };
    let scale = 1.0 / (*alpha - beta);
    let tau = (beta - *alpha) / beta;
    for x in v.iter_mut() {
        *x *= scale;
    }
    *alpha = beta;
    tau
}

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

/// `(v·a, v·b)` for lengths that are multiples of the lanes.
#[inline(always)]
fn dot_two(v: &[f64], a: &[f64], b: &[f64]) -> (f64, f64) {
    let (mut sa, mut sb) = ([0.0; LANES], [0.0; LANES]);
    let lanes = v.as_chunks::<LANES>().0.iter();
    let columns = a
        .as_chunks::<LANES>()
        .0
        .iter()
        .zip(b.as_chunks::<LANES>().0);
    for (v, (a, b)) in lanes.zip(columns) {
        for lane in 0..LANES {
            sa[lane] += v[lane] * a[lane];
            sb[lane] += v[lane] * b[lane];
        }
    }
    (sa.iter().sum(), sb.iter().sum())
}
