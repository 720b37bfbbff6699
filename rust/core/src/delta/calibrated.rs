//! The calibrated robot that a control loop runs: geometry, correction, local model blended into the whole.
//!
//! Positions are those of the measured point, in the frame of the sensors that measured it unless that of the base is asked
//! for: a delta is sent where its instrument sees the tool. Nothing here allocates; an iteration is bounded. NaN input gives
//! [`crate::Error::NotFinite`].

use super::correction::{Correction, Domain};
use super::effects::PARAMETERS;
use super::geometry::LIMBS;
use super::model::{Chain, Covariates, READINGS};
use super::nominal::Model;
use crate::Result;
use crate::chain::effects::Wanted;
use crate::chain::{self, Frame, inverse};
use crate::numbers::rigid::Rigid;
use nalgebra::{Matrix3, Vector3};

/// The inverse takes its last step where the forward model misses by less than this, mm: what the step leaves is the square
/// of it over millimetres, a millionth of the nanometre that is promised.
const NEAR_MM: f64 = 1e-6;

type Trail = chain::Trail<Model, LIMBS, READINGS, PARAMETERS>;

/// Position, its derivative by the joints, and whether they are exact or one of Newton's steps towards it.
type Reached = (Vector3<f64>, Matrix3<f64>, bool);

/// A calibrated model of one region: identified robot with its effects, and what they leave.
#[derive(Clone, Copy, Debug)]
pub struct Branch<'a> {
    /// Identified robot.
    pub chain: Chain,
    /// Correction by where the identified robot says the point is, both in the frame of the base.
    pub correction: Option<Correction<'a>>,
}

impl Branch<'_> {
    /// From the base frame to that of the sensors, before they slip, if ever.
    #[must_use]
    pub fn sensor(&self) -> &Rigid {
        &self.chain.sensor.pose.first().frame
    }

    /// From the base frame to that of the sensors as they stand now.
    ///
    /// # Errors
    /// [`crate::Error::NotFinite`] where they slip and the time is not known.
    pub fn sensor_at(&self, now: &Covariates) -> Result<&Rigid> {
        Ok(&self.chain.sensor.pose.at_time(now.time_s)?.frame)
    }

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
        let sensor = self.sensor_at(now)?;
        Ok(self.corrected(predicted.value, predicted.by_joints, sensor))
    }

    /// [`Self::forward`] from the pose that `trail` remembers, and whether it is solved to the end.
    fn forward_near(
        &self,
        joints: &Vector3<f64>,
        now: &Covariates,
        trail: &mut Trail,
    ) -> Result<Reached> {
        let settled = self.chain.predict_near(joints, now, trail)?;
        let predicted = &trail.prediction;
        let sensor = self.sensor_at(now)?;
        let (position, by_joints) = self.corrected(predicted.value, predicted.by_joints, sensor);
        Ok((position, by_joints, settled))
    }

    fn corrected(
        &self,
        position: Vector3<f64>,
        by_joints: Matrix3<f64>,
        sensor: &Rigid,
    ) -> (Vector3<f64>, Matrix3<f64>) {
        match &self.correction {
            None => (position, by_joints),
            Some(correction) => {
                let (shift, by_place) = correction.at(&sensor.apply_inverse(&position));
                let by_position = sensor.rotation * by_place * sensor.rotation.transpose();
                (
                    position + sensor.rotation * shift,
                    by_joints + by_position * by_joints,
                )
            }
        }
    }
}

/// A calibrated robot: one model for the whole workspace and perhaps a better one inside a region.
#[derive(Clone, Copy, Debug)]
pub struct Calibrated<'a> {
    /// Model of the whole workspace.
    pub whole: Branch<'a>,
    /// Model of the region of interest, where in the frame of the base it holds, and the width of the blend around it.
    pub local: Option<(Branch<'a>, Domain)>,
    /// The frame of positions.
    pub frame: Frame,
}

impl Calibrated<'_> {
    /// The same robot with positions in a frame.
    #[must_use]
    pub fn in_frame(self, frame: Frame) -> Self {
        Self { frame, ..self }
    }

    /// From the base frame to that of the sensors, by the model of the whole workspace, before they slip, if ever.
    #[must_use]
    pub fn sensor(&self) -> &Rigid {
        self.whole.sensor()
    }

    /// [`Self::sensor`] as they stand now.
    ///
    /// # Errors
    /// As [`Branch::sensor_at`].
    pub fn sensor_at(&self, now: &Covariates) -> Result<&Rigid> {
        self.whole.sensor_at(now)
    }

    /// Position for joint readings, and its derivative by them.
    ///
    /// # Errors
    /// As [`Chain::predict`].
    pub fn forward(
        &self,
        joints: &Vector3<f64>,
        now: &Covariates,
    ) -> Result<(Vector3<f64>, Matrix3<f64>)> {
        let (seen, by_joints) = self.seen(joints, now)?;
        Ok(match self.frame {
            Frame::Sensor => (seen, by_joints),
            Frame::Base => {
                let sensor = self.sensor_at(now)?;
                let back = sensor.rotation.transpose();
                (sensor.apply_inverse(&seen), back * by_joints)
            }
        })
    }

    /// [`Self::forward`] in the frame of the sensors.
    fn seen(
        &self,
        joints: &Vector3<f64>,
        now: &Covariates,
    ) -> Result<(Vector3<f64>, Matrix3<f64>)> {
        self.blended(now, |branch, _| {
            let (position, by_joints) = branch.forward(joints, now)?;
            Ok((position, by_joints, true))
        })
        .map(|(position, by_joints, _)| (position, by_joints))
    }

    /// What the whole model and, where it holds, the local one reach, with the derivative by the joints, and
    /// whether both are exact.
    fn blended(
        &self,
        now: &Covariates,
        mut reach: impl FnMut(&Branch<'_>, bool) -> Result<Reached>,
    ) -> Result<Reached> {
        let (position, by_joints, settled) = reach(&self.whole, false)?;
        let Some((local, region)) = &self.local else {
            return Ok((position, by_joints, settled));
        };
        let sensor = self.sensor_at(now)?;
        let (share, gradient) = region.share(&sensor.apply_inverse(&position));
        if share == 0.0 {
            return Ok((position, by_joints, settled));
        }
        let (inner, inner_by_joints, also) = reach(local, true)?;
        let difference = inner - position;
        Ok((
            position + difference * share,
            by_joints
                + (inner_by_joints - by_joints) * share
                + difference * ((sensor.rotation * gradient).transpose() * by_joints),
            settled && also,
        ))
    }

    /// Joint readings at which the calibrated forward model gives `position`, to 1 nm or better.
    ///
    /// # Errors
    /// [`crate::Error::OutOfReach`] names limb and distance; [`crate::Error::NotConverged`] where the model folds over.
    pub fn inverse(&self, position: &Vector3<f64>, now: &Covariates) -> Result<Vector3<f64>> {
        let position = &match self.frame {
            Frame::Sensor => *position,
            Frame::Base => self.sensor_at(now)?.apply(position),
        };
        let start = self.whole.chain.rough_inverse(position)?;
        let (mut of_whole, mut of_local) = (Trail::new(), Trail::new());
        let miss = |joints: &Vector3<f64>| {
            let (reached, by_joints, settled) = self.blended(now, |branch, is_local| {
                let trail = if is_local {
                    &mut of_local
                } else {
                    &mut of_whole
                };
                branch.forward_near(joints, now, trail)
            })?;
            Ok((position - reached, by_joints, settled))
        };
        let again = |joints: &Vector3<f64>| Ok(position - self.seen(joints, now)?.0);
        inverse(start, miss, again, |missed| missed.norm() < NEAR_MM)
    }
}

impl Chain {
    /// Joint readings near those that bring the measured point to a reading: effects but lean left out.
    ///
    /// # Errors
    /// As [`super::Kinematics::inverse`].
    pub fn rough_inverse(&self, reading: &Vector3<f64>) -> Result<Vector3<f64>> {
        self.structure
            .rough_inverse(&self.sensor.pose.first().frame.apply_inverse(reading))
    }
}
