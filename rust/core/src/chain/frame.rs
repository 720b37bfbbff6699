//! The frames in which a calibrated robot's places are given.

/// Where coordinates are counted from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame {
    /// The base of the robot, as its drawing and its controller have it: where the robot is. Nothing of the instrument is in
    /// it, neither its errors nor a slip of its stand.
    Base,
    /// The instrument that measured it, as that reads, errors and all, from where it stands at last.
    Sensor,
}
