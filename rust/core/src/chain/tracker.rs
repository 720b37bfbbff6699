//! A sensor that shows coordinates in a frame of its own: a laser tracker, a stereo camera, a measuring arm.

use super::effects::{Wanted, values_of};
use super::robot::checked;
use super::sensor::{Look, Sensor};
use super::sensor_pose::{Moments, SensorPose};
use super::table::Table;
use crate::Result;
use crate::numbers::rigid::Rigid;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// The cubic error of a tracker is named by its size this far from its middle, mm.
pub const SPAN_MM: f64 = 1000.0;

/// A tracker with the errors of where it stands, of its scale, and of its straightness.
#[derive(Clone, Copy, Debug)]
pub struct Tracker {
    pub(crate) pose: SensorPose,
    scale: f64,
    linearity: Vector3<f64>,
}

impl Tracker {
    /// A tracker with the effects that a robot has.
    pub(crate) fn new<T: Table, const P: usize>(
        nominal: &Rigid,
        moments: Moments,
        values: &[f64; P],
    ) -> Self {
        let at = T::AT.tracker;
        let [scale] = values_of(at.sensor_scale, values);
        Self {
            pose: SensorPose::new::<T, P>(nominal, moments, values),
            scale,
            linearity: Vector3::from(values_of::<3, P>(at.sensor_linearity, values)),
        }
    }

    /// As a control loop has it.
    #[must_use]
    pub(crate) fn deployed(self) -> Self {
        Self {
            pose: self.pose.deployed(),
            ..self
        }
    }

    /// What it shows of a point in its frame, and cubes of the coordinates over the span.
    fn shown(&self, seen: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let cubes = (seen / SPAN_MM).map(|t| t * t * t);
        let bent = self.linearity.component_mul(&cubes);
        (seen * (1.0 + self.scale) + bent, cubes)
    }

    /// How that changes with the point in its frame.
    fn by_seen(&self, seen: &Vector3<f64>) -> Matrix3<f64> {
        let slope = (seen / SPAN_MM).component_mul(seen) * (3.0 / SPAN_MM / SPAN_MM);
        let steep = self
            .linearity
            .component_mul(&slope)
            .add_scalar(1.0 + self.scale);
        Matrix3::from_diagonal(&steep)
    }

    /// What it reads of a point of its own frame, and the derivative by that.
    ///
    /// # Errors
    /// [`crate::Error::NotFinite`] where that is no number.
    pub(crate) fn shows(&self, seen: &Vector3<f64>) -> Result<(Vector3<f64>, Matrix3<f64>)> {
        Ok((checked(self.shown(seen).0)?, self.by_seen(seen)))
    }
}

impl Sensor<3> for Tracker {
    #[inline]
    fn value(&self, point: &Vector3<f64>, look: Look) -> Result<SVector<f64, 3>> {
        Ok(self.shown(&self.pose.at(look)?.frame.apply(point)).0)
    }

    #[inline]
    fn predict<T: Table, const P: usize>(
        &self,
        point: &Vector3<f64>,
        look: Look,
        wanted: Wanted,
        d: &mut SMatrix<f64, 3, P>,
    ) -> Result<(SVector<f64, 3>, Matrix3<f64>)> {
        let at = T::AT.tracker;
        let stand = self.pose.at(look)?;
        let turned = stand.frame.rotation * point;
        let seen = turned + stand.frame.translation;
        let (value, cubes) = self.shown(&seen);
        let by_seen = self.by_seen(&seen);
        self.pose
            .columns::<T, 3, P>(&stand, &turned, &by_seen, look, wanted, d);
        if let Some(place) = wanted.wants(at.sensor_scale) {
            d.set_column(place.start, &seen);
        }
        if let Some(place) = wanted.wants(at.sensor_linearity) {
            // a parameter touches its own axis alone: what an earlier row left on the others is cleared
            let mut own = d.fixed_columns_mut::<3>(place.start);
            own.fill(0.0);
            own.set_diagonal(&cubes);
        }
        Ok((value, by_seen * stand.frame.rotation))
    }
}
