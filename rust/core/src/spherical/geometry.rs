//! Geometry of a spherical robot with two limbs, and the order of its six parameters.

use crate::{Error, Result};
use core::f64::consts::PI;

/// Number of limbs.
pub const LIMBS: usize = 2;
/// Parameters of a limb: proximal arc, distal arc, joint offset, in this order.
pub const PER_LIMB: usize = 3;
/// All geometric parameters, limb by limb.
pub const GEOMETRIC: usize = LIMBS * PER_LIMB;

/// Which of the two meeting points of the limbs' cones the tool axis takes: the sign of the root of Eq. 35.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Assembly {
    /// Plus sign: the tool axis stands farther from the actuated axis than the elbows do (the paper's robot).
    #[default]
    Outer,
    /// Minus sign: it stands nearer; where both limbs are alike and α = β, on the actuated axis itself.
    Inner,
}

impl Assembly {
    /// Sign of the root of Eq. 35.
    #[inline(always)]
    #[must_use]
    pub const fn sign(self) -> f64 {
        match self {
            Self::Outer => 1.0,
            Self::Inner => -1.0,
        }
    }
}

/// On which side of the tool axis the two elbows stand, seen against the actuated axis: the solution of the
/// inverse kinematics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Elbows {
    /// θ₁ > φ > θ₂ (A > 0).
    #[default]
    Open,
    /// θ₁ < φ < θ₂ (A < 0).
    Crossed,
    /// Both ahead of the tool axis, θ > φ; the elbows of equal limbs coincide there, which is singular.
    Ahead,
    /// Both behind it.
    Behind,
}

impl Elbows {
    /// Sign of `ψ_i - φ` for both limbs.
    #[inline(always)]
    #[must_use]
    pub const fn signs(self) -> [f64; LIMBS] {
        match self {
            Self::Open => [1.0, -1.0],
            Self::Crossed => [-1.0, 1.0],
            Self::Ahead => [1.0, 1.0],
            Self::Behind => [-1.0, -1.0],
        }
    }
}

/// One limb: an actuated joint, a proximal link, an elbow, a distal link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limb {
    /// Angle between the actuated axis and the elbow axis, `α`, rad.
    pub alpha_rad: f64,
    /// Angle between the elbow axis and the tool axis, `β`, rad.
    pub beta_rad: f64,
    /// Added to the joint angle to give the elbow's azimuth, rad.
    pub offset_rad: f64,
}

/// Geometry of the mechanism.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// The limbs.
    pub limbs: [Limb; LIMBS],
    /// Which meeting point of the cones is taken.
    pub assembly: Assembly,
}

impl Geometry {
    /// Two equal limbs, as in the paper.
    #[must_use]
    pub const fn equal(alpha_rad: f64, beta_rad: f64) -> Self {
        let limb = Limb {
            alpha_rad,
            beta_rad,
            offset_rad: 0.0,
        };
        Self {
            limbs: [limb, limb],
            assembly: Assembly::Outer,
        }
    }

    /// Builds a geometry from the six parameters in the order of [`PER_LIMB`], limb by limb.
    #[must_use]
    pub fn from_parameters(parameters: &[f64; GEOMETRIC], assembly: Assembly) -> Self {
        let limb = |i: usize| Limb {
            alpha_rad: parameters[i * PER_LIMB],
            beta_rad: parameters[i * PER_LIMB + 1],
            offset_rad: parameters[i * PER_LIMB + 2],
        };
        Self {
            limbs: [limb(0), limb(1)],
            assembly,
        }
    }

    /// The six parameters, limb by limb.
    #[must_use]
    pub fn parameters(&self) -> [f64; GEOMETRIC] {
        let [a, b] = &self.limbs;
        [
            a.alpha_rad,
            a.beta_rad,
            a.offset_rad,
            b.alpha_rad,
            b.beta_rad,
            b.offset_rad,
        ]
    }

    /// Checks that every number is finite and every arc is between 0 and π.
    ///
    /// # Errors
    /// [`Error::InvalidGeometry`] names the limb and what is wrong.
    pub fn check(&self) -> Result<()> {
        for (limb, l) in self.limbs.iter().enumerate() {
            let wrong = |what| Err(Error::InvalidGeometry { limb, what });
            if ![l.alpha_rad, l.beta_rad, l.offset_rad]
                .iter()
                .all(|v| v.is_finite())
            {
                return wrong("a geometric parameter is not a finite number");
            }
            if !(l.alpha_rad > 0.0 && l.alpha_rad < PI) {
                return wrong("alpha must lie between 0 and pi");
            }
            if !(l.beta_rad > 0.0 && l.beta_rad < PI) {
                return wrong("beta must lie between 0 and pi");
            }
        }
        Ok(())
    }
}
