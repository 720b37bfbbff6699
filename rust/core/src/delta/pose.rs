//! The robot at one pose, or at several at once, and how the platform answers there.

use super::geometry::LIMBS;
use crate::numbers::math::{Real, Triple, dot, scale};
use crate::{Error, Result};
use nalgebra::{Matrix3, Vector3};

/// Rods closer to one plane than this (product of their unit vectors) count as singular.
pub(super) const SINGULAR: f64 = 1e-9;

/// A solved pose, from which every derivative follows.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// Platform centre, base frame, mm.
    pub position: Vector3<f64>,
    pub(super) joints: Vector3<f64>,
    pub(super) rails: [Vector3<f64>; LIMBS],
    pub(super) rods: [Vector3<f64>; LIMBS],
    pub(super) lengths: [f64; LIMBS],
    /// Column i: change of position when `(x - s_i)·dx` of limb i grows by one.
    pub(super) answers: Matrix3<f64>,
}

/// [`Pose`] for many side by side.
#[derive(Clone, Copy, Debug)]
pub struct Poses<T> {
    pub(super) position: Triple<T>,
    /// One where the pose and its derivatives can be computed, else zero.
    pub(super) reached: T,
    pub(super) rods: [Triple<T>; LIMBS],
    pub(super) answers: [Triple<T>; LIMBS],
}

impl<T: Real> Poses<T> {
    /// What a movement of the sphere centre of a limb does to the position.
    #[inline(always)]
    pub(super) fn by_end(&self, limb: usize, end: Triple<T>) -> Triple<T> {
        scale(self.answers[limb], dot(self.rods[limb], end))
    }
}

impl Pose {
    pub(super) fn rods(&self) -> &[Vector3<f64>; LIMBS] {
        &self.rods
    }

    pub(super) fn answers(&self) -> &Matrix3<f64> {
        &self.answers
    }

    /// Velocity Jacobian: derivative of the position by the joint readings.
    #[must_use]
    pub fn by_joints(&self) -> Matrix3<f64> {
        let mut d = self.answers;
        for limb in 0..LIMBS {
            let gain = self.rods[limb].dot(&self.rails[limb]);
            d.column_mut(limb).scale_mut(gain);
        }
        d
    }
}

/// Answers of the platform to the rods: columns of the inverse of the matrix whose rows they are.
///
/// # Errors
/// [`Error::Singular`] where the rods lie in one plane.
pub(super) fn answers(rods: &[Vector3<f64>; LIMBS]) -> Result<Matrix3<f64>> {
    // cross products of the rods over their triple product
    let crosses = [
        rods[1].cross(&rods[2]),
        rods[2].cross(&rods[0]),
        rods[0].cross(&rods[1]),
    ];
    let volume = rods[0].dot(&crosses[0]);
    let size_squared = rods[0].norm_squared() * rods[1].norm_squared() * rods[2].norm_squared();
    if volume * volume <= SINGULAR * SINGULAR * size_squared {
        return Err(Error::Singular);
    }
    let inverse = 1.0 / volume;
    Ok(Matrix3::from_columns(&[
        crosses[0] * inverse,
        crosses[1] * inverse,
        crosses[2] * inverse,
    ]))
}
