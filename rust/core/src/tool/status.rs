//! What filters say: depth and tip, what a step did, as flags, and how often; what its reading was like.

use core::ops::BitOr;

/// A set of gratings: bit `3 section + fibre`.
pub type Set = u16;

/// Where depth and tip are.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Told {
    /// s.
    pub time_s: f64,
    /// Insertion depth, the paper's `l`: from the hole to the unbent tip, along the unbent axis, mm.
    pub depth_mm: f64,
    /// Length of shaft beyond the hole, mm: shorter than the depth by what the bend takes.
    pub arc_mm: f64,
    /// The tip in the base frame, mm.
    pub tip_mm: [f64; 3],
    /// Covariance of depth and tip, mm².
    pub covariance: [[f64; 4]; 4],
    /// Force of the hole across the shaft, tool frame, mN.
    pub force_mn: [f64; 2],
    /// Variance of each of its components, mN².
    pub force_variance: f64,
}

/// What a step did with what it was given; several may hold. No flag at all is a filter that has not stepped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(transparent)]
pub struct Status(pub u8);

impl Status {
    /// A measurement was used. Without this the step only predicted.
    pub const UPDATED: Self = Self(1);
    /// There was no measurement.
    pub const MISSING: Self = Self(1 << 1);
    /// The measurement is older than the state, or has been used already.
    pub const LATE: Self = Self(1 << 2);
    /// The measurement holds a number that is not finite, or would have made the estimate so.
    pub const NOT_FINITE: Self = Self(1 << 3);
    /// There is no force that would tell the depth.
    pub const NO_FORCE: Self = Self(1 << 4);
    /// The pose is not finite, or its rotation no turn: the state stood still, and its covariance does not know how far
    /// it is off.
    pub const NO_MOTION: Self = Self(1 << 5);
    /// The step's time is not finite, before the state's or 1e6 s after it: nothing was done. A new clock: start anew.
    pub const CLOCK: Self = Self(1 << 6);
    /// The measurement contradicts the state or itself, and was not used.
    pub const GATED: Self = Self(1 << 7);

    /// Whether all flags of `other` are set.
    #[must_use]
    pub fn has(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

impl BitOr for Status {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// How often each flag was set. Counters wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct Counts {
    /// Steps asked for.
    pub steps: u64,
    /// [`Status::UPDATED`].
    pub updated: u64,
    /// [`Status::MISSING`].
    pub missing: u64,
    /// [`Status::LATE`].
    pub late: u64,
    /// [`Status::NOT_FINITE`].
    pub not_finite: u64,
    /// [`Status::NO_FORCE`].
    pub no_force: u64,
    /// [`Status::NO_MOTION`].
    pub no_motion: u64,
    /// [`Status::CLOCK`].
    pub clock: u64,
    /// [`Status::GATED`].
    pub gated: u64,
}

impl Counts {
    /// Counts a step.
    #[inline]
    pub fn add(&mut self, status: Status) {
        self.steps = self.steps.wrapping_add(1);
        if status == Status::UPDATED {
            self.updated = self.updated.wrapping_add(1);
            return;
        }
        for (count, flag) in [
            (&mut self.updated, Status::UPDATED),
            (&mut self.missing, Status::MISSING),
            (&mut self.late, Status::LATE),
            (&mut self.not_finite, Status::NOT_FINITE),
            (&mut self.no_force, Status::NO_FORCE),
            (&mut self.no_motion, Status::NO_MOTION),
            (&mut self.clock, Status::CLOCK),
            (&mut self.gated, Status::GATED),
        ] {
            *count = count.wrapping_add(u64::from(status.has(flag)));
        }
    }
}

/// Normalised innovations squared (NIS). Their mean is the degrees of freedom where the noise is right, more where
/// the filter is overconfident, less where it is too careful.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Consistency {
    /// Of the last update.
    pub last: f64,
    /// Degrees of freedom of the last update; zero where the last step only predicted.
    pub last_degrees: u64,
    /// Sum over all updates.
    pub sum: f64,
    /// Sum of their degrees of freedom.
    pub degrees: u64,
    /// Updates.
    pub count: u64,
}

impl Consistency {
    /// A step that only predicts.
    #[inline]
    pub fn rest(&mut self) {
        self.last = 0.0;
        self.last_degrees = 0;
    }

    /// An update of one degree of freedom.
    #[inline]
    pub fn add(&mut self, squared: f64) {
        self.last = squared;
        self.last_degrees = 1;
        self.sum += squared;
        self.degrees = self.degrees.wrapping_add(1);
        self.count = self.count.wrapping_add(1);
    }

    /// Sum over its expectation: 1 where the noise is right; zero before the first update.
    #[must_use]
    pub fn ratio(&self) -> f64 {
        if self.degrees == 0 {
            0.0
        } else {
            self.sum / self.degrees as f64
        }
    }
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
