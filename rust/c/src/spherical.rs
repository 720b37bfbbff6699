//! The calibrated spherical robot.

use crate::result::sherkit_result;
use crate::robot::{self, Read, Robot};
use crate::storage::Opaque;
use nalgebra::{Matrix2, Vector2};
use sherkit_core::spherical::{Calibrated, Covariates};
use sherkit_core::{Result, flat};

/// A calibrated spherical robot. Its content is nobody's business.
#[repr(C)]
pub struct sherkit_spherical {
    words: [u64; 192],
}

// SAFETY: one array of so many words.
unsafe impl Opaque for sherkit_spherical {
    type Value = Calibrated;
    const MARK: u64 = 0x7368_6b73_7068_6572;
    const WORDS: usize = 192;
}

/// What a pose of the spherical robot depends on beside its joints. NaN where it is not known; an effect that needs
/// it then gives SHERKIT_NOT_FINITE.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sherkit_spherical_covariates {
    /// Time, s, on the clock of the calibration.
    pub time_s: f64,
    /// Temperature, degrees Celsius.
    pub temperature_c: f64,
    /// Direction of the last motion of each joint: 1, -1 or 0.
    pub direction: [f64; 2],
}

impl From<sherkit_spherical_covariates> for Covariates {
    fn from(c: sherkit_spherical_covariates) -> Self {
        Self {
            time_s: c.time_s,
            temperature_c: c.temperature_c,
            direction: c.direction,
            ..Self::NONE
        }
    }
}

impl Read for sherkit_spherical {
    fn read(numbers: &'static [f64]) -> Result<Self::Value> {
        flat::read_spherical(numbers)
    }
}

impl Robot<2> for sherkit_spherical {
    type Known = sherkit_spherical_covariates;

    fn forward_at(
        robot: &Self::Value,
        joints: &Vector2<f64>,
        now: &Covariates,
    ) -> Result<(Vector2<f64>, Matrix2<f64>)> {
        robot.forward(joints, now)
    }

    fn inverse_at(
        robot: &Self::Value,
        place: &Vector2<f64>,
        now: &Covariates,
    ) -> Result<Vector2<f64>> {
        robot.inverse(place, now)
    }
}

/// Loads a calibration: count numbers as sherkit writes them. They are copied. Where it fails the robot is not
/// initialised.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_spherical_init(
    robot: *mut sherkit_spherical,
    numbers: *const f64,
    count: usize,
) -> sherkit_result {
    // SAFETY: the caller's word.
    unsafe { robot::init(robot, numbers, count) }
}

/// Where the tool points (phi, gamma, rad) for joint readings (2, rad), and its derivative by them (4, row by row)
/// unless jacobian is null. Covariates may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_spherical_forward(
    robot: *const sherkit_spherical,
    joints: *const f64,
    covariates: *const sherkit_spherical_covariates,
    angles: *mut f64,
    jacobian: *mut f64,
) -> sherkit_result {
    // SAFETY: the caller's word.
    unsafe { robot::forward(robot, joints, covariates, angles, jacobian) }
}

/// Joint readings (2, rad) at which the tool points to phi, gamma (rad), to 1e-12 rad. Covariates may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_spherical_inverse(
    robot: *const sherkit_spherical,
    angles: *const f64,
    covariates: *const sherkit_spherical_covariates,
    joints: *mut f64,
) -> sherkit_result {
    // SAFETY: the caller's word.
    unsafe { robot::inverse(robot, angles, covariates, joints) }
}
