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
mod interrogator;
mod poses;
mod reading;
mod state;
mod telling;
mod unknowns;

pub use interrogator::Set;
pub use unknowns::{Doubt, Tied, UNKNOWNS};

use super::filters::{Consistency, Counts, Status};
use super::rod::Rod;
use super::sensing::{Calibration, FIBRES, SECTIONS, Sensor};
use crate::numbers::rigid::Rigid;
use crate::{Error, Result};
use drift::Drift;
use interrogator::{Interrogator, Swap};
use nalgebra::{Vector2, Vector3};
use poses::{Posed, Poses};
use state::State;
pub use telling::Told;
use unknowns::{CLEARANCE, Unknowns};

/// Readings between two states that are kept to go back to.
const KEPT_EVERY: [u16; 2] = [16, 256];
/// A force is not extrapolated further, s.
const PACE_UP_TO_S: f64 = 2.0;
/// A stamp further ahead of the present than this is a wild number and no clock, s.
const AHEAD_S: f64 = 0.3;
/// A step is no longer than this, s, and no robot stands further away, mm.
const LONGEST_S: f64 = 1e6;
const FARTHEST_MM: f64 = 1e6;

/// A tool and how far it is trusted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trusted {
    /// The gratings.
    pub calibration: Calibration,
    /// The shaft.
    pub rod: Rod,
    /// What the calibration does not know.
    pub doubt: Doubt,
    /// Radius by which the hole is wider than the shaft, mm.
    pub clearance_mm: f64,
    /// How fast the hole strays along the shaft at least, mm²/s.
    pub per_second_mm2: f64,
}

/// What the last reading was like.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Look {
    /// Square of what the moments say across the force over its variance: about 1.
    pub misfit: f64,
    /// Gratings that were not believed.
    pub faulty: Set,
}

/// A state, with what was made of the drift until then.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Earlier {
    state: State,
    drift: Drift,
}

/// The filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolFilter {
    rod: Rod,
    distances_mm: [f64; 2],
    clearance_mm: f64,
    unknowns: Unknowns,
    interrogator: Interrogator,
    poses: Poses,
    state: State,
    drift: Drift,
    /// Mean square pace at which the force strays from what the motion makes of it, (mN/s)², and since when it is being
    /// taken.
    pace: f64,
    paced: State,
    /// What the hole gives way, mm/mN: sums of what it did times the force's change, and of that squared.
    yielded: [f64; 2],
    /// Earlier states to go back to when a grating turns out to have lied for a while: two of a moment ago, two of a
    /// second or two ago; and readings since the newer of each.
    earlier: [[Earlier; 2]; 2],
    since: [u16; 2],
    used_s: f64,
    /// Gratings held to be bad, those of the last failing reading, and how often in a row.
    bad: Set,
    swapped: Option<Swap>,
    silent: Set,
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

/// Whether a robot can stand so.
fn possible(pose: &Rigid) -> bool {
    // false for NaN
    let near = pose.translation.iter().all(|x| x.abs() < FARTHEST_MM);
    near && pose.rotation.iter().all(|x| x.abs() < 2.0)
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
        let c = &trusted.calibration;
        Sensor::new(*c)?;
        let d = &trusted.doubt;
        let deviations = [d.reference_nm, d.warmth, d.clearance_mm, d.distance_mm];
        let rest = [trusted.clearance_mm, trusted.per_second_mm2, variance];
        let more = deviations.iter().chain(&rest);
        let matrices = d.gains.as_flattened().iter().flatten().chain(d.beam.iter());
        if !more.copied().all(|x| x >= 0.0 && x.is_finite())
            || !matrices.copied().all(f64::is_finite)
        {
            return Err(Error::Invalid {
                what: "tool: deviations, clearance and variances must be zero or more, and finite",
            });
        }
        if !(depth_mm.abs() < FARTHEST_MM && time_s.is_finite() && possible(pose)) {
            return Err(Error::Invalid {
                what: "tool: the first depth, pose and time must be finite",
            });
        }
        let interrogator = Interrogator::new(c, d);
        let state = State {
            time_s,
            pose: *pose,
            off: Vector2::zeros(),
            along: depth_mm,
            gives: 0.0,
            free: true,
            rest: Vector2::zeros(),
            variance,
            tied: [0.0; UNKNOWNS],
            force: Vector2::zeros(),
            force_s: time_s,
            force_noise: 0.0,
            force_tied: [[0.0; UNKNOWNS]; 2],
            by_depth: 0.0,
        };
        let unknowns = Unknowns::new(d, &interrogator.gains);
        let drift = Drift::new(trusted.per_second_mm2, variance);
        Ok(Self {
            rod: trusted.rod,
            distances_mm: c.distances_mm,
            clearance_mm: trusted.clearance_mm,
            unknowns,
            interrogator,
            poses: Poses::new(Posed {
                time_s,
                pose: *pose,
            }),
            state,
            drift,
            pace: 1e3,
            paced: state,
            yielded: [0.0; 2],
            earlier: [[Earlier { state, drift }; 2]; 2],
            since: [0; 2],
            used_s: f64::NEG_INFINITY,
            bad: 0,
            swapped: None,
            silent: 0,
            suspects: 0,
            streak: 0,
            good: 0,
            alone: [0.0; FIBRES],
            alone_for: 0,
            refused: 0,
            look: Look::default(),
            counts: Counts::default(),
            consistency: Consistency::default(),
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
        self.consistency.last = 0.0;
        self.consistency.last_degrees = 0;
        let elapsed = time_s - self.poses.now().time_s;
        if !(0.0..LONGEST_S).contains(&elapsed) {
            self.counts.add(Status::CLOCK);
            return Status::CLOCK;
        }
        let mut status = Status::default();
        let pose = if possible(pose) {
            *pose
        } else {
            // the next pose says all about the motion that this one does not
            status = Status::NO_MOTION;
            self.poses.now().pose
        };
        self.poses.push(Posed { time_s, pose });
        status = status
            | match reading {
                None => Status::MISSING,
                Some((stamp_s, w)) => self.read(stamp_s, w),
            };
        self.counts.add(status);
        status
    }

    fn read(&mut self, stamp_s: f64, w: &[[f64; FIBRES]; SECTIONS]) -> Status {
        if !stamp_s.is_finite() {
            return Status::NOT_FINITE;
        }
        let now = self.poses.now().time_s;
        // a stamp from the future is a clock that is off: the reading is of now
        let at = if stamp_s < now { stamp_s } else { now };
        if stamp_s <= self.used_s || at < self.state.time_s {
            return Status::LATE;
        }
        let Some(pose) = self.poses.at(at) else {
            return Status::LATE;
        };
        // a single wild stamp must not make all that follow late
        self.used_s = if stamp_s < now + AHEAD_S {
            stamp_s
        } else {
            now
        };
        let elapsed = at - self.state.time_s;
        let mut next = self.carried(&self.state, at, &pose);
        self.drift.pass(elapsed);
        let status = self.fold(&mut next, w);
        let finite =
            next.along + next.variance + next.force.x + next.force.y + next.off.x + next.off.y;
        let mut tied = 0.0;
        for t in &next.tied {
            tied += t;
        }
        if (finite + tied).is_finite() {
            self.state = next;
            self.keep();
            status
        } else {
            Status::NOT_FINITE
        }
    }

    /// A state at a later time and another pose.
    #[inline]
    fn carried(&self, state: &State, time_s: f64, pose: &Rigid) -> State {
        let mut next = *state;
        let before = next.pose.rotation.column(2).into_owned();
        next.carry(pose);
        self.turned(&mut next, &before);
        next.lean(self.clearance_mm);
        next.variance += self.drift.per_second * (time_s - next.time_s);
        next.time_s = time_s;
        next
    }

    /// Keeps states to go back to.
    #[inline]
    fn keep(&mut self) {
        for i in 0..2 {
            self.since[i] += 1;
            if self.since[i] >= KEPT_EVERY[i] {
                self.since[i] = 0;
                self.earlier[i] = [
                    Earlier {
                        state: self.state,
                        drift: self.drift,
                    },
                    self.earlier[i][0],
                ];
            }
        }
    }

    /// Back to a state from before a fault showed, brought to where the tool is now: the depth of then is as good as
    /// what was moved is known.
    fn back(&mut self, next: &mut State, slowly: bool) {
        let Earlier { state, drift } = self.earlier[usize::from(slowly)][1];
        let elapsed = next.time_s - state.time_s;
        self.drift = drift;
        self.drift.pass(elapsed);
        let (force, force_s) = (next.force, next.force_s);
        *next = self.carried(&state, next.time_s, &next.pose);
        if state.force_s < force_s && next.gives == 0.0 {
            next.force = force;
        }
        for (i, kept) in self.earlier.iter_mut().enumerate() {
            if i == usize::from(slowly) || slowly {
                *kept = [Earlier { state, drift }; 2];
            }
        }
        self.since = [0; 2];
        self.paced = state;
    }

    /// What a turn of the shaft makes of not knowing the clearance.
    #[inline]
    fn turned(&self, state: &mut State, before: &Vector3<f64>) {
        let size = state.force.norm();
        if size > 0.0 {
            let way = state.force / size;
            let axes = &state.pose.rotation;
            let turn = axes.column(2) - before;
            let along = axes.column(0).dot(&turn) * way.x + axes.column(1).dot(&turn) * way.y;
            // l = (S - E)·z and E = S + R (u, -l): more clearance puts the hole further along the force
            state.tied[CLEARANCE] -= along * self.unknowns.clearance_mm;
        }
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

    /// Mean square pace at which the force strays from what the motion of the tool makes of it, (mN/s)².
    #[must_use]
    pub fn pace(&self) -> f64 {
        self.pace
    }

    /// Process noise of the depth at present, mm²/s.
    #[must_use]
    pub fn per_second_mm2(&self) -> f64 {
        self.drift.per_second
    }
}
