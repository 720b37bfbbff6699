//! Spherical kinematics: against the paper's closed forms, both ways, with exact derivatives.

mod common;

use common::closed_form;
use common::{config, derivative};
use nalgebra::{Vector2, Vector3};
use proptest::prelude::*;
use sherkit_core::numbers::math::Lanes;
use sherkit_core::numbers::trig::{self, LARGEST_RAD};
use sherkit_core::spherical::{Assembly, Elbows, GEOMETRIC, Geometry, Kinematics, Limb};
use sherkit_core::{Error, Singularity};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// Limbs that differ by a little, in either assembly.
fn geometries() -> impl Strategy<Value = Geometry> {
    let arc = || 0.5..1.2_f64;
    let little = || prop::array::uniform3(-0.03..0.03_f64);
    (arc(), arc(), little(), little(), any::<bool>()).prop_map(|(alpha, beta, a, b, outer)| {
        let limb = |d: [f64; 3]| Limb {
            alpha_rad: alpha + d[0],
            beta_rad: beta + d[1],
            offset_rad: 10.0 * d[2],
        };
        let assembly = if outer {
            Assembly::Outer
        } else {
            Assembly::Inner
        };
        Geometry {
            limbs: [limb(a), limb(b)],
            assembly,
        }
    })
}

/// Joints well inside: elbows apart, cones that cross at a fair angle, tool axis off the actuated one.
fn inside(geometry: &Geometry, joints: &Vector2<f64>) -> Option<(Kinematics, Vector2<f64>)> {
    let k = Kinematics::new(geometry).unwrap();
    let pose = k.pose(joints).ok()?;
    let volume = pose.axis.dot(&pose.elbows[0].cross(&pose.elbows[1]));
    let off = pose.axis.xy().norm();
    (volume.abs() > 0.05 && off > 0.1).then(|| (k, k.forward(joints).unwrap()))
}

fn joints() -> impl Strategy<Value = Vector2<f64>> {
    (-4.0..4.0_f64, 0.3..1.4_f64, any::<bool>()).prop_map(|(mean, half, crossed)| {
        let half = if crossed { -half } else { half };
        Vector2::new(mean + half, mean - half)
    })
}

proptest! {
    #![proptest_config(config())]

    /// A sine, cosine or arc tangent with a wrong coefficient, quadrant or sign.
    #[test]
    fn branchless_functions_are_exact(x in -1e6..1e6_f64, near in -8.0..8.0_f64, y in -8.0..8.0_f64) {
        for x in [x, near] {
            let ((s, c), (ls, lc)) = (trig::sin_cos(x), libm::sincos(x));
            prop_assert!((s - ls).abs() <= 2.3e-16 && (c - lc).abs() <= 2.3e-16, "{x}: {s} {ls} {c} {lc}");
        }
        let (found, expected) = (trig::atan2(y, near), libm::atan2(y, near));
        prop_assert!((found - expected).abs() <= 4.5e-16 * (1.0 + expected.abs()), "{y} {near}: {found} {expected}");
    }

    /// The cones' meeting point on the wrong branch, turned, or mirrored: equal limbs must give Eqs. 34 and 35 for
    /// both signs of the root, crossed limbs and γ beyond the actuated axis.
    #[test]
    fn equal_limbs_give_the_closed_forms(alpha in 0.4..1.3_f64, beta in 0.4..1.3_f64, joints in joints(), outer in any::<bool>()) {
        let assembly = if outer { Assembly::Outer } else { Assembly::Inner };
        let geometry = Geometry { assembly, ..Geometry::equal(alpha, beta) };
        if let Some((k, found)) = inside(&geometry, &joints) {
            let [phi, gamma] = closed_form::forward(alpha, beta, assembly, joints.into()).unwrap();
            prop_assert!((found.x - phi).abs() < 1e-12, "phi {} {phi}", found.x);
            prop_assert!((found.y - gamma).abs() < 1e-12, "gamma {} {gamma}", found.y);
            let elbows = if joints.x > joints.y { Elbows::Open } else { Elbows::Crossed };
            // arccos loses digits where a limb is nearly stretched
            let back = k.inverse(&found, elbows).unwrap();
            let steep = (0.5 * (joints.x - joints.y)).sin().abs() * gamma.sin().abs();
            prop_assert!((back - joints).amax() < 1e-13 / steep.powi(2));
            if gamma > 0.0 && joints.x > joints.y {
                let closed = closed_form::inverse(alpha, beta, [phi, gamma]).unwrap();
                prop_assert!((Vector2::from(closed) - joints).amax() < 1e-13 / steep.powi(2));
            }
        }
    }

    /// A tool axis that is not on both cones, angles that do not belong to it, an inverse that is not the forward's,
    /// or a lane that differs from the single pose.
    #[test]
    fn inverse_undoes_forward(geometry in geometries(), joints in joints()) {
        let Some((k, angles)) = inside(&geometry, &joints) else { return Ok(()) };
        let pose = k.pose(&joints).unwrap();
        for (limb, elbow) in geometry.limbs.iter().zip(&pose.elbows) {
            prop_assert!((pose.axis.dot(elbow) - limb.beta_rad.cos()).abs() < 1e-14);
            prop_assert!((elbow.z - limb.alpha_rad.cos()).abs() < 1e-14);
        }
        let ((sp, cp), (sg, cg)) = (angles.x.sin_cos(), angles.y.sin_cos());
        prop_assert!((pose.axis - Vector3::new(sg * cp, sg * sp, cg)).amax() < 1e-14);
        let signs: Vec<f64> = (0..2)
            .map(|i| (joints[i] + geometry.limbs[i].offset_rad - angles.x).sin().signum())
            .collect();
        let elbows = match (signs[0] > 0.0, signs[1] > 0.0) {
            (true, false) => Elbows::Open,
            (false, true) => Elbows::Crossed,
            (true, true) => Elbows::Ahead,
            (false, false) => Elbows::Behind,
        };
        let back = k.inverse(&angles, elbows);
        if let Ok(back) = back {
            let turns = (back - joints) / (2.0 * PI);
            let steep = pose.joints_by_angles().unwrap().amax();
            prop_assert!((turns - turns.map(f64::round)).amax() < 1e-12 * (1.0 + steep), "{turns}");
        } else if angles.y > 0.0 {
            prop_assert!(false, "{back:?}");
        }
        let (many, reached) = k.forward_lanes([Lanes([joints.x, f64::NAN]), Lanes([joints.y, 0.0])]);
        prop_assert_eq!(reached.0, [1.0, 0.0]);
        prop_assert_eq!(many.map(|v| v.0[0]), [angles.x, angles.y]);
        let (many, reached) = k.inverse_lanes([Lanes([angles.x, 0.0]), Lanes([angles.y, f64::NAN])], elbows);
        prop_assert_eq!(reached.0, [f64::from(back.is_ok()), 0.0]);
        if let Ok(back) = back {
            prop_assert_eq!(many.map(|v| v.0[0]), [back.x, back.y]);
        }
    }

    /// A derivative with a wrong sign or a forgotten term, forward or inverse.
    #[test]
    fn derivatives_are_exact(geometry in geometries(), joints in joints()) {
        let Some((k, angles)) = inside(&geometry, &joints) else { return Ok(()) };
        let pose = k.pose(&joints).unwrap();
        let steep = pose.by_joints().amax() + pose.by_parameters().amax();
        let stretched = pose.joints_by_angles().unwrap().amax();
        // a quarter turn from the mean of the elbows γ changes sign and φ jumps by half a turn
        let [a, b] = &geometry.limbs;
        let mean = 0.5 * (joints.x + joints.y + a.offset_rad + b.offset_rad);
        prop_assume!(steep < 20.0 && stretched < 20.0 && (angles.x - mean).abs() < 1.3);
        for i in 0..2 {
            let found = derivative(|h| k.forward(&(joints + Vector2::ith(i, h))).unwrap(), 1e-4);
            prop_assert!((pose.by_joints().column(i) - found).amax() < 1e-7 * steep.powi(3));
        }
        let p = geometry.parameters();
        for i in 0..GEOMETRIC {
            let at = |h: f64| {
                let mut p = p;
                p[i] += h;
                Kinematics::new(&Geometry::from_parameters(&p, geometry.assembly)).unwrap()
            };
            let found = derivative(|h| at(h).forward(&joints).unwrap(), 1e-4);
            prop_assert!((pose.by_parameters().column(i) - found).amax() < 1e-7 * steep.powi(3), "{i}: {} {found} mean {mean} at {angles}", pose.by_parameters().column(i));
        }
        // the inverse's derivatives are those of the implicit function
        let product = pose.joints_by_angles().unwrap() * pose.by_joints();
        prop_assert!((product - nalgebra::Matrix2::identity()).amax() < 1e-11 * steep * stretched);
        let own = pose.joints_by_angles().unwrap() * pose.by_parameters() + pose.joints_by_parameters().unwrap();
        prop_assert!(own.amax() < 1e-11 * steep * stretched, "{own} at {angles}");
    }

    /// Joints of any bits that panic or give angles that are not finite.
    #[test]
    fn any_bits_are_answered_finitely(geometry in geometries(), bits in prop::array::uniform2(prop_oneof![-10.0..10.0_f64, prop::num::f64::ANY])) {
        let (k, v) = (Kinematics::new(&geometry).unwrap(), Vector2::from(bits));
        // beyond what the lanes reduce they leave it to the single pose
        let far = (bits[0] - bits[1]).abs() > LARGEST_RAD || bits[1].abs() > LARGEST_RAD;
        let forward = k.forward(&v);
        prop_assert!(far || f64::from(forward.is_ok()) == k.forward_lanes(bits).1);
        for elbows in [Elbows::Open, Elbows::Crossed, Elbows::Ahead, Elbows::Behind] {
            let inverse = k.inverse(&v, elbows);
            prop_assert!(far || f64::from(inverse.is_ok()) == k.inverse_lanes(bits, elbows).1);
            for found in [forward, inverse].into_iter().flatten() {
                prop_assert!(found.iter().all(|c| c.is_finite()));
            }
        }
        if let Ok(pose) = k.pose(&v) {
            prop_assert!(pose.axis_by_parameters().iter().all(|c| c.is_finite()));
        }
    }
}

/// The paper's robot put together wrongly: figures worked out by hand for α = β = π/4.
#[test]
fn the_papers_robot_stands_where_the_cosine_rule_says() {
    let k = Kinematics::new(&Geometry::equal(FRAC_PI_4, FRAC_PI_4)).unwrap();
    // elbows a right angle of azimuth apart: tan(γ/2) = tan α cos A = √½
    let found = k
        .forward(&Vector2::new(FRAC_PI_2 + FRAC_PI_4, FRAC_PI_2 - FRAC_PI_4))
        .unwrap();
    assert!((found.x - FRAC_PI_2).abs() < 1e-15);
    assert!((found.y - 2.0 * 0.5_f64.sqrt().atan()).abs() < 1e-15);
}

/// A pose that does not exist or has no answer and is answered, or blamed on the wrong cause.
#[test]
fn singular_and_unreachable_poses_say_which() {
    let k = Kinematics::new(&Geometry::equal(0.9, 0.6)).unwrap();
    let at = |a: f64| Vector2::new(1.0 + a, 1.0 - a);
    let which = |r: Result<Vector2<f64>, Error>| match r {
        Err(Error::SingularPose(s)) => Some(s),
        _ => None,
    };
    assert_eq!(which(k.forward(&at(0.0))), Some(Singularity::ElbowsAligned));
    // sin α sin A = sin β: the cones touch
    let touch = (0.6_f64.sin() / 0.9_f64.sin()).asin();
    let miss = |a| match k.forward(&at(a)) {
        Err(Error::LimbsApart { miss_rad }) => miss_rad,
        other => panic!("{other:?}"),
    };
    let between = 2.0 * (0.9_f64.sin() * (touch + 0.1).sin()).asin();
    assert!((miss(touch + 0.1) - (between - 1.2)).abs() < 1e-12);
    assert!(k.forward(&at(touch - 1e-9)).is_ok());
    let touching = k.pose(&at(touch - 1e-15)).err();
    assert_eq!(touching, Some(Error::SingularPose(Singularity::ConesTouch)));
    // α = β: with the elbows opposite the tool axis comes to lie on the actuated axis
    let even = Kinematics::new(&Geometry::equal(0.8, 0.8)).unwrap();
    let inner = Kinematics::new(&Geometry {
        assembly: Assembly::Inner,
        ..Geometry::equal(0.8, 0.8)
    })
    .unwrap();
    assert_eq!(which(inner.forward(&at(0.5))), Some(Singularity::Pole));
    assert!(inner.pose(&at(0.5)).unwrap().axis.z > 1.0 - 1e-15);
    assert_eq!(
        which(even.inverse(&Vector2::new(0.3, 0.0), Elbows::Open)),
        Some(Singularity::Pole)
    );
    // γ beyond α + β and short of α - β
    for (gamma, expected) in [(1.6, 0.1), (0.2, -0.1)] {
        match k.inverse(&Vector2::new(0.0, gamma), Elbows::Open) {
            Err(Error::AxisOutOfReach { limb: 0, miss_rad }) => {
                assert!((miss_rad - expected).abs() < 1e-12);
            }
            other => panic!("{other:?}"),
        }
    }
    // a pose of the inner assembly
    assert_eq!(
        k.inverse(&Vector2::new(0.0, 0.4), Elbows::Open),
        Err(Error::OtherAssembly)
    );
    // a stretched limb has no inverse derivative
    let inverse = k
        .inverse(&Vector2::new(0.0, 1.5 - 1e-13), Elbows::Open)
        .unwrap();
    assert!(inverse.amax() < 1e-5);
    for bad in [f64::NAN, f64::INFINITY] {
        assert_eq!(
            k.forward(&Vector2::new(0.0, bad)),
            Err(Error::NotFinite { index: 1 })
        );
        assert_eq!(
            k.inverse(&Vector2::new(bad, 1.0), Elbows::Open),
            Err(Error::NotFinite { index: 0 })
        );
    }
    for bad in [0.0, PI, -0.1, f64::NAN] {
        assert!(matches!(
            Kinematics::new(&Geometry::equal(bad, 0.8)),
            Err(Error::InvalidGeometry { limb: 0, .. })
        ));
        assert!(Kinematics::new(&Geometry::equal(0.8, bad)).is_err());
    }
}
