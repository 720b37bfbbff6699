//! How the moments of no force move: with warmth, as references creep, and after bends, as fibres lag.
//!
//! A quarter of a second in which moments are small and stand still tells them: what leans on a hand trembles. How long ago
//! that was says how far they may have crept since. Fibres that lag show in the means of their sections:
//! each lags by a share of its own. What lags is considered: all fibres alike put the force off, each by itself the depth.

use super::moments::{Gratings, Moments};
use super::state::{N, OFFSETS, State};
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
/// Glue with play follows the least bend by as much too late as a large one, squared, nm²: of a middle bend.
pub(super) const PLAY_NM2: f64 = 1.0;
/// How much of it a bend may leave, squared; how much of it, squared, one section lags unlike the other.
const LEFT: f64 = 1.0 / 7.0;
const UNLIKE: f64 = 1.0 / 32.0;
/// The least and the largest lag over the bend, squared; how far the warmth of two gratings differs, nm, and how long after a
/// rest it does so, s.
const LEAST: f64 = 4e-8;
const MOST: f64 = 1e-2;
pub(super) const APART_NM: f64 = 1e-3;
const APART_S: f64 = 30.0;

/// Sums over a rest: of moments and of their squares over their variances, of section III, and how many.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Rest {
    pub(super) moments: [f64; 4],
    pub(super) squares: f64,
    pub(super) third: Vector2<f64>,
    pub(super) count: f64,
}

/// What was learnt of them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Offsets {
    pub(super) now: Rest,
    /// The last rest, s; how far a reference may have crept since, nm²; warmth then, nm.
    pub(super) rested_s: Option<f64>,
    pub(super) crept: f64,
    pub(super) warm: f64,
    /// Bends of late, as a fibre's shift squared, nm²; the lag over the bend, squared.
    pub(super) bent: [f64; 2],
    pub(super) lag: f64,
    /// Differences of means, of I and II and of III and both: smoothed, where they go from, nm, and since when they are known,
    /// s. Their squares beyond noise over bends squared, nm⁴ s, and bends to the fourth.
    pub(super) means: [[f64; 3]; 2],
    pub(super) shows: f64,
    pub(super) by_bend: f64,
}

impl Offsets {
    /// What the means of sections say of a lag: each fibre lags by a share of its own, and so they do not add up to nothing.
    #[inline]
    pub(super) fn learn_lag(
        &mut self,
        g: &Gratings,
        jitter: f64,
        m: &Moments,
        third: Option<f64>,
        elapsed_s: f64,
    ) {
        let [one, two, _] = m.means_nm;
        let [p, q] = g.bends(m);
        // what a bench that lags calls noise is none of a reading's
        let white = g.noise.min(jitter) / 3.0;
        let mut shows = 0.0;
        let apart = [Some(one - two), third.map(|x| x - 0.5 * (one + two))];
        let share = (elapsed_s / SMOOTH_S).min(1.0);
        for (k, noise) in [4.0, 3.0].into_iter().enumerate() {
            let Some(nm) = apart[k] else {
                self.means[k] = [0.0; 3];
                continue;
            };
            let [quick, warm, known_s] = &mut self.means[k];
            *known_s = (*known_s + elapsed_s).min(WARMTH_S);
            *quick += (nm - *quick) * (elapsed_s / known_s.min(SMOOTH_S)).min(1.0);
            *warm += (nm - *warm) * (elapsed_s / *known_s).min(1.0);
            if *known_s > SMOOTH_S {
                let left = *quick - *warm;
                shows += left * left - noise * white * share / (2.0 - share);
            }
        }
        let (keeps, bend) = ((1.0 - elapsed_s / LAG_S).max(0.0), sqrt(p * q));
        self.shows = self.shows * keeps + shows * bend * elapsed_s;
        self.by_bend = self.by_bend * keeps + bend * bend * elapsed_s;
        let told = SHOWS * self.shows + BEFORE * BEFORE_NM4_S;
        self.lag = (told / (self.by_bend + BEFORE_NM4_S)).clamp(LEAST, MOST) - LEAST;
    }

    /// Variance of a component of a section's moment by what its fibres lag, (mN·mm)².
    #[inline]
    fn lagging_moment(&self, g: &Gratings, section: usize) -> f64 {
        self.lag * self.bent[section].max(PLAY_NM2) * g.per_nm[section]
    }

    /// By what they lag unlike those of the other section.
    #[inline]
    pub(super) fn lagging(&self, g: &Gratings, section: usize) -> f64 {
        UNLIKE * self.lagging_moment(g, section)
    }

    /// Variance of a component of a force, mN², that counts moments so, by what all fibres lag alike.
    #[inline]
    pub(super) fn lagging_force(&self, g: &Gratings, by_moments: [f64; 2]) -> f64 {
        let of = |i: usize| by_moments[i] * sqrt(self.lagging_moment(g, i));
        (of(0) + of(1)) * (of(0) + of(1))
    }

    /// A reading's bends and warmth: the moments of no force are known less by what these bring; `doubt` is what is not known
    /// of a fibre's own answer to warmth.
    #[inline]
    pub(super) fn unsettle(
        &mut self,
        s: &mut State,
        g: &Gratings,
        doubt: f64,
        m: &Moments,
        elapsed_s: f64,
    ) {
        let bends = g.bends(m);
        let keeps = (1.0 - 2.0 * elapsed_s / BENT_S).max(0.0);
        let warmer = (0.5 * (m.means_nm[0] + m.means_nm[1]) - self.warm) * doubt;
        let since = |at: f64| ((s.time_s - at) / APART_S).min(1.0);
        let apart = APART_NM * self.rested_s.map_or(1.0, since);
        self.crept = apart * apart;
        for i in 0..2 {
            self.bent[i] = (self.bent[i] * keeps).max(bends[i].min(64.0));
            let most =
                (self.crept + warmer * warmer + LEFT * self.lag * self.bent[i]) * g.per_nm[i];
            for k in [OFFSETS + 2 * i, OFFSETS + 2 * i + 1] {
                let own = &mut s.p[k][k];
                *own += (most - *own).max(0.0) * (elapsed_s / LAGS_S).min(1.0);
            }
        }
    }

    /// A reading of a whole tool: where moments are small and stand still, nothing touches. The moment of section III then,
    /// where a rest is over and III told it.
    #[inline]
    pub(super) fn rest(
        &mut self,
        s: &mut State,
        g: &Gratings,
        m: &Moments,
        third: Option<&[f64; FIBRES]>,
    ) -> Option<Vector2<f64>> {
        let variance = g.per_nm.map(|v| v * g.noise);
        for k in 0..4 {
            let felt = m.m[k / 2][k % 2] + s.x[OFFSETS + k];
            let most =
                RESTS_NM2 + RESTS_NOISE * (g.noise + self.lag.max(MAY_LAG) * self.bent[k / 2]);
            if !(felt * felt < g.per_nm[k / 2] * most) {
                self.now = Rest::default();
                return None;
            }
            self.now.moments[k] += felt;
            self.now.squares += felt * felt / variance[k / 2];
        }
        self.now.third += third.map_or(Vector2::repeat(f64::NAN), |s| g.of_third(s));
        self.now.count += 1.0;
        if self.now.count < COMPARED {
            return None;
        }
        let told = self.now.moments.map(|sum| sum / COMPARED);
        let (third, mut within) = (self.now.third / COMPARED, self.now.squares / COMPARED);
        self.now = Rest::default();
        for k in 0..4 {
            within -= told[k] * told[k] / variance[k / 2];
        }
        if within > 4.0 * STILL {
            return None;
        }
        let third = third.x.is_finite().then_some(third);
        for k in 0..4 {
            let mut h = [0.0; N];
            h[OFFSETS + k] = 1.0;
            let seen = s.see(&h, NOISE * variance[k / 2]);
            s.take(&seen, told[k] - s.x[OFFSETS + k]);
        }
        self.warm = 0.5 * (m.means_nm[0] + m.means_nm[1]);
        self.rested_s = Some(s.time_s);
        third
    }
}
