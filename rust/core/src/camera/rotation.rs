//! Rotation vectors and how their matrices change, exact at small angles.

use crate::numbers::math::{sin_cos, sqrt};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Below this angle the coefficients come from their series, whose first left-out term is then below rounding.
const SMALL_RAD: f64 = 0.02;

/// `sin θ/θ`, `(1 - cos θ)/θ²`, `(θ - sin θ)/θ³`.
fn coefficients(w: &Vector3<f64>) -> [f64; 3] {
    let tt = w.norm_squared();
    if tt < SMALL_RAD * SMALL_RAD {
        return [
            1.0 - tt / 6.0 * (1.0 - tt / 20.0 * (1.0 - tt / 42.0)),
            0.5 * (1.0 - tt / 12.0 * (1.0 - tt / 30.0 * (1.0 - tt / 56.0))),
            (1.0 - tt / 20.0 * (1.0 - tt / 42.0 * (1.0 - tt / 72.0))) / 6.0,
        ];
    }
    let angle = sqrt(tt);
    let sin = sin_cos(angle).0;
    let half = sin_cos(0.5 * angle).0;
    [
        sin / angle,
        2.0 * half * half / tt,
        (angle - sin) / (tt * angle),
    ]
}

/// Matrix of a rotation vector, rad (Rodrigues).
#[must_use]
pub fn rotation_matrix(w: &Vector3<f64>) -> Matrix3<f64> {
    let [a, b, _] = coefficients(w);
    let x = w.cross_matrix();
    Matrix3::identity() + x * a + x * x * b
}

/// Rotation vector of a matrix, rad.
#[must_use]
pub fn rotation_vector(matrix: &Matrix3<f64>) -> Vector3<f64> {
    let rotation = Rotation3::from_matrix_unchecked(*matrix);
    UnitQuaternion::from_rotation_matrix(&rotation).scaled_axis()
}

/// `J` with `R(w + dw) = R(w) exp(J dw)`.
#[must_use]
pub fn right_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let [_, b, c] = coefficients(w);
    let x = w.cross_matrix();
    Matrix3::identity() - x * b + x * x * c
}

/// `J` with `R(w + dw) = exp(J dw) R(w)`.
#[must_use]
pub fn left_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    right_jacobian(&-w)
}
