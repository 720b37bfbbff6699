//! The linear Kalman filter of a fixed size.
//!
//! Source: Eqs. 4 to 7 of the tool paper; Joseph's form, Simon, *Optimal State Estimation*, 2006, Eq. 3.19, and
//! sequential updates, 6.1.
//!
//! Measurements are taken one number at a time. Correlated ones are first turned into uncorrelated ones by the
//! `L D Lᵀ` of their covariance, which may be singular. So nothing is ever inverted but one number, the
//! innovation's variance `h P hᵀ + d`, and an exact measurement (`d = 0`) is one like any other. Where even that
//! variance is rounding, the state already knows what is measured, and the number is passed over. Exact
//! measurements belong at the end of a set: what comes last holds to the last digit.
//!
//! Joseph's form keeps the covariance positive semidefinite whatever the gain's rounding; with one number at a
//! time it is two changes of rank one, so it costs no more than the short form. After each change the
//! covariance is made symmetric, and a variance that rounding took below zero is zero.

use super::ldl::Ldl;

/// An innovation's variance below this share of the terms it was summed from is rounding.
const ROUNDING: f64 = 32.0 * f64::EPSILON;

/// Mean and covariance of a state of `N` numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Filter<const N: usize> {
    /// Mean.
    pub mean: [f64; N],
    /// Covariance, symmetric.
    pub covariance: [[f64; N]; N],
}

/// How far a set of measurements was from what was expected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation {
    /// Normalised innovation squared, `νᵀ S⁻¹ ν`.
    pub squared: f64,
    /// Numbers that it sums over: its mean if the noise is right.
    pub degrees: u32,
}

/// `Σ a b`.
#[inline]
fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    let mut sum = 0.0;
    for k in 0..N {
        sum += a[k] * b[k];
    }
    sum
}

impl<const N: usize> Filter<N> {
    /// A state whose numbers are independent.
    #[must_use]
    pub fn new(mean: [f64; N], variances: [f64; N]) -> Self {
        let mut covariance = [[0.0; N]; N];
        for k in 0..N {
            covariance[k][k] = variances[k];
        }
        Self { mean, covariance }
    }

    /// Variances, the covariance's diagonal.
    #[must_use]
    pub fn variances(&self) -> [f64; N] {
        let mut variances = [0.0; N];
        for k in 0..N {
            variances[k] = self.covariance[k][k];
        }
        variances
    }

    /// Whether all numbers are finite.
    #[inline]
    #[must_use]
    pub fn is_finite(&self) -> bool {
        // zero times a number is zero for finite numbers only, and sums of zeros need no branches
        let mut sum = 0.0;
        for i in 0..N {
            sum += 0.0 * self.mean[i];
            for j in 0..N {
                sum += 0.0 * self.covariance[i][j];
            }
        }
        sum == 0.0
    }

    /// Moves a state that only drifts: `x + u`, `P + Q`. False, and nothing done, where the result is not finite.
    #[inline]
    pub fn drift(&mut self, noise: &[[f64; N]; N], input: &[f64; N]) -> bool {
        let mut next = *self;
        for i in 0..N {
            next.mean[i] += input[i];
            for j in 0..N {
                next.covariance[i][j] += noise[i][j];
            }
        }
        self.accept(next)
    }

    /// Eq. 6: `F x + u`, `F P Fᵀ + Q`. False, and nothing done, where the result is not finite.
    pub fn predict(
        &mut self,
        transition: &[[f64; N]; N],
        noise: &[[f64; N]; N],
        input: &[f64; N],
    ) -> bool {
        let mut next = *self;
        for i in 0..N {
            next.mean[i] = dot(&transition[i], &self.mean) + input[i];
            let mut row = [0.0; N];
            for j in 0..N {
                // row of F P; P is symmetric
                row[j] = dot(&transition[i], &self.covariance[j]);
            }
            for j in 0..N {
                next.covariance[i][j] = dot(&row, &transition[j]) + noise[i][j];
            }
        }
        next.settle();
        self.accept(next)
    }

    /// Eq. 7 for `M` numbers with rows `h`, noise covariance `r` (semidefinite, zeros allowed) and `innovation`,
    /// measurement less prediction. `None`, and nothing done, where a number in or out is not finite or a
    /// variance is negative.
    #[inline]
    pub fn update<const M: usize>(
        &mut self,
        h: &[[f64; N]; M],
        r: &[[f64; M]; M],
        innovation: &[f64; M],
    ) -> Option<Innovation> {
        for k in 0..M {
            let finite = r[k].iter().all(|x| x.is_finite());
            if !(r[k][k] >= 0.0 && finite) {
                return None;
            }
        }
        let factors = Ldl::new(r);
        let mut h = *h;
        let mut innovation = innovation.map(|x| [x]);
        factors.forward(&mut h);
        factors.forward(&mut innovation);
        let mut next = *self;
        let mut moved = [0.0; N];
        let mut all = Innovation {
            squared: 0.0,
            degrees: 0,
        };
        for k in 0..M {
            // the earlier numbers of the set have moved the state already
            let left = innovation[k][0] - dot(&h[k], &moved);
            if !left.is_finite() {
                return None;
            }
            if let Some((gain, variance)) = next.take(&h[k], factors.pivots[k]) {
                all.squared += left * left / variance;
                all.degrees += 1;
                for i in 0..N {
                    moved[i] += gain[i] * left;
                }
            }
        }
        for i in 0..N {
            next.mean[i] += moved[i];
        }
        self.accept(next).then_some(all)
    }

    /// The covariance after one number with row `h` and noise variance `d`; gain and innovation variance. `None`
    /// where the state already knows it exactly.
    #[inline]
    fn take(&mut self, h: &[f64; N], d: f64) -> Option<([f64; N], f64)> {
        let p = &mut self.covariance;
        let mut ph = [0.0; N];
        let mut size = 0.0;
        for i in 0..N {
            for j in 0..N {
                let term = p[i][j] * h[j];
                ph[i] += term;
                size += (h[i] * term).abs();
            }
        }
        let variance = dot(h, &ph) + d;
        if variance.is_nan() || variance <= ROUNDING * size {
            return None;
        }
        let mut gain = [0.0; N];
        for i in 0..N {
            gain[i] = ph[i] / variance;
        }
        // Joseph: (1 - K h) P (1 - K h)ᵀ + d K Kᵀ, the product from the left first
        for i in 0..N {
            for j in 0..N {
                p[i][j] -= gain[i] * ph[j];
            }
            let left = dot(&p[i], h);
            for j in 0..N {
                p[i][j] += (d * gain[i] - left) * gain[j];
            }
        }
        self.settle();
        Some((gain, variance))
    }

    /// Exactly symmetric, no variance below zero.
    #[inline]
    fn settle(&mut self) {
        for i in 0..N {
            for j in 0..i {
                let mean = 0.5 * (self.covariance[i][j] + self.covariance[j][i]);
                self.covariance[i][j] = mean;
                self.covariance[j][i] = mean;
            }
            if self.covariance[i][i] < 0.0 {
                self.covariance[i][i] = 0.0;
            }
        }
    }

    #[inline]
    fn accept(&mut self, next: Self) -> bool {
        let finite = next.is_finite();
        if finite {
            *self = next;
        }
        finite
    }
}
