//! The calibrated robot that a control loop runs: geometry, correction, local model blended into the whole.
//!
//! Positions are those of the measured point in the frame of the measurement (datum included). Nothing here
//! allocates; an iteration is bounded. NaN input gives [`crate::Error::NotFinite`].

use super::correction::{Correction, Domain};
use super::model::{Chain, Covariates};
use crate::Result;
use crate::chain::effects::Wanted;
use crate::chain::inverse;
use nalgebra::{Matrix3, Vector3};

/// The inverse is iterated until the forward model misses by less than this, mm (a thousandth of the
/// nanometre that is promised).
const INVERSE_TOLERANCE_MM: f64 = 1e-9;

/// A calibrated model of one region: identified robot with its effects, and what they leave.
#[derive(Clone, Copy, Debug)]
pub struct Branch<'a> {
    /// Identified robot.
    pub chain: Chain,
    /// Correction by where the identified robot says the point is.
    pub correction: Option<Correction<'a>>,
}

impl Branch<'_> {
    /// Position and its derivative by the joints.
    ///
    /// # Errors
    /// As [`Chain::predict`].
    pub fn forward(
        &self,
        joints: &Vector3<f64>,
        now: &Covariates,
    ) -> Result<(Vector3<f64>, Matrix3<f64>)> {
        let still = Vector3::zeros();
        let predicted = self.chain.predict(joints, now, &still, Wanted::default())?;
        let (position, by_joints) = (predicted.value, predicted.by_joints);
        Ok(match &self.correction {
            None => (position, by_joints),
            Some(correction) => {
                let (shift, by_position) = correction.at(&position);
                (position + shift, by_joints + by_position * by_joints)
            }
        })
    }
}

/// A calibrated robot: one model for the whole workspace and perhaps a better one inside a region.
#[derive(Clone, Copy, Debug)]
pub struct Calibrated<'a> {
    /// Model of the whole workspace.
    pub whole: Branch<'a>,
    /// Model of the region of interest, where it holds, and the width of the blend around it.
    pub local: Option<(Branch<'a>, Domain)>,
}

impl Calibrated<'_> {
    /// Position for joint readings, and its derivative by them.
    ///
    /// # Errors
    /// As [`Chain::predict`].
    pub fn forward(
        &self,
        joints: &Vector3<f64>,
        now: &Covariates,
    ) -> Result<(Vector3<f64>, Matrix3<f64>)> {
        let (position, by_joints) = self.whole.forward(joints, now)?;
        let Some((local, region)) = &self.local else {
            return Ok((position, by_joints));
        };
        let (share, gradient) = region.share(&position);
        if share == 0.0 {
            return Ok((position, by_joints));
        }
        let (inner, inner_by_joints) = local.forward(joints, now)?;
        let difference = inner - position;
        Ok((
            position + difference * share,
            by_joints
                + (inner_by_joints - by_joints) * share
                + difference * (gradient.transpose() * by_joints),
        ))
    }

    /// Joint readings at which the calibrated forward model gives `position`, to 1 nm or better.
    ///
    /// # Errors
    /// [`crate::Error::OutOfReach`] names limb and distance; [`crate::Error::NotConverged`] where the model folds over.
    pub fn inverse(&self, position: &Vector3<f64>, now: &Covariates) -> Result<Vector3<f64>> {
        let start = self.whole.chain.rough_inverse(position)?;
        let miss = |joints: &Vector3<f64>| {
            let (reached, by_joints) = self.forward(joints, now)?;
            Ok((position - reached, by_joints))
        };
        inverse(start, miss, |missed| missed.norm() < INVERSE_TOLERANCE_MM)
    }
}

impl Chain {
    /// Joint readings near those that bring the measured point to a reading: effects but lean and datum left out.
    ///
    /// # Errors
    /// As [`super::Kinematics::inverse`].
    pub fn rough_inverse(&self, reading: &Vector3<f64>) -> Result<Vector3<f64>> {
        self.structure.rough_inverse(&(reading - self.sensor.datum))
    }
}
