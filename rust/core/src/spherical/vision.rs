//! The paper's mapping from the picture to the sphere, its sensitivity, and where the camera should stand.
//!
//! `D = R + r` is the distance of the camera from the centre of the sphere, `r` that from its surface. A camera angle
//! `b` and the angle `δ` at the centre belong together by `sin(δ + b) = (D/R) sin b` (Eq. 13).

use crate::math::{sin_cos, sqrt};
use crate::{Error, Result};
use core::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

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
    Ok(libm::asin(ratio) - camera_angle_rad)
}

/// Camera angle that shows an angle at the centre of the sphere, rad: the inverse of [`arc_of`].
#[must_use]
pub fn camera_angle_of(radius_mm: f64, clearance_mm: f64, arc_rad: f64) -> f64 {
    let (sin, cos) = sin_cos(arc_rad);
    libm::atan2(radius_mm * sin, radius_mm * (1.0 - cos) + clearance_mm)
}

/// The paper's closed mapping, for a camera that stands at φ = π/2, γ = π/4 and looks at the centre (Eqs. 10 to 12,
/// corrected).
///
/// Exact for γ on the vertical midline of the picture, and for φ along its horizontal midline where that is read as
/// the arc of a great circle; elsewhere the two coordinates do not separate, and [`crate::camera::Camera::on_sphere`]
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
            let b = libm::atan(libm::tan(self.half_angle[k]) * (pixel[k] - n) / n);
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
    let first = c_sum - libm::tan(0.5 * step_rad) * s_sum;
    relative * first * (c - libm::tan(0.5 * arc_rad) * s)
}

/// Which part of the sphere is of interest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Region {
    /// Half the sphere (Eq. 31).
    #[default]
    Half,
    /// A quarter of it, the paper's workspace: half the first term.
    Quarter,
}

impl Region {
    const fn share(self) -> f64 {
        match self {
            Self::Half => 1.0,
            Self::Quarter => 0.5,
        }
    }
}

/// Where a camera should stand, and what it sees from there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Distance from the centre of the sphere, mm.
    pub distance_mm: f64,
    /// Angle at the centre between the line of sight and the edge of what is seen, `arccos(R/r)`, rad.
    pub half_angle_rad: f64,
    /// Share of the region of interest that is seen.
    pub coverage: f64,
    /// Area of the region that is seen, `S_ROI`, mm².
    pub seen_mm2: f64,
    /// Area of the background in the picture, `S_waste`, mm².
    pub waste_mm2: f64,
    /// `J = q S_ROI - S_waste` (Eq. 29), mm².
    pub benefit_mm2: f64,
}

/// What a camera sees from a distance from the centre (Eqs. 29 to 32). `lens_rad` is half the lens' angle of view.
///
/// # Errors
/// [`Error::InvalidCamera`] for a distance within the sphere, an angle that is none, or a weight that is not positive.
pub fn placement(
    radius_mm: f64,
    distance_mm: f64,
    lens_rad: f64,
    weight: f64,
    region: Region,
) -> Result<Placement> {
    check(radius_mm, lens_rad, weight)?;
    if distance_mm.is_nan() || distance_mm <= radius_mm {
        let what = "the camera must stand outside the sphere";
        return Err(Error::InvalidCamera { what });
    }
    let tan = libm::tan(lens_rad);
    let half_angle_rad = libm::acos(radius_mm / distance_mm);
    let seen_mm2 = 4.0 * half_angle_rad * radius_mm * radius_mm * region.share();
    let beyond = (distance_mm - radius_mm) * (distance_mm + radius_mm);
    let edge = radius_mm * distance_mm;
    let waste_mm2 = PI * (distance_mm * tan * (distance_mm * tan) - edge * edge / beyond);
    Ok(Placement {
        distance_mm,
        half_angle_rad,
        coverage: half_angle_rad / FRAC_PI_2,
        seen_mm2,
        waste_mm2,
        benefit_mm2: weight * seen_mm2 - waste_mm2,
    })
}

/// The distance of greatest benefit: the outer root of Eq. 33, `tan²θ = 2qR³/(π A r²) - R⁴/A⁴`, `r² = A² + R²`.
///
/// # Errors
/// As [`placement`], and [`Error::NoOptimum`] where the benefit falls from the sphere on.
pub fn best_placement(
    radius_mm: f64,
    lens_rad: f64,
    weight: f64,
    region: Region,
) -> Result<Placement> {
    check(radius_mm, lens_rad, weight)?;
    let tan = libm::tan(lens_rad);
    let c = 2.0 * weight * region.share() / PI;
    // with a = A/R; J grows with the distance where this is positive
    let slope = |a: f64| c / (a * (a * a + 1.0)) - 1.0 / (a * a * a * a) - tan * tan;
    // above this bound the first term alone is less than tan²θ: come from outside, down to the first rise
    let mut outer = libm::cbrt(c / (tan * tan));
    let mut inner = outer;
    loop {
        inner *= 0.995;
        if slope(inner) > 0.0 {
            break;
        }
        if inner < 1e-3 {
            return Err(Error::NoOptimum);
        }
        outer = inner;
    }
    for _ in 0..100 {
        let middle = 0.5 * (inner + outer);
        if slope(middle) > 0.0 {
            inner = middle;
        } else {
            outer = middle;
        }
    }
    let distance_mm = radius_mm * sqrt(1.0 + inner * inner);
    placement(radius_mm, distance_mm, lens_rad, weight, region)
}

fn check(radius_mm: f64, lens_rad: f64, weight: f64) -> Result<()> {
    for (index, v) in [radius_mm, lens_rad, weight].into_iter().enumerate() {
        if !v.is_finite() {
            return Err(Error::NotFinite { index });
        }
    }
    if radius_mm <= 0.0 || weight <= 0.0 || lens_rad <= 1e-6 || lens_rad >= FRAC_PI_2 {
        let what = "radius and weight must be positive, half the angle of view between 0 and pi/2";
        return Err(Error::InvalidCamera { what });
    }
    Ok(())
}
