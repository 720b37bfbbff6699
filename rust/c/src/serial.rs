//! The calibrated serial arm. It has as many joints as its calibration says, so arrays of joints are as long as that.

use crate::frame::{self, Framed, sherkit_frame};
use crate::result::{SHERKIT_NULL, answer, code_of, finite, sherkit_result};
use crate::robot::{self, Read, known};
use crate::storage::{Opaque, get, given, wanted};
use core::slice::{from_raw_parts, from_raw_parts_mut};
use nalgebra::{SVector, Vector3};
use sherkit_core::chain::Frame;
use sherkit_core::serial::{Calibrated, Covariates, JOINTS};
use sherkit_core::{Result, flat};

/// A calibrated serial arm. Its content is nobody's business.
#[repr(C)]
pub struct sherkit_serial {
    words: [u64; 1152],
}

// SAFETY: one array of so many words.
unsafe impl Opaque for sherkit_serial {
    type Value = Calibrated;
    const MARK: u64 = 0x7368_6b73_6572_6961;
    const WORDS: usize = 1152;
}

/// What a pose of the arm depends on beside its joints. NaN where it is not known; an effect that needs it then gives
/// SHERKIT_NOT_FINITE.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sherkit_serial_covariates {
    /// Time, s, on the clock of the calibration.
    pub time_s: f64,
    /// Temperature, degrees Celsius.
    pub temperature_c: f64,
    /// Direction of the last motion of each joint, 1, -1 or 0; those beyond its joints are not looked at.
    pub direction: [f64; 9],
    /// What hangs at its first target besides its own weight, kg.
    pub payload_kg: f64,
}

impl From<sherkit_serial_covariates> for Covariates {
    fn from(c: sherkit_serial_covariates) -> Self {
        Self {
            time_s: c.time_s,
            temperature_c: c.temperature_c,
            direction: c.direction,
            payload_kg: c.payload_kg,
            ..Self::NONE
        }
    }
}

impl Read for sherkit_serial {
    fn read(numbers: &'static [f64]) -> Result<Self::Value> {
        flat::read_serial(numbers)
    }
}

impl Framed for sherkit_serial {
    fn in_frame(robot: &Self::Value, frame: Frame) -> Self::Value {
        robot.in_frame(frame)
    }
}

/// Joints of an arm from C, the others zero.
///
/// # Safety
/// The pointer is null or points to as many numbers as the arm has joints.
unsafe fn joints_of(
    robot: &Calibrated,
    joints: *const f64,
) -> core::result::Result<SVector<f64, JOINTS>, sherkit_result> {
    if joints.is_null() {
        return Err(SHERKIT_NULL);
    }
    let mut out = SVector::<f64, JOINTS>::zeros();
    // SAFETY: the caller's word.
    let given = unsafe { from_raw_parts(joints, robot.joints()) };
    out.iter_mut().zip(given).for_each(|(o, q)| *o = *q);
    Ok(out)
}

/// Loads a calibration: count numbers as sherkit writes them. They are copied. Where it fails the robot is not
/// initialised. Its positions are in the frame of the base, see sherkit_serial_use_frame.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_serial_init(
    robot: *mut sherkit_serial,
    numbers: *const f64,
    count: usize,
) -> sherkit_result {
    // SAFETY: the caller's word.
    unsafe { robot::init(robot, numbers, count) }
}

/// Chooses the frame of positions from now on: SHERKIT_FRAME_BASE, which it is after sherkit_serial_init, or
/// SHERKIT_FRAME_SENSOR. An arm's programs are written in its base, from which its controller counts, and the instrument
/// is taken away after the measurement; in the frame of the sensor positions are what it would read where it stood at
/// last. SHERKIT_INVALID for any other value, which changes nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_serial_use_frame(
    robot: *mut sherkit_serial,
    frame: sherkit_frame,
) -> sherkit_result {
    // SAFETY: the caller's word.
    unsafe { frame::use_frame(robot, frame) }
}

/// How many joints it has, 1 to 9.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_serial_joints(
    robot: *const sherkit_serial,
    count: *mut usize,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        unsafe { *wanted(count)? = get(robot)?.joints() };
        Ok(())
    };
    answer(run())
}

/// Position (3, mm) of the target, in the frame that is used, for the readings of its joints (rad, or mm of those that
/// slide), and its derivative by them (3 times as many, row by row) unless jacobian is null. Covariates may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_serial_forward(
    robot: *const sherkit_serial,
    joints: *const f64,
    covariates: *const sherkit_serial_covariates,
    position: *mut f64,
    jacobian: *mut f64,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        unsafe {
            let robot = get(robot)?;
            let (q, out) = (
                joints_of(robot, joints)?,
                wanted(position.cast::<[f64; 3]>())?,
            );
            let (x, j) = robot
                .forward(&q, &known(covariates))
                .map_err(|e| code_of(&e))?;
            finite(x.iter().chain(&j))?;
            *out = x.into();
            if !jacobian.is_null() {
                let count = robot.joints();
                for (axis, row) in j.row_iter().enumerate() {
                    let out = from_raw_parts_mut(jacobian.add(axis * count), count);
                    out.iter_mut().zip(&row).for_each(|(o, v)| *o = *v);
                }
            }
        }
        Ok(())
    };
    answer(run())
}

/// Readings of its joints within their limits at which the target is at a position (3, mm) of the frame that is used, to
/// 1 nm: of many postures that to which the smallest steps lead from start, which is where the arm stands.
/// SHERKIT_OUT_OF_REACH where they lead nowhere. Covariates may be null; joints and start may be the same array.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_serial_inverse(
    robot: *const sherkit_serial,
    position: *const f64,
    start: *const f64,
    covariates: *const sherkit_serial_covariates,
    joints: *mut f64,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        unsafe {
            let robot = get(robot)?;
            let (x, start) = (
                *given(position.cast::<[f64; 3]>())?,
                joints_of(robot, start)?,
            );
            let found = robot.inverse(&Vector3::from(x), &start, &known(covariates));
            let q = found.map_err(|e| code_of(&e))?;
            finite(&q)?;
            if joints.is_null() {
                return Err(SHERKIT_NULL);
            }
            let out = from_raw_parts_mut(joints, robot.joints());
            out.iter_mut().zip(&q).for_each(|(o, v)| *o = *v);
        }
        Ok(())
    };
    answer(run())
}
