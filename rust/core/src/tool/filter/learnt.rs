//! What a filter has learnt beside its state: of readings, offsets, the edge, the tip and the gratings.

use super::moments::{GRATINGS, Moments, Shifts};
use super::slips::Slips;
use super::state::{Row, Seen};
use crate::numbers::math::sqrt;
use crate::tool::poses::Posed;
use crate::tool::sensing::{FIBRES, SECTIONS};
use crate::tool::status::Set;
use nalgebra::Vector2;

/// Innovations that pull one way: over this time, s; how far the logarithm of the hole's drift follows; the largest
/// product that counts; the first drift and the fastest over the slowest.
const INNOVATIONS_S: f64 = 0.2;
const FOLLOWS: f64 = 0.1;
const MOST_ALIKE: f64 = 16.0;
const FIRST_DRIFT: f64 = 4.0;
const FASTEST: f64 = 256.0;
/// Of the edge the first pace squared, (mm/s)², and for how long that counts, s.
const FIRST_PACE: f64 = 0.04;
const GUESSED_S: f64 = 0.01;
/// How long the robot's lateness is looked at, and over which time its sign is taken, s; how late one may be, s; what strays
/// over that time before anything is known of them, mm²; the odds that one is late at all.
const LATE_S: f64 = 30.0;
const COMPARED_S: f64 = 0.5;
const MAY_BE_S: f64 = 0.04;
const STRAYS_MM2: f64 = 0.04;
const ODDS: f64 = 1.0 / 3.0;
/// How far off the tip's force is, over the force: nobody says where section III stands.
const SHARE: f64 = 0.15;
/// No shaft is bent or warmed so far, nm; repeats of one number after which a grating is not asked.
const FARTHEST_NM: f64 = 8.0;
const REPEATS: u8 = 3;
/// Peaks that move by more at once than this may have changed places, nm; within this time, s.
const MOVED_NM: f64 = 0.08;
const AT_ONCE_S: f64 = 0.1;
/// How long noise is watched, s.
const WATCHED_S: f64 = 5.0;
/// What may be left out beside what is: nine gratings, three fibres, section III, the warmth of three sections.
pub(super) const HYPOTHESES: usize = GRATINGS + FIBRES + 1 + SECTIONS;

/// What a reading says beside the expected state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Said {
    pub(super) size: f64,
    pub(super) way: Vector2<f64>,
    /// How much deeper than expected the hole stands where the reading was looked at again, what the bend takes from `l`
    /// there, mm, and from the moments.
    pub(super) ahead: f64,
    pub(super) short: f64,
    pub(super) relief: [f64; 2],
    /// Variance of the force's components by noise, mN²; the force by the moments of I and II and by the depth.
    pub(super) noise: f64,
    pub(super) by_moments: [f64; 2],
    pub(super) by_depth: f64,
    /// Variance of the depth by what lasts, mm².
    pub(super) lasting: f64,
    /// Whether there is a force at all.
    pub(super) leans: bool,
    /// How far the depth is from the expected one, mm, where the force tells it.
    pub(super) off: Option<(f64, Seen)>,
    /// Square of what the moments say across the force over its variance.
    pub(super) misfit: f64,
}

impl Said {
    /// Square of how far the depth is off over its variance; zero where it is not told.
    pub(super) fn far(&self) -> f64 {
        self.off.map_or(0.0, |(mm, seen)| mm * mm / seen.total)
    }
}

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
    /// The last rest that was compared, and its time, s; squares of changes from one to the next, nm², and of the times in
    /// which they came, s².
    pub(super) last: Option<(f64, [f64; 4])>,
    pub(super) moved: f64,
    pub(super) waited: f64,
    /// How far a reference may have crept since the last rest, nm²; warmth then, nm.
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

/// What was learnt of the edge: mean square pace of a coordinate, (mm/s)², and how much is known of it, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Edge {
    pub(super) mean: f64,
    pub(super) known_s: f64,
    pub(super) since: Option<Then>,
    /// Since when strays add up, to what, and the hole's motion aside then, mm/s; sums by which the robot's rows are late: of
    /// strays by how that motion changed, of its squares, of squares of strays, mm, and of ones.
    pub(super) strays: Option<(f64, Vector2<f64>, Vector2<f64>)>,
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

    /// Strays over half a second beside how the motion of the hole aside changed in it: tremor is over by then.
    #[inline]
    pub(super) fn strays(&mut self, strayed: &Vector2<f64>, sideways: &Vector2<f64>, time_s: f64) {
        let Some((since_s, sum, before)) = self.strays else {
            self.strays = Some((time_s, Vector2::zeros(), *sideways));
            return;
        };
        let sum = sum + strayed;
        self.strays = Some((since_s, sum, before));
        if time_s - since_s < COMPARED_S {
            return;
        }
        self.strays = Some((time_s, Vector2::zeros(), *sideways));
        let faster = sideways - before;
        let keeps = (1.0 - (time_s - since_s) / LATE_S).max(0.0);
        let [with, own, square, n] = self.late.map(|x| x * keeps);
        let [more, squared] = [sum.dot(&faster), 0.5 * sum.norm_squared()];
        self.late = [
            with + more,
            own + faster.norm_squared(),
            square + squared,
            n + 1.0,
        ];
    }
}

/// Force at the tip, tool frame, mN, the variance of a component by noise, and of its zero, mN².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Tip {
    pub(super) force: Vector2<f64>,
    pub(super) variance: f64,
    pub(super) of_zero: f64,
    /// The moment of section III at rest, mN·mm, and how far the hole has bent III since, as a fibre's shift squared, nm².
    pub(super) zero: Vector2<f64>,
    pub(super) bent: f64,
    pub(super) tells: bool,
    /// Whether it is one.
    pub(super) on: bool,
}

impl Tip {
    /// Takes it off moments at these distances, mm.
    #[inline]
    pub(super) fn off(&self, m: &Moments, distances_mm: [f64; 2]) -> Moments {
        let mut left = *m;
        if self.on {
            for i in 0..2 {
                let of_tip = self.force * distances_mm[i];
                left.m[i] -= of_tip;
                left.z[i] -= m.j[i] * of_tip;
            }
        }
        left
    }

    /// Variance of a component that lasts, mN²; and with its noise, where there is such a force.
    #[inline]
    pub(super) fn lasting(&self) -> f64 {
        let share = f64::from(u8::from(self.on)) * SHARE * SHARE * self.force.norm_squared();
        f64::from(u8::from(self.tells)) * (self.of_zero + share)
    }

    #[inline]
    pub(super) fn unsure(&self) -> f64 {
        f64::from(u8::from(self.on)) * (self.variance + self.lasting())
    }
}

/// What was seen of the gratings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Watch {
    /// The last wavelengths, each in its place, and when; which peak shows where; how often each repeated a number.
    pub(super) last: [f64; GRATINGS],
    pub(super) at_s: f64,
    pub(super) places: [usize; GRATINGS],
    pub(super) repeats: [u8; GRATINGS],
    /// Variance of a grating from reading to reading, nm².
    pub(super) jitter: f64,
    /// Evidence for each hypothesis, the one that surely leads, and for how many readings; those in a row that were refused.
    pub(super) sums: [f64; HYPOTHESES],
    pub(super) leader: Set,
    pub(super) leads_for: u16,
    pub(super) refused: u16,
    /// What is held to be bad, and for how many readings of bending it is suspected, or a fibre that slips is.
    pub(super) held: Set,
    pub(super) suspects: u16,
    pub(super) slips: Slips,
}

impl Watch {
    pub(super) fn new(jitter: f64) -> Self {
        Self {
            last: [f64::NAN; GRATINGS],
            at_s: f64::NEG_INFINITY,
            places: core::array::from_fn(|k| k),
            repeats: [0; GRATINGS],
            jitter,
            sums: [0.0; HYPOTHESES],
            leader: 0,
            leads_for: 0,
            refused: 0,
            held: 0,
            suspects: 0,
            slips: Slips::default(),
        }
    }

    /// Puts peaks back that have changed places.
    pub(super) fn sort(&mut self, peaks: &mut [f64; GRATINGS]) {
        let mut moved: [f64; GRATINGS] = core::array::from_fn(|k| (peaks[k] - self.last[k]).abs());
        for a in 0..GRATINGS {
            for b in a + 1..GRATINGS {
                let changed = (peaks[a] - self.last[b]).abs() + (peaks[b] - self.last[a]).abs();
                let least = moved[a].min(moved[b]);
                // a bend that comes at once moves the others as well
                let alone = |k: usize| k == a || k == b || !(moved[k] > 0.25 * least);
                let swapped = moved[a] > MOVED_NM && changed < 0.1 * (moved[a] + moved[b]);
                if swapped && (0..GRATINGS).all(alone) {
                    self.places.swap(a, b);
                    peaks.swap(a, b);
                    (moved[a], moved[b]) = (0.0, 0.0);
                }
            }
        }
    }

    /// Shifts from the reference, nm, with peaks back in their places, and the gratings that say nothing: not finite, out of
    /// all bounds, or stuck.
    #[inline]
    pub(super) fn look(&mut self, w: &Shifts, reference: &Shifts, elapsed_s: f64) -> (Shifts, Set) {
        let shown = w.as_flattened();
        let mut peaks: [f64; GRATINGS] = core::array::from_fn(|k| shown[self.places[k] % GRATINGS]);
        if elapsed_s < AT_ONCE_S
            && (0..GRATINGS).any(|k| (peaks[k] - self.last[k]).abs() > MOVED_NM)
        {
            self.sort(&mut peaks);
        }
        let (mut shifts, mut silent, mut still): (Shifts, Set, Set) =
            ([[0.0; FIBRES]; SECTIONS], 0, 0);
        for k in 0..GRATINGS {
            let shift = peaks[k] - reference[k / FIBRES][k % FIBRES];
            // false for NaN
            if shift.abs() < FARTHEST_NM {
                shifts[k / FIBRES][k % FIBRES] = shift;
            } else {
                silent |= 1 << k;
            }
            let same = u8::from(peaks[k] == self.last[k]);
            self.repeats[k] = same * self.repeats[k].saturating_add(1);
            still |= Set::from(self.repeats[k] >= REPEATS) << k;
        }
        // the difference of two that a bend moves least, from reading to reading
        let jump = (peaks[7] - self.last[7]) - (peaks[8] - self.last[8]);
        if jump.abs() < MOVED_NM && jump != 0.0 {
            self.jitter += (0.25 * jump * jump - self.jitter) * (elapsed_s / WATCHED_S).min(0.1);
        }
        self.last = peaks;
        // where all stand still it is the world, or a source that gives each reading several times
        if still.count_ones() <= 3 {
            silent |= still;
        }
        (shifts, silent)
    }

    pub(super) fn hold(&mut self, held: Set) {
        (self.held, self.leads_for, self.refused) = (held, 0, 0);
        self.sums = [0.0; HYPOTHESES];
    }

    pub(super) fn misplaced(&self) -> Set {
        (0..GRATINGS).fold(0, |set, k| set | Set::from(self.places[k] != k) << k)
    }
}
