//! The calibrated robot: its inverse, its Jacobian, and what happens where models and corrections end.

mod common;

use common::{
    Random, Robot, config, derivative, drawn, effects, model_of, plausible, range_of, robots,
    some_covariates, stand, straight_over_all,
};
use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;
use sherkit_core::Error;
use sherkit_core::chain::effects::Wanted;
use sherkit_core::chain::{Frame, REFERENCE_TEMPERATURE_C, Robot as _};
use sherkit_core::delta::correction::{Correction, Domain, coefficients_len};
use sherkit_core::delta::{Branch, CATALOGUE, Calibrated, PARAMETERS, Values};
use std::ops::Range;

const BEAM_ALIGNMENT: Range<usize> = range_of(CATALOGUE, "beam_alignment");
const SENSOR_LINEARITY: Range<usize> = range_of(CATALOGUE, "sensor_linearity");
const SENSOR_POSE: Range<usize> = range_of(CATALOGUE, "sensor_pose");
const SENSOR_SLIP: Range<usize> = range_of(CATALOGUE, "sensor_slip");
const SENSOR_DRIFT: Range<usize> = range_of(CATALOGUE, "sensor_drift");

/// What a random calibrated robot is made of; [`Parts::with`] puts it together.
#[derive(Clone, Debug)]
struct Parts {
    robot: Robot,
    whole: Values,
    local: Values,
    orders: [[usize; 3]; 2],
    coefficients: [Vec<[f64; 3]>; 2],
    /// Boxes of the two corrections and of the region, about the robot's position.
    boxes: [Domain; 3],
    corrected: [bool; 2],
    has_local: bool,
}

impl Parts {
    fn with<T>(&self, use_it: impl FnOnce(&Calibrated<'_>) -> T) -> T {
        let model = model_of(&self.robot);
        let branch = |k: usize, values: &Values| {
            let correction = self.corrected[k].then(|| {
                Correction::new(self.orders[k], self.boxes[k], &self.coefficients[k])
                    .expect("coefficients that fit")
            });
            Branch::new(&model.with(values).expect("plausible values"), correction)
        };
        use_it(&Calibrated {
            whole: branch(0, &self.whole),
            local: self
                .has_local
                .then(|| (branch(1, &self.local), self.boxes[2])),
            frame: Frame::Sensor,
        })
    }

    /// Where the identified robots say the point is in the frame of the base: the coordinates in which boxes are meant.
    fn identified(&self, joints: &Vector3<f64>) -> [Vector3<f64>; 3] {
        self.with(|c| {
            let now = some_covariates();
            let of = |branch: &Branch<'_>| {
                let point = branch.chain().point(joints, &now, &Vector3::zeros());
                point.expect("in reach")
            };
            let whole = of(&c.whole);
            let local = c.local.as_ref().map_or(whole, |(branch, _)| of(branch));
            let corrected = c.whole.seen(joints, &now);
            let corrected = c.sensor().apply_inverse(&corrected.expect("in reach").0);
            [whole, local, corrected]
        })
    }

    /// Smallest distance of a pose from where a slope or a curvature jumps.
    fn distance_to_edges(&self, joints: &Vector3<f64>) -> f64 {
        let mut nearest = f64::INFINITY;
        for (position, domain) in self.identified(joints).iter().zip(&self.boxes) {
            for k in 0..3 {
                for edge in edges(domain, k) {
                    nearest = nearest.min((position[k] - edge).abs());
                }
            }
        }
        nearest
    }
}

fn edges(domain: &Domain, k: usize) -> [f64; 4] {
    [
        domain.low[k],
        domain.high[k],
        domain.low[k] - domain.fade,
        domain.high[k] + domain.fade,
    ]
}

fn parts() -> impl Strategy<Value = Parts> {
    let flags = (any::<bool>(), any::<bool>(), any::<bool>());
    (robots(), effects(), any::<u64>(), flags).prop_map(
        |(robot, whole, seed, (corrected, corrected_inside, has_local))| {
            let mut random = Random(seed);
            let whole = straight_over_all(&robot, whole);
            // the local model differs by a tenth of what is plausible; both were seen from one place
            let mut local = whole;
            let sizes: Values = plausible(CATALOGUE);
            for (p, value) in local.iter_mut().enumerate() {
                let share = if SENSOR_POSE.contains(&p) { 1e-3 } else { 0.1 };
                *value += share * sizes[p] * random.unit();
            }
            for range in [SENSOR_LINEARITY, SENSOR_SLIP] {
                local[range.clone()].copy_from_slice(&whole[range]);
            }
            let orders = [(); 2]
                .map(|()| [(); 3].map(|()| usize::try_from(random.next() % 4).expect("small")));
            let coefficients = orders.map(|o| {
                (0..coefficients_len(o))
                    .map(|_| std::array::from_fn(|_| 0.2 * random.unit()))
                    .collect()
            });
            let centre = robot.position + model_of(&robot).target_offset;
            let boxes = [60.0, 25.0, 20.0].map(|size| Domain {
                low: centre - Vector3::from_fn(|_, _| size * (1.0 + 0.4 * random.unit())),
                high: centre + Vector3::from_fn(|_, _| size * (1.0 + 0.4 * random.unit())),
                fade: 12.0 + 5.0 * random.unit(),
            });
            Parts {
                robot,
                whole,
                local,
                orders,
                coefficients,
                boxes,
                corrected: [corrected, corrected_inside],
                has_local,
            }
        },
    )
}

/// Joint readings of the calibrated robot near a place of the drawing, shifted by `away`; none beyond reach.
fn joints_near(parts: &Parts, away: &Vector3<f64>) -> Option<Vector3<f64>> {
    let model = model_of(&parts.robot);
    let place = parts.robot.position + model.target_offset + away;
    let place = parts.with(|c| c.sensor().apply(&place));
    let joints = model.with(&parts.whole).ok()?.rough_inverse(&place).ok()?;
    let position = parts
        .with(|c| {
            c.whole
                .chain()
                .value(&joints, &some_covariates(), &Vector3::zeros())
        })
        .ok()?;
    // far from the end of the workspace, where nothing is well conditioned
    ((position - place).norm() < 10.0
        && parts
            .with(|c| c.forward(&joints, &some_covariates()))
            .is_ok_and(|(_, j)| j.norm() < 8.0 && j.determinant().abs() > 0.2))
    .then_some(joints)
}

fn aways(reach: f64) -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(-reach..reach).prop_map(Vector3::from)
}

proptest! {
    #![proptest_config(config())]

    /// An inverse that solves another model than the forward one, or that stops too early: inside a region, in its
    /// blend, in the fade of a correction, beyond both.
    #[test]
    fn forward_and_inverse_undo_each_other(parts in parts(), away in aways(60.0)) {
        let Some(joints) = joints_near(&parts, &away) else { return Ok(()) };
        let now = some_covariates();
        parts.with(|c| {
            let (position, _) = c.forward(&joints, &now).unwrap();
            let back = c.inverse(&position, &now).unwrap();
            let (again, _) = c.forward(&back, &now).unwrap();
            prop_assert!((again - position).norm() < 1e-9, "{}", (again - position).norm());
            prop_assert!((back - joints).amax() < 1e-8, "{}", (back - joints).amax());
            Ok(())
        })?;
    }

    /// A frame that is another one: turned the wrong way, shifted before it is turned, that of the local model, or that of before
    /// a slip; an inverse that is asked in one frame and answers in the other; beams, bends, a slip or a drift of the stand or its warmth
    /// in where the robot is.
    #[test]
    fn both_frames_tell_of_one_place(parts in parts(), away in aways(60.0), before in any::<bool>()) {
        let Some(joints) = joints_near(&parts, &away) else { return Ok(()) };
        let (model, mut now) = (model_of(&parts.robot), some_covariates());
        if before {
            now.time_s = model.sensor_slip_time_s - 1.0;
        }
        // an instrument without errors that has always stood where the other one stands at last
        let mut straight = parts.clone();
        for values in [&mut straight.whole, &mut straight.local] {
            for k in 0..6 {
                values[SENSOR_POSE.start + k] += values[SENSOR_SLIP.start + k];
            }
            for range in [BEAM_ALIGNMENT, SENSOR_LINEARITY, SENSOR_SLIP, SENSOR_DRIFT] {
                values[range].fill(0.0);
            }
        }
        let pose: [f64; 6] = std::array::from_fn(|k| straight.whole[SENSOR_POSE.start + k]);
        let sensor = stand(&model.sensor, &pose);
        let based = parts.with(|c| c.in_frame(Frame::Base).forward(&joints, &now).unwrap());
        straight.with(|c| {
            prop_assert_eq!(c.in_frame(Frame::Base).forward(&joints, &now).unwrap(), based);
            let seen = c.forward(&joints, &now).unwrap();
            prop_assert!((sensor.apply(&based.0) - seen.0).amax() < 1e-11 * (1.0 + seen.0.norm()));
            prop_assert!((sensor.rotation * based.1 - seen.1).amax() < 1e-12 * (1.0 + seen.1.norm()));
            Ok(())
        })?;
        parts.with(|c| {
            for c in [*c, c.in_frame(Frame::Base)] {
                let at = c.forward(&joints, &now).unwrap().0;
                let back = c.inverse(&at, &now).unwrap();
                let (again, _) = c.forward(&back, &now).unwrap();
                prop_assert!((again - at).norm() < 1e-9, "{}", (again - at).norm());
                prop_assert!((back - joints).amax() < 1e-8, "{}", (back - joints).amax());
            }
            Ok(())
        })?;
        // without a correction the robot is where its chain has the point, and is read as the chain has it after the slip
        let mut bare = parts.clone();
        (bare.corrected, bare.has_local) = ([false; 2], false);
        bare.whole[SENSOR_DRIFT].fill(0.0);
        let chain = model.with(&bare.whole).unwrap();
        bare.with(|c| {
            let place = c.in_frame(Frame::Base).forward(&joints, &now).unwrap().0;
            let point = chain.point(&joints, &now, &Vector3::zeros()).unwrap();
            prop_assert!((place - point).amax() < 1e-11 * (1.0 + point.norm()));
            (now.time_s, now.stand_c) = (model.sensor_slip_time_s, REFERENCE_TEMPERATURE_C);
            let read = chain.value(&joints, &now, &Vector3::zeros()).unwrap();
            let found = c.forward(&joints, &now).unwrap().0;
            prop_assert!((found - read).amax() < 1e-11 * (1.0 + read.norm()));
            Ok(())
        })?;
    }

    /// A Jacobian that forgets the correction's slope, the local model's share, or the gradient of that share.
    #[test]
    fn jacobian_is_that_of_the_forward_model(parts in parts(), away in aways(50.0)) {
        let Some(joints) = joints_near(&parts, &away) else { return Ok(()) };
        let h = 0.02;
        prop_assume!(parts.distance_to_edges(&joints) > 0.2);
        parts.with(|c| {
            let at = |q: &Vector3<f64>| c.forward(q, &some_covariates()).unwrap();
            let (_, jacobian) = at(&joints);
            for k in 0..3 {
                let differences = derivative(|h| at(&(joints + Vector3::ith(k, h))).0, h);
                let difference = (jacobian.column(k) - differences).norm();
                prop_assert!(difference < 1e-7, "{difference}");
            }
            Ok(())
        })?;
    }

    /// A step of the model where a box, a fade, a region or a blend begins or ends: the robot would jump.
    #[test]
    fn walking_over_a_border_has_no_jump(
        parts in parts(),
        away in aways(15.0),
        which in 0..3_usize,
        axis in 0..3_usize,
        side in 0..4_usize,
    ) {
        let edge = edges(&parts.boxes[which], axis)[side];
        // a walk along one axis, long enough to cross the edge; found by bisection down to rounding
        let centre = model_of(&parts.robot).target_offset[axis] + parts.robot.position[axis];
        let mut beyond = away;
        beyond[axis] = 1.2 * (edge - centre);
        let (Some(from), Some(to)) = (joints_near(&parts, &away), joints_near(&parts, &beyond)) else {
            return Ok(());
        };
        let place = |s: f64| from + (to - from) * s;
        let past = |s: f64| parts.identified(&place(s))[which][axis] - edge;
        let (mut near, mut far) = (0.0, 1.0);
        prop_assume!(past(near) * past(far) < 0.0);
        let sign = past(far).signum();
        for _ in 0..80 {
            let middle = 0.5 * (near + far);
            if past(middle) * sign > 0.0 { far = middle } else { near = middle }
        }
        parts.with(|c| {
            let at = |s: f64| c.forward(&place(s), &some_covariates()).unwrap();
            let (before, after) = (near - 1e-10, far + 1e-10);
            let jump = (at(after).0 - at(before).0).norm();
            let way = (to - from).norm() * (after - before);
            prop_assert!(jump < 20.0 * way + 1e-11, "{jump} over {way}");
            Ok(())
        })?;
    }

    /// A correction or a local model that reaches farther than its margin, or does not hold in its own region.
    #[test]
    fn models_hold_where_they_should(parts in parts(), away in aways(80.0)) {
        let Some(joints) = joints_near(&parts, &away) else { return Ok(()) };
        let now = some_covariates();
        parts.with(|c| {
            let based = |(x, by_joints): (Vector3<f64>, Matrix3<f64>)| {
                (c.sensor().apply_inverse(&x), c.sensor().rotation.transpose() * by_joints)
            };
            let all = c.in_frame(Frame::Base).forward(&joints, &now).unwrap();
            let whole = based(c.whole.seen(&joints, &now).unwrap());
            let Some((local, region)) = &c.local else {
                prop_assert_eq!(all, whole);
                return Ok(());
            };
            let inner = based(local.seen(&joints, &now).unwrap());
            let at = whole.0;
            let beyond = |k: usize| (region.low[k] - at[k]).max(at[k] - region.high[k]);
            let farthest = (0..3).map(beyond).fold(f64::NEG_INFINITY, f64::max);
            if farthest <= 0.0 {
                prop_assert!((all.0 - inner.0).amax() < 1e-11 && (all.1 - inner.1).amax() < 1e-11);
            } else if farthest >= region.fade {
                prop_assert_eq!(all, whole);
            } else {
                // in between: no farther from either than they are from each other
                let apart = (inner.0 - whole.0).norm() + 1e-12;
                prop_assert!((all.0 - inner.0).norm() <= apart && (all.0 - whole.0).norm() <= apart);
            }
            Ok(())
        })?;
    }

    /// A panic or a number from input that is none; an inverse that claims to reach what it does not.
    #[test]
    fn any_bits_are_answered(
        parts in parts(),
        bits in prop::array::uniform3(prop_oneof![prop::num::f64::ANY, -2000.0..2000.0_f64]),
    ) {
        let (input, now) = (Vector3::from(bits), some_covariates());
        for frame in [Frame::Sensor, Frame::Base] {
            parts.with(|c| {
            let c = c.in_frame(frame);
            let (forward, inverse) = (c.forward(&input, &now), c.inverse(&input, &now));
            if input.iter().any(|v| !v.is_finite()) {
                prop_assert!(forward.is_err() && inverse.is_err());
                let refused = matches!(inverse, Err(Error::NotFinite { .. }));
                prop_assert!(refused || !input.iter().any(|v| v.is_nan()));
            }
            if let Ok((position, _)) = forward {
                prop_assert!(position.iter().all(|v| v.is_finite()));
            }
            if let Ok(joints) = inverse {
                let (position, _) = c.forward(&joints, &now).unwrap();
                prop_assert!((position - input).norm() < 1e-9);
            }
            Ok(())
            })?;
        }
    }
}

/// A robot without effects, correction or region that is not the identified robot.
#[test]
fn a_bare_calibration_is_the_identified_robot() {
    let robot = drawn();
    let chain = model_of(&robot).with(&[0.0; PARAMETERS]).unwrap();
    let bare = Calibrated {
        whole: Branch::new(&chain, None),
        local: None,
        frame: Frame::Sensor,
    };
    let now = some_covariates();
    let joints = Vector3::new(200.0, 210.0, 190.0);
    let (position, by_joints) = bare.forward(&joints, &now).unwrap();
    let predicted = chain
        .predict(&joints, &now, &Vector3::zeros(), Wanted::default())
        .unwrap();
    assert_eq!(
        (position, by_joints),
        (predicted.value, predicted.by_joints)
    );
    let far = Vector3::new(5000.0, 0.0, 0.0);
    assert!(matches!(
        bare.inverse(&far, &now),
        Err(Error::OutOfReach { .. })
    ));
}
