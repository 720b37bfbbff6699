//! The depth filter.

use crate::filters::{degrees, sherkit_noise, sherkit_statistics, sherkit_status};
use crate::result::{answer, code_of, sherkit_result};
use crate::sensing::sherkit_measurement;
use crate::storage::{Opaque, clear, get, get_mut, given, put, wanted};
use sherkit_core::kalman::{DepthFilter, Measurement, Status};

/// The filter of the insertion depth. Its content is nobody's business.
#[repr(C)]
pub struct sherkit_depth_filter {
    words: [u64; 64],
}

// SAFETY: one array of so many words.
unsafe impl Opaque for sherkit_depth_filter {
    type Value = DepthFilter;
    const MARK: u64 = 0x7368_6b64_6570_7468;
    const WORDS: usize = 64;
}

/// Insertion depth after a step.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sherkit_depth_estimate {
    /// Time of the estimate, s.
    pub time_s: f64,
    /// Depth, mm.
    pub depth_mm: f64,
    /// Its variance, mm^2.
    pub variance: f64,
    /// Normalised innovation squared of this step; zero where it only predicted.
    pub nis: f64,
    /// Its degrees of freedom.
    pub nis_degrees: u32,
    /// What the step did.
    pub status: sherkit_status,
}

fn estimate(filter: &DepthFilter, status: Status) -> sherkit_depth_estimate {
    let track = filter.track();
    sherkit_depth_estimate {
        time_s: track.time_s(),
        depth_mm: filter.depth_mm(),
        variance: filter.variance(),
        nis: track.consistency().last,
        nis_degrees: degrees(track),
        status: u32::from(status.0),
    }
}

/// Starts at a depth (mm) with a variance (mm^2) at a time (s). Where it fails the filter is not initialised.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_depth_filter_init(
    filter: *mut sherkit_depth_filter,
    depth_mm: f64,
    variance: f64,
    time_s: f64,
    noise: *const sherkit_noise,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        unsafe {
            clear(filter);
            let noise = given(noise)?.noise()?;
            let made = DepthFilter::new(depth_mm, variance, time_s, noise);
            put(filter, made.map_err(|e| code_of(&e))?)
        }
    };
    answer(run())
}

/// One step to a time, with the velocity of the tip along the tool's z axis since the last step (mm/s), and what was
/// measured; null where nothing was. What could not be used is said by the estimate's status, not by the code.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_depth_filter_step(
    filter: *mut sherkit_depth_filter,
    time_s: f64,
    velocity_mm_s: f64,
    measurement: *const sherkit_measurement,
    estimate: *mut sherkit_depth_estimate,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        let (filter, out, measured) =
            unsafe { (get_mut(filter)?, wanted(estimate)?, measurement.as_ref()) };
        let measured = measured.map(Measurement::from);
        let status = filter.step(time_s, velocity_mm_s, measured.as_ref());
        *out = self::estimate(filter, status);
        Ok(())
    };
    answer(run())
}

/// How often what happened since the filter was initialised.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_depth_filter_statistics(
    filter: *const sherkit_depth_filter,
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
