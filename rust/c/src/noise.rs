//! What a filter trusts.

use crate::result::{SHERKIT_INVALID, sherkit_result};
use sherkit_core::tool::filters::noise::Variances;
use sherkit_core::tool::filters::{Noise, Trust};

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
