//! How fast the references creep: learnt from how far the moments of no force have moved from rest to rest.
//!
//! Glue lets go and a grating creeps by a picometre a second; the moment that it makes is that of a force in another hole.
//! A quarter of a second in which nothing touches says how far each moment stands from where an earlier rest had it. The
//! squares of such changes beyond noise, over those of the times between, are the pace of the creep squared. From then on
//! the offsets are known less by as much, for as long again as it was seen.

use super::state::{Known, OFFSETS};

/// Readings of a rest that are compared as one.
const COMPARED: f64 = 50.0;
/// Rests are compared that lie further apart than this, s.
const APART_S: f64 = 1.5;
/// Deviations beyond which a change is no noise; what is left of a change after another.
const BEYOND: f64 = 2.5;
const KEEPS: f64 = 0.9;
/// How far references may have crept unseen where nothing else explains a reading, nm.
const UNSEEN_NM: f64 = 5e-3;

/// Moments of no force since the last comparison, and what was learnt of all before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Creep {
    /// Variance of a moment's component by a squared nanometre of each grating, sections I and II.
    per_nm: [f64; 2],
    /// Sums of moments, and how many.
    sums: [f64; 4],
    count: f64,
    /// The moments of the last rest, their variances, and its time, s.
    rest: [f64; 4],
    variance: [f64; 4],
    at_s: f64,
    sections: [Pace; 2],
}

/// Of a section: squares of changes, nm², of the times in which they came, s², and the pace squared, (nm/s)².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Pace {
    moved: f64,
    waited: f64,
    square: f64,
}

impl Pace {
    /// A change by so much more than noise, squared, in this time. What does not move adds up to no credit.
    fn add(&mut self, moved: f64, elapsed_s: f64) {
        self.moved = KEEPS * self.moved + moved;
        self.waited = KEEPS * self.waited + elapsed_s * elapsed_s;
        if self.moved > 0.0 {
            self.square = self.moved / self.waited;
        } else {
            *self = Self::default();
        }
    }
}

impl Creep {
    pub(super) fn new(per_nm: [f64; 2]) -> Self {
        Self {
            per_nm,
            sums: [0.0; 4],
            count: 0.0,
            rest: [0.0; 4],
            variance: [0.0; 4],
            at_s: f64::NAN,
            sections: [Pace::default(); 2],
        }
    }

    /// From one time to a later one the offsets may creep on, for as long as they were seen to.
    #[inline]
    pub(super) fn pass(&self, from_s: f64, to_s: f64, known: &mut Known) {
        for (i, pace) in self.sections.iter().enumerate() {
            if pace.square > 0.0 {
                let squared = |s: f64| ((s - self.at_s) * (s - self.at_s)).min(pace.waited);
                let more = pace.square * (squared(to_s) - squared(from_s)) * self.per_nm[i];
                for k in [2 * i, 2 * i + 1] {
                    known.p[OFFSETS + k][OFFSETS + k] += more;
                }
            }
        }
    }

    /// A depth is off by what no fault explains: another hole, or references that have crept unseen, so that they are doubted
    /// as well.
    pub(super) fn doubt(&self, known: &mut Known) {
        for k in 0..4 {
            let own = &mut known.p[OFFSETS + k][OFFSETS + k];
            *own = own.max(UNSEEN_NM * UNSEEN_NM * self.per_nm[k / 2]);
        }
    }

    /// Four moments of no force, and the variance of each.
    pub(super) fn rest(&mut self, now_s: f64, felt: [(f64, f64); 4]) {
        for (sum, (moment, _)) in self.sums.iter_mut().zip(felt) {
            *sum += moment;
        }
        self.count += 1.0;
        if self.count < COMPARED {
            return;
        }
        let (per, elapsed, sums) = (1.0 / self.count, now_s - self.at_s, self.sums);
        (self.sums, self.count) = ([0.0; 4], 0.0);
        if elapsed < APART_S {
            return;
        }
        let mut moved = [0.0; 2];
        for k in 0..4 {
            let (now, variance) = (sums[k] * per, felt[k].1 * per);
            let change = now - self.rest[k];
            let noise = BEYOND * BEYOND * (self.variance[k] + variance);
            moved[k / 2] += (change * change - noise) / (2.0 * self.per_nm[k / 2]);
            (self.rest[k], self.variance[k]) = (now, variance);
        }
        // the first rest has none before it
        if elapsed >= APART_S {
            for (section, moved) in self.sections.iter_mut().zip(moved) {
                section.add(moved, elapsed);
            }
        }
        self.at_s = now_s;
    }
}
