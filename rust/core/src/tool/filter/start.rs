//! What the filter holds, and how it starts.

use super::creep::Creep;
use super::drift::Drift;
use super::evidence::Evidence;
use super::known::{OfDepth, Trusted};
use super::moments::Gratings;
use super::pace::{Felt, Pace};
use super::poses::{Posed, Poses};
use super::state::{Known, State};
use super::status::Watch;
use super::warmth::Warmth;
use crate::numbers::math::sqrt;
use crate::numbers::rigid::Rigid;
use crate::tool::rod::{Rod, Shaft};
use crate::{Error, Result};
use nalgebra::Matrix2;

/// No robot stands further away than this, mm.
const FARTHEST_MM: f64 = 1e6;
/// What a hole gives way before that is felt, and its deviation, mm/mN: tissue is as soft as a fortieth of this per mN.
const GIVES: [f64; 2] = [0.005, 0.01];

/// The filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolFilter {
    pub(super) rod: Rod,
    pub(super) shaft: Shaft,
    pub(super) distances_mm: [f64; 2],
    pub(super) gratings: Gratings,
    /// Variance of a moment's component in whole sections.
    pub(super) variances: [f64; 2],
    pub(super) of_depth: OfDepth,
    pub(super) unknown_force: f64,
    pub(super) unknown_mean: f64,
    /// Factor of the covariance of length and stiffness.
    pub(super) beam: Matrix2<f64>,
    pub(super) floor_mm2: f64,
    pub(super) per_stiffness: f64,
    pub(super) poses: Poses,
    pub(super) state: State,
    pub(super) felt: Option<Felt>,
    pub(super) free_for: u16,
    pub(super) creep: Creep,
    pub(super) warmth: Warmth,
    pub(super) drift: Drift,
    pub(super) pace: Pace,
    pub(super) evidence: Evidence,
    pub(super) used_s: f64,
    pub(super) before: Known,
    pub(super) watch: Watch,
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
        let (c, d) = (&trusted.calibration, &trusted.doubt);
        let gratings = Gratings::new(trusted);
        let variances = [gratings.variance(0), gratings.variance(1)];
        let per_nm = variances.map(|v| v / gratings.noise.max(f64::MIN_POSITIVE));
        let unit = per_nm.map(|v| v * d.warmth * d.warmth);
        let [one, two] = per_nm.map(|v| sqrt(v) * d.reference_nm);
        let known = Known::new(
            [
                depth_mm,
                trusted.clearance_mm,
                GIVES[0],
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
            ],
            [
                sqrt(variance.max(0.0)),
                d.clearance_mm,
                GIVES[1],
                d.turn_rad,
                d.deeper_mm,
                one,
                one,
                two,
                two,
            ],
        );
        check_start(depth_mm, variance, pose, time_s)?;
        let state = State::start(time_s, pose, &known);
        Ok(Self {
            rod: trusted.rod,
            shaft: trusted.rod.shaft(),
            distances_mm: c.distances_mm,
            gratings,
            variances,
            of_depth: OfDepth::new(&d.depth),
            unknown_force: d.force,
            unknown_mean: d.mean,
            beam: factor(&d.beam),
            floor_mm2: 0.0,
            per_stiffness: 1.0 / trusted.rod.beam.stiffness(),
            poses: Poses::new(Posed {
                time_s,
                pose: *pose,
            }),
            state,
            felt: None,
            free_for: 0,
            creep: Creep::new(per_nm),
            warmth: Warmth::new(unit),
            drift: Drift::new(trusted.per_second_mm2),
            pace: Pace::new(&state),
            evidence: Evidence::new(trusted),
            used_s: f64::NEG_INFINITY,
            before: known,
            watch: Watch::default(),
        })
    }
}

/// Whether a robot can stand so.
#[inline]
pub(super) fn possible(pose: &Rigid) -> bool {
    // false for NaN
    let mut possible = true;
    for x in pose.translation.as_slice() {
        possible &= x.abs() < FARTHEST_MM;
    }
    for x in pose.rotation.as_slice() {
        possible &= x.abs() < 2.0;
    }
    possible
}

fn check_start(depth_mm: f64, variance: f64, pose: &Rigid, time_s: f64) -> Result<()> {
    let known = depth_mm.abs() < FARTHEST_MM && time_s.is_finite() && possible(pose);
    if known && variance >= 0.0 && variance.is_finite() {
        Ok(())
    } else {
        Err(Error::Invalid {
            what: "tool: the first depth, pose and time must be finite, its variance zero or more",
        })
    }
}

/// Factor `L` of a covariance of two numbers, with zeros where it is not positive.
fn factor(c: &Matrix2<f64>) -> Matrix2<f64> {
    let first = sqrt(c.m11.max(0.0));
    let below = if first > 0.0 { c.m21 / first } else { 0.0 };
    let second = sqrt((c.m22 - below * below).max(0.0));
    Matrix2::new(first, 0.0, below, second)
}
