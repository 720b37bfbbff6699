//! The nominal delta on the measurement chain: with all effects at zero it is the paper's model, seen from where the sensors stand.

use super::effects::{AT, At, CATALOGUE, PARAMETERS, Values};
use super::geometry::LIMBS;
use super::nominal::Model;
use super::structure::Structure;
use crate::chain::effects::Effect;
use crate::chain::places::Places;
use crate::chain::{self, Between, Cartesian, Distances, Moments, Robot, Settings, Table};
use crate::{Error, Result};
use core::f64::consts::TAU;

/// Coordinates that the sensors show.
pub const READINGS: usize = 3;

/// What a row of the delta brings besides its readings.
pub type Covariates = chain::Covariates<LIMBS>;
/// A row of the delta.
pub type Row = chain::Row<LIMBS>;
/// A delta with given errors and effects, ready to predict.
pub type Chain = chain::Chain<Model, LIMBS, READINGS, PARAMETERS>;
/// Reading of a row with its derivatives, mm.
pub type Prediction = chain::Prediction<LIMBS, READINGS, PARAMETERS>;

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

impl Robot<LIMBS, READINGS, PARAMETERS> for Model {
    type Structure = Structure;
    type Sensor = Cartesian;
    type Around = Between;
    const DISTANCES: Distances = Distances::BetweenPlaces;

    fn settings(&self) -> Settings<LIMBS> {
        Settings {
            home: self.home,
            wave: self.pole_pitch.map(|pitch| TAU / pitch),
            time_origin_s: self.time_origin_s,
            slip_time_s: self.slip_time_s,
            joint_slip_time_s: self.joint_slip_time_s,
        }
    }

    fn check(&self) -> Result<()> {
        let settings = [
            self.rod_spacing,
            self.time_origin_s,
            self.slip_time_s,
            self.joint_slip_time_s,
            self.sensor_slip_time_s,
        ];
        let settings = settings
            .iter()
            .chain(&self.pole_pitch)
            .chain(&self.home)
            .chain(&self.target_offset);
        let settings = settings.chain(&self.sensor.translation);
        if let Some(index) = settings.clone().position(|v| !v.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        if !self.sensor.is_proper() {
            let what = "the pose of the sensor needs right angles";
            return Err(Error::InvalidGeometry { limb: 0, what });
        }
        if self.pole_pitch.iter().any(|pitch| *pitch <= 0.0) {
            let what = "the period of the encoders must be positive";
            return Err(Error::InvalidGeometry { limb: 0, what });
        }
        Ok(())
    }

    fn structure(&self, values: &Values) -> Result<Structure> {
        Structure::new(self, values)
    }

    fn sensor(&self, values: &Values) -> Result<Cartesian> {
        Ok(Cartesian::new::<Self, PARAMETERS>(
            &self.sensor,
            self.moments(),
            values,
        ))
    }

    fn around(&self, values: &Values) -> Between {
        Between::new::<Self, PARAMETERS>(values)
    }
}
