//! Sine, cosine and arc tangent without branches, so that a loop over many angles becomes vector instructions.
//!
//! Errors stay below two units in the last place: sine and cosine after the kernels of Sun's fdlibm (reduction by
//! π/2 in three parts, Cody and Waite), the arc tangent after Moshier's Cephes. Angles beyond [`LARGEST_RAD`] lose
//! accuracy in the reduction; [`crate::math::sin_cos`] has no such limit. NaN and infinity give NaN.

use core::f64::consts::{FRAC_2_PI, FRAC_PI_2, FRAC_PI_4, PI};

/// Largest angle that [`sin_cos`] reduces accurately, rad: 160 000 turns.
pub const LARGEST_RAD: f64 = 1e6;

/// Adding and taking it away rounds to the nearest integer, which then stands in the lowest bits.
const ROUNDER: f64 = 6_755_399_441_055_744.0;

/// π/2 in three parts; products of the first two with an integer below 2²⁰ are exact.
const HALF_PI: [f64; 3] = [
    1.570_796_326_734_125_6,
    6.077_100_506_303_966e-11,
    2.022_266_248_795_950_6e-21,
];

const SINE: [f64; 6] = [
    -1.666_666_666_666_663_2e-1,
    8.333_333_333_322_49e-3,
    -1.984_126_982_985_795e-4,
    2.755_731_370_707_006_8e-6,
    -2.505_076_025_340_686_3e-8,
    1.589_690_995_211_55e-10,
];

const COSINE: [f64; 6] = [
    4.166_666_666_666_66e-2,
    -1.388_888_888_887_411e-3,
    2.480_158_728_947_673e-5,
    -2.755_731_435_139_066_3e-7,
    2.087_572_321_298_175e-9,
    -1.135_964_755_778_819_5e-11,
];

/// Sine and cosine of an angle in radians, up to [`LARGEST_RAD`].
#[inline(always)]
#[must_use]
pub fn sin_cos(angle_rad: f64) -> (f64, f64) {
    let shifted = angle_rad * FRAC_2_PI + ROUNDER;
    let quadrant = shifted.to_bits();
    let n = shifted - ROUNDER;
    let coarse = angle_rad - n * HALF_PI[0];
    let middle = n * HALF_PI[1];
    let fine = coarse - middle;
    let rest = n * HALF_PI[2] - ((coarse - fine) - middle);
    let y = fine - rest;
    let tail = (fine - y) - rest;
    let z = y * y;
    let cube = z * y;
    let s = SINE;
    let r = s[1] + z * (s[2] + z * (s[3] + z * (s[4] + z * s[5])));
    let sin = y - ((z * (0.5 * tail - cube * r) - tail) - cube * s[0]);
    let c = COSINE;
    let r = z * (c[0] + z * (c[1] + z * (c[2] + z * (c[3] + z * (c[4] + z * c[5])))));
    let half = 0.5 * z;
    let w = 1.0 - half;
    let cos = w + (((1.0 - w) - half) + (z * r - y * tail));
    // odd quadrants swap the two; the sign bit comes from the quadrant's second bit
    let swap = quadrant & 1 != 0;
    let (a, b) = if swap { (cos, sin) } else { (sin, cos) };
    let flip_a = (quadrant & 2) << 62;
    let flip_b = ((quadrant.wrapping_add(1)) & 2) << 62;
    (
        f64::from_bits(a.to_bits() ^ flip_a),
        f64::from_bits(b.to_bits() ^ flip_b),
    )
}

const NUMERATOR: [f64; 5] = [
    -6.485_021_904_942_025e1,
    -1.228_866_684_490_136_1e2,
    -7.500_855_792_314_705e1,
    -1.615_753_718_733_365e1,
    -8.750_608_600_031_904e-1,
];

const DENOMINATOR: [f64; 5] = [
    1.945_506_571_482_614e2,
    4.853_903_996_359_137e2,
    4.328_810_604_912_902_7e2,
    1.650_270_098_316_988_5e2,
    2.485_846_490_142_306_3e1,
];

/// What π/2 is beyond its double.
const HALF_PI_REST: f64 = 6.123_233_995_736_766e-17;
/// tan 3π/8: above it the arc tangent is taken of the reciprocal.
const STEEP: f64 = 2.414_213_562_373_095;

/// Angle of the direction `(x, y)` from the x axis, rad, in (-π, π]; NaN where both are zero.
#[inline(always)]
#[must_use]
pub fn atan2(y: f64, x: f64) -> f64 {
    let (up, across) = (y.abs(), x.abs());
    let steep = up > STEEP * across;
    let diagonal = up > 0.66 * across;
    let numerator = if diagonal { up - across } else { up };
    let numerator = if steep { -across } else { numerator };
    let denominator = if diagonal { up + across } else { across };
    let denominator = if steep { up } else { denominator };
    let base = if diagonal { FRAC_PI_4 } else { 0.0 };
    let base = if steep { FRAC_PI_2 } else { base };
    let rest = if diagonal { 0.5 * HALF_PI_REST } else { 0.0 };
    let rest = if steep { HALF_PI_REST } else { rest };
    let t = numerator / denominator;
    let z = t * t;
    let p = NUMERATOR;
    let q = DENOMINATOR;
    let top = p[0] + z * (p[1] + z * (p[2] + z * (p[3] + z * p[4])));
    let bottom = q[0] + z * (q[1] + z * (q[2] + z * (q[3] + z * (q[4] + z))));
    let angle = base + (t + (t * (z * (top / bottom)) + rest));
    let angle = if x < 0.0 {
        PI - (angle - 2.0 * HALF_PI_REST)
    } else {
        angle
    };
    angle.copysign(y)
}
