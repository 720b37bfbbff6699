//! The structure and body links: from joints to the marker, and how that answers to any small change.
//!
//! Gravity: a unit weight at the end of the tool axis pulls along `g`. By virtual work limb i carries the moment
//! `-sin β_i (a_i·g)` about its bend, `a_i` the axis' answer to a unit change of constraint i, and its distal link
//! bends to `β_i' = β_i - κ_i sin β_i (a_i·g)`. Only the part of `g` across the tool axis counts: the droop grows with
//! the horizontal lever arm. Loads are those of the unbent pose; with the bent arcs the pose is solved anew.
//!
//! Marker: `m = c + R x + m₁ u + m₂ v`, `u = (e₁ - x cos β₁')/sin β₁'`, `v = x × u`. The centre of limb i lies at
//! `ε_i n_i + ζ_i t_i`, `n_i` the normal of the proximal link's plane, `t_i = ∂e_i/∂α_i`; the platform's centre `c` is
//! the mean of both.

use super::effects::{AT, PARAMETERS, Values};
use super::geometry::{Geometry, LIMBS, PER_LIMB};
use super::kinematics::Kinematics;
use super::nominal::Model;
use super::pose::Pose;
use crate::chain::Mechanism;
use crate::chain::effects::{Wanted, values_of};
use crate::numbers::math::sin_cos;
use crate::{Error, Result};
use core::f64::consts::PI;
use nalgebra::{Matrix3x2, SMatrix, Vector2, Vector3};

/// The spherical robot with given errors: what joins its joints to the marker.
#[derive(Clone, Copy, Debug)]
pub struct Structure {
    kinematics: Kinematics,
    geometry: Geometry,
    extras: Extras,
}

/// What of structure and body is not in [`Kinematics`].
#[derive(Clone, Copy, Debug)]
struct Extras {
    /// Radius of the sphere on which the marker moves, mm.
    radius: f64,
    /// `ε_i`, `ζ_i`, mm.
    misses: [[f64; 2]; LIMBS],
    /// `κ_i`, rad.
    flexure: [f64; LIMBS],
    /// `m₁`, `m₂`, mm.
    marker: [f64; 2],
    /// Direction in which the weight pulls, base frame.
    gravity: Vector3<f64>,
}

impl Structure {
    /// The mechanism with its errors.
    ///
    /// # Errors
    /// [`Error::InvalidGeometry`] where the errors leave no robot.
    pub fn new(model: &Model, values: &Values) -> Result<Self> {
        let at = AT.structure;
        let [alpha, beta, radius] = values_of(at.geometry, values);
        let [more_alpha, more_beta] = values_of(at.unequal_limbs, values);
        let mut p = model.geometry.parameters();
        for (limb, sign) in [(0, 1.0), (1, -1.0)] {
            p[limb * PER_LIMB] += alpha + sign * more_alpha;
            p[limb * PER_LIMB + 1] += beta + sign * more_beta;
        }
        let geometry = Geometry::from_parameters(&p, model.geometry.assembly);
        let radius = model.radius_mm + radius;
        // written so that a NaN is refused, too
        if !(radius > 0.0 && radius.is_finite()) {
            let what = "the radius of the sphere must be positive";
            return Err(Error::InvalidGeometry { limb: 0, what });
        }
        let [e1, z1, e2, z2] = values_of(at.axis_offset, values);
        Ok(Self {
            kinematics: Kinematics::new(&geometry)?,
            geometry,
            extras: Extras {
                radius,
                misses: [[e1, z1], [e2, z2]],
                flexure: values_of(at.gravity_flexure, values),
                marker: values_of(at.marker_offset, values),
                gravity: model.gravity / model.gravity.norm(),
            },
        })
    }

    /// The robot's kinematics with its errors, without axes that miss the centre, flexure and the marker's offset.
    #[must_use]
    pub fn kinematics(&self) -> &Kinematics {
        &self.kinematics
    }

    /// Radius of the sphere on which the marker moves, mm.
    pub(super) fn radius(&self) -> f64 {
        self.extras.radius
    }

    /// Displacement of the platform's centre by elbow axes that miss it.
    pub(super) fn displaced(&self, joints: &Vector2<f64>) -> Displaced {
        let [a, b] = &self.geometry.limbs;
        let azimuths = [joints.x + a.offset_rad, joints.y + b.offset_rad];
        Displaced::at(azimuths, [a.alpha_rad, b.alpha_rad], &self.extras.misses)
    }
}

impl Mechanism<LIMBS, PARAMETERS> for Structure {
    type Solved = Solved;
    type Many<T: crate::numbers::math::Real> = ();

    #[inline]
    fn solve(&self, joints: &Vector2<f64>) -> Result<Solved> {
        Solved::of(&self.kinematics, &self.extras, joints)
    }

    #[inline]
    fn point(&self, solved: &Solved) -> Vector3<f64> {
        solved.marker
    }

    /// The pole, where the actuated axis leaves the sphere of the marker; limb by limb the point of its elbow axis nearest to
    /// the centre, and its elbow on the sphere; the platform's centre, the end of the tool axis, the marker.
    fn parts(&self, solved: &Solved, put: &mut impl FnMut(Vector3<f64>)) {
        let (pose, extras) = (&solved.pose, &self.extras);
        put(Vector3::z() * extras.radius);
        for i in 0..LIMBS {
            let [across, along] = extras.misses[i];
            let nearest = pose.normals[i] * across + pose.tangents[i] * along;
            put(nearest);
            put(nearest + pose.elbows[i] * extras.radius);
        }
        let centre = centre(&pose.normals, &pose.tangents, &extras.misses);
        put(centre);
        put(centre + pose.axis * extras.radius);
        put(solved.marker);
    }

    #[inline]
    fn columns<const M: usize>(
        &self,
        _: &Vector2<f64>,
        solved: &Solved,
        by_point: &SMatrix<f64, M, 3>,
        wanted: Wanted,
        d: &mut SMatrix<f64, M, PARAMETERS>,
    ) -> SMatrix<f64, M, LIMBS> {
        let (at, pose) = (AT.structure, &solved.pose);
        let centre = centre_by_inputs(pose, &self.extras.misses);
        let answer = |change: Change| solved.answer(&self.extras, &change);
        let limbs = wanted.wants(at.geometry).is_some() || wanted.wants(at.unequal_limbs).is_some();
        let zero = SMatrix::<f64, M, LIMBS>::zeros();
        let (mut by_joints, mut by_alphas, mut by_betas) = (zero, zero, zero);
        for i in 0..LIMBS {
            let [by_turn, by_alpha] = centre[i];
            let turn = Change::elbow(i, pose.normals[i] * pose.sin_alpha[i]);
            by_joints.set_column(i, &(by_point * (answer(turn) + by_turn)));
            if limbs {
                let proximal = Change::elbow(i, pose.tangents[i]);
                by_alphas.set_column(i, &(by_point * (answer(proximal) + by_alpha)));
                by_betas.set_column(i, &(by_point * answer(Change::beta(i))));
            }
            if let Some(place) = wanted.wants(at.gravity_flexure) {
                let soft = answer(Change::flexure(i));
                d.set_column(place.start + i, &(by_point * soft));
            }
            if let Some(place) = wanted.wants(at.axis_offset) {
                for (k, by) in [pose.normals[i], pose.tangents[i]].iter().enumerate() {
                    d.set_column(place.start + 2 * i + k, &(by_point * by * 0.5));
                }
            }
        }
        if let Some(place) = wanted.wants(at.geometry) {
            d.set_column(place.start, &(by_alphas.column(0) + by_alphas.column(1)));
            d.set_column(place.start + 1, &(by_betas.column(0) + by_betas.column(1)));
            d.set_column(place.start + 2, &(by_point * pose.axis));
        }
        if let Some(place) = wanted.wants(at.unequal_limbs) {
            d.set_column(place.start, &(by_alphas.column(0) - by_alphas.column(1)));
            d.set_column(place.start + 1, &(by_betas.column(0) - by_betas.column(1)));
        }
        if let Some(place) = wanted.wants(at.marker_offset) {
            for (k, by) in frame(pose).iter().enumerate() {
                d.set_column(place.start + k, &(by_point * by));
            }
        }
        by_joints
    }

    /// φ follows the mean of the elbows.
    #[inline]
    fn azimuth(&self, joints: &Vector2<f64>) -> f64 {
        let [a, b] = &self.geometry.limbs;
        0.5 * (joints.x + a.offset_rad + (joints.y + b.offset_rad))
    }
}

/// The solved structure.
#[derive(Clone, Copy, Debug)]
pub struct Solved {
    /// Marker, base frame, mm.
    marker: Vector3<f64>,
    /// The pose with bent links.
    pose: Pose,
    unbent: Pose,
    /// `a_i·g` of the unbent pose.
    loads: Vector3<f64>,
}

/// A small change: of the elbow axes, of the distal arcs, of the links' compliance.
#[derive(Clone, Copy, Default)]
struct Change {
    elbows: [Vector3<f64>; LIMBS],
    beta: [f64; LIMBS],
    flexure: [f64; LIMBS],
}

impl Change {
    fn elbow(limb: usize, moved: Vector3<f64>) -> Self {
        let mut change = Self::default();
        change.elbows[limb] = moved;
        change
    }

    fn beta(limb: usize) -> Self {
        let mut change = Self::default();
        change.beta[limb] = 1.0;
        change
    }

    fn flexure(limb: usize) -> Self {
        let mut change = Self::default();
        change.flexure[limb] = 1.0;
        change
    }
}

impl Solved {
    #[inline]
    fn of(kinematics: &Kinematics, extras: &Extras, joints: &Vector2<f64>) -> Result<Self> {
        let unbent = kinematics.pose(joints)?;
        let loads = unbent.answers.tr_mul(&extras.gravity);
        let mut pose = unbent;
        if extras.flexure != [0.0; LIMBS] {
            let mut beta = *kinematics.beta();
            for i in 0..LIMBS {
                beta[i] -= extras.flexure[i] * unbent.sin_beta[i] * loads[i];
                // written so that a NaN is refused, too
                if !(beta[i] > 0.0 && beta[i] < PI) {
                    let what = "the distal link bends beyond what it can";
                    return Err(Error::InvalidGeometry { limb: i, what });
                }
            }
            pose = kinematics.with_beta(beta).pose(joints)?;
        }
        let [u, v] = frame(&pose);
        let [m1, m2] = extras.marker;
        let marker = centre(&pose.normals, &pose.tangents, &extras.misses)
            + pose.axis * extras.radius
            + u * m1
            + v * m2;
        Ok(Self {
            marker,
            pose,
            unbent,
            loads,
        })
    }

    /// Movement of the marker about the centre.
    fn answer(&self, extras: &Extras, change: &Change) -> Vector3<f64> {
        let (still, bent) = (&self.unbent, &self.pose);
        let mut beta = change.beta;
        let moved = axis_moves(still, &change.elbows, &beta);
        for k in 0..LIMBS {
            let a = still.answers.column(k);
            // M⁻¹ answers to a change of M by -M⁻¹ dM M⁻¹
            let load = -(self.loads[0] * change.elbows[0].dot(&a)
                + self.loads[1] * change.elbows[1].dot(&a)
                + self.loads[2] * moved.dot(&a));
            let (sin, cos) = (still.sin_beta[k], still.cos_beta[k]);
            beta[k] -= extras.flexure[k] * (cos * change.beta[k] * self.loads[k] + sin * load)
                + change.flexure[k] * sin * self.loads[k];
        }
        let axis = axis_moves(bent, &change.elbows, &beta);
        let [m1, m2] = extras.marker;
        let mut out = axis * extras.radius;
        if m1 != 0.0 || m2 != 0.0 {
            let (elbow, turn) = (&bent.elbows[0], &change.elbows[0]);
            let (sin, cos) = (bent.sin_beta[0], bent.cos_beta[0]);
            let [u, v] = frame(bent);
            let shrink = cos / sin * beta[0];
            let du = (turn - axis * cos) / sin + bent.axis * beta[0] - u * shrink;
            let dv = (axis.cross(elbow) + bent.axis.cross(turn)) / sin - v * shrink;
            out += du * m1 + dv * m2;
        }
        out
    }
}

/// Movement of the tool axis when elbow axes and distal arcs change.
#[inline]
fn axis_moves(pose: &Pose, elbows: &[Vector3<f64>; LIMBS], beta: &[f64; LIMBS]) -> Vector3<f64> {
    let gain = |i: usize| -pose.axis.dot(&elbows[i]) - pose.sin_beta[i] * beta[i];
    pose.answers.column(0) * gain(0) + pose.answers.column(1) * gain(1)
}

/// Unit vectors across the tool axis, fixed to the distal link of limb 1: towards its elbow, and at right angles.
fn frame(pose: &Pose) -> [Vector3<f64>; 2] {
    let (sin, cos) = (pose.sin_beta[0], pose.cos_beta[0]);
    let u = (pose.elbows[0] - pose.axis * cos) / sin;
    [u, pose.axis.cross(&pose.elbows[0]) / sin]
}

/// Displacement of the platform's centre by elbow axes that miss it.
fn centre(
    normals: &[Vector3<f64>; LIMBS],
    tangents: &[Vector3<f64>; LIMBS],
    misses: &[[f64; 2]; LIMBS],
) -> Vector3<f64> {
    let limb = |i: usize| normals[i] * misses[i][0] + tangents[i] * misses[i][1];
    (limb(0) + limb(1)) * 0.5
}

/// Derivative of [`centre`] by azimuth and proximal arc of each limb.
fn centre_by_inputs(pose: &Pose, misses: &[[f64; 2]; LIMBS]) -> [[Vector3<f64>; 2]; LIMBS] {
    let limb = |i: usize| {
        let (normal, [across, along]) = (&pose.normals[i], misses[i]);
        let out = Vector3::new(normal.y, -normal.x, 0.0);
        let turn = (normal * (pose.cos_alpha[i] * along) - out * across) * 0.5;
        [turn, pose.elbows[i] * (-0.5 * along)]
    };
    [limb(0), limb(1)]
}

/// Displacement of the platform's centre without solving the pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Displaced {
    pub value: Vector3<f64>,
    pub by_azimuths: Matrix3x2<f64>,
    pub by_alphas: Matrix3x2<f64>,
    /// By `ε₁, ζ₁, ε₂, ζ₂`.
    pub by_misses: [Vector3<f64>; 2 * LIMBS],
}

impl Displaced {
    pub fn at(azimuths: [f64; LIMBS], alphas: [f64; LIMBS], misses: &[[f64; 2]; LIMBS]) -> Self {
        let zero = Vector3::zeros();
        let mut out = Self {
            value: zero,
            by_azimuths: Matrix3x2::zeros(),
            by_alphas: Matrix3x2::zeros(),
            by_misses: [zero; 2 * LIMBS],
        };
        for i in 0..LIMBS {
            let ((sin, cos), (sa, ca)) = (sin_cos(azimuths[i]), sin_cos(alphas[i]));
            let out_of_axis = Vector3::new(cos, sin, 0.0);
            let normal = Vector3::new(-sin, cos, 0.0);
            let tangent = out_of_axis * ca - Vector3::z() * sa;
            let [across, along] = misses[i];
            out.value += (normal * across + tangent * along) * 0.5;
            let turn = (normal * (ca * along) - out_of_axis * across) * 0.5;
            out.by_azimuths.set_column(i, &turn);
            let elbow = out_of_axis * sa + Vector3::z() * ca;
            out.by_alphas.set_column(i, &(elbow * (-0.5 * along)));
            out.by_misses[2 * i] = normal * 0.5;
            out.by_misses[2 * i + 1] = tangent * 0.5;
        }
        out
    }
}
