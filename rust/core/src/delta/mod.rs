//! The linear delta: three vertical prismatic joints, three rod pairs, a platform that stays parallel.
//!
//! Source: Xiao et al., "Delta Robot Kinematic Calibration for Precise Robot-Assisted Retinal Surgery",
//! ISMR 2022, Eqs. 1 to 9 (two signs of Eq. 2 are misprinted; Eq. 3 is right).

mod chain;
mod geometry;
mod kinematics;
pub mod parameters;
mod row;
mod structure;
mod trilateration;

pub use chain::{
    Chain, Covariates, LINEARITY_SPAN_MM, Model, Prediction, REFERENCE_TEMPERATURE_C, Wanted,
};
pub use geometry::{Assembly, GEOMETRIC, Geometry, IDENTIFIABLE, LIMBS, Limb, PER_LIMB};
pub use kinematics::{Kinematics, Pose};
pub use row::{Kind, Row};
