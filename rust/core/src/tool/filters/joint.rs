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
use super::tip::{exact_along, left_over};
use super::track::Track;
use crate::Result;
use crate::numbers::rigid::Rigid;
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
        let (noise, beam) = (&self.noise, &self.beam);
        let shaft = tool.rotation.data.0[2];
        let motion = |elapsed| {
            let [x, y, z] = (*velocity_mm_s).into();
            let inwards = x * shaft[0] + y * shaft[1] + z * shaft[2];
            ([inwards, x, y, z], process(noise, elapsed, &shaft))
        };
        self.track
            .step(time_s, measurement, motion, |track, m, content| {
                fold(track, noise, beam, m, content, tool)
            })
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

/// Process noise: independent but for the part that is one velocity's error along the shaft.
#[inline]
fn process(noise: &Noise, elapsed: f64, shaft: &[f64; 3]) -> [[f64; 4]; 4] {
    let [d, p] = noise.process(elapsed);
    // beneath both, so that the whole stays semidefinite
    let mut shared = noise.shared * d.min(p);
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

/// Folds a measurement in, linear about the predicted depth.
#[inline]
fn fold(
    track: &mut Track<4>,
    noise: &Noise,
    beam: &Beam,
    m: &Measurement,
    content: Content,
    tool: &Rigid,
) -> Status {
    let [depth, x, y, z] = track.filter().mean;
    let bend = beam.compliance(depth);
    let left = left_over(m, &bend, tool, [x, y, z]);
    let across = noise.of_deflection(m, &bend);
    // what is read as deflection grows with the depth taken for it
    let by_depth = [
        -m.force[0] * bend.by_depth,
        -m.force[1] * bend.by_depth,
        0.0,
    ];
    let axes = tool.rotation.data.0;
    let row = |k: usize| [by_depth[k], axes[k][0], axes[k][1], axes[k][2]];
    let h = [row(0), row(1), row(2)];
    if content == Content::ForceAlone {
        return Status::NO_FORCE | track.correct(m.time_s, &h, &exact_along(across), &left);
    }
    let h = [[1.0, 0.0, 0.0, 0.0], h[0], h[1], h[2]];
    let [[a, b], [c, d]] = across;
    let [p, q] = noise.of_both(m, &bend);
    let r = [
        [noise.of_depth(m), p, q, 0.0],
        [p, a, b, 0.0],
        [q, c, d, 0.0],
        [0.0; 4],
    ];
    let innovation = [m.depth - depth, left[0], left[1], left[2]];
    track.correct(m.time_s, &h, &r, &innovation)
}
