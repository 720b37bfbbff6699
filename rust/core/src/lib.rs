//! Numerics of sherkit: `no_std`, no allocation, no panics.
//!
//! Lengths are millimetres and angles radians throughout. Storage whose size depends on the number of
//! parameters is lent by the caller, so that the same code serves a control loop and a study of ten
//! million rows.
//!
//! The floors, from below: [`numbers`] and [`error`]; [`fit`], [`evidence`] and [`camera`], which know nothing of each other;
//! [`chain`], what all robots share; [`delta`], [`spherical`] and [`serial`], each with what only its mechanism has; [`flat`], which
//! carries a calibrated robot to a control loop. Beside them, for the flexible tool: [`tool`] (fibres, beam, their
//! calibration, and the filters that a control loop runs).
#![no_std]
#![cfg_attr(doctest, doc = include_str!("../README.md"))]

pub mod camera;
pub mod chain;
pub mod delta;
pub mod error;
pub mod evidence;
pub mod fit;
pub mod flat;
pub mod numbers;
pub mod serial;
pub mod spherical;
pub mod tool;

pub use error::{Error, Result, Singularity};
