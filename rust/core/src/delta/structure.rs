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

use super::effects::{AT, PARAMETERS, Values};
use super::geometry::{Geometry, IDENTIFIABLE, LIMBS, PER_LIMB};
use super::kinematics::{Drawn, Growth, Kinematics};
use super::nominal::Model;
use super::pose::Poses;
use super::six_rods::{Pairs, SIDES, mismatched, one_step, twisted};
use super::solved::{Extras, Solved};
use crate::Result;
use crate::chain::body::warmer;
use crate::chain::effects::{Wanted, values_of};
use crate::chain::{Columns, Covariates, Mechanism};
use crate::numbers::math::{Real, Triple, add, scale, sin_cos};
use nalgebra::{Matrix3, Rotation3, SMatrix, Vector3};

/// How far a rail is drawn above and below the height about which it leans, by the length of its limb's rods.
const RAIL_BY_ROD: f64 = 0.75;

/// The delta with given errors: what joins its joints to the measured point.
#[derive(Clone, Copy, Debug)]
pub struct Structure {
    kinematics: Kinematics,
    extras: Extras,
    /// Growth of rods, frame and rails, 1/°C, of these lengths.
    growth: [f64; 3],
    drawn: Drawn,
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
