//! The edge of the hole: what the shaft leans on, how it strays across, and a force that was not read.
//!
//! A force that was felt says where the edge stands; carried into a later pose it says which force it pushes there. Every
//! tenth of a second the edge is compared with where the motion alone has it: that tells clearance, give and turn, and what
//! is left is its pace.

use super::reading::Said;
use super::state::{CLEARANCE, GIVES, L, N, Row, State, TURN};
use crate::numbers::math::sqrt;
use crate::tool::poses::Posed;
use crate::tool::rod::Rod;
use nalgebra::{Vector2, Vector3};

/// Of the edge the first pace squared, (mm/s)², and for how long that counts, s.
const FIRST_PACE: f64 = 0.04;
const GUESSED_S: f64 = 0.01;
/// How long the robot's lateness is looked at, and over which time its sign is taken, s; how late one may be, s; what strays
/// over that time before anything is known of them, mm², and what of it is not as it was; the odds that one is late at
/// all.
const LATE_S: f64 = 30.0;
const COMPARED_S: f64 = 0.5;
const MAY_BE_S: f64 = 0.04;
const STRAYS_MM2: f64 = 0.04;
const STRAYS_ANEW_MM2: f64 = 0.004;
const ODDS: f64 = 1.0 / 3.0;
/// The largest part of strays that goes on as before.
const MOST_ALIKE: f64 = 0.98;
/// The pace is taken over this time, and remembered for the other, s.
const OVER_S: f64 = 0.1;
const KEPT_S: f64 = 5.0;
/// Deviations of the robot's lateness beyond which it is said.
const BEYOND: f64 = 2.5;
/// A square of what is left over its variance above which a window says nothing of the hole.
const FITS: f64 = 16.0;
/// What a hole gives way for a force changes by this share with the force.
const HARDENS: f64 = 0.1;
/// Deviation of a force that nobody has read, mN.
const UNREAD_MN: f64 = 100.0;

fn quarter(v: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(-v.y, v.x)
}

/// What was learnt of the edge: mean square pace of a coordinate, (mm/s)², and how much is known of it, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Edge {
    pub(super) mean: f64,
    pub(super) known_s: f64,
    pub(super) since: Option<Then>,
    /// Since when strays add up, to what, and the hole's motion aside then, mm/s; the strays before, and how that motion
    /// changed in them; sums of how strays go with those before, and of squares of these, mm².
    pub(super) strays: Option<(f64, Vector2<f64>, Vector2<f64>)>,
    pub(super) before: [Vector2<f64>; 2],
    pub(super) alike: [f64; 2],
    /// Sums by which the robot's rows are late: of strays by how that motion changed, of its squares, of squares of strays,
    /// mm, and of ones.
    pub(super) late: [f64; 4],
}

/// The edge a tenth of a second ago: where the tool was, what was known, the force and its noise, what the shaft alone gave
/// way for it, whether it told a depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Then {
    pub(super) at: Posed,
    pub(super) x: Row,
    pub(super) force: Vector2<f64>,
    pub(super) noise: f64,
    pub(super) gives: f64,
    pub(super) tells: bool,
}

impl Default for Edge {
    fn default() -> Self {
        Self {
            mean: FIRST_PACE,
            known_s: GUESSED_S,
            since: None,
            strays: None,
            before: [Vector2::zeros(); 2],
            alike: [0.0; 2],
            late: [0.0; 4],
        }
    }
}

impl Edge {
    /// By how much the robot is late, s, and the square of its deviation, s²: it is late or it is not, one robot in four before
    /// anything was seen (Jeffreys, *Theory of Probability*, V), so that what the strays exclude is not doubted on.
    pub(super) fn late(&self) -> (f64, f64) {
        let [with, own, square, n] = self.late;
        let before = MAY_BE_S * MAY_BE_S;
        let told = before * (n + 1.0) / (square + STRAYS_MM2);
        let variance = before / (1.0 + own * told);
        let mean = with * told / before * variance;
        let evidence = libm::exp((0.5 * mean * mean / variance).min(50.0));
        let odds = ODDS * sqrt(variance / before) * evidence;
        let is = odds / (1.0 + odds);
        (is * mean, is * (variance + (1.0 - is) * mean * mean))
    }

    /// Strays over half a second beside how the motion of the hole aside changed in it: tremor is over by then. An eye that
    /// turns strays as it did just before: that part, which is learnt, is taken off both.
    #[inline]
    fn strays(&mut self, strayed: &Vector2<f64>, sideways: &Vector2<f64>, time_s: f64) {
        let Some((since_s, sum, before)) = self.strays else {
            self.strays = Some((time_s, Vector2::zeros(), *sideways));
            self.before = [Vector2::zeros(); 2];
            return;
        };
        let sum = sum + strayed;
        self.strays = Some((since_s, sum, before));
        if time_s - since_s < COMPARED_S {
            return;
        }
        self.strays = Some((time_s, Vector2::zeros(), *sideways));
        let keeps = (1.0 - (time_s - since_s) / LATE_S).max(0.0);
        let now = [sum, sideways - before];
        let last = core::mem::replace(&mut self.before, now);
        let [goes, all] = self.alike;
        self.alike = [
            keeps * goes + sum.dot(&last[0]),
            keeps * all + last[0].norm_squared(),
        ];
        let alike = self.alike();
        let [sum, faster] = [0, 1].map(|i| now[i] - last[i] * alike);
        let [with, own, square, n] = self.late.map(|x| x * keeps);
        let [more, squared] = [sum.dot(&faster), 0.5 * sum.norm_squared()];
        self.late = [
            with + more,
            own + faster.norm_squared(),
            square + squared,
            n + 1.0,
        ];
    }

    /// By which part a stray goes on as the one before.
    #[inline]
    fn alike(&self) -> f64 {
        let [goes, all] = self.alike;
        (goes / (all + STRAYS_MM2)).clamp(0.0, MOST_ALIKE)
    }

    /// Variance of a coordinate of what strays, mm² a second, as it adds up over a time in which it comes and goes: what
    /// goes on as before is no new measurement each time.
    #[inline]
    fn lasts(&self) -> f64 {
        let [_, _, square, n] = self.late;
        let anew = 1.0 - self.alike();
        (square + STRAYS_ANEW_MM2) / ((n + 1.0) * COMPARED_S * anew * anew)
    }

    /// A force was felt whose components have this variance, where shaft and hole give way so much (mm/mN).
    #[inline]
    pub(super) fn felt(&mut self, s: &mut State, noise: f64, gives: f64, tells: bool) {
        let (force, gives, x) = (s.way * s.size, gives - s.x[GIVES], s.x);
        let at = Posed {
            time_s: s.time_s,
            pose: s.pose,
        };
        let now = Then {
            at,
            x,
            force,
            noise,
            gives,
            tells,
        };
        if let Some(then) = self.since {
            if now.at.time_s - then.at.time_s < OVER_S {
                return;
            }
            self.compare(s, &then, &now);
        }
        self.since = Some(now);
    }

    #[inline(never)]
    fn compare(&mut self, s: &mut State, then: &Then, now: &Then) {
        let tells = then.tells && now.tells;
        let (x, elapsed) = (s.x, now.at.time_s - then.at.time_s);
        // the edge of then by what is known now, seen from where the tool is
        let (was, is) = (&then.at.pose, &now.at.pose);
        let (before, axes) = (&was.rotation, &is.rotation);
        let sizes = [then, now].map(|t| sqrt(t.force.norm_squared()));
        let ways = [then.force / sizes[0], now.force / sizes[1]];
        let seen = |v: &Vector3<f64>| Vector2::new(axes.column(0).dot(v), axes.column(1).dot(v));
        let turned = ways[0] + quarter(&ways[0]) * (x[TURN] - then.x[TURN]);
        let way = before.column(0) * turned.x + before.column(1) * turned.y;
        let axis = before.column(2).into_owned();
        let gives = [then, now].map(|t| t.gives + x[GIVES]);
        let offs = [0, 1].map(|i| x[CLEARANCE] + gives[i] * sizes[i]);
        let hole = way * offs[0] - axis * then.x[L] + was.translation - is.translation;
        let (tilt, way) = (seen(&axis), seen(&way));
        let there = seen(&hole) - tilt * (x[L] + axes.column(2).dot(&hole));
        let here = ways[1] * offs[1];
        let strayed = here - there;
        // noise along a force moves its edge by what gives way, across it turns the edge about the middle of the hole
        let of = |a: f64, b: f64| then.noise * a * a + now.noise * b * b;
        let by_noise = [
            of(gives[0], gives[1]),
            of(offs[0] / sizes[0], offs[1] / sizes[1]),
        ];
        let square = 0.5 * (strayed.norm_squared() - by_noise[0] - by_noise[1]);
        if !(square.is_finite() && s.surely_inside()) {
            return;
        }
        if tells {
            self.strays(&strayed, &s.sideways, now.at.time_s);
        } else {
            self.strays = None;
        }
        let lasts = self.lasts().max(self.mean * elapsed);
        // tissue hardens: what it gives for more force is not quite what it gave for less
        let hard = HARDENS * x[GIVES] * (sizes[1] - sizes[0]);
        for (on, noise) in [ways[1], quarter(&ways[1])].iter().zip(by_noise) {
            let mut h = [0.0; N];
            h[L] = -tilt.dot(on);
            h[CLEARANCE] = on.dot(&(way - ways[1]));
            h[GIVES] = on.dot(&(way * sizes[0] - now.force));
            h[TURN] = on.dot(&quarter(&(way * offs[0] - here)));
            let seen = s.see(&h, lasts * elapsed + noise + hard * hard);
            let mut innovation = on.dot(&strayed);
            for k in 0..N {
                innovation -= h[k] * (s.x[k] - x[k]);
            }
            if tells && innovation * innovation < FITS * seen.total {
                s.take(&seen, innovation);
            }
        }
        self.known_s = (self.known_s + elapsed).min(KEPT_S);
        let pace = square / (elapsed * elapsed);
        self.mean = (self.mean + (pace - self.mean) * (elapsed / self.known_s).min(1.0)).max(0.0);
    }

    /// By how much the robot is late, s, where that is not by chance.
    pub(super) fn late_s(&self) -> f64 {
        let (late, variance) = self.late();
        let sure = late * late > BEYOND * BEYOND * variance;
        if sure { late } else { 0.0 }
    }

    /// Variance of a component of the force of a state that was carried on from the last one, mN², beside what was felt, and
    /// when.
    pub(super) fn strayed(
        &self,
        felt: Option<&(f64, Said)>,
        shaft: &Rod,
        last: &State,
        s: &State,
    ) -> f64 {
        let Some((at_s, felt)) = felt else {
            return UNREAD_MN * UNREAD_MN;
        };
        let (gives, waited) = (s.gives(shaft), s.time_s - at_s);
        if !(gives > 0.0) {
            return 0.0;
        }
        // what is not read for long has no pace that was ever learnt
        let edge = self.mean * waited * waited.min(OVER_S) * (1.0 + waited.min(2.0));
        let give = s.p[GIVES][GIVES] * (s.way * s.size - felt.way * felt.size).norm_squared();
        // noise across a small force turns the edge about the middle of the hole
        let moved = sqrt((s.aside - last.aside).norm_squared());
        let clear = s.x[CLEARANCE];
        let gone = moved.min(clear) * moved.min(clear);
        let turned = clear * clear * felt.noise / (felt.size * felt.size);
        let mut variance = edge
            + give
            + if felt.size > 0.0 {
                turned.min(gone)
            } else {
                0.0
            };
        if !s.surely_inside() {
            // it may lean on nothing
            variance += moved * moved + s.size * s.size * gives * gives;
        }
        variance / (gives * gives)
    }
}
