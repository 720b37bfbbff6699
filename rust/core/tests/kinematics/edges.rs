//! What lies at the edge of reach or beyond it: numbers that are none, strays, singular rods.

use super::*;

proptest! {
    #![proptest_config(config())]

    /// A number that is not finite and gets through, or is refused under the wrong index; an overflow that
    /// comes out as a result; any panic.
    #[test]
    fn any_bits_are_answered_finitely(robot in robots(), input in any_vector()) {
        let k = kinematics(&robot.geometry);
        for result in [k.forward(&input), k.inverse(&input), k.pose(&input).map(|p| p.position)] {
            match (first_not_finite(&input), result) {
                (Some(index), result) => prop_assert_eq!(result, Err(Error::NotFinite { index })),
                (None, Ok(out)) => prop_assert!(all_finite(&out), "{out:?}"),
                (None, Err(error)) => prop_assert!(!error.to_string().contains("NaN"), "{error}"),
            }
        }
        if let Ok(pose) = k.pose(&input) {
            prop_assert!(pose.by_joints().iter().all(|d| d.is_finite()));
            let by_parameters: SMatrix<f64, 3, GEOMETRIC> = k.by_parameters(&pose);
            prop_assert!(by_parameters.iter().all(|d| d.is_finite()));
        }
    }

    /// A geometry of arbitrary bits that is taken for a robot where it is none, refused where it is one, or that
    /// panics; and, as long as squares of its lengths neither overflow nor vanish, a result that is not finite.
    #[test]
    fn any_geometry_is_answered_finitely(
        parameters in prop::array::uniform(any_number()),
        equal_rods in any::<bool>(),
        above in any::<bool>(),
        wild in any::<bool>(),
        input in any_vector(),
    ) {
        let mut parameters: [f64; GEOMETRIC] = parameters;
        if equal_rods {
            parameters[9] = parameters[3];
            parameters[15] = parameters[3];
        }
        let bounded = |p: f64| p == 0.0 || (1e-6..1e9).contains(&p.abs()) || !p.is_finite();
        if !wild {
            for p in &mut parameters {
                *p = if bounded(*p) { *p } else { p.abs().log10() + 400.0 };
            }
        }
        let assembly = if above { Assembly::Above } else { Assembly::Below };
        let geometry = Geometry::from_parameters(&parameters, assembly);
        let valid = parameters.iter().all(|p| p.is_finite()) && [3, 9, 15].iter().all(|&k| parameters[k] > 0.0);
        let Ok(k) = Kinematics::new(&geometry) else {
            prop_assert!(!valid);
            return Ok(());
        };
        prop_assert!(valid);
        for result in [k.forward(&input), k.inverse(&input), k.pose(&input).map(|p| p.position)] {
            match (first_not_finite(&input), result) {
                (Some(index), result) => prop_assert_eq!(result, Err(Error::NotFinite { index })),
                (None, Ok(out)) => prop_assert!(wild || all_finite(&out), "{out:?}"),
                (None, Err(_)) => {}
            }
        }
    }

    /// One wrong joint reading, the usual cause: the report must be exact and must blame that limb. Catches a
    /// distance to the wrong circle, too-long taken for too-short, a wrong limb.
    #[test]
    fn a_stray_joint_is_named_with_its_exact_miss(
        robot in robots(),
        limb in 0..LIMBS,
        stray in 1.0..6.0_f64,
        up in any::<bool>(),
    ) {
        // bring the three carriages to one height first, so that the stray one is the culprit without doubt
        let mut geometry = robot.geometry;
        for l in &mut geometry.limbs {
            l.joint_offset_mm = 0.0;
        }
        let mut joints = Vector3::zeros();
        let rod = geometry.limbs[limb].rod_length_mm;
        joints[limb] = if up { stray * rod } else { -stray * rod };
        match kinematics(&geometry).forward(&joints) {
            Err(Error::OutOfReach { limb: found, miss_mm }) => {
                prop_assert_eq!(found, limb);
                prop_assert!(miss_mm > 0.0);
                check_miss(&geometry, &joints, limb, miss_mm)?;
            }
            Err(Error::LimbReversed { .. }) | Ok(_) => {}
            other => prop_assert!(false, "{other:?}"),
        }
    }

    /// Any joints at all: where the other two rods meet each other, the named limb's miss is exact; where they
    /// do not, following the reports one after another still ends in a robot that closes.
    #[test]
    fn following_the_reports_closes_the_robot(
        robot in robots(),
        moves in prop::array::uniform3(-1500.0..1500.0_f64),
        lengths in prop::array::uniform3(-0.6..0.6_f64),
    ) {
        let joints = robot.joints + Vector3::from(moves);
        let mut geometry = robot.geometry;
        for (l, change) in geometry.limbs.iter_mut().zip(lengths) {
            l.rod_length_mm *= 1.0 + change;
        }
        for _ in 0..4 {
            let Err(Error::OutOfReach { limb, miss_mm }) = kinematics(&geometry).forward(&joints) else {
                return Ok(());
            };
            let (k, i, j) = farthest_stray(&geometry, &joints);
            if gap(&geometry, &joints, i, j) == 0.0 {
                prop_assert_eq!(limb, k);
                check_miss(&geometry, &joints, limb, miss_mm)?;
            } else {
                // the two others miss each other: the report closes the gap between them and no more
                let closed = with_rod(&geometry, limb, miss_mm + 1e-6_f64.copysign(miss_mm));
                prop_assert!(closed.limbs[limb].rod_length_mm > 0.0, "limb {limb} has no rod left: {miss_mm}");
                prop_assert!(gap(&closed, &joints, i, j).abs() < 1e-9);
            }
            geometry = with_rod(&geometry, limb, miss_mm + 1e-6_f64.copysign(miss_mm));
        }
        prop_assert!(!is_out_of_reach(&kinematics(&geometry).forward(&joints)));
    }

    /// At the very edge of reach the miss is a rounding error and must be reported as one, not as the distance
    /// to the far side of the circle.
    #[test]
    fn the_miss_vanishes_at_the_edge(robot in robots(), limb in 0..LIMBS, up in any::<bool>(), ulps in 0_u64..40) {
        let k = kinematics(&robot.geometry);
        let at = |move_mm: f64| {
            let mut q = robot.joints;
            q[limb] += if up { move_mm } else { -move_mm };
            q
        };
        let (mut near, mut far) = (0.0, 4.0 * robot.geometry.limbs[limb].rod_length_mm);
        prop_assert!(is_out_of_reach(&k.forward(&at(far))));
        for _ in 0..200 {
            let middle: f64 = 0.5 * (near + far);
            if is_out_of_reach(&k.forward(&at(middle))) { far = middle } else { near = middle }
        }
        let beyond = f64::from_bits(far.to_bits() + ulps);
        if let Err(Error::OutOfReach { limb: found, miss_mm }) = k.forward(&at(beyond)) {
            prop_assert!(miss_mm.abs() < 1e-6, "limb {found}: {miss_mm}");
        }
    }

    /// A wrong distance in the inverse's report, or the wrong limb in it.
    #[test]
    fn the_inverse_names_the_first_short_rod(robot in robots(), away in prop::array::uniform3(-2000.0..2000.0_f64)) {
        let position = robot.position + Vector3::from(away);
        let short = |geometry: &Geometry, i: usize| {
            let d = position - anchor(&geometry.limbs[i]);
            d.x.hypot(d.y) - geometry.limbs[i].rod_length_mm
        };
        match kinematics(&robot.geometry).inverse(&position) {
            Ok(_) => prop_assert!((0..LIMBS).all(|i| short(&robot.geometry, i) <= 1e-9)),
            Err(Error::OutOfReach { limb, miss_mm }) => {
                prop_assert!((miss_mm - short(&robot.geometry, limb)).abs() < 1e-6);
                prop_assert!((0..limb).all(|i| short(&robot.geometry, i) <= 1e-9));
                let enough = with_rod(&robot.geometry, limb, miss_mm + 1e-6);
                match kinematics(&enough).inverse(&position) {
                    Err(Error::OutOfReach { limb: next, .. }) => prop_assert!(next > limb),
                    other => prop_assert!(other.is_ok()),
                }
            }
            other => prop_assert!(false, "{other:?}"),
        }
    }

    /// Derivatives of a pose whose rods lie in one plane: huge numbers instead of a refusal.
    #[test]
    fn coplanar_rods_are_singular(robot in robots(), height in -500.0..500.0_f64) {
        let mut geometry = robot.geometry;
        let centre = Vector3::new(robot.position.x, robot.position.y, 0.0);
        let mut joints = Vector3::repeat(height);
        for (i, l) in geometry.limbs.iter_mut().enumerate() {
            l.joint_offset_mm = 0.0;
            // longer by a hair, so that rounding does not put the pose out of reach
            l.rod_length_mm = (anchor(l) - centre).norm() * (1.0 + 1e-15);
            joints[i] = height;
        }
        match kinematics(&geometry).pose(&joints) {
            Err(Error::Singular | Error::OutOfReach { .. } | Error::LimbReversed { .. }) => {}
            // rounding may leave the plane by the square root of the precision, which is no singularity yet
            Ok(pose) => {
                let [a, b, c] = rods(&geometry, &pose.position, &joints).map(|r| r.normalize());
                prop_assert!(a.cross(&b).dot(&c).abs() > 1e-9);
                prop_assert!(pose.by_joints().iter().all(|d| d.is_finite()));
            }
            other => prop_assert!(false, "{other:?}"),
        }
    }

    /// Carriages on one line: a division by zero instead of a refusal.
    #[test]
    fn rails_on_one_line_are_singular(robot in robots(), spread in prop::array::uniform3(0.0..100.0_f64)) {
        let mut geometry = robot.geometry;
        for (l, spread) in geometry.limbs.iter_mut().zip(spread) {
            *l = Limb { base_angle_rad: 0.0, platform_angle_rad: 0.0, base_radius_mm: l.platform_radius_mm + spread, ..*l };
            l.joint_offset_mm = 0.0;
        }
        let k = kinematics(&geometry);
        prop_assert_eq!(k.forward(&Vector3::zeros()), Err(Error::Singular));
        prop_assert_eq!(k.forward_lanes([0.0; 3]).1, 0.0);
    }
}

/// A geometry with a NaN, an infinity or no rod that passes the check, or the wrong limb in the refusal.
#[test]
fn a_geometry_that_is_no_robot_is_refused() {
    let geometry = drawing();
    for k in 0..GEOMETRIC {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut p = geometry.parameters();
            p[k] = bad;
            let found = Kinematics::new(&Geometry::from_parameters(&p, Assembly::Below));
            assert!(
                matches!(found, Err(Error::InvalidGeometry { limb, .. }) if limb == k / PER_LIMB)
            );
        }
    }
    for limb in 0..LIMBS {
        for length in [0.0, -0.0, -1.0] {
            let mut g = geometry;
            g.limbs[limb].rod_length_mm = length;
            assert!(
                matches!(Kinematics::new(&g), Err(Error::InvalidGeometry { limb: l, .. }) if l == limb)
            );
        }
    }
}
