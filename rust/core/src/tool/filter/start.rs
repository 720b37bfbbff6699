//! What the filter holds, and how it starts.

use super::along::Along;
use super::moments::Gratings;
use super::slips::Slips;
use super::state::{BENCH, N, State};
use crate::numbers::math::sqrt;
use crate::numbers::rigid::Rigid;
use crate::tool::poses::{Posed, Poses};
use crate::tool::rod::Shaft;
use crate::tool::sensing::{FIBRES, SECTIONS};
use crate::tool::status::{Consistency, Counts, Look, Set};
use crate::tool::trusted::Trusted;
use crate::{Error, Result};
use nalgebra::{Matrix2, Matrix3, Vector2};

pub(super) const GRATINGS: usize = FIBRES * SECTIONS;
/// Nine gratings, three fibres, section III, three sections that are warmer than the others.
pub(super) const HYPOTHESES: usize = GRATINGS + FIBRES + 1 + SECTIONS;
/// The guess at the start, (mm/s)², counts as so much, s.
const FIRST: f64 = 0.04;
const GUESSED_S: f64 = 0.01;
/// The least lag of fibres over the bend, squared.
pub(super) const LEAST: f64 = 4e-8;
/// No robot stands further away than this, mm.
const FARTHEST_MM: f64 = 1e6;
/// What a hole gives way before that is felt, and its deviation, mm/mN: tissue is as soft as a fortieth of this per mN.
const GIVES: [f64; 2] = [0.005, 0.01];

/// The filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolFilter {
    pub(super) trusted: Trusted,
    pub(super) shaft: Shaft,
    pub(super) gratings: Gratings,
    /// Factors of the covariances of the bench's depth, and of length and stiffness.
    pub(super) bench: Matrix3<f64>,
    pub(super) beam: Matrix2<f64>,
    pub(super) poses: Poses,
    pub(super) state: State,
    pub(super) felt: Option<Felt>,
    pub(super) offsets: Offsets,
    pub(super) drift: Drift,
    pub(super) along: Along,
    pub(super) edge: Edge,
    pub(super) tip: Tip,
    pub(super) watch: Watch,
    pub(super) slips: Slips,
    pub(super) used_s: f64,
    pub(super) look: Look,
    pub(super) counts: Counts,
    pub(super) consistency: Consistency,
}

/// The last force that was read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Felt {
    pub(super) time_s: f64,
    pub(super) force: Vector2<f64>,
    pub(super) noise: f64,
    pub(super) by_moments: [f64; 2],
    pub(super) by_depth: f64,
}

/// Sums of innovations and of one over their variances; since when; what the last sum was over its deviation; the process
/// noise to use, mm²/s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Drift {
    pub(super) sum: f64,
    pub(super) weight: f64,
    pub(super) since_s: f64,
    pub(super) before: f64,
    pub(super) per_second: f64,
}

/// What was learnt of them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Offsets {
    /// Of the present rest: sums of moments and of their squares over their variances, and how many.
    pub(super) sums: [f64; 4],
    pub(super) squares: f64,
    pub(super) count: f64,
    pub(super) third: Vector2<f64>,
    /// The last rest, and its time, s.
    pub(super) rest: [f64; 4],
    pub(super) at_s: Option<f64>,
    /// Squares of changes, nm², and of the times in which they came, s².
    pub(super) moved: [f64; 2],
    pub(super) waited: [f64; 2],
    /// How far a reference may have crept since the last rest, nm².
    pub(super) crept: f64,
    /// Bends of late, as a fibre's shift squared, nm²; the lag over the bend, squared.
    pub(super) bent: [f64; 2],
    pub(super) lag: f64,
    /// Differences of means, of I and II and of III and both: smoothed, where they go from, nm, and since when they are known,
    /// s. Their squares beyond noise over bends squared, nm⁴ s, and bends to the fourth.
    pub(super) means: [[f64; 3]; 2],
    pub(super) shows: f64,
    pub(super) by_bend: f64,
    /// Warmth now and at the last rest, nm.
    pub(super) warm: Option<f64>,
    pub(super) warm_at_rest: f64,
}

/// What was learnt of the edge: mean square pace of a coordinate, (mm/s)², and how much is known of it, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Edge {
    pub(super) mean: f64,
    pub(super) known_s: f64,
    pub(super) since: Option<Then>,
    /// Strays since, and the hole's motion aside then, mm/s; sums by which the robot's rows are late: of strays by how that
    /// motion changed, of its squares, of squares of strays, mm, and of ones.
    pub(super) strays: Option<(f64, Vector2<f64>, Vector2<f64>)>,
    pub(super) late: [f64; 4],
}

impl Default for Edge {
    fn default() -> Self {
        Self {
            mean: FIRST,
            known_s: GUESSED_S,
            since: None,
            strays: None,
            late: [0.0; 4],
        }
    }
}

/// The edge a tenth of a second ago: force, its noise, and what the shaft alone gave way for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Then {
    pub(super) time_s: f64,
    pub(super) pose: Rigid,
    pub(super) l: f64,
    pub(super) turn: f64,
    pub(super) size: f64,
    pub(super) way: Vector2<f64>,
    pub(super) noise: f64,
    pub(super) gives: f64,
    /// Whether the force told a depth.
    pub(super) tells: bool,
}

/// Force at the tip, tool frame, mN; the moment of section III at rest, mN·mm; the variance of a component by noise, and of its zero; what is told of none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Tip {
    pub(super) force: Vector2<f64>,
    pub(super) zero: Vector2<f64>,
    /// How far the hole has bent III since its zero was seen, as a fibre's shift squared, nm².
    pub(super) bent: f64,
    pub(super) variance: f64,
    pub(super) of_zero: f64,
    pub(super) tells: bool,
    /// Whether it is one.
    pub(super) on: bool,
}

/// What is not believed: gratings, and sections (bits) whose warmth is their own.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Believed {
    pub(super) bad: Set,
    pub(super) warm: u8,
}

/// What was seen of the gratings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Watch {
    /// The last wavelengths, each in its place, and when; which peak shows where; how often each repeated a number.
    pub(super) last: [f64; GRATINGS],
    pub(super) at_s: f64,
    pub(super) elapsed_s: f64,
    /// Variance of a grating from reading to reading, nm².
    pub(super) jitter: f64,
    pub(super) places: [usize; GRATINGS],
    pub(super) repeats: [u8; GRATINGS],
    /// Evidence for each hypothesis, the leader, and for how many readings it leads.
    pub(super) sums: [f64; HYPOTHESES],
    pub(super) leader: usize,
    pub(super) leads_for: u16,
    pub(super) held: Believed,
    pub(super) good: u16,
    pub(super) refused: u16,
    /// Readings for which fibres are looked at that may slip.
    pub(super) suspects: u16,
}

impl Default for Watch {
    fn default() -> Self {
        Self {
            last: [f64::NAN; GRATINGS],
            at_s: f64::NEG_INFINITY,
            elapsed_s: 0.0,
            jitter: f64::INFINITY,
            places: core::array::from_fn(|k| k),
            repeats: [0; GRATINGS],
            sums: [0.0; HYPOTHESES],
            leader: 0,
            leads_for: 0,
            held: Believed::default(),
            good: 0,
            refused: 0,
            suspects: 0,
        }
    }
}

impl ToolFilter {
    /// Starts at a depth (mm) with a variance (mm²), with the tool at a pose (tool to base frame), at a time (s).
    ///
    /// # Errors
    /// [`Error::Invalid`] for numbers that mean nothing.
    pub fn new(
        trusted: &Trusted,
        depth_mm: f64,
        variance: f64,
        pose: &Rigid,
        time_s: f64,
    ) -> Result<Self> {
        trusted.check()?;
        let known = depth_mm.abs() < FARTHEST_MM && time_s.is_finite() && possible(pose);
        if !(known && variance >= 0.0 && variance.is_finite()) {
            return Err(Error::Invalid {
                what: "tool: the first depth, pose and time must be finite, its variance zero or more",
            });
        }
        let d = &trusted.doubt;
        let gratings = Gratings::new(trusted);
        let [one, two] = gratings.per_nm.map(|v| sqrt(v) * d.reference_nm);
        let (mut x, mut deviations) = ([0.0; N], [1.0; N]);
        x[..3].copy_from_slice(&[depth_mm, trusted.clearance_mm, GIVES[0]]);
        deviations[..BENCH].copy_from_slice(&[
            sqrt(variance),
            d.clearance_mm,
            GIVES[1],
            d.turn_rad,
            one,
            one,
            two,
            two,
            d.deeper_mm,
        ]);
        Ok(Self {
            trusted: *trusted,
            shaft: trusted.rod.shaft(),
            gratings,
            bench: factor(&d.depth),
            beam: factor(&d.beam.fixed_resize::<3, 3>(0.0)).fixed_resize(0.0),
            poses: Poses::new(Posed {
                time_s,
                pose: *pose,
            }),
            state: State::new(time_s, pose, x, deviations),
            felt: None,
            offsets: Offsets {
                lag: LEAST,
                ..Offsets::default()
            },
            drift: Drift::new(time_s, trusted.per_second_mm2 * 4.0),
            along: Along::default(),
            edge: Edge::default(),
            tip: Tip::default(),
            watch: Watch {
                jitter: gratings.noise,
                ..Watch::default()
            },
            slips: Slips::default(),
            used_s: f64::NEG_INFINITY,
            look: Look::default(),
            counts: Counts::default(),
            consistency: Consistency::default(),
        })
    }
}

/// Whether a robot can stand so; false for NaN.
#[inline]
pub(super) fn possible(pose: &Rigid) -> bool {
    let mut possible = true;
    for x in pose.translation.as_slice() {
        possible &= x.abs() < FARTHEST_MM;
    }
    for x in pose.rotation.as_slice() {
        possible &= x.abs() < 2.0;
    }
    possible
}

/// Factor `L` of a covariance, with zeros where it is not positive.
fn factor(c: &Matrix3<f64>) -> Matrix3<f64> {
    let mut l: Matrix3<f64> = Matrix3::zeros();
    for i in 0..3 {
        for j in 0..=i {
            let left = c[(i, j)] - (0..j).map(|k| l[(i, k)] * l[(j, k)]).sum::<f64>();
            l[(i, j)] = if i == j {
                sqrt(left.max(0.0))
            } else if l[(j, j)] > 0.0 {
                left / l[(j, j)]
            } else {
                0.0
            };
        }
    }
    l
}
