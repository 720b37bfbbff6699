//! Forward and inverse kinematics of the delta with their exact derivatives.
//!
//! All derivatives come from the constraint of limb i, `|x - s_i|² = l_i²`, differentiated implicitly:
//! `(x - s_i)·(dx - ds_i) = l_i dl_i`. With `A` the matrix of the rows `(x - s_i)ᵀ`, column i of `A⁻¹` is
//! the platform's answer to a unit change at limb i, and every parameter only scales one such column.
//!
//! NaN or infinite input gives [`Error::NotFinite`]; nothing else is returned for it. Stack: below 1 kB.

use super::geometry::{Assembly, GEOMETRIC, Geometry, LIMBS, PER_LIMB};
use super::pose::{Pose, Poses, SINGULAR, answers};
use super::trilateration::{culprit, meet};
use crate::numbers::math::{Real, Triple, cross, dot, scale, sin_cos, sqrt, subtract};
use crate::{Error, Result};
use nalgebra::{SMatrix, Vector3};

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
    /// Joints of the platform, seen from its centre.
    platform_joints: [Vector3<f64>; LIMBS],
    joint_offset: [f64; LIMBS],
    lean: [[f64; 2]; LIMBS],
    pivot: [f64; LIMBS],
}

/// By what part of their drawn lengths parts of the robot have grown.
#[derive(Clone, Copy, Debug)]
pub(super) struct Growth {
    pub rods: f64,
    /// Base and platform radii.
    pub frame: f64,
    /// Rails with their scales, from the plane of the base on.
    pub rails: f64,
}

/// The lengths of which parts grow, mm: rods, from the middle out to the rails and to the joints of the platform, and joint
/// offsets.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drawn {
    pub rods: [f64; LIMBS],
    pub base: [Vector3<f64>; LIMBS],
    pub platform: [Vector3<f64>; LIMBS],
    pub joint_offset: [f64; LIMBS],
}

impl Drawn {
    /// Those of a drawing.
    pub(super) fn new(geometry: &Geometry) -> Self {
        let limbs = &geometry.limbs;
        Self {
            rods: limbs.map(|l| l.rod_length_mm),
            base: limbs.map(|l| unit_vectors(l.base_angle_rad)[0] * l.base_radius_mm),
            platform: limbs.map(|l| unit_vectors(l.platform_angle_rad)[0] * l.platform_radius_mm),
            joint_offset: limbs.map(|l| l.joint_offset_mm),
        }
    }
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
            platform_joints: zero,
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
            k.platform_joints[i] = k.platform[i][0] * limb.platform_radius_mm;
            let [out, along] = &k.base[i];
            let rail = Vector3::z() + out * lean[i][0] + along * lean[i][1];
            k.rails[i] = rail / rail.norm();
            k.origins[i] = k.origin(i);
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
        self.platform_joints[limb]
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

    /// The sphere centre of a limb at a joint reading of zero.
    fn origin(&self, limb: usize) -> Vector3<f64> {
        self.base[limb][0] * self.base_radius[limb]
            + Vector3::z() * self.pivot[limb]
            + self.rails[limb] * (self.joint_offset[limb] - self.pivot[limb])
            - self.platform_joint(limb)
    }

    /// The same robot once parts of it have grown by their part of what is drawn; its joint readings grow as its rails.
    ///
    /// By what is drawn, not by what is identified: the difference is of second order, and the other way growth would tell,
    /// from next to nothing, where the base lies.
    pub(super) fn grown(&self, drawn: &Drawn, by: &Growth) -> Self {
        let mut k = *self;
        for i in 0..LIMBS {
            k.rods[i] += drawn.rods[i] * by.rods;
            k.joint_offset[i] += drawn.joint_offset[i] * by.rails;
            k.pivot[i] *= 1.0 + by.rails;
            k.platform_joints[i] += drawn.platform[i] * by.frame;
            k.origins[i] = k.origin(i) + drawn.base[i] * by.frame;
        }
        k
    }

    /// How far a carriage moves with the growth of the rails, at a joint reading.
    pub(super) fn by_rails(&self, drawn: &Drawn, limb: usize, joint: f64) -> Vector3<f64> {
        let along = joint + drawn.joint_offset[limb] - self.pivot[limb];
        Vector3::z() * self.pivot[limb] + self.rails[limb] * along
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

    /// [`Self::forward`] for poses side by side, without branches.
    ///
    /// Returns the positions, and one for those in reach, zero for the others: their positions have no meaning, and
    /// [`Self::forward`] says why.
    #[inline(always)]
    #[must_use]
    pub fn forward_lanes<T: Real>(&self, joints: [T; LIMBS]) -> (Triple<T>, T) {
        if self.lean == [[0.0; 2]; LIMBS] {
            self.lanes::<T, true>(joints)
        } else {
            self.lanes::<T, false>(joints)
        }
    }

    #[inline(always)]
    fn lanes<T: Real, const VERTICAL: bool>(&self, joints: [T; LIMBS]) -> (Triple<T>, T) {
        let (zero, sign) = (T::splat(0.0), T::splat(self.assembly.sign()));
        let centres = self.centres_of::<T, VERTICAL>(joints);
        let meeting = meet(&centres, &self.rods, self.side);
        let mut reached = meeting.height_squared.at_least(zero, T::splat(1.0), zero);
        for i in 0..LIMBS {
            let up = subtract(meeting.point, centres[i]);
            let rail = [0, 1, 2].map(|axis| T::splat(self.rails[i][axis]));
            let beyond = if VERTICAL { up[2] } else { dot(up, rail) };
            reached = zero.at_least(sign * beyond, reached, zero);
        }
        (meeting.point, reached)
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

    /// [`Self::inverse`] for poses side by side, marked as by [`Self::forward_lanes`].
    #[inline(always)]
    #[must_use]
    pub fn inverse_lanes<T: Real>(&self, position: Triple<T>) -> ([T; LIMBS], T) {
        let zero = T::splat(0.0);
        let (mut out, mut reached) = ([zero; LIMBS], T::splat(1.0));
        let sign = T::splat(self.assembly.sign());
        for limb in 0..LIMBS {
            let rail = [0, 1, 2].map(|axis| T::splat(self.rails[limb][axis]));
            let origin = [0, 1, 2].map(|axis| T::splat(self.origins[limb][axis]));
            let v = subtract(position, origin);
            let along = dot(v, rail);
            let across = subtract(v, scale(rail, along));
            let rise_squared = T::splat(self.rods[limb] * self.rods[limb]) - dot(across, across);
            out[limb] = along + sign * rise_squared.root();
            reached = rise_squared.at_least(zero, reached, zero);
            // not so where the height is not finite
            reached = T::splat(f64::INFINITY).above(along.size(), reached, zero);
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

    /// [`Self::pose`] for poses side by side.
    #[inline(always)]
    pub(super) fn poses<T: Real>(&self, joints: [T; LIMBS]) -> Poses<T> {
        let (position, reached) = self.forward_lanes(joints);
        let centres = self.centres(joints);
        let [a, b, c] = centres;
        let rods = [
            subtract(position, a),
            subtract(position, b),
            subtract(position, c),
        ];
        let crosses = [
            cross(rods[1], rods[2]),
            cross(rods[2], rods[0]),
            cross(rods[0], rods[1]),
        ];
        let volume = dot(rods[0], crosses[0]);
        let size_squared = dot(rods[0], rods[0]) * dot(rods[1], rods[1]) * dot(rods[2], rods[2]);
        let least = T::splat(SINGULAR * SINGULAR) * size_squared;
        let inverse = T::splat(1.0) / volume;
        Poses {
            position,
            reached: (volume * volume).above(least, reached, T::splat(0.0)),
            rods,
            answers: [
                scale(crosses[0], inverse),
                scale(crosses[1], inverse),
                scale(crosses[2], inverse),
            ],
        }
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
