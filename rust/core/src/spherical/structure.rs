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

use super::geometry::LIMBS;
use super::kinematics::Kinematics;
use super::pose::Pose;
use crate::math::sin_cos;
use crate::{Error, Result};
use core::f64::consts::PI;
use nalgebra::{Matrix3x2, SMatrix, Vector2, Vector3};

/// What of structure and body is not in [`Kinematics`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Extras {
    /// Radius of the sphere on which the marker moves, mm.
    pub radius: f64,
    /// `ε_i`, `ζ_i`, mm.
    pub misses: [[f64; 2]; LIMBS],
    /// `κ_i`, rad.
    pub flexure: [f64; LIMBS],
    /// `m₁`, `m₂`, mm.
    pub marker: [f64; 2],
    /// Direction in which the weight pulls, base frame.
    pub gravity: Vector3<f64>,
}

/// What the structure depends on, one column each: ψ₁, ψ₂, α₁, α₂, β₁, β₂, κ₁, κ₂.
pub(super) const INPUTS: usize = 8;

/// The solved structure.
#[derive(Clone, Copy, Debug)]
pub(super) struct Structure {
    /// Marker, base frame, mm.
    pub marker: Vector3<f64>,
    /// The pose with bent links.
    pub pose: Pose,
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

impl Structure {
    #[inline]
    pub fn solve(kinematics: &Kinematics, extras: &Extras, joints: &Vector2<f64>) -> Result<Self> {
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

    /// Derivative of the marker by the inputs.
    #[inline]
    pub fn by_inputs(&self, extras: &Extras) -> SMatrix<f64, 3, INPUTS> {
        let pose = &self.pose;
        let mut d = SMatrix::<f64, 3, INPUTS>::zeros();
        let centre = centre_by_inputs(pose, &extras.misses);
        for i in 0..LIMBS {
            let mut turn = Change::default();
            turn.elbows[i] = pose.normals[i] * pose.sin_alpha[i];
            let mut proximal = Change::default();
            proximal.elbows[i] = pose.tangents[i];
            let mut distal = Change::default();
            distal.beta[i] = 1.0;
            let mut soft = Change::default();
            soft.flexure[i] = 1.0;
            let [by_turn, by_alpha] = centre[i];
            d.set_column(i, &(self.answer(extras, &turn) + by_turn));
            d.set_column(2 + i, &(self.answer(extras, &proximal) + by_alpha));
            d.set_column(4 + i, &self.answer(extras, &distal));
            d.set_column(6 + i, &self.answer(extras, &soft));
        }
        d
    }

    /// Derivative of the marker by the sphere's radius and by both offsets of the marker.
    #[inline]
    pub fn by_body(&self) -> [Vector3<f64>; 3] {
        let [u, v] = frame(&self.pose);
        [self.pose.axis, u, v]
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
