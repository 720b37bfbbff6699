//! Forward and inverse kinematics of the delta with their exact derivatives.
//!
//! All derivatives come from the constraint of limb i, `|x - s_i|² = l_i²`, differentiated implicitly:
//! `(x - s_i)·(dx - ds_i) = l_i dl_i`. With `A` the matrix of the rows `(x - s_i)ᵀ`, column i of `A⁻¹` is
//! the platform's answer to a unit change at limb i, and every parameter only scales one such column.
//!
//! NaN or infinite input gives [`Error::NotFinite`]; nothing else is returned for it. Stack: below 1 kB.

use super::geometry::{Assembly, GEOMETRIC, Geometry, LIMBS, PER_LIMB};
use super::trilateration::{culprit, meet};
use crate::numbers::math::{Lanes, Real, Triple, dot, sin_cos, sqrt, subtract};
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
    /// Sphere centres: `s_i = origin_i + q_i rail_i`.
    origins: [Vector3<f64>; LIMBS],
    rails: [Vector3<f64>; LIMBS],
    rods: [f64; LIMBS],
    /// Radial and tangential unit vectors at the base; the same at the platform, times its radius.
    base: [[Vector3<f64>; 2]; LIMBS],
    platform: [[Vector3<f64>; 2]; LIMBS],
    base_radius: [f64; LIMBS],
    platform_radius: [f64; LIMBS],
    joint_offset: [f64; LIMBS],
    lean: [[f64; 2]; LIMBS],
    pivot: [f64; LIMBS],
}

/// How the sphere centre of a limb moves with each of its parameters.
#[derive(Clone, Copy, Debug)]
pub(super) struct ByLimb {
    pub base_radius: Vector3<f64>,
    pub base_angle: Vector3<f64>,
    /// How its rail turns with the base angle.
    pub rail_by_angle: Vector3<f64>,
    pub joint: Vector3<f64>,
    pub platform_radius: Vector3<f64>,
    pub platform_angle: Vector3<f64>,
}

/// A solved pose, from which every derivative follows.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// Platform centre, base frame, mm.
    pub position: Vector3<f64>,
    joints: Vector3<f64>,
    rails: [Vector3<f64>; LIMBS],
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
        Self::leaning(geometry, [[0.0; 2]; LIMBS], [0.0; LIMBS])
    }

    /// Prepares a geometry whose rails lean radially and tangentially, rad, each about its point at the height
    /// `pivot`, mm.
    ///
    /// # Errors
    /// [`Error::InvalidGeometry`] where a number is not finite or a rod has no length.
    pub fn leaning(
        geometry: &Geometry,
        lean: [[f64; 2]; LIMBS],
        pivot: [f64; LIMBS],
    ) -> Result<Self> {
        geometry.check()?;
        let zero = [Vector3::zeros(); LIMBS];
        let limbs = &geometry.limbs;
        let mut k = Self {
            assembly: geometry.assembly,
            side: 0.0,
            origins: zero,
            rails: zero,
            rods: limbs.map(|l| l.rod_length_mm),
            base: [[Vector3::zeros(); 2]; LIMBS],
            platform: [[Vector3::zeros(); 2]; LIMBS],
            base_radius: limbs.map(|l| l.base_radius_mm),
            platform_radius: limbs.map(|l| l.platform_radius_mm),
            joint_offset: limbs.map(|l| l.joint_offset_mm),
            lean,
            pivot,
        };
        for (i, limb) in limbs.iter().enumerate() {
            if !lean[i].iter().chain(&[pivot[i]]).all(|v| v.is_finite()) {
                let what = "the lean of the rail is not a finite number";
                return Err(Error::InvalidGeometry { limb: i, what });
            }
            k.base[i] = unit_vectors(limb.base_angle_rad);
            k.platform[i] = unit_vectors(limb.platform_angle_rad);
            let [out, along] = &k.base[i];
            let rail = Vector3::z() + out * lean[i][0] + along * lean[i][1];
            k.rails[i] = rail / rail.norm();
            k.origins[i] = out * limb.base_radius_mm
                + Vector3::z() * pivot[i]
                + k.rails[i] * (limb.joint_offset_mm - pivot[i])
                - k.platform[i][0] * limb.platform_radius_mm;
        }
        // rails lean by little, so the normal of the carriages' plane never turns from up to down
        let [a1, a2, a3] = k.origins;
        let up = (a2 - a1).cross(&(a3 - a1)).z;
        k.side = if up >= 0.0 { -1.0 } else { 1.0 } * geometry.assembly.sign();
        Ok(k)
    }

    /// Sphere centres `s_i` for joint readings, one or many side by side.
    #[inline(always)]
    fn centres<T: Real>(&self, joints: [T; LIMBS]) -> [Triple<T>; LIMBS] {
        self.centres_of::<T, false>(joints)
    }

    /// The same with vertical rails, whose horizontal parts need no computing; both give the same bits there.
    #[inline(always)]
    fn centres_of<T: Real, const VERTICAL: bool>(&self, joints: [T; LIMBS]) -> [Triple<T>; LIMBS] {
        let mut centres = [[T::splat(0.0); 3]; LIMBS];
        for i in 0..LIMBS {
            for axis in 0..3 {
                let origin = T::splat(self.origins[i][axis]);
                centres[i][axis] = match (VERTICAL, axis) {
                    (true, 0 | 1) => origin,
                    (true, _) => origin + joints[i],
                    (false, _) => origin + joints[i] * T::splat(self.rails[i][axis]),
                };
            }
        }
        centres
    }

    pub(super) fn sphere_centres(&self, joints: &Vector3<f64>) -> [Vector3<f64>; LIMBS] {
        self.centres([joints.x, joints.y, joints.z])
            .map(Vector3::from)
    }

    /// Platform joint of a limb, seen from the platform centre.
    pub(super) fn platform_joint(&self, limb: usize) -> Vector3<f64> {
        self.platform[limb][0] * self.platform_radius[limb]
    }

    pub(super) fn rods(&self) -> &[f64; LIMBS] {
        &self.rods
    }

    pub(super) fn rails(&self) -> &[Vector3<f64>; LIMBS] {
        &self.rails
    }

    pub(super) fn with_rods(mut self, rods: [f64; LIMBS]) -> Self {
        self.rods = rods;
        self
    }

    /// Derivatives of a limb's sphere centre at a joint reading.
    #[inline]
    pub(super) fn by_limb(&self, limb: usize, joint: f64) -> ByLimb {
        let ([out, along], [lr, lt]) = (&self.base[limb], self.lean[limb]);
        let [platform_out, platform_along] = &self.platform[limb];
        let mut base_angle = along * self.base_radius[limb];
        let mut rail_by_angle = Vector3::zeros();
        if lr != 0.0 || lt != 0.0 {
            rail_by_angle = self.across(limb, &(along * lr - out * lt));
            base_angle += rail_by_angle * self.height(limb, joint);
        }
        ByLimb {
            base_radius: *out,
            base_angle,
            rail_by_angle,
            joint: self.rails[limb],
            platform_radius: -platform_out,
            platform_angle: -platform_along * self.platform_radius[limb],
        }
    }

    /// Derivatives of a limb's rail by its radial and its tangential lean; the sphere centre moves by them times
    /// [`Self::height`].
    #[inline]
    pub(super) fn rail_by_lean(&self, limb: usize) -> [Vector3<f64>; 2] {
        let [out, along] = &self.base[limb];
        [self.across(limb, out), self.across(limb, along)]
    }

    /// Height of a carriage above the point about which its rail leans, mm.
    #[inline]
    pub(super) fn height(&self, limb: usize, joint: f64) -> f64 {
        joint + self.joint_offset[limb] - self.pivot[limb]
    }

    /// Change of a rail when `r = ẑ + λ_r e_r + λ_t e_t` changes by `v`: the rail is `r/|r|`, so it turns by the part of
    /// `v` across it, over `|r|`.
    #[inline]
    fn across(&self, limb: usize, v: &Vector3<f64>) -> Vector3<f64> {
        let rail = &self.rails[limb];
        let [lr, lt] = self.lean[limb];
        (v - rail * rail.dot(v)) / sqrt(1.0 + lr * lr + lt * lt)
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
            let up = Vector3::from(meeting.point) - Vector3::from(*centre);
            let beyond_mm = self.assembly.sign() * up.dot(&self.rails[limb]);
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
        if self.lean == [[0.0; 2]; LIMBS] {
            self.lanes::<L, true>(joints)
        } else {
            self.lanes::<L, false>(joints)
        }
    }

    #[inline(always)]
    fn lanes<const L: usize, const VERTICAL: bool>(
        &self,
        joints: &[[f64; L]; LIMBS],
    ) -> ([[f64; L]; 3], [bool; L]) {
        let joints = [Lanes(joints[0]), Lanes(joints[1]), Lanes(joints[2])];
        let centres = self.centres_of::<_, VERTICAL>(joints);
        let meeting = meet(&centres, &self.rods, self.side);
        let sign = self.assembly.sign();
        let mut reached = [false; L];
        // written with >= and <= so that a NaN is never in reach
        for lane in 0..L {
            reached[lane] = meeting.height_squared.0[lane] >= 0.0;
        }
        for i in 0..LIMBS {
            let up = subtract(meeting.point, centres[i]);
            let rail = [
                Lanes::splat(self.rails[i].x),
                Lanes::splat(self.rails[i].y),
                Lanes::splat(self.rails[i].z),
            ];
            let beyond = if VERTICAL { up[2].0 } else { dot(up, rail).0 };
            for lane in 0..L {
                reached[lane] &= sign * beyond[lane] <= 0.0;
            }
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
            let rail = &self.rails[limb];
            let from_origin = position - self.origins[limb];
            let along = from_origin.dot(rail);
            let across_squared = (from_origin - rail * along).norm_squared();
            let rise_squared = self.rods[limb] * self.rods[limb] - across_squared;
            if rise_squared < 0.0 {
                let miss_mm = sqrt(across_squared) - self.rods[limb];
                return Err(Error::OutOfReach { limb, miss_mm });
            }
            joints[limb] = along + self.assembly.sign() * sqrt(rise_squared);
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
            let (origin, rail) = (&self.origins[limb], &self.rails[limb]);
            let rod_squared = self.rods[limb] * self.rods[limb];
            for lane in 0..L {
                let v = [
                    position[0][lane] - origin.x,
                    position[1][lane] - origin.y,
                    position[2][lane] - origin.z,
                ];
                let along = v[0] * rail.x + v[1] * rail.y + v[2] * rail.z;
                let across = [
                    v[0] - rail.x * along,
                    v[1] - rail.y * along,
                    v[2] - rail.z * along,
                ];
                let rise_squared = rod_squared - dot(across, across);
                out[limb][lane] = along + sign * sqrt(rise_squared);
                // the second test is false where the height is not finite
                reached[lane] &= (rise_squared >= 0.0) & (along.abs() < f64::INFINITY);
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
        let answers = answers(&rods)?;
        Ok(Pose {
            position,
            joints: *joints,
            rails: self.rails,
            rods,
            lengths: self.rods,
            answers,
        })
    }

    /// Derivative of the position by the 18 geometric parameters (Eq. 8), one column each.
    #[must_use]
    pub fn by_parameters(&self, pose: &Pose) -> SMatrix<f64, 3, GEOMETRIC> {
        let mut d = SMatrix::<f64, 3, GEOMETRIC>::zeros();
        for limb in 0..LIMBS {
            let rod = &pose.rods[limb];
            let answer = pose.answers.column(limb);
            let by = self.by_limb(limb, pose.joints[limb]);
            let gains = [
                rod.dot(&by.base_radius),
                rod.dot(&by.base_angle),
                rod.dot(&by.joint),
                pose.lengths[limb],
                rod.dot(&by.platform_radius),
                rod.dot(&by.platform_angle),
            ];
            for (k, gain) in gains.iter().enumerate() {
                d.set_column(limb * PER_LIMB + k, &(answer * *gain));
            }
        }
        d
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

/// Radial and tangential unit vectors at an angle, rad.
fn unit_vectors(angle_rad: f64) -> [Vector3<f64>; 2] {
    let (sin, cos) = sin_cos(angle_rad);
    [Vector3::new(cos, sin, 0.0), Vector3::new(-sin, cos, 0.0)]
}

fn finite(v: &Vector3<f64>) -> Result<()> {
    v.iter()
        .position(|c| !c.is_finite())
        .map_or(Ok(()), |index| Err(Error::NotFinite { index }))
}
