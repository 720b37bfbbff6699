//! What the integration tests share: random robots, a seeded random source, Richardson differences.
#![allow(dead_code, reason = "each test binary uses its own part")]

pub mod closed_form;
pub mod fibres;
pub mod paper_vision;

use nalgebra::{Rotation3, SVector, Vector3};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use sherkit_core::chain::LINEARITY_SPAN_MM;
use sherkit_core::chain::effects::{Effect, place};
use sherkit_core::delta::{self, Assembly, Covariates, Geometry, LIMBS, Limb, Model, Values};
use sherkit_core::numbers::rigid::Rigid;
use std::f64::consts::TAU;
use std::ops::Range;

/// Seed of every property test: a run that says something else than the last one shall mean that the code changed.
const SEED: u64 = 0x5e_ed;

/// Cases of a random run for each case of a fixed one.
const MORE: u32 = 32;

/// Proptest's defaults with the same cases in every run, or with `SHERKIT_RANDOM` set (`make test-slow`) more of
/// them, new in each run; `PROPTEST_RNG_SEED` and `PROPTEST_CASES` go before both. No files of past failures: the
/// failing input is printed in full, and belongs into the test as a case of its own.
pub fn config() -> ProptestConfig {
    let given = ProptestConfig::default();
    let random = std::env::var_os("SHERKIT_RANDOM").is_some_and(|v| !v.is_empty());
    let (cases, rng_seed) = match (random, given.rng_seed) {
        (true, seed) if std::env::var_os("PROPTEST_CASES").is_none() => (MORE * given.cases, seed),
        (false, RngSeed::Random) => (given.cases, RngSeed::Fixed(SEED)),
        (_, seed) => (given.cases, seed),
    };
    ProptestConfig {
        cases,
        rng_seed,
        failure_persistence: None,
        max_global_rejects: 1_000_000,
        max_local_rejects: 1_000_000,
        ..given
    }
}

/// A robot and one pose of it, computed here from the drawing and not by the crate.
#[derive(Clone, Copy, Debug)]
pub struct Robot {
    pub geometry: Geometry,
    pub position: Vector3<f64>,
    pub joints: Vector3<f64>,
    /// Where its instrument stands.
    pub sensor: Rigid,
}

/// Instruments that stand anywhere: turned by any turn, and 300 mm aside along each axis at most.
pub fn sensors() -> impl Strategy<Value = Rigid> {
    let shift = prop::array::uniform3(-300.0..300.0_f64);
    (any::<u64>(), shift).prop_map(|(seed, shift)| Rigid {
        rotation: rotation(&mut Random(seed)),
        translation: Vector3::from(shift),
    })
}

/// Where a limb's carriage would stand at joint reading zero if the platform joint were its centre.
pub fn anchor(limb: &Limb) -> Vector3<f64> {
    let base = Vector3::new(limb.base_angle_rad.cos(), limb.base_angle_rad.sin(), 0.0);
    let platform = Vector3::new(
        limb.platform_angle_rad.cos(),
        limb.platform_angle_rad.sin(),
        0.0,
    );
    base * limb.base_radius_mm - platform * limb.platform_radius_mm
        + Vector3::z() * limb.joint_offset_mm
}

/// Vectors from the carriages to the platform joints for a platform centre and joint readings.
pub fn rods(
    geometry: &Geometry,
    position: &Vector3<f64>,
    joints: &Vector3<f64>,
) -> [Vector3<f64>; LIMBS] {
    std::array::from_fn(|i| position - anchor(&geometry.limbs[i]) - Vector3::z() * joints[i])
}

/// Random robots of both assembly modes and both limb orders, each in a pose that is not near-singular.
pub fn robots() -> impl Strategy<Value = Robot> {
    let unit = || prop::array::uniform3(-1.0..1.0_f64);
    let shape = (
        any::<bool>(),
        any::<bool>(),
        0.0..TAU,
        160.0..400.0_f64,
        20.0..90.0_f64,
        1.05..2.0_f64,
    );
    let deviations = (unit(), unit(), unit(), unit(), unit(), unit());
    let place = (0.0..0.6_f64, 0.0..TAU, -500.0..500.0_f64);
    (shape, deviations, place, sensors()).prop_filter_map(
        "a pose within reach and far from singular",
        |(shape, deviations, (share, direction, z), sensor)| {
            let (above, clockwise, turn, base, platform, ratio) = shape;
            let reach = base - platform;
            let (rb, tb, dq, l, rp, tp) = deviations;
            let limbs = std::array::from_fn(|i| {
                let third = i as f64 * TAU / 3.0;
                let angle = turn + if clockwise { -third } else { third };
                Limb {
                    base_radius_mm: base + 20.0 * rb[i],
                    base_angle_rad: angle + 0.1 * tb[i],
                    joint_offset_mm: 50.0 * dq[i],
                    rod_length_mm: 1.6 * ratio * reach + 10.0 * l[i],
                    platform_radius_mm: platform + 10.0 * rp[i],
                    platform_angle_rad: angle + 0.1 * tp[i],
                }
            });
            let assembly = if above {
                Assembly::Above
            } else {
                Assembly::Below
            };
            let geometry = Geometry { limbs, assembly };
            let (x, y) = (direction.cos(), direction.sin());
            let position = Vector3::new(share * reach * x, share * reach * y, z);
            let joints = joints_at(&geometry, &position, [assembly.sign(); LIMBS])?;
            let [a, b, c] = rods(&geometry, &position, &joints).map(|r| r.normalize());
            let steep = [a, b, c].iter().all(|r| r.z.abs() > 0.2);
            (steep && a.cross(&b).dot(&c).abs() > 0.1).then_some(Robot {
                geometry,
                position,
                joints,
                sensor,
            })
        },
    )
}

/// From the base to an instrument that is off its nominal pose by six numbers, by the formula of the sensor's pose.
pub fn stand(nominal: &Rigid, off: &[f64]) -> Rigid {
    let turn = Rotation3::new(Vector3::from_column_slice(&off[..3]));
    Rigid {
        rotation: turn.matrix() * nominal.rotation,
        translation: nominal.translation + Vector3::from_column_slice(&off[3..6]),
    }
}

/// A robot as on a drawing: three equal limbs a third of a turn apart.
pub fn drawing() -> Geometry {
    let limbs = std::array::from_fn(|i| {
        let angle = i as f64 * TAU / 3.0;
        Limb {
            base_radius_mm: 200.0,
            base_angle_rad: angle,
            joint_offset_mm: 0.0,
            rod_length_mm: 300.0,
            platform_radius_mm: 50.0,
            platform_angle_rad: angle,
        }
    });
    Geometry {
        limbs,
        assembly: Assembly::Below,
    }
}

/// A pose of the robot of the drawing, seen by an instrument that stands aside and turned.
pub fn drawn() -> Robot {
    Robot {
        geometry: drawing(),
        position: Vector3::zeros(),
        joints: Vector3::repeat(200.0),
        sensor: Rigid {
            rotation: rotation(&mut Random(3)),
            translation: Vector3::new(210.0, -140.0, 35.0),
        },
    }
}

/// Joint readings that put the carriages above (+1) or below (-1) the platform joints, by Pythagoras.
pub fn joints_at(
    geometry: &Geometry,
    position: &Vector3<f64>,
    sides: [f64; LIMBS],
) -> Option<Vector3<f64>> {
    let mut joints = Vector3::zeros();
    for (i, limb) in geometry.limbs.iter().enumerate() {
        let away = position - anchor(limb);
        let rise_squared = limb.rod_length_mm.powi(2) - away.x.powi(2) - away.y.powi(2);
        if rise_squared < 0.0 {
            return None;
        }
        joints[i] = away.z + sides[i] * rise_squared.sqrt();
    }
    Some(joints)
}

/// The chain's model of a robot: a target off the platform centre, rods in pairs, home where it stands.
pub fn model_of(robot: &Robot) -> Model {
    Model {
        geometry: robot.geometry,
        target_offset: Vector3::new(7.0, -11.0, -30.0),
        sensor: robot.sensor,
        rod_spacing: 40.0,
        pole_pitch: [16.0, 12.0, 20.0],
        home: [robot.joints.x, robot.joints.y - 40.0, robot.joints.z + 90.0],
        time_origin_s: 100.0,
        slip_time_s: 2000.0,
        joint_slip_time_s: 2100.0,
        sensor_slip_time_s: 2200.0,
    }
}

/// A row of which everything is known: warm, after the slip, the joints moving up, down and not at all.
pub fn some_covariates() -> Covariates {
    Covariates {
        time_s: 5000.0,
        temperature_c: 24.0,
        stand_c: 24.5,
        payload_kg: f64::NAN,
        direction: [1.0, -1.0, 0.0],
        ..Covariates::NONE
    }
}

/// Where the parameters of an effect stand.
pub const fn range_of(table: &[Effect], name: &str) -> Range<usize> {
    match place(table, name) {
        Some(place) => place.range(),
        None => panic!("no effect of that name"),
    }
}

/// Plausible size of each parameter of a table.
pub fn plausible<const P: usize>(table: &[Effect]) -> [f64; P] {
    let mut sizes = table.iter().flat_map(|e| e.parameters).map(|p| p.size);
    std::array::from_fn(|_| sizes.next().expect("a size for each"))
}

/// Random values of all parameters of the delta, each within a third of its plausible size.
pub fn effects() -> impl Strategy<Value = Values> {
    any::<u64>().prop_map(|seed| {
        let mut random = Random(seed);
        plausible(delta::CATALOGUE).map(|s| 0.3 * s * random.unit())
    })
}

/// The same with sensors that are as straight over all that they read of a robot as others are over 20 mm.
pub fn straight_over_all(robot: &Robot, mut values: Values) -> Values {
    let read = robot.sensor.apply(&robot.position).amax() + 100.0;
    for value in &mut values[range_of(delta::CATALOGUE, "sensor_linearity")] {
        *value *= (LINEARITY_SPAN_MM / read).powi(3);
    }
    values
}

/// Central difference extrapolated once (Richardson): error of fourth order in `h`.
pub fn derivative<const N: usize>(f: impl Fn(f64) -> SVector<f64, N>, h: f64) -> SVector<f64, N> {
    let central = |h: f64| (f(h) - f(-h)) / (2.0 * h);
    (central(0.5 * h) * 4.0 - central(h)) / 3.0
}

/// Splitmix64: random numbers from one seed, so that a failing case shrinks to a seed and not to a thousand
/// numbers.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform between -1 and 1.
    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    /// Standard normal, by Box and Muller.
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (0.5 - 0.5 * self.unit()).max(f64::MIN_POSITIVE).ln()).sqrt();
        radius * (std::f64::consts::PI * self.unit()).cos()
    }

    /// Log-uniform between `10^-decades` and `10^decades`.
    pub fn magnitude(&mut self, decades: f64) -> f64 {
        10.0_f64.powf(decades * self.unit())
    }
}

/// A random rotation, by a random quaternion.
pub fn rotation(random: &mut Random) -> nalgebra::Matrix3<f64> {
    let q = nalgebra::Quaternion::new(
        random.normal(),
        random.normal(),
        random.normal(),
        random.normal(),
    );
    nalgebra::UnitQuaternion::from_quaternion(q)
        .to_rotation_matrix()
        .into_inner()
}
