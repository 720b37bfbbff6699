//! The calibrated arm that a control loop runs. Nothing here allocates; an iteration is bounded.

use super::arm::{JOINTS, Model};
use super::effects::{AT, PARAMETERS, Values};
use super::model::{Chain, Covariates, Prediction};
use super::structure::Structure;
use crate::chain::effects::Wanted;
use crate::chain::{Frame, Mechanism, Robot, Tracker};
use crate::numbers::rigid::Rigid;
use crate::{Error, Result};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// The inverse is iterated until the forward model misses by less than this, mm (a thousandth of the nanometre that is
/// promised).
const INVERSE_TOLERANCE_MM: f64 = 1e-9;
const ITERATIONS: usize = 200;
/// Millimetres of a sliding joint that weigh as much as a radian of a turning one.
const SLIDE_MM: f64 = 500.0;
/// The longest step, rad.
const LONGEST: f64 = 0.5;
/// Damping at the start, and where nothing helps any more, in parts of the mean square of the Jacobian.
const DAMPING: f64 = 1e-2;
const MOST_DAMPING: f64 = 1e8;

/// Lowest and highest reading of each joint, rad or mm.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// The lowest.
    pub low: [f64; JOINTS],
    /// The highest.
    pub high: [f64; JOINTS],
}

/// An identified arm: where its target really is, in the frame of its base, which its programs are written in, unless it is
/// asked for as its tracker reads it. A delay of the tracker is left out: a loop asks where the arm stands.
#[derive(Clone, Copy, Debug)]
pub struct Calibrated {
    chain: Chain,
    tracker: Tracker,
    frame: Frame,
    limits: Limits,
    count: usize,
    /// What a unit of each joint weighs in a step of the inverse; nothing where there is none.
    weights: SVector<f64, JOINTS>,
}

impl Calibrated {
    /// The arm with identified `values`.
    ///
    /// # Errors
    /// As [`Model::with`]; [`Error::InvalidGeometry`] for limits of which the lower is above the higher.
    pub fn new(model: &Model, values: &Values, limits: &Limits) -> Result<Self> {
        let tracker = Tracker::new::<Model, PARAMETERS>(&model.sensor, model.moments(), values);
        let mut values = *values;
        let (pose, at) = (AT.pose, AT.tracker);
        for measured in [
            pose.sensor_pose,
            pose.sensor_slip,
            pose.sensor_drift,
            at.sensor_scale,
            at.sensor_linearity,
            AT.joints.reading_delay,
            AT.bar.bar_zero,
        ] {
            for value in measured
                .and_then(|place| values.get_mut(place.range()))
                .unwrap_or_default()
            {
                *value = 0.0;
            }
        }
        let own = Model {
            sensor: Rigid::identity(),
            ..*model
        };
        let chain = own.with(&values)?;
        let mut weights = SVector::zeros();
        for (i, joint) in model.joints.iter().enumerate().take(model.count) {
            if limits.low[i].is_nan() || limits.high[i].is_nan() || limits.low[i] > limits.high[i] {
                let what = "the lowest reading of a joint is not above its highest";
                return Err(Error::InvalidGeometry { limb: i, what });
            }
            weights[i] = if joint.prismatic {
                SLIDE_MM * SLIDE_MM
            } else {
                1.0
            };
        }
        Ok(Self {
            chain,
            tracker: tracker.deployed(),
            frame: Frame::Base,
            limits: *limits,
            count: model.count,
            weights,
        })
    }

    /// How many joints it has.
    #[must_use]
    pub fn joints(&self) -> usize {
        self.count.min(JOINTS)
    }

    /// The same arm with places in a frame.
    #[must_use]
    pub fn in_frame(self, frame: Frame) -> Self {
        Self { frame, ..self }
    }

    /// From the base frame to that of the sensor, where it stands at last.
    #[must_use]
    pub fn sensor(&self) -> &Rigid {
        &self.tracker.pose.first().frame
    }

    /// Where the target is, mm, with its derivative by the joints.
    ///
    /// # Errors
    /// As [`Chain::value`].
    pub fn forward(
        &self,
        joints: &SVector<f64, JOINTS>,
        now: &Covariates,
    ) -> Result<(Vector3<f64>, SMatrix<f64, 3, JOINTS>)> {
        let (place, by_joints) = self.at_base(joints, now)?;
        Ok(match self.frame {
            Frame::Base => (place, by_joints),
            Frame::Sensor => {
                let sensor = self.sensor();
                let (read, by_seen) = self.tracker.shows(&sensor.apply(&place))?;
                (read, by_seen * sensor.rotation * by_joints)
            }
        })
    }

    /// [`Self::forward`] in the frame of the base.
    fn at_base(
        &self,
        joints: &SVector<f64, JOINTS>,
        now: &Covariates,
    ) -> Result<(Vector3<f64>, SMatrix<f64, 3, JOINTS>)> {
        let found = self.predict(joints, now, Wanted::NONE)?;
        Ok((found.value, found.by_joints))
    }

    /// What it predicts in the frame of the base, with derivatives by wanted parameters, for the account of accuracy.
    ///
    /// # Errors
    /// As [`Chain::value`].
    #[inline]
    pub fn predict(
        &self,
        joints: &SVector<f64, JOINTS>,
        now: &Covariates,
        wanted: Wanted,
    ) -> Result<Prediction> {
        self.chain.predict(joints, now, &Vector3::zeros(), wanted)
    }

    /// The turn of the frame behind the last joint.
    ///
    /// # Errors
    /// As [`Chain::value`].
    pub fn flange(&self, joints: &SVector<f64, JOINTS>, now: &Covariates) -> Result<Matrix3<f64>> {
        let turned = self.chain.joints.at::<Model>(joints, now, Wanted::NONE);
        let solved = self.chain.structure.solve_at(&turned.value, now)?;
        Ok(Structure::flange(&solved))
    }

    /// Joint readings within the limits at which the target is at `place`, to 1 nm or better: those to which the smallest
    /// steps lead from `start` (Levenberg's damping; Nakamura and Hanafusa, "Inverse kinematic solutions with
    /// singularity robustness for robot manipulator control", 1986).
    ///
    /// # Errors
    /// [`Error::TargetOutOfReach`] says how near it comes; as [`Self::forward`].
    pub fn inverse(
        &self,
        place: &Vector3<f64>,
        start: &SVector<f64, JOINTS>,
        now: &Covariates,
    ) -> Result<SVector<f64, JOINTS>> {
        if let Some(index) = place.iter().chain(start).position(|v| !v.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        let mut joints = self.within(start);
        let (mut reached, mut by_joints) = self.forward(&joints, now)?;
        let mut damping = DAMPING;
        for _ in 0..ITERATIONS {
            let missed = place - reached;
            let miss_mm = missed.norm();
            if miss_mm < INVERSE_TOLERANCE_MM {
                return Ok(joints);
            }
            if damping > MOST_DAMPING {
                return Err(Error::TargetOutOfReach { miss_mm });
            }
            let trial = self.within(&(joints + self.step(&joints, &by_joints, &missed, damping)));
            let (there, slope) = self.forward(&trial, now)?;
            if (place - there).norm() < miss_mm {
                (joints, reached, by_joints) = (trial, there, slope);
                damping *= 0.1;
            } else {
                damping = (10.0 * damping).max(1e-9);
            }
        }
        Err(Error::TargetOutOfReach {
            miss_mm: (place - reached).norm(),
        })
    }

    /// A damped step towards what is missed. Joints that stand at a limit and would pass it stay there.
    fn step(
        &self,
        joints: &SVector<f64, JOINTS>,
        by_joints: &SMatrix<f64, 3, JOINTS>,
        missed: &Vector3<f64>,
        damping: f64,
    ) -> SVector<f64, JOINTS> {
        let mut weights = self.weights;
        let mut step = SVector::zeros();
        for _ in 0..self.joints() {
            let weighted = SMatrix::<f64, JOINTS, JOINTS>::from_diagonal(&weights);
            let back = weighted * by_joints.transpose();
            let mut square = by_joints * back;
            let mean = square.trace() / 3.0;
            for k in 0..3 {
                square[(k, k)] += damping * mean;
            }
            let Some(inverse) = square.try_inverse() else {
                return SVector::zeros();
            };
            step = back * inverse * missed;
            let mut freed = false;
            for i in 0..self.joints() {
                let beyond = joints[i] + step[i];
                let stuck = (joints[i] <= self.limits.low[i] && beyond < self.limits.low[i])
                    || (joints[i] >= self.limits.high[i] && beyond > self.limits.high[i]);
                if stuck && weights[i] > 0.0 {
                    weights[i] = 0.0;
                    freed = true;
                }
            }
            if !freed {
                break;
            }
        }
        let mut longest = 0.0_f64;
        for i in 0..self.joints() {
            if self.weights[i] > 0.0 {
                longest = longest.max(step[i].abs() / libm::sqrt(self.weights[i]));
            }
        }
        if longest > LONGEST {
            step *= LONGEST / longest;
        }
        step
    }

    fn within(&self, joints: &SVector<f64, JOINTS>) -> SVector<f64, JOINTS> {
        SVector::from_fn(|i, _| {
            if i < self.count {
                joints[i].max(self.limits.low[i]).min(self.limits.high[i])
            } else {
                0.0
            }
        })
    }
}
