//! Forward and inverse kinematics, their derivatives and their refusals, on random robots.

#[path = "../common/mod.rs"]
mod common;
mod edges;

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

    /// The 18 parameters in another order on the way out than on the way in.
    #[test]
    fn parameters_round_trip(robot in robots()) {
        let p = robot.geometry.parameters();
        prop_assert_eq!(Geometry::from_parameters(&p, robot.geometry.assembly), robot.geometry);
        prop_assert_eq!(p[PER_LIMB + 3], robot.geometry.limbs[1].rod_length_mm);
    }
}
