//! The calibrated robot that a control loop runs: geometry, correction, local model blended into the whole.
//!
//! Positions are those of the measured point, as the sensors that measured it read it unless the frame of the base is asked
//! for: a delta is sent where its instrument sees the tool. In the frame of the base the robot is where it is, whatever its
//! sensors make of it. Nothing here allocates; an iteration is bounded. NaN input gives
//! [`crate::Error::NotFinite`].

use super::correction::{Correction, Domain};
use super::effects::PARAMETERS;
use super::geometry::LIMBS;
use super::model::{Chain, Covariates, Prediction, READINGS};
use super::nominal::Model;
use crate::Result;
use crate::chain::effects::Wanted;
use crate::chain::{self, Frame, REFERENCE_TEMPERATURE_C, inverse};
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
    chain: Chain,
    correction: Option<Correction<'a>>,
}

impl<'a> Branch<'a> {
    /// An identified robot, and its correction by where that says the point is, both in the frame of the base.
    #[must_use]
    pub fn new(chain: &Chain, correction: Option<Correction<'a>>) -> Self {
        let sensor = chain.sensor.deployed();
        Self {
            chain: Chain { sensor, ..*chain },
            correction,
        }
    }

    /// The identified robot as it is deployed.
    #[must_use]
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// From the base frame to that of the sensors, where they stand at last.
    #[must_use]
    pub fn sensor(&self) -> &Rigid {
        &self.chain.sensor.pose.first().frame
    }

    /// Where the point is seen from where the sensors stand, and its derivative by the joints: as they would read it had they no
    /// errors of their own.
    ///
    /// # Errors
    /// As [`Chain::predict`].
    pub fn seen(
        &self,
        joints: &Vector3<f64>,
        now: &Covariates,
    ) -> Result<(Vector3<f64>, Matrix3<f64>)> {
        let (chain, still, none) = (&self.chain, Vector3::zeros(), Wanted::default());
        let mut out = Prediction::new();
        chain.predict_by(
            &chain.sensor.pose,
            joints,
            &known(now),
            &still,
            0,
            none,
            &mut out,
        )?;
        Ok(self.corrected(out.value, out.by_joints))
    }

    /// [`Self::seen`] from the pose that `trail` remembers, and whether it is solved to the end.
    fn seen_near(
        &self,
        joints: &Vector3<f64>,
        now: &Covariates,
        trail: &mut Trail,
    ) -> Result<Reached> {
        let chain = &self.chain;
        let settled = chain.predict_near(&chain.sensor.pose, joints, &known(now), trail)?;
        let predicted = &trail.prediction;
        let (position, by_joints) = self.corrected(predicted.value, predicted.by_joints);
        Ok((position, by_joints, settled))
    }

    /// What is seen as positions of a frame have it: as the sensors read it, or for the base, where they do not count, as it is.
    fn shown(
        &self,
        frame: Frame,
        seen: Vector3<f64>,
        by_joints: Matrix3<f64>,
    ) -> Result<(Vector3<f64>, Matrix3<f64>)> {
        Ok(match frame {
            Frame::Base => (seen, by_joints),
            Frame::Sensor => {
                let (read, by_seen) = self.chain.sensor.shows(&seen)?;
                (read, by_seen * by_joints)
            }
        })
    }

    fn corrected(
        &self,
        position: Vector3<f64>,
        by_joints: Matrix3<f64>,
    ) -> (Vector3<f64>, Matrix3<f64>) {
        match &self.correction {
            None => (position, by_joints),
            Some(correction) => {
                let sensor = self.sensor();
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

    /// From the base frame to that of the sensors, by the model of the whole workspace, where they stand at last.
    #[must_use]
    pub fn sensor(&self) -> &Rigid {
        self.whole.sensor()
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
        let (shown, by_joints) = self.shown(joints, now)?;
        Ok(match self.frame {
            Frame::Sensor => (shown, by_joints),
            Frame::Base => {
                let sensor = self.sensor();
                let back = sensor.rotation.transpose();
                (sensor.apply_inverse(&shown), back * by_joints)
            }
        })
    }

    /// [`Self::forward`] in the axes of the sensors, and read by them where the frame is theirs.
    fn shown(
        &self,
        joints: &Vector3<f64>,
        now: &Covariates,
    ) -> Result<(Vector3<f64>, Matrix3<f64>)> {
        self.blended(|branch, _| {
            let (position, by_joints) = branch.seen(joints, now)?;
            Ok((position, by_joints, true))
        })
        .map(|(position, by_joints, _)| (position, by_joints))
    }

    /// What the whole model and, where it holds, the local one reach, with the derivative by the joints, and
    /// whether both are exact.
    fn blended(
        &self,
        mut reach: impl FnMut(&Branch<'_>, bool) -> Result<Reached>,
    ) -> Result<Reached> {
        let (seen, by_seen, settled) = reach(&self.whole, false)?;
        let (position, by_joints) = self.whole.shown(self.frame, seen, by_seen)?;
        let Some((local, region)) = &self.local else {
            return Ok((position, by_joints, settled));
        };
        let sensor = self.sensor();
        let (share, gradient) = region.share(&sensor.apply_inverse(&seen));
        if share == 0.0 {
            return Ok((position, by_joints, settled));
        }
        let (inner, by_inner, also) = reach(local, true)?;
        let (inner, inner_by_joints) = local.shown(self.frame, inner, by_inner)?;
        let difference = inner - position;
        Ok((
            position + difference * share,
            by_joints
                + (inner_by_joints - by_joints) * share
                + difference * ((sensor.rotation * gradient).transpose() * by_seen),
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
            Frame::Base => self.sensor().apply(position),
        };
        let start = self.whole.chain.rough_inverse(position)?;
        let (mut of_whole, mut of_local) = (Trail::new(), Trail::new());
        let miss = |joints: &Vector3<f64>| {
            let (reached, by_joints, settled) = self.blended(|branch, is_local| {
                let trail = if is_local {
                    &mut of_local
                } else {
                    &mut of_whole
                };
                branch.seen_near(joints, now, trail)
            })?;
            Ok((position - reached, by_joints, settled))
        };
        let again = |joints: &Vector3<f64>| Ok(position - self.shown(joints, now)?.0);
        inverse(start, miss, again, |missed| missed.norm() < NEAR_MM)
    }
}

/// What a loop knows: not how warm the stands are, on which instrument and robot move apart.
fn known(now: &Covariates) -> Covariates {
    Covariates {
        stand_c: REFERENCE_TEMPERATURE_C,
        ..*now
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
