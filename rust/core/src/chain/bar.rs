//! A sensor that shows how far the measured point is from a fixed centre: a ball bar, a wire, a laser interferometer that
//! follows.

use super::effects::{Wanted, values_of};
use super::sensor::{Look, Sensor, first};
use super::table::Table;
use crate::Result;
use nalgebra::{SMatrix, SVector, Vector3};

/// Centres that a robot may have.
pub const CENTRES: usize = 8;

/// The centres of a robot where they really are, base frame, and what its bars add to every distance, mm.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bars {
    centres: [Vector3<f64>; CENTRES],
    zero: f64,
}

/// One of them.
#[derive(Clone, Copy, Debug)]
pub struct Bar {
    number: usize,
    centre: Vector3<f64>,
    zero: f64,
}

impl Bars {
    /// Those of a robot, with their errors.
    pub(crate) fn new<T: Table, const P: usize>(
        nominal: &[Vector3<f64>; CENTRES],
        values: &[f64; P],
    ) -> Self {
        let off: [f64; 3 * CENTRES] = values_of(T::AT.bar.centres, values);
        let [zero] = values_of(T::AT.bar.bar_zero, values);
        let mut centres = *nominal;
        for (centre, off) in centres.iter_mut().zip(off.as_chunks::<3>().0) {
            *centre += Vector3::from(*off);
        }
        Self { centres, zero }
    }

    /// The bar at a centre; that at the first where there is none of this number.
    pub(crate) fn at(&self, number: usize) -> Bar {
        let number = if number < CENTRES { number } else { 0 };
        Bar {
            number,
            centre: self.centres[number],
            zero: self.zero,
        }
    }
}

impl<const M: usize> Sensor<M> for Bar {
    fn value(&self, point: &Vector3<f64>, _: Look) -> Result<SVector<f64, M>> {
        Ok(first((point - self.centre).norm() + self.zero))
    }

    fn predict<T: Table, const P: usize>(
        &self,
        point: &Vector3<f64>,
        _: Look,
        wanted: Wanted,
        d: &mut SMatrix<f64, M, P>,
    ) -> Result<(SVector<f64, M>, SMatrix<f64, M, 3>)> {
        let between = point - self.centre;
        let distance = between.norm();
        // in its centre a distance has no direction; it is stationary there
        let along = if distance > 0.0 {
            between / distance
        } else {
            Vector3::zeros()
        };
        if let Some(place) = wanted.wants(T::AT.bar.centres) {
            for axis in 0..3 {
                d[(0, place.start + 3 * self.number + axis)] = -along[axis];
            }
        }
        if let Some(place) = wanted.wants(T::AT.bar.bar_zero) {
            d[(0, place.start)] = 1.0;
        }
        let mut by_point = SMatrix::<f64, M, 3>::zeros();
        by_point.set_row(0, &along.transpose());
        Ok((first(distance + self.zero), by_point))
    }
}
