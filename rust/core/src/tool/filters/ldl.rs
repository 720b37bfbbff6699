//! `L D Lᵀ` of a small positive semidefinite matrix, pivots of zero allowed.
//!
//! Source: Golub and Van Loan, *Matrix Computations*, 4.1.2 and 4.2.8. A covariance with an exact row has a zero
//! pivot; its column of `L` is then zero.
//!
//! There is no pivoting: rows stay in the caller's order, and a definite matrix does not need it. One that is singular
//! but for rounding can have a last pivot below zero, which is cut off: where a leading block is nearly singular too,
//! by a share `s` of its diagonal element, the factors are then those of a matrix that is off by about ε/s. The
//! covariances of the filters have no such block: exact rows are zeros and stand last, the others have noise.

/// Pivots below this share of their diagonal element are the rounding of what was subtracted.
const ROUNDING: f64 = 32.0 * f64::EPSILON;

/// A factorisation.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Ldl<const N: usize> {
    /// Unit lower triangle, rows; what is on and above the diagonal is not read.
    pub lower: [[f64; N]; N],
    /// Pivots, zero or more.
    pub pivots: [f64; N],
}

impl<const N: usize> Ldl<N> {
    /// Factors a matrix, of which the lower triangle is read. NaN gives pivots of zero.
    #[inline]
    pub fn new(a: &[[f64; N]; N]) -> Self {
        let mut lower = [[0.0; N]; N];
        let mut pivots = [0.0; N];
        for j in 0..N {
            let mut pivot = a[j][j];
            for k in 0..j {
                pivot -= lower[j][k] * lower[j][k] * pivots[k];
            }
            // the comparisons are false for NaN; above the second no quotient overflows
            if pivot > ROUNDING * a[j][j] && pivot > f64::MIN_POSITIVE {
                pivots[j] = pivot;
                for i in j + 1..N {
                    let mut sum = a[i][j];
                    for k in 0..j {
                        sum -= lower[i][k] * lower[j][k] * pivots[k];
                    }
                    lower[i][j] = sum / pivot;
                }
            }
        }
        Self { lower, pivots }
    }

    /// `L⁻¹` applied to rows in place.
    #[inline]
    pub fn forward<const M: usize>(&self, rows: &mut [[f64; M]; N]) {
        for i in 1..N {
            for j in 0..i {
                for k in 0..M {
                    rows[i][k] -= self.lower[i][j] * rows[j][k];
                }
            }
        }
    }
}
