//! A sensor that shows how far the measured point is above a fixed plane: a probe that touches a plate, a gauge on a
//! table, a laser against a mirror. Beside a straight line it is how far off the point is to one side: two planes that
//! cross in a beam are that beam.
//!
//! A plane through `c` with the normal `n` leans by `a`, `b` along its own `u`, `v` and lies higher by `δ`:
//! `h = m·(x - c)/|m| - δ`, `m = n + a u + b v`.

use super::effects::{Wanted, values_of};
use super::sensor::{Look, Sensor, first};
use super::table::Table;
use crate::Result;
use crate::numbers::math::sqrt;
use nalgebra::{SMatrix, SVector, Vector3};

/// Planes that a robot may have.
pub const PLANES: usize = 4;
/// Errors of each: two leans, then how much higher it lies.
const EACH: usize = 3;

/// A plane as drawn, base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flat {
    /// A point of it, mm.
    pub at: Vector3<f64>,
    /// Its normal, of length one, towards the side where distances are positive.
    pub normal: Vector3<f64>,
}

impl Flat {
    /// Through the origin, upwards.
    pub const GROUND: Self = Self {
        at: Vector3::new(0.0, 0.0, 0.0),
        normal: Vector3::new(0.0, 0.0, 1.0),
    };

    /// Two directions within it, square to each other: the first along the axis of the base that it is nearest to.
    #[must_use]
    pub fn within(&self) -> [Vector3<f64>; 2] {
        let n = &self.normal;
        let steep = n.map(f64::abs);
        // the axis of the base that lies most within the plane; of equal ones the first
        let mut along = Vector3::x();
        if steep.y < steep.x && steep.y <= steep.z {
            along = Vector3::y();
        } else if steep.z < steep.x {
            along = Vector3::z();
        }
        let u = along - n * n.dot(&along);
        let u = u / u.norm();
        [u, n.cross(&u)]
    }
}

/// The planes of a robot where they really are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Planes([Plane; PLANES]);

/// One of them.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    number: usize,
    at: Vector3<f64>,
    within: [Vector3<f64>; 2],
    leans: [f64; 2],
    higher: f64,
    /// The normal as it leans, and its length.
    normal: Vector3<f64>,
    length: f64,
}

impl Plane {
    fn new(number: usize, drawn: &Flat, [a, b, higher]: [f64; EACH]) -> Self {
        let within = drawn.within();
        let leant = drawn.normal + within[0] * a + within[1] * b;
        let length = sqrt(leant.norm_squared());
        Self {
            number,
            at: drawn.at,
            within,
            leans: [a, b],
            higher,
            normal: leant / length,
            length,
        }
    }
}

impl Planes {
    /// Those of a robot, with their errors.
    pub(crate) fn new<T: Table, const P: usize>(drawn: &[Flat; PLANES], values: &[f64; P]) -> Self {
        let off: [f64; EACH * PLANES] = values_of(T::AT.plane.planes, values);
        let off = off.as_chunks::<EACH>().0;
        Self(core::array::from_fn(|k| Plane::new(k, &drawn[k], off[k])))
    }

    /// The plane of a number; the first where there is none of this number.
    pub(crate) fn at(&self, number: usize) -> Plane {
        self.0[if number < PLANES { number } else { 0 }]
    }
}

impl<const M: usize> Sensor<M> for Plane {
    fn value(&self, point: &Vector3<f64>, _: Look) -> Result<SVector<f64, M>> {
        let above = self.normal.dot(&(point - self.at));
        Ok(first(above - self.higher))
    }

    fn predict<T: Table, const P: usize>(
        &self,
        point: &Vector3<f64>,
        _: Look,
        wanted: Wanted,
        d: &mut SMatrix<f64, M, P>,
    ) -> Result<(SVector<f64, M>, SMatrix<f64, M, 3>)> {
        let lever = point - self.at;
        let above = self.normal.dot(&lever);
        if let Some(place) = wanted.wants(T::AT.plane.planes) {
            let start = place.start + EACH * self.number;
            for (k, along) in self.within.iter().enumerate() {
                // a normal that leans also grows, and is made one long again
                let grown = above * self.leans[k] / self.length;
                d[(0, start + k)] = (along.dot(&lever) - grown) / self.length;
            }
            d[(0, start + 2)] = -1.0;
        }
        let mut by_point = SMatrix::<f64, M, 3>::zeros();
        by_point.set_row(0, &self.normal.transpose());
        Ok((first(above - self.higher), by_point))
    }
}
