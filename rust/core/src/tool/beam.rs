//! The shaft as a cantilever that the sclera pushes sideways: where its tip goes.
//!
//! Source: Eq. 9 of the tool paper, `δ = F (a³/(3EI) + a² d/(2EI))` with `a = h - d`: bent as far as the contact,
//! straight beyond it. Depth holds in `[0, h]`. Outside, the compliance stays at the end's value (that of a
//! tip load below zero, none above h), so that it is continuous and an estimate that strays does no harm; its
//! derivative by depth is then zero. NaN gives NaN.

use crate::{Error, Result};

/// Length and stiffness of the shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    length_mm: f64,
    stiffness: f64,
    /// One over it: a loop does not divide.
    pub(super) softness: f64,
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
            softness: 1.0 / stiffness,
        })
    }

    /// The tool of the paper: 60 mm, `3EI` = 3.39e6 mN·mm².
    #[must_use]
    pub fn ebrahimi_2020() -> Self {
        Self {
            length_mm: 60.0,
            stiffness: 3.39e6 / 3.0,
            softness: 3.0 / 3.39e6,
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
}
