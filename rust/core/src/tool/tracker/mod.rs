//! Depth and tip from wavelengths and poses, with a deviation that is true: what a control loop runs on a calibrated
//! tool.
//!
//! The eye's hole stands at `E`. The unbent shaft, with its end at `S` and its axis along `z`, passes it; where the shaft
//! leans on its edge the hole is `u` off the axis, which is the bend there and the clearance. So the hole stands at
//! `(u, -l)` in the tool's frame with `l = (S - E)·z`, and when the tool moves the hole does not: `l` changes by `Ṡ·z` and
//! by `(S - E)·ż`, the turn about the hole, which Eq. 8 of the tool paper leaves out. Nothing is integrated: the hole is
//! carried from one pose to the other, whatever lies between. A bent shaft reaches less far, so the depth, the length of
//! shaft beyond the hole, is `l` and what the bend takes ([`Rod`]).
//!
//! Depth is measured by what the moments differ across their levers, `c = (m_I a_II - m_II a_I)·f` with `a_i = l_i - d`
//! for the depth `d` expected: it is `F Δl` times what the depth is off, its noise does not know the force that is
//! measured with it, and no ratio of two noisy numbers is taken. The force is the weighted mean of `m_i / a_i`.
//!
//! The filter is Schmidt's in unit unknowns ([`unknowns`]): what the calibration does not know stays in the error and is
//! never averaged away.
//!
//! A reading belongs to its stamp. The state stands at the last stamp and goes on to the present by the pose alone, so
//! that a late reading costs what any other does ([`poses`]).

mod doubting;
mod drift;
mod going;
mod interrogator;
mod moments;
mod pace;
mod poses;
mod reading;
mod state;
mod stray;
mod telling;
mod trusted;
mod unknowns;

pub use interrogator::Set;
pub use telling::Told;
pub use trusted::Trusted;
pub use unknowns::{Doubt, Tied, UNKNOWNS};

use super::filters::{Consistency, Counts, Status};
use super::rod::{Rod, Shaft};
use super::sensing::{FIBRES, SECTIONS};
use crate::numbers::rigid::Rigid;
use crate::{Error, Result};
use drift::Drift;
use going::Kept;
use interrogator::{Interrogator, Swap};
use moments::Gains;
use pace::Pace;
use poses::{Posed, Poses};
use state::State;
use unknowns::Unknowns;

/// A stamp further ahead of the present than this is a wild number and no clock, s.
const AHEAD_S: f64 = 0.3;
/// A step is no longer than this, s, and no robot stands further away, mm.
const LONGEST_S: f64 = 1e6;
const FARTHEST_MM: f64 = 1e6;

/// What the last reading was like.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Look {
    /// Square of what the moments say across the force over its variance: about 1.
    pub misfit: f64,
    /// Gratings that were not believed.
    pub faulty: Set,
}

/// What was seen of the readings and is doubted; nothing yet at a start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Watch {
    /// Gratings held to be bad.
    bad: Set,
    /// Those of the bad that crept away.
    crept: Set,
    swapped: Option<Swap>,
    silent: Set,
    /// Those of the last failing reading, and how often in a row.
    suspects: Set,
    streak: u16,
    good: u16,
    /// How badly a lost section fits without each of its gratings, slowly, and for how many readings.
    alone: [f64; FIBRES],
    alone_for: u16,
    refused: u16,
    look: Look,
    counts: Counts,
    consistency: Consistency,
}

/// The filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolFilter {
    rod: Rod,
    shaft: Shaft,
    distances_mm: [f64; 2],
    clearance_mm: f64,
    unknowns: Unknowns,
    gains: Gains,
    interrogator: Interrogator,
    poses: Poses,
    state: State,
    drift: Drift,
    pace: Pace,
    kept: Kept,
    used_s: f64,
    watch: Watch,
}

/// Whether a robot can stand so.
#[inline]
fn possible(pose: &Rigid) -> bool {
    // false for NaN
    let mut possible = true;
    for x in pose.translation.as_slice() {
        possible &= x.abs() < FARTHEST_MM;
    }
    for x in pose.rotation.as_slice() {
        possible &= x.abs() < 2.0;
    }
    possible
}

/// The state at a start.
fn first(depth_mm: f64, variance: f64, pose: &Rigid, time_s: f64) -> Result<State> {
    let known = depth_mm.abs() < FARTHEST_MM && time_s.is_finite() && possible(pose);
    if !(known && variance >= 0.0 && variance.is_finite()) {
        return Err(Error::Invalid {
            what: "tool: the first depth, pose and time must be finite, its variance zero or more",
        });
    }
    Ok(State::start(time_s, pose, depth_mm, variance))
}

impl ToolFilter {
    /// Starts at a depth (mm) with a variance (mm²), with the tool at a pose (tool to base frame), at a time (s).
    ///
    /// # Errors
    /// [`Error::Invalid`] for numbers that mean nothing.
    pub fn new(
        trusted: &Trusted,
        depth_mm: f64,
        variance: f64,
        pose: &Rigid,
        time_s: f64,
    ) -> Result<Self> {
        trusted.check()?;
        let state = first(depth_mm, variance, pose, time_s)?;
        let c = &trusted.calibration;
        let drift = Drift::new(trusted.per_second_mm2, variance);
        Ok(Self {
            rod: trusted.rod,
            shaft: trusted.rod.shaft(),
            distances_mm: c.distances_mm,
            clearance_mm: trusted.clearance_mm,
            unknowns: Unknowns::new(&trusted.doubt),
            gains: Gains::new(c, &trusted.warmth),
            interrogator: Interrogator::new(c, &trusted.doubt),
            poses: Poses::new(Posed {
                time_s,
                pose: *pose,
            }),
            state,
            drift,
            pace: Pace::new(&state),
            kept: Kept::new(&state, &drift),
            used_s: f64::NEG_INFINITY,
            watch: Watch::default(),
        })
    }

    /// The same tool from another start, as [`ToolFilter::new`], with what was learnt of how the eye moves and gives way:
    /// for a smoother, which comes back over a run.
    ///
    /// # Errors
    /// As [`ToolFilter::new`].
    pub fn anew(&self, depth_mm: f64, variance: f64, pose: &Rigid, time_s: f64) -> Result<Self> {
        let state = first(depth_mm, variance, pose, time_s)?;
        let drift = self.drift.anew(variance);
        Ok(Self {
            interrogator: self.interrogator.anew(),
            poses: Poses::new(Posed {
                time_s,
                pose: *pose,
            }),
            state,
            drift,
            pace: self.pace.anew(&state),
            kept: Kept::new(&state, &drift),
            used_s: f64::NEG_INFINITY,
            watch: Watch::default(),
            ..*self
        })
    }

    /// Moves the tool to a pose at a time, and folds in a reading: its stamp on the clock of the steps (s) and nine
    /// wavelengths (nm; three fibres at each of the sections I, II, III). A stamp may lie up to 0.3 s back, and must be
    /// later than the one before. See [`Status`] for what may be refused.
    #[inline]
    pub fn step(
        &mut self,
        time_s: f64,
        pose: &Rigid,
        reading: Option<(f64, &[[f64; FIBRES]; SECTIONS])>,
    ) -> Status {
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
    fn read(&mut self, stamp_s: f64, w: &[[f64; FIBRES]; SECTIONS]) -> Status {
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
        let (per_second, clearance) = (self.drift.per_second, self.unknowns.clearance_mm);
        let before = self.state.time_s;
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
            self.state.go(at, &then, per_second, clearance);
        } else {
            self.state.go(at, pose, per_second, clearance);
        }
        self.used_s = used;
        self.drift.pass(at - before);
        let status = self.fold(w);
        if !status.has(Status::UPDATED) {
            self.state.lean(&self.shaft, self.clearance_mm);
        }
        self.kept.keep(&self.state, &self.drift);
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

    /// Mean square pace at which the force strays from what the motion of the tool makes of it, (mN/s)².
    #[must_use]
    pub fn pace(&self) -> f64 {
        self.pace.felt
    }

    /// Process noise of the depth at present, mm²/s.
    #[must_use]
    pub fn per_second_mm2(&self) -> f64 {
        self.drift.per_second
    }
}
