//! How the moments of no force move: with warmth, as references creep, and after bends, as fibres lag.
//!
//! A quarter of a second in which moments are small and stand still tells them: what leans on a hand trembles. How far they
//! stand from where an earlier rest had them says how references creep. Fibres that lag show in the means of their sections:
//! each lags by a share of its own. What lags is considered: all fibres alike put the force off, each by itself the depth.

use super::ToolFilter;
use super::learnt::Rest;
use super::moments::Moments;
use super::state::{N, OFFSETS};
use crate::numbers::math::sqrt;
use crate::tool::sensing::FIBRES;
use nalgebra::Vector2;

/// Readings of a rest that are taken as one; by how much more than noise they may vary, and the noise their mean counts
/// with, over one reading's.
const COMPARED: f64 = 50.0;
const STILL: f64 = 1.4;
const NOISE: f64 = 0.2;
/// Beyond these a moment is none of a rest: as a fibre's shift, squared, nm², and over noise and what fibres lag, squared;
/// what they may lag before anything was seen of it, over the bend, squared.
const RESTS_NM2: f64 = 2e-6;
const RESTS_NOISE: f64 = 9.0;
const MAY_LAG: f64 = 1e-5;
/// Rests are compared that lie further apart than this, s; deviations beyond which a change is no noise; what is left of a
/// change after another.
const APART_S: f64 = 1.5;
const BEYOND: f64 = 2.5;
const KEEPS: f64 = 0.9;
/// How long a bend is remembered, and over which time what it left is, s.
const BENT_S: f64 = 20.0;
const LAGS_S: f64 = 1.0;
/// Means of sections are smoothed over the one, and go from where they are over the other, s; for so long is remembered what
/// they say, s.
const SMOOTH_S: f64 = 0.25;
const WARMTH_S: f64 = 10.0;
const LAG_S: f64 = 30.0;
/// Square of how much fibres lag over what shows of it in their means: those of three that scatter by a third.
const SHOWS: f64 = 81.0;
/// What they may lag before anything was seen of it, over the bend, squared; and the bend that this counts as, nm⁴ s.
const BEFORE: f64 = 4e-5;
const BEFORE_NM4_S: f64 = 0.005;
/// How much of it a bend may leave, squared; how much of it, squared, one section lags unlike the other.
const LEFT: f64 = 1.0 / 7.0;
const UNLIKE: f64 = 1.0 / 32.0;
/// The least and the largest lag over the bend, squared; how far the warmth of two gratings differs, nm.
const LEAST: f64 = 4e-8;
const MOST: f64 = 1e-2;
pub(super) const APART_NM: f64 = 1e-3;

impl ToolFilter {
    /// What the means of sections say of a lag: each fibre lags by a share of its own, and so they do not add up to nothing.
    #[inline]
    pub(super) fn learn_lag(&mut self, m: &Moments, third: Option<f64>, elapsed_s: f64) {
        let [one, two, _] = m.means_nm;
        let [p, q] = self.gratings.bends(m);
        let white = self.gratings.noise.min(self.watch.jitter) / 3.0;
        let (o, mut shows) = (&mut self.offsets, 0.0);
        let apart = [Some(one - two), third.map(|x| x - 0.5 * (one + two))];
        let share = (elapsed_s / SMOOTH_S).min(1.0);
        for (k, noise) in [4.0, 3.0].into_iter().enumerate() {
            let Some(nm) = apart[k] else {
                o.means[k] = [0.0; 3];
                continue;
            };
            let [quick, warm, known_s] = &mut o.means[k];
            *known_s = (*known_s + elapsed_s).min(WARMTH_S);
            *quick += (nm - *quick) * (elapsed_s / known_s.min(SMOOTH_S)).min(1.0);
            *warm += (nm - *warm) * (elapsed_s / *known_s).min(1.0);
            if *known_s > SMOOTH_S {
                let left = *quick - *warm;
                shows += left * left - noise * white * share / (2.0 - share);
            }
        }
        let (keeps, bend) = ((1.0 - elapsed_s / LAG_S).max(0.0), sqrt(p * q));
        o.shows = o.shows * keeps + shows * bend * elapsed_s;
        o.by_bend = o.by_bend * keeps + bend * bend * elapsed_s;
        let told = SHOWS * o.shows + BEFORE * BEFORE_NM4_S;
        o.lag = (told / (o.by_bend + BEFORE_NM4_S)).clamp(LEAST, MOST) - LEAST;
    }

    /// Variance of a component of a section's moment by what its fibres lag, (mN·mm)².
    #[inline]
    fn lagging_moment(&self, section: usize) -> f64 {
        self.offsets.lag * self.offsets.bent[section] * self.gratings.per_nm[section]
    }

    /// By what they lag unlike those of the other section.
    #[inline]
    pub(super) fn lagging(&self, section: usize) -> f64 {
        UNLIKE * self.lagging_moment(section)
    }

    /// Variance of a component of a force, mN², that counts moments so, by what all fibres lag alike.
    #[inline]
    pub(super) fn lagging_force(&self, by_moments: [f64; 2]) -> f64 {
        let of = |i: usize| by_moments[i] * sqrt(self.lagging_moment(i));
        (of(0) + of(1)) * (of(0) + of(1))
    }

    /// A reading's bends and warmth: the moments of no force are known less by what these bring.
    #[inline]
    pub(super) fn unsettle(&mut self, m: &Moments, elapsed_s: f64) {
        let (o, g) = (&mut self.offsets, &self.gratings);
        let bends = g.bends(m);
        let keeps = (1.0 - 2.0 * elapsed_s / BENT_S).max(0.0);
        let warmer = (0.5 * (m.means_nm[0] + m.means_nm[1]) - o.warm) * self.trusted.doubt.warmth;
        let waited = o.last.map_or(0.0, |(at, _)| self.state.time_s - at);
        o.crept = o.moved * (waited * waited / o.waited.max(1e-9)).min(1.0);
        for i in 0..2 {
            o.bent[i] = (o.bent[i] * keeps).max(bends[i].min(64.0));
            let most = (o.crept + warmer * warmer + LEFT * o.lag * o.bent[i]) * g.per_nm[i];
            for k in [OFFSETS + 2 * i, OFFSETS + 2 * i + 1] {
                let own = &mut self.state.p[k][k];
                *own += (most - *own).max(0.0) * (elapsed_s / LAGS_S).min(1.0);
            }
        }
    }

    /// A reading of a whole tool: where moments are small and stand still, nothing touches.
    #[inline]
    pub(super) fn rest(&mut self, m: &Moments, third: Option<&[f64; FIBRES]>) {
        let (s, o, g) = (&mut self.state, &mut self.offsets, &self.gratings);
        let variance = g.per_nm.map(|v| v * g.noise);
        for k in 0..4 {
            let felt = m.m[k / 2][k % 2] + s.x[OFFSETS + k];
            let most = RESTS_NM2 + RESTS_NOISE * (g.noise + o.lag.max(MAY_LAG) * o.bent[k / 2]);
            if !(felt * felt < g.per_nm[k / 2] * most) {
                o.now = Rest::default();
                return;
            }
            o.now.moments[k] += felt;
            o.now.squares += felt * felt / variance[k / 2];
        }
        o.now.third += third.map_or(Vector2::repeat(f64::NAN), |s| g.of_third(s));
        o.now.count += 1.0;
        if o.now.count < COMPARED {
            return;
        }
        let told = o.now.moments.map(|sum| sum / COMPARED);
        let (third, mut within) = (o.now.third / COMPARED, o.now.squares / COMPARED);
        o.now = Rest::default();
        for k in 0..4 {
            within -= told[k] * told[k] / variance[k / 2];
        }
        if within > 4.0 * STILL {
            return;
        }
        if third.x.is_finite() {
            (self.tip.zero, self.tip.bent) = (third, 0.0);
        }
        for k in 0..4 {
            let mut h = [0.0; N];
            h[OFFSETS + k] = 1.0;
            let seen = s.see(&h, NOISE * variance[k / 2]);
            s.take(&seen, told[k] - s.x[OFFSETS + k]);
        }
        o.warm = 0.5 * (m.means_nm[0] + m.means_nm[1]);
        if let Some((at_s, before)) = o.last {
            let waited = s.time_s - at_s;
            if waited < APART_S {
                return;
            }
            let mut moved = -BEYOND * BEYOND * 2.0 / COMPARED * g.noise;
            for k in 0..4 {
                moved += 0.25 * (told[k] - before[k]) * (told[k] - before[k]) / g.per_nm[k / 2];
            }
            // what does not move adds up to no credit
            o.moved = (KEEPS * o.moved + moved).max(0.0);
            let more = KEEPS * o.waited + waited * waited;
            o.waited = if o.moved > 0.0 { more } else { 0.0 };
        }
        o.last = Some((s.time_s, told));
    }
}
