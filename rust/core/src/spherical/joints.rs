//! The joints link: from joint readings to the joints as they were when the camera saw them.

use super::geometry::LIMBS;
use super::parameters::{
    BACKLASH, CAMERA_DELAY, ENCODER_ECCENTRICITY, JOINT_OFFSET, JOINT_SCALE, PARAMETERS, Values, of,
};
use crate::math::sin_cos;
use nalgebra::{SMatrix, Vector2};

/// What a row brings besides its readings. NaN where it is not known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariates {
    /// Time of the reading, s.
    pub time_s: f64,
    /// Temperature, °C.
    pub temperature_c: f64,
    /// Direction of the last motion of each joint, ±1 or 0.
    pub direction: [f64; LIMBS],
    /// Velocity of each joint, rad/s.
    pub velocity_rad_s: [f64; LIMBS],
}

impl Covariates {
    /// Nothing known.
    pub const NONE: Self = Self {
        time_s: f64::NAN,
        temperature_c: f64::NAN,
        direction: [f64::NAN; LIMBS],
        velocity_rad_s: [f64::NAN; LIMBS],
    };
}

/// Effects that act at the joints.
#[derive(Clone, Copy, Debug)]
pub(super) struct JointEffects {
    offset: [f64; LIMBS],
    scale: [f64; LIMBS],
    eccentricity: [f64; 2 * LIMBS],
    backlash: [f64; LIMBS],
    delay: f64,
    home: [f64; LIMBS],
}

/// Joint readings turned into joints, with derivatives by reading and by the link's own parameters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Joints {
    pub value: Vector2<f64>,
    pub by_reading: [f64; LIMBS],
    /// Per joint: by scale, by sine, by cosine, by backlash, by delay.
    by_own: [[f64; 5]; LIMBS],
}

impl JointEffects {
    pub fn new(values: &Values, home: [f64; LIMBS]) -> Self {
        Self {
            offset: of(values, JOINT_OFFSET),
            scale: of(values, JOINT_SCALE),
            eccentricity: of(values, ENCODER_ECCENTRICITY),
            backlash: of(values, BACKLASH),
            delay: of::<1>(values, CAMERA_DELAY)[0],
            home,
        }
    }

    /// `θ = r + o + s (r - home) + a sin r + b cos r + w direction/2 - delay · velocity`.
    #[inline]
    pub fn at(&self, readings: &[f64; LIMBS], row: &Covariates) -> Joints {
        let mut out = Joints {
            value: Vector2::from(*readings),
            by_reading: [1.0; LIMBS],
            by_own: [[0.0; 5]; LIMBS],
        };
        for i in 0..LIMBS {
            let r = readings[i];
            let from_home = r - self.home[i];
            let half_way = 0.5 * row.direction[i];
            let (sin, cos) = sin_cos(r);
            let [a, b] = [self.eccentricity[2 * i], self.eccentricity[2 * i + 1]];
            out.value[i] += self.offset[i] + self.scale[i] * from_home + a * sin + b * cos;
            // an effect at zero does not ask for its covariate
            if self.backlash[i] != 0.0 {
                out.value[i] += self.backlash[i] * half_way;
            }
            if self.delay != 0.0 {
                out.value[i] -= self.delay * row.velocity_rad_s[i];
            }
            out.by_reading[i] += self.scale[i] + a * cos - b * sin;
            out.by_own[i] = [from_home, sin, cos, half_way, -row.velocity_rad_s[i]];
        }
        out
    }
}

impl Joints {
    /// Writes the columns of the link's own parameters, carried on by the derivative by the joints.
    #[inline]
    pub fn columns<const N: usize>(
        &self,
        d: &mut SMatrix<f64, N, PARAMETERS>,
        by_joints: &SMatrix<f64, N, LIMBS>,
    ) {
        let mut delay = SMatrix::<f64, N, 1>::zeros();
        for i in 0..LIMBS {
            let by_joint = by_joints.column(i);
            let [scale, sin, cos, half_way, late] = self.by_own[i];
            for (index, gain) in [
                (JOINT_OFFSET.start + i, 1.0),
                (JOINT_SCALE.start + i, scale),
                (ENCODER_ECCENTRICITY.start + 2 * i, sin),
                (ENCODER_ECCENTRICITY.start + 2 * i + 1, cos),
                (BACKLASH.start + i, half_way),
            ] {
                d.set_column(index, &(by_joint * gain));
            }
            delay += by_joint * late;
        }
        d.set_column(CAMERA_DELAY.start, &delay);
    }

    /// Carries a derivative by the joints on to one by the readings.
    #[inline]
    pub fn by_readings<const N: usize>(
        &self,
        mut by_joints: SMatrix<f64, N, LIMBS>,
    ) -> SMatrix<f64, N, LIMBS> {
        for i in 0..LIMBS {
            by_joints.column_mut(i).scale_mut(self.by_reading[i]);
        }
        by_joints
    }
}
