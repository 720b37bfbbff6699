//! The calibrated robot that a control loop runs: geometry, correction, local model blended into the whole.
//!
//! Positions are those of the measured point in the frame of the measurement (datum included). Nothing here
//! allocates; an iteration is bounded. NaN input gives [`Error::NotFinite`].

use crate::bernstein::{Correction, Domain};
use crate::delta::{Kinematics, Predictor};
use crate::{Error, Result};
use nalgebra::{Matrix3, Vector3};

/// The inverse is iterated until the forward model misses by less than this, mm (a thousandth of the
/// nanometre that is promised).
const INVERSE_TOLERANCE_MM: f64 = 1e-9;
const INVERSE_ITERATIONS: usize = 30;

/// A calibrated model of one region: identified geometry and what it leaves.
#[derive(Clone, Copy, Debug)]
pub struct Branch<'a> {
    /// Identified robot.
    pub predictor: Predictor,
    /// Correction by where the identified robot says the point is.
    pub correction: Option<Correction<'a>>,
}

impl Branch<'_> {
    /// Position and its derivative by the joints.
    ///
    /// # Errors
    /// As [`Kinematics::pose`].
    pub fn forward(&self, joints: &Vector3<f64>) -> Result<(Vector3<f64>, Matrix3<f64>)> {
        let pose = self.predictor.kinematics.pose(joints)?;
        let position = pose.position + self.predictor.shift;
        let by_joints = pose.by_joints();
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
    /// As [`Kinematics::pose`].
    pub fn forward(&self, joints: &Vector3<f64>) -> Result<(Vector3<f64>, Matrix3<f64>)> {
        let (position, by_joints) = self.whole.forward(joints)?;
        let Some((local, region)) = &self.local else {
            return Ok((position, by_joints));
        };
        let (share, gradient) = region.share(&position);
        if share == 0.0 {
            return Ok((position, by_joints));
        }
        let (inner, inner_by_joints) = local.forward(joints)?;
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
    /// [`Error::OutOfReach`] names limb and distance; [`Error::NotConverged`] where the model folds over.
    pub fn inverse(&self, position: &Vector3<f64>) -> Result<Vector3<f64>> {
        let kinematics: &Kinematics = &self.whole.predictor.kinematics;
        let mut joints = kinematics.inverse(&(position - self.whole.predictor.shift))?;
        for _ in 0..INVERSE_ITERATIONS {
            let (reached, by_joints) = self.forward(&joints)?;
            let miss = position - reached;
            if miss.norm() < INVERSE_TOLERANCE_MM {
                return Ok(joints);
            }
            joints += by_joints.try_inverse().ok_or(Error::Singular)? * miss;
        }
        Err(Error::NotConverged {
            iterations: INVERSE_ITERATIONS,
        })
    }
}
