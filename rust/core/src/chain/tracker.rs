//! A sensor that shows coordinates in a frame of its own: a laser tracker, a stereo camera, a measuring arm.

use super::body::since;
use super::effects::{Wanted, values_of};
use super::sensor::{Look, Sensor};
use super::table::Table;
use crate::camera::{left_jacobian, rotation_matrix};
use crate::numbers::rigid::Rigid;
use crate::{Error, Result};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// The cubic error of a tracker is named by its size this far from its middle, mm.
pub const SPAN_MM: f64 = 1000.0;

/// A tracker with the errors of where it stands, of its scale, and of its straightness.
#[derive(Clone, Copy, Debug)]
pub struct Tracker {
    stand: Stand,
    /// From the moment of the slip on, where it slips.
    slipped: Option<Stand>,
    slip_time_s: f64,
    scale: f64,
    linearity: Vector3<f64>,
}

/// Where it stands: from the base frame to its own, and the turn that is its error, rad.
#[derive(Clone, Copy, Debug)]
struct Stand {
    frame: Rigid,
    turn: Vector3<f64>,
}

impl Stand {
    /// The picture of the robot turned about the tracker's own axes, then shifted.
    fn new(nominal: &Rigid, pose: &[f64; 6]) -> Self {
        let turn = Vector3::new(pose[0], pose[1], pose[2]);
        let shift = Vector3::new(pose[3], pose[4], pose[5]);
        let frame = Rigid {
            rotation: rotation_matrix(&turn) * nominal.rotation,
            translation: nominal.translation + shift,
        };
        Self { frame, turn }
    }
}

impl Tracker {
    /// A tracker with the effects that a robot has; it slips at a moment, s.
    pub(crate) fn new<T: Table, const P: usize>(
        nominal: &Rigid,
        slip_time_s: f64,
        values: &[f64; P],
    ) -> Self {
        let at = T::AT.tracker;
        let mut pose: [f64; 6] = values_of(at.tracker_frame, values);
        let stand = Stand::new(nominal, &pose);
        let slip: [f64; 6] = values_of(at.tracker_slip, values);
        let slipped = (slip != [0.0; 6]).then(|| {
            pose.iter_mut().zip(slip).for_each(|(p, s)| *p += s);
            Stand::new(nominal, &pose)
        });
        let [scale] = values_of(at.sensor_scale, values);
        Self {
            stand,
            slipped,
            slip_time_s,
            scale,
            linearity: Vector3::from(values_of::<3, P>(at.sensor_linearity, values)),
        }
    }

    /// As it stands at the time of a reading.
    fn at(&self, look: Look) -> Result<&Stand> {
        match &self.slipped {
            Some(_) if look.time_s.is_nan() => Err(Error::NotFinite { index: 0 }),
            Some(slipped) if look.time_s >= self.slip_time_s => Ok(slipped),
            _ => Ok(&self.stand),
        }
    }

    /// What it shows of a point in its frame, and cubes of the coordinates over the span.
    fn shown(&self, seen: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let cubes = (seen / SPAN_MM).map(|t| t * t * t);
        let bent = self.linearity.component_mul(&cubes);
        (seen * (1.0 + self.scale) + bent, cubes)
    }
}

impl Sensor<3> for Tracker {
    #[inline]
    fn value(&self, point: &Vector3<f64>, look: Look) -> Result<SVector<f64, 3>> {
        Ok(self.shown(&self.at(look)?.frame.apply(point)).0)
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
        let stand = self.at(look)?;
        let turned = stand.frame.rotation * point;
        let seen = turned + stand.frame.translation;
        let (value, cubes) = self.shown(&seen);
        let slope = (seen / SPAN_MM).component_mul(&seen) * (3.0 / SPAN_MM / SPAN_MM);
        let steep = self
            .linearity
            .component_mul(&slope)
            .add_scalar(1.0 + self.scale);
        let by_seen = Matrix3::from_diagonal(&steep);
        let (frame, slip) = (
            wanted.wants(at.tracker_frame),
            wanted.wants(at.tracker_slip),
        );
        if frame.is_some() || slip.is_some() {
            let by_turn = -(by_seen * turned.cross_matrix() * left_jacobian(&stand.turn));
            for (place, share) in [(frame, 1.0), (slip, since(look.time_s, self.slip_time_s))] {
                if let Some(place) = place {
                    d.fixed_columns_mut::<3>(place.start)
                        .copy_from(&(by_turn * share));
                    d.fixed_columns_mut::<3>(place.start + 3)
                        .copy_from(&(by_seen * share));
                }
            }
        }
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
