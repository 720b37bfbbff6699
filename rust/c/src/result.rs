//! What a function says.

use sherkit_core::Error;

/// One of the SHERKIT codes: SHERKIT_OK, or why not.
pub type sherkit_result = i32;

/// Done.
pub const SHERKIT_OK: i32 = 0;
/// A pointer that must point to something is null.
pub const SHERKIT_NULL: i32 = 1;
/// The object has not been initialised, or is one of another kind.
pub const SHERKIT_NOT_INITIALISED: i32 = 2;
/// A number in or out is NaN or infinite; a covariate may be what lacks.
pub const SHERKIT_NOT_FINITE: i32 = 3;
/// The robot cannot take this pose.
pub const SHERKIT_OUT_OF_REACH: i32 = 4;
/// The robot stands where joints and position do not follow from each other.
pub const SHERKIT_SINGULAR: i32 = 5;
/// The bounded iteration did not settle.
pub const SHERKIT_NOT_CONVERGED: i32 = 6;
/// Numbers that mean nothing: a negative variance, a length of zero, a geometry that is no robot, a frame that is none.
pub const SHERKIT_INVALID: i32 = 7;
/// A calibration that this version cannot read.
pub const SHERKIT_UNREADABLE: i32 = 8;

/// The code of an error.
pub fn code_of(error: &Error) -> sherkit_result {
    match error {
        Error::OutOfReach { .. }
        | Error::LimbReversed { .. }
        | Error::LimbsApart { .. }
        | Error::AxisOutOfReach { .. }
        | Error::TargetOutOfReach { .. }
        | Error::OtherAssembly
        | Error::BehindCamera { .. }
        | Error::RayMisses { .. }
        | Error::LensFolds => SHERKIT_OUT_OF_REACH,
        Error::Singular | Error::SingularPose(_) | Error::Collinear { .. } => SHERKIT_SINGULAR,
        Error::NotFinite { .. } => SHERKIT_NOT_FINITE,
        Error::NotConverged { .. } | Error::NoOptimum => SHERKIT_NOT_CONVERGED,
        Error::InvalidGeometry { .. }
        | Error::InvalidCamera { .. }
        | Error::WrongLength { .. }
        | Error::TooFew { .. }
        | Error::Invalid { .. } => SHERKIT_INVALID,
    }
}

/// What the core made, or the code of its error.
pub fn coded<T>(made: sherkit_core::Result<T>) -> Result<T, sherkit_result> {
    made.map_err(|error| code_of(&error))
}

/// The code of what was done.
pub fn answer(done: Result<(), sherkit_result>) -> sherkit_result {
    match done {
        Ok(()) => SHERKIT_OK,
        Err(code) => code,
    }
}

/// Refuses results that are not finite: a calibration of numbers beyond all measure can make them.
pub fn finite<'a>(numbers: impl IntoIterator<Item = &'a f64>) -> Result<(), sherkit_result> {
    let all = numbers.into_iter().all(|x| x.is_finite());
    if all { Ok(()) } else { Err(SHERKIT_NOT_FINITE) }
}
