//! Rows of a run: where the joints were, what else is known; readings at one place, or a distance between two places,
//! in which the datum cancels.

use nalgebra::{SMatrix, SVector, Vector3};

/// What a row brings besides its readings. NaN where it is not known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariates<const J: usize> {
    /// Time of the reading, s.
    pub time_s: f64,
    /// Temperature, °C.
    pub temperature_c: f64,
    /// Temperature of what the instrument and the robot stand on, °C: that of the room, later. A control loop, which has no
    /// instrument, leaves it where the drawing was made.
    pub stand_c: f64,
    /// What hangs at the target besides the robot's own weight, kg.
    pub payload_kg: f64,
    /// Direction of the last motion of each joint, ±1 or 0.
    pub direction: [f64; J],
    /// Velocity of each joint, its unit by s.
    pub velocity: [f64; J],
}

impl<const J: usize> Covariates<J> {
    /// Nothing known.
    pub const NONE: Self = Self {
        time_s: f64::NAN,
        temperature_c: f64::NAN,
        stand_c: f64::NAN,
        payload_kg: f64::NAN,
        direction: [f64::NAN; J],
        velocity: [f64::NAN; J],
    };
}

/// Something that stands fixed, by its number, from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fixed {
    /// A centre.
    Centre(usize),
    /// A plane: how far above it.
    Plane(usize),
}

/// What of a robot was read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Aim {
    /// Which of its targets, from 0.
    pub target: usize,
    /// From where the distance of the target was read, instead of its place.
    pub from: Option<Fixed>,
}

/// A row: where the joints were, what else is known, what was read there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row<const J: usize> {
    /// Joint readings, mm or rad.
    pub joints: [f64; J],
    /// Joint readings at the other end, where a distance was read instead of the place.
    pub to: Option<[f64; J]>,
    /// Which target, and from where.
    pub aim: Aim,
    /// Time, temperature, directions, velocities.
    pub covariates: Covariates<J>,
    /// Added to the measured point before the sensor sees it, mm: a user's own effect. Of a distance between two places, by
    /// how much more its first end is displaced than the other.
    pub push: Vector3<f64>,
}

/// Reading of one row with its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Prediction<const J: usize, const M: usize, const P: usize> {
    /// What the sensor would show.
    pub value: SVector<f64, M>,
    /// By the joint readings; of a distance between two places by those of its first end.
    pub by_joints: SMatrix<f64, M, J>,
    /// By a displacement of the measured point, mm; of the first end alone as above.
    pub by_body: SMatrix<f64, M, 3>,
    /// By the parameters, one column each.
    pub by_parameters: SMatrix<f64, M, P>,
}

impl<const J: usize, const M: usize, const P: usize> Prediction<J, M, P> {
    /// Room for a prediction.
    #[must_use]
    pub fn new() -> Self {
        Self {
            value: SVector::zeros(),
            by_joints: SMatrix::zeros(),
            by_body: SMatrix::zeros(),
            by_parameters: SMatrix::zeros(),
        }
    }
}

impl<const J: usize, const M: usize, const P: usize> Default for Prediction<J, M, P> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const J: usize> Row<J> {
    /// Whether one distance was read, instead of a place.
    #[inline]
    #[must_use]
    pub fn is_distance(&self) -> bool {
        self.to.is_some() || self.aim.from.is_some()
    }
}
