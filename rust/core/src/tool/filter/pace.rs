//! The force where it was not read: carried on by the tool's motion, and how far the hole's edge may have strayed since.
//!
//! A force that was felt says where the hole stands; carried into a later pose it says which force it pushes there
//! ([`State::lean`]). Every tenth of a second the edge is compared with where the motion alone has it: what is left is its
//! pace, and where the force has changed plainly, what the hole gives way for it.

use super::known::UNKNOWNS;
use super::state::{CLEARANCE, GIVES, L, N, Row, State, TURN};
use nalgebra::{Vector2, Vector3};

/// The pace is taken over this time, and remembered for the other, s.
const OVER_S: f64 = 0.1;
const KEPT_S: f64 = 5.0;
/// The guess at the start, (mm/s)², counts as so much, s.
const FIRST: f64 = 0.04;
const GUESSED_S: f64 = 0.01;
/// A square of what is left over its variance above which a window says nothing of the hole.
const FITS: f64 = 16.0;
/// What a hole gives way for a force changes by this share with the force.
const HARDENS: f64 = 0.1;
/// Deviation of a force that nobody has read, mN: what presses a tool in an eye is smaller as a rule.
const UNREAD_MN: f64 = 100.0;
/// Deviations of a force below which nobody notices it.
const NOTICED: f64 = 5.0;

/// A quarter of a turn on.
#[inline]
fn quarter(v: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(-v.y, v.x)
}

#[inline]
fn turned(v: &Vector2<f64>, small_rad: f64) -> Vector2<f64> {
    v + quarter(v) * small_rad
}

/// What was learnt of the edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pace {
    /// Mean square pace of a coordinate of the edge, (mm/s)².
    mean: f64,
    /// The same with all that was felt, noise as well.
    all: f64,
    /// How much is known of it, s.
    known_s: f64,
    since: State,
    noise: f64,
    gives: f64,
    leans: bool,
}

impl Pace {
    pub(super) fn new(start: &State) -> Self {
        Self {
            mean: FIRST,
            all: FIRST,
            known_s: GUESSED_S,
            since: *start,
            noise: 0.0,
            gives: 0.0,
            leans: false,
        }
    }

    /// Mean square pace of the edge with all that was felt, (mm/s)².
    pub(super) fn all(&self) -> f64 {
        self.all
    }

    /// The shaft does not lean any more.
    #[inline]
    pub(super) fn lost(&mut self) {
        self.leans = false;
    }

    /// A force was felt whose components have this variance, where shaft and hole give way so much (mm/mN).
    #[inline]
    pub(super) fn felt(&mut self, now: &mut State, noise: f64, gives: f64) {
        if !self.leans {
            self.begin(now, noise, gives);
        } else if now.time_s - self.since.time_s >= OVER_S {
            self.renew(now, noise, gives);
            self.begin(now, noise, gives);
        }
    }

    fn begin(&mut self, now: &State, noise: f64, gives: f64) {
        self.since = *now;
        self.noise = noise;
        self.gives = gives - now.known.x[GIVES];
        self.leans = true;
    }

    #[inline(never)]
    fn renew(&mut self, now: &mut State, noise: f64, gives: f64) {
        let mut then = self.since;
        let x = now.known.x;
        let (size, elapsed) = (then.size, now.time_s - then.time_s);
        // the edge of then, by what is known now
        let way = turned(&then.way, x[TURN] - then.known.x[TURN]);
        let off = x[CLEARANCE] + (self.gives + x[GIVES]) * size;
        then.aside = way * off;
        let (before, axes) = (then.pose.rotation, &now.pose.rotation);
        let seen = |v: &Vector3<f64>| Vector2::new(axes.column(0).dot(v), axes.column(1).dot(v));
        let tilt = seen(&before.column(2).into_owned());
        then.go(now.time_s, &now.pose, 0.0);
        let way = seen(&(before.column(0) * way.x + before.column(1) * way.y));
        let there = then.aside - tilt * (now.l() - then.l());
        // less where the force has it now
        let here = now.way * (x[CLEARANCE] + gives * now.size);
        let strayed = here - there;
        // noise along a force moves its edge by what gives way, across it turns the edge about the middle of the hole
        let turns = [off / size, (x[CLEARANCE] + gives * now.size) / now.size];
        let gave = [self.gives + x[GIVES], gives];
        let of = |by: [f64; 2]| self.noise * by[0] * by[0] + noise * by[1] * by[1];
        let by_noise = [of(gave), of(turns)];
        let square = 0.5 * (strayed.norm_squared() - by_noise[0] - by_noise[1]);
        if !(square.is_finite() && now.surely_inside()) {
            return;
        }
        // tissue hardens: what it gives for more force is not quite what it gave for less
        let hard = HARDENS * x[GIVES] * (now.size - size);
        let side = quarter(&now.way);
        for (on, noise) in [now.way, side].iter().zip(by_noise) {
            let mut h = [0.0; N];
            h[L] = -tilt.dot(on);
            h[CLEARANCE] = on.dot(&(way - now.way));
            h[GIVES] = on.dot(&(way * size - now.way * now.size));
            h[TURN] = on.dot(&quarter(&(way * off - here)));
            let row = Row {
                h,
                tied: [0.0; UNKNOWNS],
                noise: self.mean * elapsed * elapsed + noise + hard * hard,
            };
            let seen = now.known.see(&row);
            let mut innovation = on.dot(&strayed);
            for k in 0..N {
                innovation -= h[k] * (now.known.x[k] - x[k]);
            }
            if innovation * innovation < FITS * seen.total {
                now.known.take(&seen, innovation);
            }
        }
        let per_squared = 1.0 / (elapsed * elapsed);
        self.known_s = (self.known_s + elapsed).min(KEPT_S);
        self.mean += (square * per_squared - self.mean) * (elapsed / self.known_s).min(1.0);
        if !(self.mean > 0.0) {
            self.mean = 0.0;
        }
        self.all +=
            (0.5 * strayed.norm_squared() * per_squared - self.all) * (elapsed / KEPT_S).min(1.0);
    }

    /// Variance of a component of the force of a carried state (mN²), felt at a time with this noise, since when the hole
    /// has moved across the shaft by the pose (mm).
    pub(super) fn strayed(&self, s: &State, felt: Option<&Felt>, moved_mm: f64, gives: f64) -> f64 {
        let Some(felt) = felt else {
            return UNREAD_MN * UNREAD_MN;
        };
        if !(gives > 0.0) {
            return 0.0;
        }
        let stiff = 1.0 / gives;
        let waited = s.time_s - felt.time_s;
        let edge = self.mean * waited * waited.min(OVER_S);
        if s.free {
            // it stands anywhere within the clearance, and may lean as far as it was moved
            let most = moved_mm * moved_mm + edge;
            let room = NOTICED * NOTICED * felt.noise * gives * gives + most;
            return room.min(most) * stiff * stiff / 4.0;
        }
        let changed = (s.force() - felt.way * felt.size).norm_squared();
        let give = s.known.covariance(GIVES, GIVES) * changed;
        // noise across a small force turns the edge about the middle of the hole
        let clearance = s.known.x[CLEARANCE] * stiff;
        let farther = if felt.size > 0.0 {
            clearance / felt.size
        } else {
            0.0
        };
        let gone = (moved_mm * stiff).min(clearance);
        let turned = (felt.noise * farther * farther).min(gone * gone);
        let mut variance = (edge + give) * stiff * stiff + turned;
        if !s.surely_inside() {
            let press = moved_mm * stiff;
            variance += s.size * s.size + press * press;
        }
        variance
    }
}

/// The last force that was read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Felt {
    pub(super) time_s: f64,
    pub(super) way: Vector2<f64>,
    pub(super) size: f64,
    /// Variance of its components by noise, and what moments and depth make of it.
    pub(super) noise: f64,
    pub(super) by_moments: [f64; 2],
    pub(super) by_depth: f64,
}
