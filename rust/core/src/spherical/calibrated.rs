//! The calibrated spherical robot that a control loop runs. Nothing here allocates; an iteration is bounded.

use super::centre::Centre;
use super::effects::{AT, Values};
use super::geometry::Elbows;
use super::model::{Chain, Covariates, Prediction};
use super::nominal::{Model, Readings};
use crate::Result;
use crate::chain::effects::Wanted;
use crate::chain::{Robot, inverse};
use core::f64::consts::PI;
use nalgebra::{Matrix2, Vector2, Vector3};

/// The inverse takes its last step where the forward model misses by less than this, rad: what the step leaves is its square.
const NEAR_RAD: f64 = 1e-7;

/// An identified spherical robot: where its tool really points.
///
/// Angles φ and γ are those of the end of the tool axis seen from the nominal centre: errors of joints, links and
/// centre count. What belongs to the measurement alone does not: the camera, its delay, datum, and the marker with its
/// offset, growth, drift and slip.
#[derive(Clone, Copy, Debug)]
pub struct Calibrated {
    chain: Chain,
    elbows: Elbows,
}

impl Calibrated {
    /// The robot with identified `values`.
    ///
    /// # Errors
    /// As [`Model::with`].
    pub fn new(model: &Model, values: &Values, elbows: Elbows) -> Result<Self> {
        let mut values = *values;
        let (joints, body) = (AT.joints, AT.body);
        for measured in [
            AT.angles.datum,
            AT.structure.marker_offset,
            joints.camera_delay,
            body.thermal_growth,
            body.drift,
            body.slip,
        ] {
            for value in measured
                .and_then(|place| values.get_mut(place.range()))
                .unwrap_or_default()
            {
                *value = 0.0;
            }
        }
        let pointing = Model {
            readings: Readings::Angles,
            ..*model
        };
        let chain = pointing.with(&values)?;
        Ok(Self { chain, elbows })
    }

    /// φ and γ for joint readings, and their derivative by them.
    ///
    /// # Errors
    /// As [`Chain::value`].
    pub fn forward(
        &self,
        joints: &Vector2<f64>,
        now: &Covariates,
    ) -> Result<(Vector2<f64>, Matrix2<f64>)> {
        let found = self.predict(joints, now, Wanted::NONE)?;
        Ok((found.value, found.by_joints))
    }

    /// φ and γ with derivatives by joints and wanted parameters, for the account of accuracy.
    ///
    /// # Errors
    /// As [`Chain::value`].
    #[inline]
    pub fn predict(
        &self,
        joints: &Vector2<f64>,
        now: &Covariates,
        wanted: Wanted,
    ) -> Result<Prediction> {
        let still = Vector3::zeros();
        self.chain.predict(joints, now, &still, wanted)
    }

    /// Joint readings at which the calibrated robot points to φ and γ, to 1e-12 rad.
    ///
    /// # Errors
    /// As the inverse kinematics of the identified robot; [`crate::Error::NotConverged`] where the effects fold it over.
    pub fn inverse(&self, angles: &Vector2<f64>, now: &Covariates) -> Result<Vector2<f64>> {
        let start = self
            .chain
            .structure
            .kinematics()
            .inverse(angles, self.elbows)?;
        let miss = |joints: &Vector2<f64>| {
            let (reached, by_joints) = self.forward(joints, now)?;
            let mut missed = angles - reached;
            missed.x = wrapped(missed.x);
            Ok((missed, by_joints, true))
        };
        let again = |joints: &Vector2<f64>| Ok(miss(joints)?.0);
        inverse(start, miss, again, |missed| missed.amax() < NEAR_RAD)
    }

    /// Displacement of the remote centre of motion at joint readings.
    ///
    /// # Errors
    /// As [`Chain::centre`].
    pub fn centre(&self, joints: &Vector2<f64>, now: &Covariates) -> Result<Centre> {
        self.chain.centre(&[joints.x, joints.y], now)
    }
}

/// An angle in (-π, π].
fn wrapped(angle: f64) -> f64 {
    angle - 2.0 * PI * libm::round(angle / (2.0 * PI))
}
