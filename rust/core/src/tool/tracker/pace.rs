//! How far the force strays from what the motion of the tool makes of it, and what the hole gives way.

use super::ToolFilter;
use super::state::State;

/// The pace of the force is taken over this time, and remembered for the other at most, s.
const OVER_S: f64 = 0.1;
const KEPT_S: f64 = 5.0;
/// The guess at the start counts as so much, s.
const GUESSED_S: f64 = 0.01;
/// Guess at the start, (mN/s)².
const FIRST: f64 = 1e3;
/// A force is not extrapolated further, s.
const UP_TO_S: f64 = 2.0;
/// No hole gives way more, mm/mN.
const MOST_GIVING: f64 = 0.1;

/// What was learnt of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Mean square pace at which the force strays, without what its noise makes of it, (mN/s)².
    mean: f64,
    /// The same of all that was felt, with noise and free shaft.
    pub(super) felt: f64,
    /// How much is known of it, s.
    known_s: f64,
    /// Since when it is being taken.
    pub(super) since: State,
    /// Sums of what the hole gave way times the force's change, and of that squared.
    yielded: [f64; 2],
    /// What the hole gives way, mm/mN.
    pub(super) hole_gives: f64,
}

impl Pace {
    pub(super) fn new(start: &State) -> Self {
        Self {
            mean: FIRST,
            felt: FIRST,
            known_s: GUESSED_S,
            since: *start,
            yielded: [0.0; 2],
            hole_gives: 0.0,
        }
    }

    /// Anew from a state, with what was learnt.
    pub(super) fn anew(&self, start: &State) -> Self {
        Self {
            since: *start,
            ..*self
        }
    }

    /// Variance of a component of the force after a time, mN²: in proportion as long as it was taken over, and from one
    /// such time to the next as it comes.
    #[inline]
    pub fn strayed(&self, waited_s: f64) -> f64 {
        let waited = waited_s.min(UP_TO_S);
        let mean = if self.mean > 0.0 { self.mean } else { 0.0 };
        mean * waited * waited.min(OVER_S)
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
        then.carry(&now.pose, 0.0);
        if let Some(gives) = shaft_gives
            && then.touched
            && then.size > 0.0
        {
            // the edge stood at the rest's place less what the force pushed it
            let there = then.off - force * then.hole_gives;
            let here = now.way * (gives * now.size + self.clearance_mm);
            let changed = now.force() - force;
            let kept = 1.0 - elapsed.min(KEPT_S) / (4.0 * KEPT_S);
            let [shared, squares] = self.pace.yielded;
            let shared = shared * kept - (here - there).dot(&changed);
            let squares = squares * kept + changed.norm_squared();
            if shared.is_finite() && squares.is_finite() {
                self.pace.yielded = [shared, squares];
                self.pace.hole_gives = if shared > 0.0 && squares > 0.0 {
                    (shared / squares).min(MOST_GIVING)
                } else {
                    0.0
                };
            }
            // what is learnt of the hole by now is no straying
            then.hole_gives = self.pace.hole_gives;
            then.off = there + force * then.hole_gives;
        }
        then.lean(&self.shaft, self.clearance_mm);
        let strayed = (now.force() - then.force()).norm_squared() / 2.0;
        let squared = elapsed * elapsed;
        let felt = (strayed / squared - self.pace.felt) * (elapsed.min(KEPT_S) / KEPT_S);
        self.pace.felt += if felt.is_finite() { felt } else { 0.0 };
        // how a free shaft comes to lean on the edge of its hole is no straying: see `State::edge`
        if !then.free && shaft_gives.is_some() && then.surely_inside() {
            let moved = (now.pose.translation - self.pace.since.pose.translation).norm();
            let edge = then.edge(moved, self.clearance_mm, then.gives(&self.shaft), 0.0);
            let noise = noise + now.felt.noise + edge;
            self.pace.known_s = (self.pace.known_s + elapsed).min(KEPT_S);
            let weight = (elapsed / self.pace.known_s).min(1.0);
            let mean = ((strayed - noise) / squared - self.pace.mean) * weight;
            self.pace.mean += if mean.is_finite() { mean } else { 0.0 };
        }
    }
}
