//! The paper's two filters: of the depth, of the tip.
//!
//! Functions stand here one by one, because the header is made from what is written, not from what a macro makes; what
//! they do is in [`init`], [`step`] and [`tell`].

use crate::noise::sherkit_noise;
use crate::result::{answer, coded, sherkit_result};
use crate::sensing::{sherkit_beam, sherkit_measurement, sherkit_pose};
use crate::status::{degrees, sherkit_statistics, sherkit_status};
use crate::storage::{Opaque, get, get_mut, given, init, opaque, wanted};
use nalgebra::Vector3;
use sherkit_core::numbers::rigid::Rigid;
use sherkit_core::tool::beam::Beam;
use sherkit_core::tool::filters::{DepthFilter, Measurement, Noise, Status, TipFilter};

/// Steps a filter with what was measured, if anything was, and says where it is.
///
/// # Safety
/// Pointers are null or valid, and nobody else uses the filter.
unsafe fn step<T: Opaque, E>(
    filter: *mut T,
    measurement: *const sherkit_measurement,
    estimate: *mut E,
    advance: impl FnOnce(&mut T::Value, Option<&Measurement>) -> Result<Status, sherkit_result>,
    tell: impl FnOnce(&T::Value, Status) -> E,
) -> sherkit_result {
    let run = || {
        // SAFETY: the caller's word.
        let (filter, out, measured) =
            unsafe { (get_mut(filter)?, wanted(estimate)?, measurement.as_ref()) };
        let status = advance(filter, measured.map(Measurement::from).as_ref())?;
        *out = tell(filter, status);
        Ok(())
    };
    answer(run())
}

/// Says how a filter fared.
///
/// # Safety
/// As [`step`].
unsafe fn tell<T: Opaque>(
    filter: *const T,
    statistics: *mut sherkit_statistics,
    of: impl FnOnce(&T::Value) -> sherkit_statistics,
) -> sherkit_result {
    let run = || {
        // SAFETY: the caller's word.
        let (filter, out) = unsafe { (get(filter)?, wanted(statistics)?) };
        *out = of(filter);
        Ok(())
    };
    answer(run())
}

/// Velocity and pose of the unbent tip.
///
/// # Safety
/// Pointers are null or valid.
unsafe fn motion(
    velocity_mm_s: *const f64,
    pose: *const sherkit_pose,
) -> Result<(Vector3<f64>, Rigid), sherkit_result> {
    // SAFETY: the caller's word.
    let (velocity, pose) = unsafe { (given(velocity_mm_s.cast::<[f64; 3]>())?, given(pose)?) };
    Ok((Vector3::from(*velocity), Rigid::from(pose)))
}

/// Beam and noise of a filter, and its first pose.
///
/// # Safety
/// Pointers are null or valid.
unsafe fn tool(
    beam: *const sherkit_beam,
    pose: *const sherkit_pose,
    noise: *const sherkit_noise,
) -> Result<(Beam, Rigid, Noise), sherkit_result> {
    // SAFETY: the caller's word.
    unsafe {
        let (beam, tool) = (given(beam)?.beam()?, Rigid::from(given(pose)?));
        Ok((beam, tool, given(noise)?.noise()?))
    }
}

/// The filter of the insertion depth. Its content is nobody's business.
#[repr(C)]
pub struct sherkit_depth_filter {
    words: [u64; 64],
}

opaque!(sherkit_depth_filter, DepthFilter, 0x7368_6b64_6570_7468, 64);

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

fn depth_estimate(filter: &DepthFilter, status: Status) -> sherkit_depth_estimate {
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
    // SAFETY: pointers are null or valid.
    let noise = || unsafe { given(noise)? }.noise();
    let made = || coded(DepthFilter::new(depth_mm, variance, time_s, noise()?));
    // SAFETY: as above.
    answer(unsafe { init(filter, made) })
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
    let advance =
        |f: &mut DepthFilter, m: Option<&Measurement>| Ok(f.step(time_s, velocity_mm_s, m));
    // SAFETY: pointers are null or valid.
    unsafe { step(filter, measurement, estimate, advance, depth_estimate) }
}

/// How often what happened since the filter was initialised.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_depth_filter_statistics(
    filter: *const sherkit_depth_filter,
    statistics: *mut sherkit_statistics,
) -> sherkit_result {
    // SAFETY: pointers are null or valid.
    unsafe { tell(filter, statistics, |f| sherkit_statistics::of(f.track())) }
}

/// The filter of the tip's position. Its content is nobody's business.
#[repr(C)]
pub struct sherkit_tip_filter {
    words: [u64; 128],
}

opaque!(sherkit_tip_filter, TipFilter, 0x7368_6b74_6970_6669, 128);

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

fn tip_estimate(filter: &TipFilter, status: Status) -> sherkit_tip_estimate {
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
    let made = || {
        // SAFETY: pointers are null or valid.
        let (beam, tool, noise) = unsafe { tool(beam, pose, noise)? };
        coded(TipFilter::new(beam, &tool, variance, time_s, noise))
    };
    // SAFETY: as above.
    answer(unsafe { init(filter, made) })
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
    let advance = |f: &mut TipFilter, m: Option<&Measurement>| {
        // SAFETY: pointers are null or valid.
        let (velocity, pose) = unsafe { motion(velocity_mm_s, pose)? };
        Ok(f.step(time_s, &velocity, &pose, (depth_mm, depth_variance), m))
    };
    // SAFETY: pointers are null or valid.
    unsafe { step(filter, measurement, estimate, advance, tip_estimate) }
}

/// How often what happened since the filter was initialised.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_tip_filter_statistics(
    filter: *const sherkit_tip_filter,
    statistics: *mut sherkit_statistics,
) -> sherkit_result {
    // SAFETY: pointers are null or valid.
    unsafe { tell(filter, statistics, |f| sherkit_statistics::of(f.track())) }
}
