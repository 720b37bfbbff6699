//! What the drawing and the user say of a spherical robot and its camera.

use super::geometry::{Geometry, LIMBS};
use crate::camera::{Description, Face};
use nalgebra::Vector3;

/// What a run reads, throughout.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Readings {
    /// Pixel of the marker, u and v.
    #[default]
    Pixels,
    /// Direction of the marker seen from the nominal centre, φ and γ, rad.
    Angles,
}

/// Nominal robot and camera, and the settings of the effects: what the drawing and the user say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// Nominal geometry.
    pub geometry: Geometry,
    /// Nominal radius of the sphere on which the marker moves, mm.
    pub radius_mm: f64,
    /// Nominal camera; where angles are read, nobody looks through it.
    pub camera: Description,
    /// Side of the sphere that the camera sees.
    pub face: Face,
    /// What is read.
    pub readings: Readings,
    /// Direction in which the weight pulls, base frame, of any length but zero.
    pub gravity: Vector3<f64>,
    /// Joint readings of the home position, rad, about which scale errors turn.
    pub home: [f64; LIMBS],
    /// Time from which drift counts, s.
    pub time_origin_s: f64,
    /// Moment of the slip, s.
    pub slip_time_s: f64,
    /// Moment at which joints slip, s.
    pub joint_slip_time_s: f64,
    /// Period of each encoder's cyclic error, rad.
    pub encoder_period: [f64; LIMBS],
    /// Moment of the slip of the camera, s.
    pub sensor_slip_time_s: f64,
}
