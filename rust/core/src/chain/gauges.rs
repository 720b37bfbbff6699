//! What reads distances: from what stands fixed in the base frame, centres and planes, or between two places.

use super::bar::{Bar, Bars, CENTRES};
use super::effects::{Wanted, values_of};
use super::plane::{Flat, PLANES, Plane, Planes};
use super::row::Fixed;
use super::sensor::{Look, Sensor};
use super::table::Table;
use crate::Result;
use core::fmt::Debug;
use nalgebra::{SMatrix, SVector, Vector3};

/// What stands fixed around a robot. Nothing does around one of whose type this is `()`, and it costs nothing.
pub trait Around: Copy + Debug {
    /// What reads the distance from one of them.
    fn gauge(&self, from: Fixed) -> Option<Gauge>;

    /// What a distance between two places reads beyond itself, mm.
    #[inline]
    fn zero(&self) -> f64 {
        0.0
    }
}

impl Around for () {
    fn gauge(&self, _: Fixed) -> Option<Gauge> {
        None
    }
}

/// A bar that is held between two places: nothing stands fixed.
#[derive(Clone, Copy, Debug)]
pub struct Between {
    zero: f64,
}

impl Between {
    /// That of a robot, with its error.
    pub(crate) fn new<T: Table, const P: usize>(values: &[f64; P]) -> Self {
        let [zero] = values_of(T::AT.bar.bar_zero, values);
        Self { zero }
    }
}

impl Around for Between {
    fn gauge(&self, _: Fixed) -> Option<Gauge> {
        None
    }

    #[inline]
    fn zero(&self) -> f64 {
        self.zero
    }
}

/// Centres and planes where they really are.
#[derive(Clone, Copy, Debug)]
pub struct Gauges {
    bars: Bars,
    planes: Planes,
}

impl Gauges {
    /// Those of a robot, with their errors.
    pub(crate) fn new<T: Table, const P: usize>(
        centres_mm: &[Vector3<f64>; CENTRES],
        planes: &[Flat; PLANES],
        values: &[f64; P],
    ) -> Self {
        Self {
            bars: Bars::new::<T, P>(centres_mm, values),
            planes: Planes::new::<T, P>(planes, values),
        }
    }
}

impl Around for Gauges {
    fn gauge(&self, from: Fixed) -> Option<Gauge> {
        Some(match from {
            Fixed::Centre(number) => Gauge::Bar(self.bars.at(number)),
            Fixed::Plane(number) => Gauge::Plane(self.planes.at(number)),
        })
    }
}

/// A sensor that shows one distance.
#[derive(Clone, Copy, Debug)]
pub enum Gauge {
    /// From a centre.
    Bar(Bar),
    /// Above a plane.
    Plane(Plane),
}

/// Clears the columns of all of them.
#[inline]
pub(super) fn clear<T: Table, const M: usize, const P: usize>(
    wanted: Wanted,
    d: &mut SMatrix<f64, M, P>,
) {
    for place in [T::AT.bar.centres, T::AT.bar.bar_zero, T::AT.plane.planes] {
        if let Some(place) = wanted.wants(place) {
            for column in place.range() {
                d.column_mut(column).fill(0.0);
            }
        }
    }
}

impl<const M: usize> Sensor<M> for Gauge {
    fn value(&self, point: &Vector3<f64>, look: Look) -> Result<SVector<f64, M>> {
        match self {
            Self::Bar(bar) => bar.value(point, look),
            Self::Plane(plane) => plane.value(point, look),
        }
    }

    fn predict<T: Table, const P: usize>(
        &self,
        point: &Vector3<f64>,
        look: Look,
        wanted: Wanted,
        d: &mut SMatrix<f64, M, P>,
    ) -> Result<(SVector<f64, M>, SMatrix<f64, M, 3>)> {
        match self {
            Self::Bar(bar) => bar.predict::<T, P>(point, look, wanted, d),
            Self::Plane(plane) => plane.predict::<T, P>(point, look, wanted, d),
        }
    }
}
