//! On to a later time and another pose, and back to before a fault.

use super::ToolFilter;
use super::drift::Drift;
use super::state::State;
use crate::numbers::rigid::Rigid;

/// Readings between two states that are kept to go back to.
const KEPT_EVERY: [u16; 2] = [16, 256];

/// A state, with what was made of the drift until then.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Earlier {
    state: State,
    drift: Drift,
}

/// Earlier states to go back to when a grating turns out to have lied for a while: two of a moment ago, two of a second
/// or two ago; and readings since the newer of each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kept {
    earlier: [[Earlier; 2]; 2],
    since: [u16; 2],
}

impl Kept {
    pub(super) fn new(state: &State, drift: &Drift) -> Self {
        let earlier = Earlier {
            state: *state,
            drift: *drift,
        };
        Self {
            earlier: [[earlier; 2]; 2],
            since: [0; 2],
        }
    }

    #[inline]
    pub(super) fn keep(&mut self, state: &State, drift: &Drift) {
        for i in 0..2 {
            self.since[i] += 1;
            if self.since[i] >= KEPT_EVERY[i] {
                self.since[i] = 0;
                let newest = Earlier {
                    state: *state,
                    drift: *drift,
                };
                self.earlier[i] = [newest, self.earlier[i][0]];
            }
        }
    }
}

impl State {
    /// On to a time and a pose; the hole strays by this variance a second.
    #[inline]
    pub(super) fn go(&mut self, time_s: f64, pose: &Rigid, per_second: f64, clearance_mm: f64) {
        self.variance += per_second * (time_s - self.time_s);
        self.time_s = time_s;
        self.carry(pose, clearance_mm);
    }
}

impl ToolFilter {
    /// The state at a later time and another pose.
    pub(super) fn carried(&self, state: &State, time_s: f64, pose: &Rigid) -> State {
        let mut next = *state;
        next.go(
            time_s,
            pose,
            self.drift.per_second,
            self.unknowns.clearance_mm,
        );
        next.lean(&self.shaft, self.clearance_mm);
        next
    }

    /// Back to a state from before a fault showed, brought to where the tool is now: the depth of then is as good as
    /// what was moved is known.
    pub(super) fn back(&mut self, slowly: bool) {
        let Earlier { state, drift } = self.kept.earlier[usize::from(slowly)][1];
        let now = self.state;
        self.drift = drift;
        self.drift.pass(now.time_s - state.time_s);
        self.state = self.carried(&state, now.time_s, &now.pose);
        if state.felt.time_s < now.felt.time_s && !self.state.touched {
            self.state.push(&now.force());
        }
        for (i, kept) in self.kept.earlier.iter_mut().enumerate() {
            if i == usize::from(slowly) || slowly {
                *kept = [Earlier { state, drift }; 2];
            }
        }
        self.kept.since = [0; 2];
        self.pace.since = state;
    }
}
