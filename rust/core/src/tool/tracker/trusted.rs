//! A tool and how far it is trusted.

use super::unknowns::Doubt;
use crate::tool::rod::Rod;
use crate::tool::sensing::{Calibration, FIBRES, Sensor};
use crate::{Error, Result};

/// A tool and how far it is trusted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trusted {
    /// The gratings.
    pub calibration: Calibration,
    /// How much more than the mean of its section each fibre of sections I and II answers to warmth, relative.
    pub warmth: [[f64; FIBRES]; 2],
    /// The shaft.
    pub rod: Rod,
    /// What the calibration does not know.
    pub doubt: Doubt,
    /// Radius by which the hole is wider than the shaft, mm.
    pub clearance_mm: f64,
    /// How fast the hole strays along the shaft at least, mm²/s.
    pub per_second_mm2: f64,
}

impl Trusted {
    /// Whether the numbers mean something.
    pub(super) fn check(&self) -> Result<()> {
        Sensor::new(self.calibration)?;
        let d = &self.doubt;
        let deviations = [
            d.reference_nm,
            d.unlike,
            d.warmth,
            d.clearance_mm,
            d.distance_mm,
        ];
        let rest = [self.clearance_mm, self.per_second_mm2];
        let mut more = deviations.iter().chain(&rest).copied();
        let mut matrices = d.gains.as_flattened().iter().flatten().chain(d.beam.iter());
        let mut warmth = self.warmth.as_flattened().iter();
        let known = warmth.all(|x| x.is_finite()) && matrices.all(|x| x.is_finite());
        if known && more.all(|x| x >= 0.0 && x.is_finite()) {
            Ok(())
        } else {
            Err(Error::Invalid {
                what: "tool: deviations, clearance and variances must be zero or more, and finite",
            })
        }
    }
}
