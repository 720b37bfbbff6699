//! Forward and inverse kinematics, their derivatives and their refusals, on random robots.

mod common;

use common::{anchor, config, derivative, drawing, joints_at, robots, rods};
use nalgebra::{Complex, Matrix3, SMatrix, Vector3};
use proptest::prelude::*;
use sherkit_core::Error;
use sherkit_core::delta::{Assembly, GEOMETRIC, Geometry, Kinematics, LIMBS, Limb, PER_LIMB};
use sherkit_core::numbers::{math::Lanes, wide::Wide};

fn kinematics(geometry: &Geometry) -> Kinematics {
    Kinematics::new(geometry).expect("a valid geometry")
}

/// Step for differences: a parameter's own unit, about a millimetre of movement either way.
fn step_of(parameter: usize) -> f64 {
    match parameter % PER_LIMB {
        1 | 5 => 1e-3,
        _ => 0.2,
    }
}

fn with_parameter(geometry: &Geometry, k: usize, change: f64) -> Geometry {
    let mut p = geometry.parameters();
    p[k] += change;
    Geometry::from_parameters(&p, geometry.assembly)
}

/// Position for 18 parameters and three joints in complex numbers, by Newton on `|x - s_i|² = l_i²` itself:
/// no trilateration, no sign choice, nothing shared with the crate. `start` is the real solution.
fn complex_forward(
    parameters: &[Complex<f64>; GEOMETRIC],
    joints: &[Complex<f64>; LIMBS],
    start: &Vector3<f64>,
) -> Vector3<Complex<f64>> {
    // cosine and sine of a + ih for an h whose square vanishes
    let cos_sin = |z: Complex<f64>| {
        let (s, c) = z.re.sin_cos();
        (Complex::new(c, -s * z.im), Complex::new(s, c * z.im))
    };
    let mut x = start.map(Complex::from);
    for _ in 0..6 {
        let mut a = Matrix3::zeros();
        let mut miss = Vector3::zeros();
        for i in 0..LIMBS {
            let p = &parameters[i * PER_LIMB..];
            let ((cb, sb), (cp, sp)) = (cos_sin(p[1]), cos_sin(p[5]));
            let s = Vector3::new(
                p[0] * cb - p[4] * cp,
                p[0] * sb - p[4] * sp,
                p[2] + joints[i],
            );
            let rod = x - s;
            // the bilinear product, without conjugation
            let squared = rod.x * rod.x + rod.y * rod.y + rod.z * rod.z;
            a.set_row(i, &(rod * Complex::from(2.0)).transpose());
            miss[i] = p[3] * p[3] - squared;
        }
        x += a.lu().solve(&miss).expect("far from singular");
    }
    x
}

/// Any finite or infinite number and any NaN, often near the workspace and often far beyond it.
fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        prop::num::f64::ANY,
        any::<u64>().prop_map(f64::from_bits),
        -1000.0..1000.0_f64,
        (-308.0..308.0_f64, any::<bool>()).prop_map(|(e, negative)| {
            let x = 10.0_f64.powf(e);
            if negative { -x } else { x }
        }),
    ]
}

fn any_vector() -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(any_number()).prop_map(Vector3::from)
}

fn all_finite(v: &Vector3<f64>) -> bool {
    v.iter().all(|c| c.is_finite())
}

fn first_not_finite(v: &Vector3<f64>) -> Option<usize> {
    v.iter().position(|c| !c.is_finite())
}

fn bits(v: &Vector3<f64>) -> [u64; 3] {
    [v.x, v.y, v.z].map(f64::to_bits)
}

fn is_out_of_reach<T>(r: &sherkit_core::Result<T>) -> bool {
    matches!(r, Err(Error::OutOfReach { .. }))
}

fn with_rod(geometry: &Geometry, limb: usize, change_mm: f64) -> Geometry {
    with_parameter(geometry, limb * PER_LIMB + 3, change_mm)
}

/// A miss must be exact: a micrometre-thousandth more in its direction and the rods meet, as much less and
/// they do not.
fn check_miss(
    geometry: &Geometry,
    joints: &Vector3<f64>,
    limb: usize,
    miss_mm: f64,
) -> Result<(), TestCaseError> {
    let slack = 1e-6_f64.copysign(miss_mm);
    let enough = with_rod(geometry, limb, miss_mm + slack);
    let scant = with_rod(geometry, limb, miss_mm - slack);
    prop_assert!(
        enough.limbs[limb].rod_length_mm > 0.0,
        "no rod left: {miss_mm}"
    );
    prop_assert!(!is_out_of_reach(&kinematics(&enough).forward(joints)));
    prop_assert!(is_out_of_reach(&kinematics(&scant).forward(joints)));
    Ok(())
}

/// Limb whose joint stands farthest from the middle of the other two, the one that a report names first.
fn farthest_stray(geometry: &Geometry, joints: &Vector3<f64>) -> (usize, usize, usize) {
    let z: [f64; 3] = std::array::from_fn(|i| anchor(&geometry.limbs[i]).z + joints[i]);
    let stray = |k: usize| (z[k] - 0.5 * (z[(k + 1) % 3] + z[(k + 2) % 3])).abs();
    let k = (0..3)
        .max_by(|&a, &b| stray(a).total_cmp(&stray(b)))
        .expect("three");
    (k, (k + 1) % 3, (k + 2) % 3)
}

/// How far the spheres of two limbs are from touching: positive apart, negative one inside the other.
fn gap(geometry: &Geometry, joints: &Vector3<f64>, i: usize, j: usize) -> f64 {
    let s = |i: usize| anchor(&geometry.limbs[i]) + Vector3::z() * joints[i];
    let between = (s(i) - s(j)).norm();
    let (a, b) = (
        geometry.limbs[i].rod_length_mm,
        geometry.limbs[j].rod_length_mm,
    );
    if between > a + b {
        between - a - b
    } else {
        (between - (a - b).abs()).min(0.0)
    }
}

proptest! {
    #![proptest_config(config())]

    /// A wrong sign, a swapped index or the other solution of the quadratic in either direction: both are
    /// compared with Pythagoras on the drawing, and with each other, to 1e-9 mm.
    #[test]
    fn forward_and_inverse_undo_each_other(robot in robots()) {
        let k = kinematics(&robot.geometry);
        let joints = k.inverse(&robot.position).unwrap();
        prop_assert!((joints - robot.joints).amax() < 1e-9);
        let position = k.forward(&robot.joints).unwrap();
        prop_assert!((position - robot.position).amax() < 1e-9, "{}", (position - robot.position).amax());
        prop_assert!((k.forward(&joints).unwrap() - robot.position).amax() < 1e-9);
        prop_assert!((k.inverse(&position).unwrap() - robot.joints).amax() < 1e-9);
        prop_assert_eq!(bits(&k.pose(&robot.joints).unwrap().position), bits(&position));
    }

    /// An accepted position that is no solution: wherever the joints stand, an Ok lies on all three spheres
    /// with every carriage on the side that the assembly mode says.
    #[test]
    fn an_accepted_position_fulfils_the_constraints(
        robot in robots(),
        moves in prop::array::uniform3(-400.0..400.0_f64),
    ) {
        let joints = robot.joints + Vector3::from(moves);
        if let Ok(position) = kinematics(&robot.geometry).forward(&joints) {
            for (rod, limb) in rods(&robot.geometry, &position, &joints).iter().zip(&robot.geometry.limbs) {
                prop_assert!((rod.norm() - limb.rod_length_mm).abs() < 1e-9, "{}", rod.norm() - limb.rod_length_mm);
                prop_assert!(rod.z * robot.geometry.assembly.sign() <= 1e-9);
            }
        }
    }

    /// A limb folded through the horizontal that is accepted, named wrongly, or reported with a wrong distance.
    /// The spheres meet at the robot's position and at its mirror image in the plane of the carriages.
    #[test]
    fn a_reversed_limb_is_named(robot in robots(), folded in prop::array::uniform3(any::<bool>())) {
        let sign = robot.geometry.assembly.sign();
        let sides = folded.map(|f| if f { -sign } else { sign });
        let joints = joints_at(&robot.geometry, &robot.position, sides).unwrap();
        let away = rods(&robot.geometry, &robot.position, &joints);
        let normal = (away[1] - away[0]).cross(&(away[2] - away[0])).normalize();
        let height = away[0].dot(&normal);
        // the side of the plane that the assembly mode says, whichever way the normal points
        let wanted = -sign * normal.z.signum();
        let image = if height * wanted > 0.0 { Vector3::zeros() } else { normal * (-2.0 * height) };
        let beyond = away.map(|rod| sign * (rod + image).z);
        prop_assume!(height.abs() > 1.0 && beyond.iter().all(|b| b.abs() > 1e-6));
        match (beyond.iter().position(|b| *b > 0.0), kinematics(&robot.geometry).forward(&joints)) {
            (None, Ok(position)) => prop_assert!((position - robot.position - image).amax() < 1e-8),
            (Some(limb), Err(Error::LimbReversed { limb: found, beyond_mm })) => {
                prop_assert_eq!(found, limb);
                prop_assert!((beyond_mm - beyond[limb]).abs() < 1e-8, "{}", beyond_mm - beyond[limb]);
            }
            other => prop_assert!(false, "{other:?}"),
        }
    }

    /// A wrong entry in the Jacobian by the joints: compared with differences to 1e-7 and with the complex
    /// step through the constraints themselves to 1e-10.
    #[test]
    fn derivative_by_joints_is_exact(robot in robots()) {
        let k = kinematics(&robot.geometry);
        let by_joints = k.pose(&robot.joints).unwrap().by_joints();
        let parameters = robot.geometry.parameters().map(Complex::from);
        for j in 0..LIMBS {
            let column = by_joints.column(j).into_owned();
            let size = column.norm().max(1.0);
            let differences = derivative(|h| {
                let mut q = robot.joints;
                q[j] += h;
                k.forward(&q).unwrap()
            }, 0.2);
            prop_assert!((column - differences).norm() < 1e-7 * size);
            let h = 1e-20;
            let mut q: [Complex<f64>; LIMBS] = std::array::from_fn(|i| robot.joints[i].into());
            q[j].im = h;
            let exact = complex_forward(&parameters, &q, &robot.position).map(|c| c.im / h);
            prop_assert!((column - exact).norm() < 1e-10 * size, "{}", (column - exact).norm() / size);
        }
    }

    /// A wrong column among the 18, radians taken for degrees, a limb's gain in another limb's column.
    #[test]
    fn derivative_by_parameters_is_exact(robot in robots()) {
        let k = kinematics(&robot.geometry);
        let by_parameters: SMatrix<f64, 3, GEOMETRIC> = k.by_parameters(&k.pose(&robot.joints).unwrap());
        let q: [Complex<f64>; LIMBS] = std::array::from_fn(|i| robot.joints[i].into());
        for p in 0..GEOMETRIC {
            let column = by_parameters.column(p).into_owned();
            let size = column.norm().max(1.0);
            let differences = derivative(
                |h| kinematics(&with_parameter(&robot.geometry, p, h)).forward(&robot.joints).unwrap(),
                step_of(p),
            );
            prop_assert!((column - differences).norm() < 1e-7 * size, "{p}: {}", (column - differences).norm() / size);
            let h = 1e-20;
            let mut parameters = robot.geometry.parameters().map(Complex::from);
            parameters[p].im = h;
            let exact = complex_forward(&parameters, &q, &robot.position).map(|c| c.im / h);
            prop_assert!((column - exact).norm() < 1e-10 * size, "{p}: {}", (column - exact).norm() / size);
        }
    }

    /// Rails that lean: a centre that is not where the drawing says, an inverse along the vertical, a derivative
    /// that forgets that rail and lean turn with the base angle, lanes that take the rail for vertical.
    #[test]
    fn leaning_rails_are_followed(
        robot in robots(),
        lean in prop::array::uniform3(prop::array::uniform2(-0.02..0.02_f64)),
        pivot in prop::array::uniform3(-300.0..300.0_f64),
    ) {
        let with = |geometry: &Geometry| Kinematics::leaning(geometry, lean, pivot).unwrap();
        let k = with(&robot.geometry);
        // far from the pivot a lean moves a rail by centimetres, which may put the place out of reach
        let Ok(joints) = k.inverse(&robot.position) else { return Ok(()) };
        prop_assume!(k.pose(&joints).is_ok_and(|p| p.by_joints().norm() < 8.0 && p.by_joints().determinant() > 0.2));
        prop_assert!((k.forward(&joints).unwrap() - robot.position).amax() < 1e-9);
        for (i, limb) in robot.geometry.limbs.iter().enumerate() {
            let (sin, cos) = limb.base_angle_rad.sin_cos();
            let rail = Vector3::new(cos * lean[i][0] - sin * lean[i][1], sin * lean[i][0] + cos * lean[i][1], 1.0).normalize();
            let foot = anchor(limb) - Vector3::z() * (limb.joint_offset_mm - pivot[i]);
            let centre = foot + rail * (joints[i] + limb.joint_offset_mm - pivot[i]);
            prop_assert!(((robot.position - centre).norm() - limb.rod_length_mm).abs() < 1e-9);
        }
        let lanes = k.forward_lanes([0, 1, 2].map(|c| Lanes([joints[c], joints[c] + 100.0])));
        for (lane, up) in [(0, 0.0), (1, 100.0)] {
            let single = k.forward(&joints.add_scalar(up));
            prop_assert_eq!(f64::from(single.is_ok()), lanes.1.0[lane]);
            if let Ok(single) = single {
                prop_assert_eq!(bits(&Vector3::from_fn(|c, _| lanes.0[c].0[lane])), bits(&single));
            }
        }
        let pose = k.pose(&joints).unwrap();
        let (by_joints, by_parameters) = (pose.by_joints(), k.by_parameters(&pose));
        for j in 0..LIMBS {
            let differences = derivative(|h| {
                let mut q = joints;
                q[j] += h;
                k.forward(&q).unwrap()
            }, 0.1);
            prop_assert!((by_joints.column(j) - differences).norm() < 1e-7 * by_joints.column(j).norm().max(1.0));
        }
        for p in 0..GEOMETRIC {
            let column = by_parameters.column(p).into_owned();
            let differences = derivative(
                |h| with(&with_parameter(&robot.geometry, p, h)).forward(&joints).unwrap(),
                0.5 * step_of(p),
            );
            prop_assert!((column - differences).norm() < 1e-7 * column.norm().max(1.0), "{p}");
        }
    }

    /// Lanes that take another path than the single pose, in reach or out of it, down to the last bit.
    #[test]
    fn forward_lanes_equal_single_poses(
        robot in robots(),
        others in prop::collection::vec((any::<bool>(), any_vector(), prop::array::uniform3(-300.0..300.0_f64)), 8),
    ) {
        let k = kinematics(&robot.geometry);
        let joints: Vec<Vector3<f64>> = others
            .iter()
            .map(|(wild, any, near)| if *wild { *any } else { robot.joints + Vector3::from(*near) })
            .collect();
        let (positions, reached) = k.forward_lanes(Lanes::columns(&std::array::from_fn(|lane| joints[lane].into())));
        for lane in 0..8 {
            let single = k.forward(&joints[lane]);
            prop_assert_eq!(f64::from(single.is_ok()), reached.0[lane], "{:?}", single);
            let one = k.forward_lanes::<f64>(joints[lane].into());
            prop_assert_eq!(one.1, reached.0[lane]);
            if let Ok(single) = single {
                let in_lane = Vector3::from_fn(|c, _| positions[c].0[lane]);
                prop_assert_eq!(bits(&in_lane), bits(&single));
                prop_assert_eq!(bits(&one.0.into()), bits(&single));
            }
        }
    }

    /// As above, for the inverse.
    #[test]
    fn inverse_lanes_equal_single_poses(
        robot in robots(),
        others in prop::collection::vec((any::<bool>(), any_vector(), prop::array::uniform3(-400.0..400.0_f64)), 8),
    ) {
        let k = kinematics(&robot.geometry);
        let positions: Vec<Vector3<f64>> = others
            .iter()
            .map(|(wild, any, near)| if *wild { *any } else { robot.position + Vector3::from(*near) })
            .collect();
        let (joints, reached) = k.inverse_lanes(Lanes::columns(&std::array::from_fn(|lane| positions[lane].into())));
        for lane in 0..8 {
            let single = k.inverse(&positions[lane]);
            prop_assert_eq!(f64::from(single.is_ok()), reached.0[lane], "{:?}", single);
            if let Ok(single) = single {
                prop_assert_eq!(bits(&Vector3::from_fn(|c, _| joints[c].0[lane])), bits(&single));
            }
        }
    }

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

    /// The 18 parameters in another order on the way out than on the way in.
    #[test]
    fn parameters_round_trip(robot in robots()) {
        let p = robot.geometry.parameters();
        prop_assert_eq!(Geometry::from_parameters(&p, robot.geometry.assembly), robot.geometry);
        prop_assert_eq!(p[PER_LIMB + 3], robot.geometry.limbs[1].rod_length_mm);
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
