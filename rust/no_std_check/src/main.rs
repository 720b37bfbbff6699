//! A program without `std` that calls the core's loop functions. It is built, never run: if the core or one
//! of its dependencies needed `std`, its panic handler would clash with the one below.
#![no_std]
#![no_main]

use core::panic::PanicInfo;
use nalgebra::{Vector2, Vector3};
use sherkit_core::camera::{Description, Face};
use sherkit_core::chain::effects::Wanted;
use sherkit_core::chain::{Aim, Frame, Robot};
use sherkit_core::delta::{
    Assembly, Branch, Calibrated, Covariates, GEOMETRIC, Geometry, Model, PARAMETERS,
};
use sherkit_core::numbers::rigid::Rigid;
use sherkit_core::spherical;

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
    let model = Model {
        geometry: Geometry::from_parameters(parameters, Assembly::Below),
        target_offset: Vector3::zeros(),
        sensor: Rigid::identity(),
        rod_spacing: 40.0,
        pole_pitch: [2.0; 3],
        home: [0.0; 3],
        time_origin_s: 0.0,
        slip_time_s: 0.0,
        joint_slip_time_s: 0.0,
        sensor_slip_time_s: 0.0,
    };
    let Ok(chain) = model.with(&[0.0; PARAMETERS]) else {
        return 1;
    };
    let whole = Branch::new(&chain, None);
    let robot = Calibrated {
        whole,
        local: None,
        frame: Frame::Sensor,
    };
    let Ok((position, _)) = robot.forward(&Vector3::from(*joints), &Covariates::NONE) else {
        return 2;
    };
    let Ok(next) = robot.inverse(&position, &Covariates::NONE) else {
        return 3;
    };
    target.copy_from_slice(next.as_slice());
    0
}

/// The same for the spherical robot: the pixel of its marker, and the joints that bring it there.
#[unsafe(no_mangle)]
pub extern "C" fn spherical_step(
    camera: &[f64; 15],
    joints: &mut [f64; 2],
    pixel: &[f64; 2],
) -> i32 {
    let model = spherical::Model {
        geometry: spherical::Geometry::equal(0.8, 0.8),
        radius_mm: 200.0,
        camera: Description::from_parameters(camera),
        face: Face::Near,
        readings: spherical::Readings::Pixels,
        gravity: -Vector3::z(),
        home: [0.0; 2],
        time_origin_s: 0.0,
        slip_time_s: 0.0,
        joint_slip_time_s: 0.0,
        encoder_period: [0.4, 0.3],
        sensor_slip_time_s: 0.0,
    };
    let Ok(chain) = model.with(&[0.0; spherical::PARAMETERS]) else {
        return 1;
    };
    let row = spherical::Row {
        joints: *joints,
        to: None,
        aim: Aim::default(),
        covariates: spherical::Covariates::NONE,
        push: Vector3::zeros(),
    };
    if chain.row_predict(&row, Wanted::ALL).is_err()
        || chain
            .inverse_residual(&row, &Vector2::from(*pixel))
            .is_err()
    {
        return 2;
    }
    let Ok(camera) = model.camera(&[0.0; spherical::PARAMETERS]) else {
        return 1;
    };
    let seen = camera.angles_on_sphere(&Vector2::from(*pixel), 200.0, Face::Near);
    let Ok(angles) = seen else { return 3 };
    let Ok(found) = chain
        .structure()
        .kinematics()
        .inverse(&angles, spherical::Elbows::Open)
    else {
        return 4;
    };
    joints.copy_from_slice(found.as_slice());
    0
}
