//! The calibrated spherical robot that a control loop runs. Nothing here allocates; an iteration is bounded.

use super::chain::{Centre, Chain, Kind, Model, Prediction, Row};
use super::geometry::Elbows;
use super::joints::Covariates;
use super::parameters::{CAMERA_DELAY, DATUM, MARKER_OFFSET, Values};
use crate::{Error, Result};
use core::f64::consts::PI;
use nalgebra::{Matrix2, Vector2, Vector3};

/// The inverse is iterated until the forward model misses by less than this, rad: 0.2 pm on a sphere of 200 mm.
const TOLERANCE_RAD: f64 = 1e-12;
const ITERATIONS: usize = 30;

/// An identified spherical robot: where its tool really points.
///
/// Angles φ and γ are those of the end of the tool axis seen from the nominal centre: errors of joints, links and
/// centre count. What belongs to the measurement alone does not: the camera, its delay, datum and the marker's offset.
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
        for measured in [DATUM, MARKER_OFFSET, CAMERA_DELAY] {
            values[measured].fill(0.0);
        }
        let chain = model.with(&values)?;
        Ok(Self { chain, elbows })
    }

    fn row(joints: &Vector2<f64>, now: &Covariates) -> Row {
        Row {
            joints: [joints.x, joints.y],
            covariates: *now,
            push: Vector3::zeros(),
            kind: Kind::Angles,
        }
    }

    /// φ and γ for joint readings, and their derivative by them.
    ///
    /// # Errors
    /// As [`Chain::row_value`].
    pub fn forward(
        &self,
        joints: &Vector2<f64>,
        now: &Covariates,
    ) -> Result<(Vector2<f64>, Matrix2<f64>)> {
        let Prediction {
            value, by_joints, ..
        } = self.chain.row_predict(&Self::row(joints, now))?;
        Ok((value, by_joints))
    }

    /// φ and γ with derivatives by joints and parameters, for the account of accuracy.
    ///
    /// # Errors
    /// As [`Chain::row_value`].
    pub fn predict(&self, joints: &Vector2<f64>, now: &Covariates) -> Result<Prediction> {
        self.chain.row_predict(&Self::row(joints, now))
    }

    /// Joint readings at which the calibrated robot points to φ and γ, to 1e-12 rad.
    ///
    /// # Errors
    /// As the inverse kinematics of the identified robot; [`Error::NotConverged`] where the effects fold it over.
    pub fn inverse(&self, angles: &Vector2<f64>, now: &Covariates) -> Result<Vector2<f64>> {
        let mut joints = self.chain.kinematics().inverse(angles, self.elbows)?;
        for _ in 0..ITERATIONS {
            let (reached, by_joints) = self.forward(&joints, now)?;
            let mut miss = angles - reached;
            miss.x = wrapped(miss.x);
            if miss.amax() < TOLERANCE_RAD {
                return Ok(joints);
            }
            joints += by_joints.try_inverse().ok_or(Error::Singular)? * miss;
        }
        Err(Error::NotConverged {
            iterations: ITERATIONS,
        })
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
