//! Sine, cosine and arc tangent without branches, so that a loop over many angles becomes vector instructions.
//!
//! Errors stay below two units in the last place: sine and cosine after the kernels of Sun's fdlibm (reduction by
//! π/2 in three parts, Cody and Waite), the arc tangent after Moshier's Cephes. Angles beyond [`LARGEST_RAD`] lose
//! accuracy in the reduction; [`crate::numbers::math::sin_cos`] has no such limit. NaN and infinity give NaN.

use crate::numbers::math::Real;
use core::f64::consts::{FRAC_2_PI, FRAC_PI_2, FRAC_PI_4, PI};

/// Largest angle that [`sin_cos`] reduces accurately, rad: 160 000 turns.
pub const LARGEST_RAD: f64 = 1e6;

/// Adding and taking it away rounds to the nearest integer.
const ROUNDER: f64 = 6_755_399_441_055_744.0;

/// π/2 in three parts; products of the first two with an integer below 2²⁰ are exact.
const HALF_PI: [f64; 3] = [
    1.570_796_326_734_125_6,
    6.077_100_506_303_966e-11,
    2.022_266_248_795_950_6e-21,
];

const FIRST_OF_SINE: f64 = -1.666_666_666_666_663_2e-1;

const SINE: [f64; 5] = [
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

/// `Σ c_k z^k`.
#[inline(always)]
fn polynomial<T: Real, const N: usize>(z: T, c: &[f64; N]) -> T {
    let mut sum = T::splat(c[N - 1]);
    for k in (0..N - 1).rev() {
        sum = T::splat(c[k]) + z * sum;
    }
    sum
}

/// The nearest integer.
#[inline(always)]
fn nearest<T: Real>(x: T) -> T {
    (x + T::splat(ROUNDER)) - T::splat(ROUNDER)
}

/// Sine and cosine of an angle in radians, up to [`LARGEST_RAD`]; one or many side by side.
#[inline(always)]
#[must_use]
pub fn sin_cos<T: Real>(angle_rad: T) -> (T, T) {
    let of = T::splat;
    let n = nearest(angle_rad * of(FRAC_2_PI));
    let coarse = angle_rad - n * of(HALF_PI[0]);
    let middle = n * of(HALF_PI[1]);
    let fine = coarse - middle;
    let rest = n * of(HALF_PI[2]) - ((coarse - fine) - middle);
    let y = fine - rest;
    let tail = (fine - y) - rest;
    let z = y * y;
    let cube = z * y;
    let r = polynomial(z, &SINE);
    let sin = y - ((z * (of(0.5) * tail - cube * r) - tail) - cube * of(FIRST_OF_SINE));
    let r = z * polynomial(z, &COSINE);
    let half = of(0.5) * z;
    let w = of(1.0) - half;
    let cos = w + (((of(1.0) - w) - half) + (z * r - y * tail));
    // the quadrant, from -2 to 2: odd ones swap the two, and each has its own sign
    let quadrant = n - of(4.0) * nearest(n * of(0.25));
    let odd = (quadrant.size() - of(1.0)).size();
    let (one, minus) = (of(1.0), of(-1.0));
    let up = (quadrant - of(0.5)).size().above(one, minus, one);
    let across = (quadrant + of(0.5)).size().above(one, minus, one);
    (
        up * of(0.5).above(odd, cos, sin),
        across * of(0.5).above(odd, sin, cos),
    )
}

const NUMERATOR: [f64; 5] = [
    -6.485_021_904_942_025e1,
    -1.228_866_684_490_136_1e2,
    -7.500_855_792_314_705e1,
    -1.615_753_718_733_365e1,
    -8.750_608_600_031_904e-1,
];

const DENOMINATOR: [f64; 6] = [
    1.945_506_571_482_614e2,
    4.853_903_996_359_137e2,
    4.328_810_604_912_902_7e2,
    1.650_270_098_316_988_5e2,
    2.485_846_490_142_306_3e1,
    1.0,
];

/// What π/2 is beyond its double.
const HALF_PI_REST: f64 = 6.123_233_995_736_766e-17;
/// tan 3π/8: above it the arc tangent is taken of the reciprocal.
const STEEP: f64 = 2.414_213_562_373_095;

/// Angle of the direction `(x, y)` from the x axis, rad, in (-π, π]; NaN where both are zero. One or many side by
/// side.
#[inline(always)]
#[must_use]
pub fn atan2<T: Real>(y: T, x: T) -> T {
    let of = T::splat;
    let (up, across) = (y.size(), x.size());
    let (steep, diagonal) = (of(STEEP) * across, of(0.66) * across);
    let pick = |low: T, middle: T, high: T| up.above(steep, high, up.above(diagonal, middle, low));
    let t = pick(up, up - across, of(0.0) - across) / pick(across, up + across, up);
    let base = pick(of(0.0), of(FRAC_PI_4), of(FRAC_PI_2));
    let rest = pick(of(0.0), of(0.5 * HALF_PI_REST), of(HALF_PI_REST));
    let z = t * t;
    let ratio = polynomial(z, &NUMERATOR) / polynomial(z, &DENOMINATOR);
    let angle = base + (t + (t * (z * ratio) + rest));
    let behind = of(PI) - (angle - of(2.0 * HALF_PI_REST));
    of(0.0).above(x, behind, angle).signed(y)
}
