//! A calibrated robot as a row of numbers: what one program writes and a control loop in another language reads.
//!
//! Every entry is an `f64`, so that nothing depends on word size, padding or byte order but that of the numbers.
//! The row begins with the version of the layout, the kind of robot and the number of its parameters. A reader refuses
//! what it does not know, and numbers from which the robot could not compute. A delta's coefficients are not copied:
//! the row must outlive the robot that is read from it.
//!
//! Delta (kind 1): branch of the whole workspace; 1 and low corner, high corner and blend of the region, and its
//! branch, or 0. A branch is a model (assembly ±1, 18 geometric parameters, target offset, pose of the sensors (turn row by
//! row, shift), rod spacing, pole pitch of each joint, home, time origin, slip times of point, joints and sensors), the values of all parameters, and 1 and orders, low corner, high corner, fade and
//! coefficients of its correction, or 0. Spherical (kind 2): assembly ±1, 6 geometric parameters, radius, the camera's 15,
//! face ±1, gravity, home, time origin, slip times of marker and joints, period of each encoder, slip time of the
//! camera, place of the elbows (0 open, 1 crossed, 2 ahead,
//! 3 behind), the values of all parameters. Serial (kind 3): number of joints, of each its frame behind the one before it
//! (turn row by row, shift), 1 where it slides, by how much it follows the one before, home, mass and the centre of it, lowest and highest reading; 4 targets,
//! 8 centres, pose of the sensor, gravity, period of each joint, time origin, slip times of target and joints, the values of
//! all parameters.

use crate::camera::{Description, Face};
use crate::chain::{Flat, Frame, PLANES, Robot};
use crate::delta;
use crate::delta::correction::{Correction, Domain, MAX_ORDER, coefficients_len};
use crate::delta::{Branch, Calibrated};
use crate::numbers::rigid::Rigid;
use crate::serial::{self, Joint, Limits};
use crate::spherical::{self, Elbows, Readings};
use crate::{Error, Result};
use nalgebra::{Matrix3, Vector3};

/// Version of the layout.
const VERSION: f64 = 6.0;
const DELTA: f64 = 1.0;
const SPHERICAL: f64 = 2.0;
const SERIAL: f64 = 3.0;

/// What a branch of a calibrated delta is made from.
#[derive(Clone, Copy, Debug)]
pub struct BranchParts<'a> {
    /// Nominal robot.
    pub model: &'a delta::Model,
    /// Values of all its parameters.
    pub values: &'a delta::Values,
    /// What they leave.
    pub correction: Option<Correction<'a>>,
}

/// Writes a calibrated delta, number by number.
pub fn write_delta(
    whole: &BranchParts<'_>,
    local: Option<(&BranchParts<'_>, &Domain)>,
    mut put: impl FnMut(f64),
) {
    let parameters = delta::PARAMETERS as f64;
    [VERSION, DELTA, parameters].into_iter().for_each(&mut put);
    write_branch(whole, &mut put);
    match local {
        None => put(0.0),
        Some((branch, region)) => {
            put(1.0);
            write_domain(region, &mut put);
            write_branch(branch, &mut put);
        }
    }
}

fn write_branch(parts: &BranchParts<'_>, put: &mut impl FnMut(f64)) {
    let m = parts.model;
    put(m.geometry.assembly.sign());
    m.geometry.parameters().into_iter().for_each(&mut *put);
    m.target_offset.iter().copied().for_each(&mut *put);
    write_rigid(&m.sensor, put);
    put(m.rod_spacing);
    let settings = m.pole_pitch.into_iter().chain(m.home);
    settings.for_each(&mut *put);
    [
        m.time_origin_s,
        m.slip_time_s,
        m.joint_slip_time_s,
        m.sensor_slip_time_s,
    ]
    .into_iter()
    .for_each(&mut *put);
    parts.values.iter().copied().for_each(&mut *put);
    match &parts.correction {
        None => put(0.0),
        Some(correction) => {
            put(1.0);
            let orders = correction.orders().map(|order| order as f64);
            orders.into_iter().for_each(&mut *put);
            write_domain(correction.domain(), put);
            let coefficients = correction.coefficients().as_flattened();
            coefficients.iter().copied().for_each(put);
        }
    }
}

fn write_rigid(rigid: &Rigid, put: &mut impl FnMut(f64)) {
    let turn = rigid.rotation.transpose();
    let numbers = turn.iter().chain(&rigid.translation);
    numbers.copied().for_each(put);
}

fn write_domain(domain: &Domain, put: &mut impl FnMut(f64)) {
    let corners = domain.low.iter().chain(&domain.high);
    corners.copied().for_each(&mut *put);
    put(domain.fade);
}

/// Writes a calibrated spherical robot, number by number.
pub fn write_spherical(
    model: &spherical::Model,
    values: &spherical::Values,
    elbows: Elbows,
    mut put: impl FnMut(f64),
) {
    let parameters = spherical::PARAMETERS as f64;
    [VERSION, SPHERICAL, parameters]
        .into_iter()
        .for_each(&mut put);
    put(model.geometry.assembly.sign());
    model.geometry.parameters().into_iter().for_each(&mut put);
    put(model.radius_mm);
    model.camera.parameters().into_iter().for_each(&mut put);
    put(match model.face {
        Face::Near => 1.0,
        Face::Far => -1.0,
    });
    model.gravity.iter().copied().for_each(&mut put);
    model.home.into_iter().for_each(&mut put);
    put(model.time_origin_s);
    put(model.slip_time_s);
    put(model.joint_slip_time_s);
    model.encoder_period.into_iter().for_each(&mut put);
    put(model.sensor_slip_time_s);
    put(match elbows {
        Elbows::Open => 0.0,
        Elbows::Crossed => 1.0,
        Elbows::Ahead => 2.0,
        Elbows::Behind => 3.0,
    });
    values.iter().copied().for_each(&mut put);
}

/// Writes a calibrated arm, number by number.
pub fn write_serial(
    model: &serial::Model,
    values: &serial::Values,
    limits: &Limits,
    mut put: impl FnMut(f64),
) {
    [
        VERSION,
        SERIAL,
        serial::PARAMETERS as f64,
        model.count as f64,
    ]
    .into_iter()
    .for_each(&mut put);
    let ranges = limits.low.iter().zip(&limits.high);
    for (joint, (low, high)) in model.joints.iter().zip(ranges).take(model.count) {
        write_rigid(&joint.fixed, &mut put);
        put(if joint.prismatic { 1.0 } else { 0.0 });
        [joint.follows, joint.home, joint.mass_kg]
            .into_iter()
            .for_each(&mut put);
        joint.centre_mm.iter().copied().for_each(&mut put);
        [*low, *high].into_iter().for_each(&mut put);
    }
    let points = model.targets_mm.iter().chain(&model.centres_mm);
    points.flatten().copied().for_each(&mut put);
    write_rigid(&model.sensor, &mut put);
    model.gravity.iter().copied().for_each(&mut put);
    let periods = model.encoder_period.iter().take(model.count);
    periods.copied().for_each(&mut put);
    put(model.time_origin_s);
    put(model.slip_time_s);
    put(model.joint_slip_time_s);
    values.iter().copied().for_each(&mut put);
}

/// What is left of a row.
struct Reader<'a>(&'a [f64]);

const SHORT: Error = Error::Invalid {
    what: "calibration: the row of numbers ends too early",
};

fn refuse<T>(what: &'static str) -> Result<T> {
    Err(Error::Invalid { what })
}

impl<'a> Reader<'a> {
    fn take<const N: usize>(&mut self) -> Result<[f64; N]> {
        let (head, tail) = self.0.split_first_chunk::<N>().ok_or(SHORT)?;
        self.0 = tail;
        Ok(*head)
    }

    fn one(&mut self) -> Result<f64> {
        self.take::<1>().map(|[x]| x)
    }

    fn finite<const N: usize>(&mut self) -> Result<[f64; N]> {
        let found = self.take()?;
        if found.iter().all(|x: &f64| x.is_finite()) {
            Ok(found)
        } else {
            refuse("calibration: a number of the model is not finite")
        }
    }

    fn points<const N: usize>(&mut self) -> Result<[Vector3<f64>; N]> {
        let mut out = [Vector3::zeros(); N];
        for point in &mut out {
            *point = Vector3::from(self.finite::<3>()?);
        }
        Ok(out)
    }

    fn rigid(&mut self) -> Result<Rigid> {
        Ok(Rigid {
            rotation: Matrix3::from_row_slice(&self.finite::<9>()?),
            translation: Vector3::from(self.finite::<3>()?),
        })
    }

    /// Those of the joints that an arm has; of others no number is asked.
    fn periods(&mut self, count: usize) -> Result<[f64; serial::JOINTS]> {
        let mut out = [1.0; serial::JOINTS];
        for period in out.iter_mut().take(count) {
            [*period] = self.finite()?;
        }
        Ok(out)
    }

    fn flag(&mut self) -> Result<bool> {
        match self.one()? {
            0.0 => Ok(false),
            1.0 => Ok(true),
            _ => refuse("calibration: what should be 0 or 1 is neither"),
        }
    }

    /// Either of two by its sign.
    fn side<T>(&mut self, plus: T, minus: T) -> Result<T> {
        match self.one()? {
            1.0 => Ok(plus),
            -1.0 => Ok(minus),
            _ => refuse("calibration: what should be 1 or -1 is neither"),
        }
    }

    /// How many of its `parameters` the row holds: a row from before encoders had a second wave lacks the last, two of
    /// each of its `joints`.
    fn head(&mut self, kind: f64, parameters: usize, joints: usize) -> Result<usize> {
        let [version, found, count] = self.take()?;
        let known = [parameters, parameters - 2 * joints]
            .into_iter()
            .find(|known| *known as f64 == count);
        let Some(known) = known.filter(|_| version == VERSION) else {
            return refuse("calibration: written by another version");
        };
        if found != kind {
            return refuse("calibration: that of another kind of robot");
        }
        Ok(known)
    }

    /// Values of all parameters, of which the row holds the first.
    fn values<const N: usize>(&mut self, known: usize) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for value in values.iter_mut().take(known) {
            [*value] = self.finite()?;
        }
        Ok(values)
    }

    fn end(&self) -> Result<()> {
        if self.0.is_empty() {
            Ok(())
        } else {
            refuse("calibration: the row of numbers is too long")
        }
    }

    /// Corners may be infinite where a variable has order zero.
    fn domain(&mut self) -> Result<Domain> {
        let [low, high] = [self.take::<3>()?, self.take::<3>()?];
        let fade = self.one()?;
        let ordered = low.iter().zip(&high).all(|(low, high)| low <= high);
        if !(ordered && fade >= 0.0 && fade.is_finite()) {
            return refuse("calibration: a box or its fade is none");
        }
        Ok(Domain {
            low: Vector3::from(low),
            high: Vector3::from(high),
            fade,
        })
    }

    fn correction(&mut self) -> Result<Option<Correction<'a>>> {
        if !self.flag()? {
            return Ok(None);
        }
        let mut orders = [0; 3];
        for (order, found) in orders.iter_mut().zip(self.take::<3>()?) {
            *order = (0..=MAX_ORDER)
                .find(|k| *k as f64 == found)
                .ok_or(Error::Invalid {
                    what: "calibration: an order of the correction is none",
                })?;
        }
        let domain = self.domain()?;
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
        let assembly = self.side(delta::Assembly::Below, delta::Assembly::Above)?;
        let geometry = self.finite()?;
        let target_offset = Vector3::from(self.finite::<3>()?);
        let sensor = self.rigid()?;
        let [rod_spacing] = self.finite()?;
        let [pole_pitch, home] = [self.finite()?, self.finite()?];
        let [
            time_origin_s,
            slip_time_s,
            joint_slip_time_s,
            sensor_slip_time_s,
        ] = self.finite()?;
        let model = delta::Model {
            geometry: delta::Geometry::from_parameters(&geometry, assembly),
            target_offset,
            sensor,
            rod_spacing,
            pole_pitch,
            home,
            time_origin_s,
            slip_time_s,
            joint_slip_time_s,
            sensor_slip_time_s,
        };
        Ok(Branch::new(
            &model.with(&self.values(known)?)?,
            self.correction()?,
        ))
    }
}

/// Reads a calibrated delta.
///
/// # Errors
/// [`Error::Invalid`] says what the row lacks; otherwise as [`Robot::with`].
pub fn read_delta(numbers: &[f64]) -> Result<Calibrated<'_>> {
    let mut row = Reader(numbers);
    let known = row.head(DELTA, delta::PARAMETERS, delta::LIMBS)?;
    let whole = row.branch(known)?;
    let local = if row.flag()? {
        let region = row.domain()?;
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
    let mut row = Reader(numbers);
    let known = row.head(SPHERICAL, spherical::PARAMETERS, spherical::LIMBS)?;
    let assembly = row.side(spherical::Assembly::Outer, spherical::Assembly::Inner)?;
    let model = spherical::Model {
        geometry: spherical::Geometry::from_parameters(&row.finite()?, assembly),
        radius_mm: row.finite::<1>()?[0],
        camera: Description::from_parameters(&row.finite()?),
        face: row.side(Face::Near, Face::Far)?,
        readings: Readings::Angles,
        gravity: Vector3::from(row.finite::<3>()?),
        home: row.finite()?,
        time_origin_s: row.finite::<1>()?[0],
        slip_time_s: row.finite::<1>()?[0],
        joint_slip_time_s: row.finite::<1>()?[0],
        encoder_period: row.finite()?,
        sensor_slip_time_s: row.finite::<1>()?[0],
    };
    let elbows = match row.one()? {
        0.0 => Elbows::Open,
        1.0 => Elbows::Crossed,
        2.0 => Elbows::Ahead,
        3.0 => Elbows::Behind,
        _ => return refuse("calibration: the elbows stand nowhere"),
    };
    let values = row.values(known)?;
    row.end()?;
    spherical::Calibrated::new(&model, &values, elbows)
}

/// Reads a calibrated arm.
///
/// # Errors
/// [`Error::Invalid`] says what the row lacks; otherwise as [`Robot::with`].
pub fn read_serial(numbers: &[f64]) -> Result<serial::Calibrated> {
    let mut row = Reader(numbers);
    let known = row.head(SERIAL, serial::PARAMETERS, serial::JOINTS)?;
    let found = row.one()?;
    let Some(count) = (1..=serial::JOINTS).find(|k| *k as f64 == found) else {
        return refuse("calibration: an arm has one to nine joints");
    };
    let mut joints = [Joint::NONE; serial::JOINTS];
    let mut limits = Limits {
        low: [0.0; serial::JOINTS],
        high: [0.0; serial::JOINTS],
    };
    let ranges = limits.low.iter_mut().zip(&mut limits.high);
    for (joint, (low, high)) in joints.iter_mut().zip(ranges).take(count) {
        joint.fixed = row.rigid()?;
        joint.prismatic = row.flag()?;
        [joint.follows, joint.home, joint.mass_kg] = row.finite()?;
        joint.centre_mm = Vector3::from(row.finite::<3>()?);
        [*low, *high] = row.finite()?;
    }
    let model = serial::Model {
        joints,
        count,
        targets_mm: row.points()?,
        centres_mm: row.points()?,
        // what its distances were read from has no part in where its target is
        planes: [Flat::GROUND; PLANES],
        sensor: row.rigid()?,
        gravity: Vector3::from(row.finite::<3>()?),
        encoder_period: row.periods(count)?,
        time_origin_s: row.finite::<1>()?[0],
        slip_time_s: row.finite::<1>()?[0],
        joint_slip_time_s: row.finite::<1>()?[0],
        sensor_slip_time_s: 0.0,
    };
    let values = row.values(known)?;
    row.end()?;
    serial::Calibrated::new(&model, &values, &limits)
}
