//! What the fibres tell a filter at one time.

use crate::tool::sensing::{Depth, Reading};

/// Force and depth with their covariance and time.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Measurement {
    /// When the fibres were read, s, on the clock of the steps.
    pub time_s: f64,
    /// Sclera force, tool frame, mN.
    pub force: [f64; 2],
    /// Its covariance, mN².
    pub force_covariance: [[f64; 2]; 2],
    /// Depth, mm; not read where there is no force.
    pub depth: f64,
    /// Its variance, mm²; infinite where there is no force.
    pub depth_variance: f64,
    /// Covariance of depth with force, mm·mN.
    pub depth_with_force: [f64; 2],
}

/// What a measurement is good for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Content {
    /// Force and depth.
    ForceAndDepth,
    /// Force alone: it is too small to tell the depth.
    ForceAlone,
    /// A number that is not finite where one is needed.
    NotFinite,
}

impl Measurement {
    /// Without covariances, for noise that is not propagated.
    #[must_use]
    pub fn plain(time_s: f64, force: [f64; 2], depth: f64) -> Self {
        Self {
            time_s,
            force,
            force_covariance: [[0.0; 2]; 2],
            depth,
            depth_variance: 0.0,
            depth_with_force: [0.0; 2],
        }
    }

    /// What a sensor read at a time.
    #[must_use]
    pub fn from_reading(time_s: f64, reading: &Reading) -> Self {
        let c = &reading.force_covariance;
        let (depth, depth_variance, depth_with_force) = match reading.depth {
            Depth::Measured {
                mm,
                variance,
                with_force,
            } => (mm, variance, [with_force.x, with_force.y]),
            Depth::NoForce => (0.0, f64::INFINITY, [0.0; 2]),
        };
        Self {
            time_s,
            force: [reading.force.x, reading.force.y],
            force_covariance: [[c.m11, c.m12], [c.m21, c.m22]],
            depth,
            depth_variance,
            depth_with_force,
        }
    }

    /// Squared length of the force, mN².
    #[inline]
    #[must_use]
    pub fn force_squared(&self) -> f64 {
        self.force[0] * self.force[0] + self.force[1] * self.force[1]
    }

    #[inline]
    pub(super) fn content(&self) -> Content {
        let squared = self.force_squared();
        let [[a, b], [c, d]] = self.force_covariance;
        if !(squared + a.abs() + b.abs() + c.abs() + d.abs()).is_finite() {
            return Content::NotFinite;
        }
        // Eq. 2 divides by the force: without one, whatever stands for depth is no measurement
        if self.depth_variance == f64::INFINITY || squared == 0.0 {
            return Content::ForceAlone;
        }
        let [x, y] = self.depth_with_force;
        if (self.depth.abs() + self.depth_variance + x.abs() + y.abs()).is_finite() {
            Content::ForceAndDepth
        } else {
            Content::NotFinite
        }
    }
}
