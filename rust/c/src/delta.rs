//! The calibrated delta.

use crate::result::{SHERKIT_NULL, SHERKIT_UNREADABLE, answer, code_of, finite, sherkit_result};
use crate::storage::{Opaque, clear, get, given, put, wanted};
use nalgebra::Vector3;
use sherkit_core::calibrated::Calibrated;
use sherkit_core::delta::Covariates;
use sherkit_core::{Error, flat};

/// A calibrated delta robot. Its content is nobody's business.
#[repr(C)]
pub struct sherkit_delta {
    words: [u64; 320],
}

// SAFETY: one array of so many words.
unsafe impl Opaque for sherkit_delta {
    type Value = Calibrated<'static>;
    const MARK: u64 = 0x7368_6b64_656c_7461;
    const WORDS: usize = 320;
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

/// The code of an error while a calibration is read.
pub fn code_of_reading(error: &Error) -> sherkit_result {
    match error {
        Error::Invalid { .. } | Error::WrongLength { .. } => SHERKIT_UNREADABLE,
        other => code_of(other),
    }
}

/// The numbers of a calibration.
///
/// # Safety
/// The pointer is null or points to so many numbers.
pub unsafe fn numbers<'a>(first: *const f64, count: usize) -> Result<&'a [f64], sherkit_result> {
    if first.is_null() {
        return Err(SHERKIT_NULL);
    }
    if count > isize::MAX as usize / 8 {
        return Err(SHERKIT_UNREADABLE);
    }
    // SAFETY: the caller's word, and the length is one that an array can have.
    Ok(unsafe { core::slice::from_raw_parts(first, count) })
}

/// Loads a calibration: count numbers as sherkit writes them. They are not copied and must stay as they are for as
/// long as the robot is used. Where it fails the robot is not initialised.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_delta_init(
    robot: *mut sherkit_delta,
    numbers: *const f64,
    count: usize,
) -> sherkit_result {
    // SAFETY: pointers are null or valid.
    answer(unsafe {
        clear(robot);
        self::numbers(numbers, count)
            .and_then(|row| flat::read_delta(row).map_err(|e| code_of_reading(&e)))
            .and_then(|found| put(robot, found))
    })
}

/// What is known, or nothing.
unsafe fn known(covariates: *const sherkit_delta_covariates) -> Covariates {
    // SAFETY: null or valid.
    unsafe { covariates.as_ref() }.map_or(Covariates::NONE, |c| Covariates {
        time_s: c.time_s,
        temperature_c: c.temperature_c,
        direction: c.direction,
    })
}

/// Position (3, mm) for joint readings (3, mm), and its derivative by them (9, row by row) unless jacobian is null.
/// Covariates may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_delta_forward(
    robot: *const sherkit_delta,
    joints: *const f64,
    covariates: *const sherkit_delta_covariates,
    position: *mut f64,
    jacobian: *mut f64,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        unsafe {
            let (robot, joints) = (get(robot)?, given(joints.cast::<[f64; 3]>())?);
            let position = wanted(position.cast::<[f64; 3]>())?;
            let found = robot.forward(&Vector3::from(*joints), &known(covariates));
            let (x, j) = found.map_err(|e| code_of(&e))?;
            finite(x.iter().chain(&j))?;
            *position = x.into();
            if let Some(jacobian) = jacobian.cast::<[[f64; 3]; 3]>().as_mut() {
                *jacobian = j.transpose().into();
            }
        }
        Ok(())
    };
    answer(run())
}

/// Joint readings (3, mm) at which the robot stands at a position (3, mm), to 1 nm. Covariates may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_delta_inverse(
    robot: *const sherkit_delta,
    position: *const f64,
    covariates: *const sherkit_delta_covariates,
    joints: *mut f64,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        unsafe {
            let (robot, position) = (get(robot)?, given(position.cast::<[f64; 3]>())?);
            let joints = wanted(joints.cast::<[f64; 3]>())?;
            let found = robot.inverse(&Vector3::from(*position), &known(covariates));
            let q = found.map_err(|e| code_of(&e))?;
            finite(&q)?;
            *joints = q.into();
        }
        Ok(())
    };
    answer(run())
}
