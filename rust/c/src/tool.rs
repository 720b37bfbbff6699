//! The filter that a control loop runs on the flexible tool: wavelengths and poses in, depth and tip out.

use crate::result::{answer, coded, sherkit_result};
use crate::sensing::{sherkit_beam, sherkit_pose, sherkit_sensor_calibration};
use crate::status::{sherkit_statistics, sherkit_status};
use crate::storage::{get, get_mut, given, init, opaque, wanted};
use nalgebra::{Matrix2, Matrix3, Vector2};
use sherkit_core::numbers::rigid::Rigid;
use sherkit_core::tool::filter::{Doubt, Look, Status, Told, ToolFilter, Trusted};
use sherkit_core::tool::rod::{Bending, Rod};

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
    /// What the mean of three fibres answers to a moment at sections I and II, nm per mN mm, and the standard deviation of
    /// that over a fibre's own answer.
    pub means_nm: [[f64; 2]; 2],
    /// See above.
    pub mean_doubt: f64,
    /// Covariance of t0, t1, t2, mm^2: at a length d beyond the hole the depth that the gratings measure is off by
    /// t0 + t1 (d/10) + t2 (d/10)^2.
    pub depth_covariance: [[f64; 3]; 3],
    /// Standard deviation of how much deeper than that the gratings count all depths, mm.
    pub deeper_doubt_mm: f64,
    /// Of how far the gratings are turned about the shaft against the robot's frame, rad.
    pub turn_doubt_rad: f64,
    /// Of a force over the force.
    pub force_doubt: f64,
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
    /// Radius by which the hole is wider than the shaft, and its standard deviation, mm.
    pub clearance_mm: f64,
    /// See above.
    pub clearance_doubt_mm: f64,
    /// How fast the hole strays along the shaft at least, mm^2/s.
    pub per_second_mm2: f64,
}

impl sherkit_tool {
    fn trusted(&self) -> Result<Trusted, sherkit_result> {
        let exact = self.exact != 0;
        Ok(Trusted {
            calibration: self.sensor.calibration(),
            means: self.means_nm.map(Vector2::from),
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
                depth: Matrix3::from(self.depth_covariance).transpose(),
                deeper_mm: self.deeper_doubt_mm,
                turn_rad: self.turn_doubt_rad,
                force: self.force_doubt,
                beam: Matrix2::from(self.beam_covariance).transpose(),
                reference_nm: self.reference_doubt_nm,
                mean: self.mean_doubt,
                unlike: self.warmth_unlike,
                warmth: self.warmth_doubt,
                clearance_mm: self.clearance_doubt_mm,
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
    /// Insertion depth, the paper's l: from the hole to the unbent tip, along the unbent axis, mm.
    pub depth_mm: f64,
    /// Length of shaft beyond the hole, mm: shorter than the depth by what the bend takes.
    pub arc_mm: f64,
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

impl sherkit_tool_estimate {
    /// After a step.
    pub fn from(told: &Told, look: &Look, status: Status) -> Self {
        Self {
            time_s: told.time_s,
            depth_mm: told.depth_mm,
            arc_mm: told.arc_mm,
            tip_mm: told.tip_mm,
            covariance: told.covariance,
            force_mn: told.force_mn,
            force_variance: told.force_variance,
            misfit: look.misfit,
            faulty: u32::from(look.faulty),
            status: u32::from(status.0),
        }
    }
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
        *out = sherkit_tool_estimate::from(&filter.told(), &filter.look(), status);
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
