//! A program without `std` that calls the core's loop functions. It is built, never run: if the core or one
//! of its dependencies needed `std`, its panic handler would clash with the one below.
#![no_std]
#![no_main]

use core::panic::PanicInfo;
use nalgebra::Vector3;
use sherkit_core::calibrated::{Branch, Calibrated};
use sherkit_core::delta::{Assembly, GEOMETRIC, Geometry, Kinematics, Predictor};

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}

/// One step of a loop: where the robot is, and where its joints must go.
#[unsafe(no_mangle)]
pub extern "C" fn loop_step(
    parameters: &[f64; GEOMETRIC],
    joints: &[f64; 3],
    target: &mut [f64; 3],
) -> i32 {
    let geometry = Geometry::from_parameters(parameters, Assembly::Below);
    let Ok(kinematics) = Kinematics::new(&geometry) else {
        return 1;
    };
    let predictor = Predictor {
        kinematics,
        shift: Vector3::zeros(),
    };
    let whole = Branch {
        predictor,
        correction: None,
    };
    let robot = Calibrated { whole, local: None };
    let Ok((position, _)) = robot.forward(&Vector3::from(*joints)) else {
        return 2;
    };
    let Ok(next) = robot.inverse(&position) else {
        return 3;
    };
    target.copy_from_slice(next.as_slice());
    0
}
