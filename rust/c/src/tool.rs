//! The filter that a control loop runs on the flexible tool: wavelengths and poses in, depth and tip out.

use crate::result::{answer, coded, sherkit_result};
use crate::sensing::{sherkit_beam, sherkit_pose, sherkit_sensor_calibration};
use crate::status::{sherkit_statistics, sherkit_status};
use crate::storage::{get, get_mut, given, init, opaque, wanted};
use nalgebra::{Matrix2, Matrix3};
use sherkit_core::numbers::rigid::Rigid;
use sherkit_core::tool::rod::{Bending, Rod};
use sherkit_core::tool::tracker::{Doubt, ToolFilter, Trusted};

/// A calibrated tool, and what its calibration does not know. A doubt of zero is certainty.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sherkit_tool {
    /// The gratings.
    pub sensor: sherkit_sensor_calibration,
    /// The shaft.
    pub beam: sherkit_beam,
    /// 1: it bends as an elastica; 0: as a cantilever by small angles.
    pub exact: u32,
    /// Covariance of each row of K_I and K_II, (mN mm/nm)^2.
    pub gain_covariance: [[[[f64; 3]; 3]; 2]; 2],
    /// Standard deviation of a reference wavelength, nm.
    pub reference_doubt_nm: f64,
    /// How unlike fibres answer to warmth: standard deviation over the mean answer.
    pub warmth_unlike: f64,
    /// How much more than the mean of its section each fibre of sections I and II answers to warmth, relative, and the
    /// standard deviation of that: `warmth_unlike` where nothing was learnt of it.
    pub warmth: [[f64; 3]; 2],
    /// See above.
    pub warmth_doubt: f64,
    /// Covariance of length (mm) and stiffness (mN mm^2).
    pub beam_covariance: [[f64; 2]; 2],
    /// Standard deviation of where the sections stand, mm.
    pub distance_doubt_mm: f64,
    /// Radius by which the hole is wider than the shaft, and its standard deviation, mm.
    pub clearance_mm: f64,
    /// See above.
    pub clearance_doubt_mm: f64,
    /// How fast the hole strays along the shaft at least, mm^2/s.
    pub per_second_mm2: f64,
}

impl sherkit_tool {
    fn trusted(&self) -> Result<Trusted, sherkit_result> {
        let matrix = |m: [[f64; 3]; 3]| Matrix3::from(m).transpose();
        let exact = self.exact != 0;
        Ok(Trusted {
            calibration: self.sensor.calibration(),
            warmth: self.warmth,
            rod: Rod {
                beam: self.beam.beam()?,
                bending: if exact {
                    Bending::Exact
                } else {
                    Bending::Small
                },
            },
            doubt: Doubt {
                gains: self.gain_covariance.map(|rows| rows.map(matrix)),
                reference_nm: self.reference_doubt_nm,
                unlike: self.warmth_unlike,
                warmth: self.warmth_doubt,
                beam: Matrix2::from(self.beam_covariance).transpose(),
                clearance_mm: self.clearance_doubt_mm,
                distance_mm: self.distance_doubt_mm,
            },
            clearance_mm: self.clearance_mm,
            per_second_mm2: self.per_second_mm2,
        })
    }
}

/// The filter of a tool. Its content is nobody's business.
#[repr(C)]
pub struct sherkit_tool_filter {
    words: [u64; 2048],
}

opaque!(sherkit_tool_filter, ToolFilter, 0x7368_6b74_6f6f_6c66, 2048);

/// Depth and tip after a step.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sherkit_tool_estimate {
    /// Time of the estimate, s.
    pub time_s: f64,
    /// Insertion depth: length of shaft inside the eye, mm.
    pub depth_mm: f64,
    /// The tip in the base frame, mm.
    pub tip_mm: [f64; 3],
    /// Covariance of depth and tip, mm^2.
    pub covariance: [[f64; 4]; 4],
    /// Force of the hole across the shaft, tool frame, mN.
    pub force_mn: [f64; 2],
    /// Variance of each of its components, mN^2.
    pub force_variance: f64,
    /// Square of what the moments of the last reading say across the force over its variance: about 1.
    pub misfit: f64,
    /// Gratings that were not believed in the last reading: bit 3 section + fibre.
    pub faulty: u32,
    /// What the step did.
    pub status: sherkit_status,
}

/// Starts at a depth (mm) with a variance (mm^2), with the tool at a pose, at a time (s). Where it fails the filter is
/// not initialised.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_tool_filter_init(
    filter: *mut sherkit_tool_filter,
    tool: *const sherkit_tool,
    depth_mm: f64,
    variance: f64,
    pose: *const sherkit_pose,
    time_s: f64,
) -> sherkit_result {
    let made = || {
        // SAFETY: pointers are null or valid.
        let (tool, pose) = unsafe { (given(tool)?.trusted()?, Rigid::from(given(pose)?)) };
        coded(ToolFilter::new(&tool, depth_mm, variance, &pose, time_s))
    };
    // SAFETY: as above.
    answer(unsafe { init(filter, made) })
}

/// One step to a time (s) with the tool at a pose, and a reading: nine wavelengths (nm; three fibres at each of the
/// sections I, II, III; null where there is none) with the time that they were taken at, which may lie up to 0.3 s back.
/// What could not be used is said by the estimate's status, not by the code.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_tool_filter_step(
    filter: *mut sherkit_tool_filter,
    time_s: f64,
    pose: *const sherkit_pose,
    stamp_s: f64,
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
        let status = filter.step(time_s, &pose, waves.map(|w| (stamp_s, w)));
        let (told, look) = (filter.told(), filter.look());
        *out = sherkit_tool_estimate {
            time_s: told.time_s,
            depth_mm: told.depth_mm,
            tip_mm: told.tip_mm,
            covariance: told.covariance,
            force_mn: told.force_mn,
            force_variance: told.force_variance,
            misfit: look.misfit,
            faulty: u32::from(look.faulty),
            status: u32::from(status.0),
        };
        Ok(())
    };
    answer(run())
}

/// How often what happened since the filter was initialised.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_tool_filter_statistics(
    filter: *const sherkit_tool_filter,
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
