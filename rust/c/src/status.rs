//! What the steps of a filter did, as flags and as counts.

use sherkit_core::tool::filter::{Consistency, Counts};

/// What a step did with what it was given: a sum of these flags. Without SHERKIT_STATUS_UPDATED it only predicted.
pub type sherkit_status = u32;

/// A measurement was used.
pub const SHERKIT_STATUS_UPDATED: u32 = 1;
/// There was no measurement.
pub const SHERKIT_STATUS_MISSING: u32 = 2;
/// The measurement is older than the state, or has been used already.
pub const SHERKIT_STATUS_LATE: u32 = 4;
/// The measurement holds a number that is not finite, or would have made the estimate so.
pub const SHERKIT_STATUS_NOT_FINITE: u32 = 8;
/// There is no force that would tell the depth.
pub const SHERKIT_STATUS_NO_FORCE: u32 = 16;
/// The pose is not finite, or its rotation no turn: the state stood still, and its covariance does not know how far it is off.
pub const SHERKIT_STATUS_NO_MOTION: u32 = 32;
/// The step's time is not finite or lies before the state's: nothing was done at all.
pub const SHERKIT_STATUS_CLOCK: u32 = 64;
/// The measurement contradicts the state or itself, and was not used.
pub const SHERKIT_STATUS_GATED: u32 = 128;

const _: () = {
    use sherkit_core::tool::filter::Status;
    assert!(SHERKIT_STATUS_UPDATED == Status::UPDATED.0 as u32);
    assert!(SHERKIT_STATUS_MISSING == Status::MISSING.0 as u32);
    assert!(SHERKIT_STATUS_LATE == Status::LATE.0 as u32);
    assert!(SHERKIT_STATUS_NOT_FINITE == Status::NOT_FINITE.0 as u32);
    assert!(SHERKIT_STATUS_NO_FORCE == Status::NO_FORCE.0 as u32);
    assert!(SHERKIT_STATUS_NO_MOTION == Status::NO_MOTION.0 as u32);
    assert!(SHERKIT_STATUS_CLOCK == Status::CLOCK.0 as u32);
    assert!(SHERKIT_STATUS_GATED == Status::GATED.0 as u32);
};

/// How often what happened, and the innovation statistics (NIS). nis_sum over nis_degrees is 1 where the noise is
/// right, more where the filter is overconfident.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sherkit_statistics {
    /// Steps asked for.
    pub steps: u64,
    /// Steps that used a measurement.
    pub updated: u64,
    /// Steps without a measurement.
    pub missing: u64,
    /// Measurements that came late.
    pub late: u64,
    /// Measurements that were not finite.
    pub not_finite: u64,
    /// Measurements without force.
    pub no_force: u64,
    /// Motions that were not finite.
    pub no_motion: u64,
    /// Steps refused for their time.
    pub clock: u64,
    /// Measurements that were refused.
    pub gated: u64,
    /// Updates that the sum is over.
    pub nis_count: u64,
    /// Their degrees of freedom.
    pub nis_degrees: u64,
    /// Sum of their normalised innovations squared.
    pub nis_sum: f64,
}

impl sherkit_statistics {
    /// Of counts and innovations.
    pub fn from(counts: &Counts, nis: &Consistency) -> Self {
        Self {
            steps: counts.steps,
            updated: counts.updated,
            missing: counts.missing,
            late: counts.late,
            not_finite: counts.not_finite,
            no_force: counts.no_force,
            no_motion: counts.no_motion,
            clock: counts.clock,
            gated: counts.gated,
            nis_count: nis.count,
            nis_degrees: nis.degrees,
            nis_sum: nis.sum,
        }
    }
}
