//! Insertion depth from the robot's velocity along the shaft and the fibres (Eq. 8 of the tool paper).

use super::filter::Filter;
use super::measurement::{Content, Measurement};
use super::noise::Noise;
use super::status::Status;
use super::track::Track;
use crate::Result;

/// The depth filter: one number, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthFilter {
    track: Track<1>,
    noise: Noise,
}

impl DepthFilter {
    /// Starts at a depth (mm) with a variance (mm²) at a time (s).
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for numbers that mean nothing.
    pub fn new(depth_mm: f64, variance: f64, time_s: f64, noise: Noise) -> Result<Self> {
        noise.check()?;
        Ok(Self {
            track: Track::new(Filter::new([depth_mm], [variance]), time_s)?,
            noise,
        })
    }

    /// Moves the estimate to `time_s` with the velocity of the tip along the tool's z axis since the last step,
    /// mm/s, then folds the measurement in. See [`Status`] for what may be refused.
    #[inline]
    pub fn step(
        &mut self,
        time_s: f64,
        velocity_mm_s: f64,
        measurement: Option<&Measurement>,
    ) -> Status {
        let noise = &self.noise;
        let motion = |elapsed| ([velocity_mm_s], [[noise.process(elapsed)[0]]]);
        self.track
            .step(time_s, measurement, motion, |track, m, content| {
                if content == Content::ForceAlone {
                    return Status::NO_FORCE;
                }
                let innovation = m.depth - track.filter().mean[0];
                track.correct(m.time_s, &[[1.0]], &[[noise.of_depth(m)]], &[innovation])
            })
    }

    /// Depth, mm.
    #[must_use]
    pub fn depth_mm(&self) -> f64 {
        self.track.filter().mean[0]
    }

    /// Its variance, mm².
    #[must_use]
    pub fn variance(&self) -> f64 {
        self.track.filter().variances()[0]
    }

    /// Time, statistics, last step.
    #[must_use]
    pub fn track(&self) -> &Track<1> {
        &self.track
    }
}
