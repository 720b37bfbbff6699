//! Where the hole stands in the tool's frame, what else is learnt in a run, and how well all of it is known.
//!
//! The hole stands at `E` in the base. The tool sees it at `(u, -l)`: `l` along its unbent axis, the paper's depth, and
//! `u` aside, which is the clearance `c`, what the shaft gives way and what the hole does: `u = f (c + w + g F)` where the
//! force has the way `f`. When the tool moves, the hole does not: it is carried into the new frame. A turn of the shaft
//! brings what is not known of `u` into `l`, and so the filter learns `c` and `g`.
//!
//! Estimated are `l`, `c`, `g` and the moments `o` that the gratings show where nothing touches; considered is
//! [`OfDepth`](super::known). The error of the estimates is `η + T u`: `P` is the covariance of `η`, `T` says how the rest
//! hangs on the considered unknowns. The update is Schmidt's for one number, in Joseph's form.

use super::known::{Tied, UNKNOWNS, dot};
use crate::numbers::math::sqrt;
use crate::numbers::rigid::Rigid;
use crate::tool::rod::Shaft;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Numbers estimated: `l` (mm), clearance (mm), what the hole gives way (mm/mN), the gratings' turn about the shaft
/// (rad), how much deeper they are (mm), four moments (mN·mm).
pub(super) const N: usize = 9;
/// Their places.
pub(super) const L: usize = 0;
pub(super) const CLEARANCE: usize = 1;
pub(super) const GIVES: usize = 2;
pub(super) const TURN: usize = 3;
pub(super) const DEEPER: usize = 4;
pub(super) const OFFSETS: usize = 5;

/// How long a slide is looked at, s, and how fast it is before friction is all against it, mm/s.
const SLIDES_S: f64 = 0.1;
const SLIDES_MM_S: f64 = 0.2;

/// The estimates and what is known of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Known {
    pub(super) x: [f64; N],
    pub(super) p: [[f64; N]; N],
    pub(super) tied: [Tied; N],
}

/// A number that is measured: how it hangs on the estimates and on the considered unknowns, and its noise.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    pub(super) h: [f64; N],
    pub(super) tied: Tied,
    pub(super) noise: f64,
}

/// What a measurement of a [`Row`] would do: its covariance with the estimates' own noise, how it hangs on the unknowns
/// in all, the variance of both.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    with: [f64; N],
    tied: Tied,
    own: f64,
    pub(super) total: f64,
}

impl Known {
    pub(super) fn new(x: [f64; N], deviations: [f64; N]) -> Self {
        let mut p = [[0.0; N]; N];
        for i in 0..N {
            p[i][i] = deviations[i] * deviations[i];
        }
        Self {
            x,
            p,
            tied: [[0.0; UNKNOWNS]; N],
        }
    }

    /// Before a measurement is taken.
    #[inline]
    pub(super) fn see(&self, row: &Row) -> Seen {
        let (mut with, mut tied) = ([0.0; N], row.tied);
        for j in 0..N {
            let (h, of_j) = (row.h[j], &self.p[j]);
            for i in 0..N {
                with[i] += of_j[i] * h;
            }
            for k in 0..UNKNOWNS {
                tied[k] += self.tied[j][k] * h;
            }
        }
        let mut own = row.noise;
        for i in 0..N {
            own += row.h[i] * with[i];
        }
        Seen {
            with,
            tied,
            own,
            total: own + dot(&tied, &tied),
        }
    }

    /// Schmidt's update by a measurement that is `innovation` off. False, and nothing done, where it means nothing.
    #[inline]
    pub(super) fn take(&mut self, seen: &Seen, innovation: f64) -> bool {
        let per_total = 1.0 / seen.total;
        if !(seen.total > 0.0 && (innovation * per_total).is_finite()) {
            return false;
        }
        let mut gain = seen.with;
        for i in 0..N {
            gain[i] = (gain[i] + dot(&self.tied[i], &seen.tied)) * per_total;
        }
        let mut less = [0.0; N];
        for i in 0..N {
            self.x[i] += gain[i] * innovation;
            less[i] = 0.5 * seen.own * gain[i] - seen.with[i];
        }
        for i in 0..N {
            // P - g aᵀ - a gᵀ + s g gᵀ, as symmetric as before to the last bit
            let (g, l, own) = (gain[i], less[i], &mut self.p[i]);
            for j in 0..N {
                own[j] += l * gain[j] + g * less[j];
            }
            if own[i] < 0.0 {
                own[i] = 0.0;
            }
            for k in 0..UNKNOWNS {
                self.tied[i][k] -= gain[i] * seen.tied[k];
            }
        }
        true
    }

    /// Adds `share` times the errors of `from` to those of `to`.
    #[inline]
    fn mix(&mut self, to: usize, from: usize, share: f64) {
        for k in 0..N {
            self.p[to][k] += share * self.p[from][k];
        }
        for k in 0..N {
            self.p[k][to] += share * self.p[k][from];
        }
        for k in 0..UNKNOWNS {
            self.tied[to][k] += share * self.tied[from][k];
        }
    }

    /// Moments that are felt where nothing touches, mN·mm.
    #[inline]
    pub(super) fn offsets(&self) -> [f64; 4] {
        let [.., a, b, c, d] = self.x;
        [a, b, c, d]
    }

    /// `l` is known to this variance and no better (mm²), as after another hole was entered.
    pub(super) fn forget_depth(&mut self, variance: f64) {
        for k in 0..N {
            self.p[L][k] = 0.0;
            self.p[k][L] = 0.0;
        }
        self.p[L][L] = variance;
        self.tied[L] = [0.0; UNKNOWNS];
    }

    /// Covariance of two estimates, with what hangs on the unknowns.
    #[inline]
    pub(super) fn covariance(&self, i: usize, j: usize) -> f64 {
        self.p[i][j] + dot(&self.tied[i], &self.tied[j])
    }
}

/// The state at the last stamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct State {
    pub(super) time_s: f64,
    pub(super) pose: Rigid,
    pub(super) known: Known,
    /// Place of the hole aside of the unbent axis, tool's frame, mm.
    pub(super) aside: Vector2<f64>,
    /// What the last bend took from `l` for the length of shaft beyond the hole, mm, and from the moments.
    pub(super) short: f64,
    pub(super) relief: [f64; 2],
    /// Whether anything has ever touched.
    pub(super) touched: bool,
    /// Whether the last reading felt nothing of the hole; the shaft's axis when it was last felt, base frame.
    pub(super) free: bool,
    pub(super) axis: Vector3<f64>,
    /// Where the hole then stood, base frame, and how far the free shaft has since gone beyond its clearance, mm.
    hole: Vector3<f64>,
    beyond: f64,
    /// How fast the shaft slides in, mm/s, over a tenth of a second.
    slide: f64,
    /// How `l` came to hang on clearance and give at the last step.
    pub(super) shares: [f64; 2],
    /// Force across the shaft: size, mN, and way.
    pub(super) size: f64,
    pub(super) way: Vector2<f64>,
}

impl State {
    pub(super) fn start(time_s: f64, pose: &Rigid, known: &Known) -> Self {
        Self {
            time_s,
            pose: *pose,
            known: *known,
            aside: Vector2::zeros(),
            short: 0.0,
            relief: [1.0; 2],
            touched: false,
            free: true,
            axis: pose.rotation.column(2).into_owned(),
            hole: pose.translation - pose.rotation.column(2) * known.x[L],
            beyond: 0.0,
            slide: 0.0,
            shares: [0.0; 2],
            size: 0.0,
            way: Vector2::new(1.0, 0.0),
        }
    }

    /// `l`, mm.
    #[inline]
    pub(super) fn l(&self) -> f64 {
        self.known.x[L]
    }

    /// Length of shaft beyond the hole as the gratings count it, mm.
    #[inline]
    pub(super) fn arc(&self) -> f64 {
        self.known.x[L] + self.known.x[DEEPER] - self.short
    }

    pub(super) fn force(&self) -> Vector2<f64> {
        self.way * self.size
    }

    pub(super) fn push(&mut self, force: &Vector2<f64>) {
        self.size = sqrt(force.norm_squared());
        if self.size > 0.0 {
            self.way = force / self.size;
        }
    }

    /// Which way the shaft slides: 1 in, -1 out, less where it hardly does.
    #[inline]
    pub(super) fn slides(&self) -> f64 {
        self.slide / sqrt(self.slide * self.slide + SLIDES_MM_S * SLIDES_MM_S)
    }

    /// Whether the tip is beyond the hole without doubt.
    pub(super) fn surely_inside(&self) -> bool {
        let l = self.l();
        l > 0.0 && l * l > 9.0 * self.known.covariance(L, L)
    }

    /// On to a later time and another pose; the hole, which stays, strays along the shaft by this variance a second.
    #[inline]
    pub(super) fn go(&mut self, time_s: f64, pose: &Rigid, per_second_mm2: f64) {
        let axes = &pose.rotation;
        let turn = axes.column(2) - self.pose.rotation.column(2);
        let before = &self.pose.rotation;
        let aside = before.column(0) * self.aside.x + before.column(1) * self.aside.y;
        let gone = self.pose.translation - pose.translation;
        let there = turned_back(axes, &(aside - before.column(2) * self.l() + gone));
        self.shares = [0.0; 2];
        if self.touched {
            // more clearance puts the hole further along the force, and the turn brings that into l
            let way = before.column(0) * self.way.x + before.column(1) * self.way.y;
            let share = -turn.dot(&way);
            if share != 0.0 {
                self.shares = [share, share * self.size];
                self.known.mix(L, CLEARANCE, share);
                self.known.mix(L, GIVES, share * self.size);
            }
        }
        if self.free {
            // a free shaft stands anywhere in its hole, and what it turns brings that into l
            let turned = |z: &Matrix3<f64>| (z.column(2) - self.axis).norm_squared();
            let more = turned(axes) - turned(before);
            let c = self.known.x[CLEARANCE];
            let room = 0.5 * c * c + self.known.p[CLEARANCE][CLEARANCE];
            if more > 0.0 {
                self.known.p[L][L] += room * more;
            }
            // one that goes further aside than its hole is wide, and feels nothing, is not where it was
            let seen = turned_back(axes, &(self.hole - pose.translation));
            let far = sqrt(seen.x * seen.x + seen.y * seen.y)
                - c
                - sqrt(self.known.p[CLEARANCE][CLEARANCE]);
            if far > self.beyond {
                self.known.p[L][L] += far * far - self.beyond * self.beyond;
                self.beyond = far;
            }
        } else {
            self.axis = axes.column(2).into_owned();
            self.hole = self.pose.translation + aside - before.column(2) * self.l();
            self.beyond = 0.0;
        }
        let elapsed = time_s - self.time_s;
        if elapsed > 0.0 {
            let share = elapsed / (elapsed + SLIDES_S);
            self.slide += ((-there.z - self.l()) / elapsed - self.slide) * share;
        }
        self.aside = Vector2::new(there.x, there.y);
        self.known.x[L] = -there.z;
        self.pose = *pose;
        self.known.p[L][L] += per_second_mm2 * (time_s - self.time_s);
        self.time_s = time_s;
    }

    /// What shaft and hole give way for a force, mm/mN.
    #[inline]
    pub(super) fn gives(&self, shaft: &Shaft) -> f64 {
        shaft.gives(self.size * self.size, shaft.arc(self.arc())) + self.known.x[GIVES]
    }

    /// The force where the hole stands now: none within the clearance, in proportion beyond.
    pub(super) fn lean(&mut self, shaft: &Shaft) {
        if !self.touched {
            return;
        }
        let (far, gives) = (sqrt(self.aside.norm_squared()), self.gives(shaft));
        let pressed = far - self.known.x[CLEARANCE];
        // a shaft that has left the eye leans on nothing
        let pushed = if pressed > 0.0 && self.l() > 0.0 && gives > 0.0 {
            self.aside * (pressed / (far * gives))
        } else {
            Vector2::zeros()
        };
        self.push(&pushed);
    }
}

/// `Rᵀ v`.
#[inline]
fn turned_back(r: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    let of = |k: usize| r[(0, k)] * v.x + r[(1, k)] * v.y + r[(2, k)] * v.z;
    Vector3::new(of(0), of(1), of(2))
}
