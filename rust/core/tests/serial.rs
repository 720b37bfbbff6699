//! The serial arm against a mechanism that anybody can draw, and its derivatives against differences.

mod common;

use common::{config, derivative, range_of, sensors, stand};
use nalgebra::{Matrix3, SVector, Vector3};
use proptest::prelude::*;
use sherkit_core::chain::effects::Wanted;
use sherkit_core::chain::{
    Aim, CENTRES, Covariates, Fixed, Flat, Frame, PLANES, Prediction, REFERENCE_TEMPERATURE_C,
    Robot, Row,
};
use sherkit_core::numbers::rigid::Rigid;
use sherkit_core::serial::{
    CATALOGUE, Calibrated, JOINTS, Joint, Limits, Model, PARAMETERS, TARGETS, Values,
};
use std::f64::consts::{FRAC_PI_2, PI};
use std::ops::Range;

const SENSOR_POSE: Range<usize> = range_of(CATALOGUE, "sensor_pose");
const SENSOR_SLIP: Range<usize> = range_of(CATALOGUE, "sensor_slip");
const SENSOR_DRIFT: Range<usize> = range_of(CATALOGUE, "sensor_drift");

fn turn(axis: usize, angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    match axis {
        0 => Matrix3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c),
        1 => Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c),
        _ => Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0),
    }
}

fn joint(shift: [f64; 3], rotation: Matrix3<f64>, prismatic: bool, mass_kg: f64) -> Joint {
    Joint {
        fixed: Rigid {
            rotation,
            translation: Vector3::from(shift),
        },
        prismatic,
        follows: 0.0,
        home: if prismatic { 20.0 } else { 0.2 },
        mass_kg,
        centre_mm: Vector3::new(30.0, -40.0, 50.0),
    }
}

/// Four joints that turn, one of them parallel to another, and one that slides.
fn arm() -> Model {
    let mut joints = [Joint::NONE; JOINTS];
    joints[0] = joint([0.0, 0.0, 90.0], Matrix3::identity(), false, 4.0);
    joints[1] = joint([10.0, 130.0, 0.0], turn(0, FRAC_PI_2), false, 8.0);
    joints[2] = joint([420.0, 0.0, 0.0], Matrix3::identity(), false, 2.0);
    joints[3] = joint([390.0, 30.0, 0.0], turn(1, -1.1), true, 3.0);
    joints[4] = joint([0.0, 95.0, 5.0], turn(0, -FRAC_PI_2), false, 1.0);
    joints[2].follows = -1.0;
    Model {
        joints,
        count: 5,
        targets_mm: [
            Vector3::new(15.0, -20.0, 80.0),
            Vector3::new(-60.0, 40.0, 30.0),
            Vector3::new(70.0, 10.0, 50.0),
            Vector3::new(0.0, 0.0, 120.0),
        ],
        centres_mm: [Vector3::new(300.0, 400.0, -200.0); CENTRES],
        planes: [Flat {
            at: Vector3::new(500.0, -300.0, 80.0),
            normal: Vector3::new(0.48, -0.6, 0.64),
        }; PLANES],
        sensor: Rigid {
            rotation: turn(2, 2.0) * turn(0, 0.3),
            translation: Vector3::new(1500.0, -700.0, 300.0),
        },
        gravity: Vector3::new(0.6, 0.0, -0.8),
        encoder_period: std::array::from_fn(|i| 0.4 + 0.05 * i as f64),
        time_origin_s: 100.0,
        slip_time_s: 500.0,
        joint_slip_time_s: 600.0,
        sensor_slip_time_s: 600.0,
    }
}

fn row() -> Row<JOINTS> {
    Row {
        joints: [0.7, -0.9, 1.3, 60.0, 0.4, 0.0, 0.0, 0.0, 0.0],
        to: None,
        aim: Aim::default(),
        covariates: Covariates {
            time_s: 700.0,
            temperature_c: 23.0,
            stand_c: 23.5,
            payload_kg: 4.0,
            direction: [1.0, -1.0, 1.0, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0],
            velocity: [0.1, 0.2, -0.3, 20.0, 0.5, 0.0, 0.0, 0.0, 0.0],
        },
        push: Vector3::new(0.3, -0.2, 0.1),
    }
}

/// Every parameter at a share of its plausible size, signs alternating.
fn some(share: f64) -> Values {
    let mut values = [0.0; PARAMETERS];
    let sizes = CATALOGUE.iter().flat_map(|e| e.parameters);
    for (k, (value, parameter)) in values.iter_mut().zip(sizes).enumerate() {
        *value = share * parameter.size * if k % 2 == 0 { 1.0 } else { -0.7 };
    }
    values
}

/// The longest steps of a difference, rad and mm.
const STEP: [f64; 2] = [0.05, 50.0];

/// A central difference of fourth order.
fn difference(at: impl Fn(f64) -> Vector3<f64>, h: f64) -> Vector3<f64> {
    ((at(h) - at(-h)) * 8.0 - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h)
}

/// A column that forgets a sign, an order of turns, what a joint carries, or a joint that another one moves; at zero
/// effects, where links leave work out, and at plausible ones.
#[test]
fn derivatives_are_exact() {
    let agree = |column: Vector3<f64>, other: Vector3<f64>, what: &str, number: usize| {
        let miss = (column - other).norm() / column.norm().max(1.0);
        assert!(miss < 1e-8, "{what} {number}: {miss:e} {column} {other}");
    };
    let (model, sizes) = (arm(), || CATALOGUE.iter().flat_map(|e| e.parameters));
    let (centre, plane) = (|k| Some(Fixed::Centre(k)), |k| Some(Fixed::Plane(k)));
    let aims = [
        (0, None),
        (2, None),
        (0, centre(1)),
        (1, plane(3)),
        (3, centre(2)),
        (0, plane(0)),
    ];
    let mut reused = Prediction::new();
    for (share, (target, from)) in [0.0, 1.0]
        .into_iter()
        .flat_map(|s| aims.map(|aim| (s, aim)))
    {
        let row = Row {
            aim: Aim { target, from },
            ..row()
        };
        let values = some(share);
        let chain = model.with(&values).unwrap();
        let found = chain.row_predict(&row, Wanted::ALL).unwrap();
        assert_eq!(found.value, chain.row_value(&row).unwrap());
        // what an earlier row left, of another target, is gone
        let all = Wanted::ALL;
        chain.row_predict_into(&row, all, &mut reused).unwrap();
        assert_eq!(found.by_parameters, reused.by_parameters);
        for (p, parameter) in sizes().enumerate() {
            let moved = |h: f64| {
                let mut values = values;
                values[p] += h;
                model.with(&values).unwrap().row_value(&row).unwrap()
            };
            // the tracker may stand anywhere: a step of its whole size is none of a derivative
            let by = difference(
                moved,
                0.2 * parameter
                    .size
                    .min(STEP[usize::from(parameter.unit == "mm")]),
            );
            agree(found.by_parameters.column(p).into(), by, parameter.name, p);
        }
        for k in 0..JOINTS {
            let moved = |h: f64| {
                let mut row = row;
                row.joints[k] += h;
                chain.row_value(&row).unwrap()
            };
            agree(
                found.by_joints.column(k).into(),
                difference(moved, 1e-3),
                "joint",
                k,
            );
        }
    }
}

proptest! {
    #![proptest_config(config())]

    /// A tracker that turns about the robot's axes instead of its own, or shifts before it turns; a column of its pose or of its
    /// slip that is that of another turn, or acts before its time; the arm in one frame that is not the arm in the other.
    #[test]
    fn the_sensor_sees_from_where_it_stands(
        sensor in sensors(),
        off in prop::array::uniform6(-3.0..3.0_f64),
        slip in prop::array::uniform6(-0.3..0.3_f64),
        rate in prop::array::uniform6(-0.3..0.3_f64),
        share in 0.0..1.0_f64,
        slipped in any::<bool>(),
    ) {
        let model = Model { sensor, ..arm() };
        let mut values = some(share);
        values[SENSOR_POSE].copy_from_slice(&off);
        values[SENSOR_SLIP].copy_from_slice(&slip);
        values[SENSOR_DRIFT].copy_from_slice(&rate);
        let mut row = row();
        row.covariates.time_s = model.sensor_slip_time_s + if slipped { 100.0 } else { -1.0 };
        // the same arm seen from its base by a tracker of the same faults cannot tell: its faults are of what it sees
        let mut true_to_size = values;
        for name in ["sensor_scale", "sensor_linearity"] {
            true_to_size[range_of(CATALOGUE, name)].fill(0.0);
        }
        let hours = (row.covariates.time_s - model.time_origin_s) / 3600.0;
        let pose: [f64; 6] = std::array::from_fn(|k| off[k] + if slipped { slip[k] } else { 0.0 } + rate[k] * hours);
        let mut from_base = true_to_size;
        from_base[SENSOR_POSE].fill(0.0);
        from_base[SENSOR_SLIP].fill(0.0);
        from_base[SENSOR_DRIFT].fill(0.0);
        let at_base = Model { sensor: Rigid::identity(), ..model }.with(&from_base).unwrap().row_value(&row).unwrap();
        let seen = model.with(&true_to_size).unwrap().row_value(&row).unwrap();
        prop_assert!((seen - stand(&sensor, &pose).apply(&at_base)).amax() < 1e-10);

        let predicted = model.with(&values).unwrap().row_predict(&row, Wanted::ALL).unwrap();
        for p in SENSOR_POSE.chain(SENSOR_SLIP).chain(SENSOR_DRIFT) {
            let differences = derivative(|h| {
                let mut v = values;
                v[p] += h;
                model.with(&v).unwrap().row_value(&row).unwrap()
            }, 1e-3);
            let column = predicted.by_parameters.column(p).into_owned();
            prop_assert!((column - differences).norm() < 1e-7 * column.norm().max(1.0), "{p}: {column} {differences}");
        }

        let limits = Limits { low: [-1e3; JOINTS], high: [1e3; JOINTS] };
        let arm_of = |values: &Values| Calibrated::new(&model, values, &limits).unwrap();
        let based = arm_of(&values);
        let sensed = based.in_frame(Frame::Sensor);
        let joints = SVector::from(row.joints);
        let mut now = row.covariates;
        (now.stand_c, now.velocity) = (REFERENCE_TEMPERATURE_C, [0.0; JOINTS]);
        let (place, by_joints) = based.forward(&joints, &now).unwrap();
        let (there, seen_by_joints) = sensed.forward(&joints, &now).unwrap();
        // as the tracker reads it after its slip, errors and all; none of them is in where the arm is
        let pose: [f64; 6] = std::array::from_fn(|k| off[k] + slip[k]);
        let last = stand(&sensor, &pose);
        prop_assert!((arm_of(&from_base).forward(&joints, &now).unwrap().0 - place).amax() == 0.0);
        let straight = arm_of(&true_to_size).in_frame(Frame::Sensor);
        let (seen, seen_by) = straight.forward(&joints, &now).unwrap();
        prop_assert!((seen - last.apply(&place)).amax() < 1e-10);
        prop_assert!((seen_by - last.rotation * by_joints).amax() < 1e-10);
        row.covariates = now;
        row.covariates.time_s = now.time_s.max(model.sensor_slip_time_s);
        row.push = Vector3::zeros();
        if slipped {
            // but for what it drifted: a loop has it where it stood
            let mut steady = values;
            steady[SENSOR_DRIFT].fill(0.0);
            let read = model.with(&steady).unwrap().row_value(&row).unwrap();
            prop_assert!((there - read).amax() < 1e-10, "{there} {read}");
        }
        for k in 0..JOINTS {
            let differences = derivative(|h| {
                let mut q = joints;
                q[k] += h;
                sensed.forward(&q, &now).unwrap().0
            }, 1e-3);
            let column = seen_by_joints.column(k).into_owned();
            prop_assert!((column - differences).norm() < 1e-6 * column.norm().max(1.0), "{k}: {column} {differences}");
        }
        let start = joints.map(|q| 0.98 * q);
        for (arm, at) in [(&based, place), (&sensed, there)] {
            let back = arm.inverse(&at, &start, &now).unwrap();
            prop_assert!((arm.forward(&back, &now).unwrap().0 - at).norm() < 1e-6);
        }
    }
}

/// A target that is another one, and a distance that counts from somewhere else.
#[test]
fn targets_and_distances_are_where_they_are_drawn() {
    let model = Model {
        sensor: Rigid::identity(),
        ..arm()
    };
    let chain = model.with(&some(0.0)).unwrap();
    let at = |target: usize, from: Option<Fixed>| {
        let mut row = row();
        row.covariates = Covariates::NONE;
        row.aim = Aim { target, from };
        chain.row_value(&row).unwrap()
    };
    let push = row().push;
    let flange = |k: usize| {
        let mut one = model;
        one.targets_mm = [model.targets_mm[k]; TARGETS];
        let limits = Limits {
            low: [-1e3; JOINTS],
            high: [1e3; JOINTS],
        };
        let arm = Calibrated::new(&one, &some(0.0), &limits).unwrap();
        let joints = SVector::from(row().joints);
        arm.forward(&joints, &Covariates::NONE).unwrap().0 + push
    };
    for k in 0..TARGETS {
        assert!((at(k, None) - flange(k)).norm() < 1e-12);
        let distance = (flange(k) - model.centres_mm[1]).norm();
        let read = at(k, Some(Fixed::Centre(1)));
        assert!((read - Vector3::new(distance, 0.0, 0.0)).norm() < 1e-12);
        let drawn = model.planes[2];
        let above = (flange(k) - drawn.at).dot(&drawn.normal);
        let read = at(k, Some(Fixed::Plane(2)));
        assert!((read - Vector3::new(above, 0.0, 0.0)).norm() < 1e-12);
    }
}

/// A chain that is not the drawing where nothing is wrong: a planar arm whose elbow is a right angle, and its slide.
#[test]
fn it_is_the_drawing_without_effects() {
    let mut joints = [Joint::NONE; JOINTS];
    joints[0] = joint([0.0; 3], Matrix3::identity(), false, 1.0);
    joints[1] = joint([250.0, 0.0, 0.0], Matrix3::identity(), false, 1.0);
    joints[2] = joint([180.0, 0.0, 0.0], turn(1, FRAC_PI_2), true, 1.0);
    let model = Model {
        joints,
        count: 3,
        targets_mm: [Vector3::zeros(); TARGETS],
        sensor: Rigid::identity(),
        gravity: -Vector3::z(),
        ..arm()
    };
    let mut row = row();
    row.joints = [0.0, FRAC_PI_2, 35.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0];
    row.push = Vector3::zeros();
    row.covariates = Covariates::NONE;
    let at = |values: &Values| model.with(values).unwrap().row_value(&row).unwrap();
    assert!((at(&some(0.0)) - Vector3::new(250.0, 215.0, 0.0)).norm() < 1e-12);
}

/// A moment of the wrong sign or size: a stick held level by a joint whose axis is level bends down by all of its yield,
/// and not at all where it stands upright.
#[test]
fn it_gives_way_under_its_weight() {
    let mut joints = [Joint::NONE; JOINTS];
    joints[0] = joint([0.0; 3], turn(0, FRAC_PI_2), false, 2.0);
    joints[0].centre_mm = Vector3::new(200.0, 0.0, 0.0);
    let model = Model {
        joints,
        count: 1,
        targets_mm: [Vector3::new(400.0, 0.0, 0.0); TARGETS],
        sensor: Rigid::identity(),
        gravity: -Vector3::z(),
        ..arm()
    };
    let first = CATALOGUE
        .iter()
        .take_while(|e| e.name != "joint_compliance")
        .map(|e| e.parameters.len())
        .sum::<usize>();
    let mut values = some(0.0);
    values[first] = 0.01;
    let chain = model.with(&values).unwrap();
    for (angle, bent) in [
        (0.0, -0.01),
        (FRAC_PI_2, 0.0),
        (PI, 0.01),
        (PI / 3.0, -0.005),
    ] {
        let mut row = row();
        row.joints = [angle, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        row.push = Vector3::zeros();
        row.covariates = Covariates::NONE;
        let (sin, cos) = (angle + bent).sin_cos();
        let expected = Vector3::new(400.0 * cos, 0.0, 400.0 * sin);
        assert!(
            (chain.row_value(&row).unwrap() - expected).norm() < 1e-9,
            "{angle}"
        );
    }
}

/// An inverse that stops early, leaves the limits, or promises what no posture reaches.
#[test]
fn the_inverse_comes_back() {
    let limits = Limits {
        low: [-2.0, -2.0, -2.0, 0.0, -2.0, 0.0, 0.0, 0.0, 0.0],
        high: [2.0, 2.0, 2.0, 100.0, 2.0, 0.0, 0.0, 0.0, 0.0],
    };
    let arm = Calibrated::new(&arm(), &some(0.3), &limits).unwrap();
    let now = row().covariates;
    let start = SVector::from([0.5, -0.5, 0.8, 50.0, 0.1, 0.0, 0.0, 0.0, 0.0]);
    for k in 0..40 {
        let spread = |i: usize| ((k * (i + 3)) as f64 * 0.37).sin();
        let joints = SVector::from_fn(|i, _| match i {
            3 => 50.0 + 40.0 * spread(i),
            0..=4 => 1.2 * spread(i),
            _ => 0.0,
        });
        let (place, _) = arm.forward(&joints, &now).unwrap();
        let found = arm.inverse(&place, &start, &now).unwrap();
        let (reached, _) = arm.forward(&found, &now).unwrap();
        assert!((reached - place).norm() < 1e-9, "{k}");
        for i in 0..5 {
            assert!(
                limits.low[i] <= found[i] && found[i] <= limits.high[i],
                "{k} {i}"
            );
        }
    }
    assert!(
        arm.inverse(&Vector3::new(5000.0, 0.0, 0.0), &start, &now)
            .is_err()
    );
}

/// A plane that leans the other way, or lies lower where it should lie higher, against three of its points.
#[test]
fn planes_lean_and_lie_higher() {
    let tilted = Flat {
        at: Vector3::new(10.0, 20.0, 30.0),
        normal: Vector3::new(0.0, -0.6, 0.8),
    };
    for flat in [tilted, Flat::GROUND] {
        let [u, v] = flat.within();
        for (a, b) in [(u, v), (u, flat.normal), (v, flat.normal)] {
            assert!(a.dot(&b).abs() < 1e-15 && (a.norm() - 1.0).abs() < 1e-15);
        }
        assert!((u - Vector3::x()).norm() < 1e-15);
        let model = Model {
            planes: [flat; PLANES],
            ..arm()
        };
        let mut values = [0.0; PARAMETERS];
        let place = CATALOGUE.iter().take_while(|e| e.name != "planes");
        let start: usize = place.map(|e| e.parameters.len()).sum();
        values[start..start + 3].copy_from_slice(&[0.03, -0.02, 5.0]);
        let chain = model.with(&values).unwrap();
        let mut row = row();
        row.aim.from = Some(Fixed::Plane(0));
        row.push = Vector3::zeros();
        let read = chain.row_value(&row).unwrap().x;
        let point = chain.row_point(&row).unwrap();
        // the leaning plane by three points of it, then moved along its normal
        let [o, p, q] = [
            flat.at,
            flat.at + u - flat.normal * 0.03,
            flat.at + v + flat.normal * 0.02,
        ];
        let normal = (p - o).cross(&(q - o)).normalize();
        assert!((read - (normal.dot(&(point - o)) - 5.0)).abs() < 1e-9);
    }
}
