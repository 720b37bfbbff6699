//! The link `structure`, as each mechanism fills it.

use super::columns::Columns;
use super::effects::Wanted;
use super::row::Covariates;
use crate::Result;
use crate::numbers::math::{Real, Triple};
use core::fmt::Debug;
use nalgebra::{SMatrix, SVector, Vector3};

/// The link `structure`: from joints to the measured point, with what only this mechanism has.
pub trait Mechanism<const J: usize, const P: usize>: Copy + Debug {
    /// A solved pose, from which every derivative follows.
    type Solved;
    /// Solved poses side by side.
    type Many<T: Real>;

    /// Solves the pose.
    ///
    /// # Errors
    /// Says why the joints make no pose, or one without derivatives.
    fn solve(&self, joints: &SVector<f64, J>) -> Result<Self::Solved>;

    /// Puts the pose of these joints, as by [`Self::solve_at`], in the place of one nearby, if any: as far as one step goes. Whether that is all the
    /// way is returned. Who iterates on the joints besides need not solve each pose to the end.
    ///
    /// # Errors
    /// As [`Self::solve`].
    #[inline]
    fn solve_near(
        &self,
        joints: &SVector<f64, J>,
        row: &Covariates<J>,
        near: &mut Option<Self::Solved>,
    ) -> Result<bool> {
        *near = Some(self.solve_at(joints, row)?);
        Ok(true)
    }

    /// Measured point of a solved pose, base frame, mm.
    fn point(&self, solved: &Self::Solved) -> Vector3<f64>;

    /// [`Self::solve`] of a mechanism that its load or its warmth changes.
    ///
    /// # Errors
    /// As [`Self::solve`].
    #[inline]
    fn solve_at(&self, joints: &SVector<f64, J>, row: &Covariates<J>) -> Result<Self::Solved> {
        let _ = row;
        self.solve(joints)
    }

    /// The same pose with another of the targets that a robot may carry as the measured point.
    #[inline]
    fn aimed(&self, solved: Self::Solved, target: usize) -> Self::Solved {
        let _ = target;
        solved
    }

    /// The measured point without what its derivatives need; the same bits as by [`Self::solve`].
    ///
    /// # Errors
    /// As [`Self::solve`].
    #[inline]
    fn point_at(&self, joints: &SVector<f64, J>) -> Result<Vector3<f64>> {
        Ok(self.point(&self.solve(joints)?))
    }

    /// [`Self::point_at`] of a target, by [`Self::solve_at`].
    ///
    /// # Errors
    /// As [`Self::solve`].
    #[inline]
    fn target_at(
        &self,
        joints: &SVector<f64, J>,
        row: &Covariates<J>,
        target: usize,
    ) -> Result<Vector3<f64>> {
        let _ = (row, target);
        self.point_at(joints)
    }

    /// Hands over the points of its parts at a solved pose, base frame, mm, in an order of its own: what a drawing joins by
    /// lines. As many at every pose; the measured point is the last.
    fn parts(&self, solved: &Self::Solved, put: &mut impl FnMut(Vector3<f64>)) {
        put(self.point(solved));
    }

    /// Writes its wanted columns, carried on by the derivative of the readings by the point; returns that by the joints.
    fn columns<const M: usize>(
        &self,
        joints: &SVector<f64, J>,
        solved: &Self::Solved,
        by_point: &SMatrix<f64, M, 3>,
        wanted: Wanted,
        d: &mut SMatrix<f64, M, P>,
    ) -> SMatrix<f64, M, J>;

    /// [`Self::solve`] for poses side by side: measured points, one for those that have one and derivatives, else zero.
    /// None where the effects that act or are wanted must be computed one pose at a time.
    #[inline(always)]
    fn solve_many<T: Real>(
        &self,
        joints: [T; J],
        wanted: Wanted,
    ) -> Option<(Triple<T>, T, Self::Many<T>)> {
        let _ = (joints, wanted);
        None
    }

    /// Hands over its wanted columns, by which the measured points move.
    #[inline(always)]
    fn columns_many<T: Real>(
        &self,
        joints: [T; J],
        solved: &Self::Many<T>,
        wanted: Wanted,
        to: &mut impl Columns<T, 3>,
    ) {
        let _ = (joints, solved, wanted, to);
    }

    /// Azimuth about which angles of the measured point are counted, rad.
    #[inline]
    fn azimuth(&self, joints: &SVector<f64, J>) -> f64 {
        let _ = joints;
        0.0
    }
}
