//! Numerics of sherkit: `no_std`, no allocation, no panics.
//!
//! Lengths are millimetres and angles radians throughout. Storage whose size depends on the number of
//! parameters is lent by the caller, so that the same code serves a control loop and a study of ten
//! million rows.
//!
//! The floors, from below: [`math`], [`trig`], [`inverse`] and [`error`]; [`delta`], [`camera`] and [`least_squares`], which know
//! nothing of each other; [`spherical`], which is seen by a [`camera`]; [`bernstein`]; [`calibrated`], the model that
//! a control loop runs; [`flat`], which carries it there. Beside them, for the flexible tool: [`rigid`] and [`jacobi`]; [`registration`] and [`tool`]
//! (fibres, beam, their calibration); [`kalman`], the filters that a control loop runs.
#![no_std]

pub mod bernstein;
pub mod calibrated;
pub mod camera;
pub mod delta;
pub mod error;
pub mod flat;
pub mod inverse;
pub mod jacobi;
pub mod kalman;
pub mod least_squares;
pub mod math;
pub mod registration;
pub mod rigid;
pub mod spherical;
pub mod tool;
pub mod trig;

pub use error::{Error, Result, Singularity};
