//! Depth and tip from wavelengths and poses, with a deviation that is true: what a control loop runs on a calibrated tool.
//!
//! [`state`] carries the hole from pose to pose, [`moments`] says what the fibres feel, [`reading`] what that makes of force
//! and depth, [`judging`] and [`slips`] which gratings not to believe, [`offsets`] how the moments of no force move, [`edge`]
//! how the hole strays, [`along`] whether it goes with the shaft, [`tip`] what touches beside it, [`told`] where depth and tip are. Beside it stands the paper's own
//! filter, [`super::paper`].
//!
//! A reading belongs to its stamp. The state stands at the last stamp and goes on to the present by the pose alone, so that a
//! late reading costs what any other does.

// a comparison that is false for NaN is meant so
#![allow(clippy::neg_cmp_op_on_partial_ord)]

mod along;
mod edge;
mod judging;
mod moments;
mod offsets;
mod reading;
mod slips;
mod start;
mod state;
mod tip;
mod told;

pub use super::status::{Consistency, Counts, Look, Set, Status, Told};
pub use super::trusted::{Doubt, Trusted};
pub use moments::Shifts;
pub use start::ToolFilter;

use super::poses::Posed;
use crate::numbers::math::sqrt;
use crate::numbers::rigid::Rigid;
use start::possible;

/// A stamp further ahead of the present than this is a wild number and no clock, s; a step is no longer than the other.
const AHEAD_S: f64 = 0.3;
const LONGEST_S: f64 = 1e6;

impl ToolFilter {
    /// Moves the tool to a pose at a time, and folds in a reading: its stamp on the clock of the steps (s) and nine
    /// wavelengths (nm; three fibres at each of the sections I, II, III). A stamp may lie up to 0.3 s back, and must be
    /// later than the one before. See [`Status`] for what may be refused.
    #[inline]
    pub fn step(&mut self, time_s: f64, pose: &Rigid, reading: Option<(f64, &Shifts)>) -> Status {
        self.consistency.rest();
        let elapsed = time_s - self.poses.now().time_s;
        if !(0.0..LONGEST_S).contains(&elapsed) {
            self.counts.add(Status::CLOCK);
            return Status::CLOCK;
        }
        // the next pose says all about the motion that one which is none does not
        let pose = possible(pose).then_some(pose);
        let moved = pose.map_or(Status::NO_MOTION, |_| Status::default());
        self.poses.push(time_s, pose);
        let status = moved | reading.map_or(Status::MISSING, |(stamp_s, w)| self.read(stamp_s, w));
        self.counts.add(status);
        status
    }

    #[inline]
    fn read(&mut self, stamp_s: f64, w: &Shifts) -> Status {
        if !stamp_s.is_finite() {
            return Status::NOT_FINITE;
        }
        let Posed { time_s: now, pose } = *self.poses.now();
        // a stamp from the future is a clock that is off: the reading is of now
        let (late, at) = (stamp_s < now, stamp_s.min(now));
        if stamp_s <= self.used_s || at < self.state.time_s {
            return Status::LATE;
        }
        let then = if late { self.poses.at(at) } else { Some(pose) };
        let Some(then) = then else {
            return Status::LATE;
        };
        self.state.go(at, &then, self.drift.per_second);
        // a single wild stamp must not make all that follow late
        self.used_s = if stamp_s < now + AHEAD_S {
            stamp_s
        } else {
            now
        };
        let status = self.fold(w);
        if !status.has(Status::UPDATED) {
            self.state.lean(&self.shaft);
        }
        status
    }

    /// What the last reading was like.
    #[must_use]
    pub fn look(&self) -> Look {
        self.look
    }

    /// How often what happened.
    #[must_use]
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Innovation statistics of the depth.
    #[must_use]
    pub fn consistency(&self) -> &Consistency {
        &self.consistency
    }

    /// Time of the estimate, s.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        self.poses.now().time_s
    }

    /// Mean square pace at which the edge of the hole strays from where the motion of the tool has it, (mm/s)².
    #[must_use]
    pub fn pace(&self) -> f64 {
        self.edge.mean
    }

    /// Process noise of the depth at present, mm²/s.
    #[must_use]
    pub fn per_second_mm2(&self) -> f64 {
        self.drift.per_second
    }

    /// What was learnt: clearance of the hole (mm), what it gives way (mm/mN), the gratings' turn (rad), how much deeper they
    /// count (mm), the moments of no force (mN·mm).
    #[must_use]
    pub fn learnt(&self) -> [f64; 8] {
        let [_, c, g, t, a, b, d, e, deeper, ..] = self.state.x;
        [c, g, t, deeper, a, b, d, e]
    }

    /// How much fibres lag behind their bends, over the bend: what all of them have in common.
    #[must_use]
    pub fn lags(&self) -> f64 {
        sqrt(self.offsets.lag)
    }
}
