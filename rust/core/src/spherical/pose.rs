//! A solved pose and its exact derivatives, from the constraints differentiated implicitly: with `M` of the rows
//! `e₁ᵀ, e₂ᵀ, xᵀ`, `M dx = (-x·de₁ - sin β₁ dβ₁, -x·de₂ - sin β₂ dβ₂, 0)`.

use super::geometry::{GEOMETRIC, LIMBS, PER_LIMB};
use crate::chain::angles_by_axis;
use crate::numbers::math::sin_cos;
use crate::{Error, Result, Singularity};
use nalgebra::{Matrix2, Matrix3, Matrix3x2, SMatrix, Vector3};

/// Sines and products of unit vectors below this count as singular.
pub(super) const SINGULAR: f64 = 1e-9;

/// A solved pose, from which every derivative follows.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// Tool axis, base frame, unit vector.
    pub axis: Vector3<f64>,
    /// Azimuth φ of the tool axis, rad, continuous with the mean of the joint angles; NaN at γ = 0.
    pub phi_rad: f64,
    /// Polar angle γ of the tool axis, rad; negative beyond the actuated axis.
    pub gamma_rad: f64,
    /// Elbow axes, unit vectors.
    pub elbows: [Vector3<f64>; LIMBS],
    /// Normals of the planes of actuated axis and elbow axis: where an elbow goes when its joint turns.
    pub normals: [Vector3<f64>; LIMBS],
    /// Tangents in those planes, at right angles to the elbow axes: where an elbow goes when α grows.
    pub tangents: [Vector3<f64>; LIMBS],
    /// Column i: change of the axis when constraint i, `x·e_i - cos β_i`, gives way by one. The third is that of
    /// the length.
    pub answers: Matrix3<f64>,
    pub(super) sin_alpha: [f64; LIMBS],
    pub(super) cos_alpha: [f64; LIMBS],
    pub(super) sin_beta: [f64; LIMBS],
    pub(super) cos_beta: [f64; LIMBS],
}

impl Pose {
    /// Derivative of the tool axis by the joint angles.
    #[must_use]
    pub fn axis_by_joints(&self) -> Matrix3x2<f64> {
        let column = |i: usize| {
            let moved = self.axis.dot(&self.normals[i]) * self.sin_alpha[i];
            self.answers.column(i) * -moved
        };
        Matrix3x2::from_columns(&[column(0), column(1)])
    }

    /// Derivative of the tool axis by the six geometric parameters.
    #[must_use]
    pub fn axis_by_parameters(&self) -> SMatrix<f64, 3, GEOMETRIC> {
        let mut d = SMatrix::<f64, 3, GEOMETRIC>::zeros();
        let by_joints = self.axis_by_joints();
        for i in 0..LIMBS {
            let answer = self.answers.column(i);
            let alpha = answer * -self.axis.dot(&self.tangents[i]);
            d.set_column(i * PER_LIMB, &alpha);
            d.set_column(i * PER_LIMB + 1, &(answer * -self.sin_beta[i]));
            d.set_column(i * PER_LIMB + 2, &by_joints.column(i));
        }
        d
    }

    /// Derivative of φ, γ by the tool axis, across it; not finite at γ = 0.
    #[must_use]
    pub fn angles_by_axis(&self) -> SMatrix<f64, 2, 3> {
        angles_by_axis(&self.axis, self.gamma_rad)
    }

    /// Derivative of φ, γ by the joint angles; not finite at γ = 0.
    #[must_use]
    pub fn by_joints(&self) -> Matrix2<f64> {
        self.angles_by_axis() * self.axis_by_joints()
    }

    /// Derivative of φ, γ by the six geometric parameters, one column each; not finite at γ = 0.
    #[must_use]
    pub fn by_parameters(&self) -> SMatrix<f64, 2, GEOMETRIC> {
        self.angles_by_axis() * self.axis_by_parameters()
    }

    /// Derivative of the joint angles by φ, γ, with the geometry held.
    ///
    /// # Errors
    /// [`Error::SingularPose`] where a limb is stretched or folded: its elbow lies in the plane of both axes.
    pub fn joints_by_angles(&self) -> Result<Matrix2<f64>> {
        let mut d = Matrix2::zeros();
        let (x, z) = (&self.axis, self.axis.z);
        let sine = sin_cos(self.gamma_rad).0;
        let by_angles = [
            Vector3::new(-x.y, x.x, 0.0),
            Vector3::new(x.x * z / sine, x.y * z / sine, -sine),
        ];
        for i in 0..LIMBS {
            let gain = self.limb_gain(i)?;
            for (k, by) in by_angles.iter().enumerate() {
                d[(i, k)] = -self.elbows[i].dot(by) / gain;
            }
        }
        Ok(d)
    }

    /// Derivative of the joint angles by the six geometric parameters, with φ, γ held.
    ///
    /// # Errors
    /// As [`Self::joints_by_angles`].
    pub fn joints_by_parameters(&self) -> Result<SMatrix<f64, 2, GEOMETRIC>> {
        let mut d = SMatrix::<f64, 2, GEOMETRIC>::zeros();
        for i in 0..LIMBS {
            let gain = self.limb_gain(i)?;
            let first = i * PER_LIMB;
            d[(i, first)] = -self.axis.dot(&self.tangents[i]) / gain;
            d[(i, first + 1)] = -self.sin_beta[i] / gain;
            d[(i, first + 2)] = -1.0;
        }
        Ok(d)
    }

    /// `∂(x·e_i)/∂θ_i`.
    fn limb_gain(&self, limb: usize) -> Result<f64> {
        let gain = self.axis.dot(&self.normals[limb]) * self.sin_alpha[limb];
        if gain.abs() < SINGULAR {
            return Err(Error::SingularPose(Singularity::LimbStretched { limb }));
        }
        Ok(gain)
    }
}
