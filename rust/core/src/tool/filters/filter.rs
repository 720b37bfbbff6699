//! The linear Kalman filter of a fixed size, on the factors of its covariance.
//!
//! Source: Eqs. 4 to 7 of the tool paper; Bierman, *Factorization Methods for Discrete Sequential Estimation*, 1977,
//! V.3 (update) and Thornton's weighted Gram–Schmidt, VI.4 (prediction).
//!
//! The covariance is kept as `L D Lᵀ` with a unit triangle and pivots that are zero or more by the form of their
//! arithmetic, a quotient of sums of squares: it stays positive semidefinite after any number of steps, whatever
//! the rounding. Joseph's form was tried first and is not enough here: with exact measurements the covariance
//! is singular, and once its other directions shrink, the rounding that is left along the singular one is a
//! negative eigenvalue of their size.
//!
//! Measurements are taken one number at a time. Correlated ones are first turned into uncorrelated ones by the
//! `L D Lᵀ` of their covariance, which may be singular. So nothing is ever inverted but one number, the
//! innovation's variance `h P hᵀ + d`, and an exact measurement (`d = 0`) is one like any other. Where that variance
//! is zero, the state already knows what is measured, and the number is passed over. Exact measurements belong at
//! the end of a set: what comes last holds to the last digit.

use super::ldl::Ldl;

/// A component of a measurement along a factor, below this share of the terms it was summed from, is rounding. It
/// stands well above the rounding of one sum, because the factors carry that of the steps before.
const ROUNDING: f64 = 1e-12;

/// A state of `N` numbers: mean and factored covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Filter<const N: usize> {
    /// Mean.
    pub mean: [f64; N],
    pub(super) factors: Ldl<N>,
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
        let factors = Ldl {
            lower: [[0.0; N]; N],
            pivots: variances,
        };
        Self { mean, factors }
    }

    /// A state with this covariance (positive semidefinite; its lower triangle is read).
    #[must_use]
    pub fn with_covariance(mean: [f64; N], covariance: &[[f64; N]; N]) -> Self {
        Self {
            mean,
            factors: Ldl::new(covariance),
        }
    }

    /// The covariance: exactly symmetric, no variance below zero.
    #[must_use]
    pub fn covariance(&self) -> [[f64; N]; N] {
        let mut p = [[0.0; N]; N];
        for i in 0..N {
            for j in 0..=i {
                let mut sum = 0.0;
                for k in 0..=j {
                    let [a, b] = [i, j].map(|i| {
                        if i == k {
                            1.0
                        } else {
                            self.factors.lower[i][k]
                        }
                    });
                    sum += a * b * self.factors.pivots[k];
                }
                p[i][j] = sum;
                p[j][i] = sum;
            }
        }
        p
    }

    /// Variances, the covariance's diagonal.
    #[must_use]
    pub fn variances(&self) -> [f64; N] {
        let mut variances = self.factors.pivots;
        for i in 0..N {
            for k in 0..i {
                let l = self.factors.lower[i][k];
                variances[i] += l * l * self.factors.pivots[k];
            }
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
            sum += 0.0 * self.mean[i] + 0.0 * self.factors.pivots[i];
            for j in 0..i {
                sum += 0.0 * self.factors.lower[i][j];
            }
        }
        sum == 0.0
    }

    /// Moves a state that only drifts: `x + u`, `P + Q`. False, and nothing done, where the result is not finite or
    /// a variance of the noise is negative.
    #[inline]
    pub fn drift(&mut self, noise: &[[f64; N]; N], input: &[f64; N]) -> bool {
        let mut moved = [[0.0; N]; N];
        for i in 0..N {
            for j in 0..i {
                moved[i][j] = self.factors.lower[i][j];
            }
            moved[i][i] = 1.0;
        }
        self.spread::<true>(moved, self.mean, noise, input)
    }

    /// Eq. 6: `F x + u`, `F P Fᵀ + Q`. False, and nothing done, where the result is not finite or a variance of the
    /// noise is negative.
    pub fn predict(
        &mut self,
        transition: &[[f64; N]; N],
        noise: &[[f64; N]; N],
        input: &[f64; N],
    ) -> bool {
        let mut moved = *transition;
        let mut mean = [0.0; N];
        for i in 0..N {
            mean[i] = dot(&transition[i], &self.mean);
            for j in 0..N {
                for k in j + 1..N {
                    moved[i][j] += transition[i][k] * self.factors.lower[k][j];
                }
            }
        }
        self.spread::<false>(moved, mean, noise, input)
    }

    /// Factors of `W D Wᵀ + Q`, by Gram–Schmidt on the rows of `[W | L_Q]` weighted with `[D | D_Q]`. Row `j` of `L_Q`,
    /// and of `W` where it is `LOWER` triangular, ends at its diagonal and stays so: rows above are taken off alone.
    #[inline]
    fn spread<const LOWER: bool>(
        &mut self,
        mut w: [[f64; N]; N],
        mean: [f64; N],
        noise: &[[f64; N]; N],
        input: &[f64; N],
    ) -> bool {
        for i in 0..N {
            if noise[i].iter().any(|x| !x.is_finite()) || noise[i][i] < 0.0 {
                return false;
            }
        }
        let q = Ldl::new(noise);
        let mut v = q.lower;
        let mut next = *self;
        for i in 0..N {
            v[i][i] = 1.0;
            next.mean[i] = mean[i] + input[i];
        }
        for j in 0..N {
            let (one, other) = (w[j], v[j]);
            let (end, other_end) = (if LOWER { j + 1 } else { N }, j + 1);
            let mut weighted = [[0.0; N]; 2];
            let (mut pivot, mut of_noise) = (0.0, 0.0);
            for k in 0..end {
                weighted[0][k] = one[k] * self.factors.pivots[k];
                pivot += one[k] * weighted[0][k];
            }
            for k in 0..other_end {
                weighted[1][k] = other[k] * q.pivots[k];
                of_noise += other[k] * weighted[1][k];
            }
            pivot += of_noise;
            // no quotient overflows above it
            let held = pivot > f64::MIN_POSITIVE;
            next.factors.pivots[j] = if held { pivot } else { 0.0 };
            for i in j + 1..N {
                let (mut sum, mut of_noise) = (0.0, 0.0);
                for k in 0..end {
                    sum += w[i][k] * weighted[0][k];
                }
                for k in 0..other_end {
                    of_noise += v[i][k] * weighted[1][k];
                }
                let share = if held { (sum + of_noise) / pivot } else { 0.0 };
                next.factors.lower[i][j] = share;
                for k in 0..end {
                    w[i][k] -= share * one[k];
                }
                for k in 0..other_end {
                    v[i][k] -= share * other[k];
                }
            }
        }
        // a pivot that is no number was not held, and must not pass for zero
        let possible = w.as_flattened().iter().all(|x| x.is_finite());
        possible && self.accept(next)
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
            let finite = r[k].iter().all(|x| x.is_finite()) && h[k].iter().all(|x| x.is_finite());
            if !(r[k][k] >= 0.0 && finite) {
                return None;
            }
        }
        let noise = Ldl::new(r);
        let mut h = *h;
        let mut innovation = innovation.map(|x| [x]);
        noise.forward(&mut h);
        noise.forward(&mut innovation);
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
            if let Some((gain, variance)) = next.factors.take(&h[k], noise.pivots[k]) {
                let share = left / variance;
                all.squared += left * share;
                all.degrees += 1;
                for i in 0..N {
                    moved[i] += gain[i] * share;
                }
            }
        }
        for i in 0..N {
            next.mean[i] += moved[i];
        }
        (all.squared.is_finite() && self.accept(next)).then_some(all)
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

impl<const N: usize> Ldl<N> {
    /// Bierman's update of the factors with one number of row `h` and noise variance `d`: `P hᵀ` and the innovation
    /// variance. `None` where the state already knows it exactly.
    #[inline]
    fn take(&mut self, h: &[f64; N], d: f64) -> Option<([f64; N], f64)> {
        let mut variance = d;
        let mut along = [0.0; N];
        for j in (0..N).rev() {
            let (mut sum, mut size) = (h[j], h[j].abs());
            for i in j + 1..N {
                let term = self.lower[i][j] * h[i];
                sum += term;
                size += term.abs();
            }
            // what is known exactly stays so: its component here is rounding, and would become a gain
            along[j] = if sum.abs() > ROUNDING * size {
                sum
            } else {
                0.0
            };
            variance += along[j] * along[j] * self.pivots[j];
        }
        if variance.is_nan() || variance <= f64::MIN_POSITIVE {
            return None;
        }
        let mut gain = [0.0; N];
        let mut before = d;
        for j in (0..N).rev() {
            let spread = along[j] * self.pivots[j];
            let after = before + along[j] * spread;
            // while nothing has a variance there is nothing to share
            let share = if before > 0.0 { along[j] / before } else { 0.0 };
            if after > 0.0 {
                self.pivots[j] *= before / after;
            }
            for i in j + 1..N {
                let l = self.lower[i][j];
                self.lower[i][j] = l - share * gain[i];
                gain[i] += l * spread;
            }
            gain[j] = spread;
            before = after;
        }
        if d == 0.0 {
            self.settle(h);
        }
        Some((gain, before))
    }

    /// Takes the rounding out of the components along a row that was just measured exactly, which are zero. A factor
    /// that became small in the update has rounding of its size before: against the terms that are left, such a
    /// component would look like news the next time.
    #[inline]
    fn settle(&mut self, h: &[f64; N]) {
        for j in 0..N {
            if self.pivots[j] > 0.0 {
                let mut sum = h[j];
                let mut most = j;
                for i in j + 1..N {
                    sum += self.lower[i][j] * h[i];
                    if most == j || h[i].abs() > h[most].abs() {
                        most = i;
                    }
                }
                // the factor that needs to change least
                if most > j && h[most] != 0.0 {
                    self.lower[most][j] -= sum / h[most];
                }
            }
        }
    }
}
