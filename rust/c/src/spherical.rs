//! The calibrated spherical robot.

use crate::delta::{code_of_reading, numbers};
use crate::result::{answer, code_of, finite, sherkit_result};
use crate::storage::{Opaque, clear, get, given, put, wanted};
use nalgebra::Vector2;
use sherkit_core::flat;
use sherkit_core::spherical::{Calibrated, Covariates};

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

/// Loads a calibration: count numbers as sherkit writes them. They are copied. Where it fails the robot is not
/// initialised.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_spherical_init(
    robot: *mut sherkit_spherical,
    numbers: *const f64,
    count: usize,
) -> sherkit_result {
    // SAFETY: pointers are null or valid.
    answer(unsafe {
        clear(robot);
        self::numbers(numbers, count)
            .and_then(|row| flat::read_spherical(row).map_err(|e| code_of_reading(&e)))
            .and_then(|found| put(robot, found))
    })
}

/// What is known, or nothing. A loop commands places, so velocities are zero.
unsafe fn known(covariates: *const sherkit_spherical_covariates) -> Covariates {
    // SAFETY: null or valid.
    let known = unsafe { covariates.as_ref() }.map_or(Covariates::NONE, |c| Covariates {
        time_s: c.time_s,
        temperature_c: c.temperature_c,
        direction: c.direction,
        ..Covariates::NONE
    });
    Covariates {
        velocity_rad_s: [0.0; 2],
        ..known
    }
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
    let run = || {
        // SAFETY: pointers are null or valid.
        unsafe {
            let (robot, joints) = (get(robot)?, given(joints.cast::<[f64; 2]>())?);
            let angles = wanted(angles.cast::<[f64; 2]>())?;
            let found = robot.forward(&Vector2::from(*joints), &known(covariates));
            let (x, j) = found.map_err(|e| code_of(&e))?;
            finite(x.iter().chain(&j))?;
            *angles = x.into();
            if let Some(jacobian) = jacobian.cast::<[[f64; 2]; 2]>().as_mut() {
                *jacobian = j.transpose().into();
            }
        }
        Ok(())
    };
    answer(run())
}

/// Joint readings (2, rad) at which the tool points to phi, gamma (rad), to 1e-12 rad. Covariates may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_spherical_inverse(
    robot: *const sherkit_spherical,
    angles: *const f64,
    covariates: *const sherkit_spherical_covariates,
    joints: *mut f64,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        unsafe {
            let (robot, angles) = (get(robot)?, given(angles.cast::<[f64; 2]>())?);
            let joints = wanted(joints.cast::<[f64; 2]>())?;
            let found = robot.inverse(&Vector2::from(*angles), &known(covariates));
            let q = found.map_err(|e| code_of(&e))?;
            finite(&q)?;
            *joints = q.into();
        }
        Ok(())
    };
    answer(run())
}
