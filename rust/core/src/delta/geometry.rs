//! Geometry of a linear delta and the order of its 18 parameters.

use crate::{Error, Result};

/// Number of limbs.
pub const LIMBS: usize = 3;
/// Geometric parameters of a limb: base radius, base angle, joint offset, rod length, platform radius,
/// platform angle, in this order. The first four are those of Eq. 9.
pub const PER_LIMB: usize = 6;
/// All geometric parameters, limb by limb (Eq. 8).
pub const GEOMETRIC: usize = LIMBS * PER_LIMB;
/// How many of a limb's parameters can be identified; the platform's own are dependent (Eq. 9).
pub const IDENTIFIABLE: usize = 4;

/// On which side of the carriages the platform is assembled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Assembly {
    /// The platform hangs below the carriages.
    #[default]
    Below,
    /// The platform stands above the carriages.
    Above,
}

impl Assembly {
    /// +1 where the carriages are above the platform, else -1.
    #[inline(always)]
    #[must_use]
    pub const fn sign(self) -> f64 {
        match self {
            Self::Below => 1.0,
            Self::Above => -1.0,
        }
    }
}

/// One limb: a vertical rail, a rod pair, a joint on the platform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limb {
    /// Distance of the rail from the base centre, `r_b`.
    pub base_radius_mm: f64,
    /// Direction of the rail seen from the base centre, `θ_b`.
    pub base_angle_rad: f64,
    /// Added to the joint reading to give the carriage height, `δq`.
    pub joint_offset_mm: f64,
    /// Length of the rod pair, `l`.
    pub rod_length_mm: f64,
    /// Distance of the platform joint from the platform centre, `r_p`.
    pub platform_radius_mm: f64,
    /// Direction of the platform joint seen from the platform centre, `θ_p`.
    pub platform_angle_rad: f64,
}

/// Geometry of the whole robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// The limbs.
    pub limbs: [Limb; LIMBS],
    /// Side on which the platform is assembled.
    pub assembly: Assembly,
}

impl Geometry {
    /// Builds a geometry from the 18 parameters in the order of [`PER_LIMB`], limb by limb.
    #[must_use]
    pub fn from_parameters(parameters: &[f64; GEOMETRIC], assembly: Assembly) -> Self {
        let limb = |i: usize| {
            let p = &parameters[i * PER_LIMB..];
            Limb {
                base_radius_mm: p[0],
                base_angle_rad: p[1],
                joint_offset_mm: p[2],
                rod_length_mm: p[3],
                platform_radius_mm: p[4],
                platform_angle_rad: p[5],
            }
        };
        Self {
            limbs: [limb(0), limb(1), limb(2)],
            assembly,
        }
    }

    /// The 18 parameters, limb by limb.
    #[must_use]
    pub fn parameters(&self) -> [f64; GEOMETRIC] {
        let mut p = [0.0; GEOMETRIC];
        for (limb, out) in self.limbs.iter().zip(p.chunks_exact_mut(PER_LIMB)) {
            out.copy_from_slice(&[
                limb.base_radius_mm,
                limb.base_angle_rad,
                limb.joint_offset_mm,
                limb.rod_length_mm,
                limb.platform_radius_mm,
                limb.platform_angle_rad,
            ]);
        }
        p
    }

    /// Checks that every number is finite and every rod has a length.
    ///
    /// # Errors
    /// [`Error::InvalidGeometry`] names the limb and what is wrong.
    pub fn check(&self) -> Result<()> {
        for (limb, (l, p)) in self
            .limbs
            .iter()
            .zip(self.parameters().chunks_exact(PER_LIMB))
            .enumerate()
        {
            if p.iter().any(|v| !v.is_finite()) {
                let what = "a geometric parameter is not a finite number";
                return Err(Error::InvalidGeometry { limb, what });
            }
            if l.rod_length_mm <= 0.0 {
                let what = "the rod length must be positive";
                return Err(Error::InvalidGeometry { limb, what });
            }
        }
        Ok(())
    }
}
