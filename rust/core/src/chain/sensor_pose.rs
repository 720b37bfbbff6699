//! The sensor's pose: from the base of the robot to the instrument (the *robot–world* transform of hand–eye calibration;
//! Shah, Eastman, Hong, "An overview of robot-sensor calibration methods", 2012).
//!
//! `seen = exp(turn) R₀ x + t₀ + shift`: the picture of the robot is turned about the instrument's own axes, then shifted;
//! the place where the origin of the base is seen stays where it turns. It may change once, at a moment: a stand is knocked;
//! and steadily, while a tripod settles.

use super::body::{hours, since};
use super::effects::{Wanted, values_of};
use super::sensor::{Look, Sensor};
use super::table::Table;
use crate::camera::{left_jacobian, rotation_matrix};
use crate::numbers::rigid::Rigid;
use crate::{Error, Result};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// Where an instrument stands, with what a robot's table has of it.
#[derive(Clone, Copy, Debug)]
pub struct SensorPose {
    nominal: Rigid,
    off: [f64; 6],
    slip: [f64; 6],
    rate: [f64; 6],
    moments: Moments,
    /// Before it slips or drifts, and after the slip.
    first: Stand,
    slipped: Stand,
}

/// Time from which the drift of an instrument counts, and moment of its slip, s.
#[derive(Clone, Copy, Debug)]
pub struct Moments {
    pub(crate) origin_s: f64,
    pub(crate) slip_s: f64,
}

/// One place to stand: from the base frame to the instrument's, and the turn by which it is off the nominal one.
#[derive(Clone, Copy, Debug)]
pub struct Stand {
    /// From the base frame to that of the instrument.
    pub frame: Rigid,
    by_turn: Matrix3<f64>,
}

/// A pose that does not change.
const STILL: [f64; 6] = [0.0; 6];

/// A pose changed by a share of another.
fn sum(off: &[f64; 6], by: &[f64; 6], share: f64) -> [f64; 6] {
    core::array::from_fn(|k| off[k] + share * by[k])
}

impl Stand {
    fn new(nominal: &Rigid, off: &[f64; 6]) -> Self {
        let turn = Vector3::new(off[0], off[1], off[2]);
        let shift = Vector3::new(off[3], off[4], off[5]);
        Self {
            frame: Rigid {
                rotation: rotation_matrix(&turn) * nominal.rotation,
                translation: nominal.translation + shift,
            },
            by_turn: left_jacobian(&turn),
        }
    }

    /// By which vectors a small change of each component of the turn turns what is seen.
    pub(crate) fn axes(&self) -> &Matrix3<f64> {
        &self.by_turn
    }
}

impl SensorPose {
    /// The pose with the errors that a robot has.
    pub(crate) fn new<T: Table, const P: usize>(
        nominal: &Rigid,
        moments: Moments,
        values: &[f64; P],
    ) -> Self {
        let at = T::AT.pose;
        let off = values_of(at.sensor_pose, values);
        let slip = values_of(at.sensor_slip, values);
        let first = Stand::new(nominal, &off);
        Self {
            nominal: *nominal,
            off,
            slip,
            rate: values_of(at.sensor_drift, values),
            moments,
            first,
            slipped: if slip == STILL {
                first
            } else {
                Stand::new(nominal, &sum(&off, &slip, 1.0))
            },
        }
    }

    /// As a control loop has it, at all times: what a loop is told, it is told after the run, when the stand has long been
    /// knocked, and nobody sends a robot to where an instrument would have seen it before, or sees it when it has drifted.
    /// So a loop needs no time for it.
    #[must_use]
    pub(crate) fn deployed(self) -> Self {
        Self {
            off: sum(&self.off, &self.slip, 1.0),
            slip: STILL,
            rate: STILL,
            first: self.slipped,
            ..self
        }
    }

    /// Before it slips or drifts, if ever.
    pub(crate) fn first(&self) -> &Stand {
        &self.first
    }

    /// Whether it is the same at all times, and no derivative by a slip or a drift is wanted.
    pub(crate) fn stays<T: Table>(&self, wanted: Wanted) -> bool {
        let at = T::AT.pose;
        self.slip == STILL
            && self.rate == STILL
            && wanted.wants(at.sensor_slip).is_none()
            && wanted.wants(at.sensor_drift).is_none()
    }

    /// Where it stands at the time of a reading.
    ///
    /// # Errors
    /// [`Error::NotFinite`] where it slips or drifts and the time is not known.
    pub(crate) fn at(&self, look: Look) -> Result<Stand> {
        if self.slip == STILL && self.rate == STILL {
            return Ok(self.first);
        }
        if look.time_s.is_nan() {
            return Err(Error::NotFinite { index: 0 });
        }
        let slipped = look.time_s >= self.moments.slip_s;
        if self.rate == STILL {
            return Ok(if slipped { self.slipped } else { self.first });
        }
        let share = f64::from(u8::from(slipped));
        let off = sum(&self.off, &self.slip, share);
        let drifted = hours(look.time_s, self.moments.origin_s);
        Ok(Stand::new(&self.nominal, &sum(&off, &self.rate, drifted)))
    }

    /// Writes the wanted columns: `turned` is the point turned and not shifted, `by_seen` what the instrument makes of a
    /// change of what it sees.
    #[inline]
    pub(crate) fn columns<T: Table, const M: usize, const P: usize>(
        &self,
        stand: &Stand,
        turned: &Vector3<f64>,
        by_seen: &SMatrix<f64, M, 3>,
        look: Look,
        wanted: Wanted,
        d: &mut SMatrix<f64, M, P>,
    ) {
        let at = T::AT.pose;
        let shares = [
            (at.sensor_pose, 1.0),
            (at.sensor_slip, since(look.time_s, self.moments.slip_s)),
            (at.sensor_drift, hours(look.time_s, self.moments.origin_s)),
        ];
        if !shares.iter().any(|(own, _)| wanted.wants(*own).is_some()) {
            return;
        }
        let by_turn = -(by_seen * turned.cross_matrix() * stand.by_turn);
        for (own, share) in shares {
            if let Some(place) = wanted.wants(own) {
                d.fixed_columns_mut::<3>(place.start)
                    .copy_from(&(by_turn * share));
                d.fixed_columns_mut::<3>(place.start + 3)
                    .copy_from(&(by_seen * share));
            }
        }
    }
}

/// An instrument without errors of its own: it shows points as they are seen from where it stands.
impl Sensor<3> for SensorPose {
    #[inline]
    fn value(&self, point: &Vector3<f64>, look: Look) -> Result<SVector<f64, 3>> {
        Ok(self.at(look)?.frame.apply(point))
    }

    #[inline]
    fn predict<T: Table, const P: usize>(
        &self,
        point: &Vector3<f64>,
        look: Look,
        wanted: Wanted,
        d: &mut SMatrix<f64, 3, P>,
    ) -> Result<(SVector<f64, 3>, Matrix3<f64>)> {
        let stand = self.at(look)?;
        let turned = stand.frame.rotation * point;
        let straight = Matrix3::identity();
        self.columns::<T, 3, P>(&stand, &turned, &straight, look, wanted, d);
        Ok((turned + stand.frame.translation, stand.frame.rotation))
    }
}
