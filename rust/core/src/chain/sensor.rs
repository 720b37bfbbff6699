//! The link `sensor`, as each instrument fills it.

use super::columns::Columns;
use super::effects::Wanted;
use super::table::Table;
use crate::Result;
use crate::numbers::math::{Real, Triple};
use core::fmt::Debug;
use nalgebra::{SMatrix, SVector, Vector3};

/// What an instrument's reading depends on besides the point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Azimuth about which angles are counted, rad.
    pub azimuth: f64,
    /// Time of the reading, s; NaN where it is not known.
    pub time_s: f64,
}

/// The link `sensor`: what an instrument shows of a point.
pub trait Sensor<const M: usize>: Copy + Debug {
    /// Reading of a point.
    ///
    /// # Errors
    /// Says why the instrument shows nothing.
    fn value(&self, point: &Vector3<f64>, look: Look) -> Result<SVector<f64, M>>;

    /// [`Self::value`] with the derivative by the point; writes its wanted columns.
    ///
    /// # Errors
    /// As [`Self::value`].
    fn predict<T: Table, const P: usize>(
        &self,
        point: &Vector3<f64>,
        look: Look,
        wanted: Wanted,
        d: &mut SMatrix<f64, M, P>,
    ) -> Result<(SVector<f64, M>, SMatrix<f64, M, 3>)>;

    /// Readings of points side by side with the derivative by the point, row by row; hands over its wanted columns. None
    /// where points are looked at one at a time.
    #[inline(always)]
    fn predict_many<T: Table, N: Real>(
        &self,
        points: Triple<N>,
        wanted: Wanted,
        to: &mut impl Columns<N, M>,
    ) -> Option<([N; M], [Triple<N>; M])> {
        let _ = (points, wanted, to);
        None
    }
}

/// The point itself, base frame: ends of a distance are seen by no instrument, whose beams or axes could be bent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Itself;

impl<const M: usize> Sensor<M> for Itself {
    fn value(&self, point: &Vector3<f64>, _: Look) -> Result<SVector<f64, M>> {
        Ok(SVector::from_fn(|k, _| if k < 3 { point[k] } else { 0.0 }))
    }

    fn predict<T: Table, const P: usize>(
        &self,
        point: &Vector3<f64>,
        look: Look,
        _: Wanted,
        _: &mut SMatrix<f64, M, P>,
    ) -> Result<(SVector<f64, M>, SMatrix<f64, M, 3>)> {
        Ok((self.value(point, look)?, SMatrix::identity()))
    }
}

/// A distance as a reading: the first component, the others zero.
pub(super) fn first<const M: usize>(distance: f64) -> SVector<f64, M> {
    SVector::from_fn(|axis, _| if axis == 0 { distance } else { 0.0 })
}
