//! Where the hole stands in the tool's frame and what is known of it, at the last stamp.

use super::unknowns::Tied;
use crate::numbers::rigid::Rigid;
use crate::tool::rod::Rod;
use nalgebra::{Vector2, Vector3};

/// The state at the last stamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct State {
    pub(super) time_s: f64,
    pub(super) pose: Rigid,
    /// Place of the hole in the tool's frame: off the axis where nothing pushes it, and `l`.
    pub(super) off: Vector2<f64>,
    pub(super) along: f64,
    /// What shaft and hole give way for a force, mm/mN; zero before the first touch.
    pub(super) gives: f64,
    /// Whether the last reading felt nothing of the hole, so that it may stand anywhere within its clearance.
    pub(super) free: bool,
    /// What was felt beyond what the hole pushes.
    pub(super) rest: Vector2<f64>,
    /// Noise of `l`, and how it hangs on the unknowns.
    pub(super) variance: f64,
    pub(super) tied: Tied,
    /// Force across the shaft, when it was read, the variance of its components by noise.
    pub(super) force: Vector2<f64>,
    pub(super) force_s: f64,
    pub(super) force_noise: f64,
    /// How force along and across itself hangs on the unknowns at a given depth, and along itself on the depth.
    pub(super) force_tied: [Tied; 2],
    pub(super) by_depth: f64,
}

impl State {
    /// Depth under this state's force.
    pub(super) fn depth(&self, rod: &Rod) -> f64 {
        depth_of(rod, self.along, self.force.norm())
    }

    /// Carries the hole, which stands still, into the frame of another pose.
    #[inline]
    pub(super) fn carry(&mut self, pose: &Rigid) {
        let hole = self
            .pose
            .apply(&Vector3::new(self.off.x, self.off.y, -self.along));
        let there = pose.apply_inverse(&hole);
        self.off = Vector2::new(there.x, there.y);
        self.along = -there.z;
        self.pose = *pose;
    }

    /// What the hole pushes where it stands: none within the clearance, in proportion beyond.
    #[inline]
    pub(super) fn pushed(&self, clearance_mm: f64) -> Vector2<f64> {
        let far = self.off.norm();
        let pressed = far - clearance_mm;
        // a shaft that has left the eye leans on nothing
        if pressed > 0.0 && self.along > 0.0 {
            self.off * (pressed / (far * self.gives))
        } else {
            Vector2::zeros()
        }
    }

    /// Variance of the force's components by not knowing on which side of its edge the hole stands, since it was read:
    /// the hole may stand anywhere around a free shaft, and a tip near the hole may have left it.
    pub(super) fn edge(&self, moved_mm: f64, clearance_mm: f64) -> f64 {
        let mut variance = 0.0;
        if self.gives > 0.0 && moved_mm > 0.0 {
            if self.free {
                let least = moved_mm.min(2.0 * clearance_mm) / self.gives;
                variance += least * least / 4.0;
            }
            let mut deviation = self.variance;
            for t in &self.tied {
                deviation += t * t;
            }
            if self.along * self.along < 9.0 * deviation || self.along < 0.0 {
                variance +=
                    self.force.norm_squared() + moved_mm * moved_mm / (self.gives * self.gives);
            }
        }
        variance
    }

    /// The force where the hole stands now.
    #[inline]
    pub(super) fn lean(&mut self, clearance_mm: f64) {
        if self.gives > 0.0 {
            let before = self.force.norm();
            self.force = self.rest + self.pushed(clearance_mm);
            let share = if before > 0.0 {
                self.force.norm() / before
            } else {
                0.0
            };
            let share = if share < 2.0 { share } else { 2.0 };
            for row in &mut self.force_tied {
                for t in row {
                    *t *= share;
                }
            }
            self.by_depth *= share;
        }
    }
}

/// Length beyond the hole that stands at `along` on the unbent axis.
#[inline]
pub(super) fn depth_of(rod: &Rod, along: f64, force: f64) -> f64 {
    let first = along - rod.contact_short(force, along);
    along - rod.contact_short(force, first)
}
