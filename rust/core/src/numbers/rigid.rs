//! A rigid transform: a turn, then a shift.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// How far the columns of a turn may be from a right angle or one.
pub const SQUARE: f64 = 1e-6;

/// `x ↦ R x + t`. The turn is taken to be a rotation; nothing here checks it. Lengths are mm. NaN passes through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rigid {
    /// Rotation `R`.
    pub rotation: Matrix3<f64>,
    /// Shift `t`, mm: where the origin goes.
    pub translation: Vector3<f64>,
}

impl Rigid {
    /// The transform that moves nothing.
    #[must_use]
    pub fn identity() -> Self {
        Self {
            rotation: Matrix3::identity(),
            translation: Vector3::zeros(),
        }
    }

    /// Whether its turn is a rotation: right angles, lengths of one, no mirror.
    #[must_use]
    pub fn is_proper(&self) -> bool {
        let r = &self.rotation;
        let off = r.transpose() * r - Matrix3::identity();
        off.amax() < SQUARE && r.determinant() > 0.0
    }

    /// Its turn as a rotation vector, rad.
    #[must_use]
    pub fn rotation_vector(&self) -> Vector3<f64> {
        let turn = Rotation3::from_matrix_unchecked(self.rotation);
        UnitQuaternion::from_rotation_matrix(&turn).scaled_axis()
    }

    /// Where a point goes.
    #[must_use]
    pub fn apply(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// Where a point came from: `Rᵀ (y - t)`, as in Eq. 11 of the tool paper.
    #[must_use]
    pub fn apply_inverse(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation.transpose() * (point - self.translation)
    }

    /// The way back.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self {
            rotation,
            translation: -(rotation * self.translation),
        }
    }
}
