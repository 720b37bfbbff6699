//! The fibres of the flexible tool, its beam and its pose.

use crate::result::{answer, coded, sherkit_result};
use crate::storage::{get, given, init, opaque, wanted};
use nalgebra::{Matrix2x3, Matrix3, Vector3};
use sherkit_core::numbers::rigid::Rigid;
use sherkit_core::tool::beam::Beam;
use sherkit_core::tool::sensing::{Calibration, Depth, Reading, Sensor};

/// Calibration of the gratings.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sherkit_sensor_calibration {
    /// K_I and K_II, mN mm/nm: a row for each of the moments' components, a column for each fibre.
    pub gains: [[[f64; 3]; 2]; 2],
    /// From the tip to sections I and II, mm.
    pub distances_mm: [f64; 2],
    /// Wavelengths of the unloaded tool, nm: a row of fibres for each of the sections I, II, III.
    pub reference_nm: [[f64; 3]; 3],
    /// Standard deviation of one wavelength, nm.
    pub noise_nm: f64,
}

impl sherkit_sensor_calibration {
    /// The core's calibration.
    pub fn calibration(&self) -> Calibration {
        let gain = |[[a, b, c], [d, e, f]]: [[f64; 3]; 2]| Matrix2x3::new(a, b, c, d, e, f);
        Calibration {
            gains: self.gains.map(gain),
            distances_mm: self.distances_mm,
            reference_nm: self.reference_nm,
            noise_nm: self.noise_nm,
        }
    }
}

/// The fibres of a calibrated tool. Its content is nobody's business.
#[repr(C)]
pub struct sherkit_sensor {
    words: [u64; 64],
}

opaque!(sherkit_sensor, Sensor, 0x7368_6b73_656e_736f, 64);

/// What the fibres tell at one time.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sherkit_measurement {
    /// When the fibres were read, s, on the clock of the steps.
    pub time_s: f64,
    /// Sclera force, tool frame, mN.
    pub force_mn: [f64; 2],
    /// Its covariance, mN^2.
    pub force_covariance: [[f64; 2]; 2],
    /// Insertion depth, mm; not read where its variance is infinite.
    pub depth_mm: f64,
    /// Its variance, mm^2; infinite where there is no force that would tell the depth.
    pub depth_variance: f64,
    /// Covariance of depth with force, mm mN.
    pub depth_with_force: [f64; 2],
}

impl sherkit_measurement {
    /// What was read at a time.
    fn of(time_s: f64, reading: &Reading) -> Self {
        let c = &reading.force_covariance;
        let (depth_mm, depth_variance, depth_with_force) = match reading.depth {
            Depth::Measured {
                mm,
                variance,
                with_force,
            } => (mm, variance, with_force.into()),
            Depth::NoForce => (0.0, f64::INFINITY, [0.0; 2]),
        };
        Self {
            time_s,
            force_mn: reading.force.into(),
            force_covariance: [[c.m11, c.m12], [c.m21, c.m22]],
            depth_mm,
            depth_variance,
            depth_with_force,
        }
    }

    /// What could not be read.
    fn none(time_s: f64) -> Self {
        Self {
            time_s,
            force_mn: [f64::NAN; 2],
            force_covariance: [[f64::NAN; 2]; 2],
            depth_mm: f64::NAN,
            depth_variance: f64::NAN,
            depth_with_force: [f64::NAN; 2],
        }
    }
}

/// Length and stiffness of the shaft.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sherkit_beam {
    /// Free length h, mm.
    pub length_mm: f64,
    /// Bending stiffness EI, mN mm^2.
    pub stiffness: f64,
}

impl sherkit_beam {
    /// The core's beam.
    pub fn beam(&self) -> Result<Beam, sherkit_result> {
        coded(Beam::new(self.length_mm, self.stiffness))
    }
}

/// Pose of the tool: takes tool coordinates to the base frame. The tool's z axis runs along the unbent shaft and out
/// of the tip, its origin is where the unbent tip would be.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sherkit_pose {
    /// Rotation, rows.
    pub rotation: [[f64; 3]; 3],
    /// Where the origin goes, mm.
    pub translation_mm: [f64; 3],
}

impl From<&sherkit_pose> for Rigid {
    fn from(pose: &sherkit_pose) -> Self {
        Self {
            rotation: Matrix3::from(pose.rotation).transpose(),
            translation: Vector3::from(pose.translation_mm),
        }
    }
}

/// The tool of Ebrahimi et al. 2020: 60 mm, 3 EI = 3.39e6 mN mm^2.
#[unsafe(no_mangle)]
pub extern "C" fn sherkit_beam_ebrahimi_2020() -> sherkit_beam {
    let beam = Beam::ebrahimi_2020();
    sherkit_beam {
        length_mm: beam.length_mm(),
        stiffness: beam.stiffness(),
    }
}

/// Prepares the fibres. Where it fails the sensor is not initialised.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_sensor_init(
    sensor: *mut sherkit_sensor,
    calibration: *const sherkit_sensor_calibration,
) -> sherkit_result {
    let made = || {
        // SAFETY: pointers are null or valid.
        let c = unsafe { given(calibration)? };
        coded(Sensor::new(c.calibration()))
    };
    // SAFETY: as above.
    answer(unsafe { init(sensor, made) })
}

/// Force and depth from wavelengths (9, nm; three fibres at each of the sections I, II, III) read at a time. With
/// SHERKIT_NOT_FINITE the measurement is written too, all NaN but the time.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sherkit_sensor_read(
    sensor: *const sherkit_sensor,
    time_s: f64,
    wavelengths_nm: *const f64,
    measurement: *mut sherkit_measurement,
) -> sherkit_result {
    let run = || {
        // SAFETY: pointers are null or valid.
        let (sensor, wavelengths, measurement) = unsafe {
            (
                get(sensor)?,
                given(wavelengths_nm.cast::<[[f64; 3]; 3]>())?,
                wanted(measurement)?,
            )
        };
        let read = coded(sensor.read(wavelengths));
        *measurement = match &read {
            Ok(reading) => sherkit_measurement::of(time_s, reading),
            Err(_) => sherkit_measurement::none(time_s),
        };
        read.map(|_| ())
    };
    answer(run())
}
