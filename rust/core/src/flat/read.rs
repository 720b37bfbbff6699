//! A calibrated robot from its numbers; what is no calibration is refused.

use super::{
    DELTA, LATER_OF_DELTA, LATER_OF_SERIAL, LATER_OF_SPHERICAL, Row, SERIAL, SPHERICAL, refuse,
};
use crate::camera::{self, Description, Face};
use crate::chain::{CENTRES, Flat, Frame, PLANES, Robot};
use crate::delta::correction::{Correction, Domain, MAX_ORDER, coefficients_len};
use crate::delta::{self, Branch, Calibrated};
use crate::numbers::rigid::Rigid;
use crate::serial::{self, Joint, Limits};
use crate::spherical::{self, Elbows, Readings};
use crate::{Error, Result};
use nalgebra::Vector3;

/// What is left of a row.
struct Reader<'a>(&'a [f64]);

const SHORT: Error = Error::Invalid {
    what: "calibration: the row of numbers ends too early",
};

impl Row for Reader<'_> {
    fn any(&mut self, value: &mut f64) -> Result<()> {
        let (found, left) = self.0.split_first().ok_or(SHORT)?;
        (*value, self.0) = (*found, left);
        Ok(())
    }
}

const ANYWHERE: Domain = Domain {
    low: Vector3::new(0.0, 0.0, 0.0),
    high: Vector3::new(0.0, 0.0, 0.0),
    fade: 0.0,
};

impl<'a> Reader<'a> {
    fn end(&self) -> Result<()> {
        if self.0.is_empty() {
            Ok(())
        } else {
            refuse("calibration: the row of numbers is too long")
        }
    }

    fn correction(&mut self) -> Result<Option<Correction<'a>>> {
        let (mut there, mut domain) = (false, ANYWHERE);
        self.flag(&mut there)?;
        if !there {
            return Ok(None);
        }
        let mut orders = [0; 3];
        for order in &mut orders {
            let mut found = 0.0;
            self.any(&mut found)?;
            *order = (0..=MAX_ORDER)
                .find(|k| *k as f64 == found)
                .ok_or(Error::Invalid {
                    what: "calibration: an order of the correction is none",
                })?;
        }
        self.domain(&mut domain)?;
        let (numbers, tail) = self
            .0
            .split_at_checked(3 * coefficients_len(orders))
            .ok_or(SHORT)?;
        self.0 = tail;
        if !numbers.iter().all(|x| x.is_finite()) {
            return refuse("calibration: a coefficient is not finite");
        }
        Correction::new(orders, domain, numbers.as_chunks::<3>().0).map(Some)
    }

    fn branch(&mut self, known: usize) -> Result<Branch<'a>> {
        let mut values = [0.0; delta::PARAMETERS];
        let mut model = delta::Model {
            geometry: delta::Geometry::from_parameters(
                &[0.0; delta::GEOMETRIC],
                delta::Assembly::Below,
            ),
            target_offset: Vector3::zeros(),
            sensor: Rigid::identity(),
            rod_spacing: 0.0,
            pole_pitch: [1.0; delta::LIMBS],
            home: [0.0; delta::LIMBS],
            time_origin_s: 0.0,
            slip_time_s: 0.0,
            joint_slip_time_s: 0.0,
            sensor_slip_time_s: 0.0,
        };
        self.delta(&mut model, &mut values, known)?;
        Ok(Branch::new(&model.with(&values)?, self.correction()?))
    }
}

/// Reads a calibrated delta.
///
/// # Errors
/// [`Error::Invalid`] says what the row lacks; otherwise as [`Robot::with`].
pub fn read_delta(numbers: &[f64]) -> Result<Calibrated<'_>> {
    let (mut row, mut there, mut region) = (Reader(numbers), false, ANYWHERE);
    let known = row.head(DELTA, delta::PARAMETERS, LATER_OF_DELTA)?;
    let whole = row.branch(known)?;
    row.flag(&mut there)?;
    let local = if there {
        row.domain(&mut region)?;
        Some((row.branch(known)?, region))
    } else {
        None
    };
    row.end()?;
    Ok(Calibrated {
        whole,
        local,
        frame: Frame::Sensor,
    })
}

/// Reads a calibrated spherical robot.
///
/// # Errors
/// [`Error::Invalid`] says what the row lacks; otherwise as [`Robot::with`].
pub fn read_spherical(numbers: &[f64]) -> Result<spherical::Calibrated> {
    let (mut row, mut elbows, mut values) =
        (Reader(numbers), Elbows::Open, [0.0; spherical::PARAMETERS]);
    let mut model = spherical::Model {
        geometry: spherical::Geometry::equal(0.0, 0.0),
        radius_mm: 0.0,
        camera: Description::from_parameters(&[0.0; camera::PARAMETERS]),
        face: Face::Near,
        readings: Readings::Angles,
        gravity: Vector3::zeros(),
        home: [0.0; spherical::LIMBS],
        time_origin_s: 0.0,
        slip_time_s: 0.0,
        joint_slip_time_s: 0.0,
        encoder_period: [1.0; spherical::LIMBS],
        sensor_slip_time_s: 0.0,
    };
    let known = row.head(SPHERICAL, spherical::PARAMETERS, LATER_OF_SPHERICAL)?;
    row.spherical(&mut model, &mut elbows, &mut values, known)?;
    row.end()?;
    spherical::Calibrated::new(&model, &values, elbows)
}

/// Reads a calibrated arm.
///
/// # Errors
/// [`Error::Invalid`] says what the row lacks; otherwise as [`Robot::with`].
pub fn read_serial(numbers: &[f64]) -> Result<serial::Calibrated> {
    let (mut row, mut values) = (Reader(numbers), [0.0; serial::PARAMETERS]);
    let mut limits = Limits {
        low: [0.0; serial::JOINTS],
        high: [0.0; serial::JOINTS],
    };
    let mut model = serial::Model {
        joints: [Joint::NONE; serial::JOINTS],
        count: 0,
        targets_mm: [Vector3::zeros(); serial::TARGETS],
        centres_mm: [Vector3::zeros(); CENTRES],
        // what its distances were read from has no part in where its target is
        planes: [Flat::GROUND; PLANES],
        sensor: Rigid::identity(),
        gravity: Vector3::zeros(),
        encoder_period: [1.0; serial::JOINTS],
        time_origin_s: 0.0,
        slip_time_s: 0.0,
        joint_slip_time_s: 0.0,
        sensor_slip_time_s: 0.0,
    };
    let known = row.head(SERIAL, serial::PARAMETERS, LATER_OF_SERIAL)?;
    row.serial(&mut model, &mut limits, &mut values, known)?;
    row.end()?;
    serial::Calibrated::new(&model, &values, &limits)
}
