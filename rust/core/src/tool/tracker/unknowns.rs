//! What the calibration does not know, as independent unknowns of unit variance.
//!
//! Schmidt's filter (Schmidt 1966; Jazwinski, *Stochastic Processes and Filtering Theory*, 8.4) carries how an estimate's
//! error hangs on parameters that it does not estimate. Written in unit unknowns `θ = L⁻¹ δ` the error is `T θ` plus noise
//! of its own, and its covariance `T Tᵀ + P`: no covariance of the parameters is left in the loop, and both parts are
//! semidefinite by their form.
//!
//! The unknowns of sections I and II stand side by side, so that both are worked on at once.

use super::moments::{Bends, Pair};
use crate::numbers::math::sqrt;
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2};

/// Unknowns of one section: two of each row of its gain, two references, two coefficients of warmth.
const OF_SECTION: usize = 8;
/// All unknowns: both sections, the clearance of the hole, the places of the sections, and the mean wavelength that a
/// lost grating of I or II is rebuilt from.
pub const UNKNOWNS: usize = 2 * OF_SECTION + 4;
/// Place of the clearance of the hole.
pub(super) const CLEARANCE: usize = 2 * OF_SECTION;
/// Place of the sections' distance from the tip.
pub(super) const DISTANCE: usize = CLEARANCE + 1;
/// Place of what a rebuilt grating does not know, sections I and II.
const REBUILT: usize = DISTANCE + 1;

/// How an error hangs on the unknowns.
pub type Tied = [f64; UNKNOWNS];

/// What the calibration says of its own errors. All zero: it is exact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Doubt {
    /// Covariance of each row of `K_I` and `K_II`, (mN·mm/nm)².
    pub gains: [[Matrix3<f64>; 2]; 2],
    /// Standard deviation of a reference wavelength, nm.
    pub reference_nm: f64,
    /// How unlike fibres answer to warmth: standard deviation over the mean answer.
    pub unlike: f64,
    /// What is not known of a fibre's own answer ([`super::Trusted::warmth`]): the same, where nothing was learnt of it.
    pub warmth: f64,
    /// Covariance of length (mm) and stiffness (mN·mm²).
    pub beam: Matrix2<f64>,
    /// Standard deviation of the clearance of the hole, mm.
    pub clearance_mm: f64,
    /// Standard deviation of where the sections stand, mm.
    pub distance_mm: f64,
}

impl Default for Doubt {
    fn default() -> Self {
        Self {
            gains: [[Matrix3::zeros(); 2]; 2],
            reference_nm: 0.0,
            unlike: 0.0,
            warmth: 0.0,
            beam: Matrix2::zeros(),
            clearance_mm: 0.0,
            distance_mm: 0.0,
        }
    }
}

/// `1/√6` and `1/√2`, which make two differences of three numbers orthonormal.
pub(super) const LENGTHS: (f64, f64) = (0.408_248_290_463_863, core::f64::consts::FRAC_1_SQRT_2);

/// Columns: where a fibre goes among two orthonormal differences of three, without what is common to them.
pub(super) fn differences() -> Matrix2x3<f64> {
    let (a, b) = LENGTHS;
    Matrix2x3::new(2.0 * a, -a, -a, 0.0, b, -b)
}

/// Factor `L` of a covariance of two numbers, with zeros where it is not positive.
fn factor(c: &Matrix2<f64>) -> Matrix2<f64> {
    let first = sqrt(c.m11.max(0.0));
    let below = if first > 0.0 { c.m21 / first } else { 0.0 };
    let second = sqrt((c.m22 - below * below).max(0.0));
    Matrix2::new(first, 0.0, below, second)
}

/// The doubt, prepared for the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unknowns {
    /// Of each row of the gains: its factor's three numbers, of both sections.
    gains: [[Pair; 3]; 2],
    reference_nm: f64,
    /// See [`Doubt`].
    unlike: f64,
    warmth: f64,
    /// Factor of the covariance of length and stiffness.
    pub(super) beam: Matrix2<f64>,
    pub(super) clearance_mm: f64,
    pub(super) distance_mm: f64,
}

impl Unknowns {
    /// Of a doubt.
    pub(super) fn new(doubt: &Doubt) -> Self {
        let to: Matrix2x3<f64> = differences();
        let of = |section: usize, row: usize| {
            let [one, two] = &doubt.gains;
            let [x, y] = if section == 0 { one } else { two };
            factor(&(to * (if row == 0 { x } else { y }) * to.transpose()))
        };
        let rows = |row: usize| {
            let (a, b) = (of(0, row), of(1, row));
            [[a.m11, b.m11], [a.m21, b.m21], [a.m22, b.m22]]
        };
        Self {
            gains: [rows(0), rows(1)],
            reference_nm: doubt.reference_nm,
            unlike: doubt.unlike,
            warmth: doubt.warmth,
            beam: factor(&doubt.beam),
            clearance_mm: doubt.clearance_mm,
            distance_mm: doubt.distance_mm,
        }
    }

    /// How the moments along a way, each weighted, hang on the unknowns. `by`: moments by the differences, see
    /// [`super::moments::Gains`].
    #[inline]
    pub(super) fn of_moments(
        &self,
        by: &[[Pair; 2]; 2],
        m: &Bends,
        way: &Vector2<f64>,
        weights: &Pair,
    ) -> Tied {
        let mut tied = [0.0; UNKNOWNS];
        let [d, e] = &m.differences;
        for s in 0..2 {
            let w = [way.x * weights[s], way.y * weights[s]];
            for row in 0..2 {
                let [a, b, c] = &self.gains[row];
                tied[4 * row + s] = (a[s] * d[s] + b[s] * e[s]) * w[row];
                tied[4 * row + 2 + s] = c[s] * e[s] * w[row];
            }
            let warm = self.warmth * m.common_nm[s];
            for k in 0..2 {
                let moved = by[0][k][s] * w[0] + by[1][k][s] * w[1];
                tied[8 + 2 * k + s] = moved * self.reference_nm;
                tied[12 + 2 * k + s] = moved * warm;
            }
        }
        if m.any_rebuilt {
            for s in 0..2 {
                let unlike = self.unlike * m.common_nm[s].abs();
                tied[REBUILT + s] = m.rebuilt[s].dot(way) * unlike * weights[s];
            }
        }
        tied
    }
}
