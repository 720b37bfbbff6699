//! What the weight of an arm does to its joints, by the drawing: errors of the geometry change it by less than a
//! hundredth of what it bends.
//!
//! Joint i carries the moment `T_i = z_i · (M_i × g)` with `M_i = Σ m_k (c_k - o_i)` over the links behind it, or the force
//! `W_i z_i · g` along a prismatic axis; g is the direction of the weight. Moments count in parts of the greatest that
//! the same weights could make, stretched out at right angles to g. The moment of what hangs at the first target counts in
//! N·m, its force in N.

use super::arm::{JOINTS, Joint, Model};
use super::frames::{Link, Place, stand};
use nalgebra::{SMatrix, SVector, Vector3};

/// Standard gravity, m/s².
const GRAVITY: f64 = 9.80665;

/// The weights of an arm as drawn.
#[derive(Clone, Copy, Debug)]
pub(super) struct Load {
    links: [Link; JOINTS],
    joints: [Joint; JOINTS],
    count: usize,
    gravity: Vector3<f64>,
    /// One over the greatest moment or force; zero where a joint carries nothing.
    greatest: [f64; JOINTS],
    /// Where a payload hangs, in the frame behind the last joint, mm.
    target: Vector3<f64>,
}

/// What each joint carries, and how that changes with the joints.
pub(super) type Carried = (SVector<f64, JOINTS>, SMatrix<f64, JOINTS, JOINTS>);

impl Load {
    pub(super) fn new(model: &Model) -> Self {
        let links = model
            .joints
            .map(|joint| Link::new(&joint.fixed, joint.prismatic, [0.0; 2], [0.0; 2]));
        let mut greatest = [0.0; JOINTS];
        for (i, out) in greatest.iter_mut().enumerate().take(model.count) {
            let (mut reach, mut most) = (0.0, 0.0);
            for (k, joint) in model.joints.iter().enumerate().take(model.count).skip(i) {
                if k > i {
                    reach += joint.fixed.translation.norm();
                }
                most += joint.mass_kg
                    * if model.joints[i].prismatic {
                        1.0
                    } else {
                        reach + joint.centre_mm.norm()
                    };
            }
            if most > 0.0 {
                *out = 1.0 / most;
            }
        }
        Self {
            links,
            joints: model.joints,
            count: model.count,
            gravity: model.gravity,
            greatest,
            target: model.targets_mm[0],
        }
    }

    /// What the joints carry of the arm itself at these values.
    pub(super) fn carried(&self, values: &SVector<f64, JOINTS>) -> Carried {
        let weights = self.joints.map(|joint| (joint.mass_kg, joint.centre_mm));
        self.moments(values, &weights, &self.greatest)
    }

    /// What they carry of a payload, kg: N·m, or N along those that slide.
    pub(super) fn hung(&self, values: &SVector<f64, JOINTS>, payload_kg: f64) -> Carried {
        let mut weights = [(0.0, Vector3::zeros()); JOINTS];
        if let Some(last) = weights[..self.count.min(JOINTS)].last_mut() {
            *last = (payload_kg, self.target);
        }
        let scale = self.joints.map(|joint| {
            if joint.prismatic {
                GRAVITY
            } else {
                1e-3 * GRAVITY
            }
        });
        self.moments(values, &weights, &scale)
    }

    /// What weights behind the joints, each with its centre, put on them, in a scale of each.
    fn moments(
        &self,
        values: &SVector<f64, JOINTS>,
        weights: &[(f64, Vector3<f64>); JOINTS],
        scale: &[f64; JOINTS],
    ) -> Carried {
        // no more than there is room for, so that no index can be proved wrong
        let count = self.count.min(JOINTS);
        let (places, _) = stand(&self.links, count, values.as_ref(), &[1.0; JOINTS]);
        let (mut load, mut by_joints) = (SVector::zeros(), SMatrix::zeros());
        // the weight behind each joint, and its moment about the base
        let mut behind = [(0.0, Vector3::zeros()); JOINTS];
        let (mut weight, mut moment) = (0.0, Vector3::zeros());
        for k in (0..count).rev() {
            let (mass, centre) = weights[k];
            weight += mass;
            moment += places[k].behind.apply(&centre) * mass;
            behind[k] = (weight, moment - places[k].origin * weight);
        }
        for i in 0..count {
            let scale = scale[i];
            let (place, (weight, moment)) = (&places[i], behind[i]);
            load[i] = scale
                * if place.prismatic {
                    weight * place.axis.dot(&self.gravity)
                } else {
                    place.axis.dot(&moment.cross(&self.gravity))
                };
            for j in 0..count {
                by_joints[(i, j)] = scale * self.change(i, j, &places, &behind);
            }
        }
        (load, by_joints)
    }

    /// How the moment or force at a joint changes with another.
    fn change(
        &self,
        i: usize,
        j: usize,
        places: &[Place; JOINTS],
        behind: &[(f64, Vector3<f64>); JOINTS],
    ) -> f64 {
        let (at, mover, (weight, moment)) = (&places[i], &places[j], behind[i]);
        if j <= i {
            // all that the joint carries moves with its axis
            if mover.prismatic {
                return 0.0;
            }
            let turned = mover.axis.cross(&at.axis);
            return if at.prismatic {
                weight * turned.dot(&self.gravity)
            } else {
                let moved = mover.axis.cross(&moment);
                turned.dot(&moment.cross(&self.gravity)) + at.axis.dot(&moved.cross(&self.gravity))
            };
        }
        if at.prismatic {
            return 0.0;
        }
        let (weight, moment) = behind[j];
        let moved = if mover.prismatic {
            mover.axis * weight
        } else {
            mover.axis.cross(&moment)
        };
        at.axis.dot(&moved.cross(&self.gravity))
    }
}
