//! Brown–Conrady distortion and its inverse by Newton's method.

use crate::numbers::math::Real;
use crate::{Error, Result};
use nalgebra::{Matrix2, SMatrix};

const ITERATIONS: usize = 30;
/// Newton's steps are settled when nothing moves by more than this, in units of the focal length.
const TOLERANCE: f64 = 1e-14;
/// Points between the middle of the picture and a direction at which the distortion must not have folded over.
const CHECKS: u8 = 8;

/// `k₁, k₂, p₁, p₂, k₃`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lens(pub [f64; 5]);

impl Lens {
    /// Where the lens shows the direction `(x, y, 1)`.
    #[inline(always)]
    pub fn bend<T: Real>(&self, [x, y]: [T; 2]) -> [T; 2] {
        let [k1, k2, p1, p2, k3] = self.0.map(T::splat);
        let two = T::splat(2.0);
        let (xx, yy, xy) = (x * x, y * y, x * y);
        let rr = xx + yy;
        let radial = T::splat(1.0) + rr * (k1 + rr * (k2 + rr * k3));
        [
            x * radial + two * p1 * xy + p2 * (rr + two * xx),
            y * radial + p1 * (rr + two * yy) + two * p2 * xy,
        ]
    }

    /// Derivative of [`Self::bend`] by the direction.
    pub fn by_direction(&self, [x, y]: [f64; 2]) -> Matrix2<f64> {
        let [k1, k2, p1, p2, k3] = self.0;
        let rr = x * x + y * y;
        let radial = 1.0 + rr * (k1 + rr * (k2 + rr * k3));
        let steep = 2.0 * (k1 + rr * (2.0 * k2 + rr * 3.0 * k3));
        let mixed = x * y * steep + 2.0 * (p1 * x + p2 * y);
        Matrix2::new(
            radial + x * x * steep + 2.0 * p1 * y + 6.0 * p2 * x,
            mixed,
            mixed,
            radial + y * y * steep + 6.0 * p1 * y + 2.0 * p2 * x,
        )
    }

    /// Derivative of [`Self::bend`] by the coefficients.
    pub fn by_coefficients([x, y]: [f64; 2]) -> SMatrix<f64, 2, 5> {
        let rr = x * x + y * y;
        let (r4, xy) = (rr * rr, 2.0 * x * y);
        SMatrix::<f64, 2, 5>::new(
            x * rr,
            x * r4,
            xy,
            rr + 2.0 * x * x,
            x * r4 * rr,
            y * rr,
            y * r4,
            rr + 2.0 * y * y,
            xy,
            y * r4 * rr,
        )
    }

    /// The direction that [`Self::bend`] maps to `bent`, on the side of the fold where the middle of the picture is.
    pub fn straighten(&self, bent: [f64; 2]) -> Result<[f64; 2]> {
        if self.0 == [0.0; 5] {
            return Ok(bent);
        }
        let mut at = bent;
        let size = 1.0 + bent[0].abs() + bent[1].abs();
        for _ in 0..ITERATIONS {
            let shown = self.bend(at);
            let (ex, ey) = (shown[0] - bent[0], shown[1] - bent[1]);
            let d = self.by_direction(at);
            let determinant = d[(0, 0)] * d[(1, 1)] - d[(0, 1)] * d[(1, 0)];
            // the first guess may lie beyond the fold, where a direction within it still exists: come nearer
            if determinant.is_nan() || determinant <= 0.0 {
                at = [0.7 * at[0], 0.7 * at[1]];
                continue;
            }
            let step = [
                (d[(1, 1)] * ex - d[(0, 1)] * ey) / determinant,
                (d[(0, 0)] * ey - d[(1, 0)] * ex) / determinant,
            ];
            at = [at[0] - step[0], at[1] - step[1]];
            if step[0].abs().max(step[1].abs()) <= TOLERANCE * size {
                return self.unfolded(at);
            }
        }
        Err(Error::LensFolds)
    }

    /// Lets a direction pass if the distortion keeps its sense all the way out to it.
    fn unfolded(&self, at: [f64; 2]) -> Result<[f64; 2]> {
        for check in 1..=CHECKS {
            let share = f64::from(check) / f64::from(CHECKS);
            let d = self.by_direction([share * at[0], share * at[1]]);
            let determinant = d[(0, 0)] * d[(1, 1)] - d[(0, 1)] * d[(1, 0)];
            // two senses turned at once leave the determinant positive, but not the trace
            if determinant.is_nan() || determinant <= 0.0 || d[(0, 0)] + d[(1, 1)] <= 0.0 {
                return Err(Error::LensFolds);
            }
        }
        Ok(at)
    }
}
