//! How much the filters trust the fibres and the robot.
//!
//! Source: section VII of the tool paper. Its noise is a step at 50 mN; [`Trust::Propagated`] instead follows from
//! the covariance that the sensing carries, without any step.

use super::measurement::Measurement;
use crate::tool::beam::{Beam, Compliance};
use crate::{Error, Result};

/// Two variances of the measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Variances {
    /// Of the depth, mm².
    pub depth: f64,
    /// Of each component across the shaft: of the deflection (mm²) or of the force (mN²).
    pub across: f64,
}

/// Where the noise of a measurement comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trust {
    /// One set of variances below a force, another from it on.
    Switched {
        /// The force, mN.
        at_mn: f64,
        /// Below it.
        below: Variances,
        /// From it on.
        above: Variances,
        /// Whether [`Variances::across`] is of the force, as Eq. 14 would have it, or of the deflection.
        of_force: bool,
    },
    /// From the measurement's own covariance.
    Propagated {
        /// Added to it: what the models of gratings and beam leave out.
        floor: Variances,
    },
}

/// Noise of a filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Of the measurements.
    pub trust: Trust,
    /// Process noise that each step adds, mm²: depth, and each axis of the tip.
    pub per_step: [f64; 2],
    /// Process noise per time, mm²/s: depth, and each axis of the tip.
    pub per_second: [f64; 2],
}

impl Noise {
    /// The paper's, for steps of 200 Hz, its entries read as variances in mm².
    #[must_use]
    pub fn ebrahimi_2020() -> Self {
        Self {
            trust: Trust::Switched {
                at_mn: 50.0,
                below: Variances {
                    depth: 1e6,
                    across: 10.0,
                },
                above: Variances {
                    depth: 0.005,
                    across: 0.002,
                },
                of_force: false,
            },
            per_step: [0.0025, 0.01],
            per_second: [0.0; 2],
        }
    }

    /// The paper's, with the entries for the tip read as variances of the force, mN²: Eq. 14 measures in that
    /// space, and the paper gives no units.
    #[must_use]
    pub fn ebrahimi_2020_of_force() -> Self {
        let mut noise = Self::ebrahimi_2020();
        if let Trust::Switched { of_force, .. } = &mut noise.trust {
            *of_force = true;
        }
        noise
    }

    /// Measurement noise from the sensing. `per_second` is how fast depth and tip stray from what the robot's
    /// velocity says (mm²/s), `floor` what the models leave out (mm²).
    #[must_use]
    pub fn propagated(per_second: [f64; 2], floor: Variances) -> Self {
        Self {
            trust: Trust::Propagated { floor },
            per_step: [0.0; 2],
            per_second,
        }
    }

    /// Refuses noise that is none.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a variance that is negative or not finite.
    pub fn check(&self) -> Result<()> {
        let variance = |x: f64| x >= 0.0 && x.is_finite();
        let pair = |v: &Variances| variance(v.depth) && variance(v.across);
        let trust = match &self.trust {
            Trust::Switched {
                at_mn,
                below,
                above,
                ..
            } => variance(*at_mn) && pair(below) && pair(above),
            Trust::Propagated { floor } => pair(floor),
        };
        let process = self.per_step.iter().chain(&self.per_second);
        if !trust || !process.copied().all(variance) {
            return Err(Error::Invalid {
                what: "noise: variances must be zero or more, and finite",
            });
        }
        Ok(())
    }

    /// Process noise of a step of this length: depth, and each axis of the tip, mm².
    #[inline]
    pub(super) fn process(&self, elapsed_s: f64) -> [f64; 2] {
        [
            self.per_step[0] + self.per_second[0] * elapsed_s,
            self.per_step[1] + self.per_second[1] * elapsed_s,
        ]
    }

    /// Which of the two sets holds.
    #[inline]
    fn switched(at_mn: f64, below: &Variances, above: &Variances, m: &Measurement) -> Variances {
        if m.force_squared() < at_mn * at_mn {
            *below
        } else {
            *above
        }
    }

    /// Variance of a measured depth, mm².
    #[inline]
    #[must_use]
    pub fn of_depth(&self, m: &Measurement) -> f64 {
        match &self.trust {
            Trust::Switched {
                at_mn,
                below,
                above,
                ..
            } => Self::switched(*at_mn, below, above, m).depth,
            Trust::Propagated { floor } => m.depth_variance + floor.depth,
        }
    }

    /// Covariance of the measured deflection across the shaft, mm², at a known depth.
    #[inline]
    pub(super) fn of_deflection(&self, m: &Measurement, c: &Compliance) -> [[f64; 2]; 2] {
        match &self.trust {
            Trust::Switched {
                at_mn,
                below,
                above,
                of_force,
            } => {
                let across = Self::switched(*at_mn, below, above, m).across;
                let r = if *of_force {
                    across * c.value * c.value
                } else {
                    across
                };
                [[r, 0.0], [0.0, r]]
            }
            Trust::Propagated { floor } => {
                let square = c.value * c.value;
                let f = &m.force_covariance;
                [
                    [f[0][0] * square + floor.across, f[0][1] * square],
                    [f[1][0] * square, f[1][1] * square + floor.across],
                ]
            }
        }
    }

    /// As above where the depth has a variance of its own. The paper's noise does not know it.
    #[inline]
    #[must_use]
    pub fn of_tip(
        &self,
        m: &Measurement,
        beam: &Beam,
        depth_mm: f64,
        depth_variance: f64,
    ) -> [[f64; 2]; 2] {
        let c = beam.compliance(depth_mm);
        let mut r = self.of_deflection(m, &c);
        if let Trust::Propagated { .. } = self.trust {
            let moved = m.force.map(|f| f * c.by_depth);
            for i in 0..2 {
                for j in 0..2 {
                    r[i][j] += moved[i] * moved[j] * depth_variance;
                }
            }
        }
        r
    }
}
