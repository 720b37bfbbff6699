//! What the three filters have in common: status, noise, statistics.

use crate::result::{SHERKIT_INVALID, sherkit_result};
use sherkit_core::kalman::noise::Variances;
use sherkit_core::kalman::track::Track;
use sherkit_core::kalman::{Noise, Trust};

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
/// The motion is not finite: the state stood still, and its covariance does not know how far it is off.
pub const SHERKIT_STATUS_NO_MOTION: u32 = 32;
/// The step's time is not finite or lies before the state's: nothing was done at all.
pub const SHERKIT_STATUS_CLOCK: u32 = 64;

const _: () = {
    use sherkit_core::kalman::Status;
    assert!(SHERKIT_STATUS_UPDATED == Status::UPDATED.0 as u32);
    assert!(SHERKIT_STATUS_MISSING == Status::MISSING.0 as u32);
    assert!(SHERKIT_STATUS_LATE == Status::LATE.0 as u32);
    assert!(SHERKIT_STATUS_NOT_FINITE == Status::NOT_FINITE.0 as u32);
    assert!(SHERKIT_STATUS_NO_FORCE == Status::NO_FORCE.0 as u32);
    assert!(SHERKIT_STATUS_NO_MOTION == Status::NO_MOTION.0 as u32);
    assert!(SHERKIT_STATUS_CLOCK == Status::CLOCK.0 as u32);
};

/// Measurement noise switched at a force, as in the paper.
pub const SHERKIT_NOISE_SWITCHED: u32 = 0;
/// The same, with the variances across the shaft those of the force, mN^2.
pub const SHERKIT_NOISE_SWITCHED_OF_FORCE: u32 = 1;
/// Measurement noise from the measurement's own covariance.
pub const SHERKIT_NOISE_PROPAGATED: u32 = 2;

/// What a filter trusts. Pairs are depth, then across the shaft (measurements) or each axis of the tip (process); mm^2.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sherkit_noise {
    /// One of the SHERKIT_NOISE kinds.
    pub kind: u32,
    /// Force at which it is switched, mN. Not read where it is propagated.
    pub at_mn: f64,
    /// Variances below that force. Not read where it is propagated.
    pub below: [f64; 2],
    /// Variances from it on; where it is propagated, what is added for what the models leave out.
    pub above: [f64; 2],
    /// Process noise that each step adds, mm^2.
    pub per_step: [f64; 2],
    /// Process noise per time, mm^2/s.
    pub per_second: [f64; 2],
    /// Share, 0 to 1, of the process noise that depth and tip have in common along the shaft.
    pub shared: f64,
}

fn pair([depth, across]: [f64; 2]) -> Variances {
    Variances { depth, across }
}

impl sherkit_noise {
    fn of(noise: &Noise) -> Self {
        let (kind, at_mn, below, above) = match noise.trust {
            Trust::Switched {
                at_mn,
                below,
                above,
                of_force,
            } => (u32::from(of_force), at_mn, below, above),
            Trust::Propagated { floor } => (SHERKIT_NOISE_PROPAGATED, 0.0, floor, floor),
        };
        Self {
            kind,
            at_mn,
            below: [below.depth, below.across],
            above: [above.depth, above.across],
            per_step: noise.per_step,
            per_second: noise.per_second,
            shared: noise.shared,
        }
    }

    /// The core's noise.
    pub fn noise(&self) -> Result<Noise, sherkit_result> {
        let trust = match self.kind {
            SHERKIT_NOISE_SWITCHED | SHERKIT_NOISE_SWITCHED_OF_FORCE => Trust::Switched {
                at_mn: self.at_mn,
                below: pair(self.below),
                above: pair(self.above),
                of_force: self.kind == SHERKIT_NOISE_SWITCHED_OF_FORCE,
            },
            SHERKIT_NOISE_PROPAGATED => Trust::Propagated {
                floor: pair(self.above),
            },
            _ => return Err(SHERKIT_INVALID),
        };
        Ok(Noise {
            trust,
            per_step: self.per_step,
            per_second: self.per_second,
            shared: self.shared,
        })
    }
}

/// The noise of Ebrahimi et al. 2020, for steps of 200 Hz.
#[unsafe(no_mangle)]
pub extern "C" fn sherkit_noise_ebrahimi_2020() -> sherkit_noise {
    sherkit_noise::of(&Noise::ebrahimi_2020())
}

/// Measurement noise from the sensing; process noise per time, and what the models leave out, of depth and tip.
#[unsafe(no_mangle)]
pub extern "C" fn sherkit_noise_propagated(
    depth_per_second: f64,
    tip_per_second: f64,
    depth_floor: f64,
    across_floor: f64,
) -> sherkit_noise {
    let floor = pair([depth_floor, across_floor]);
    sherkit_noise::of(&Noise::propagated(
        [depth_per_second, tip_per_second],
        floor,
    ))
}

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
    /// Updates that the sum is over.
    pub nis_count: u64,
    /// Their degrees of freedom.
    pub nis_degrees: u64,
    /// Sum of their normalised innovations squared.
    pub nis_sum: f64,
}

impl sherkit_statistics {
    /// Those of a state.
    pub fn of<const N: usize>(track: &Track<N>) -> Self {
        let (counts, nis) = (track.counts(), track.consistency());
        Self {
            steps: counts.steps,
            updated: counts.updated,
            missing: counts.missing,
            late: counts.late,
            not_finite: counts.not_finite,
            no_force: counts.no_force,
            no_motion: counts.no_motion,
            clock: counts.clock,
            nis_count: nis.count,
            nis_degrees: nis.degrees,
            nis_sum: nis.sum,
        }
    }
}

/// Degrees of freedom of the last update, of which there are at most four.
pub fn degrees<const N: usize>(track: &Track<N>) -> u32 {
    u32::try_from(track.consistency().last_degrees).unwrap_or(u32::MAX)
}
