//! The shaft as a cantilever that the sclera pushes sideways: where its tip goes.
//!
//! Source: Eq. 9 of the tool paper, `δ = F (a³/(3EI) + a² d/(2EI))` with `a = h - d`: bent as far as the contact,
//! straight beyond it. Depth holds in `[0, h]`. Outside, the compliance stays at the end's value (that of a
//! tip load below zero, none above h), so that it is continuous and an estimate that strays does no harm; its
//! derivative by depth is then zero. NaN gives NaN.

use crate::numbers::rigid::Rigid;
use crate::{Error, Result};
use nalgebra::{Matrix2, Matrix2x5, Vector2, Vector3};

/// Length and stiffness of the shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    length_mm: f64,
    stiffness: f64,
}

/// Tip deflection for a unit force and its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compliance {
    /// `δ/F`, mm/mN; the derivative of the deflection by force.
    pub value: f64,
    /// By depth, mm/mN per mm.
    pub by_depth: f64,
    /// By length, mm/mN per mm.
    pub by_length: f64,
    /// By stiffness, mm/mN per mN·mm².
    pub by_stiffness: f64,
}

/// Depth held in `[0, length]`. `f64::clamp` would have to check its bounds, and could panic.
fn held(depth: f64, length: f64) -> f64 {
    if depth < 0.0 {
        0.0
    } else if depth > length {
        length
    } else {
        depth
    }
}

impl Beam {
    /// A shaft of free length `h` (mm) and bending stiffness `EI` (mN·mm²).
    ///
    /// # Errors
    /// [`Error::Invalid`] where either is not a positive number.
    pub fn new(length_mm: f64, stiffness: f64) -> Result<Self> {
        let positive = |x: f64| x > 0.0 && x.is_finite();
        if !positive(length_mm) || !positive(stiffness) {
            return Err(Error::Invalid {
                what: "beam: length and stiffness must be positive",
            });
        }
        Ok(Self {
            length_mm,
            stiffness,
        })
    }

    /// The tool of the paper: 60 mm, `3EI` = 3.39e6 mN·mm².
    #[must_use]
    pub fn ebrahimi_2020() -> Self {
        Self {
            length_mm: 60.0,
            stiffness: 3.39e6 / 3.0,
        }
    }

    /// Free length `h`, mm.
    #[must_use]
    pub fn length_mm(&self) -> f64 {
        self.length_mm
    }

    /// Bending stiffness `EI`, mN·mm².
    #[must_use]
    pub fn stiffness(&self) -> f64 {
        self.stiffness
    }

    /// Deflection of the tip per force (Eq. 9) at a depth in mm.
    #[must_use]
    pub fn compliance(&self, depth_mm: f64) -> Compliance {
        let (h, k) = (self.length_mm, self.stiffness);
        let d = held(depth_mm, h);
        let a = h - d;
        let value = a * a * (2.0 * a + 3.0 * d) / (6.0 * k);
        // a depth held at an end moves with the end, not with depth
        let by_depth = if depth_mm < 0.0 {
            0.0
        } else {
            -a * (h + d) / (2.0 * k)
        };
        Compliance {
            value,
            by_depth,
            by_length: a * h / k,
            by_stiffness: -value / k,
        }
    }

    /// Deflection of the shaft at the contact itself per force, mm/mN: `a³/(3EI)`, what a calibration measures.
    #[must_use]
    pub fn contact_compliance(&self, depth_mm: f64) -> f64 {
        let a = self.length_mm - held(depth_mm, self.length_mm);
        a * a * a / (3.0 * self.stiffness)
    }

    /// Deflection of the tip in the tool frame, mm. Along the shaft it is zero, as the paper takes it to be.
    #[must_use]
    pub fn deflection(&self, force_mn: &Vector2<f64>, depth_mm: f64) -> Vector3<f64> {
        let c = self.compliance(depth_mm).value;
        Vector3::new(force_mn.x * c, force_mn.y * c, 0.0)
    }

    /// Derivatives of the deflection's x and y, in mm: by the force's x and y (mN), by depth (mm), length (mm) and
    /// stiffness (mN·mm²).
    #[must_use]
    pub fn deflection_derivatives(&self, force_mn: &Vector2<f64>, depth_mm: f64) -> Matrix2x5<f64> {
        let c = self.compliance(depth_mm);
        Matrix2x5::from_columns(&[
            Vector2::new(c.value, 0.0),
            Vector2::new(0.0, c.value),
            force_mn * c.by_depth,
            force_mn * c.by_length,
            force_mn * c.by_stiffness,
        ])
    }

    /// The tip in the base frame, mm, where `tool` takes tool coordinates there (Eq. 11: `P = R δ + S`).
    #[must_use]
    pub fn tip(&self, force_mn: &Vector2<f64>, depth_mm: f64, tool: &Rigid) -> Vector3<f64> {
        tool.apply(&self.deflection(force_mn, depth_mm))
    }

    /// Covariance of the deflection's x and y, mm², to first order, from those of force and depth and from how
    /// they go together (mm·mN).
    #[must_use]
    pub fn deflection_covariance(
        &self,
        force_mn: &Vector2<f64>,
        depth_mm: f64,
        force_covariance: &Matrix2<f64>,
        depth_variance: f64,
        with_force: &Vector2<f64>,
    ) -> Matrix2<f64> {
        let c = self.compliance(depth_mm);
        let by_depth = force_mn * c.by_depth;
        let mixed = by_depth * (with_force * c.value).transpose();
        force_covariance * (c.value * c.value)
            + by_depth * by_depth.transpose() * depth_variance
            + mixed
            + mixed.transpose()
    }
}
