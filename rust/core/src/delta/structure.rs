//! The structure link: from carriages to the measured point, and how that answers to any small change.
//!
//! With equal rods and parallel joint axes the platform stays parallel and three spheres fix it. Where the two rods of a
//! limb differ, or the axis at its carriage is turned against that at the platform, the platform also tilts: then all six
//! rods `|x + R a - c|² = L²` are solved by Newton's method.
//!
//! Under the platform's weight limb i pulls with `w_i |μ_i|` times that weight, where `μ_i` joins its carriage to the
//! middle of its joint on the platform and `Σ w_i μ_i = -ẑ` (force balance). Its rods are longer by `c_i w_i |μ_i|`, and
//! its carriage gives way along its rail `r_i` by `d_i w_i (μ_i·r_i)`. Loads and pose are brought to agree.
//!
//! Rods, frame and rails grow with the temperature, each by its own part of what is drawn: lengths, radii and heights
//! above the base. Where all parts are equal the whole robot is only larger.
//!
//! Every parameter acts by moving the ends of rods or lengthening them. With rods as rows of `A` and `g_k` the columns of
//! `A⁻¹` a parallel platform moves by `Σ g_k (ρ_k·dv_k + L_k dL_k)`, a tilted one by the inverse of its six rods. Loads
//! `y` answer to that by `dy = Φ + B dy`, with `Φ` what the movement alone makes of them and `B` what loads make of loads.

use super::effects::{AT, PARAMETERS, Values};
use super::geometry::{Geometry, IDENTIFIABLE, LIMBS, PER_LIMB};
use super::kinematics::{Drawn, Growth, Kinematics, Poses, answers};
use super::nominal::Model;
use super::six_rods::{Motion, Pairs, Rod, SIDES, Tilted, mismatched, one_step, six_rods, twisted};
use crate::chain::body::warmer;
use crate::chain::effects::{Wanted, values_of};
use crate::chain::{Columns, Covariates, Mechanism};
use crate::numbers::inverse::{Inverse, inverse};
use crate::numbers::math::{Real, Triple, add, scale, sin_cos};
use crate::{Error, Result};
use nalgebra::{Matrix3, Matrix6, Rotation3, SMatrix, Vector3, Vector6};

const ITERATIONS: usize = 60;
/// How far a rail is drawn above and below the height about which it leans, by the length of its limb's rods.
const RAIL_BY_ROD: f64 = 0.75;
/// Loads are settled when none changes by more than this, mm.
const TOLERANCE_MM: f64 = 1e-12;
/// Pivot ratio below which loads run away.
const SINGULAR: f64 = 1e-12;

/// The delta with given errors: what joins its joints to the measured point.
#[derive(Clone, Copy, Debug)]
pub struct Structure {
    kinematics: Kinematics,
    extras: Extras,
    /// Growth of rods, frame and rails, 1/°C, of these lengths.
    growth: [f64; 3],
    drawn: Drawn,
}

/// What of the structure is not in [`Kinematics`].
#[derive(Clone, Copy, Debug)]
struct Extras {
    /// From the platform centre to the measured point, platform frame, mm.
    target: Vector3<f64>,
    pairs: Pairs,
    /// Stretch of a limb under the whole weight, mm.
    stretch: [f64; LIMBS],
    /// How far a carriage gives way under the whole weight, mm.
    yielding: [f64; LIMBS],
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
        let twist: [f64; LIMBS] = values_of(at.limb_twist, values);
        let half = 0.5 * model.rod_spacing;
        let pair = |limb: usize, turned: f64| {
            // the drawing says how the axes lie: errors of the angles move joints, and twist alone turns an axis
            let (sin, cos) = sin_cos(model.geometry.limbs[limb].platform_angle_rad + turned);
            Vector3::new(-sin * half, cos * half, 0.0)
        };
        Ok(Self {
            kinematics: Kinematics::leaning(&geometry, lean, model.home)?,
            extras: Extras {
                target: model.target_offset,
                pairs: Pairs {
                    half_platform: [pair(0, 0.0), pair(1, 0.0), pair(2, 0.0)],
                    half_carriage: [pair(0, twist[0]), pair(1, twist[1]), pair(2, twist[2])],
                    mismatch: values_of(at.rod_mismatch, values),
                    twist,
                },
                stretch: values_of(at.gravity_sag, values),
                yielding: values_of(at.drive_compliance, values),
            },
            growth: values_of(at.link_growth, values),
            drawn: Drawn::new(&model.geometry),
        })
    }

    /// By what parts have grown, where any has: an effect at zero does not ask for its covariate.
    #[inline]
    fn grown(&self, row: &Covariates<LIMBS>) -> Option<Growth> {
        if self.growth == [0.0; 3] {
            return None;
        }
        let [rods, frame, rails] = self
            .growth
            .map(|a| if a == 0.0 { 0.0 } else { a * warmer(row) });
        Some(Growth { rods, frame, rails })
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
    type Many<T: Real> = Poses<T>;

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
        if self.extras.pairs.are_parallel() && self.extras.is_stiff() {
            return Ok(self.kinematics.forward(joints)? + self.extras.target);
        }
        Ok(self.solve(joints)?.point)
    }

    #[inline]
    fn solve_at(&self, joints: &Vector3<f64>, row: &Covariates<LIMBS>) -> Result<Solved> {
        let mut solved = match self.grown(row) {
            None => self.solve(joints)?,
            Some(grown) => {
                let larger = self.kinematics.grown(&self.drawn, &grown);
                let longer = joints * (1.0 + grown.rails);
                let mut solved = Solved::of(&larger, &self.extras, &longer)?;
                solved.grown = Some(grown);
                solved
            }
        };
        solved.warmer = warmer(row);
        Ok(solved)
    }

    #[inline]
    fn target_at(
        &self,
        joints: &Vector3<f64>,
        row: &Covariates<LIMBS>,
        _: usize,
    ) -> Result<Vector3<f64>> {
        if self.growth == [0.0; 3] {
            return self.point_at(joints);
        }
        Ok(self.solve_at(joints, row)?.point)
    }

    #[inline]
    fn solve_near(
        &self,
        joints: &Vector3<f64>,
        row: &Covariates<LIMBS>,
        near: &mut Option<Solved>,
    ) -> Result<bool> {
        let (kinematics, extras) = (&self.kinematics, &self.extras);
        if self.growth != [0.0; 3] {
            *near = Some(self.solve_at(joints, row)?);
            return Ok(true);
        }
        if extras.pairs.are_parallel() || !extras.is_stiff() {
            *near = Some(self.solve(joints)?);
            return Ok(true);
        }
        // the platform stands beside the parallel one as it did nearby
        let (beside, turn) = match near {
            Some(Solved {
                beside,
                tilted: Some(tilted),
                ..
            }) => (*beside, tilted.turn),
            _ => (Vector3::zeros(), Rotation3::identity()),
        };
        let solved = near.insert(Solved::parallel(kinematics, extras, joints)?);
        let parallel = solved.point - solved.arm;
        let (centre, tilted, settled) = one_step(
            kinematics,
            &extras.pairs,
            joints,
            (&(parallel + beside), &turn),
        )?;
        solved.tilt(kinematics, extras, &centre, &tilted)?;
        Ok(settled)
    }

    /// Limb by limb the foot and the head of its rail, the ends of its rods at the carriage, the same at the platform; then
    /// the platform's centre and the measured point.
    fn parts(&self, solved: &Solved, put: &mut impl FnMut(Vector3<f64>)) {
        let (k, pairs) = (&self.kinematics, &self.extras.pairs);
        let centre = solved.point - solved.arm;
        for limb in 0..LIMBS {
            let on_platform = centre + solved.levers[limb];
            let carriage = on_platform - solved.rods[limb];
            let (rail, reach) = (k.rails()[limb], RAIL_BY_ROD * k.rods()[limb]);
            let pivot = carriage - rail * k.height(limb, solved.joints[limb]);
            put(pivot - rail * reach);
            put(pivot + rail * reach);
            for side in SIDES {
                put(carriage + pairs.half_carriage[limb] * side);
            }
            let half = solved.tilted.map_or(pairs.half_platform[limb], |t| {
                t.turn * pairs.half_platform[limb]
            });
            for side in SIDES {
                put(on_platform + half * side);
            }
        }
        put(centre);
        put(solved.point);
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
        let (at, still) = (AT.structure, Vector3::zeros());
        let larger;
        let (kinematics, scale) = match &solved.grown {
            None => (&self.kinematics, 1.0),
            Some(grown) => {
                larger = self.kinematics.grown(&self.drawn, grown);
                (&larger, 1.0 + grown.rails)
            }
        };
        if let Some(place) = wanted.wants(at.rod_mismatch) {
            let columns = by_point * solved.by_rods(&self.extras.pairs, mismatched);
            d.fixed_columns_mut::<LIMBS>(place.start)
                .copy_from(&columns);
        }
        if let Some(place) = wanted.wants(at.limb_twist) {
            let columns = by_point * solved.by_rods(&self.extras.pairs, twisted);
            d.fixed_columns_mut::<LIMBS>(place.start)
                .copy_from(&columns);
        }
        let limbs = [at.limb_1, at.limb_2, at.limb_3];
        let platforms = [at.platform_1, at.platform_2, at.platform_3];
        let mut by_joints = SMatrix::<f64, M, LIMBS>::zeros();
        for limb in 0..LIMBS {
            let joint = solved.joints[limb];
            let by = kinematics.by_limb(limb, joint);
            let by_joint = by_point * solved.by_carriage(limb, &by.joint, &still);
            by_joints.set_column(limb, &(by_joint * scale));
            if wanted.wants(limbs[limb]).is_some() {
                let first = limb * PER_LIMB;
                let radius = solved.by_carriage(limb, &by.base_radius, &still);
                let angle = solved.by_carriage(limb, &by.base_angle, &by.rail_by_angle);
                d.set_column(first, &(by_point * radius));
                d.set_column(first + 1, &(by_point * angle));
                d.set_column(first + 2, &by_joint);
                d.set_column(first + 3, &(by_point * solved.by_length(limb)));
            }
            if wanted.wants(platforms[limb]).is_some() {
                let first = limb * PER_LIMB + IDENTIFIABLE;
                let radius = solved.by_platform(limb, &by.platform_radius);
                let angle = solved.by_platform(limb, &by.platform_angle);
                d.set_column(first, &(by_point * radius));
                d.set_column(first + 1, &(by_point * angle));
            }
            if let Some(place) = wanted.wants(at.rail_lean) {
                let height = kinematics.height(limb, joint);
                for (k, rail) in kinematics.rail_by_lean(limb).iter().enumerate() {
                    let column = by_point * solved.by_carriage(limb, &(rail * height), rail);
                    d.set_column(place.start + 2 * limb + k, &column);
                }
            }
            if let Some(place) = wanted.wants(at.gravity_sag) {
                let column = by_point * solved.by_stretch(limb);
                d.set_column(place.start + limb, &column);
            }
            if let Some(place) = wanted.wants(at.drive_compliance) {
                let column = by_point * solved.by_yielding(limb, &by.joint);
                d.set_column(place.start + limb, &column);
            }
        }
        if let Some(place) = wanted.wants(at.link_growth) {
            let mut sums = Matrix3::zeros();
            for limb in 0..LIMBS {
                let frame = solved.by_carriage(limb, &self.drawn.base[limb], &still)
                    + solved.by_platform(limb, &-self.drawn.platform[limb]);
                let rails = self.kinematics.by_rails(&self.drawn, limb, joints[limb]);
                let rails = solved.by_carriage(limb, &rails, &still);
                let rods = solved.by_length(limb) * self.drawn.rods[limb];
                sums += Matrix3::from_columns(&[rods, frame, rails]);
            }
            d.fixed_columns_mut::<3>(place.start)
                .copy_from(&(by_point * sums * solved.warmer));
        }
        by_joints
    }

    #[inline(always)]
    fn solve_many<T: Real>(
        &self,
        joints: [T; LIMBS],
        wanted: Wanted,
    ) -> Option<(Triple<T>, T, Poses<T>)> {
        let at = AT.structure;
        // what tilts the platform or loads it is solved by iteration, or its derivatives are; what grows is another robot in
        // each row
        let iterated = [
            at.rod_mismatch,
            at.limb_twist,
            at.gravity_sag,
            at.drive_compliance,
            at.link_growth,
        ];
        let plain =
            self.extras.pairs.are_parallel() && self.extras.is_stiff() && self.growth == [0.0; 3];
        if !plain
            || iterated
                .into_iter()
                .any(|place| wanted.wants(place).is_some())
        {
            return None;
        }
        let poses = self.kinematics.poses(joints);
        let point = add(poses.position, splat(&self.extras.target));
        Some((point, poses.reached, poses))
    }

    #[inline(always)]
    fn columns_many<T: Real>(
        &self,
        joints: [T; LIMBS],
        poses: &Poses<T>,
        wanted: Wanted,
        to: &mut impl Columns<T, LIMBS>,
    ) {
        let at = AT.structure;
        let limbs = [at.limb_1, at.limb_2, at.limb_3];
        let platforms = [at.platform_1, at.platform_2, at.platform_3];
        for limb in 0..LIMBS {
            // where its joint is at zero; what grows with the joint is added
            let by = self.kinematics.by_limb(limb, 0.0);
            if wanted.wants(limbs[limb]).is_some() {
                let first = limb * PER_LIMB;
                let turned = scale(splat(&by.rail_by_angle), joints[limb]);
                to.put(first, poses.by_end(limb, splat(&by.base_radius)));
                to.put(
                    first + 1,
                    poses.by_end(limb, add(splat(&by.base_angle), turned)),
                );
                to.put(first + 2, poses.by_end(limb, splat(&by.joint)));
                to.put(
                    first + 3,
                    scale(poses.answers[limb], T::splat(self.kinematics.rods()[limb])),
                );
            }
            if wanted.wants(platforms[limb]).is_some() {
                let first = limb * PER_LIMB + IDENTIFIABLE;
                to.put(first, poses.by_end(limb, splat(&by.platform_radius)));
                to.put(first + 1, poses.by_end(limb, splat(&by.platform_angle)));
            }
            if let Some(place) = wanted.wants(at.rail_lean) {
                let height = joints[limb] + T::splat(self.kinematics.height(limb, 0.0));
                for (k, rail) in self.kinematics.rail_by_lean(limb).iter().enumerate() {
                    to.put(
                        place.start + 2 * limb + k,
                        poses.by_end(limb, scale(splat(rail), height)),
                    );
                }
            }
        }
    }
}

/// A vector the same everywhere.
#[inline(always)]
fn splat<T: Real>(v: &Vector3<f64>) -> Triple<T> {
    [T::splat(v.x), T::splat(v.y), T::splat(v.z)]
}

impl Extras {
    /// Whether nothing gives way under the weight.
    fn is_stiff(&self) -> bool {
        self.stretch == [0.0; LIMBS] && self.yielding == [0.0; LIMBS]
    }
}

/// What the weight does: by how much each carriage gives way and each limb stretches, mm.
type Loads = Vector6<f64>;

/// How the loads answer to a small change.
#[derive(Clone, Copy, Debug)]
struct Loaded {
    /// Pull of each limb by its length, `w`, of a unit weight.
    pulls: Vector3<f64>,
    rails: [Vector3<f64>; LIMBS],
    stretch: [f64; LIMBS],
    yielding: [f64; LIMBS],
    /// `(I - B)⁻¹`.
    answer: Matrix6<f64>,
}

/// The solved structure.
#[derive(Clone, Copy, Debug)]
pub struct Solved {
    /// Measured point, base frame, mm.
    point: Vector3<f64>,
    /// Joints as the carriages stand, mm.
    joints: Vector3<f64>,
    /// From each carriage to the middle of its joint on the platform.
    rods: [Vector3<f64>; LIMBS],
    /// Columns `g_i` of the inverse of these rods.
    answers: Matrix3<f64>,
    lengths: [f64; LIMBS],
    /// From the centre of the platform to its joints, and to the measured point, base frame.
    levers: [Vector3<f64>; LIMBS],
    arm: Vector3<f64>,
    /// From the centre of the parallel platform to that of the tilted one.
    beside: Vector3<f64>,
    tilted: Option<Tilted>,
    loaded: Option<Loaded>,
    /// By how much it is warmer than the drawing, °C, and what has grown by that.
    warmer: f64,
    grown: Option<Growth>,
}

impl Solved {
    #[inline]
    fn of(kinematics: &Kinematics, extras: &Extras, joints: &Vector3<f64>) -> Result<Self> {
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
    fn unloaded(kinematics: &Kinematics, extras: &Extras, joints: &Vector3<f64>) -> Result<Self> {
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
    fn parallel(kinematics: &Kinematics, extras: &Extras, joints: &Vector3<f64>) -> Result<Self> {
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
    fn tilt(
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
    fn pulls(&self) -> Vector3<f64> {
        -self.answers.row(2).transpose()
    }

    fn loads(&self, kinematics: &Kinematics, extras: &Extras) -> Loads {
        let (w, rails) = (self.pulls(), kinematics.rails());
        let give = |i: usize| extras.yielding[i] * w[i] * self.rods[i].dot(&rails[i]);
        let longer = |i: usize| extras.stretch[i] * w[i] * self.rods[i].norm();
        Loads::new(give(0), give(1), give(2), longer(0), longer(1), longer(2))
    }

    /// Keeps what the derivatives under load need.
    fn load(&mut self, kinematics: &Kinematics, extras: &Extras) -> Result<()> {
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
    fn by_end(&self, limb: usize, end: &Vector3<f64>) -> Motion {
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
    fn by_longer(&self, limb: usize) -> Motion {
        match &self.tilted {
            None => Motion {
                centre: self.answers.column(limb) * self.lengths[limb],
                turn: Vector3::zeros(),
            },
            Some(tilted) => tilted.by_gains(limb, |rod, _| rod.length),
        }
    }

    /// What a motion of the platform does to the measured point.
    fn shown(&self, motion: &Motion) -> Vector3<f64> {
        motion.centre + motion.turn.cross(&self.arm)
    }

    /// What a motion does to the measured point with the loads that it makes; `end` and `rail` are those of a limb whose
    /// carriage moved by them.
    #[inline(always)]
    fn settled(
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
    fn by_loads(&self, loaded: &Loaded, loads: &Loads) -> Vector3<f64> {
        let mut motion = Motion::default();
        for limb in 0..LIMBS {
            motion.add(&self.by_end(limb, &loaded.rails[limb]), loads[limb]);
            motion.add(&self.by_longer(limb), loads[LIMBS + limb]);
        }
        self.shown(&motion)
    }

    /// Derivative of the measured point by a movement of the carriage end of a limb and of the direction of its rail.
    #[inline(always)]
    fn by_carriage(&self, limb: usize, end: &Vector3<f64>, rail: &Vector3<f64>) -> Vector3<f64> {
        if self.tilted.is_none() && self.loaded.is_none() {
            return self.answers.column(limb) * self.rods[limb].dot(end);
        }
        self.settled(&self.by_end(limb, end), limb, end, rail)
    }

    /// Derivative by a movement of the sphere centre of a limb that its platform end makes, given in the platform frame.
    #[inline(always)]
    fn by_platform(&self, limb: usize, centre: &Vector3<f64>) -> Vector3<f64> {
        let end = match &self.tilted {
            None => *centre,
            Some(tilted) => tilted.turn * centre,
        };
        self.by_carriage(limb, &end, &Vector3::zeros())
    }

    /// Derivative by the length of the rods of a limb.
    #[inline(always)]
    fn by_length(&self, limb: usize) -> Vector3<f64> {
        let still = Vector3::zeros();
        self.settled(&self.by_longer(limb), limb, &still, &still)
    }

    /// Derivative by the compliance of a limb along itself.
    #[inline(always)]
    fn by_stretch(&self, limb: usize) -> Vector3<f64> {
        let longer = self.pulls()[limb] * self.rods[limb].norm();
        match &self.loaded {
            None => self.shown(&self.by_longer(limb)) * longer,
            Some(loaded) => self.by_loads(loaded, &(loaded.answer.column(LIMBS + limb) * longer)),
        }
    }

    /// Derivative by the compliance of a carriage along its rail.
    #[inline(always)]
    fn by_yielding(&self, limb: usize, rail: &Vector3<f64>) -> Vector3<f64> {
        let give = self.pulls()[limb] * self.rods[limb].dot(rail);
        match &self.loaded {
            None => self.shown(&self.by_end(limb, rail)) * give,
            Some(loaded) => self.by_loads(loaded, &(loaded.answer.column(limb) * give)),
        }
    }

    /// Derivative by what lengthens the rod on the positive side of a limb by `gain` (times its length) and shortens the
    /// other, one column a limb.
    fn by_rods(
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
    fn made(
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
