//! The spherical parallel robot: two limbs with a common actuated axis, all axes through one centre.
//!
//! Frame: origin at the remote centre of motion; z along the common actuated axis; joint angles θ and the azimuth φ
//! counted about z from the x axis, right-handed; γ from the z axis, so that the tool axis is
//! `(sin γ cos φ, sin γ sin φ, cos γ)`. Elbow axis of limb i: polar angle `α_i`, azimuth `θ_i + offset_i`. With equal
//! limbs φ is the mean of the joint angles and γ follows from the spherical cosine rule.
//!
//! Source: Agand, Taghirad, Molaei, "Vision-Based Kinematic Calibration of Spherical Robots" (Eqs. 6, 10 to 12, 20 to
//! 35; Eqs. 11, 12 and 27 are misprinted).

mod calibrated;
mod centre;
mod cones;
mod effects;
mod geometry;
mod kinematics;
mod model;
mod nominal;
mod pose;
mod residual;
mod structure;
pub mod vision;

pub use calibrated::Calibrated;
pub use centre::Centre;
pub use effects::{CATALOGUE, PARAMETERS, Values};
pub use geometry::{Assembly, Elbows, GEOMETRIC, Geometry, LIMBS, Limb, PER_LIMB};
pub use kinematics::Kinematics;
pub use model::{Chain, Covariates, Instrument, Prediction, READINGS, Row};
pub use nominal::{Model, Readings};
pub use pose::Pose;
pub use residual::InverseResidual;
pub use structure::Structure;
