//! The paper's mapping from the picture to the sphere and its sensitivity, against which the general camera is tested.
//!
//! `D = R + r` is the distance of the camera from the centre of the sphere, `r` that from its surface. A camera angle
//! `b` and the angle `δ` at the centre belong together by `sin(δ + b) = (D/R) sin b` (Eq. 13).

use sherkit_core::numbers::math::sin_cos;
use sherkit_core::{Error, Result};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

/// Angle at the centre of the sphere for a camera angle: `asin((R + r)/R · sin b) - b` (Eq. 11, whose bracket is
/// misprinted).
///
/// # Errors
/// [`Error::RayMisses`] beyond the edge of the sphere.
pub fn arc_of(radius_mm: f64, clearance_mm: f64, camera_angle_rad: f64) -> Result<f64> {
    let distance = radius_mm + clearance_mm;
    let sin = sin_cos(camera_angle_rad).0;
    let ratio = distance / radius_mm * sin;
    if ratio.is_nan() || ratio.abs() > 1.0 {
        let miss_mm = (distance * sin).abs() - radius_mm;
        return Err(Error::RayMisses { miss_mm });
    }
    Ok(ratio.asin() - camera_angle_rad)
}

/// Camera angle that shows an angle at the centre of the sphere, rad: the inverse of [`arc_of`].
#[must_use]
pub fn camera_angle_of(radius_mm: f64, clearance_mm: f64, arc_rad: f64) -> f64 {
    let (sin, cos) = sin_cos(arc_rad);
    (radius_mm * sin).atan2(radius_mm * (1.0 - cos) + clearance_mm)
}

/// The paper's closed mapping, for a camera that stands at φ = π/2, γ = π/4 and looks at the centre (Eqs. 10 to 12,
/// corrected).
///
/// Exact for γ on the vertical midline of the picture, and for φ along its horizontal midline where that is read as
/// the arc of a great circle; elsewhere the two coordinates do not separate, and `Camera::on_sphere`
/// is exact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosedMapping {
    /// Radius of the sphere `R`, mm.
    pub radius_mm: f64,
    /// Distance of the camera from the surface of the sphere `r`, mm.
    pub clearance_mm: f64,
    /// Half the picture's width and height, `n_x`, `n_y`, px.
    pub half_size: [f64; 2],
    /// Camera angles at its edges, `α_max`, `δ_max`, rad.
    pub half_angle: [f64; 2],
}

impl ClosedMapping {
    /// φ, γ of a pixel, rad.
    ///
    /// # Errors
    /// As [`arc_of`].
    pub fn angles(&self, pixel: [f64; 2]) -> Result<[f64; 2]> {
        let mut out = [FRAC_PI_2, FRAC_PI_4];
        for k in 0..2 {
            let n = self.half_size[k];
            let b = (self.half_angle[k].tan() * (pixel[k] - n) / n).atan();
            out[k] += arc_of(self.radius_mm, self.clearance_mm, b)?;
        }
        Ok(out)
    }
}

/// Exact change of the camera angle with the angle at the centre, `dθ/dδ`, of which Eqs. 20 to 28 seek an
/// approximation: `R (D cos δ - R) / (D² - 2 D R cos δ + R²)`; `R/r` in the middle.
#[must_use]
pub fn sensitivity(radius_mm: f64, clearance_mm: f64, arc_rad: f64) -> f64 {
    let distance = radius_mm + clearance_mm;
    let (sin, cos) = sin_cos(0.5 * arc_rad);
    let chord_squared = clearance_mm * clearance_mm + 4.0 * distance * radius_mm * sin * sin;
    let facing = distance * (cos * cos - sin * sin) - radius_mm;
    radius_mm * facing / chord_squared
}

/// The paper's approximation of the relative sensitivity, `S = (δ/θ) dθ/dδ` (Eq. 27), for a step `dδ`.
///
/// As printed; at δ = 0 it is 1 for every distance, where `dθ/dδ` is `R/r`, and nowhere does it start from 3.
#[must_use]
pub fn approximate_sensitivity(
    radius_mm: f64,
    clearance_mm: f64,
    arc_rad: f64,
    step_rad: f64,
) -> f64 {
    let theta = camera_angle_of(radius_mm, clearance_mm, arc_rad);
    let relative = if arc_rad == 0.0 {
        1.0
    } else {
        radius_mm * arc_rad / (clearance_mm * theta)
    };
    let ((s_sum, c_sum), (s, c)) = (sin_cos(theta + arc_rad), sin_cos(theta));
    let first = c_sum - (0.5 * step_rad).tan() * s_sum;
    relative * first * (c - (0.5 * arc_rad).tan() * s)
}
