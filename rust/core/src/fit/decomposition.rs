//! What a triangle says about its parameters: rank, directions, step, covariance.
//!
//! Columns are first scaled to unit length, so that rank does not depend on units. One-sided Jacobi
//! (Hestenes; Golub and Van Loan 8.6.3) on the transposed triangle then gives singular values to full relative
//! accuracy, with the right singular vectors as the rotated columns and the rotated right-hand side for free.
//!
//! Directions that no row observes are left at the smallest change in units of each parameter's plausible
//! size. That is the limit of a prior `N(0, size²)` whose weight goes to zero, so the covariance of that
//! limit is what the observed directions have from the data and the unobserved ones from the sizes.

use super::stack::dot;
use crate::numbers::math::sqrt;
use crate::{Error, Result};

/// Numbers that a [`Decomposition`] of `n` parameters needs.
#[must_use]
pub const fn decomposition_len(n: usize) -> usize {
    n * (n + 1) + n * n + 3 * n
}

/// Sweeps after which Jacobi is taken to have failed; ten are usual.
const SWEEPS: usize = 60;
/// Columns are orthogonal when their cosine is below this.
const ORTHOGONAL: f64 = 1e-15;
/// A vector of less than this squared length is zero: the scaled columns are of unit length. Rotated further,
/// what is only rounding would shrink until its products underflow, and never be orthogonal.
const NOTHING: f64 = 1e-60;

/// A parameter whose plausible size moves the readings by less than this part of what the strongest one does, or of
/// what is to be explained, is not observed: what its column holds is rounding.
const ROUNDING: f64 = 1e-13;
/// Nor is one by less than this part of what nothing observed explains: ten thousand such sizes would be no machine, as
/// a squareness about an axis that nobody reads, which a sensor that stands a hair askew seems to tell.
const ABSURD: f64 = 1e-4;

/// Singular value decomposition of a column-scaled triangle. `S` is storage of [`decomposition_len`].
#[derive(Clone, Debug)]
pub struct Decomposition<S> {
    n: usize,
    rank: usize,
    storage: S,
}

/// The pieces of the storage.
struct Parts<'a> {
    /// `n` rows of `n + 1`: a right singular vector, then its component of the right-hand side.
    vectors: &'a mut [f64],
    /// `n` rows of `n`, of which the first `n - rank` are the unobserved directions in plausible sizes.
    unobserved: &'a mut [f64],
    singular: &'a mut [f64],
    norms: &'a mut [f64],
    sizes: &'a mut [f64],
}

fn parts(storage: &mut [f64], n: usize) -> Parts<'_> {
    let (vectors, rest) = storage.split_at_mut(n * (n + 1));
    let (unobserved, rest) = rest.split_at_mut(n * n);
    let (singular, rest) = rest.split_at_mut(n);
    let (norms, sizes) = rest.split_at_mut(n);
    Parts {
        vectors,
        unobserved,
        singular,
        norms,
        sizes,
    }
}

impl<S: AsRef<[f64]> + AsMut<[f64]>> Decomposition<S> {
    /// Room for `n` parameters.
    ///
    /// # Errors
    /// [`Error::WrongLength`] where the storage is not [`decomposition_len`] numbers long.
    pub fn new(n: usize, storage: S) -> Result<Self> {
        let (expected, found) = (decomposition_len(n), storage.as_ref().len());
        if expected != found {
            return Err(Error::WrongLength { expected, found });
        }
        Ok(Self {
            n,
            rank: 0,
            storage,
        })
    }

    /// A decomposition whose storage was filled by an earlier [`Self::decompose`] of that rank.
    ///
    /// # Errors
    /// [`Error::WrongLength`] where the storage is not [`decomposition_len`] numbers long.
    pub(super) fn restore(n: usize, rank: usize, storage: S) -> Result<Self> {
        let mut d = Self::new(n, storage)?;
        d.rank = rank.min(n);
        Ok(d)
    }

    /// Decomposes the triangle of [`super::Stack::triangle`]. Singular values below `tolerance` times the
    /// largest count as zero. `sizes` are the plausible sizes of the parameters.
    ///
    /// # Errors
    /// [`Error::WrongLength`]; [`Error::NotFinite`] names the column that holds no number.
    pub fn decompose(&mut self, triangle: &[f64], sizes: &[f64], tolerance: f64) -> Result<()> {
        let n = self.n;
        for (expected, found) in [((n + 1) * (n + 1), triangle.len()), (n, sizes.len())] {
            if expected != found {
                return Err(Error::WrongLength { expected, found });
            }
        }
        let p = parts(self.storage.as_mut(), n);
        p.sizes.copy_from_slice(sizes);
        for (k, norm) in p.norms.iter_mut().enumerate() {
            let squared: f64 = triangle[k..]
                .iter()
                .step_by(n + 1)
                .take(k + 1)
                .map(|x| x * x)
                .sum();
            if !squared.is_finite() {
                return Err(Error::NotFinite { index: k });
            }
            *norm = sqrt(squared);
        }
        let left: f64 = triangle[n..].iter().step_by(n + 1).map(|x| x * x).sum();
        let strongest = p
            .norms
            .iter()
            .zip(sizes)
            .fold(sqrt(left), |most, (&norm, &size)| most.max(norm * size));
        for (norm, &size) in p.norms.iter_mut().zip(sizes) {
            if *norm * size <= ROUNDING * strongest {
                *norm = 0.0;
            }
        }
        self.turn(triangle, tolerance)?;
        let told: f64 = self.observed().map(|(_, c, _)| c * c).sum();
        let least = ABSURD * sqrt((left - told).max(0.0));
        let p = parts(self.storage.as_mut(), n);
        let mut absurd = false;
        for (norm, &size) in p.norms.iter_mut().zip(sizes) {
            if *norm > 0.0 && *norm * size <= least {
                *norm = 0.0;
                absurd = true;
            }
        }
        if absurd {
            self.turn(triangle, tolerance)?;
        }
        let p = parts(self.storage.as_mut(), n);
        complete(p.vectors, p.unobserved, p.norms, p.sizes, n, self.rank);
        Ok(())
    }

    /// Singular values and vectors of the columns that have a norm, and the rank.
    fn turn(&mut self, triangle: &[f64], tolerance: f64) -> Result<()> {
        let n = self.n;
        let p = parts(self.storage.as_mut(), n);
        // row i of the triangle, scaled, is column i of its transpose: one vector to rotate
        for (i, (vector, row)) in p
            .vectors
            .chunks_exact_mut(n + 1)
            .zip(triangle.chunks_exact(n + 1))
            .enumerate()
        {
            vector[..i].fill(0.0);
            for k in i..n {
                vector[k] = if p.norms[k] > 0.0 {
                    row[k] / p.norms[k]
                } else {
                    0.0
                };
            }
            vector[n] = row[n];
        }
        rotate(p.vectors, n)?;
        order_by_length(p.vectors, p.singular, n);
        let largest = p.singular.first().copied().unwrap_or(0.0);
        self.rank = p
            .singular
            .iter()
            .take_while(|&&s| s > tolerance * largest && s > 0.0)
            .count();
        Ok(())
    }

    /// Number of observed directions.
    #[must_use]
    pub fn rank(&self) -> usize {
        self.rank
    }

    /// Singular values of the column-scaled system, largest first.
    #[must_use]
    pub fn singular_values(&self) -> &[f64] {
        let n = self.n;
        &self.storage.as_ref()[n * (n + 1) + n * n..][..n]
    }

    /// Unobserved directions as changes in units of plausible size, `n` numbers each, orthonormal.
    pub fn unobserved(&self) -> impl Iterator<Item = &[f64]> {
        let n = self.n;
        self.storage.as_ref()[n * (n + 1)..][..n * n]
            .chunks_exact(n.max(1))
            .take(n - self.rank)
    }

    fn norms(&self) -> &[f64] {
        let n = self.n;
        &self.storage.as_ref()[n * (n + 1) + n * n + n..][..n]
    }

    fn sizes(&self) -> &[f64] {
        let n = self.n;
        &self.storage.as_ref()[n * (n + 1) + n * n + 2 * n..][..n]
    }

    fn observed(&self) -> impl Iterator<Item = (&[f64], f64, f64)> {
        let n = self.n;
        self.storage
            .as_ref()
            .chunks_exact(n + 1)
            .zip(self.singular_values())
            .take(self.rank)
            .map(move |(v, &s)| (&v[..n], v[n], s))
    }

    /// Writes the damped least-squares step. Damping is relative to the column-scaled singular values.
    pub fn step(&self, damping: f64, step: &mut [f64]) {
        step.fill(0.0);
        for (v, c, s) in self.observed() {
            let gain = c * s / (s * s + damping);
            for (out, x) in step.iter_mut().zip(v) {
                *out += gain * x;
            }
        }
        for (out, norm) in step.iter_mut().zip(self.norms()) {
            if *norm > 0.0 {
                *out /= norm;
            }
        }
    }

    /// By how much a step of this damping would lower the sum of squares, were the rows linear.
    #[must_use]
    pub fn gain(&self, damping: f64) -> f64 {
        self.observed()
            .map(|(_, c, s)| {
                let left = damping / (s * s + damping);
                c * c * (1.0 - left * left)
            })
            .sum()
    }

    /// The damping that halves the step along the weakest direction observed.
    #[must_use]
    pub fn weakest(&self) -> f64 {
        let weakest = self.observed().map(|(_, _, s)| s * s).reduce(f64::min);
        weakest.unwrap_or(0.0).max(f64::MIN_POSITIVE)
    }

    /// Takes the unobserved directions out of a change of the parameters.
    pub fn remove_unobserved(&self, change: &mut [f64]) {
        let sizes = self.sizes();
        for direction in self.unobserved() {
            let along: f64 = direction
                .iter()
                .zip(change.iter().zip(sizes))
                .map(|(d, (c, s))| d * c / s)
                .sum();
            for (c, (d, s)) in change.iter_mut().zip(direction.iter().zip(sizes)) {
                *c -= along * d * s;
            }
        }
    }

    /// Writes the covariance for rows of unit noise: `data` (n × n) from the rows, `unobserved` (n × n) from the
    /// plausible sizes along directions that no row observes. `scratch` holds n numbers.
    pub fn covariance(&self, data: &mut [f64], unobserved: &mut [f64], scratch: &mut [f64]) {
        let n = self.n;
        data.fill(0.0);
        unobserved.fill(0.0);
        for (v, _, s) in self.observed() {
            for (out, (x, norm)) in scratch.iter_mut().zip(v.iter().zip(self.norms())) {
                *out = if *norm > 0.0 { x / norm / s } else { 0.0 };
            }
            self.remove_unobserved(scratch);
            add_outer(data, scratch, n);
        }
        for direction in self.unobserved() {
            for (out, (d, size)) in scratch.iter_mut().zip(direction.iter().zip(self.sizes())) {
                *out = d * size;
            }
            add_outer(unobserved, scratch, n);
        }
    }
}

fn add_outer(matrix: &mut [f64], v: &[f64], n: usize) {
    for (row, a) in matrix.chunks_exact_mut(n).zip(v) {
        for (m, b) in row.iter_mut().zip(v) {
            *m += a * b;
        }
    }
}

/// Rotates pairs of vectors until all are orthogonal; the last component of each rides along.
fn rotate(vectors: &mut [f64], n: usize) -> Result<()> {
    let width = n + 1;
    for _ in 0..SWEEPS {
        let mut settled = true;
        for i in 0..n {
            let (head, tail) = vectors.split_at_mut((i + 1) * width);
            let a = &mut head[i * width..];
            for b in tail.chunks_exact_mut(width) {
                let (aa, bb) = (dot(&a[..n], &a[..n]), dot(&b[..n], &b[..n]));
                let ab = dot(&a[..n], &b[..n]);
                if ab * ab <= ORTHOGONAL * ORTHOGONAL * aa * bb || aa.min(bb) <= NOTHING {
                    continue;
                }
                settled = false;
                let zeta = (bb - aa) / (2.0 * ab);
                let t = zeta.signum() / (zeta.abs() + sqrt(1.0 + zeta * zeta));
                let cos = 1.0 / sqrt(1.0 + t * t);
                let sin = cos * t;
                for (x, y) in a.iter_mut().zip(b.iter_mut()) {
                    (*x, *y) = (cos * *x - sin * *y, sin * *x + cos * *y);
                }
            }
        }
        if settled {
            return Ok(());
        }
    }
    Err(Error::NotConverged { iterations: SWEEPS })
}

/// Normalises the vectors, longest first.
fn order_by_length(vectors: &mut [f64], singular: &mut [f64], n: usize) {
    let width = n + 1;
    for (s, v) in singular.iter_mut().zip(vectors.chunks_exact_mut(width)) {
        *s = sqrt(dot(&v[..n], &v[..n]));
        if *s > 0.0 {
            for x in &mut v[..n] {
                *x /= *s;
            }
        }
    }
    for i in 0..n {
        let best = (i..n).fold(i, |b, k| if singular[k] > singular[b] { k } else { b });
        if best != i {
            singular.swap(i, best);
            let (head, tail) = vectors.split_at_mut(best * width);
            head[i * width..][..width].swap_with_slice(&mut tail[..width]);
        }
    }
}

/// Completes the observed vectors to a basis and expresses the rest in units of plausible size, orthonormal.
fn complete(
    vectors: &mut [f64],
    unobserved: &mut [f64],
    norms: &[f64],
    sizes: &[f64],
    n: usize,
    rank: usize,
) {
    let width = n + 1;
    for m in rank..n {
        // the unit vector that the vectors so far explain least, made orthogonal to them twice
        let (known, rest) = vectors.split_at_mut(m * width);
        let v = &mut rest[..n];
        let explained = |k: usize| -> f64 { known.chunks_exact(width).map(|u| u[k] * u[k]).sum() };
        let start = (0..n).fold(0, |b, k| if explained(k) < explained(b) { k } else { b });
        v.fill(0.0);
        v[start] = 1.0;
        for _ in 0..2 {
            orthonormalise(v, known.chunks_exact(width).map(|u| &u[..n]));
        }
    }
    for m in 0..n - rank {
        let (known, rest) = unobserved.split_at_mut(m * n);
        let out = &mut rest[..n];
        let v = &vectors[(rank + m) * width..][..n];
        for k in 0..n {
            let norm = if norms[k] > 0.0 { norms[k] } else { 1.0 };
            out[k] = v[k] / (norm * sizes[k]);
        }
        for _ in 0..2 {
            orthonormalise(out, known.chunks_exact(n));
        }
    }
}

fn orthonormalise<'a>(v: &mut [f64], known: impl Iterator<Item = &'a [f64]>) {
    let length = sqrt(dot(v, v));
    for x in v.iter_mut() {
        *x /= length;
    }
    for u in known {
        let along = dot(v, u);
        for (x, y) in v.iter_mut().zip(u) {
            *x -= along * y;
        }
    }
    let length = sqrt(dot(v, v));
    for x in v.iter_mut() {
        *x /= length;
    }
}
