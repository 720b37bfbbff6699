//! The whole measurement chain: derivatives by every parameter, and what it is without effects.

mod common;

use common::{
    anchor, config, derivative, drawn, effects, joints_at, model_of, plausible, range_of, robots,
    rods, some_covariates, stand,
};
use nalgebra::{Matrix3, Matrix6, Rotation3, Vector3, Vector6};
use proptest::prelude::*;
use sherkit_core::Error;
use sherkit_core::chain::effects::Wanted;
use sherkit_core::chain::{Aim, Columns, Robot as _};
use sherkit_core::delta::{CATALOGUE, Covariates, LIMBS, Model, PARAMETERS, Row, Values};
use sherkit_core::numbers::rigid::Rigid;
use std::f64::consts::TAU;
use std::ops::Range;

/// Where the parameters of an effect stand.
const fn of(name: &str) -> Range<usize> {
    range_of(CATALOGUE, name)
}

const BACKLASH: Range<usize> = of("backlash");
const BAR_ZERO: Range<usize> = of("bar_zero");
const BEAM_ALIGNMENT: Range<usize> = of("beam_alignment");
const DRIVE_COMPLIANCE: Range<usize> = of("drive_compliance");
const DRIFT: Range<usize> = of("drift");
const ENCODER_CYCLIC: Range<usize> = of("encoder_cyclic");
const ENCODER_SECOND: Range<usize> = of("encoder_second");
const GRAVITY_SAG: Range<usize> = of("gravity_sag");
const JOINT_SCALE: Range<usize> = of("joint_scale");
const JOINT_SLIP: Range<usize> = of("joint_slip");
const LIMB_TWIST: Range<usize> = of("limb_twist");
const LINK_GROWTH: Range<usize> = of("link_growth");
const ROD_MISMATCH: Range<usize> = of("rod_mismatch");
const SENSOR_LINEARITY: Range<usize> = of("sensor_linearity");
const SENSOR_POSE: Range<usize> = of("sensor_pose");
const SENSOR_SLIP: Range<usize> = of("sensor_slip");
const SENSOR_DRIFT: Range<usize> = of("sensor_drift");
const SLIP: Range<usize> = of("slip");
const THERMAL_GROWTH: Range<usize> = of("thermal_growth");
const THERMAL_SHIFT: Range<usize> = of("thermal_shift");

/// Columns of one row that is computed as many are.
struct Together(nalgebra::SMatrix<f64, 3, PARAMETERS>);

impl Columns<f64, 3> for Together {
    fn put(&mut self, parameter: usize, column: [f64; 3]) {
        self.0.set_column(parameter, &column.into());
    }
}

proptest! {
    #![proptest_config(config())]

    /// A column of all parameters that forgets a link behind its own, a sign, or the other end of a distance; at zero
    /// effects, where many columns come from formulas of their own, and at effects of plausible size; before the instrument
    /// slips and after it.
    #[test]
    fn derivatives_are_exact(
        robot in robots(),
        values in effects(),
        quiet in any::<bool>(),
        slipped in any::<bool>(),
        moves in prop::array::uniform3(3.0..8.0_f64),
        push in prop::array::uniform3(-1.0..1.0_f64),
    ) {
        let values = if quiet { [0.0; PARAMETERS] } else { values };
        let model = model_of(&robot);
        let joints = [robot.joints.x, robot.joints.y, robot.joints.z];
        let to = std::array::from_fn(|i| joints[i] + moves[i]);
        let mut covariates = some_covariates();
        covariates.time_s = model.sensor_slip_time_s + if slipped { 900.0 } else { -1.0 };
        let row = |to| Row { joints, to, aim: Aim::default(), covariates, push: Vector3::from(push) };
        let chain = model.with(&values).unwrap();
        // steps that move the reading by a few hundredths of a millimetre
        let place = chain.row_predict(&row(None), Wanted::ALL).unwrap();
        let sizes: Values = plausible(CATALOGUE);
        let steps: Values = std::array::from_fn(|p| {
            let moved = place.by_parameters.column(p).norm();
            if moved > 0.0 { (0.02 / moved).min(0.3 * sizes[p]) } else { 0.3 * sizes[p] }
        });
        for row in [row(None), row(Some(to))] {
            let predicted = chain.row_predict(&row, Wanted::ALL).unwrap();
            prop_assert_eq!(predicted.value, chain.row_value(&row).unwrap());
            for p in 0..PARAMETERS {
                let differences = derivative(|h| {
                    let mut v = values;
                    v[p] += h;
                    model.with(&v).unwrap().row_value(&row).unwrap()
                }, steps[p]);
                let column = predicted.by_parameters.column(p).into_owned();
                let difference = (column - differences).norm();
                // a step moves a far robot by little more than its last digits, of which a distance keeps the difference
                let room = 1e-7 * column.norm().max(1.0) + 1e-11 / steps[p];
                prop_assert!(difference < room, "{:?} parameter {p}: {difference} of {room}", row.to);
            }
            for axis in 0..3 {
                let differences = derivative(|h| {
                    let mut r = row;
                    r.push[axis] += h;
                    chain.row_value(&r).unwrap()
                }, 0.1);
                prop_assert!((predicted.by_body.column(axis) - differences).norm() < 1e-7);
                let differences = derivative(|h| {
                    let mut r = row;
                    r.joints[axis] += h;
                    chain.row_value(&r).unwrap()
                }, 0.02);
                let column = predicted.by_joints.column(axis);
                let difference = (column - differences).norm() / column.norm().max(1.0);
                prop_assert!(difference < 1e-7, "{:?} joint {axis}: {difference}", row.to);
            }
        }
    }

    /// A distance that an instrument's beams bend, or that is not that of its places; a bar's zero with the wrong sign; a
    /// derivative by the other end that is not the first's with the ends exchanged.
    #[test]
    fn a_distance_is_that_of_its_places(
        robot in robots(),
        values in effects(),
        moves in prop::array::uniform3(3.0..8.0_f64),
    ) {
        let mut values = values;
        let chain = model_of(&robot).with(&values).unwrap();
        let joints = [robot.joints.x, robot.joints.y, robot.joints.z];
        let to: [f64; LIMBS] = std::array::from_fn(|i| joints[i] + moves[i]);
        let row = |joints, to| Row { joints, to, aim: Aim::default(), covariates: some_covariates(), push: Vector3::zeros() };
        let (there, here) = (row(to, Some(joints)), row(joints, Some(to)));
        let apart = chain.row_point(&row(to, None)).unwrap() - chain.row_point(&row(joints, None)).unwrap();
        let found = chain.row_value(&here).unwrap().x;
        prop_assert!((found - apart.norm() - values[BAR_ZERO.start]).abs() < 1e-9);
        values[SENSOR_POSE].fill(0.0);
        values[SENSOR_SLIP].fill(0.0);
        values[SENSOR_DRIFT].fill(0.0);
        values[BEAM_ALIGNMENT].fill(0.0);
        values[SENSOR_LINEARITY].fill(0.0);
        prop_assert_eq!(model_of(&robot).with(&values).unwrap().row_value(&here).unwrap().x, found);
        let by_joints = chain.row_predict(&there, Wanted::ALL).unwrap().by_joints;
        for axis in 0..3 {
            let differences = derivative(|h| {
                let mut to = to;
                to[axis] += h;
                chain.row_value(&row(joints, Some(to))).unwrap()
            }, 0.02);
            prop_assert!((by_joints.column(axis) - differences).norm() < 1e-6, "{axis}");
        }
    }

    /// A column that is left out or another one's where rows are computed side by side, of geometry, lean and sensors, turned
    /// or in the axes of the base; rows whose effects are solved by iteration that are answered nevertheless.
    #[test]
    fn rows_side_by_side_equal_rows_alone(
        robot in robots(),
        values in effects(),
        push in prop::array::uniform3(-1.0..1.0_f64),
        turned in any::<bool>(),
        off in any::<bool>(),
    ) {
        let mut model = model_of(&robot);
        if !turned {
            model.sensor.rotation = Matrix3::identity();
        }
        let one_by_one = [BACKLASH, ENCODER_CYCLIC, ENCODER_SECOND, JOINT_SCALE, JOINT_SLIP, DRIFT, SLIP, THERMAL_GROWTH, THERMAL_SHIFT, GRAVITY_SAG, DRIVE_COMPLIANCE, LIMB_TWIST, LINK_GROWTH, ROD_MISMATCH, SENSOR_SLIP, SENSOR_DRIFT];
        let mut plain = values;
        if !off {
            plain[SENSOR_POSE].fill(0.0);
        }
        for range in &one_by_one {
            plain[range.clone()].fill(0.0);
        }
        let free: Vec<usize> = (0..PARAMETERS).filter(|p| !one_by_one.iter().any(|range| range.contains(p))).collect();
        let (joints, push) = (robot.joints.into(), Vector3::from(push));
        let none = Covariates::NONE;
        for wanted in [Wanted::of(CATALOGUE, &free), Wanted::of(CATALOGUE, &free[..1]), Wanted::NONE] {
            let chain = model.with(&plain).unwrap();
            let alone = chain.predict(&robot.joints, &none, &push, wanted).unwrap();
            let mut columns = Together(nalgebra::SMatrix::zeros());
            let (value, reached) = chain.predict_many(joints, push.into(), wanted, &mut columns).unwrap();
            prop_assert_eq!(reached, 1.0);
            prop_assert_eq!(Vector3::from(value), alone.value);
            for p in 0..PARAMETERS {
                let (together, alone) = (columns.0.column(p), alone.by_parameters.column(p));
                prop_assert!((together - alone).norm() <= 1e-12 * alone.norm().max(1.0), "{p}: {together} {alone}");
            }
        }
        for range in one_by_one {
            let mut acting = plain;
            acting[range.clone()].fill(1e-4);
            let mut columns = Together(nalgebra::SMatrix::zeros());
            let chain = model.with(&acting).unwrap();
            prop_assert!(chain.predict_many::<f64>(joints, push.into(), Wanted::NONE, &mut columns).is_none());
            let wanted = Wanted::of(CATALOGUE, &[range.start]);
            let chain = model.with(&plain).unwrap();
            prop_assert!(chain.predict_many::<f64>(joints, push.into(), wanted, &mut columns).is_none());
        }
    }

    /// A derivative that is wanted and left out, or that depends on what else is wanted.
    #[test]
    fn wanted_derivatives_do_not_depend_on_each_other(
        robot in robots(),
        values in effects(),
        wanted in prop::collection::vec(0..PARAMETERS, 0..6),
    ) {
        let chain = model_of(&robot).with(&values).unwrap();
        let predict = |w| chain.predict(&robot.joints, &some_covariates(), &Vector3::zeros(), w).unwrap();
        let (all, some) = (predict(Wanted::ALL), predict(Wanted::of(CATALOGUE, &wanted)));
        prop_assert_eq!((all.value, all.by_joints, all.by_body), (some.value, some.by_joints, some.by_body));
        for p in 0..PARAMETERS {
            let (all, some) = (all.by_parameters.column(p), some.by_parameters.column(p));
            prop_assert!(some == all || (!wanted.contains(&p) && some.amax() == 0.0), "{p}");
        }
    }

    /// A reading without effects that is not where the platform, the target and the sensor's pose put it, in whichever order of
    /// turns and shifts; a distance that is none.
    #[test]
    fn without_effects_readings_are_where_the_drawing_says(
        robot in robots(),
        off in prop::array::uniform6(-3.0..3.0_f64),
        away in prop::array::uniform3(-20.0..20.0_f64),
    ) {
        let mut values = [0.0; PARAMETERS];
        values[SENSOR_POSE].copy_from_slice(&off);
        let (model, away) = (model_of(&robot), Vector3::from(away));
        let chain = model.with(&values).unwrap();
        let (nothing, still) = (Covariates::NONE, Vector3::zeros());
        let found = chain.value(&robot.joints, &nothing, &still).unwrap();
        let target = robot.position + model.target_offset;
        prop_assert!((found - stand(&model.sensor, &off).apply(&target)).amax() < 1e-9);
        prop_assert!((chain.rough_inverse(&found).unwrap() - robot.joints).amax() < 1e-9);
        let sides = [robot.geometry.assembly.sign(); LIMBS];
        if let Some(to) = joints_at(&robot.geometry, &(robot.position + away), sides) {
            let joints = [robot.joints.x, robot.joints.y, robot.joints.z];
            let row = Row { joints, to: Some([to.x, to.y, to.z]), aim: Aim::default(), covariates: nothing, push: still };
            let found = chain.row_value(&row).unwrap();
            prop_assert!((found - Vector3::new(away.norm(), 0.0, 0.0)).amax() < 1e-8);
        }
    }

    /// An effect of joints, body or sensors with a wrong sign, size or centre: each written out by hand.
    #[test]
    fn simple_effects_are_what_they_say(robot in robots(), values in effects()) {
        let (model, now) = (model_of(&robot), some_covariates());
        let mut quiet = values;
        for range in [
            JOINT_SCALE, ENCODER_CYCLIC, ENCODER_SECOND, BACKLASH, JOINT_SLIP, THERMAL_GROWTH, DRIFT, SLIP, THERMAL_SHIFT,
            BEAM_ALIGNMENT, SENSOR_LINEARITY, SENSOR_POSE, SENSOR_SLIP, SENSOR_DRIFT,
        ] {
            quiet[range].fill(0.0);
        }
        let v = |range: Range<usize>, k: usize| values[range.start + k];
        let joints = Vector3::from_fn(|i, _| {
            let q = robot.joints[i];
            let turns = TAU * q / model.pole_pitch[i];
        let ((sin, cos), (sin_twice, cos_twice)) = (turns.sin_cos(), (2.0 * turns).sin_cos());
            q + v(JOINT_SCALE, i) * (q - model.home[i])
                + v(ENCODER_CYCLIC, 2 * i) * sin
                + v(ENCODER_CYCLIC, 2 * i + 1) * cos
                + v(ENCODER_SECOND, 2 * i) * sin_twice
                + v(ENCODER_SECOND, 2 * i + 1) * cos_twice
                // the full width between the two directions
                + v(BACKLASH, i) * now.direction[i] / 2.0
                + v(JOINT_SLIP, i)
        });
        let still = Vector3::zeros();
        let at_base = Model { sensor: Rigid::identity(), ..model };
        let body = at_base.with(&quiet).unwrap().value(&joints, &now, &still).unwrap()
            * (1.0 + v(THERMAL_GROWTH, 0) * (now.temperature_c - 20.0));
        let hours = (now.time_s - model.time_origin_s) / 3600.0;
        let push = Vector3::new(0.3, -0.2, 0.1);
        let body = body + push + Vector3::from_fn(|i, _| v(DRIFT, i) * hours + v(SLIP, i) + v(THERMAL_SHIFT, i) * (now.stand_c - 20.0));
        let off: [f64; 6] =
            std::array::from_fn(|k| v(SENSOR_POSE, k) + v(SENSOR_SLIP, k) + v(SENSOR_DRIFT, k) * hours);
        let seen = stand(&model.sensor, &off).apply(&body);
        let expected = Vector3::from_fn(|i, _| {
            let shown = seen[i] + (0..3).map(|k| v(BEAM_ALIGNMENT, 3 * i + k) * seen[k]).sum::<f64>();
            shown + v(SENSOR_LINEARITY, i) * (shown / 20.0).powi(3)
        });
        let found = model.with(&values).unwrap().value(&robot.joints, &now, &push).unwrap();
        prop_assert!((found - expected).amax() < 1e-9, "{}", found - expected);
        // before its time there is no slip
        let mut early = now;
        early.time_s = model.slip_time_s - 1.0;
        let mut only = [0.0; PARAMETERS];
        only[SLIP].fill(0.1);
        only[JOINT_SLIP].fill(0.1);
        only[SENSOR_SLIP].fill(0.1);
        let at = |values| model.with(values).unwrap().value(&robot.joints, &early, &still).unwrap();
        prop_assert_eq!(at(&only), at(&[0.0; PARAMETERS]));
    }

    /// Sag or drives that go up, or with the wrong share of the weight: against forces from statics, rods that stretch
    /// and carriages that give way.
    #[test]
    fn rods_and_drives_carry_their_share(
        robot in robots(),
        stretch in prop::array::uniform3(0.0..0.3_f64),
        give in prop::array::uniform3(0.0..0.3_f64),
    ) {
        let model = model_of(&robot);
        let mut values = [0.0; PARAMETERS];
        values[GRAVITY_SAG].copy_from_slice(&stretch);
        values[DRIVE_COMPLIANCE].copy_from_slice(&give);
        let of = |v| model.with(v).unwrap().value(&robot.joints, &Covariates::NONE, &Vector3::zeros()).unwrap();
        let moved = robot.sensor.rotation.transpose() * (of(&values) - of(&[0.0; PARAMETERS]));
        // where the platform hangs, tensions hold a unit weight (the sum of T ρ/|ρ|, from carriage to platform,
        // points down), and each rod is longer by what its own tension makes of it
        let (mut bent, mut tensions) = ([Vector3::zeros(); LIMBS], Vector3::zeros());
        let mut carriages = robot.joints;
        for _ in 0..20 {
            bent = rods(&robot.geometry, &(robot.position + moved), &carriages);
            let directions = bent.map(|r| r.normalize());
            tensions = Matrix3::from_columns(&directions).lu().solve(&-Vector3::z()).unwrap();
            // what pulls a carriage along its rail is the vertical part of its limb's tension
            carriages = robot.joints + Vector3::from_fn(|i, _| give[i] * tensions[i] * directions[i].z);
        }
        for i in 0..LIMBS {
            let longer = bent[i].norm() - robot.geometry.limbs[i].rod_length_mm;
            prop_assert!((longer - stretch[i] * tensions[i]).abs() < 1e-9, "{longer} {}", tensions[i]);
        }
        prop_assert!(moved.z <= 0.0);
    }

    /// A platform that tilts the other way, about the wrong centre, or not at all: against six rods solved here.
    #[test]
    fn unequal_rods_and_twisted_axes_tilt_the_platform(
        robot in robots(),
        mismatch in prop::array::uniform3(-0.5..0.5_f64),
        twist in prop::array::uniform3(-0.03..0.03_f64),
    ) {
        let model = model_of(&robot);
        let mut values = [0.0; PARAMETERS];
        values[ROD_MISMATCH].copy_from_slice(&mismatch);
        values[LIMB_TWIST].copy_from_slice(&twist);
        let now = Covariates::NONE;
        let found = model.with(&values).unwrap().value(&robot.joints, &now, &Vector3::zeros()).unwrap();
        let found = robot.sensor.apply_inverse(&found);
        let turn_of = |pose: &Vector6<f64>| Rotation3::from_scaled_axis(Vector3::new(pose[3], pose[4], pose[5]));
        let misses = |pose: &Vector6<f64>| {
            let (centre, turn) = (Vector3::new(pose[0], pose[1], pose[2]), turn_of(pose));
            Vector6::from_fn(|row, _| {
                let (i, side) = (row / 2, if row % 2 == 0 { 1.0 } else { -1.0 });
                let limb = &robot.geometry.limbs[i];
                let (sin, cos) = limb.platform_angle_rad.sin_cos();
                let ball = Vector3::new(cos, sin, 0.0) * limb.platform_radius_mm;
                let along = Vector3::new(-sin, cos, 0.0) * (side * 0.5 * model.rod_spacing);
                let above = Rotation3::from_axis_angle(&Vector3::z_axis(), twist[i]) * along;
                let carriage = anchor(limb) + ball + Vector3::z() * robot.joints[i];
                (centre + turn * (ball + along) - carriage - above).norm()
                    - limb.rod_length_mm - 0.5 * side * mismatch[i]
            })
        };
        let mut pose = Vector6::zeros();
        pose.fixed_rows_mut::<3>(0).copy_from(&robot.position);
        for _ in 0..12 {
            let h = 1e-5;
            let columns: [Vector6<f64>; 6] = std::array::from_fn(|k| {
                let step = Vector6::ith(k, h);
                (misses(&(pose + step)) - misses(&(pose - step))) / (2.0 * h)
            });
            pose -= Matrix6::from_columns(&columns).lu().solve(&misses(&pose)).unwrap();
        }
        prop_assume!(misses(&pose).amax() < 1e-11);
        let expected = Vector3::new(pose[0], pose[1], pose[2]) + turn_of(&pose) * model.target_offset;
        prop_assert!((found - expected).amax() < 1e-8, "{}", found - expected);
    }

    /// Values or joints of any bits that panic or give a reading that is not finite.
    #[test]
    fn any_bits_are_answered_finitely(
        robot in robots(),
        values in effects(),
        wild in prop::collection::vec((0..PARAMETERS, any::<u64>()), 0..3),
        joints in prop::array::uniform3(prop_oneof![-300.0..300.0_f64, prop::num::f64::ANY]),
    ) {
        let mut values = values;
        for (p, bits) in wild {
            values[p] = f64::from_bits(bits);
        }
        let finite = values.iter().all(|v| v.is_finite());
        let Ok(chain) = model_of(&robot).with(&values) else { return Ok(()) };
        prop_assert!(finite);
        let joints = robot.joints + Vector3::from(joints);
        for now in [some_covariates(), Covariates::NONE] {
            if let Ok(value) = chain.value(&joints, &now, &Vector3::zeros()) {
                prop_assert!(value.iter().all(|v| v.is_finite()), "{value}");
            }
            if let Ok(p) = chain.predict(&joints, &now, &Vector3::zeros(), Wanted::default()) {
                prop_assert!(p.value.iter().all(|v| v.is_finite()));
            }
        }
    }
}

/// A distance between two equal places divided by itself.
#[test]
fn a_distance_of_zero_has_a_finite_derivative() {
    let robot = drawn();
    let joints: [f64; LIMBS] = robot.joints.into();
    let row = Row {
        joints,
        to: Some(joints),
        aim: Aim::default(),
        covariates: some_covariates(),
        push: Vector3::zeros(),
    };
    let chain = model_of(&robot).with(&[0.0; PARAMETERS]).unwrap();
    let predicted = chain.row_predict(&row, Wanted::ALL).unwrap();
    assert_eq!(predicted.value, Vector3::zeros());
    let mut columns = predicted.by_parameters;
    assert_eq!(columns[(0, BAR_ZERO.start)], 1.0);
    columns.column_mut(BAR_ZERO.start).fill(0.0);
    assert_eq!(columns.amax(), 0.0);
}

/// An effect whose covariate is missing and that is quietly left out, or one at zero that spoils the reading.
#[test]
fn an_effect_without_its_covariate_is_refused() {
    let robot = drawn();
    let model = model_of(&robot);
    let value = |values: &Values| {
        model
            .with(values)
            .unwrap()
            .value(&robot.joints, &Covariates::NONE, &Vector3::zeros())
    };
    assert!(value(&[0.0; PARAMETERS]).is_ok());
    for p in [
        BACKLASH.start,
        THERMAL_GROWTH.start,
        DRIFT.start,
        SLIP.start,
        SENSOR_SLIP.start,
    ] {
        let mut values = [0.0; PARAMETERS];
        values[p] = 1e-3;
        assert!(
            matches!(value(&values), Err(Error::NotFinite { .. })),
            "{p}"
        );
    }
}

/// A value that is no number and goes into every reading, or the wrong one blamed.
#[test]
fn a_value_that_is_no_number_is_named() {
    let robot = drawn();
    for index in 0..PARAMETERS {
        for bad in [f64::NAN, f64::INFINITY] {
            let mut values = [0.0; PARAMETERS];
            values[index] = bad;
            let refused = model_of(&robot).with(&values).err();
            assert_eq!(refused, Some(Error::NotFinite { index }));
        }
    }
}
