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
use crate::tool::rod::Shaft;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Numbers of the state, and their places: `l` (mm), clearance (mm), what the hole gives way (mm/mN), the gratings' turn
/// about the shaft (rad), four moments of no force (mN·mm), how much deeper the gratings count (mm).
pub(super) const N: usize = 13;
pub(super) const L: usize = 0;
pub(super) const CLEARANCE: usize = 1;
pub(super) const GIVES: usize = 2;
pub(super) const TURN: usize = 3;
pub(super) const OFFSETS: usize = 4;
pub(super) const DEEPER: usize = 8;
/// Never learnt, of unit variance: three of the bench, and friction.
pub(super) const BENCH: usize = 9;
pub(super) const FRICTION: usize = 12;
/// A number for each of the state.
pub(super) type Row = [f64; N];

/// How long the robot's speed is looked at, s.
const SPEEDS_S: f64 = 0.03;
/// How long others are, s.
const SLIDES_S: f64 = 0.1;

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
    hole: Vector3<f64>,
    beyond: f64,
    /// How fast the shaft slides in, the hole goes aside of the tool, and the robot goes, mm/s, and squared, mm²/s².
    pub(super) slide: f64,
    pub(super) speed: Vector3<f64>,
    pub(super) speed2: f64,
    pub(super) sideways: Vector2<f64>,
    /// How far it slid in since a depth was told, mm.
    pub(super) slid: f64,
}

/// What goes with a number that is to be measured, and its variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Seen {
    with: Row,
    pub(super) total: f64,
}

impl Seen {
    /// How much of the number `l` follows.
    #[inline]
    pub(super) fn gain(&self) -> f64 {
        self.with[L] / self.total
    }
}

impl State {
    pub(super) fn new(time_s: f64, pose: &Rigid, x: Row, deviations: Row) -> Self {
        let mut p = [[0.0; N]; N];
        for i in 0..N {
            p[i][i] = deviations[i] * deviations[i];
        }
        Self {
            time_s,
            pose: *pose,
            x,
            p,
            lasting: 0.0,
            aside: Vector2::zeros(),
            size: 0.0,
            way: Vector2::new(1.0, 0.0),
            short: 0.0,
            relief: [1.0; 2],
            touched: false,
            free: true,
            hole: pose.translation - pose.rotation.column(2) * x[L],
            beyond: 0.0,
            slide: 0.0,
            speed: Vector3::zeros(),
            speed2: 0.0,
            sideways: Vector2::zeros(),
            slid: 0.0,
        }
    }

    /// Before a number is measured that hangs on all by `h`, with this noise: what goes with it, and its variance.
    #[inline]
    pub(super) fn see(&self, h: &Row, noise: f64) -> Seen {
        let mut with = [0.0; N];
        for j in 0..N {
            for i in 0..N {
                with[i] += self.p[j][i] * h[j];
            }
        }
        let mut total = noise;
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
        let (mut gain, mut less) = ([0.0; N], [0.0; N]);
        for i in 0..N {
            gain[i] = if i < BENCH {
                seen.with[i] * per_total
            } else {
                0.0
            };
            less[i] = 0.5 * seen.total * gain[i] - seen.with[i];
            self.x[i] += gain[i] * innovation;
        }
        for i in 0..N {
            let (g, l, own) = (gain[i], less[i], &mut self.p[i]);
            for j in 0..N {
                own[j] += l * gain[j] + g * less[j];
            }
            own[i] = own[i].max(0.0);
        }
        true
    }

    /// A number is known to this variance and no better, and by itself.
    pub(super) fn forget(&mut self, k: usize, variance: f64) {
        for i in 0..N {
            self.p[k][i] = 0.0;
            self.p[i][k] = 0.0;
        }
        self.p[k][k] = variance;
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
    pub(super) fn gives(&self, shaft: &Shaft) -> f64 {
        shaft.gives(self.size * self.size, shaft.arc(self.arc())) + self.x[GIVES]
    }

    /// On to a later time and another pose; the hole, which stays, strays along the shaft by this variance a second.
    #[inline]
    pub(super) fn go(&mut self, time_s: f64, pose: &Rigid, per_second_mm2: f64) {
        let (before, axes) = (self.pose.rotation, &pose.rotation);
        let aside = before.column(0) * self.aside.x + before.column(1) * self.aside.y;
        let from_tip = aside - before.column(2) * self.x[L];
        let there = turned_back(axes, &(from_tip + self.pose.translation - pose.translation));
        if self.free {
            // one that goes further aside than its hole is wide, and feels nothing, is not where it was
            let seen = turned_back(axes, &(self.hole - pose.translation));
            let clear = self.x[CLEARANCE] + sqrt(self.p[CLEARANCE][CLEARANCE]);
            let far = sqrt(seen.x * seen.x + seen.y * seen.y) - clear;
            if far > self.beyond {
                self.p[L][L] += far * far - self.beyond * self.beyond;
                self.beyond = far;
            }
        } else {
            self.hole = self.pose.translation + from_tip;
            self.beyond = 0.0;
        }
        let elapsed = time_s - self.time_s;
        if elapsed > 0.0 {
            let share = elapsed / (elapsed + SLIDES_S);
            self.slide += ((-there.z - self.x[L]) / elapsed - self.slide) * share;
            let gone = (pose.translation - self.pose.translation) / elapsed;
            self.speed += (gone - self.speed) * (elapsed / (elapsed + SPEEDS_S));
            self.speed2 += (gone.norm_squared() - self.speed2) * share;
            self.sideways += ((there.xy() - self.aside) / elapsed - self.sideways) * share;
        }
        self.aside = there.xy();
        self.slid -= there.z + self.x[L];
        self.x[L] = -there.z;
        self.pose = *pose;
        self.p[L][L] += per_second_mm2 * elapsed;
        self.time_s = time_s;
    }

    /// The force where the hole stands now: none within the clearance, in proportion beyond.
    pub(super) fn lean(&mut self, shaft: &Shaft) {
        let (far, gives) = (sqrt(self.aside.norm_squared()), self.gives(shaft));
        if self.touched {
            // a shaft that has left the eye leans on nothing
            let leans = self.x[L] > 0.0 && gives > 0.0 && far > self.x[CLEARANCE];
            self.size = if leans {
                (far - self.x[CLEARANCE]) / gives
            } else {
                0.0
            };
            if leans {
                self.way = self.aside / far;
            }
        }
    }
}

/// `Rᵀ v`.
#[inline]
fn turned_back(r: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    let of = |k: usize| r[(0, k)] * v.x + r[(1, k)] * v.y + r[(2, k)] * v.z;
    Vector3::new(of(0), of(1), of(2))
}
