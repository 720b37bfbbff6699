//! The spherical robot's measurement chain: derivatives by every parameter, and each effect by a formula of its own.

#[path = "../common/mod.rs"]
mod common;
mod refused;

use common::{Random, config, derivative, plausible, range_of};
use nalgebra::{Matrix3, Rotation3, SVector, Vector2, Vector3};
use proptest::prelude::*;
use sherkit_core::camera::{Camera, Description, Face};
use sherkit_core::chain::effects::Wanted;
use sherkit_core::chain::{Aim, Robot as _};
use sherkit_core::spherical::{
    Assembly, CATALOGUE, Chain, Covariates, Geometry, Kinematics, Limb, Model, PARAMETERS,
    Readings, Row, Values,
};
use sherkit_core::{Error, Singularity};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};
use std::ops::Range;

const KINDS: [Readings; 2] = [Readings::Pixels, Readings::Angles];

/// Where the parameters of an effect stand.
const fn of(name: &str) -> Range<usize> {
    range_of(CATALOGUE, name)
}

const GEOMETRY: Range<usize> = of("geometry");
const DATUM: Range<usize> = of("datum");
const SENSOR_POSE: Range<usize> = of("sensor_pose");
const FOCAL_LENGTH: Range<usize> = of("focal_length");
const PRINCIPAL_POINT: Range<usize> = of("principal_point");
const LENS_DISTORTION: Range<usize> = of("lens_distortion");
const JOINT_OFFSET: Range<usize> = of("joint_offset");
const JOINT_SCALE: Range<usize> = of("joint_scale");
const JOINT_SLIP: Range<usize> = of("joint_slip");
const ENCODER_ECCENTRICITY: Range<usize> = of("encoder_eccentricity");
const ENCODER_CYCLIC: Range<usize> = of("encoder_cyclic");
const ENCODER_SECOND: Range<usize> = of("encoder_second");
const BACKLASH: Range<usize> = of("backlash");
const UNEQUAL_LIMBS: Range<usize> = of("unequal_limbs");
const AXIS_OFFSET: Range<usize> = of("axis_offset");
const GRAVITY_FLEXURE: Range<usize> = of("gravity_flexure");
const MARKER_OFFSET: Range<usize> = of("marker_offset");
const CAMERA_DELAY: Range<usize> = of("camera_delay");
const THERMAL_GROWTH: Range<usize> = of("thermal_growth");
const THERMAL_SHIFT: Range<usize> = of("thermal_shift");
const DRIFT: Range<usize> = of("drift");
const SLIP: Range<usize> = of("slip");
const SENSOR_SLIP: Range<usize> = of("sensor_slip");
const SENSOR_DRIFT: Range<usize> = of("sensor_drift");

/// The same robot read in pixels and in angles.
fn both(model: &Model) -> [Model; 2] {
    let [pixels, angles] = KINDS;
    [
        Model {
            readings: pixels,
            ..*model
        },
        Model {
            readings: angles,
            ..*model
        },
    ]
}

fn effects() -> impl Strategy<Value = Values> {
    any::<u64>().prop_map(|seed| {
        let mut random = Random(seed);
        plausible(CATALOGUE).map(|s| s * random.unit())
    })
}

fn row(joints: [f64; 2]) -> Row {
    Row {
        joints,
        to: None,
        aim: Aim::default(),
        covariates: Covariates {
            time_s: 5000.0,
            temperature_c: 24.0,
            stand_c: 24.5,
            payload_kg: f64::NAN,
            direction: [1.0, -1.0],
            velocity: [0.3, -0.7],
        },
        push: Vector3::new(0.4, -0.6, 0.2),
    }
}

/// Cameras that look at the centre from about where the paper's does, turned by any turn about the line of sight, and then
/// a little aside.
fn cameras() -> impl Strategy<Value = Description> {
    let place = (-0.2..0.2_f64, -0.2..0.2_f64, 420.0..520.0_f64);
    let roll = (-PI..PI, prop::array::uniform2(-0.05..0.05_f64));
    let shift = prop::array::uniform3(-20.0..20.0_f64);
    (place, roll, shift).prop_map(|((phi, gamma, distance), (roll, tilt), shift)| {
        let intrinsics = [1100.0, 1080.0, 640.0, 320.0];
        let mut camera = Description::facing(FRAC_PI_2 + phi, 0.8 + gamma, distance, intrinsics);
        let turn = Rotation3::new(Vector3::new(tilt[0], tilt[1], 0.0))
            * Rotation3::new(Vector3::z() * roll);
        camera.rotation = (turn * Rotation3::new(camera.rotation)).scaled_axis();
        camera.translation = turn * camera.translation + Vector3::from(shift);
        camera.distortion = [-0.1, 0.02, 1e-3, -2e-3, 0.005];
        camera
    })
}

/// A robot like the paper's but not quite equal, tilted against gravity, and a pose of it.
fn robots() -> impl Strategy<Value = (Model, [f64; 2])> {
    let arcs = prop::array::uniform4(0.6..0.95_f64);
    let gravity = prop::array::uniform3(-1.0..1.0_f64);
    let pose = (0.8..2.3_f64, 0.5..0.95_f64);
    (arcs, gravity, pose, cameras()).prop_filter_map(
        "gravity has a direction",
        |(arcs, gravity, (mean, half), camera)| {
            let limb = |i: usize| Limb {
                alpha_rad: 0.78 + 0.1 * (arcs[i] - 0.78),
                beta_rad: 0.82 + 0.1 * (arcs[2 + i] - 0.78),
                offset_rad: 0.05 * i as f64,
            };
            let geometry = Geometry {
                limbs: [limb(0), limb(1)],
                assembly: Assembly::Outer,
            };
            let gravity = Vector3::from(gravity);
            (gravity.norm() > 0.2).then_some((
                Model {
                    geometry,
                    radius_mm: 200.0,
                    camera,
                    face: Face::Near,
                    readings: Readings::Pixels,
                    gravity,
                    home: [0.3, -0.2],
                    time_origin_s: 100.0,
                    slip_time_s: 2000.0,
                    joint_slip_time_s: 2100.0,
                    encoder_period: [0.4, 0.5],
                    sensor_slip_time_s: 2200.0,
                },
                [mean + half, mean - half],
            ))
        },
    )
}

fn near<const N: usize>(a: SVector<f64, N>, b: SVector<f64, N>, tolerance: f64) -> bool {
    (a - b).amax() < tolerance * (1.0 + b.amax())
}

proptest! {
    #![proptest_config(config())]

    /// A column that forgets a link behind its own, or a sign; at zero effects, where loads and frames come
    /// from the unbent pose, and at effects of plausible size.
    #[test]
    fn derivatives_are_exact(
        robot in robots(),
        values in effects(),
        quiet in any::<bool>(),
        slipped in any::<bool>(),
    ) {
        let (model, joints) = robot;
        let values = if quiet { [0.0; PARAMETERS] } else { values };
        let (mut row, sizes): (Row, Values) = (row(joints), plausible(CATALOGUE));
        if !slipped {
            row.covariates.time_s = model.sensor_slip_time_s - 1.0;
        }
        for model in both(&model) {
            let chain = model.with(&values).unwrap();
            let found = chain.row_predict(&row, Wanted::ALL).unwrap();
            prop_assert_eq!(found.value, chain.row_value(&row).unwrap());
            for p in 0..PARAMETERS {
                let at = |h: f64| {
                    let mut v = values;
                    v[p] += h;
                    model.with(&v).unwrap().row_value(&row).unwrap()
                };
                let expected = derivative(at, 0.1 * sizes[p]);
                let column: Vector2<f64> = found.by_parameters.column(p).into();
                prop_assert!(near(column, expected, 3e-7), "{:?} parameter {p}: {column} {expected}", model.readings);
            }
            for axis in 0..3 {
                let expected = derivative(|h| {
                    let mut r = row;
                    r.push[axis] += h;
                    chain.row_value(&r).unwrap()
                }, 0.1);
                prop_assert!(near(found.by_body.column(axis).into(), expected, 1e-8));
            }
            for i in 0..2 {
                let expected = derivative(|h| {
                    let mut r = row;
                    r.joints[i] += h;
                    chain.row_value(&r).unwrap()
                }, 1e-3);
                prop_assert!(near(found.by_joints.column(i).into(), expected, 3e-7));
            }
        }
    }

    /// A reading without effects that is not where kinematics, sphere and camera put it.
    #[test]
    fn without_effects_the_chain_is_the_papers_model(robot in robots()) {
        let (model, joints) = robot;
        let chain = model.with(&[0.0; PARAMETERS]).unwrap();
        let bare = Row { covariates: Covariates::NONE, push: Vector3::zeros(), ..row(joints) };
        let pointing = Model { readings: Readings::Angles, ..model }.with(&[0.0; PARAMETERS]).unwrap();
        let angles = Kinematics::new(&model.geometry).unwrap().forward(&Vector2::from(joints)).unwrap();
        let ((sp, cp), (sg, cg)) = (angles.x.sin_cos(), angles.y.sin_cos());
        let point = Vector3::new(sg * cp, sg * sp, cg) * model.radius_mm;
        let pixel = Camera::new(&model.camera).unwrap().project(&point).unwrap();
        prop_assert!((pointing.row_value(&bare).unwrap() - angles).amax() < 1e-13);
        prop_assert!((chain.row_value(&bare).unwrap() - pixel).amax() < 1e-9);
        // and back, where the camera sees the marker and not the sphere before it: its own inverse gives the angles, so that
        // Eq. 6 has nothing left
        let stands = Rotation3::new(model.camera.rotation).inverse() * -model.camera.translation;
        prop_assume!((stands - point).dot(&point) > 0.05 * (stands - point).norm() * model.radius_mm);
        let camera = model.camera(&[0.0; PARAMETERS]).unwrap();
        let seen = camera.angles_on_sphere(&pixel, model.radius_mm, Face::Near).unwrap();
        prop_assert!((seen - angles).amax() < 1e-9, "{}", seen - angles);
        for (chain, reading) in [(&chain, pixel), (&pointing, angles)] {
            let left = chain.inverse_residual(&bare, &reading).unwrap();
            prop_assert!(left.value.amax() < 1e-8, "{}", left.value);
        }
    }

    /// The paper's residual with a wrong sign or a forgotten path through camera, sphere or limbs.
    #[test]
    fn derivatives_of_the_papers_residual_are_exact(robot in robots(), values in effects(), off in prop::array::uniform2(-0.01..0.01_f64)) {
        let (model, joints) = robot;
        let mut values = values;
        let behind = [AXIS_OFFSET, GRAVITY_FLEXURE, MARKER_OFFSET, THERMAL_GROWTH, THERMAL_SHIFT, DRIFT, SLIP];
        for range in behind.clone() {
            values[range].fill(0.0);
        }
        let row = Row { push: Vector3::zeros(), ..row(joints) };
        let sizes: Values = plausible(CATALOGUE);
        for model in both(&model) {
            let chain = model.with(&values).unwrap();
            let scale = if model.readings == Readings::Pixels { 500.0 } else { 1.0 };
            let reading = chain.row_value(&row).unwrap() + Vector2::from(off) * scale;
            let Ok(found) = chain.inverse_residual(&row, &reading) else { continue };
            // stretched limbs and the edge of the sphere are too steep for differences
            let steepest = (0..PARAMETERS)
                .map(|p| found.by_parameters.column(p).amax() * sizes[p])
                .fold(0.0, f64::max);
            if steepest > 0.15 {
                continue;
            }
            for p in 0..PARAMETERS {
                let at = |h: f64| {
                    let mut v = values;
                    v[p] += h;
                    model.with(&v).unwrap().inverse_residual(&row, &reading).unwrap().value
                };
                let column: Vector2<f64> = found.by_parameters.column(p).into();
                if behind.iter().any(|range| range.contains(&p)) {
                    prop_assert_eq!(column.amax(), 0.0);
                    continue;
                }
                let expected = derivative(at, 0.02 * sizes[p]);
                prop_assert!(near(column, expected, 1e-5), "{:?} parameter {p}: {column} {expected}", model.readings);
            }
        }
    }

    /// The remote centre's error with a wrong frame, sign or share: the vectors drawn here from rotations.
    #[test]
    fn the_centre_moves_with_the_joints(robot in robots(), values in effects()) {
        let (model, joints) = robot;
        let chain = model.with(&values).unwrap();
        let r = row(joints);
        let found = chain.centre(&joints, &r.covariates).unwrap();
        let mut expected = Vector3::zeros();
        let theta = joints_by_hand(&model, &values, &joints, &r.covariates);
        for i in 0..2 {
            let sign = if i == 0 { 1.0 } else { -1.0 };
            let alpha = model.geometry.limbs[i].alpha_rad + values[0] + sign * values[UNEQUAL_LIMBS.start];
            let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), theta[i] + model.geometry.limbs[i].offset_rad)
                * Rotation3::from_axis_angle(&Vector3::y_axis(), alpha);
            // in the link's own frame the elbow axis is z, the tangent x and the normal of its plane y
            let [across, along] = [values[AXIS_OFFSET.start + 2 * i], values[AXIS_OFFSET.start + 2 * i + 1]];
            expected += turn * Vector3::new(along, across, 0.0) / 2.0;
        }
        prop_assert!((found.value - expected).amax() < 1e-12);
        let sizes: Values = plausible(CATALOGUE);
        let at = |v: &Values, q: &[f64; 2]| model.with(v).unwrap().centre(q, &r.covariates).unwrap().value;
        for p in 0..PARAMETERS {
            let column = derivative(|h| { let mut v = values; v[p] += h; at(&v, &joints) }, 0.1 * sizes[p]);
            prop_assert!(near(found.by_parameters.column(p).into(), column, 1e-8), "{p}");
        }
        for i in 0..2 {
            let column = derivative(|h| { let mut q = joints; q[i] += h; at(&values, &q) }, 2e-3);
            prop_assert!(near(found.by_joints.column(i).into(), column, 1e-8));
        }
        // and the marker goes with it
        let (mut still, mut values) = (values, values);
        still[AXIS_OFFSET].fill(0.0);
        for values in [&mut still, &mut values] {
            values[THERMAL_GROWTH].fill(0.0);
        }
        let chain = model.with(&values).unwrap();
        let moved = chain.row_point(&r).unwrap() - model.with(&still).unwrap().row_point(&r).unwrap();
        prop_assert!((moved - expected).amax() < 1e-11);
    }

    /// Flexure that goes up, in the wrong share, or not with the lever arm: the potential of a weight on two springs,
    /// at its minimum to first order.
    #[test]
    fn flexure_is_the_least_energy_of_weight_and_springs(robot in robots(), soft in prop::array::uniform2(1e-5..2e-5_f64)) {
        let (model, joints) = robot;
        let mut values = [0.0; PARAMETERS];
        values[GRAVITY_FLEXURE].copy_from_slice(&soft);
        let r = Row { push: Vector3::zeros(), ..row(joints) };
        let at = |v: &Values| model.with(v).unwrap().row_point(&r).unwrap() / model.radius_mm;
        let (still, bent) = (at(&[0.0; PARAMETERS]), at(&values));
        let moved = bent - still;
        // E = Σ (Δβ_i)²/(2κ_i) - g·x, with β_i the angle between elbow and tool axis
        let elbow = |i: usize| {
            let limb = &model.geometry.limbs[i];
            let ((sa, ca), (s, c)) = (limb.alpha_rad.sin_cos(), (joints[i] + limb.offset_rad).sin_cos());
            Vector3::new(sa * c, sa * s, ca)
        };
        let g = model.gravity.normalize();
        let energy = |x: &Vector3<f64>| {
            let x = x.normalize();
            (0..2).map(|i| {
                let opened = x.dot(&elbow(i)).acos() - model.geometry.limbs[i].beta_rad;
                opened * opened / (2.0 * soft[i])
            }).sum::<f64>() - g.dot(&x)
        };
        let slope = |x: Vector3<f64>| {
            let found = Vector3::from_fn(|k, _| derivative(|h| SVector::<f64, 1>::new(energy(&(x + Vector3::ith(k, h)))), 1e-4).x);
            found - still * still.dot(&found)
        };
        let pull = slope(still);
        prop_assert!(slope(bent).norm() < 2e-3 * pull.norm() + 1e-6, "{} of {}", slope(bent).norm(), pull.norm());
        prop_assert!(moved.dot(&g) >= -1e-12);
        // the pull is the lever arm of the weight
        prop_assert!((pull.norm() - still.cross(&g).norm()).abs() < 1e-6);
    }

    /// Joints, marker, datum or camera with a wrong sign, size or frame: written out by hand.
    #[test]
    fn simple_effects_are_what_they_say(robot in robots(), values in effects()) {
        let (model, joints) = robot;
        let r = row(joints);
        let v = |range: Range<usize>, k: usize| values[range.start + k];
        let theta = joints_by_hand(&model, &values, &joints, &r.covariates);
        // the same joints without effects of joints, and the marker without its offset
        let mut plain = values;
        for range in [JOINT_OFFSET, JOINT_SCALE, ENCODER_ECCENTRICITY, ENCODER_CYCLIC, ENCODER_SECOND, BACKLASH, JOINT_SLIP, CAMERA_DELAY, MARKER_OFFSET, THERMAL_GROWTH, THERMAL_SHIFT, DRIFT, SLIP] {
            plain[range].fill(0.0);
        }
        let chain = model.with(&plain).unwrap();
        let straight = Row { joints: theta, ..r };
        let marker = chain.row_point(&straight).unwrap() - r.push;
        let radius = model.radius_mm + v(GEOMETRY, 2);
        let axis = (marker - chain.centre(&theta, &r.covariates).unwrap().value) / radius;
        prop_assert!((axis.norm() - 1.0).abs() < 1e-12);
        let azimuth = theta[0] + model.geometry.limbs[0].offset_rad;
        let alpha = model.geometry.limbs[0].alpha_rad + v(GEOMETRY, 0) + v(UNEQUAL_LIMBS, 0);
        let elbow = Vector3::new(alpha.sin() * azimuth.cos(), alpha.sin() * azimuth.sin(), alpha.cos());
        let towards = (elbow - axis * axis.dot(&elbow)).normalize();
        let marker = marker + towards * v(MARKER_OFFSET, 0) + axis.cross(&towards) * v(MARKER_OFFSET, 1);
        // everything grows about the remote centre, then the marker wanders and slips
        let warm = 1.0 + v(THERMAL_GROWTH, 0) * (r.covariates.temperature_c - 20.0);
        let hours = (r.covariates.time_s - model.time_origin_s) / 3600.0;
        let marker = marker * warm + Vector3::from_fn(|k, _| v(DRIFT, k) * hours + v(SLIP, k)) + r.push;
        let found = model.with(&values).unwrap().row_point(&r).unwrap();
        prop_assert!((found - marker).amax() < 1e-9, "{}", found - marker);
        // stands move the robot against what looks at it
        let marker = marker + Vector3::from_fn(|k, _| v(THERMAL_SHIFT, k) * (r.covariates.stand_c - 20.0));
        // the camera
        let mut c = model.camera;
        let off: [f64; 6] =
            std::array::from_fn(|k| v(SENSOR_POSE, k) + v(SENSOR_SLIP, k) + v(SENSOR_DRIFT, k) * hours);
        let turn = Rotation3::new(Vector3::new(off[0], off[1], off[2]));
        let shift = Vector3::new(off[3], off[4], off[5]);
        let seen = (turn * Rotation3::new(c.rotation)) * marker + c.translation + shift;
        for k in 0..4 {
            c.distortion[k] += v(LENS_DISTORTION, k);
        }
        for k in 0..2 {
            c.intrinsics[k] *= 1.0 + v(FOCAL_LENGTH, 0);
            c.intrinsics[2 + k] += v(PRINCIPAL_POINT, k);
        }
        c.rotation = Vector3::zeros();
        c.translation = Vector3::zeros();
        let pixel = Camera::new(&c).unwrap().project(&seen).unwrap();
        prop_assert!((model.with(&values).unwrap().row_value(&r).unwrap() - pixel).amax() < 1e-8);
        let angles = Model { readings: Readings::Angles, ..model }.with(&values).unwrap().row_value(&r).unwrap();
        let d = marker.normalize();
        prop_assert!((angles.x - v(DATUM, 0) - d.y.atan2(d.x)).abs() < 1e-12);
        prop_assert!((angles.y - v(DATUM, 1) - d.z.acos()).abs() < 1e-11);
    }

    /// Unequal limbs of the wrong sign: against a solution of the two cones by Newton's method.
    #[test]
    fn unequal_limbs_move_the_tool_axis(robot in robots(), a in -0.02..0.02_f64, b in -0.02..0.02_f64) {
        let (model, joints) = robot;
        let mut values = [0.0; PARAMETERS];
        values[UNEQUAL_LIMBS].copy_from_slice(&[a, b]);
        let r = Row { push: Vector3::zeros(), ..row(joints) };
        let found = model.with(&values).unwrap().row_point(&r).unwrap() / model.radius_mm;
        let elbow = |i: usize, sign: f64| {
            let limb = &model.geometry.limbs[i];
            let ((sa, ca), (s, c)) = ((limb.alpha_rad + sign * a).sin_cos(), (joints[i] + limb.offset_rad).sin_cos());
            (Vector3::new(sa * c, sa * s, ca), (limb.beta_rad + sign * b).cos())
        };
        let ((e1, c1), (e2, c2)) = (elbow(0, 1.0), elbow(1, -1.0));
        let mut x = model.with(&[0.0; PARAMETERS]).unwrap().row_point(&r).unwrap().normalize();
        for _ in 0..20 {
            let m = Matrix3::from_rows(&[e1.transpose(), e2.transpose(), x.transpose() * 2.0]);
            let miss = Vector3::new(x.dot(&e1) - c1, x.dot(&e2) - c2, x.norm_squared() - 1.0);
            x -= m.try_inverse().unwrap() * miss;
        }
        prop_assert!((x - found).amax() < 1e-11);
    }

    /// Values, joints or readings of any bits that panic or give a reading that is not finite.
    #[test]
    fn any_bits_are_answered_finitely(
        robot in robots(),
        values in effects(),
        wild in prop::collection::vec((0..PARAMETERS, any::<u64>()), 0..3),
        bits in prop::array::uniform4(prop_oneof![-300.0..300.0_f64, prop::num::f64::ANY]),
    ) {
        let (model, joints) = robot;
        let mut values = values;
        for (p, b) in wild {
            values[p] = f64::from_bits(b);
        }
        for model in both(&model) {
            let Ok(chain): Result<Chain, Error> = model.with(&values) else { continue };
            for joints in [joints, [bits[0], bits[1]]] {
                for covariates in [Covariates::NONE, row(joints).covariates] {
                    let row = Row { covariates, ..row(joints) };
                    if let Ok(value) = chain.row_value(&row) {
                        prop_assert!(value.iter().all(|v| v.is_finite()));
                    }
                    let _ = chain.row_predict(&row, Wanted::ALL);
                    let _ = chain.inverse_residual(&row, &Vector2::new(bits[2], bits[3]));
                }
            }
        }
    }
}

/// The joints as the effects make them, from the formulas.
fn joints_by_hand(
    model: &Model,
    values: &Values,
    joints: &[f64; 2],
    covariates: &Covariates,
) -> [f64; 2] {
    std::array::from_fn(|i| {
        let q = joints[i];
        let v = |range: Range<usize>, k: usize| values[range.start + k];
        q + v(JOINT_OFFSET, i)
            + v(JOINT_SCALE, i) * (q - model.home[i])
            + v(ENCODER_ECCENTRICITY, 2 * i) * q.sin()
            + v(ENCODER_ECCENTRICITY, 2 * i + 1) * q.cos()
            + v(ENCODER_CYCLIC, 2 * i) * (TAU * q / model.encoder_period[i]).sin()
            + v(ENCODER_CYCLIC, 2 * i + 1) * (TAU * q / model.encoder_period[i]).cos()
            + v(ENCODER_SECOND, 2 * i) * (2.0 * TAU * q / model.encoder_period[i]).sin()
            + v(ENCODER_SECOND, 2 * i + 1) * (2.0 * TAU * q / model.encoder_period[i]).cos()
            // the full width between the two directions
            + v(BACKLASH, i) * covariates.direction[i] / 2.0
            + v(JOINT_SLIP, i)
            // the camera shows where the robot was
            - v(CAMERA_DELAY, 0) * covariates.velocity[i]
    })
}
