//! The inverse of a calibrated robot: Newton's iteration with a bound, once for every robot.

use crate::{Error, Result};
use nalgebra::{SMatrix, SVector};

const ITERATIONS: usize = 30;

/// Joint readings at which nothing is missed any more. `miss` gives what is still missed at joint readings, and the
/// derivative of what is reached by them.
///
/// # Errors
/// Those of `miss`; [`Error::Singular`]; [`Error::NotConverged`] where the model folds over.
pub(crate) fn inverse<const J: usize>(
    start: SVector<f64, J>,
    miss: impl Fn(&SVector<f64, J>) -> Result<(SVector<f64, J>, SMatrix<f64, J, J>)>,
    settled: impl Fn(&SVector<f64, J>) -> bool,
) -> Result<SVector<f64, J>> {
    let mut joints = start;
    for _ in 0..ITERATIONS {
        let (missed, by_joints) = miss(&joints)?;
        if settled(&missed) {
            return Ok(joints);
        }
        joints += by_joints.try_inverse().ok_or(Error::Singular)? * missed;
    }
    Err(Error::NotConverged {
        iterations: ITERATIONS,
    })
}
