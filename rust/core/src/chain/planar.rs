//! The smallest mechanism, kept as a test of the chain: a planar arm of two revolute joints, measured by coordinates.
//! What is here is all that a new mechanism has to say; joints, body and sensor effects it takes from their links. Its
//! instrument may stand anywhere.
//!
//! Frame: z along both axes, origin at the shoulder. `p = l₁ u(θ₁) + l₂ u(θ₁ + θ₂)` in the plane `z = height`; under its
//! own weight the shoulder tilts in proportion to the moment, so that the tip falls by `droop · (reach/span)²`.

use super::effects::{Effect, OWN_LEVER, Wanted, places, values_of};
use super::places::Places;
use super::table::effects;
use super::{
    Aim, Cartesian, Covariates, Distances, Mechanism, Moments, Prediction, Robot, Row, Settings,
    Table,
};
use crate::camera::rotation_matrix;
use crate::numbers::math::sin_cos;
use crate::numbers::rigid::Rigid;
use crate::{Error, Result};
use core::f64::consts::PI;
use nalgebra::{Matrix3x2, SMatrix, Vector2, Vector3};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

extern crate std;

places! { At: links droop }

effects! { At;
    links: Structure by structure (base) {
        length_1 "δl₁", length_2 "δl₂": "mm", 1.0, 1.0;
    }
    joint_offset: Joints by joints (base) {
        offset_1 "δθ₁", offset_2 "δθ₂": "rad", 0.02, OWN_LEVER;
    }
    sensor_pose: Sensor by pose (base) {
        sensor_turn_x, sensor_turn_y, sensor_turn_z: "rad", 1.0, 20.0;
        sensor_shift_x, sensor_shift_y, sensor_shift_z: "mm", 10.0, 1.0;
    }
    sensor_slip: Sensor by pose needs "time_s" search "time_s" {
        turn_x, turn_y, turn_z: "rad", 2e-3, 20.0;
        shift_x, shift_y, shift_z: "mm", 0.1, 1.0;
    }
    sensor_drift: Sensor by pose needs "time_s" {
        turn_rate_x, turn_rate_y, turn_rate_z: "rad/h", 2e-3, 20.0;
        shift_rate_x, shift_rate_y, shift_rate_z: "mm/h", 0.1, 1.0;
    }
    joint_scale: Joints by joints {
        scale_1, scale_2: "rad/rad", 2e-3, 200.0;
    }
    encoder_eccentricity: Joints by joints {
        sine_1, cosine_1, sine_2, cosine_2: "rad", 2e-3, 200.0;
    }
    encoder_cyclic: Joints by joints search "period_rad" {
        sine_1, cosine_1, sine_2, cosine_2: "rad", 1e-3, 200.0;
    }
    backlash: Joints by joints needs "direction" {
        width_1, width_2: "rad", 1e-3, 200.0;
    }
    joint_slip: Joints by joints needs "time_s" search "time_s" {
        step_1, step_2: "rad", 2e-3, 200.0;
    }
    // by how much the tip falls at full reach
    droop: Structure by structure {
        fall: "mm", 0.2, 1.0;
    }
    thermal_growth: Body by body needs "temperature_c" {
        coefficient "α": "1/°C", 2e-5, 200.0;
    }
    drift: Body by body needs "time_s" {
        rate_x, rate_y, rate_z: "mm/h", 0.1, 1.0;
    }
    slip: Body by body needs "time_s" search "time_s" {
        step_x, step_y, step_z: "mm", 0.1, 1.0;
    }
    thermal_shift: Sensor by body needs "temperature_c" search "lag_s" {
        shift_x, shift_y, shift_z: "mm/°C", 0.01, 1.0;
    }
    sensor_linearity: Sensor by cartesian {
        cubic_x, cubic_y, cubic_z: "mm", 0.005, 1.0;
    }
}

/// The arm as drawn: lengths of its links and height of its plane, mm; from its base to the instrument.
#[derive(Clone, Copy, Debug)]
struct Arm {
    lengths: [f64; 2],
    height: f64,
    sensor: Rigid,
}

/// The arm with its errors: lengths of its links, height of its plane, fall by squared reach.
#[derive(Clone, Copy, Debug)]
struct Structure {
    lengths: [f64; 2],
    height: f64,
    fall: f64,
    span: f64,
}

impl Table for Arm {
    type Own = At;
    const CATALOGUE: &'static [Effect] = CATALOGUE;
    const AT: Places<At> = AT;
}

impl Robot<2, 3, PARAMETERS> for Arm {
    type Structure = Structure;
    type Sensor = Cartesian;
    type Around = ();
    const DISTANCES: Distances = Distances::BetweenPlaces;

    fn settings(&self) -> Settings<2> {
        Settings {
            home: [0.1, -0.2],
            wave: [7.0, 11.0],
            time_origin_s: 100.0,
            slip_time_s: 500.0,
            joint_slip_time_s: 600.0,
        }
    }

    fn check(&self) -> Result<()> {
        if self.lengths.iter().all(|l| *l > 0.0) {
            return Ok(());
        }
        let what = "the links must have a length";
        Err(Error::InvalidGeometry { limb: 0, what })
    }

    fn structure(&self, values: &Values) -> Result<Structure> {
        let more: [f64; 2] = values_of(AT.structure.links, values);
        let [fall] = values_of(AT.structure.droop, values);
        let lengths = [self.lengths[0] + more[0], self.lengths[1] + more[1]];
        Ok(Structure {
            lengths,
            height: self.height,
            fall,
            span: self.lengths[0] + self.lengths[1],
        })
    }

    fn sensor(&self, values: &Values) -> Result<Cartesian> {
        Ok(Cartesian::new::<Self, PARAMETERS>(
            &self.sensor,
            Moments {
                origin_s: 100.0,
                slip_s: SENSOR_SLIP_S,
            },
            values,
        ))
    }

    fn around(&self, _: &Values) {}
}

/// Along the links, and the tip without its fall.
struct Solved {
    along: [Vector2<f64>; 2],
    tip: Vector2<f64>,
}

impl Structure {
    /// A change of the tip in its plane, with what it falls by it.
    fn falling(&self, tip: &Vector2<f64>, change: &Vector2<f64>) -> Vector3<f64> {
        let down = -2.0 * self.fall * tip.dot(change) / (self.span * self.span);
        Vector3::new(change.x, change.y, down)
    }
}

impl Mechanism<2, PARAMETERS> for Structure {
    type Solved = Solved;
    type Many<T: crate::numbers::math::Real> = ();

    fn solve(&self, joints: &Vector2<f64>) -> Result<Solved> {
        let along = [joints.x, joints.x + joints.y].map(|angle| {
            let (sin, cos) = sin_cos(angle);
            Vector2::new(cos, sin)
        });
        let tip = along[0] * self.lengths[0] + along[1] * self.lengths[1];
        Ok(Solved { along, tip })
    }

    fn point(&self, solved: &Solved) -> Vector3<f64> {
        let reach = solved.tip.norm() / self.span;
        let height = self.height - self.fall * reach * reach;
        Vector3::new(solved.tip.x, solved.tip.y, height)
    }

    fn columns<const M: usize>(
        &self,
        _: &Vector2<f64>,
        solved: &Solved,
        by_point: &SMatrix<f64, M, 3>,
        wanted: Wanted,
        d: &mut SMatrix<f64, M, PARAMETERS>,
    ) -> SMatrix<f64, M, 2> {
        let Solved { along, tip } = solved;
        if let Some(place) = wanted.wants(AT.structure.links) {
            for (k, one) in along.iter().enumerate() {
                d.set_column(place.start + k, &(by_point * self.falling(tip, one)));
            }
        }
        if let Some(place) = wanted.wants(AT.structure.droop) {
            let reach = tip.norm() / self.span;
            d.set_column(place.start, &(by_point.column(2) * (-reach * reach)));
        }
        let swing = |arm: Vector2<f64>| self.falling(tip, &Vector2::new(-arm.y, arm.x));
        let turns = [swing(*tip), swing(along[1] * self.lengths[1])];
        by_point * Matrix3x2::from_columns(&turns)
    }
}

/// When the instrument slips.
const SENSOR_SLIP_S: f64 = 650.0;

/// The arm, seen from where its instrument stands.
const fn arm(sensor: Rigid) -> Arm {
    Arm {
        lengths: [250.0, 180.0],
        height: 40.0,
        sensor,
    }
}

/// Instruments that stand anywhere: turned by any turn, and 300 mm aside along each axis at most.
fn sensors() -> impl Strategy<Value = Rigid> {
    let turn = prop::array::uniform3(-PI..PI);
    let shift = prop::array::uniform3(-300.0..300.0_f64);
    (turn, shift).prop_map(|(turn, shift)| Rigid {
        rotation: rotation_matrix(&Vector3::from(turn)),
        translation: Vector3::from(shift),
    })
}

/// Few cases, the same in every run unless others are asked for, as in `tests/common`.
fn config() -> ProptestConfig {
    let given = ProptestConfig::default();
    let random = std::env::var_os("SHERKIT_RANDOM").is_some_and(|v| !v.is_empty());
    ProptestConfig {
        cases: 32,
        rng_seed: if random {
            given.rng_seed
        } else {
            RngSeed::Fixed(0x5e_ed)
        },
        failure_persistence: None,
        ..given
    }
}

const ROW: Row<2> = Row {
    joints: [0.4, 0.9],
    to: None,
    aim: Aim {
        target: 0,
        from: None,
    },
    covariates: Covariates {
        time_s: 700.0,
        temperature_c: 23.0,
        stand_c: 22.0,
        payload_kg: f64::NAN,
        direction: [1.0, -1.0],
        velocity: [f64::NAN; 2],
    },
    push: Vector3::new(0.3, -0.2, 0.1),
};

/// Every parameter at a share of its plausible size, signs alternating.
fn some(share: f64) -> Values {
    let mut values = [0.0; PARAMETERS];
    let sizes = CATALOGUE.iter().flat_map(|e| e.parameters);
    for (k, (value, parameter)) in values.iter_mut().zip(sizes).enumerate() {
        *value = share * parameter.size * if k % 2 == 0 { 1.0 } else { -0.7 };
    }
    values
}

/// A central difference of fourth order.
fn difference(at: impl Fn(f64) -> Vector3<f64>, h: f64) -> Vector3<f64> {
    ((at(h) - at(-h)) * 8.0 - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h)
}

/// Whether a column is what differences say, to 1e-7 of itself or of a unit.
fn agree(column: &Vector3<f64>, other: &Vector3<f64>, what: &str, number: usize) {
    let miss = (column - other).norm() / column.norm().max(1.0);
    assert!(miss < 3e-7, "{what} {number}: {miss}");
}

proptest! {
    #![proptest_config(config())]

    /// A column of the mechanism, or of a link that has never served two joints, that forgets a sign, another link or the
    /// other end of a distance; at zero effects, where links leave work out, and at plausible ones; before the instrument slips
    /// and after it.
    #[test]
    fn derivatives_are_exact(sensor in sensors(), slipped in any::<bool>()) {
        let (arm, mut here) = (arm(sensor), ROW);
        if !slipped {
            here.covariates.time_s = SENSOR_SLIP_S - 1.0;
        }
        for (values, to) in [
            (some(0.0), None),
            (some(1.0), None),
            (some(1.0), Some([-0.3, 1.4])),
        ] {
            has_exact_derivatives(&arm, &values, &Row { to, ..here });
        }
    }
}

fn has_exact_derivatives(arm: &Arm, values: &Values, row: &Row<2>) {
    let sizes = CATALOGUE.iter().flat_map(|e| e.parameters);
    let chain = arm.with(values).unwrap();
    let found: Prediction<2, 3, PARAMETERS> = chain.row_predict(row, Wanted::ALL).unwrap();
    assert_eq!(found.value, chain.row_value(row).unwrap());
    for (p, parameter) in sizes.enumerate() {
        let moved = |h: f64| {
            let mut values = *values;
            values[p] += h;
            arm.with(&values).unwrap().row_value(row).unwrap()
        };
        let column = found.by_parameters.column(p).into_owned();
        // an instrument may be turned by any turn: a step of that size is none of a derivative
        let by = difference(moved, 0.05 * parameter.size.min(0.05));
        agree(&column, &by, parameter.name, p);
    }
    for k in 0..2 {
        let moved = |h: f64| {
            let mut row = *row;
            row.joints[k] += h;
            chain.row_value(&row).unwrap()
        };
        let column = found.by_joints.column(k).into_owned();
        agree(&column, &difference(moved, 1e-3), "joint", k);
    }
    for axis in 0..3 {
        let moved = |h: f64| {
            let mut row = *row;
            row.push[axis] += h;
            chain.row_value(&row).unwrap()
        };
        let column = found.by_body.column(axis).into_owned();
        agree(&column, &difference(moved, 0.1), "axis", axis);
    }
}

/// A chain that is not the drawing where nothing is wrong, or that needs covariates of effects that are not at work; and a
/// fall of the wrong sign or size.
#[test]
fn it_is_the_drawing_without_effects() {
    let joints = [0.0, core::f64::consts::FRAC_PI_2];
    let row = Row {
        joints,
        to: None,
        aim: Aim::default(),
        covariates: Covariates::NONE,
        push: Vector3::zeros(),
    };
    let arm = arm(Rigid::identity());
    let at = |values: &Values| arm.with(values).unwrap().row_point(&row).unwrap();
    let mut values = some(0.0);
    assert!((at(&values) - Vector3::new(250.0, 180.0, 40.0)).norm() < 1e-12);
    values[AT.structure.droop.unwrap().start] = 1.0;
    let share = (250.0_f64.powi(2) + 180.0_f64.powi(2)) / 430.0_f64.powi(2);
    assert!((at(&values) - Vector3::new(250.0, 180.0, 40.0 - share)).norm() < 1e-12);
}
