//! The tip from the robot's velocity and the bending that the force tells (Eqs. 10 to 14 of the tool paper).
//!
//! Eq. 13 measures in units of force, `F + Γ Rᵀ S = Γ Rᵀ P`, with `α_z` any number but zero. Multiplied by `Γ⁻¹`
//! this is `δ + Rᵀ S = Rᵀ P`: the same filter, with noise in mm², no free `α_z`, and no `α` that grows without
//! bound where the sclera nears the clamp. Its third line, no deflection along the shaft, is exact: the noise has a
//! zero there.

use super::filter::Filter;
use super::measurement::Measurement;
use super::noise::Noise;
use super::status::Status;
use super::track::Track;
use crate::Result;
use crate::numbers::rigid::Rigid;
use crate::tool::beam::{Beam, Compliance};
use nalgebra::Vector3;

/// The tip filter: three numbers, mm, base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TipFilter {
    track: Track<3>,
    noise: Noise,
    beam: Beam,
}

/// What the measured force bends beyond a tip, in the tool frame, mm: there is no deflection along the shaft.
#[inline]
pub(super) fn left_over(
    m: &Measurement,
    bend: &Compliance,
    tool: &Rigid,
    tip: [f64; 3],
) -> [f64; 3] {
    let t = &tool.translation;
    let away = [tip[0] - t.x, tip[1] - t.y, tip[2] - t.z];
    let [x, y, z] = tool
        .rotation
        .data
        .0
        .map(|a| a[0] * away[0] + a[1] * away[1] + a[2] * away[2]);
    [m.force[0] * bend.value - x, m.force[1] * bend.value - y, -z]
}

/// Noise of a deflection whose part along the shaft, none, is exact.
#[inline]
pub(super) fn exact_along([[a, b], [c, d]]: [[f64; 2]; 2]) -> [[f64; 3]; 3] {
    [[a, b, 0.0], [c, d, 0.0], [0.0; 3]]
}

impl TipFilter {
    /// Starts with the unbent tip where `tool` (tool to base frame) has it, with a variance per axis (mm²).
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for numbers that mean nothing.
    pub fn new(beam: Beam, tool: &Rigid, variance: f64, time_s: f64, noise: Noise) -> Result<Self> {
        noise.check()?;
        let t = &tool.translation;
        Ok(Self {
            track: Track::new(Filter::new([t.x, t.y, t.z], [variance; 3]), time_s)?,
            noise,
            beam,
        })
    }

    /// Moves the estimate to `time_s` with the velocity of the unbent tip in the base frame since the last step,
    /// mm/s, then folds the measured force in, given the tool's pose now and the depth (mm) with its variance (mm²),
    /// as the depth filter has them. See [`Status`] for what may be refused; without depth or pose there is
    /// nothing to fold in, and the status is [`Status::NOT_FINITE`].
    #[inline]
    pub fn step(
        &mut self,
        time_s: f64,
        velocity_mm_s: &Vector3<f64>,
        tool: &Rigid,
        depth: (f64, f64),
        measurement: Option<&Measurement>,
    ) -> Status {
        let (noise, beam) = (&self.noise, &self.beam);
        let motion = |elapsed| {
            let q = noise.process(elapsed)[1];
            let process = [[q, 0.0, 0.0], [0.0, q, 0.0], [0.0, 0.0, q]];
            ((*velocity_mm_s).into(), process)
        };
        self.track.step(time_s, measurement, motion, |track, m, _| {
            let axes = tool.rotation.data.0;
            let bend = beam.compliance(depth.0);
            let innovation = left_over(m, &bend, tool, track.filter().mean);
            let r = exact_along(noise.of_tip(m, beam, depth.0, depth.1));
            track.correct(m.time_s, &axes, &r, &innovation)
        })
    }

    /// The tip in the base frame, mm.
    #[must_use]
    pub fn tip(&self) -> Vector3<f64> {
        Vector3::from(self.track.filter().mean)
    }

    /// Time, statistics, last step.
    #[must_use]
    pub fn track(&self) -> &Track<3> {
        &self.track
    }
}
