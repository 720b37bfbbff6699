//! The paper's closed forms for two equal limbs (Eqs. 34 and 35) and their inverse.

use sherkit_core::numbers::math::{sin_cos, sqrt};
use sherkit_core::spherical::Assembly;
use sherkit_core::{Error, Result, Singularity};
use std::f64::consts::PI;

/// φ, γ of the tool axis for joint angles (Eqs. 34, 35), rad; `γ` is negative where the tool axis has passed
/// beyond the actuated axis.
///
/// # Errors
/// [`Error::LimbsApart`] where the root is imaginary, [`Error::NotFinite`].
pub fn forward(
    alpha_rad: f64,
    beta_rad: f64,
    assembly: Assembly,
    joints: [f64; 2],
) -> Result<[f64; 2]> {
    for (index, v) in joints.iter().enumerate() {
        if !v.is_finite() {
            return Err(Error::NotFinite { index });
        }
    }
    let half = 0.5 * (joints[0] - joints[1]);
    let ((sa, ca), (sb, cb)) = (sin_cos(alpha_rad), sin_cos(beta_rad));
    let (s, c) = sin_cos(half);
    let under = sb * sb - sa * s * (sa * s);
    if under < 0.0 {
        let miss_rad = 2.0 * ((sa * s).abs().min(1.0).asin() - sb.min(1.0).asin());
        return Err(Error::LimbsApart { miss_rad });
    }
    let gamma = 2.0 * (sa * c + assembly.sign() * sqrt(under)).atan2(ca + cb);
    Ok([0.5 * (joints[0] + joints[1]), gamma])
}

/// Joint angles for φ, γ with `θ₁ ≥ θ₂`: `A = arccos((cos β - cos α cos γ) / (sin α sin γ))`, `θ = φ ± A`.
///
/// # Errors
/// [`Error::AxisOutOfReach`], [`Error::SingularPose`] at γ = 0, [`Error::NotFinite`].
pub fn inverse(alpha_rad: f64, beta_rad: f64, angles: [f64; 2]) -> Result<[f64; 2]> {
    for (index, v) in angles.iter().enumerate() {
        if !v.is_finite() {
            return Err(Error::NotFinite { index });
        }
    }
    let [phi, gamma] = angles;
    let ((sa, ca), (sg, cg)) = (sin_cos(alpha_rad), sin_cos(gamma));
    if sg == 0.0 {
        return Err(Error::SingularPose(Singularity::Pole));
    }
    let cos = (beta_rad.cos() - ca * cg) / (sa * sg);
    if cos.abs() > 1.0 {
        let miss_rad = miss_of(alpha_rad, beta_rad, gamma);
        return Err(Error::AxisOutOfReach { limb: 0, miss_rad });
    }
    let half = cos.acos();
    Ok([phi + half, phi - half])
}

/// By how much γ exceeds what a limb reaches (positive), or falls short of it (negative), rad.
fn miss_of(alpha: f64, beta: f64, gamma: f64) -> f64 {
    let gamma = gamma.cos().acos();
    let most = (alpha + beta).min(2.0 * PI - alpha - beta);
    if gamma > most {
        gamma - most
    } else {
        gamma - (alpha - beta).abs()
    }
}
