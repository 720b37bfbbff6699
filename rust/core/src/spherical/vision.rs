//! Where the camera should stand that looks at the sphere: near enough to see small angles, far enough to see all.
//!
//! Source: Agand, Taghirad, Molaei, Eqs. 29 to 33.

use crate::numbers::math::sqrt;
use crate::{Error, Result};
use core::f64::consts::{FRAC_PI_2, PI};

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
    /// Area of the background in the picture, `S_waste`, mm²; negative where the lens does not take in the whole rim of
    /// the sphere, which the paper supposes: areas and benefit then mean nothing.
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
    // Eq. 33 with a = A/R: J grows with the distance where this is above tan²θ. Times a⁴(a² + 1), the difference to
    // a level is a polynomial whose signs change twice for a level above zero and once for one below: by Descartes'
    // rule there is one peak, and one crossing on either side of it.
    let growth = |a: f64| c / (a * (a * a + 1.0)) - 1.0 / (a * a * a * a);
    let rises = |a: f64| 4.0 * (a * a + 1.0) * (a * a + 1.0) > c * a * a * a * (3.0 * a * a + 1.0);
    // the growth is negative below the first, less than tan²θ above the second by its first term alone
    let (first, last) = (1.0 / c, libm::cbrt(c / (tan * tan)));
    let peak = last_where(first, last, rises);
    if first >= last || growth(peak) <= tan * tan {
        return Err(Error::NoOptimum);
    }
    let a = last_where(peak, last, |a| growth(a) > tan * tan);
    placement(
        radius_mm,
        radius_mm * sqrt(1.0 + a * a),
        lens_rad,
        weight,
        region,
    )
}

/// The last number of an interval for which `holds`, where it does from the lower end up to some place.
fn last_where(mut yes: f64, mut no: f64, holds: impl Fn(f64) -> bool) -> f64 {
    loop {
        let middle = 0.5 * (yes + no);
        if middle <= yes || middle >= no {
            return yes;
        }
        if holds(middle) {
            yes = middle;
        } else {
            no = middle;
        }
    }
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
