//! What the instruments show: the measurement chain of the delta, with its derivatives.
//!
//! joints (offset) → structure (the two radii, angles, the rods) → body (target offset) → sensor (datum).
//! A reading is a coordinate of the measured point, or the distance between two of its places, in which
//! the datum cancels. Parameters are *errors*, added to the nominal values, as in Table II of the paper.

use super::geometry::{GEOMETRIC, Geometry, LIMBS};
use super::kinematics::{Kinematics, Pose};
use crate::{Error, Result};
use nalgebra::{SMatrix, Vector3};

/// Parameters of the chain: 18 geometric errors limb by limb, then the datum (x, y, z).
pub const PARAMETERS: usize = GEOMETRIC + 3;

/// Nominal robot: what the drawing says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// Nominal geometry.
    pub geometry: Geometry,
    /// From the platform centre to the measured point, mm. The platform stays parallel.
    pub target_offset: Vector3<f64>,
}

/// A measured row: where the joints were, and which readings were taken there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Coordinates of the measured point.
    Position {
        /// Joint readings, mm.
        joints: [f64; LIMBS],
    },
    /// Distance between the measured points of two joint readings.
    Distance {
        /// Joint readings at one end, mm.
        from: [f64; LIMBS],
        /// Joint readings at the other end, mm.
        to: [f64; LIMBS],
    },
}

/// Predicted readings and their derivatives by all parameters; a distance fills the first row only.
#[derive(Clone, Copy, Debug)]
pub struct Prediction {
    /// Position (x, y, z) or distance (first component), mm.
    pub value: Vector3<f64>,
    /// One column a parameter.
    pub derivative: SMatrix<f64, 3, PARAMETERS>,
}

impl Model {
    /// The robot with the given errors, ready to predict.
    ///
    /// # Errors
    /// [`Error::InvalidGeometry`] where the errors leave no robot.
    pub fn with(&self, errors: &[f64; PARAMETERS]) -> Result<Predictor> {
        let mut p = self.geometry.parameters();
        for (value, error) in p.iter_mut().zip(errors) {
            *value += error;
        }
        let geometry = Geometry::from_parameters(&p, self.geometry.assembly);
        let datum = Vector3::new(
            errors[GEOMETRIC],
            errors[GEOMETRIC + 1],
            errors[GEOMETRIC + 2],
        );
        if !datum.iter().all(|d| d.is_finite()) {
            return Err(Error::NotFinite { index: GEOMETRIC });
        }
        Ok(Predictor {
            kinematics: Kinematics::new(&geometry)?,
            shift: self.target_offset + datum,
        })
    }
}

/// A robot with given errors.
#[derive(Clone, Copy, Debug)]
pub struct Predictor {
    /// Kinematics of the platform centre.
    pub kinematics: Kinematics,
    /// From the platform centre to the reading: target offset and datum.
    pub shift: Vector3<f64>,
}

impl Predictor {
    /// Predicts a row without derivatives.
    ///
    /// # Errors
    /// As [`Kinematics::forward`].
    pub fn value(&self, kind: &Kind) -> Result<Vector3<f64>> {
        let at = |q: &[f64; LIMBS]| self.kinematics.forward(&Vector3::from(*q));
        match kind {
            Kind::Position { joints } => Ok(at(joints)? + self.shift),
            Kind::Distance { from, to } => Ok(Vector3::new((at(to)? - at(from)?).norm(), 0.0, 0.0)),
        }
    }

    /// Predicts a row with its derivatives.
    ///
    /// # Errors
    /// As [`Kinematics::pose`].
    pub fn predict(&self, kind: &Kind) -> Result<Prediction> {
        let at = |q: &[f64; LIMBS]| self.kinematics.pose(&Vector3::from(*q));
        match kind {
            Kind::Position { joints } => {
                let pose: Pose = at(joints)?;
                let mut derivative = self.kinematics.by_parameters::<PARAMETERS>(&pose);
                derivative
                    .fixed_columns_mut::<3>(GEOMETRIC)
                    .fill_with_identity();
                Ok(Prediction {
                    value: pose.position + self.shift,
                    derivative,
                })
            }
            Kind::Distance { from, to } => {
                let (a, b) = (at(from)?, at(to)?);
                let between = b.position - a.position;
                let distance = between.norm();
                // two equal places have no direction; their distance is stationary at zero
                let along = if distance > 0.0 {
                    between / distance
                } else {
                    Vector3::zeros()
                };
                let change = self.kinematics.by_parameters::<PARAMETERS>(&b)
                    - self.kinematics.by_parameters::<PARAMETERS>(&a);
                let mut derivative = SMatrix::<f64, 3, PARAMETERS>::zeros();
                derivative.set_row(0, &along.tr_mul(&change));
                Ok(Prediction {
                    value: Vector3::new(distance, 0.0, 0.0),
                    derivative,
                })
            }
        }
    }
}
