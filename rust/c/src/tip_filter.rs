//! The tip filter.

use crate::filters::{degrees, sherkit_noise, sherkit_statistics, sherkit_status};
use crate::result::{answer, code_of, sherkit_result};
use crate::sensing::{sherkit_beam, sherkit_measurement, sherkit_pose};
use crate::storage::{Opaque, clear, get, get_mut, given, put, wanted};
use nalgebra::Vector3;
use sherkit_core::kalman::{Measurement, Status, TipFilter};
use sherkit_core::rigid::Rigid;

/// The filter of the tip's position. Its content is nobody's business.
#[repr(C)]
pub struct sherkit_tip_filter {
    words: [u64; 128],
}

// SAFETY: one array of so many words.
unsafe impl Opaque for sherkit_tip_filter {
    type Value = TipFilter;
    const MARK: u64 = 0x7368_6b74_6970_6669;
    const WORDS: usize = 128;
}

/// Position of the tip after a step.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sherkit_tip_estimate {
    /// Time of the estimate, s.
    pub time_s: f64,
    /// The tip in the base frame, mm.
    pub tip_mm: [f64; 3],
    /// Its covariance, mm^2.
    pub covariance: [[f64; 3]; 3],
    /// Normalised innovation squared of this step; zero where it only predicted.
    pub nis: f64,
    /// Its degrees of freedom.
    pub nis_degrees: u32,
    /// What the step did.
    pub status: sherkit_status,
}

fn estimate(filter: &TipFilter, status: Status) -> sherkit_tip_estimate {
    let track = filter.track();
    sherkit_tip_estimate {
        time_s: track.time_s(),
        tip_mm: filter.tip().into(),
        covariance: track.filter().covariance(),
        nis: track.consistency().last,
        nis_degrees: degrees(track),
        status: u32::from(status.0),
    }
}

/// Starts with the unbent tip of a pose, with a variance per axis (mm^2), at a time (s). Where it fails the filter is
/// not initialised.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_tip_filter_init(
    filter: *mut sherkit_tip_filter,
    beam: *const sherkit_beam,
    pose: *const sherkit_pose,
    variance: f64,
    time_s: f64,
    noise: *const sherkit_noise,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        unsafe {
            clear(filter);
            let (beam, tool) = (given(beam)?.beam()?, Rigid::from(given(pose)?));
            let noise = given(noise)?.noise()?;
            let made = TipFilter::new(beam, &tool, variance, time_s, noise);
            put(filter, made.map_err(|e| code_of(&e))?)
        }
    };
    answer(run())
}

/// One step to a time, with the velocity of the unbent tip in the base frame since the last step (3, mm/s), the pose
/// of the tool now, the depth (mm) with its variance (mm^2), and what was measured; null where nothing was. What could
/// not be used is said by the estimate's status, not by the code.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_tip_filter_step(
    filter: *mut sherkit_tip_filter,
    time_s: f64,
    velocity_mm_s: *const f64,
    pose: *const sherkit_pose,
    depth_mm: f64,
    depth_variance: f64,
    measurement: *const sherkit_measurement,
    estimate: *mut sherkit_tip_estimate,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        let (filter, velocity, pose) = unsafe {
            (
                get_mut(filter)?,
                given(velocity_mm_s.cast::<[f64; 3]>())?,
                given(pose)?,
            )
        };
        // SAFETY: as above.
        let (out, measured) = unsafe { (wanted(estimate)?, measurement.as_ref()) };
        let status = filter.step(
            time_s,
            &Vector3::from(*velocity),
            &Rigid::from(pose),
            (depth_mm, depth_variance),
            measured.map(Measurement::from).as_ref(),
        );
        *out = self::estimate(filter, status);
        Ok(())
    };
    answer(run())
}

/// How often what happened since the filter was initialised.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_tip_filter_statistics(
    filter: *const sherkit_tip_filter,
    statistics: *mut sherkit_statistics,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        let (filter, out) = unsafe { (get(filter)?, wanted(statistics)?) };
        *out = sherkit_statistics::of(filter.track());
        Ok(())
    };
    answer(run())
}
