//! The linear delta: three vertical prismatic joints, three rod pairs, a platform that stays parallel.
//!
//! Source: Xiao et al., "Delta Robot Kinematic Calibration for Precise Robot-Assisted Retinal Surgery",
//! ISMR 2022, Eqs. 1 to 9 (two signs of Eq. 2 are misprinted; Eq. 3 is right).

mod calibrated;
pub mod correction;
mod effects;
mod geometry;
mod kinematics;
mod model;
pub mod moments;
mod nominal;
mod pose;
mod six_rods;
mod solved;
mod structure;
mod trilateration;

pub use calibrated::{Branch, Calibrated};
pub use effects::{CATALOGUE, PARAMETERS, Values};
pub use geometry::{Assembly, GEOMETRIC, Geometry, IDENTIFIABLE, LIMBS, Limb, PER_LIMB};
pub use kinematics::Kinematics;
pub use model::{Chain, Covariates, Prediction, READINGS, Row};
pub use nominal::Model;
pub use pose::Pose;
pub use structure::Structure;
