//! The solved structure, and how its point answers to a movement of the end of a rod, a longer one, a turned rail.
//!
//! Every parameter acts by moving the ends of rods or lengthening them. With rods as rows of `A` and `g_k` the columns of
//! `A⁻¹` a parallel platform moves by `Σ g_k (ρ_k·dv_k + L_k dL_k)`, a tilted one by the inverse of its six rods. Loads
//! `y` answer to that by `dy = Φ + B dy`, with `Φ` what the movement alone makes of them and `B` what loads make of loads.

use super::geometry::LIMBS;
use super::kinematics::{Growth, Kinematics};
use super::pose::answers;
use super::six_rods::{Motion, Pairs, Rod, Tilted, six_rods};
use crate::numbers::inverse::{Inverse, inverse};
use crate::{Error, Result};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

const ITERATIONS: usize = 60;
/// Loads are settled when none changes by more than this, mm.
const TOLERANCE_MM: f64 = 1e-12;
/// Pivot ratio below which loads run away.
const SINGULAR: f64 = 1e-12;

/// What of the structure is not in [`Kinematics`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Extras {
    /// From the platform centre to the measured point, platform frame, mm.
    pub(super) target: Vector3<f64>,
    pub(super) pairs: Pairs,
    /// Stretch of a limb under the whole weight, mm.
    pub(super) stretch: [f64; LIMBS],
    /// How far a carriage gives way under the whole weight, mm.
    pub(super) yielding: [f64; LIMBS],
}

impl Extras {
    /// Whether nothing gives way under the weight.
    pub(super) fn is_stiff(&self) -> bool {
        self.stretch == [0.0; LIMBS] && self.yielding == [0.0; LIMBS]
    }
}

/// What the weight does: by how much each carriage gives way and each limb stretches, mm.
type Loads = Vector6<f64>;

/// How the loads answer to a small change.
#[derive(Clone, Copy, Debug)]
pub(super) struct Loaded {
    /// Pull of each limb by its length, `w`, of a unit weight.
    pub(super) pulls: Vector3<f64>,
    pub(super) rails: [Vector3<f64>; LIMBS],
    pub(super) stretch: [f64; LIMBS],
    pub(super) yielding: [f64; LIMBS],
    /// `(I - B)⁻¹`.
    pub(super) answer: Matrix6<f64>,
}

/// The solved structure.
#[derive(Clone, Copy, Debug)]
pub struct Solved {
    /// Measured point, base frame, mm.
    pub(super) point: Vector3<f64>,
    /// Joints as the carriages stand, mm.
    pub(super) joints: Vector3<f64>,
    /// From each carriage to the middle of its joint on the platform.
    pub(super) rods: [Vector3<f64>; LIMBS],
    /// Columns `g_i` of the inverse of these rods.
    pub(super) answers: Matrix3<f64>,
    pub(super) lengths: [f64; LIMBS],
    /// From the centre of the platform to its joints, and to the measured point, base frame.
    pub(super) levers: [Vector3<f64>; LIMBS],
    pub(super) arm: Vector3<f64>,
    /// From the centre of the parallel platform to that of the tilted one.
    pub(super) beside: Vector3<f64>,
    pub(super) tilted: Option<Tilted>,
    pub(super) loaded: Option<Loaded>,
    /// By how much it is warmer than the drawing, °C, and what has grown by that.
    pub(super) warmer: f64,
    pub(super) grown: Option<Growth>,
}

impl Solved {
    #[inline]
    pub(super) fn of(
        kinematics: &Kinematics,
        extras: &Extras,
        joints: &Vector3<f64>,
    ) -> Result<Self> {
        if extras.is_stiff() {
            return Self::unloaded(kinematics, extras, joints);
        }
        let mut loads = Loads::zeros();
        for _ in 0..ITERATIONS {
            let (give, longer) = (loads.fixed_rows::<3>(0), loads.fixed_rows::<3>(3));
            let lengths = Vector3::from(*kinematics.rods()) + longer;
            let loaded = kinematics.with_rods(lengths.into());
            let mut solved = Self::unloaded(&loaded, extras, &(joints + give))?;
            let next = solved.loads(kinematics, extras);
            let moved = (next - loads).amax();
            if moved <= TOLERANCE_MM {
                solved.load(kinematics, extras)?;
                return Ok(solved);
            }
            loads = next;
        }
        Err(Error::NotConverged {
            iterations: ITERATIONS,
        })
    }

    #[inline]
    pub(super) fn unloaded(
        kinematics: &Kinematics,
        extras: &Extras,
        joints: &Vector3<f64>,
    ) -> Result<Self> {
        let mut solved = Self::parallel(kinematics, extras, joints)?;
        if !extras.pairs.are_parallel() {
            let start = solved.point - solved.arm;
            let (centre, tilted) = six_rods(kinematics, &extras.pairs, joints, &start)?;
            solved.tilt(kinematics, extras, &centre, &tilted)?;
        }
        Ok(solved)
    }

    /// The platform as if nothing tilted it.
    #[inline]
    pub(super) fn parallel(
        kinematics: &Kinematics,
        extras: &Extras,
        joints: &Vector3<f64>,
    ) -> Result<Self> {
        let pose = kinematics.pose(joints)?;
        Ok(Self {
            point: pose.position + extras.target,
            joints: *joints,
            rods: *pose.rods(),
            answers: *pose.answers(),
            lengths: *kinematics.rods(),
            levers: [0, 1, 2].map(|limb| kinematics.platform_joint(limb)),
            arm: extras.target,
            beside: Vector3::zeros(),
            tilted: None,
            loaded: None,
            warmer: f64::NAN,
            grown: None,
        })
    }

    /// Takes the place of a tilted platform.
    pub(super) fn tilt(
        &mut self,
        kinematics: &Kinematics,
        extras: &Extras,
        centre: &Vector3<f64>,
        tilted: &Tilted,
    ) -> Result<()> {
        self.beside = centre - (self.point - self.arm);
        let rods = &tilted.rods;
        self.rods = [0, 1, 2].map(|k| (rods[k][0].vector + rods[k][1].vector) * 0.5);
        self.answers = answers(&self.rods)?;
        self.levers = [0, 1, 2].map(|limb| tilted.turn * kinematics.platform_joint(limb));
        self.arm = tilted.turn * extras.target;
        self.point = centre + self.arm;
        self.tilted = Some(*tilted);
        Ok(())
    }

    /// Pull of each limb by its length: `Σ w_i μ_i = -ẑ`.
    pub(super) fn pulls(&self) -> Vector3<f64> {
        -self.answers.row(2).transpose()
    }

    pub(super) fn loads(&self, kinematics: &Kinematics, extras: &Extras) -> Loads {
        let (w, rails) = (self.pulls(), kinematics.rails());
        let give = |i: usize| extras.yielding[i] * w[i] * self.rods[i].dot(&rails[i]);
        let longer = |i: usize| extras.stretch[i] * w[i] * self.rods[i].norm();
        Loads::new(give(0), give(1), give(2), longer(0), longer(1), longer(2))
    }

    /// Keeps what the derivatives under load need.
    pub(super) fn load(&mut self, kinematics: &Kinematics, extras: &Extras) -> Result<()> {
        let mut loaded = Loaded {
            pulls: self.pulls(),
            rails: *kinematics.rails(),
            stretch: extras.stretch,
            yielding: extras.yielding,
            answer: Matrix6::identity(),
        };
        let still = Vector3::zeros();
        let mut transposed = [[0.0; 2 * LIMBS]; 2 * LIMBS];
        for limb in 0..LIMBS {
            let rail = loaded.rails[limb];
            let by_give = loaded.made(self, &self.by_end(limb, &rail), limb, &rail, &still);
            let by_longer = loaded.made(self, &self.by_longer(limb), limb, &still, &still);
            for (k, made) in [(limb, by_give), (LIMBS + limb, by_longer)] {
                transposed[k] = (-made).into();
                transposed[k][k] += 1.0;
            }
        }
        let Inverse { rows, weakest } = inverse(transposed).ok_or(Error::Singular)?;
        if weakest <= SINGULAR {
            return Err(Error::Singular);
        }
        // rows of the inverse of a transposed matrix are the columns of its inverse, as nalgebra reads them
        loaded.answer = Matrix6::from(rows);
        self.loaded = Some(loaded);
        Ok(())
    }

    /// Motion of the platform by a movement of the carriage end of a limb, loads held. This and what calls it is inlined,
    /// so that the limb is known to be one of three and no index is left to be checked.
    #[inline(always)]
    pub(super) fn by_end(&self, limb: usize, end: &Vector3<f64>) -> Motion {
        match &self.tilted {
            None => Motion {
                centre: self.answers.column(limb) * self.rods[limb].dot(end),
                turn: Vector3::zeros(),
            },
            Some(tilted) => tilted.by_gains(limb, |rod, _| rod.vector.dot(end)),
        }
    }

    /// Motion of the platform by the length of the rods of a limb, loads held.
    #[inline(always)]
    pub(super) fn by_longer(&self, limb: usize) -> Motion {
        match &self.tilted {
            None => Motion {
                centre: self.answers.column(limb) * self.lengths[limb],
                turn: Vector3::zeros(),
            },
            Some(tilted) => tilted.by_gains(limb, |rod, _| rod.length),
        }
    }

    /// What a motion of the platform does to the measured point.
    pub(super) fn shown(&self, motion: &Motion) -> Vector3<f64> {
        motion.centre + motion.turn.cross(&self.arm)
    }

    /// What a motion does to the measured point with the loads that it makes; `end` and `rail` are those of a limb whose
    /// carriage moved by them.
    #[inline(always)]
    pub(super) fn settled(
        &self,
        motion: &Motion,
        limb: usize,
        end: &Vector3<f64>,
        rail: &Vector3<f64>,
    ) -> Vector3<f64> {
        self.shown(motion)
            + self.loaded.map_or(Vector3::zeros(), |loaded| {
                let made = loaded.made(self, motion, limb, end, rail);
                self.by_loads(&loaded, &(loaded.answer * made))
            })
    }

    /// What loads do to the measured point.
    #[inline(always)]
    pub(super) fn by_loads(&self, loaded: &Loaded, loads: &Loads) -> Vector3<f64> {
        let mut motion = Motion::default();
        for limb in 0..LIMBS {
            motion.add(&self.by_end(limb, &loaded.rails[limb]), loads[limb]);
            motion.add(&self.by_longer(limb), loads[LIMBS + limb]);
        }
        self.shown(&motion)
    }

    /// Derivative of the measured point by a movement of the carriage end of a limb and of the direction of its rail.
    #[inline(always)]
    pub(super) fn by_carriage(
        &self,
        limb: usize,
        end: &Vector3<f64>,
        rail: &Vector3<f64>,
    ) -> Vector3<f64> {
        if self.tilted.is_none() && self.loaded.is_none() {
            return self.answers.column(limb) * self.rods[limb].dot(end);
        }
        self.settled(&self.by_end(limb, end), limb, end, rail)
    }

    /// Derivative by a movement of the sphere centre of a limb that its platform end makes, given in the platform frame.
    #[inline(always)]
    pub(super) fn by_platform(&self, limb: usize, centre: &Vector3<f64>) -> Vector3<f64> {
        let end = match &self.tilted {
            None => *centre,
            Some(tilted) => tilted.turn * centre,
        };
        self.by_carriage(limb, &end, &Vector3::zeros())
    }

    /// Derivative by the length of the rods of a limb.
    #[inline(always)]
    pub(super) fn by_length(&self, limb: usize) -> Vector3<f64> {
        let still = Vector3::zeros();
        self.settled(&self.by_longer(limb), limb, &still, &still)
    }

    /// Derivative by the compliance of a limb along itself.
    #[inline(always)]
    pub(super) fn by_stretch(&self, limb: usize) -> Vector3<f64> {
        let longer = self.pulls()[limb] * self.rods[limb].norm();
        match &self.loaded {
            None => self.shown(&self.by_longer(limb)) * longer,
            Some(loaded) => self.by_loads(loaded, &(loaded.answer.column(LIMBS + limb) * longer)),
        }
    }

    /// Derivative by the compliance of a carriage along its rail.
    #[inline(always)]
    pub(super) fn by_yielding(&self, limb: usize, rail: &Vector3<f64>) -> Vector3<f64> {
        let give = self.pulls()[limb] * self.rods[limb].dot(rail);
        match &self.loaded {
            None => self.shown(&self.by_end(limb, rail)) * give,
            Some(loaded) => self.by_loads(loaded, &(loaded.answer.column(limb) * give)),
        }
    }

    /// Derivative by what lengthens the rod on the positive side of a limb by `gain` (times its length) and shortens the
    /// other, one column a limb.
    pub(super) fn by_rods(
        &self,
        pairs: &Pairs,
        gain: impl Fn(&Pairs, usize, &Vector3<f64>, f64) -> f64,
    ) -> Matrix3<f64> {
        let still = Vector3::zeros();
        let column = |limb: usize, motion: Motion| self.settled(&motion, limb, &still, &still);
        if let Some(tilted) = &self.tilted {
            let motion = |limb| {
                let one = |rod: &Rod, side| side * gain(pairs, limb, &rod.vector, rod.length);
                column(limb, tilted.by_gains(limb, one))
            };
            return Matrix3::from_columns(&[motion(0), motion(1), motion(2)]);
        }
        // around the parallel platform the two rods of a limb differ only by a turn, `(pair × ρ_i)·dw = gain`, and the
        // centre follows
        let row = |i: usize| pairs.half_platform[i].cross(&self.rods[i]).transpose();
        let Some(turn) = Matrix3::from_rows(&[row(0), row(1), row(2)]).try_inverse() else {
            return Matrix3::zeros(); // rods without a distance between them cannot tilt the platform
        };
        let motion = |limb: usize| {
            let gain = gain(pairs, limb, &self.rods[limb], self.lengths[limb]);
            let turn: Vector3<f64> = turn.column(limb) * gain;
            let mut centre = Vector3::zeros();
            for k in 0..LIMBS {
                let moved = turn.cross(&self.levers[k]);
                centre -= self.answers.column(k) * self.rods[k].dot(&moved);
            }
            column(limb, Motion { centre, turn })
        };
        Matrix3::from_columns(&[motion(0), motion(1), motion(2)])
    }
}

impl Loaded {
    /// What a motion makes of the loads where these are held meanwhile.
    #[inline(always)]
    pub(super) fn made(
        &self,
        solved: &Solved,
        motion: &Motion,
        limb: usize,
        end: &Vector3<f64>,
        rail: &Vector3<f64>,
    ) -> Loads {
        let mut moved = solved.levers.map(|l| motion.centre + motion.turn.cross(&l));
        for (i, moved) in moved.iter_mut().enumerate() {
            if i == limb {
                *moved -= end;
            }
        }
        // Σ dw_i μ_i + Σ w_i dμ_i = 0
        let w = &self.pulls;
        let turned = moved[0] * w[0] + moved[1] * w[1] + moved[2] * w[2];
        let mut made = Loads::zeros();
        for i in 0..LIMBS {
            let (rod, more) = (&solved.rods[i], -solved.answers.column(i).dot(&turned));
            let mut along = moved[i].dot(&self.rails[i]);
            if i == limb {
                along += rod.dot(rail);
            }
            let length = rod.norm();
            made[i] = self.yielding[i] * (more * rod.dot(&self.rails[i]) + w[i] * along);
            let longer = more * length + w[i] * rod.dot(&moved[i]) / length;
            made[LIMBS + i] = self.stretch[i] * longer;
        }
        made
    }
}
