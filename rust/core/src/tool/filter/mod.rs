//! Depth and tip from wavelengths and poses, with a deviation that is true: what a control loop runs on a calibrated
//! tool.
//!
//! [`state`] carries the hole from pose to pose, [`moments`] says what the fibres feel, [`reading`] what that makes of
//! force and depth, [`judging`] which gratings not to believe ([`evidence`], [`hypotheses`]), [`creep`] how the references
//! go, [`pace`] and [`drift`] how the hole strays, [`told`] where depth and tip are. Beside it stands the paper's own filter,
//! [`super::paper`]. All are parts of one value, which [`start`] makes.
//!
//! A reading belongs to its stamp. The state stands at the last stamp and goes on to the present by the pose alone, so
//! that a late reading costs what any other does ([`poses`]).

// a comparison that is false for NaN is meant so
#![allow(clippy::neg_cmp_op_on_partial_ord)]

mod creep;
mod drift;
mod evidence;
mod hypotheses;
mod judging;
mod known;
mod moments;
mod pace;
mod poses;
mod reading;
mod slips;
mod smoother;
mod start;
mod state;
mod status;
mod told;
mod warmth;

pub use known::{Doubt, Tied, Trusted, UNKNOWNS};
pub use moments::{Set, Shifts};
pub use smoother::{Node, Smoothed, smooth};
pub use start::ToolFilter;
pub use status::{Consistency, Counts, Look, Status};
pub use told::Told;

use crate::numbers::rigid::Rigid;
use poses::Posed;
use start::possible;

/// A stamp further ahead of the present than this is a wild number and no clock, s.
const AHEAD_S: f64 = 0.3;
/// A step is no longer than this, s.
const LONGEST_S: f64 = 1e6;

impl ToolFilter {
    /// Moves the tool to a pose at a time, and folds in a reading: its stamp on the clock of the steps (s) and nine
    /// wavelengths (nm; three fibres at each of the sections I, II, III). A stamp may lie up to 0.3 s back, and must be
    /// later than the one before. See [`Status`] for what may be refused.
    #[inline]
    pub fn step(&mut self, time_s: f64, pose: &Rigid, reading: Option<(f64, &Shifts)>) -> Status {
        self.watch.consistency.rest();
        let elapsed = time_s - self.poses.now().time_s;
        if !(0.0..LONGEST_S).contains(&elapsed) {
            self.watch.counts.add(Status::CLOCK);
            return Status::CLOCK;
        }
        let mut status = Status::default();
        let pose = if possible(pose) {
            Some(pose)
        } else {
            // the next pose says all about the motion that this one does not
            status = Status::NO_MOTION;
            None
        };
        self.poses.push(time_s, pose);
        status = status
            | match reading {
                None => Status::MISSING,
                Some((stamp_s, w)) => self.read(stamp_s, w),
            };
        self.watch.counts.add(status);
        status
    }

    #[inline]
    fn read(&mut self, stamp_s: f64, w: &Shifts) -> Status {
        if !stamp_s.is_finite() {
            return Status::NOT_FINITE;
        }
        let Posed { time_s: now, pose } = self.poses.now();
        // a stamp from the future is a clock that is off: the reading is of now
        let late = stamp_s < *now;
        let at = if late { stamp_s } else { *now };
        if stamp_s <= self.used_s || at < self.state.time_s {
            return Status::LATE;
        }
        let (per_second, before) = (self.drift.per_second, self.state.time_s);
        // a single wild stamp must not make all that follow late
        let used = if stamp_s < now + AHEAD_S {
            stamp_s
        } else {
            *now
        };
        if late {
            let Some(then) = self.poses.at(at) else {
                return Status::LATE;
            };
            self.state.go(at, &then, per_second);
        } else {
            self.state.go(at, pose, per_second);
        }
        self.used_s = used;
        self.drift.pass(at - before);
        self.creep.pass(before, at, &mut self.state.known);
        let status = self.fold(w);
        if !status.has(Status::UPDATED) {
            self.state.lean(&self.shaft);
        }
        status
    }

    /// What the last reading was like.
    #[must_use]
    pub fn look(&self) -> Look {
        self.watch.look
    }

    /// How often what happened.
    #[must_use]
    pub fn counts(&self) -> &Counts {
        &self.watch.counts
    }

    /// The last reading, for a smoother, and its time, s.
    #[must_use]
    pub fn node(&self) -> (f64, Node) {
        let node = Node {
            before: self.before,
            after: self.state.known,
            shares: self.state.shares,
        };
        (self.state.time_s, node)
    }

    /// Innovation statistics of the depth.
    #[must_use]
    pub fn consistency(&self) -> &Consistency {
        &self.watch.consistency
    }

    /// Time of the estimate, s.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        self.poses.now().time_s
    }

    /// Mean square pace at which the edge of the hole strays from where the motion of the tool has it, (mm/s)².
    #[must_use]
    pub fn pace(&self) -> f64 {
        self.pace.all()
    }

    /// Process noise of the depth at present, mm²/s.
    #[must_use]
    pub fn per_second_mm2(&self) -> f64 {
        self.drift.per_second
    }

    /// What was learnt of the hole: clearance (mm), what it gives way (mm/mN), and the moments of no force (mN·mm).
    #[must_use]
    pub fn learnt(&self) -> [f64; 8] {
        let [_, rest @ ..] = self.state.known.x;
        rest
    }
}
