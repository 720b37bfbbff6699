//! The nominal spherical robot on the measurement chain: with all effects at zero it is the paper's model, a marker on
//! the tool axis, on a sphere about the remote centre, seen by the nominal camera.

use super::effects::{AT, At, CATALOGUE, PARAMETERS, Values};
use super::geometry::LIMBS;
use super::nominal::{Model, Readings};
use super::structure::Structure;
use crate::camera::{Camera, Face};
use crate::chain::effects::{Effect, Wanted};
use crate::chain::places::Places;
use crate::chain::{self, Angles, Eye, Look, Moments, Robot, Sensor, Settings, Table};
use crate::{Error, Result};
use core::f64::consts::TAU;
use nalgebra::{Matrix2x3, SMatrix, Vector2, Vector3};

/// Numbers that a reading has.
pub const READINGS: usize = 2;

/// What a row of the spherical robot brings besides its readings.
pub type Covariates = chain::Covariates<LIMBS>;
/// A row of the spherical robot.
pub type Row = chain::Row<LIMBS>;
/// A spherical robot with given errors and effects, ready to predict.
pub type Chain = chain::Chain<Model, LIMBS, READINGS, PARAMETERS>;
/// Reading of a row with its derivatives, px or rad.
pub type Prediction = chain::Prediction<LIMBS, READINGS, PARAMETERS>;

/// What the robot is measured with.
#[derive(Clone, Copy, Debug)]
#[allow(clippy::large_enum_variant, reason = "nothing is allocated here")]
pub enum Instrument {
    /// A camera, and the side of the sphere that it sees.
    Camera(Eye, Face),
    /// Vision has been applied already.
    Angles(Angles),
}

impl Sensor<READINGS> for Instrument {
    #[inline]
    fn value(&self, point: &Vector3<f64>, look: Look) -> Result<Vector2<f64>> {
        match self {
            Self::Camera(eye, _) => eye.value(point, look),
            Self::Angles(angles) => angles.value(point, look),
        }
    }

    #[inline]
    fn predict<T: Table, const P: usize>(
        &self,
        point: &Vector3<f64>,
        look: Look,
        wanted: Wanted,
        d: &mut SMatrix<f64, READINGS, P>,
    ) -> Result<(Vector2<f64>, Matrix2x3<f64>)> {
        match self {
            Self::Camera(eye, _) => eye.predict::<T, P>(point, look, wanted, d),
            Self::Angles(angles) => angles.predict::<T, P>(point, look, wanted, d),
        }
    }
}

impl Model {
    /// From when its instrument drifts, and when it slips.
    pub(crate) fn moments(&self) -> Moments {
        Moments {
            origin_s: self.time_origin_s,
            slip_s: self.sensor_slip_time_s,
        }
    }

    /// The camera with its errors.
    ///
    /// # Errors
    /// As [`Camera::new`].
    pub fn camera(&self, values: &Values) -> Result<Camera> {
        Ok(*Eye::new::<Self, PARAMETERS>(&self.camera, self.moments(), values)?.camera())
    }
}

impl Table for Model {
    type Own = At;
    const CATALOGUE: &'static [Effect] = CATALOGUE;
    const AT: Places<At> = AT;
}

impl Robot<LIMBS, READINGS, PARAMETERS> for Model {
    type Structure = Structure;
    type Sensor = Instrument;
    type Around = ();

    fn settings(&self) -> Settings<LIMBS> {
        Settings {
            home: self.home,
            wave: self.encoder_period.map(|period| TAU / period),
            time_origin_s: self.time_origin_s,
            slip_time_s: self.slip_time_s,
            joint_slip_time_s: self.joint_slip_time_s,
        }
    }

    fn check(&self) -> Result<()> {
        let times = [
            self.time_origin_s,
            self.slip_time_s,
            self.joint_slip_time_s,
            self.sensor_slip_time_s,
        ];
        let mut settings = self
            .home
            .iter()
            .chain(&self.encoder_period)
            .chain(&self.gravity)
            .chain(&times);
        if let Some(index) = settings.position(|v| !v.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        if self.encoder_period.iter().any(|period| *period <= 0.0) {
            let what = "the period of the encoders must be positive";
            return Err(Error::InvalidGeometry { limb: 0, what });
        }
        let norm = self.gravity.norm();
        if !(norm > 0.0 && norm.is_finite()) {
            let what = "gravity needs a direction";
            return Err(Error::InvalidGeometry { limb: 0, what });
        }
        Ok(())
    }

    fn structure(&self, values: &Values) -> Result<Structure> {
        Structure::new(self, values)
    }

    fn sensor(&self, values: &Values) -> Result<Instrument> {
        Ok(match self.readings {
            Readings::Pixels => {
                let eye = Eye::new::<Self, PARAMETERS>(&self.camera, self.moments(), values)?;
                Instrument::Camera(eye, self.face)
            }
            Readings::Angles => Instrument::Angles(Angles::new::<Self, PARAMETERS>(values)),
        })
    }

    fn around(&self, _: &Values) {}
}
