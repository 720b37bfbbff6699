//! Calibrated robots as rows of numbers: what is written is read back, and what is no calibration is refused.

mod common;

use common::{
    Random, Robot, config, effects, model_of, robots, some_covariates, straight_over_all,
};
use nalgebra::{SVector, Vector2, Vector3};
use proptest::prelude::*;
use sherkit_core::camera::{Description, Face};
use sherkit_core::chain::{CENTRES, Flat, Frame, PLANES, Robot as _};
use sherkit_core::delta::correction::{Correction, Domain, coefficients_len};
use sherkit_core::delta::{self, Branch, Calibrated, Values};
use sherkit_core::flat::{
    BranchParts, read_delta, read_serial, read_spherical, write_delta, write_serial,
    write_spherical,
};
use sherkit_core::serial::{self, JOINTS, Joint, Limits};
use sherkit_core::spherical::{self, Elbows};

/// What a random calibrated delta is made of.
struct Parts {
    robot: Robot,
    values: [Values; 2],
    orders: [usize; 3],
    coefficients: Vec<[f64; 3]>,
    domain: Domain,
    corrected: bool,
    has_local: bool,
}

impl Parts {
    fn new(robot: &Robot, values: &Values, seed: u64) -> Self {
        let mut random = Random(seed);
        let centre = robot.position + model_of(robot).target_offset;
        let orders = [(); 3].map(|()| usize::try_from(random.next() % 4).expect("small"));
        let values = straight_over_all(robot, *values);
        Self {
            robot: *robot,
            values: [values, values.map(|v| 0.9 * v)],
            orders,
            coefficients: (0..coefficients_len(orders))
                .map(|_| std::array::from_fn(|_| 0.2 * random.unit()))
                .collect(),
            domain: Domain {
                low: centre - Vector3::repeat(20.0 + random.unit()),
                high: centre + Vector3::repeat(20.0 + random.unit()),
                fade: 5.0 + random.unit(),
            },
            corrected: random.unit() > 0.0,
            has_local: random.unit() > 0.0,
        }
    }

    fn correction(&self) -> Option<Correction<'_>> {
        let made = || Correction::new(self.orders, self.domain, &self.coefficients);
        self.corrected
            .then(|| made().expect("coefficients that fit"))
    }

    fn made(&self) -> Calibrated<'_> {
        let branch = |k: usize| {
            let chain = model_of(&self.robot).with(&self.values[k]);
            Branch::new(&chain.expect("values"), self.correction())
        };
        Calibrated {
            whole: branch(0),
            local: self.has_local.then(|| (branch(1), self.domain)),
            frame: Frame::Sensor,
        }
    }

    fn written(&self) -> Vec<f64> {
        let model = model_of(&self.robot);
        let [whole, local] = [0, 1].map(|k: usize| BranchParts {
            model: &model,
            values: &self.values[k],
            correction: self.correction(),
        });
        let mut row = Vec::new();
        let local = self.has_local.then_some((&local, &self.domain));
        write_delta(&whole, local, |x| row.push(x));
        row
    }
}

/// Numbers at the end of a delta's parameters that rows from before lack: how fast its instrument's pose changes; its bar's
/// as well; those of its encoders' second wave as well.
const LATER_OF_DELTA: [usize; 3] = [6, 6 + 1, 6 + 1 + 2 * delta::LIMBS];

/// Where the values of a delta's first branch end in its row: behind its head, its geometry, its target and sensor, its
/// rods, its joints, its moments.
const fn values_of_delta_end() -> usize {
    3 + (1 + delta::GEOMETRIC + 3 + 12 + 1 + 6 + 4) + delta::PARAMETERS
}

proptest! {
    #![proptest_config(config())]

    /// A number lost, doubled or in another place.
    #[test]
    fn a_delta_comes_back_to_the_last_bit(robot in robots(), values in effects(), seed in any::<u64>()) {
        let parts = Parts::new(&robot, &values, seed);
        let row = parts.written();
        let read = read_delta(&row).expect("what was written");
        let joints = robot.joints + Vector3::new(0.3, -0.2, 0.1);
        let (made, now) = (parts.made(), some_covariates());
        prop_assert_eq!(read.frame, Frame::Sensor);
        prop_assert_eq!(read.sensor(), made.sensor());
        for frame in [Frame::Sensor, Frame::Base] {
            let (read, made) = (read.in_frame(frame), made.in_frame(frame));
            let found = made.forward(&joints, &now);
            prop_assert_eq!(read.forward(&joints, &now), found);
            if let Ok((place, _)) = found {
                prop_assert_eq!(read.inverse(&place, &now), made.inverse(&place, &now));
            }
        }
    }

    /// A row from before encoders had a second wave, or bars a zero, that is refused, or read from the wrong places: all but
    /// the last parameters of each branch, and as if those were zero.
    #[test]
    fn a_delta_from_before_is_read(robot in robots(), values in effects(), seed in any::<u64>()) {
        let later = LATER_OF_DELTA[(seed % 3) as usize];
        let mut parts = Parts::new(&robot, &values, seed);
        for own in parts.values.iter_mut().flat_map(|all| &mut all[delta::PARAMETERS - later..]) {
            *own = 0.0;
        }
        let mut old = parts.written();
        let end = values_of_delta_end();
        if parts.has_local {
            // behind the first branch's correction: that there is a region, the region, the other branch
            let correction = if parts.corrected { 1 + 3 + 7 + 3 * parts.coefficients.len() } else { 1 };
            let other = end + correction + 1 + 7 + end - 3;
            old.drain(other - later..other);
        }
        old.drain(end - later..end);
        old[2] -= later as f64;
        let (read, made, now) = (read_delta(&old).expect("one from before"), parts.made(), some_covariates());
        prop_assert_eq!(read.forward(&parts.robot.joints, &now), made.forward(&parts.robot.joints, &now));
        prop_assert_eq!(read.local.is_some(), made.local.is_some());
    }

    /// A row that is cut, continued or spoilt, and that is taken all the same or panics.
    #[test]
    fn a_row_that_is_no_delta_is_refused(robot in robots(), values in effects(), seed in any::<u64>()) {
        let parts = Parts::new(&robot, &values, seed);
        let row = parts.written();
        for end in 0..row.len() {
            prop_assert!(read_delta(&row[..end]).is_err(), "{} of {}", end, row.len());
        }
        let mut spoilt = row.clone();
        spoilt.push(0.0);
        prop_assert!(read_delta(&spoilt).is_err());
        for k in 0..row.len() {
            for bad in [f64::NAN, f64::INFINITY, 1e300, -7.5] {
                spoilt.clone_from(&row);
                spoilt[k] = bad;
                let Ok(robot) = read_delta(&spoilt) else { continue };
                prop_assert!(!bad.is_nan(), "{}", k);
                // what is read must answer, whatever it is
                if let Ok((x, j)) = robot.forward(&parts.robot.joints, &some_covariates()) {
                    prop_assert!(bad.is_infinite() || x.iter().chain(&j).all(|x| x.is_finite()), "{} {}", k, bad);
                }
            }
        }
    }
}

/// The same for an arm.
#[test]
fn an_arm_comes_back_to_the_last_bit() {
    let mut joints = [Joint::NONE; JOINTS];
    for (k, joint) in joints.iter_mut().enumerate().take(4) {
        joint.fixed.rotation =
            sherkit_core::camera::rotation_matrix(&Vector3::new(1.2, 0.3, 0.1 * k as f64));
        joint.fixed.translation = Vector3::new(200.0, 30.0 * k as f64, 50.0);
        (joint.prismatic, joint.home, joint.mass_kg) = (k == 2, 0.1 * k as f64, 3.0);
        joint.follows = 0.5 * k as f64;
        joint.centre_mm = Vector3::new(20.0, 40.0, 60.0);
    }
    let model = serial::Model {
        joints,
        count: 4,
        targets_mm: [Vector3::new(10.0, 20.0, 30.0); serial::TARGETS],
        centres_mm: [Vector3::new(-1.0, -2.0, -3.0); CENTRES],
        planes: [Flat::GROUND; PLANES],
        sensor: common::drawn().sensor,
        gravity: -Vector3::z(),
        encoder_period: std::array::from_fn(|i| 0.4 + 0.05 * i as f64),
        time_origin_s: 1.0,
        slip_time_s: 2.0,
        joint_slip_time_s: 102.0,
        sensor_slip_time_s: 3.0,
    };
    let limits = Limits {
        low: std::array::from_fn(|k| -3.0 - k as f64),
        high: [3.0; JOINTS],
    };
    let values = std::array::from_fn(|k| 1e-4 * (k as f64 - 40.0));
    let mut row = Vec::new();
    write_serial(&model, &values, &limits, |x| row.push(x));
    let read = read_serial(&row).expect("what was written");
    let made = serial::Calibrated::new(&model, &values, &limits).expect("an arm");
    let now = serial::Covariates {
        time_s: 3.0,
        temperature_c: 21.0,
        stand_c: 21.5,
        payload_kg: 3.0,
        direction: [1.0; JOINTS],
        velocity: [0.0; JOINTS],
    };
    let joints = SVector::from([0.3, -0.5, 20.0, 0.7, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let start = SVector::zeros();
    assert_eq!(read.sensor(), made.sensor());
    for frame in [Frame::Base, Frame::Sensor] {
        let (read, made) = (read.in_frame(frame), made.in_frame(frame));
        let found = made.forward(&joints, &now).expect("a place");
        assert_eq!(read.forward(&joints, &now), Ok(found));
        assert_eq!(
            read.inverse(&found.0, &start, &now),
            made.inverse(&found.0, &start, &now)
        );
    }
    for end in 0..row.len() {
        assert!(read_serial(&row[..end]).is_err());
    }
    for k in 0..row.len() {
        for bad in [f64::NAN, f64::INFINITY, 1e300, -7.5] {
            let mut spoilt = row.clone();
            spoilt[k] = bad;
            // what is read must answer, whatever it is
            if let Ok(arm) = read_serial(&spoilt) {
                assert!(bad.is_finite(), "{k}");
                let _ = arm.forward(&joints, &now);
            }
        }
    }
    assert!(read_delta(&row).is_err());
    // a row from before gears had a second wave: all but the last parameters, and as if these were zero
    let later = 6 + 2 * JOINTS;
    let before = serial::PARAMETERS - later;
    let values = std::array::from_fn(|k| if k < before { values[k] } else { 0.0 });
    let made = serial::Calibrated::new(&model, &values, &limits).expect("an arm");
    let mut old = row;
    old.truncate(old.len() - later);
    old[2] = before as f64;
    let read = read_serial(&old).expect("an arm from before");
    assert_eq!(read.forward(&joints, &now), made.forward(&joints, &now));
}

/// The same for the spherical robot.
#[test]
fn a_spherical_robot_comes_back_to_the_last_bit() {
    let model = spherical::Model {
        geometry: spherical::Geometry::equal(0.9, 0.7),
        radius_mm: 200.0,
        camera: Description::facing(1.57, 0.8, 446.0, [1100.0, 1100.0, 640.0, 320.0]),
        face: Face::Far,
        readings: spherical::Readings::Pixels,
        gravity: Vector3::new(0.1, -0.9, 0.2),
        home: [1.4, 1.6],
        time_origin_s: 0.0,
        slip_time_s: 0.0,
        joint_slip_time_s: 0.0,
        encoder_period: [0.4, 0.3],
        sensor_slip_time_s: 0.0,
    };
    let values = std::array::from_fn(|k| 1e-4 * (k as f64 - 7.0));
    let now = spherical::Covariates {
        time_s: 3.0,
        temperature_c: 21.0,
        stand_c: 21.5,
        payload_kg: 3.0,
        direction: [1.0, -1.0],
        velocity: [0.0; 2],
    };
    for elbows in [Elbows::Open, Elbows::Crossed, Elbows::Ahead, Elbows::Behind] {
        let mut row = Vec::new();
        write_spherical(&model, &values, elbows, |x| row.push(x));
        let read = read_spherical(&row).expect("what was written");
        let made = spherical::Calibrated::new(&model, &values, elbows).expect("a robot");
        for joints in [[2.1, 0.9], [2.5, 1.4], [1.4, 2.0]].map(Vector2::from) {
            assert_eq!(read.forward(&joints, &now), made.forward(&joints, &now));
            let angles = Vector2::new(1.5, 0.8);
            assert_eq!(read.inverse(&angles, &now), made.inverse(&angles, &now));
        }
        for end in 0..row.len() {
            assert!(read_spherical(&row[..end]).is_err());
        }
        for k in 0..row.len() {
            let mut spoilt = row.clone();
            spoilt[k] = f64::NAN;
            assert!(read_spherical(&spoilt).is_err(), "{k}");
        }
        assert!(read_delta(&row).is_err());
    }
    // from before encoders had a second wave
    let later = 6 + 4;
    let before = spherical::PARAMETERS - later;
    let values = std::array::from_fn(|k| if k < before { values[k] } else { 0.0 });
    let mut old = Vec::new();
    write_spherical(&model, &values, Elbows::Open, |x| old.push(x));
    old.truncate(old.len() - later);
    old[2] = before as f64;
    let read = read_spherical(&old).expect("one from before");
    let made = spherical::Calibrated::new(&model, &values, Elbows::Open).expect("a robot");
    let joints = Vector2::new(2.1, 0.9);
    assert_eq!(read.forward(&joints, &now), made.forward(&joints, &now));
}
