//! Where the hole stands in the tool's frame, what else is learnt in a run, and how well all of it is known.
//!
//! The hole stands at `E` in the base. The tool sees it at `(u, -l)`: `l` along its unbent axis, the paper's depth, and `u`
//! aside: clearance, what the shaft gives way and what the hole does, `u = f (c + w + g F)` where the force has the way `f`.
//! When the tool moves, the hole does not: it is carried into the new frame. A turn of the shaft brings what is not known
//! of `u` into `l`, and so the filter learns `c` and `g`.
//!
//! What a filter must not average away is *considered* (Schmidt 1966; Jazwinski, *Stochastic Processes and Filtering Theory*,
//! 8.4): it stands in the covariance, and no measurement moves it. So there is one covariance, and one step.

use crate::numbers::math::sqrt;
use crate::numbers::rigid::Rigid;
use crate::tool::rod::Rod;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Numbers of the state, and their places: `l` (mm), clearance (mm), what the hole gives way (mm/mN), the gratings' turn
/// about the shaft (rad), four moments of no force (mN·mm), how much deeper the gratings count (mm); never learnt, three of
/// the bench ([`Doubt::depth`](super::Doubt)).
pub(super) const N: usize = 12;
pub(super) const L: usize = 0;
pub(super) const CLEARANCE: usize = 1;
pub(super) const GIVES: usize = 2;
pub(super) const TURN: usize = 3;
pub(super) const OFFSETS: usize = 4;
pub(super) const DEEPER: usize = 8;
pub(super) const BENCH: usize = 9;
/// A number for each of the state.
pub(super) type Row = [f64; N];

/// How long speeds are looked at that correct anything, s, and how long those that doubts go by.
const SPEEDS_S: f64 = 0.03;
const DOUBTS_S: f64 = 0.1;

/// The state at the last stamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct State {
    pub(super) time_s: f64,
    pub(super) pose: Rigid,
    pub(super) x: Row,
    pub(super) p: [Row; N],
    /// Deviation of `l` by errors of readings that last, mm: no averaging takes it.
    pub(super) lasting: f64,
    /// Place of the hole aside of the unbent axis, tool's frame, mm; force across the shaft, mN, and its way.
    pub(super) aside: Vector2<f64>,
    pub(super) size: f64,
    pub(super) way: Vector2<f64>,
    /// What the last bend took from `l` for the length of shaft beyond the hole, mm, and from the moments.
    pub(super) short: f64,
    pub(super) relief: [f64; 2],
    /// Whether anything has ever touched; whether the last reading felt nothing of the hole.
    pub(super) touched: bool,
    pub(super) free: bool,
    /// The hole (base frame) when it was last felt; how far beyond its clearance the shaft went since, mm.
    pub(super) hole: Vector3<f64>,
    pub(super) beyond: f64,
    /// How fast the robot goes, mm/s, and products of that, the shaft slides in, and the hole goes aside of the tool, mm/s;
    /// how far the shaft slid in since a depth was told, mm.
    pub(super) speed: Vector3<f64>,
    pub(super) speeds: Matrix3<f64>,
    pub(super) slide: f64,
    pub(super) sideways: Vector2<f64>,
    pub(super) slid: f64,
}

/// What goes with a number that is to be measured, and its variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Seen {
    pub(super) with: Row,
    pub(super) total: f64,
}

impl State {
    /// Before a number is measured that hangs on all by `h`, with this noise: what goes with it, and its variance.
    #[inline]
    pub(super) fn see(&self, h: &Row, noise: f64) -> Seen {
        let (mut with, mut total) = ([0.0; N], noise);
        for j in 0..N {
            for i in 0..N {
                with[i] += self.p[j][i] * h[j];
            }
        }
        for i in 0..N {
            total += h[i] * with[i];
        }
        Seen { with, total }
    }

    /// Schmidt's step by a number that is `innovation` off: no gain for what is considered. False, and nothing done, where
    /// it means nothing.
    #[inline]
    pub(super) fn take(&mut self, seen: &Seen, innovation: f64) -> bool {
        let per_total = 1.0 / seen.total;
        if !(seen.total > 0.0 && (innovation * per_total).is_finite()) {
            return false;
        }
        let (mut gain, mut less) = ([0.0; N], seen.with.map(|w| -w));
        for i in 0..BENCH {
            gain[i] = seen.with[i] * per_total;
            less[i] *= 0.5;
            self.x[i] += gain[i] * innovation;
        }
        for i in 0..N {
            for j in 0..N {
                self.p[i][j] += less[i] * gain[j] + gain[i] * less[j];
            }
            self.p[i][i] = self.p[i][i].max(0.0);
        }
        for k in [CLEARANCE, GIVES] {
            self.x[k] = self.x[k].max(0.0);
        }
        true
    }

    /// Length of shaft beyond the hole as the gratings count it, mm.
    #[inline]
    pub(super) fn arc(&self) -> f64 {
        self.x[L] + self.x[DEEPER] - self.short
    }

    /// Whether the tip is beyond the hole without doubt.
    pub(super) fn surely_inside(&self) -> bool {
        self.x[L] > 0.0 && self.x[L] * self.x[L] > 9.0 * self.p[L][L]
    }

    /// What shaft and hole give way for a force, mm/mN.
    #[inline]
    pub(super) fn gives(&self, shaft: &Rod) -> f64 {
        shaft.gives(self.size * self.size, shaft.arc(self.arc())) + self.x[GIVES]
    }

    /// On to a later time and another pose; the hole, which stays, strays along the shaft by this variance a second.
    #[inline]
    pub(super) fn go(&mut self, time_s: f64, pose: &Rigid, per_second_mm2: f64) {
        let (before, axes) = (self.pose, &pose.rotation);
        let back = |v: Vector3<f64>| {
            let of = |k: usize| axes[(0, k)] * v.x + axes[(1, k)] * v.y + axes[(2, k)] * v.z;
            Vector3::new(of(0), of(1), of(2))
        };
        let seen = Vector3::new(self.aside.x, self.aside.y, -self.x[L]);
        let place = before.rotation * seen + before.translation;
        let there = back(place - pose.translation);
        if self.free {
            // one that goes further aside than its hole is wide, and feels nothing, is not where it was
            let clear = self.x[CLEARANCE] + sqrt(self.p[CLEARANCE][CLEARANCE]);
            let seen = back(self.hole - pose.translation);
            let far = sqrt(seen.x * seen.x + seen.y * seen.y) - clear;
            if far > self.beyond {
                self.p[L][L] += far * far - self.beyond * self.beyond;
                self.beyond = far;
            }
        } else {
            (self.hole, self.beyond) = (place, 0.0);
        }
        let elapsed = time_s - self.time_s;
        if elapsed > 0.0 {
            let share = elapsed / (elapsed + SPEEDS_S);
            let gone = (pose.translation - before.translation) / elapsed;
            self.speed += (gone - self.speed) * share;
            self.sideways += ((there.xy() - self.aside) / elapsed - self.sideways) * share;
            let share = elapsed / (elapsed + DOUBTS_S);
            self.speeds += (gone * gone.transpose() - self.speeds) * share;
            self.slide += ((-there.z - self.x[L]) / elapsed - self.slide) * share;
        }
        self.aside = there.xy();
        self.slid -= there.z + self.x[L];
        self.x[L] = -there.z;
        self.p[L][L] += per_second_mm2 * elapsed;
        (self.time_s, self.pose) = (time_s, *pose);
    }

    /// The force where the hole stands now: none within the clearance, in proportion beyond.
    pub(super) fn lean(&mut self, shaft: &Rod) {
        if !self.touched {
            return;
        }
        let (far, gives) = (sqrt(self.aside.norm_squared()), self.gives(shaft));
        // a shaft that has left the eye leans on nothing
        if self.x[L] > 0.0 && gives > 0.0 && far > self.x[CLEARANCE] {
            self.size = (far - self.x[CLEARANCE]) / gives;
            self.way = self.aside / far;
        } else {
            self.size = 0.0;
        }
    }
}
