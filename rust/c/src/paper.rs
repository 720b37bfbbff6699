//! The paper's two filters, of depth and tip, as they are printed: to reproduce it, and to compare with.

use crate::result::{answer, coded, sherkit_result};
use crate::sensing::{sherkit_beam, sherkit_pose, sherkit_sensor_calibration};
use crate::status::sherkit_statistics;
use crate::storage::{get, get_mut, given, init, opaque, wanted};
use crate::tool::sherkit_tool_estimate;
use sherkit_core::numbers::rigid::Rigid;
use sherkit_core::tool::filter::Look;
use sherkit_core::tool::paper::{PaperFilter, PaperNoise};

/// The filters of Ebrahimi et al. 2020 (Eqs. 8 and 14). Their content is nobody's business.
#[repr(C)]
pub struct sherkit_paper_filter {
    words: [u64; 128],
}

opaque!(
    sherkit_paper_filter,
    PaperFilter,
    0x7368_6b70_6170_6572,
    128
);

/// Starts at a depth (mm) with a variance (mm^2, of each axis of the tip as well), with the tool at a pose, at a time
/// (s), with the paper's noise for steps of 200 Hz. of_force: 1 where its entries for the tip are variances of the force
/// (mN^2), 0 where they are of the deflection (mm^2); the paper gives no units. Where it fails the filter is not
/// initialised.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_paper_filter_init(
    filter: *mut sherkit_paper_filter,
    sensor: *const sherkit_sensor_calibration,
    beam: *const sherkit_beam,
    of_force: u32,
    depth_mm: f64,
    variance: f64,
    pose: *const sherkit_pose,
    time_s: f64,
) -> sherkit_result {
    let made = || {
        // SAFETY: pointers are null or valid.
        let (sensor, beam, pose) = unsafe { (given(sensor)?, given(beam)?, given(pose)?) };
        let noise = PaperNoise {
            of_force: of_force != 0,
            ..PaperNoise::ebrahimi_2020()
        };
        coded(PaperFilter::new(
            &sensor.calibration(),
            beam.beam()?,
            noise,
            depth_mm,
            variance,
            &Rigid::from(pose),
            time_s,
        ))
    };
    // SAFETY: as above.
    answer(unsafe { init(filter, made) })
}

/// One step to a time (s) with the tool at a pose, and nine wavelengths of that time (nm; three fibres at each of the
/// sections I, II, III; null where there are none). In the estimate depth and tip are independent, arc_mm is depth_mm,
/// force_variance and misfit are zero, and no grating is faulty: of these the paper says nothing. What could not be used
/// is said by its status, not by the code.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_paper_filter_step(
    filter: *mut sherkit_paper_filter,
    time_s: f64,
    pose: *const sherkit_pose,
    wavelengths_nm: *const f64,
    estimate: *mut sherkit_tool_estimate,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        let (filter, out, pose, waves) = unsafe {
            (
                get_mut(filter)?,
                wanted(estimate)?,
                Rigid::from(given(pose)?),
                wavelengths_nm.cast::<[[f64; 3]; 3]>().as_ref(),
            )
        };
        let status = filter.step(time_s, &pose, waves);
        *out = sherkit_tool_estimate::from(&filter.told(), &Look::default(), status);
        Ok(())
    };
    answer(run())
}

/// How often what happened since the filter was initialised, and the innovations of the depth.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_paper_filter_statistics(
    filter: *const sherkit_paper_filter,
    statistics: *mut sherkit_statistics,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        let (filter, out) = unsafe { (get(filter)?, wanted(statistics)?) };
        *out = sherkit_statistics::from(filter.counts(), filter.consistency());
        Ok(())
    };
    answer(run())
}
