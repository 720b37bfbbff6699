//! A second touch, near the tip: section III, which the hole does not bend, measures its force.

use super::ToolFilter;
use super::moments::Shifts;
use super::state::L;
use nalgebra::Vector2;

/// Where section III stands from the tip, mm, and from which depth of the hole on nothing else bends it, mm.
const THIRD_MM: f64 = 5.0;
pub(super) const DEEP_MM: f64 = 7.0;
/// How fast such a force changes, mN²/s; more than this is a fault of gratings, mN.
const CHANGES: f64 = 4.0;
const MOST_MN: f64 = 40.0;
/// How far a grating of III is off its zero by a warmth of its own, squared, nm²: 0.03 K at 10 pm/K.
const ZERO_NM2: f64 = 1e-7;
/// Of the bends of the others, squared: glue that has play lets all fibres lag by one strain.
const PLAY: f64 = 1.0 / 36.0;
/// Squares of deviations from which on there is a force, and down to which.
const FELT: f64 = 16.0;
const GONE: f64 = 6.0;

impl ToolFilter {
    /// The tip's force, where section III tells it.
    #[inline]
    pub(super) fn feel_tip(&mut self, shifts: &Shifts, tells: bool, elapsed_s: f64) {
        let (t, g) = (&mut self.tip, &self.gratings);
        let per = 0.5 * (g.per_nm[0] + g.per_nm[1]) / (THIRD_MM * THIRD_MM);
        let third = g.of_third(&shifts[2]);
        let told = (third - t.zero) / THIRD_MM;
        // what the hole's bends leave in its zero, since it stood near the tip
        if !(self.state.x[L] > DEEP_MM) {
            t.bent = t.bent.max((third.norm_squared() / g.per_nm[0]).min(64.0));
        }
        t.bent = t
            .bent
            .max(PLAY * self.offsets.bent[0].max(self.offsets.bent[1]));
        let tells = tells && told.norm_squared() < MOST_MN * MOST_MN;
        if !(tells && t.tells) {
            (t.force, t.variance) = (Vector2::zeros(), CHANGES);
        }
        t.tells = tells;
        // its zero is known as well as the bench repeats a reference, and its gratings are as warm as each other
        let zero = self.trusted.doubt.reference_nm;
        let lags = self.offsets.lag * t.bent;
        t.of_zero = per * (zero * zero + ZERO_NM2 + self.offsets.crept + lags);
        if tells {
            t.variance += CHANGES * elapsed_s;
            let gain = t.variance / (t.variance + per * g.noise);
            t.force += (told - t.force) * gain;
            t.variance *= 1.0 - gain;
        }
        let least = if t.on { GONE } else { FELT };
        t.on = tells && t.force.norm_squared() > least * (t.variance + t.of_zero);
    }
}
