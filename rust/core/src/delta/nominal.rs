//! What the drawing and the user say of a delta.

use super::geometry::{Geometry, LIMBS};
use crate::numbers::rigid::Rigid;
use nalgebra::Vector3;

/// Nominal robot and the settings of its effects: what the drawing and the user say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// Nominal geometry.
    pub geometry: Geometry,
    /// From the platform centre to the measured point, mm.
    pub target_offset: Vector3<f64>,
    /// From the base frame to that of the sensors, mm.
    pub sensor: Rigid,
    /// Distance between the two rods of a limb, mm; zero where the platform cannot tilt.
    pub rod_spacing: f64,
    /// Period of each encoder's cyclic error, mm.
    pub pole_pitch: [f64; LIMBS],
    /// Joint readings of the home position, mm, about which scale errors and leans turn.
    pub home: [f64; LIMBS],
    /// Time from which drift counts, s.
    pub time_origin_s: f64,
    /// Moment of the slip, s.
    pub slip_time_s: f64,
    /// Moment at which joints slip, s.
    pub joint_slip_time_s: f64,
    /// Moment at which the sensors slip, s.
    pub sensor_slip_time_s: f64,
}
