//! A serial arm: up to nine revolute or prismatic joints, one behind another, and a target that a tracker sees.
//!
//! Every geometric error is a small joint of its own before the joint that it belongs to: two shifts and two tilts across
//! its axis, besides the offset along or about it. Standard and modified Denavit-Hartenberg, Hayati and URDF tables all
//! turn into this form, which stays well conditioned where neighbouring axes are parallel (Hayati and Mirmirani,
//! "Improving the absolute positioning accuracy of robot manipulators", 1985; Schröer, Albright and Grethlein,
//! "Complete, minimal and model-continuous kinematic models for robot calibration", 1997).

mod arm;
mod calibrated;
mod effects;
mod frames;
mod load;
mod model;
mod structure;

pub use arm::{JOINTS, Joint, Model, TARGETS};
pub use calibrated::{Calibrated, Limits};
pub use effects::{CATALOGUE, PARAMETERS, Values};
pub use model::{Chain, Covariates, Prediction, READINGS, Row};
pub use structure::Structure;
