//! A sensor that shows coordinates: three lasers on a cube.
//!
//! `r = (1 + B) s` is what straight sensors show of the point `s` as it is seen from the sensor's pose; sensors that bend
//! show `r + c (r / span)³`. A scale bends about its own zero, wherever that lies in the workspace.

use super::columns::Columns;
use super::effects::{Wanted, values_of};
use super::robot::checked;
use super::sensor::{Look, Sensor};
use super::sensor_pose::{Moments, SensorPose};
use super::table::Table;
use crate::Result;
use crate::numbers::math::{Real, Triple, cross, dot, scale};
use crate::numbers::rigid::Rigid;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// The cubic error of a sensor is named by its size this far from its zero, mm.
pub const LINEARITY_SPAN_MM: f64 = 20.0;

/// Where it stands, beams that are not square, sensors that bend away from the straight line.
#[derive(Clone, Copy, Debug)]
pub struct Cartesian {
    pub(crate) pose: SensorPose,
    beams: Matrix3<f64>,
    linearity: Vector3<f64>,
}

/// What straight sensors show of a point: cubes of their readings over the span, and how they steepen.
struct Seen {
    value: Vector3<f64>,
    cubes: Vector3<f64>,
    steep: Vector3<f64>,
}

impl Cartesian {
    /// The instrument with the effects that a robot has, where it stands.
    pub(crate) fn new<T: Table, const P: usize>(
        nominal: &Rigid,
        moments: Moments,
        values: &[f64; P],
    ) -> Self {
        let at = T::AT.cartesian;
        Self {
            pose: SensorPose::new::<T, P>(nominal, moments, values),
            beams: Matrix3::from_row_slice(&values_of::<9, P>(at.beam_alignment, values)),
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

    #[inline]
    fn seen(&self, point: &Vector3<f64>) -> Seen {
        let value = point + self.beams * point;
        let mut cubes = Vector3::zeros();
        let mut steep = Vector3::from_element(1.0);
        for k in 0..3 {
            let t = value[k] / LINEARITY_SPAN_MM;
            cubes[k] = t * t * t;
            steep[k] += 3.0 * self.linearity[k] * t * t / LINEARITY_SPAN_MM;
        }
        Seen {
            value,
            cubes,
            steep,
        }
    }

    #[inline]
    fn shown(&self, seen: &Seen) -> Vector3<f64> {
        seen.value + self.linearity.component_mul(&seen.cubes)
    }

    /// How that changes with the point.
    #[inline]
    fn by_point(&self, seen: &Seen) -> Matrix3<f64> {
        let mut by_point = self.beams;
        for k in 0..3 {
            by_point[(k, k)] += 1.0;
            by_point.row_mut(k).scale_mut(seen.steep[k]);
        }
        by_point
    }

    /// What it reads of a point of its own frame, and the derivative by that.
    ///
    /// # Errors
    /// [`crate::Error::NotFinite`] where that is no number.
    pub(crate) fn shows(&self, point: &Vector3<f64>) -> Result<(Vector3<f64>, Matrix3<f64>)> {
        let seen = self.seen(point);
        Ok((checked(self.shown(&seen))?, self.by_point(&seen)))
    }
}

impl Sensor<3> for Cartesian {
    #[inline]
    fn value(&self, point: &Vector3<f64>, look: Look) -> Result<SVector<f64, 3>> {
        let point = self.pose.at(look)?.frame.apply(point);
        Ok(self.shown(&self.seen(&point)))
    }

    #[inline]
    fn predict<T: Table, const P: usize>(
        &self,
        point: &Vector3<f64>,
        look: Look,
        wanted: Wanted,
        d: &mut SMatrix<f64, 3, P>,
    ) -> Result<(SVector<f64, 3>, Matrix3<f64>)> {
        let stand = self.pose.at(look)?;
        let turned = stand.frame.rotation * point;
        let point = turned + stand.frame.translation;
        let seen = self.seen(&point);
        let by_point = self.by_point(&seen);
        let at = T::AT.cartesian;
        self.pose
            .columns::<T, 3, P>(&stand, &turned, &by_point, look, wanted, d);
        // parameters touch their own axis alone: what an earlier row left on the others is cleared
        if let Some(place) = wanted.wants(at.sensor_linearity) {
            let mut own = d.fixed_columns_mut::<3>(place.start);
            own.fill(0.0);
            own.set_diagonal(&seen.cubes);
        }
        if let Some(place) = wanted.wants(at.beam_alignment) {
            d.fixed_columns_mut::<9>(place.start).fill(0.0);
            for axis in 0..3 {
                for from in 0..3 {
                    d[(axis, place.start + 3 * axis + from)] = seen.steep[axis] * point[from];
                }
            }
        }
        Ok((self.shown(&seen), by_point * stand.frame.rotation))
    }

    #[inline(always)]
    fn predict_many<T: Table, N: Real>(
        &self,
        points: Triple<N>,
        wanted: Wanted,
        to: &mut impl Columns<N, 3>,
    ) -> Option<(Triple<N>, [Triple<N>; 3])> {
        if !self.pose.stays::<T>(wanted) {
            return None;
        }
        let (at, of) = (T::AT.cartesian, N::splat);
        let nothing = [of(0.0); 3];
        let (mut value, mut by_seen) = (nothing, [nothing; 3]);
        let stand = self.pose.first();
        let turn = [0, 1, 2].map(|axis| [0, 1, 2].map(|k| of(stand.frame.rotation[(axis, k)])));
        let turned = turn.map(|row| dot(row, points));
        let shift = &stand.frame.translation;
        let points = [0, 1, 2].map(|axis| turned[axis] + of(shift[axis]));
        for axis in 0..3 {
            let (mut beams, mut along) = (nothing, nothing);
            for k in 0..3 {
                let exact = if k == axis { 1.0 } else { 0.0 };
                beams[k] = of(self.beams[(axis, k)]);
                along[k] = of(exact + self.beams[(axis, k)]);
            }
            let leaning = dot([0, 1, 2].map(|k| of(self.beams[(axis, k)])), points);
            let seen = points[axis] + leaning;
            let t = seen / of(LINEARITY_SPAN_MM);
            let cube = t * t * t;
            let steep = of(1.0) + of(3.0 * self.linearity[axis] / LINEARITY_SPAN_MM) * t * t;
            value[axis] = seen + of(self.linearity[axis]) * cube;
            by_seen[axis] = scale(along, steep);
            if let Some(place) = wanted.wants(at.sensor_linearity) {
                to.put(place.start + axis, of_axis(axis, cube));
            }
            if let Some(place) = wanted.wants(at.beam_alignment) {
                for k in 0..3 {
                    to.put(place.start + 3 * axis + k, of_axis(axis, steep * points[k]));
                }
            }
        }
        if let Some(place) = wanted.wants(T::AT.pose.sensor_pose) {
            for k in 0..3 {
                if to.uses(place.start + k) {
                    let axis = stand.axes().column(k);
                    let moved = cross([of(axis[0]), of(axis[1]), of(axis[2])], turned);
                    to.put(place.start + k, by_seen.map(|row| dot(row, moved)));
                }
                to.put(place.start + 3 + k, by_seen.map(|row| row[k]));
            }
        }
        let by_point = by_seen.map(|row| [0, 1, 2].map(|k| dot(row, turn.map(|line| line[k]))));
        Some((value, by_point))
    }
}

/// A column of what touches one axis alone.
#[inline(always)]
fn of_axis<N: Real>(axis: usize, gain: N) -> Triple<N> {
    let mut column = [N::splat(0.0); 3];
    column[axis] = gain;
    column
}
