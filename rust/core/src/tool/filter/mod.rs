//! Depth and tip from wavelengths and poses, with a deviation that is true: what a control loop runs on a calibrated
//! tool.
//!
//! [`state`] carries the hole from pose to pose, [`moments`] says what the fibres feel, [`reading`] what that makes of
//! force and depth, [`evidence`] which gratings not to believe, [`creep`] how the references go, [`pace`] and [`drift`] how
//! the hole strays, [`told`] where depth and tip are. Beside it stands the paper's own filter, [`super::paper`].
//!
//! A reading belongs to its stamp. The state stands at the last stamp and goes on to the present by the pose alone, so
//! that a late reading costs what any other does ([`poses`]).

// a comparison that is false for NaN is meant so
#![allow(clippy::neg_cmp_op_on_partial_ord)]

mod creep;
mod drift;
mod evidence;
mod known;
mod moments;
mod pace;
mod poses;
mod reading;
mod smoother;
mod state;
mod status;
mod told;

pub use known::{Doubt, Tied, Trusted, UNKNOWNS};
pub use moments::{Set, Shifts};
pub use smoother::{Node, Smoothed, smooth};
pub use status::{Consistency, Counts, Status};
pub use told::Told;

use super::rod::{Rod, Shaft};
use crate::numbers::math::sqrt;
use crate::numbers::rigid::Rigid;
use crate::{Error, Result};
use creep::Creep;
use drift::Drift;
use evidence::Evidence;
use known::OfDepth;
use moments::Gratings;
use nalgebra::Matrix2;
use pace::{Felt, Pace};
use poses::{Posed, Poses};
use reading::Said;
use state::{Known, State};

/// A stamp further ahead of the present than this is a wild number and no clock, s.
const AHEAD_S: f64 = 0.3;
/// A step is no longer than this, s, and no robot stands further away, mm.
const LONGEST_S: f64 = 1e6;
const FARTHEST_MM: f64 = 1e6;
/// What a hole gives way before that is felt, and its deviation, mm/mN: tissue is as soft as a fortieth of this per mN.
const GIVES: [f64; 2] = [0.005, 0.01];

/// What the last reading was like.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Look {
    /// Square of what the moments say across the force over its variance: about 1.
    pub misfit: f64,
    /// Gratings that were not believed.
    pub faulty: Set,
}

/// What happened, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Watch {
    look: Look,
    counts: Counts,
    consistency: Consistency,
}

/// Warmth, and what unlike fibres make of it.
///
/// Answers that nobody knows make moments in proportion to how much warmer it is than where the last rest told them: not a
/// random walk, one error that grows.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Warmth {
    now_nm: f64,
    rest_nm: f64,
    /// Variance of a moment's component by a squared nanometre, sections I and II.
    unit: [f64; 2],
}

/// The filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolFilter {
    rod: Rod,
    shaft: Shaft,
    distances_mm: [f64; 2],
    gratings: Gratings,
    /// Variance of a moment's component in whole sections.
    variances: [f64; 2],
    of_depth: OfDepth,
    unknown_force: f64,
    unknown_mean: f64,
    /// Factor of the covariance of length and stiffness.
    beam: Matrix2<f64>,
    floor_mm2: f64,
    per_stiffness: f64,
    poses: Poses,
    state: State,
    felt: Option<Felt>,
    free_for: u16,
    creep: Creep,
    warmth: Warmth,
    drift: Drift,
    pace: Pace,
    evidence: Evidence,
    used_s: f64,
    before: Known,
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

/// Factor `L` of a covariance of two numbers, with zeros where it is not positive.
fn factor(c: &Matrix2<f64>) -> Matrix2<f64> {
    let first = sqrt(c.m11.max(0.0));
    let below = if first > 0.0 { c.m21 / first } else { 0.0 };
    let second = sqrt((c.m22 - below * below).max(0.0));
    Matrix2::new(first, 0.0, below, second)
}

impl Warmth {
    /// A reading's warmth: the offsets' variances grow by what it adds.
    #[inline]
    fn pass(&mut self, nm: f64, known: &mut Known) {
        let before = self.now_nm - self.rest_nm;
        if nm.is_finite() {
            self.now_nm += 0.02 * (nm - self.now_nm);
        }
        let now = self.now_nm - self.rest_nm;
        let more = now * now - before * before;
        if more > 0.0 {
            for k in 0..4 {
                known.p[state::OFFSETS + k][state::OFFSETS + k] += more * self.unit[k / 2];
            }
        }
    }

    /// Offsets were learnt at this warmth.
    fn rest(&mut self, before: &Known, after: &Known) {
        let o = state::OFFSETS;
        if before.p[o][o] > 0.0 {
            let left = (after.p[o][o] / before.p[o][o]).min(1.0);
            self.rest_nm = self.now_nm + (self.rest_nm - self.now_nm) * left;
        }
    }
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
        let (c, d) = (&trusted.calibration, &trusted.doubt);
        let gratings = Gratings::new(trusted);
        let variances = [gratings.variance(0), gratings.variance(1)];
        let per_nm = variances.map(|v| v / gratings.noise.max(f64::MIN_POSITIVE));
        let unit = per_nm.map(|v| v * d.warmth * d.warmth);
        let [one, two] = per_nm.map(|v| sqrt(v) * d.reference_nm);
        let known = Known::new(
            [
                depth_mm,
                trusted.clearance_mm,
                GIVES[0],
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
            ],
            [
                sqrt(variance.max(0.0)),
                d.clearance_mm,
                GIVES[1],
                d.turn_rad,
                d.deeper_mm,
                one,
                one,
                two,
                two,
            ],
        );
        check_start(depth_mm, variance, pose, time_s)?;
        let state = State::start(time_s, pose, &known);
        Ok(Self {
            rod: trusted.rod,
            shaft: trusted.rod.shaft(),
            distances_mm: c.distances_mm,
            gratings,
            variances,
            of_depth: OfDepth::new(&d.depth),
            unknown_force: d.force,
            unknown_mean: d.mean,
            beam: factor(&d.beam),
            floor_mm2: 0.0,
            per_stiffness: 1.0 / trusted.rod.beam.stiffness(),
            poses: Poses::new(Posed {
                time_s,
                pose: *pose,
            }),
            state,
            felt: None,
            free_for: 0,
            creep: Creep::new(per_nm),
            warmth: Warmth {
                now_nm: 0.0,
                rest_nm: 0.0,
                unit,
            },
            drift: Drift::new(trusted.per_second_mm2),
            pace: Pace::new(&state),
            evidence: Evidence::new(trusted),
            used_s: f64::NEG_INFINITY,
            before: known,
            watch: Watch::default(),
        })
    }

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

fn check_start(depth_mm: f64, variance: f64, pose: &Rigid, time_s: f64) -> Result<()> {
    let known = depth_mm.abs() < FARTHEST_MM && time_s.is_finite() && possible(pose);
    if known && variance >= 0.0 && variance.is_finite() {
        Ok(())
    } else {
        Err(Error::Invalid {
            what: "tool: the first depth, pose and time must be finite, its variance zero or more",
        })
    }
}

impl Felt {
    fn of(said: &Said, time_s: f64, size: f64) -> Self {
        Self {
            time_s,
            way: said.way,
            size,
            noise: said.noise,
            by_moments: said.by_moments,
            by_depth: said.by_depth,
        }
    }
}
