//! The camera: projection with derivatives, and back onto a sphere.

mod common;

use common::{Random, config, derivative};
use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use proptest::prelude::*;
use sherkit_core::Error;
use sherkit_core::camera::{
    Camera, Description, Face, PARAMETERS, left_jacobian, rotation_matrix, rotation_vector,
};
use std::f64::consts::FRAC_PI_2;

/// A camera near the paper's, anywhere about the sphere, with the distortion of a fair lens.
fn cameras() -> impl Strategy<Value = Description> {
    any::<u64>().prop_map(|seed| {
        let mut random = Random(seed);
        let mut of = |middle: f64, size: f64| middle + size * random.unit();
        let facing = Description::facing(of(0.0, 3.0), of(1.2, 1.0), of(450.0, 100.0), [0.0; 4]);
        // pushed and turned, so that the sphere is off the middle of the picture
        let turn = rotation_matrix(&Vector3::new(of(0.0, 0.1), of(0.0, 0.1), of(0.0, 3.0)));
        Description {
            intrinsics: [
                of(1100.0, 200.0),
                of(1100.0, 200.0),
                of(640.0, 20.0),
                of(320.0, 20.0),
            ],
            distortion: [
                of(-0.1, 0.1),
                of(0.02, 0.02),
                of(0.0, 2e-3),
                of(0.0, 2e-3),
                of(0.0, 0.01),
            ],
            rotation: rotation_vector(&(turn * rotation_matrix(&facing.rotation))),
            translation: turn * facing.translation
                + Vector3::new(of(0.0, 20.0), of(0.0, 20.0), 0.0),
        }
    })
}

proptest! {
    #![proptest_config(config())]

    /// A term of the distortion forgotten or in the wrong order, a rotation the wrong way: the textbook's formula
    /// written out again.
    #[test]
    fn projection_is_the_formula(camera in cameras(), point in prop::array::uniform3(-150.0..150.0_f64)) {
        let point = Vector3::from(point);
        let seen = Rotation3::new(camera.rotation) * point + camera.translation;
        let (x, y) = (seen.x / seen.z, seen.y / seen.z);
        let [k1, k2, p1, p2, k3] = camera.distortion;
        let r2 = x.powi(2) + y.powi(2);
        let radial = 1.0 + k1 * r2 + k2 * r2.powi(2) + k3 * r2.powi(3);
        let bent = Vector2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        let [fx, fy, cx, cy] = camera.intrinsics;
        let expected = Vector2::new(fx * bent.x + cx, fy * bent.y + cy);
        let ready = Camera::new(&camera).unwrap();
        let found = ready.project(&point).unwrap();
        prop_assert!((found - expected).amax() < 1e-9);
        let (lane, ok) = ready.project_lanes::<f64>(point.into());
        prop_assert_eq!((found.x, found.y, 1.0), (lane[0], lane[1], ok));
    }

    /// A derivative of the projection that forgets a term; at small and vanishing rotations too, where the general
    /// formula divides by zero.
    #[test]
    fn derivatives_are_exact(camera in cameras(), point in prop::array::uniform3(-150.0..150.0_f64), shrink in prop_oneof![Just(1.0), Just(0.0), Just(1e-9), 1e-3..2e-2_f64]) {
        let mut camera = camera;
        let point = Vector3::from(point);
        if shrink != 1.0 {
            camera.rotation *= shrink;
            camera.translation = Vector3::new(5.0, -7.0, 460.0);
        }
        let at = |p: &[f64; PARAMETERS], x: &Vector3<f64>| Camera::new(&Description::from_parameters(p)).unwrap().project(x).unwrap();
        let p = camera.parameters();
        let ready = Camera::new(&camera).unwrap();
        let found = ready.projection(&point).unwrap();
        let near = |a: Vector2<f64>, b: Vector2<f64>| (a - b).amax() < 1e-7 * (1.0 + b.amax());
        for axis in 0..3 {
            let expected = derivative(|h| at(&p, &(point + Vector3::ith(axis, h))), 0.5);
            prop_assert!(near(ready.by_point(&found).column(axis).into(), expected));
        }
        for k in 0..PARAMETERS {
            let step = match k { 0..4 => 1.0, 4..9 => 1e-2, 9..12 => 2e-3, _ => 0.5 };
            let expected = derivative(|h| { let mut p = p; p[k] += h; at(&p, &point) }, step);
            let column: Vector2<f64> = match k {
                0..4 => found.by_intrinsics.column(k).into(),
                4..9 => found.by_distortion.column(k - 4).into(),
                _ => ready.by_pose(&found, &point).column(k - 9).into(),
            };
            prop_assert!(near(column, expected), "{k}: {column} {expected}");
        }
    }

    /// A rotation vector that is lost on the way to the matrix and back, or a Jacobian of the wrong side.
    #[test]
    fn rotation_vectors_are_exact(w in prop::array::uniform3(-1.7..1.7_f64), small in any::<bool>(), d in prop::array::uniform3(-1.0..1.0_f64)) {
        let w = Vector3::from(w) * if small { 1e-3 } else { 1.0 };
        let expected = Rotation3::new(w).into_inner();
        prop_assert!((rotation_matrix(&w) - expected).amax() < 1e-14);
        prop_assert!((rotation_vector(&expected) - w).amax() < 1e-13);
        let d = Vector3::from(d);
        let moved = derivative(|h| {
            let m: Matrix3<f64> = rotation_matrix(&(w + d * h)) * expected.transpose();
            Vector3::new(m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)]) * 0.5
        }, 1e-3);
        prop_assert!((left_jacobian(&w) * d - moved).amax() < 1e-9);
    }

    /// A pixel that does not lead back to the point of the sphere it shows, on either face.
    #[test]
    fn pixels_lead_back_to_the_sphere(camera in cameras(), place in prop::array::uniform3(-1.0..1.0_f64), radius in 150.0..230.0_f64) {
        let ready = Camera::new(&camera).unwrap();
        let towards = ready.position().normalize();
        let radius = radius.min(0.7 * ready.position().norm());
        let point = (towards * 1.2 + Vector3::from(place)).normalize() * radius;
        let facing = (ready.position() - point).dot(&point) / radius;
        prop_assume!(facing.abs() > 30.0);
        let face = if facing > 0.0 { Face::Near } else { Face::Far };
        let pixel = ready.project(&point).unwrap();
        let straight = ready.undistort(&pixel).unwrap();
        let seen = ready.seen(&point);
        prop_assert!((straight - seen / seen.z).amax() < 1e-13);
        let found = ready.on_sphere(&pixel, radius, face).unwrap();
        prop_assert!((found - point).amax() < 1e-8, "{}", found - point);
        let (origin, direction) = ready.ray(&pixel).unwrap();
        prop_assert!((point - origin).cross(&direction).norm() < 1e-9);
    }

    /// Pixels of any bits that panic or give a direction that is not finite.
    #[test]
    fn any_pixel_is_answered_finitely(camera in cameras(), pixel in prop::array::uniform2(prop_oneof![-3000.0..3000.0_f64, prop::num::f64::ANY])) {
        let ready = Camera::new(&camera).unwrap();
        let pixel = Vector2::from(pixel);
        if let Ok(direction) = ready.undistort(&pixel) {
            prop_assert!(direction.iter().all(|v| v.is_finite()));
            // and it is the pixel's: projecting it gives the pixel
            let point = ready.rotation().transpose() * (direction * 100.0 - camera.translation);
            prop_assert!((ready.project(&point).unwrap() - pixel).amax() < 1e-7 * (1.0 + pixel.amax()));
        }
        if let Ok(point) = ready.on_sphere(&pixel, 200.0, Face::Near) {
            prop_assert!((point.norm() - 200.0).abs() < 1e-6);
        }
    }
}

/// The paper's set-up mirrored or upside down: growing φ to the right, growing γ downwards, the centre in the middle.
#[test]
fn a_camera_that_faces_the_centre_sees_angles_grow_right_and_down() {
    let camera = Camera::new(&Description::facing(
        FRAC_PI_2,
        0.8,
        446.0,
        [1000.0, 1000.0, 640.0, 320.0],
    ))
    .unwrap();
    let at = |phi: f64, gamma: f64| {
        let ((sp, cp), (sg, cg)) = (phi.sin_cos(), gamma.sin_cos());
        camera
            .project(&(Vector3::new(sg * cp, sg * sp, cg) * 200.0))
            .unwrap()
    };
    assert!((at(FRAC_PI_2, 0.8) - Vector2::new(640.0, 320.0)).amax() < 1e-9);
    assert!(at(FRAC_PI_2 + 0.1, 0.8).x > 650.0);
    let below = at(FRAC_PI_2, 0.9);
    assert!(below.y > 330.0 && (below.x - 640.0).abs() < 1e-9);
    assert!((camera.position().norm() - 446.0).abs() < 1e-9);
}

/// A point behind the camera that shows, a ray past the sphere that hits it, a fold that is not noticed.
#[test]
fn what_is_not_seen_is_an_error() {
    let plain = Description {
        intrinsics: [1000.0, 1000.0, 640.0, 320.0],
        distortion: [0.0; 5],
        rotation: Vector3::zeros(),
        translation: Vector3::new(0.0, 0.0, 500.0),
    };
    let camera = Camera::new(&plain).unwrap();
    assert_eq!(
        camera.project(&Vector3::new(0.0, 0.0, -510.0)),
        Err(Error::BehindCamera { depth_mm: -10.0 })
    );
    assert_eq!(camera.project_lanes([0.0, 0.0, -510.0]).1, 0.0);
    // the edge of the sphere is seen at asin(R/D)
    let edge = 1000.0 * (200.0_f64 / 500.0).asin().tan();
    let on = |u: f64| camera.on_sphere(&Vector2::new(640.0 + u, 320.0), 200.0, Face::Near);
    assert!(on(edge - 1e-6).is_ok());
    match on(edge + 1.0) {
        Err(Error::RayMisses { miss_mm }) => assert!(miss_mm > 0.0 && miss_mm < 1.0),
        other => panic!("{other:?}"),
    }
    // a camera inside the sphere sees its far side alone
    let inside = Camera::new(&Description {
        translation: Vector3::new(0.0, 0.0, 50.0),
        ..plain
    })
    .unwrap();
    let middle = Vector2::new(640.0, 320.0);
    assert!(matches!(
        inside.on_sphere(&middle, 200.0, Face::Near),
        Err(Error::BehindCamera { .. })
    ));
    assert!(inside.on_sphere(&middle, 200.0, Face::Far).unwrap().z > 199.0);
    // with k₁ = -1 the picture folds at r = 1/√3, where it shows 2/(3√3)
    let fold = Camera::new(&Description {
        distortion: [-1.0, 0.0, 0.0, 0.0, 0.0],
        ..plain
    })
    .unwrap();
    let shown = 2.0 / 27.0_f64.sqrt();
    let at = |r: f64| fold.undistort(&Vector2::new(640.0 + 1000.0 * r, 320.0));
    assert!((at(shown - 1e-5).unwrap().x - 1.0 / 3.0_f64.sqrt()).abs() < 1e-2);
    assert_eq!(at(shown + 1e-5), Err(Error::LensFolds));
    assert_eq!(at(5.0), Err(Error::LensFolds));
    for bad in [f64::NAN, f64::INFINITY] {
        assert_eq!(
            camera.undistort(&Vector2::new(0.0, bad)),
            Err(Error::NotFinite { index: 1 })
        );
        assert_eq!(
            camera.project(&Vector3::new(bad, 0.0, 0.0)),
            Err(Error::NotFinite { index: 0 })
        );
        let mut p = plain.parameters();
        p[7] = bad;
        assert_eq!(
            Camera::new(&Description::from_parameters(&p)).err(),
            Some(Error::NotFinite { index: 7 })
        );
    }
    assert!(matches!(
        Camera::new(&Description {
            intrinsics: [0.0, 1.0, 0.0, 0.0],
            ..plain
        }),
        Err(Error::InvalidCamera { .. })
    ));
}
