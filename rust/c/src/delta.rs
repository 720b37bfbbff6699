//! The calibrated delta.

use crate::frame::{self, Framed, sherkit_frame};
use crate::result::sherkit_result;
use crate::robot::{self, Read, Robot};
use crate::storage::Opaque;
use nalgebra::{Matrix3, Vector3};
use sherkit_core::chain::Frame;
use sherkit_core::delta::{Calibrated, Covariates};
use sherkit_core::{Result, flat};

/// A calibrated delta robot. Its content is nobody's business.
#[repr(C)]
pub struct sherkit_delta {
    words: [u64; 640],
}

// SAFETY: one array of so many words.
unsafe impl Opaque for sherkit_delta {
    type Value = Calibrated<'static>;
    const MARK: u64 = 0x7368_6b64_656c_7461;
    const WORDS: usize = 640;
}

/// What a reading of the delta depends on beside its joints. NaN where it is not known; an effect that needs it then
/// gives SHERKIT_NOT_FINITE.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sherkit_delta_covariates {
    /// Time, s, on the clock of the calibration.
    pub time_s: f64,
    /// Temperature, degrees Celsius.
    pub temperature_c: f64,
    /// Direction of the last motion of each joint: 1, -1 or 0.
    pub direction: [f64; 3],
}

impl From<sherkit_delta_covariates> for Covariates {
    fn from(c: sherkit_delta_covariates) -> Self {
        Self {
            time_s: c.time_s,
            temperature_c: c.temperature_c,
            direction: c.direction,
            ..Self::NONE
        }
    }
}

impl Read for sherkit_delta {
    fn read(numbers: &'static [f64]) -> Result<Self::Value> {
        flat::read_delta(numbers)
    }
}

impl Robot<3> for sherkit_delta {
    type Known = sherkit_delta_covariates;

    fn forward_at(
        robot: &Self::Value,
        joints: &Vector3<f64>,
        now: &Covariates,
    ) -> Result<(Vector3<f64>, Matrix3<f64>)> {
        robot.forward(joints, now)
    }

    fn inverse_at(
        robot: &Self::Value,
        place: &Vector3<f64>,
        now: &Covariates,
    ) -> Result<Vector3<f64>> {
        robot.inverse(place, now)
    }
}

impl Framed for sherkit_delta {
    fn in_frame(robot: &Self::Value, frame: Frame) -> Self::Value {
        robot.in_frame(frame)
    }
}

/// Loads a calibration: count numbers as sherkit writes them. They are not copied and must stay as they are for as
/// long as the robot is used. Where it fails the robot is not initialised. Its positions are in the frame of the sensor,
/// see sherkit_delta_use_frame.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_delta_init(
    robot: *mut sherkit_delta,
    numbers: *const f64,
    count: usize,
) -> sherkit_result {
    // SAFETY: the caller's word.
    unsafe { robot::init(robot, numbers, count) }
}

/// Chooses the frame of positions from now on: SHERKIT_FRAME_SENSOR, which it is after sherkit_delta_init, or
/// SHERKIT_FRAME_BASE. A delta is sent where its instrument reads the tool, because only there the readings promise
/// anything: how the base itself is tilted and shifted against them is no better known than the readings tell. In the
/// frame of the base the robot is where it is, whatever the instrument makes of it.
/// SHERKIT_INVALID for any other value, which changes nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_delta_use_frame(
    robot: *mut sherkit_delta,
    frame: sherkit_frame,
) -> sherkit_result {
    // SAFETY: the caller's word.
    unsafe { frame::use_frame(robot, frame) }
}

/// Position (3, mm) for joint readings (3, mm), and its derivative by them (9, row by row) unless jacobian is null,
/// both in the frame that is used. Covariates may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_delta_forward(
    robot: *const sherkit_delta,
    joints: *const f64,
    covariates: *const sherkit_delta_covariates,
    position: *mut f64,
    jacobian: *mut f64,
) -> sherkit_result {
    // SAFETY: the caller's word.
    unsafe { robot::forward(robot, joints, covariates, position, jacobian) }
}

/// Joint readings (3, mm) at which the robot stands at a position (3, mm) of the frame that is used, to 1 nm. Covariates
/// may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_delta_inverse(
    robot: *const sherkit_delta,
    position: *const f64,
    covariates: *const sherkit_delta_covariates,
    joints: *mut f64,
) -> sherkit_result {
    // SAFETY: the caller's word.
    unsafe { robot::inverse(robot, position, covariates, joints) }
}
