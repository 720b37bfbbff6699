//! The structure link: from carriages to the measured point, and how that answers to any small change.
//!
//! With equal rods the platform stays parallel and three spheres fix it. Under the platform's weight limb i
//! carries the share `f_i = -L_i g_iz` of it, with `g_i` the columns of `A⁻¹` and the rods as rows of `A` (force
//! balance: `Aᵀφ = -ẑ`), and its rods are longer by `c_i f_i`; lengths and pose are brought to agree. With unequal
//! rods the platform also tilts: then all six rods `|x + R a - c|² = L²` are solved by Newton's method.
//!
//! Every parameter acts by moving a carriage end by `dv` or lengthening rods by `dl`. With
//! `dx = Σ g_k (r_k·dv_k + L_k dL_k)` and `dg_i = -Σ_k g_k (g_i·(dx - dv_k))`, the rods answer by
//! `(I - C M) dL = dl + C h`, `M_ij = L_i s_z (g_i·g_j) L_j - g_iz δ_ij`,
//! `h_i = L_i (s_z g_i·dx₀ - Σ_k g_kz g_i·dv_k)`, `s = Σ g_k`, `dx₀ = Σ g_k r_k·dv_k`.

use super::effects::{AT, PARAMETERS, Values};
use super::geometry::{Geometry, IDENTIFIABLE, LIMBS, PER_LIMB};
use super::kinematics::Kinematics;
use super::nominal::Model;
use crate::chain::Mechanism;
use crate::chain::effects::{Wanted, values_of};
use crate::numbers::inverse::{Inverse, inverse};
use crate::numbers::math::{sin_cos, sqrt};
use crate::{Error, Result};
use nalgebra::{Matrix3, Matrix6, Rotation3, SMatrix, Vector3, Vector6};

const ITERATIONS: usize = 60;
/// Lengths and Newton steps are settled when nothing moves by more than this, mm.
const TOLERANCE_MM: f64 = 1e-12;
/// Pivot ratio below which the six rods do not fix the platform.
const SINGULAR: f64 = 1e-12;

/// The delta with given errors: what joins its joints to the measured point.
#[derive(Clone, Copy, Debug)]
pub struct Structure {
    kinematics: Kinematics,
    extras: Extras,
}

/// What of the structure is not in [`Kinematics`].
#[derive(Clone, Copy, Debug)]
struct Extras {
    /// From the platform centre to the measured point, platform frame, mm.
    target: Vector3<f64>,
    /// Half the distance between the rods of a limb along its joint axis, mm.
    half_pair: [Vector3<f64>; LIMBS],
    /// Difference of the two rods of a limb, mm.
    mismatch: [f64; LIMBS],
    /// Stretch of a limb under the whole weight, mm.
    compliance: [f64; LIMBS],
}

impl Structure {
    /// The mechanism with its errors.
    ///
    /// # Errors
    /// As [`Kinematics::leaning`].
    pub fn new(model: &Model, values: &Values) -> Result<Self> {
        let mut geometry = model.geometry.parameters();
        for (g, e) in geometry.iter_mut().zip(values) {
            *g += e;
        }
        let geometry = Geometry::from_parameters(&geometry, model.geometry.assembly);
        let at = AT.structure;
        let [r1, t1, r2, t2, r3, t3] = values_of(at.rail_lean, values);
        let lean = [[r1, t1], [r2, t2], [r3, t3]];
        let half = 0.5 * model.rod_spacing;
        let pair = |limb: usize| {
            // the joint axes of a limb are alike at carriage and platform, or equal rods would tilt it too
            let (sin, cos) = sin_cos(model.geometry.limbs[limb].platform_angle_rad);
            Vector3::new(-sin * half, cos * half, 0.0)
        };
        Ok(Self {
            kinematics: Kinematics::leaning(&geometry, lean, model.home)?,
            extras: Extras {
                target: model.target_offset,
                half_pair: [pair(0), pair(1), pair(2)],
                mismatch: values_of(at.rod_mismatch, values),
                compliance: values_of(at.gravity_sag, values),
            },
        })
    }

    /// Joint readings near those that bring the measured point to a place: effects but lean left out.
    ///
    /// # Errors
    /// As [`Kinematics::inverse`].
    pub fn rough_inverse(&self, point: &Vector3<f64>) -> Result<Vector3<f64>> {
        self.kinematics.inverse(&(point - self.extras.target))
    }
}

impl Mechanism<LIMBS, PARAMETERS> for Structure {
    type Solved = Solved;

    #[inline]
    fn solve(&self, joints: &Vector3<f64>) -> Result<Solved> {
        Solved::of(&self.kinematics, &self.extras, joints)
    }

    #[inline]
    fn point(&self, solved: &Solved) -> Vector3<f64> {
        solved.point
    }

    #[inline]
    fn point_at(&self, joints: &Vector3<f64>) -> Result<Vector3<f64>> {
        if self.extras.is_plain() {
            return Ok(self.kinematics.forward(joints)? + self.extras.target);
        }
        Ok(self.solve(joints)?.point)
    }

    #[inline]
    fn columns<const M: usize>(
        &self,
        joints: &Vector3<f64>,
        solved: &Solved,
        by_point: &SMatrix<f64, M, 3>,
        wanted: Wanted,
        d: &mut SMatrix<f64, M, PARAMETERS>,
    ) -> SMatrix<f64, M, LIMBS> {
        let at = AT.structure;
        if let Some(place) = wanted.wants(at.rod_mismatch) {
            let columns = by_point * solved.by_rod_mismatch(&self.kinematics, &self.extras);
            d.fixed_columns_mut::<LIMBS>(place.start)
                .copy_from(&columns);
        }
        let limbs = [at.limb_1, at.limb_2, at.limb_3];
        let platforms = [at.platform_1, at.platform_2, at.platform_3];
        let mut by_joints = SMatrix::<f64, M, LIMBS>::zeros();
        for limb in 0..LIMBS {
            let joint = joints[limb];
            let by = self.kinematics.by_limb(limb, joint);
            let by_joint = by_point * solved.by_carriage(limb, &by.joint);
            by_joints.set_column(limb, &by_joint);
            if wanted.wants(limbs[limb]).is_some() {
                let first = limb * PER_LIMB;
                let radius = solved.by_carriage(limb, &by.base_radius);
                let angle = solved.by_carriage(limb, &by.base_angle);
                d.set_column(first, &(by_point * radius));
                d.set_column(first + 1, &(by_point * angle));
                d.set_column(first + 2, &by_joint);
                d.set_column(first + 3, &(by_point * solved.by_length(limb)));
            }
            if wanted.wants(platforms[limb]).is_some() {
                let first = limb * PER_LIMB + IDENTIFIABLE;
                // the kinematics gives the sphere centre, which moves against the platform end
                let radius = solved.by_platform(limb, &-by.platform_radius);
                let angle = solved.by_platform(limb, &-by.platform_angle);
                d.set_column(first, &(by_point * radius));
                d.set_column(first + 1, &(by_point * angle));
            }
            if let Some(place) = wanted.wants(at.rail_lean) {
                for (k, lean) in self.kinematics.by_lean(limb, joint).iter().enumerate() {
                    let column = by_point * solved.by_carriage(limb, lean);
                    d.set_column(place.start + 2 * limb + k, &column);
                }
            }
            if let Some(place) = wanted.wants(at.gravity_sag) {
                let column = by_point * solved.by_compliance(limb);
                d.set_column(place.start + limb, &column);
            }
        }
        by_joints
    }
}

impl Extras {
    /// Whether three spheres are all there is.
    fn is_plain(&self) -> bool {
        self.mismatch == [0.0; LIMBS] && self.is_stiff()
    }

    fn is_stiff(&self) -> bool {
        self.compliance == [0.0; LIMBS]
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

/// How the rods answer to load: shares of the weight, and `(I - C M)⁻¹`.
#[derive(Clone, Copy, Debug)]
struct Loaded {
    shares: Vector3<f64>,
    compliance: Vector3<f64>,
    answer: Matrix3<f64>,
}

/// The platform tilted by unequal rods.
#[derive(Clone, Copy, Debug)]
struct Tilted {
    rods: [[Rod; 2]; LIMBS],
    turn: Rotation3<f64>,
    arm: Vector3<f64>,
}

/// The solved structure.
#[derive(Clone, Copy, Debug)]
pub struct Solved {
    /// Measured point, base frame, mm.
    point: Vector3<f64>,
    /// Rods of the parallel platform.
    rods: [Vector3<f64>; LIMBS],
    /// Columns `g_i` of the inverse of the rods.
    answers: Matrix3<f64>,
    lengths: [f64; LIMBS],
    loaded: Option<Loaded>,
    tilted: Option<Tilted>,
}

impl Solved {
    #[inline]
    fn of(kinematics: &Kinematics, extras: &Extras, joints: &Vector3<f64>) -> Result<Self> {
        if extras.is_stiff() {
            return Self::unloaded(kinematics, extras, joints);
        }
        let stretched = stretched(kinematics, &extras.compliance, joints)?;
        let mut structure = Self::unloaded(&stretched, extras, joints)?;
        structure.load(&extras.compliance)?;
        Ok(structure)
    }

    #[inline]
    fn unloaded(kinematics: &Kinematics, extras: &Extras, joints: &Vector3<f64>) -> Result<Self> {
        let pose = kinematics.pose(joints)?;
        let mut structure = Self {
            point: pose.position + extras.target,
            rods: *pose.rods(),
            answers: *pose.answers(),
            lengths: *kinematics.rods(),
            loaded: None,
            tilted: None,
        };
        if extras.mismatch != [0.0; LIMBS] {
            let (centre, tilted) = six_rods(kinematics, extras, joints, &pose.position)?;
            structure.point = centre + tilted.arm;
            structure.tilted = Some(tilted);
        }
        Ok(structure)
    }

    /// Keeps what the derivatives under load need.
    fn load(&mut self, compliance: &[f64; LIMBS]) -> Result<()> {
        let all = self.answers.column_sum();
        let mut system = Matrix3::identity();
        for i in 0..LIMBS {
            let gi = self.answers.column(i);
            for j in 0..LIMBS {
                let gj = self.answers.column(j);
                let m = self.lengths[i] * all.z * gi.dot(&gj) * self.lengths[j];
                system[(i, j)] -= compliance[i] * m;
            }
            system[(i, i)] += compliance[i] * gi.z;
        }
        self.loaded = Some(Loaded {
            shares: shares(&self.answers, &self.lengths),
            compliance: Vector3::from(*compliance),
            answer: system.try_inverse().ok_or(Error::Singular)?,
        });
        Ok(())
    }

    /// Derivative of the measured point by a movement of the carriage end of a limb.
    #[inline]
    fn by_carriage(&self, limb: usize, moved: &Vector3<f64>) -> Vector3<f64> {
        let stiff = match &self.tilted {
            None => self.answers.column(limb) * self.rods[limb].dot(moved),
            Some(tilted) => tilted.by_end(limb, moved),
        };
        stiff + self.by_load(limb, moved)
    }

    /// Derivative by a movement of the platform end of a limb, given in the platform frame.
    #[inline]
    fn by_platform(&self, limb: usize, moved: &Vector3<f64>) -> Vector3<f64> {
        let sphere = -moved;
        let stiff = match &self.tilted {
            None => self.answers.column(limb) * self.rods[limb].dot(&sphere),
            Some(tilted) => tilted.by_end(limb, &(tilted.turn * sphere)),
        };
        stiff + self.by_load(limb, &sphere)
    }

    /// Derivative by the length of the rods of a limb.
    #[inline]
    fn by_length(&self, limb: usize) -> Vector3<f64> {
        match &self.loaded {
            None => self.by_true_length(limb),
            Some(loaded) => self.by_true_lengths(&loaded.answer.column(limb).into_owned()),
        }
    }

    /// Derivative by the compliance of a limb: its share of the weight lengthens its rods.
    fn by_compliance(&self, limb: usize) -> Vector3<f64> {
        match &self.loaded {
            None => {
                let share = shares(&self.answers, &self.lengths)[limb];
                self.by_true_length(limb) * share
            }
            Some(loaded) => {
                let longer = loaded.answer.column(limb) * loaded.shares[limb];
                self.by_true_lengths(&longer)
            }
        }
    }

    /// Derivative by the difference of the two rods of each limb, one column a limb.
    fn by_rod_mismatch(&self, kinematics: &Kinematics, extras: &Extras) -> Matrix3<f64> {
        match &self.tilted {
            None => self.mismatch_of_parallel(kinematics, extras),
            Some(tilted) => tilted.by_mismatch(),
        }
    }

    /// By the length that the rods of a limb have under load.
    #[inline]
    fn by_true_length(&self, limb: usize) -> Vector3<f64> {
        match &self.tilted {
            None => self.answers.column(limb) * self.lengths[limb],
            Some(tilted) => tilted.by_length(limb),
        }
    }

    fn by_true_lengths(&self, longer: &Vector3<f64>) -> Vector3<f64> {
        (0..LIMBS).fold(Vector3::zeros(), |sum, k| {
            sum + self.by_true_length(k) * longer[k]
        })
    }

    /// What a movement of a sphere centre does by way of the loads. Inlined, so that the limb is a constant and no index
    /// is left to be checked.
    #[inline(always)]
    fn by_load(&self, limb: usize, moved: &Vector3<f64>) -> Vector3<f64> {
        let Some(loaded) = &self.loaded else {
            return Vector3::zeros();
        };
        let first = self.answers.column(limb) * self.rods[limb].dot(moved);
        let all = self.answers.column_sum();
        let lift = self.answers[(2, limb)];
        let mut load = Vector3::zeros();
        for i in 0..LIMBS {
            let g = self.answers.column(i);
            load[i] = self.lengths[i] * (all.z * g.dot(&first) - lift * g.dot(moved));
        }
        self.by_true_lengths(&(loaded.answer * loaded.compliance.component_mul(&load)))
    }

    /// Around the parallel platform the two rods of a limb differ only by a turn:
    /// `(pair × ρ_i)·dw = L_i m_i`, and the centre follows.
    fn mismatch_of_parallel(&self, kinematics: &Kinematics, extras: &Extras) -> Matrix3<f64> {
        let row = |i: usize| (extras.half_pair[i] * 2.0).cross(&self.rods[i]).transpose();
        let Some(turn) = Matrix3::from_rows(&[row(0), row(1), row(2)]).try_inverse() else {
            return Matrix3::zeros(); // rods without a distance between them cannot tilt the platform
        };
        let mut out = Matrix3::zeros();
        for limb in 0..LIMBS {
            let dw: Vector3<f64> = turn.column(limb) * self.lengths[limb];
            let mut centre = Vector3::zeros();
            for k in 0..LIMBS {
                let lever = dw.cross(&kinematics.platform_joint(k));
                centre -= self.answers.column(k) * self.rods[k].dot(&lever);
            }
            out.set_column(limb, &(centre + dw.cross(&extras.target)));
        }
        out
    }
}

impl Tilted {
    fn by_gains(&self, limb: usize, gain: impl Fn(&Rod, f64) -> f64) -> Vector3<f64> {
        let (mut centre, mut turn) = (Vector3::zeros(), Vector3::zeros());
        for (rod, side) in self.rods[limb].iter().zip([1.0, -1.0]) {
            let gain = gain(rod, side);
            centre += rod.centre * gain;
            turn += rod.turn * gain;
        }
        centre + turn.cross(&self.arm)
    }

    fn by_end(&self, limb: usize, moved: &Vector3<f64>) -> Vector3<f64> {
        self.by_gains(limb, |rod, _| rod.vector.dot(moved))
    }

    fn by_length(&self, limb: usize) -> Vector3<f64> {
        self.by_gains(limb, |rod, _| rod.length)
    }

    fn by_mismatch(&self) -> Matrix3<f64> {
        let column = |limb: usize| self.by_gains(limb, |rod, side| 0.5 * side * rod.length);
        Matrix3::from_columns(&[column(0), column(1), column(2)])
    }
}

/// Shares of the weight that the limbs carry.
fn shares(answers: &Matrix3<f64>, lengths: &[f64; LIMBS]) -> Vector3<f64> {
    -answers
        .row(2)
        .transpose()
        .component_mul(&Vector3::from(*lengths))
}

/// The kinematics with rods as long as they are under the weight.
fn stretched(
    kinematics: &Kinematics,
    compliance: &[f64; LIMBS],
    joints: &Vector3<f64>,
) -> Result<Kinematics> {
    let mut current = *kinematics;
    for _ in 0..ITERATIONS {
        let pose = current.pose(joints)?;
        let share = shares(pose.answers(), current.rods());
        let mut lengths = *kinematics.rods();
        let mut moved = 0.0_f64;
        for i in 0..LIMBS {
            lengths[i] += compliance[i] * share[i];
            moved = moved.max((lengths[i] - current.rods()[i]).abs());
        }
        current = current.with_rods(lengths);
        if moved <= TOLERANCE_MM {
            return Ok(current);
        }
    }
    Err(Error::NotConverged {
        iterations: ITERATIONS,
    })
}

/// Newton on six rods from the parallel platform.
fn six_rods(
    kinematics: &Kinematics,
    extras: &Extras,
    joints: &Vector3<f64>,
    start: &Vector3<f64>,
) -> Result<(Vector3<f64>, Tilted)> {
    let centres = kinematics.sphere_centres(joints);
    let mut centre = *start;
    let mut turn = Rotation3::identity();
    for _ in 0..ITERATIONS {
        let mut system = [[0.0; 6]; 6];
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
                let (v, t) = (rod.vector, lever.cross(&rod.vector));
                system[row] = [v.x, v.y, v.z, t.x, t.y, t.z];
                miss[row] = 0.5 * (rod.length * rod.length - rod.vector.norm_squared());
            }
        }
        let worst = miss.amax();
        let Inverse { rows, weakest } = inverse(system).ok_or(Error::Singular)?;
        if weakest <= SINGULAR || !worst.is_finite() {
            return Err(Error::Singular);
        }
        let inverse = Matrix6::from(rows).transpose();
        if worst <= TOLERANCE_MM * sqrt(rods[0][0].vector.norm_squared()) {
            for (limb, pair) in rods.iter_mut().enumerate() {
                for (k, rod) in pair.iter_mut().enumerate() {
                    let column = inverse.column(2 * limb + k);
                    rod.centre = column.fixed_rows::<3>(0).into_owned();
                    rod.turn = column.fixed_rows::<3>(3).into_owned();
                }
            }
            let arm = turn * extras.target;
            return Ok((centre, Tilted { rods, turn, arm }));
        }
        let step = inverse * miss;
        centre += step.fixed_rows::<3>(0);
        turn = Rotation3::from_scaled_axis(step.fixed_rows::<3>(3).into_owned()) * turn;
    }
    Err(Error::NotConverged {
        iterations: ITERATIONS,
    })
}
