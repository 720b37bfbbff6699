//! A calibrated robot in a control loop, whatever the robot: bodies once. The functions themselves stand in the
//! file of each robot, because what makes the header does not look into macros.

use crate::result::{SHERKIT_NULL, SHERKIT_UNREADABLE, answer, code_of, finite, sherkit_result};
use crate::storage::{Opaque, clear, get, given, put, wanted};
use nalgebra::{SMatrix, SVector};
use sherkit_core::chain::{Covariates, REFERENCE_TEMPERATURE_C};
use sherkit_core::{Error, Result};

/// What a row of numbers holds.
pub trait Read: Opaque {
    /// The robot of a row.
    fn read(numbers: &'static [f64]) -> Result<Self::Value>;
}

/// A calibrated robot of as many coordinates as joints.
pub trait Robot<const N: usize>: Read {
    /// What C says is known.
    type Known: Copy + Into<Covariates<N>>;
    /// Where it is at joint readings, with the derivative by them.
    fn forward_at(
        robot: &Self::Value,
        joints: &SVector<f64, N>,
        now: &Covariates<N>,
    ) -> Result<(SVector<f64, N>, SMatrix<f64, N, N>)>;
    /// Joint readings at which it is somewhere.
    fn inverse_at(
        robot: &Self::Value,
        place: &SVector<f64, N>,
        now: &Covariates<N>,
    ) -> Result<SVector<f64, N>>;
}

/// Loads a robot.
///
/// # Safety
/// Pointers are null or valid; the numbers outlive the robot where it does not copy them.
pub unsafe fn init<T: Read>(robot: *mut T, numbers: *const f64, count: usize) -> sherkit_result {
    // SAFETY: pointers are null or valid.
    answer(unsafe {
        clear(robot);
        self::numbers(numbers, count)
            .and_then(|row| T::read(row).map_err(|e| code_of_reading(&e)))
            .and_then(|found| put(robot, found))
    })
}

/// Where a robot is.
///
/// # Safety
/// Pointers are null or valid.
pub unsafe fn forward<T: Robot<N>, const N: usize>(
    robot: *const T,
    joints: *const f64,
    covariates: *const T::Known,
    place: *mut f64,
    jacobian: *mut f64,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        unsafe {
            let (robot, joints) = (get(robot)?, given(joints.cast::<[f64; N]>())?);
            let place = wanted(place.cast::<[f64; N]>())?;
            let found = T::forward_at(robot, &SVector::from(*joints), &known(covariates));
            let (x, j) = found.map_err(|e| code_of(&e))?;
            finite(x.iter().chain(&j))?;
            *place = x.into();
            if let Some(jacobian) = jacobian.cast::<[[f64; N]; N]>().as_mut() {
                *jacobian = j.transpose().into();
            }
        }
        Ok(())
    };
    answer(run())
}

/// Joint readings that bring a robot somewhere.
///
/// # Safety
/// Pointers are null or valid.
pub unsafe fn inverse<T: Robot<N>, const N: usize>(
    robot: *const T,
    place: *const f64,
    covariates: *const T::Known,
    joints: *mut f64,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        unsafe {
            let (robot, place) = (get(robot)?, given(place.cast::<[f64; N]>())?);
            let joints = wanted(joints.cast::<[f64; N]>())?;
            let found = T::inverse_at(robot, &SVector::from(*place), &known(covariates));
            let q = found.map_err(|e| code_of(&e))?;
            finite(&q)?;
            *joints = q.into();
        }
        Ok(())
    };
    answer(run())
}

/// What is known, or nothing. A loop commands places, so velocities are zero; it has no instrument whose stand warms.
///
/// # Safety
/// The pointer is null or valid.
pub unsafe fn known<K: Copy + Into<Covariates<N>>, const N: usize>(
    covariates: *const K,
) -> Covariates<N> {
    // SAFETY: null or valid.
    let known = unsafe { covariates.as_ref() }.map_or(Covariates::NONE, |c| (*c).into());
    Covariates {
        velocity: [0.0; N],
        stand_c: REFERENCE_TEMPERATURE_C,
        ..known
    }
}

/// The code of an error while a calibration is read.
fn code_of_reading(error: &Error) -> sherkit_result {
    match error {
        Error::Invalid { .. } | Error::WrongLength { .. } => SHERKIT_UNREADABLE,
        other => code_of(other),
    }
}

/// The numbers of a calibration.
///
/// # Safety
/// The pointer is null or points to so many numbers, which outlive what is made of them.
unsafe fn numbers(
    first: *const f64,
    count: usize,
) -> core::result::Result<&'static [f64], sherkit_result> {
    if first.is_null() {
        return Err(SHERKIT_NULL);
    }
    if count > isize::MAX as usize / 8 {
        return Err(SHERKIT_UNREADABLE);
    }
    // SAFETY: the caller's word, and the length is one that an array can have.
    Ok(unsafe { core::slice::from_raw_parts(first, count) })
}
