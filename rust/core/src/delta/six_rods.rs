//! The platform tilted by its six rods, where the two of a limb differ or its axes are not parallel.

use super::geometry::LIMBS;
use super::kinematics::Kinematics;
use crate::numbers::inverse::{Inverse, inverse};
use crate::numbers::math::sqrt;
use crate::{Error, Result};
use nalgebra::{Matrix6, Rotation3, Vector3, Vector6};

const ITERATIONS: usize = 60;
/// Newton's steps are settled when no rod misses its length by more than this, mm.
const TOLERANCE_MM: f64 = 1e-12;
/// Newton squares what is missed, in units of the robot's size: from here on it is below [`TOLERANCE_MM`] after one step, mm.
const SQUARED_MM: f64 = 1e-6;
/// Pivot ratio below which the six rods do not fix the platform.
const SINGULAR: f64 = 1e-12;
/// The two rods of a limb, as they stand along its axis.
pub(super) const SIDES: [f64; 2] = [1.0, -1.0];

/// The rods of each limb.
#[derive(Clone, Copy, Debug)]
pub struct Pairs {
    /// Half the distance between the rods of a limb along its joint axis at the platform, mm.
    pub half_platform: [Vector3<f64>; LIMBS],
    /// The same at the carriage.
    pub half_carriage: [Vector3<f64>; LIMBS],
    /// Difference of the two rods of a limb, mm.
    pub mismatch: [f64; LIMBS],
    /// Turn of the joint axis at the carriage against that at the platform, rad.
    pub twist: [f64; LIMBS],
}

impl Pairs {
    /// Whether nothing tilts the platform.
    pub fn are_parallel(&self) -> bool {
        self.mismatch == [0.0; LIMBS] && self.twist == [0.0; LIMBS]
    }
}

/// How a unit of mismatch lengthens the rod on the positive side of a limb, times its length; the other is shortened.
pub fn mismatched(_: &Pairs, _: usize, _: &Vector3<f64>, length: f64) -> f64 {
    0.5 * length
}

/// What a unit of twist is to the rod on the positive side of a limb: its end at the carriage moves along it.
pub fn twisted(pairs: &Pairs, limb: usize, rod: &Vector3<f64>, _: f64) -> f64 {
    rod.dot(&Vector3::z().cross(&pairs.half_carriage[limb]))
}

/// One of six rods: its vector, length, and the platform's answer to a unit gain.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rod {
    pub vector: Vector3<f64>,
    pub length: f64,
    pub answer: Motion,
}

/// A small motion of the platform: of its centre, and a turn about it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Motion {
    pub centre: Vector3<f64>,
    pub turn: Vector3<f64>,
}

impl Motion {
    pub fn add(&mut self, other: &Self, gain: f64) {
        self.centre += other.centre * gain;
        self.turn += other.turn * gain;
    }
}

/// The platform tilted by its six rods.
#[derive(Clone, Copy, Debug)]
pub struct Tilted {
    pub rods: [[Rod; 2]; LIMBS],
    pub turn: Rotation3<f64>,
}

impl Tilted {
    #[inline(always)]
    pub fn by_gains(&self, limb: usize, gain: impl Fn(&Rod, f64) -> f64) -> Motion {
        let mut motion = Motion::default();
        for (rod, side) in self.rods[limb].iter().zip(SIDES) {
            motion.add(&rod.answer, gain(rod, side));
        }
        motion
    }
}

/// Newton on six rods from the parallel platform.
pub fn six_rods(
    kinematics: &Kinematics,
    pairs: &Pairs,
    joints: &Vector3<f64>,
    start: &Vector3<f64>,
) -> Result<(Vector3<f64>, Tilted)> {
    let centres = kinematics.sphere_centres(joints);
    let (mut centre, mut turn) = (*start, Rotation3::identity());
    for _ in 0..ITERATIONS {
        let step = Step::at(kinematics, pairs, &centres, &centre, &turn)?;
        if step.worst_mm <= TOLERANCE_MM {
            let rods = step.rods;
            return Ok((centre, Tilted { rods, turn }));
        }
        (centre, turn) = step.taken(&centre, &turn);
    }
    Err(Error::NotConverged {
        iterations: ITERATIONS,
    })
}

/// One of Newton's steps from a platform that stands near: its place, its rods as they were before the step, and whether
/// what the step leaves is nothing.
pub fn one_step(
    kinematics: &Kinematics,
    pairs: &Pairs,
    joints: &Vector3<f64>,
    near: (&Vector3<f64>, &Rotation3<f64>),
) -> Result<(Vector3<f64>, Tilted, bool)> {
    let centres = kinematics.sphere_centres(joints);
    let step = Step::at(kinematics, pairs, &centres, near.0, near.1)?;
    let (centre, turn) = step.taken(near.0, near.1);
    let rods = step.rods;
    Ok((centre, Tilted { rods, turn }, step.worst_mm <= SQUARED_MM))
}

/// The rods of a platform, with what it answers, and Newton's step from there.
struct Step {
    rods: [[Rod; 2]; LIMBS],
    motion: Vector6<f64>,
    /// By how much the worst rod misses its length, mm.
    worst_mm: f64,
}

impl Step {
    fn at(
        kinematics: &Kinematics,
        pairs: &Pairs,
        centres: &[Vector3<f64>; LIMBS],
        centre: &Vector3<f64>,
        turn: &Rotation3<f64>,
    ) -> Result<Self> {
        let mut system = [[0.0; 6]; 6];
        let mut miss = Vector6::zeros();
        let mut rods = [[Rod::default(); 2]; LIMBS];
        for (limb, pair) in rods.iter_mut().enumerate() {
            let joint = kinematics.platform_joint(limb);
            // sphere centres are carriage minus platform joint
            let carriage = centres[limb] + joint;
            for (k, (rod, side)) in pair.iter_mut().zip(SIDES).enumerate() {
                let lever = turn * (joint + pairs.half_platform[limb] * side);
                rod.vector = centre + lever - carriage - pairs.half_carriage[limb] * side;
                rod.length = kinematics.rods()[limb] + 0.5 * side * pairs.mismatch[limb];
                let row = 2 * limb + k;
                let (v, t) = (rod.vector, lever.cross(&rod.vector));
                system[row] = [v.x, v.y, v.z, t.x, t.y, t.z];
                miss[row] = 0.5 * (rod.length * rod.length - rod.vector.norm_squared());
            }
        }
        let worst_mm = miss.amax() / sqrt(rods[0][0].vector.norm_squared());
        let Inverse { rows, weakest } = inverse(system).ok_or(Error::Singular)?;
        if weakest <= SINGULAR || !worst_mm.is_finite() {
            return Err(Error::Singular);
        }
        let inverse = Matrix6::from(rows).transpose();
        for (limb, pair) in rods.iter_mut().enumerate() {
            for (k, rod) in pair.iter_mut().enumerate() {
                let column = inverse.column(2 * limb + k);
                rod.answer = Motion {
                    centre: column.fixed_rows::<3>(0).into_owned(),
                    turn: column.fixed_rows::<3>(3).into_owned(),
                };
            }
        }
        Ok(Self {
            rods,
            motion: inverse * miss,
            worst_mm,
        })
    }

    fn taken(
        &self,
        centre: &Vector3<f64>,
        turn: &Rotation3<f64>,
    ) -> (Vector3<f64>, Rotation3<f64>) {
        let more = Rotation3::from_scaled_axis(self.motion.fixed_rows::<3>(3).into_owned());
        (centre + self.motion.fixed_rows::<3>(0), more * turn)
    }
}
