//! How far the edge of the hole strays from where the tool's motion has it, and what the hole gives way.
//!
//! It is the edge that strays, and the force follows as stiffly as shaft and hole are there. What the hole gives way is a
//! slope of two things that are both measured: what their noise makes of it is taken off (Fuller, *Measurement Error
//! Models*, 1.2), and what is not known of it is in every force that is foreseen from a change.

use super::ToolFilter;
use super::state::State;
use nalgebra::Vector3;

/// The pace of the force is taken over this time, and remembered for the other at most, s.
pub(super) const OVER_S: f64 = 0.1;
const KEPT_S: f64 = 5.0;
/// The guess at the start counts as so much, s.
const GUESSED_S: f64 = 0.01;
/// Guesses at the start: of the edge, (mm/s)², and of all that is felt, (mN/s)².
const FIRST: f64 = 1.0;
const FIRST_FELT: f64 = 1e3;
/// No hole gives way more, mm/mN; and how much one may, before anything was felt of it (standard deviation).
const MOST_GIVING: f64 = 0.1;
const GIVING: f64 = 0.01;

/// What was learnt of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Mean square pace at which the edge strays, without what the force's noise makes of it, (mm/s)².
    mean: f64,
    /// Mean of the shaft's axis over the same time, base frame.
    pub(super) axis: Vector3<f64>,
    /// The mean of the force, with all that was felt, noise and free shaft, (mN/s)².
    pub(super) felt: f64,
    /// How much is known of it, s.
    known_s: f64,
    /// Since when it is being taken.
    pub(super) since: State,
    /// Sums of what the hole gave way times the force's change, of that squared, and of that with its noise.
    yielded: [f64; 3],
    /// What the hole gives way, mm/mN, and the variance of that.
    pub(super) hole_gives: f64,
    pub(super) giving: f64,
}

impl Pace {
    pub(super) fn new(start: &State) -> Self {
        Self {
            mean: FIRST,
            axis: start.pose.rotation.column(2).into_owned(),
            felt: FIRST_FELT,
            known_s: GUESSED_S,
            since: *start,
            yielded: [0.0; 3],
            hole_gives: 0.0,
            giving: GIVING * GIVING,
        }
    }

    /// Anew from a state, with what was learnt.
    pub(super) fn anew(&self, start: &State) -> Self {
        Self {
            since: *start,
            ..*self
        }
    }

    /// The mean square pace, (mm/s)².
    pub(super) fn square(&self) -> f64 {
        if self.mean > 0.0 { self.mean } else { 0.0 }
    }
}

impl ToolFilter {
    /// Renews the pace from the state at its start to the one now, in which the shaft gives way so much where it is
    /// touched (mm/mN). The hole must not have been placed anew yet; whether `since` is to be renewed when it is.
    #[inline]
    pub(super) fn keep_pace(&mut self, shaft_gives: Option<f64>) -> bool {
        let renewed = self.state.time_s - self.pace.since.time_s >= OVER_S;
        if renewed {
            self.renew_pace(shaft_gives);
        }
        renewed
    }

    #[inline(never)]
    fn renew_pace(&mut self, shaft_gives: Option<f64>) {
        let now = &self.state;
        let mut then = self.pace.since;
        let elapsed = now.time_s - then.time_s;
        let (force, noise) = (
            then.force(),
            then.felt.noise * then.felt.share * then.felt.share,
        );
        let gave = self.shaft.gives(
            then.size * then.size,
            self.shaft.arc(then.along - then.short),
        );
        then.carry(&now.pose, 0.0);
        if let Some(gives) = shaft_gives
            && then.touched
            && then.size > 0.0
        {
            // the edge stood at the rest's place less what the force pushed it
            let there = then.off - force * then.hole_gives;
            let here = now.way * (gives * now.size + self.clearance_mm);
            let changed = now.force() - force;
            if !then.free {
                // noise of a force is in its change, and in where the shaft says that the edge stands
                let share = self.clearance_mm / now.size.max(f64::MIN_POSITIVE);
                let shared_then = self.clearance_mm / then.size;
                let by_noise =
                    now.felt.noise * (2.0 * gives + share) + noise * (2.0 * gave + shared_then);
                let felt = changed.norm_squared();
                let squared = felt - 2.0 * (now.felt.noise + noise);
                self.pace.learn_giving(
                    elapsed,
                    [by_noise - (here - there).dot(&changed), squared, felt],
                    (now.felt.noise + noise) * (gives * gives),
                );
            }
            // what is learnt of the hole by now is no straying
            then.hole_gives = self.pace.hole_gives;
            then.off = there + force * then.hole_gives;
        }
        then.lean(&self.shaft, self.clearance_mm);
        let strayed = (now.force() - then.force()).norm_squared() / 2.0;
        let per_squared = 1.0 / (elapsed * elapsed);
        let felt = (strayed * per_squared - self.pace.felt) * (elapsed.min(KEPT_S) / KEPT_S);
        self.pace.felt += if felt.is_finite() { felt } else { 0.0 };
        // how a free shaft comes to lean on the edge of its hole is no straying: see `State::edge`
        if !then.free && shaft_gives.is_some() && then.surely_inside() {
            let gives = then.gives(&self.shaft);
            let edge = then.turned(self.clearance_mm, gives).mean();
            let noise = (noise + now.felt.noise + edge) * (gives * gives);
            let left = strayed * (gives * gives) - noise;
            self.pace.known_s = (self.pace.known_s + elapsed).min(KEPT_S);
            let weight = (elapsed / self.pace.known_s).min(1.0);
            let mean = (left * per_squared - self.pace.mean) * weight;
            self.pace.mean += if mean.is_finite() { mean } else { 0.0 };
            self.pace.axis += (now.pose.rotation.column(2) - self.pace.axis) * weight;
        }
    }
}

impl Pace {
    /// What the hole gives way, by one more window: what it gave way times the force's change, that squared, the same
    /// with its noise, and the variance of a component of where the edge is seen, by noise.
    ///
    /// A slope by the first over the second is as sure as the second over the third (reliability): while a tool stands
    /// still, the force changes by noise alone, and nothing is known of the hole.
    fn learn_giving(&mut self, elapsed_s: f64, more: [f64; 3], noise_mm2: f64) {
        let kept = 1.0 - elapsed_s.min(KEPT_S) / (4.0 * KEPT_S);
        let [shared, squares, felt] = self.yielded;
        let sums = [
            shared * kept + more[0],
            squares * kept + more[1],
            felt * kept + more[2],
        ];
        if !sums.iter().all(|x| x.is_finite()) {
            return;
        }
        self.yielded = sums;
        let [shared, squares, felt] = sums;
        // `felt` is `squares` and what noise adds
        let reliability = if squares > 0.0 { squares / felt } else { 0.0 };
        let variance = self.square() * elapsed_s * elapsed_s + noise_mm2;
        let known = reliability * squares + variance / (GIVING * GIVING);
        if known > 0.0 {
            let given = reliability * shared / known;
            self.hole_gives = if given > 0.0 {
                given.min(MOST_GIVING)
            } else {
                0.0
            };
            self.giving = variance / known;
        }
    }
}
