//! The nominal arm on the measurement chain: with all effects at zero it is the drawing, seen by a tracker.

use super::arm::{JOINTS, Model};
use super::effects::{AT, At, CATALOGUE, PARAMETERS, Values};
use super::structure::Structure;
use crate::chain::effects::Effect;
use crate::chain::places::Places;
use crate::chain::{self, Distances, Gauges, Moments, Robot, Settings, Table, Tracker};
use crate::numbers::rigid::SQUARE;
use crate::{Error, Result};
use core::f64::consts::TAU;
use nalgebra::Vector3;

/// Coordinates that the tracker shows.
pub const READINGS: usize = 3;

/// What a row of an arm brings besides its readings.
pub type Covariates = chain::Covariates<JOINTS>;
/// A row of an arm.
pub type Row = chain::Row<JOINTS>;
/// An arm with given errors and effects, ready to predict.
pub type Chain = chain::Chain<Model, JOINTS, READINGS, PARAMETERS>;
/// Reading of a row with its derivatives, mm.
pub type Prediction = chain::Prediction<JOINTS, READINGS, PARAMETERS>;

impl Model {
    /// From when its instrument drifts, and when it slips.
    pub(crate) fn moments(&self) -> Moments {
        Moments {
            origin_s: self.time_origin_s,
            slip_s: self.sensor_slip_time_s,
        }
    }
}

impl Table for Model {
    type Own = At;
    const CATALOGUE: &'static [Effect] = CATALOGUE;
    const AT: Places<At> = AT;
}

impl Robot<JOINTS, READINGS, PARAMETERS> for Model {
    type Structure = Structure;
    type Sensor = Tracker;
    type Around = Gauges;

    const DISTANCES: Distances = Distances::FromFixed;

    fn joints(&self) -> usize {
        self.count
    }

    fn settings(&self) -> Settings<JOINTS> {
        Settings {
            home: self.joints.map(|joint| joint.home),
            wave: self.encoder_period.map(|period| TAU / period),
            time_origin_s: self.time_origin_s,
            slip_time_s: self.slip_time_s,
            joint_slip_time_s: self.joint_slip_time_s,
        }
    }

    fn check(&self) -> Result<()> {
        let refuse = |limb, what| Err(Error::InvalidGeometry { limb, what });
        let mine = self.joints.get(..self.count).unwrap_or_default();
        if mine.is_empty() {
            return refuse(0, "an arm has one to nine joints");
        }
        for (limb, joint) in mine.iter().enumerate() {
            let numbers = joint.fixed.translation.iter().chain(&joint.centre_mm);
            let mut numbers = numbers.chain([&joint.follows, &joint.home, &joint.mass_kg]);
            if numbers.any(|v| !v.is_finite()) || !joint.fixed.is_proper() {
                return refuse(
                    limb,
                    "the frame of a joint needs finite lengths and right angles",
                );
            }
            if joint.mass_kg < 0.0 {
                return refuse(limb, "no mass is below zero");
            }
        }
        let times = [
            self.time_origin_s,
            self.slip_time_s,
            self.joint_slip_time_s,
            self.sensor_slip_time_s,
        ];
        let points = self.targets_mm.iter().chain(&self.centres_mm);
        let points = points.chain(self.planes.iter().map(|plane| &plane.at));
        let settings = times
            .iter()
            .chain(&self.encoder_period)
            .chain(points.flatten())
            .chain(&self.gravity);
        let mut settings = settings.chain(&self.sensor.translation);
        if let Some(index) = settings.position(|v| !v.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        if !self.sensor.is_proper() {
            return refuse(0, "the pose of the sensor needs right angles");
        }
        if self.encoder_period.iter().any(|period| *period <= 0.0) {
            return refuse(0, "the period of the encoders must be positive");
        }
        // nor is a direction that is not a number
        let is_one = |v: &Vector3<f64>| (v.norm() - 1.0).abs() <= SQUARE;
        if !is_one(&self.gravity) {
            return refuse(0, "gravity needs a direction of length one");
        }
        if !self.planes.iter().all(|plane| is_one(&plane.normal)) {
            return refuse(0, "a plane needs a normal of length one");
        }
        Ok(())
    }

    fn structure(&self, values: &Values) -> Result<Structure> {
        Ok(Structure::new(self, values))
    }

    fn sensor(&self, values: &Values) -> Result<Tracker> {
        Ok(Tracker::new::<Self, PARAMETERS>(
            &self.sensor,
            self.moments(),
            values,
        ))
    }

    fn around(&self, values: &Values) -> Gauges {
        Gauges::new::<Self, PARAMETERS>(&self.centres_mm, &self.planes, values)
    }
}
