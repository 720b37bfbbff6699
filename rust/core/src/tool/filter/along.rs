//! Whether the hole goes along with the shaft: what readings correct of the depth, beside how the shaft slid meanwhile.
//!
//! Of a hole that stays, corrections are by chance. Of one that the shaft takes along they are a share of each slide, the other
//! way; a zero of the bench, a pace of straying or a late robot are none.

use crate::numbers::math::sqrt;

/// Slides are compared over this time, s; a longer one without a depth is left out, s.
const OVER_S: f64 = 0.5;
const GAP_S: f64 = 0.1;
/// The least share that is one, and how many of its deviations; so many comparisons at least.
const SHARE: f64 = 0.04;
const BEYOND: f64 = 3.0;
const LEAST: f64 = 20.0;
/// Comparisons that are left out at first.
const SETTLES: u32 = 10;
/// What went along comes back within about this, s.
const RETURNS_S: f64 = 3.0;

/// Of the present window: since when, the slide and the correction, mm. Over all windows: products of both, squares of slides
/// and of corrections, mm², and how many.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Along {
    last_s: f64,
    since_s: f64,
    slid: f64,
    moved: f64,
    windows: u32,
    sums: [f64; 4],
}

impl Along {
    /// The depth was corrected after a slide since the last time that it was told, mm.
    #[inline]
    pub(super) fn add(&mut self, time_s: f64, slid: f64, moved: f64) {
        if time_s - self.last_s > GAP_S {
            (self.since_s, self.slid, self.moved) = (time_s, 0.0, 0.0);
        } else {
            self.slid += slid;
            self.moved += moved;
        }
        self.last_s = time_s;
        if time_s - self.since_s > OVER_S {
            let (k, c) = (self.slid, self.moved);
            self.windows += 1;
            // the first correct where the tool was thought to start
            if self.windows > SETTLES {
                for (sum, more) in self.sums.iter_mut().zip([k * c, k * k, c * c, 1.0]) {
                    *sum += more;
                }
            }
            (self.since_s, self.slid, self.moved) = (time_s, 0.0, 0.0);
        }
    }

    /// The share of a slide by which the hole goes along; zero where that may be chance.
    #[inline]
    pub(super) fn share(&self) -> f64 {
        let [both, slides, corrections, n] = self.sums;
        let share = -both / slides;
        let noise = sqrt((corrections - share * share * slides).max(0.0) / (n * slides));
        if n > LEAST && share > SHARE.max(BEYOND * noise) {
            share
        } else {
            0.0
        }
    }

    /// Variance of the depth by where the hole has gone, mm².
    pub(super) fn doubt(&self) -> f64 {
        let [_, slides, _, n] = self.sums;
        let share = self.share();
        if share > 0.0 {
            share * share * slides / n * (RETURNS_S / OVER_S)
        } else {
            0.0
        }
    }
}
