//! The structure link: from carriages to the measured point, and how that answers to any small change.
//!
//! With equal rods the platform stays parallel and three spheres fix it. With unequal rods it tilts: then all
//! six rods `|x + R a - c|² = l²` are solved for position and rotation by Newton's method. Either way every
//! parameter acts by moving the carriage end of a limb by `dv` or lengthening its rods by `dl`, so one small
//! inverse gives all derivatives: `ρ·(dx + dw × R a) = ρ·dv + l dl` for each rod ρ.
//!
//! Sag is linear elasticity on top: with `g_i` the columns of `A⁻¹` (rows of `A` are the rods), limb i carries the
//! share `-l_i g_iz` of the weight, stretches by `c_i` times that, and the platform moves by
//! `-Σ c_i l_i² g_iz g_i`. Derivation: force balance `Aᵀφ = -ẑ` and the constraint above.

use super::geometry::LIMBS;
use super::kinematics::Kinematics;
use crate::math::sqrt;
use crate::{Error, Result};
use nalgebra::{Matrix3, Matrix6, Rotation3, Vector3, Vector6};

const NEWTON_ITERATIONS: usize = 25;
/// Newton stops when no rod is wrong by more than this, mm.
const NEWTON_TOLERANCE_MM: f64 = 1e-12;
/// Pivot ratio below which the six rods do not fix the platform.
const SINGULAR: f64 = 1e-12;

/// What of the structure is not in [`Kinematics`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Extras {
    /// From the platform centre to the measured point, platform frame, mm.
    pub target: Vector3<f64>,
    /// Half the distance between the rods of a limb along its joint axis, mm.
    pub half_pair: [Vector3<f64>; LIMBS],
    /// Difference of the two rods of a limb, mm.
    pub mismatch: [f64; LIMBS],
    /// Stretch under the whole weight, mm.
    pub compliance: [f64; LIMBS],
}

impl Extras {
    /// Whether three spheres are all there is.
    pub fn is_plain(&self) -> bool {
        self.mismatch == [0.0; LIMBS] && self.compliance == [0.0; LIMBS]
    }
}

/// One of six rods: its vector, length, and the platform's answer to a unit gain.
#[derive(Clone, Copy, Debug, Default)]
struct Rod {
    vector: Vector3<f64>,
    length: f64,
    centre: Vector3<f64>,
    turn: Vector3<f64>,
}

/// The solved structure.
#[derive(Clone, Copy, Debug)]
pub(super) struct Structure {
    /// Measured point, base frame, mm, sag included.
    pub point: Vector3<f64>,
    /// Mean rod of each limb.
    means: [Vector3<f64>; LIMBS],
    /// Both rods of each limb, where the platform tilts.
    pairs: Option<[[Rod; 2]; LIMBS]>,
    /// From the platform centre to the measured point, base frame.
    arm: Vector3<f64>,
    turn: Rotation3<f64>,
    /// Columns `g_i` of the inverse of the mean rods, and the mean rods' lengths.
    answers: Matrix3<f64>,
    lengths: [f64; LIMBS],
    compliance: [f64; LIMBS],
}

/// A small change at one limb: of its carriage end against its platform end, and of the length of its rods.
#[derive(Clone, Copy, Debug)]
struct Change {
    end: Vector3<f64>,
    length: f64,
}

impl Structure {
    #[inline]
    pub fn solve(kinematics: &Kinematics, extras: &Extras, joints: &Vector3<f64>) -> Result<Self> {
        let pose = kinematics.pose(joints)?;
        let mut structure = Self {
            point: pose.position + extras.target,
            means: *pose.rods(),
            pairs: None,
            arm: extras.target,
            turn: Rotation3::identity(),
            answers: *pose.answers(),
            lengths: *kinematics.rods(),
            compliance: extras.compliance,
        };
        if extras.mismatch != [0.0; LIMBS] {
            let centres = kinematics.sphere_centres(joints);
            structure.tilt(kinematics, extras, &centres, &pose.position)?;
        }
        if extras.compliance != [0.0; LIMBS] {
            structure.point += structure.sag();
        }
        Ok(structure)
    }

    /// Replaces the parallel platform by the one that six rods hold.
    fn tilt(
        &mut self,
        kinematics: &Kinematics,
        extras: &Extras,
        centres: &[Vector3<f64>; LIMBS],
        start: &Vector3<f64>,
    ) -> Result<()> {
        let (centre, turn, pairs) = six_rods(kinematics, extras, centres, start)?;
        self.turn = turn;
        self.arm = turn * extras.target;
        self.point = centre + self.arm;
        self.means = [
            centre - centres[0],
            centre - centres[1],
            centre - centres[2],
        ];
        let rows = Matrix3::from_columns(&self.means).transpose();
        self.answers = rows.try_inverse().ok_or(Error::Singular)?;
        self.pairs = Some(pairs);
        Ok(())
    }

    /// Movement of the measured point under the weight.
    fn sag(&self) -> Vector3<f64> {
        let mut sum = Vector3::zeros();
        for limb in 0..LIMBS {
            sum += self.by_compliance(limb) * self.compliance[limb];
        }
        sum
    }

    /// Derivative by the compliance of a limb.
    pub fn by_compliance(&self, limb: usize) -> Vector3<f64> {
        let g = self.answers.column(limb);
        g * (-self.lengths[limb] * self.lengths[limb] * g.z)
    }

    /// Derivative of the measured point by a movement of the carriage end of a limb.
    #[inline]
    pub fn by_carriage(&self, limb: usize, moved: &Vector3<f64>) -> Vector3<f64> {
        let change = Change {
            end: *moved,
            length: 0.0,
        };
        match &self.pairs {
            None => self.parallel(limb, self.means[limb].dot(moved), &change),
            Some(pairs) => self.tilted(&pairs[limb], limb, &change, &change),
        }
    }

    /// Derivative by a movement of the platform end of a limb, given in the platform frame.
    #[inline]
    pub fn by_platform(&self, limb: usize, moved: &Vector3<f64>) -> Vector3<f64> {
        let sphere = Change {
            end: -moved,
            length: 0.0,
        };
        match &self.pairs {
            None => self.parallel(limb, -self.means[limb].dot(moved), &sphere),
            Some(pairs) => {
                let rod = Change {
                    end: -(self.turn * moved),
                    length: 0.0,
                };
                self.tilted(&pairs[limb], limb, &rod, &sphere)
            }
        }
    }

    /// Derivative by the length of the rods of a limb.
    #[inline]
    pub fn by_length(&self, limb: usize) -> Vector3<f64> {
        let change = Change {
            end: Vector3::zeros(),
            length: 1.0,
        };
        match &self.pairs {
            None => self.parallel(limb, self.lengths[limb], &change),
            Some(pairs) => self.tilted(&pairs[limb], limb, &change, &change),
        }
    }

    #[inline]
    fn parallel(&self, limb: usize, gain: f64, change: &Change) -> Vector3<f64> {
        let centre = self.answers.column(limb) * gain;
        centre + self.sag_change(&centre, Some((limb, change)))
    }

    /// `rod` is the change as the six rods see it, `sphere` as the mean rod does, on which sag depends.
    fn tilted(&self, pair: &[Rod; 2], limb: usize, rod: &Change, sphere: &Change) -> Vector3<f64> {
        let (mut centre, mut turn) = (Vector3::zeros(), Vector3::zeros());
        for one in pair {
            let gain = one.vector.dot(&rod.end) + one.length * rod.length;
            centre += one.centre * gain;
            turn += one.turn * gain;
        }
        let sag = self.sag_change(&centre, Some((limb, sphere)));
        centre + turn.cross(&self.arm) + sag
    }

    /// Derivative of the measured point by the difference of the two rods of each limb, one column a limb.
    pub fn by_rod_mismatch(&self, kinematics: &Kinematics, extras: &Extras) -> Matrix3<f64> {
        match &self.pairs {
            None => self.mismatch_of_parallel(kinematics, extras),
            Some(pairs) => self.mismatch_of_rods(pairs),
        }
    }

    /// How sag changes when the platform centre moves and a limb changes:
    /// `dg_i = -Σ_k g_k (dρ_k·g_i)` with `dρ_k = dx - dv_k`.
    #[inline]
    fn sag_change(&self, centre: &Vector3<f64>, at: Option<(usize, &Change)>) -> Vector3<f64> {
        let mut sum = Vector3::zeros();
        if self.compliance == [0.0; LIMBS] {
            return sum;
        }
        let all = self.answers.column_sum();
        for i in 0..LIMBS {
            let c = self.compliance[i];
            if c == 0.0 {
                continue;
            }
            let g: Vector3<f64> = self.answers.column(i).into_owned();
            let l = self.lengths[i];
            let mut dg = -all * g.dot(centre);
            let mut stretch = 0.0;
            if let Some((limb, change)) = at {
                dg += self.answers.column(limb) * g.dot(&change.end);
                if limb == i {
                    stretch = 2.0 * l * change.length;
                }
            }
            sum -= (dg * g.z + g * dg.z) * (c * l * l) + g * (c * stretch * g.z);
        }
        sum
    }

    /// Around the parallel platform the two rods of a limb differ only by a turn:
    /// `(e_i × ρ_i)·dw = l_i m_i / |pair|`, and the centre follows.
    fn mismatch_of_parallel(&self, kinematics: &Kinematics, extras: &Extras) -> Matrix3<f64> {
        let row = |i: usize| {
            (extras.half_pair[i] * 2.0)
                .cross(&self.means[i])
                .transpose()
        };
        let Some(turn) = Matrix3::from_rows(&[row(0), row(1), row(2)]).try_inverse() else {
            return Matrix3::zeros(); // rods without a distance between them cannot tilt the platform
        };
        let mut out = Matrix3::zeros();
        for limb in 0..LIMBS {
            let dw: Vector3<f64> = turn.column(limb) * self.lengths[limb];
            let mut centre = Vector3::zeros();
            for k in 0..LIMBS {
                let lever = dw.cross(&kinematics.platform_joint(k));
                centre -= self.answers.column(k) * self.means[k].dot(&lever);
            }
            let moved = centre + dw.cross(&self.arm) + self.sag_change(&centre, None);
            out.set_column(limb, &moved);
        }
        out
    }

    fn mismatch_of_rods(&self, pairs: &[[Rod; 2]; LIMBS]) -> Matrix3<f64> {
        let mut out = Matrix3::zeros();
        for (limb, [plus, minus]) in pairs.iter().enumerate() {
            let centre = plus.centre * (0.5 * plus.length) - minus.centre * (0.5 * minus.length);
            let turn = plus.turn * (0.5 * plus.length) - minus.turn * (0.5 * minus.length);
            let moved = centre + turn.cross(&self.arm) + self.sag_change(&centre, None);
            out.set_column(limb, &moved);
        }
        out
    }
}

/// Newton on six rods from the parallel platform.
fn six_rods(
    kinematics: &Kinematics,
    extras: &Extras,
    centres: &[Vector3<f64>; LIMBS],
    start: &Vector3<f64>,
) -> Result<(Vector3<f64>, Rotation3<f64>, [[Rod; 2]; LIMBS])> {
    let mut centre = *start;
    let mut turn = Rotation3::identity();
    for _ in 0..NEWTON_ITERATIONS {
        let mut system = Matrix6::zeros();
        let mut miss = Vector6::zeros();
        let mut rods = [[Rod::default(); 2]; LIMBS];
        for (limb, pair) in rods.iter_mut().enumerate() {
            let joint = kinematics.platform_joint(limb);
            // sphere centres are carriage minus platform joint
            let carriage = centres[limb] + joint;
            for (k, rod) in pair.iter_mut().enumerate() {
                let side = if k == 0 { 1.0 } else { -1.0 };
                let offset = extras.half_pair[limb] * side;
                let lever = turn * (joint + offset);
                rod.vector = centre + lever - carriage - offset;
                rod.length = kinematics.rods()[limb] + 0.5 * side * extras.mismatch[limb];
                let row = 2 * limb + k;
                system
                    .fixed_view_mut::<1, 3>(row, 0)
                    .copy_from(&rod.vector.transpose());
                system
                    .fixed_view_mut::<1, 3>(row, 3)
                    .copy_from(&lever.cross(&rod.vector).transpose());
                miss[row] = 0.5 * (rod.length * rod.length - rod.vector.norm_squared());
            }
        }
        let lu = system.full_piv_lu();
        let u = lu.u();
        let pivots = u.diagonal();
        if pivots.amin() <= SINGULAR * pivots.amax() {
            return Err(Error::Singular);
        }
        let inverse = lu.try_inverse().ok_or(Error::Singular)?;
        let worst = miss.amax();
        if !worst.is_finite() {
            return Err(Error::Singular);
        }
        if worst <= NEWTON_TOLERANCE_MM * sqrt(rods[0][0].vector.norm_squared()) {
            for (limb, pair) in rods.iter_mut().enumerate() {
                for (k, rod) in pair.iter_mut().enumerate() {
                    let column = inverse.column(2 * limb + k);
                    rod.centre = column.fixed_rows::<3>(0).into_owned();
                    rod.turn = column.fixed_rows::<3>(3).into_owned();
                }
            }
            return Ok((centre, turn, rods));
        }
        let step = inverse * miss;
        centre += step.fixed_rows::<3>(0);
        turn = Rotation3::from_scaled_axis(step.fixed_rows::<3>(3).into_owned()) * turn;
    }
    Err(Error::NotConverged {
        iterations: NEWTON_ITERATIONS,
    })
}
