//! Columns of rows side by side, as they go from link to link.

use crate::numbers::math::{Real, Triple, dot};

/// Takes the columns of rows side by side: how `M` coordinates move with each parameter. A trait, since a closure is not
/// always inlined.
pub trait Columns<T, const M: usize> {
    /// Takes that of a parameter.
    fn put(&mut self, parameter: usize, column: [T; M]);

    /// Whether it has a use for that of a parameter; what has none need not be computed.
    #[inline(always)]
    fn uses(&self, _parameter: usize) -> bool {
        true
    }
}

/// Columns of a point, carried on to the readings.
pub(super) struct Carried<'a, T, C, const M: usize> {
    pub(super) by_point: [Triple<T>; M],
    pub(super) to: &'a mut C,
}

impl<T: Real, C: Columns<T, M>, const M: usize> Columns<T, 3> for Carried<'_, T, C, M> {
    #[inline(always)]
    fn put(&mut self, parameter: usize, column: Triple<T>) {
        let mut shown = [T::splat(0.0); M];
        for axis in 0..M {
            shown[axis] = dot(self.by_point[axis], column);
        }
        self.to.put(parameter, shown);
    }
}
