//! The structure link: from the joints to the target, and what the joints do to each other on the way.
//!
//! A joint follows the one before it by a share, `v_i = q_i + s_i (q_{i-1} - home)`, and gives way under the weight behind
//! it, `w_i = v_i + y_i T_i(v)`, with `T` of [`super::load`]. Then frames follow one another, and every small error moves
//! the target as a joint in its place would.

use super::effects::{AT, PARAMETERS, Values};
use super::frames::{Link, Place, stand};
use super::load::{Carried, Load};
use super::model::{JOINTS, Model};
use crate::Result;
use crate::chain::Mechanism;
use crate::chain::effects::{Wanted, values_of};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// The arm with given errors: what joins its joints to the target.
#[derive(Clone, Copy, Debug)]
pub struct Structure {
    links: [Link; JOINTS],
    count: usize,
    /// The target behind the last joint, mm.
    tool: Vector3<f64>,
    home: [f64; JOINTS],
    /// Share by which each joint follows the one before it.
    follows: [f64; JOINTS],
    /// How far each joint gives way, rad or mm.
    yields: [f64; JOINTS],
    load: Load,
}

/// A solved pose.
#[derive(Clone, Copy, Debug)]
pub struct Solved {
    places: [Place; JOINTS],
    point: Vector3<f64>,
    /// The joints as they follow one another, before they give way.
    coupled: SVector<f64, JOINTS>,
    /// What they carry, where they give way.
    carried: Option<Carried>,
}

impl Structure {
    /// The mechanism with its errors.
    pub(super) fn new(model: &Model, values: &Values) -> Self {
        let at = AT.structure;
        let shift: [f64; 2 * JOINTS] = values_of(at.joint_shift, values);
        let lean: [f64; 2 * JOINTS] = values_of(at.joint_tilt, values);
        let share: [f64; JOINTS - 1] = values_of(at.joint_coupling, values);
        let two = |of: &[f64; 2 * JOINTS], i: usize| [of[2 * i], of[2 * i + 1]];
        let link = |i: usize| {
            let joint = &model.joints[i];
            Link::new(&joint.fixed, joint.prismatic, two(&shift, i), two(&lean, i))
        };
        let follows = |i: usize| if i == 0 { 0.0 } else { share[i - 1] };
        Self {
            links: core::array::from_fn(link),
            count: model.count,
            tool: model.tool_mm + Vector3::from(values_of::<3, PARAMETERS>(at.tool, values)),
            home: model.joints.map(|joint| joint.home),
            follows: core::array::from_fn(follows),
            yields: values_of(at.joint_compliance, values),
            load: Load::new(model),
        }
    }

    /// The frame behind the last joint, base frame.
    pub(super) fn flange(&self, solved: &Solved) -> Matrix3<f64> {
        solved.places[self.count - 1].behind.rotation
    }
}

impl Mechanism<JOINTS, PARAMETERS> for Structure {
    type Solved = Solved;
    type Many<T: crate::numbers::math::Real> = ();

    fn solve(&self, joints: &SVector<f64, JOINTS>) -> Result<Solved> {
        let mut coupled = *joints;
        for i in 1..self.count {
            coupled[i] += self.follows[i] * (joints[i - 1] - self.home[i - 1]);
        }
        let (mut values, mut carried) = (coupled, None);
        if self.yields.iter().any(|y| *y != 0.0) {
            let found = self.load.carried(&coupled);
            for i in 0..self.count {
                values[i] += self.yields[i] * found.0[i];
            }
            carried = Some(found);
        }
        let places = stand(&self.links[..self.count], values.as_ref());
        let point = places[self.count - 1].behind.apply(&self.tool);
        Ok(Solved {
            places,
            point,
            coupled,
            carried,
        })
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
                let columns = by_point * place.before.fixed_columns::<2>(0);
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
        if let Some(at) = wanted.wants(at.tool) {
            d.fixed_columns_mut::<3>(at.start)
                .copy_from(&(by_point * self.flange(solved)));
        }
        let wanted_yield = wanted.wants(at.joint_compliance);
        if solved.carried.is_some() || wanted_yield.is_some() {
            let (load, by) = solved
                .carried
                .unwrap_or_else(|| self.load.carried(&solved.coupled));
            let rigid = by_joints;
            for i in 0..self.count {
                let by_joint = rigid.column(i);
                if let Some(at) = wanted_yield {
                    d.set_column(at.start + i, &(by_joint * load[i]));
                }
                by_joints += by_joint * by.row(i) * self.yields[i];
            }
        }
        // each joint also moves the one that follows it
        let apart = by_joints;
        for i in 1..self.count {
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
