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

mod read;
mod write;

pub use read::{read_delta, read_serial, read_spherical};
pub use write::{write_delta, write_serial, write_spherical};

use crate::camera::{Description, Face};
use crate::delta;
use crate::delta::correction::{Correction, Domain};
use crate::numbers::rigid::Rigid;
use crate::serial::{self, Limits};
use crate::spherical::{self, Elbows};
use crate::{Error, Result};

/// Version of the layout.
const VERSION: f64 = 6.0;
const DELTA: f64 = 1.0;
const SPHERICAL: f64 = 2.0;
const SERIAL: f64 = 3.0;

/// Numbers at the end of each kind's parameters that rows from before do not hold: how fast the instrument's pose changes,
/// a delta's bar, and two of each joint for the second wave of its encoder.
const LATER_OF_DELTA: &[usize] = &[6, 6 + 1, 6 + 1 + 2 * delta::LIMBS];
const LATER_OF_SPHERICAL: &[usize] = &[6, 6 + 2 * spherical::LIMBS];
const LATER_OF_SERIAL: &[usize] = &[6, 6 + 2 * serial::JOINTS];

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

fn refuse<T>(what: &'static str) -> Result<T> {
    Err(Error::Invalid { what })
}

/// A row that is written or read: what stands in it is said once, for both ways.
trait Row {
    /// Any number; it is put there, or taken from there.
    fn any(&mut self, value: &mut f64) -> Result<()>;

    /// How many of its `parameters` the row holds; rows from before there were the last of them lack as many as is `later`.
    fn head(&mut self, kind: f64, parameters: usize, later: &[usize]) -> Result<usize> {
        let [mut version, mut found, mut count] = [VERSION, kind, parameters as f64];
        for number in [&mut version, &mut found, &mut count] {
            self.any(number)?;
        }
        let known = core::iter::once(0)
            .chain(later.iter().copied())
            .map(|lacked| parameters - lacked)
            .find(|known| *known as f64 == count);
        let Some(known) = known.filter(|_| version == VERSION) else {
            return refuse("calibration: written by another version");
        };
        if found != kind {
            return refuse("calibration: that of another kind of robot");
        }
        Ok(known)
    }

    fn numbers<'n>(&mut self, values: impl IntoIterator<Item = &'n mut f64>) -> Result<()> {
        for value in values {
            self.any(value)?;
            if !value.is_finite() {
                return refuse("calibration: a number of the model is not finite");
            }
        }
        Ok(())
    }

    /// One of a few, by the number that stands for it.
    fn choice<T: Copy + PartialEq>(
        &mut self,
        value: &mut T,
        among: &[(f64, T)],
        otherwise: &'static str,
    ) -> Result<()> {
        let mut number = among
            .iter()
            .find_map(|(number, one)| (one == value).then_some(*number))
            .unwrap_or(f64::NAN);
        self.any(&mut number)?;
        let Some((_, found)) = among.iter().find(|(one, _)| *one == number) else {
            return refuse(otherwise);
        };
        *value = *found;
        Ok(())
    }

    fn flag(&mut self, value: &mut bool) -> Result<()> {
        let ways = [(0.0, false), (1.0, true)];
        self.choice(
            value,
            &ways,
            "calibration: what should be 0 or 1 is neither",
        )
    }

    /// Either of two by its sign.
    fn side<T: Copy + PartialEq>(&mut self, value: &mut T, plus: T, minus: T) -> Result<()> {
        let ways = [(1.0, plus), (-1.0, minus)];
        self.choice(
            value,
            &ways,
            "calibration: what should be 1 or -1 is neither",
        )
    }

    /// A turn row by row, and a shift.
    fn rigid(&mut self, value: &mut Rigid) -> Result<()> {
        let mut turn = value.rotation.transpose();
        self.numbers(&mut turn)?;
        value.rotation = turn.transpose();
        self.numbers(&mut value.translation)
    }

    /// Corners, which may be infinite where a variable has order zero, and the blend.
    fn domain(&mut self, value: &mut Domain) -> Result<()> {
        let numbers = value.low.iter_mut().chain(&mut value.high);
        for number in numbers.chain([&mut value.fade]) {
            self.any(number)?;
        }
        let ordered = (value.low.iter().zip(&value.high)).all(|(low, high)| low <= high);
        if ordered && value.fade >= 0.0 && value.fade.is_finite() {
            Ok(())
        } else {
            refuse("calibration: a box or its fade is none")
        }
    }

    /// A delta as drawn, and the first `known` values of its parameters.
    fn delta(
        &mut self,
        model: &mut delta::Model,
        values: &mut delta::Values,
        known: usize,
    ) -> Result<()> {
        let (mut assembly, mut geometry) = (model.geometry.assembly, model.geometry.parameters());
        self.side(
            &mut assembly,
            delta::Assembly::Below,
            delta::Assembly::Above,
        )?;
        self.numbers(&mut geometry)?;
        model.geometry = delta::Geometry::from_parameters(&geometry, assembly);
        self.numbers(&mut model.target_offset)?;
        self.rigid(&mut model.sensor)?;
        self.numbers([&mut model.rod_spacing])?;
        self.numbers(&mut model.pole_pitch)?;
        self.numbers(&mut model.home)?;
        self.numbers([
            &mut model.time_origin_s,
            &mut model.slip_time_s,
            &mut model.joint_slip_time_s,
            &mut model.sensor_slip_time_s,
        ])?;
        self.numbers(values.iter_mut().take(known))
    }

    fn spherical(
        &mut self,
        model: &mut spherical::Model,
        elbows: &mut Elbows,
        values: &mut spherical::Values,
        known: usize,
    ) -> Result<()> {
        use spherical::Assembly::{Inner, Outer};
        let (mut assembly, mut geometry) = (model.geometry.assembly, model.geometry.parameters());
        self.side(&mut assembly, Outer, Inner)?;
        self.numbers(&mut geometry)?;
        model.geometry = spherical::Geometry::from_parameters(&geometry, assembly);
        self.numbers([&mut model.radius_mm])?;
        let mut camera = model.camera.parameters();
        self.numbers(&mut camera)?;
        model.camera = Description::from_parameters(&camera);
        self.side(&mut model.face, Face::Near, Face::Far)?;
        self.numbers(&mut model.gravity)?;
        self.numbers(&mut model.home)?;
        self.numbers([
            &mut model.time_origin_s,
            &mut model.slip_time_s,
            &mut model.joint_slip_time_s,
        ])?;
        self.numbers(&mut model.encoder_period)?;
        self.numbers([&mut model.sensor_slip_time_s])?;
        let ways = [Elbows::Open, Elbows::Crossed, Elbows::Ahead, Elbows::Behind];
        let mut each = [(0.0, Elbows::Open); 4];
        for (k, (one, way)) in each.iter_mut().zip(ways).enumerate() {
            *one = (k as f64, way);
        }
        self.choice(elbows, &each, "calibration: the elbows stand nowhere")?;
        self.numbers(values.iter_mut().take(known))
    }

    fn serial(
        &mut self,
        model: &mut serial::Model,
        limits: &mut Limits,
        values: &mut serial::Values,
        known: usize,
    ) -> Result<()> {
        let mut count = model.count as f64;
        self.any(&mut count)?;
        let Some(count) = (1..=serial::JOINTS).find(|k| *k as f64 == count) else {
            return refuse("calibration: an arm has one to nine joints");
        };
        model.count = count;
        let ranges = limits.low.iter_mut().zip(&mut limits.high);
        for (joint, (low, high)) in model.joints.iter_mut().zip(ranges).take(count) {
            self.rigid(&mut joint.fixed)?;
            self.flag(&mut joint.prismatic)?;
            self.numbers([&mut joint.follows, &mut joint.home, &mut joint.mass_kg])?;
            self.numbers(&mut joint.centre_mm)?;
            self.numbers([low, high])?;
        }
        for point in model.targets_mm.iter_mut().chain(&mut model.centres_mm) {
            self.numbers(point)?;
        }
        self.rigid(&mut model.sensor)?;
        self.numbers(&mut model.gravity)?;
        self.numbers(model.encoder_period.iter_mut().take(count))?;
        self.numbers([
            &mut model.time_origin_s,
            &mut model.slip_time_s,
            &mut model.joint_slip_time_s,
        ])?;
        self.numbers(values.iter_mut().take(known))
    }
}
