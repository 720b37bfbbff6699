//! Depth and tip in one state, with what they know of each other.
//!
//! Eqs. 8 and 14 of the tool paper share force, depth and robot velocity; kept apart, the tip filter takes
//! the depth filter's estimate for a fresh measurement at every step, and its covariance does not hold. Here Eq. 9 is
//! linear about the predicted depth, so that a depth that is off moves the tip and a tip that is off moves the
//! depth, and the measured depth and force keep the covariance that the sensing gives them.

use super::filter::Filter;
use super::measurement::{Content, Measurement};
use super::noise::Noise;
use super::status::Status;
use super::tip::left_over;
use super::track::Track;
use crate::Result;
use crate::rigid::Rigid;
use crate::tool::beam::Beam;
use nalgebra::Vector3;

/// The joint filter: depth, then the tip in the base frame, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthTipFilter {
    track: Track<4>,
    noise: Noise,
    beam: Beam,
}

impl DepthTipFilter {
    /// Starts at a depth (mm) with the unbent tip where `tool` (tool to base frame) has it; variances (mm²) of the
    /// depth and of each axis of the tip.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for numbers that mean nothing.
    pub fn new(
        beam: Beam,
        depth_mm: f64,
        tool: &Rigid,
        variances: [f64; 2],
        time_s: f64,
        noise: Noise,
    ) -> Result<Self> {
        noise.check()?;
        let t = &tool.translation;
        let [d, p] = variances;
        let filter = Filter::new([depth_mm, t.x, t.y, t.z], [d, p, p, p]);
        Ok(Self {
            track: Track::new(filter, time_s)?,
            noise,
            beam,
        })
    }

    /// Moves the estimate to `time_s` with the velocity of the unbent tip in the base frame since the last step,
    /// mm/s, then folds the measurement in, given the tool's pose now. Without force enough to tell the depth the
    /// force is still used, and the status says both.
    #[inline]
    pub fn step(
        &mut self,
        time_s: f64,
        velocity_mm_s: &Vector3<f64>,
        tool: &Rigid,
        measurement: Option<&Measurement>,
    ) -> Status {
        let Some(elapsed) = self.track.elapsed(time_s) else {
            return Status::CLOCK;
        };
        let admitted = self.track.admit(measurement);
        let axes = tool.rotation.data.0;
        let shaft = axes[2];
        let v = [velocity_mm_s.x, velocity_mm_s.y, velocity_mm_s.z];
        let inwards = v[0] * shaft[0] + v[1] * shaft[1] + v[2] * shaft[2];
        let velocity = [inwards, v[0], v[1], v[2]];
        let status = self
            .track
            .predict(elapsed, &velocity, &self.process(elapsed, &shaft));
        let used = match admitted {
            Err(why) => why,
            Ok((m, content)) => self.fold(m, content, tool, &axes),
        };
        self.track.finish(time_s, status | used)
    }

    /// Process noise: independent but for the part that is one velocity's error along the shaft.
    #[inline]
    fn process(&self, elapsed: f64, shaft: &[f64; 3]) -> [[f64; 4]; 4] {
        let [d, p] = self.noise.process(elapsed);
        // beneath both, so that the whole stays semidefinite
        let mut shared = self.noise.shared * d.min(p);
        if !(shaft[0] + shaft[1] + shaft[2]).is_finite() {
            shared = 0.0;
        }
        let [x, y, z] = if shared == 0.0 {
            [0.0; 3]
        } else {
            shaft.map(|s| s * shared)
        };
        [
            [d, x, y, z],
            [x, p, 0.0, 0.0],
            [y, 0.0, p, 0.0],
            [z, 0.0, 0.0, p],
        ]
    }

    #[inline]
    fn fold(
        &mut self,
        m: &Measurement,
        content: Content,
        tool: &Rigid,
        axes: &[[f64; 3]; 3],
    ) -> Status {
        let [depth, x, y, z] = self.track.filter().mean;
        let c = self.beam.compliance(depth);
        let deflection = m.force.map(|f| f * c.value);
        let [across_x, across_y, along] = left_over(deflection, tool, axes, [x, y, z]);
        let [[a, b], [d, e]] = self.noise.of_deflection(m, &c);
        let [ax, ay, az] = *axes;
        // what is read as deflection grows with the depth taken for it
        let by_depth = m.force.map(|f| -f * c.by_depth);
        let across = [
            [by_depth[0], ax[0], ax[1], ax[2]],
            [by_depth[1], ay[0], ay[1], ay[2]],
            [0.0, az[0], az[1], az[2]],
        ];
        if content == Content::ForceAlone {
            let r = [[a, b, 0.0], [d, e, 0.0], [0.0; 3]];
            let innovation = [across_x, across_y, along];
            return Status::NO_FORCE | self.track.correct(m.time_s, &across, &r, &innovation);
        }
        let [p, q] = self.noise.of_both(m, &c);
        let h = [[1.0, 0.0, 0.0, 0.0], across[0], across[1], across[2]];
        let r = [
            [self.noise.of_depth(m), p, q, 0.0],
            [p, a, b, 0.0],
            [q, d, e, 0.0],
            [0.0; 4],
        ];
        let innovation = [m.depth - depth, across_x, across_y, along];
        self.track.correct(m.time_s, &h, &r, &innovation)
    }

    /// Depth, mm.
    #[must_use]
    pub fn depth_mm(&self) -> f64 {
        self.track.filter().mean[0]
    }

    /// The tip in the base frame, mm.
    #[must_use]
    pub fn tip(&self) -> Vector3<f64> {
        let [_, x, y, z] = self.track.filter().mean;
        Vector3::new(x, y, z)
    }

    /// Time, statistics, last step. The state is depth, then tip.
    #[must_use]
    pub fn track(&self) -> &Track<4> {
        &self.track
    }
}
