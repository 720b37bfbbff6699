//! Where the hole stands in the tool's frame and what is known of it, at the last stamp.

use super::moments::Bends;
use super::unknowns::{CLEARANCE, Tied, UNKNOWNS};
use crate::numbers::math::sqrt;
use crate::numbers::rigid::Rigid;
use crate::tool::rod::Shaft;
use nalgebra::{Matrix3, Vector2, Vector3};

/// What the last force was read from: how it hangs on unknowns and depth is worked out where it is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Felt {
    pub(super) time_s: f64,
    pub(super) bends: Bends,
    /// Along which way, and what each section's moment counted.
    pub(super) way: Vector2<f64>,
    pub(super) weights: [f64; 2],
    /// Variance of the force's components by noise.
    pub(super) noise: f64,
    /// Size of the force then, mN, and per millimetre of depth.
    pub(super) size: f64,
    pub(super) by_depth: f64,
    /// Size of the force over what it was then.
    pub(super) share: f64,
}

/// The state at the last stamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct State {
    pub(super) time_s: f64,
    pub(super) pose: Rigid,
    /// Place of the hole in the tool's frame: off the axis where nothing pushes it, and `l`.
    pub(super) off: Vector2<f64>,
    pub(super) along: f64,
    /// What the bend took from `l` for the depth when it was last read, mm, and from the moments (`Shaft::relief`).
    pub(super) short: f64,
    pub(super) relief: [f64; 2],
    /// Whether anything has ever touched, and what the hole then gives way for a force, mm/mN.
    pub(super) touched: bool,
    pub(super) hole_gives: f64,
    /// Whether the last reading felt nothing of the hole, so that it may stand anywhere within its clearance.
    pub(super) free: bool,
    /// When the hole was last felt, s.
    pub(super) felt_s: f64,
    /// What was felt beyond what the hole pushes.
    pub(super) rest: Vector2<f64>,
    /// Noise of `l`, and how it hangs on the unknowns.
    pub(super) variance: f64,
    pub(super) tied: Tied,
    /// Force across the shaft: size and way.
    pub(super) size: f64,
    pub(super) way: Vector2<f64>,
    pub(super) felt: Felt,
}

impl State {
    /// At a depth, with nothing felt.
    pub(super) fn start(time_s: f64, pose: &Rigid, depth_mm: f64, variance: f64) -> Self {
        let way = Vector2::new(1.0, 0.0);
        Self {
            time_s,
            pose: *pose,
            off: Vector2::zeros(),
            along: depth_mm,
            short: 0.0,
            relief: [1.0; 2],
            touched: false,
            hole_gives: 0.0,
            free: true,
            felt_s: time_s,
            rest: Vector2::zeros(),
            variance,
            tied: [0.0; UNKNOWNS],
            size: 0.0,
            way,
            felt: Felt {
                time_s,
                bends: Bends::default(),
                way,
                weights: [0.0; 2],
                noise: 0.0,
                size: 0.0,
                by_depth: 0.0,
                share: 1.0,
            },
        }
    }

    /// Whether any reading has told a force.
    pub(super) fn read(&self) -> bool {
        self.felt.weights != [0.0; 2]
    }

    /// Force across the shaft, mN.
    pub(super) fn force(&self) -> Vector2<f64> {
        self.way * self.size
    }

    /// Sets the force.
    pub(super) fn push(&mut self, force: &Vector2<f64>) {
        self.size = sqrt(force.norm_squared());
        if self.size > 0.0 {
            self.way = force / self.size;
        }
    }

    /// Depth under this state's force.
    #[inline]
    pub(super) fn depth(&self, shaft: &Shaft) -> f64 {
        self.along - shaft.short(self.size * self.size, shaft.arc(self.along - self.short))
    }

    /// Variance of `l`, with what hangs on the unknowns.
    pub(super) fn total_variance(&self) -> f64 {
        let mut total = self.variance;
        for t in &self.tied {
            total += t * t;
        }
        total
    }

    /// Whether the tip is beyond the hole without doubt.
    pub(super) fn surely_inside(&self) -> bool {
        self.along > 0.0 && self.along * self.along > 9.0 * self.total_variance()
    }

    /// Carries the hole, which stands still, into the frame of another pose. `clearance_mm`: deviation of the
    /// clearance, whose unknown a turn of the shaft brings into `l`.
    #[inline]
    pub(super) fn carry(&mut self, pose: &Rigid, clearance_mm: f64) {
        let before = self.pose.rotation.column(2).into_owned();
        let seen = Vector3::new(self.off.x, self.off.y, -self.along);
        let gone = self.pose.translation - pose.translation;
        let there = turned_back(&pose.rotation, &(self.pose.rotation * seen + gone));
        self.off = Vector2::new(there.x, there.y);
        self.along = -there.z;
        self.pose = *pose;
        if self.size > 0.0 {
            let axes = &self.pose.rotation;
            let turn = axes.column(2) - before;
            let along =
                axes.column(0).dot(&turn) * self.way.x + axes.column(1).dot(&turn) * self.way.y;
            // l = (S - E)·z and E = S + R (u, -l): more clearance puts the hole further along the force
            self.tied[CLEARANCE] -= along * clearance_mm;
        }
    }

    /// What shaft and hole give way for a force, mm/mN; zero before the first touch.
    #[inline]
    pub(super) fn gives(&self, shaft: &Shaft) -> f64 {
        if self.touched {
            let arc = shaft.arc(self.along - self.short);
            shaft.gives(self.size * self.size, arc) + self.hole_gives
        } else {
            0.0
        }
    }

    /// What the hole pushes where it stands: none within the clearance, in proportion beyond.
    #[inline]
    pub(super) fn pushed(&self, clearance_mm: f64, gives: f64) -> Vector2<f64> {
        let far = sqrt(self.off.norm_squared());
        let pressed = far - clearance_mm;
        // a shaft that has left the eye leans on nothing
        if pressed > 0.0 && self.along > 0.0 && gives > 0.0 {
            self.off * (pressed / (far * gives))
        } else {
            Vector2::zeros()
        }
    }

    /// The force where the hole stands now.
    pub(super) fn lean(&mut self, shaft: &Shaft, clearance_mm: f64) {
        if self.touched {
            let before = self.size;
            let gives = self.gives(shaft);
            self.push(&(self.rest + self.pushed(clearance_mm, gives)));
            let share = if before > 0.0 {
                self.size / before
            } else {
                0.0
            };
            self.felt.share *= if share < 2.0 { share } else { 2.0 };
        }
    }
}

/// `Rᵀ v`.
#[inline]
fn turned_back(r: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    let of = |k: usize| r[(0, k)] * v.x + r[(1, k)] * v.y + r[(2, k)] * v.z;
    Vector3::new(of(0), of(1), of(2))
}
