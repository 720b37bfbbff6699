//! The frames in which a calibrated robot's places are given.

/// Where coordinates are counted from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame {
    /// The base of the robot, as its drawing and its controller have it.
    Base,
    /// The instrument that measured it, where that stood.
    Sensor,
}
