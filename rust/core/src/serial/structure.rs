//! The structure link: from the joints to the target, and what the joints do to each other on the way.
//!
//! A joint follows the one before it as drawn and by a share that is its error,
//! `v_i = q_i + f_i q_{i-1} + s_i (q_{i-1} - home)`, and gives way under the weight behind
//! it, `w_i = v_i + y_i T_i(v) + c_i U_i(v)`, with `T` of the arm and `U` of what hangs at its target ([`super::load`]).
//! The links between them grow with the temperature, each by its own part of its length. Then frames follow one another,
//! and every small error moves the target as a joint in its place would.

use super::arm::{JOINTS, Model, TARGETS};
use super::effects::{AT, PARAMETERS, Values};
use super::frames::{self, Link, stand};
use super::load::{Carried, Load};
use crate::Result;
use crate::chain::body::{since, warmer};
use crate::chain::effects::{Place, Wanted, values_of};
use crate::chain::{Covariates, Mechanism};
use crate::numbers::rigid::Rigid;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// The arm with given errors: what joins its joints to the target.
#[derive(Clone, Copy, Debug)]
pub struct Structure {
    links: [Link; JOINTS],
    count: usize,
    /// The targets behind the last joint, mm.
    targets: [Vector3<f64>; TARGETS],
    home: [f64; JOINTS],
    /// Share by which each joint follows the one before it beyond what is drawn, and with that.
    share: [f64; JOINTS],
    follows: [f64; JOINTS],
    /// How far each joint gives way, rad or mm.
    yields: [f64; JOINTS],
    /// The same under a payload, rad/(N·m) or mm/N.
    gives: [f64; JOINTS],
    load: Load,
    /// Growth of the links, 1/°C: of the base, then behind each joint.
    growth: [f64; JOINTS + 1],
    /// By how much the targets slip where they are held, mm, and from which moment on, s.
    slip: Vector3<f64>,
    slip_time_s: f64,
}

/// A solved pose.
#[derive(Clone, Copy, Debug)]
pub struct Solved {
    places: [frames::Place; JOINTS],
    /// The frame behind the last joint.
    flange: Rigid,
    /// Which of the targets is measured.
    target: usize,
    point: Vector3<f64>,
    /// The joints as they follow one another, before they give way.
    coupled: SVector<f64, JOINTS>,
    /// What they carry, where they give way.
    carried: Option<Carried>,
    /// What of it is the payload's, where they give way under that.
    hung: Option<Carried>,
    payload_kg: f64,
    /// By how much it is warmer than the drawing, °C, and the factors by which links have grown.
    warmer: f64,
    grown: [f64; JOINTS + 1],
    /// One once the targets have slipped, zero before.
    slipped: f64,
}

impl Structure {
    /// The mechanism with its errors.
    pub(super) fn new(model: &Model, values: &Values) -> Self {
        let at = AT.structure;
        let shift: [f64; 2 * JOINTS] = values_of(at.joint_shift, values);
        let lean: [f64; 2 * JOINTS] = values_of(at.joint_tilt, values);
        let share: [f64; JOINTS - 1] = values_of(at.joint_coupling, values);
        let two = |of: &[f64; 2 * JOINTS], i: usize| [of[2 * i], of[2 * i + 1]];
        let mut targets = model.targets_mm;
        let others: [f64; 3 * TARGETS - 3] = values_of(at.targets, values);
        let tool: [f64; 3] = values_of(at.tool, values);
        let off = core::iter::once(&tool).chain(others.as_chunks::<3>().0);
        for (target, off) in targets.iter_mut().zip(off) {
            *target += Vector3::from(*off);
        }
        let link = |i: usize| {
            let joint = &model.joints[i];
            Link::new(&joint.fixed, joint.prismatic, two(&shift, i), two(&lean, i))
        };
        let share: [f64; JOINTS] =
            core::array::from_fn(|i| if i == 0 { 0.0 } else { share[i - 1] });
        Self {
            links: core::array::from_fn(link),
            count: model.count.min(JOINTS),
            targets,
            home: model.joints.map(|joint| joint.home),
            share,
            follows: core::array::from_fn(|i| model.joints[i].follows + share[i]),
            yields: values_of(at.joint_compliance, values),
            gives: values_of(at.payload_compliance, values),
            load: Load::new(model),
            growth: values_of(at.link_growth, values),
            slip: Vector3::from(values_of::<3, PARAMETERS>(at.slip, values)),
            slip_time_s: model.slip_time_s,
        }
    }

    /// Where a target is held behind the last joint, slipped or not, mm; an effect at zero does not ask for its
    /// covariate.
    fn held(&self, target: usize, slipped: f64) -> Vector3<f64> {
        let [first, ..] = &self.targets;
        let own = self.targets.get(target).unwrap_or(first);
        if self.slip == Vector3::zeros() {
            *own
        } else {
            own + self.slip * slipped
        }
    }

    /// The frame behind the last joint, base frame.
    pub(super) fn flange(solved: &Solved) -> Matrix3<f64> {
        solved.flange.rotation
    }
}

impl Mechanism<JOINTS, PARAMETERS> for Structure {
    type Solved = Solved;
    type Many<T: crate::numbers::math::Real> = ();

    fn solve(&self, joints: &SVector<f64, JOINTS>) -> Result<Solved> {
        self.solve_at(joints, &Covariates::NONE)
    }

    fn solve_at(&self, joints: &SVector<f64, JOINTS>, row: &Covariates<JOINTS>) -> Result<Solved> {
        let mut coupled = *joints;
        for i in 1..self.count.min(JOINTS) {
            coupled[i] += self.follows[i] * joints[i - 1] - self.share[i] * self.home[i - 1];
        }
        let (mut values, mut carried) = (coupled, None);
        if self.yields.iter().any(|y| *y != 0.0) {
            let found = self.load.carried(&coupled);
            for i in 0..self.count.min(JOINTS) {
                values[i] += self.yields[i] * found.0[i];
            }
            carried = Some(found);
        }
        let mut hung = None;
        // an effect at zero does not ask for its covariate
        if self.gives.iter().any(|c| *c != 0.0) {
            let found = self.load.hung(&coupled, row.payload_kg);
            for i in 0..self.count.min(JOINTS) {
                values[i] += self.gives[i] * found.0[i];
            }
            hung = Some(found);
        }
        let warmer = warmer(row);
        let grown = self
            .growth
            .map(|a| if a == 0.0 { 1.0 } else { 1.0 + a * warmer });
        let [between @ .., _] = &grown;
        let (places, flange) = stand(&self.links, self.count, values.as_ref(), between);
        let slipped = since(row.time_s, self.slip_time_s);
        let point = flange.apply(&(self.held(0, slipped) * grown[self.count.min(JOINTS)]));
        Ok(Solved {
            places,
            flange,
            target: 0,
            point,
            coupled,
            carried,
            hung,
            payload_kg: row.payload_kg,
            warmer,
            grown,
            slipped,
        })
    }

    fn aimed(&self, solved: Solved, target: usize) -> Solved {
        match self.targets.get(target) {
            Some(_) if target > 0 => {
                let held = self.held(target, solved.slipped) * solved.grown[self.count.min(JOINTS)];
                Solved {
                    target,
                    point: solved.flange.apply(&held),
                    ..solved
                }
            }
            _ => solved,
        }
    }

    fn target_at(
        &self,
        joints: &SVector<f64, JOINTS>,
        row: &Covariates<JOINTS>,
        target: usize,
    ) -> Result<Vector3<f64>> {
        Ok(self.aimed(self.solve_at(joints, row)?, target).point)
    }

    fn point(&self, solved: &Solved) -> Vector3<f64> {
        solved.point
    }

    /// Joint by joint a point of its axis, the same one millimetre along the axis, and where what it carries is; then the
    /// target.
    fn parts(&self, solved: &Solved, put: &mut impl FnMut(Vector3<f64>)) {
        for place in &solved.places[..self.count] {
            put(place.origin);
            put(place.origin + place.axis);
            put(place.behind.translation);
        }
        put(solved.point);
    }

    fn columns<const M: usize>(
        &self,
        joints: &SVector<f64, JOINTS>,
        solved: &Solved,
        by_point: &SMatrix<f64, M, 3>,
        wanted: Wanted,
        d: &mut SMatrix<f64, M, PARAMETERS>,
    ) -> SMatrix<f64, M, JOINTS> {
        let at = AT.structure;
        let (shift, lean) = (wanted.wants(at.joint_shift), wanted.wants(at.joint_tilt));
        let mut by_joints = SMatrix::<f64, M, JOINTS>::zeros();
        for (i, place) in solved.places.iter().enumerate().take(self.count) {
            by_joints.set_column(i, &(by_point * place.moves(&solved.point)));
            if let Some(at) = shift {
                let columns = by_point * place.before.fixed_columns::<2>(0) * solved.grown[i];
                d.fixed_columns_mut::<2>(at.start + 2 * i)
                    .copy_from(&columns);
            }
            if let Some(at) = lean {
                let lever = solved.point - place.origin;
                let about_x: Vector3<f64> = place.before.column(0).into();
                for (k, axis) in [about_x, place.lean_y].iter().enumerate() {
                    d.set_column(at.start + 2 * i + k, &(by_point * axis.cross(&lever)));
                }
            }
        }
        let last = self.count.min(JOINTS);
        let end = solved.grown[last];
        if let Some(at) = wanted.wants(at.link_growth) {
            let held = self.held(solved.target, solved.slipped);
            for i in 0..=last {
                let place = solved.places.get(i).filter(|_| i < last);
                let reach = place.map_or_else(|| Self::flange(solved) * held, |p| p.reach);
                d.set_column(at.start + i, &(by_point * reach * solved.warmer));
            }
        }
        // a row shows one target: what an earlier row left in the columns of the others is cleared
        let first = wanted.wants(at.tool).map(|at| (at.start, 0));
        let others = wanted.wants(at.targets);
        let others = others.map(|at| (1..TARGETS).map(move |k| (at.start + 3 * (k - 1), k)));
        for (start, target) in first.into_iter().chain(others.into_iter().flatten()) {
            let mut own = d.fixed_columns_mut::<3>(start);
            if target == solved.target {
                own.copy_from(&(by_point * Self::flange(solved) * end));
            } else {
                own.fill(0.0);
            }
        }
        if let Some(at) = wanted.wants(at.slip) {
            d.fixed_columns_mut::<3>(at.start)
                .copy_from(&(by_point * Self::flange(solved) * end * solved.slipped));
        }
        let rigid = by_joints;
        let asked = wanted.wants(at.joint_compliance);
        if solved.carried.is_some() || asked.is_some() {
            let found = solved.carried;
            let found = found.unwrap_or_else(|| self.load.carried(&solved.coupled));
            give_way(last, &found, &self.yields, asked, &rigid, &mut by_joints, d);
        }
        let asked = wanted.wants(at.payload_compliance);
        if solved.hung.is_some() || asked.is_some() {
            let found = solved.hung;
            let found = found.unwrap_or_else(|| self.load.hung(&solved.coupled, solved.payload_kg));
            give_way(last, &found, &self.gives, asked, &rigid, &mut by_joints, d);
        }
        // each joint also moves the one that follows it
        let apart = by_joints;
        for i in 1..self.count.min(JOINTS) {
            if let Some(at) = wanted.wants(at.joint_coupling) {
                let travel = joints[i - 1] - self.home[i - 1];
                d.set_column(at.start + i - 1, &(apart.column(i) * travel));
            }
            by_joints.set_column(
                i - 1,
                &(apart.column(i - 1) + apart.column(i) * self.follows[i]),
            );
        }
        by_joints
    }
}

/// The columns of joints that give way under what they carry, and what that changes in how the target moves with them.
/// Inlined, so that the places of the columns are numbers which the compiler knows.
#[inline(always)]
fn give_way<const M: usize>(
    count: usize,
    (load, by): &Carried,
    gives: &[f64; JOINTS],
    asked: Option<Place>,
    rigid: &SMatrix<f64, M, JOINTS>,
    by_joints: &mut SMatrix<f64, M, JOINTS>,
    d: &mut SMatrix<f64, M, PARAMETERS>,
) {
    for i in 0..count.min(JOINTS) {
        let by_joint = rigid.column(i);
        if let Some(at) = asked {
            d.set_column(at.start + i, &(by_joint * load[i]));
        }
        // what is not known does nothing where nothing gives way
        if gives[i] != 0.0 {
            *by_joints += by_joint * by.row(i) * gives[i];
        }
    }
}
