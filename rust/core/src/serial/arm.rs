//! An arm as drawn: its joints, what it carries, and what stands around it.

use crate::chain::{CENTRES, Flat, PLANES};
use crate::numbers::rigid::Rigid;
use nalgebra::{Matrix3, Vector3};

/// The most joints that an arm may have.
pub const JOINTS: usize = 9;
/// Targets that an arm may carry.
pub const TARGETS: usize = 4;

/// A joint as drawn, which turns about or slides along the z of its own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// From the frame behind the joint before it, or the base, to its own at zero; mm.
    pub fixed: Rigid,
    /// Whether it slides.
    pub prismatic: bool,
    /// Part of the reading of the joint before it by which it moves besides, as drawn: one or minus one behind a
    /// parallelogram.
    pub follows: f64,
    /// Reading about which scale errors turn, rad or mm.
    pub home: f64,
    /// Mass of the link behind it, kg, or in any other unit that is the same for all.
    pub mass_kg: f64,
    /// Centre of that mass in the frame behind the joint, mm.
    pub centre_mm: Vector3<f64>,
}

impl Joint {
    /// One that is not there.
    pub const NONE: Self = Self {
        fixed: Rigid {
            rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
            translation: Vector3::new(0.0, 0.0, 0.0),
        },
        prismatic: true,
        follows: 0.0,
        home: 0.0,
        mass_kg: 0.0,
        centre_mm: Vector3::new(0.0, 0.0, 0.0),
    };
}

/// A nominal arm and the settings of its effects.
#[derive(Clone, Copy, Debug)]
pub struct Model {
    /// Its joints from the base on; those beyond [`Model::count`] are not looked at.
    pub joints: [Joint; JOINTS],
    /// How many it has.
    pub count: usize,
    /// Its targets in the frame behind the last joint, mm; the first is what it brings somewhere.
    pub targets_mm: [Vector3<f64>; TARGETS],
    /// The fixed centres from which distances are read, base frame, mm.
    pub centres_mm: [Vector3<f64>; CENTRES],
    /// The fixed planes from which distances are read.
    pub planes: [Flat; PLANES],
    /// From the base frame to that of the sensor, mm.
    pub sensor: Rigid,
    /// Direction of the weight, base frame, of length one.
    pub gravity: Vector3<f64>,
    /// Period of the cyclic error of each joint's gear or encoder, rad, or mm of one that slides.
    pub encoder_period: [f64; JOINTS],
    /// Time from which drift counts, s.
    pub time_origin_s: f64,
    /// Moment at which the target slips, s.
    pub slip_time_s: f64,
    /// Moment at which joints slip, s.
    pub joint_slip_time_s: f64,
    /// Moment at which the sensor slips, s.
    pub sensor_slip_time_s: f64,
}
