//! The measurement chain, once for every robot: joint readings → joints → structure → body → sensor → reading.
//!
//! A link maps a value to a value and knows two derivatives: by its input, and by its own parameters. The derivative of a
//! reading by a parameter is that of its own link, carried on by the derivatives of the links behind it. What differs
//! from robot to robot is the link `structure`, a [`Mechanism`]; [`joints`](Joints), [`body`](Body) and the sensors
//! ([`Cartesian`], [`Tracker`], [`Eye`], [`Angles`]) are the same for all. Which of their effects a robot has, its table says
//! ([`effects`]): the place of each parameter is a constant of the type, so that what a robot has not costs nothing.
//!
//! A covariate that a row lacks is NaN; an effect that needs it must then be at zero, where it is not asked.
//!
//! The numbers `J` of joints, `M` of readings and `P` of parameters are parameters of every type, because stable Rust has
//! no other way to say that the sizes of arrays belong to a robot.

mod angles;
mod bar;
pub(crate) mod body;
mod camera;
mod cartesian;
mod columns;
pub mod effects;
mod frame;
mod gauges;
mod inverse;
mod joints;
mod mechanism;
pub mod places;
#[cfg(test)]
mod planar;
mod plane;
mod readings;
mod robot;
mod row;
mod sensor;
mod sensor_pose;
pub(crate) mod table;
mod tracker;

pub use angles::Angles;
pub(crate) use angles::{angles_by_axis, angles_of};
pub use bar::CENTRES;
pub use body::{Body, REFERENCE_TEMPERATURE_C};
pub use camera::Eye;
pub use cartesian::{Cartesian, LINEARITY_SPAN_MM};
pub use columns::Columns;
pub use frame::Frame;
pub use gauges::{Around, Between, Gauge, Gauges};
pub(crate) use inverse::inverse;
pub use joints::{Joints, Turned};
pub use mechanism::Mechanism;
pub use plane::{Flat, PLANES};
pub(crate) use robot::Trail;
pub use robot::{Chain, Distances, Robot};
pub use row::{Aim, Covariates, Fixed, Prediction, Row};
pub use sensor::{Look, Sensor};
pub use sensor_pose::{Moments, SensorPose, Stand};
pub use table::{Settings, Table};
pub use tracker::Tracker;
