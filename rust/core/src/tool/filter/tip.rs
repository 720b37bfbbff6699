//! A second touch, near the tip: section III, which the hole does not bend, measures its force.

use super::moments::{Gratings, Moments, Shifts};
use super::offsets::Offsets;
use nalgebra::Vector2;

/// Where section III stands from the tip, mm, and from which depth of the hole on nothing else bends it, mm.
const THIRD_MM: f64 = 5.0;
pub(super) const DEEP_MM: f64 = 7.0;
/// How fast such a force changes, mN²/s; more than this is a fault of gratings, mN.
const CHANGES: f64 = 4.0;
const MOST_MN: f64 = 40.0;
/// How far a grating of III is off its zero by a warmth of its own, squared, nm²: 0.03 K at 10 pm/K.
const ZERO_NM2: f64 = 1e-7;
/// Glue that has play lets all fibres lag, squared, nm², by what the hole bends the others: a sixth of that.
const PLAY_NM2: f64 = 1.0 / 36.0;
/// Squares of deviations from which on there is a force, and down to which.
const FELT: f64 = 16.0;
const GONE: f64 = 6.0;
/// How far off the tip's force is, over the force: nobody says where section III stands.
const SHARE: f64 = 0.15;

/// Force at the tip, tool frame, mN, the variance of a component by noise, and of its zero, mN².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Tip {
    pub(super) force: Vector2<f64>,
    pub(super) variance: f64,
    pub(super) of_zero: f64,
    /// The moment of section III at rest, mN·mm.
    pub(super) zero: Vector2<f64>,
    pub(super) tells: bool,
    /// Whether it is one.
    pub(super) on: bool,
}

impl Tip {
    /// The tip's force, where section III tells it: it is believed, and the hole stands deep enough not to bend it.
    #[inline]
    pub(super) fn feel(
        &mut self,
        g: &Gratings,
        o: &Offsets,
        reference_nm: f64,
        shifts: &Shifts,
        (believed, deep): (bool, bool),
        elapsed_s: f64,
    ) {
        let per = 0.5 * (g.per_nm[0] + g.per_nm[1]) / (THIRD_MM * THIRD_MM);
        let third = g.of_third(&shifts[2]);
        let told = (third - self.zero) / THIRD_MM;
        let tells = believed && deep && told.norm_squared() < MOST_MN * MOST_MN;
        if !(tells && self.tells) {
            (self.force, self.variance) = (Vector2::zeros(), CHANGES);
        }
        self.tells = tells;
        // its zero is known as well as the bench repeats a reference, and its gratings are as warm as each other
        let lags = o.lag * PLAY_NM2;
        self.of_zero = per * (reference_nm * reference_nm + ZERO_NM2 + o.crept + lags);
        if tells {
            self.variance += CHANGES * elapsed_s;
            let gain = self.variance / (self.variance + per * g.noise);
            self.force += (told - self.force) * gain;
            self.variance *= 1.0 - gain;
        }
        let least = if self.on { GONE } else { FELT };
        self.on = tells && self.force.norm_squared() > least * (self.variance + self.of_zero);
    }

    /// Takes it off moments at these distances, mm.
    #[inline]
    pub(super) fn off(&self, m: &Moments, distances_mm: [f64; 2]) -> Moments {
        let mut left = *m;
        if self.on {
            for i in 0..2 {
                let of_tip = self.force * distances_mm[i];
                left.m[i] -= of_tip;
                left.z[i] -= m.j[i] * of_tip;
            }
        }
        left
    }

    /// Variance of a component that lasts, mN²; and with its noise, where there is such a force.
    #[inline]
    pub(super) fn lasting(&self) -> f64 {
        let share = f64::from(u8::from(self.on)) * SHARE * SHARE * self.force.norm_squared();
        f64::from(u8::from(self.tells)) * (self.of_zero + share)
    }

    #[inline]
    pub(super) fn unsure(&self) -> f64 {
        f64::from(u8::from(self.on)) * (self.variance + self.lasting())
    }
}
