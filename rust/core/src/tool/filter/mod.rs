//! Depth and tip from wavelengths and poses, with a deviation that is true: what a control loop runs on a calibrated tool.
//!
//! **States**: depth, clearance of the hole, what it gives way, the gratings' turn, four moments of no force, the bench's zero.
//! **Considered** beside them: three of the bench, in the same covariance ([`state`]); lag, crept references and a pace of the
//! edge are doubts that the run itself tells ([`offsets`], [`edge`]). **Measured**: the depth by two moments ([`moments`],
//! [`reading`]), the edge of the hole where the motion alone has it ([`edge`]), moments at rest ([`offsets`]), the tip's force
//! by section III ([`tip`]): all by one Schmidt step. **Guards**: means of sections that accuse gratings ([`judging`],
//! [`slips`]), and what only makes a sentence: a robot that is late, a hole that goes along ([`along`]). [`told`] says where
//! depth and tip are. Beside it stands the paper's own filter, [`super::paper`].
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
mod state;
mod tip;
mod told;
mod watch;

pub use super::status::{Consistency, Counts, Look, Set, Status, Told};
pub use super::trusted::{Doubt, Trusted};
pub use moments::Shifts;

use super::poses::{Posed, Poses};
use super::rod::Rod;
use crate::numbers::math::sqrt;
use crate::numbers::rigid::Rigid;
use crate::{Error, Result};
use nalgebra::{Matrix3, Vector2, Vector3};
use state::{BENCH, CLEARANCE, DEEPER, L, N, State};

/// A stamp further ahead of the present than this is a wild number and no clock, s; a step is no longer than the other.
const AHEAD_S: f64 = 0.3;
const LONGEST_S: f64 = 1e6;
/// No robot stands further away than this, mm; squares by which the columns of a turn may miss each other's product.
const FARTHEST_MM: f64 = 1e6;
const NO_TURN: f64 = 0.01;
/// What a hole gives way before that is felt, and its deviation, mm/mN: tissue is as soft as a fortieth of this per mN.
const GIVES: [f64; 2] = [0.005, 0.01];

/// Numbers that are learnt.
pub const LEARNT: usize = 13;

/// The filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolFilter {
    trusted: Trusted,
    shaft: Rod,
    gratings: moments::Gratings,
    poses: Poses,
    state: State,
    /// The last force that was read, and when.
    felt: Option<(f64, reading::Said)>,
    offsets: offsets::Offsets,
    drift: along::Drift,
    along: along::Along,
    edge: edge::Edge,
    tip: tip::Tip,
    watch: watch::Watch,
    used_s: f64,
    look: Look,
    counts: Counts,
    consistency: Consistency,
}

impl ToolFilter {
    /// Starts at a depth (mm) with a variance (mm²), with the tool at a pose (tool to base frame), at a time (s).
    ///
    /// # Errors
    /// [`Error::Invalid`] for numbers that mean nothing.
    pub fn new(
        t: &Trusted,
        depth_mm: f64,
        variance: f64,
        pose: &Rigid,
        time_s: f64,
    ) -> Result<Self> {
        t.check()?;
        let known = depth_mm.abs() < FARTHEST_MM && time_s.is_finite() && possible(pose);
        if !(known && variance >= 0.0 && variance.is_finite()) {
            return Err(Error::Invalid {
                what: "tool: the first depth, pose and time must be finite, its variance zero or more",
            });
        }
        let (d, gratings) = (&t.doubt, moments::Gratings::new(t));
        // until a rest tells them, moments of no force are known as well as gratings are as warm as on the bench
        let rest = d.reference_nm * d.reference_nm + offsets::APART_NM * offsets::APART_NM;
        let [one, two] = gratings.per_nm.map(|v| v * rest);
        let variances = [
            variance,
            d.clearance_mm * d.clearance_mm,
            GIVES[1] * GIVES[1],
            d.turn_rad * d.turn_rad,
            one,
            one,
            two,
            two,
            d.deeper_mm * d.deeper_mm,
        ];
        let (mut x, mut p) = ([0.0; N], [[0.0; N]; N]);
        x[..3].copy_from_slice(&[depth_mm, t.clearance_mm, GIVES[0]]);
        for (k, v) in variances.into_iter().enumerate() {
            p[k][k] = v;
        }
        for i in 0..3 {
            for j in 0..3 {
                p[BENCH + i][BENCH + j] = d.depth[(i, j)];
            }
        }
        // the bench's zero is learnt from a hole that stays, but no hole stays so well that it is known better than before
        p[BENCH][BENCH] += d.deeper_mm * d.deeper_mm;
        let start = Posed {
            time_s,
            pose: *pose,
        };
        Ok(Self {
            trusted: *t,
            shaft: t.rod,
            gratings,
            poses: Poses::new(start),
            state: State {
                time_s,
                pose: *pose,
                x,
                p,
                lasting: 0.0,
                aside: Vector2::zeros(),
                size: 0.0,
                way: Vector2::new(1.0, 0.0),
                short: 0.0,
                relief: [1.0; 2],
                touched: false,
                free: true,
                hole: pose.translation - pose.rotation.column(2) * depth_mm,
                beyond: 0.0,
                speed: Vector3::zeros(),
                speeds: Matrix3::zeros(),
                slide: 0.0,
                sideways: Vector2::zeros(),
                slid: 0.0,
            },
            felt: None,
            offsets: offsets::Offsets::default(),
            drift: along::Drift::new(time_s, t.per_second_mm2),
            along: along::Along::default(),
            edge: edge::Edge::default(),
            tip: tip::Tip::default(),
            watch: watch::Watch::new(gratings.noise),
            used_s: f64::NEG_INFINITY,
            look: Look::default(),
            counts: Counts::default(),
            consistency: Consistency::default(),
        })
    }

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

    /// Takes a reading into the state.
    #[inline]
    fn take(&mut self, said: &reading::Said) -> Status {
        let (s, mut status) = (&mut self.state, Status::UPDATED);
        let mut moved = 0.0;
        if let Some((mm, seen)) = &said.off {
            let before = s.x[L] + s.x[DEEPER];
            if !s.take(seen, *mm) {
                return Status::NOT_FINITE;
            }
            let gain = (seen.with[L] / seen.total).clamp(0.0, 1.0);
            s.lasting += gain * (sqrt(said.lasting) - s.lasting);
            moved = s.x[L] + s.x[DEEPER] - before;
            self.along.add(s.time_s, s.slid, moved);
            s.slid = 0.0;
            let white = seen.total - (reading::LASTS - 1.0) * said.lasting;
            self.consistency.add(mm * mm / white);
            let slowest = self.trusted.per_second_mm2;
            self.drift.add(*mm, seen.total, s.time_s, slowest);
        } else {
            status = status | Status::NO_FORCE;
        }
        if !(said.noise > 0.0 && said.size.is_finite()) {
            s.lean(&self.shaft);
            return status;
        }
        s.size = (said.size + said.by_depth * (moved - said.ahead)).max(0.0);
        (s.way, s.short, s.relief) = (said.way, said.short, said.relief);
        self.felt = Some((
            s.time_s,
            reading::Said {
                size: s.size,
                ..*said
            },
        ));
        s.touched |= said.off.is_some();
        s.free = !said.leans;
        if said.leans && s.touched {
            let (gives, tells) = (s.gives(&self.shaft), said.off.is_some());
            self.edge.felt(s, said.noise, gives, tells);
            s.aside = s.way * (s.x[CLEARANCE] + gives * s.size);
        } else {
            let far = sqrt(s.aside.norm_squared());
            if far > s.x[CLEARANCE] {
                s.aside *= s.x[CLEARANCE] / far;
            }
            (self.edge.since, self.edge.strays) = (None, None);
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

    /// What was learnt: process noise of the depth (mm²/s), mean square pace at which the edge of the hole strays from where
    /// the motion of the tool has it ((mm/s)²), clearance of the hole (mm), what it gives way (mm/mN), the gratings' turn
    /// (rad), how much deeper they count (mm), the moments of no force (4, mN·mm), the share of its slides by which the shaft
    /// takes the hole along, how much fibres lag behind their bends, over the bend, and by how much the robot's rows are later
    /// than the gratings (s). The share and what is late are zero where that may be chance.
    #[must_use]
    pub fn learnt(&self) -> [f64; LEARNT] {
        let [_, c, g, t, a, b, d, e, deeper, ..] = self.state.x;
        let (drift, pace) = (self.drift.per_second, self.edge.mean);
        let (along, lags, late) = (
            self.along.share(),
            sqrt(self.offsets.lag),
            self.edge.late_s(),
        );
        [drift, pace, c, g, t, deeper, a, b, d, e, along, lags, late]
    }
}

/// Whether a robot can stand so; false for NaN.
#[inline]
fn possible(pose: &Rigid) -> bool {
    let mut possible = true;
    for x in pose.translation.as_slice() {
        possible &= x.abs() < FARTHEST_MM;
    }
    // what is left of a pose that was lost on its way is no turn
    let (r, mut off) = (&pose.rotation, 0.0);
    for k in 0..3 {
        let third = r.column((k + 1) % 3).cross(&r.column((k + 2) % 3)) - r.column(k);
        off += third.norm_squared();
    }
    possible && off < NO_TURN
}
