//! A calibrated tool as the filter takes it, and what its calibration does not know.
//!
//! Whatever the bench leaves open, of gains, of where sections and loads stood, the depth that follows from two moments is
//! off by `θ₀ + θ₁ d + θ₂ d²`: a section that stands elsewhere puts it off in proportion to the other's arm, gains in
//! proportion to both. So the three are all.

use super::rod::Rod;
use super::sensing::{Calibration, FIBRES, Sensor};
use crate::{Error, Result};
use nalgebra::{Matrix2, Matrix3, Vector2};

/// A tool and how far it is trusted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trusted {
    /// The gratings.
    pub calibration: Calibration,
    /// What the mean of three fibres answers to a moment at sections I and II, nm per mN·mm: nothing where fibres stand
    /// evenly, two per cent of a fibre's own answer where they are off by as much.
    pub means: [Vector2<f64>; 2],
    /// How much more than the mean of its section each fibre of sections I and II answers to warmth, relative.
    pub warmth: [[f64; FIBRES]; 2],
    /// The shaft.
    pub rod: Rod,
    /// What the calibration does not know.
    pub doubt: Doubt,
    /// Radius by which the hole is wider than the shaft, mm, as far as it is known before it is felt.
    pub clearance_mm: f64,
    /// How fast the hole strays along the shaft at least, mm²/s.
    pub per_second_mm2: f64,
}

/// What the calibration says of its own errors. All zero: it is exact.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Doubt {
    /// Covariance of `θ₀, θ₁, θ₂`: the depth is off by `θ₀ + θ₁ d/10 + θ₂ (d/10)²`, all in mm.
    pub depth: Matrix3<f64>,
    /// By how much more than that the gratings may count all depths deeper, mm: where the bench had its zero.
    pub deeper_mm: f64,
    /// How far the gratings may be turned about the shaft against the robot's frame, rad.
    pub turn_rad: f64,
    /// Deviation of a force over the force.
    pub force: f64,
    /// Covariance of length (mm) and stiffness (mN·mm²).
    pub beam: Matrix2<f64>,
    /// Standard deviation of a reference wavelength, nm.
    pub reference_nm: f64,
    /// Of what a bend leaves in the mean of three fibres, over the shift that it makes.
    pub mean: f64,
    /// How unlike fibres answer to warmth: standard deviation over the mean answer.
    pub unlike: f64,
    /// What is not known of a fibre's own answer ([`Trusted::warmth`]): the same, where nothing was learnt of it.
    pub warmth: f64,
    /// Standard deviation of the clearance of the hole, mm.
    pub clearance_mm: f64,
}

impl Trusted {
    /// Whether the numbers mean something.
    pub(super) fn check(&self) -> Result<()> {
        Sensor::new(self.calibration)?;
        let d = &self.doubt;
        let deviations = [
            d.deeper_mm,
            d.turn_rad,
            d.force,
            d.reference_nm,
            d.mean,
            d.unlike,
            d.warmth,
            d.clearance_mm,
            self.clearance_mm,
            self.per_second_mm2,
        ];
        let mut numbers = d.depth.iter().chain(d.beam.iter());
        let mut warmth = self.warmth.as_flattened().iter();
        let means = self
            .means
            .iter()
            .all(|m| m.x.is_finite() && m.y.is_finite());
        let known = means && warmth.all(|x| x.is_finite()) && numbers.all(|x| x.is_finite());
        if known && deviations.iter().all(|x| *x >= 0.0 && x.is_finite()) {
            Ok(())
        } else {
            Err(Error::Invalid {
                what: "tool: deviations, clearance and variances must be zero or more, and finite",
            })
        }
    }
}
