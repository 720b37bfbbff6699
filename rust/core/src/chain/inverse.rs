//! The inverse of a calibrated robot: Newton's iteration with a bound, once for every robot.

use crate::{Error, Result};
use nalgebra::{SMatrix, SVector};

const ITERATIONS: usize = 30;

/// What is still missed at joint readings, the derivative of what is reached by them, and whether both are exact: what is
/// solved by iteration itself may come closer with each step of this one.
pub(crate) type Missed<const J: usize> = (SVector<f64, J>, SMatrix<f64, J, J>, bool);

/// Joint readings at which nothing is missed any more, as `miss` tells. Newton's iteration squares what is missed: where it
/// is `near`, the step that is left is the last. What is reached then is asked once more, of `again`, which knows nothing
/// of the way there: a calibration that makes no robot may come near on a branch that forward kinematics never takes.
///
/// # Errors
/// Those of `miss` and `again`; [`Error::Singular`]; [`Error::NotConverged`] where the model folds over.
pub(crate) fn inverse<const J: usize>(
    start: SVector<f64, J>,
    mut miss: impl FnMut(&SVector<f64, J>) -> Result<Missed<J>>,
    again: impl FnOnce(&SVector<f64, J>) -> Result<SVector<f64, J>>,
    near: impl Fn(&SVector<f64, J>) -> bool,
) -> Result<SVector<f64, J>> {
    let mut joints = start;
    for _ in 0..ITERATIONS {
        let (missed, by_joints, exact) = miss(&joints)?;
        joints += by_joints.try_inverse().ok_or(Error::Singular)? * missed;
        if exact && near(&missed) {
            if near(&again(&joints)?) {
                return Ok(joints);
            }
            break;
        }
    }
    Err(Error::NotConverged {
        iterations: ITERATIONS,
    })
}
