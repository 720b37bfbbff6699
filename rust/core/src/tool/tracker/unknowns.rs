//! What the calibration does not know, as independent unknowns of unit variance.
//!
//! Schmidt's filter (Schmidt 1966; Jazwinski, *Stochastic Processes and Filtering Theory*, 8.4) carries how an estimate's
//! error hangs on parameters that it does not estimate. Written in unit unknowns `θ = L⁻¹ δ` the error is `T θ` plus noise
//! of its own, and its covariance `T Tᵀ + P`: no covariance of the parameters is left in the loop, and both parts are
//! semidefinite by their form.

use crate::numbers::math::sqrt;
use crate::tool::sensing::FIBRES;
use nalgebra::{Matrix2, Matrix3, Vector2};

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
pub(super) const REBUILT: usize = DISTANCE + 1;

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
            warmth: 0.0,
            beam: Matrix2::zeros(),
            clearance_mm: 0.0,
            distance_mm: 0.0,
        }
    }
}

/// Two differences of three fibres, orthonormal, without what is common to them.
pub(super) fn differences(shift: &[f64; FIBRES]) -> Vector2<f64> {
    let (a, b) = (1.0 / sqrt(6.0), 1.0 / sqrt(2.0));
    Vector2::new(
        a * (2.0 * shift[0] - shift[1] - shift[2]),
        b * (shift[1] - shift[2]),
    )
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
    gains: [[Matrix2<f64>; 2]; 2],
    /// Moments by the two differences, `K` on them.
    by_differences: [Matrix2<f64>; 2],
    reference_nm: f64,
    /// See [`Doubt::warmth`].
    pub(super) warmth: f64,
    /// Factor of the covariance of length and stiffness.
    pub(super) beam: Matrix2<f64>,
    pub(super) clearance_mm: f64,
    pub(super) distance_mm: f64,
}

impl Unknowns {
    /// Of a doubt, for gains without common mode.
    pub(super) fn new(doubt: &Doubt, gains: &[nalgebra::Matrix2x3<f64>; 2]) -> Self {
        let basis = |k: usize| {
            let mut unit = [0.0; FIBRES];
            unit[k] = 1.0;
            differences(&unit)
        };
        // columns: where a fibre goes among the differences
        let to = nalgebra::Matrix2x3::from_columns(&[basis(0), basis(1), basis(2)]);
        Self {
            gains: doubt
                .gains
                .map(|rows| rows.map(|c| factor(&(to * c * to.transpose())))),
            by_differences: gains.map(|k| k * to.transpose()),
            reference_nm: doubt.reference_nm,
            warmth: doubt.warmth,
            beam: factor(&doubt.beam),
            clearance_mm: doubt.clearance_mm,
            distance_mm: doubt.distance_mm,
        }
    }

    /// How the moment of a section along a way hangs on the section's unknowns, for these shifts of its fibres and their
    /// mean.
    #[inline]
    pub(super) fn of_moment(
        &self,
        section: usize,
        way: &Vector2<f64>,
        shift: &Vector2<f64>,
        common_nm: f64,
    ) -> [f64; OF_SECTION] {
        let rows = &self.gains[section];
        let (x, y) = (rows[0].tr_mul(shift) * way.x, rows[1].tr_mul(shift) * way.y);
        let by = self.by_differences[section].tr_mul(way);
        let (still, warm) = (by * self.reference_nm, by * (self.warmth * common_nm));
        [x.x, x.y, y.x, y.y, still.x, still.y, warm.x, warm.y]
    }

    /// Where a section's unknowns stand.
    #[inline]
    pub(super) fn place(section: usize) -> usize {
        section * OF_SECTION
    }
}
