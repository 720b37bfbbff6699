//! Forward and inverse kinematics of two unequal limbs with their exact derivatives: two cones that meet.
//!
//! Limb i holds the tool axis `x` on a cone about its elbow axis `e_i`: `x·e_i = cos β_i`, `|x| = 1`, with `e_i` at
//! the polar angle `α_i` and the azimuth `ψ_i = θ_i + offset_i`.
//!
//! NaN or infinite input gives [`Error::NotFinite`]. Stack: below 1 kB.

use super::cones::{Cones, Meeting};
use super::geometry::{Elbows, Geometry, LIMBS};
use super::pose::{Pose, SINGULAR};
use crate::numbers::math::{Real, dot, sin_cos, sqrt};
use crate::numbers::trig;
use crate::{Error, Result, Singularity};
use core::f64::consts::PI;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Where the cones touch, rounding leaves elbow axes and tool axis a volume of the root of an ulp.
const TOUCHING: f64 = 1e-7;

/// A spherical robot ready to compute with: sines and cosines are taken once.
#[derive(Clone, Copy, Debug)]
pub struct Kinematics {
    cones: Cones,
    alpha: [f64; LIMBS],
    beta: [f64; LIMBS],
}

impl Kinematics {
    /// Prepares a geometry.
    ///
    /// # Errors
    /// [`Error::InvalidGeometry`] where a number is not finite or an arc is not between 0 and π.
    pub fn new(geometry: &Geometry) -> Result<Self> {
        geometry.check()?;
        let limbs = &geometry.limbs;
        let alpha = limbs.map(|l| sin_cos(l.alpha_rad));
        let beta = limbs.map(|l| l.beta_rad);
        Ok(Self {
            cones: Cones {
                sign: geometry.assembly.sign(),
                sin_alpha: alpha.map(|a| a.0),
                cos_alpha: alpha.map(|a| a.1),
                cos_beta: beta.map(|b| sin_cos(b).1),
                offset: limbs.map(|l| l.offset_rad),
            },
            alpha: limbs.map(|l| l.alpha_rad),
            beta,
        })
    }

    /// The same with other distal arcs, rad.
    pub(super) fn with_beta(mut self, beta: [f64; LIMBS]) -> Self {
        self.beta = beta;
        self.cones.cos_beta = beta.map(|b| sin_cos(b).1);
        self
    }

    pub(super) fn beta(&self) -> &[f64; LIMBS] {
        &self.beta
    }

    fn azimuths(&self, joints: &Vector2<f64>) -> [f64; LIMBS] {
        [
            joints.x + self.cones.offset[0],
            joints.y + self.cones.offset[1],
        ]
    }

    /// Solves for the tool axis; the pole is let through.
    fn solve(&self, joints: &Vector2<f64>) -> Result<Meeting<f64>> {
        finite(joints)?;
        let [a, b] = self.azimuths(joints);
        let half = 0.5 * (a - b);
        // the lanes' own sine within its range, so that both give the same bits
        let sines = if half.abs() <= trig::LARGEST_RAD {
            trig::sin_cos(half)
        } else {
            sin_cos(half)
        };
        let m = self.cones.meet(0.5 * (a + b), sines);
        if m.spread_squared < SINGULAR * SINGULAR {
            return Err(Error::SingularPose(Singularity::ElbowsAligned));
        }
        if m.height_squared < 0.0 {
            let [_, d] = self.cones.halves(sines);
            let between = 2.0 * libm::asin(sqrt(dot(d, d)).min(1.0));
            return Err(Error::LimbsApart {
                miss_rad: self.apart(between),
            });
        }
        Ok(m)
    }

    /// How much farther apart than the cones allow (positive) or nearer (negative) the elbows are, rad.
    fn apart(&self, between: f64) -> f64 {
        let [b1, b2] = self.beta;
        let most = (b1 + b2).min(2.0 * PI - b1 - b2);
        if between > most {
            between - most
        } else {
            between - (b1 - b2).abs()
        }
    }

    /// φ and γ of the tool axis for joint angles, rad.
    ///
    /// # Errors
    /// [`Error::LimbsApart`] where the cones do not meet, [`Error::SingularPose`] where the elbow axes coincide or
    /// the tool axis lies on the actuated axis, [`Error::NotFinite`].
    pub fn forward(&self, joints: &Vector2<f64>) -> Result<Vector2<f64>> {
        let m = self.solve(joints)?;
        if m.polar_squared < SINGULAR * SINGULAR {
            return Err(Error::SingularPose(Singularity::Pole));
        }
        Ok(Vector2::from(m.angles))
    }

    /// [`Self::forward`] for poses side by side, without branches.
    ///
    /// Returns φ, γ, and one for those that can be computed, zero for the others: their angles have no meaning, and
    /// [`Self::forward`] says why. Angles beyond [`trig::LARGEST_RAD`] are left to it too.
    #[inline(always)]
    #[must_use]
    pub fn forward_lanes<T: Real>(&self, joints: [T; LIMBS]) -> ([T; 2], T) {
        let of = T::splat;
        let [a, b] = [0, 1].map(|i| joints[i] + of(self.cones.offset[i]));
        let half = of(0.5) * (a - b);
        let m = self.cones.meet(of(0.5) * (a + b), trig::sin_cos(half));
        // asked so that a NaN is never reached
        let least = of(SINGULAR * SINGULAR);
        let mut reached = m.height_squared.at_least(of(0.0), of(1.0), of(0.0));
        for enough in [
            (m.spread_squared, least),
            (m.polar_squared, least),
            (of(f64::MAX), m.angles[0].size()),
            (of(trig::LARGEST_RAD), half.size()),
        ] {
            reached = enough.0.at_least(enough.1, reached, of(0.0));
        }
        (m.angles, reached)
    }

    /// Joint angles that bring the tool axis to φ, γ, rad, with the elbows on the given sides.
    ///
    /// # Errors
    /// [`Error::AxisOutOfReach`] names limb and angle, [`Error::OtherAssembly`] where the pose belongs to the other
    /// sign of Eq. 35, [`Error::SingularPose`] at γ = 0, [`Error::NotFinite`].
    pub fn inverse(&self, angles: &Vector2<f64>, elbows: Elbows) -> Result<Vector2<f64>> {
        finite(angles)?;
        let sines = if angles.y.abs() <= trig::LARGEST_RAD {
            trig::sin_cos(angles.y)
        } else {
            sin_cos(angles.y)
        };
        if sines.0.abs() < SINGULAR {
            return Err(Error::SingularPose(Singularity::Pole));
        }
        let (joints, cosines, side) = self.cones.reach(angles.x, sines, elbows.signs());
        if let Some(limb) = cosines.iter().position(|c| c.abs() > 1.0) {
            let miss_rad = miss_of(self.alpha[limb], self.beta[limb], angles.y);
            return Err(Error::AxisOutOfReach { limb, miss_rad });
        }
        if self.cones.sign * side < 0.0 {
            return Err(Error::OtherAssembly);
        }
        Ok(Vector2::from(joints))
    }

    /// [`Self::inverse`] for poses side by side, marked as by [`Self::forward_lanes`].
    #[inline(always)]
    #[must_use]
    pub fn inverse_lanes<T: Real>(&self, angles: [T; 2], elbows: Elbows) -> ([T; LIMBS], T) {
        let of = T::splat;
        let sines = trig::sin_cos(angles[1]);
        let (joints, cosines, side) = self.cones.reach(angles[0], sines, elbows.signs());
        let mut reached = of(1.0);
        for enough in [
            (of(1.0), cosines[0].size()),
            (of(1.0), cosines[1].size()),
            (sines.0.size(), of(SINGULAR)),
            (of(self.cones.sign) * side, of(0.0)),
            (of(f64::MAX), joints[0].size()),
            (of(trig::LARGEST_RAD), angles[1].size()),
        ] {
            reached = enough.0.at_least(enough.1, reached, of(0.0));
        }
        (joints, reached)
    }

    /// Solves the pose and keeps what its derivatives need. At γ = 0 the axis and its derivatives are given, φ is
    /// NaN.
    ///
    /// # Errors
    /// As [`Self::forward`] but for γ = 0, and [`Error::SingularPose`] where the cones touch.
    pub fn pose(&self, joints: &Vector2<f64>) -> Result<Pose> {
        let m = self.solve(joints)?;
        let [a, b] = self.azimuths(joints);
        let (sin, cos) = sin_cos(0.5 * (a + b));
        let axis = Vector3::new(
            m.axis[0] * cos - m.axis[1] * sin,
            m.axis[0] * sin + m.axis[1] * cos,
            m.axis[2],
        );
        let mut pose = self.pose_at(axis, [a, b])?;
        let at_pole = m.polar_squared < SINGULAR * SINGULAR;
        pose.phi_rad = if at_pole { f64::NAN } else { m.angles[0] };
        pose.gamma_rad = m.angles[1];
        Ok(pose)
    }

    /// The pose whose tool axis stands at φ, γ, with each elbow on the side where the joints `near` have it; the
    /// assembly is not asked.
    ///
    /// # Errors
    /// As [`Self::inverse`] but for [`Error::OtherAssembly`].
    pub(super) fn pose_below(&self, angles: &Vector2<f64>, near: &Vector2<f64>) -> Result<Below> {
        finite(angles)?;
        let (sin, cos) = sin_cos(angles.y);
        if sin.abs() < SINGULAR {
            return Err(Error::SingularPose(Singularity::Pole));
        }
        let azimuths = self.azimuths(near);
        let signs = azimuths.map(|a| 1.0_f64.copysign(sin_cos(a - angles.x).0));
        let (joints, cosines, _) = self.cones.reach(angles.x, (sin, cos), signs);
        if let Some(limb) = cosines.iter().position(|c| c.abs() > 1.0) {
            let miss_rad = miss_of(self.alpha[limb], self.beta[limb], angles.y);
            return Err(Error::AxisOutOfReach { limb, miss_rad });
        }
        let (sp, cp) = sin_cos(angles.x);
        let axis = Vector3::new(sin * cp, sin * sp, cos);
        let joints = Vector2::from(joints);
        let mut pose = self.pose_at(axis, self.azimuths(&joints))?;
        pose.phi_rad = angles.x;
        pose.gamma_rad = angles.y;
        Ok(Below { joints, pose })
    }

    /// The pose of a tool axis and elbow azimuths that belong together; its angles are left open.
    fn pose_at(&self, axis: Vector3<f64>, azimuths: [f64; LIMBS]) -> Result<Pose> {
        let zero = [Vector3::zeros(); LIMBS];
        let (mut elbows, mut normals, mut tangents) = (zero, zero, zero);
        for (i, azimuth) in azimuths.into_iter().enumerate() {
            let (sin, cos) = sin_cos(azimuth);
            let (sa, ca) = (self.cones.sin_alpha[i], self.cones.cos_alpha[i]);
            elbows[i] = Vector3::new(sa * cos, sa * sin, ca);
            normals[i] = Vector3::new(-sin, cos, 0.0);
            tangents[i] = Vector3::new(ca * cos, ca * sin, -sa);
        }
        let crosses = [
            elbows[1].cross(&axis),
            axis.cross(&elbows[0]),
            elbows[0].cross(&elbows[1]),
        ];
        let volume = axis.dot(&crosses[2]);
        if volume.abs() < TOUCHING {
            return Err(Error::SingularPose(Singularity::ConesTouch));
        }
        let answers = Matrix3::from_columns(&crosses) / volume;
        Ok(Pose {
            axis,
            phi_rad: f64::NAN,
            gamma_rad: f64::NAN,
            elbows,
            normals,
            tangents,
            answers,
            sin_alpha: self.cones.sin_alpha,
            cos_alpha: self.cones.cos_alpha,
            sin_beta: self.beta.map(|b| sin_cos(b).0),
            cos_beta: self.cones.cos_beta,
        })
    }
}

/// A pose found from its tool axis, with its joint angles.
pub(super) struct Below {
    pub joints: Vector2<f64>,
    pub pose: Pose,
}

/// By how much γ exceeds what a limb reaches (positive), or falls short of it (negative), rad.
pub(super) fn miss_of(alpha: f64, beta: f64, gamma: f64) -> f64 {
    let gamma = libm::acos(sin_cos(gamma).1);
    let most = (alpha + beta).min(2.0 * PI - alpha - beta);
    if gamma > most {
        gamma - most
    } else {
        gamma - (alpha - beta).abs()
    }
}

fn finite(v: &Vector2<f64>) -> Result<()> {
    v.iter()
        .position(|c| !c.is_finite())
        .map_or(Ok(()), |index| Err(Error::NotFinite { index }))
}
