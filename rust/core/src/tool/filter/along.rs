//! How the hole moves along the shaft, by what readings correct of the depth: by itself, and with the shaft.
//!
//! Corrections beside how the shaft slid meanwhile say whether it goes along. Of a hole that stays, corrections are by chance. Of one that the shaft takes along they are a share of each slide, the other
//! way; a zero of the bench, a pace of straying or a late robot are none.

use crate::numbers::math::sqrt;

/// Innovations that pull one way: over this time, s; how far the logarithm of the hole's drift follows; the largest
/// product that counts; the first drift and the fastest over the slowest.
const INNOVATIONS_S: f64 = 0.2;
const FOLLOWS: f64 = 0.1;
const MOST_ALIKE: f64 = 16.0;
const FIRST_DRIFT: f64 = 4.0;
const FASTEST: f64 = 256.0;
/// Slides are compared over this time, s; a longer one without a depth is left out, s.
const OVER_S: f64 = 0.5;
const GAP_S: f64 = 0.1;
/// The least share that is one, and how many of its deviations; so many comparisons at least, and those that are left out
/// at first: they correct where the tool was thought to start.
const SHARE: f64 = 0.04;
const BEYOND: f64 = 3.0;
const LEAST: f64 = 20.0;
const SETTLES: f64 = 10.0;

/// Sums of innovations and of one over their variances; since when; what the last sum was over its deviation; the process
/// noise to use, mm²/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Drift {
    pub(super) sum: f64,
    pub(super) weight: f64,
    pub(super) since_s: f64,
    pub(super) before: f64,
    pub(super) per_second: f64,
}

impl Drift {
    pub(super) fn new(since_s: f64, slowest: f64) -> Self {
        let (sum, weight, before, per_second) = (0.0, 0.0, 0.0, FIRST_DRIFT * slowest);
        Self {
            sum,
            weight,
            since_s,
            before,
            per_second,
        }
    }

    /// How fast the hole strays along the shaft: where the process noise is right, innovations are independent, and the sum
    /// of those of one moment has nothing to do with that of the next (Mehra, *IEEE Trans. Automatic Control* 15, 1970).
    #[inline]
    pub(super) fn add(&mut self, innovation: f64, variance: f64, time_s: f64, slowest: f64) {
        self.sum += innovation / variance;
        self.weight += 1.0 / variance;
        let now = self.sum / sqrt(self.weight);
        if time_s - self.since_s < INNOVATIONS_S {
            return;
        }
        let now = if now.is_finite() { now } else { 0.0 };
        let alike = (now * self.before).clamp(-MOST_ALIKE, MOST_ALIKE);
        let next = self.per_second * libm::exp(FOLLOWS * alike);
        self.per_second = next.min(slowest * FASTEST).max(slowest);
        (self.sum, self.weight, self.since_s, self.before) = (0.0, 0.0, time_s, now);
    }
}

/// Of the present window: since when, the slide and the correction, mm. Over all windows: how many, products of both, squares
/// of slides and of corrections, mm².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Along {
    last_s: f64,
    since_s: f64,
    slid: f64,
    moved: f64,
    count: f64,
    sums: [f64; 3],
}

impl Along {
    /// The depth was corrected after a slide since the last time that it was told, mm.
    #[inline]
    pub(super) fn add(&mut self, time_s: f64, slid: f64, moved: f64) {
        let gap = time_s - self.last_s > GAP_S;
        self.last_s = time_s;
        if !gap {
            (self.slid, self.moved) = (self.slid + slid, self.moved + moved);
            if time_s - self.since_s <= OVER_S {
                return;
            }
            let (k, c) = (self.slid, self.moved);
            self.count += 1.0;
            if self.count > SETTLES {
                let [both, slides, corrections] = self.sums;
                self.sums = [both + k * c, slides + k * k, corrections + c * c];
            }
        }
        (self.since_s, self.slid, self.moved) = (time_s, 0.0, 0.0);
    }

    /// The share of a slide by which the hole goes along; zero where that may be chance.
    pub(super) fn share(&self) -> f64 {
        let ([both, slides, corrections], n) = (self.sums, self.count - SETTLES);
        let share = -both / slides;
        let noise = sqrt((corrections - share * share * slides).max(0.0) / (n * slides));
        let sure = n > LEAST && share > SHARE.max(BEYOND * noise);
        if sure { share } else { 0.0 }
    }
}
