//! Forward and inverse kinematics of the delta with their exact derivatives.
//!
//! All derivatives come from the constraint of limb i, `|x - s_i|² = l_i²`, differentiated implicitly:
//! `(x - s_i)·(dx - ds_i) = l_i dl_i`. With `A` the matrix of the rows `(x - s_i)ᵀ`, column i of `A⁻¹` is
//! the platform's answer to a unit change at limb i, and every parameter only scales one such column.
//!
//! NaN or infinite input gives [`Error::NotFinite`]; nothing else is returned for it. Stack: below 1 kB.

use super::geometry::{Assembly, GEOMETRIC, Geometry, LIMBS, PER_LIMB};
use super::trilateration::{culprit, meet};
use crate::math::{Lanes, Real, Triple, sin_cos, sqrt};
use crate::{Error, Result};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Rods closer to one plane than this (product of their unit vectors) count as singular.
const SINGULAR: f64 = 1e-9;

/// A delta ready to compute with: sines and cosines are taken once.
#[derive(Clone, Copy, Debug)]
pub struct Kinematics {
    assembly: Assembly,
    /// Side of the plane of the carriages on which the platform is, along `d_2 × d_3` of the trilateration.
    side: f64,
    /// Horizontal sphere centre and joint offset: `s_i = anchor_i + q_i ẑ`.
    anchors: [Vector3<f64>; LIMBS],
    rods: [f64; LIMBS],
    /// Derivatives of `anchor` by base radius, base angle, platform radius, platform angle.
    by_base_radius: [Vector3<f64>; LIMBS],
    by_base_angle: [Vector3<f64>; LIMBS],
    by_platform_radius: [Vector3<f64>; LIMBS],
    by_platform_angle: [Vector3<f64>; LIMBS],
}

/// A solved pose, from which every derivative follows.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// Platform centre, base frame, mm.
    pub position: Vector3<f64>,
    rods: [Vector3<f64>; LIMBS],
    lengths: [f64; LIMBS],
    /// Column i: change of position when `(x - s_i)·dx` of limb i grows by one.
    answers: Matrix3<f64>,
}

impl Kinematics {
    /// Prepares a geometry.
    ///
    /// # Errors
    /// [`Error::InvalidGeometry`] where a number is not finite or a rod has no length.
    pub fn new(geometry: &Geometry) -> Result<Self> {
        geometry.check()?;
        let zero = [Vector3::zeros(); LIMBS];
        let mut k = Self {
            assembly: geometry.assembly,
            side: 0.0,
            anchors: zero,
            rods: geometry.limbs.map(|l| l.rod_length_mm),
            by_base_radius: zero,
            by_base_angle: zero,
            by_platform_radius: zero,
            by_platform_angle: zero,
        };
        for (i, limb) in geometry.limbs.iter().enumerate() {
            let (sb, cb) = sin_cos(limb.base_angle_rad);
            let (sp, cp) = sin_cos(limb.platform_angle_rad);
            let (rb, rp) = (limb.base_radius_mm, limb.platform_radius_mm);
            k.anchors[i] = Vector3::new(rb * cb - rp * cp, rb * sb - rp * sp, limb.joint_offset_mm);
            k.by_base_radius[i] = Vector3::new(cb, sb, 0.0);
            k.by_base_angle[i] = Vector3::new(-rb * sb, rb * cb, 0.0);
            k.by_platform_radius[i] = Vector3::new(-cp, -sp, 0.0);
            k.by_platform_angle[i] = Vector3::new(rp * sp, -rp * cp, 0.0);
        }
        // rails are vertical, so the normal of the carriages' plane never turns from up to down
        let [a1, a2, a3] = k.anchors;
        let up = (a2 - a1).cross(&(a3 - a1)).z;
        k.side = if up >= 0.0 { -1.0 } else { 1.0 } * geometry.assembly.sign();
        Ok(k)
    }

    /// Sphere centres `s_i` for joint readings, one or many side by side.
    #[inline(always)]
    fn centres<T: Real>(&self, joints: [T; LIMBS]) -> [Triple<T>; LIMBS] {
        let mut centres = [[T::splat(0.0); 3]; LIMBS];
        for i in 0..LIMBS {
            let a = &self.anchors[i];
            centres[i] = [T::splat(a.x), T::splat(a.y), T::splat(a.z) + joints[i]];
        }
        centres
    }

    /// Platform centre for the given joint readings (Eq. 3 solved for x, y, z).
    ///
    /// # Errors
    /// [`Error::OutOfReach`] names limb and distance, [`Error::LimbReversed`] a limb beyond the horizontal,
    /// [`Error::NotFinite`] a joint that is no number.
    pub fn forward(&self, joints: &Vector3<f64>) -> Result<Vector3<f64>> {
        finite(joints)?;
        let centres = self.centres([joints.x, joints.y, joints.z]);
        let meeting = meet(&centres, &self.rods, self.side);
        if meeting.height_squared.is_nan() {
            return Err(Error::Singular);
        }
        if meeting.height_squared < 0.0 {
            let (limb, miss_mm) = culprit(&centres.map(Vector3::from), &self.rods);
            return Err(Error::OutOfReach { limb, miss_mm });
        }
        for (limb, centre) in centres.iter().enumerate() {
            let beyond_mm = self.assembly.sign() * (meeting.point[2] - centre[2]);
            if beyond_mm > 0.0 {
                return Err(Error::LimbReversed { limb, beyond_mm });
            }
        }
        Ok(Vector3::from(meeting.point))
    }

    /// [`Self::forward`] for `L` poses at once, laid out as lanes so that it vectorises.
    ///
    /// Returns the positions and which lanes are in reach; the position of any other lane has no meaning,
    /// and [`Self::forward`] says why.
    #[inline(always)]
    #[must_use]
    pub fn forward_lanes<const L: usize>(
        &self,
        joints: &[[f64; L]; LIMBS],
    ) -> ([[f64; L]; 3], [bool; L]) {
        let centres = self.centres([Lanes(joints[0]), Lanes(joints[1]), Lanes(joints[2])]);
        let meeting = meet(&centres, &self.rods, self.side);
        let sign = self.assembly.sign();
        let z = meeting.point[2].0;
        let mut reached = [false; L];
        for lane in 0..L {
            // written with >= so that a NaN is never in reach
            reached[lane] = (meeting.height_squared.0[lane] >= 0.0)
                & (sign * (centres[0][2].0[lane] - z[lane]) >= 0.0)
                & (sign * (centres[1][2].0[lane] - z[lane]) >= 0.0)
                & (sign * (centres[2][2].0[lane] - z[lane]) >= 0.0);
        }
        let [x, y, z] = meeting.point;
        ([x.0, y.0, z.0], reached)
    }

    /// Joint readings that bring the platform centre to `position`.
    ///
    /// # Errors
    /// [`Error::OutOfReach`] names the first limb whose rod is too short, and by how much.
    pub fn inverse(&self, position: &Vector3<f64>) -> Result<Vector3<f64>> {
        finite(position)?;
        let mut joints = Vector3::zeros();
        for limb in 0..LIMBS {
            let (dx, dy) = (
                position.x - self.anchors[limb].x,
                position.y - self.anchors[limb].y,
            );
            let horizontal_squared = dx * dx + dy * dy;
            let rise_squared = self.rods[limb] * self.rods[limb] - horizontal_squared;
            if rise_squared < 0.0 {
                let miss_mm = sqrt(horizontal_squared) - self.rods[limb];
                return Err(Error::OutOfReach { limb, miss_mm });
            }
            joints[limb] =
                position.z + self.assembly.sign() * sqrt(rise_squared) - self.anchors[limb].z;
        }
        Ok(joints)
    }

    /// [`Self::inverse`] for `L` poses at once; lanes out of reach are marked `false`.
    #[inline(always)]
    #[must_use]
    pub fn inverse_lanes<const L: usize>(
        &self,
        position: &[[f64; L]; 3],
    ) -> ([[f64; L]; LIMBS], [bool; L]) {
        let mut out = [[0.0; L]; LIMBS];
        let mut reached = [true; L];
        let sign = self.assembly.sign();
        for limb in 0..LIMBS {
            let a = self.anchors[limb];
            let rod_squared = self.rods[limb] * self.rods[limb];
            for lane in 0..L {
                let dx = position[0][lane] - a.x;
                let dy = position[1][lane] - a.y;
                let rise_squared = rod_squared - (dx * dx + dy * dy);
                out[limb][lane] = position[2][lane] + sign * sqrt(rise_squared) - a.z;
                // the second test is false where z is not finite
                reached[lane] &= (rise_squared >= 0.0) & (position[2][lane].abs() < f64::INFINITY);
            }
        }
        (out, reached)
    }

    /// Solves the pose and keeps what its derivatives need.
    ///
    /// # Errors
    /// As [`Self::forward`], and [`Error::Singular`] where the rods lie in one plane.
    pub fn pose(&self, joints: &Vector3<f64>) -> Result<Pose> {
        let position = self.forward(joints)?;
        let centres = self.centres([joints.x, joints.y, joints.z]);
        let rods = [
            position - Vector3::from(centres[0]),
            position - Vector3::from(centres[1]),
            position - Vector3::from(centres[2]),
        ];
        // rows of A are the rods, so the columns of A⁻¹ are their cross products over the triple product
        let crosses = [
            rods[1].cross(&rods[2]),
            rods[2].cross(&rods[0]),
            rods[0].cross(&rods[1]),
        ];
        let volume = rods[0].dot(&crosses[0]);
        let size = self.rods[0] * self.rods[1] * self.rods[2];
        if volume.abs() <= SINGULAR * size {
            return Err(Error::Singular);
        }
        let inverse = 1.0 / volume;
        let answers = Matrix3::from_columns(&[
            crosses[0] * inverse,
            crosses[1] * inverse,
            crosses[2] * inverse,
        ]);
        Ok(Pose {
            position,
            rods,
            lengths: self.rods,
            answers,
        })
    }

    /// Derivative of the position by the 18 geometric parameters (Eq. 8), in the first columns of `N`.
    #[must_use]
    #[inline]
    pub fn by_parameters<const N: usize>(&self, pose: &Pose) -> SMatrix<f64, 3, N> {
        const { assert!(N >= GEOMETRIC) }
        let mut d = SMatrix::<f64, 3, N>::zeros();
        for limb in 0..LIMBS {
            let rod = &pose.rods[limb];
            let answer = pose.answers.column(limb);
            let gains = [
                rod.dot(&self.by_base_radius[limb]),
                rod.dot(&self.by_base_angle[limb]),
                rod.z,
                pose.lengths[limb],
                rod.dot(&self.by_platform_radius[limb]),
                rod.dot(&self.by_platform_angle[limb]),
            ];
            for (k, gain) in gains.iter().enumerate() {
                for axis in 0..3 {
                    d[(axis, limb * PER_LIMB + k)] = answer[axis] * gain;
                }
            }
        }
        d
    }
}

impl Pose {
    /// Velocity Jacobian: derivative of the position by the joint readings.
    #[must_use]
    pub fn by_joints(&self) -> Matrix3<f64> {
        let mut d = self.answers;
        for limb in 0..LIMBS {
            let gain = self.rods[limb].z;
            d.column_mut(limb).scale_mut(gain);
        }
        d
    }
}

fn finite(v: &Vector3<f64>) -> Result<()> {
    v.iter()
        .position(|c| !c.is_finite())
        .map_or(Ok(()), |index| Err(Error::NotFinite { index }))
}
